"""Residuals of a model against targets, every evaluation logged to a file and never paid for twice.

A fit that is started again with the same log (see `calibrate.log`) walks through it without a run.
"""

import time
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from axijax.core.fingerprint import fingerprint, versions
from calibrate.log import FitLog, curve_entry, curve_of_entry
from calibrate.model import Cost, Model, RunFailed, jacobian_of, stretch_tangent


@dataclass(frozen=True)
class Evaluation:
    """One point of a fit; M numbers, P parameters, tangents along D of them.

    coordinates: (P,). prediction: (M,), NaN for a failed run. jacobian: (M, D) in coordinates, or None.
    stretch: (M,) derivative to log kn at fixed ks/kn by the strain stretch. curve: the run's fields, None where it
    failed. failed: why, or None. replayed: read from the log, nothing was run.
    largest_tangent: largest |dR/dz| of the pass over its records, zero without one [-].
    """

    coordinates: np.ndarray
    prediction: np.ndarray
    jacobian: np.ndarray | None
    stretch: np.ndarray
    curve: SimpleNamespace | None
    failed: str | None = None
    replayed: bool = False
    largest_tangent: float = 0.0


def half_rise_strain(strain, ratio) -> float:
    """Strain at which R has risen halfway from 1 to its peak [-]; where it scatters, the mean of first and last
    crossing."""
    top = int(np.argmax(ratio))
    level = 1 + 0.5 * (ratio[top] - 1)
    above = np.flatnonzero(ratio[: top + 1] >= level)
    below = np.flatnonzero(ratio[: top + 1] < level)
    if top == 0 or below.size == 0:
        return float(strain[top])

    def crossing(k):
        if k == 0:  # the data begin above the level: a line from R = 1 at no strain
            return strain[0] * (level - 1) / (ratio[0] - 1)
        return strain[k - 1] + (strain[k] - strain[k - 1]) * (level - ratio[k - 1]) / (ratio[k] - ratio[k - 1])

    return float(0.5 * (crossing(above[0]) + crossing(min(below[-1] + 1, top))))


