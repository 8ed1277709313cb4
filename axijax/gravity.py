"""Gravity as a term: a constant acceleration of every ball. Given to a test by `Params(terms=(Gravity(...),))`."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from axijax.neighbors import Network
from axijax.quantity import quantity
from axijax.term import Push, Spent, Term, share_of_sector
from axijax.vector import Vector


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Gravity(Term):
    """Weight along -z, and for tilted scenes along x and y; those need the full cylinder (n = 1), since a sector's images
    would fall each in its own direction.

    bulk_density: of the balls, that of the material [M/L^3].
    """

    gravity: jax.Array | float = quantity(9.81, "acceleration of gravity, along -z", "L/T^2", least=-jnp.inf)
