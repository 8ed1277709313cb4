"""One step of the discrete element method: forces, damping, integration, and the critical time step.

Central differences with velocities half a step behind the positions (Cundall & Strack 1979): forces from the
positions at t and the velocities at t - dt/2 give the velocities at t + dt/2, these the positions at t + dt.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.contact import Contacts, contact_law, resultants
from axijax.membrane import membrane_force
from axijax.neighbors import Network
from axijax.packing import plane_distances
from axijax.platens import platen_forces, sector_plane_force
from axijax.sector import turn

Damping = Literal["dashpot", "local", "background", "none"]

# Largest share of the critical time step that is accepted, and the share taken by default. Past the limit nothing
# blows up: the Coulomb cap bounds the motion and the peak silently falls, so the limit is kept at arm's length.
SAFE_STEP = 0.8
DEFAULT_STEP = 0.6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Params:
    """What a test is differentiated against: numbers in consistent units, each may be a traced JAX value.

    Defaults are those of Cui & O'Sullivan (2005), section 4.2, with friction as measured by Rowe (1962).

    friction: Coulomb coefficient between balls [-]; a number, or (N,) one per ball (a contact takes the mean).
    normal_stiffness, shear_stiffness: of a contact [F/L].
    confining_stress: s3, compression positive [F/L^2].
    platen_speed: speed of each platen during shear, inward positive [L/T].
    density: of the balls [M/L^3].
    damping_ratio: beta of the contact dashpots c = 2 beta sqrt(k m*) [-].
    local_damping: Cundall's local damping coefficient, used by damping = "local" [-].
    background_damping: mass-proportional damping rate, used by damping = "background" [1/T].
    """

    friction: jax.Array | float = 0.12278
    normal_stiffness: jax.Array | float = 1.5e9
    shear_stiffness: jax.Array | float = 1.5e9
    confining_stress: jax.Array | float = 5.0e4
    platen_speed: jax.Array | float = 0.01
    density: jax.Array | float = 2000.0
    damping_ratio: jax.Array | float = 0.05
    local_damping: jax.Array | float = 0.7
    background_damping: jax.Array | float = 0.5

    @property
    def platen_stiffness(self) -> jax.Array | float:
        """Stiffness of ball-plate contacts: the balls' normal stiffness [F/L]."""
        return self.normal_stiffness


def check_params(params: Params) -> None:
    """Raise ValueError, naming field, value and what is allowed, for concrete parameters that make no sense."""
    positive = ("normal_stiffness", "shear_stiffness", "confining_stress", "density")
    for name, value in vars(params).items():
        if isinstance(value, jax.core.Tracer):
            continue
        numbers = np.asarray(value)
        if numbers.dtype.kind not in "fiu":
            raise ValueError(f"{name} = {value!r}: must be a number.")
        worst = numbers[~np.isfinite(numbers)] if not np.isfinite(numbers).all() else numbers.min(keepdims=True)
        shown = worst.ravel()[0]
        if not np.isfinite(numbers).all():
            raise ValueError(f"{name} = {shown}: must be a finite number.")
        if name in positive and shown <= 0:
            raise ValueError(f"{name} = {shown:g}: must be positive.")
        if shown < 0:
            raise ValueError(f"{name} = {shown:g}: must be zero or positive.")
        if name == "local_damping" and numbers.max() >= 1:
            raise ValueError(f"{name} = {numbers.max():g}: must be below 1, or a force no longer moves its ball.")


@dataclass(frozen=True)
class Scene:
    """What is modelled at all; static and hashable, so that only what a scene needs is compiled.

    rotation: balls may spin.
    friction: contacts carry tangential springs; without it no spring is stored and nothing spins.
    damping: "dashpot" (in the contacts, the default), "local" (Cundall's; its tangents are meaningless),
        "background" (mass-proportional; adds strength that is not there) or "none".
    """

    rotation: bool = True
    friction: bool = True
    damping: Damping = "dashpot"

    def __post_init__(self) -> None:
        if self.damping not in ("dashpot", "local", "background", "none"):
            raise ValueError(
                f"damping = {self.damping!r}: must be 'dashpot', 'local', 'background' or 'none'; "
                "take 'dashpot' where derivatives are wanted."
            )

    @property
    def spins(self) -> bool:
        return self.rotation and self.friction


class State(NamedTuple):
    """What a step carries; a pytree.

    displacement: (3, N) from the network's reference positions, at time t [L].
    velocity: (3, N) at t - dt/2 [L/T].
    spin: (3, N) angular velocity at t - dt/2 [1/T]; None where nothing spins.
    spring: (3, K, N) tangential springs [L]; None without friction.
    platens: (2,) heights of the bottom and the top platen at t [L].
    platen_speeds: (2,) their velocities at t - dt/2 [L/T], upward positive.
    time: () since the stage began [T].
    """

    displacement: jax.Array
    velocity: jax.Array
    spin: jax.Array | None
    spring: jax.Array | None
    platens: jax.Array
    platen_speeds: jax.Array
    time: jax.Array


