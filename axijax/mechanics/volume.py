"""What the volume of a specimen is, from the positions of its balls and platens alone.

A lattice keeps its membrane zone: its volume is pi Rm^2 H, its void ratio e this over the volume of its balls less one,
and none of what follows is computed for it (`axijax.observe`). The outer balls of a random specimen come and go, small
ones drop into pores, and no mean over whichever are outermost now can be followed through that: the volume of a random
specimen is that of its solids times 1 + e, the solids being known and the void ratio e being counted below the skin.

- A probe of one radius, the mean by mass, rolls over all balls from outside along radial lines. The surface that it
  leaves is smoothed over SMOOTH radii, and what sticks out of the smooth surface by more than a radius is cut off, so
  that a ball that has been squeezed out does not lift the surface.
- Between the platens, void and solid are counted with a weight that rises from 0 one radius below this surface to 1 two
  radii below it. At the surface itself a void ratio is a matter of where the membrane is drawn, and hardly changes.

The count is exact for the balls, up to the curvature of the surface over one of them. It knows no membrane zone and no
history, so that a ball that joins or leaves the zone changes nothing, and lists made anew do not either.

How deep it begins is a choice, and counts that begin elsewhere find other balls cut: of packings of 150, 300 and 600
independent balls (eight each, radii 16 to 24) the difference between a count from one to two radii deep and one from
two to three scatters by 1.6, 0.9 and 0.6 % of the volume, about as the number of balls to the power -2/3. So the
volumetric strain of a few hundred balls in a sector is known to some 1 %, and, by that law, to 0.3 % of some thousands.
"""

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.gather import gathered
from axijax.core.sector import Sector, radial_distance
from axijax.core.vector import Vector

SPACING = 1.0  # of the points at which the surface is found, in radii of equal balls filling twice the height in width
SMOOTH = 1.5  # radii over which the surface is smoothed, as the standard deviation of a Gaussian
WIDE, TALL, CHUNK = 6, 5, 256  # columns and rows of a tile, which holds a ball of the mean size; tiles written at once
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
    surface = _surface(place, rho, angle, radius, mean, sector, bottom, top)
    depth = _between(surface, angle, (place.z - bottom) / (top - bottom), sector) - rho

    def weight_at(below):
        return jnp.clip(below / mean - 1, 0.0, 1.0)

    inside = sum(share * weight_at(depth + node * radius) for node, share in NODES)
    solid = (4 / 3) * np.pi * (weight * radius**3 * inside).sum()
    # Integral of weight times rho over rho, from the axis to the surface.
    to_one, to_two = (jnp.maximum(surface - deep * mean, 0.0) ** 3 / 6 for deep in (1, 2))
    space = sector.angle * (top - bottom) * ((to_one - to_two) / mean).mean()
    return jnp.where(solid > 0, space / jnp.where(solid > 0, solid, 1.0) - 1, jnp.nan)


def _surface(place: Vector, rho, angle, radius, mean, sector: Sector, bottom, top) -> jax.Array:
    """Distance of the skin from the axis at points spread evenly over angle and height, (A, Z) [L]."""
    across = (rho.size * sector.order) ** (1 / 3) / SPACING
    columns, rows = max(4, int(5.1 * across / sector.order)), max(4, int(3.24 * across))
    theta = jnp.asarray((np.arange(columns) + 0.5) * sector.angle / columns, rho.dtype)
    height = bottom + (top - bottom) * jnp.asarray((np.arange(rows) + 0.5) / rows, rho.dtype)
    reach = radius + mean

    ball = _outermost(*jax.lax.stop_gradient((place, rho, angle, reach, bottom, top)), (columns, rows), sector)
    column = jnp.arange(columns, dtype=jnp.int32)[:, None]
    if sector.boundary == "periodic":  # the nearest image stands out farthest
        turns = (jax.lax.stop_gradient(angle)[ball] - theta[:, None]) / sector.angle
        column = column + columns * jnp.floor(turns + 0.5).astype(jnp.int32)
    here = Vector(*gathered(tuple(place), ball))
    middle, beside = _along_line(here, column, columns, sector)
    rough = jnp.maximum(_leaving(middle, beside, height - here.z, reach[ball]) - mean, 0.0)

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


