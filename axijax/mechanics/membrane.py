"""The stress-controlled cylindrical membrane (Cui & O'Sullivan 2005, section 3.2).

The outer balls carry inward radial forces s3 * A_i. A_i is the area of ball i's Voronoi cell on the cylinder
through the middle of the membrane zone, unfolded to x' = theta * Rm, z' = z, with Rm = (rho_min + rho_max) / 2 of
the zone's balls. (Of a zone found by exposure Rm is the mean of rho: in a random specimen one ball in a pore would
shift the middle by 5 to 15 %, and the stresses with it.) The cells are periodic in x' with period 2*pi*Rm/n (mirrored
at rigid sector planes) and cut at the platens by mirror points, so that they tile the strip exactly.

SciPy triangulates the zone on the host (`build_membrane`); from that triangulation `cell_areas` finds the cells'
areas at later positions inside jit, with exact derivatives, and `membrane_force` consumes the areas. The force
points from the ball's current position to the axis: with directions frozen at the start, the specimen would spin
up about its axis. A force normal to the membrane's surface, with a part along z, is in `membrane_surface`.
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.gather import added, gathered
from axijax.core.once import computed_once
from axijax.core.sector import Sector, radial_distance
from axijax.core.shown import shown
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.membrane_surface import Surface, axial_areas, fitted_profile
from axijax.mechanics.triangulation import neighbours_median, surface_triangles
from axijax.specimen.specimen import Specimen, ZoneRule


@shown
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
    edge: (3, T) int, the edge opposite to each corner, numbered over the triangulation.
    edge_inside: (3 T,) bool, edges with a triangle to either side.
    counted: (Z,) bool, balls that Rm is taken over; one squeezed far out of the surface is loaded but not counted.
    sector_angle: () angle of the sector [rad].
    surface: of a membrane that also pushes along z where it slopes; None where it only presses towards the axis.
    zone_rule: the specimen's, see `Specimen`; it decides what Rm is.
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
    edge: jax.Array
    edge_inside: jax.Array
    counted: jax.Array
    sector_angle: jax.Array
    surface: Surface | None = None
    zone_rule: ZoneRule = field(default="given", metadata={"static": True})


# A zone ball this many of its radii farther out than its neighbours on the surface no longer counts for Rm.
SQUEEZED_OUT = 4.0


def build_membrane(
    specimen: Specimen, sector: Sector, triangles: int | None = None, dtype=np.float64, balls: int | None = None
) -> Membrane:
    """Triangulate the membrane zone on the unfolded cylinder (host, SciPy's Delaunay).

    triangles, balls: numbers of triangles T and of zone balls Z to pad to, so that a rebuilt membrane keeps its shape;
        None takes what is needed. A zone is padded with its first ball, which then has no further share.

    Raises ValueError where the zone is empty, a zone ball is on the axis, two zone balls share one place on the
    cylinder (their cells would be undefined), or triangles or balls is too small.
    """
    return jax.device_put(membrane_arrays(specimen, sector, triangles, dtype, balls))


def membrane_arrays(specimen: Specimen, sector: Sector, triangles: int | None, dtype, balls: int | None) -> Membrane:
    """`build_membrane` in NumPy arrays, for use where JAX must not be called."""
    unfolded = unfold(specimen, sector)
    zone, theta, corners, owners, codes = (
        unfolded.zone, unfolded.theta, unfolded.corners, unfolded.owners, unfolded.codes
    )  # fmt: skip
    celled = np.isin(np.arange(zone.size), owners[corners[codes[5][corners] > 0]])
    if not celled.all():
        raise ValueError(
            f"membrane_zone: ball {zone[~celled][0]} lies at the same place of the unfolded cylinder as another zone "
            "ball, so it has no Voronoi cell; mark only one of them."
        )
    needed = corners.shape[1]
    if triangles is not None and triangles < needed:
        raise ValueError(f"triangles = {triangles}: the membrane needs {needed}; allow at least that many.")
    if balls is not None and balls < zone.size:
        raise ValueError(f"balls = {balls}: the membrane zone holds {zone.size}; allow at least that many.")
    ends = np.sort(np.stack([corners[[1, 2]], corners[[2, 0]], corners[[0, 1]]], axis=1), axis=0)
    _, edge = np.unique(ends[0].astype(np.int64) * owners.size + ends[1], return_inverse=True)
    edge = edge.reshape(3, -1)
    edges: Any = np.concatenate([edge, np.full((3, (triangles or needed) - needed), edge.max() + 1)], 1)
    edge_inside = np.bincount(edge.ravel(), minlength=3 * (triangles or needed)) == 2
    pad = np.zeros((triangles or needed) - needed, int)  # padding repeats a triangle that nobody owns
    unowned = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])[:, None, None]
    code = np.concatenate([codes[:, corners], codes[:, corners[:, pad]] * unowned], axis=2)
    spare = (balls or zone.size) - zone.size
    again = np.concatenate([np.arange(zone.size), np.zeros(spare, int)])
    first = np.arange(again.size) < zone.size
    angle: Any = np.asarray(sector.angle, dtype)
    direction: Any = unfolded.direction[:, again]
    return Membrane(
        zone=zone[again].astype(np.int32),
        angle=theta[again].astype(dtype),
        direction=direction.astype(dtype),
        share=(unfolded.share[again] * first).astype(dtype),
        corner=owners[np.concatenate([corners, corners[:, pad]], 1)].astype(np.int32),
        turn_sign=code[0].astype(dtype),
        turn_shift=code[1].astype(dtype),
        flip_sign=code[2].astype(dtype),
        flip_bottom=code[3].astype(dtype),
        flip_top=code[4].astype(dtype),
        owned=code[5].astype(dtype),
        edge=edges.astype(np.int32),
        edge_inside=edge_inside,
        counted=unfolded.counted[again] & first,
        sector_angle=angle,
        zone_rule=specimen.zone_rule,
    )


def sloping(membrane: Membrane, made: Specimen, tied: bool) -> Membrane:
    """The membrane of a specimen as made, from now on normal to its own surface; tied: its ends to the platens."""
    places = jnp.asarray(made.positions, membrane.angle.dtype)
    surface = Surface(jnp.hypot(places[0], places[1]))
    if tied:
        ring = jnp.asarray(made.radius[made.membrane_zone].mean(), places.dtype)
        surface = surface._replace(rim=membrane_radius(membrane, from_rows(places)), ring=ring)
    return replace(membrane, surface=surface)


class Unfolded(NamedTuple):
    """The zone's Z balls on the unfolded cylinder (host).

    zone: (Z,) which balls; theta: (Z,) their angles [rad]; direction: (2, Z) those as unit vectors.
    counted: (Z,) which of them Rm is taken over; radius: Rm [L].
    places, codes, owners, share: the balls and their copies, see `unfolded_copies`.
    corners: (3, T) triangles between them.
    """

    zone: np.ndarray
    theta: np.ndarray
    direction: np.ndarray
    counted: np.ndarray
    radius: float
    places: np.ndarray
    codes: np.ndarray
    owners: np.ndarray
    share: np.ndarray
    corners: np.ndarray


def unfold(specimen: Specimen, sector: Sector) -> Unfolded:
    zone = np.flatnonzero(specimen.membrane_zone)
    points = specimen.positions[:, zone]
    if zone.size == 0:
        raise ValueError("membrane_zone holds no ball: mark the outer balls, or there are no cells to load.")
    rho = np.hypot(points[0], points[1])
    if rho.min() <= 1e-6 * specimen.radius[zone].min():
        raise ValueError(
            f"membrane_zone: ball {zone[rho.argmin()]} is on the axis, where a radial force has no direction; "
            "mark the outer balls only."
        )
    theta = sector.angle_of(points)
    counted = np.ones(zone.size, bool)
    for _ in range(4):  # a ball squeezed out must not shift the cylinder on which it is found to be so
        middle = middle_radius(rho[counted], specimen.zone_rule)
        places, codes, owners, share = unfolded_copies(theta, points[2], middle, specimen.bottom, specimen.top, sector)
        corners = surface_triangles(places, codes[5] > 0)
        before, counted = counted, _within_surface(rho, specimen.radius[zone], owners[corners])
        if (before == counted).all():
            break
    return Unfolded(zone, theta, points[:2] / rho, counted, middle, places, codes, owners, share, corners)


def middle_radius(rho: np.ndarray, zone_rule: ZoneRule) -> float:
    """Rm of zone balls at these distances from the axis (host) [L]."""
    return rho.mean() if zone_rule == "exposure" else (rho.min() + rho.max()) / 2


def unfolded_copies(theta, z, middle, bottom, top, sector: Sector):
    """The zone's balls and the copies that shape their cells: one period to either side, or a mirror image in either
    rigid plane, and all of these mirrored in either platen.

    Returns their places (2, C), the codes (6, C) of how each follows from its ball, the ball (C,), and each ball's
    share of its cell (Z,).
    """
    if sector.boundary == "periodic":
        home = np.mod(theta, sector.angle)
        home = np.where(sector.angle - home < 1e-12, 0.0, home)
        across = [(1.0, 0.0), (1.0, -sector.angle), (1.0, sector.angle)]
    else:
        # Mirrored in both planes one after the other as well, which matters where a plane's own mirror is left out.
        home = theta
        across = [(sign, shift * sector.angle) for sign, shift in ((1, 0), (-1, 0), (-1, 2), (1, -2), (1, 2))]
    upright = [(1, 0, 0), (-1, 2, 0), (-1, 0, 2), (1, 2, -2), (1, -2, 2)]
    # Only copies near the strip matter; a zone of few balls keeps them all.
    width, height = middle * sector.angle, top - bottom
    margin = 6 * np.sqrt(width * height / z.size) if z.size >= 30 else np.inf
    same = np.zeros(z.size)
    places, codes, owners = [], [], []
    for sign, shift in across:
        for flip, at_bottom, at_top in upright:
            x = middle * (sign * home + shift)
            y = flip * z + at_bottom * bottom + at_top * top
            original = (sign, shift, flip, at_bottom) == (1, 0, 1, 0)
            # A centre on a platen or a rigid plane is its own mirror image: leave the copy out and share the cell.
            itself = (np.abs(x - middle * home) < 1e-9 * middle) & (np.abs(y - z) < 1e-9 * middle) & (not original)
            same += itself
            close = (x > -margin) & (x < width + margin) & (y > bottom - margin) & (y < top + margin)
            kept = np.flatnonzero(close & ~itself)
            one = np.ones(kept.size)
            # The shift includes the move into the first sector, so that it applies to the ball's own angle.
            moved = shift + sign * (home - theta)[kept]
            places.append(np.stack([x[kept], y[kept]]))
            codes.append(np.stack([sign * one, moved, flip * one, at_bottom * one, at_top * one, original * one]))
            owners.append(kept)
    return np.concatenate(places, 1), np.concatenate(codes, 1), np.concatenate(owners), 1 / (1 + same)


def _within_surface(rho, radius, corners):
    """Which balls are less than SQUEEZED_OUT radii farther out than the median of their neighbours; (Z,) bool."""
    within = rho - neighbours_median(rho, corners) < SQUEEZED_OUT * radius
    return within if within.any() else np.ones_like(within)


def in_zone(membrane: Membrane, positions: Vector) -> Vector:
    """Vectors of the balls (N,) at those of the zone; (Z,)."""
    return Vector(*gathered(tuple(positions), membrane.zone))


def membrane_radius(membrane: Membrane, positions: Vector) -> jax.Array:
    """Radius Rm of the cylinder through the middle of the zone [L]; positions: (N,) vectors."""
    rho = radial_distance(in_zone(membrane, positions))
    if membrane.zone_rule == "exposure":
        return jnp.where(membrane.counted, rho, 0.0).sum() / membrane.counted.sum()
    least = jnp.where(membrane.counted, rho, jnp.inf).min()
    most = jnp.where(membrane.counted, rho, -jnp.inf).max()
    return (least + most) / 2


def cell_areas(membrane: Membrane, positions: Vector, bottom, top) -> jax.Array:
    """Area of each ball's Voronoi cell on the unfolded cylinder, zero outside the zone; (N,) [L^2].

    positions: (N,) vectors, current ball centres [L]; bottom, top: heights of the platens [L].
    """
    return _cells(membrane, positions, bottom, top)[0]


def stale_cells(membrane: Membrane, positions: Vector, bottom, top) -> jax.Array:
    """How far the triangulation is from a Delaunay one: the area between ball and cell edge that is counted with
    the wrong sign, as a share of the strip's area [-]. Zero after `build_membrane`; the areas' error is of its order.
    """
    return _cells(membrane, positions, bottom, top)[1]


def _cells(membrane: Membrane, positions: Vector, bottom, top) -> tuple[jax.Array, jax.Array]:
    """Areas (N,) and staleness of the cells.

    A cell is a sum over the edges from its ball: a quarter of the edge's length times that of the cell's side across
    it. In each triangle the side across the edge opposite to a corner has half the edge's length times the cotangent
    of that corner. So the sum over all cells is the strip's area for any positions, and each area is the Voronoi
    cell's while the triangulation is still a Delaunay one, where no side has a negative length.
    """
    radius = membrane_radius(membrane, positions)
    place = _corner_places(membrane, positions, bottom, top, radius)
    kite, corner_area = _kites(membrane, place)
    area = added(corner_area, membrane.corner, membrane.zone.size, radius)
    area = added(area * membrane.share, membrane.zone, positions.x.size, radius)

    across = added(kite, membrane.edge, membrane.edge.size, radius)
    wrong = jnp.where(membrane.edge_inside, jnp.maximum(-across, 0.0), 0.0).sum()
    return area, wrong / (membrane.sector_angle * radius * (top - bottom))


def _kites(membrane: Membrane, place: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Area from either end of the edge opposite to each corner to the cell's side across it, and each corner's part of
    its ball's cell; (3, T) each [L^2]."""
    edge = place[:, (2, 0, 1)] - place[:, (1, 2, 0)]  # opposite to each corner, counter-clockwise
    twice_area = edge[0, 0] * edge[1, 1] - edge[1, 0] * edge[0, 1]
    cotangent = -(edge[:, (1, 2, 0)] * edge[:, (2, 0, 1)]).sum(0) / twice_area
    kite = cotangent * (edge * edge).sum(0) / 8
    return kite, membrane.owned * (kite[(1, 2, 0), :] + kite[(2, 0, 1), :])


@shown
@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Load:
    """The lateral load of a specimen, per unit of confining stress.

    lateral: (N,) cell areas, pressed towards the axis; or (2, N) constant horizontal vectors, for a specimen that is
        loaded without a membrane [L^2].
    section: () area of the sector's section that the platens carry [L^2].
    stale: () how far the membrane's triangulation has aged, see `stale_cells`; zero without a membrane [-].
    axial: (N,) upward forces of a membrane that slopes [L^2]; None where it has none, as is the next.
    ends: (2,) sections of the membrane at the bottom and the top platen [L^2].
    """

    lateral: jax.Array
    section: jax.Array
    stale: jax.Array | float = 0.0
    axial: jax.Array | None = None
    ends: jax.Array | None = None


def check_load(load: Load, cut: Specimen) -> None:
    """Raise ValueError, naming what is wrong, for a constant load that a sector's balls cannot carry."""
    if not isinstance(load, Load):
        raise ValueError(f"lateral_load is a {type(load).__name__}: must be a membrane.Load.")
    lateral, section, count = np.asarray(load.lateral), np.asarray(load.section), len(cut)
    if lateral.shape not in ((2, count), (count,)):
        raise ValueError(
            f"lateral_load.lateral has shape {lateral.shape}: must be (2, {count}), a horizontal vector for each ball "
            f"of the sector, or ({count},), the area of each ball's cell."
        )
    if section.shape != () or section.dtype.kind not in "fiu" or not (np.isfinite(section) and section > 0):
        raise ValueError(f"lateral_load.section = {section}: must be one number, positive and finite [L^2].")
    if lateral.dtype.kind not in "fiu" or not np.isfinite(lateral).all():
        raise ValueError("lateral_load.lateral holds values that are not finite numbers: every ball needs one [L^2].")
    if lateral.ndim == 1 and lateral.min() < 0:
        raise ValueError(f"lateral_load.lateral holds an area of {lateral.min():g}: must be zero or positive [L^2].")
    if load.axial is not None or load.ends is not None:
        raise ValueError("lateral_load.axial, lateral_load.ends: must be None, they are a membrane's.")
    outward = lateral * cut.positions[:2] if lateral.ndim == 2 else lateral * np.hypot(*cut.positions[:2])
    if not outward.sum() > 0:
        raise ValueError(
            "lateral_load.lateral does not confine the balls: its vectors are those of the missing neighbours, away "
            "from the axis, and press the other way; turn their sign."
        )


def membrane_load(membrane: Membrane, positions: Vector, bottom, top) -> Load:
    """Cells and section at the current positions."""
    radius = membrane_radius(membrane, positions)
    section = 0.5 * membrane.sector_angle * radius**2
    areas, stale = _cells(membrane, positions, bottom, top)
    if membrane.surface is None:
        return Load(areas, section, stale)
    place = _corner_places(membrane, positions, bottom, top, radius)
    profile = fitted_profile(membrane, positions, _kites(membrane, place)[1], radius, bottom, top)
    return Load(areas, section, stale, axial_areas(membrane, place, profile, radius, areas.size), profile.ends())


def lateral_force(stress, load: Load, positions: Vector) -> Vector:
    """Force on each ball, horizontal but for a membrane that slopes, (N,) vectors [F]. stress: confining stress,
    compression positive."""
    if load.lateral.ndim == 2:
        x, y = -stress * load.lateral
        return Vector(x, y, jnp.zeros_like(x))
    force = membrane_force(stress, load.lateral, positions)
    return force if load.axial is None else Vector(force.x, force.y, stress * load.axial)


def membrane_force(stress, areas: jax.Array, positions: Vector) -> Vector:
    """Radial force of the membrane on each ball, stress * area from its current position to the axis; (N,) [F].

    stress: confining stress, compression positive; areas: (N,) from `cell_areas` [L^2]; positions: (N,) vectors.
    """
    rho = radial_distance(positions)
    inward = -areas / jnp.where(rho > 0, rho, 1.0)
    # In this order, so that a servo that asks for the forces of a unit stress shares all but the last product.
    return Vector(stress * (inward * positions.x), stress * (inward * positions.y), jnp.zeros_like(inward))


def _corner_places(membrane, positions, bottom, top, radius):
    x, y, z = in_zone(membrane, positions)
    cos, sin = membrane.direction
    theta = membrane.angle + jnp.arctan2(cos * y - sin * x, cos * x + sin * y)  # no jump at theta = 2*pi
    theta, z = gathered((computed_once(theta, top > bottom), z), membrane.corner)
    across = membrane.turn_sign * theta + membrane.turn_shift
    height = membrane.flip_sign * z + membrane.flip_bottom * bottom + membrane.flip_top * top
    return jnp.stack([radius * across, height])
