"""Lists that change inside jit: `contact_list` gives `allocate`, which makes room on the host, and `update`, which
finds the contacts again; `rebuild_in_jit` the membrane as well.

The search puts every image of every ball into a grid of cells at least as wide as the longest contact and looks round
each ball in its 27 cells, so that an image is found like any other ball, for any n. Cells and capacities are fixed;
whatever does not fit, and whatever else went wrong, sets bits in the list's status, which stick.

Measured (two cores, n = 1, 4, 12; ms): 500 balls 2, 3, 8; 2000 balls 11, 37, 44; 8000 balls 400, 270, 610; the host's
k-d tree 3 to 12, 19 to 30, 130 to 210. All pairs take 7 to 83 and 250 to 1000, and jax-md's list misses images.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import QhullError

from axijax.core.gather import taken
from axijax.core.sector import Sector
from axijax.core.status import FULL_LIST, NOT_FINITE, STALE_CELLS, STALE_LIST
from axijax.core.vector import Vector, zeros
from axijax.mechanics.contact_list import (
    ContactList,
    Grid,
    build_contact_list,
    carry_memory,
    closing,
    keys,
    pair_cubes,
    places_in,
)
from axijax.mechanics.contacts import geometry
from axijax.mechanics.membrane import Membrane, membrane_arrays
from axijax.mechanics.outer_balls import zone_found_again
from axijax.mechanics.state import State
from axijax.specimen.specimen import Specimen


class ContactListFunctions(NamedTuple):
    """As jax-md's `NeighborListFns`: `allocate(specimen) -> ContactList` on the host, where a list gets its room;
    `update(displacement, network) -> ContactList` inside jit, where it keeps it. Look at `did_buffer_overflow`."""

    allocate: Callable[[Specimen], ContactList]
    update: Callable[[Vector, ContactList], ContactList]


def contact_list(
    sector: Sector,
    skin: float | None = None,
    capacity_multiplier: float = 1.5,
    largest_overlap: float = 0.05,
    dtype=np.float64,
) -> ContactListFunctions:
    """Contact lists of a sector by jax-md's protocol; springs go from one to the next by
    `axijax.mechanics.contact_list.carry`.

    capacity_multiplier: room over what is needed when the list is allocated [-]. The other arguments, and the errors of
        `allocate`, are those of `build_contact_list`.
    """

    def allocate(specimen: Specimen) -> ContactList:
        tight = build_contact_list(specimen, sector, skin, largest_overlap=largest_overlap, dtype=dtype)
        width = int(np.ceil(capacity_multiplier * tight.slot.shape[0]))
        contacts = 8 * int(np.ceil(capacity_multiplier * tight.first.size / 8))
        network = build_contact_list(specimen, sector, skin, width, contacts, largest_overlap, dtype)
        return replace(network, grid=grid_for(network, capacity_multiplier))

    return ContactListFunctions(allocate, update)


def grid_for(network: ContactList, capacity_multiplier: float = 1.5) -> Grid:
    """A grid for a contact list's balls, its capacity `capacity_multiplier` times what is needed now (host)."""
    x, y, z = np.asarray(network.positions)
    widest = 2 * float(network.radius.max()) + float(network.skin)
    across, along = (int(np.ceil(1.1 * size / widest)) + 1 for size in (2 * np.hypot(x, y).max(), np.ptp(z)))
    grid = Grid((across, across, along), 1)
    fullest = int(_cell_counts(grid, network, network.positions).max())
    return replace(grid, capacity=int(np.ceil(capacity_multiplier * fullest)) + 2)


