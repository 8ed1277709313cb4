"""The stress-controlled cylindrical membrane (Cui & O'Sullivan 2005, section 3.2).

The outer balls carry inward radial forces s3 * A_i. A_i is the area of ball i's Voronoi cell on the cylinder
through the middle of the membrane zone, unfolded to x' = theta * Rm, z' = z, with Rm = (rho_min + rho_max) / 2 of
the zone's balls. The cells are periodic in x' with period 2*pi*Rm/n (mirrored at rigid sector planes) and cut at
the platens by mirror points, so that they tile the strip exactly.

SciPy triangulates the zone on the host (`build_membrane`); from that triangulation `cell_areas` finds the cells'
areas at later positions inside jit, with exact derivatives, and `membrane_force` consumes the areas. The force
points from the ball's current position to the axis: with directions frozen at the start, the specimen would
spin up about its axis. It has no vertical component, so it does not follow a barrelling specimen's slope.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import Delaunay

from axijax.packing import Specimen
from axijax.sector import Sector, radial_distance


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Membrane:
    """The zone and the triangulation behind its Voronoi cells; a pytree of arrays.

    zone: (Z,) int, the balls of the membrane zone.
    angle: (Z,) polar angle at the reference positions [rad], in [0, 2*pi).
    direction: (2, Z) unit vector of that angle.
    share: (Z,) part of the cell inside the strip: 1, or 1/2 for a centre exactly on a platen or rigid plane.
    corner: (3, T) int, corners of the triangles as places in the zone.
    turn_sign, turn_shift: (3, T), a corner's angle is turn_sign * theta + turn_shift.
    flip_sign, flip_bottom, flip_top: (3, T), its height is flip_sign * z + flip_bottom * bottom + flip_top * top.
    owned: (3, T) 1 where the corner is the ball itself and not a copy.
    sector_angle: () angle of the sector [rad].
    """

    zone: jax.Array
    angle: jax.Array
    direction: jax.Array
    share: jax.Array
    corner: jax.Array
    turn_sign: jax.Array
    turn_shift: jax.Array
    flip_sign: jax.Array
    flip_bottom: jax.Array
    flip_top: jax.Array
    owned: jax.Array
    sector_angle: jax.Array


def build_membrane(specimen: Specimen, sector: Sector, dtype=np.float64) -> Membrane:
    """Triangulate the membrane zone on the unfolded cylinder (host, SciPy's Delaunay).

    Raises ValueError where the zone is empty, a zone ball is on the axis, or two zone balls share one place on
    the cylinder (their cells would be undefined).
    """
    zone = np.flatnonzero(specimen.membrane_zone)
    points = specimen.positions[:, zone]
    bottom, top = specimen.bottom, specimen.top
    if zone.size == 0:
        raise ValueError("membrane_zone holds no ball: mark the outer balls, or there are no cells to load.")
    rho = np.hypot(points[0], points[1])
    if rho.min() < 1e-6 * rho.max() or rho.max() == 0:
        raise ValueError(
            f"membrane_zone: ball {zone[rho.argmin()]} is on the axis, where a radial force has no direction; "
            "mark the outer balls only."
        )
    middle = (rho.min() + rho.max()) / 2
    theta = sector.angle_of(points)
    theta_in = np.mod(theta, sector.angle) if sector.boundary == "periodic" else theta
    theta_in = np.where(sector.angle - theta_in < 1e-12, 0.0, theta_in)

    # Copies: one period to either side, or a mirror image in either rigid plane; mirrored in either platen.
    if sector.boundary == "periodic":
        across = [(1.0, 0.0), (1.0, -sector.angle), (1.0, sector.angle)]
    else:
        across = [(1.0, 0.0), (-1.0, 0.0), (-1.0, 2 * sector.angle)]
    upright = [(1.0, 0.0, 0.0), (-1.0, 2.0, 0.0), (-1.0, 0.0, 2.0)]
    tolerance = 1e-9 * middle
    places, codes, owners = [], [], []
    share = np.ones(zone.size)
    for sign, shift in across:
        for flip, at_bottom, at_top in upright:
            x = middle * (sign * theta_in + shift)
            z = flip * points[2] + at_bottom * bottom + at_top * top
            # A centre on a platen or rigid plane is its own mirror image: leave the copy out, halve the cell.
            own = (np.abs(x - middle * theta_in) < tolerance) & (np.abs(z - points[2]) < tolerance)
            is_self = (sign, shift, flip) == (1.0, 0.0, 1.0)
            if not is_self:
                share = np.where(own, share / 2, share)
            keep = np.flatnonzero(~own | is_self)
            # The shift undoes the move into the first sector, so that it applies to the ball's own angle.
            undo = sign * (theta_in - theta)[keep]
            places.append(np.stack([x[keep], z[keep]]))
            ones = np.ones(keep.size)
            codes.append(np.stack([sign * ones, shift + undo, flip * ones, at_bottom * ones, at_top * ones, 1.0 * is_self * ones]))
            owners.append(keep)
    places, codes, owners = np.concatenate(places, 1), np.concatenate(codes, 1), np.concatenate(owners)

    # Only copies that can reach into the strip matter; too few to be trimmed are all kept.
    spacing = np.sqrt(middle * sector.angle * (top - bottom) / zone.size)
    margin = max(6 * spacing, 0.0)
    near = (
        (places[0] > -margin) & (places[0] < middle * sector.angle + margin)
        & (places[1] > bottom - margin) & (places[1] < top + margin)
    ) | (zone.size < 30)
    places, codes, owners = places[:, near], codes[:, near], owners[near]
    corners = Delaunay(places.T).simplices.T
    present = np.isin(np.arange(zone.size), owners[np.unique(corners[codes[5][corners] > 0])])
    if not present.all():
        lost = zone[~present]
        raise ValueError(
            f"membrane_zone: ball {lost[0]} lies at the same place of the unfolded cylinder as another zone ball, so "
            "it has no Voronoi cell; mark only one of them."
        )
    a, b, c = places[:, corners[0]], places[:, corners[1]], places[:, corners[2]]
    clockwise = _cross(b - a, c - a) < 0
    corners[1:, clockwise] = corners[:0:-1, clockwise]
    corners = corners[:, codes[5][corners].any(axis=0)]
    code = codes[:, corners]
    return Membrane(
        zone=jnp.asarray(zone.astype(np.int32)),
        angle=jnp.asarray(theta.astype(dtype)),
        direction=jnp.asarray((points[:2] / rho).astype(dtype)),
        share=jnp.asarray(share.astype(dtype)),
        corner=jnp.asarray(owners[corners].astype(np.int32)),
        turn_sign=jnp.asarray(code[0].astype(dtype)),
        turn_shift=jnp.asarray(code[1].astype(dtype)),
        flip_sign=jnp.asarray(code[2].astype(dtype)),
        flip_bottom=jnp.asarray(code[3].astype(dtype)),
        flip_top=jnp.asarray(code[4].astype(dtype)),
        owned=jnp.asarray(code[5].astype(dtype)),
        sector_angle=jnp.asarray(sector.angle, dtype),
    )


def membrane_radius(membrane: Membrane, positions: jax.Array) -> jax.Array:
    """Radius Rm of the cylinder through the middle of the zone [L]; positions (3, N)."""
    rho = radial_distance(positions[:, membrane.zone])
    return (rho.min() + rho.max()) / 2


def cell_areas(membrane: Membrane, positions: jax.Array, bottom, top) -> jax.Array:
    """Area of each ball's Voronoi cell on the unfolded cylinder, zero outside the zone; (N,) [L^2].

    positions: (3, N) current ball centres [L]; bottom, top: heights of the platens [L].

    The cell is summed from the triangles around the ball: each adds the quadrilateral of the corner, the two
    middles of its sides and the circumcentre. The sum over all cells is the strip's area for any positions; each
    area is the Voronoi cell's while the triangulation is still a Delaunay one (`stale_cells` tells).
    """
    radius = membrane_radius(membrane, positions)
    place = _corner_places(membrane, positions, bottom, top, radius)
    centre = _circumcentres(place)
    area = jnp.zeros(membrane.zone.size, positions.dtype)
    for corner, (before, after) in enumerate(((2, 1), (0, 2), (1, 0))):
        own = place[:, corner]
        to_centre = centre - own
        piece = _cross(place[:, after] - own, to_centre) + _cross(to_centre, place[:, before] - own)
        area = area.at[membrane.corner[corner]].add(0.25 * piece * membrane.owned[corner])
    return jnp.zeros(positions.shape[1], positions.dtype).at[membrane.zone].set(area * membrane.share)


def stale_cells(membrane: Membrane, positions: jax.Array, bottom, top) -> jax.Array:
    """How far the triangulation is from a Delaunay one: the area that is counted with the wrong sign, as a share
    of the strip's area [-]. Zero just after `build_membrane`; the areas' error is of the same order."""
    radius = membrane_radius(membrane, positions)
    place = _corner_places(membrane, positions, bottom, top, radius)
    centre = _circumcentres(place)
    wrong = 0.0
    for corner, (before, after) in enumerate(((2, 1), (0, 2), (1, 0))):
        own = place[:, corner]
        pieces = _cross(place[:, after] - own, centre - own), _cross(centre - own, place[:, before] - own)
        # An obtuse triangle's circumcentre lies outside it and its neighbour makes up for it; only a negative
        # whole piece is wrong.
        wrong += jnp.sum(jnp.maximum(-(pieces[0] + pieces[1]), 0.0) * membrane.owned[corner])
    return 0.25 * wrong / (membrane.sector_angle * radius * (top - bottom))


def membrane_force(stress, areas: jax.Array, positions: jax.Array) -> jax.Array:
    """Radial force of the membrane on each ball, stress * area towards the axis; (2, N) along x and y [F].

    stress: confining stress, compression positive; areas: (N,) from `cell_areas` [L^2]; positions: (3, N).
    """
    rho = radial_distance(positions)
    inward = -stress * areas / jnp.where(rho > 0, rho, 1.0)
    return inward * positions[:2]


def _corner_places(membrane, positions, bottom, top, radius):
    x, y, z = positions[:, membrane.zone]
    cos, sin = membrane.direction
    theta = membrane.angle + jnp.arctan2(cos * y - sin * x, cos * x + sin * y)  # no jump at theta = 2*pi
    across = membrane.turn_sign * theta[membrane.corner] + membrane.turn_shift
    height = membrane.flip_sign * z[membrane.corner] + membrane.flip_bottom * bottom + membrane.flip_top * top
    return jnp.stack([radius * across, height])


def _circumcentres(place):
    a, b, c = place[:, 0], place[:, 1], place[:, 2]
    u, v = b - a, c - a
    square_u, square_v = (u * u).sum(0), (v * v).sum(0)
    scale = 0.5 / _cross(u, v)
    return a + scale * jnp.stack([v[1] * square_u - u[1] * square_v, u[0] * square_v - v[0] * square_u])


def _cross(u, v):
    return u[0] * v[1] - u[1] * v[0]
