"""The sector: a cylinder divided by its rotations.

A cylinder with n-fold symmetry about z is represented by one sector of angle 2*pi/n. The images of a ball are
its rotations by k*2*pi/n, k = 0..n-1; position, velocity, spin and contact springs all rotate. A rotation and
never a mirror, so that a rigid swirl about z is force-free (Cui & O'Sullivan 2005, section 3.1 and figure 2;
there the image of (x, y, z) is (-y, x, z)). A contact is (ball i, ball j, image k), its force acts on ball i
alone and the same contact seen from j is (j, i, -k). n = 1 is the full cylinder.

For comparison only, the two sector planes may be rigid instead, and frictionless as in section 4.3 of the paper or
with a friction of their own; a ball then has no image but itself.
"""

from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.quantity import setting
from axijax.core.vector import Vector

Boundary = Literal["periodic", "rigid"]

# A ball whose centre is closer to the axis than this fraction of its radius is on it.
ON_AXIS = 1e-6
# Angles closer to a sector plane than this are on it [rad, or parts of a sector].
ON_PLANE = 1e-9


@dataclass(frozen=True)
class Sector:
    """One sector of a cylinder; static and hashable.

    order: number n of sectors in the full cylinder [-]; the sector spans theta in [0, 2*pi/n).
    boundary: "periodic" (images are rotations) or "rigid" (planes at theta = 0 and 2*pi/n).

    Raises ValueError for an order that is not a whole number >= 1, an unknown boundary, or rigid planes with
    order < 3 (their two planes would coincide, or enclose more than the half space of each).
    """

    order: int = setting(
        4, "number n of sectors in the full cylinder, each of theta in [0, 2*pi/n)", "-", least=1, most=1000, whole=True
    )
    boundary: Boundary = setting(
        "periodic", '"periodic" (images are rotations) or "rigid" (planes at theta = 0 and 2*pi/n)'
    )

    def __post_init__(self) -> None:
        if isinstance(self.order, bool) or not isinstance(self.order, int | np.integer) or self.order < 1:
            raise ValueError(
                f"sector order = {self.order!r}: must be a whole number n >= 1 (the sector spans 2*pi/n); "
                "use 4 for the paper's quarter or 1 for the full cylinder."
            )
        if self.boundary not in ("periodic", "rigid"):
            raise ValueError(f"sector boundary = {self.boundary!r}: must be 'periodic' or 'rigid'.")
        if self.boundary == "rigid" and self.order < 3:
            raise ValueError(
                f"sector order = {self.order} with rigid planes: must be >= 3, so that two distinct planes meet "
                "at the axis at less than 180 degrees; use periodic boundaries for a half or full cylinder."
            )

    @property
    def angle(self) -> float:
        """Angle of the sector, 2*pi/n [rad]."""
        return 2 * np.pi / self.order

    @property
    def images(self) -> int:
        """Number of images of each ball: n for periodic planes, 1 (the ball itself) for rigid ones."""
        return self.order if self.boundary == "periodic" else 1

    def cos_sin(self, k: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the rotation to image k, exact for quarter turns. k: any shape, any whole number."""
        angles = self.angle * (np.asarray(k) % self.order)
        exact = [np.where(np.abs(values) < 1e-15, 0.0, values) for values in (np.cos(angles), np.sin(angles))]
        return exact[0], exact[1]

    def rotate(self, vectors: np.ndarray, k: np.ndarray | int) -> np.ndarray:
        """Rotate vectors (3, ...) about z to image k (host, NumPy). k: broadcastable to vectors.shape[1:]."""
        (x, y, z), (cos, sin) = vectors, self.cos_sin(k)
        return np.stack([cos * x - sin * y, sin * x + cos * y, np.broadcast_to(z, np.shape(cos * x))])

    def angle_of(self, positions: np.ndarray) -> np.ndarray:
        """Polar angle of positions (3, N) in [0, 2*pi), rounding noise just below 2*pi counted as 0."""
        theta = np.mod(np.arctan2(positions[1], positions[0]), 2 * np.pi)
        return np.where(2 * np.pi - theta < ON_PLANE, 0.0, theta)

    def home_image(self, positions: np.ndarray) -> np.ndarray:
        """The image k that brings each ball of positions (3, N) into theta in [0, 2*pi/n); (N,) int.

        A ball on the plane theta = 2*pi/n belongs to theta = 0, to within rounding, so that it counts once.
        """
        turns = np.floor(self.angle_of(positions) / self.angle + ON_PLANE).astype(int)
        return (-turns) % self.order

    def on_axis(self, positions: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
        """Balls of positions (3, N) whose centre is on the axis (type F of the paper); (N,) bool.

        Such a ball is its own image. With n = 1, or with rigid planes, no ball is special.
        """
        distance = np.hypot(positions[0], positions[1])
        return (distance < ON_AXIS * np.asarray(radius)) & (self.images > 1)

    def weight(self, on_axis: np.ndarray) -> np.ndarray:
        """Share of each ball that belongs to the sector: 1, or 1/n on the axis; (N,) [-]."""
        return np.where(on_axis, 1.0 / self.images, 1.0)


def plane_normals(sector: Sector) -> np.ndarray:
    """Unit normals of the planes theta = 0 and theta = 2*pi/n that point into the sector; (2, 2), rows of x and y."""
    cos, sin = (float(value) for value in sector.cos_sin(1))
    return np.array([[0.0, 1.0], [sin, -cos]])


def radial_distance(positions: Vector) -> jax.Array:
    """Distance rho of positions (N,) from the axis [L], with a finite derivative (zero) on the axis."""
    square = positions.x**2 + positions.y**2
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
