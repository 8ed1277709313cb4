"""What a test measures at one moment: stress ratios, strains, coordination, sliding, balance. Compression positive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.core.once import computed_once
from axijax.core.sector import radial_distance
from axijax.core.shown import shown
from axijax.core.vector import Vector, per_root
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.contacts import Geometry, geometry
from axijax.mechanics.dynamics import Forces, Scene, all_forces, next_motion, positions
from axijax.mechanics.membrane import Load, Membrane, lateral_force, membrane_radius
from axijax.mechanics.membrane_surface import straightened
from axijax.mechanics.params import Params
from axijax.mechanics.state import Loading, State
from axijax.mechanics.volume import solid_volume, void_ratio
from axijax.mechanics.walls import WallForces, platen_loads


@shown
class Observation(NamedTuple):
    """Measured at one moment; every field a scalar.

    stress_ratio: R = s1/s3 with s1 = platen force / area of the sector of radius Rm (Cui & O'Sullivan 2005) [-]. Under
        a membrane that slopes: of the force as `membrane_surface.straightened`.
    virial_ratio: F H / (1/2 sum F_i rho_i), platen force F against the lateral load F_i at rho_i; no area in it [-]. A
        membrane's axial forces times their heights are taken off F H.
    core_ratio: vertical over mean horizontal Love-Weber stress of the balls within rho < Rm/2 and the middle 60 %
        of the height [-].
    lateral_stress: s3 at this moment, which is also that of the stress ratios [F/L^2].
    bottom_force, top_force: axial forces that the whole cylinder puts on the platens, compression positive [F].
    height, membrane_radius: distance of the platens and radius Rm [L].
    volume: of the full cylinder, see `axijax.mechanics.volume` [L^3].
    void_ratio: voids over solids of a random specimen, counted below the skin [-]; NaN for a lattice, where nothing is
        counted: its cylinder of radius Rm is smaller than the balls', and would give 0.12 where the crystal has 0.35.
    coordination_number: mean number of touching contacts of a ball, platens not counted [-].
    unbalanced_force: mean resultant on a ball over mean contact force [-].
    sliding_fraction: share of the touching contacts at the Coulomb limit [-].
    chatter: how far contacts move to and fro from one step to the next, see `chatter` [-].

    Of a test in stages only, see `axijax.mechanics.state.Loading`:
    pore_pressure [F/L^2], path_length, servo_error [-]; stage: its number, from 1.
    Only where platens have friction, of the whole cylinder, whose horizontal forces cancel between periodic planes:
    end_restraint: what they hold the specimen's ends together with, the friction towards the axis summed over the balls
        on both, over their normal forces [-].
    bottom_shear_x, bottom_shear_y, top_shear_x, top_shear_y: force of the balls on the platen [F].
    bottom_torque, top_torque: moment of the balls on the platen about the axis [F L].
    """

    stress_ratio: jax.Array
    virial_ratio: jax.Array
    core_ratio: jax.Array
    lateral_stress: jax.Array
    bottom_force: jax.Array
    top_force: jax.Array
    height: jax.Array
    membrane_radius: jax.Array
    volume: jax.Array
    void_ratio: jax.Array
    coordination_number: jax.Array
    unbalanced_force: jax.Array
    sliding_fraction: jax.Array
    chatter: jax.Array
    pore_pressure: jax.Array | None = None
    path_length: jax.Array | None = None
    servo_error: jax.Array | None = None
    stage: jax.Array | None = None
    end_restraint: jax.Array | None = None
    bottom_shear_x: jax.Array | None = None
    bottom_shear_y: jax.Array | None = None
    bottom_torque: jax.Array | None = None
    top_shear_x: jax.Array | None = None
    top_shear_y: jax.Array | None = None
    top_torque: jax.Array | None = None


class Space(NamedTuple):
    """What is measured without a contact: radius Rm, and `volume` and `void_ratio` of `Observation`; scalars."""

    membrane_radius: jax.Array
    volume: jax.Array
    void_ratio: jax.Array


def space(network: ContactList, membrane: Membrane, state: State) -> Space:
    """Measure the room that a specimen takes."""
    place, platens = positions(network, state), state.platens
    radius = membrane_radius(membrane, place)
    if membrane.zone_rule != "exposure":
        volume = jnp.pi * radius**2 * (platens[1] - platens[0])
        return Space(radius, volume, jnp.full_like(volume, jnp.nan))
    balls = network.radius, network.weight, network.sector
    voids = void_ratio(place, *balls, platens.astype(network.dtype))
    return Space(radius, (1 + voids) * solid_volume(*balls), voids)


def observe(
    scene: Scene, params: Params, network: ContactList, membrane: Membrane, load: Load, dt, state: State,
    room: Space | None = None,
) -> Observation:  # fmt: skip
    """Measure a state; arguments as in `axijax.mechanics.dynamics.all_forces`. room: where `space` has measured it."""
    forces = all_forces(scene, params, network, load, dt, state)
    place = positions(network, state)
    height = state.platens[1] - state.platens[0]
    stress, loading = state.lateral_stress(params), state.loading
    platen_forces = forces.platen_forces(network)
    platen_force = straightened(stress, load, platen_forces).mean()
    lateral = lateral_force(stress, load, place)
    room = space(network, membrane, state) if room is None else room

    force = forces.contacts.force
    pair = geometry(network, state.displacement)
    normal = pair.branch * per_root(pair.branch.dot(pair.branch))
    normal_force = force.dot(normal)
    touching = (pair.overlap > 0) * network.share
    number = touching.sum()
    some = jnp.maximum(number, 1e-300)
    mean_force = (normal_force * network.share).sum() / some
    resultant = jnp.sqrt(forces.resultant.dot(forces.resultant) + 1e-300)
    sliding = jnp.zeros_like(number)
    if forces.contacts.moment_arm is not None:
        sliding = (at_coulomb_limit(params, network, force, normal) * touching).sum() / some
    return Observation(
        stress_ratio=platen_force / load.section / stress,
        virial_ratio=virial_ratio(platen_forces.mean(), lateral, load, place, state.platens),
        core_ratio=core_stress_ratio(network, forces, normal, place, room.membrane_radius, state.platens),
        lateral_stress=jnp.asarray(stress, platen_force.dtype),
        bottom_force=platen_forces[0] * network.sector.order,
        top_force=platen_forces[1] * network.sector.order,
        height=height,
        **room._asdict(),
        coordination_number=2 * number / network.weight.sum(),
        unbalanced_force=(resultant * network.weight).sum() / network.weight.sum() / jnp.maximum(mean_force, 1e-300),
        sliding_fraction=sliding,
        chatter=chatter(params, network, dt, state, forces, pair, normal),
        **({} if params.material.platen_friction is None else platen_records(network, place, forces.walls)),
        **({} if loading is None else of_loading(loading, network.dtype)),
    )


def of_loading(loading: Loading, dtype) -> dict[str, jax.Array]:
    """What of a path's memory is recorded, by the fields of `Observation`."""
    return {
        "pore_pressure": loading.pore_pressure,
        "path_length": loading.path_length,
        "servo_error": loading.error,
        "stage": loading.stage.astype(dtype),
    }


def platen_records(network: ContactList, place: Vector, walls: WallForces) -> dict[str, jax.Array]:
    """What rough platens feel, by the fields of `Observation`."""
    force, moment = platen_loads(network, place, walls)
    rho = radial_distance(place)
    found: dict[str, jax.Array] = {}
    inward = pressed = jnp.zeros_like(force.z[0])
    for end, (name, push, held) in enumerate(zip(("bottom", "top"), walls.normal, walls.held, strict=False)):
        found |= {f"{name}_shear_x": force.x[end], f"{name}_shear_y": force.y[end], f"{name}_torque": moment.z[end]}
        if held is not None:
            along = (held.x * place.x + held.y * place.y) / jnp.where(rho > 0, rho, 1.0)
            inward += (along * network.weight).sum()
        pressed += (push * network.weight).sum()
    if network.sector.images > 1:
        whole = {"shear_x": 0.0, "shear_y": 0.0, "torque": network.sector.order}
        found = {name: value * whole[name.partition("_")[2]] for name, value in found.items()}
    return found | {"end_restraint": inward / jnp.maximum(pressed, 1e-300)}


def virial_ratio(platen_force, lateral: Vector, load: Load, place: Vector, platens) -> jax.Array:
    """Mean axial over mean lateral stress from boundary forces and their places alone [-]."""
    height = platens[1] - platens[0]
    if load.axial is None:
        return platen_force * height / jnp.maximum(-0.5 * lateral.dot(place).sum(), 1e-300)
    upright = platen_force * height - (lateral.z * (place.z - platens.mean())).sum()
    return upright / jnp.maximum(-0.5 * (lateral.x * place.x + lateral.y * place.y).sum(), 1e-300)


def at_coulomb_limit(params: Params, network: ContactList, force: Vector, normal: Vector) -> jax.Array:
    """Which contacts slide, by their forces and normals, (C,) vectors; the cap is a product of rounded numbers."""
    normal_force = force.dot(normal)
    tangential = force - normal * normal_force
    limit = (1 - 1e-6) * params.material.contact_friction(network) * normal_force
    return tangential.dot(tangential) >= limit**2


def chatter(params: Params, network: ContactList, dt, state: State, forces: Forces, pair: Geometry, normal):
    """How far contacts move to and fro from one step to the next, against what their springs hold [-].

    -sum(u . u') / sum(s^2) over the touching contacts, u and u' being the slips of this step and of the next, s the
    slip at the Coulomb limit, f times normal force over ks; likewise for the approach in the normal direction, with
    the overlap for s. The larger of the two. A mode that is too fast for the time step changes sign at every step, and
    all that the Coulomb cap leaves of it is this. Slips of a sound run go on as they began: it stays below zero, or
    within rounding of it. It has no derivative.
    """
    params, state, forces, pair, normal = jax.lax.stop_gradient((params, state, forces, pair, normal))

    def moved(velocity: Vector, spin: Vector | None) -> tuple[Vector, jax.Array]:
        relative = network.apart(velocity)
        if spin is not None:
            turning = network.together(spin * network.radius)
            relative = relative - turning.cross(pair.branch) * pair.per_reach
        approach = relative.dot(normal)
        return (relative - normal * approach) * dt, approach * dt

    overlap = jnp.maximum(pair.overlap, 0.0)
    touching = (overlap > 0) * network.share
    later = computed_once(next_motion(params, network, dt, state, forces), (touching > 0).any())
    slip, approach = moved(state.velocity, state.spin)
    next_slip, next_approach = moved(*later)

    def reversing(product, scale):
        squares = (touching * scale**2).sum()
        return jnp.where(squares > 0, -(touching * product).sum() / jnp.where(squares > 0, squares, 1.0), 0.0)

    along = reversing(approach * next_approach, overlap)
    if state.spring is None:
        return along
    law = params.material.contact_law(network).at(pair, None, dt)
    limit = params.material.contact_friction(network) * overlap * (law.normal_stiffness / law.shear_stiffness)
    return jnp.maximum(along, reversing(slip.dot(next_slip), limit))


def in_core(place: Vector, radius, platens) -> jax.Array:
    """Which places are in the inner core, rho < Rm/2 and the middle 60 % of the height; platens: (2,) heights [L]."""
    middle, height = platens.mean(), platens[1] - platens[0]
    return (radial_distance(place) < radius / 2) & (jnp.abs(place.z - middle) < 0.3 * height)


def core_stress_ratio(network: ContactList, forces: Forces, normal, place, radius, platens) -> jax.Array:
    """Vertical over mean horizontal Love-Weber stress of the inner core; the mean is the same for all images.

    Each ball adds force times arm of its own half of a contact; the core's volume drops out of the ratio.
    """
    arm = network.radius * in_core(place, radius, platens)
    arm = network.share * (arm[network.first] + arm[network.second])
    force = forces.contacts.force
    vertical = (force.z * normal.z * arm).sum()
    horizontal = 0.5 * ((force.x * normal.x + force.y * normal.y) * arm).sum()
    return jnp.where(horizontal > 0, vertical / jnp.where(horizontal > 0, horizontal, 1.0), jnp.nan)
