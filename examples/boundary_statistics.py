"""Statistics of the boundary study: means over the seeds, their errors, and changes from the full cylinder."""

import csv
import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

STRAINS = np.linspace(0, 0.149, 299)  # axial strains at which curves are compared
WINDOW = 0.01  # axial strain over which a curve is averaged before its peak is taken
EARLY, LATE = (0.01, 0.05), (0.11, 0.149)  # axial strain
CURVES = ("stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "coordination_number")
COMPARED = ("early ratio", "peak ratio", "critical ratio", "early ratio x (1 + void ratio)")
ALL = "all"  # in place of a friction: the mean over the frictions
DEFINITIONS = """\
Axial strain 0 to 15 %, curves averaged over 1 % of strain, no cut. R = s1/s3, platen force over the area of radius Rm.
peak ratio, strain at peak, dilatancy at peak (-d(volumetric strain)/d(axial strain) over +-1 % about it): of the MEAN
curve over the seeds. early ratio: mean over 1 to 5 %. critical ratio: mean over 11 to 15 %. mean of the runs' peaks:
each run's own maximum; noise lifts it, the more the fewer balls a sector has. scatter: standard deviation over the
seeds, of the early ratio or at the strain of the mean curve's peak. early ratio x (1 + void ratio): as if all sections
were as solid; the hole that a narrow sector has along its axis carries no load. Errors (+-): jackknife over the seeds;
a strain at peak is a maximum's place, whose error the jackknife only indicates. void ratio, solid fractions: before
shear; inner half is within Rm/2. coordination: ball-ball contacts only, so that rigid planes lower it. arc length:
2 pi Rm/n. f = all: mean over the frictions of the changes from n = 1; packings are the same at all frictions, so a
seed is left out at all of them together."""


@dataclass
class Sample:
    """The runs of one size, boundary, order and friction.

    runs: by seed. failed: those that broke off, by seed, with what was said. numbers: of all runs. left_out: of all but
    one, by seed.
    """

    size: int
    friction: float
    boundary: str
    order: int
    runs: dict[int, dict] = field(default_factory=dict)
    failed: dict[int, str] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    left_out: dict[int, dict[str, float]] = field(default_factory=dict)

    def error(self, name: str) -> float:
        """Jackknife standard error of a number; NaN for a single run."""
        return jackknife([numbers[name] for numbers in self.left_out.values()])

    def scatter(self) -> float:
        """Standard deviation of a single run's early ratio."""
        return self.error("early ratio") * np.sqrt(len(self.runs))


def jackknife(values) -> float:
    return float(np.sqrt((len(values) - 1) * np.var(values))) if len(values) > 1 else np.nan


def statistics_of(folder: Path) -> dict[tuple, Sample]:
    """Samples of all runs in a folder, by (size, friction, boundary, order). Raises SystemExit where there is none."""
    samples: dict[tuple, Sample] = {}
    for path in sorted(folder.glob("*.json")):
        found = json.loads(path.read_text())
        case = found["case"]
        key = case["size"], case["friction"], case["boundary"], case["order"]
        sample = samples.setdefault(key, Sample(*key))
        if "failed" in found:
            sample.failed[case["seed"]] = found["failed"]
            print(f"failed: {path.stem}: {found['failed']}")
        else:
            sample.runs[case["seed"]] = found
    if not any(sample.runs for sample in samples.values()):
        raise SystemExit(f"no runs in '{folder}': run the study first, without --draw.")
    for sample in samples.values():
        if sample.runs:
            find_numbers(sample)
    return dict(sorted(samples.items()))


def find_numbers(sample: Sample) -> None:
    """Fill in a sample's numbers, with and without each of its seeds."""
    runs = list(sample.runs.values())
    curves, densities = curves_of(runs), [densities_of(run) for run in runs]
    scalars = {name: np.array([density[name] for density in densities]) for name in densities[0]}
    sample.numbers = numbers_of(curves, scalars)
    for place, seed in enumerate(sample.runs) if len(runs) > 1 else ():
        kept = np.arange(len(runs)) != place
        some = ({name: rows[kept] for name, rows in which.items()} for which in (curves, scalars))
        sample.left_out[seed] = numbers_of(*some)
    radius = np.mean([run["report"]["membrane_radius"] for run in runs])
    mean_radius = np.mean([run["mean_radius"] for run in runs])
    sample.numbers["arc length [diameters]"] = np.pi * radius / sample.order / mean_radius


def curves_of(runs) -> dict[str, np.ndarray]:
    """Curves of each run at STRAINS, means over WINDOW of axial strain (shorter at either end); (S, G)."""
    half = np.minimum(np.minimum(STRAINS, STRAINS[-1] - STRAINS), WINDOW / 2) + 1e-9  # symmetric up to the ends
    low, high = np.searchsorted(STRAINS, STRAINS - half), np.searchsorted(STRAINS, STRAINS + half)
    curves = {}
    for name in CURVES:
        rows = [np.interp(STRAINS, run["curve"]["axial_strain"], run["curve"][name]) for run in runs]
        total = np.cumsum(np.pad(rows, ((0, 0), (1, 0))), axis=1)
        curves[name] = (total[:, high] - total[:, low]) / (high - low)
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
    mean = {name: rows.mean(axis=0) for name, rows in (curves | scalars).items()}
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
    } | {name: mean[name] for name in scalars}