def _along_line(place: Vector, column, columns: int, sector: Sector):
    """Of the radial line of a column: how far from the axis it passes a place, and how far beside it.

    Columns go on beyond the sector into its images, from -2 pi to 4 pi.
    """
    around = columns * sector.order
    angle = (np.arange(-around, 2 * around) + 0.5) * (sector.angle / columns)
    cos, sin = (
        jnp.asarray(values, place.x.dtype).at[column + around].get(mode="clip")
        for values in (np.cos(angle), np.sin(angle))
    )
    return place.x * cos + place.y * sin, place.x * sin - place.y * cos


def _leaving(middle, beside, above, reach):
    """How far from the axis a radial line leaves a ball inflated by the probe; zero where it misses it.

    It passes the ball's centre at the distance `middle` from the axis, `beside` it and `above` it.
    """
    square = reach**2 - beside**2 - above**2
    met = (square > 0) & (middle > 0)
    return jnp.where(met, middle + jnp.sqrt(jnp.where(met, square, 1.0)), 0.0)


def _outermost(place: Vector, rho, angle, reach, bottom, top, shape: tuple[int, int], sector: Sector) -> jax.Array:
    """Which inflated ball the probe meets first on its way in at each point of the surface, (A, Z); no derivative.

    Ball after ball, from the one that stands out farthest inwards, writes itself to the points within its reach, until
    none of the others stands out as far as what has been found at every point. So the core of a specimen costs nothing,
    and nothing is left out whatever the specimen looks like. A ball is written in tiles of WIDE columns by TALL rows,
    as many as it needs; each pass of the loop writes CHUNK tiles.
    """
    (columns, rows), balls, around = shape, rho.size, shape[0] * sector.order
    low_bits = (1 << (balls - 1).bit_length()) - 1

    def rank(distance, ball):
        """One whole number that orders by distance, and by ball (the first is highest) where distances are equal.

        A positive number's bits order as it does; the last ones, some 1e-12 of it, give way to the ball's number.
        """
        ordered = jax.lax.bitcast_convert_type(distance.astype(jnp.float64), jnp.int64)
        return ordered & ~low_bits | (balls - 1 - ball)

    def ball_of(rank):
        return balls - 1 - (rank & low_bits).astype(jnp.int32)

    farthest = jnp.sort(rank(rho + reach, jnp.arange(balls)))[::-1]
    order = ball_of(farthest)
    place, rho, angle, reach = jax.tree.map(lambda values: values[order], (place, rho, angle, reach))

    def tiles(middle, half, least, most, size):
        """First of the points within `half` of a place, counted in points, and the number of tiles for all of them."""
        first = jnp.maximum(jnp.ceil(middle - half).astype(jnp.int32), least)
        last = jnp.minimum(jnp.floor(middle + half).astype(jnp.int32), most)
        return first, (jnp.maximum(last - first + 1, 0) + size - 1) // size

    sine = reach / jnp.maximum(rho, reach)
    half = sine * (1 + (np.pi / 2 - 1) * sine**2)  # never less than the arcsine
    per_angle, per_height = columns / sector.angle, rows / (top - bottom)
    half, limits = half * per_angle, (0, columns - 1)
    if sector.boundary == "periodic":  # once round the sector is enough, its images follow
        half, limits = jnp.minimum(half, columns / 2), (-around, 2 * around - 1)
    left, beside = tiles(angle * per_angle - 0.5, half, *limits, WIDE)
    lowest, above = tiles((place.z - bottom) * per_height - 0.5, reach * per_height, 0, rows - 1, TALL)
    ends = jnp.cumsum(beside * above, dtype=jnp.int32)

    def unfinished(carried):
        done, ball, best = carried
        return (done < ends[-1]) & (best.min() < farthest[ball] & ~low_bits)

    def entries(tile, ball):
        """The points of these tiles of these balls, and what is written there, both (WIDE, TALL, CHUNK)."""
        part = tile - (ends - beside * above)[ball]
        column = left[ball] + part % beside[ball] * WIDE + np.arange(WIDE, dtype=np.int32)[:, None]
        row = lowest[ball] + part // beside[ball] * TALL + np.arange(TALL, dtype=np.int32)[:, None]
        middle, aside = _along_line(place.at(ball), column, columns, sector)
        height = bottom + (row + 0.5).astype(rho.dtype) / per_height
        distance = _leaving(middle[:, None], aside[:, None], height - place.z[ball], reach[ball])
        # A last tile stands over; a ball without any, looked at behind the end of the list, may have one anywhere.
        inside = (row >= 0) & (row < rows)
        if sector.boundary == "rigid":
            inside = inside & ((column >= 0) & (column < columns))[:, None]
        wrapped = np.arange(-around, 2 * around, dtype=np.int32) % columns * rows
        point = jnp.asarray(wrapped).at[column + around].get(mode="clip")[:, None] + jnp.clip(row, 0, rows - 1)
        return point, jnp.where(inside, rank(distance, order[ball]), 0)

    def write(carried):
        done, _, best = carried
        tile = done + jnp.arange(CHUNK, dtype=jnp.int32)
        ball = jnp.searchsorted(ends, tile, side="right", method="scan_unrolled").astype(jnp.int32)
        ball = jnp.minimum(ball, balls - 1)
        # There is always a tile left. But XLA fuses across everything but a branch, and the entries together with the
        # scatter make a loop that is not vectorised and takes twice as long.
        blank = jax.tree.map(lambda made: jnp.zeros(made.shape, made.dtype), jax.eval_shape(entries, tile, ball))
        point, found = jax.lax.cond(done < ends[-1], entries, lambda *_: blank, tile, ball)
        return done + CHUNK, ball[-1], best.at[point.ravel()].max(found.ravel(), mode="promise_in_bounds")

    nothing = jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32), jnp.zeros(columns * rows, jnp.int64)
    return ball_of(jax.lax.while_loop(unfinished, write, nothing)[2]).reshape(columns, rows)


