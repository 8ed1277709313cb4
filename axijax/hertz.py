"""The Hertz-Mindlin contact law: elastic spheres of one material, stiffer the harder they are pressed.

With contact radius a = sqrt(R* overlap), R* = r1 r2/(r1 + r2), E* = G/(1 - nu) and G* = G/(2 (2 - nu)):

    normal force      (4/3) E* a overlap, that is (4/3) E* sqrt(R*) overlap^1.5 (Hertz; Johnson 1985)
    tangential force  grows by 8 G* a times the slip (Mindlin 1949, no slip within the contact), capped as in `contact`
    dashpots          2 beta sqrt(5/6) sqrt(k m*), k the tangent stiffness 2 E* a or 8 G* a of the moment (Tsuji 1992)

With these dashpots the speed depends on overlap^1.25 as it does on the overlap of a linear spring and dashpot (Antypov
& Elliott 2011), so the restitution is that of the linear law at the same beta, whatever the speed.

A tangential spring whose stiffness follows the normal force must not hand out energy that nobody put in. When a contact
is pressed harder its tangential force stays and the spring shortens; when it is let go the spring stays and the force
falls with the contact radius (Walton's rule; `mindlin_rescale/force` in LAMMPS). Either way elastic energy is lost, as
by the microslip of the full Mindlin-Deresiewicz theory, and none is ever gained (Elata & Berryman 1996).

At any moment this is the linear law with the constants of that moment, which `HertzLaw.at` gives: everything else about
a contact is in `axijax.contact`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.contact import Geometry, Law
from axijax.neighbors import Network
from axijax.platens import Wall
from axijax.vector import Vector

# Overlaps below this, in reduced radii, are as stiff as at it: there the roots have no finite derivative.
SHALLOW = 1e-9


class HertzLaw(NamedTuple):
    """Constants of the Hertz-Mindlin law; numbers or (C,) arrays. Viscosities are None without dashpots.

    normal, shear: secant normal and tangential stiffness over the root of the overlap [F/L^1.5]; friction [-].
    normal_viscosity, shear_viscosity: over the fourth root of the overlap [F T/L^1.25].
    shallow: overlap below which nothing softens any more [L].
    """

    normal: jax.Array
    shear: jax.Array
    friction: jax.Array
    normal_viscosity: jax.Array | None
    shear_viscosity: jax.Array | None
    shallow: jax.Array

    def at(self, place: Geometry, approach: Vector | None, dt) -> Law:
        """The linear law of this moment; approach: velocities of the first balls against the second [L/T]."""
        root = jnp.sqrt(jnp.maximum(place.overlap, self.shallow))
        kept = normal_viscosity = shear_viscosity = None
        if approach is not None:
            # The overlap one step ago, to third order in the step.
            apart = place.apart
            parted = dt * (apart.dot(approach) - 0.5 * dt * approach.dot(approach)) / jnp.sqrt(apart.dot(apart))
            before = jnp.sqrt(jnp.maximum(place.overlap + parted, self.shallow))
            kept = jnp.minimum(before / root, 1.0)
        if self.normal_viscosity is not None and self.shear_viscosity is not None:
            fourth = jnp.sqrt(root)
            normal_viscosity, shear_viscosity = self.normal_viscosity * fourth, self.shear_viscosity * fourth
        return Law(self.normal * root, self.shear * root, self.friction, normal_viscosity, shear_viscosity, kept)

    def energy(self, overlap_product):
        """Elastic energy (8/15) E* sqrt(R*) overlap^2.5 of a contact whose overlaps have this product [F L]."""
        return 0.4 * self.normal * overlap_product**1.25


class HertzWall(NamedTuple):
    """Frictionless plates of the balls' material; stiffness and viscosity (N,) over the roots of the overlap."""

    stiffness: jax.Array
    viscosity: jax.Array | None
    shallow: jax.Array

    def at(self, gap) -> Wall:
        """The linear wall of this moment, at gaps (N,) [L]."""
        root = jnp.sqrt(jnp.maximum(-gap, self.shallow))
        return Wall(self.stiffness * root, None if self.viscosity is None else self.viscosity * jnp.sqrt(root))

    def energy(self, overlap_product):
        """Elastic energy of a ball-plate contact whose overlaps have this product [F L]."""
        return 0.4 * self.stiffness * overlap_product**1.25


