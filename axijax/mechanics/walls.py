"""Walls: an array of planes. Two platens that move along z, and for comparison two rigid sector planes that stand.

A wall pushes a ball like another ball of its material would, along its normal; where it has a friction coefficient it
also holds the ball's surface back by a capped spring, of which inf is glued. Platens and sector planes have a
coefficient each.
"""

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from axijax.core.sector import plane_normals
from axijax.core.vector import Vector, zeros
from axijax.mechanics import capped_spring
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.term import Memory, Push, Spent, Stored, Term, share_of_sector


class Wall(NamedTuple):
    """Constants of linear ball-plate contacts, numbers or (N,).

    stiffness [F/L]; viscosity [F T/L], or None.
    shear_stiffness, shear_viscosity: tangential, for walls with friction.
    kept: the share of the spring of the step before that is left before this step's slip [-]; None for all of it.
    """

    stiffness: jax.Array | float
    viscosity: jax.Array | None
    shear_stiffness: jax.Array | float | None = None
    shear_viscosity: jax.Array | None = None
    kept: jax.Array | None = None

    def at(self, gap, closing_speed=None, dt=None) -> "Wall":
        """The wall of this moment: the same at all gaps (N,) [L]."""
        return self

    def energy(self, overlap_product):
        """Elastic energy of a contact whose overlaps, a little earlier and later, have this product [F L]."""
        return 0.5 * self.stiffness * overlap_product


class WallLaw(Protocol):
    """What a law of ball-plate contacts is to the rest of the program."""

    def at(self, gap, closing_speed=None, dt=None) -> Wall: ...

    def energy(self, overlap_product) -> jax.Array: ...


class Plane(NamedTuple):
    """One wall and where the balls are before it.

    normal: unit vector into the specimen, three plain numbers.
    gap: (N,) from the balls' surfaces, negative for an overlap [L].
    speed: of the plane along its normal [L/T].
    friction: [-]; None for a smooth plane.
    """

    normal: tuple[float, float, float]
    gap: jax.Array
    speed: jax.Array | float
    friction: Any

    def along(self, vectors: Vector) -> jax.Array:
        """Components of vectors along the normal."""
        parts = [n * v for n, v in zip(self.normal, vectors, strict=True) if n != 0]
        return sum(parts[1:], parts[0])

    def times(self, numbers: jax.Array) -> Vector:
        """The normal times numbers."""
        return Vector(*(n * numbers if n != 0 else jnp.zeros_like(numbers) for n in self.normal))

    def closing_speed(self, velocity: Vector) -> jax.Array:
        return self.speed - self.along(velocity)

    def slip_rate(self, velocity: Vector, spin: Vector | None, radius) -> Vector:
        """Velocity of the balls' surfaces along the plane, (N,) vectors [L/T]."""
        rate = velocity - self.times(self.along(velocity))
        return rate if spin is None else rate - spin.cross(self.times(radius))


class WallForces(NamedTuple):
    """What each plane does.

    normal: (N,) each, positive [F].
    held: tangential force on the plane, (N,) vectors [F]; None where smooth, as is the next.
    springs: after this step, (N,) vectors [L].
    """

    normal: tuple[jax.Array, ...]
    held: tuple[Vector | None, ...]
    springs: tuple[Vector | None, ...]


def planes(
    network: ContactList, displacement: Vector, platens, platen_speeds, platen_friction=None, plane_friction=None
) -> tuple[Plane, ...]:
    """Bottom platen, top platen and, between rigid planes, the two sector planes, with the friction of either pair.

    displacement: (N,) of the balls [L]; platens, platen_speeds: (2,) heights [L] and velocities, upward positive.
    """
    # Heights are subtracted in the platens' float64: in float32 their rounding is not small against an overlap.
    above = (network.positions.z - platens[0] - network.radius + displacement.z).astype(network.dtype)
    below = (platens[1] - network.positions.z - network.radius - displacement.z).astype(network.dtype)
    found = [
        Plane((0.0, 0.0, 1.0), above, platen_speeds[0], platen_friction),
        Plane((0.0, 0.0, -1.0), below, -platen_speeds[1], platen_friction),
    ]
    if network.sector.boundary == "rigid":
        place = network.positions + displacement
        for x, y in plane_normals(network.sector).tolist():
            found.append(Plane((x, y, 0.0), x * place.x + y * place.y - network.radius, 0.0, plane_friction))
    return tuple(found)


