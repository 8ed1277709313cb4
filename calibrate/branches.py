"""Curves that turn back: unloading and reloading, compared branch by branch.

A branch is what lies between two reversals of the axial strain. A measured and a simulated specimen do not turn at
quite the same strain, and where they have turned R changes steeply: so a branch is compared by the strain travelled
since its own reversal, the first one by the strain itself. A reversal is one by more than TURN of the strains' range;
less is scatter of a gauge or of a servo.
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

TURN = 2e-3  # of the range of the strain, by which it must go back to have turned
SHORT = 0.02  # of a branch, by which a simulated one may be shorter than the measured; its end is held there
POINTS = 401  # of a branch that is seen by itself


def reversals(strain, least: float) -> list[int]:
    """Places at which (T,) axial strains turn back by more than `least` (host)."""
    found, direction, extreme, place = [], 0, float(strain[0]), 0
    for here, value in enumerate(np.asarray(strain, float).tolist()):
        if direction == 0:
            if abs(value - strain[0]) > least:
                direction, extreme, place = (1 if value > strain[0] else -1), value, here
        elif direction * (value - extreme) > 0:
            extreme, place = value, here
        elif direction * (extreme - value) > least:
            found.append(place)
            direction, extreme, place = -direction, value, here
    return found


def travelled(strain):
    """Strain travelled to and fro, (T,) from 0 [-]."""
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(jnp.asarray(strain))))])


def first_reversals(strain, number: int):
    """(number,) places of the first reversals of (T,) strains, as `reversals` by TURN of their range; T - 1 where there
    are no more. Traceable, without a derivative."""
    strain = jax.lax.stop_gradient(jnp.asarray(strain))
    least = TURN * (strain.max() - strain.min())
    last = strain.size - 1

    def look(carry, here):
        direction, extreme, place, count, found = carry
        value = strain[here]
        begun = (direction == 0) & (jnp.abs(value - strain[0]) > least)
        further = begun | (direction * (value - extreme) > 0)
        turned = ~further & (direction * (extreme - value) > least)
        found = jnp.where(turned, found.at[count].set(place, mode="drop"), found)
        direction = jnp.where(begun, jnp.sign(value - strain[0]), jnp.where(turned, -direction, direction))
        new = further | turned
        return (
            direction, jnp.where(new, value, extreme), jnp.where(new, here, place), count + turned, found,
        ), None  # fmt: skip

    zero = jnp.zeros((), int)
    start = jnp.zeros_like(strain[0]), strain[0], zero, zero, jnp.full(number, last)
    return jax.lax.scan(look, start, jnp.arange(strain.size))[0][-1]


@dataclass(frozen=True)
class Places:
    """Where on a path M points lie. branch: (M,) which, from 0. since: (M,) strain travelled since its reversal, in the
    first branch since no strain [-]. length: (M,) of the branch."""

    branch: np.ndarray
    since: np.ndarray
    length: np.ndarray

    @classmethod
    def of(cls, strain) -> "Places":
        """Of (M,) measured strains (host)."""
        strain = np.asarray(strain, float)
        turns = reversals(strain, TURN * np.ptp(strain))
        branch = np.searchsorted(turns, np.arange(strain.size), side="left")
        begins = np.concatenate([[0.0], strain[turns]])
        ends = np.concatenate([strain[turns], strain[-1:]])
        return cls(branch, np.abs(strain - begins[branch]), np.abs(ends - begins)[branch])

    def read(self, curve, *fields: str) -> list[jax.Array]:
        """What a simulated curve has in its fields at these places, (M,) each; NaN where it does not come that far."""
        path = travelled(curve.axial_strain)
        turns = first_reversals(curve.axial_strain, int(self.branch.max()) + 1)
        marks = path[jnp.concatenate([jnp.zeros(1, int), turns])]
        begin, end = marks[self.branch], marks[self.branch + 1]
        wanted = begin + self.since
        there = (wanted <= end + SHORT * self.length) & (end > begin)
        at = jnp.minimum(wanted, end)
        return [jnp.where(there, jnp.interp(at, path, jnp.asarray(getattr(curve, name))), jnp.nan) for name in fields]


@dataclass(frozen=True)
class OnBranch:
    """A functional of one branch of a curve, whose axial strain is that travelled since the branch began: the slope of
    an unloading, say, OnBranch(InitialSlope(0, 2e-4), 1).

    of: functional of a curve, as in `calibrate.targets`. branch: which, from 0, the first loading. Raises ValueError
    for one below 0.
    """

    of: Any
    branch: int = 1

    def __post_init__(self):
        if isinstance(self.branch, bool) or not isinstance(self.branch, int) or self.branch < 0:
            raise ValueError(f"branch = {self.branch!r}: must be a whole number, 0 is the first loading.")

    @property
    def name(self) -> str:
        return f"{getattr(self.of, 'name', 'functional')}, branch {self.branch}"

    def _alone(self, curve) -> SimpleNamespace:
        path = travelled(curve.axial_strain)
        marks = path[jnp.concatenate([jnp.zeros(1, int), first_reversals(curve.axial_strain, self.branch + 1)])]
        begin, end = marks[self.branch], marks[self.branch + 1]
        since = jnp.linspace(0.0, 1.0, POINTS) * (end - begin)
        names = ("stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain", "void_ratio")
        there = {name: getattr(curve, name) for name in names if getattr(curve, name, None) is not None}
        seen = {name: jnp.interp(begin + since, path, jnp.asarray(values)) for name, values in there.items()}
        return SimpleNamespace(axial_strain=since, **seen)

    def __call__(self, curve):
        return self.of(self._alone(curve))

    def trouble(self, curve) -> str | None:
        """Why a finished curve has no such number."""
        from calibrate.targets import trouble

        found = len(reversals(curve.axial_strain, TURN * np.ptp(np.asarray(curve.axial_strain))))
        if found < self.branch:
            return f"it turns back {found} time(s), so that it has no branch {self.branch}"
        return trouble(self.of, self._alone(curve))
