"""What is compared: named numbers read off a curve, each with exact derivatives.

A functional is called with anything that has the arrays of `axijax.Curve` (axial_strain, stress_ratio, ...
of T values, compression positive, strain as a fraction) and returns one number; it can stand inside jit and jvp.
A peak is only defined once it is said which one: the hard maximum over records is the noisiest and its tangent
that of one record, the window mean is the smoothest (PHYSICS 4). `Datum` pairs a functional with a measurement.
Further functionals, those of a laboratory's report, are in `calibrate.functionals`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from axijax.core.gather import gathered

RATIOS = ("stress_ratio", "virial_ratio", "core_ratio")
BEFORE_END = 0.05  # share of a run's strain, at its end, in which a maximum is no peak: it may still rise
WINDOW_POINTS = 201  # of the trapezoidal mean over a window


def _check_ratio(ratio: str) -> None:
    if ratio not in RATIOS:
        raise ValueError(f"ratio = {ratio!r}: must be one of {', '.join(map(repr, RATIOS))}.")


def _check_strain(name: str, value: float, low: float = 0.0) -> None:
    if not (np.isfinite(value) and low <= value < 0.5):
        hint = "; a strain is a fraction here, 0.4 % is 0.004" if np.isfinite(value) and value >= 0.5 else ""
        raise ValueError(f"{name} = {value!r}: must be a strain from {low:g} to below 0.5{hint}.")


def _check_temperature(value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"temperature = {value!r}: must be positive and finite, in units of the stress ratio.")


def passed_peak(curve, ratio: str) -> bool:
    """Whether a finished curve has its largest stress ratio before its end, by more than the last BEFORE_END of its
    strain; otherwise its maximum is where the run stopped and no peak."""
    strain = np.asarray(curve.axial_strain)
    return bool(strain[np.argmax(getattr(curve, ratio))] < strain[-1] - BEFORE_END * (strain[-1] - strain[0]))


def not_reached(functional, curve, *fields: str) -> str | None:
    """Why a curve does not reach the strain of a functional, or has not the field; None where it does."""
    for field in fields:
        values = getattr(curve, field, None)
        if values is None or not np.isfinite(np.asarray(values)).any():
            return f"it has no {field.replace('_', ' ')}"
    ends, wanted = float(np.asarray(curve.axial_strain)[-1]), last_strain(functional)
    if wanted > ends * (1 + 1e-9):
        return f"it ends at strain {ends:.4g}, before {wanted:g}"
    begins = float(np.asarray(curve.axial_strain)[0])
    first = getattr(functional, "start", getattr(functional, "strain", begins))
    if first < begins - 1e-12:
        return f"it begins at strain {begins:.4g}, after {first:g}"
    return None


def last_strain(functional) -> float:
    """Axial strain that a curve must reach for a functional [-]."""
    own = getattr(functional, "last_strain", None)
    return float(own if own is not None else getattr(functional, "stop", getattr(functional, "strain", 0.0)))


def trouble(functional, curve) -> str | None:
    """Why a curve, measured or of a finished run, does not reach a functional's number, in the middle of a sentence."""
    own = getattr(functional, "trouble", None)
    if own is not None:
        return own(curve)
    wrong = not_reached(functional, curve)
    if wrong is None and not np.isfinite(np.asarray(functional(curve))).all():
        return "the number is not finite there"
    return wrong


def no_peak(curve, ratio: str) -> str | None:
    """Why the largest stress ratio of a curve is no peak; None where it is one."""
    if wrong := not_reached(None, curve, ratio):
        return wrong
    if passed_peak(curve, ratio):
        return None
    values, strain = np.asarray(getattr(curve, ratio)), np.asarray(curve.axial_strain)
    top = int(values.argmax())
    return (
        f"its largest stress ratio, {values[top]:.4g}, is at its end (strain {strain[top]:.3g} of {strain[-1]:.3g}): "
        "the curve still rises, and that is no peak"
    )


