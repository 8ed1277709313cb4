"""The record of a test, and what is said of one that went wrong."""

import warnings
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.status import UNSTABLE, described
from axijax.mechanics.observe import Observation

CHATTER = 1e-3  # `observe.chatter` of a sound run is below zero; above this, contacts chatter


class SimulationError(RuntimeError):
    """A run that went wrong; says what happened and what to do. `curve` holds what was computed."""

    def __init__(self, message: str, curve: "Curve | None"):
        super().__init__(message)
        self.curve = curve


class Confinement(NamedTuple):
    """How confinement ended: mean unbalanced force over mean contact force, |s1 - s3|/s3, steps taken."""

    unbalanced_force: jax.Array
    stress_error: jax.Array
    steps: jax.Array

    @property
    def worst(self) -> jax.Array:
        """The larger of the two errors [-]."""
        return jnp.maximum(self.unbalanced_force, self.stress_error)


class Recorded(NamedTuple):
    """What is said of a recorded quantity: long name, and unit as NetCDF writes it, "1" for none."""

    long_name: str
    unit: str


def recorded(long_name: str, unit: str = "1", **default) -> Any:
    """A field of `Curve` with one value a record. Files, reports and batches read its declaration from here; a quantity
    of the same name in `observe.Observation` is taken over. default=None: of tests in stages only."""
    return field(metadata={"record": Recorded(long_name, unit)}, **default)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Curve:
    """The record of a test: fields of T values, compression positive. Stress ratios as in `observe.Observation`.

    axial_strain: shortening over the height at the end of confinement [-].
    volumetric_strain: loss of volume over the volume at the end of confinement [-]; what the volume is, see
        `axijax.mechanics.volume`.
    void_ratio: voids over solids of a random specimen, counted below the skin [-]; NaN for a lattice.
    confinement: what was observed at the end of confinement; stress_error there is |s1 - s3| / s3.
    status: bits, zero for a sound run (see `raise_for_status`).
    """

    axial_strain: jax.Array = recorded("axial strain, compression positive")
    stress_ratio: jax.Array = recorded("stress ratio s1/s3, platen force over the area of the sector of radius Rm")
    virial_ratio: jax.Array = recorded("stress ratio s1/s3 from platen force and membrane forces, free of any area")
    core_ratio: jax.Array = recorded("vertical over horizontal Love-Weber stress of the inner core")
    volumetric_strain: jax.Array = recorded("volumetric strain, compression positive")
    void_ratio: jax.Array = recorded("voids over solids below the skin, counted; none for a lattice")
    coordination_number: jax.Array = recorded("mean number of contacts of a ball")
    unbalanced_force: jax.Array = recorded("mean resultant over mean contact force")
    sliding_fraction: jax.Array = recorded("share of the contacts at the Coulomb limit")
    chatter: jax.Array = recorded("motion of contacts to and fro from step to step, against what their springs hold")
    membrane_radius: jax.Array = recorded("radius Rm through the middle of the membrane zone", "L")
    lateral_stress: jax.Array | None = recorded("effective lateral stress s3", "F L-2", default=None)
    pore_pressure: jax.Array | None = recorded("pore pressure, or what would keep the volume", "F L-2", default=None)
    path_length: jax.Array | None = recorded("axial strain travelled, to and fro", default=None)
    servo_error: jax.Array | None = recorded("servo error as a stress, over the confining stress", default=None)
    stage: jax.Array | None = recorded("number of the stage", default=None)
    confinement: Confinement
    status: jax.Array


# The fields of a curve that hold one value a record, and what is said of each where it is written; and those that only
# tests in stages have.
_ALL: dict[str, Recorded] = {f.name: f.metadata["record"] for f in fields(Curve) if "record" in f.metadata}
STAGE_RECORDS = {f.name: _ALL[f.name] for f in fields(Curve) if f.name in _ALL and f.default is None}
RECORDS = {name: about for name, about in _ALL.items() if name not in STAGE_RECORDS}


def records_of(curve: Curve) -> dict[str, Recorded]:
    """The fields that this curve holds, and what is said of each."""
    return RECORDS if curve.stage is None else _ALL


