"""The contact law: linear springs with Coulomb friction, tangential history and optional dashpots.

Normal force kn * overlap + cn * closing speed, never tensile. Tangential force ks * spring + ct * slip rate,
where the spring is the slip summed up over the life of the contact, kept in the contact plane; the total is
capped at friction * normal force and the spring is scaled by the same factor (Cundall & Strack 1979; Luding 2008).
Stiffnesses are the contact's, not the ball's. Dashpots c = 2 * beta * sqrt(k * m*), with m* the reduced mass of
the pair, m/2 for two equal balls.

A law whose constants depend on the overlap (`axijax.mechanics.hertz`) is this one with the constants of the moment,
which its method `at` gives.

`frictional_law` carries its own derivative: written out by hand it shares the intermediate results of the value, and a
tangent costs little more than the value does.
"""

from functools import partial
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from axijax.core.vector import Vector, per_root, zeros
from axijax.mechanics import capped_spring
from axijax.mechanics.capped_spring import moving, plus, plus_vector
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.term import Memory, Push, Spent, Stored, Term


class Law(NamedTuple):
    """Constants of the linear law; numbers or (C,) arrays. Viscosities are None without dashpots.

    normal_stiffness, shear_stiffness [F/L]; friction [-]; normal_viscosity, shear_viscosity [F T/L].
    kept: the share of the spring of the step before that is left before this step's slip [-]; None for all of it.
    """

    normal_stiffness: jax.Array | float
    shear_stiffness: jax.Array | float
    friction: jax.Array | float | None
    normal_viscosity: jax.Array | None
    shear_viscosity: jax.Array | None
    kept: jax.Array | None = None

    def at(self, place: "Geometry", approach: Vector | None, dt) -> "Law":
        """The law of this moment: the same at all."""
        return self

    def energy(self, overlap_product):
        """Elastic energy of a contact whose overlaps, a little earlier and later, have this product [F L]."""
        return 0.5 * self.normal_stiffness * overlap_product


class ContactLaw(Protocol):
    """What a contact law is to the rest of the program."""

    def at(self, place: "Geometry", approach: Vector | None, dt) -> Law: ...

    def energy(self, overlap_product) -> jax.Array: ...


class ContactForces(NamedTuple):
    """What the law makes of every contact; (C,) arrays in the frame of the contact's first ball.

    force: on the first ball [F].
    moment_arm: force x branch over the sum of the radii; times its radius the moment on either ball [F]. None without
        friction. Arms shortened by the overlap, in slip and moment alike, make a rigid turn of the pair free of slip
        and keep its angular momentum.
    spring: tangential spring after this step [L]; None without friction.
    """

    force: Vector
    moment_arm: Vector | None
    spring: Vector | None


class Geometry(NamedTuple):
    """Where the two balls of every contact are; (C,).

    branch: vector from the second ball to the first [L].
    per_reach: one over the sum of the radii [1/L].
    overlap: positive where they touch [L]. Found from the change since the list was built, so that float32 does
        not lose it in the difference of two large distances.
    """

    branch: Vector
    per_reach: jax.Array
    overlap: jax.Array


def geometry(network: ContactList, displacement: Vector) -> Geometry:
    """Branch vectors and overlaps after the balls' displacement (N,) from the reference positions."""
    change = network.apart(displacement)
    branch = network.branch + change
    distance = jnp.sqrt(branch.dot(branch))
    longer = (2 * network.branch.dot(change) + change.dot(change)) / (distance + network.distance)
    return Geometry(branch, 1 / (network.distance + network.overlap), network.overlap - longer)


def contact_forces(
    law: ContactLaw, network: ContactList, dt, displacement, velocity, surface_speed, spring
) -> ContactForces:
    """Forces of all contacts and their springs one step later.

    displacement, velocity: (N,) [L], [L/T]. surface_speed: (N,) radius times spin [L/T]; None where nothing spins.
    spring: (C,) [L]; None for frictionless contacts. dt: time step [T].
    """
    place = geometry(network, displacement)
    if spring is None:
        frictionless = law.at(place, None, dt)
        if frictionless.normal_viscosity is None:
            return ContactForces(elastic_force(frictionless, place), None, None)
    approach = network.apart(velocity)
    if spring is None:
        return ContactForces(frictionless_force(frictionless, place, approach), None, None)
    surface_velocity = None
    if surface_speed is not None:
        surface_velocity = network.together(surface_speed)
    return ContactForces(*frictional_law(law.at(place, approach, dt), dt, place, approach, surface_velocity, spring))


def elastic_force(law: Law, place: Geometry) -> Vector:
    """Force of a frictionless contact without dashpots."""
    distance = jnp.sqrt(place.branch.dot(place.branch))
    return place.branch * (law.normal_stiffness * jnp.maximum(place.overlap, 0.0) / distance)