def _at(curve, strain, field: str):
    """A field of the curve at given strains, NaN beyond the records, so that a short run is never read past its end."""
    strains = jnp.asarray(curve.axial_strain)
    # The first record is taken at strain zero to rounding; a hair below it is still the start.
    strain = jnp.where(jnp.abs(strain) < 1e-12, strains[0], strain)
    values = jnp.asarray(getattr(curve, field), strains.dtype)
    after = jnp.clip(jnp.searchsorted(strains, strain, side="right"), 1, strains.size - 1)
    # As jnp.interp, whose reverse mode scatters.
    (low, high), (before, behind) = gathered((strains, values), jnp.stack([after - 1, after]))
    apart = jnp.where(high > low, high - low, 1.0)
    met = jnp.where(high > low, before + (strain - low) / apart * (behind - before), before)
    return jnp.where((strain < strains[0]) | (strain > strains[-1]), jnp.nan, met)


@dataclass(frozen=True)
class HardPeak:
    """Largest recorded stress ratio [-]; its tangent is that of the record at the top.

    ratio: "stress_ratio" (platens, the paper's), "virial_ratio" or "core_ratio". Raises ValueError for another.
    """

    ratio: str = "stress_ratio"
    name = "hard maximum of R"

    def __post_init__(self):
        _check_ratio(self.ratio)

    def __call__(self, curve):
        return jnp.asarray(getattr(curve, self.ratio)).max()

    def trouble(self, curve) -> str | None:
        """Why a finished curve has no peak."""
        return no_peak(curve, self.ratio)


@dataclass(frozen=True)
class WindowMean:
    """Mean stress ratio [-] between two axial strains; NaN where the curve ends before.

    start, stop: strains [-], the default the flat top of the paper's specimen. Raises ValueError unless
    0 <= start < stop < 0.5.
    """

    start: float = 0.0025
    stop: float = 0.005
    ratio: str = "stress_ratio"

    def __post_init__(self):
        _check_ratio(self.ratio)
        _check_strain("start", self.start)
        _check_strain("stop", self.stop)
        if not self.start < self.stop:
            raise ValueError(f"window from start = {self.start:g} to stop = {self.stop:g}: start must be below stop.")

    @property
    def name(self) -> str:
        return f"mean of R from {100 * self.start:g} to {100 * self.stop:g} % strain"

    def __call__(self, curve):
        values = _at(curve, jnp.linspace(self.start, self.stop, WINDOW_POINTS), self.ratio)
        return (values.sum() - 0.5 * (values[0] + values[-1])) / (WINDOW_POINTS - 1)


def _boltzmann_weights(curve, ratio: str, temperature: float):
    """exp(R/temperature) d(strain), normalised; (T,)."""
    values, strains = jnp.asarray(getattr(curve, ratio)), jnp.asarray(curve.axial_strain)
    spacing = jnp.asarray(jnp.gradient(strains))
    weight = spacing * jnp.exp((values - values.max()) / temperature)
    return weight / weight.sum()


@dataclass(frozen=True)
class SmoothPeak:
    """Smooth maximum [-]: the mean of R over strain with weights exp(R / temperature); below the hard maximum by about
    temperature/2 for a parabolic top, equal to it as temperature -> 0.

    temperature: in units of R. Raises ValueError unless positive.
    """

    temperature: float = 0.01
    ratio: str = "stress_ratio"

    def __post_init__(self):
        _check_ratio(self.ratio)
        _check_temperature(self.temperature)

    @property
    def name(self) -> str:
        return f"smooth maximum of R, temperature {self.temperature:g}"

    def __call__(self, curve):
        weights = _boltzmann_weights(curve, self.ratio, self.temperature)
        return (weights * getattr(curve, self.ratio)).sum()

    def trouble(self, curve) -> str | None:
        """Why a finished curve has no peak."""
        return no_peak(curve, self.ratio)


@dataclass(frozen=True)
class RatioAt:
    """Stress ratio [-] at an axial strain [-], linear between records. Raises ValueError unless 0 <= strain < 0.5."""

    strain: float
    ratio: str = "stress_ratio"

    def __post_init__(self):
        _check_ratio(self.ratio)
        _check_strain("strain", self.strain)

    @property
    def name(self) -> str:
        return f"R at {100 * self.strain:g} % strain"

    def __call__(self, curve):
        return _at(curve, self.strain, self.ratio)