class Peak(NamedTuple):
    """The largest stress ratio of a curve, and whether it is a peak; made by `find_peak`.

    record: its place. axial_strain, stress_ratio: there [-].
    doubt: why it is no peak, in words; empty where it is one.
    """

    record: int
    axial_strain: float
    stress_ratio: float
    doubt: str

    @property
    def reached(self) -> bool:
        """Whether it is a peak."""
        return not self.doubt

    @property
    def short(self) -> str:
        """The value, and why it is no peak."""
        if self.reached:
            return f"peak {self.stress_ratio:.4f}"
        return f"largest so far {self.stress_ratio:.4f} ({self.doubt})"

    def __str__(self) -> str:
        name = "peak stress ratio" if self.reached else "largest stress ratio so far"
        told = f"{name} {self.stress_ratio:.4f} at {100 * self.axial_strain:.3f} % axial strain"
        return told if self.reached else f"{told}, {self.doubt}"


# What follows a maximum decides whether it is a peak: this share of the strain without exceeding it, or a fall by this
# share of R - 1 that is also this many times the scatter of single records.
PEAK_STRAIN, PEAK_FALL, PEAK_SCATTER = 0.1, 0.01, 4.0


def find_peak(axial_strain, stress_ratio) -> Peak:
    """The largest stress ratio of a curve, simulated or measured, and whether it is a peak (T values each).

    It is one where the last tenth of the strain lies behind it, or where the curve has fallen from it by more than a
    hundredth of R - 1 and than it scatters from record to record. The last record never is, nor are the last few of a
    noisy curve that rises: all that is known then is that a peak, if there is one, is higher.
    """
    strain, ratio = np.asarray(axial_strain, float), np.asarray(stress_ratio, float)
    sound = np.flatnonzero(np.isfinite(strain) & np.isfinite(ratio))  # a run that failed may end in NaN
    if not sound.size:
        return Peak(0, float("nan"), float("nan"), "no record is a number")
    strain, ratio = strain[sound], ratio[sound]
    top = int(ratio.argmax())
    after = ratio[top + 1 :]
    doubt = ""
    if not after.size:
        doubt = "at the last record: the curve still rises, no peak"
    elif top == 0:
        doubt = "at the first record: the curve never rises above its start, no peak"
    elif strain[-1] - strain[top] < PEAK_STRAIN * (strain[-1] - strain[0]):
        # Of values with independent scatter s the second differences have sqrt(6) s, and 1.65 s as median size.
        scatter = float(np.median(np.abs(np.diff(ratio, 2)))) / 1.65
        if ratio[top] - after[-3:].mean() < max(PEAK_FALL * (ratio[top] - 1), PEAK_SCATTER * scatter):
            records = "one record" if after.size == 1 else f"{after.size} records"
            doubt = f"{records} before the last: the curve has not clearly fallen since, no peak"
    return Peak(int(sound[top]), float(strain[top]), float(ratio[top]), doubt)


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


def raise_for_status(status, curve: Curve | None = None) -> None:
    """Raise SimulationError, naming what went wrong and what to do, unless a curve's status bits are all zero."""
    bits = int(np.bitwise_or.reduce(np.asarray(status).ravel()))
    if bits:
        raise SimulationError(f"the test went wrong: {described(bits)}.", curve)


def no_records(staged: bool = False) -> Observation:
    """An observation of no moment at all; staged: of a test in stages, whose records hold more."""
    empty: Any = np.zeros(0)
    return Observation(*[empty] * (len(Observation._fields) - (0 if staged else len(STAGE_RECORDS))))


def warn_of_chatter(curve: Curve) -> None:
    """Warn of chatter that has died out by the peak: the peak is right, the curve before it is not."""
    strain = curve.axial_strain[curve.chatter > CHATTER]
    if strain.size:
        warnings.warn(
            f"contacts chattered between {100 * strain.min():.3g} and {100 * strain.max():.3g} % axial strain, though "
            "not at the peak: the curve is inexact there; lower time_step.",
            stacklevel=3,
        )


def make_curve(seen: Observation, balance: Confinement, status=0) -> Curve:
    """A curve from T observations, strains counted from the first."""
    status = status | jnp.where(seen.chatter[jnp.argmax(seen.stress_ratio)] > CHATTER, UNSTABLE, 0)
    taken = {name: getattr(seen, name) for name in _ALL if name in Observation._fields}
    return Curve(
        axial_strain=1 - seen.height / seen.height[0],
        volumetric_strain=1 - seen.volume / seen.volume[0],
        confinement=balance,
        status=status,
        **taken,
    )
