"""Damping: what takes energy out of the motion. A part of the material; None is no damping at all.

Dashpots in the contacts are the default, and the only kind whose derivatives mean something near failure. The other two
act on each ball's motion and are there for comparison with other codes, and for confinement.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from axijax.core.quantity import quantity
from axijax.core.sector import radial_distance
from axijax.core.tree import pytree
from axijax.core.vector import Vector


class Damping:
    """What a kind of damping is to the rest of the program; this one does nothing.

    Motions, forces and their product with the inertia stand for velocities, forces and masses, or for spins, moments
    and moments of inertia; (N,) vectors and numbers.
    """

    @property
    def viscosity_ratio(self):
        """beta of dashpots in the contacts [-], or None without."""
        return None

    def advance(self, dt, place: Vector, motion: Vector, force: Vector, per_inertia) -> Vector:
        """The motion at t + dt/2 from that at t - dt/2 and the forces at t; place: (N,) ball centres [L]."""
        return motion + force * (dt * per_inertia)

    def power(self, place: Vector, motion: Vector, mean_motion: Vector, force: Vector, inertia) -> jax.Array:
        """Power that it takes from each ball, (N,) [F L/T]. motion: at t - dt/2; mean_motion: over the step about t."""
        return jnp.zeros_like(inertia)


UNDAMPED = Damping()


@pytree
@dataclass(frozen=True)
class Dashpot(Damping):
    """Dashpots c = 2 beta sqrt(k m*) in the contacts, normal while they touch, tangential while they stick."""

    damping_ratio: jax.Array | float = quantity(
        0.05, "beta of the contact dashpots c = 2 beta sqrt(k m*)", "-", symbols=("beta",)
    )

    @property
    def viscosity_ratio(self):
        return self.damping_ratio


@pytree
@dataclass(frozen=True)
class LocalDamping(Damping):
    """Cundall's local damping, -a |F| sign(v) in each component: a force is reduced where it drives the motion, and
    raised where it opposes it. Its tangents are meaningless: they do not see the switching of the sign.

    Radial, circumferential and vertical components, so that a ball and its turned images are damped alike.
    """

    local_damping: jax.Array | float = quantity(
        0.7, "Cundall's local damping coefficient", "-", below=1.0, coordinate="logit"
    )

    def drag(self, place: Vector, motion: Vector, force: Vector) -> Vector:
        """The damping force [F]."""
        distance = radial_distance(place)
        off_axis = jnp.where(distance > 0, distance, 1.0)
        cos, sin = jnp.where(distance > 0, place.x / off_axis, 1.0), place.y / off_axis
        force_in, motion_in = force.turned(cos, -sin), motion.turned(cos, -sin)
        drag = [-self.local_damping * jnp.abs(f) * jnp.sign(m) for f, m in zip(force_in, motion_in, strict=True)]
        return Vector(*drag).turned(cos, sin)

    def advance(self, dt, place, motion, force, per_inertia):
        return motion + (force + self.drag(place, motion, force)) * (dt * per_inertia)

    def power(self, place, motion, mean_motion, force, inertia):
        return -self.drag(place, motion, force).dot(mean_motion)


@pytree
@dataclass(frozen=True)
class BackgroundDamping(Damping):
    """Mass-proportional damping: every velocity and spin decays at a rate. Adds strength that is not there."""

    background_damping: jax.Array | float = quantity(0.5, "mass-proportional damping rate", "1/T")

    def advance(self, dt, place, motion, force, per_inertia):
        # Half of it on either side of the force, so that even a large rate only stops the balls.
        half = 0.5 * dt * self.background_damping
        return (motion * (1 - half) + force * (dt * per_inertia)) * (1 / (1 + half))

    def power(self, place, motion, mean_motion, force, inertia):
        return self.background_damping * inertia * mean_motion.dot(mean_motion)
