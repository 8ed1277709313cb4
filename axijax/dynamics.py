"""One step of the discrete element method: forces, damping, integration.

Central differences with velocities half a step behind the positions (Cundall & Strack 1979): forces from the
positions at t and the velocities at t - dt/2 give the velocities at t + dt/2, these the positions at t + dt.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.contact import ContactLaw, Contacts, contact_forces, contact_friction, linear_law, resultants
from axijax.hertz import confined_force, hertz_law, hertz_wall, secant_to_shear_stiffness, tangent_stiffness
from axijax.membrane import Load, lateral_force
from axijax.neighbors import Network
from axijax.platens import WallLaw, linear_wall, platen_forces, sector_plane_force
from axijax.sector import radial_distance
from axijax.vector import Vector, zeros

Damping = Literal["dashpot", "local", "background", "none"]
ContactLawName = Literal["linear", "hertz"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Params:
    """What a test is differentiated against: numbers in consistent units, each may be a traced JAX value.

    Defaults are those of Cui & O'Sullivan (2005), section 4.2, with friction as measured by Rowe (1962).

    friction may also be (N,), one per ball: a contact takes the mean.

    friction: Coulomb coefficient between balls [-].
    normal_stiffness, shear_stiffness: of a contact, with contact_law = "linear" [F/L].
    shear_modulus: of the balls' material, with contact_law = "hertz" [F/L^2]; by default glass, the stress being in Pa.
    poisson_ratio: of the balls' material, with contact_law = "hertz" [-].
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
    shear_modulus: jax.Array | float = 2.9e10
    poisson_ratio: jax.Array | float = 0.2

    @property
    def platen_stiffness(self) -> jax.Array | float:
        """Stiffness of ball-plate contacts of the linear law: the balls' normal stiffness [F/L]."""
        return self.normal_stiffness


# Parameters that must be above zero; all others may be zero.
POSITIVE = ("normal_stiffness", "shear_stiffness", "shear_modulus", "confining_stress", "platen_speed", "density")


def check_params(params: Params, balls: int) -> None:
    """Raise ValueError, naming field, value and what is allowed, for concrete parameters that make no sense.

    balls: number of balls in the sector, for a friction per ball.
    """
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
        if name in POSITIVE and shown <= 0:
            raise ValueError(f"{name} = {shown:g}: must be positive{', inward' if name == 'platen_speed' else ''}.")
        if shown < 0:
            raise ValueError(f"{name} = {shown:g}: must be zero or positive.")
        if name == "local_damping" and numbers.max() >= 1:
            raise ValueError(f"{name} = {numbers.max():g}: must be below 1, or a force no longer moves its ball.")
        if name == "poisson_ratio" and numbers.max() >= 0.5:
            raise ValueError(f"{name} = {numbers.max():g}: must be below 0.5, where a material is incompressible.")
        if numbers.shape != () and not (name == "friction" and numbers.shape == (balls,)):
            allowed = "one number" + (f", or ({balls},), one per ball" if name == "friction" else "")
            raise ValueError(f"{name} has shape {numbers.shape}: must be {allowed}.")


@dataclass(frozen=True)
class Scene:
    """What is modelled at all; static and hashable, so that only what a scene needs is compiled.

    rotation: balls may spin.
    friction: contacts carry tangential springs; without it no spring is stored and nothing spins.
    damping: "dashpot" (in the contacts, the default), "local" (Cundall's; its tangents are meaningless),
        "background" (mass-proportional; adds strength that is not there) or "none".
    contact_law: "linear" springs, or "hertz" for elastic spheres of one material (Hertz-Mindlin, see `axijax.hertz`).
    """

    rotation: bool = True
    friction: bool = True
    damping: Damping = "dashpot"
    contact_law: ContactLawName = "linear"

    def __post_init__(self) -> None:
        if self.damping not in ("dashpot", "local", "background", "none"):
            raise ValueError(
                f"damping = {self.damping!r}: must be 'dashpot', 'local', 'background' or 'none'; "
                "take 'dashpot' where derivatives are wanted."
            )
        if self.contact_law not in ("linear", "hertz"):
            raise ValueError(f"contact_law = {self.contact_law!r}: must be 'linear' or 'hertz'.")

    @property
    def spins(self) -> bool:
        return self.rotation and self.friction


