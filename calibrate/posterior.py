"""What the data say of the parameters, through the surfaces of `calibrate.surrogate`.

For each fitted test the difference between data and surface has the variance of: the packings of the data (a curve of
one packing scatters, the mean of m packings a m-th of that, a laboratory's test of a million grains next to nothing),
the surface itself, and the measurement. It is Student's, since the scatter is known from the runs alone. Surfaces that
stand on the same runs err together; each of T such tests counts T times the surface's variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaln
from scipy.stats import f as f_distribution

from calibrate.ground import Ground
from calibrate.nodes import Nodes
from calibrate.surrogate import Surrogate, surrogate

WIDE_STATE = 1.5  # beyond this, in twice the standard deviation of the packings' void ratios, data lie outside the runs


@dataclass(frozen=True)
class Compared:
    """One test against its surface.

    places: of its parameters in the vector of all. packings: that the data are the mean of; inf for a laboratory.
    sharing: tests that stand on the same runs. state: coordinate of the data's void ratio, None where not known.
    slack: factor on the covariance, above one where the surface cannot reach the data.
    """

    name: str
    nodes: Nodes
    ground: Ground
    stress: float
    places: np.ndarray
    packings: float
    surface: Surrogate
    sharing: int = 1
    state: float | None = None
    weight: float = 1.0
    slack: float = 1.0

    def expected(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, K) mean and variance of the surface at (n, P_all) physical values."""
        x = self.ground.x(values[:, self.places], self.stress)
        if self.state is not None:
            x = np.column_stack([x, np.full(len(x), self.state)])
        mean, variance = self.surface.predict(x)
        return mean, variance * self.sharing

    def covariance(self, variance: np.ndarray, surface: bool = True, scatter: bool = True) -> np.ndarray:
        """(n, K, K) of data minus surface; without the one or the other source to see what it does."""
        diagonal = variance * surface + self.surface.scatter / self.packings * scatter
        whole = np.eye(diagonal.shape[1]) * diagonal[:, :, None] + self.surface.covariance(self.nodes.noise)
        return whole * self.slack / self.weight

    def misfit(self, values: np.ndarray, **sources: bool) -> tuple[np.ndarray, np.ndarray]:
        """(n,) squared distance of the data in standard deviations, and log determinant of the covariance / 2."""
        mean, variance = self.expected(values)
        factor = np.linalg.cholesky(self.covariance(variance, **sources))
        apart = self.surface.components(self.nodes.values) - mean
        white = np.linalg.solve(factor, apart[..., None])[..., 0]
        return (white**2).sum(1), np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(1)

    def log_likelihood(self, values: np.ndarray, **sources: bool) -> np.ndarray:
        """(n,) log of the density of the data."""
        squared, determinant = self.misfit(values, **sources)
        free, count = self.surface.freedom, self.count
        constant = gammaln((free + count) / 2) - gammaln(free / 2) - count / 2 * np.log(free * np.pi)
        return constant - determinant - (free + count) / 2 * np.log1p(squared / free)

    @property
    def count(self) -> int:
        """Components."""
        return len(self.surface.processes)

    def chance(self, values: np.ndarray) -> float:
        """Chance that data made by the model itself would lie farther from it than these do, mean over the values."""
        squared, _ = self.misfit(values)
        return float(f_distribution.sf(squared / self.count, self.count, self.surface.freedom).mean())

    def predictive(self, values: np.ndarray, rng: np.random.Generator, packings: float | None = None) -> np.ndarray:
        """(n, D) numbers that a test might give at (n, P_all) values: packings, surface, what the components leave out
        and measurement drawn anew."""
        mean, variance = self.expected(values)
        share = 1 / (self.packings if packings is None else packings)
        spread = np.sqrt((variance + self.surface.scatter * share) * self.slack)
        tails = np.sqrt(self.surface.freedom / rng.chisquare(self.surface.freedom, (len(values), 1)))
        drawn = self.surface.numbers(mean + spread * rng.standard_normal(mean.shape) * tails)
        rest = self.surface.outside * np.sqrt(share + 1 / len(self.surface.x))
        measured = rng.standard_normal(drawn.shape) @ np.linalg.cholesky(self.nodes.noise).T
        return drawn + rest * rng.standard_normal(drawn.shape) + measured


def compared(
    name: str, nodes: Nodes, ground: Ground, stress: float, places: Sequence[int], packings: float,
    void_ratio: float | None = None, **others: Any,
) -> Compared:  # fmt: skip
    """A test against the surface through its ground's runs.

    Raises ValueError for too few runs, and where the runs have no void ratio that could be compared with the data's.
    """
    values = np.array([nodes.of(_Curve(run.curve)) for run in ground.runs])
    x, state = ground.run_x(), None
    if void_ratio is not None:
        counted = ground.void_ratios()
        if not np.isfinite(counted).all():
            raise ValueError(
                f"'{name}': void_ratio = {void_ratio:g} is given, but no void ratio is counted in the runs of this "
                "scene; leave it out."
            )
        centre, width = counted.mean(), 2 * counted.std()
        state = float((void_ratio - centre) / width)
        x = np.column_stack([x, (counted - centre) / width])
    surface = surrogate(x, values, straight=0 if state is None else 1)
    return Compared(name, nodes, ground, stress, np.asarray(places, int), packings, surface, state=state, **others)


class _Curve:
    """A stored curve's fields as attributes."""

    def __init__(self, fields):
        self.__dict__.update(fields)
