"""The contact law: linear springs with Coulomb friction, tangential history and optional dashpots.

Normal force kn * overlap + cn * closing speed, never tensile. Tangential force ks * spring + ct * slip rate,
where the spring is the slip summed up over the life of the contact, kept in the contact plane; the total is
capped at friction * normal force and the spring is scaled by the same factor (Cundall & Strack 1979; Luding 2008).
Stiffnesses are the contact's, not the ball's. Dashpots c = 2 * beta * sqrt(k * m*), with m* the reduced mass of
the pair, m/2 for two equal balls.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.neighbors import Network, image_table


class Contacts(NamedTuple):
    """What the law makes of every entry of the contact list; component-major arrays.

    normal: (3, K, N) unit vector from the neighbour to the ball [-].
    normal_force: (K, N) repulsion [F].
    tangential_force: (3, K, N) force on the ball along the contact plane [F]; None without friction.
    spring: (3, K, N) tangential spring after this step [L]; None without friction.
    sliding: (K, N) bool, the Coulomb cap acts; None without friction.
    overlap: (K, N) overlap, negative for a gap [L].
    """

    normal: jax.Array
    normal_force: jax.Array
    tangential_force: jax.Array | None
    spring: jax.Array | None
    sliding: jax.Array | None
    overlap: jax.Array


def dot(a, b):
    """Scalar product along the leading axis of two (3, ...) arrays."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """Vector product along the leading axis of two (3, ...) arrays."""
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def gather(table, network: Network):
    """Rows of a table of images at the entries of the contact list: (..., N + M) -> (..., K, N)."""
    return table.at[..., network.column].get(mode="promise_in_bounds")


def contact_law(params, network: Network, reduced_mass, dt, motion, spring, *, dashpots: bool) -> Contacts:
    """Forces of all contacts on the balls of their columns.

    params: needs normal_stiffness, shear_stiffness, friction, damping_ratio.
    reduced_mass: () or (K, N) reduced mass m* of the pairs [M]; used by the dashpots.
    dt: time step [T].
    motion: (displacement, velocity, spin), (3, N) each; spin None for balls that do not rotate.
    spring: (3, K, N) tangential springs [L], or None for frictionless contacts.
    """
    displacement, velocity, spin = motion
    apart = network.branch + displacement[:, None] - gather(image_table(network, displacement), network)
    distance = jnp.sqrt(dot(apart, apart))
    normal = apart / distance
    overlap = network.reach - distance
    touching = overlap > 0

    moving = spring is not None or dashpots
    if moving:
        relative = velocity[:, None] - gather(image_table(network, velocity), network)
        normal_speed = dot(relative, normal)
    normal_force = params.normal_stiffness * overlap
    if dashpots:
        viscosity = 2 * params.damping_ratio * jnp.sqrt(params.normal_stiffness * reduced_mass)
        normal_force = normal_force - viscosity * normal_speed
    normal_force = jnp.where(touching & (normal_force > 0), normal_force, 0.0)
    if spring is None:
        return Contacts(normal, normal_force, None, None, None, overlap)

    slip_rate = relative - normal_speed * normal
    if spin is not None:
        surface = network.radius * spin
        slip_rate = slip_rate - cross(surface[:, None] + gather(image_table(network, surface), network), normal)
    trial_spring = spring - dot(spring, normal) * normal + dt * slip_rate
    trial = params.shear_stiffness * trial_spring
    if dashpots:
        viscosity = 2 * params.damping_ratio * jnp.sqrt(params.shear_stiffness * reduced_mass)
        trial = trial + viscosity * slip_rate
    size = dot(trial, trial)
    moved = size > 0
    size = jnp.sqrt(jnp.where(moved, size, 1.0))  # the tangent of sqrt at zero would be NaN
    limit = contact_friction(params, network) * normal_force
    sliding = moved & (size > limit)
    scale = jnp.where(sliding, limit / size, jnp.where(touching, 1.0, 0.0))
    return Contacts(normal, normal_force, -scale * trial, scale * trial_spring, sliding & touching, overlap)


def contact_friction(params, network: Network):
    """Friction coefficient of each contact: the scene's, or the mean of the two balls' where it is per ball."""
    friction = params.friction
    if jnp.ndim(friction) == 0:
        return friction
    return 0.5 * (friction + friction.at[jnp.maximum(network.neighbor, 0)].get(mode="promise_in_bounds"))


def contact_force(contacts: Contacts) -> jax.Array:
    """Whole force of every contact on its ball, (3, K, N) [F]."""
    force = contacts.normal_force * contacts.normal
    return force if contacts.tangential_force is None else force + contacts.tangential_force


def resultants(contacts: Contacts, network: Network, *, rotation: bool):
    """Sum of the contact forces (3, N) [F] and of their moments about the centres (3, N) [F L] on each ball."""
    force = contact_force(contacts).sum(axis=1)
    if not rotation:
        return force, None
    return force, -network.radius * cross(contacts.normal, contacts.tangential_force).sum(axis=1)
