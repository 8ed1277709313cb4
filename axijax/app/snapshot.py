"""One moment of a test as plain NumPy arrays, for pictures, files and checks: balls, contacts, membrane, platens.

The sector's images are filled in where asked for: every vector and tensor is turned with its ball, a ball on the axis
comes once, and so does a contact that is its own image.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.sector import Sector, plane_normals
from axijax.core.vector import zeros
from axijax.mechanics.contacts import geometry
from axijax.mechanics.dynamics import all_forces, positions
from axijax.mechanics.membrane import lateral_force, membrane_radius
from axijax.mechanics.membrane_surface import straightened
from axijax.mechanics.observe import at_coulomb_limit
from axijax.mechanics.outer_balls import cell_polygons
from axijax.triaxial.engine import current_load
from axijax.triaxial.progress import Progress
from axijax.triaxial.test import TriaxialTest


class Balls(NamedTuple):
    """B balls; (B,) arrays, vectors (3, B), tensors (3, 3, B).

    number, image: the ball of the test's `cut`, and by how many turns of 2 pi / n it is turned.
    positions [L], radius [L], velocity [L/T], spin [1/T].
    displacement: since the end of confinement [L]; None where the snapshot was made without its positions.
    stress: mean stress of the ball, compression positive, sum of arm times force over its volume (Love-Weber); the
        forces are those of contacts, platens, membrane and rigid planes [F/L^2].
    coordination: number of touching contacts with other balls.
    weight: share of the ball that belongs to the sector, 1/n on the axis; 1 where images are filled in.
    membrane_area: area of its membrane cell, zero inside [L^2].
    membrane_zone: whether it carries the membrane.
    """

    number: np.ndarray
    image: np.ndarray
    positions: np.ndarray
    radius: np.ndarray
    displacement: np.ndarray | None
    velocity: np.ndarray
    spin: np.ndarray
    stress: np.ndarray
    coordination: np.ndarray
    weight: np.ndarray
    membrane_area: np.ndarray
    membrane_zone: np.ndarray


class TouchingContacts(NamedTuple):
    """C touching contacts; (C,) arrays, vectors (3, C).

    first, second, image: the contact (i, j, k): ball i touches ball j turned k times. copy: by how many turns the
        contact itself is turned.
    start, end: centres of ball i and of the image of ball j [L].
    force: on ball i [F]. normal: unit vector towards ball i.
    normal_force, tangential_force: sizes [F].
    sliding: at the Coulomb limit.
    share: part of the contact that belongs to the sector; 1 where images are filled in.
    """

    first: np.ndarray
    second: np.ndarray
    image: np.ndarray
    copy: np.ndarray
    start: np.ndarray
    end: np.ndarray
    force: np.ndarray
    normal: np.ndarray
    normal_force: np.ndarray
    tangential_force: np.ndarray
    sliding: np.ndarray
    share: np.ndarray


class MembraneCells(NamedTuple):
    """Z cells on the unfolded cylinder of radius Rm.

    number, image: ball of each cell and how often it is turned, (Z,).
    places: (2, Z) of the balls on it, x' = theta Rm and z [L]. polygons: corners (P, 2) of each cell [L].
    area: (Z,) of the cells as loaded [L^2]. force, upward: (Z,) towards the axis and along it [F].
    radius: Rm [L].
    stale: share of the strip counted to a wrong cell since the membrane was triangulated [-].
    """

    number: np.ndarray
    image: np.ndarray
    places: np.ndarray
    polygons: list[np.ndarray]
    area: np.ndarray
    force: np.ndarray
    upward: np.ndarray
    radius: float
    stale: float


class Platens(NamedTuple):
    """The bottom and the top platen: heights (2,) [L] and forces of the balls on them (2,), positive [F].

    restraint: friction of these and of rigid sector planes towards the axis, times distance, summed [F L].
    """

    heights: np.ndarray
    forces: np.ndarray
    restraint: float


class Snapshot(NamedTuple):
    """One moment of a test; `full` where the sector's images are filled in.

    axial_strain, stress_ratio: at this moment [-]. confining_stress: lateral stress at this moment [F/L^2].
    """

    axial_strain: float
    stress_ratio: float
    confining_stress: float
    sector: Sector
    full: bool
    balls: Balls
    contacts: TouchingContacts
    membrane: MembraneCells
    platens: Platens


def confined_positions(test: TriaxialTest, progress: Progress) -> np.ndarray:
    """Ball centres at the end of confinement, (3, N) [L], by confining once more."""
    state, _ = test.confine(progress.params)
    return np.asarray(positions(test.network, state), float)


def snapshot(
    test: TriaxialTest, progress: Progress, full: bool = False, confined: np.ndarray | None = None
) -> Snapshot:
    """The last state of a shear in progress (host).

    full: fill in the images to the whole cylinder; with n = 1 or rigid planes there are none.
    confined: (3, N) centres at the end of confinement, from which displacements count, see `confined_positions` [L].
    """
    sector, network, state = test.sector, progress.network, progress.state
    n = sector.images
    dt = test.prepared.time_step
    seen = _mechanics(test.scene, progress.params, network, progress.membrane, progress.fixed, dt, state)
    seen = {name: np.asarray(value) for name, value in seen.items()}
    place = np.asarray(positions(network, state), float)
    heights = np.asarray(state.platens, float)
    radius, on_axis = test.cut.radius, sector.on_axis(test.cut.positions, test.cut.radius)

    # All images of all balls, and all images of all contacts, each once; the sector's own come first.
    number, image = np.tile(np.arange(radius.size), n), np.repeat(np.arange(n), radius.size)
    distinct = (image == 0) | ~on_axis[number]
    number, image = number[distinct], image[distinct]
    touching = np.flatnonzero((np.asarray(network.image) >= 0) & (seen["overlap"] > 0))
    copies = np.rint(n * np.asarray(network.share, float)[touching]).astype(int)
    copy = np.repeat(np.arange(n), touching.size)
    contact = np.tile(touching, n)
    once = copy < np.tile(copies, n)
    contact, copy = contact[once], copy[once]
    first, second, turn = (np.asarray(a)[contact] for a in (network.first, network.second, network.image))

    # Where a ball's image is in the list above.
    row = np.full((n, radius.size), -1)
    row[image, number] = np.arange(number.size)
    row[:, on_axis] = row[0, on_axis]
    ends = row[copy, first], row[(copy + turn) % n, second]

    force, apart = sector.rotate(seen["force"][:, contact], copy), sector.rotate(seen["apart"][:, contact], copy)
    length = np.linalg.norm(apart, axis=0)
    normal = apart / length
    normal_force = (force * normal).sum(0)
    tangential_force = np.linalg.norm(force - normal * normal_force, axis=0)
    start = sector.rotate(place[:, first], copy)

    # Arms end where the contact law puts them, on the branch in the proportion of the radii.
    stress = np.zeros((number.size, 3, 3))
    product = np.einsum("ac,bc->cab", apart, force) / (radius[first] + radius[second])[:, None, None]
    for end, ball in zip(ends, (first, second), strict=True):
        np.add.at(stress, end, product * radius[ball][:, None, None])
    stress += _turned(sector, _boundary_moments(sector, radius, place, heights, seen)[number], image)
    stress = np.moveaxis(stress / (4 / 3 * np.pi * radius[number] ** 3)[:, None, None], 0, -1)

    def turned(vectors):
        return sector.rotate(np.asarray(vectors, float)[:, number], image)

    def part(table, kept):
        return type(table)(*(None if values is None else values[..., kept] for values in table))

    balls = Balls(
        number=number,
        image=image,
        positions=turned(place),
        radius=radius[number],
        displacement=None if confined is None else turned(place - confined),
        velocity=turned(state.velocity),
        spin=turned(np.zeros_like(place) if state.spin is None else state.spin),
        stress=stress,
        coordination=np.bincount(np.concatenate(ends), minlength=number.size),
        weight=np.ones(number.size) if full else sector.weight(on_axis)[number],
        membrane_area=seen["area"][number],
        membrane_zone=np.isin(number, np.asarray(progress.membrane.zone)),
    )
    contacts = TouchingContacts(
        first=first, second=second, image=turn, copy=copy, start=start, end=start - apart, force=force, normal=normal,
        normal_force=normal_force, tangential_force=tangential_force, sliding=seen["sliding"][contact],
        share=np.ones(contact.size) if full else np.asarray(network.share, float)[contact],
    )  # fmt: skip
    times = n if full else 1
    forces = seen["platens"] * times
    inward = np.einsum("wai,ai,i->", seen["held"][:, :2], place[:2], np.asarray(network.weight)) * times
    lateral_stress = float(state.lateral_stress(progress.params))
    return Snapshot(
        axial_strain=progress.strain,
        stress_ratio=float(seen["straightened"].mean() / seen["section"] / lateral_stress),
        confining_stress=lateral_stress,
        sector=sector,
        full=full,
        balls=balls if full else part(balls, balls.image == 0),
        contacts=contacts if full else part(contacts, contacts.copy == 0),
        membrane=_cells(test, progress, seen, heights, sector.images if full else 1),
        platens=Platens(heights, forces, float(inward)),
    )


@partial(jax.jit, static_argnums=0)
def _mechanics(scene, params, network, membrane, fixed, dt, state):
    """Forces of a moment, by name."""
    place = positions(network, state)
    load = current_load(membrane, network, state, fixed)
    forces = all_forces(scene, params, network, load, dt, state)
    pair = geometry(network, state.displacement)
    force = forces.contacts.force
    normal = pair.branch * (1 / pair.branch.dot(pair.branch) ** 0.5)
    sliding = jnp.zeros_like(network.first, bool)
    if forces.contacts.spring is not None:
        sliding = at_coulomb_limit(params, network, force, normal)
    lateral = lateral_force(state.lateral_stress(params), load, place)
    still = zeros(network.radius.shape, network.dtype)
    held = [jnp.stack([*(still if each is None else each)]) for each in forces.walls.held]
    return {
        "force": jnp.stack([*force]),
        "apart": jnp.stack([*pair.branch]),
        "overlap": pair.overlap,
        "sliding": sliding,
        "platens": forces.platen_forces(network),
        "straightened": straightened(state.lateral_stress(params), load, forces.platen_forces(network)),
        "lateral": jnp.stack([*lateral]),
        "walls": jnp.stack(forces.walls.normal),
        "held": jnp.stack(held),
        "area": load.lateral if load.lateral.ndim == 1 else jnp.zeros_like(network.radius),
        "section": load.section,
        "stale": load.stale,
        "membrane_radius": membrane_radius(membrane, place),
        "resultant": jnp.stack([*forces.resultant]),
    }


def _boundary_moments(sector: Sector, radius: np.ndarray, place: np.ndarray, heights: np.ndarray, seen) -> np.ndarray:
    """Arm times force of platens, lateral load and rigid planes on each ball; (N, 3, 3) [F L]. Arms reach to the
    platen or the plane, and to the ball's surface where the membrane presses."""

    def pressed(direction, size, arm):
        return np.einsum("ai,bi,i->iab", direction, direction, size * arm)

    lateral = seen["lateral"]
    size = np.linalg.norm(lateral, axis=0)
    total = pressed(lateral / np.where(size > 0, size, 1.0), size, radius)
    inward, gaps = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], [place[2] - heights[0], heights[1] - place[2]]
    if sector.boundary == "rigid":
        normals = plane_normals(sector)
        inward += [[*normal, 0.0] for normal in normals]
        gaps += [normal @ place[:2] for normal in normals]
    for normal, gap, push, held in zip(np.array(inward), gaps, seen["walls"], seen["held"], strict=True):
        total += np.einsum("a,bi->iab", normal, gap * (normal[:, None] * push - held))
    return total


