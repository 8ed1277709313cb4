"""Statistics of the boundary study: means over the seeds, their errors, and changes from the full cylinder."""

import itertools
import json
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ORDERS = (1, 2, 3, 4, 6, 8, 12)  # sectors in the full cylinder
STRAINS = np.linspace(0, 0.149, 299)  # axial strains at which curves are compared
WINDOW = 0.01  # axial strain over which a curve is averaged before its peak is taken
EARLY, LATE = (0.01, 0.05), (0.11, 0.149)  # axial strain
CURVES = ("stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "coordination_number")
ARCS = (0, 2.8, 3.5, 4.5, 5.5, 8.5, 20)  # mean diameters
COMPARED = ("early ratio", "peak ratio", "critical ratio", "early ratio x (1 + void ratio)")


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
    for path in sorted(folder.glob("[0-9]*.json")):
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
    """The numbers that the study compares, of a set of runs; `boundary_tables.DEFINITIONS` says what each is."""
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


def by_arc(found) -> list[tuple[float, float, int, float, float, float]]:
    """Changes of all sizes and orders between periodic planes, together by the arc of the sector, wide ones first.

    Arc from and to [diameters], number of samples, weighted mean and its error [%], chi^2 a degree of freedom; where
    that is above 1 the error is widened by its root. Sectors of a size share a full cylinder: errors are a little low.
    """
    periodic = [value for (_, boundary, _), value in found.items() if boundary == "periodic"]
    rows = []
    for least, most in itertools.pairwise(ARCS):
        some = np.array([(value, error) for value, error, arc in periodic if least <= arc < most])
        if len(some):
            weight = some[:, 1] ** -2
            mean = (weight * some[:, 0]).sum() / weight.sum()
            spread = (weight * (some[:, 0] - mean) ** 2).sum() / max(len(some) - 1, 1)
            rows.append((least, most, len(some), mean, np.sqrt(max(spread, 1) / weight.sum()), spread))
    return rows[::-1]


def of_size(found, size):
    return {key[1:]: value for key, value in found.items() if key[0] == size}


def narrowest(found, scatter: float) -> int:
    """Largest order up to which no periodic sector differs from the full cylinder by more than the scatter."""
    largest = 1
    for (boundary, order), (value, *_) in sorted(found.items()):
        if boundary == "periodic":
            if abs(value) > scatter:
                break
            largest = order
    return largest