class Forces(NamedTuple):
    """All forces at one moment: contacts, sums on the balls and on the platens.

    resultant: (3, N) unbalanced force on each ball, before any damping but the dashpots' [F].
    moment: (3, N) [F L], or None.
    platen_push: (2, N) push of the bottom and the top platen on each ball, positive [F].
    contacts: what the law made of each entry.
    """

    resultant: jax.Array
    moment: jax.Array | None
    platen_push: jax.Array
    contacts: Contacts


def initial_state(network: Network, scene: Scene, platens: jax.Array) -> State:
    """Balls at rest at the reference positions, springs unstrained."""
    still = jnp.zeros_like(network.positions)
    return State(
        displacement=still,
        velocity=still,
        spin=still if scene.spins else None,
        spring=jnp.zeros_like(network.branch) if scene.friction else None,
        platens=jnp.asarray(platens, still.dtype),
        platen_speeds=jnp.zeros(2, still.dtype),
        time=jnp.zeros((), still.dtype),
    )


def ball_mass(params: Params, network: Network) -> jax.Array:
    """Mass of each ball, (N,) [M]."""
    return _mass_per_cube(params) * network.radius**3


def _mass_per_cube(params: Params):
    return params.density * (4 / 3) * jnp.pi


def all_forces(scene: Scene, params: Params, network: Network, areas: jax.Array, dt, state: State) -> Forces:
    """Contacts, platens, sector planes and membrane at the positions of `state`. areas: (N,) membrane cells [L^2]."""
    dashpots = scene.damping == "dashpot"
    mass = ball_mass(params, network)
    contacts = contact_law(
        params,
        network,
        _mass_per_cube(params) * network.pair_cube if dashpots else None,
        dt,
        (state.displacement, state.velocity, state.spin),
        state.spring,
        dashpots=dashpots,
    )
    force, moment = resultants(contacts, network, rotation=scene.spins)
    positions = network.positions + state.displacement
    viscosity = 2 * params.damping_ratio * jnp.sqrt(params.platen_stiffness * mass) if dashpots else None
    push = platen_forces(
        params, network, positions[2], state.velocity[2], state.platens, state.platen_speeds, viscosity
    )
    sideways = membrane_force(params.confining_stress, areas, positions)
    if network.sector.boundary == "rigid":
        sideways = sideways + sector_plane_force(params, network, positions, state.velocity, viscosity)
    force = force + jnp.concatenate([sideways, push[:1] - push[1:]])
    return Forces(force * network.free, None if moment is None else moment * network.free, push, contacts)


# A platen drive gives the platens' velocities at t + dt/2 from the state and the forces at t.
PlatenDrive = Callable[[Params, State, jax.Array, jax.Array, jax.Array], jax.Array]


def make_step(scene: Scene, drive: PlatenDrive):
    """A pure function step(params, network, areas, dt, state) -> state for one scene and one way to move the platens."""

    def step(params: Params, network: Network, areas: jax.Array, dt, state: State) -> State:
        forces = all_forces(scene, params, network, areas, dt, state)
        mass = ball_mass(params, network)
        force, moment = forces.resultant, forces.moment
        if scene.damping == "local":
            direction = network.positions[:2] + state.displacement[:2]
            force = _local_damping(params, force, state.velocity, direction)
            moment = None if moment is None else _local_damping(params, moment, state.spin, direction)
        velocity, spin = state.velocity, state.spin
        if scene.damping == "background":
            # Half of it on either side of the step, so that a large rate only stops the balls.
            half = 0.5 * dt * params.background_damping
            velocity = ((1 - half) * velocity + dt * force / mass) / (1 + half)
            if spin is not None:
                spin = ((1 - half) * spin + dt * moment / (0.4 * mass * network.radius**2)) / (1 + half)
        else:
            velocity = velocity + dt * force / mass
            if spin is not None:
                spin = spin + dt * moment / (0.4 * mass * network.radius**2)
        push = (forces.platen_push * network.weight).sum(axis=1)
        platen_speeds = drive(params, state, dt, push, areas.sum())
        return State(
            displacement=state.displacement + dt * velocity,
            velocity=velocity,
            spin=spin,
            spring=forces.contacts.spring,
            platens=state.platens + dt * platen_speeds,
            platen_speeds=platen_speeds,
            time=state.time + dt,
        )

    return step


def _local_damping(params, force, velocity, direction):
    """Cundall's damping: each component of the force reduced where it drives the motion, raised where it opposes it.

    The components are radial, circumferential and vertical, so that a ball and its turned images are damped alike.
    """
    distance = jnp.sqrt(direction[0] ** 2 + direction[1] ** 2)
    cos = jnp.where(distance > 0, direction[0] / jnp.where(distance > 0, distance, 1.0), 1.0)
    sin = jnp.where(distance > 0, direction[1] / jnp.where(distance > 0, distance, 1.0), 0.0)
    force_in, velocity_in = (jnp.stack(turn(vector, cos, -sin)) for vector in (force, velocity))
    damped = force_in - params.local_damping * jnp.abs(force_in) * jnp.sign(velocity_in)
    return jnp.stack(turn(damped, cos, sin))


