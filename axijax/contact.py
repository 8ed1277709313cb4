"""The contact law: linear springs with Coulomb friction, tangential history and optional dashpots.

Normal force kn * overlap + cn * closing speed, never tensile. Tangential force ks * spring + ct * slip rate,
where the spring is the slip summed up over the life of the contact, kept in the contact plane; the total is
capped at friction * normal force and the spring is scaled by the same factor (Cundall & Strack 1979; Luding 2008).
Stiffnesses are the contact's, not the ball's. Dashpots c = 2 * beta * sqrt(k * m*), with m* the reduced mass of
the pair, m/2 for two equal balls.

A law whose constants depend on the overlap (`axijax.hertz`) is this one with the constants of the moment, which its
method `at` gives.

`frictional_law` carries its own derivative: written out by hand it shares the intermediate results of the value, and a
tangent costs little more than the value does.
"""

from functools import partial
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from axijax.neighbors import Network
from axijax.vector import Vector


class Law(NamedTuple):
    """Constants of the linear law; numbers or (C,) arrays. Viscosities are None without dashpots.

    normal_stiffness, shear_stiffness [F/L]; friction [-]; normal_viscosity, shear_viscosity [F T/L].
    kept: the share of the spring of the step before that is left before this step's slip [-]; None for all of it.
    """

    normal_stiffness: jax.Array
    shear_stiffness: jax.Array
    friction: jax.Array
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


class Contacts(NamedTuple):
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

    apart: vector from the second ball to the first [L].
    per_reach: one over the sum of the radii [1/L].
    overlap: positive where they touch [L]. Found from the change since the list was built, so that float32 does
        not lose it in the difference of two large distances.
    """

    apart: Vector
    per_reach: jax.Array
    overlap: jax.Array


def geometry(network: Network, displacement: Vector) -> Geometry:
    """Branch vectors and overlaps after the balls' displacement (N,) from the reference positions."""
    change = network.of_first(displacement) - network.of_second(displacement)
    apart = network.branch + change
    distance = jnp.sqrt(apart.dot(apart))
    longer = (2 * network.branch.dot(change) + change.dot(change)) / (distance + network.distance)
    return Geometry(apart, 1 / (network.distance + network.overlap), network.overlap - longer)


def linear_law(params, network: Network, mass_per_cube, *, dashpots: bool) -> Law:
    """Constants of all contacts from the parameters; mass_per_cube: ball mass over its radius cubed [M/L^3]."""
    normal_viscosity = shear_viscosity = None
    if dashpots:
        reduced_mass = mass_per_cube * network.pair_cube
        normal_viscosity = 2 * params.damping_ratio * jnp.sqrt(params.normal_stiffness * reduced_mass)
        shear_viscosity = 2 * params.damping_ratio * jnp.sqrt(params.shear_stiffness * reduced_mass)
    friction = contact_friction(params, network)
    return Law(params.normal_stiffness, params.shear_stiffness, friction, normal_viscosity, shear_viscosity)


def contact_friction(params, network: Network):
    """Friction coefficient of the contacts: the scene's, or the mean of the two balls' where given per ball [-]."""
    friction = params.friction
    if jnp.ndim(friction) == 0:
        return friction
    return 0.5 * (friction[network.first] + friction[network.second])


def contact_forces(law: ContactLaw, network: Network, dt, displacement, velocity, surface_speed, spring) -> Contacts:
    """Forces of all contacts and their springs one step later.

    displacement, velocity: (N,) [L], [L/T]. surface_speed: (N,) radius times spin [L/T]; None where nothing spins.
    spring: (C,) [L]; None for frictionless contacts. dt: time step [T].
    """
    place = geometry(network, displacement)
    if spring is None:
        frictionless = law.at(place, None, dt)
        if frictionless.normal_viscosity is None:
            return Contacts(elastic_force(frictionless, place), None, None)
    approach = network.of_first(velocity) - network.of_second(velocity)
    if spring is None:
        return Contacts(frictionless_force(frictionless, place, approach), None, None)
    rolling = None
    if surface_speed is not None:
        rolling = network.of_first(surface_speed) + network.of_second(surface_speed)
    return Contacts(*frictional_law(law.at(place, approach, dt), dt, place, approach, rolling, spring))


def elastic_force(law: Law, place: Geometry) -> Vector:
    """Force of a frictionless contact without dashpots."""
    distance = jnp.sqrt(place.apart.dot(place.apart))
    return place.apart * (law.normal_stiffness * jnp.maximum(place.overlap, 0.0) / distance)


def frictionless_force(law: Law, place: Geometry, approach: Vector) -> Vector:
    """Force of a frictionless contact with a dashpot."""
    distance = jnp.sqrt(place.apart.dot(place.apart))
    assert law.normal_viscosity is not None
    push = law.normal_stiffness * place.overlap - law.normal_viscosity * place.apart.dot(approach) / distance
    return place.apart * (jnp.where((place.overlap > 0) & (push > 0), push, 0.0) / distance)


