"""What the friction of the platens does to a random specimen, and what the membrane's direction does.

Dense specimens of one size, as a full cylinder and as a sector, are sheared between smooth, rough and glued platens,
and under a membrane that pushes towards the axis, along its own normal, or with its ends tied to the platens. Every run
writes one file, so the study may be stopped and started again:

    python examples/platen_friction.py --output study --picture platen_friction.png
    python examples/platen_friction.py --output study --platens 0 --membranes radial normal tied --strain 0.15

It writes table.csv into the output folder: means over the seeds with their standard errors.
"""

import argparse
import itertools
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from specimen_pool import save_rows

FRICTION = 0.3  # between balls
COMPACTION_FRICTION = 0.05
INERTIAL_NUMBER = 2e-3
SLICES = 6  # of the height, in which radius and place of the specimen are taken
WINDOW = 0.004  # of axial strain, over which a curve is smoothed for its peak
NEAR = 0.01  # of axial strain to either side, over which it is averaged
AT = (0.02, 0.05, 0.10, 0.15)


def shape(made, now, symmetric: bool) -> tuple[float, float]:
    """Barrelling, by how much more the middle third has widened than the end sixths, and sway, how far the slices have
    moved sideways against each other, both over the mean radius [-]. By the balls that were in a slice, and of these
    on its surface, when the specimen was made. A symmetric specimen stands upright."""
    heights = np.linspace(made.bottom, made.top, SLICES + 1)
    slices = np.digitize(made.positions[2], heights[1:-1])
    shift, widened = np.zeros((SLICES, 2)), np.zeros(SLICES)
    for k in range(SLICES):
        if not symmetric:
            shift[k] = (now.positions - made.positions)[:2, slices == k].mean(axis=1)
        outer = (slices == k) & made.membrane_zone
        before, after = made.positions[:2, outer], now.positions[:2, outer] - shift[k][:, None]
        widened[k] = (np.hypot(*after) - np.hypot(*before)).mean()
    radius = np.hypot(*made.positions[:2, made.membrane_zone]).mean()
    apart = np.hypot(*(shift[:, None] - shift[None]).T).max()
    return (widened[2:4].mean() - widened[[0, -1]].mean()) / radius, apart / radius


def sheared(size: int, order: int, platen: float, membrane: str, seed: int, strain: float) -> dict:
    """Make, confine and shear one specimen; what the study keeps of it."""
    import axijax
    from axijax.mechanics.rebuild import specimen_now
    from axijax.triaxial.random_specimen import platen_speed, random_cylinder

    sector = axijax.Sector(order)
    specimen, _ = random_cylinder(size, sector, compaction_friction=COMPACTION_FRICTION, seed=seed)
    params = axijax.Params(friction=FRICTION, platen_friction=platen or None)
    params = replace(params, platen_speed=platen_speed(INERTIAL_NUMBER, specimen, params))
    test = axijax.TriaxialTest(
        specimen, sector, axijax.Scene(membrane=membrane), params, strain,
        confining_friction=COMPACTION_FRICTION, tolerance=1e-3, confine_steps=100_000,
    )  # fmt: skip
    run = test.run()
    curve = run.curve
    barrelling, sway = shape(
        test.cut, specimen_now(test.cut, run.network, run.membrane, run.state), symmetric=order > 1
    )
    kept = {"barrelling": barrelling, "sway": sway}
    for name in ("axial_strain", "stress_ratio", "core_ratio", "volumetric_strain", "end_restraint"):
        values = getattr(curve, name)
        kept[name] = None if values is None else [float(f"{value:.6g}") for value in np.asarray(values)]
    return kept


def smoothed(strain, values):
    """Mean of a curve over the window around each of its points."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    low, high = (np.searchsorted(strain, strain + way * WINDOW / 2) for way in (-1, 1))
    return (total[high] - total[low]) / np.maximum(high - low, 1)


def figures_of(found: dict) -> dict[str, float]:
    """The numbers of one run."""
    strain, ratio = np.array(found["axial_strain"]), np.array(found["stress_ratio"])
    smooth = smoothed(strain, ratio)
    top = int(smooth.argmax())
    late = strain > 0.8 * strain[-1]
    restraint = found["end_restraint"]
    numbers = {
        "peak": smooth[top],
        "strain at peak [%]": 100 * strain[top],
        "late": ratio[late].mean(),
        "barrelling [%]": 100 * found["barrelling"],
        "sway [%]": 100 * found["sway"],
        "end restraint": 0.0 if restraint is None else float(np.mean(np.array(restraint)[late])),
    }
    for at in AT:
        near = np.abs(strain - at) < NEAR
        if strain[-1] > at - NEAR / 4:
            numbers[f"R at {100 * at:g} %"] = ratio[near].mean()
            numbers[f"volumetric strain at {100 * at:g} % [%]"] = (
                100 * np.array(found["volumetric_strain"])[near].mean()
            )
    return numbers


def work(options) -> None:
    """Run what is missing."""
    import axijax
    from axijax.core.files import write_whole

    axijax.fast_cpu_kernels()
    for case in cases(options):
        path = file_of(options, case)
        if path.exists():
            continue
        started = time.perf_counter()
        try:
            found = sheared(options.size, *case, options.strain)
        except (ValueError, RuntimeError) as error:
            found = {"failed": str(error)}
            print(f"{path.stem}: {error}", flush=True)
        text = json.dumps(found)
        write_whole(path, lambda part, text=text: part.write_text(text))
        print(f"{path.stem}: {time.perf_counter() - started:.0f} s", flush=True)


def cases(options):
    """All runs asked for: (order, platen friction, membrane, seed); a seed's together, so that one may stop early."""
    for seed, *kind in itertools.product(range(options.seeds), options.orders, options.platens, options.membranes):
        yield *kind, seed


