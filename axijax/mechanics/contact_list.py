"""The contact list: which ball may touch which image of which other, and from where.

A contact is (ball i, ball j, image k) with the spring and the force in the frame of ball i. The same contact seen
from j is (j, i, -k), so each pair is listed once: its force acts on i, and turned back by -k with the other sign on
j. Every ball gathers its contacts through a table of slots; nothing is scattered, and sums have a fixed order.

The list is built on the host by a k-d tree over all images (`axijax.mechanics.contact_search` makes it anew inside
jit), and stays right while no two balls have come closer by more than the skin (`closing`). Motion is stored as
displacement from the positions at which the list was built, and each contact keeps its branch vector of that moment: so
float32 loses nothing to large coordinates, and any image of a ball may represent it.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.gather import taken
from axijax.core.images import directed_pairs
from axijax.core.sector import Sector, radial_distance
from axijax.core.shown import shown
from axijax.core.status import FULL_LIST
from axijax.core.vector import Vector
from axijax.mechanics import contact_sums
from axijax.specimen.specimen import Specimen

if TYPE_CHECKING:
    from axijax.mechanics.term import Memory


@dataclass(frozen=True)
class Grid:
    """Cells of the search inside jit: how many along x, y, z, and for how many balls each; static and hashable.

    What lies outside goes to the outermost cells, so that a specimen may outgrow the grid until one is full.
    """

    cells: tuple[int, int, int]
    capacity: int


class Room(NamedTuple):
    """Numbers of contacts and of slots of the tight lists, see `axijax.mechanics.tight_list`; static and hashable.

    crowd, further: balls that may have more contacts than `width`, and how many more each, see `Crowd`; 0 for none.
    """

    contacts: int
    width: int
    crowd: int = 0
    further: int = 0


class Crowd(NamedTuple):
    """Further slots of the balls that have more contacts than the table of slots has rows: of a wide grading the
    largest balls have some dozen contacts, most balls six. There are M - 1 columns for them, and an empty one.

    slot, side, slot_cos, slot_sin: (R, M) as of `ContactList`. column: (N,) int, of each ball, the last where it has no
    further slots.
    """

    slot: jax.Array
    side: jax.Array
    slot_cos: jax.Array
    slot_sin: jax.Array
    column: jax.Array


@shown
@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactList:
    """C possible contacts among N balls, at most K each; a pytree of arrays. The last contact is never closed.

    first, second, image: (C,) int, the contact (i, j, k); -1 in image where the contact is padding.
    cos, sin: (C,) of the turn to image k.
    branch: (C,) vectors from the image of j to i at the reference positions [L]; huge where padding.
    distance, overlap: (C,) their length and the overlap there, negative for a gap [L].
    pair_cube: A B / (A + B) of the two balls' `mass_cube` [L^3], for the reduced mass; () where all balls are equal.
    share: (C,) the part of each contact that belongs to the sector, so that sums count it once [-].
    slot: (K, N) int, the contacts of each ball; the last contact where a slot is empty.
    side: (K, N) 1 where the ball is the contact's first, -1 where its second, 0 where the slot is empty.
    slot_cos, slot_sin: (K, N) of the turn from the contact's frame to the ball's.
    positions: (N,) reference positions [L].
    radius, weight: (N,) ball radii [L] and the share of each ball that belongs to the sector [-].
    free: (N,) vectors of 1 where a ball may move along x, y, z (and spin about it), 0 where the axis forbids it.
    skin: how much farther than touching the list looks [L].
    status: bits of what went wrong in any update so far; an error sticks.
    grid: with which `axijax.mechanics.contact_search` finds contacts inside jit; None where it never does.
    tight: room of the tight lists that steps may see in its place; None where nearly all of its contacts touch.
    crowd: further slots of balls with more contacts than K; None where none can have more.
    mass_factor: (N,) by which the balls' true masses and moments of inertia are multiplied, see
        `axijax.mechanics.mass_scaling`; None for true ones [-].
    """

    first: jax.Array
    second: jax.Array
    image: jax.Array
    cos: jax.Array
    sin: jax.Array
    branch: Vector
    distance: jax.Array
    overlap: jax.Array
    pair_cube: jax.Array
    share: jax.Array
    slot: jax.Array
    side: jax.Array
    slot_cos: jax.Array
    slot_sin: jax.Array
    positions: Vector
    radius: jax.Array
    weight: jax.Array
    free: Vector
    skin: jax.Array
    status: jax.Array
    sector: Sector = field(metadata={"static": True})
    grid: Grid | None = field(default=None, metadata={"static": True})
    tight: Room | None = field(default=None, metadata={"static": True})
    crowd: Crowd | None = None
    mass_factor: jax.Array | None = None

    @property
    def dtype(self):
        return self.radius.dtype

    @property
    def did_buffer_overflow(self) -> jax.Array:
        """Whether an update found more contacts than there is room for, as in jax-md; then make a new list."""
        return (self.status & FULL_LIST) != 0

    @property
    def mass_cube(self) -> jax.Array:
        """Radius cubed, times the mass factor: what the balls' masses are proportional to; (N,) [L^3]."""
        cube = self.radius**3
        return cube if self.mass_factor is None else cube * self.mass_factor

    def contact_radii(self) -> tuple[jax.Array, jax.Array]:
        """Radii of the contacts' first and second balls [L]; () where all balls are equal."""
        if self.pair_cube.ndim == 0:
            radius = jnp.cbrt(2 * self.pair_cube)
            return radius, radius
        first, second = (self.radius.at[i].get(mode="promise_in_bounds") for i in (self.first, self.second))
        return first, second

    def at_ends(self, vectors: Vector) -> tuple[Vector, Vector]:
        """Vectors of the balls (N,) at the contacts' first balls, and at their second, turned to their image; (C,)."""
        found = contact_sums.at_ends(self, tuple(vectors))
        first, second = Vector(*found[:3]), Vector(*found[3:])
        return first, second if self.sector.images == 1 else second.turned(self.cos, self.sin)

    def numbers_at_ends(self, numbers: jax.Array) -> list[jax.Array]:
        """Numbers of the balls (N,) at the contacts' first and second balls; (C,) each."""
        return contact_sums.at_ends(self, (numbers,))

    def apart(self, vectors: Vector) -> Vector:
        """Vectors of the balls (N,) at the contacts' first balls less those at the second, as turned; (C,)."""
        first, second = self.at_ends(vectors)
        return first - second

    def together(self, vectors: Vector) -> Vector:
        """The sum of the two in place of their difference."""
        first, second = self.at_ends(vectors)
        return first + second

    def sum_on_balls(self, vectors: Vector, *, reaction: float) -> Vector:
        """Sum of the contacts' vectors (C,) on each ball (N,), times `reaction` (-1 or 1) on the second ball."""
        return Vector(*contact_sums.on_balls(self, vectors, reaction))


