"""From balls to contacts and from contacts to balls: the two ways in which every derivative goes as well.

The slots of a ball are the inverse of the contacts' first and second balls. So each of the two functions is the other's
transpose, but for what is listed more or less than twice: a ball on the axis has a contact with a ball off it once for
each image, and a contact of a ball with its own image at half a turn is its own mirror image, and acts on it once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from axijax.core.gather import IN_BOUNDS, Arrays, Linear, linear
from axijax.core.once import computed_once
from axijax.core.vector import Vector

if TYPE_CHECKING:
    from axijax.mechanics.contact_list import ContactList


def at_ends(network: "ContactList", numbers: Arrays) -> list[jax.Array]:
    """Numbers of the balls, arrays (N,), at the contacts' first balls, and then all of them at the second; (C,)."""
    shared: tuple[jax.Array, ...] = ()
    if network.sector.images > 1:
        share = jnp.where(_axial(network), 1 / network.sector.images, 1.0)
        shared = share.astype(network.dtype), _own_mirror(network)

    def tables(slots):
        return network.first, network.second, slots.slot, slots.side, *shared

    more = _further(network, tables)
    return linear(_Rest(_at_ends, len(more)), _Sums(_from_ends, len(more)), (*more, *tables(network)), numbers)


def on_balls(network: "ContactList", vectors: Vector, reaction: float) -> list[jax.Array]:
    """Components (N,) of the sum of the contacts' vectors (C,) on each ball, times `reaction` on the second ball."""
    turned = network.sector.images > 1

    def tables(slots):
        factor = slots.side if reaction < 0 else jnp.abs(slots.side)
        turn = (factor * slots.slot_cos, factor * slots.slot_sin) if turned else ()
        return slots.slot, factor, *turn

    listed = (network.image >= 0).astype(network.dtype)
    ends = network.first, network.second
    rows, transpose = (_turned_rows, _from_balls_turned) if turned else (_rows, _from_balls)
    given: tuple[jax.Array, ...]
    if turned:
        axial, mirror = _axial(network), _own_mirror(network)
        back = reaction * jnp.where(mirror, 0.0, listed)
        across, along = jnp.where(axial, 0.0, back), jnp.where(axial, network.sector.images * back, back)
        given = *ends, network.cos, network.sin, listed, across, along
    else:
        given = *ends, listed, reaction * listed
    more = _further(network, tables)
    fixed = *more, *tables(network), *given
    return linear(_Sums(rows, len(more)), _Rest(transpose, len(more)), fixed, tuple(vectors))


def _further(network: "ContactList", tables: Callable[[Any], Arrays]) -> tuple[jax.Array, ...]:
    """Tables of the crowd's slots, behind its columns; none where the list has no crowd."""
    crowd = network.crowd
    return () if crowd is None else (crowd.column, *tables(crowd))


@dataclass(frozen=True)
class _Rest:
    """A function that knows nothing of the `crowd` first tables."""

    function: Linear
    crowd: int

    def __call__(self, fixed, values):
        return self.function(fixed[self.crowd :], values)


@dataclass(frozen=True)
class _Sums:
    """Sums (N,) over the slots, of the (K, N) that `rows` gives for tables and values.

    crowd: number of tables of further slots, which come first.
    """

    rows: Linear
    crowd: int

    def __call__(self, fixed, values):
        sums = self._summed(fixed[self.crowd :], values)
        if not self.crowd:
            return sums
        column, *tables = fixed[: self.crowd]
        further = computed_once(self._summed(tables, values), column[0] >= 0)
        return [one + more.at[column].get(**IN_BOUNDS) for one, more in zip(sums, further, strict=True)]

    def _summed(self, tables, values):
        return [each.sum(axis=0) for each in self.rows(tables, values)]


def _axial(network: "ContactList") -> jax.Array:
    """Contacts of a ball off the axis with one on it, which are in a slot of that one for each image; (C,) bool."""
    on_axis = network.free.x == 0
    first, second = (on_axis.at[ball].get(**IN_BOUNDS) for ball in (network.first, network.second))
    return second & ~first


def _own_mirror(network: "ContactList") -> jax.Array:
    """Contacts of a ball with its own image at half a turn, which are in one slot; (C,) bool."""
    half = (2 * network.image) % network.sector.order == 0
    return (network.first == network.second) & half & (network.image >= 0)


def _at_ends(fixed, values):
    first, second, *_ = fixed
    return [each.at[ball].get(**IN_BOUNDS) for ball in (first, second) for each in values]


def _from_ends(fixed, values):
    first, _, slot, side, *shared = fixed
    half = len(values) // 2
    ours, theirs = values[:half], values[half:]
    if shared:
        share, mirror = shared
        ours = [one + jnp.where(mirror, other, 0) for one, other in zip(ours, theirs, strict=True)]
        theirs = [each * share for each in theirs]
    index = slot + first.size * (side < 0)

    def gathered(one, other):
        there = jnp.concatenate([one, other]).at[index].get(**IN_BOUNDS)
        return jnp.where(side != 0, there, 0)

    return [gathered(*each) for each in zip(ours, theirs, strict=True)]


def _rows(fixed, values):
    slot, factor, *_ = fixed
    return list(Vector(*values).at(slot) * factor)


def _from_balls(fixed, values):
    _, _, first, second, listed, back = fixed
    vectors = Vector(*values)
    return list(vectors.at(first) * listed + vectors.at(second) * back)


def _turned_rows(fixed, values):
    slot, factor, cos, sin, *_ = fixed
    there = Vector(*values).at(slot)
    return [cos * there.x - sin * there.y, sin * there.x + cos * there.y, factor * there.z]


def _from_balls_turned(fixed, values):
    *_, first, second, cos, sin, listed, across, along = fixed
    vectors = Vector(*values)
    theirs = vectors.at(second).turned(cos, sin)
    return list(vectors.at(first) * listed + Vector(theirs.x * across, theirs.y * across, theirs.z * along))