def file_of(options, case) -> Path:
    order, platen, membrane, seed = case
    return options.output / f"{options.size}_n{order}_p{platen:g}_{membrane}_s{seed}_{100 * options.strain:g}.json"


def table(options) -> list[dict]:
    """Means over the seeds of each kind of run, and their standard errors."""
    rows = []
    for kind in itertools.product(options.orders, options.platens, options.membranes):
        files = [file_of(options, (*kind, seed)) for seed in range(options.seeds)]
        found = [json.loads(file.read_text()) for file in files if file.exists()]
        sound = [figures_of(each) for each in found if "failed" not in each]
        if not sound:
            continue
        rows.append(dict(zip(("order", "platen friction", "membrane"), kind, strict=True)) | means(sound))
    return rows


def means(sound: list[dict]) -> dict:
    """How many runs there are, and of each of their numbers the mean and its standard error."""
    row: dict = {"runs": len(sound)}
    for name in sound[0]:
        values = np.array([each[name] for each in sound])
        row[name] = float(values.mean())
        row[f"{name} +-"] = float(values.std(ddof=1) / len(values) ** 0.5) if len(values) > 1 else float("nan")
    return row


def write_table(rows: list[dict], path: Path) -> None:
    save_rows(path, rows)
    for row in rows:
        names = [name for name in row if f"{name} +-" in row]
        told = ", ".join(f"{name} {row[name]:.3g} +- {row[f'{name} +-']:.2g}" for name in names)
        print(f"n = {row['order']}, platens {row['platen friction']:g}, {row['membrane']}: {told}")


def draw(options, path: Path) -> None:
    """Stress ratio against axial strain, mean over the seeds; a panel for each order of sector."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(options.orders), figsize=(5.2 * len(options.orders), 4), sharey=True)
    grid = np.linspace(0, options.strain * 0.995, 200)
    for axes, order in zip(np.atleast_1d(panels), options.orders, strict=True):
        kinds = list(itertools.product(options.platens, options.membranes))
        for colour, (platen, membrane) in zip(
            plt.get_cmap("viridis")(np.linspace(0, 0.9, len(kinds))), kinds, strict=True
        ):
            files = [file_of(options, (order, platen, membrane, seed)) for seed in range(options.seeds)]
            found = [json.loads(file.read_text()) for file in files if file.exists()]
            curves = [
                np.interp(grid, each["axial_strain"], smoothed(np.array(each["axial_strain"]), each["stress_ratio"]))
                for each in found
                if "failed" not in each
            ]
            if not curves:
                continue
            mean, error = np.mean(curves, 0), np.std(curves, 0) / max(len(curves) - 1, 1) ** 0.5
            name = "glued" if np.isinf(platen) else f"{platen:g}"
            axes.plot(100 * grid, mean, color=colour, label=f"{name}, {membrane}")
            axes.fill_between(100 * grid, mean - error, mean + error, color=colour, alpha=0.2, lw=0)
        axes.set(title=f"n = {order}", xlabel="axial strain [%]")
        axes.legend(title="platen friction, membrane")
    np.atleast_1d(panels)[0].set_ylabel("stress ratio s1/s3 [-]")
    figure.suptitle(f"{options.size} balls in the full cylinder, f = {FRICTION}, {options.seeds} seeds")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("platen_friction"))
    parser.add_argument("--size", type=int, default=1008, help="balls in the full cylinder")
    parser.add_argument("--orders", type=int, nargs="+", default=(1, 4), help="sectors in the full cylinder")
    parser.add_argument("--platens", type=float, nargs="+", default=(0.0, 0.2, 0.5, np.inf), help="inf for glued")
    parser.add_argument("--membranes", nargs="+", default=("radial",), choices=("radial", "normal", "tied"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--strain", type=float, default=0.10)
    parser.add_argument("--picture", type=Path, help="write a picture of the curves here")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    work(options)
    rows = table(options)
    write_table(rows, options.output / "table.csv")
    if options.picture:
        draw(options, options.picture)


if __name__ == "__main__":
    main()