def critical_time_step(scene: Scene, params: Params, network: Network, touching_within: float = 1e-3) -> float:
    """Largest stable time step 2/omega (sqrt(1 + xi^2) - xi) of the actual network [T] (host).

    omega is the largest frequency of the linearised system with every contact stuck, translations and spins
    together, found by a sparse eigenvalue solver; xi is that mode's damping ratio from the dashpots, which lower
    the limit (O'Sullivan & Bray 2004 for the undamped part). Contacts count as closed where the gap is below
    touching_within of the ball's radius.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    entries = np.asarray(network.neighbor) >= 0
    branch = np.asarray(network.branch, float)
    distance = np.linalg.norm(branch, axis=0)
    radius = np.asarray(network.radius, float)
    entries &= distance - np.asarray(network.reach) < touching_within * radius
    k, i = np.nonzero(entries)
    j, image = np.asarray(network.neighbor)[k, i], np.asarray(network.image)[k, i]
    normal = (branch / distance)[:, k, i]
    cos, sin = network.sector.cos_sin(image)
    mass = float(np.asarray(params.density)) * 4 / 3 * np.pi * radius**3
    spins = scene.spins
    share = np.asarray(network.weight, float)
    free = np.asarray(network.free, float)
    free = np.concatenate([free, free]) if spins else free
    scale = np.stack([mass] * 3 + [0.4 * mass * radius**2] * (3 if spins else 0))
    scale = 1 / np.sqrt(scale * share)
    count = radius.size
    stiffness = float(params.normal_stiffness), float(params.shear_stiffness) if scene.friction else 0.0
    beta = float(np.asarray(params.damping_ratio)) if scene.damping == "dashpot" else 0.0
    reduced = 1 / (1 / mass[i] + 1 / mass[j])
    viscosity = [2 * beta * np.sqrt(constant * reduced) for constant in stiffness]

    # Ball-plate contacts, and those with rigid sector planes, as springs to the ground.
    z = np.asarray(network.positions[2], float)
    lowest, highest = (z - radius).min(), (z + radius).max()
    ground = [
        (np.flatnonzero(z - radius - lowest < touching_within * radius), np.array([0.0, 0.0, 1.0])),
        (np.flatnonzero(highest - z - radius < touching_within * radius), np.array([0.0, 0.0, 1.0])),
    ]
    if network.sector.boundary == "rigid":
        gaps = np.asarray(plane_distances(np.asarray(network.positions, float), network.sector)) - radius
        c, s = (float(value) for value in network.sector.cos_sin(1))
        for gap, direction in zip(gaps, (np.array([0.0, 1.0, 0.0]), np.array([s, -c, 0.0])), strict=True):
            ground.append((np.flatnonzero(gap < touching_within * radius), direction))
    wall = float(params.platen_stiffness)

    def apply(vector, normal_constant, shear_constant, wall_constant):
        motion = (vector.reshape(-1, count) * scale * free).reshape(-1, 3, count)
        relative = motion[0][:, i] - np.stack(turn(motion[0][:, j], cos, sin))
        if spins:
            surface = radius * motion[1]
            relative -= np.cross(surface[:, i] + np.stack(turn(surface[:, j], cos, sin)), normal, axis=0)
        along = (relative * normal).sum(0) * normal
        force = normal_constant * along + shear_constant * (relative - along)
        result = np.zeros_like(motion)
        for axis in range(3):
            result[0, axis] = np.bincount(i, force[axis], count)
        if spins:
            moment = -radius[i] * np.cross(normal, force, axis=0)
            for axis in range(3):
                result[1, axis] = np.bincount(i, moment[axis], count)
        for balls, direction in ground:
            push = direction @ motion[0][:, balls]
            result[0][:, balls] += np.asarray(wall_constant)[..., balls] * direction[:, None] * push
        return (result.reshape(-1, count) * np.concatenate([share[None]] * scale.shape[0]) * scale * free).ravel()

    size = scale.size
    operator = LinearOperator((size, size), lambda v: apply(v, *stiffness, np.full(count, wall)), dtype=float)
    start = np.random.default_rng(0).standard_normal(size)
    values, modes = eigsh(operator, k=1, which="LA", v0=start, tol=1e-6)
    omega = float(np.sqrt(max(values[0], 0.0)))
    if omega == 0:
        raise ValueError("critical time step: no contact is closed, so there is no frequency to resolve.")
    wall_viscosity = 2 * beta * np.sqrt(wall * mass)
    xi = float(modes[:, 0] @ apply(modes[:, 0], *viscosity, wall_viscosity)) / (2 * omega)
    return 2 / omega * (np.sqrt(1 + xi**2) - xi)