def wall_force(gap, closing_speed, stiffness, viscosity):
    """Normal force of a linear spring and dashpot, never tensile.

    gap: distance from the ball's surface to the wall, negative for an overlap [L]; closing_speed [L/T].
    """
    force = -stiffness * gap
    if viscosity is not None:
        force = force + viscosity * closing_speed
    return jnp.where((gap < 0) & (force > 0), force, 0.0)


class WallTerm(Term):
    """Forces of platens and rigid sector planes. Its memory are the springs of each plane that has friction; the detail
    of its push is `WallForces`."""

    stiffens = False
    acts_apart = False

    def planes(self, params, network: ContactList, state, displacement=None, platens=None) -> tuple[Plane, ...]:
        """The planes at a state, or with balls and platens somewhere else."""
        displacement = state.displacement if displacement is None else displacement
        platens = state.platens if platens is None else platens
        material = params.material
        frictions = material.platen_friction, material.plane_friction
        return planes(network, displacement, platens, state.platen_speeds, *frictions)

    def init(self, params, network) -> Memory:
        still = zeros(network.radius.shape, network.dtype)
        springs = tuple(None if friction is None else still for friction in _frictions(params, network))
        return _memory(springs)

    def forces(self, params, network, dt, state, memory) -> Push:
        law = params.material.wall_law(network)
        found: list[tuple[Any, Any, Any]] = []
        force = moment = None
        springs = self._springs(params, network, memory)
        for plane, spring in zip(self.planes(params, network, state), springs, strict=True):
            closing = plane.closing_speed(state.velocity)
            wall = law.at(plane.gap, closing, dt)
            pressed = wall_force(plane.gap, closing, wall.stiffness, wall.viscosity)
            push, held, after = plane.times(pressed), None, None
            if spring is not None:
                rate = plane.slip_rate(state.velocity, state.spin, network.radius)
                limit = jnp.where(pressed > 0, plane.friction * jnp.where(pressed > 0, pressed, 1.0), 0.0)
                held, after = capped_spring.capped(
                    spring if wall.kept is None else spring * wall.kept,
                    rate, wall.shear_stiffness, wall.shear_viscosity, limit.astype(network.dtype), dt,
                )  # fmt: skip
                push = push - held
                turning = plane.times(network.radius).cross(held)
                moment = turning if moment is None else moment + turning
            force = push if force is None else force + push
            found.append((pressed, held, after))
        detail = WallForces(*zip(*found, strict=True))
        return Push(force, moment, _memory(detail.springs), detail)

    def spent(self, params, network, dt, state, memory, push, mean) -> Spent:
        law, lost = params.material.wall_law(network), jnp.zeros_like(network.radius)
        speeds = mean.platen_speeds
        bottom, top = (share_of_sector(network, force) for force in push.detail.normal[:2])
        now, later = self.planes(params, network, state), self.planes(params, network, mean)
        for plane, moving, pressed in zip(now, later, push.detail.normal, strict=True):
            wall = law.at(plane.gap)
            spring = wall_force(plane.gap, plane.closing_speed(state.velocity), wall.stiffness, None)
            lost += (pressed - spring) * moving.closing_speed(mean.velocity)
        friction, viscous = self._friction(params, network, dt, state, memory, push, mean)
        return Spent(
            work=dt * (bottom * speeds[0] - top * speeds[1]),
            damping=dt * share_of_sector(network, lost + viscous),
            friction=friction,
        )

    def stored(self, params, network, dt, state, memory, push) -> Stored:
        law = params.material.wall_law(network)
        normal = shear = jnp.zeros_like(network.radius)
        before = self._before(params, network, dt, state)
        for plane, earlier in zip(self.planes(params, network, state), before, strict=True):
            normal += law.energy(jnp.maximum(-plane.gap, 0.0) * jnp.maximum(-earlier.gap, 0.0))
        springs = self._springs(params, network, memory)
        for earlier, spring, after in zip(before, springs, push.detail.springs, strict=True):
            if spring is not None:
                shear += 0.5 * law.at(earlier.gap).shear_stiffness * spring.dot(after)
        return Stored(share_of_sector(network, normal), share_of_sector(network, shear))

    def pending(self, params, network, dt, state, memory, push):
        return self._friction(params, network, dt, state, memory, push, None)[0]

    def _friction(self, params, network, dt, state, memory, push, mean):
        """What the springs lost in slip, at one end of the step or, with a mean motion, at both; and the power (N,) of
        their dashpots at that mean motion."""
        law = params.material.wall_law(network)
        lost = viscous = jnp.zeros_like(network.radius)
        places = zip(
            self.planes(params, network, state), self._before(params, network, dt, state),
            self._springs(params, network, memory), push.detail.held, push.detail.springs, strict=True,
        )  # fmt: skip
        for plane, earlier, spring, held, after in places:
            if spring is None:
                continue
            closing = plane.closing_speed(state.velocity)
            wall, before = law.at(plane.gap, closing, dt), law.at(earlier.gap)
            rate = plane.slip_rate(state.velocity, state.spin, network.radius)
            cut = capped_spring.slip(spring, rate, dt, after)
            lost += capped_spring.lost_at_first_end(before.shear_stiffness, spring, cut)
            if mean is not None:
                stiffness = before.shear_stiffness, wall.shear_stiffness
                lost += capped_spring.lost_at_last_end(*stiffness, spring, after, cut)
                elastic = after * wall.shear_stiffness
                viscous += (held - elastic).dot(plane.slip_rate(mean.velocity, mean.spin, network.radius))
        return share_of_sector(network, lost), viscous

    def _before(self, params, network: ContactList, dt, state) -> tuple[Plane, ...]:
        """The planes at t - dt."""
        return self.planes(
            params, network, state, state.displacement - state.velocity * dt, state.platens - state.platen_speeds * dt
        )

    def _springs(self, params, network: ContactList, memory: Memory):
        return memory.ball or (None,) * len(_frictions(params, network))


