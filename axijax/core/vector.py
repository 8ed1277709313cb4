"""Vectors as three separate arrays of components.

XLA's CPU compiler writes one loop per array: with the components apart, one pass over the contacts makes all of a
contact's results, where a stacked (3, ...) array would be assembled by branches that each recompute the whole chain.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.gather import IN_BOUNDS


def per_root(square: jax.Array) -> jax.Array:
    """1/sqrt(square). Written like this since XLA makes a reciprocal root of that one, which its CPU compiler computes
    number by number, four times as slowly as a root and a division."""
    return jnp.sqrt(square) / square


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Vector:
    """Three arrays of the same shape; a pytree. `numpy.asarray(vector)` is the (3, ...) array."""

    x: jax.Array
    y: jax.Array
    z: jax.Array

    def __iter__(self) -> Iterator[jax.Array]:
        return iter((self.x, self.y, self.z))

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.stack([np.asarray(component, dtype) for component in self])

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, scalar) -> "Vector":
        return Vector(self.x * scalar, self.y * scalar, self.z * scalar)

    def dot(self, other: "Vector") -> jax.Array:
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def turned(self, cos, sin) -> "Vector":
        """Rotated about z by the angle of this cosine and sine."""
        return Vector(cos * self.x - sin * self.y, sin * self.x + cos * self.y, self.z)

    def map(self, function: Callable[[jax.Array], jax.Array]) -> "Vector":
        return Vector(function(self.x), function(self.y), function(self.z))

    def at(self, index: jax.Array) -> "Vector":
        """The vectors at these places, which must all exist."""
        return self.map(lambda component: component.at[index].get(**IN_BOUNDS))


def from_rows(rows) -> Vector:
    """Vector from the rows of a (3, ...) array."""
    return Vector(*(jnp.asarray(row) for row in rows))


def zeros(shape, dtype) -> Vector:
    return Vector(*(jnp.zeros(shape, dtype) for _ in range(3)))
