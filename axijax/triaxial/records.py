"""The record of a test, and what is said of one that went wrong."""

import warnings
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax import theory
from axijax.core.shown import Card, line_picture, numbers, per_cent, shown
from axijax.core.smoothing import Smooth, advancing
from axijax.core.status import UNSTABLE, described
from axijax.mechanics.observe import Observation
from axijax.mechanics.params import Params

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
    """What is said of a recorded quantity: long name, unit as NetCDF writes it, "1" for none, and what a test must have
    for it to be recorded, "" for nothing."""

    long_name: str
    unit: str
    of: str = ""


STAGES, ROUGH = "stages", "rough platens"


class Derived(property):
    """A property of `Curve` that follows from its records: (T,) values that are neither observed nor kept in memory,
    but written, reported and drawn as records are."""

    record: Recorded


def derived(long_name: str, unit: str = "1") -> Any:
    """Makes a function of a curve such a property."""

    def declare(function) -> Derived:
        made = Derived(function, doc=long_name)
        made.record = Recorded(long_name, unit)
        return made

    return declare


def recorded(long_name: str, unit: str = "1", of: str = "", **default: Any) -> Any:
    """A field of `Curve` with one value a record. Files, reports and batches read its declaration from here; a quantity
    of the same name in `observe.Observation` is taken over. of: what a test must have for it, "" for nothing."""
    if of:
        default["default"] = None
    return field(metadata={"record": Recorded(long_name, unit, of)}, **default)


@shown
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
    lateral_stress: jax.Array = recorded("effective lateral stress s3, compression positive", "F L-2")
    bottom_force: jax.Array = recorded("axial force on the bottom platen, of the whole cylinder", "F")
    top_force: jax.Array = recorded("axial force on the top platen, of the whole cylinder", "F")
    pore_pressure: jax.Array | None = recorded("pore pressure, or what would keep the volume", "F L-2", of=STAGES)
    path_length: jax.Array | None = recorded("axial strain travelled, to and fro", of=STAGES)
    servo_error: jax.Array | None = recorded("servo error as a stress, over the confining stress", of=STAGES)
    stage: jax.Array | None = recorded("number of the stage", of=STAGES)
    end_restraint: jax.Array | None = recorded("friction on both platens towards the axis, over force", of=ROUGH)
    bottom_shear_x: jax.Array | None = recorded("force of the whole cylinder on the bottom platen", "F", of=ROUGH)
    bottom_shear_y: jax.Array | None = recorded("force of the whole cylinder on the bottom platen", "F", of=ROUGH)
    bottom_torque: jax.Array | None = recorded("its moment on the bottom platen about the axis", "F L", of=ROUGH)
    top_shear_x: jax.Array | None = recorded("force of the whole cylinder on the top platen", "F", of=ROUGH)
    top_shear_y: jax.Array | None = recorded("force of the whole cylinder on the top platen", "F", of=ROUGH)
    top_torque: jax.Array | None = recorded("its moment on the top platen about the axis", "F L", of=ROUGH)
    confinement: Confinement
    status: jax.Array

    def _card(self) -> Card:
        from axijax.triaxial.peak import peak_of

        strain, ratio = numbers(self.axial_strain), numbers(self.stress_ratio)
        if strain is None or ratio is None or numbers(self.void_ratio) is None:
            return Card("Curve", {"records": "of a batch, traced, or none"})
        peak = peak_of(self)
        name = "peak stress ratio [-]" if peak.reached else "largest stress ratio so far [-]"
        rows = {
            "records": str(strain.size),
            "axial strain": f"to {per_cent(strain[-1])}",
            name: f"{peak.value} at {per_cent(peak.axial_strain)} axial strain",
            "volumetric strain at the end": per_cent(float(np.asarray(self.volumetric_strain)[-1])),
            "status": described(int(np.asarray(self.status))) or "sound",
        }
        return Card("Curve", rows, line_picture(100 * strain, ratio, "axial strain [%]", "stress ratio s1/s3 [-]"))

    @derived("axial stress s1 = R s3, compression positive", "F L-2")
    def axial_stress(self):
        return self.stress_ratio * self.lateral_stress

    @derived("mean stress p = (s1 + 2 s3)/3", "F L-2")
    def mean_stress(self):
        return theory.mean_stress(self.axial_stress, self.lateral_stress)

    @derived("deviatoric stress q = s1 - s3", "F L-2")
    def deviatoric_stress(self):
        return theory.deviatoric_stress(self.axial_stress, self.lateral_stress)

    @derived("mobilised friction angle, sin(phi) = (R - 1)/(R + 1)", "degree")
    def friction_angle(self):
        return jnp.rad2deg(theory.friction_angle(self.stress_ratio))

    @derived(
        "dilatancy rate d = -d(volumetric strain)/d(axial strain), expansion positive; slope of a local quadratic over "
        "0.6 to 1.4 of the axial strain; none while the axial strain goes back"
    )
    def dilatancy_rate(self):
        return dilatancy_rates(self.axial_strain, self.volumetric_strain)

    @derived("dilatancy angle, sin(psi) = d/(2 + d) (Vermeer & de Borst 1984, with total strain)", "degree")
    def dilatancy_angle(self):
        return jnp.rad2deg(theory.dilatancy_angle(self.dilatancy_rate))


