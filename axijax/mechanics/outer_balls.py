"""Which balls carry the membrane: in a random specimen those that can be seen from outside (host).
And the zone's cells as polygons, for pictures.

A ball is looked at along radial lines, from far outside to the axis, through points spread evenly over its disc. It
is an outer ball where at least SIGHT of them meet it first, the one through its centre among them: so no two outer
balls share one place of the unfolded cylinder, and their Voronoi cells are well shaped. A ball at the bottom of a
narrow pore is not loaded (DEEP), and no wide part of the surface is left without a ball (HOLE).

On the FCC octagon of Cui & O'Sullivan (2005) this gives the zone of their paper, 138 balls in the quarter.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import Voronoi

from axijax.core.sector import Sector
from axijax.mechanics.membrane import middle_radius, unfold, unfolded_copies
from axijax.mechanics.triangulation import neighbours_median, surface_triangles
from axijax.specimen.specimen import Specimen, ZoneRule

SIGHT = 0.6  # part of its disc that must be in sight for a ball to be an outer one
STAY = 0.4  # part below which it ceases to be one; lower, so that the zone does not flicker
DEEP = 2.0  # an outer ball lies at most this many mean radii below the median of its neighbours on the surface
HOLE = 3.0  # no empty circle between outer balls on the unfolded cylinder has a radius of more mean radii
POINTS = 64  # points on a ball's disc
CELLS = 8  # along either side of what a ball is quickly found to cover
MOST_CELLS = 4000  # round a specimen, and along it


def outer_balls(
    positions: np.ndarray,
    radius: np.ndarray,
    bottom: float,
    top: float,
    sector: Sector,
    before: np.ndarray | None = None,
) -> np.ndarray:
    """The outer balls of a sector, found by exposure; (N,) bool.

    positions: (3, N) ball centres, of any image each [L]; radius: (N,) or one number [L]; bottom, top: heights of the
    platens [L]. before: (N,) bool, the outer balls found last time; these stay down to a smaller part in sight.

    Raises ValueError where every ball is on the axis.
    """
    radius = np.broadcast_to(np.asarray(radius, float), positions.shape[1:])
    seen = visible_share(positions, radius, sector)
    zone = seen >= (SIGHT if before is None else np.where(before, STAY, SIGHT))
    if not zone.any():
        zone = (seen == seen.max()) & (seen > 0)
    if not zone.any():
        raise ValueError("membrane_zone: every ball is on the axis, so there is no outer ball; add balls off the axis.")
    mean = radius[zone].mean()
    reach = np.hypot(positions[0], positions[1]) + radius
    balls = np.flatnonzero(zone)
    if balls.size > 3:
        _, corners, owners = _surface(positions, balls, bottom, top, sector)
        below = neighbours_median(reach[balls], owners[corners]) - reach[balls]
        zone[balls[below > DEEP * mean]] = False
        _fill_holes(zone, positions, reach, (seen > 0), bottom, top, sector, HOLE * mean)
    return zone


def visible_share(positions: np.ndarray, radius: np.ndarray, sector: Sector) -> np.ndarray:
    """The part of each ball's disc that is seen from outside along radial lines; zero where its centre is not; (N,).

    A ball nearer to the axis than half its radius has no outer side: zero as well. All images stand in the way.
    """
    count = radius.size
    rho, theta, z = np.hypot(positions[0], positions[1]), np.arctan2(positions[1], positions[0]), positions[2]
    ball, turn = np.tile(np.arange(count), sector.images), np.repeat(np.arange(sector.images), count)
    order = np.argsort(z[ball], kind="stable")
    ball, turn = ball[order], turn[order]
    half_width = np.arcsin(np.minimum(radius / np.maximum(rho, 1e-300), 1))
    number = np.arange(POINTS)  # a sunflower's seeds lie evenly on a disc; the centre is the first
    away, around = np.sqrt(number / POINTS), number * np.pi * (3 - 5**0.5)
    across, upward, depth = away * np.cos(around), away * np.sin(around), np.sqrt(1 - away**2)

    def in_front(looked_at, reach, outermost):
        """Pairs (i, place in the sorted images) of balls looked at and of those that may stand before them: within
        reach of their height, coming farther out than `outermost`, and at an angle that overlaps theirs."""
        there = np.flatnonzero((rho + radius)[ball] > outermost.min(initial=np.inf))
        low, high = (np.searchsorted(z[ball[there]], z[looked_at] + sign * reach) for sign in (-1, 1))
        sizes = high - low
        i = np.repeat(looked_at, sizes)
        near = there[np.arange(i.size) - np.repeat(np.cumsum(sizes) - sizes - low, sizes)]
        kept = (rho + radius)[ball[near]] > np.repeat(outermost, sizes)
        i, near = i[kept], near[kept]
        j = ball[near]
        aside = np.abs((theta[j] + turn[near] * sector.angle - theta[i] + np.pi) % (2 * np.pi) - np.pi)
        kept = (aside < half_width[i] + half_width[j]) & (np.abs(z[j] - z[i]) < radius[i] + radius[j])
        kept &= (j != i) | (turn[near] != 0)
        return i[kept], near[kept]

    def facing(balls, points):
        """Radial lines through points of the balls' discs: sine and cosine of the angle from the centre's, and how far
        out they leave; (balls, points)."""
        sine = np.clip(radius[balls, None] * across[points] / rho[balls, None], -1, 1)
        cosine = np.sqrt(1 - sine**2)
        return sine, cosine, rho[balls, None] * cosine + radius[balls, None] * depth[points]

    def hidden(i, near, lines, place, points):
        """Whether ball i is hidden by one that may stand before it, at these points of its disc; (pairs, points).
        lines: of `facing`, in which ball i has this place."""
        j = ball[near]
        sine, cosine, own = lines
        aside = theta[j] + turn[near] * sector.angle - theta[i]
        sin, cos = rho[j] * np.sin(aside), rho[j] * np.cos(aside)
        height = (z[i] - z[j])[:, None] + radius[i, None] * upward[points]
        inside = radius[j, None] ** 2 - (sine[place] * cos[:, None] - cosine[place] * sin[:, None]) ** 2 - height**2
        behind = np.zeros(inside.shape, bool)
        pair, point = np.nonzero(inside > 0)
        at = place[pair], point
        outward = cosine[at] * cos[pair] + sine[at] * sin[pair] + np.sqrt(inside[pair, point])
        behind[pair, point] = outward > own[at]
        return behind

    def parts(balls):
        """The balls of a mask in parts of like reach: what may stand before the outer ones is little."""
        chosen = np.flatnonzero(balls)
        chosen = chosen[np.argsort((rho + radius)[chosen], kind="stable")]
        return map(np.sort, np.array_split(chosen, 4 + count // 2000))

    share = np.zeros(count)
    seen = (rho > radius / 2) & (rho + radius >= covered_to(rho, theta, z, radius, 2 * np.pi / sector.images))
    # Most balls are inside, and the line through the centre tells.
    for some in parts(seen):
        i, near = in_front(some, radius.max(), (rho + radius)[some])
        seen[i[hidden(i, near, facing(some, slice(1)), np.searchsorted(some, i), slice(1))[:, 0]]] = False
    for some in parts(seen):
        lines = facing(some, slice(None))
        i, near = in_front(some, radius[some] + radius.max(), lines[2].min(axis=1))
        place = np.searchsorted(some, i)
        covered = np.zeros((some.size, POINTS), bool)
        first = np.flatnonzero(np.diff(place, prepend=-1))  # of the pairs of each ball, which follow one another
        if first.size:
            covered[place[first]] = np.logical_or.reduceat(hidden(i, near, lines, place, slice(None)), first)
        share[some] = 1 - covered.mean(axis=1)
    return share


def covered_to(rho, theta, z, radius, period: float) -> np.ndarray:
    """How far from the axis other balls surely stand on the radial line through each ball's centre, (N,) [L].

    Found quickly, so that only balls near the outside need a closer look: angle and height are cut into cells, and a
    ball stands before every cell that lies within the square in its disc, of some CELLS of them at most. Arrays (N,);
    period: angle after which the balls come again.
    """
    if not np.isfinite(rho + z).all():  # of a run that went wrong, as is one with a ball that has flown far away
        return np.zeros(rho.shape)
    bottom, size = z.min(), radius.mean() / 3
    tall, columns = max(size, np.ptp(z) / MOST_CELLS), int(np.clip(period * (rho + radius).max() / size, 1, MOST_CELLS))
    rows, per_angle = int(np.ptp(z) / tall) + 1, columns / period
    across = np.minimum(radius / np.maximum(2**0.5 * rho, 1e-300) * per_angle, CELLS / 2)
    upward = np.minimum(radius / 2**0.5 / tall, CELLS / 2)
    x, y = theta * per_angle, (z - bottom) / tall
    left, low = (np.ceil(middle - half).astype(int) for middle, half in ((x, across), (y, upward)))
    right, high = (np.floor(middle + half).astype(int) for middle, half in ((x, across), (y, upward)))
    far = np.sqrt(np.maximum(rho**2 - radius**2, 0.0))
    cells = np.zeros((columns, rows))
    for column, row in np.ndindex(CELLS, CELLS):
        here = np.flatnonzero((left + column < right) & (low + row < np.minimum(high, rows)) & (low + row >= 0))
        np.maximum.at(cells, ((left[here] + column) % columns, low[here] + row), far[here])
    return cells[np.floor(x).astype(int) % columns, np.minimum(y.astype(int), rows - 1)]


def zone_found_again(specimen: Specimen, sector: Sector) -> np.ndarray:
    """The specimen's membrane zone at its present positions; (N,) bool (host).

    A zone found by exposure (`Specimen.zone_rule`) is found so again. A given zone is kept, and every ball is added
    that has come through it: the membrane is then the surface that joins the zone's balls, rho interpolated linearly
    between them on the unfolded cylinder, and a ball whose centre lies outside it touches the membrane from now on.
    """
    from scipy.interpolate import LinearNDInterpolator

    positions, zone = specimen.positions, specimen.membrane_zone
    if specimen.zone_rule == "exposure":
        return outer_balls(positions, specimen.radius, specimen.bottom, specimen.top, sector, zone)
    balls = np.flatnonzero(zone)
    places, _, owners, middle = _unfolded(positions, balls, specimen.bottom, specimen.top, sector, "given")
    rho = np.hypot(positions[0], positions[1])
    surface = LinearNDInterpolator(places.T, rho[balls][owners])
    outside = rho > surface(middle * _home(positions, sector), positions[2]) + 1e-9 * middle
    return zone | outside


def _home(positions, sector: Sector):
    """Polar angles, those of the image in the first sector between periodic planes."""
    theta = sector.angle_of(positions)
    return np.mod(theta, sector.angle) if sector.boundary == "periodic" else theta


def _unfolded(positions, balls, bottom, top, sector: Sector, zone_rule: ZoneRule = "exposure"):
    """Places (2, C) of the balls and their copies on the unfolded cylinder, which are themselves (C,), whose they are
    (C,), and the cylinder's radius."""
    middle = middle_radius(np.hypot(*positions[:2, balls]), zone_rule)
    theta = sector.angle_of(positions[:, balls])
    places, codes, owners, _ = unfolded_copies(theta, positions[2, balls], middle, bottom, top, sector)
    return places, codes[5] > 0, owners, middle


