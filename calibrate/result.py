"""What a fit returns: estimates with standard errors, what the data cannot tell, and a picture of the comparison."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from axijax.core.files import write_whole
from axijax.core.palette import COLOURS
from axijax.core.shown import Card, shown
from calibrate.evaluate import Evaluation
from calibrate.measured import MeasuredCurve
from calibrate.model import Cost
from calibrate.parameters import ParameterSet

ACCURACY = 1e-3  # relative, of a simulated curve; see `of_the_simulator`
FITTED, PREDICTED = COLOURS[:2]
UNKNOWN = 1.0  # standard error of a log (or logit) from which a parameter counts as not identified: a factor e
RESOLVED = 1e-8  # standard error of a log (or logit) below which it is rounding, as of data that a run made itself
ENTANGLED = 0.98  # correlation from which two parameters count as not told apart


@shown
@dataclass(frozen=True)
class Fit:
    """Result of a fit of P parameters to M numbers.

    estimate: {name: value}. standard_error: {name: in the value's unit}, linear in the value; interval: {name: (low,
    high)} of one standard error, made in the log or logit and so always physical. Both are NaN where they would mean
    nothing: the fit has not converged, the data do not identify the parameter, or it is below rounding.
    coordinates: (P,). covariance: (P, P) of the coordinates; correlation: (P, P).
    prediction, observed, sigma: (M,) of the targets behind one another; band: (M,) standard error of the prediction
    that the parameters' covariance makes, NaN where the fit has not converged.
    jacobian: (M, P) in coordinates; where tangents are reused it is that of the last pass.
    scatter: root mean square of (prediction - observed)/sigma over the degrees of freedom [-], NaN without any.
    status: "converged", "not converged: .." where there is a doubt (see `calibrate.verdict`), or "stopped: ..".
    warnings: sentences on these doubts, identifiability and limits.
    cost: runs, tangent passes and forward equivalents; failed_runs: those rejected.
    evaluations: every one made, in order.
    """

    parameters: ParameterSet
    coordinates: np.ndarray
    covariance: np.ndarray
    jacobian: np.ndarray
    prediction: np.ndarray
    observed: np.ndarray
    sigma: np.ndarray
    scatter: float
    status: str
    warnings: tuple[str, ...]
    targets: tuple
    cost: Cost
    failed_runs: int = 0
    notes: tuple[str, ...] = ()
    evaluations: tuple[Evaluation, ...] = ()

    @property
    def converged(self) -> bool:
        return self.status == "converged"

    @property
    def estimate(self) -> Mapping[str, float]:
        return self.parameters.values(self.coordinates)

    @property
    def _spread(self) -> np.ndarray:
        """(P,) standard errors of the coordinates, NaN where one would mean nothing."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.where(self.converged & (spread > RESOLVED) & (spread <= UNKNOWN), spread, np.nan)

    @property
    def standard_error(self) -> Mapping[str, float]:
        rows = zip(self.estimate.items(), self.parameters.about, self._spread, strict=True)
        return {name: float(s * about.coordinate_rate(value)) for (name, value), about, s in rows}

    @property
    def interval(self) -> Mapping[str, tuple[float, float]]:
        rows = zip(self.parameters.names, self.parameters.about, self.coordinates, self._spread, strict=True)
        return {n: (float(each.from_coordinate(z - s)), float(each.from_coordinate(z + s))) for n, each, z, s in rows}

    def _no_error(self, place: int) -> str:
        """Why a parameter has no standard error."""
        if not self.converged:
            return "the fit has not converged"
        return "not identified by these data" if self.covariance[place, place] > UNKNOWN**2 else "below rounding"

    @property
    def correlation(self) -> np.ndarray:
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        spread = np.where(spread > 0, spread, 1.0)
        return self.covariance / np.outer(spread, spread)

    @property
    def band(self) -> np.ndarray:
        variance = np.einsum("mp,pq,mq->m", self.jacobian, self.covariance, self.jacobian)
        return np.sqrt(np.maximum(variance, 0.0)) if self.converged else np.full(self.observed.size, np.nan)

    def doubted(self, words: str, sentence: str) -> "Fit":
        """The same result, no longer converged for a reason found afterwards, with a warning that says so."""
        status = f"not converged: {words}" if self.converged else self.status
        return replace(self, status=status, warnings=(*self.warnings, sentence))

    def _card(self) -> Card:
        found = {}
        for place, (name, value) in enumerate(self.estimate.items()):
            error, (low, high) = self.standard_error[name], self.interval[name]
            found[name] = f"{value:.6g}"
            found[name] += (
                f" (no standard error: {self._no_error(place)})"
                if np.isnan(error)
                else f" +- {error:.2g} (one standard error: {low:.6g} to {high:.6g})"
            )
        rows = {"status": self.status, **found, "scatter [-]": f"{self.scatter:.3g}"}
        rows |= {"cost": f"{self.cost.forward_equivalents:.1f} runs", "warnings": "; ".join(self.warnings) or "none"}
        return Card("Fit", rows, brief=("status", *found))

    def __str__(self) -> str:
        rows = [f"fit {self.status}"]
        if not np.isnan(self.scatter):
            rows[0] += f"; scatter {self.scatter:.3g} of the stated uncertainty"
        for place, (name, value) in enumerate(self.estimate.items()):
            (low, high), error = self.interval[name], self.standard_error[name]
            rows.append(
                f"  {name} = {value:.6g}   (no standard error: {self._no_error(place)})"
                if np.isnan(error)
                else f"  {name} = {value:.6g} +- {error:.2g}   (one standard error: {low:.6g} to {high:.6g})"
            )
        names = self.parameters.names
        for i in range(len(names) if self.converged else 0):
            for j in range(i):
                rows.append(f"  correlation of {names[j]} and {names[i]}: {self.correlation[i, j]:+.3f}")
        rows.append(
            f"  cost: {self.cost.runs} runs and {self.cost.passes} passes with {self.cost.tangents} tangents = "
            f"{self.cost.forward_equivalents:.1f} runs, {self.failed_runs} failed"
        )
        rows += [f"  warning: {text}" for text in self.warnings]
        rows += [f"  note: {text}" for text in self.notes]
        return "\n".join(rows)

    def save(self, path) -> Path:
        """Write everything but the targets as JSON, null for what is not known; returns the path."""
        told = {
            "status": self.status,
            "estimate": dict(self.estimate),
            "standard_error": dict(self.standard_error),
            "interval_one_standard_error": dict(self.interval),
            "correlation": self.correlation.tolist(),
            "scatter": self.scatter,
            "observed": self.observed.tolist(),
            "prediction": self.prediction.tolist(),
            "band_one_sigma": self.band.tolist(),
            "runs": self.cost.runs,
            "passes": self.cost.passes,
            "tangents": self.cost.tangents,
            "forward_equivalents": self.cost.forward_equivalents,
            "failed_runs": self.failed_runs,
            "data": [{"source": target.source} | _facts(target) for target in self.targets],
            "warnings": list(self.warnings),
            "notes": list(self.notes),
        }
        text = json.dumps(_without_nan(told), indent=2, allow_nan=False) + "\n"
        write_whole(Path(path), lambda target: target.write_text(text))
        return Path(path)

    def draw(self, path) -> Path:
        """Write a picture of predicted against observed with the 2-sigma band of the prediction; returns the path."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        path = Path(path)
        panels = [panel for target, at in self._places() for panel in _panels(target, at)]
        figure = Figure(figsize=(5.2 * len(panels), 4.2), layout="constrained")
        FigureCanvasAgg(figure)
        for axes, (label, x, at, xlabel) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
            predicted, band = self.prediction[at], 2 * self.band[at]
            if x is None:
                axes.errorbar(
                    [0], self.observed[at], 2 * self.sigma[at], fmt="ko", capsize=4, label="measured, 2 sigma"
                )
                axes.errorbar([0.3], predicted, band, fmt="s", color=FITTED, capsize=4, label="fitted, 2 sigma")
                axes.set(xlim=(-0.5, 0.8), xticks=[], ylabel=label)
            else:
                axes.plot(x, self.observed[at], "k.", ms=4, label="measured")
                axes.plot(x, predicted, color=FITTED, label="fitted")
                axes.fill_between(
                    x, predicted - band, predicted + band, color=FITTED, alpha=0.25, label="2 sigma of the fit"
                )
                axes.set(xlabel=xlabel, ylabel=label)
            axes.legend(frameon=False, fontsize=9)
        errors = {n: "" if np.isnan(e) else f" $\\pm$ {e:.1g}" for n, e in self.standard_error.items()}
        title = ", ".join(f"{n} = {v:.4g}{errors[n]}" for n, v in self.estimate.items())
        figure.suptitle(title, fontsize="medium")
        write_whole(path, lambda target: figure.savefig(target, dpi=150))
        return path

    def _places(self):
        start = 0
        for target in self.targets:
            stop = start + target.observed.size
            yield target, slice(start, stop)
            start = stop


def _facts(target) -> dict:
    """What the file of a measured curve says beside its columns."""
    return target.facts.as_dict() if isinstance(target, MeasuredCurve) else {}


def _without_nan(value):
    """The same with None for every number that is not finite, which JSON has no word for."""
    if isinstance(value, dict):
        return {name: _without_nan(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _panels(target, at: slice):
    if not isinstance(target, MeasuredCurve):
        return [(target.label, None, at, "")]
    x, count = 100 * target.axial_strain, len(target)
    panels = [("stress ratio R [-]", x, slice(at.start, at.start + count), "axial strain [%]")]
    if target.volumetric_strain is not None:
        panels.append(
            ("volumetric strain [-]\n(compression positive)", x, slice(at.start + count, at.stop), "axial strain [%]")
        )
    return panels


def of_the_simulator(prediction, stretch, sigma, weighted_jacobian) -> np.ndarray:
    """(P, P) covariance of the coordinates that the simulator's own accuracy makes, however good the data are.

    What loading speed, time step and confinement leave of a lattice's curve at the default settings is 0.1 % (guide,
    limits), the same way along the whole curve: of its height, as (M,) `prediction`, and of its strains, as the
    (M,) derivative `stretch` to the logarithm of the strain. A fit takes it for parameters: step by step as the (M',
    P) Jacobian over the (M,) `sigma` says.
    """
    made = np.zeros((weighted_jacobian.shape[1],) * 2)
    for shift in (prediction, np.nan_to_num(stretch)):
        rows = np.zeros(len(weighted_jacobian))
        rows[: len(sigma)] = ACCURACY * shift / sigma
        step, *_ = np.linalg.lstsq(weighted_jacobian, rows, rcond=1e-8)
        made += np.outer(step, step)
    return made


def uncertainty(parameters: ParameterSet, residual, weighted_jacobian, sigma_known: bool):
    """(covariance (P, P), scatter, warnings) from the (M',) residual and its (M', P) Jacobian, priors among the rows.

    The covariance is that of a linear model, s^2 (J^T J)^-1, with s = 1 where the uncertainties are known and else the
    scatter of the residuals. Directions that no number feels get a variance of 1e6 instead of a division by zero.
    """
    _, values, right = np.linalg.svd(weighted_jacobian, full_matrices=False)
    freedom = residual.size - len(parameters)
    scatter = float(np.sqrt(residual @ residual / freedom)) if freedom > 0 else float("nan")
    size = 1.0 if sigma_known or freedom <= 0 else scatter
    # A tiny scatter (data made by the program itself) must not hide a direction that nothing feels.
    felt = values > 1e-8 * max(values[0], 1e-300)
    variance = np.where(felt, (size / np.where(felt, values, 1.0)) ** 2, 1e6)
    covariance = (right.T * np.minimum(variance, 1e6)) @ right
    spread = np.sqrt(np.diag(covariance))
    warnings = []
    for name, error in zip(parameters.names, spread, strict=True):
        if error > UNKNOWN:
            warnings.append(
                f"{name} is not identified by these data: its standard error is a factor {np.exp(min(error, 14)):.3g} "
                "either way; add data that feel it (stiffness shows in the curve before the peak, not in the peak), "
                "fix it, or give a prior."
            )
    correlation = covariance / np.outer(spread, spread)
    for i in range(len(parameters)):
        for j in range(i):
            if abs(correlation[i, j]) > ENTANGLED:
                warnings.append(
                    f"{parameters.names[j]} and {parameters.names[i]} are not told apart (correlation "
                    f"{correlation[i, j]:+.3f}): only a combination of them is known; fix one or add data."
                )
    return covariance, scatter, tuple(warnings)
