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
STRAINS = np.linspace(0, 0.149, 299)  # axial strains at which curves are compared
WINDOW = 0.01  # axial strain over which a curve is averaged before its peak is taken
EARLY, LATE = (0.01, 0.05), (0.11, 0.149)  # axial strain
CURVES = ("stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "coordination_number")
COLOURS = dict(zip(ORDERS, ("black", "C0", "C9", "C2", "C8", "C1", "C3"), strict=True))
DEFINITIONS = """\
Axial strain 0 to 15 %, curves averaged over 1 % of strain, no cut. R = s1/s3, platen force over the area of radius Rm.
peak ratio, strain at peak, dilatancy at peak (-d(volumetric strain)/d(axial strain) over +-1 % about it): of the MEAN
curve over the seeds. early ratio: mean over 1 to 5 %. critical ratio: mean over 11 to 15 %. mean of the runs' peaks:
each run's own maximum; noise lifts it, the more the fewer balls a sector has. scatter: standard deviation over the
seeds, of the early ratio or at the strain of the mean curve's peak. early ratio x (1 + void ratio): as if all sections
were as solid; the hole that a narrow sector has along its axis carries no load. Errors (+-): jackknife over the seeds;
a strain at peak is a maximum's place, whose error the jackknife only indicates. void ratio, solid fractions: before
shear; inner half is within Rm/2. coordination: ball-ball contacts only, so that rigid planes lower it. arc length:
2 pi Rm/n."""

SIZES = (504, 1008, 2016, 4032)  # multiples of 24, so that every order divides them
FRICTIONS = (0.1, 0.2, 0.3, 0.4, 0.5)


def packings(options):
    """All specimens asked for: (size, order, boundary, seed). Each is sheared with every friction.

    Small specimens first; all seeds of an order follow each other, as those share what is compiled.
    """
    for size in options.sizes:
        boundaries = [(order, "periodic") for order in options.orders]
        boundaries += [(order, "rigid") for order in options.orders if order in RIGID]
        for (order, boundary), seed in itertools.product(boundaries, range(options.seeds)):
            yield size, order, boundary, seed


def sheared(specimen, report, sector, friction, strain) -> dict:
    """Shear one specimen and return what the study keeps of it."""
    import axijax
    from axijax.fabric import contact_statistics, profiles
    from axijax.random_packing import platen_speed
    from axijax.results import RECORDS

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
    }  # fmt: skip


def work(options) -> None:
    """Make and shear all that is missing and that no other process is at."""
    import axijax
    from axijax.random_packing import random_cylinder

    axijax.fast_cpu_kernels()
    for size, order, boundary, seed in packings(options):
        packing = f"{size}_{boundary}_{order}_s{seed}"
        lock = options.output / f"{packing}.lock"
        paths = {friction: options.output / f"{packing}_f{friction:g}.json" for friction in options.frictions}
        with open(lock, "w") as held:
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue  # another process is at it; its lock goes with it
            missing = [friction for friction, path in paths.items() if not path.exists()]
            started = time.perf_counter()
            sector, specimen = axijax.Sector(order, boundary), None
            for friction in missing:
                try:
                    if specimen is None:
                        specimen, report = random_cylinder(
                            size, sector, compaction_friction=COMPACTION_FRICTION, seed=seed
                        )
                    found = sheared(specimen, report, sector, friction, options.strain)
                except (ValueError, RuntimeError) as error:
                    found = {"failed": str(error)}
                    print(f"{paths[friction].stem}: {error}", flush=True)
                found["case"] = {
                    "size": size, "order": order, "boundary": boundary, "friction": friction, "seed": seed,
                    "strain": options.strain,
                }  # fmt: skip
                part = paths[friction].with_suffix(f".{os.getpid()}.part")
                part.write_text(json.dumps(found))
                part.replace(paths[friction])
            lock.unlink(missing_ok=True)
        if missing:
            print(f"{packing}: {len(missing)} tests in {time.perf_counter() - started:.0f} s", flush=True)


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


def curves_of(runs) -> dict[str, np.ndarray]:
    """Curves of each run at STRAINS, means over WINDOW of axial strain (shorter at either end); (S, G)."""
    half = np.minimum(np.minimum(STRAINS, STRAINS[-1] - STRAINS), WINDOW / 2) + 1e-9  # symmetric up to the ends
    low, high = np.searchsorted(STRAINS, STRAINS - half), np.searchsorted(STRAINS, STRAINS + half)
    curves = {}
    for field in CURVES:
        rows = [np.interp(STRAINS, run["curve"]["axial_strain"], run["curve"][field]) for run in runs]
        total = np.cumsum(np.pad(rows, ((0, 0), (1, 0))), axis=1)
        curves[field] = (total[:, high] - total[:, low]) / (high - low)
    return curves


