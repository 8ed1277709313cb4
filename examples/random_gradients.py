"""Where is a derivative to friction healthy in randomly packed balls, and does the mean over packings hold longer?

    python examples/random_gradients.py [--balls 150] [--packings 8] [--damping-ratio 0.3] [--output FOLDER]

Quarter sectors of random packings are sheared at f = 0.3 to 1 % axial strain. For each packing: dR/df as a tangent, the
verdict of calibrate on it (tangent against central differences with h = 1e-3 of the same packing) and the strain at
which the two part by 10 %. For the ensemble: the mean tangent against differences with h = 0.02 and 0.05 of the mean
curve, in windows of strain, each with its standard error. One contact list serves a run (`simulate`), which is right
at these strains; a packing whose run is not sound is named and left out. The contacts are damped with beta = 0.3: with
the usual 0.05 the differences are the same, but tangents run away from 0.5 % strain. Written: random_gradients.csv and
random_gradients.png. PHYSICS.md, section 4, has figures of an independent program.
"""

import argparse
import csv
import time
from dataclasses import replace
from pathlib import Path

import axijax

axijax.fast_cpu_kernels()  # forward mode only, four times as fast; before anything is computed

import numpy as np  # noqa: E402

from axijax.specimen.grading import linear  # noqa: E402
from axijax.triaxial.random_specimen import platen_speed, random_cylinder  # noqa: E402
from calibrate import Model, RunFailed, WindowMean, gradient  # noqa: E402

FRICTION = 0.3
WINDOWS = ((0.002, 0.004), (0.004, 0.006), (0.006, 0.008), (0.008, 0.01))
STEPS = (0.02, 0.05)  # of friction, for the differences of the mean curve
STRAINS = np.linspace(0, 0.01, 101)


def one_packing(balls: int, seed: int, damping_ratio: float):
    """(verdict, parting strain, tangent at STRAINS, {h: difference quotient at STRAINS}) of one packing."""
    sector = axijax.Sector(4)
    specimen, _ = random_cylinder(4 * balls, sector, linear(17.0, 23.0), compaction_friction=0.05, seed=seed)
    params = axijax.Params(friction=FRICTION, damping_ratio=damping_ratio)
    params = replace(params, platen_speed=platen_speed(1e-3, specimen, params))
    test = axijax.TriaxialTest(
        specimen, sector, params=params, axial_strain=0.0105, confining_friction=0.05, tolerance=1e-3
    )
    model = Model(test, "f", hold_time_step=False)
    found = gradient(model, WindowMean(0.002, 0.01), "f", steps=(1e-3,))
    z = model.parameters.coordinates()
    curve, tangents = model.run_with_tangents(z)
    per_friction = 1 / (FRICTION * (1 - FRICTION))

    def sampled(run, values):
        return np.interp(STRAINS, run.axial_strain, values)

    quotients = {}
    for h in STEPS:
        up, down = (model.run(model.parameters.coordinates({"f": FRICTION + side * h})) for side in (1, -1))
        quotients[h] = (sampled(up, up.stress_ratio) - sampled(down, down.stress_ratio)) / (2 * h)
    health = found.health
    return health.verdict, health.usable_strain, sampled(curve, tangents.stress_ratio[0]) * per_friction, quotients


