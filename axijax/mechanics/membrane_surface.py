"""The membrane's surface rho(z), and what the confining stress pushes along z where the surface slopes.

A specimen as made is a cylinder. Its surface is, from then on,

    rho(z) = Rm + u(z) - mean of u over the height,

u(z) being the polynomial of degree DEGREE fitted to the radial displacements of the zone's balls since they were made,
each weighted by its cell. (Fitted to the displacements and not to the places: a lattice whose layers differ in width,
or a random specimen whose surface is rough by half a ball, has not barrelled.) A(z) is the sector's section, half the
sector's angle times rho squared. A membrane whose ends are tied to platens as wide as the specimen as made goes there
from A(z) to the platens' section within a ball's radius: s3 also presses on the ring by which the specimen's end
stands out.

The axial force on a ball is s3 times the integral of dA/dz over its cell, over the strip's width; by the divergence
theorem that is the integral of A n_z along the cell's sides. Every side between two cells is counted for both with
opposite signs, so the balls between any two heights together bear s3 times the difference of the sections there, to
rounding, whatever A(z) and however crude the quadrature; all of them s3 times that of the two ends.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import legendre

from axijax.core.gather import added, gathered
from axijax.core.sector import radial_distance
from axijax.core.vector import Vector

if TYPE_CHECKING:
    from axijax.mechanics.membrane import Load, Membrane

DEGREE = 4
GAUSS = 0.5 - 12**-0.5, 0.5 + 12**-0.5  # places on a side at which A is taken; exact for a cone
RIDGE = 1e-13  # of the mean square: balls at fewer heights than the fit has numbers have no best one


class Surface(NamedTuple):
    """What a membrane that follows its specimen's slope remembers.

    made: (N,) distance of every ball from the axis in the specimen as made [L].
    rim: radius of the platens to which the ends are tied [L]; None where they are free, as is the next.
    ring: height over which a tied end narrows, a ball's radius [L].
    """

    made: jax.Array
    rim: jax.Array | None = None
    ring: jax.Array | None = None


class Profile(NamedTuple):
    """Sections over the height.

    shape: (DEGREE + 1,) coefficients of rho in powers of x, which is -1 at the bottom platen and 1 at the top [L].
    bottom, top: heights of the platens [L]. half_angle: half the sector's angle [rad]. surface: rim and ring of tied
    ends.
    """

    shape: jax.Array
    bottom: jax.Array
    top: jax.Array
    half_angle: jax.Array
    surface: Surface

    def section(self, height) -> jax.Array:
        """The section of the membrane at any heights [L^2]. Mirrored in the platens, so that a cell whose ball is on
        one, which the mirror completes, has twice the force of its inner half."""
        inside = jnp.clip(height, self.bottom, self.top)
        within, mirrored = self._section(jnp.stack([inside, 2 * inside - height]))
        return 2 * within - mirrored

    def ends(self) -> jax.Array:
        """(2,) sections at the bottom and the top platen [L^2]."""
        return self._section(jnp.stack([self.bottom, self.top]))

    def _section(self, height):
        free = self._free(height)
        _, rim, ring = self.surface
        if rim is None or ring is None:
            return free
        for end in (self.bottom, self.top):
            near = jnp.clip(1 - jnp.abs(height - end) / ring, 0.0, 1.0)
            free += near * (self.half_angle * rim**2 - self._free(end))
        return free

    def _free(self, height):
        """The section with ends that are not tied."""
        x = (2 * height - self.bottom - self.top) / (self.top - self.bottom)
        return self.half_angle * jnp.polyval(self.shape[::-1], x, unroll=DEGREE + 1) ** 2


# Legendre polynomials in powers of x: row n holds the coefficients of the n-th. Their own means over -1 to 1 are zero,
# but for the first one's.
LEGENDRE = np.stack([np.pad(legendre.leg2poly([0] * n + [1]), (0, DEGREE - n)) for n in range(DEGREE + 1)])


def fitted_profile(membrane: "Membrane", positions: Vector, corner_areas: jax.Array, radius, bottom, top) -> Profile:
    """The surface of a zone at these positions. corner_areas: (3, T) parts of the cells; radius: Rm."""
    surface = membrane.surface
    assert surface is not None
    zone, corner = membrane.zone, membrane.corner.ravel()
    weight = (membrane.counted * membrane.share)[corner] * corner_areas.ravel()
    places = Vector(*gathered(tuple(positions), zone))
    x = (2 * places.z - bottom - top) / (top - bottom)
    moved = radial_distance(places) - surface.made[zone]
    to_powers = jnp.asarray(LEGENDRE, x.dtype)
    terms = to_powers @ x ** jnp.arange(DEGREE + 1)[:, None]
    *terms, moved = gathered((*terms, moved), corner)
    terms = jnp.stack(terms)
    weighted = terms * (weight / weight.sum())
    matrix = weighted @ terms.T + RIDGE * jnp.eye(DEGREE + 1, dtype=x.dtype)
    fitted = jnp.linalg.solve(matrix, weighted @ moved)
    shape = fitted.at[0].set(radius) @ to_powers
    return Profile(shape, bottom, top, 0.5 * membrane.sector_angle, surface)


def axial_areas(membrane: "Membrane", place: jax.Array, profile: Profile, radius, count: int) -> jax.Array:
    """Axial force on each ball over the confining stress, upward positive; (N,) [L^2].

    place: (2, 3, T) corners of the triangles on the unfolded cylinder, counter-clockwise [L]; radius: Rm; count: N.
    """
    after, before = (1, 2, 0), (2, 0, 1)
    edge = place[:, before] - place[:, after]  # opposite to each corner
    middle = 0.5 * (place[1, before, :] + place[1, after, :])
    twice_area = edge[0, 0] * edge[1, 1] - edge[1, 0] * edge[0, 1]
    cotangent = -(edge[:, after] * edge[:, before]).sum(0) / twice_area
    # The side of two cells runs from the middle of the edge between their balls to the centre of the triangle's circle.
    rise = 0.5 * cotangent * edge[0]
    mean = profile.section(jnp.stack([middle + t * rise for t in GAUSS])).mean(axis=0)
    through = 0.5 * cotangent * edge[1] * mean  # times n_z and length, out of the cell of the edge's first end
    flow = membrane.owned * (through[before, :] - through[after, :])
    axial = added(flow, membrane.corner, membrane.zone.size, radius)
    axial = axial * membrane.share / (membrane.sector_angle * radius)
    return added(axial, membrane.zone, count, radius)


def straightened(stress, load: "Load", platen_forces: jax.Array) -> jax.Array:
    """Platen forces (2,) as they would be on ends as wide as Rm: what the confining stress presses on the difference is
    no axial stress of the specimen (a laboratory's deviator force over its corrected area)."""
    if load.ends is None:
        return platen_forces
    return platen_forces - stress * (load.ends - load.section)
