"""From balls to contacts and from contacts to balls: the two ways in which every derivative goes as well.

The slots of a ball are the inverse of the contacts' first and second balls. So each of the two functions is the other's
transpose, but for what is listed more or less than twice: a ball on the axis has a contact with a ball off it once for
each image, and a contact of a ball with its own image at half a turn is its own mirror image, and acts on it once.
"""

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from axijax.core.gather import IN_BOUNDS, Arrays, linear
from axijax.core.vector import Vector

if TYPE_CHECKING:
    from axijax.mechanics.contact_list import ContactList


def at_ends(network: "ContactList", numbers: Arrays) -> list[jax.Array]:
    """Numbers of the balls, arrays (N,), at the contacts' first balls, and then all of them at the second; (C,)."""
    tables: tuple[jax.Array, ...] = (network.first, network.second, network.slot, network.side)
    if network.sector.images > 1:
        share = jnp.where(_axial(network), 1 / network.sector.images, 1.0)
        tables = *tables, share.astype(network.dtype), _own_mirror(network)
    return linear(_at_ends, _from_ends, tables, numbers)


def on_balls(network: "ContactList", vectors: Vector, reaction: float) -> list[jax.Array]:
    """Components (N,) of the sum of the contacts' vectors (C,) on each ball, times `reaction` on the second ball."""
    factor = network.side if reaction < 0 else jnp.abs(network.side)
    listed = (network.image >= 0).astype(network.dtype)
    ends = network.first, network.second
    if network.sector.images == 1:
        return linear(_sum, _from_balls, (network.slot, factor, *ends, listed, reaction * listed), tuple(vectors))
    axial, mirror = _axial(network), _own_mirror(network)
    back = reaction * jnp.where(mirror, 0.0, listed)
    across, along = jnp.where(axial, 0.0, back), jnp.where(axial, network.sector.images * back, back)
    turn = factor * network.slot_cos, factor * network.slot_sin
    tables = network.slot, factor, *turn, *ends, network.cos, network.sin, listed, across, along
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


def _from_ends(fixed, values):
    first, _, slot, side, *shared = fixed
    half = len(values) // 2
    ours, theirs = values[:half], values[half:]
    if shared:
        share, mirror = shared
        ours = [one + jnp.where(mirror, other, 0) for one, other in zip(ours, theirs, strict=True)]
        theirs = [each * share for each in theirs]
    index = slot + first.size * (side < 0)

    def summed(one, other):
        there = jnp.concatenate([one, other]).at[index].get(**IN_BOUNDS)
        return jnp.where(side != 0, there, 0).sum(axis=0)

    return [summed(*each) for each in zip(ours, theirs, strict=True)]


def _sum(fixed, values):
    slot, factor, *_ = fixed
    there = Vector(*values).at(slot) * factor
    return [component.sum(axis=0) for component in there]


def _from_balls(fixed, values):
    _, _, first, second, listed, back = fixed
    vectors = Vector(*values)
    return list(vectors.at(first) * listed + vectors.at(second) * back)


def _turned_sum(fixed, values):
    slot, factor, cos, sin, *_ = fixed
    there = Vector(*values).at(slot)
    there = Vector(cos * there.x - sin * there.y, sin * there.x + cos * there.y, factor * there.z)
    return [component.sum(axis=0) for component in there]


def _from_balls_turned(fixed, values):
    *_, first, second, cos, sin, listed, across, along = fixed
    vectors = Vector(*values)
    theirs = vectors.at(second).turned(cos, sin)
    return list(vectors.at(first) * listed + Vector(theirs.x * across, theirs.y * across, theirs.z * along))