def update(displacement: Vector, network: ContactList) -> ContactList:
    """The contact list at the present positions.

    displacement: (N,) vectors from the old list's reference positions; those of the new list are the present ones [L].
    Sets status bits, which stick: FULL_LIST where slots, contacts or cells did not suffice, STALE_LIST where two balls
    may have come closer by more than the skin, so that the old list may have missed a contact, NOT_FINITE.

    A contact that was listed keeps its branch vector and overlap to the last bit, with its tangent; indices have none.
    """
    assert network.grid is not None, "a list that is updated inside jit comes from `contact_list`"
    positions = network.positions + displacement
    near, full = _neighbours(network.grid, network, jax.lax.stop_gradient(positions))
    first, second, image, tables, too_many = _pair_up(network, near)

    moved = geometry(network, displacement)
    place, known = places_in(network, replace(network, first=first, second=second, image=image))
    listed = image >= 0

    turn = jnp.maximum(image, 0)
    cosine, sine = _turns(network)
    cos, sin = cosine[turn], sine[turn]
    far = 1e3 * network.radius.max()
    slot, side, turned = tables
    there = {"first": first, "second": second, "image": image, "cos": cos, "sin": sin, "slot": slot, "side": side}
    new = replace(network, **there, slot_cos=cosine[turned], slot_sin=sine[turned])
    fresh = new.apart(positions)
    fresh = Vector(jnp.where(listed, fresh.x, far), fresh.y * listed, fresh.z * listed)
    *kept, deep = taken([*moved.branch, moved.overlap], place, *places_in(new, network))
    branch = Vector(*(jnp.where(known, a, b) for a, b in zip(kept, fresh, strict=True)))
    distance = jnp.sqrt(branch.dot(branch))
    radii = network.radius[first], network.radius[second]
    overlap = jnp.where(known, deep, radii[0] + radii[1] - distance)
    overlap = jnp.where(listed, overlap, 2 * network.radius.max() - far)

    on_axis = network.free.x == 0
    alone = (first == second) & ((2 * image) % network.sector.order == 0)
    weight = jnp.where(on_axis[first] & on_axis[second], network.weight[first], 1.0) * jnp.where(alone, 0.5, 1.0)
    pair_cube = network.pair_cube
    if pair_cube.ndim:
        pair_cube = pair_cubes(new)
    bits = jnp.where(full | too_many, FULL_LIST, 0)
    bits |= jnp.where(closing(network, displacement) > network.skin, STALE_LIST, 0)
    bits |= jnp.where(jnp.isfinite(jnp.asarray(tuple(positions))).all(), 0, NOT_FINITE)
    return replace(
        new,
        branch=branch,
        distance=distance,
        overlap=overlap,
        pair_cube=pair_cube,
        share=jnp.where(listed, weight, 0.0).astype(network.dtype),
        positions=positions,
        status=network.status | bits,
    )


def rebuild_in_jit(network: ContactList, membrane: Membrane, state: State) -> tuple[ContactList, Membrane, State]:
    """Contact list and membrane at the present positions, and the state that goes with them.

    The membrane's zone is found again and triangulated by SciPy on the host, called from inside jit, in the room that
    it has; the list's status has FULL_LIST where that does not suffice, STALE_CELLS where it cannot be triangulated.
    Nothing of it has a tangent but the areas that are found from it.
    """
    made = update(state.displacement, network)
    held = membrane, network.radius, made.positions, state.platens
    membrane, trouble = jax.pure_callback(
        partial(_triangulated, network.sector, network.dtype),
        (jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, a.dtype), membrane), jax.ShapeDtypeStruct((), np.int32)),
        jax.lax.stop_gradient(held),
        vmap_method="sequential",
    )
    still = zeros(network.radius.shape, network.dtype)
    state = state._replace(displacement=still, memory=carry_memory(network, made, state.memory))
    return replace(made, status=made.status | trouble), membrane, state


def _triangulated(sector: Sector, dtype, held) -> tuple[Membrane, np.ndarray]:
    """The membrane found again on the host, or the old one and the bit that says why not."""
    old, radius, positions, (bottom, top) = jax.tree.map(np.asarray, held)
    zone = np.isin(np.arange(radius.size), old.zone)
    try:
        now = Specimen(np.asarray(positions), radius, float(bottom), float(top), zone, "", old.zone_rule)
        now = replace(now, membrane_zone=zone_found_again(now, sector))
        if now.membrane_zone.sum() > old.zone.size:
            return old, np.asarray(FULL_LIST, np.int32)
        made = membrane_arrays(now, sector, None, dtype, old.zone.size)
        if made.corner.shape[1] > old.corner.shape[1]:
            return old, np.asarray(FULL_LIST, np.int32)
        made = membrane_arrays(now, sector, old.corner.shape[1], dtype, old.zone.size)
    except (ValueError, QhullError):
        return old, np.asarray(STALE_CELLS, np.int32)
    made = replace(made, surface=old.surface)
    return jax.tree.map(lambda new, was: np.asarray(new, was.dtype), made, old), np.asarray(0, np.int32)


def _turns(network: ContactList):
    """Cosines and sines of the turns to all images."""
    return [jnp.asarray(values, network.dtype) for values in network.sector.cos_sin(np.arange(network.sector.images))]


def _copies(network: ContactList, positions: Vector):
    """Places of all images (P,) of the balls, in the order of the key ball * images + image; which of them are balls of
    their own. All images of a ball on the axis are the ball itself."""
    images = network.sector.images
    cos, sin = _turns(network)
    x, y, z = (part[:, None] for part in positions)
    places = Vector(cos * x - sin * y, sin * x + cos * y, jnp.broadcast_to(z, (z.size, images))).map(jnp.ravel)
    on_axis = (network.free.x == 0)[:, None]
    return places, (~on_axis | (jnp.arange(images) == 0)).ravel()


