"""Descent by optax's Adam: for many parameters, or as the plain alternative that a fit of few is measured against.

Adam needs a gradient a step and no Jacobian. For few parameters it takes ten times the runs of least squares; for a
friction of every ball the gradient comes from reverse mode, at a cost that does not grow with their
number.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from calibrate.evaluate import Evaluator
from calibrate.fit import _prior_rows
from calibrate.model import Model, RunFailed
from calibrate.parameters import ParameterSet, Prior, fittable
from calibrate.result import Fit
from calibrate.start import start_by_rule
from calibrate.verdict import CONVERGED, concluded, weighted_residual


def _adam(value_and_gradient: Callable, start: np.ndarray, low, high, learning_rate: float, steps: int, settled: float):
    """Adam with its steps halved after a failed point, which is left again. Returns (best point, its loss, losses)."""
    import optax

    if not (np.isfinite(learning_rate) and learning_rate > 0):
        raise ValueError(f"learning_rate = {learning_rate!r}: must be positive, the size of a step of a log or logit.")
    if isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
        raise ValueError(f"steps = {steps!r}: must be a whole number >= 1.")
    optimiser = optax.adam(1.0)
    memory = optimiser.init(jnp.asarray(start))
    point, last, best, least, losses, size = np.array(start), None, None, np.inf, [], learning_rate
    for _ in range(steps):
        loss, slope = value_and_gradient(point)
        losses.append(float(loss))
        if not (np.isfinite(loss) and np.isfinite(slope).all()):
            if last is None:
                raise RunFailed("descent: the run at the start failed; start elsewhere.")
            point, size = 0.5 * (point + last), 0.5 * size  # a failed run is a rejected step
            continue
        if loss < least:
            best, least = point.copy(), float(loss)
        update, memory = optimiser.update(jnp.asarray(slope), memory)
        last, point = point, np.clip(point + size * np.asarray(update), low, high)
        if np.abs(point - last).max() < settled:
            break
    return best, least, losses


def fit_by_descent(
    simulator,
    targets,
    names: Sequence[str] | str,
    *,
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, Prior] | None = None,
    learning_rate: float = 0.1,
    steps: int = 60,
    settled: float = 1e-4,
    log: str | Path | None = None,
) -> Fit:
    """Fit named parameters by Adam on the mean square of the weighted residuals, gradients by tangents.

    start: values by name, by default the rule of `fit_parameters`. learning_rate: of the log or logit [-]. steps: most
    passes. settled: stop when a step is smaller [-]. The rest and the result as in `fit_parameters`; the standard
    errors are from the tangents at the best point. Raises what it raises.
    """
    model = (
        simulator
        if isinstance(simulator, Model)
        else Model(simulator, ParameterSet.of(simulator.params, names, bounds))
    )
    parameters = model.parameters
    evaluator = Evaluator(model, targets, log)
    rows, centres = _prior_rows(parameters, priors)
    evaluator.check_count(extra=len(rows))
    low, high = parameters.limits()

    def value_and_gradient(z):
        tried = evaluator.tangents(z, range(len(parameters)))
        if tried.failed:
            return np.nan, np.full(len(z), np.nan)
        residual = weighted_residual(evaluator, (rows, centres), z, tried.prediction)
        weighted = np.concatenate([tried.jacobian / evaluator.sigma[:, None], rows])
        return residual @ residual / residual.size, 2 * weighted.T @ residual / residual.size

    z = parameters.coordinates(start) if start else start_by_rule(model.simulator, parameters, evaluator.targets)
    best, _, losses = _adam(value_and_gradient, z, low, high, learning_rate, steps, settled)
    status = CONVERGED if len(losses) < steps else f"stopped: {steps} steps are spent"
    return concluded(
        evaluator, status, lambda tried: tried.jacobian, start=z, last=best, prior_rows=(rows, centres),
        tolerance=settled,
    )  # fmt: skip


@dataclass(frozen=True)
class FrictionField:
    """A friction for each of N balls.

    friction: (N,) [-]. losses: (S,) mean weighted square misfit with the prior's part, one a step.
    """

    friction: np.ndarray
    losses: np.ndarray


def fit_friction_per_ball(
    test, targets, prior: Prior, *, learning_rate: float = 0.05, steps: int = 20, settled: float = 1e-4
) -> FrictionField:
    """Fit a friction for every ball of a test's sector by Adam and reverse mode.

    targets: Datum and MeasuredCurve objects. prior: of each ball's friction, which a curve alone cannot tell apart; its
    part of the loss is the mean over the balls. Each step costs four to six runs. Raises ValueError for targets beyond
    the run, RunFailed where the run at the prior fails.
    """
    targets = list(targets) if isinstance(targets, list | tuple) else [targets]
    model = Model(test, ParameterSet.of(replace(test.params, friction=prior.value), "friction"))
    evaluator = Evaluator(model, targets)
    observed, sigma = jnp.asarray(evaluator.observed), jnp.asarray(evaluator.sigma)
    friction, _ = fittable(test.params)["friction"]
    centre = friction.to_coordinate(prior.value)

    def loss(z):
        curve = test.simulate(replace(test.params, friction=friction.from_coordinate(z)))
        misfit = (jnp.concatenate([target.predict(curve) for target in targets]) - observed) / sigma
        total = jnp.mean(misfit**2) + jnp.mean(((z - centre) / prior.spread) ** 2)
        return jnp.where(curve.status == 0, total, jnp.nan)

    compiled = jax.jit(jax.value_and_grad(loss))

    def value_and_gradient(z):
        value, slope = compiled(jnp.asarray(z))
        return float(value), np.asarray(slope)

    start = np.full(len(test.cut), float(centre))
    best, _, losses = _adam(value_and_gradient, start, -20.0, 20.0, learning_rate, steps, settled)
    return FrictionField(np.asarray(friction.from_coordinate(best)), np.array(losses))
