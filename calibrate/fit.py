"""Least-squares fits of a few parameters, through scipy.optimize.least_squares with tangents for the Jacobian.

The economical way, the default: single runs, each carried over to the data by similarity (`start.py`), until that moves
little; there one pass with tangents, and after that single runs again, with the tangents kept while the misfit falls
fast and the stiffness column always fresh and free from the strain stretch (PHYSICS 3.3). The fit stops when the step
that the linear model still wants is below the tolerance or a tenth of a standard error. A failed run is a rejected
step; whether the end may be called converged is for `calibrate.verdict` to say.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from axijax.core.bars import counting
from calibrate.evaluate import Evaluation, Evaluator
from calibrate.model import Model, RunFailed
from calibrate.parameters import ParameterSet, Prior
from calibrate.result import Fit, uncertainty
from calibrate.start import corrected_by_run, start_by_rule
from calibrate.verdict import CONVERGED, best_evaluation, concluded, weighted_residual

Jacobian = Literal["economical", "tangent", "difference"]
Progress = Callable[[float, float], object] | bool
DIFFERENCE_STEP = 1e-4  # of the coordinates, for jacobian="difference"
GOOD_PROGRESS = 0.3  # tangents are kept while the misfit that they can explain falls below this share of what it was
SCATTERED = 0.5  # standard errors; a smaller step that does not shrink from run to run is the runs' own scatter
RULE_RUNS, RULE_MOVE = 4, 0.3  # most runs by the rule; the move of a coordinate after which tangents take over


class _Stop(Exception):  # noqa: N818 - no error: how a search ends inside scipy
    """Enough: the fit has converged or spent its runs."""


def fit_parameters(
    simulator,
    targets,
    names: Sequence[str] | str,
    *,
    start: Mapping[str, float] | Literal["rule", "test"] = "rule",
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, Prior] | None = None,
    jacobian: Jacobian = "economical",
    by_rule: bool = True,
    tolerance: float = 1e-3,
    max_runs: float = 60,
    starts: int = 1,
    seed: int = 0,
    log: str | Path | None = None,
    progress: Progress = False,
) -> Fit:
    """Fit named parameters of a test to measured numbers and curves.

    simulator: a TriaxialTest (or anything with `params` and `simulate`), or a Model made before.
    targets: one or several of Datum and MeasuredCurve.
    names: parameters or aliases: f, kn, ks, ks/kn, s3, beta, rho (see calibrate.parameters).
    start: "rule" (friction from the peak by Thornton's inverse, kn from the rise), "test" (the test's own), or values.
    bounds: {name: (lower, upper)} physical. priors: {name: Prior}.
    jacobian: "economical" (see the module; of a test in stages it is "tangent"), "tangent" (a fresh pass at every
        point), "difference" (two-point, step 1e-4: on smooth runs it beats a tangent that costs more than about 0.7 of
        a run, and fails where runs scatter).
    by_rule: begin with runs carried over by similarity, four at most.
    tolerance: smallest step of a log or logit that is still worth a run [-].
    max_runs: forward-equivalent runs after which to stop.
    starts: with more than one, so many starts are run first, one a core at a time, the others random within the bounds,
        and the fit goes on from the best; a start whose run fails is passed over.
    log: file for every evaluation; named again it resumes.
    progress: True for a bar in the terminal or the notebook; or a function, called before each run with the runs spent
        and the most that are allowed.

    Raises ValueError for what cannot be fitted (fewer numbers than parameters, say), RunFailed where no start gives a
    sound run.
    """
    if jacobian not in ("economical", "tangent", "difference"):
        raise ValueError(f"jacobian = {jacobian!r}: must be 'economical', 'tangent' or 'difference'.")
    if not (np.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"tolerance = {tolerance!r}: must be positive.")
    model = (
        simulator
        if isinstance(simulator, Model)
        else Model(simulator, ParameterSet.of(simulator.params, names, bounds))
    )
    evaluator = Evaluator(model, targets, log)
    if getattr(model.simulator, "stages", ()) and jacobian == "economical":
        jacobian = "tangent"  # similarity says nothing of curves that turn at given strains
    prior_rows = _prior_rows(model.parameters, priors)
    evaluator.check_count(extra=len(prior_rows[0]))
    first = _first_point(model, evaluator, start, starts, seed)
    with counting(progress) as tell:
        search = _Search(evaluator, prior_rows, jacobian, tolerance, max_runs, tell)
        status = search.run(first, by_rule and jacobian == "economical")
        return search.result(first, status)


def _prior_rows(parameters: ParameterSet, priors):
    """Priors as extra rows: (Q, P) Jacobian and (Q,) centre in coordinates over their spread."""
    rows, centres = [], []
    for name, prior in (priors or {}).items():
        name = parameters.full_name(name)
        if name not in parameters.names:
            raise ValueError(
                f"a prior is given for '{name}', which is not fitted; fitted are {', '.join(parameters.names)}."
            )
        row = np.eye(len(parameters))[parameters.names.index(name)] / prior.spread
        rows.append(row)
        centres.append(float(parameters.about_of(name).to_coordinate(prior.value)) / prior.spread)
    return np.array(rows).reshape(-1, len(parameters)), np.array(centres)


def _first_point(model: Model, evaluator: Evaluator, start, starts: int, seed: int) -> np.ndarray:
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 1:
        raise ValueError(f"starts = {starts!r}: must be a whole number >= 1.")
    if isinstance(start, Mapping):
        first = model.parameters.coordinates(start)
    elif start == "rule":
        first = start_by_rule(model.simulator, model.parameters, evaluator.targets)
    elif start == "test":
        first = model.parameters.coordinates()
    else:
        raise ValueError(f"start = {start!r}: must be 'rule', 'test' or values by name.")
    if starts == 1:
        return first
    low, high = model.parameters.limits()
    random = np.random.default_rng(seed).uniform(low, high, (starts - 1, len(low)))
    points = [first, *random]
    tried = evaluator.values(points)
    misfit = [np.sum(((one.prediction - evaluator.observed) / evaluator.sigma) ** 2) for one in tried]
    # A start whose run failed has no misfit, and is passed over.
    return points[int(np.nanargmin(misfit))] if np.isfinite(misfit).any() else first


class _Search:
    """One descent; keeps what is known at the accepted point."""

    def __init__(
        self, evaluator: Evaluator, prior_rows, jacobian: Jacobian, tolerance: float, max_runs: float,
        tell: Callable[[float, float], object],
    ):  # fmt: skip
        self.tell = tell
        self.evaluator, self.model = evaluator, evaluator.model
        self.parameters = evaluator.model.parameters
        self.priors = prior_rows
        self.kind, self.tolerance, self.max_runs = jacobian, tolerance, max_runs
        self.latest: dict[tuple, Evaluation] = {}
        self.kept: np.ndarray | None = None  # (M, P) of the last pass
        self.kept_misfit = np.inf  # the explainable part of the misfit at the last accepted point
        self.wanted = np.inf  # the step that the linear model still wants, in standard errors
        self.point: np.ndarray | None = None
        self.slopes: np.ndarray | None = None
        # Every target known with its own uncertainty, or only the proportion of the weights?
        self.sigma_known = all(getattr(target, "sigma_known", True) for target in evaluator.targets)

    def run(self, first: np.ndarray, by_rule: bool) -> str:
        from scipy.optimize import least_squares

        low, high = self.parameters.limits()
        try:
            if by_rule:
                first = self._by_rule(first)
            first = self._sound_start(np.clip(first, low, high))
            found = least_squares(
                self._residual,
                first,
                jac=self._jacobian,
                bounds=(low, high),
                method="trf",
                x_scale=1.0,
                xtol=0.1 * self.tolerance / np.sqrt(len(first)),
                ftol=1e-12,
                gtol=1e-12,
                max_nfev=200,
            )
        except _Stop as stop:
            return str(stop)
        if found.status <= 0:
            return "stopped: too many steps"
        if self.wanted < SCATTERED:
            return CONVERGED
        return (
            "stopped: no step lowers the misfit further, though the slopes ask for one of "
            f"{self.wanted:.2g} standard errors"
        )

    def _by_rule(self, first: np.ndarray) -> np.ndarray:
        """Single runs, each carried over to the data by similarity, until that asks for a last small move."""
        for _ in range(RULE_RUNS):
            tried = self._evaluate(first)
            better = corrected_by_run(self.evaluator, tried, self.priors)
            if better is None:
                break
            move, first = np.abs(better - first).max(), better
            if move < RULE_MOVE:
                break
        return first

    def _sound_start(self, first: np.ndarray) -> np.ndarray:
        """The start, moved towards the test's own parameters while its run fails, and at last the best that was run."""
        home = self.parameters.coordinates()
        for share in (0.0, 0.5, 0.8, 1.0):
            z = first + share * (home - first)
            tried = self._evaluate(z, first=True)
            if not tried.failed:
                return z
        if all(one.failed for one in self.evaluator.evaluations):
            raise RunFailed(f"no start gives a sound run, not even the test's own parameters: {tried.failed}.")
        z = best_evaluation(self.evaluator, self.priors).coordinates
        if self._evaluate(z, first=True).failed:
            raise _Stop(f"stopped: no start gives sound tangents, not even the test's own parameters: {tried.failed}")
        return z

    def _along(self) -> list[int]:
        """Places of the parameters whose tangents are run; the stretch gives the stiffness in the economical way."""
        names = self.parameters.names
        free = self.kind == "economical" and "normal_stiffness" in names
        return [p for p, name in enumerate(names) if not (free and name == "normal_stiffness")]

    def _evaluate(self, z, first: bool = False) -> Evaluation:
        key = tuple(np.asarray(z, float).tolist())
        if key in self.latest and not (first and self.latest[key].jacobian is None and self._along()):
            return self.latest[key]
        if self.model.cost.forward_equivalents >= self.max_runs:
            raise _Stop(f"stopped: {self.max_runs:g} runs are spent")
        self.tell(self.model.cost.forward_equivalents, self.max_runs)
        with_tangents = self._along() and (self.kind == "tangent" or (first and self.kind == "economical"))
        evaluation = self.evaluator.tangents(z, self._along()) if with_tangents else self.evaluator.value(z)
        self.latest[key] = evaluation
        return evaluation

    def _weighted(self, z, prediction) -> np.ndarray:
        return weighted_residual(self.evaluator, self.priors, z, prediction)

    def _weighted_slopes(self, slopes) -> np.ndarray:
        return np.concatenate([slopes / self.evaluator.sigma[:, None], self.priors[0]])

    def _residual(self, z) -> np.ndarray:
        # NaN at a trial point makes scipy shrink the step and try again, which is what a failed run deserves.
        return self._weighted(z, self._evaluate(z).prediction)

    def _assembled(self, evaluation: Evaluation) -> np.ndarray:
        """(M, P): fresh or kept tangents, the stretch in the stiffness column of the economical way."""
        names, along = self.parameters.names, self._along()
        slopes = np.zeros((evaluation.prediction.size, len(names)))
        if evaluation.jacobian is not None:
            slopes[:, along] = evaluation.jacobian
        elif along and self.kept is not None:
            slopes[:, along] = self.kept[:, along]
        if len(along) < len(names):
            column = names.index("normal_stiffness")
            slopes[:, column] = evaluation.stretch
            if "shear_stiffness" in names:  # the stretch moves both; kn alone is what is left
                slopes[:, column] -= slopes[:, names.index("shear_stiffness")]
        return slopes

    def _jacobian(self, z) -> np.ndarray:
        evaluation = self._evaluate(z)
        residual = self._weighted(z, evaluation.prediction)
        fresh = evaluation.jacobian is not None or not self._along()
        if self.kind == "difference":
            slopes, fresh = self._differences(z, evaluation), True
        else:
            slopes = self._assembled(evaluation)
        misfit = self._explainable(z, slopes, residual)
        if not fresh and misfit > GOOD_PROGRESS * self.kept_misfit:
            if self.wanted < SCATTERED:
                raise _Stop(CONVERGED)
            self.tell(self.model.cost.forward_equivalents, self.max_runs)
            evaluation = self.evaluator.tangents(z, self._along())
            self.latest[tuple(np.asarray(z).tolist())] = evaluation
            if not evaluation.failed:
                slopes, fresh = self._assembled(evaluation), True
                misfit = self._explainable(z, slopes, residual)
        if fresh:
            self.kept = slopes
        self.kept_misfit = misfit
        return self._weighted_slopes(slopes)

    def _explainable(self, z, slopes, residual) -> float:
        """The part of the misfit that the linear model can still remove at this accepted point. Raises _Stop where the
        Gauss-Newton step is below the tolerance or a tenth of a standard error in every coordinate."""
        self.point, self.slopes = np.array(z, float), slopes
        weighted = self._weighted_slopes(slopes)
        step, *_ = np.linalg.lstsq(weighted, -residual, rcond=1e-8)
        left = residual + weighted @ step
        covariance, *_ = uncertainty(self.parameters, left, weighted, self.sigma_known)
        error = np.sqrt(np.diag(covariance))
        self.wanted = float((np.abs(step) / error).max())
        if (np.abs(step) <= np.maximum(self.tolerance, 0.1 * error)).all():
            raise _Stop(CONVERGED)
        return float(residual @ residual - left @ left)

    def _differences(self, z, evaluation: Evaluation) -> np.ndarray:
        columns = []
        for p in range(len(self.parameters)):
            for h in (DIFFERENCE_STEP, -DIFFERENCE_STEP):
                moved = self._evaluate(z + h * np.eye(len(z))[p])
                if not moved.failed:
                    break
            columns.append((moved.prediction - evaluation.prediction) / h)
        return np.nan_to_num(np.stack(columns, axis=1))

    def result(self, start: np.ndarray, status: str) -> Fit:
        notes: tuple[str, ...] = ()
        if self.kind != "difference" and self._along() and self.model.cost.tangent_cost > 0.7:
            notes = (
                f"a tangent costs {self.model.cost.tangent_cost:.2g} runs here; on smooth runs jacobian='difference' "
                "is no dearer, what a tangent buys is that scatter between runs does not spoil it.",
            )
        return concluded(
            self.evaluator, status, self._slopes_at, start=start, last=self.point, prior_rows=self.priors,
            sigma_known=self.sigma_known, tolerance=self.tolerance, notes=notes,
        )  # fmt: skip

    def _slopes_at(self, evaluation: Evaluation) -> np.ndarray | None:
        """The Jacobian at the point where the search came to rest, and what is nearest to it elsewhere."""
        if self.kind == "difference" or (self.point is not None and np.array_equal(evaluation.coordinates, self.point)):
            return self.slopes
        if self._along() and evaluation.jacobian is None and self.kept is None:
            return None
        return self._assembled(evaluation)
