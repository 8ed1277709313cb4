"""Sands hidden behind other packings: how near a fit comes to them, and whether its intervals hold them.

    python examples/twin_sands.py --truths 10 --folder twin_sands     # an hour of one core
    python examples/twin_sands.py --truths 20 --folder twin_sands --rolling

Parameters are drawn, a specimen of 500 balls (--balls for others; half of them are simulated) is packed and sheared
with them to 10 % strain, 1 % noise is put on R and volumetric strain, and the fit knows nothing but that curve. Half
the truths are the curve of one packing, half the mean of eight. One library of 40 runs, on packings of its own, serves
all of them.
Writes twins.csv: for each truth and parameter the true value, the interval, and the verdict.
"""

import argparse
import csv
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.stats import qmc

import axijax
import calibrate
from calibrate.axes import axes_of, physical
from calibrate.ensemble import run_all
from calibrate.library import Library

SECTOR, REACH, NOISE = axijax.Sector(2), 0.0975, 0.01
STRESS, RADIUS = 5.0e4, 20.0
BOUNDS = {
    False: {
        "friction": (0.15, 0.65),
        "normal_stiffness": (400 * STRESS * RADIUS, 8000 * STRESS * RADIUS),
        "stiffness_ratio": (0.1, 1.5),
    },
    True: {
        "friction": (0.15, 0.65),
        "normal_stiffness": (400 * STRESS * RADIUS, 8000 * STRESS * RADIUS),
        "rolling_friction": (0.0, 0.6),
    },
}
# Where truths lie: f 0.2..0.6, kn/(s3 r) 600..6000, ks/kn 0.2..1, eta_r 0..0.5.
TRUE = {"friction": (0.2, 0.6), "normal_stiffness": (6e8, 6e9), "stiffness_ratio": (0.2, 1.0),
        "rolling_friction": (0.0, 0.5)}  # fmt: skip


def sand(seed: int, params: axijax.Params, balls: int) -> axijax.TriaxialTest:
    """A test of a dense random specimen, loaded at an inertial number of 2e-3."""
    specimen, report = axijax.random_cylinder(balls, SECTOR, compaction_friction=0.05, seed=seed, params=params)
    params = replace(params, platen_speed=axijax.platen_speed(2e-3, specimen, params))
    return axijax.TriaxialTest(
        specimen, SECTOR, params=params, axial_strain=REACH, confining_friction=report.compaction_friction,
        tolerance=1e-3, confine_steps=100_000, record_every=20,
    )  # fmt: skip


def scene(rolling: bool, balls: int) -> calibrate.RandomScene:
    params = axijax.Params(friction=0.4, normal_stiffness=2e9, shear_stiffness=1e9, confining_stress=STRESS)
    if rolling:
        params = replace(params, shear_stiffness=6e8, rolling_friction=0.2)
    made = {"make": f"{sand.__module__}.sand", "balls": str(balls)}
    return calibrate.RandomScene(partial(sand, balls=balls), params, made, {"friction": 0.05})


def hidden(names, number: int) -> list[float]:
    """The values of a truth."""
    share = qmc.Sobol(len(names), seed=1).random(64)[number]
    values = []
    for name, u in zip(names, share, strict=True):
        low, high = TRUE[name]
        values.append(low + u * (high - low) if name in ("friction", "rolling_friction") else low * (high / low) ** u)
    return values


def measured(curves, number: int) -> tuple[calibrate.MeasuredCurve, float]:
    """The mean of curves with noise, and the mean void ratio that they begin with."""
    strain = 2e-4 + (REACH - 2e-4) * np.linspace(0, 1, 250) ** 1.5
    rng = np.random.default_rng(number)
    ratio, volume = (
        np.mean([np.interp(strain, c.axial_strain, getattr(c, name)) for c in curves], axis=0)
        for name in ("stress_ratio", "volumetric_strain")
    )
    ratio = ratio * (1 + NOISE * rng.standard_normal(strain.size))
    volume = volume + NOISE * np.abs(volume).max() * rng.standard_normal(strain.size)
    return calibrate.MeasuredCurve(strain, ratio, volume), float(np.mean([c.void_ratio[:3].mean() for c in curves]))


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--folder", type=Path, default=Path("twin_sands"))
    asked.add_argument("--balls", type=int, default=500, help="in the full cylinder")
    asked.add_argument("--truths", type=int, default=10, help="of one packing")
    asked.add_argument("--of-eight", type=int, default=10, help="truths that are the mean of eight packings")
    asked.add_argument("--further", type=int, default=0, help="runs placed for each truth; 0: the 40 alone")
    asked.add_argument("--rolling", action="store_true", help="with rolling friction, ks/kn held")
    asked.add_argument("--without-void-ratio", action="store_true", help="the fit is not told the truths' void ratios")
    asked.add_argument("--workers", type=int, default=1)
    given = asked.parse_args()
    world, bounds = scene(given.rolling, given.balls), BOUNDS[given.rolling]
    names, axes = list(bounds), axes_of(world, list(bounds), bounds)
    truths = Library(world, given.folder / "truths")
    rows = []
    for packings in (1, 8):
        for number in range(given.truths if packings == 1 else given.of_eight):
            values = hidden(names, number if packings == 1 else 20 + number)
            point = world.point(physical(world, axes, values), STRESS)
            first = 100_000 + number if packings == 1 else 200_000 + 8 * number
            made = run_all(world, [(point, first + k) for k in range(packings)], REACH, truths, workers=given.workers)
            curves = [SimpleNamespace(**run.curve) for run in made if run.curve is not None]
            curve, void_ratio = measured(curves, number)
            test = calibrate.StudyTest(
                "twin", curve, world, packings=packings, void_ratio=None if given.without_void_ratio else void_ratio
            )
            fit = calibrate.fit_study(
                [test], names, bounds=bounds, runs=40, further=given.further, library=given.folder / "runs",
                workers=given.workers,
            )  # fmt: skip
            for name, true in zip(names, values, strict=True):
                low, middle, high = fit.intervals[name]
                wrong = middle - true if name == "rolling_friction" else middle / true - 1
                rows.append([packings, number, name, true, low, middle, high, wrong, low < true < high, fit.made,
                             fit.status])  # fmt: skip
            shown = ", ".join(f"{row[2]} {row[5]:.3g} for {row[3]:.3g}" for row in rows[-len(names):])
            print(f"{packings} packing(s), truth {number}: {shown}; {fit.status}", flush=True)
    with open(given.folder / "twins.csv", "w", newline="") as file:
        writer = csv.writer(file)
        heads = "packings truth parameter true low median high error inside new_runs status"
        writer.writerow(heads.split())
        writer.writerows(rows)
    print("packings, parameter: truths, median |error|, share of 95 % intervals that hold the truth")
    for packings in (1, 8):
        for name in names:
            mine = [row for row in rows if row[0] == packings and row[2] == name]
            if not mine:
                continue
            error, inside = np.median([abs(row[7]) for row in mine]), np.mean([row[8] for row in mine])
            print(f"  {packings}, {name}: {len(mine)}, {error:.3f}, {inside:.2f}")
    wrong = [row for row in rows if row[10] == "converged" and not row[8]]
    print(f"converged and outside its interval: {len(wrong)} of {sum(row[10] == 'converged' for row in rows)}")


if __name__ == "__main__":
    axijax.fast_cpu_kernels()
    main()
