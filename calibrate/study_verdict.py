"""How a fit on random packings ends, by name and in words that say what to do.

converged            nothing below holds.
out of reach         the model cannot make these data; by how much it misses.
at a bound           the answer is against the edge of the box in which it was sought.
not identified       the data leave more than half of the box open; along which direction.
scatter too large    the data are of so few packings that they leave it open; how many would do.
runs spent           further runs would narrow the answer; by how much.
badly sampled        the weights of the posterior's points cannot be trusted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.axes import Axis
from calibrate.sampling import Sample

OPEN = 0.5  # share of the box that a 95 % interval may cover
EDGE = 0.04  # share of the box within which an answer is against its bound
MATERIAL_RATIO, MATERIAL_VOLUME = 0.04, 0.004  # misses that matter: relative of R, and of strain (a laboratory's own
# scatter is 2.5 % of R)
LEAST_EFFECTIVE, LARGEST_K = 200, 0.7
TRADED = 0.3  # share of a direction from which a second parameter belongs to it


@dataclass(frozen=True)
class Verdict:
    """name: one of the module's. words: for the status. sentence: what it means and what to do."""

    name: str
    words: str
    sentence: str


@dataclass(frozen=True)
class Precision:
    """What one standard deviation of a parameter is made of, and how many packings would do.

    now: as fitted. scatter: the part that the data's own packings make, surface: the part that the runs' surface makes.
    relative: whether these are shares of the value.
    """

    now: float
    scatter: float
    surface: float
    packings: float
    relative: bool

    def packings_for(self, wanted: float) -> float | None:
        """Packings whose mean would give this standard deviation, None where the surface alone leaves more."""
        rest = self.now**2 - self.scatter**2
        if wanted**2 <= rest or not np.isfinite(self.packings):
            return None
        return self.packings * self.scatter**2 / (wanted**2 - rest)


def open_ones(found: Sample) -> np.ndarray:
    """(P,) whether a parameter is not identified."""
    low, high = found.quantiles([0.025, 0.975])
    return high - low > OPEN


def verdicts(
    axes: Sequence[Axis],
    found: Sample,
    intervals: Mapping[str, tuple[float, float, float]],
    shares: np.ndarray,
    precisions: Mapping[str, Precision],
    misses: Sequence[str],
    known: bool,
    precision: float | None,
) -> list[Verdict]:
    """All that holds, the gravest first; empty where the fit has converged.

    misses: a sentence for each test that is out of reach. intervals: 2.5, 50 and 97.5 % of each parameter.
    """
    told: list[Verdict] = []
    if found.effective < LEAST_EFFECTIVE or found.pareto_k > LARGEST_K:
        told.append(
            Verdict(
                "badly sampled",
                "the posterior is badly sampled",
                f"the posterior's points amount to {found.effective:.0f} independent ones with a Pareto k of "
                f"{found.pareto_k:.2f} (at least {LEAST_EFFECTIVE} and at most {LARGEST_K} are wanted): the intervals "
                "are rough; fit fewer parameters or narrow the bounds.",
            )
        )
    if misses:
        told.append(
            Verdict(
                "out of reach",
                "the model cannot reach these data",
                " ".join(misses) + " The intervals say little then; look at units and signs of "
                "the data, the void ratio of the packings, and what is modelled (rolling resistance) or held.",
            )
        )
    open_now = open_ones(found)
    middle = found.quantiles([0.5])[0]
    for k, axis in enumerate(axes):
        edge = axis.low if middle[k] < 0.5 else axis.high
        if min(middle[k], 1 - middle[k]) < EDGE and not open_now[k]:
            told.append(
                Verdict(
                    "at a bound",
                    f"{_name(axis)} is at its bound",
                    f"{_name(axis)} is at its {'lower' if middle[k] < 0.5 else 'upper'} bound {edge:.4g}: widen the "
                    "bounds, or doubt the data.",
                )
            )
    unknown = [k for k in range(len(axes)) if open_now[k]]
    scattered = [k for k in unknown if _by_scatter(precisions[_name(axes[k])])]
    for k in unknown:
        if k in scattered:
            continue
        low, _, high = intervals[_name(axes[k])]
        told.append(
            Verdict(
                "not identified",
                f"not identified: {_name(axes[k])}, the data allow {low:.2g} to {high:.2g}",
                f"{_name(axes[k])} is not identified: the data allow {low:.3g} to {high:.3g}, of the {axes[k].low:.3g} "
                f"to {axes[k].high:.3g} in which it was sought. {_direction(axes, found, int(k))}",
            )
        )
    limit = precision
    loose = {
        name: each for name, each in precisions.items() if limit and each.now > limit and _by_scatter(each)
    } | {_name(axes[k]): precisions[_name(axes[k])] for k in scattered}  # fmt: skip
    for name, each in loose.items():
        wanted = limit or 0.5 * each.now
        number = each.packings_for(wanted)
        much = f"the mean of {np.ceil(number):.0f} packings would give {_size(wanted, each)}" if number else (
            "data of more or larger packings are needed, and more runs"
        )  # fmt: skip
        told.append(
            Verdict(
                "scatter too large",
                f"scatter too large for {name}",
                f"{name} is known to {_size(each.now, each)} only (one standard deviation), since the data are the "
                f"mean of {each.packings:g} packing(s), whose curve scatters: {much}.",
            )
        )
    if not known and not (loose and all(_by_scatter(each) for each in precisions.values())):
        slow = [_name(axis) for axis, share in zip(axes, shares, strict=True) if share < 0.8]
        by = ", ".join(f"{name} {_size(precisions[name].surface, precisions[name])}" for name in slow)
        told.append(
            Verdict(
                "runs spent",
                "runs spent",
                "the runs are spent while further ones would narrow the answer; the intervals hold what the surface "
                f"through them does not know ({by or 'more than was asked for'}): allow more runs.",
            )
        )
    return told


def _by_scatter(each: Precision) -> bool:
    return each.scatter**2 > 0.5 * each.now**2


def _size(value: float, each: Precision) -> str:
    return f"+-{100 * value:.2g} %" if each.relative else f"+-{value:.2g}"


def _name(axis: Axis) -> str:
    return axis.label or axis.name


def _direction(axes: Sequence[Axis], found: Sample, place: int) -> str:
    """In words, along what the data do not tell this parameter."""
    sizes, directions = np.linalg.eigh(found.covariance)
    row = directions[:, int(np.argmax(sizes * directions[place] ** 2))]
    row = row / row[place]
    others = [k for k in range(len(axes)) if k != place and abs(row[k]) > TRADED]
    if not others:
        return "No other parameter goes with it: hold it, or add data that feel it."
    words = " and ".join(f"{_name(axes[k])} {'rises' if row[k] > 0 else 'falls'}" for k in others)
    return f"As it rises, {words}, and the curves stay as they are: hold one, or add a test that tells them apart."


def direction_table(axes: Sequence[Axis], found: Sample) -> list[dict]:
    """The posterior's principal directions, the widest first: its width over that of the box, and its parts."""
    sizes, directions = np.linalg.eigh(12 * found.covariance)
    return [
        {
            "width_over_box": float(np.sqrt(max(size, 0.0))),
            "parts": {_name(axis): float(part) for axis, part in zip(axes, column, strict=True)},
        }
        for size, column in sorted(zip(sizes, directions.T, strict=True), key=lambda pair: -pair[0])
    ]
