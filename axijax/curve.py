"""The record of a test, and what is said of one that went wrong."""

import warnings
from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.confinement import Confinement
from axijax.observe import Observation
from axijax.status import NOT_FINITE, REMEDIES, UNSTABLE

CHATTER = 1e-3  # `observe.chatter` of a sound run is below zero; above this, contacts chatter


class SimulationError(RuntimeError):
    """A run that went wrong; says what happened and what to do. `curve` holds what was computed."""

    def __init__(self, message: str, curve: "Curve | None"):
        super().__init__(message)
        self.curve = curve


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Curve:
    """The record of a test: fields of T values, compression positive. Stress ratios as in `observe.Observation`.

    axial_strain: shortening over the height at the end of confinement [-].
    volumetric_strain: loss of volume over the volume at the end of confinement [-]; what the volume is, see
        `axijax.volume`.
    void_ratio: counted below the skin, as there [-].
    confinement: what was observed at the end of confinement; stress_error there is |s1 - s3| / s3.
    status: bits, zero for a sound run (see `raise_for_status`).
    """

    axial_strain: jax.Array
    stress_ratio: jax.Array
    virial_ratio: jax.Array
    core_ratio: jax.Array
    volumetric_strain: jax.Array
    void_ratio: jax.Array
    coordination_number: jax.Array
    unbalanced_force: jax.Array
    sliding_fraction: jax.Array
    chatter: jax.Array
    membrane_radius: jax.Array
    confinement: Confinement
    status: jax.Array


# The fields of a curve that hold one value a record.
RECORDS = tuple(f.name for f in fields(Curve) if f.name not in ("confinement", "status"))


def raise_for_status(status, curve: Curve | None = None) -> None:
    """Raise SimulationError, naming what went wrong and what to do, unless a curve's status bits are all zero."""
    bits = int(np.bitwise_or.reduce(np.asarray(status).ravel()))
    if bits & NOT_FINITE:  # of which all others are consequences
        bits = NOT_FINITE
    if bits:
        reasons = [text for bit, text in REMEDIES.items() if bits & bit]
        raise SimulationError("the test went wrong: " + "; ".join(reasons) + ".", curve)


def no_records() -> Observation:
    """An observation of no moment at all."""
    empty: Any = np.zeros(0)
    return Observation(*[empty] * len(Observation._fields))


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
    return Curve(
        axial_strain=1 - seen.height / seen.height[0],
        stress_ratio=seen.stress_ratio,
        virial_ratio=seen.virial_ratio,
        core_ratio=seen.core_ratio,
        volumetric_strain=1 - seen.volume / seen.volume[0],
        void_ratio=seen.void_ratio,
        coordination_number=seen.coordination_number,
        unbalanced_force=seen.unbalanced_force,
        sliding_fraction=seen.sliding_fraction,
        chatter=seen.chatter,
        membrane_radius=seen.membrane_radius,
        confinement=balance,
        status=status,
    )