def change(some: list[Sample], full: list[Sample], name: str) -> tuple[float, float]:
    """Mean over the frictions of a number's relative change from the full cylinder, and its standard error [%].

    some, full: samples of the same frictions. A seed is left out at all frictions together.
    """

    def mean_ratio(without=None, without_full=None):
        above = [sample.left_out.get(without, sample.numbers)[name] for sample in some]
        below = [sample.left_out.get(without_full, sample.numbers)[name] for sample in full]
        return np.mean(np.divide(above, below))

    seeds, full_seeds = ({seed for sample in which for seed in sample.left_out} for which in (some, full))
    errors = (
        jackknife([mean_ratio(without=seed) for seed in seeds]),
        jackknife([mean_ratio(without_full=seed) for seed in full_seeds]),
    )
    return 100 * (mean_ratio() - 1), 100 * float(np.hypot(*errors))


def changes(samples, name: str, frictions=None):
    """Change of a number from the full cylinder by (size, boundary, order), over these frictions, or over all that both
    have: (change, error, arc length), [%] and mean diameters."""
    found = {}
    groups = defaultdict(dict)
    for sample in samples.values():
        if sample.numbers and (frictions is None or sample.friction in frictions):
            groups[sample.size, sample.boundary, sample.order][sample.friction] = sample
    for (size, boundary, order), some in groups.items():
        full = groups.get((size, "periodic", 1), {})
        both = sorted(set(some) & set(full))
        if order > 1 and both:
            pair = [some[f] for f in both], [full[f] for f in both]
            arc = np.mean([sample.numbers["arc length [diameters]"] for sample in pair[0]])
            found[size, boundary, order] = (*change(*pair, name), float(arc))
    return found


def full_scatter(samples) -> dict[int, float]:
    """Relative scatter of single full cylinders' early ratio, root mean square over the frictions, by size [%]."""
    squares = defaultdict(list)
    for sample in samples.values():
        if sample.order == 1 and len(sample.runs) > 1:
            squares[sample.size].append((sample.scatter() / sample.numbers["early ratio"]) ** 2)
    return {size: 100 * float(np.sqrt(np.mean(some))) for size, some in squares.items()}


def write_csv(samples, path: Path) -> None:
    rows = []
    for sample in samples.values():
        row = {
            "size": sample.size, "friction": sample.friction, "boundary": sample.boundary, "order": sample.order,
            "runs": len(sample.runs), "failed": len(sample.failed),
        }  # fmt: skip
        for name, value in sample.numbers.items():
            row[name] = value
            if name in next(iter(sample.left_out.values()), {}):
                row[name + " +-"] = sample.error(name)
        if sample.left_out:
            row["scatter of a run's early ratio"] = sample.scatter()
        rows.append(row)
    at = {(row["size"], row["friction"], row["boundary"], row["order"]): row for row in rows}
    frictions = sorted({sample.friction for sample in samples.values()})
    for wanted in (*((f,) for f in frictions), None):
        for name in COMPARED:
            for (size, boundary, order), (value, error, arc) in changes(samples, name, wanted).items():
                key = size, wanted[0] if wanted else ALL, boundary, order
                if key not in at:
                    at[key] = dict(zip(("size", "friction", "boundary", "order"), key, strict=True))
                    at[key]["arc length [diameters]"] = arc
                    rows.append(at[key])
                at[key][f"{name}, change from n = 1 [%]"] = value
                at[key][f"{name}, change from n = 1 [%] +-"] = error
    fields = list(dict.fromkeys(name for row in rows for name in row))
    with open(path, "w", newline="") as file:
        for line in DEFINITIONS.splitlines():
            file.write(f"# {line}\n")
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(
            {name: f"{value:.5g}" if isinstance(value, float) else value for name, value in row.items()} for row in rows
        )


def print_tables(samples) -> None:
    """Markdown: changes from the full cylinder, over all frictions and by friction; then the numbers themselves."""
    print(DEFINITIONS + "\n")
    scatter = full_scatter(samples)
    sizes = sorted(scatter)
    for name in COMPARED:
        print(f"\n{name}, change from n = 1 [%], mean over the frictions (arc length in diameters)")
        found = changes(samples, name)
        print_changes({f"{size} balls": of_size(found, size) for size in sizes})
    print("\nscatter of single full cylinders, early ratio [%]")
    table([f"{size} balls" for size in sizes], [[f"{scatter[size]:.1f}" for size in sizes]])
    frictions = sorted({sample.friction for sample in samples.values()})
    by_friction = {f"f = {f:g}": changes(samples, "early ratio", (f,)) for f in frictions}
    for size in sizes:
        print(f"\nearly ratio, change from n = 1 [%], {size} balls, by friction")
        print_changes({name: of_size(found, size) for name, found in by_friction.items()})
    shown = ("peak ratio", "strain at peak [%]", "dilatancy at peak", "early ratio", "critical ratio",
             "coordination at end", "void ratio at start", "solid fraction, inner half",
             "solid fraction, outer half")  # fmt: skip
    rows = []
    for sample in samples.values():
        row = [f"{sample.size}", f"{sample.friction:g}", sample.boundary, f"{sample.order}", f"{len(sample.runs)}"]
        row[-1] += f", {len(sample.failed)} failed" * bool(sample.failed)
        for name in shown if sample.numbers else ():
            digits = 1 if "%" in name else 3
            row.append(f"{sample.numbers[name]:.{digits}f} ± {sample.error(name):.{digits}f}")
        rows.append(row)
    print()
    table(["balls", "f", "boundary", "n", "runs", *shown], rows)


def of_size(found, size):
    return {key[1:]: value for key, value in found.items() if key[0] == size}


def print_changes(columns) -> None:
    """A table of changes: under each heading those by (boundary, order)."""
    rows = []
    for boundary, order in sorted({key for some in columns.values() for key in some}):
        row = [f"{order}{', rigid' * (boundary == 'rigid')}"]
        for some in columns.values():
            value = some.get((boundary, order))
            row.append("{:+.1f} ± {:.1f} ({:.1f})".format(*value) if value else "-")
        rows.append(row)
    table(["n", *columns], rows)


def table(heads, rows) -> None:
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
