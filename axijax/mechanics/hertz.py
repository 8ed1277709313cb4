"""The Hertz-Mindlin contact law: elastic spheres of one material, stiffer the harder they are pressed.

With contact radius a = sqrt(R* overlap), R* = r1 r2/(r1 + r2), E* = G/(1 - nu) and G* = G/(2 (2 - nu)):

    normal force      (4/3) E* a overlap, that is (4/3) E* sqrt(R*) overlap^1.5 (Hertz; Johnson 1985)
    tangential force  grows by 8 G* a times the slip (Mindlin 1949, no slip within the contact), capped as in `contacts`
    dashpots          2 beta sqrt(5/6) sqrt(k m*), k the tangent stiffness 2 E* a or 8 G* a of the moment (Tsuji 1992)

With these dashpots the speed depends on overlap^1.25 as it does on the overlap of a linear spring and dashpot (Antypov
& Elliott 2011), so the restitution is that of the linear law at the same beta, whatever the speed.

A tangential spring whose stiffness follows the normal force must not hand out energy that nobody put in. When a contact
is pressed harder its tangential force stays and the spring shortens; when it is let go the spring stays and the force
falls with the contact radius (Walton's rule; `mindlin_rescale/force` in LAMMPS). Either way elastic energy is lost, as
by the microslip of the full Mindlin-Deresiewicz theory, and none is ever gained (Elata & Berryman 1996).

At any moment this is the linear law with the constants of that moment, which `HertzLaw.at` gives: everything else about
a contact is in `axijax.mechanics.contacts`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.core.vector import Vector
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.contacts import Geometry, Law
from axijax.mechanics.material import Material
from axijax.mechanics.walls import Wall

# Contacts grow stiffer under load, with the cube root of their force. The time step is chosen for contacts with this
# many times the mean force under the confining stress: in a close packing at failure it is 2/(1 - f) times.
OVERLOAD = 4.0

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
    friction: jax.Array | float | None
    normal_viscosity: jax.Array | None
    shear_viscosity: jax.Array | None
    shallow: jax.Array

    def at(self, place: Geometry, approach: Vector | None, dt) -> Law:
        """The linear law of this moment; approach: velocities of the first balls against the second [L/T]."""
        root = jnp.sqrt(jnp.maximum(place.overlap, self.shallow))
        kept = normal_viscosity = shear_viscosity = None
        if approach is not None:
            # The overlap one step ago, to third order in the step.
            branch = place.branch
            parted = dt * (branch.dot(approach) - 0.5 * dt * approach.dot(approach)) / jnp.sqrt(branch.dot(branch))
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
    """Plates of the balls' material; stiffnesses and viscosities (N,) over the roots of the overlap, see `HertzLaw`.

    The tangential ones are None for smooth plates.
    """

    stiffness: jax.Array
    viscosity: jax.Array | None
    shear: jax.Array | None
    shear_viscosity: jax.Array | None
    shallow: jax.Array

    def at(self, gap, closing_speed=None, dt=None) -> Wall:
        """The linear wall of this moment, at gaps (N,) [L]."""
        root = jnp.sqrt(jnp.maximum(-gap, self.shallow))
        viscosity = shear = shear_viscosity = kept = None
        fourth = jnp.sqrt(root)
        if self.viscosity is not None:
            viscosity = self.viscosity * fourth
        if self.shear is not None:
            shear = self.shear * root
            shear_viscosity = None if self.shear_viscosity is None else self.shear_viscosity * fourth
            if closing_speed is not None:
                before = jnp.sqrt(jnp.maximum(-gap - dt * closing_speed, self.shallow))
                kept = jnp.minimum(before / root, 1.0)
        return Wall(self.stiffness * root, viscosity, shear, shear_viscosity, kept)

    def energy(self, overlap_product):
        """Elastic energy of a ball-plate contact whose overlaps have this product [F L]."""
        return 0.4 * self.stiffness * overlap_product**1.25


@pytree
@dataclass(frozen=True)
class Hertz(Material):
    """Elastic spheres of one material (Hertz-Mindlin), by default of glass, the stress being in Pa."""

    shear_modulus: jax.Array | float = quantity(
        2.9e10, "shear modulus of the balls' material", "F/L^2", above=0.0, symbols=("G",)
    )
    poisson_ratio: jax.Array | float = quantity(
        0.2, "Poisson's ratio of the balls' material", "-", below=0.5, symbols=("nu",)
    )

    dashpot_factor = (5 / 6) ** 0.5

    @property
    def moduli(self):
        """E* = G/(1 - nu) and 8 G* = 4 G/(2 - nu) of two bodies of one material [F/L^2]."""
        return self.shear_modulus / (1 - self.poisson_ratio), 4 * self.shear_modulus / (2 - self.poisson_ratio)

    def contact_law(self, network: ContactList) -> HertzLaw:
        friction = self.contact_friction(network) if self.frictional else None
        radius = reduced_radius(network)
        root = jnp.sqrt(radius)
        normal, shear = (modulus * root for modulus in self.moduli)
        normal_viscosity = shear_viscosity = None
        beta = self.kind_of_damping.viscosity_ratio
        if beta is not None:
            viscosity = 2 * beta * jnp.sqrt(self.reduced_mass(network) * (5 / 6))
            normal_viscosity, shear_viscosity = viscosity * jnp.sqrt(2 * normal), viscosity * jnp.sqrt(shear)
        return HertzLaw((4 / 3) * normal, shear, friction, normal_viscosity, shear_viscosity, SHALLOW * radius)

    def wall_law(self, network: ContactList) -> HertzWall:
        # A flat plate of the balls' material, so R* is the ball's radius.
        normal, shear = (modulus * jnp.sqrt(network.radius) for modulus in self.moduli)
        rough = self.rough_walls
        viscosity = shear_viscosity = None
        beta = self.kind_of_damping.viscosity_ratio
        if beta is not None:
            mass = self.mass(network)
            viscosity = 2 * beta * jnp.sqrt(2 * normal * mass * (5 / 6))
            shear_viscosity = 2 * beta * jnp.sqrt(shear * mass * (5 / 6))
        return HertzWall(
            (4 / 3) * normal, viscosity, shear if rough else None, shear_viscosity if rough else None,
            SHALLOW * network.radius,
        )  # fmt: skip

    def confined_stiffness(self, network, stress):
        return self.tangent_stiffness(0.5 * network.radius.mean(), confined_force(network, stress))

    def force(self, radius, overlap):
        """Normal force (4/3) E* sqrt(R*) overlap^1.5 [F] for the reduced radius [L]; zero without overlap."""
        return (4 / 3) * self.moduli[0] * jnp.sqrt(radius) * jnp.maximum(overlap, 0.0) ** 1.5

    def tangent_stiffness(self, radius, force):
        """Normal and tangential tangent stiffness 2 E* a, 8 G* a [F/L] at a normal force [F], for a reduced radius."""
        modulus, shear_modulus = self.moduli
        contact_radius = jnp.cbrt(0.75 * force * radius / modulus)
        return 2 * modulus * contact_radius, shear_modulus * contact_radius

    def stiffness_over(self, reference):
        def under_load(material):
            """What the stiffnesses under a given force are proportional to."""
            modulus, shear_modulus = material.moduli
            return modulus ** (2 / 3), shear_modulus * modulus ** (-1 / 3)

        (normal, shear), (normal_0, shear_0) = under_load(self), under_load(reference)
        return jnp.maximum(normal / normal_0, shear / shear_0)

    def stiffest(self, network, stress, touching_within):
        radius = np.asarray(network.radius, float)
        force = OVERLOAD * confined_force(network, stress, touching_within)
        reduced = reduced_radius(network)
        deepest = jnp.maximum(force, self.force(reduced, network.overlap))
        normal, shear = self.tangent_stiffness(reduced, deepest)

        def of_wall(balls, area, overlap):
            share = np.asarray(network.weight)[balls].sum()
            load = OVERLOAD * float(stress) * area / max(share, 1e-3)
            load = jnp.maximum(load, self.force(radius[balls], overlap))
            return [np.asarray(k) for k in self.tangent_stiffness(radius[balls], load)]

        return np.asarray(normal), np.asarray(shear), of_wall


def reduced_radius(network: ContactList):
    """R* = r1 r2/(r1 + r2) of the contacts [L]; () where all balls are equal."""
    if jnp.ndim(network.pair_cube) == 0:
        return jnp.cbrt(0.25 * network.pair_cube)  # of equal balls r/2, from r^3/2
    first, second = network.contact_radii()
    return first * second / (first + second)


def confined_force(network: ContactList, stress, touching_within: float = 1e-3):
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
    return 3 * stress * volume / jnp.maximum(branches, 2 * radius.min())