def _evaluate(law: Law, dt, place: Geometry, approach: Vector, rolling: Vector | None, spring: Vector):
    """The frictional law, and the intermediate results that its derivative shares."""
    inverse = 1 / jnp.sqrt(place.apart.dot(place.apart))
    normal = place.apart * inverse
    normal_speed = approach.dot(normal)
    slip_rate = approach - normal * normal_speed
    if rolling is not None:
        slip_rate = slip_rate - rolling.cross(place.apart) * place.per_reach
    push = law.normal_stiffness * place.overlap
    if law.normal_viscosity is not None:
        push = push - law.normal_viscosity * normal_speed
    touching = place.overlap > 0
    pressing = touching & (push > 0)
    push = jnp.where(pressing, push, 0.0)
    if law.kept is not None:
        spring = spring * law.kept
    twist = spring.dot(normal)
    trial_spring = spring - normal * twist + slip_rate * dt
    trial = trial_spring * law.shear_stiffness
    if law.shear_viscosity is not None:
        trial = trial + slip_rate * law.shear_viscosity
    square, limit = trial.dot(trial), law.friction * push
    sliding = square > limit * limit
    # Without slip it would be 0/0, in value and tangent. The cap is a minimum, not a choice by `sliding`: the compiler
    # makes a condition anew wherever it is used, rounded differently, so two choices by it need not agree.
    per_size = 1 / jnp.sqrt(jnp.where(square > 0, square, 1.0))
    scale = jnp.where(touching, jnp.minimum(limit * per_size, 1.0), 0.0)
    force = normal * push - trial * scale
    shared = (
        inverse, normal, normal_speed, slip_rate, touching, pressing, push, spring, twist, trial_spring, trial, sliding,
        per_size, scale,
    )  # fmt: skip
    return (force, force.cross(place.apart) * place.per_reach, trial_spring * scale), shared


@partial(jax.custom_jvp)
def frictional_law(law: Law, dt, place: Geometry, approach: Vector, rolling: Vector | None, spring: Vector):
    """Force and moment arm on the first ball, and the spring one step later; arguments as in `contact_forces`."""
    return _evaluate(law, dt, place, approach, rolling, spring)[0]


def _frictional_law_jvp(primals, tangents):
    law, dt, place, approach, rolling, spring = primals
    law_d, _, place_d, approach_d, rolling_d, spring_d = tangents  # x_d is the tangent of x; dt is held

    def moving(tangent, primal):
        return jax.tree.map(
            lambda d, p: jnp.zeros_like(p) if isinstance(d, SymbolicZero) else d,
            tangent, primal, is_leaf=lambda leaf: isinstance(leaf, SymbolicZero),
        )  # fmt: skip

    def plus(total, tangent, factor):
        """total + tangent * factor, without the work where a parameter is not differentiated."""
        return total if tangent is None or isinstance(tangent, SymbolicZero) else total + factor * tangent

    def plus_vector(total: Vector, tangent, factor: Vector) -> Vector:
        return total if tangent is None or isinstance(tangent, SymbolicZero) else total + factor * tangent

    place_d, approach_d, spring_d = moving(place_d, place), moving(approach_d, approach), moving(spring_d, spring)
    results, shared = _evaluate(*primals)
    (
        inverse, normal, normal_speed, slip_rate, touching, pressing, push, left, twist, trial_spring, trial, sliding,
        per_size, scale,
    ) = shared  # fmt: skip
    force = results[0]
    normal_d = (place_d.apart - normal * normal.dot(place_d.apart)) * inverse
    normal_speed_d = approach_d.dot(normal) + approach.dot(normal_d)
    slip_rate_d = approach_d - normal * normal_speed_d - normal_d * normal_speed
    if rolling is not None:
        rolling_d = moving(rolling_d, rolling)
        arm_d = rolling_d.cross(place.apart) + rolling.cross(place_d.apart)
        slip_rate_d = slip_rate_d - arm_d * place.per_reach
    push_d = plus(law.normal_stiffness * place_d.overlap, law_d.normal_stiffness, place.overlap)
    if law.normal_viscosity is not None:
        push_d = plus(push_d - law.normal_viscosity * normal_speed_d, law_d.normal_viscosity, -normal_speed)
    push_d = jnp.where(pressing, push_d, 0.0)
    if law.kept is not None:
        spring_d = plus_vector(spring_d * law.kept, law_d.kept, spring)
    twist_d = spring_d.dot(normal) + left.dot(normal_d)
    trial_spring_d = spring_d - normal_d * twist - normal * twist_d + slip_rate_d * dt
    trial_d = plus_vector(trial_spring_d * law.shear_stiffness, law_d.shear_stiffness, trial_spring)
    if law.shear_viscosity is not None:
        trial_d = plus_vector(trial_d + slip_rate_d * law.shear_viscosity, law_d.shear_viscosity, slip_rate)
    limit_d = plus(law.friction * push_d, law_d.friction, push)
    size_d = per_size * trial.dot(trial_d)
    scale_d = jnp.where(sliding & touching, per_size * (limit_d - scale * size_d), 0.0)
    force_d = normal_d * push + normal * push_d - trial_d * scale - trial * scale_d
    return results, (
        force_d,
        (force_d.cross(place.apart) + force.cross(place_d.apart)) * place.per_reach,
        trial_spring_d * scale + trial_spring * scale_d,
    )


frictional_law.defjvp(_frictional_law_jvp, symbolic_zeros=True)


def resultants(contacts: Contacts, network: Network) -> tuple[Vector, Vector | None]:
    """Sum of the contact forces [F] and of their moments about the centre [F L] on each ball; (N,) vectors."""
    force = network.sum_on_balls(contacts.force, reaction=-1)
    if contacts.moment_arm is None:
        return force, None
    return force, network.sum_on_balls(contacts.moment_arm, reaction=1) * network.radius