def densities_of(run) -> dict[str, float]:
    """Void ratio of the whole cylinder, and solid fractions of its inner and outer half by radius, before shear."""
    profile = run["profiles"]["start axis"]
    edges, solid = np.array(profile["edges"]), np.array(profile["solid_fraction"], float)
    area, outside = np.diff(edges**2), edges[:-1] >= edges[-1] / 2 - 1e-9
    return {
        "void ratio at start": run["report"]["void_ratio"],
        "solid fraction, inner half": float((area * solid)[~outside].sum() / area[~outside].sum()),
        "solid fraction, outer half": float((area * solid)[outside].sum() / area[outside].sum()),
    }


def numbers_of(curves, scalars) -> dict[str, float]:
    """The numbers that the study compares, of a set of runs; DEFINITIONS says what each is."""
    mean = {field: rows.mean(axis=0) for field, rows in (curves | scalars).items()}
    peak = int(mean["stress_ratio"].argmax())
    near = np.abs(STRAINS - STRAINS[peak]) < WINDOW
    early, late = ((a <= STRAINS) & (b >= STRAINS) for a, b in (EARLY, LATE))
    return {
        "peak ratio": mean["stress_ratio"][peak],
        "strain at peak [%]": 100 * STRAINS[peak],
        "dilatancy at peak": -np.polyfit(STRAINS[near], mean["volumetric_strain"][near], 1)[0],
        "early ratio": mean["stress_ratio"][early].mean(),
        "early ratio x (1 + void ratio)": mean["stress_ratio"][early].mean() * (1 + mean["void ratio at start"]),
        "critical ratio": mean["stress_ratio"][late].mean(),
        "virial peak ratio": mean["virial_ratio"].max(),
        "core peak ratio": mean["core_ratio"].max(),
        "mean of the runs' peaks": curves["stress_ratio"].max(axis=1).mean(),
        "volumetric strain at end [%]": 100 * mean["volumetric_strain"][late].mean(),
        "coordination at start": mean["coordination_number"][0],
        "coordination at end": mean["coordination_number"][late].mean(),
    } | {field: mean[field] for field in scalars}


def with_errors(runs) -> dict[str, float]:
    """Numbers of a set of runs, jackknife standard errors (field + " +-") and the scatter of a single run."""
    curves, densities = curves_of(runs), [densities_of(run) for run in runs]
    scalars = {field: np.array([density[field] for density in densities]) for field in densities[0]}
    whole, row = numbers_of(curves, scalars), {}
    left_out = []
    for place in range(len(runs)) if len(runs) > 1 else ():
        kept = np.arange(len(runs)) != place
        some = {field: rows[kept] for field, rows in curves.items()}
        left_out.append(numbers_of(some, {field: values[kept] for field, values in scalars.items()}))
    for field, value in whole.items():
        row[field], row[field + " +-"] = value, np.nan
        if left_out:
            others = np.array([numbers[field] for numbers in left_out])
            row[field + " +-"] = np.sqrt((len(runs) - 1) * others.var())
    at_peak = curves["stress_ratio"][:, int(np.searchsorted(STRAINS, row["strain at peak [%]"] / 100 - 1e-9))]
    row["scatter of a run's early ratio"] = row["early ratio +-"] * np.sqrt(len(runs))
    row["scatter of a run at peak"] = at_peak.std(ddof=1) if len(runs) > 1 else np.nan
    radius = np.mean([run["report"]["membrane_radius"] for run in runs])
    row["arc length [diameters]"] = (
        np.pi * radius / runs[0]["case"]["order"] / np.mean([r["mean_radius"] for r in runs])
    )
    return row