def _surface(positions, balls, bottom, top, sector: Sector):
    """Places (2, C) on the unfolded cylinder, the triangles (3, T) between them, and whose places they are (C,)."""
    places, own, owners, _ = _unfolded(positions, balls, bottom, top, sector)
    return places, surface_triangles(places, own), owners


def _fill_holes(zone, positions, reach, seen, bottom, top, sector: Sector, widest) -> None:
    """Add to the zone, in each empty circle wider than allowed, the ball in it that comes farthest out; in place."""
    home = _home(positions, sector)
    while True:
        balls = np.flatnonzero(zone)
        places, own, _, middle = _unfolded(positions, balls, bottom, top, sector)
        corners = surface_triangles(places, own)
        a, b, c = (places[:, corner] for corner in corners)
        u, v = b - a, c - a
        cross = 2 * (u[0] * v[1] - u[1] * v[0])
        uu, vv = (u * u).sum(0), (v * v).sum(0)
        offset = np.stack([v[1] * uu - u[1] * vv, u[0] * vv - v[0] * uu]) / cross
        centre, size = a + offset, np.hypot(*offset)
        within = (centre[1] >= bottom) & (centre[1] <= top)
        if sector.boundary == "rigid":
            within &= (centre[0] >= 0) & (centre[0] <= middle * sector.angle)
        for hole in np.argsort(-size * within):
            if not within[hole] or size[hole] <= widest:
                return
            across = middle * home - centre[0, hole]
            if sector.boundary == "periodic":
                width = middle * sector.angle
                across = (across + width / 2) % width - width / 2
            inside = seen & ~zone & (np.hypot(across, positions[2] - centre[1, hole]) < size[hole] / 2)
            if inside.any():
                zone[np.flatnonzero(inside)[reach[inside].argmax()]] = True
                break
        else:
            return


