"""Residuals of a model against targets, every evaluation logged to a file and never paid for twice.

The log is JSON lines: a header that says what is fitted to what, then one line an evaluation. Numbers are written so
that they read back exactly; a fit that is started again with the same log walks through it without a run.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from calibrate.model import FIELDS, Cost, Model, RunFailed, jacobian_of, stretch_tangent


@dataclass(frozen=True)
class Evaluation:
    """One point of a fit; M numbers, P parameters, tangents along D of them.

    coordinates: (P,). prediction: (M,), NaN for a failed run. jacobian: (M, D) in coordinates, or None.
    stretch: (M,) derivative to log kn at fixed ks/kn by the strain stretch. curve: the run's fields, None where it
    failed. failed: why, or None. replayed: read from the log, nothing was run.
    """

    coordinates: np.ndarray
    prediction: np.ndarray
    jacobian: np.ndarray | None
    stretch: np.ndarray
    curve: SimpleNamespace | None
    failed: str | None = None
    replayed: bool = False


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
        reach = getattr(model.simulator, "axial_strain", None)
        for target in self.targets:
            if reach is not None and target.last_strain > reach:
                raise ValueError(
                    f"'{target.label}' goes to strain {target.last_strain:g}, but the test stops at axial_strain = "
                    f"{reach:g}: run it farther, or cut the data."
                )
        self.observed = np.concatenate([target.observed for target in self.targets])
        self.sigma = np.concatenate([target.sigma for target in self.targets])
        self.evaluations: list[Evaluation] = []
        self._path = None if log is None else Path(log)
        self._known: dict[tuple, dict] = {}
        if self._path is not None:
            self._open(self._path)

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
        from axijax.batch import parallel

        points = [np.asarray(z, float) for z in points]
        found: dict[int, Evaluation] = {}

        def run(number):
            known = (tuple(points[number].tolist()), ()) in self._known
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
        key = (tuple(z.tolist()), along)
        found = self._known.get(key)
        result = self._restored(z, found) if found else self._fresh(z, along, curve)
        self.evaluations.append(result)
        return result

    def _fresh(self, z, along, curve) -> Evaluation:
        """curve: of a run made before, or the RunFailed that it ended with."""
        start = time.perf_counter()
        slopes, failed, kept = None, None, None
        nothing = np.full(self.observed.size, np.nan)
        try:
            if along:
                curve, tangents = self.model.run_with_tangents(z, np.eye(len(z))[list(along)])
                slopes = np.concatenate([jacobian_of(target, curve, tangents)[1] for target in self.targets])
            else:
                curve = self.model.run(z) if curve is None else curve
                if isinstance(curve, RunFailed):
                    raise curve
            prediction = self.predict(curve)
            one = stretch_tangent(curve)
            stretch = np.concatenate([jacobian_of(target, curve, one)[1][:, 0] for target in self.targets])
            kept = SimpleNamespace(**{name: getattr(curve, name) for name in FIELDS if hasattr(curve, name)})
            if not np.isfinite(prediction).all():
                failed = "a target is not finite: the run does not reach its strain"
            elif slopes is not None and not np.isfinite(slopes).all():
                failed = "a tangent is not finite; look at the gradient's health"
        except RunFailed as error:
            failed = str(error)
        if failed:
            prediction, slopes, stretch, kept = nothing, None, nothing, None
        result = Evaluation(z, prediction, slopes, stretch, kept, failed)
        self._write(result, along, time.perf_counter() - start)
        return result

    def _header(self) -> dict:
        parameters = self.model.parameters
        return {
            "kind": "header",
            "names": list(parameters.names),
            "reference": dict(parameters.reference),
            "simulator": str(getattr(self.model.simulator, "protocol", type(self.model.simulator).__name__)),
            "targets": [target.label for target in self.targets],
            "observed": self.observed.tolist(),
            "sigma": self.sigma.tolist(),
        }

    def _open(self, path: Path) -> None:
        header = self._header()
        if not path.exists() or not path.read_text().strip():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(header) + "\n")
            return
        for number, line in enumerate(path.read_text().splitlines()):
            try:
                entry = json.loads(line)
            except json.JSONDecodeError:
                continue  # a line cut short when the program was stopped
            if number == 0:
                different = [name for name in header if entry.get(name) != header[name]]
                if different:
                    raise ValueError(
                        f"log {path} belongs to another fit (its {', '.join(different)} differ); name another "
                        "file or delete it."
                    )
            elif not entry["failed"] or "status" in entry["failed"] or "finite" in entry["failed"]:
                self._known[tuple(entry["z"]), tuple(entry["along"])] = entry

    def _write(self, result: Evaluation, along, seconds: float) -> None:
        if self._path is None:
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
        if not result.failed:
            entry |= {
                "prediction": result.prediction.tolist(),
                "jacobian": None if result.jacobian is None else result.jacobian.tolist(),
                "stretch": result.stretch.tolist(),
                "curve": {name: values.tolist() for name, values in vars(result.curve).items()},
            }
        with self._path.open("a") as file:
            file.write(json.dumps(entry) + "\n")

    def _restored(self, z, entry) -> Evaluation:
        if entry["failed"]:
            nothing = np.full(self.observed.size, np.nan)
            return Evaluation(z, nothing, None, nothing, None, entry["failed"], True)
        slopes = None if entry["jacobian"] is None else np.array(entry["jacobian"])
        return Evaluation(
            z,
            np.array(entry["prediction"]),
            slopes,
            np.array(entry["stretch"]),
            SimpleNamespace(**{name: np.array(values) for name, values in entry["curve"].items()}),
            None,
            True,
        )