@dataclass(frozen=True)
class StrainAtPeak:
    """Axial strain at the peak [-], made differentiable as the mean strain with weights exp(R / temperature).

    The strain of the largest record jumps from record to record and its derivative is zero in between. The top is
    flat, so this number is ill-conditioned whatever the definition: a temperature of 0.01 averages over the strains
    at which R is within about 0.5 % of its peak. temperature: in units of R. Raises ValueError unless positive.
    """

    temperature: float = 0.01
    ratio: str = "stress_ratio"

    def __post_init__(self):
        _check_ratio(self.ratio)
        _check_temperature(self.temperature)

    @property
    def name(self) -> str:
        return f"strain at peak, temperature {self.temperature:g}"

    def __call__(self, curve):
        return (_boltzmann_weights(curve, self.ratio, self.temperature) * curve.axial_strain).sum()

    def trouble(self, curve) -> str | None:
        """Why a finished curve has no peak."""
        return no_peak(curve, self.ratio)


@dataclass(frozen=True)
class InitialSlope:
    """dR/d(axial strain) [-]: least-squares slope of R between two strains; NaN where the curve ends before.

    start, stop: strains [-]; the default starts after the platens' ramp and ends near the first slip of the paper's
    specimen. Raises ValueError unless 0 <= start < stop < 0.5.
    """

    start: float = 1e-4
    stop: float = 4e-4
    ratio: str = "stress_ratio"

    def __post_init__(self):
        WindowMean(self.start, self.stop, self.ratio)

    @property
    def name(self) -> str:
        return f"slope of R from {100 * self.start:g} to {100 * self.stop:g} % strain"

    def __call__(self, curve):
        strains = jnp.linspace(self.start, self.stop, WINDOW_POINTS)
        centred = strains - strains.mean()
        return (centred * _at(curve, strains, self.ratio)).sum() / (centred**2).sum()


@dataclass(frozen=True)
class Datum:
    """One measured number: the functional that predicts it, its value and its standard uncertainty, in one unit.

    functional: curve -> number, one of this module's or any function of that form.
    value, uncertainty: as the functional's unit. Raises ValueError unless finite and uncertainty > 0.
    source: where the number comes from.
    """

    functional: Callable[[Any], Any]
    value: float
    uncertainty: float
    source: str = ""

    def __post_init__(self):
        if not np.isfinite(self.value):
            raise ValueError(f"value = {self.value!r} of '{self.label}': must be a finite number.")
        if not (np.isfinite(self.uncertainty) and self.uncertainty > 0):
            raise ValueError(
                f"uncertainty = {self.uncertainty!r} of '{self.label}': must be positive; it weighs this number "
                "against others and sets the interval of what is fitted to it."
            )

    @property
    def label(self) -> str:
        return getattr(self.functional, "name", getattr(self.functional, "__name__", "functional"))

    @property
    def observed(self) -> np.ndarray:
        """(1,) the measured number."""
        return np.array([self.value], float)

    @property
    def sigma(self) -> np.ndarray:
        """(1,) its standard uncertainty."""
        return np.array([self.uncertainty], float)

    @classmethod
    def measured(cls, functional, curve, uncertainty: float) -> "Datum":
        """The number that a measured curve gives for a functional, as a datum.

        Raises ValueError, with the reason, where the curve does not reach it: a peak of data that still rise, say.
        """
        source = getattr(curve, "source", "")
        label = getattr(functional, "name", getattr(functional, "__name__", "functional"))
        if why := trouble(functional, curve):
            raise ValueError(f"{source or 'the measured curve'} does not reach '{label}': {why}.")
        return cls(functional, float(functional(curve)), uncertainty, source)

    @property
    def last_strain(self) -> float:
        """Axial strain that a run must reach [-]."""
        return last_strain(self.functional)

    def predict(self, curve):
        """(1,) what a simulated curve gives for it."""
        return jnp.reshape(self.functional(curve), (1,))
