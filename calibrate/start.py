"""Where a fit begins: friction from the peak by Thornton's inverse, stiffness from the rise, then both put right by one
run or two, each carried over to other parameters by similarity.

The formulas hold for face-centred cubic arrays; for other specimens they are a first guess that the first run corrects:
what counts is the ratio of the run to the formula at the run's own parameters.
"""

from types import SimpleNamespace

import numpy as np

from axijax.theory import fcc_first_slip, fcc_horizontal_opening_strain, fcc_stress_ratio, fcc_youngs_modulus
from calibrate.evaluate import half_rise_strain
from calibrate.measured import MeasuredCurve
from calibrate.targets import HardPeak, SmoothPeak, WindowMean

LOCKED = 0.95  # friction up to which the formulas of an array are used, which locks at 1


def observed_peak(targets) -> float | None:
    """Peak stress ratio that the targets show, None without one [-]."""
    for target in targets:
        if isinstance(target, MeasuredCurve):
            return float(target.stress_ratio.max())
        if isinstance(getattr(target, "functional", None), HardPeak | SmoothPeak | WindowMean):
            return float(target.value)
    return None


def observed_rise(targets) -> float | None:
    """Strain at half the rise that the targets show, None without a curve [-]."""
    for target in targets:
        if isinstance(target, MeasuredCurve):
            first = target.advancing
            return half_rise_strain(first.axial_strain, first.stress_ratio)
    return None


def thornton_inverse(stress_ratio: float) -> float:
    """Friction from a peak, (R - 2)/(R + 2), kept within 0.005 .. 0.9 so that it can be a start [-]."""
    return float(np.clip((stress_ratio - 2) / (stress_ratio + 2), 0.005, 0.9))


def start_by_rule(simulator, parameters, targets) -> np.ndarray:
    """(P,) coordinates of a start within the limits; what no rule reaches takes the simulator's own value."""
    values = {}
    peak, rise = observed_peak(targets), observed_rise(targets)
    reference = parameters.reference
    if peak is not None and "friction" in parameters.names:
        values["friction"] = thornton_inverse(peak)
    stiff = [name for name in ("normal_stiffness", "shear_stiffness") if name in parameters.names]
    specimen = getattr(simulator, "specimen", None)
    if peak is not None and rise and stiff and specimen is not None:
        friction = min(values.get("friction", reference.get("friction", 0.0)), LOCKED)
        ratio = reference["stiffness_ratio"]
        radius = float(np.mean(specimen.radius))
        slope = float(fcc_youngs_modulus(1.0, ratio, radius)) / reference["confining_stress"]  # of R, at kn = 1
        level = 0.5 * (peak - 1)
        # Past the first slip the rise is slower (PHYSICS 3.3); below ks/kn = f nothing slips before the peak.
        slip, softer = fcc_first_slip(friction, max(ratio, friction))
        slip, softer = float(slip) - 1, float(softer)
        strain = level / slope if level <= slip else slip / slope + (level - slip) / (slope * softer)
        values["normal_stiffness"] = strain / rise
        values["shear_stiffness"] = ratio * strain / rise
        values = {name: value for name, value in values.items() if name in parameters.names}
    return _within(parameters, values)


def similar_curve(curve, before, after, stretch: float) -> SimpleNamespace:
    """The curve that a run predicts at another friction and stiffness, with no run.

    curve: the run's fields of (T,). before, after: friction of the run and of the prediction [-]. stretch: kn / s3 of
    the prediction over the run's [-].
    R - 1 scales as Thornton's peak does; strains as the strain at which FCC's horizontal contacts open, which is where
    R peaks, s3/kn (3+f)/(1-f) (PHYSICS 3.3). Beyond the run's end the last value is held.
    """
    before, after = min(before, LOCKED), min(after, LOCKED)
    formula, found = fcc_stress_ratio(before), float(np.max(curve.stress_ratio))
    # How far this specimen is off the formula; a run that still rises at its end only says how far at least.
    share = found / formula if np.argmax(curve.stress_ratio) < curve.stress_ratio.size - 1 else max(found / formula, 1)
    higher = (share * fcc_stress_ratio(after) - 1) / (share * formula - 1)
    opening = [fcc_horizontal_opening_strain(friction, 1.0, 1.0, 1.0) for friction in (before, after)]
    faster = stretch * opening[0] / opening[1]
    strain = np.asarray(curve.axial_strain)
    fields = {"axial_strain": strain}
    for name in ("stress_ratio", "virial_ratio", "core_ratio"):
        if hasattr(curve, name):
            fields[name] = 1 + higher * (np.interp(faster * strain, strain, getattr(curve, name)) - 1)
    if hasattr(curve, "volumetric_strain"):
        fields["volumetric_strain"] = np.interp(faster * strain, strain, curve.volumetric_strain) / faster
        if hasattr(curve, "void_ratio"):
            fields["void_ratio"] = (1 + curve.void_ratio[0]) * (1 - fields["volumetric_strain"]) - 1
    return SimpleNamespace(**fields)


def corrected_by_run(evaluator, evaluation, prior_rows) -> np.ndarray | None:
    """(P,) coordinates at which the run, carried over by `similar_curve`, fits the targets best; kn and ks move
    together. None where the run failed or nothing that similarity knows is fitted.

    prior_rows: (Q, P) and (Q,) as `fit` makes them.
    """
    from scipy.optimize import least_squares

    parameters = evaluator.model.parameters
    names = parameters.names
    with_friction, with_stiffness = "friction" in names, "normal_stiffness" in names
    if evaluation.failed or not (with_friction or with_stiffness):
        return None
    low, high = parameters.limits()
    here = np.clip(evaluation.coordinates, low, high)
    stiff = [names.index(name) for name in ("normal_stiffness", "shear_stiffness") if name in names]
    rows = []
    if with_friction:
        rows.append(np.eye(len(names))[names.index("friction")])
    if with_stiffness:
        rows.append(np.eye(len(names))[stiff].sum(axis=0))
    directions = np.array(rows)
    # A material without friction has no such number.
    friction = (parameters.reference | parameters.values(here)).get("friction", 0.0)

    def residual(moves):
        z = np.clip(here + moves @ directions, low, high)
        moved = z - here
        stretch = np.exp(moved[names.index("normal_stiffness")]) if with_stiffness else 1.0
        curve = similar_curve(evaluation.curve, friction, parameters.values(z).get("friction", friction), stretch)
        misfit = (evaluator.predict(curve) - evaluator.observed) / evaluator.sigma
        # What the targets do not feel stays where it is.
        return np.concatenate([np.nan_to_num(misfit), prior_rows[0] @ z - prior_rows[1], 1e-3 * moves])

    found = least_squares(residual, np.zeros(len(directions)), diff_step=1e-3, xtol=1e-4, ftol=1e-6, max_nfev=30)
    return _within(parameters, parameters.values(here + found.x @ directions))


def _within(parameters, values) -> np.ndarray:
    """(P,) coordinates of these values, or the reference, a little inside the limits."""
    kept = {}
    for name, about, low, high in zip(
        parameters.names, parameters.about, parameters.lower, parameters.upper, strict=True
    ):
        if about.coordinate == "linear":
            inside = low + 0.02 * (high - low), high - 0.02 * (high - low)
        else:
            margin = (high / low) ** 0.02
            inside = low * margin, high / margin
        kept[name] = float(np.clip(values.get(name, parameters.reference[name]), *inside))
    return parameters.coordinates(kept)