def draw(options) -> None:
    """Table (CSV and printed) and pictures of what has been run."""
    import csv

    runs, failed = read(options.output)
    rows = []
    for key in sorted(set(runs) | set(failed)):
        row = dict(zip(("size", "friction", "boundary", "order"), key, strict=True))
        row |= {"runs": len(runs[key]), "failed": failed.get(key, 0)}
        rows.append(row | (with_errors(runs[key]) if runs[key] else {}))
    if not rows:
        raise SystemExit(f"no runs in '{options.output}': run the study first, without --draw.")
    full = {(row["size"], row["friction"]): row for row in rows if row["order"] == 1}
    for row in rows:
        whole = full.get((row["size"], row["friction"]), {})
        if "peak ratio" in row and "peak ratio" in whole and row["order"] > 1:
            for field in ("peak ratio", "early ratio", "critical ratio", "early ratio x (1 + void ratio)"):
                values, errors = (np.array([row[field + end], whole[field + end]]) for end in ("", " +-"))
                change = values[0] / values[1]
                row[f"{field}, change from n = 1 [%]"] = 100 * (change - 1)
                row[f"{field}, change from n = 1 [%] +-"] = 100 * change * np.hypot(*(errors / values))
    fields = list(dict.fromkeys(field for row in rows for field in row))
    with open(options.output / "boundary_sensitivity.csv", "w", newline="") as file:
        for line in DEFINITIONS.splitlines():
            file.write(f"# {line}\n")
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(
            {field: f"{value:.5g}" if isinstance(value, float) else value for field, value in row.items()}
            for row in rows
        )
    print_table(rows)
    draw_numbers(runs, rows, options.output / "boundary_sensitivity.png")
    draw_profiles(runs, options.output / "boundary_profiles.png")


def print_table(rows) -> None:
    """Markdown."""
    shown = ("peak ratio", "strain at peak [%]", "dilatancy at peak", "early ratio", "critical ratio",
             "mean of the runs' peaks", "early ratio, change from n = 1 [%]", "scatter of a run's early ratio",
             "early ratio x (1 + void ratio), change from n = 1 [%]", "coordination at end", "void ratio at start",
             "solid fraction, inner half", "solid fraction, outer half", "arc length [diameters]")  # fmt: skip

    def cell(row, field) -> str:
        if field not in row:
            return "-"
        digits = 1 if "%" in field or "arc" in field else 3
        error = row.get(field + " +-", np.nan)
        return f"{row[field]:.{digits}f}" + (f" ± {error:.{digits}f}" if np.isfinite(error) else "")

    print(DEFINITIONS)
    print("| balls | f | boundary | n | runs | " + " | ".join(shown) + " |")
    print("|" + "---|" * (5 + len(shown)))
    for row in rows:
        count = f"{row['runs']}" + (f", {row['failed']} failed" if row["failed"] else "")
        print(
            f"| {row['size']} | {row['friction']:g} | {row['boundary']} | {row['order']} | {count} | "
            + " | ".join(cell(row, field) for field in shown)
            + " |"
        )


def figure_of(rows: int, columns: int):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.1 * columns, 3.6 * rows + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def fullest(runs) -> tuple[int, float]:
    """(size, friction) of which most orders have been run; of these, the largest."""
    orders = defaultdict(int)
    for (size, friction, _, _), some in runs.items():
        orders[size, friction] += bool(some)
    return max(orders, key=lambda key: (orders[key], key))


def mean_profile(runs, stage: str, field: str):
    """(middles of the bins [mean diameters], mean over the runs); parts of the fabric weighted with the contacts."""
    some = [run["profiles"][stage] for run in runs]
    edges = np.mean([np.array(p["edges"]) / run["mean_radius"] / 2 for p, run in zip(some, runs, strict=True)], axis=0)
    values, weight = (np.array([p[key] for p in some], float) for key in (field, "contacts"))
    if field == "solid_fraction":
        weight = np.ones_like(values)
    kept = weight * np.isfinite(values)
    total = kept.sum(axis=0)
    mean = (kept * np.nan_to_num(values)).sum(axis=0) / np.where(total > 0, total, np.nan)
    return (edges[1:] + edges[:-1]) / 2, mean


