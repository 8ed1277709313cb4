"""Shear a scene with YADE; started by `peers.run_peer` as `yade -n -x yade_shear.py scene.npz --steps 4000`.

Contacts are `Law2_ScGeom_FrictPhys_CundallStrack` with Cundall's local damping, which is what YADE is made for. A scene
with rolling resistance takes `Law2_ScGeom6D_CohFrictPhys_CohesionMoment` without cohesion, in its incremental form:
rolling stiffness ks R1 R2 alphaKr, moment cut at etaRoll min(R1, R2) times the normal force, as ours. YADE makes
kn = 2 E1 r1 E2 r2/(E1 r1 + E2 r2) and likewise ks of poisson * young, so each size of ball is a material with
young = kn/radius; against a wall, which has one young for all sizes, kn and ks are put right where they are not.

The spring of a contact turns with the common spin of its balls, and ours does not; in a triaxial test nothing spins
that way. The membrane's forces are permanent forces, turned to the axis at every record. Prints one line of JSON.
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
stiffness, shear = float(scene["normal_stiffness"]), float(scene["shear_stiffness"])
positions = scene["positions"].T
radius = np.broadcast_to(scene["radius"], len(positions)).tolist()
bottom, top = (float(height) for height in scene["platens"])
rolling = "rolling_friction" in scene

balls, resisting = FrictMat, {}  # noqa: F821 - YADE puts its classes and O into a script's namespace
if rolling:
    balls = CohFrictMat  # noqa: F821
    resisting = {
        "momentRotationLaw": True, "isCohesive": False, "alphaKr": float(scene["rolling_stiffness"]),
        "etaRoll": float(scene["rolling_friction"]), "alphaKtw": 0.0, "etaTwist": 0.0,
    }  # fmt: skip


def elastic(size):
    """Of balls of this size, or of a wall that meets them."""
    return {"young": stiffness / size, "poisson": shear / stiffness}


angle, density = math.atan(float(scene["friction"])), float(scene["density"])
materials = {
    size: O.materials.append(balls(density=density, frictionAngle=angle, **elastic(size), **resisting))  # noqa: F821
    for size in sorted(set(radius))
}
# A plain one: contacts with walls are springs without friction or moments.
smooth = O.materials.append(FrictMat(density=1, frictionAngle=0, **elastic(float(np.mean(radius)))))  # noqa: F821
O.bodies.append(  # noqa: F821
    [
        utils.sphere(tuple(place), size, material=materials[size])  # noqa: F821
        for place, size in zip(positions.tolist(), radius)  # noqa: B905 - equally long
    ]
)
low = O.bodies.append(utils.wall((0, 0, bottom), axis=2, sense=1, material=smooth))  # noqa: F821
high = O.bodies.append(utils.wall((0, 0, top), axis=2, sense=-1, material=smooth))  # noqa: F821


def stiffen():
    """Walls meet balls of every size with the same stiffness."""
    for wall in (low, high):
        for contact in O.interactions.withBody(wall):  # noqa: F821
            if contact.isReal and contact.phys.kn != stiffness:
                contact.phys.kn, contact.phys.ks = stiffness, shear


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


shapes = [Ig2_Sphere_Sphere_ScGeom6D() if rolling else Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()]  # noqa: F821
physics, laws = [Ip2_FrictMat_FrictMat_FrictPhys()], [Law2_ScGeom_FrictPhys_CundallStrack()]  # noqa: F821
if rolling:
    physics.append(Ip2_CohFrictMat_CohFrictMat_CohFrictPhys())  # noqa: F821
    laws.append(Law2_ScGeom6D_CohFrictPhys_CohesionMoment(useIncrementalForm=True, always_use_moment_law=True))  # noqa: F821
O.engines = [  # noqa: F821
    ForceResetter(),  # noqa: F821
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=SKIN * min(radius)),  # noqa: F821
    InteractionLoop(shapes, physics, laws),  # noqa: F821
    PyRunner(command="drive()", iterPeriod=1, label="driver"),  # noqa: F821
    NewtonIntegrator(damping=float(scene["local_damping"]), gravity=(0, 0, 0)),  # noqa: F821
    PyRunner(command="record()", iterPeriod=options.record),  # noqa: F821
]
if len(materials) > 1:
    O.engines += [PyRunner(command="stiffen()", iterPeriod=10)]  # noqa: F821
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
