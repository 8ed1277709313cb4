"""The motion of any scene about rest, linearised by JAX from `axijax.mechanics.dynamics.all_forces`: what sets the
critical time step where a term or a material is not one that `axijax.mechanics.time_step` knows by heart (host).

Every contact sticks: friction and all other caps (`Term.stuck`) are without limit, and whatever is nearer than touching
is pressed together. Tangential springs do not follow from the places of the balls; they grow in a step by slip rate
times dt. So the forces' derivative by velocities and spins is C + dt K_t, of dashpots and tangential springs, and that
by displacements is what is left of the stiffness. A term with springs of its own is seen if it lets them grow by a step
before it takes their force, as contacts and walls do.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.quantity import optional_parts
from axijax.core.sector import plane_normals
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.contacts import Geometry
from axijax.mechanics.dynamics import Scene, all_forces, initial_state
from axijax.mechanics.hertz import OVERLOAD, confined_force
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import Params
from axijax.mechanics.state import State
from axijax.mechanics.term import STICKING, Term

DEEPEST = 0.1  # largest overlap at which a law is taken, in sums of radii


class Operators(NamedTuple):
    """Stiffness and viscosity of the stuck scene between coordinates in which every inertia is 1.

    size: number of coordinates. stiff, viscous: vector -> vector, symmetric, [1/T^2] and [1/T].
    """

    size: int
    stiff: Callable[[np.ndarray], np.ndarray]
    viscous: Callable[[np.ndarray], np.ndarray]


class Plate(NamedTuple):
    """What touches one platen or rigid sector plane.

    balls: their numbers. normal: into the specimen, (3,). gap: (N,) of all balls, negative for an overlap [L]. area: of
    the plate [L^2]. friction: the material's number of its friction.
    """

    balls: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    area: float
    friction: str


def closed_contacts(network: ContactList, touching_within: float) -> np.ndarray:
    """(C,) which contacts count as closed: a gap below touching_within of the smallest radius."""
    return -np.asarray(network.overlap, float) < touching_within * np.asarray(network.radius, float).min()


def plates(network: ContactList, touching_within: float) -> list[Plate]:
    """Platens, as near as the lowest and the highest ball, and rigid sector planes."""
    radius, place = np.asarray(network.radius, float), np.asarray(network.positions, float)
    lowest, highest = (place[2] - radius).min(), (place[2] + radius).max()
    outer = (np.hypot(*place[:2]) + radius).max()
    section = np.pi * outer**2 / network.sector.order
    found = [
        (np.array([0.0, 0.0, 1.0]), place[2] - radius - lowest, section, "platen_friction"),
        (np.array([0.0, 0.0, -1.0]), highest - place[2] - radius, section, "platen_friction"),
    ]
    if network.sector.boundary == "rigid":
        for inward in plane_normals(network.sector):
            normal = np.array([*inward, 0.0])
            found.append((normal, normal @ place - radius, outer * (highest - lowest), "plane_friction"))
    return [
        Plate(np.flatnonzero(gap < touching_within * radius), normal, gap, float(area), friction)
        for normal, gap, area, friction in found
    ]


def coordinates(network: ContactList, mass: np.ndarray, spins: bool) -> tuple[np.ndarray, np.ndarray]:
    """Displacement or turn of each ball for each coordinate, and where none may be; (3 or 6, N) [M^-1/2], [-]."""
    radius, share = np.asarray(network.radius, float), np.asarray(network.weight, float)
    scale = np.stack([mass] * 3 + [0.4 * mass * radius**2] * (3 if spins else 0))
    free = np.asarray(network.free, float)
    return 1 / np.sqrt(scale * share), np.concatenate([free, free]) if spins else free


def linearised(
    scene: Scene, params: Params, network: ContactList, touching_within: float = 1e-3, squeeze: float | None = None
) -> Operators:
    """The operators of a scene, every term included.

    squeeze: overlap of every closed contact, in sums of radii, or in radii at a plate; None: that under the load to
        come, `hertz.OVERLOAD` times the mean contact force under the confining stress, or that which there is where it
        is deeper.
    """
    params = replace(params, **_stuck(params))
    network = jax.tree.map(lambda a: a.astype(float) if jnp.issubdtype(a.dtype, jnp.floating) else a, network)
    mass = np.asarray(params.material.mass(network), float)
    mean_stiffness = params.material.confined_stiffness(network, params.confining_stress)[0]
    dt = 0.1 * float(np.sqrt(mass.min() / np.asarray(mean_stiffness)))
    pressed, platens = _pressed(params, network, touching_within, squeeze, dt)
    state = initial_state(scene, params, pressed, platens)
    scale, free = coordinates(network, mass, state.spin is not None)
    weight = np.asarray(network.weight)

    def response(vector, moved, dt):
        motion = vector.reshape(scale.shape) * scale * free
        velocity, spin = from_rows(motion[:3]), None if state.spin is None else from_rows(motion[3:])
        pushes = _response(scene, params, pressed, state, dt, velocity * moved, velocity, spin)
        change = np.concatenate([np.asarray(push) for push in pushes if push is not None])
        return -(change * weight * scale * free).ravel()

    # Forces' derivative by velocity is linear in dt: two steps' give its two parts.
    def stiff(vector):
        return response(vector / dt, dt, 2 * dt) - response(vector / dt, 0.0, dt)

    def viscous(vector):
        return 2 * response(vector, 0.0, dt) - response(vector, 0.0, 2 * dt)

    return Operators(scale.size, stiff, viscous)


def _stuck(params: Params) -> dict[str, Any]:
    material = params.material
    limits = {"friction": STICKING, "platen_friction": np.inf, "plane_friction": np.inf}
    stuck: dict[str, Any] = {name: limit for name, limit in limits.items() if getattr(material, name) is not None}
    stuck["terms"] = tuple(term.stuck() for term in params.terms)
    for name in optional_parts(material):
        part = getattr(material, name)
        if isinstance(part, Term):
            stuck[name] = part.stuck()
    return stuck


@partial(jax.jit, static_argnums=0)
def _response(
    scene: Scene, params: Params, network: ContactList, state: State, dt, moved: Vector, velocity: Vector, spin
):
    """Change of resultants and moments with this change of displacement, velocity and spin, (N,) vectors."""
    load = Load(jnp.zeros_like(network.radius), jnp.ones(()))

    def at(displacement, velocity, spin):
        there = state._replace(displacement=displacement, velocity=velocity, spin=spin)
        forces = all_forces(scene, params, network, load, dt, there)
        return forces.resultant, forces.moment

    return jax.jvp(at, (state.displacement, state.velocity, state.spin), (moved, velocity, spin))[1]


def _pressed(params: Params, network: ContactList, touching_within: float, squeeze: float | None, dt):
    """The network with all that is closed pressed together, and the platens' heights; contacts and plates each by
    itself, so that no place of the balls need answer to all."""
    radius, overlap = np.asarray(network.radius), np.asarray(network.overlap)
    reach = np.asarray(network.distance) + overlap
    closed = closed_contacts(network, touching_within)
    stress = params.confining_stress
    normal = network.branch * (1 / network.distance)

    if squeeze is None:
        law = params.material.contact_law(network)

        @jax.jit
        def contact_force(overlap):
            place = Geometry(normal * (reach - overlap), 1 / reach, overlap)
            return law.at(place, None, dt).normal_stiffness * overlap

        depth = _overlap_at(contact_force, OVERLOAD * confined_force(network, stress, touching_within), reach)
        depth = np.maximum(depth, overlap)
    else:
        depth = squeeze * reach
    overlap = np.where(closed, depth, overlap)

    wall = params.material.wall_law(network)

    @jax.jit
    def wall_force(depth):
        return wall.at(-depth).stiffness * depth

    found = plates(network, touching_within)
    wanted = np.zeros((len(found), radius.size))  # how far along the plate's normal its balls must go
    for row, plate in zip(wanted, found, strict=True):
        if squeeze is None:
            share = np.asarray(network.weight)[plate.balls].sum()
            load = OVERLOAD * float(stress) * plate.area / max(share, 1e-3)
            depth = _overlap_at(wall_force, load, radius)
            depth = np.maximum(depth, -plate.gap)
        else:
            depth = squeeze * radius
        row[plate.balls] = (-depth - plate.gap)[plate.balls]
    # Only plates read the balls' places, contacts their branches.
    normals = np.stack([plate.normal for plate in found])[None] * (wanted != 0).T[:, :, None]
    shift = (np.linalg.pinv(normals) @ wanted.T[:, :, None])[:, :, 0].T
    place = np.asarray(network.positions)
    pressed = replace(
        network, overlap=jnp.asarray(overlap), distance=jnp.asarray(reach - overlap),
        branch=normal * (reach - overlap), positions=from_rows(place + shift),
    )  # fmt: skip
    return pressed, ((place[2] - radius).min(), (place[2] + radius).max())


def _overlap_at(force_of, target, reach: np.ndarray) -> np.ndarray:
    """Overlaps at which a law presses with a force, by halving their logarithms; at most DEEPEST of the reach."""
    low, high = np.full(reach.shape, np.log(1e-12)), np.full(reach.shape, np.log(DEEPEST))
    for _ in range(60):
        middle = 0.5 * (low + high)
        enough = np.asarray(force_of(jnp.asarray(reach * np.exp(middle))) >= target)
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return reach * np.exp(high)
