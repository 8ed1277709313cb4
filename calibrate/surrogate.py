"""A surface through all runs of a scene: what curve to expect for which parameters, and how sure that is.

Every run was made on a packing of its own, so what the surface leaves of it is the scatter of packings. The numbers of
a curve (`calibrate.nodes`) are put into a few components in which this scatter is independent and of size one; in each
a Gaussian process carries a parabola and what bends otherwise. What it says of a point is checked on every run by
leaving that run out, and where it was too sure, its variances are raised.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

KEPT = 0.9999  # share of the variance that the components keep
# Degrees of freedom for each component: with fewer the least of their scatters is found too small, and a parameter too
# sure (coverage of 95 % intervals on 40 left-out runs of 500 balls: 4 components 95 %, 8 components 80 %).
FREEDOM_EACH, MOST_COMPONENTS = 7, 8

# The slopes and lengths of the processes are chosen by the runs that they then explain; on 160 surfaces whose truth was
# known their own variance was too small by 1.05 to 1.35 with 30 or 40 runs.
CHOSEN = 1.3

# Centres and widths of the normal priors of the logarithms of slope, curvature, size and length of bends, and scatter,
# for coordinates from -1 to 1 and values in which the packings' scatter is about one.
PRIOR = {"slope": (5.0, 1.5), "curvature": (1.5, 1.5), "bend": (1.0, 1.5), "scatter": (1.0, 0.4), "length": (1.2, 0.6)}


def quadratic(x: np.ndarray) -> np.ndarray:
    """(n, p) one, the (n, P) coordinates, their squares and products."""
    pairs = [x[:, [i]] * x[:, i:] for i in range(x.shape[1])]
    return np.concatenate([np.ones((len(x), 1)), x, *pairs], axis=1)


class Process:
    """A Gaussian process for one component of N runs at (N, P) coordinates between -1 and 1."""

    def __init__(self, x: np.ndarray, y: np.ndarray):
        self.x, self.mean = x, float(y.mean())
        centre = np.log([PRIOR[name][0] for name in ("slope", "curvature", "bend", "scatter")])
        width = [PRIOR[name][1] for name in ("slope", "curvature", "bend", "scatter")]
        dims = x.shape[1]
        self._centre = np.concatenate([centre, np.full(dims, np.log(PRIOR["length"][0]))])
        self._width = np.concatenate([width, np.full(dims, PRIOR["length"][1])])
        self._y = y - self.mean
        self._apart = (x[:, None, :] - x[None, :, :]) ** 2
        found = minimize(self._cost, self._centre, jac=True, method="L-BFGS-B", options={"maxiter": 60})
        self.theta = found.x
        covariance = self._parts(self._apart, x @ x.T)[0] + self.scatter**2 * np.eye(len(x))
        self._factor = cho_factor(covariance, lower=True)
        self._alpha = cho_solve(self._factor, self._y)

    @property
    def scatter(self) -> float:
        """Standard deviation from packing to packing."""
        return float(np.exp(self.theta[3]))

    def _parts(self, apart, product, theta=None):
        theta = self.theta if theta is None else theta
        slope, curvature, bend = np.exp(2 * theta[:3])
        bent = bend * np.exp(-0.5 * (apart * np.exp(-2 * theta[4:])).sum(-1))
        line, curve = slope * product, curvature * product**2
        return 100.0 + line + curve + bent, line, curve, bent

    def _cost(self, theta):
        """Minus the log of the posterior density of the logarithms, and its gradient."""
        product = self.x @ self.x.T
        whole, line, curve, bent = self._parts(self._apart, product, theta)
        noise = np.exp(2 * theta[3])
        try:
            factor = cho_factor(whole + noise * np.eye(len(self.x)), lower=True)
        except np.linalg.LinAlgError:
            return 1e10, np.zeros_like(theta)
        inverse = cho_solve(factor, np.eye(len(self.x)))
        alpha = inverse @ self._y
        from_prior = (theta - self._centre) / self._width
        cost = 0.5 * self._y @ alpha + np.log(np.diag(factor[0])).sum() + 0.5 * from_prior @ from_prior
        weight = np.outer(alpha, alpha) - inverse
        slopes = [2 * line, 2 * curve, 2 * bent, 2 * noise * np.eye(len(self.x))]
        slopes += [bent * self._apart[..., k] * np.exp(-2 * theta[4 + k]) for k in range(self.x.shape[1])]
        gradient = np.array([-0.5 * (weight * each).sum() for each in slopes])
        return float(cost), gradient + from_prior / self._width

    def predict(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) mean, and variance of the mean of many packings, at (n, P) coordinates."""
        slope, curvature, bend = np.exp(2 * self.theta[:3])
        product, length = x @ self.x.T, np.exp(-self.theta[4:])
        here, there = x * length, self.x * length
        apart = (here**2).sum(1)[:, None] + (there**2).sum(1) - 2 * here @ there.T
        cross = 100.0 + (slope + curvature * product) * product + bend * np.exp(-0.5 * np.maximum(apart, 0.0))
        own = (x**2).sum(1)
        prior = 100.0 + slope * own + curvature * own**2 + bend
        half = solve_triangular(self._factor[0], cross.T, lower=True)
        return self.mean + cross @ self._alpha, np.maximum(prior - (half**2).sum(0), 0.0)

    def residual(self) -> tuple[np.ndarray, float]:
        """(N,) what the process leaves of the runs, and the degrees of freedom of that."""
        noise = self.scatter**2
        inverse = cho_solve(self._factor, np.eye(len(self.x)))
        return noise * self._alpha, float(noise * np.trace(inverse))

    def left_out(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) what the other runs say of each run less what it gave, and the variance of that."""
        inverse = cho_solve(self._factor, np.eye(len(self.x)))
        variance = 1 / np.diag(inverse)
        return -self._alpha * variance, variance


@dataclass(frozen=True)
class Surrogate:
    """A surface through N runs; K components of D numbers, P coordinates.

    x: (N, P), between -1 and 1. mean, scale: (D,). basis: (K, D) rows that turn scaled numbers into components.
    back: (K, D) that turns components back. processes: K. inflation: factor on all variances found by leaving out.
    scatter: (K,) variance from packing to packing in the components. outside: (D,) standard deviation of what the
    components do not hold, in the units of the numbers. freedom: degrees of freedom of the components' distribution,
    which is Student's, as the scatter is known from the runs alone. left_out: (N, K) what the other runs say of each
    run less what it gave, over the standard deviation.
    """

    x: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    basis: np.ndarray
    back: np.ndarray
    processes: tuple[Process, ...]
    inflation: float
    outside: np.ndarray
    freedom: float
    left_out: np.ndarray

    @property
    def scatter(self) -> np.ndarray:
        return np.array([each.scatter**2 for each in self.processes]) * self.inflation

    def components(self, values: np.ndarray) -> np.ndarray:
        """(.., K) of (.., D) numbers."""
        return ((values - self.mean) / self.scale) @ self.basis.T

    def covariance(self, noise: np.ndarray) -> np.ndarray:
        """(K, K) covariance in the components of a (D, D) one of the numbers."""
        rows = self.basis / self.scale
        return rows @ noise @ rows.T

    def numbers(self, components: np.ndarray) -> np.ndarray:
        """(.., D) numbers of (.., K) components."""
        return self.mean + self.scale * (components @ self.back)

    def predict(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, K) mean and variance of the mean of many packings in each component, at (n, P) coordinates."""
        found = [each.predict(x) for each in self.processes]
        return np.stack([m for m, _ in found], -1), CHOSEN * self.inflation * np.stack([v for _, v in found], -1)