def _gaussian(distance) -> jax.Array:
    """Weights of a mean over places at these distances, in standard deviations; rows add up to one."""
    weights = jnp.exp(-(distance**2) / 2)
    return weights / weights.sum(axis=1, keepdims=True)


def _between(surface, angle, height, sector: Sector) -> jax.Array:
    """The surface at angles and heights (N,), the height as a share of the specimen's, interpolated linearly."""
    columns, rows = surface.shape
    x = angle / sector.angle * columns - 0.5
    if sector.boundary != "periodic":
        x = jnp.clip(x, 0, columns - 1)
    y = jnp.clip(height * rows - 0.5, 0, rows - 1)
    floors = jax.lax.stop_gradient((jnp.floor(x), jnp.floor(y)))
    u, v = x - floors[0], y - floors[1]
    # Not by a remainder, which a CPU takes number by number. Half a column more keeps rounding away from the ends.
    turns = jnp.floor((floors[0] + 0.5) / columns) if sector.boundary == "periodic" else 0
    left, below = (floors[0] - columns * turns).astype(jnp.int32), floors[1].astype(jnp.int32)
    right = left + 1
    right = jnp.where(right == columns, 0 if sector.boundary == "periodic" else columns - 1, right)
    above = jnp.minimum(below + 1, rows - 1)

    def at(column, row):  # all four in one array would be put together anew for each ball
        return gathered((surface.ravel(),), rows * column + row)[0]

    return (1 - u) * ((1 - v) * at(left, below) + v * at(left, above)) + u * (
        (1 - v) * at(right, below) + v * at(right, above)
    )