def draw_numbers(runs, rows, path: Path) -> None:
    figure, axes = figure_of(2, 4)
    groups = defaultdict(list)
    for row in rows:
        if "peak ratio" in row:
            groups[row["size"], row["friction"]].append(row)
    if len(groups) > 1:  # one order alone compares with nothing
        groups = {key: some for key, some in groups.items() if len(some) > 1 or key == fullest(runs)}
    by_order = {
        axes[0, 1]: "peak ratio, change from n = 1 [%]",
        axes[0, 2]: "early ratio, change from n = 1 [%]",
        axes[0, 3]: "critical ratio, change from n = 1 [%]",
        axes[1, 1]: "solid fraction, outer half",
        axes[1, 2]: "dilatancy at peak",
    }
    for colour, (size, friction) in enumerate(sorted(groups, key=lambda key: (abs(key[1] - 0.3), key))):
        for boundary, marker, line in (("periodic", "o", "-"), ("rigid", "s", ":")):
            some = [row for row in groups[size, friction] if row["boundary"] == boundary]
            style = dict(
                fmt=marker + line, color=f"C{colour}", markersize=5, capsize=2, linewidth=1,
                label=f"{size} balls, f = {friction:g}" + (", rigid planes" if boundary == "rigid" else ""),
                markerfacecolor="white" if boundary == "rigid" else f"C{colour}",
            )  # fmt: skip
            if not some:
                continue
            inner = [row["solid fraction, inner half"] for row in some]
            axes[1, 1].plot(
                [r["order"] for r in some], inner, "v" + line, color=f"C{colour}", markersize=4, linewidth=0.6
            )
            for place, field in (by_order | {axes[1, 3]: by_order[axes[0, 2]]}).items():
                shown = [row for row in some if field in row]
                along = "arc length [diameters]" if place is axes[1, 3] else "order"
                x = [row[along] * 1.02 ** (colour - 1) for row in shown]
                place.errorbar(x, [row[field] for row in shown], [row[field + " +-"] for row in shown], **style)
    for place, field in by_order.items():
        place.set(title=field, xscale="log", xlabel="sectors n in the full cylinder")
        place.set_xticks(ORDERS, [str(order) for order in ORDERS])
        place.minorticks_off()
    axes[0, 2].set_title("mean ratio over 1 to 5 %, change from\nn = 1 [%]; band: scatter of full cylinders")
    axes[0, 3].set_title("critical ratio, mean over 11 to 15 %,\nchange from n = 1 [%]")
    axes[1, 1].set_title("solid fraction before shear\nouter half, and (triangles) within Rm/2")
    axes[1, 3].set(title="mean ratio over 1 to 5 %, change from\nn = 1 [%], against arc length", xscale="log")
    axes[1, 3].set_xlabel("arc length of the sector at Rm [mean diameters]")
    axes[1, 3].set_xticks([2, 3, 5, 10, 15], ["2", "3", "5", "10", "15"])
    axes[1, 3].minorticks_off()
    whole = [row for row in groups[fullest(runs)] if row["order"] == 1]
    for place in (*axes[0, 1:], axes[1, 3]):
        place.axhline(0, color="0.5", linewidth=0.8)
        for row in whole if place in (axes[0, 2], axes[1, 3]) else ():
            scatter = 100 * row["scatter of a run's early ratio"] / row["early ratio"]
            place.axhspan(-scatter, scatter, color="0.9", zorder=0)

    size, friction = fullest(runs)
    for boundary, line in (("periodic", "-"), ("rigid", ":")):
        for order in ORDERS:
            some = runs.get((size, friction, boundary, order))
            if some:
                style = {"color": COLOURS[order], "linestyle": line, "linewidth": 1.3}
                label = f"{order}" + (", rigid" if boundary == "rigid" else "")
                axes[0, 0].plot(100 * STRAINS, curves_of(some)["stress_ratio"].mean(axis=0), label=label, **style)
                axes[1, 0].plot(*mean_profile(some, "start axis", "solid_fraction"), **style)
    axes[0, 0].set(title=f"mean curves, {size} balls, f = {friction:g}", xlabel="axial strain [%]", ylabel="R")
    axes[0, 0].set_ylim(bottom=1)
    axes[0, 0].legend(title="n", ncols=3, fontsize=7, loc="lower right")
    axes[1, 0].set(title="solid fraction before shear, the same", xlabel="distance from the axis [mean diameters]")
    axes[1, 0].set_ylim(0, 0.75)
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle(
        "Random dense specimens against the order of the sector: means over seeds, jackknife standard errors"
    )
    figure.savefig(path, dpi=110)


def draw_profiles(runs, path: Path) -> None:
    size, friction = fullest(runs)
    figure, axes = figure_of(2, 3)
    shown = {
        "solid_fraction": "solid fraction",
        "circumferential": "circumferential part of the fabric",
        "vertical": "vertical part of the fabric",
    }
    for row, place in zip(axes, ("axis", "plane"), strict=True):
        for axis, (field, title) in zip(row, shown.items(), strict=True):
            for boundary, line in (("periodic", "-"), ("rigid", ":")):
                for order in ORDERS:
                    some = runs.get((size, friction, boundary, order))
                    if some:
                        label = f"n = {order}" + (", rigid" if boundary == "rigid" else "")
                        at, values = mean_profile(some, f"end {place}", field)
                        axis.plot(at, values, line, color=COLOURS[order], linewidth=1.2, label=label)
            wall = "axis" if place == "axis" else "nearest sector plane"
            axis.set(title=title, xlabel=f"from the {wall} [mean diameters]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(f"Inside: {size} balls, f = {friction:g}, at the end of shear: mean over seeds")
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("boundary_sensitivity"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="balls in the full cylinder")
    parser.add_argument("--orders", type=int, nargs="+", default=ORDERS, help="sectors in the full cylinder")
    parser.add_argument("--frictions", type=float, nargs="+", default=FRICTIONS)
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