def _memory(springs: tuple[Vector | None, ...]) -> Memory:
    return Memory(ball=None if all(spring is None for spring in springs) else springs)


def _frictions(params, network: ContactList) -> tuple[Any, ...]:
    """Friction of each plane; None where it is smooth."""
    platens, sectors = (params.material.platen_friction,) * 2, (params.material.plane_friction,) * 2
    return platens + sectors if network.sector.boundary == "rigid" else platens


class PlatenLoads(NamedTuple):
    """What the balls of a sector put on the bottom and the top platen; (2,) vectors.

    force [F]. moment: about the origin, of forces that act where the balls' surfaces are [F L].
    """

    force: Vector
    moment: Vector


def platen_loads(network: ContactList, place: Vector, walls: WallForces) -> PlatenLoads:
    """Normal and friction forces together. place: (N,) ball centres; walls: the detail of `WallTerm`'s push."""
    found = []
    for up, pressed, held in zip((1.0, -1.0), walls.normal, walls.held, strict=False):
        still = jnp.zeros_like(pressed)
        force = Vector(still, still, -up * pressed)
        force = force if held is None else force + held
        moment = (place - Vector(still, still, up * network.radius)).cross(force)
        found.append([vectors.map(lambda part: (part * network.weight).sum()) for vectors in (force, moment)])
    forces, moments = zip(*found, strict=True)
    return PlatenLoads(*(Vector(*map(jnp.stack, zip(*each, strict=True))) for each in (forces, moments)))
