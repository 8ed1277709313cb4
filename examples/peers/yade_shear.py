"""Shear a scene with YADE; started by `peers.run_peer` as `yade -n -x yade_shear.py scene.npz --steps 4000`.

Contacts are `Law2_ScGeom_FrictPhys_CundallStrack` with Cundall's local damping, which is what YADE is made for; for
equal balls its kn is young * radius and its ks poisson * kn, and likewise against a wall. The spring of a contact turns
with the common spin of its balls, and ours does not; in a triaxial test nothing spins that way. The membrane's forces
are permanent forces, turned to the axis at every record. Prints one line of JSON.
"""

import argparse
import json
import math
import time

import numpy as np

BEGAN = time.perf_counter()
SKIN = 0.02  # of the radius: what boxes are larger than their balls; balls hardly move

parser = argparse.ArgumentParser()
parser.add_argument("scene")
parser.add_argument("--steps", type=int, required=True)
parser.add_argument("--record", type=int, default=50)
parser.add_argument("--damping", choices=("local",), default="local")
parser.add_argument("--time-step", type=float)
parser.add_argument("--speed", type=float)
options = parser.parse_args()

scene = np.load(options.scene)
time_step = options.time_step or float(scene["time_step"])
speed = options.speed or float(scene["platen_speed"])
ramp = float(scene["ramp_time"])
radius, stiffness = float(scene["radius"]), float(scene["normal_stiffness"])
positions = scene["positions"].T
bottom, top = (float(height) for height in scene["platens"])

balls = {"young": stiffness / radius, "poisson": float(scene["shear_stiffness"]) / stiffness}
O.materials.append(  # noqa: F821 - YADE puts O and its classes into a script's namespace
    FrictMat(density=float(scene["density"]), frictionAngle=math.atan(float(scene["friction"])), label="ball", **balls)  # noqa: F821
)
O.materials.append(FrictMat(density=1, frictionAngle=0, label="platen", **balls))  # noqa: F821
O.bodies.append([utils.sphere(tuple(place), radius, material="ball") for place in positions.tolist()])  # noqa: F821
low = O.bodies.append(utils.wall((0, 0, bottom), axis=2, sense=1, material="platen"))  # noqa: F821
high = O.bodies.append(utils.wall((0, 0, top), axis=2, sense=-1, material="platen"))  # noqa: F821

magnitude = scene["membrane_force"]
zone = np.flatnonzero(magnitude).tolist()
pushes = []


def record():
    """Turn the membrane's forces, and note the platen force."""
    for i in zone:
        x, y, _ = O.bodies[i].state.pos  # noqa: F821
        inward = -magnitude[i] / math.hypot(x, y)
        O.forces.setPermF(i, (inward * x, inward * y, 0.0))  # noqa: F821
    pushes.append((abs(O.forces.f(low)[2]) + abs(O.forces.f(high)[2])) / 2)  # noqa: F821


def drive():
    """The smooth ramp 3 x^2 - 2 x^3 of the platen speed; once it is reached, nothing is left to do."""
    x = min((O.iter + 1) * time_step / ramp, 1.0)  # noqa: F821
    now = speed * x * x * (3 - 2 * x)
    O.bodies[low].state.vel, O.bodies[high].state.vel = (0, 0, now), (0, 0, -now)  # noqa: F821
    if x >= 1:
        driver.dead = True  # noqa: F821


O.engines = [  # noqa: F821
    ForceResetter(),  # noqa: F821
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=SKIN * radius),  # noqa: F821
    InteractionLoop(  # noqa: F821
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()],  # noqa: F821
        [Ip2_FrictMat_FrictMat_FrictPhys()],  # noqa: F821
        [Law2_ScGeom_FrictPhys_CundallStrack()],  # noqa: F821
    ),
    PyRunner(command="drive()", iterPeriod=1, label="driver"),  # noqa: F821
    NewtonIntegrator(damping=float(scene["local_damping"]), gravity=(0, 0, 0)),  # noqa: F821
    PyRunner(command="record()", iterPeriod=options.record),  # noqa: F821
]
O.dt = time_step  # noqa: F821
record()
pushes.clear()
O.run(1, True)  # noqa: F821
setup = time.perf_counter() - BEGAN
started = time.perf_counter()
O.run(options.steps, True)  # noqa: F821
seconds = time.perf_counter() - started
ratio = np.array(pushes) / float(scene["section"]) / float(scene["confining_stress"])
at = np.arange(1, ratio.size + 1) * options.record * time_step
x = at / ramp
strain = 2 * speed * ramp * np.where(x < 1, x**3 - x**4 / 2, x - 0.5) / (top - bottom)
from yade import config  # noqa: E402

reply = {
    "seconds": seconds, "setup_seconds": setup, "steps": options.steps,
    "version": f"YADE {config.version}", "axial_strain": strain.tolist(), "stress_ratio": ratio.tolist(),
}  # fmt: skip
print(json.dumps(reply), flush=True)
