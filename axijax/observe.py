"""What a test measures at one moment: stress ratios, strains, coordination, sliding, balance. Compression positive."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.contact import contact_friction, geometry
from axijax.dynamics import Forces, Params, Scene, State, all_forces, positions
from axijax.membrane import Load, Membrane, lateral_force, membrane_radius
from axijax.neighbors import Network
from axijax.sector import radial_distance


class Observation(NamedTuple):
    """Measured at one moment; every field a scalar.

    stress_ratio: R = s1/s3 with s1 = platen force / area of the sector of radius Rm (Cui & O'Sullivan 2005) [-].
    virial_ratio: F H / (1/2 sum F_i rho_i), platen force F against the lateral load F_i at rho_i; no area in it [-].
    core_ratio: vertical over mean horizontal Love-Weber stress of the balls within rho < Rm/2 and the middle 60 %
        of the height [-].
    height, membrane_radius: distance of the platens and radius Rm [L].
    coordination_number: mean number of touching contacts of a ball, platens not counted [-].
    unbalanced_force: mean resultant on a ball over mean contact force [-].
    sliding_fraction: share of the touching contacts at the Coulomb limit [-].
    """

    stress_ratio: jax.Array
    virial_ratio: jax.Array
    core_ratio: jax.Array
    height: jax.Array
    membrane_radius: jax.Array
    coordination_number: jax.Array
    unbalanced_force: jax.Array
    sliding_fraction: jax.Array


def observe(
    scene: Scene, params: Params, network: Network, membrane: Membrane, load: Load, dt, state: State
) -> Observation:
    """Measure a state; arguments as in `axijax.dynamics.all_forces`."""
    forces = all_forces(scene, params, network, load, dt, state)
    place = positions(network, state)
    height = state.platens[1] - state.platens[0]
    platen_force = jnp.stack([(push * network.weight).sum() for push in forces.platen_push]).mean()
    lateral = lateral_force(params.confining_stress, load, place)

    force = forces.contacts.force
    branch = geometry(network, state.displacement)
    normal = branch.apart * (1 / jnp.sqrt(branch.apart.dot(branch.apart)))
    normal_force = force.dot(normal)
    touching = (branch.overlap > 0) * network.share
    number = touching.sum()
    some = jnp.maximum(number, 1e-300)
    mean_force = (normal_force * network.share).sum() / some
    resultant = jnp.sqrt(forces.resultant.dot(forces.resultant) + 1e-300)
    sliding = jnp.zeros_like(number)
    if forces.contacts.moment_arm is not None:
        limit = contact_friction(params, network) * normal_force
        tangential = force - normal * normal_force
        sliding = ((tangential.dot(tangential) >= ((1 - 1e-6) * limit) ** 2) * touching).sum() / some
    return Observation(
        stress_ratio=platen_force / load.section / params.confining_stress,
        virial_ratio=platen_force * height / jnp.maximum(-0.5 * lateral.dot(place).sum(), 1e-300),
        core_ratio=core_stress_ratio(network, forces, normal, place, membrane_radius(membrane, place), state.platens),
        height=height,
        membrane_radius=membrane_radius(membrane, place),
        coordination_number=2 * number / network.weight.sum(),
        unbalanced_force=(resultant * network.weight).sum() / network.weight.sum() / jnp.maximum(mean_force, 1e-300),
        sliding_fraction=sliding,
    )


def core_stress_ratio(network: Network, forces: Forces, normal, place, radius, platens) -> jax.Array:
    """Vertical over mean horizontal Love-Weber stress of the inner core; the mean is the same for all images.

    Each ball adds force times arm of its own half of a contact; the core's volume drops out of the ratio.
    """
    middle, height = platens.mean(), platens[1] - platens[0]
    inside = (radial_distance(place) < radius / 2) & (jnp.abs(place.z - middle) < 0.3 * height)
    arm = network.radius * inside
    arm = network.share * (arm[network.first] + arm[network.second])
    force = forces.contacts.force
    vertical = (force.z * normal.z * arm).sum()
    horizontal = 0.5 * ((force.x * normal.x + force.y * normal.y) * arm).sum()
    return jnp.where(horizontal > 0, vertical / jnp.where(horizontal > 0, horizontal, 1.0), jnp.nan)
