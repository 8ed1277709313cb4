"""From balls to contacts and from contacts to balls: the two ways in which every derivative goes as well.

The slots of a ball are the inverse of the contacts' first and second balls. So each of the two functions is the other's
transpose, but for what is listed more or less than twice: a ball on the axis has a contact with a ball off it once for
each image, and a contact of a ball with its own image at half a turn is its own mirror image, and acts on it once.
"""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from axijax.core.gather import IN_BOUNDS, Arrays, linear
from axijax.core.once import computed_once
from axijax.core.vector import Vector

if TYPE_CHECKING:
    from axijax.mechanics.contact_list import ContactList


def at_ends(network: "ContactList", numbers: Arrays) -> list[jax.Array]:
    """Numbers of the balls, arrays (N,), at the contacts' first balls, and then all of them at the second; (C,)."""
    tables: tuple[jax.Array, ...] = (network.first, network.second, network.slot, network.side)
    if network.sector.images > 1:
        share = jnp.where(_axial(network), 1 / network.sector.images, 1.0)
        tables = *tables, share.astype(network.dtype), _own_mirror(network)
    if crowd := network.crowd:
        tables = crowd.ball, crowd.column, crowd.slot, crowd.side, *tables
        return linear(_at_ends_crowded, _from_ends_crowded, tables, numbers)
    return linear(_at_ends, _from_ends, tables, numbers)


def on_balls(network: "ContactList", vectors: Vector, reaction: float) -> list[jax.Array]:
    """Components (N,) of the sum of the contacts' vectors (C,) on each ball, times `reaction` on the second ball."""
    signed = (lambda side: side) if reaction < 0 else jnp.abs
    factor, crowd = signed(network.side), network.crowd
    tables: tuple[jax.Array, ...]
    listed = (network.image >= 0).astype(network.dtype)
    ends = network.first, network.second
    if network.sector.images == 1:
        tables = network.slot, factor, *ends, listed, reaction * listed
        if crowd:
            tables = crowd.ball, crowd.column, crowd.slot, signed(crowd.side), *tables
            return linear(_sum_crowded, _from_balls_crowded, tables, tuple(vectors))
        return linear(_sum, _from_balls, tables, tuple(vectors))
    axial, mirror = _axial(network), _own_mirror(network)
    back = reaction * jnp.where(mirror, 0.0, listed)
    across, along = jnp.where(axial, 0.0, back), jnp.where(axial, network.sector.images * back, back)
    turn = factor * network.slot_cos, factor * network.slot_sin
    tables = network.slot, factor, *turn, *ends, network.cos, network.sin, listed, across, along
    if crowd:
        factor = signed(crowd.side)
        more = crowd.ball, crowd.column, crowd.slot, factor, factor * crowd.slot_cos, factor * crowd.slot_sin
        return linear(_turned_sum_crowded, _from_balls_turned_crowded, (*more, *tables), tuple(vectors))
    return linear(_turned_sum, _from_balls_turned, tables, tuple(vectors))


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


def _rows_from_ends(fixed, values):
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


def _from_ends(fixed, values):
    return _summed(_rows_from_ends(fixed, values))


def _rows(fixed, values):
    slot, factor, *_ = fixed
    return Vector(*values).at(slot) * factor


def _sum(fixed, values):
    return _summed(_rows(fixed, values))


def _summed(rows):
    """Sums over the slots, in their order."""
    return [each.sum(axis=0) for each in rows]


def _with_crowd(sums, rows, ball, column):
    """Sums (N,) that go on, for a crowd's balls, with the (R, M) rows of their further slots. One slot after the other,
    as one table of up to 18 rows is summed, so that bits do not hang on where the first table ends."""
    sums = computed_once(sums, ball[0] >= 0)
    begun = [each.at[ball].get(**IN_BOUNDS)[None] for each in sums]
    whole = computed_once(_summed(map(jnp.concatenate, zip(begun, rows, strict=True))), ball[0] >= 0)
    crowded = column < ball.size - 1
    return [jnp.where(crowded, new.at[column].get(**IN_BOUNDS), one) for one, new in zip(sums, whole, strict=True)]


def _sum_crowded(fixed, values):
    ball, column, slot, factor, *tables = fixed
    return _with_crowd(_sum(tables, values), _rows((slot, factor), values), ball, column)


def _from_balls_crowded(fixed, values):
    return _from_balls(fixed[4:], values)


def _at_ends_crowded(fixed, values):
    return _at_ends(fixed[4:], values)


def _from_ends_crowded(fixed, values):
    ball, column, slot, side, *tables = fixed
    first, second, _, _, *shared = tables
    more = _rows_from_ends((first, second, slot, side, *shared), values)
    return _with_crowd(_from_ends(tables, values), more, ball, column)


def _from_balls(fixed, values):
    _, _, first, second, listed, back = fixed
    vectors = Vector(*values)
    return list(vectors.at(first) * listed + vectors.at(second) * back)


def _turned_rows(fixed, values):
    slot, factor, cos, sin, *_ = fixed
    there = Vector(*values).at(slot)
    return Vector(cos * there.x - sin * there.y, sin * there.x + cos * there.y, factor * there.z)


def _turned_sum(fixed, values):
    return _summed(_turned_rows(fixed, values))


def _turned_sum_crowded(fixed, values):
    ball, column, slot, factor, cos, sin, *tables = fixed
    return _with_crowd(_turned_sum(tables, values), _turned_rows((slot, factor, cos, sin), values), ball, column)


def _from_balls_turned_crowded(fixed, values):
    return _from_balls_turned(fixed[6:], values)


def _from_balls_turned(fixed, values):
    *_, first, second, cos, sin, listed, across, along = fixed
    vectors = Vector(*values)
    theirs = vectors.at(second).turned(cos, sin)
    return list(vectors.at(first) * listed + Vector(theirs.x * across, theirs.y * across, theirs.z * along))