def build_contact_list(
    specimen: Specimen,
    sector: Sector,
    skin: float | None = None,
    max_contacts_per_ball: int | None = None,
    contacts: int | None = None,
    largest_overlap: float = 0.05,
    dtype=np.float64,
) -> ContactList:
    """Contact list of a specimen's balls in a sector (host).

    skin: how much farther than touching to look [L]; None takes 0.8 of the smallest radius, which in a cubic
        close packing stops just short of the second neighbours.
    max_contacts_per_ball, contacts: numbers of slots K and of contacts C to pad to; None takes what is needed. A
        rebuilt list that keeps both keeps its shape, and nothing is compiled again.
    largest_overlap: refuse a specimen with a deeper overlap than this, in radii of the smaller ball [-].

    Raises ValueError for overlapping balls, images included, and for numbers to pad to that are too small.
    """
    positions, radius = specimen.positions, specimen.radius
    count = len(specimen)
    if skin is None:
        skin = 0.8 * float(radius.min())
    if not (np.isfinite(skin) and skin >= 0):
        raise ValueError(f"skin = {skin!r}: must be zero or positive [L].")
    on_axis = sector.on_axis(positions, radius)
    i, j, k = directed_pairs(positions, radius, skin, sector, on_axis)
    ball, contact, side, turn, (i, j, k) = _pair_up(i, j, k, on_axis, sector)
    branch = positions[:, i] - sector.rotate(positions[:, j], k)
    distance = np.linalg.norm(branch, axis=0)
    overlap = radius[i] + radius[j] - distance
    depth = overlap / np.minimum(radius[i], radius[j])
    if depth.size and depth.max() > largest_overlap:
        worst = depth.argmax()
        raise ValueError(
            f"specimen: ball {i[worst]} and image {k[worst]} of ball {j[worst]} overlap by {depth[worst]:.3g} "
            f"radii: at most {largest_overlap:g} is allowed; move or remove one of them, or give the test the "
            "stiffness and the confining stress under which the packing was made."
        )

    per_ball = np.bincount(ball, minlength=count)
    needed = max(int(per_ball.max(initial=0)), 1)
    slots_of_a_ball = needed if max_contacts_per_ball is None else max_contacts_per_ball
    if slots_of_a_ball < needed:
        raise ValueError(
            f"max_contacts_per_ball = {slots_of_a_ball}: a ball has {needed} neighbours; allow at least that many."
        )
    # A multiple of 8 keeps the loops over contacts free of remainders.
    length = contacts or -(-(i.size + 1) // 8) * 8
    if length < i.size + 1:
        raise ValueError(f"contact list length = {length}: {i.size + 1} are needed; allow at least that many.")
    row = np.arange(ball.size) - np.repeat(np.cumsum(per_ball) - per_ball, per_ball)

    def slots(values, empty, kind=dtype):
        table = np.full((slots_of_a_ball, count), empty, kind)
        table[row, ball] = values
        return table

    def padded(values, empty, kind=dtype):
        return np.concatenate([values, np.full(length - i.size, empty)]).astype(kind)

    far = 1e3 * radius.max()  # a padding contact is between balls far apart that never touch
    cubes = radius[i] ** 3, radius[j] ** 3
    equal = np.ptp(radius) == 0
    share = sector.weight(on_axis[i] & on_axis[j]) / np.where((i == j) & (2 * k % sector.order == 0), 2.0, 1.0)
    cos, sin = sector.cos_sin(k)
    slot_cos, slot_sin = sector.cos_sin(turn)
    made: dict[str, Any] = dict(
        first=padded(i, 0, np.int32),
        second=padded(j, 0, np.int32),
        image=padded(k, -1, np.int32),
        cos=padded(cos, 1.0),
        sin=padded(sin, 0.0),
        branch=Vector(padded(branch[0], far), padded(branch[1], 0.0), padded(branch[2], 0.0)),
        distance=padded(distance, far),
        overlap=padded(overlap, 2 * radius.max() - far),
        pair_cube=np.asarray(radius[0] ** 3 / 2, dtype) if equal else padded(cubes[0] * cubes[1] / sum(cubes), 1.0),
        share=padded(share, 0.0),
        slot=slots(contact, length - 1, np.int32),
        side=slots(side, 0.0),
        slot_cos=slots(slot_cos, 1.0),
        slot_sin=slots(slot_sin, 0.0),
        positions=Vector(*positions.astype(dtype)),
        radius=radius.astype(dtype),
        weight=sector.weight(on_axis).astype(dtype),
        free=Vector(*np.stack([~on_axis, ~on_axis, np.ones(count, bool)]).astype(dtype)),
        skin=np.asarray(skin, dtype),
        status=np.zeros((), np.int32),
    )
    return jax.device_put(ContactList(**made, sector=sector))  # all at once, which takes a tenth of the time


def with_mass_factor(network: ContactList, factor: jax.Array | None) -> ContactList:
    """The same contacts between balls whose true masses are multiplied by `factor`, (N,) or None [-]."""
    network = replace(network, mass_factor=factor)
    return network if factor is None else replace(network, pair_cube=pair_cubes(network))


def pair_cubes(network: ContactList) -> jax.Array:
    """(C,) of a network in which not all balls have one mass, see `ContactList.pair_cube`; 1 where padding [L^3]."""
    cube = network.mass_cube
    a, b = cube[network.first], cube[network.second]
    return jnp.where(network.image >= 0, a * b / (a + b), 1.0)


def closing(network: ContactList, displacement: Vector, further: jax.Array | None = None) -> jax.Array:
    """The most by which two balls, images included, can have come closer since the list was built [L].

    No contact is missing while this is below the skin. displacement: (N,) vectors since then [L]; further: (N,) by
    which each ball may move besides, None for nothing [L].

    It is the sum of the two largest displacements; so one ball that flies alone does not wear the list twice. A ball
    that can touch its own image, however, meets one that comes inward as much as itself: from rho0 to rho the distance
    2 rho sin(pi k/n) to image k falls by 2 (rho0 - rho) sin(pi k/n), and where they can touch sin(pi k/n) < radius/rho.
    Nothing jumps in it, so that a ball that slowly comes near enough to touch its image wears the list on the way.
    """
    moved = displacement.dot(displacement)
    if further is not None:
        moved = (jnp.sqrt(moved) + further) ** 2
    farthest = moved.argmax()
    sum_of_two = jnp.sqrt(moved[farthest]) + jnp.sqrt(moved.at[farthest].set(0.0).max())
    if network.sector.images == 1:
        return sum_of_two
    rho = radial_distance(network.positions + displacement)
    if further is not None:
        rho = jnp.maximum(rho - further, 0.0)
    inward = jnp.maximum(radial_distance(network.positions) - rho, 0.0)
    return jnp.maximum(sum_of_two, (2 * inward * network.radius / jnp.maximum(rho, network.radius)).max())


def _pair_up(i, j, k, on_axis, sector: Sector):
    """One contact for each pair of directed entries (i, j, k) and (j, i, -k).

    Returns, for each directed entry, its ball, its contact, its side (1 first, -1 second) and the turn from the
    contact's frame to the ball's; then the contacts (i, j, k).

    The first ball is the one off the axis: seen from an on-axis ball the contact exists under all images, seen from
    its neighbour once. Else it is the lower number, and for a ball against its own image the smaller turn.
    """
    images = sector.images
    back = -k % images
    only_second = on_axis[i] & ~on_axis[j]
    only_first = on_axis[j] & ~on_axis[i]
    own = only_first | (~only_second & ((i < j) | ((i == j) & (k <= back))))
    count = int(max(i.max(initial=0), j.max(initial=0))) + 1

    def key(a, b, c):
        return (a * count + b) * images + c

    keys = key(i[own], j[own], k[own])  # sorted, as the entries are
    mirrored = key(j, i, np.where(only_second, 0, back))
    contact = np.searchsorted(keys, np.where(own, key(i, j, k), mirrored))
    # A reaction acts on the second ball itself, the contact on its image k: turn back by that much.
    turn = np.where(own, 0, k)
    return i, contact, np.where(own, 1.0, -1.0), turn, (i[own], j[own], k[own])


def keys(network: ContactList, first, second, image) -> jax.Array:
    """One number for each contact (i, j, k), ascending in a list; padding comes last."""
    key = (first.astype(jnp.int64) * network.radius.size + second) * network.sector.images + image
    return jnp.where(image >= 0, key, jnp.iinfo(jnp.int64).max)


def places_in(old: ContactList, new: ContactList) -> tuple[jax.Array, jax.Array]:
    """Where each contact of the new list is in the old one, and whether it is there at all; (C,) each.

    Both lists must describe every ball by the same image.
    """
    before, after = (keys(each, each.first, each.second, each.image) for each in (old, new))
    order = jnp.argsort(before)
    place = order[jnp.minimum(jnp.searchsorted(before, after, sorter=order), before.size - 1)]
    return place, (before[place] == after) & (new.image >= 0)


@jax.jit
def carry(old: ContactList, new: ContactList, values: Any) -> Any:
    """What belongs to the old list's contacts, a pytree of (C,) arrays, at each contact's place in the new list; zero
    for contacts that the old list does not hold."""
    place, known = places_in(old, new)
    parts, structure = jax.tree.flatten(values)
    found = taken(parts, place, *places_in(new, old))
    return jax.tree.unflatten(structure, [jnp.where(known, part, jnp.zeros((), part.dtype)) for part in found])


def carry_memory(old: ContactList, new: ContactList, memory: tuple["Memory", ...]) -> tuple["Memory", ...]:
    """The terms' memory, with what belongs to contacts carried to a new list."""
    return tuple(each._replace(contact=carry(old, new, each.contact)) for each in memory)