def in_windows(rows: np.ndarray) -> np.ndarray:
    """(K, W) means of (K, 101) rows over the windows."""
    return np.stack([rows[:, (a <= STRAINS) & (b >= STRAINS)].mean(axis=1) for a, b in WINDOWS], axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--balls", type=int, default=150, help="in the quarter sector")
    parser.add_argument("--packings", type=int, default=8)
    parser.add_argument("--damping-ratio", type=float, default=0.3, help="beta of the contact dashpots")
    parser.add_argument("--output", default=".", help="folder for the table and the picture")
    options = parser.parse_args()
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)

    tangents, quotients, rows = [], {h: [] for h in STEPS}, []  # one entry a packing
    for seed in range(options.packings):
        clock = time.perf_counter()
        try:
            verdict, usable, tangent, differences = one_packing(options.balls, seed, options.damping_ratio)
        except (RunFailed, axijax.SimulationError, ValueError) as error:
            print(f"packing {seed}: left out, {error}", flush=True)
            continue
        tangents.append(tangent)
        for h in STEPS:
            quotients[h].append(differences[h])
        rows.append([seed, verdict, usable, *in_windows(tangent[None])[0]])
        shown = "  ".join(f"{value:8.3g}" for value in rows[-1][3:])
        print(f"packing {seed}: {verdict:28s} {shown}   {time.perf_counter() - clock:.0f} s", flush=True)
    if len(rows) < 2:
        raise SystemExit("fewer than two packings gave sound runs: nothing to average.")
    with (folder / "random_gradients.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["seed", "verdict", "usable_strain", *(f"dR/df {a:g}..{b:g}" for a, b in WINDOWS)])
        writer.writerows(rows)

    tangents, usable = np.array(tangents), np.array([row[2] for row in rows])
    differences = {h: np.array(values) for h, values in quotients.items()}
    report(tangents, usable, differences)
    draw(tangents, usable, differences, folder / "random_gradients.png")
    print(f"written: {folder / 'random_gradients.csv'}, {folder / 'random_gradients.png'}")


def report(tangents, usable, quotients) -> None:
    """Mean and standard error over the packings, by window; third, of the tangents that the verdict allows."""
    print(f"\ndR/df at f = {FRICTION:g}, mean of {len(tangents)} packings +- standard error")
    print(f"{'strain':30s}" + "".join(f"{f'{100 * a:g}..{100 * b:g} %':>16s}" for a, b in WINDOWS))
    healthy = np.where(usable[:, None] >= [b for _, b in WINDOWS], in_windows(tangents), np.nan)
    series = {f"differences, h = {h:g}": in_windows(values) for h, values in quotients.items()}
    series |= {"tangents": in_windows(tangents), "tangents, where usable": healthy}
    for name, values in series.items():
        cells = []
        for column in values.T:
            kept = column[np.isfinite(column)]
            error = f" +- {kept.std(ddof=1) / np.sqrt(kept.size):.2g}" if kept.size > 1 else ""
            cells.append(f"{kept.mean():.3g}{error}" if kept.size else "-")
        print(f"{name:30s}" + "".join(f"{cell:>16s}" for cell in cells))
    counts = (f"{count} of {len(usable)}" for count in np.isfinite(healthy).sum(axis=0))
    print(f"{'packings where usable':30s}" + "".join(f"{count:>16s}" for count in counts))


def draw(tangents, usable, quotients, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 4), layout="constrained")
    FigureCanvasAgg(figure)
    single, mean = figure.subplots(1, 2, sharey=True)
    x, top = 100 * STRAINS, 2.5 * np.abs(quotients[STEPS[-1]].mean(axis=0)).max()
    for place, (tangent, limit, difference) in enumerate(zip(tangents, usable, quotients[STEPS[0]], strict=True)):
        first, colour = not place, f"C{place % 10}"
        kept = limit >= STRAINS
        single.plot(x[kept], tangent[kept], color=colour, lw=1.4, label="tangent, as far as usable" if first else None)
        single.plot(x[kept][-1:], tangent[kept][-1:], "o", color=colour, ms=4)
        single.plot(x, difference, ":", color=colour, lw=0.8, label=f"difference, h = {STEPS[0]:g}" if first else None)
    single.set(title="each packing", ylabel="dR/df [-]", ylim=(-0.3 * top, top))
    series = {f"differences, h = {h:g}": v for h, v in quotients.items()} | {"tangents": tangents}
    for place, (name, values) in enumerate(series.items()):
        middle, error = values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))
        mean.plot(x, middle, color=f"C{place}", label=name)
        mean.fill_between(x, middle - error, middle + error, color=f"C{place}", alpha=0.2)
    mean.set(title=f"mean of {len(tangents)} packings, band: standard error")
    for axes in (single, mean):
        axes.set_xlabel("axial strain [%]")
        axes.legend(frameon=False, fontsize="small", loc="upper left")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