def _moduli(params):
    """E* = G/(1 - nu) and 8 G* = 4 G/(2 - nu) of two bodies of one material [F/L^2]."""
    return params.shear_modulus / (1 - params.poisson_ratio), 4 * params.shear_modulus / (2 - params.poisson_ratio)


def secant_to_shear_stiffness(params):
    """Secant normal stiffness over tangential stiffness, (2 - nu)/(3 (1 - nu)) at any load [-]."""
    return (2 - params.poisson_ratio) / (3 * (1 - params.poisson_ratio))


def reduced_radius(network: Network):
    """R* = r1 r2/(r1 + r2) of the contacts [L]; () where all balls are equal."""
    if jnp.ndim(network.pair_cube) == 0:
        return jnp.cbrt(0.25 * network.pair_cube)  # of equal balls r/2, from r^3/2
    first, second = (
        network.radius.at[index].get(mode="promise_in_bounds") for index in (network.first, network.second)
    )
    return first * second / (first + second)


def hertz_law(params, network: Network, mass_per_cube, friction, *, dashpots: bool) -> HertzLaw:
    """Constants of all contacts from the parameters; mass_per_cube: ball mass over its radius cubed [M/L^3]."""
    modulus, shear_modulus = _moduli(params)
    radius = reduced_radius(network)
    root = jnp.sqrt(radius)
    normal, shear = modulus * root, shear_modulus * root
    normal_viscosity = shear_viscosity = None
    if dashpots:
        viscosity = 2 * params.damping_ratio * jnp.sqrt(mass_per_cube * network.pair_cube * (5 / 6))
        normal_viscosity, shear_viscosity = viscosity * jnp.sqrt(2 * normal), viscosity * jnp.sqrt(shear)
    return HertzLaw((4 / 3) * normal, shear, friction, normal_viscosity, shear_viscosity, SHALLOW * radius)


def hertz_wall(params, network: Network, mass_per_cube, *, dashpots: bool) -> HertzWall:
    """Constants of ball-plate contacts: a flat plate of the balls' material, so R* is the ball's radius."""
    modulus, _ = _moduli(params)
    normal = modulus * jnp.sqrt(network.radius)
    viscosity = None
    if dashpots:
        mass = mass_per_cube * network.radius**3
        viscosity = 2 * params.damping_ratio * jnp.sqrt(2 * normal * mass * (5 / 6))
    return HertzWall((4 / 3) * normal, viscosity, SHALLOW * network.radius)


def hertz_force(params, radius, overlap):
    """Normal force (4/3) E* sqrt(R*) overlap^1.5 [F] for the reduced radius [L]; zero without overlap."""
    return (4 / 3) * _moduli(params)[0] * jnp.sqrt(radius) * jnp.maximum(overlap, 0.0) ** 1.5


def tangent_stiffness(params, radius, force):
    """Normal and tangential tangent stiffness 2 E* a, 8 G* a [F/L] at a normal force [F], for a reduced radius [L]."""
    modulus, shear_modulus = _moduli(params)
    contact_radius = jnp.cbrt(0.75 * force * radius / modulus)
    return 2 * modulus * contact_radius, shear_modulus * contact_radius


def confined_force(params, network: Network, touching_within: float = 1e-3):
    """Mean normal force of a contact under the confining stress [F], not less than the true one: 3 s3 V / sum(l).

    From the mean stress s3 = sum(force * l) / (3 V) of a packing with branches l = r1 + r2 (Love-Weber). The volume V
    is that of the cylinder around the balls, a little more than the membrane's. Contacts are closed as in
    `time_step.critical_time_step`.
    """
    place, radius = network.positions, network.radius
    outer = (jnp.sqrt(place.x**2 + place.y**2) + radius).max()
    height = (place.z + radius).max() - (place.z - radius).min()
    volume = jnp.pi * outer**2 * height / network.sector.order
    closed = -network.overlap < touching_within * radius.min()
    branches = jnp.where(closed, (network.distance + network.overlap) * network.share, 0.0).sum()
    return 3 * params.confining_stress * volume / jnp.maximum(branches, 2 * radius.min())
