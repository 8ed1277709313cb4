"""How sensitive are randomly packed balls to the circumferential boundary? The question Cui & O'Sullivan left open.

Random dense specimens are made with the symmetry of a sector of order n, confined and sheared; n = 1 is the full
cylinder. Every run writes one file, so the study may be stopped and started again at any time, and run by several
processes at once:

    python examples/boundary_sensitivity.py --output study            # run what is missing
    python examples/boundary_sensitivity.py --output study --draw     # table and pictures of what is there
"""

import argparse
import fcntl
import itertools
import json
import multiprocessing
import os
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

ORDERS = (1, 2, 3, 4, 6, 8, 12)
RIGID = (3, 4, 6, 8, 12)
INERTIAL_NUMBER = 2e-3
COMPACTION_FRICTION = 0.05  # dense; without any friction a packing takes five times as long to settle
WINDOW = 0.01  # axial strain over which a curve is averaged before its peak is taken
PEAK_BEFORE = 0.08  # axial strain; later maxima are fluctuations about the critical state
SMOOTH = ("axial_strain", "stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "coordination_number")

# (size, orders, orders between rigid planes, frictions, first seed, last seed + 1), in the order of importance; each
# goes through its seeds, all orders a seed. Sizes are multiples of 24, so that every order divides them.
STAGES = (
    (504, ORDERS, (4, 12), (0.3,), 0, 5),
    (1008, ORDERS, (4, 12), (0.3,), 0, 5),
    (504, ORDERS, (4, 12), (0.3,), 5, 10),
    (1008, ORDERS, (4, 12), (0.3,), 5, 10),
    (2016, (1, 2, 4, 8, 12), (4, 12), (0.3,), 0, 5),
    (504, (1, 4, 8, 12), (4,), (0.1, 0.5), 0, 10),
    (504, (), (3, 6, 8), (0.3,), 0, 10),
    (2016, (1, 2, 4, 8, 12), (4, 12), (0.3,), 5, 10),
    (1008, (1, 4, 8, 12), (4,), (0.1, 0.5), 0, 10),
    (4032, (1, 4, 8, 12), (4, 12), (0.3,), 0, 10),
    (504, ORDERS, RIGID, (0.2, 0.4), 0, 10),
)


def cases(options):
    """All runs asked for, most important first: (size, order, boundary, friction, seed)."""
    stages = STAGES
    if options.sizes or options.orders or options.frictions:
        orders = tuple(options.orders or ORDERS)
        rigid = tuple(order for order in orders if order in RIGID)
        frictions = tuple(options.frictions or (0.3,))
        stages = tuple((size, orders, rigid, frictions, 0, options.seeds) for size in options.sizes or (504,))
    for size, orders, rigid, frictions, first, last in stages:
        boundaries = [(order, "periodic") for order in orders] + [(order, "rigid") for order in rigid]
        for seed, friction in itertools.product(range(first, min(last, options.seeds)), frictions):
            yield from ((size, order, boundary, friction, seed) for order, boundary in boundaries)


def name_of(size, order, boundary, friction, seed) -> str:
    return f"{size}_{boundary}_{order}_f{friction:g}_s{seed}"


def test_one(size, order, boundary, friction, seed, strain) -> dict:
    """Make one specimen, shear it and return what the study keeps of it."""
    import axijax
    from axijax.fabric import contact_statistics, profiles
    from axijax.random_packing import platen_speed, random_cylinder
    from axijax.results import RECORDS

    clock, cpu = time.perf_counter(), time.process_time()
    sector = axijax.Sector(order, boundary)
    specimen, report = random_cylinder(size, sector, compaction_friction=COMPACTION_FRICTION, seed=seed)
    made = time.process_time() - cpu
    params = axijax.Params(friction=friction)
    params = replace(params, platen_speed=platen_speed(INERTIAL_NUMBER, specimen, params))
    test = axijax.TriaxialTest(
        specimen,
        sector,
        params=params,
        axial_strain=strain,
        confining_friction=COMPACTION_FRICTION,
        tolerance=1e-3,
        confine_steps=100_000,
    )
    run = test.run()
    zone = np.isin(np.arange(len(test.cut)), np.asarray(run.membrane.zone))
    bottom, top = (float(height) for height in run.state.platens)
    end = replace(test.cut, positions=run.positions, bottom=bottom, top=top, membrane_zone=zone)
    rows = {field: np.asarray(getattr(run.curve, field), float) for field in RECORDS}
    shown = {}
    for stage, cut, radius in (
        ("start", test.cut, report.membrane_radius),
        ("end", end, float(rows["membrane_radius"][-1])),
    ):
        for place, profile in zip(("axis", "plane"), profiles(cut, sector, radius), strict=True):
            shown[f"{stage} {place}"] = {key: np.round(row, 6).tolist() for key, row in profile._asdict().items()}
    return {
        "report": {
            key: value for key, value in vars(report).items() if isinstance(value, int | float | str)
        },
        "end": contact_statistics(end, sector)._asdict(),
        "mean_radius": float(specimen.radius.mean()),
        "curve": {field: [float(f"{value:.6g}") for value in row] for field, row in rows.items()},
        "profiles": shown,
        "cpu_seconds": {"made": made, "all": time.process_time() - cpu},
        "seconds": time.perf_counter() - clock,
    }  # fmt: skip


def work(options) -> None:
    """Run all that is missing and that no other process is at."""
    import axijax

    axijax.fast_cpu_kernels()
    for case in cases(options):
        path = options.output / (name_of(*case) + ".json")
        if path.exists():
            continue
        lock = path.with_suffix(".lock")
        with open(lock, "w") as held:
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue  # another process is at it; its lock goes with it
            if path.exists():
                continue
            started = time.perf_counter()
            try:
                found = test_one(*case, options.strain)
            except (ValueError, RuntimeError) as error:
                found = {"failed": str(error)}
            keys = ("size", "order", "boundary", "friction", "seed")
            found["case"] = dict(zip(keys, case, strict=True)) | {"strain": options.strain}
            part = path.with_suffix(f".{os.getpid()}.part")
            part.write_text(json.dumps(found))
            part.replace(path)
            lock.unlink(missing_ok=True)
            outcome = found.get("failed", f"{found.get('cpu_seconds')}")
            print(f"{name_of(*case)}  {time.perf_counter() - started:.0f} s  {outcome}", flush=True)


def windowed(strain, values):
    """Mean over WINDOW of axial strain about each record (NaN-free)."""
    low, high = np.searchsorted(strain, strain - WINDOW / 2), np.searchsorted(strain, strain + WINDOW / 2)
    total = np.concatenate([[0.0], np.cumsum(values)])
    return (total[high] - total[low]) / (high - low)


def numbers_of(found) -> dict[str, float]:
    """The numbers of one run that the study compares."""
    curve = {key: np.array(found["curve"][key]) for key in SMOOTH}
    strain = curve["axial_strain"]
    ratio, volume = windowed(strain, curve["stress_ratio"]), windowed(strain, curve["volumetric_strain"])
    peak = int(np.where(strain < PEAK_BEFORE, ratio, 0.0).argmax())
    near = np.abs(strain - strain[peak]) < WINDOW
    dilatancy = -np.polyfit(strain[near], volume[near], 1)[0]
    late = strain > strain[-1] - 0.04
    return {
        "peak ratio": ratio[peak],
        "peak ratio, unsmoothed": curve["stress_ratio"].max(),
        "strain at peak [%]": 100 * strain[peak],
        "dilatancy at peak": dilatancy,
        "critical ratio": curve["stress_ratio"][late].mean(),
        "volumetric strain at end [%]": 100 * curve["volumetric_strain"][late].mean(),
        "coordination at start": curve["coordination_number"][0],
        "coordination at end": curve["coordination_number"][late].mean(),
        "void ratio at start": found["report"]["void_ratio"],
        "core void ratio at start": found["report"]["core_void_ratio"],
    }


def read(folder: Path):
    """Runs by (size, friction, boundary, order), and the number of those that failed by the same."""
    runs, failed = defaultdict(list), defaultdict(int)
    for path in sorted(folder.glob("*.json")):
        found = json.loads(path.read_text())
        case = found["case"]
        key = case["size"], case["friction"], case["boundary"], case["order"]
        if "failed" in found:
            failed[key] += 1
            print(f"failed: {path.stem}: {found['failed']}")
        else:
            runs[key].append(found)
    return runs, failed


def draw(options) -> None:
    """Table (CSV and printed) and pictures of what has been run."""
    import csv

    runs, failed = read(options.output)
    rows = []
    for key in sorted(set(runs) | set(failed)):
        numbers = [numbers_of(found) for found in runs[key]]
        row = dict(zip(("size", "friction", "boundary", "order"), key, strict=True))
        row |= {"runs": len(numbers), "failed": failed.get(key, 0)}
        for field in numbers[0] if numbers else ():
            values = np.array([number[field] for number in numbers])
            row[field] = values.mean()
            row[field + " +-"] = values.std(ddof=1) / np.sqrt(values.size) if values.size > 1 else np.nan
        rows.append(row)
    if not rows:
        raise SystemExit(f"no runs in '{options.output}': run the study first, without --draw.")
    fields = list(dict.fromkeys(field for row in rows for field in row))
    with open(options.output / "boundary_sensitivity.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(rows)
    print_table(rows)
    draw_numbers(rows, options.output / "boundary_sensitivity.png")
    draw_profiles(runs, options.output / "boundary_profiles.png")


def print_table(rows) -> None:
    shown = ("peak ratio", "strain at peak [%]", "dilatancy at peak", "critical ratio", "coordination at end",
             "void ratio at start")  # fmt: skip
    print("size    f  boundary   n runs failed " + " ".join(f"{field:>20}" for field in shown))
    for row in rows:
        cells = [f"{row[field]:.3f} +- {row[field + ' +-']:.3f}" if field in row else "-" for field in shown]
        print(
            f"{row['size']:4} {row['friction']:4g}  {row['boundary']:8} {row['order']:3} {row['runs']:4} "
            f"{row['failed']:6} " + " ".join(f"{cell:>20}" for cell in cells)
        )


def draw_numbers(rows, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = ("peak ratio", "strain at peak [%]", "dilatancy at peak", "critical ratio", "coordination at end",
             "void ratio at start")  # fmt: skip
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained", sharex=True)
    groups = defaultdict(list)
    for row in rows:
        if "peak ratio" in row:
            groups[row["size"], row["friction"]].append(row)
    for colour, (size, friction) in enumerate(sorted(groups)):
        for boundary, marker, line in (("periodic", "o", "-"), ("rigid", "s", ":")):
            some = [row for row in groups[size, friction] if row["boundary"] == boundary]
            label = f"{size} balls, f = {friction:g}" + (", rigid planes" if boundary == "rigid" else "")
            for axis, field in zip(axes.flat, shown, strict=True):
                if some:
                    axis.errorbar(
                        [row["order"] * 1.015 ** (colour - 2) for row in some],
                        [row[field] for row in some],
                        [row[field + " +-"] for row in some],
                        fmt=marker + line, color=f"C{colour}", markersize=4, capsize=2, linewidth=1,
                        label=label, markerfacecolor="white" if boundary == "rigid" else f"C{colour}",
                    )  # fmt: skip
    for axis, field in zip(axes.flat, shown, strict=True):
        axis.set_title(field, fontsize=10)
        axis.set_xscale("log")
        axis.set_xticks(ORDERS, [str(order) for order in ORDERS])
        axis.minorticks_off()
    for axis in axes[1]:
        axis.set_xlabel("sectors n in the full cylinder")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle("Random dense specimens: mean and standard error over seeds against the sector's order")
    figure.savefig(path, dpi=130)


def draw_profiles(runs, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    counts = defaultdict(int)
    for (size, friction, boundary, _), found in runs.items():
        if boundary == "periodic":
            counts[size, friction] += len(found)
    size, friction = max(counts, key=lambda key: (counts[key], key))
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained")
    shown = ("solid_fraction", "circumferential", "vertical")
    titles = ("solid fraction", "circumferential part of the fabric", "vertical part of the fabric")
    for row, place in enumerate(("axis", "plane")):
        for boundary, line in (("periodic", "-"), ("rigid", ":")):
            for order in ORDERS:
                some = runs.get((size, friction, boundary, order))
                if not some:
                    continue
                profiles = [found["profiles"][f"end {place}"] for found in some]
                edges = np.mean([np.array(p["edges"]) / f["mean_radius"] / 2 for p, f in zip(profiles, some)], axis=0)  # noqa: B905
                middle = (edges[1:] + edges[:-1]) / 2
                weight = np.array([p["contacts"] for p in profiles])
                for axis, field in zip(axes[row], shown, strict=True):
                    values = np.array([p[field] for p in profiles], float)
                    if field != "solid_fraction":  # of all contacts in the bin, over the seeds
                        values = np.nansum(values * weight, axis=0) / np.where(weight.sum(0) > 0, weight.sum(0), np.nan)
                    else:
                        values = np.nanmean(values, axis=0)
                    axis.plot(
                        middle, values, line, color=f"C{ORDERS.index(order)}", linewidth=1.2,
                        label=f"n = {order}" + (", rigid" if boundary == "rigid" else ""),
                    )  # fmt: skip
        for axis, title in zip(axes[row], titles, strict=True):
            axis.set_title(title, fontsize=10)
            wall = "axis" if place == "axis" else "nearest sector plane"
            axis.set_xlabel(f"distance from the {wall} [mean diameters]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=8, fontsize=8)
    figure.suptitle(f"{size} balls, f = {friction:g}, at the end of shear: mean over seeds")
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("boundary_sensitivity"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--sizes", type=int, nargs="+", help="balls in the full cylinder, multiples of 24")
    parser.add_argument("--orders", type=int, nargs="+", help="sectors in the full cylinder")
    parser.add_argument("--frictions", type=float, nargs="+")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument("--strain", type=float, default=0.15, help="axial strain at the end")
    parser.add_argument("--draw", action="store_true", help="draw what is there, run nothing")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    if options.draw:
        draw(options)
        return
    if options.workers == 1:
        work(options)
        return
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=work, args=(options,)) for _ in range(options.workers)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()


if __name__ == "__main__":
    main()
