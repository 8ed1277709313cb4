"""A tight list: of a contact list's pairs those that can touch during the next few steps, found inside jit.

In a random packing the contact list holds twice as many pairs as touch, so that it lasts, and a pair costs as much
whether it touches or not. So steps see only the pairs whose gap their balls can close in a while. Every ball is allowed
so much displacement (`allowances`), a pair is kept where its gap is smaller than what its two balls are allowed
together, and as long as no ball has moved by more than it was allowed (`Tight.holds`), no contact is missing: images
move as far as their balls do. In a slow test that would be true for many records, but each record begins with a list
of its own (`axijax.triaxial.tight_steps`). A pair that does not touch has no force and an unstrained spring, and
contacts keep their order, so that a step gives the same result to rounding whichever of the two lists it sees.

Contacts and slots of the tight list have a fixed room; where that does not suffice it says so (`Tight.fits`), and the
contact list itself has to be used.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.gather import taken
from axijax.core.vector import Vector
from axijax.mechanics.contact_list import ContactList, Crowd, closing
from axijax.mechanics.contacts import geometry
from axijax.mechanics.term import Memory

STEPS = 50  # most steps that are taken before it is found out whether the list held
SLACK = 0.01  # by which any ball may move between two filterings, in radii of the smallest ball
FASTER = 2.0  # times what it would move at its present speed, which it may move besides


class Tight(NamedTuple):
    """A tight list, and what leads from and to the contact list that it was filtered from.

    network: the list, with the reference positions and the sector of the contact list; () and (C',) arrays.
    place: (C',) int, of each of its contacts in the contact list; the last, never closed, where there is none.
    found_at: (C,) int, of each contact of the contact list in this one; the last where it is not there.
    start: (N,) displacements at which it was made [L]. allowed: (N,) how far each ball may move from there [L].
    closed: the most by which two balls can have come closer since the contact list was built, while this one holds [L].
    fits: whether it holds all that it should.
    """

    network: ContactList
    place: jax.Array
    found_at: jax.Array
    start: Vector
    allowed: jax.Array
    closed: jax.Array
    fits: jax.Array

    def memory_in(self, memory: tuple[Memory, ...]) -> tuple[Memory, ...]:
        """The terms' memory, with that of contacts for this list; it was made for the contact list."""
        kept = self.found_at < self.place.size - 1
        parts, structure = jax.tree.flatten([each.contact for each in memory])
        inside = jax.tree.unflatten(structure, taken(parts, self.place, self.found_at, kept))
        return tuple(each._replace(contact=contact) for each, contact in zip(memory, inside, strict=True))

    def memory_out(self, memory: tuple[Memory, ...], before: tuple[Memory, ...]) -> tuple[Memory, ...]:
        """The terms' memory for the contact list again; `before`, what it was, where this list lacks the contact."""
        kept, real = self.found_at < self.place.size - 1, self.place < self.found_at.size - 1
        parts, structure = jax.tree.flatten([each.contact for each in memory])
        old = jax.tree.leaves([each.contact for each in before])
        found = taken(parts, self.found_at, self.place, real)
        outside = jax.tree.unflatten(structure, [jnp.where(kept, *each) for each in zip(found, old, strict=True)])
        return tuple(each._replace(contact=contact) for each, contact in zip(memory, outside, strict=True))

    def moved(self, displacement: Vector) -> jax.Array:
        """The square of how far each ball is from where it was when the list was made; (N,) [L^2]."""
        change = jax.lax.stop_gradient(displacement - self.start)
        return change.dot(change)

    def holds(self, farthest: jax.Array) -> jax.Array:
        """Whether no contact has been missed, balls having been so far away; farthest: (N,) as `moved` [L^2]."""
        return self.fits & (farthest <= self.allowed**2).all()

    def lasts(self, displacement: Vector, velocity: Vector, dt, steps) -> jax.Array:
        """Whether it is likely to hold for so many steps more from these displacements and velocities."""
        ahead = jnp.sqrt(self.moved(displacement)) + _reach(velocity, dt, steps).astype(self.allowed.dtype)
        return self.fits & (ahead <= self.allowed).all()


def allowances(network: ContactList, velocity: Vector, dt, steps) -> jax.Array:
    """How far each ball may move in so many steps; (N,) [L]. velocity: (N,) vectors [L/T]; dt: of a step [T]."""
    return (_reach(velocity, dt, steps) + SLACK * network.radius.min()).astype(network.dtype)


def _reach(velocity: Vector, dt, steps) -> jax.Array:
    """How far each ball is expected to move at most, (N,) [L]; no derivative."""
    return jax.lax.stop_gradient(jnp.sqrt(velocity.dot(velocity)) * (FASTER * dt * steps))


def tighten(network: ContactList, displacement: Vector, allowed: jax.Array) -> Tight:
    """The pairs whose gap is smaller than what their balls may move together.

    displacement: (N,) vectors from the reference positions [L]; allowed: (N,) [L]. Needs `network.tight`.
    """
    assert network.tight is not None
    length, width, columns, further = network.tight
    nothing, balls = network.first.size - 1, network.radius.size
    still = jax.lax.stop_gradient(displacement)
    pair = geometry(network, still)
    first, second = (allowed.at[ball].get(mode="promise_in_bounds") for ball in (network.first, network.second))
    near = (pair.overlap + first + second > 0) & (network.image >= 0)
    order = jnp.cumsum(near, dtype=jnp.int32)
    found_at = jnp.where(near, jnp.minimum(order, length) - 1, length - 1)
    place = jnp.full(length, nothing, jnp.int32)
    place = place.at[jnp.where(near, order - 1, length)].set(
        jnp.arange(nothing + 1, dtype=jnp.int32), mode="drop", unique_indices=True
    )
    place = place.at[length - 1].set(nothing)

    there = found_at.at[network.slot].get(mode="promise_in_bounds")
    every = jnp.arange(balls, dtype=jnp.int32)
    chosen, number = _chosen(there < length - 1, 0, width)

    def slots(chosen, ball):
        """The tables of slots, whose rows are those of the contact list that are `chosen` for each `ball`."""
        there_is, index = chosen >= 0, jnp.maximum(chosen, 0) * balls + ball

        def of(table, without):
            return jnp.where(there_is, table.ravel().at[index].get(mode="promise_in_bounds"), without)

        made = {"slot": of(there, length - 1), "side": of(network.side, 0.0)}
        if network.sector.images > 1:
            return made | {"slot_cos": of(network.slot_cos, 1.0), "slot_sin": of(network.slot_sin, 0.0)}
        return made | {name: jnp.broadcast_to(value, chosen.shape) for name, value in _unturned(network)}

    crowded, crowd = number > width, None
    if columns:
        column = jnp.where(crowded, jnp.minimum(jnp.cumsum(crowded, dtype=jnp.int32), columns) - 1, columns - 1)
        ball = jnp.zeros(columns, jnp.int32).at[column].set(every).at[columns - 1].set(0)
        filled = (there < length - 1)[:, ball] & (jnp.arange(columns) < crowded.sum())
        crowd = Crowd(**slots(_chosen(filled, width, further)[0], ball), column=column)

    def contact(values):
        return values if values.ndim == 0 else taken([values], place, found_at, found_at < length - 1)[0]

    tight = replace(
        network,
        **{name: contact(getattr(network, name)) for name in OF_CONTACTS},
        branch=network.branch.map(contact),
        **slots(chosen, every),
        crowd=crowd,
        tight=None,
    )
    closed = closing(network, still, allowed)
    fits = (order[-1] <= length - 1) & (number.max() <= width + further) & (closed <= network.skin)
    fits &= crowded.sum() < max(columns, 1)
    return Tight(tight, place, found_at, still, allowed, closed, fits)


def _chosen(filled: jax.Array, begin: int, width: int) -> tuple[jax.Array, jax.Array]:
    """Of (K, B) slots that are filled or not: the row of the one that comes `begin`-th, and so on, of each ball, -1
    where there is none, (width, B); and how many there are, (B,)."""
    rows = begin + jnp.arange(width, dtype=jnp.int32)[:, None]

    def next_row(carry, row):
        chosen, number = carry
        slot, there = row
        return (jnp.where(there & (number == rows), slot, chosen), number + there), None

    start = jnp.full((width, filled.shape[1]), -1, jnp.int32), jnp.zeros(filled.shape[1], jnp.int32)
    return jax.lax.scan(next_row, start, (jnp.arange(filled.shape[0], dtype=jnp.int32), filled))[0]


OF_CONTACTS = ("first", "second", "image", "cos", "sin", "distance", "overlap", "pair_cube", "share")


def _unturned(network: ContactList):
    return ("slot_cos", jnp.ones((), network.dtype)), ("slot_sin", jnp.zeros((), network.dtype))


def near_pairs(network: ContactList) -> tuple[int, np.ndarray]:
    """What the tight lists of a contact list need room for while its balls move slowly: number of contacts, and (N,) of
    slots (host)."""
    reach = 3 * SLACK * float(network.radius.min())
    near = (np.asarray(network.overlap) > -reach) & (np.asarray(network.image) >= 0)
    return int(near.sum()), near[np.asarray(network.slot)].sum(axis=0)