class State(NamedTuple):
    """What a step carries; a pytree.

    displacement: (N,) vectors from the network's reference positions, at time t [L].
    velocity: (N,) vectors at t - dt/2 [L/T].
    spin: (N,) angular velocities at t - dt/2 [1/T]; None where nothing spins.
    spring: (C,) tangential springs of the contacts [L]; None without friction.
    platens: (2,) heights of the bottom and the top platen at t, float64 whatever the rest is: a step moves them by
        less than the rounding of a float32 height [L].
    platen_speeds: (2,) their velocities at t - dt/2 [L/T], upward positive.
    time: () since the stage began [T].
    """

    displacement: Vector
    velocity: Vector
    spin: Vector | None
    spring: Vector | None
    platens: jax.Array
    platen_speeds: jax.Array
    time: jax.Array


class Forces(NamedTuple):
    """All forces at one moment: contacts, sums on the balls and on the platens.

    resultant: (N,) unbalanced force on each ball, before any damping but the dashpots' [F].
    moment: (N,) [F L], or None where nothing spins.
    platen_push: push of the bottom and of the top platen on each ball, (N,) each, positive [F].
    contacts: what the law made of each contact.
    """

    resultant: Vector
    moment: Vector | None
    platen_push: tuple[jax.Array, jax.Array]
    contacts: Contacts


def initial_state(network: Network, scene: Scene, platens: jax.Array) -> State:
    """Balls at rest at the reference positions, springs unstrained."""
    still = zeros(network.radius.shape, network.dtype)
    return State(
        displacement=still,
        velocity=still,
        spin=still if scene.spins else None,
        spring=zeros(network.first.shape, network.dtype) if scene.friction else None,
        platens=jnp.asarray(platens, jnp.float64),
        platen_speeds=jnp.zeros(2, network.dtype),
        time=jnp.zeros((), jnp.float64),
    )


def positions(network: Network, state: State) -> Vector:
    """Ball centres (N,) [L]."""
    return network.positions + state.displacement


def mass_per_cube(params: Params):
    """Mass of a ball over its radius cubed [M/L^3]."""
    return params.density * (4 / 3) * jnp.pi


def contact_laws(scene: Scene, params: Params, network: Network) -> tuple[ContactLaw, WallLaw]:
    """The law of the contacts and that of the plates, with the dashpots that the scene asks for."""
    dashpots = scene.damping == "dashpot"
    per_cube = mass_per_cube(params)
    if scene.contact_law == "hertz":
        friction = contact_friction(params, network)
        return (
            hertz_law(params, network, per_cube, friction, dashpots=dashpots),
            hertz_wall(params, network, per_cube, dashpots=dashpots),
        )
    law = linear_law(params, network, per_cube, dashpots=dashpots)
    return law, linear_wall(params, per_cube * network.radius**3, dashpots=dashpots)


def secant_stiffness_ratio(scene: Scene, params: Params):
    """Normal force over overlap, over the tangential stiffness [-]; of either law the same at any load."""
    if scene.contact_law == "hertz":
        return secant_to_shear_stiffness(params)
    return params.normal_stiffness / params.shear_stiffness