class Evaluator:
    """Runs a model and compares it with targets.

    model: of P parameters. targets: Datum and MeasuredCurve objects; their numbers are put in one row, M in all.
    log: path of the evaluation log, continued where it exists.

    Raises ValueError for no target, limits beyond the test's time step (Model.check_stiffest), a target beyond the
    run's last strain, fewer numbers than parameters (`check_count`), or a log that belongs to another fit.
    """

    def __init__(self, model: Model, targets, log=None):
        self.model = model
        model.check_stiffest()
        model.cost = Cost(tangent_cost=model.cost.tangent_cost)  # each fit counts its own runs
        self.targets = list(targets) if isinstance(targets, list | tuple) else [targets]
        if not self.targets:
            raise ValueError("targets is empty: give at least one Datum or MeasuredCurve.")
        # A test in stages goes where these lead.
        staged = bool(getattr(model.simulator, "stages", ()))
        reach = None if staged else getattr(model.simulator, "axial_strain", None)
        for target in self.targets:
            if getattr(target, "places", None) is not None and getattr(model.simulator, "stages", None) == ():
                turn = int(np.argmax(target.places.branch > 0)) - 1
                raise ValueError(
                    f"'{target.label}' turns back at strain {target.axial_strain[turn]:g}, but the test has no stages: "
                    "give it those of the data (stages=curve.stages(), or [[stage]] in its case file)."
                )
            if reach is not None and target.last_strain > reach:
                raise ValueError(
                    f"'{target.label}' goes to strain {target.last_strain:g}, but the test stops at axial_strain = "
                    f"{reach:g}: run it farther, or cut the data."
                )
        self.observed = np.concatenate([target.observed for target in self.targets])
        self.sigma = np.concatenate([target.sigma for target in self.targets])
        self.evaluations: list[Evaluation] = []
        self._log = None if log is None else FitLog(log, self._identity())

    def check_count(self, extra: int = 0) -> None:
        """Raise ValueError where there are fewer numbers (with `extra` priors) than parameters."""
        count, wanted = self.observed.size + extra, len(self.model.parameters)
        if count < wanted:
            names = ", ".join(self.model.parameters.names)
            raise ValueError(
                f"{self.observed.size} measured number(s) for {wanted} parameters ({names}): cannot tell them apart; "
                f"fit at most {max(count, 1)}, add a prior, or measure more (a whole curve)."
            )

    def predict(self, curve) -> np.ndarray:
        """(M,) numbers that a curve gives for the targets."""
        return np.concatenate([np.asarray(target.predict(curve)) for target in self.targets])

    def value(self, z) -> Evaluation:
        """One run."""
        return self._evaluate(np.asarray(z, float), ())

    def values(self, points) -> list[Evaluation]:
        """One run each, several cores at a time, logged as they come; a run that fails leaves the others alone."""
        from axijax.core.parallel import parallel

        points = [np.asarray(z, float) for z in points]
        found: dict[int, Evaluation] = {}

        def run(number):
            known = self._log is not None and (tuple(points[number].tolist()), ()) in self._log.known
            return None if known else self.model.run(points[number])

        def finished(place, curve):
            if isinstance(curve, Exception) and not isinstance(curve, RunFailed):
                raise curve
            found[numbers[place]] = self._evaluate(points[numbers[place]], (), curve)

        numbers = [0]  # the first by itself: it compiles
        parallel(run, numbers, finished=finished)
        numbers = list(range(1, len(points)))
        parallel(run, numbers, finished=finished)
        return [found[number] for number in range(len(points))]

    def tangents(self, z, along) -> Evaluation:
        """Value and tangents along the parameters of these places in the set, in one pass."""
        return self._evaluate(np.asarray(z, float), tuple(along))

    def _evaluate(self, z, along, curve=None) -> Evaluation:
        found = None if self._log is None else self._log.known.get((tuple(z.tolist()), along))
        result = self._restored(z, found) if found else self._fresh(z, along, curve)
        self.evaluations.append(result)
        return result

    def _fresh(self, z, along, curve) -> Evaluation:
        """curve: of a run made before, or the RunFailed that it ended with."""
        start = time.perf_counter()
        tangents = None
        try:
            if along:
                curve, tangents = self.model.run_with_tangents(z, np.eye(len(z))[list(along)])
            else:
                curve = self.model.run(z) if curve is None else curve
                if isinstance(curve, RunFailed):
                    raise curve
            result = self._compared(z, curve, tangents)
        except RunFailed as error:
            result = self._failure(z, str(error))
        self._write(result, along, tangents, time.perf_counter() - start)
        return result

    def _compared(self, z, curve, tangents, replayed: bool = False) -> Evaluation:
        """A curve and the tangents of D directions, or None, against the targets."""
        # The same numbers, of the same type, whether they come from a run or from the log.
        curve = curve_of_entry(curve_entry(curve))
        slopes, largest = None, 0.0
        prediction = self.predict(curve)
        if not np.isfinite(prediction).all():
            return self._failure(z, "a target is not finite: the run does not reach its strain", replayed)
        if tangents is not None:
            tangents = curve_of_entry(curve_entry(tangents))
            slopes = np.concatenate([jacobian_of(target, curve, tangents)[1] for target in self.targets])
            largest = largest_tangent(tangents)
            if not np.isfinite(slopes).all():
                return self._failure(z, "a tangent is not finite; look at the gradient's health", replayed)
        one = stretch_tangent(curve)
        stretch = np.concatenate([jacobian_of(target, curve, one)[1][:, 0] for target in self.targets])
        return Evaluation(z, prediction, slopes, stretch, curve, None, replayed, largest)

    def _failure(self, z, why: str, replayed: bool = False) -> Evaluation:
        nothing = np.full(self.observed.size, np.nan)
        return Evaluation(z, nothing, None, nothing, None, why, replayed)

    def _identity(self) -> dict[str, str]:
        """All that decides what an evaluation gives, and the data; where the data were read from does not."""
        model, parts = self.model, versions()
        parts |= fingerprint(model.simulator)
        parts |= fingerprint({"names": model.parameters.names, "hold_time_step": model.hold_time_step}, "fit")
        for number, target in enumerate(self.targets, 1):
            name = "data" if len(self.targets) == 1 else f"data.{number}"
            parts |= {n: part for n, part in fingerprint(target, name).items() if n != f"{name}.source"}
        return parts

    def _write(self, result: Evaluation, along, tangents, seconds: float) -> None:
        if self._log is None:
            return
        residual = (result.prediction - self.observed) / self.sigma
        entry = {
            "kind": "tangents" if along else "value",
            "values": self.model.parameters.values(result.coordinates),
            "chi2": None if result.failed else float(residual @ residual),
            "failed": result.failed,
            "seconds": round(seconds, 3),
            "z": result.coordinates.tolist(),
            "along": list(along),
        }
        if result.curve is not None:
            entry["curve"] = curve_entry(result.curve)
            entry["tangents"] = None if tangents is None else curve_entry(tangents)
        self._log.write(entry)

    def _restored(self, z, entry) -> Evaluation:
        if entry["failed"]:
            return self._failure(z, entry["failed"], replayed=True)
        tangents = None if entry["tangents"] is None else curve_of_entry(entry["tangents"])
        return self._compared(z, curve_of_entry(entry["curve"]), tangents, replayed=True)


def largest_tangent(tangents) -> float:
    """Largest |dR/dz| over the records, the root sum of squares of the directions' (D, T) tangents; inf where one is
    not finite [-]."""
    slopes = np.nan_to_num(tangents.stress_ratio, nan=np.inf, posinf=np.inf, neginf=np.inf)
    with np.errstate(over="ignore"):
        return float(np.sqrt((slopes**2).sum(axis=0)).max())