def _turned(sector: Sector, tensors: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Tensors (B, 3, 3) turned with their balls; image: (B,)."""
    axes = sector.rotate(np.eye(3)[:, :, None], image)  # (3, 3, B): the turned axes, one a column
    return np.einsum("aib,bij,cjb->bac", axes, tensors, axes)


def _cells(test: TriaxialTest, progress: Progress, seen, heights: np.ndarray, images: int) -> MembraneCells:
    membrane, sector = progress.membrane, progress.network.sector
    if progress.fixed is not None and progress.fixed.lateral.ndim == 2:  # loaded without a membrane
        none, still = np.zeros(0, int), np.zeros(0)
        return MembraneCells(none, none, np.zeros((2, 0)), [], still, still, still, float(seen["membrane_radius"]), 0.0)
    zone, radius = np.asarray(membrane.zone), float(seen["membrane_radius"])
    now = replace(
        test.cut, positions=np.asarray(positions(progress.network, progress.state), float), bottom=heights[0],
        top=heights[1], membrane_zone=np.isin(np.arange(len(test.cut)), zone),
    )  # fmt: skip
    cells = cell_polygons(now, sector)
    image = np.repeat(np.arange(images), zone.size)
    shift = np.array([radius * sector.angle, 0.0])
    return MembraneCells(
        number=np.tile(cells.balls, images),
        image=image,
        places=np.concatenate([cells.places + k * shift[:, None] for k in range(images)], axis=1),
        polygons=[polygon + k * shift for k in range(images) for polygon in cells.polygons],
        area=np.tile(seen["area"][cells.balls], images),
        force=np.tile(np.linalg.norm(seen["lateral"][:2, cells.balls], axis=0), images),
        upward=np.tile(seen["lateral"][2, cells.balls], images),
        radius=radius,
        stale=float(seen["stale"]),
    )
