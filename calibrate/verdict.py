"""How a fit ends: the best point that was evaluated, and whether it may be called converged.

A search that has come to rest has not always found the answer: runs failed on the way, tangents ran away, nothing in
reach fits the data. Each doubt takes the word "converged" from the status and is told in a sentence among the warnings.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from calibrate.evaluate import Evaluation, Evaluator
from calibrate.measured import MeasuredCurve
from calibrate.model import LARGEST, RunFailed
from calibrate.result import Fit, of_the_simulator, uncertainty
from calibrate.targets import trouble

CONVERGED = "converged"
FAR = 5.0  # times the stated uncertainty; a larger root mean square misfit is no answer to the data
NEAR_BOUND = 2e-3  # of a log or logit


@dataclass(frozen=True)
class Doubt:
    """A reason why a fit is not converged: a few words for the status, and a sentence with a remedy."""

    words: str
    sentence: str


def weighted_residual(evaluator: Evaluator, prior_rows, z, prediction) -> np.ndarray:
    """(M + Q,) residuals over their uncertainties, priors behind the data. prior_rows: (Q, P) rows and (Q,) centres in
    coordinates over their spread."""
    residual = (prediction - evaluator.observed) / evaluator.sigma
    return np.concatenate([residual, prior_rows[0] @ np.asarray(z) - prior_rows[1]])


def best_evaluation(evaluator: Evaluator, prior_rows, last: np.ndarray | None = None) -> Evaluation:
    """The sound evaluation with the least misfit, the one at `last` where none is better.

    Raises RunFailed where every run failed.
    """
    sound = [tried for tried in evaluator.evaluations if not tried.failed]
    if not sound:
        raise RunFailed(f"no run of the fit was sound: {evaluator.evaluations[-1].failed}.")

    def misfit(tried: Evaluation) -> tuple[float, bool, bool]:
        residual = weighted_residual(evaluator, prior_rows, tried.coordinates, tried.prediction)
        elsewhere = last is None or not np.array_equal(tried.coordinates, last)
        return float(residual @ residual), elsewhere, tried.jacobian is None

    return min(sound, key=misfit)


def concluded(
    evaluator: Evaluator,
    status: str,
    slopes_at: Callable[[Evaluation], np.ndarray | None],
    *,
    start: np.ndarray,
    last: np.ndarray | None = None,
    prior_rows=None,
    sigma_known: bool | None = None,
    tolerance: float = 1e-3,
    notes: tuple[str, ...] = (),
) -> Fit:
    """The result of a search that ended.

    status: "converged" or why it stopped. slopes_at: (M, P) Jacobian at an evaluation, or None where none is known.
    start, last: (P,) where the search began and where it came to rest. prior_rows: see `weighted_residual`.
    sigma_known: as in `uncertainty`; by default what the targets say. tolerance: smallest step that the search took.

    Raises RunFailed where every run failed.
    """
    parameters = evaluator.model.parameters
    prior_rows = (np.zeros((0, len(parameters))), np.zeros(0)) if prior_rows is None else prior_rows
    if sigma_known is None:
        sigma_known = all(getattr(target, "sigma_known", True) for target in evaluator.targets)
    best = best_evaluation(evaluator, prior_rows, last)
    residual = weighted_residual(evaluator, prior_rows, best.coordinates, best.prediction)
    slopes, warnings = slopes_at(best), ()
    if slopes is None or not np.isfinite(slopes).all():
        slopes = np.zeros((evaluator.observed.size, len(parameters)))
        covariance, scatter = np.full((len(parameters),) * 2, np.nan), float("nan")
    else:
        weighted = np.concatenate([slopes / evaluator.sigma[:, None], prior_rows[0]])
        covariance, scatter, warnings = uncertainty(parameters, residual, weighted, sigma_known)
        covariance = covariance + of_the_simulator(best.prediction, best.stretch, evaluator.sigma, weighted)
    doubts = _doubts(evaluator, best, residual)
    if last is not None:
        allowed = np.maximum(2 * tolerance, 0.2 * np.nan_to_num(np.sqrt(np.abs(np.diag(covariance)))))
        if (np.abs(best.coordinates - last) > allowed).any():
            doubts.append(
                Doubt(
                    "a point on the way fits better than the one where the search came to rest",
                    f"the search came to rest at {_named(evaluator, last)}, where the misfit is larger than at the "
                    f"point returned, {_named(evaluator, best.coordinates)}: the misfit is rough from run to run, so "
                    "the best value may lie elsewhere; fit a shorter strain range.",
                )
            )
    if status == CONVERGED and doubts:
        status = f"not converged: {', '.join(doubt.words for doubt in doubts)}"
    return Fit(
        parameters,
        best.coordinates,
        covariance,
        slopes,
        best.prediction,
        evaluator.observed,
        evaluator.sigma,
        scatter,
        status,
        (*(doubt.sentence for doubt in doubts), *warnings, *_rising(evaluator)),
        tuple(evaluator.targets),
        replace(evaluator.model.cost),
        sum(tried.failed is not None for tried in evaluator.evaluations),
        (*_no_step(evaluator, start, best.coordinates, tolerance), *notes),
        tuple(evaluator.evaluations),
    )


def _doubts(evaluator: Evaluator, best: Evaluation, residual: np.ndarray) -> list[Doubt]:
    """Why the best point is no converged fit, whatever the search says."""
    tried, parameters, doubts = evaluator.evaluations, evaluator.model.parameters, []
    failed = [one for one in tried if one.failed]
    if failed:
        doubts.append(
            Doubt(
                f"{len(failed)} of {len(tried)} runs failed",
                f"{len(failed)} of {len(tried)} runs failed on the way, the first at "
                f"{_named(evaluator, failed[0].coordinates)}: {failed[0].failed}. The search kept clear of them, and "
                "a better fit may lie beyond.",
            )
        )
    largest = max((one.largest_tangent for one in tried), default=0.0)
    if not largest <= LARGEST:
        doubts.append(
            Doubt(
                "the tangents ran away",
                f"the tangents ran away, to |dR/d log p| = {largest:.2g}; above {LARGEST:g} they say nothing about "
                "where the misfit falls: cut the data to a shorter strain range, or take jacobian='difference' in "
                "calibrate.fit_parameters.",
            )
        )
    misfit = float(np.sqrt(residual @ residual / max(residual.size - len(parameters), 1)))
    if not misfit <= FAR:
        doubts.append(
            Doubt(
                f"the misfit is {misfit:.3g} times the stated uncertainty",
                f"the misfit is {misfit:.3g} times the stated uncertainty (more than {FAR:g} is no fit): either these "
                "parameters cannot make the measured curve, or the search has not found how. Compare the two curves, "
                "then look at the data's units and signs, at the case, and at which parameters are fitted.",
            )
        )
    low, high = parameters.limits()
    for p, name in enumerate(parameters.names):
        if min(best.coordinates[p] - low[p], high[p] - best.coordinates[p]) < NEAR_BOUND:
            doubts.append(
                Doubt(f"{name} is at its bound", f"{name} is at its bound; widen the bounds or doubt the data.")
            )
    for target in evaluator.targets:
        functional = getattr(target, "functional", None)
        why = None if functional is None or best.curve is None else trouble(functional, best.curve)
        if why:
            doubts.append(
                Doubt(
                    f"the run does not reach '{target.label}'",
                    f"the run does not reach '{target.label}': {why}. The parameter that fits it is wrong; run it "
                    "farther with a larger axial_strain, or compare another number.",
                )
            )
    return doubts


def _rising(evaluator: Evaluator) -> list[str]:
    """A warning for each measured curve that ends before its peak."""
    return [
        f"the data still rise at the last point (R = {target.stress_ratio[-1]:g}, strain {target.last_strain:g}): the "
        "peak is not in them, so the friction rests on the rise; look at its interval."
        for target in evaluator.targets
        if isinstance(target, MeasuredCurve) and target.stress_ratio.argmax() == len(target) - 1
    ]


def _no_step(evaluator: Evaluator, start: np.ndarray, found: np.ndarray, tolerance: float) -> list[str]:
    """A note where the answer is where the search began."""
    if np.array_equal(start, found):
        return [f"no step was taken: the answer is the start, {_named(evaluator, start)}."]
    if (np.abs(found - start) <= 5 * tolerance).all():
        return [f"hardly a step was taken: the answer is within {5 * tolerance:.1%} of the start, "
                f"{_named(evaluator, start)}."]  # fmt: skip
    return []


def _named(evaluator: Evaluator, z) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in evaluator.model.parameters.values(z).items())
