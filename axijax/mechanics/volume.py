"""What the volume of a specimen is, from the positions of its balls and platens alone.

A lattice keeps its membrane zone, and its volume is pi Rm^2 H. The outer balls of a random specimen come and go, small
ones drop into pores, and no mean over whichever are outermost now can be followed through that: the volume of a random
specimen is that of its solids times 1 + e, the solids being known and the void ratio e being counted below the skin.

- A probe of one radius, the mean by mass, rolls over all balls from outside along radial lines. The surface that it
  leaves is smoothed over SMOOTH radii, and what sticks out of the smooth surface by more than a radius is cut off, so
  that a ball that has been squeezed out does not lift the surface.
- Between the platens, void and solid are counted with a weight that rises from 0 one radius below this surface to 1 two
  radii below it. At the surface itself a void ratio is a matter of where the membrane is drawn, and hardly changes.

The count is exact for the balls, up to the curvature of the surface over one of them. It knows no membrane zone and no
history, so that a ball that joins or leaves the zone changes nothing, and lists made anew do not either.
"""

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.sector import Sector, radial_distance
from axijax.core.vector import Vector

SPACING = 1.0  # of the points at which the surface is found, in radii of equal balls filling twice the height in width
SMOOTH = 1.5  # radii over which the surface is smoothed, as the standard deviation of a Gaussian
# Points and weights along a ball's diameter by which a cubic's mean over the ball is exact (Gauss-Gegenbauer).
NODES = ((0.0, 16 / 30), ((3 / 7) ** 0.5, 7 / 30), (-((3 / 7) ** 0.5), 7 / 30))


def solid_volume(radius: jax.Array, weight: jax.Array, sector: Sector) -> jax.Array:
    """Volume of all balls of the full cylinder [L^3]; radius, weight: (N,) of the sector's balls."""
    return sector.order * (4 / 3) * np.pi * (weight * radius**3).sum()


def void_ratio(place: Vector, radius: jax.Array, weight: jax.Array, sector: Sector, platens: jax.Array) -> jax.Array:
    """Volume of the voids over that of the solids below the specimen's skin, as in the head of this module [-].

    place: (N,) vectors, ball centres of any image each [L]; radius, weight: (N,) radii [L] and shares of the balls that
    belong to the sector; platens: (2,) heights [L]. NaN where nothing lies deep enough.
    """
    mean = (weight * radius**4).sum() / (weight * radius**3).sum()
    bottom, top = platens
    rho = radial_distance(place)
    off_axis = rho > 0
    angle = jnp.arctan2(place.y, jnp.where(off_axis, place.x, 1.0))
    surface = _surface(rho, angle, place.z, radius, mean, sector, bottom, top)
    depth = _between(surface, angle, (place.z - bottom) / (top - bottom), sector) - rho

    def weight_at(below):
        return jnp.clip(below / mean - 1, 0.0, 1.0)

    inside = sum(share * weight_at(depth + node * radius) for node, share in NODES)
    solid = (4 / 3) * np.pi * (weight * radius**3 * inside).sum()
    # Integral of weight times rho over rho, from the axis to the surface.
    to_one, to_two = (jnp.maximum(surface - deep * mean, 0.0) ** 3 / 6 for deep in (1, 2))
    space = sector.angle * (top - bottom) * ((to_one - to_two) / mean).mean()
    return jnp.where(solid > 0, space / jnp.where(solid > 0, solid, 1.0) - 1, jnp.nan)


def _surface(rho, angle, z, radius, mean, sector: Sector, bottom, top) -> jax.Array:
    """Distance of the skin from the axis at points spread evenly over angle and height, (A, Z) [L]."""
    across = (rho.size * sector.order) ** (1 / 3) / SPACING
    columns, rows = max(4, int(5.1 * across / sector.order)), max(4, int(3.24 * across))
    theta = jnp.asarray((np.arange(columns) + 0.5) * sector.angle / columns, rho.dtype)
    height = bottom + (top - bottom) * jnp.asarray((np.arange(rows) + 0.5) / rows, rho.dtype)
    reach = radius + mean

    def along_lines(rho, angle, theta):
        """Of lines at angle theta: how far out they pass the ball's centre, and how far beside it, squared."""
        aside = theta - angle
        if sector.boundary == "periodic":  # the nearest image stands out farthest
            aside = jnp.mod(aside + sector.angle / 2, sector.angle) - sector.angle / 2
        return rho * jnp.cos(aside), (rho * jnp.sin(aside)) ** 2

    def leaving(middle, beside, above, reach):
        """How far from the axis a line leaves the ball inflated by the probe; zero where it misses it."""
        square = reach**2 - beside - above**2
        met = (square > 0) & (middle > 0)
        return jnp.where(met, middle + jnp.sqrt(jnp.where(met, square, 1.0)), 0.0)

    middle, beside, heights, reaches = jax.lax.stop_gradient((*along_lines(rho, angle, theta[:, None]), z, reach))

    def outermost(level):
        return jnp.argmax(leaving(middle, beside, level - heights, reaches), axis=1)

    ball = jax.lax.map(outermost, jax.lax.stop_gradient(height)).T
    middle, beside = along_lines(rho[ball], angle[ball], theta[:, None])
    found = leaving(middle, beside, height - z[ball], reach[ball])
    rough = jnp.maximum(found - mean, 0.0)

    aside = jnp.abs(theta[:, None] - theta)
    if sector.boundary == "periodic":
        aside = jnp.minimum(aside, sector.angle - aside)
    around = _gaussian(rough.mean() * aside / (SMOOTH * mean))
    along = _gaussian((height[:, None] - height) / (SMOOTH * mean))

    def smooth(surface):
        return around @ surface @ along.T

    for _ in range(2):
        rough = jnp.minimum(rough, smooth(rough) + mean)
    return smooth(rough)


def _gaussian(distance) -> jax.Array:
    """Weights of a mean over places at these distances, in standard deviations; rows add up to one."""
    weights = jnp.exp(-(distance**2) / 2)
    return weights / weights.sum(axis=1, keepdims=True)


def _between(surface, angle, height, sector: Sector) -> jax.Array:
    """The surface at angles and heights (N,), the height as a share of the specimen's, interpolated linearly."""
    columns, rows = surface.shape
    x = angle / sector.angle * columns - 0.5
    x = jnp.mod(x, columns) if sector.boundary == "periodic" else jnp.clip(x, 0, columns - 1)
    y = jnp.clip(height * rows - 0.5, 0, rows - 1)
    left, below = (jax.lax.stop_gradient(jnp.floor(part)).astype(jnp.int32) for part in (x, y))
    right = (left + 1) % columns if sector.boundary == "periodic" else jnp.minimum(left + 1, columns - 1)
    left = left % columns  # a modulus may round up to its divisor
    above = jnp.minimum(below + 1, rows - 1)
    u, v = x - jnp.floor(x), y - below
    return (1 - u) * ((1 - v) * surface[left, below] + v * surface[left, above]) + u * (
        (1 - v) * surface[right, below] + v * surface[right, above]
    )
