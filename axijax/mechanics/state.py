"""What a step carries: motion of the balls and platens, the memory of every term, and of the path that loads them."""

from typing import Any, NamedTuple

import jax

from axijax.core.shown import shown
from axijax.core.vector import Vector
from axijax.mechanics.term import Memory


class Loading(NamedTuple):
    """What a path remembers that commands the lateral stress; scalars, compression positive.

    lateral_stress: effective, with which the membrane presses the balls [F/L^2].
    pore_pressure: of a fluid that cannot leave, or that would keep the volume as the path does [F/L^2].
    lateral_strain: natural, of what the membrane loads, conjugate to its work; kept by paths that need it [-].
    path_length: axial strain travelled since the end of confinement, to and fro [-].
    error: how far off the path the servo is, as a stress over the confining stress [-].
    height: distance of the platens at the end of confinement [L].
    stage: number of the stage, from 1. memory: of its path.
    """

    lateral_stress: jax.Array
    pore_pressure: jax.Array
    lateral_strain: jax.Array
    path_length: jax.Array
    error: jax.Array
    height: jax.Array
    stage: jax.Array
    memory: Any = None


@shown
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
    loading: of a path that commands the lateral stress; None where that is the confining stress throughout.
    """

    displacement: Vector
    velocity: Vector
    spin: Vector | None
    memory: tuple[Memory, ...]
    platens: jax.Array
    platen_speeds: jax.Array
    time: jax.Array
    loading: Loading | None = None

    @property
    def spring(self) -> Vector | None:
        """(C,) tangential springs of the contacts [L]; None without friction."""
        return self.memory[0].contact

    def lateral_stress(self, params) -> jax.Array | float:
        """With which the membrane presses at this moment [F/L^2]."""
        if self.loading is None:
            return params.confining_stress
        return self.loading.lateral_stress.astype(self.displacement.x.dtype)

    def with_spring(self, spring: Vector | None) -> "State":
        """The state with these tangential springs in the contacts."""
        return self._replace(memory=(self.memory[0]._replace(contact=spring), *self.memory[1:]))