def all_forces(scene: Scene, params: Params, network: Network, load: Load, dt, state: State) -> Forces:
    """Contacts, platens, sector planes and lateral load at the positions of `state`."""
    law, wall = contact_laws(scene, params, network)
    rolling = None if state.spin is None else state.spin * network.radius
    contacts = contact_forces(law, network, dt, state.displacement, state.velocity, rolling, state.spring)
    force, moment = resultants(contacts, network)
    place = positions(network, state)
    push = platen_forces(wall, network, state.displacement.z, state.velocity.z, state.platens, state.platen_speeds)
    sideways = lateral_force(params.confining_stress, load, place)
    if network.sector.boundary == "rigid":
        sideways = sideways + sector_plane_force(wall, network, place, state.velocity)
    force = force + Vector(sideways.x, sideways.y, push[0] - push[1])
    if network.sector.images > 1:
        force = Vector(force.x * network.free.x, force.y * network.free.y, force.z)
        if moment is not None:
            moment = Vector(moment.x * network.free.x, moment.y * network.free.y, moment.z)
    return Forces(force, moment if scene.spins else None, push, contacts)


# A platen drive gives the platens' velocities at t + dt/2 from the state, the step, the forces (2,) that the balls put
# on the platens and the area of the section, at t.
PlatenDrive = Callable[[Params, State, jax.Array, jax.Array, jax.Array], jax.Array]


def make_step(scene: Scene, drive: PlatenDrive):
    """A pure function step(params, network, load, dt, state) -> state for one scene and one way to move the platens."""

    def step(params: Params, network: Network, load: Load, dt, state: State) -> State:
        forces = all_forces(scene, params, network, load, dt, state)
        push = jnp.stack([(side * network.weight).sum() for side in forces.platen_push])
        platen_speeds = drive(params, state, dt, push, load.section)
        velocity, spin = next_motion(scene, params, network, dt, state, forces)
        return State(
            displacement=state.displacement + velocity * dt,
            velocity=velocity,
            spin=spin,
            spring=forces.contacts.spring,
            platens=state.platens + dt * platen_speeds,
            platen_speeds=platen_speeds,
            time=state.time + dt,
        )

    return step


def next_motion(scene: Scene, params: Params, network: Network, dt, state: State, forces: Forces):
    """Velocities and spins (or None) at t + dt/2 from the forces at t; (N,) vectors [L/T], [1/T]."""
    mass = mass_per_cube(params) * network.radius**3
    advance = partial(_advance, scene, params, dt, positions(network, state))
    velocity = advance(state.velocity, forces.resultant, 1 / mass)
    if state.spin is None or forces.moment is None:
        return velocity, None
    return velocity, advance(state.spin, forces.moment, 1 / (0.4 * mass * network.radius**2))


def _advance(scene: Scene, params: Params, dt, place: Vector, motion: Vector, force: Vector, per_inertia) -> Vector:
    """Velocities (or spins) half a step after the forces (or moments), damped as the scene says."""
    if scene.damping == "local":
        force = force + local_damping_force(params, place, motion, force)
    if scene.damping == "background":
        # Half of it on either side of the force, so that even a large rate only stops the balls.
        half = 0.5 * dt * params.background_damping
        return (motion * (1 - half) + force * (dt * per_inertia)) * (1 / (1 + half))
    return motion + force * (dt * per_inertia)


def local_damping_force(params: Params, place: Vector, motion: Vector, force: Vector) -> Vector:
    """Cundall's local damping, -a |F| sign(v) in each component: a force is reduced where it drives the motion, and
    raised where it opposes it. Also for moments and spins.

    Radial, circumferential and vertical components, so that a ball and its turned images are damped alike.
    """
    distance = radial_distance(place)
    off_axis = jnp.where(distance > 0, distance, 1.0)
    cos, sin = jnp.where(distance > 0, place.x / off_axis, 1.0), place.y / off_axis
    force_in, motion_in = force.turned(cos, -sin), motion.turned(cos, -sin)
    drag = [-params.local_damping * jnp.abs(f) * jnp.sign(m) for f, m in zip(force_in, motion_in, strict=True)]
    return Vector(*drag).turned(cos, sin)


def confined_stiffness(scene: Scene, params: Params, network: Network):
    """Normal and tangential tangent stiffness [F/L] of the mean contact under the confining stress."""
    if scene.contact_law == "hertz":
        return tangent_stiffness(params, 0.5 * network.radius.mean(), confined_force(params, network))
    return params.normal_stiffness, params.shear_stiffness