# The fields of a curve that hold one value a record, and what is said of each where it is written.
RECORDS: dict[str, Recorded] = {f.name: f.metadata["record"] for f in fields(Curve) if "record" in f.metadata}
# The same of what is derived from them, and of both.
DERIVED: dict[str, Recorded] = {n: each.record for n, each in vars(Curve).items() if isinstance(each, Derived)}
QUANTITIES = RECORDS | DERIVED


def records_of(curve: Any) -> dict[str, Recorded]:
    """The records that a curve has, and what is said of each; it may also be the dataset of a file."""
    return {n: about for n, about in RECORDS.items() if not about.of or getattr(curve, n, None) is not None}


def quantities_of(curve: Any) -> dict[str, Recorded]:
    """The same with what is derived from them."""
    return records_of(curve) | DERIVED


def dilatancy_rates(axial_strain, volumetric_strain) -> np.ndarray:
    """-d(volumetric strain)/d(axial strain), smoothed as `axijax.core.smoothing` does, (T,) on the host; NaN where the
    axial strain does not lie beyond all before it, and where fewer than three records do."""
    strain, volume = np.asarray(axial_strain, float), np.asarray(volumetric_strain, float)
    used = advancing(strain) & np.isfinite(volume)
    rates = np.full(strain.shape, np.nan)
    if used.sum() >= 3:
        rates[used] = -Smooth(strain[used]).slopes(volume[used])
    return rates


def raise_for_status(status, curve: Curve | None = None) -> None:
    """Raise SimulationError, naming what went wrong and what to do, unless a curve's status bits are all zero."""
    bits = int(np.bitwise_or.reduce(np.asarray(status).ravel()))
    if bits:
        raise SimulationError(f"the test went wrong: {described(bits)}.", curve)


def no_records(params: Params | None = None, staged: bool = False) -> Observation:
    """An observation of no moment at all, with what a test with these parameters records, in stages or not."""
    rough = params is not None and params.material.platen_friction is not None
    there = {"", STAGES if staged else "", ROUGH if rough else ""}
    absent = {name for name, about in RECORDS.items() if about.of not in there}
    fields_of: dict[str, Any] = {name: None if name in absent else np.zeros(0) for name in Observation._fields}
    return Observation(**fields_of)


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
    taken = {name: getattr(seen, name) for name in RECORDS if name in Observation._fields}
    return Curve(
        axial_strain=1 - seen.height / seen.height[0],
        volumetric_strain=1 - seen.volume / seen.volume[0],
        confinement=balance,
        status=status,
        **taken,
    )
