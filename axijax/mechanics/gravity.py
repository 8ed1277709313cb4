"""Gravity as a term: a constant acceleration of every ball, `Params(terms=(Gravity(),))`."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.core.vector import Vector
from axijax.mechanics.term import Push, Spent, Term, share_of_sector


@pytree
@dataclass(frozen=True)
class Gravity(Term):
    """Weight of the balls; along -z by default.

    Components across the axis make sense in the full cylinder only, since the images of a ball share its accelerations,
    each turned. Both platens of a triaxial test are carried by s3 in confinement, so that a heavy specimen finds no
    equilibrium between them; gravity is for scenes with platens that stand, and for weights that are small beside s3.
    Weights are the true ones where masses are scaled (`axijax.mechanics.mass_scaling`).
    """

    gravity_z: jax.Array | float = quantity(-9.81, "acceleration along z", "L/T^2", least=-jnp.inf, coordinate="linear")
    gravity_x: jax.Array | float = quantity(0.0, "acceleration along x", "L/T^2", least=-jnp.inf, coordinate="linear")
    gravity_y: jax.Array | float = quantity(0.0, "acceleration along y", "L/T^2", least=-jnp.inf, coordinate="linear")

    stiffens = False
    acts_apart = False

    def check(self, sector):
        if sector.order > 1 and (self.gravity_x != 0 or self.gravity_y != 0):
            raise ValueError(
                f"gravity across the axis in a sector of order {sector.order}: its images would fall each in its own "
                "direction; take order 1, the full cylinder, or gravity_z alone."
            )

    def forces(self, params, network, dt, state, memory) -> Push:
        mass = params.material.mass_per_cube * network.radius**3
        return Push(Vector(mass * self.gravity_x, mass * self.gravity_y, mass * self.gravity_z))

    def spent(self, params, network, dt, state, memory, push, mean) -> Spent:
        return Spent(work=dt * share_of_sector(network, push.force.dot(mean.velocity)))
