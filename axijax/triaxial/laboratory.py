"""What a laboratory writes of a triaxial test: strength, angles, dilatancy, stiffness, void ratio, off its curve.

The peak is that of `axijax.triaxial.peak`. Values "at the peak" and "at large strain" are those of the smoothed curve
(`axijax.core.smoothing`), with its standard errors; large strain is nine tenths of the way to the end, where the
window still reaches past the place, and is said only where that is at least twice the strain at the peak. It is a
critical state as far as the dilatancy rate there is zero.
"""

from typing import Any, NamedTuple

import numpy as np

from axijax import theory
from axijax.core.smoothing import Moment, Smooth, advancing
from axijax.triaxial.peak import Peak, is_random, peak_of

LARGE_STRAIN, PAST_PEAK = 0.9, 2.0  # share of the strain reached, and least multiple of the strain at the peak


class Angle(NamedTuple):
    """An angle and its standard error [degrees]."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{self.value:.1f} +- {self.error:.1f}" if self.error >= 0.05 else f"{self.value:.2f}"


class Laboratory(NamedTuple):
    """Compression positive; rates of dilatancy d = -d(volumetric strain)/d(axial strain) expansion positive; what
    a test does not show is NaN.

    peak: stress ratio R and where, with its error; see there whether it is a peak.
    friction_angle: at the peak [degrees]. dilatancy, dilatancy_error: rate at the peak [-].
    dilatancy_angle: there, sin(psi) = d/(2 + d) [degrees].
    volumetric_strain_at_peak, volumetric_strain: there and at the end [-]. axial_strain: at the end [-].
    large_strain: where the next two are read [-]. large_strain_angle: friction angle there [degrees].
    large_strain_dilatancy: rate there [-].
    secant_modulus: E50 = q/(axial strain) from the start to half the deviatoric stress at the peak [F/L^2].
    void_ratio_start, void_ratio: of a random specimen, at the start and at the end [-].
    """

    peak: Peak
    friction_angle: Angle
    dilatancy: float
    dilatancy_error: float
    dilatancy_angle: float
    volumetric_strain_at_peak: float
    volumetric_strain: float
    axial_strain: float
    large_strain: float
    large_strain_angle: Angle
    large_strain_dilatancy: float
    secant_modulus: float
    void_ratio_start: float
    void_ratio: float

    def rows(self, asked: float | None = None) -> dict[str, str]:
        """Name with unit, and value, of what the test shows, for people. asked: the axial strain that a finished test
        was to reach; no record lies past it, so that the last is up to `record_every` steps before it."""
        peak, at = self.peak, "at the peak" if self.peak.reached else "there"
        name = "peak stress ratio s1/s3 [-]"
        if not peak.reached:
            name = f"largest stress ratio s1/s3 so far [-], {peak.doubt}"
        rows = {
            name: peak.value if peak.error is not None else f"{peak.stress_ratio:.4g}",
            f"axial strain {at} [%]": f"{100 * peak.axial_strain:.3g}",
            f"friction angle {at} [degrees]": str(self.friction_angle),
        }
        if np.isfinite(self.dilatancy):
            rows[f"dilatancy rate -d eps_v/d eps_1 {at} [-]"] = _with_error(self.dilatancy, self.dilatancy_error)
            rows[f"dilatancy angle {at} [degrees]"] = f"{self.dilatancy_angle:.1f}"
        rows[f"volumetric strain {at} [%]"] = f"{100 * self.volumetric_strain_at_peak:.3g}"
        if np.isfinite(self.large_strain):
            where = f"at {100 * self.large_strain:.3g} % axial strain"
            rows[f"large-strain friction angle [degrees], {where}"] = str(self.large_strain_angle)
            rows[f"dilatancy rate {where} [-]"] = f"{self.large_strain_dilatancy:.2f}"
        if np.isfinite(self.secant_modulus):
            rows["secant modulus E50 [F/L²]"] = f"{self.secant_modulus:.3g}"
        rows["axial strain reached [%]"] = f"{100 * self.axial_strain:.4g}"
        if asked is not None and rows["axial strain reached [%]"] != f"{100 * asked:.4g}":
            rows["axial strain reached [%]"] += f", the last record before {100 * asked:.4g}"
        rows["volumetric strain at the end [%]"] = f"{100 * self.volumetric_strain:.3g}"
        if np.isfinite(self.void_ratio_start):
            rows["void ratio, start and end [-]"] = f"{self.void_ratio_start:.4f}, {self.void_ratio:.4f}"
        return rows

    def values(self) -> dict[str, float | bool | None]:
        """The numbers by name, for JSON; None where there is none."""
        peak = self.peak
        found: dict[str, Any] = {
            "peak_stress_ratio": peak.stress_ratio, "peak_error": peak.error, "axial_strain_at_peak": peak.axial_strain,
            "peak_reached": peak.reached, "friction_angle": self.friction_angle.value,
            "friction_angle_error": self.friction_angle.error, "large_strain_angle": self.large_strain_angle.value,
            "large_strain_angle_error": self.large_strain_angle.error,
        }  # fmt: skip
        found |= {name: value for name, value in self._asdict().items() if isinstance(value, float)}
        return {name: value if value is not None and np.isfinite(value) else None for name, value in found.items()}


def laboratory(curve: Any) -> Laboratory:
    """Of a `Curve`, or of a dataset of one (T values each)."""
    peak = peak_of(curve)
    nan = float("nan")
    names = "axial_strain", "stress_ratio", "lateral_stress", "volumetric_strain", "void_ratio"
    strain, ratio, s3, volume, voids = (np.asarray(getattr(curve, name), float) for name in names)
    used = advancing(strain) & np.isfinite(ratio) & np.isfinite(volume)
    nothing = Moment(nan, nan, nan, nan)
    at_peak, ratio_there, volume_there, place = nothing, nothing, nothing, nan
    if used.sum() >= 3:
        smooth = Smooth(strain[used])
        at_peak = smooth.at(peak.axial_strain, volume[used])
        place = strain[used][0] + LARGE_STRAIN * (strain[used][-1] - strain[used][0])
        if peak.reached and place - strain[used][0] >= PAST_PEAK * (peak.axial_strain - strain[used][0]):
            ratio_there, volume_there = smooth.at(place, ratio[used]), smooth.at(place, volume[used])
        else:
            place = nan
    random = is_random(curve) and used.any()
    return Laboratory(
        peak=peak,
        friction_angle=_angle(peak.stress_ratio, peak.error or 0.0),
        dilatancy=-at_peak.slope,
        dilatancy_error=at_peak.slope_error,
        dilatancy_angle=float(np.rad2deg(theory.dilatancy_angle(np.asarray(-at_peak.slope)))),
        volumetric_strain_at_peak=at_peak.value,
        volumetric_strain=float(volume[used][-1]) if used.any() else nan,
        axial_strain=float(strain[used][-1]) if used.any() else nan,
        large_strain=float(place),
        large_strain_angle=_angle(ratio_there.value, ratio_there.value_error),
        large_strain_dilatancy=-volume_there.slope,
        secant_modulus=_secant_modulus(strain[used], (ratio * s3 - s3)[used], peak),
        void_ratio_start=float(voids[used][0]) if random else nan,
        void_ratio=float(voids[used][-1]) if random else nan,
    )


def _angle(ratio: float, error: float) -> Angle:
    """The friction angle at a stress ratio, whose derivative is 1/((R + 1) sqrt(R))."""
    if not ratio > 0:
        return Angle(float("nan"), float("nan"))
    slope = 1 / ((ratio + 1) * ratio**0.5)
    return Angle(float(np.rad2deg(theory.friction_angle(ratio))), float(np.rad2deg(slope * error)))


def _secant_modulus(strain: np.ndarray, q: np.ndarray, peak: Peak) -> float:
    """From the first record to where half of the rise to the peak is first exceeded, between two records."""
    before = strain <= peak.axial_strain
    if before.sum() < 2:
        return float("nan")
    half = (q[0] + float(np.interp(peak.axial_strain, strain, q))) / 2
    first = int(np.argmax(q > half))
    if q[first] <= half or not first:
        return float("nan")
    share = (half - q[first - 1]) / (q[first] - q[first - 1])
    reached = strain[first - 1] + share * (strain[first] - strain[first - 1])
    return float((half - q[0]) / (reached - strain[0]))


def _with_error(value: float, error: float) -> str:
    return f"{value:.2f} +- {error:.2f}" if error >= 0.005 else f"{value:.3f}"
