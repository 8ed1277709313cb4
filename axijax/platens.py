"""Rigid plates: the two platens, and the rigid sector planes of the comparison runs. All frictionless."""

from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from axijax.neighbors import Network
from axijax.sector import plane_normals
from axijax.vector import Vector, zeros


class Wall(NamedTuple):
    """Constants of linear ball-plate contacts, numbers or (N,): stiffness [F/L], viscosity [F T/L] or None."""

    stiffness: jax.Array
    viscosity: jax.Array | None

    def at(self, gap) -> "Wall":
        """The wall of this moment: the same at all gaps (N,) [L]."""
        return self

    def energy(self, overlap_product):
        """Elastic energy of a contact whose overlaps, a little earlier and later, have this product [F L]."""
        return 0.5 * self.stiffness * overlap_product


class WallLaw(Protocol):
    """What a law of ball-plate contacts is to the rest of the program."""

    def at(self, gap) -> Wall: ...

    def energy(self, overlap_product) -> jax.Array: ...


def linear_wall(params, mass, *, dashpots: bool) -> Wall:
    """Plates that are as stiff as a contact of two balls; mass: (N,) of the balls [M]."""
    stiffness = params.platen_stiffness
    return Wall(stiffness, 2 * params.damping_ratio * jnp.sqrt(stiffness * mass) if dashpots else None)


def wall_force(gap, closing_speed, stiffness, viscosity):
    """Linear spring and dashpot of a frictionless wall, never tensile.

    gap: distance from the ball's surface to the wall, negative for an overlap [L]; closing_speed [L/T].
    """
    force = -stiffness * gap
    if viscosity is not None:
        force = force + viscosity * closing_speed
    return jnp.where((gap < 0) & (force > 0), force, 0.0)


def platen_forces(wall: WallLaw, network: Network, rise, speed, platens, platen_speeds):
    """Upward push of the bottom platen and downward push of the top one on each ball, (N,) each, positive [F].

    rise, speed: (N,) z displacement of the balls [L] and their velocity [L/T].
    platens, platen_speeds: (2,) heights of the bottom and top platen [L] and their velocities [L/T].
    """
    # Heights are subtracted in the platens' float64: in float32 their rounding is not small against an overlap.
    above = (network.positions.z - platens[0] - network.radius + rise).astype(network.dtype)
    below = (platens[1] - network.positions.z - network.radius - rise).astype(network.dtype)
    bottom = wall_force(above, platen_speeds[0] - speed, *wall.at(above))
    top = wall_force(below, speed - platen_speeds[1], *wall.at(below))
    return bottom, top


def sector_plane_force(wall: WallLaw, network: Network, positions: Vector, velocity: Vector) -> Vector:
    """Push of the two rigid sector planes on each ball, (N,) vectors [F]."""
    total = zeros(network.radius.shape, network.dtype)
    for inward_x, inward_y in plane_normals(network.sector):
        gap = inward_x * positions.x + inward_y * positions.y - network.radius
        closing = -(inward_x * velocity.x + inward_y * velocity.y)
        push = wall_force(gap, closing, *wall.at(gap))
        total = total + Vector(inward_x * push, inward_y * push, jnp.zeros_like(push))
    return total
