"""Samples of a distribution in a box, by importance sampling that adapts itself, with a statement of its own health.

Points of a Sobol sequence come first. Step by step, from a flat distribution to the one wanted, kernels are set around
the points that weigh most and new points are drawn from them, so that several maxima, bent ridges and flat directions
are all held. What is left is a set of weighted points: their effective number, and the Pareto k of their weights
(Vehtari et al. 2024; below 0.7 the weights can be trusted), say how well. The weights' mean is the evidence.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.special import gammaln, logsumexp
from scipy.stats import qmc

POINTS = 4096
KERNELS, GROUPS = 240, 10
TAIL = 5.0  # degrees of freedom of the kernels, whose tails are then heavier than a normal distribution's
MOST_STAGES, LAST_STAGES = 30, 5
EDGE = 1e-9
FLAT, WIDE = 0.1, 0.2  # shares of the points that are drawn from the whole box, and from one wide kernel


@dataclass(frozen=True)
class Sample:
    """Weighted points of a distribution in the unit box.

    points: (n, P) between 0 and 1. weights: (n,) with the sum one. log_likelihood: (n,).
    evidence: log of the mean likelihood over the box. effective: number of independent points that know as much.
    pareto_k: of the weights; above 0.7 they cannot be trusted.
    """

    points: np.ndarray
    weights: np.ndarray
    log_likelihood: np.ndarray
    evidence: float
    effective: float
    pareto_k: float

    def draws(self, count: int, seed: int = 0) -> np.ndarray:
        """(count,) places of points drawn by their weights, evenly over them."""
        start = np.random.default_rng(seed).random()
        return np.searchsorted(np.cumsum(self.weights)[:-1], (start + np.arange(count)) / count)

    def quantiles(self, shares) -> np.ndarray:
        """(len(shares), P) values below which these shares of the weight lie."""
        found = []
        for column in self.points.T:
            order = np.argsort(column)
            reached = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
            found.append(np.interp(shares, reached, column[order]))
        return np.stack(found, axis=1)

    @property
    def mean(self) -> np.ndarray:
        return self.weights @ self.points

    @property
    def covariance(self) -> np.ndarray:
        """(P, P)."""
        centred = self.points - self.mean
        return (centred.T * self.weights) @ centred


def sample(log_density: Callable[[np.ndarray], np.ndarray], dims: int, points: int = POINTS, seed: int = 0) -> Sample:
    """A sample of a density in the unit box of `dims` dimensions, relative to the flat one.

    log_density: of (n, P) points, (n,); it may be -inf. Raises ValueError where it is so everywhere.
    """
    rng = np.random.default_rng(seed)
    flat = qmc.Sobol(dims, seed=seed).random(points)
    open_space = _opened(np.clip(flat, EDGE, 1 - EDGE))
    proposal = _log_volume(open_space)
    density = _finite(log_density(flat))
    if np.isneginf(density).all():
        raise ValueError("no point of the box has a density: the bounds exclude what the data ask for.")
    reached, at_end = 0.0, 0
    for _ in range(MOST_STAGES):
        # As much of the density as leaves half of the points effective; at the end all of it, twice.
        base = _log_volume(open_space) - proposal
        power = _power(base, density, reached)
        weights = _normalised(base + power * density)
        if power >= 1.0 and reached >= 1.0:
            at_end += 1
            if at_end > LAST_STAGES or 1 / (weights**2).sum() > 0.25 * points:
                break
        reached = power
        open_space, proposal = _drawn(_kernels(open_space, weights, rng), points, rng)
        density = _finite(log_density(_closed(open_space)))
    base = _log_volume(open_space) - proposal
    logs = base + density
    smoothed, k = pareto_smoothed(logs)
    weights = _normalised(smoothed)
    return Sample(
        _closed(open_space), weights, density, float(logsumexp(logs) - np.log(points)), float(1 / (weights**2).sum()), k
    )


def pareto_smoothed(logs: np.ndarray) -> tuple[np.ndarray, float]:
    """Log weights with their largest replaced by those of a Pareto distribution fitted to them, and its shape k
    (Vehtari, Simpson, Gelman, Yao & Gabry 2024; the fit of Zhang & Stephens 2009)."""
    count = int(min(0.2 * logs.size, 3 * np.sqrt(logs.size)))
    order = np.argsort(logs)
    tail, cut = order[-count:], logs[order[-count - 1]]
    if count < 5 or not np.isfinite(cut):
        return logs, np.inf
    top = logs.max()
    excess = np.exp(logs[tail] - top) - np.exp(cut - top)
    if not excess[-1] > 0 or not (excess > 0).any():
        return logs, 0.0
    excess = np.maximum(excess, 1e-300)
    trials = 30 + int(np.sqrt(count))
    quarter = excess[int(count / 4 + 0.5) - 1]
    b = 1 / excess[-1] + (1 - np.sqrt(trials / (np.arange(1, trials + 1) - 0.5))) / (3 * max(quarter, 1e-300))
    with np.errstate(all="ignore"):
        shapes = np.log1p(-b[:, None] * excess).mean(1)
        likelihood = count * (np.log(-b / shapes) - shapes - 1)
    likelihood = np.where(np.isfinite(likelihood), likelihood, -np.inf)
    b_mean = float((b * _normalised(likelihood)).sum())
    k = float(np.log1p(-b_mean * excess).mean())
    scale = -k / b_mean
    k = (count * k + 5) / (count + 10)  # a weak prior at 1/2
    share = (np.arange(count) + 0.5) / count
    with np.errstate(all="ignore"):
        fitted = scale * np.expm1(-k * np.log1p(-share)) / k if abs(k) > 1e-12 else -scale * np.log1p(-share)
        fitted = np.log(fitted + np.exp(cut - top)) + top
    made = logs.copy()
    if np.isfinite(fitted).all():
        made[tail] = np.minimum(fitted, top)
    return made, k


def _finite(values) -> np.ndarray:
    values = np.asarray(values, float)
    return np.where(np.isfinite(values), values, -np.inf)


def _normalised(logs: np.ndarray) -> np.ndarray:
    return np.exp(logs - logsumexp(logs))


def _power(base: np.ndarray, density: np.ndarray, reached: float) -> float:
    def effective(power: float) -> float:
        weights = _normalised(base + power * np.where(np.isneginf(density), -1e300, density) if power else base)
        return 1 / (weights**2).sum()

    wanted = 0.3 * len(base)
    if effective(1.0) >= wanted or reached >= 1.0:
        return 1.0
    low, high = reached, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= wanted else (low, middle)
    return max(low, reached + 1e-4)


def _opened(points: np.ndarray) -> np.ndarray:
    return np.log(points) - np.log1p(-points)


def _closed(open_space: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-open_space))


def _log_volume(open_space: np.ndarray) -> np.ndarray:
    """(n,) log of d point / d open coordinate: the density of a flat distribution in the open coordinates."""
    return -(np.logaddexp(0, open_space) + np.logaddexp(0, -open_space)).sum(1)


@dataclass(frozen=True)
class _Kernels:
    """Groups of kernels, each (J, P) centres and the (P, P) lower factor of their covariance, and their shares; the
    first group is one wide kernel over all."""

    groups: list[tuple[np.ndarray, np.ndarray]]
    shares: np.ndarray


def _kernels(open_space: np.ndarray, weights: np.ndarray, rng) -> _Kernels:
    """Around points drawn by their weights, in groups that follow a bent ridge each with its own covariance."""
    dims = open_space.shape[1]
    mean = weights @ open_space
    whole = ((open_space - mean).T * weights) @ (open_space - mean) + 1e-10 * np.eye(dims)
    # Drawn more often than there are kernels: the covariance of a group is that of its draws.
    places = np.searchsorted(np.cumsum(weights)[:-1], (rng.random() + np.arange(2000)) / 2000)
    drawn = open_space[places]
    white = np.linalg.solve(np.linalg.cholesky(whole), (drawn - mean).T).T
    _, member = kmeans2(white, GROUPS, minit="++", rng=rng)
    groups, shares = [(mean[None], 1.3 * np.linalg.cholesky(whole))], [WIDE]
    for group in range(GROUPS):
        mine = drawn[member == group]
        if len(mine) < 4 * dims:
            continue
        # A little of the whole, for groups of few different points.
        spread = np.cov(mine.T).reshape(dims, dims) + 1e-4 * whole
        count = max(int(KERNELS * len(mine) / len(drawn)), 2)
        width = (4 / ((dims + 2) * count)) ** (1 / (dims + 4))
        # Drawn together a little, so that kernels and points have the spread of the points alone.
        chosen = mine[rng.permutation(len(mine))[:count]] - mine.mean(0)
        centres = mine.mean(0) + np.sqrt(max(1 - width**2, 0.0)) * chosen
        groups.append((centres, width * np.linalg.cholesky(spread)))
        shares.append(len(mine) / len(drawn))
    found = np.array(shares)
    found[1:] *= (1 - FLAT - WIDE) / found[1:].sum()
    return _Kernels(groups, found)


def _drawn(kernels: _Kernels, count: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """(count, P) points of the mixture of kernels and the whole box, and the log of its density."""
    dims = kernels.groups[0][0].shape[1]
    numbers = rng.multinomial(count, [FLAT, *kernels.shares])
    points = [_opened(np.clip(rng.random((numbers[0], dims)), EDGE, 1 - EDGE))]
    for (centres, spread), number in zip(kernels.groups, numbers[1:], strict=True):
        points.append(_student(centres[rng.permutation(np.arange(number) % len(centres))], spread, rng))
    found = np.concatenate(points)
    logs = [np.log(FLAT) + _log_volume(found)]
    for (centres, spread), share in zip(kernels.groups, kernels.shares, strict=True):
        logs.append(np.log(share) + _kernel_density(found, centres, spread))
    return found, logsumexp(logs, axis=0)


def _student(centres: np.ndarray, spread: np.ndarray, rng) -> np.ndarray:
    normal = rng.standard_normal(centres.shape) @ spread.T
    return np.clip(centres + normal / np.sqrt(rng.chisquare(TAIL, (len(centres), 1)) / TAIL), -30, 30)


def _kernel_density(open_space: np.ndarray, centres: np.ndarray, spread: np.ndarray) -> np.ndarray:
    dims = open_space.shape[1]
    inverse = np.linalg.inv(spread)
    a, b = open_space @ inverse.T, centres @ inverse.T
    distance = np.maximum((a**2).sum(1)[:, None] + (b**2).sum(1) - 2 * a @ b.T, 0.0)
    constant = gammaln((TAIL + dims) / 2) - gammaln(TAIL / 2) - dims / 2 * np.log(TAIL * np.pi)
    mean = ((1 + distance / TAIL) ** (-(TAIL + dims) / 2)).mean(1)
    return np.log(mean) + constant - np.log(np.diag(spread)).sum()
