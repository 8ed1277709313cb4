"""Rolling and torsional resistance: contacts that resist relative rotation, as the corners of a sand grain do.

    rolling   M_b <- M_b - kr w_b dt,  kr = alpha_r R1 R2 ks,  |M_b| <= eta_r min(R1, R2) Fn
    torsion   the same with the part of w along the normal, alpha_tw and eta_tw

w is the rotation rate of ball 1 against ball 2, w_b its part in the contact plane; M acts on ball 1 and -M on ball 2
(Iwashita & Oda 1998; the form of YADE's CohesiveFrictionalContactLaw, with which Toyoura sand was fitted). PFC's
rrlinear and LAMMPS' rolling sds use the effective radius R1 R2/(R1 + R2), so their coefficients are twice these for
equal balls. ks is that of the contact law at the moment; where it falls as a Hertzian contact is let go, the moment
falls with it, so that no closed cycle gains energy.

Both are parts of the material and terms of the scene: `Params(rolling=Rolling(rolling_friction=0.3))`, or by name.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.core.vector import Vector, per_root, zeros
from axijax.mechanics import capped_spring
from axijax.mechanics.contacts import geometry, normal_force_of
from axijax.mechanics.term import STICKING, Memory, Push, Spent, Stored, Term


class RotationResistance(Term):
    """A spring against the relative rotation of two balls in contact. Its memory are the angles of the springs, (C,)
    vectors [-]; the detail of its push the moments on the first balls with the opposite sign [F L], and the angles."""

    def ratio_and_friction(self):
        """Stiffness over R1 R2 ks, and largest moment over min(R1, R2) Fn [-]."""
        raise NotImplementedError

    def part(self, vectors: Vector, normal: Vector) -> Vector:
        """The part of rotations that it resists."""
        raise NotImplementedError

    stiffens = False  # what it adds is in `axijax.mechanics.time_step`
    acts_apart = False

    def init(self, params, network):
        return Memory(contact=zeros(network.first.shape, network.dtype))

    def forces(self, params, network, dt, state, memory):
        if state.spin is None:
            return Push(None, None, memory)
        place, normal, approach = self._contacts(network, state)
        law = params.material.contact_law(network).at(place, approach, dt)
        ratio, friction = self.ratio_and_friction()
        first, second = network.contact_radii()
        angle = memory.contact if law.kept is None else memory.contact * law.kept
        moment, after = capped_spring.capped(
            self.part(angle, normal),
            self._rate(network, state.spin, normal),
            ratio * first * second * law.shear_stiffness,
            None,
            friction * jnp.minimum(first, second) * normal_force_of(law, place, approach.dot(normal))[1],
            dt,
        )
        on_balls = network.sum_on_balls(moment * -1.0, reaction=-1)
        return Push(None, on_balls, Memory(contact=after), (moment, after))

    def spent(self, params, network, dt, state, memory, push, mean):
        if state.spin is None:
            return Spent()
        cut, before, now = self._cut(params, network, dt, state, memory, push)
        lost = capped_spring.lost_at_first_end(before, memory.contact, cut)
        lost += capped_spring.lost_at_last_end(before, now, memory.contact, push.detail[1], cut)
        return Spent(friction=(lost * network.share).sum())

    def pending(self, params, network, dt, state, memory, push):
        if state.spin is None:
            return 0.0
        cut, before, _ = self._cut(params, network, dt, state, memory, push)
        return (capped_spring.lost_at_first_end(before, memory.contact, cut) * network.share).sum()

    def stored(self, params, network, dt, state, memory, push):
        if state.spin is None:
            return Stored()
        _, before, _ = self._cut(params, network, dt, state, memory, push)
        return Stored(shear_springs=0.5 * (before * memory.contact.dot(push.detail[1]) * network.share).sum())

    def _contacts(self, network, state):
        place = geometry(network, state.displacement)
        normal = place.branch * per_root(place.branch.dot(place.branch))
        return place, normal, network.apart(state.velocity)

    def _rate(self, network, spin, normal):
        return self.part(network.apart(spin), normal)

    def _cut(self, params, network, dt, state, memory, push):
        """What was cut off the springs since t - dt, and their stiffness then and now."""
        _, normal, _ = self._contacts(network, state)
        cut = capped_spring.slip(memory.contact, self._rate(network, state.spin, normal), dt, push.detail[1])
        law, (first, second) = params.material.contact_law(network), network.contact_radii()
        moments = state.displacement - state.velocity * dt, state.displacement
        factor = self.ratio_and_friction()[0] * first * second
        before, now = (factor * law.at(geometry(network, each), None, dt).shear_stiffness for each in moments)
        return cut, before, now


@pytree
@dataclass(frozen=True)
class Rolling(RotationResistance):
    """Resistance to rolling of one ball on another."""

    rolling_stiffness: jax.Array | float = quantity(
        0.5, "rolling stiffness alpha_r, over R1 R2 times the tangential stiffness", "-", above=0.0,
        symbols=("alpha_r",),
    )  # fmt: skip
    rolling_friction: jax.Array | float = quantity(
        0.1, "rolling friction eta_r: largest moment over the smaller radius times the normal force", "-",
        symbols=("eta_r",),
    )  # fmt: skip

    def ratio_and_friction(self):
        return self.rolling_stiffness, self.rolling_friction

    def stuck(self):
        return replace(self, rolling_friction=STICKING)

    def part(self, vectors, normal):
        return vectors - normal * vectors.dot(normal)


@pytree
@dataclass(frozen=True)
class Torsion(RotationResistance):
    """Resistance to spinning of one ball against another about their normal."""

    torsional_stiffness: jax.Array | float = quantity(
        0.5, "torsional stiffness alpha_tw, over R1 R2 times the tangential stiffness", "-", above=0.0,
        symbols=("alpha_tw",),
    )  # fmt: skip
    torsional_friction: jax.Array | float = quantity(
        0.1, "torsional friction eta_tw: largest moment over the smaller radius times the normal force", "-",
        symbols=("eta_tw",),
    )  # fmt: skip

    def ratio_and_friction(self):
        return self.torsional_stiffness, self.torsional_friction

    def stuck(self):
        return replace(self, torsional_friction=STICKING)

    def part(self, vectors, normal):
        return normal * vectors.dot(normal)
