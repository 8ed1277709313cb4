"""Rolling resistance beside YADE and LAMMPS, on the same random packings; half an hour on two cores.

    python examples/peers/rolling.py [--balls 500] [--seeds 2] [--codes YADE,LAMMPS] [--keep curves.npz]

A full cylinder of balls is compacted and confined here. From the confined positions, at rest and without springs, each
code shears it with the membrane's forces fixed in size, Cundall's local damping and the same time step, for four pairs
of friction f and rolling friction eta_r. Balls are of many sizes for YADE, whose law is ours. LAMMPS gets equal balls:
its `rolling sds` uses the effective radius R1 R2/(R1 + R2) with one pair of numbers for all contacts, so that it is our
law for equal balls only, with mu_r = 2 eta_r and k_r = 4 alpha_r ks.

Neighbouring trajectories of a random packing part soon: the same program from a start moved by 1e-9 of a radius is what
another code can be asked to agree with, and stands beside it. Printed for each pair, up to our peak: mean and largest
difference in R from ours, as shares of R, after a running mean over 0.1 % strain; for each packing, and for the mean
curve of all packings.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import axijax

axijax.fast_cpu_kernels()

import jax  # noqa: E402
import numpy as np  # noqa: E402
import peers  # noqa: E402

from axijax.grading import linear, uniform  # noqa: E402
from axijax.triaxial.progress import Progress, begin  # noqa: E402

PAIRS = {(0.4, 0.0): 0.03, (0.4, 0.1): 0.04, (0.4, 0.3): 0.07, (0.25, 0.5): 0.07}  # and an axial strain past the peak
STIFFNESS_RATIO, ROLLING_STIFFNESS = 0.3, 0.5
SMOOTHED = 0.001  # strain of the running mean
OURS, MOVED = "ours", "moved"


def make_test(specimen, friction, eta, inertial_number, axial_strain, confining_friction) -> axijax.TriaxialTest:
    rolling = axijax.Rolling(rolling_stiffness=ROLLING_STIFFNESS, rolling_friction=eta)
    stiffness = axijax.Params().normal_stiffness
    params = axijax.Params(
        friction=friction, shear_stiffness=STIFFNESS_RATIO * stiffness, rolling=rolling, damping=axijax.LocalDamping()
    )
    params = replace(params, platen_speed=axijax.platen_speed(inertial_number, specimen, params))
    return axijax.TriaxialTest(
        specimen, axijax.Sector(1), params=params, axial_strain=axial_strain, refresh=False, tolerance=1e-3,
        confining_friction=confining_friction,
    )  # fmt: skip


def from_rest(test: axijax.TriaxialTest, confined: Progress, moved: float = 0.0) -> Progress:
    """The start of a shear at the confined positions, moved a little at random, without springs."""
    state = confined.state
    rng = np.random.default_rng(0)
    radius = test.cut.radius.mean()
    displacement = jax.tree.map(lambda x: x + moved * radius * rng.normal(size=x.shape), state.displacement)
    memory = jax.tree.map(lambda x: 0 * x, state.memory)
    return confined._replace(params=test.params, state=state._replace(displacement=displacement, memory=memory))


def smoothed(strain, ratio, at):
    """Running mean of a curve over SMOOTHED strain, at these strains."""
    area = np.concatenate([[0.0], np.cumsum((ratio[1:] + ratio[:-1]) / 2 * np.diff(strain))])
    low, high = np.maximum(at - SMOOTHED / 2, strain[0]), np.minimum(at + SMOOTHED / 2, strain[-1])
    return (np.interp(high, strain, area) - np.interp(low, strain, area)) / (high - low)


def compare(ours, theirs):
    """Mean and largest difference up to our peak, both peaks with their strains; all of smoothed curves."""
    at = np.arange(SMOOTHED, min(ours[0][-1], theirs[0][-1]) - SMOOTHED / 2, SMOOTHED / 10)
    mine, other = smoothed(*ours, at), smoothed(*theirs, at)
    top = int(mine.argmax())
    difference = np.abs(other / mine - 1)[: top + 1]
    return difference.mean(), difference.max(), mine[top], at[top], other.max(), at[other.argmax()]


def curve_of(curve):
    return np.asarray(curve.axial_strain), np.asarray(curve.stress_ratio)


def shear(specimen, pair, options, compaction_friction, codes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Curves of one packing by code, ours first; strain and stress ratio each."""
    test = make_test(specimen, *pair, options.inertial_number, PAIRS[pair], compaction_friction)
    confined = begin(test, test.params)
    start = from_rest(test, confined)
    curves = {
        OURS: curve_of(test.run(start=start).curve),
        MOVED: curve_of(test.run(start=from_rest(test, confined, 1e-9)).curve),
    }
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.npz"
        peers.write_scene(scene, test, start.network, start.state, start.fixed)
        steps = test.prepared.numerics.records * test.record_every
        for code in codes:
            done = peers.run_peer(code, scene, steps, damping="local")
            curves[code] = done.axial_strain, done.stress_ratio
    return curves


def show(pair, other: str, curves) -> None:
    mean, largest, peak, at, theirs, there = compare(curves[OURS], curves[other])
    print(
        f"  f {pair[0]:4.2f} eta_r {pair[1]:3.1f} {other:8s}R differs by {100 * mean:.2f} % in the mean, "
        f"{100 * largest:.2f} % at most; peak {peak:.3f} at {100 * at:.2f} %, theirs {theirs:.3f} at "
        f"{100 * there:.2f} % ({100 * (theirs / peak - 1):+.2f} %)",
        flush=True,
    )


def mean_curve(curves):
    """Of several packings."""
    strain = np.linspace(0, min(curve[0][-1] for curve in curves), 2001)
    return strain, np.mean([np.interp(strain, *curve) for curve in curves], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--balls", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--inertial-number", type=float, default=1e-3)
    parser.add_argument("--codes", default="YADE,LAMMPS")
    parser.add_argument("--keep", type=Path, help="file for all curves (.npz)")
    options = parser.parse_args()
    lacking = peers.missing()
    codes = [code for code in options.codes.split(",") if code not in lacking]
    for code in set(options.codes.split(",")) & set(lacking):
        print(f"{code}: {lacking[code]}")
    kept = {}
    for code, name, grading in ((peers.YADE, "radii 16 to 24", linear(16.0, 24.0)), (peers.LAMMPS, "equal", uniform())):
        if code not in codes:
            continue
        found = {pair: [] for pair in PAIRS}
        for seed in range(options.seeds):
            specimen, report = axijax.random_cylinder(options.balls, axijax.Sector(1), grading, seed=seed)
            print(f"{name}, seed {seed}: {len(specimen)} balls, void ratio {report.void_ratio:.3f}", flush=True)
            for pair in PAIRS:
                curves = shear(specimen, pair, options, report.compaction_friction, [code])
                found[pair].append(curves)
                for other in (MOVED, code):
                    show(pair, other, curves)
                kept |= {f"{name} {seed} {pair} {which}": np.stack(curve) for which, curve in curves.items()}
                if options.keep:
                    np.savez(options.keep, **kept)
        print(f"{name}, mean curves of {options.seeds} packings")
        for pair, runs in found.items():
            means = {which: mean_curve([curves[which] for curves in runs]) for which in (OURS, MOVED, code)}
            for other in (MOVED, code):
                show(pair, other, means)


if __name__ == "__main__":
    main()
