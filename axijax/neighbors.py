"""The contact list: which ball may touch which image of which other, and from where.

A full list, K entries a ball, entry (k, i) = (ball i, ball j, image) in component-major arrays. It is built on
the host by a k-d tree over all images, and stays right while no ball has moved more than half the skin. The
motion is stored as displacement from the positions at which the list was built, and each entry keeps its branch
vector at that moment: so float32 loses nothing to large coordinates, and any image of a ball may represent it.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from axijax.packing import Specimen
from axijax.sector import Sector, turn


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Network:
    """Contact list of N balls with K entries each, a pytree of arrays.

    neighbor, image: (K, N) int, ball j and image of each entry; neighbor = -1 where the entry is empty.
    branch: (3, K, N) vector from the image of j to i at the reference positions [L]; huge where empty.
    reach: sum of the two radii [L]; () where all balls are equal, else (K, N).
    pair_cube: a^3 b^3 / (a^3 + b^3) of the two radii a, b [L^3], for the reduced mass; shaped like reach.
    column: (K, N) int, the entry's column in the table of images that `image_table` makes.
    copy_of, copy_cos, copy_sin: (M,) the balls of which a turned copy is in use, and the turn.
    positions: (3, N) reference positions [L].
    radius, weight: (N,) ball radii [L] and the share of each ball that belongs to the sector [-].
    free: (3, N) 1 where a ball may move along x, y, z (and spin about it), 0 where the axis forbids it.
    skin: how much farther than touching the list looks [L].
    """

    neighbor: jax.Array
    image: jax.Array
    branch: jax.Array
    reach: jax.Array
    pair_cube: jax.Array
    column: jax.Array
    copy_of: jax.Array
    copy_cos: jax.Array
    copy_sin: jax.Array
    positions: jax.Array
    radius: jax.Array
    weight: jax.Array
    free: jax.Array
    skin: jax.Array
    sector: Sector = field(metadata={"static": True})


def image_table(network: Network, vectors: jax.Array) -> jax.Array:
    """Vectors (3, N) of all balls followed by the turned copies that some entry needs; (3, N + M)."""
    if network.copy_of.size == 0:
        return vectors
    copies = jnp.stack(turn(vectors[:, network.copy_of], network.copy_cos, network.copy_sin))
    return jnp.concatenate([vectors, copies], axis=1)


def build_network(
    specimen: Specimen,
    sector: Sector,
    skin: float | None = None,
    width: int | None = None,
    copies: int | None = None,
    largest_overlap: float = 0.05,
    dtype=np.float64,
) -> Network:
    """Contact list of a specimen's balls in a sector (host).

    skin: how much farther than touching to look [L]; None takes 0.8 of the smallest radius, which in a cubic
        close packing stops just short of the second neighbours.
    width: number of entries K a ball; None takes what is needed.
    copies: number of turned copies M to pad to; None takes what is needed. A rebuilt list that keeps width and
        copies keeps its shape, and nothing is compiled again.
    largest_overlap: refuse a specimen with a deeper overlap than this, in radii of the smaller ball [-].

    Raises ValueError for overlapping balls, images included, and for a width or copies that are too small.
    """
    positions, radius = specimen.positions, specimen.radius
    count = len(specimen)
    if skin is None:
        skin = 0.8 * float(radius.min())
    if not (np.isfinite(skin) and skin >= 0):
        raise ValueError(f"skin = {skin!r}: must be zero or positive [L].")
    on_axis = sector.on_axis(positions, radius)

    i, j, k = _pairs(positions, 2 * radius.max() + skin, sector, on_axis)
    branch = positions[:, i] - sector.rotate(positions[:, j], k)
    reach = radius[i] + radius[j]
    near = np.linalg.norm(branch, axis=0) < reach + skin
    i, j, k, branch, reach = i[near], j[near], k[near], branch[:, near], reach[near]
    overlap = (reach - np.linalg.norm(branch, axis=0)) / np.minimum(radius[i], radius[j])
    if overlap.size and overlap.max() > largest_overlap:
        worst = overlap.argmax()
        raise ValueError(
            f"specimen: ball {i[worst]} and image {k[worst]} of ball {j[worst]} overlap by {overlap[worst]:.3g} "
            f"radii: at most {largest_overlap:g} is allowed; move or remove one of them."
        )

    order = np.lexsort((k, j, i))
    i, j, k, branch, reach = i[order], j[order], k[order], branch[:, order], reach[order]
    per_ball = np.bincount(i, minlength=count)
    needed = max(int(per_ball.max(initial=0)), 1)
    if width is None:
        width = needed
    if needed > width:
        raise ValueError(f"neighbour list width = {width}: a ball has {needed} neighbours; allow at least that many.")
    slot = np.arange(i.size) - np.repeat(np.cumsum(per_ball) - per_ball, per_ball)

    def filled(values, empty, kind):
        table = np.full((width, count), empty, kind)
        table[slot, i] = values
        return table

    pairs, which = np.unique(np.stack([j[k != 0], k[k != 0]]), axis=1, return_inverse=True)
    column = np.array(j)
    column[k != 0] = count + which.ravel()
    if copies is not None and copies < pairs.shape[1]:
        raise ValueError(f"turned copies = {copies}: {pairs.shape[1]} are in use; allow at least that many.")
    pairs = np.concatenate([pairs, np.zeros((2, (copies or pairs.shape[1]) - pairs.shape[1]), pairs.dtype)], axis=1)
    cos, sin = sector.cos_sin(pairs[1])
    cubes = radius[i] ** 3, radius[j] ** 3
    pair_cube = cubes[0] * cubes[1] / (cubes[0] + cubes[1])

    def per_entry(values, alike):
        """One number where all balls are equal: a scene that does not need an array does not carry one."""
        return jnp.asarray(alike, dtype) if np.ptp(radius) == 0 else jnp.asarray(filled(values, alike, dtype))

    far = 1e3 * radius.max()  # an empty entry is a ball far away that never touches
    return Network(
        neighbor=jnp.asarray(filled(j, -1, np.int32)),
        image=jnp.asarray(filled(k, 0, np.int32)),
        branch=jnp.asarray(np.stack([filled(branch[axis], far, dtype) for axis in range(3)])),
        reach=per_entry(reach, 2 * radius[0]),
        pair_cube=per_entry(pair_cube, radius[0] ** 3 / 2),
        column=jnp.asarray(np.where(filled(1, 0, bool), filled(column, 0, np.int32), np.arange(count, dtype=np.int32))),
        copy_of=jnp.asarray(pairs[0].astype(np.int32)),
        copy_cos=jnp.asarray(cos.astype(dtype)),
        copy_sin=jnp.asarray(sin.astype(dtype)),
        positions=jnp.asarray(positions.astype(dtype)),
        radius=jnp.asarray(radius.astype(dtype)),
        weight=jnp.asarray(sector.weight(on_axis).astype(dtype)),
        free=jnp.asarray(np.stack([~on_axis, ~on_axis, np.ones(count, bool)]).astype(dtype)),
        skin=jnp.asarray(skin, dtype),
        sector=sector,
    )


def _pairs(positions: np.ndarray, cutoff: float, sector: Sector, on_axis: np.ndarray):
    """All (i, j, k) whose centres are nearer than cutoff, a ball's own self and the copies of an on-axis ball left out."""
    count = positions.shape[1]
    balls = np.tile(np.arange(count), sector.images)
    turns = np.repeat(np.arange(sector.images), count)
    copies = sector.rotate(positions[:, balls], turns)
    distinct = (turns == 0) | ~on_axis[balls]  # all images of an on-axis ball are the ball itself
    balls, turns, copies = balls[distinct], turns[distinct], copies[:, distinct]
    near = cKDTree(positions.T).sparse_distance_matrix(cKDTree(copies.T), cutoff, output_type="ndarray")
    i, column = near["i"], near["j"]
    j, k = balls[column], turns[column]
    other = (i != j) | (k != 0)
    return i[other], j[other], k[other]


def carry_springs(old: Network, new: Network, springs: np.ndarray) -> np.ndarray:
    """Springs (3, K, N) of the old list's entries, each at its place (ball, neighbour, image) in the new list (host).

    A contact that the new list does not hold is open, and its spring is dropped. Both lists must describe every
    ball by the same image, as `rebuild` does.
    """
    images = old.sector.images

    def keys(network):
        neighbor = np.asarray(network.neighbor, np.int64)
        ball = np.arange(neighbor.shape[1])
        key = (ball * neighbor.shape[1] + neighbor) * images + np.asarray(network.image)
        return np.where(neighbor >= 0, key, -1)

    before, after = keys(old).ravel(), keys(new).ravel()
    order = np.argsort(before)
    place = np.minimum(np.searchsorted(before, after, sorter=order), before.size - 1)
    found = (before[order[place]] == after) & (after >= 0)
    flat = np.asarray(springs).reshape(3, -1)[:, order[place]] * found
    return flat.reshape(3, *new.neighbor.shape)
