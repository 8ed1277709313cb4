"""Gradings of random specimens: distributions of ball radii, by number, and as sieves measure them, by mass."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from axijax.packing import check_positive


@dataclass(frozen=True)
class Grading:
    """A distribution of ball radii: cumulative share by number against radius, linear between knots.

    radii: (K,) rising [L]. share: (K,) from 0 to 1 [-]. name: what it is, for reports.
    """

    radii: tuple[float, ...]
    share: tuple[float, ...]
    name: str

    def sample(self, balls: int) -> np.ndarray:
        """Radii at the middles of `balls` equal parts of the distribution, rising; (balls,) [L]."""
        return np.interp((np.arange(balls) + 0.5) / balls, self.share, self.radii)


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
    return Grading((small, small, large, large), (0.0, number, number, 1.0), name)


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
    return Grading(tuple(fine / 2), tuple(share), f"sieve curve {path.name}")
