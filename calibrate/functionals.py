"""Numbers of a laboratory's report as functionals of a curve: dilatancy, stress-dilatancy, volume, angles, E50.

As those of `calibrate.targets`: each is called with anything that has the arrays of `axijax.Curve`, simulated or
measured, and returns one number, with exact derivatives. `Datum.measured(functional, curve, uncertainty)` reads it off
a measured curve. Where a curve does not reach the number, `trouble(curve)` says why in a sentence, measured data are
refused with it, and a fit to a run that does not reach it is not called converged.

Rates are slopes of least-squares lines over a stretch of strain, `width`, so that records are smoothed by a stated
amount: the volume of a random specimen scatters by 1e-4 to 1e-3 from record to record.
"""

from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np

from calibrate.targets import HardPeak, _at, _check_ratio, _check_strain, not_reached

CENTRES, POINTS = 81, 41  # stretches of strain that are looked at; points of one of them


def _check_stretch(start: float, stop: float, width: float) -> None:
    _check_strain("start", start)
    _check_strain("stop", stop)
    if not (np.isfinite(width) and 0 < width <= stop - start):
        raise ValueError(
            f"width = {width!r}: must be positive and at most stop - start = {stop - start:g}, the strain over which "
            "it smooths."
        )


def _stretches(start: float, stop: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres (CENTRES,) of stretches of strain within start to stop, and places (POINTS,) about a centre."""
    return np.linspace(start + width / 2, stop - width / 2, CENTRES), np.linspace(-width / 2, width / 2, POINTS)


def dilatancy_along(curve, start: float, stop: float, width: float):
    """(strain, -d(volumetric strain)/d(axial strain)) (CENTRES,) [-]: positive where the volume grows; slopes of least
    squares over stretches of this width. NaN where the curve ends before."""
    centres, about = _stretches(start, stop, width)
    volume = _at(curve, centres[:, None] + about[None, :], "volumetric_strain")
    return centres, -(volume @ about) / (about @ about)


def stress_dilatancy(curve, start: float, stop: float, width: float, ratio: str = "stress_ratio"):
    """(R, D) (CENTRES,) each [-]: mean of R over the stretches and Rowe's D = 1 - d(volumetric)/d(axial strain)."""
    centres, about = _stretches(start, stop, width)
    mean = _at(curve, centres[:, None] + about[None, :], ratio).mean(axis=1)
    return mean, 1 + dilatancy_along(curve, start, stop, width)[1]


def rowe_constant(stress_ratio, dilatancy) -> tuple[float, float]:
    """(K, its standard error) of R = K D, by least squares through the origin, from measured pairs (M,) of R = s1/s3
    and D = 1 - d(volumetric)/d(axial strain) (Rowe 1962).

    Raises ValueError for fewer than two pairs, or numbers that are not positive and finite.
    """
    R, D = np.asarray(stress_ratio, float), np.asarray(dilatancy, float)
    if R.ndim != 1 or R.shape != D.shape or R.size < 2:
        raise ValueError(f"stress_ratio and dilatancy have shapes {R.shape} and {D.shape}: must be (M,) both, M > 1.")
    if not (np.isfinite([R, D]).all() and (R > 0).all() and (D > 0).all()):
        raise ValueError("stress_ratio and dilatancy must be positive and finite; D = 1 - d(eps_v)/d(eps_a).")
    K = float(R @ D / (D @ D))
    return K, float(np.sqrt(np.sum((R - K * D) ** 2) / (R.size - 1) / (D @ D)))


@dataclass(frozen=True)
class MaxDilatancy:
    """Largest -d(volumetric strain)/d(axial strain) [-] between two axial strains, as a slope of least squares over
    `width`; its derivative is that of the stretch at the top.

    start, stop, width: strains [-]. Raises ValueError unless 0 <= start < stop < 0.5 and 0 < width <= stop - start.
    """

    stop: float
    start: float = 0.0
    width: float = 0.01

    def __post_init__(self):
        _check_stretch(self.start, self.stop, self.width)

    @property
    def name(self) -> str:
        return f"maximum dilatancy up to {100 * self.stop:g} % strain, over {100 * self.width:g} %"

    def __call__(self, curve):
        return dilatancy_along(curve, self.start, self.stop, self.width)[1].max()

    def trouble(self, curve) -> str | None:
        """Why a curve has no such number: it ends before, or dilates ever more up to there."""
        wrong = not_reached(self, curve, "volumetric_strain")
        if wrong:
            return wrong
        centres, rate = dilatancy_along(curve, self.start, self.stop, self.width)
        top = int(np.argmax(rate))
        if top == len(centres) - 1:
            return f"the dilatancy still grows at strain {self.stop:g} ({float(rate[top]):.3g}): no maximum is in it"
        return None


@dataclass(frozen=True)
class StressDilatancy:
    """K of Rowe's R = K D [-], fitted by least squares to R against D = 1 - d(volumetric)/d(axial strain) between two
    axial strains (Rowe 1962, Proc. R. Soc. A 269). For a face-centred cubic array K = (1 + f)/(1 - f); of sands
    tan^2(45 + phi_f/2), with phi_f between the friction of grains and that at constant volume.

    start, stop, width: strains [-], as of MaxDilatancy.
    """

    start: float
    stop: float
    width: float = 0.01
    ratio: str = "stress_ratio"

    def __post_init__(self):
        _check_ratio(self.ratio)
        _check_stretch(self.start, self.stop, self.width)

    @property
    def name(self) -> str:
        return f"K = R/D from {100 * self.start:g} to {100 * self.stop:g} % strain"

    def __call__(self, curve):
        R, D = stress_dilatancy(curve, self.start, self.stop, self.width, self.ratio)
        return (R * D).sum() / (D * D).sum()

    def trouble(self, curve) -> str | None:
        """Why a curve has no such number: it ends before, or its volume falls as fast as its height."""
        wrong = not_reached(self, curve, "volumetric_strain", self.ratio)
        if wrong:
            return wrong
        D = np.asarray(stress_dilatancy(curve, self.start, self.stop, self.width, self.ratio)[1])
        if D.min() <= 0:
            return f"D = 1 - d(eps_v)/d(eps_a) is {D.min():.3g} in it: R = K D holds of what shears, start later"
        return None


@dataclass(frozen=True)
class VolumeAt:
    """Volumetric strain [-], compression positive, at an axial strain [-]."""

    strain: float

    def __post_init__(self):
        _check_strain("strain", self.strain)

    @property
    def name(self) -> str:
        return f"volumetric strain at {100 * self.strain:g} % strain"

    def __call__(self, curve):
        return _at(curve, self.strain, "volumetric_strain")

    def trouble(self, curve) -> str | None:
        """Why a curve has no such number."""
        return not_reached(self, curve, "volumetric_strain")


@dataclass(frozen=True)
class VoidRatioAt:
    """Void ratio [-] at an axial strain [-]: of random specimens, counted below the skin, and of measured curves whose
    void ratio at the start is known."""

    strain: float

    def __post_init__(self):
        _check_strain("strain", self.strain)

    @property
    def name(self) -> str:
        return f"void ratio at {100 * self.strain:g} % strain"

    def __call__(self, curve):
        return _at(curve, self.strain, "void_ratio")

    def trouble(self, curve) -> str | None:
        """Why a curve has no such number: it ends before, is a lattice's, or was measured without e0."""
        if not np.isfinite(np.asarray(getattr(curve, "void_ratio", np.nan))).all():
            return "it has no void ratio: a lattice has none, and data need the one at the start (void_ratio)"
        return not_reached(self, curve, "void_ratio")


@dataclass(frozen=True)
class FrictionAngle:
    """Mobilised friction angle asin((R - 1)/(R + 1)) [degrees] of a functional that gives a stress ratio: at the peak
    FrictionAngle(), smoothed FrictionAngle(SmoothPeak(0.02)), at large strain FrictionAngle(WindowMean(0.15, 0.2))."""

    of: object = field(default_factory=HardPeak)

    @property
    def name(self) -> str:
        return f"friction angle of {getattr(self.of, 'name', 'R')}"

    @property
    def last_strain(self) -> float:
        """Axial strain that a run must reach [-]."""
        return getattr(self.of, "stop", getattr(self.of, "strain", 0.0))

    def __call__(self, curve):
        R = self.of(curve)  # type: ignore[operator]
        return jnp.degrees(jnp.arcsin((R - 1) / (R + 1)))

    def trouble(self, curve) -> str | None:
        """That of the stress ratio."""
        inner = getattr(self.of, "trouble", None)
        return inner(curve) if inner else not_reached(self, curve, getattr(self.of, "ratio", "stress_ratio"))


@dataclass(frozen=True)
class E50:
    """Secant modulus at half of the peak deviator stress, over the confining stress [-]: (R50 - 1)/strain there, with
    R50 halfway from 1 to the peak; times s3 it is a laboratory's E50."""

    ratio: str = "stress_ratio"
    name = "E50 over s3"

    def __post_init__(self):
        _check_ratio(self.ratio)

    def __call__(self, curve):
        R, strain = jnp.asarray(getattr(curve, self.ratio)), jnp.asarray(curve.axial_strain)
        half = 1 + 0.5 * (R.max() - 1)
        after = jnp.clip(jnp.argmax(half <= R), 1, R.size - 1)  # the first record at or above it
        low, high = R[after - 1], R[after]
        share = (half - low) / (high - low)
        return (half - 1) / (strain[after - 1] + share * (strain[after] - strain[after - 1]))

    def trouble(self, curve) -> str | None:
        """Why a curve has no such number: no peak, or more than half of it in the first record."""
        wrong = HardPeak(self.ratio).trouble(curve)
        R = np.asarray(getattr(curve, self.ratio))
        if wrong is None and R[0] >= 1 + 0.5 * (R.max() - 1):
            return f"it begins at R = {R[0]:.4g}, above half of its rise: there is no strain at half of the peak"
        return wrong
