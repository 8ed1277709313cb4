"""The largest stress ratio of a curve, and whether it is a peak.

A regular array's curve is smooth: its peak is the largest record. That of a random specimen jumps, by several tenths
where it has few balls, and its largest record is what jumped highest: its peak is the maximum of the smoothed curve,
with an error (`axijax.core.smoothing`).
"""

from typing import Any, NamedTuple

import numpy as np

from axijax.core.smoothing import Smooth, advancing


class Peak(NamedTuple):
    """The largest stress ratio of a curve, and whether it is a peak; made by `find_peak`.

    record: its place, or the nearest to it. axial_strain, stress_ratio: there [-].
    doubt: why it is no peak, in words; empty where it is one.
    error: standard error of a smoothed one [-]; None where it is that of a single record.
    """

    record: int
    axial_strain: float
    stress_ratio: float
    doubt: str
    error: float | None = None

    @property
    def reached(self) -> bool:
        """Whether it is a peak."""
        return not self.doubt

    @property
    def value(self) -> str:
        """The stress ratio, with its error where it has one."""
        if self.error is None:
            return f"{self.stress_ratio:.4f}"
        return f"{self.stress_ratio:.3f} +- {self.error:.3f} (smoothed)"

    @property
    def short(self) -> str:
        """The value, and why it is no peak."""
        return f"peak {self.value}" if self.reached else f"largest so far {self.value} ({self.doubt})"

    def __str__(self) -> str:
        name = "peak stress ratio" if self.reached else "largest stress ratio so far"
        told = f"{name} {self.value} at {100 * self.axial_strain:.3f} % axial strain"
        return told if self.reached else f"{told}, {self.doubt}"


# What follows a maximum decides whether it is a peak: this share of the strain without exceeding it, or a fall by this
# share of R - 1 that is also this many times the scatter of single records, or this many times a smooth one's error.
PEAK_STRAIN, PEAK_FALL, PEAK_SCATTER, PEAK_ERRORS = 0.1, 0.01, 4.0, 2.0


def find_peak(axial_strain, stress_ratio, smoothed: bool = False) -> Peak:
    """The largest stress ratio of a curve, simulated or measured, and whether it is a peak (T values each).

    It is one where the last tenth of the strain lies behind it, or where the curve has fallen from it by more than a
    hundredth of R - 1 and than it scatters. The last record never is, nor are the last few of a noisy curve that rises:
    all that is known then is that a peak, if there is one, is higher.

    smoothed: the maximum of the smoothed curve, with its error, of the records that lie beyond all strain before them.
    """
    strain, ratio = np.asarray(axial_strain, float), np.asarray(stress_ratio, float)
    sound = np.isfinite(strain) & np.isfinite(ratio)  # a run that failed may end in NaN
    if smoothed and (sound & advancing(strain)).sum() >= 3:
        return _smooth_peak(strain, ratio, np.flatnonzero(sound & advancing(strain)))
    places = np.flatnonzero(sound)
    if not places.size:
        return Peak(0, float("nan"), float("nan"), "no record is a number")
    strain, ratio = strain[places], ratio[places]
    top = int(ratio.argmax())
    # Of values with independent scatter s the second differences have sqrt(6) s, and 1.65 s as median size.
    scatter = float(np.median(np.abs(np.diff(ratio, 2)))) / 1.65 if ratio.size > 2 else 0.0
    fallen = ratio[top] - ratio[top + 1 :][-3:].mean() if top + 1 < ratio.size else 0.0
    doubt = _doubt(strain, top, fallen, max(PEAK_FALL * (ratio[top] - 1), PEAK_SCATTER * scatter))
    return Peak(int(places[top]), float(strain[top]), float(ratio[top]), doubt)


def _smooth_peak(strain: np.ndarray, ratio: np.ndarray, used: np.ndarray) -> Peak:
    strain, ratio = strain[used], ratio[used]
    smooth = Smooth(strain)
    place, value, error = smooth.maximum(ratio)
    top = int(np.abs(strain - place).argmin())
    curve = smooth.curve(ratio)
    fallen = float(curve(place) - curve(strain[-1]))
    doubt = _doubt(strain, top, fallen, max(PEAK_FALL * (value - 1), PEAK_ERRORS * error))
    return Peak(int(used[top]), place, value, doubt, error)


def _doubt(strain: np.ndarray, top: int, fallen: float, needed: float) -> str:
    """Why the record `top` is no peak; empty where it is one. fallen: how far the curve has, to its end; needed: how
    far it must where the end is near."""
    after = strain.size - 1 - top
    if not after:
        return "at the last record: the curve still rises, no peak"
    if not top:
        return "at the first record: the curve never rises above its start, no peak"
    if strain[-1] - strain[top] < PEAK_STRAIN * (strain[-1] - strain[0]) and fallen < needed:
        records = "one record" if after == 1 else f"{after} records"
        return f"{records} before the last: the curve has not clearly fallen since, no peak"
    return ""


def peak_of(curve: Any) -> Peak:
    """The peak of a `Curve`, or of a dataset of one: smoothed where it is a random specimen's."""
    return find_peak(curve.axial_strain, curve.stress_ratio, is_random(curve))


def is_random(curve: Any) -> bool:
    """Whether a curve is that of a random specimen, whose records say a void ratio."""
    return bool(np.isfinite(np.asarray(curve.void_ratio, float)).any())


def at_peak(curve: Any, peak: Peak, name: str) -> float:
    """A record of the curve at its peak, smoothed where the peak is."""
    strain, values = np.asarray(curve.axial_strain, float), np.asarray(getattr(curve, name), float)
    if peak.error is None:
        return float(values[peak.record])
    used = advancing(strain) & np.isfinite(values)
    return float(Smooth(strain[used]).curve(values[used])(peak.axial_strain)) if used.sum() >= 3 else float("nan")


FLAT = 0.003  # share of its largest value within which a curve's top counts as flat


def flat_top(axial_strain, stress_ratio) -> tuple[float, float]:
    """Strains between which the stress ratio stays within 0.3 % of its largest value, around that value's (T values
    each) [-]; linear between records. A side on which the curve ends before it has fallen so far is NaN, so that no end
    of a curve is taken for the end of its top.
    """
    strain, ratio = np.asarray(axial_strain, float), np.asarray(stress_ratio, float)
    sound = np.isfinite(strain) & np.isfinite(ratio)
    strain, ratio = strain[sound], ratio[sound]
    if not ratio.size:
        return float("nan"), float("nan")
    top, level = int(ratio.argmax()), (1 - FLAT) * float(ratio.max())

    def crossing(outward: np.ndarray) -> float:
        """Where the curve, followed away from its top, first falls below the level."""
        below = np.flatnonzero(ratio[outward] < level)
        if not below.size:
            return float("nan")
        inside, outside = outward[below[0] - 1], outward[below[0]]
        share = (ratio[inside] - level) / (ratio[inside] - ratio[outside])
        return float(strain[inside] + share * (strain[outside] - strain[inside]))

    return crossing(np.arange(top, -1, -1)), crossing(np.arange(top, ratio.size))