def least_runs(dims: int) -> int:
    """Fewest runs through which a surface in so many coordinates can be laid."""
    return 3 * dims + 8


def surrogate(x: np.ndarray, values: np.ndarray, straight: int = 0) -> Surrogate:
    """The surface through (N, D) numbers of runs at (N, P) coordinates between -1 and 1.

    straight: so many of the last coordinates act nearly along a line, such as the void ratio that a packing began with.

    Raises ValueError for fewer runs than `least_runs`.
    """
    count, dims = x.shape
    if count < least_runs(dims):
        raise ValueError(f"{count} runs for {dims} parameters: a surface through them needs {least_runs(dims)}.")
    design = np.concatenate([quadratic(x[:, : dims - straight]), x[:, dims - straight :]], axis=1)
    if design.shape[1] > count // 2:  # too few for products: slopes alone
        design = design[:, : 1 + dims]
    freedom = float(count - design.shape[1])
    mean = values.mean(0)
    scale = np.maximum(_residual(design, values).std(0) * np.sqrt(count / freedom), 1e-12)
    scaled = (values - mean) / scale
    _, sizes, rows = np.linalg.svd(scaled, full_matrices=False)
    held = int(np.searchsorted(np.cumsum(sizes**2) / (sizes**2).sum(), KEPT)) + 1
    wanted = max(min(dims - straight + 1, int(freedom // 3)), int(freedom // FREEDOM_EACH), 1)
    rows = rows[: min(held, MOST_COMPONENTS, wanted, len(sizes))]
    # What a parabola leaves is scatter and bends; what the processes leave, scatter alone.
    residual = _residual(design, scaled @ rows.T)
    for again in (False, True):
        basis, back = _whitened(scaled, rows, residual, freedom)
        final = scaled @ basis.T
        processes = tuple(Process(x, final[:, k]) for k in range(len(rows)))
        if not again:
            left, freedoms = zip(*(each.residual() for each in processes), strict=True)
            residual, freedom = np.stack(left, axis=1) @ back @ rows.T, float(np.mean(freedoms))
    missed, variance = np.stack([each.left_out() for each in processes], axis=1)
    # Of a covariance estimated with n degrees of freedom the prediction has Student's distribution with n - K + 1.
    student = max(freedom - len(rows) + 1, 1.0)
    inflation = freedom / student * max(float((missed**2 / variance).mean()), 1.0)
    outside = (scaled - final @ back) * scale
    outside_sd = np.sqrt((outside**2).sum(0) / max(count - len(rows) - 1, 1))
    left_out = (missed / np.sqrt(inflation * variance)).T
    return Surrogate(x, mean, scale, basis, back, processes, inflation, outside_sd, student, left_out)


def _whitened(scaled: np.ndarray, rows: np.ndarray, residual: np.ndarray, freedom: float):
    """(K, D) rows into components in which a (N, K) residual along `rows` is independent and one, those that the
    parameters move most first; and (K, D) rows back."""
    kept = len(rows)
    spread = residual.T @ residual / freedom
    lower = np.linalg.cholesky(spread + 1e-10 * np.trace(spread) * np.eye(kept))
    signal = solve_triangular(lower, (scaled @ rows.T - residual).T, lower=True).T
    _, _, turned = np.linalg.svd(signal - signal.mean(0), full_matrices=True)
    return turned @ solve_triangular(lower, rows, lower=True), turned @ lower.T @ rows


def _residual(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    return values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