def _cells(grid: Grid, network: ContactList, positions: Vector, places: Vector):
    """The cell (3, ...) of every place."""
    rho = jnp.sqrt((positions.x**2 + positions.y**2).max())
    widest = 2 * network.radius.max() + network.skin
    origin = -rho, -rho, positions.z.min()
    return [
        jnp.clip(((part - start) / widest).astype(jnp.int32), 0, cells - 1)
        for part, start, cells in zip(places, origin, grid.cells, strict=True)
    ]


def _cell_counts(grid: Grid, network: ContactList, positions: Vector):
    places, real = _copies(network, positions)
    x, y, z = _cells(grid, network, positions, places)
    number = (x * grid.cells[1] + y) * grid.cells[2] + z
    return jnp.zeros(np.prod(grid.cells), jnp.int32).at[number].add(real)


def _neighbours(grid: Grid, network: ContactList, positions: Vector):
    """Keys (K, N) of the images near each ball, ascending, or `nothing` = N * images; and whether any did not fit."""
    places, real = _copies(network, positions)
    images, nothing = network.sector.images, real.size
    size = int(np.prod(grid.cells))
    x, y, z = _cells(grid, network, positions, places)
    number = jnp.where(real, (x * grid.cells[1] + y) * grid.cells[2] + z, size)
    order = jnp.argsort(number)
    start = jnp.searchsorted(number[order], jnp.arange(size + 1))
    row = jnp.arange(nothing) - start[number[order]]
    table = jnp.full((size, grid.capacity), nothing, jnp.int32)
    table = table.at[number[order], row].set(order.astype(jnp.int32), mode="drop")
    full = jnp.diff(start).max() > grid.capacity

    own = _cells(grid, network, positions, positions)
    steps = [[-1, 0, 1] if cells > 1 else [0] for cells in grid.cells]
    around = np.stack(np.meshgrid(*steps, indexing="ij")).reshape(3, -1, 1)
    x, y, z = (jnp.clip(cell + step, 0, most - 1) for cell, step, most in zip(own, around, grid.cells, strict=True))
    # A cell that is looked into twice, at the border, does no harm: a key is taken once.
    there = table[(x * grid.cells[1] + y) * grid.cells[2] + z]  # (27, N, capacity)
    there = there.transpose(0, 2, 1).reshape(-1, network.radius.size)
    at = jnp.minimum(there, nothing - 1)
    apart = places.at(at) - positions
    reach = network.radius[at // images] + network.radius + network.skin
    itself = there == jnp.arange(network.radius.size) * images
    near = (there < nothing) & (apart.dot(apart) < reach * reach) & ~itself
    there = jnp.where(near, there, nothing)

    def following(last, _):
        key = jnp.where(there > last, there, nothing).min(axis=0)
        return key, key

    last, near = jax.lax.scan(following, jnp.full(network.radius.shape, -1, jnp.int32), None, network.slot.shape[0])
    return near, full | ((there > last) & (there < nothing)).any()


def _pair_up(network: ContactList, near):
    """The contacts (C,), and the tables (K, N) of contact, side and turn; see
    `axijax.mechanics.contact_list._pair_up`."""
    images, balls, width = network.sector.images, network.radius.size, near.shape[0]
    listed = near < balls * images
    i = jnp.broadcast_to(jnp.arange(balls, dtype=near.dtype), near.shape)
    j, k = jnp.where(listed, near // images, 0), near % images
    back = -k % images
    on_axis = network.free.x == 0
    only_second, only_first = on_axis[i] & ~on_axis[j], on_axis[j] & ~on_axis[i]
    own = listed & (only_first | (~only_second & ((i < j) | ((i == j) & (k <= back)))))
    length = network.first.size
    place = jnp.nonzero(own.T.ravel(), size=length, fill_value=-1)[0]
    too_many = own.sum() > length - 1  # the last contact is never closed
    taken = (place >= 0) & (jnp.arange(length) < length - 1)
    first = jnp.where(taken, place // width, 0).astype(jnp.int32)
    row = jnp.where(taken, place % width, 0)
    second = jnp.where(taken, j[row, first], 0).astype(jnp.int32)
    image = jnp.where(taken, k[row, first], -1).astype(jnp.int32)

    wanted = jnp.where(own, keys(network, i, j, k), keys(network, j, i, jnp.where(only_second, 0, back)))
    slot = jnp.searchsorted(keys(network, first, second, image), wanted)
    slot = jnp.where(listed, jnp.minimum(slot, length - 1), length - 1).astype(jnp.int32)
    side = jnp.where(listed, jnp.where(own, 1.0, -1.0), 0.0).astype(network.dtype)
    turn = jnp.where(listed & ~own, k, 0)
    return first, second, image, (slot, side, turn), too_many