def frictionless_force(law: Law, place: Geometry, approach: Vector) -> Vector:
    """Force of a frictionless contact with a dashpot."""
    distance = jnp.sqrt(place.branch.dot(place.branch))
    return place.branch * (normal_force_of(law, place, place.branch.dot(approach) / distance)[1] / distance)


def normal_force_of(law: Law, place: Geometry, normal_speed: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Which contacts press, and their normal forces, never tensile; (C,). normal_speed: at which they part [L/T]."""
    force = law.normal_stiffness * place.overlap
    if law.normal_viscosity is not None:
        force = force - law.normal_viscosity * normal_speed
    pressing = (place.overlap > 0) & (force > 0)
    return pressing, jnp.where(pressing, force, 0.0)


def _evaluate(law: Law, dt, place: Geometry, approach: Vector, surface_velocity: Vector | None, spring: Vector):
    """The frictional law, and the intermediate results that its derivative shares."""
    inverse = per_root(place.branch.dot(place.branch))
    normal = place.branch * inverse
    normal_speed = approach.dot(normal)
    slip_rate = approach - normal * normal_speed
    if surface_velocity is not None:
        slip_rate = slip_rate - surface_velocity.cross(place.branch) * place.per_reach
    pressing, normal_force = normal_force_of(law, place, normal_speed)
    if law.kept is not None:
        spring = spring * law.kept
    normal_part = spring.dot(normal)
    in_plane = spring - normal * normal_part
    assert law.friction is not None
    tangential, after, slipping = capped_spring.value(
        in_plane, slip_rate, law.shear_stiffness, law.shear_viscosity, law.friction * normal_force, dt
    )
    force = normal * normal_force - tangential
    shared = inverse, normal, normal_speed, slip_rate, pressing, normal_force, spring, normal_part, slipping
    return (force, force.cross(place.branch) * place.per_reach, after), shared


@partial(jax.custom_jvp)
def frictional_law(law: Law, dt, place: Geometry, approach: Vector, surface_velocity: Vector | None, spring: Vector):
    """Force and moment arm on the first ball, and the spring one step later; arguments as in `contact_forces`."""
    return _evaluate(law, dt, place, approach, surface_velocity, spring)[0]


def _frictional_law_jvp(primals, tangents):
    law, dt, place, approach, surface_velocity, spring = primals
    law_d, _, place_d, approach_d, surface_velocity_d, spring_d = tangents  # x_d is the tangent of x; dt is held
    place_d, approach_d, spring_d = moving(place_d, place), moving(approach_d, approach), moving(spring_d, spring)
    results, shared = _evaluate(*primals)
    inverse, normal, normal_speed, slip_rate, pressing, normal_force, left, normal_part, slipping = shared
    force = results[0]
    normal_d = (place_d.branch - normal * normal.dot(place_d.branch)) * inverse
    normal_speed_d = approach_d.dot(normal) + approach.dot(normal_d)
    slip_rate_d = approach_d - normal * normal_speed_d - normal_d * normal_speed
    if surface_velocity is not None:
        surface_velocity_d = moving(surface_velocity_d, surface_velocity)
        arm_d = surface_velocity_d.cross(place.branch) + surface_velocity.cross(place_d.branch)
        slip_rate_d = slip_rate_d - arm_d * place.per_reach
    normal_force_d = plus(law.normal_stiffness * place_d.overlap, law_d.normal_stiffness, place.overlap)
    if law.normal_viscosity is not None:
        normal_force_d = normal_force_d - law.normal_viscosity * normal_speed_d
        normal_force_d = plus(normal_force_d, law_d.normal_viscosity, -normal_speed)
    normal_force_d = jnp.where(pressing, normal_force_d, 0.0)
    if law.kept is not None:
        spring_d = plus_vector(spring_d * law.kept, law_d.kept, spring)
    normal_part_d = spring_d.dot(normal) + left.dot(normal_d)
    in_plane_d = spring_d - normal_d * normal_part - normal * normal_part_d
    limit_d = plus(law.friction * normal_force_d, law_d.friction, normal_force)
    tangential_d, after_d = capped_spring.tangent(
        slipping, law.shear_stiffness, limit_d, in_plane_d, slip_rate_d, law_d.shear_stiffness, law_d.shear_viscosity,
        slip_rate, law.shear_viscosity, dt,
    )  # fmt: skip
    force_d = normal_d * normal_force + normal * normal_force_d - tangential_d
    moment_arm_d = (force_d.cross(place.branch) + force.cross(place_d.branch)) * place.per_reach
    return results, (force_d, moment_arm_d, after_d)


frictional_law.defjvp(_frictional_law_jvp, symbolic_zeros=True)


class ContactTerm(Term):
    """Forces between the balls of a material. Its memory are the contacts' tangential springs; the detail of its push
    is `ContactForces`."""

    stiffens = False
    acts_apart = False

    def init(self, params, network) -> Memory:
        frictional = params.material.frictional
        return Memory(contact=zeros(network.first.shape, network.dtype) if frictional else None)

    def forces(self, params, network, dt, state, memory) -> Push:
        law = params.material.contact_law(network)
        surface_speed = None if state.spin is None else state.spin * network.radius
        found = contact_forces(law, network, dt, state.displacement, state.velocity, surface_speed, memory.contact)
        force, moment = resultants(found, network)
        return Push(force, moment, Memory(contact=found.spring), found)

    def spent(self, params, network, dt, state, memory, push, mean) -> Spent:
        lost = self.pending(params, network, dt, state, memory, push)
        if memory.contact is not None:
            before, now = (law.shear_stiffness for law in self._before_and_now(params, network, dt, state))
            cut, after = self._slip(network, dt, state, memory, push), push.detail.spring
            later = capped_spring.lost_at_last_end(before, now, memory.contact, after, cut)
            lost += (later * network.share).sum()
        return Spent(damping=dt * self._dashpot_power(params, network, dt, state, push, mean), friction=lost)

    def pending(self, params, network, dt, state, memory, push):
        if memory.contact is None:
            return jnp.zeros((), network.dtype)
        before = self._before_and_now(params, network, dt, state)[0].shear_stiffness
        cut = self._slip(network, dt, state, memory, push)
        return (capped_spring.lost_at_first_end(before, memory.contact, cut) * network.share).sum()

    def stored(self, params, network, dt, state, memory, push) -> Stored:
        now, before = (jnp.maximum(geometry(network, at).overlap, 0.0) for at in _now_and_before(dt, state))
        shear = 0.0
        if memory.contact is not None:
            stiffness = self._before_and_now(params, network, dt, state)[0].shear_stiffness
            stretch = memory.contact.dot(push.detail.spring)
            shear = 0.5 * (stiffness * stretch * network.share).sum()
        return Stored((params.material.contact_law(network).energy(now * before) * network.share).sum(), shear)

    def _before_and_now(self, params, network, dt, state) -> tuple[Law, Law]:
        """The constants of the contacts at t - dt and t."""
        now, before = (geometry(network, at) for at in _now_and_before(dt, state))
        law = params.material.contact_law(network)
        return law.at(before, None, dt), law.at(now, None, dt)

    def _slip(self, network, dt, state, memory, push) -> Vector:
        """What has been cut off the springs since t - dt; (C,) vectors [L]."""
        normal, relative = relative_motion(network, state.displacement, state.velocity, state.spin)
        rate = relative - normal * relative.dot(normal)
        return capped_spring.slip(memory.contact, rate, dt, push.detail.spring)

    def _dashpot_power(self, params, network, dt, state, push, mean):
        """Power that the dashpots take at these velocities: what the forces at t hold beside the springs."""
        place = geometry(network, state.displacement)
        law = params.material.contact_law(network).at(place, None, dt)
        if law.normal_viscosity is None:
            return jnp.zeros((), network.dtype)
        normal, relative = relative_motion(network, state.displacement, mean.velocity, mean.spin)
        elastic = normal * (law.normal_stiffness * jnp.maximum(place.overlap, 0.0))
        if push.detail.spring is not None:
            elastic = elastic - push.detail.spring * law.shear_stiffness
        return ((elastic - push.detail.force).dot(relative) * network.share).sum()


def _now_and_before(dt, state) -> tuple[Vector, Vector]:
    """Displacements at t and t - dt."""
    return state.displacement, state.displacement - state.velocity * dt


def relative_motion(network: ContactList, displacement: Vector, velocity: Vector, spin: Vector | None):
    """Normals of the contacts, and the velocity of the first ball's surface against the second's; (C,) vectors."""
    place = geometry(network, displacement)
    normal = place.branch * per_root(place.branch.dot(place.branch))
    relative = network.apart(velocity)
    if spin is not None:
        surface_velocity = network.together(spin * network.radius)
        relative = relative - surface_velocity.cross(place.branch) * place.per_reach
    return normal, relative


def resultants(contacts: ContactForces, network: ContactList) -> tuple[Vector, Vector | None]:
    """Sum of the contact forces [F] and of their moments about the centre [F L] on each ball; (N,) vectors."""
    force = network.sum_on_balls(contacts.force, reaction=-1)
    if contacts.moment_arm is None:
        return force, None
    return force, network.sum_on_balls(contacts.moment_arm, reaction=1) * network.radius
