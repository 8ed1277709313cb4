"""Where a fit begins: friction from the peak by Thornton's inverse, stiffness from the rise, then both put right by one
run.

The formulas hold for face-centred cubic arrays; for other specimens they are a first guess that the first run corrects:
what counts is the ratio of the run to the formula at the run's own parameters.
"""

import numpy as np

from calibrate.evaluate import half_rise_strain
from calibrate.measured import MeasuredCurve
from calibrate.targets import HardPeak, SmoothPeak, WindowMean


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
            return half_rise_strain(target.axial_strain, target.stress_ratio)
    return None


def thornton_inverse(stress_ratio: float) -> float:
    """Friction from a peak, (R - 2)/(R + 2), kept within 0.005 .. 0.9 so that it can be a start [-]."""
    return float(np.clip((stress_ratio - 2) / (stress_ratio + 2), 0.005, 0.9))


def start_by_rule(simulator, parameters, targets) -> np.ndarray:
    """(P,) coordinates of a start within the limits; what no rule reaches takes the simulator's own value."""
    from axijax.theory import fcc_first_slip, fcc_youngs_modulus

    values = {}
    peak, rise = observed_peak(targets), observed_rise(targets)
    reference = parameters.reference
    if peak is not None and "friction" in parameters.names:
        values["friction"] = thornton_inverse(peak)
    stiff = [name for name in ("normal_stiffness", "shear_stiffness") if name in parameters.names]
    specimen = getattr(simulator, "specimen", None)
    if peak is not None and rise and stiff and specimen is not None:
        friction = values.get("friction", reference["friction"])
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


def corrected_by_run(parameters, targets, evaluation) -> np.ndarray | None:
    """(P,) coordinates after one run anywhere: the formula scaled to the run's peak, strains scaled to its rise.
    None where the targets show neither, or the run failed."""
    peak, rise = observed_peak(targets), observed_rise(targets)
    if evaluation.failed or peak is None:
        return None
    values = parameters.values(evaluation.coordinates)
    if "friction" in values:
        formula = 2 * (1 + values["friction"]) / (1 - values["friction"])
        values["friction"] = thornton_inverse(peak * formula / evaluation.peak)
    if rise and "normal_stiffness" in values:
        factor = evaluation.rise / rise
        for name in ("normal_stiffness", "shear_stiffness"):
            if name in values:
                values[name] *= factor
    return _within(parameters, values)


def _within(parameters, values) -> np.ndarray:
    low, high = parameters.lower, parameters.upper
    margin = (high / low) ** 0.02
    kept = {
        name: float(np.clip(values.get(name, parameters.reference[name]), low[p] * margin[p], high[p] / margin[p]))
        for p, name in enumerate(parameters.names)
    }
    return parameters.coordinates(kept)
