"""Shear a packing of equal balls with rolling resistance with LAMMPS; started by `peers.run_peer`.

    python lammps_rolling.py scene.npz --steps 4000

Contacts are `granular`: hooke, tangential linear_history, rolling sds, all without dashpots; damping is `fix
damping/cundall`. The moment of `rolling sds` is that of a spring at the effective radius R1 R2/(R1 + R2), so for equal
balls our law has k_r = 4 alpha_r ks and mu_r = 2 eta_r; with balls of many sizes no one pair of numbers is our law.
The rest is as in `lammps_shear`, but for walls that meet every ball.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from lammps_shear import SKIN, load_library, press


def build(scene, options, lammps):
    """A LAMMPS instance, ready to shear."""
    lmp = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
    positions = scene["positions"]
    radius = float(np.mean(scene["radius"]))
    if np.ptp(scene["radius"]) > 0:
        raise SystemExit("lammps_rolling takes equal balls: its rolling law is ours for these only")
    stiffness, shear = float(scene["normal_stiffness"]), float(scene["shear_stiffness"])
    rolling = 4 * float(scene["rolling_stiffness"]) * shear, 2 * float(scene["rolling_friction"])
    (low_x, low_y), (high_x, high_y) = positions[:2].min(axis=1) - 6 * radius, positions[:2].max(axis=1) + 6 * radius
    bottom, top = (float(height) for height in scene["platens"])
    ramp, damping = float(scene["ramp_time"]), float(scene["local_damping"])
    count = positions.shape[1]
    lmp.commands_list(
        [
            "units si",
            "atom_style sphere",
            "atom_modify map array",
            "boundary f f f",
            "newton on",
            "comm_modify vel yes",
            f"region box block {low_x} {high_x} {low_y} {high_y} {bottom - 2 * radius} {top + 2 * radius}",
            "create_box 1 box",
        ]
    )
    lmp.create_atoms(count, list(range(1, count + 1)), [1] * count, positions.T.ravel().tolist())
    lmp.commands_list(
        [
            f"set group all diameter {2 * radius!r}",
            f"set group all density {float(scene['density'])!r}",
            f"neighbor {SKIN * radius!r} bin",
            "neigh_modify delay 0 every 10 check yes",
            "pair_style granular",
            f"pair_coeff * * hooke {stiffness!r} 0.0 tangential linear_history {shear!r} 0.0 "
            f"{float(scene['friction'])!r} rolling sds {rolling[0]!r} 0.0 {rolling[1]!r} damping velocity",
            f"timestep {options.time_step!r}",
            "variable t equal step*dt",
            f"variable x equal v_t/{ramp!r}",
            f"variable way equal {options.speed * ramp!r}*((v_x<1)*(v_x^3-v_x^4/2)+(v_x>=1)*(v_x-0.5))",
            f"variable bottom equal {bottom!r}+v_way",
            f"variable top equal {top!r}-v_way",
            "fix motion all nve/sphere",
            f"fix low all wall/harmonic zlo v_bottom {stiffness / 2!r} 0.0 {radius!r} units box",
            f"fix high all wall/harmonic zhi v_top {stiffness / 2!r} 0.0 {radius!r} units box",
            "fix membrane all external pf/array 1",
            f"fix drag all damping/cundall {damping} {damping}",  # after every force
            "thermo_modify norm no lost error",
            f"thermo {10**9}",
        ]
    )
    return lmp


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("--record", type=int, default=50)
    parser.add_argument("--damping", choices=("local",), default="local")
    options = parser.parse_args()
    began = time.perf_counter()
    lammps = load_library()
    scene = np.load(options.scene)
    options.time_step, options.speed = float(scene["time_step"]), float(scene["platen_speed"])
    lmp = build(scene, options, lammps)
    magnitude = scene["membrane_force"]
    press(lmp, magnitude)
    lmp.command("run 0 post no")
    setup = time.perf_counter() - began
    pushes, started = [], time.perf_counter()
    for _ in range(options.steps // options.record):
        press(lmp, magnitude)
        lmp.command(f"run {options.record} pre no post no")
        pushes.append((abs(lmp.extract_fix("low", 0, 1, 0)) + abs(lmp.extract_fix("high", 0, 1, 0))) / 2)
    seconds = time.perf_counter() - started
    ratio = np.array(pushes) / float(scene["section"]) / float(scene["confining_stress"])
    ramp = float(scene["ramp_time"])
    x = (np.arange(ratio.size) + 1) * options.record * options.time_step / ramp
    strain = 2 * options.speed * ramp * np.where(x < 1, x**3 - x**4 / 2, x - 0.5) / np.ptp(scene["platens"])
    reply = {
        "seconds": seconds, "setup_seconds": setup, "steps": options.record * ratio.size,
        "version": f"LAMMPS {lmp.version()}", "axial_strain": strain.tolist(), "stress_ratio": ratio.tolist(),
    }  # fmt: skip
    print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    main()
