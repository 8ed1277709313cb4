"""A measured file in, a calibrated test out: what `axijax calibrate DATA.csv` calls."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from axijax.core.bars import telling
from axijax.core.files import draw_afterwards
from calibrate.fit import Progress, fit_parameters
from calibrate.gradients import Health, gradient
from calibrate.measured import DataError, MeasuredCurve, read_measured
from calibrate.model import Model
from calibrate.output import claim
from calibrate.parameters import ParameterSet, Prior
from calibrate.result import Fit
from calibrate.targets import WindowMean


def calibrate_file(
    data,
    names: Sequence[str] | str,
    test,
    output,
    *,
    check: bool = True,
    report=print,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    start: Mapping[str, float] | Literal["rule", "test"] = "rule",
    priors: Mapping[str, Prior] | None = None,
    max_runs: float = 60,
    progress: Progress = False,
    **reading,
) -> Fit:
    """Fit named parameters of a test to a measured curve in a CSV file, and write everything to a folder.

    data: path of the CSV file, or a curve read before; names: list of names or aliases, or one string with commas;
    test: a TriaxialTest, whose parameters are the reference for whatever is not fitted and whose axial_strain the data
    must not exceed. output: folder for fit.json, fit.png and evaluations.jsonl (an interrupted fit resumes from it).
    check: end with the health of the gradient at the answer (six runs a parameter).
    report: called with each line of text. bounds, start, priors, max_runs, progress: of fit_parameters. reading: of
    read_measured, such as columns={"axial_strain": "[%]"}.

    Raises DataError for data that cannot be used, ValueError for names and strains that make no sense, RunFailed where
    no start gives a sound run. Warns of data that look wrong; the warnings stand in the fit and in fit.json too.
    """
    curve = data if isinstance(data, MeasuredCurve) else read_measured(data, **reading)
    if not getattr(test, "stages", ()):
        check_reach(curve, test.axial_strain)
    file = _file(curve)
    volume = curve.volumetric_strain
    changed = "none" if volume is None else f"{100 * volume.min():.4g} to {100 * volume.max():.4g} %"
    report(
        f"read {len(curve)} rows: axial strain {100 * curve.axial_strain[0]:.4g} to {100 * curve.last_strain:.4g} %, "
        f"{_turning(curve)}"
        f"stress ratio {curve.stress_ratio.min():.4g} to {curve.stress_ratio.max():.4g}, volumetric strain {changed}"
    )
    if str(curve.facts):
        report(f"the file says: {curve.facts}")
    model = Model(test, ParameterSet.of(test.params, names, bounds))
    looked_wrong = curve.warnings + _other_confining_stress(curve, model, file)
    output = Path(output)
    output.mkdir(parents=True, exist_ok=True)
    claim(output)
    log = output / "evaluations.jsonl"
    found = fit_parameters(
        model, curve, names, start=start, priors=priors, max_runs=max_runs, log=log,
        progress=progress,
    )  # fmt: skip
    found = replace(found, warnings=looked_wrong + found.warnings)
    found.save(output / "fit.json")
    report(str(found))
    problem = draw_afterwards("fit.png", lambda: found.draw(output / "fit.png"))
    if problem is not None:
        report(f"warning: {problem}")
    before = len(found.warnings)
    if check:
        stop = curve.last_strain
        window = WindowMean(0.5 * stop, stop) if curve.places is None else curve
        with telling(bool(progress)) as tell:
            tell("health of the gradient")
            slopes = gradient(model, window, values=found.estimate, steps=(1e-3, 1e-4))
        report(f"gradient of the {getattr(window, 'name', curve.label)} at the answer")
        report(str(slopes))
        found = _with_health(found, slopes.health)
        if found.warnings[before:]:
            found.save(output / "fit.json")
            report(f"fit {found.status}")
        for sentence in found.warnings[before:]:
            report(f"  warning: {sentence}")
    report(f"written: {output / 'fit.json'}, {output / 'fit.png'}, {output / 'evaluations.jsonl'}")
    return found


def check_reach(curve: MeasuredCurve, axial_strain: float) -> None:
    """Raise DataError where a test stops before the data do."""
    if curve.last_strain > axial_strain:
        raise DataError(
            f"{_file(curve)}: '{curve.label}' goes to strain {curve.last_strain:g}, but the test stops at "
            f"axial_strain = {axial_strain:g}: run it farther, or cut the data; if the strains of the file are in "
            "percent, write [%] behind the name of their column."
        )


def _turning(curve: MeasuredCurve) -> str:
    return "" if curve.places is None else f"turning back {int(curve.places.branch.max())} time(s), "


def _file(curve: MeasuredCurve) -> str:
    return Path(curve.source).name or "the measured curve"


def _other_confining_stress(curve: MeasuredCurve, model: Model, file: str) -> tuple[str, ...]:
    """A warning, given and returned, where the test has another confining stress than the data."""
    if curve.confining is None or "confining_stress" in model.parameters.names:
        return ()
    said = curve.confining.unlike(float(model.simulator.params.confining_stress))
    if said is None:
        return ()
    warnings.warn(f"{file}: {said}", stacklevel=3)
    return (f"{file}: {said}",)


def _with_health(found: Fit, health: Health | None) -> Fit:
    """The fit with what the health of the gradient at its answer says of it."""
    if health is None or health.healthy:
        return found
    if health.usable_strain > 0:
        sentence = (
            f"the tangents agree with differences of the runs only up to strain {health.usable_strain:.2g}: fit the "
            "data up to there and compare."
        )
        return replace(found, warnings=(*found.warnings, sentence))
    return found.doubted(
        "the tangents disagree with differences of the runs",
        "the tangents at the answer disagree with differences of the runs, so where the search came to rest means "
        "little: cut the data to a shorter strain range, or take jacobian='difference' in calibrate.fit_parameters.",
    )