class Cells(NamedTuple):
    """The membrane's Voronoi cells on the unfolded cylinder, for pictures (host).

    balls: (Z,) the balls of the zone, in the order of what follows.
    places: (2, Z) their places x' = theta * Rm in [0, width) and z [L].
    polygons: Z arrays (M, 2), the corners of each cell counter-clockwise [L]. Between periodic planes a cell may reach
        beyond x' = 0 or width; shifted by width it closes the gap on the other side.
    areas: (Z,) areas of the cells [L^2]; they add up to width times height.
    radius, width: Rm, and the length of the sector's strip [L].
    """

    balls: np.ndarray
    places: np.ndarray
    polygons: list[np.ndarray]
    areas: np.ndarray
    radius: float
    width: float


def cell_polygons(specimen: Specimen, sector: Sector) -> Cells:
    """The cells of a specimen's membrane zone, as cut to the sector, at its present positions.

    Raises ValueError as `build_membrane` does.
    """
    flat = unfold(specimen, sector)
    width = flat.radius * sector.angle
    diagram = Voronoi(flat.places.T)
    own = np.flatnonzero(flat.codes[5] > 0)
    own = own[np.argsort(flat.owners[own])]
    polygons, areas = [], np.zeros(own.size)
    for ball, place in enumerate(own):
        corners = diagram.vertices[diagram.regions[diagram.point_region[place]]]
        around = corners - flat.places[:, place]
        corners = corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
        if flat.share[ball] < 1:  # a centre on a platen or a rigid plane: the cell is cut there
            corners = _cut(_cut(corners, 1, specimen.bottom, 1), 1, specimen.top, -1)
            if sector.boundary == "rigid":
                corners = _cut(_cut(corners, 0, 0.0, 1), 0, width, -1)
        polygons.append(corners)
        x, y = corners.T
        areas[ball] = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    return Cells(flat.zone, flat.places[:, own], polygons, areas, flat.radius, width)


def _cut(corners, axis, at, sign):
    """The part of a convex polygon (M, 2) where sign * (coordinate - at) >= 0."""
    kept = []
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        u, v = sign * (a[axis] - at), sign * (b[axis] - at)
        if u >= 0:
            kept.append(a)
        if u * v < 0:
            kept.append(a + (b - a) * (u / (u - v)))
    return np.array(kept)
