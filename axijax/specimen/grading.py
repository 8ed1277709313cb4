"""Gradings of random specimens: distributions of ball radii, by number, and as sieves measure them, by mass."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from axijax.specimen.specimen import check_positive

WELL_MET = 0.05  # share of the whole mass by which a fraction may miss what was asked for without a warning
MOST_BALLS = 1_000_000  # in a sector, beyond which it is not looked for how many balls would do
MANY = 2000  # balls of a fraction whose mean volume is that of the distribution


class Fraction(NamedTuple):
    """One fraction of a grading, between two sieves.

    smallest, largest: radii of the balls that belong to it [L]. wanted, got: shares of the whole mass [-].
    balls: how many it got.
    """

    smallest: float
    largest: float
    wanted: float
    got: float
    balls: int


@dataclass(frozen=True)
class Grading:
    """A distribution of ball radii: cumulative share by number against radius, linear between knots.

    radii: (K,) rising [L]. share: (K,) from 0 to 1 [-]. name: what it is, for reports.
    sieves: (F + 1,) radii that part the fractions whose masses are asked for, from the smallest to the largest [L];
        empty where radii are asked for by number alone.
    """

    radii: tuple[float, ...]
    share: tuple[float, ...]
    name: str
    sieves: tuple[float, ...] = ()

    def sample(self, balls: int) -> np.ndarray:
        """Radii of so many balls, rising; (balls,) [L]: at the middles of equal parts of the distribution by number.

        Between sieves there are as many of them as come nearest to the masses asked for.
        """
        return self._between(balls, 0.0, 1.0) if not self.sieves else np.concatenate(_Quotas(self).radii(balls))

    def fractions(self, radius: np.ndarray) -> list[Fraction]:
        """What balls of these radii are against what was asked for; empty without sieves."""
        if not self.sieves:
            return []
        balls = np.histogram(radius, self.sieves)[0]
        got = np.histogram(radius, self.sieves, weights=radius**3)[0] / (radius**3).sum()
        parts = zip(self.sieves[:-1], self.sieves[1:], _Quotas(self).wanted, got, balls, strict=True)
        return [Fraction(float(a), float(b), float(wanted), float(now), int(n)) for a, b, wanted, now, n in parts]

    def enough(self, balls: int) -> int | None:
        """A number of balls that meets every fraction, the least that is found from `balls` on; None beyond MOST_BALLS.

        Every fraction then has a ball, and is within WELL_MET.
        """
        quotas = _Quotas(self)
        few, many = balls, balls
        while not quotas.met(many):
            few, many = many, int(1.25 * many) + 1
            if many > MOST_BALLS:
                return None
        while many - few > 1:
            middle = (few + many) // 2
            few, many = (few, middle) if quotas.met(middle) else (middle, many)
        return many

    def _between(self, balls: int, low: float, high: float) -> np.ndarray:
        """Radii of balls in the part of the distribution between two shares by number; (balls,) [L]."""
        middles = (np.arange(balls) + 0.5) / max(balls, 1)
        return np.interp(low + (high - low) * middles, self.share, self.radii)


class _Quotas:
    """How many balls of each fraction meet a grading's masses best.

    share: (F + 1,) cumulative, by number, at the sieves. wanted: (F,) of the mass. cube: (F,) mean cubed radius [L^3].
    """

    def __init__(self, grading: Grading) -> None:
        self.grading, inner = grading, grading.sieves[1:-1]
        self._known: dict[tuple[int, int], float] = {}
        self.share = np.concatenate([[0.0], np.interp(inner, grading.radii, grading.share), [1.0]])
        radii, share = np.append(grading.radii, inner), np.append(grading.share, self.share[1:-1])
        order = np.lexsort((share, radii))
        a, b, number = radii[order][:-1], radii[order][1:], np.diff(share[order])
        cubes = number * (a + b) * (a**2 + b**2) / 4  # the mean cube of radii that are spread evenly from a to b
        mass = np.bincount(np.searchsorted(inner, (a + b) / 2), cubes, len(grading.sieves) - 1)
        self.wanted, self.cube = mass / mass.sum(), mass / np.maximum(np.diff(self.share), 1e-300)

    def radii(self, balls: int) -> list[np.ndarray]:
        """Those of each fraction [L]."""
        parts = zip(self.counts(balls), self.share[:-1], self.share[1:], strict=True)
        return [self.grading._between(count, low, high) for count, low, high in parts]

    def met(self, balls: int) -> bool:
        off, empty, _ = self._misses(self.counts(balls))
        return off <= WELL_MET and not empty

    def counts(self, balls: int) -> np.ndarray:
        """Balls of each fraction, (F,): from the nearest whole numbers by moving single balls while that helps."""
        exact = balls * np.diff(self.share)
        counts = exact.astype(int)
        counts[np.argsort(counts - exact)[: balls - counts.sum()]] += 1
        best = self._misses(counts)
        kinds, one = np.flatnonzero(self.wanted > 0), np.eye(counts.size, dtype=int)
        while True:
            moved = [counts + one[b] - one[a] for a in kinds for b in kinds if a != b and counts[a] > 0]
            tried = [self._misses(now) for now in moved]
            if not tried or min(tried) >= best:
                return counts
            best = min(tried)
            counts = moved[tried.index(best)]

    def _misses(self, counts: np.ndarray) -> tuple[float, int, float]:
        """What makes one choice worse than another: by how much of the mass the worst fraction is missed, where that
        is more than WELL_MET; then how many fractions have no ball; then by how much the worst is missed anyway."""
        cubes = np.array([self._cubes(place, count) for place, count in enumerate(counts)])
        off = float(np.abs(cubes / cubes.sum() - self.wanted).max())
        return max(off, WELL_MET), int(((counts == 0) & (self.wanted > 0)).sum()), off

    def _cubes(self, place: int, count: int) -> float:
        """Cubed radii of so many balls of one fraction, summed [L^3]."""
        if count > MANY:
            return count * self.cube[place]
        if (place, count) not in self._known:
            radii = self.grading._between(count, self.share[place], self.share[place + 1])
            self._known[place, count] = float((radii**3).sum())
        return self._known[place, count]


def uniform(radius: float = 20.0) -> Grading:
    """All balls of one radius [L]."""
    check_positive("radius", radius)
    return Grading((radius, radius), (0.0, 1.0), f"uniform, radius {radius:g}")


def two_sizes(small: float, large: float, small_mass: float) -> Grading:
    """Two radii [L]; small_mass: share of the mass that the smaller balls have [-]."""
    check_positive("small", small)
    check_positive("large", large)
    if not small < large:
        raise ValueError(f"small = {small:g}, large = {large:g}: small must be below large.")
    if not 0 < small_mass < 1:
        raise ValueError(f"small_mass = {small_mass!r}: must lie between 0 and 1.")
    number = (small_mass / small**3) / (small_mass / small**3 + (1 - small_mass) / large**3)
    name = f"two sizes, radii {small:g} and {large:g}, {100 * small_mass:g} % small by mass"
    between = (small * large) ** 0.5
    return Grading((small, small, large, large), (0.0, number, number, 1.0), name, (small, between, large))


def linear(smallest: float, largest: float) -> Grading:
    """Radii spread evenly, by number, between two [L]."""
    check_positive("smallest", smallest)
    check_positive("largest", largest)
    if not smallest <= largest:
        raise ValueError(f"smallest = {smallest:g}, largest = {largest:g}: smallest must not be above largest.")
    return Grading((smallest, largest), (0.0, 1.0), f"linear, radii {smallest:g} to {largest:g}")


def sieve_curve(path: Path | str) -> Grading:
    """Grading from a CSV file: two columns under a header line, sieve opening (ball diameter) [L] and per cent passing
    by mass, which must begin at 0 and end at 100; the mass is spread evenly over log(diameter) between sieves.

    Raises ValueError, naming the line, where the file cannot be read or makes no sense.
    """
    import csv

    path = Path(path)
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"sieve curve '{path}' cannot be read ({error}).") from None
    sieves = []
    for line, row in enumerate(rows[1:], start=2):
        try:
            opening, passing = (float(cell) for cell in row)
        except ValueError:
            raise ValueError(
                f"sieve curve '{path}', line {line} is {','.join(row)!r}: must be two numbers, sieve opening and per "
                "cent passing by mass."
            ) from None
        if not (np.isfinite(opening) and opening > 0 and 0 <= passing <= 100):
            raise ValueError(
                f"sieve curve '{path}', line {line} is {','.join(row)!r}: the opening must be positive and the per "
                "cent passing between 0 and 100."
            )
        sieves.append((opening, passing))
    if len(sieves) < 2:
        raise ValueError(f"sieve curve '{path}' has {len(sieves)} sieves below its header line: at least 2 are needed.")
    opening, passing = np.array(sorted(sieves)).T
    if (np.diff(opening) <= 0).any() or (np.diff(passing) < 0).any():
        raise ValueError(f"sieve curve '{path}': per cent passing must rise with the opening, each opening given once.")
    if passing[0] != 0 or passing[-1] != 100:
        raise ValueError(
            f"sieve curve '{path}' goes from {passing[0]:g} to {passing[-1]:g} % passing: add the sieve that nothing "
            "passes and the one that everything passes."
        )
    # The number of balls per mass goes with d^-3, its mean over an interval of log d in closed form.
    fine = np.unique(np.concatenate([opening, np.geomspace(opening[0], opening[-1], 400)]))
    mass = np.diff(np.interp(np.log(fine), np.log(opening), passing))
    number = mass * (fine[:-1] ** -3 - fine[1:] ** -3) / (3 * np.log(fine[1:] / fine[:-1]))
    share = np.concatenate([[0.0], np.cumsum(number) / number.sum()])
    share[-1] = 1.0
    return Grading(tuple(fine / 2), tuple(share), f"sieve curve {path.name}", tuple(opening / 2))
