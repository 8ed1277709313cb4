"""What a test measures at one moment: stress ratios, strains, coordination, sliding, balance. Compression positive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.contact import Contacts, contact_force
from axijax.dynamics import Params, Scene, State, all_forces
from axijax.membrane import Membrane, membrane_radius
from axijax.neighbors import Network
from axijax.sector import radial_distance


class Observation(NamedTuple):
    """Measured at one moment; every field a scalar.

    stress_ratio: R = s1/s3 with s1 = platen force / area of the sector of radius Rm (Cui & O'Sullivan 2005) [-].
    virial_ratio: F H / (1/2 sum F_i rho_i), platen force F against the membrane's radial forces F_i; no area in it [-].
    core_ratio: vertical over mean horizontal Love-Weber stress of the balls within rho < Rm/2 and the middle 60 %
        of the height [-].
    height, membrane_radius: distance of the platens and radius Rm [L].
    coordination_number: mean number of touching contacts of a ball, platens not counted [-].
    unbalanced_force: mean resultant on a ball over mean contact force [-].
    sliding_fraction: share of the touching contacts at the Coulomb limit [-].
    top_and_bottom: difference of the two platen forces over their mean [-].
    """

    stress_ratio: jax.Array
    virial_ratio: jax.Array
    core_ratio: jax.Array
    height: jax.Array
    membrane_radius: jax.Array
    coordination_number: jax.Array
    unbalanced_force: jax.Array
    sliding_fraction: jax.Array
    top_and_bottom: jax.Array


def observe(
    scene: Scene, params: Params, network: Network, membrane: Membrane, areas: jax.Array, dt, state: State
) -> Observation:
    """Measure a state; arguments as in `axijax.dynamics.all_forces`."""
    forces = all_forces(scene, params, network, areas, dt, state)
    positions = network.positions + state.displacement
    share = network.weight
    radius = membrane_radius(membrane, positions)
    height = state.platens[1] - state.platens[0]
    platen_forces = (forces.platen_push * share).sum(axis=1)
    platen_force = platen_forces.mean()
    rho = radial_distance(positions)
    radial = params.confining_stress * areas
    area = 0.5 * network.sector.angle * radius**2

    contacts = forces.contacts
    touching = (contacts.overlap > 0) * share
    number = touching.sum()
    some = jnp.maximum(number, 1.0)
    mean_force = (contacts.normal_force * share).sum() / some
    size = jnp.sqrt((forces.resultant**2).sum(axis=0) + 1e-300)
    sliding = jnp.zeros(()) if contacts.sliding is None else (contacts.sliding * share).sum() / some
    return Observation(
        stress_ratio=platen_force / area / params.confining_stress,
        virial_ratio=platen_force * height / (0.5 * (radial * rho).sum()),
        core_ratio=core_stress_ratio(network, contacts, positions, radius, state.platens),
        height=height,
        membrane_radius=radius,
        coordination_number=number / share.sum(),
        unbalanced_force=(size * share).sum() / share.sum() / jnp.maximum(mean_force, 1e-300),
        sliding_fraction=sliding,
        top_and_bottom=(platen_forces[1] - platen_forces[0]) / jnp.maximum(platen_force, 1e-300),
    )


def ball_moments(network: Network, contacts: Contacts) -> jax.Array:
    """Each ball's share of the Love-Weber stress times volume: sum over its contacts of force times branch half;
    (3, 3, N) [F L], compression positive. Divide a sum over balls by the volume they stand for."""
    return jnp.einsum("akn,bkn->abn", contact_force(contacts), contacts.normal) * network.radius


def core_stress_ratio(network, contacts, positions, radius, platens) -> jax.Array:
    """Vertical over mean horizontal Love-Weber stress of the inner core; the horizontal mean turns with no image."""
    middle, height = platens.mean(), platens[1] - platens[0]
    rho = radial_distance(positions)
    core = (rho < radius / 2) & (jnp.abs(positions[2] - middle) < 0.3 * height)
    force = contact_force(contacts)
    weight = core * network.weight * network.radius
    along = [(force[axis] * contacts.normal[axis] * weight).sum() for axis in range(3)]
    horizontal = 0.5 * (along[0] + along[1])
    return jnp.where(horizontal > 0, along[2] / jnp.where(horizontal > 0, horizontal, 1.0), jnp.nan)

