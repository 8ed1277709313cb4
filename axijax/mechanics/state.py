"""What a step carries: motion of the balls and platens, and the memory of every term."""

from typing import NamedTuple

import jax

from axijax.core.vector import Vector
from axijax.mechanics.term import Memory


class State(NamedTuple):
    """What a step carries; a pytree.

    displacement: (N,) vectors from the network's reference positions, at time t [L].
    velocity: (N,) vectors at t - dt/2 [L/T].
    spin: (N,) angular velocities at t - dt/2 [1/T]; None where nothing spins.
    memory: of each term, in the terms' order.
    platens: (2,) heights of the bottom and the top platen at t, float64 whatever the rest is: a step moves them by
        less than the rounding of a float32 height [L].
    platen_speeds: (2,) their velocities at t - dt/2 [L/T], upward positive.
    time: () since the stage began [T].
    """

    displacement: Vector
    velocity: Vector
    spin: Vector | None
    memory: tuple[Memory, ...]
    platens: jax.Array
    platen_speeds: jax.Array
    time: jax.Array

    @property
    def spring(self) -> Vector | None:
        """(C,) tangential springs of the contacts [L]; None without friction."""
        return self.memory[0].contact

    def with_spring(self, spring: Vector | None) -> "State":
        """The state with these tangential springs in the contacts."""
        return self._replace(memory=(self.memory[0]._replace(contact=spring), *self.memory[1:]))
