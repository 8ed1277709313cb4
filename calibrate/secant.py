"""One parameter from one number, by the secant: no tangent, because none pays.

A pass with a tangent costs more than the run that gives the secant its slope, and a start by rule is close already.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibrate.evaluate import Evaluator
from calibrate.measured import ROWE
from calibrate.model import Model, RunFailed
from calibrate.parameters import ParameterSet
from calibrate.result import Fit
from calibrate.start import start_by_rule
from calibrate.targets import Datum
from calibrate.verdict import CONVERGED, concluded


def fit_one(
    simulator,
    datum,
    name: str = "friction",
    *,
    start: float | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    tolerance: float | None = None,
    max_runs: int = 12,
    log: str | Path | None = None,
) -> Fit:
    """Fit one parameter to one number by the secant: about three or four runs and no tangent.

    datum: the target. start: physical value; for friction by default Thornton's inverse of the datum, and the second
    run takes the slope of his formula. tolerance: of the number, in its unit, by default a fiftieth of its uncertainty.
    The rest as in `fit_parameters`. Raises ValueError for a target of several numbers, RunFailed where the first run is
    not sound.
    """
    model = (
        simulator
        if isinstance(simulator, Model)
        else Model(simulator, ParameterSet.of(simulator.params, [name], bounds))
    )
    parameters = model.parameters
    if len(parameters) != 1:
        raise ValueError(
            f"{len(parameters)} parameters ({', '.join(parameters.names)}): a secant fits one; use fit_parameters."
        )
    if datum.observed.size != 1:
        raise ValueError(
            f"'{datum.label}' holds {datum.observed.size} numbers: a secant fits one number; use fit_parameters."
        )
    evaluator = Evaluator(model, datum, log)
    name = parameters.names[0]
    goal = 0.02 * float(datum.sigma[0]) if tolerance is None else tolerance
    low, high = parameters.limits()
    z = (
        start_by_rule(simulator, parameters, evaluator.targets)
        if start is None
        else parameters.coordinates({name: start})
    )
    tried = evaluator.value(z)
    if tried.failed:
        raise RunFailed(f"the first run, {name} = {parameters.values(z)[name]:g}, failed: {tried.failed}.")
    error = float(tried.prediction[0] - datum.observed[0])
    value = parameters.values(z)[name]
    # The slope before there is a secant: Thornton's 4/(1-f)^2 for friction; else a guess that only sets a first step of
    # 5 %.
    rate = float(parameters.about_of(name).coordinate_rate(value))
    slope = 4 / (1 - value) ** 2 * rate if name == "friction" else None
    points, status = [(float(z[0]), error, tried)], "stopped: too many runs"
    while True:
        if abs(error) <= goal and slope is not None and len(points) > 1:
            status = CONVERGED
            break
        if len(evaluator.evaluations) >= max_runs:
            break
        move = -error / slope if slope else 0.05
        # Near the answer the step is kept large enough for its secant to be a slope and not rounding.
        move = float(np.clip(move, -1.0, 1.0))
        if len(points) == 1 and abs(move) < 0.01:
            move = np.copysign(0.01, move)
        nearest = min(points, key=lambda point: abs(point[1]))
        at = float(np.clip(nearest[0] + move, low[0], high[0]))
        tried = evaluator.value(np.array([at]))
        for _ in range(4):
            if not tried.failed:
                break
            at = 0.5 * (at + nearest[0])  # a failed run: half the step
            tried = evaluator.value(np.array([at]))
        if tried.failed or at == nearest[0]:
            status = "stopped: the runs fail" if tried.failed else f"stopped: {name} is at its bound"
            break
        error = float(tried.prediction[0] - datum.observed[0])
        points.append((at, error, tried))
        (za, ea, _), (zb, eb, _) = sorted(points, key=lambda point: abs(point[1]))[:2]
        if zb != za and ea != eb:
            slope = (eb - ea) / (zb - za)
        error = ea
    # A slope that is not known says nothing, and its standard error is told to be unknown.
    jacobian = np.array([[slope if slope else 0.0]])
    return concluded(evaluator, status, lambda best: jacobian, start=z, sigma_known=True)


def fit_friction_to_peak(test, datum: Datum | None = None, **options) -> Fit:
    """Friction from a measured peak, by default Rowe's 2.4 +- 0.05; `options` as in fit_one.

    test: a TriaxialTest that runs past its peak (0.5 % strain for the paper's specimen). Raises what fit_one raises.
    """
    return fit_one(test, ROWE.datum() if datum is None else datum, "friction", **options)
