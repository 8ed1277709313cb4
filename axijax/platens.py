"""Rigid plates: the two platens, and the rigid sector planes of the comparison runs. All frictionless."""

import jax.numpy as jnp

from axijax.neighbors import Network
from axijax.sector import plane_normals
from axijax.vector import Vector, zeros


def wall_force(gap, closing_speed, stiffness, viscosity):
    """Linear spring and dashpot of a frictionless wall, never tensile.

    gap: distance from the ball's surface to the wall, negative for an overlap [L]; closing_speed [L/T].
    """
    force = -stiffness * gap
    if viscosity is not None:
        force = force + viscosity * closing_speed
    return jnp.where((gap < 0) & (force > 0), force, 0.0)


def platen_forces(params, network: Network, rise, speed, platens, platen_speeds, viscosity):
    """Upward push of the bottom platen and downward push of the top one on each ball, (N,) each, positive [F].

    rise, speed: (N,) z displacement of the balls [L] and their velocity [L/T].
    platens, platen_speeds: (2,) heights of the bottom and top platen [L] and their velocities [L/T].
    viscosity: (N,) dashpot constant [F T/L], or None.
    """
    # Heights are subtracted in the platens' float64: in float32 their rounding is not small against an overlap.
    above = (network.positions.z - platens[0] - network.radius + rise).astype(network.dtype)
    below = (platens[1] - network.positions.z - network.radius - rise).astype(network.dtype)
    bottom = wall_force(above, platen_speeds[0] - speed, params.platen_stiffness, viscosity)
    top = wall_force(below, speed - platen_speeds[1], params.platen_stiffness, viscosity)
    return bottom, top


def sector_plane_force(params, network: Network, positions: Vector, velocity: Vector, viscosity) -> Vector:
    """Push of the two rigid sector planes on each ball, (N,) vectors [F]."""
    total = zeros(network.radius.shape, network.dtype)
    for (inward_x, inward_y) in plane_normals(network.sector):
        gap = inward_x * positions.x + inward_y * positions.y - network.radius
        closing = -(inward_x * velocity.x + inward_y * velocity.y)
        push = wall_force(gap, closing, params.platen_stiffness, viscosity)
        total = total + Vector(inward_x * push, inward_y * push, jnp.zeros_like(push))
    return total
