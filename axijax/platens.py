"""Rigid plates: the two platens, and the rigid sector planes of the comparison runs. All frictionless."""

import jax
import jax.numpy as jnp

from axijax.neighbors import Network
from axijax.packing import plane_distances


def wall_force(gap, closing_speed, stiffness, viscosity):
    """Linear spring and dashpot of a frictionless wall, never tensile.

    gap: distance from the ball's surface to the wall, negative for an overlap [L]; closing_speed [L/T].
    """
    force = -stiffness * gap
    if viscosity is not None:
        force = force + viscosity * closing_speed
    return jnp.where((gap < 0) & (force > 0), force, 0.0)


def platen_forces(params, network: Network, height, speed, platens, platen_speeds, viscosity) -> jax.Array:
    """Upward push of the bottom platen and downward push of the top one on each ball; (2, N), positive [F].

    height, speed: (N,) z of the ball centres [L] and their velocity [L/T].
    platens, platen_speeds: (2,) heights of the bottom and top platen [L] and their velocities [L/T].
    viscosity: (N,) dashpot constant [F T/L], or None.
    """
    upward = jnp.array([1.0, -1.0], height.dtype)[:, None]
    gap = upward * (height - platens[:, None]) - network.radius
    closing = -upward * (speed - platen_speeds[:, None])
    return wall_force(gap, closing, params.platen_stiffness, viscosity)


def sector_plane_force(params, network: Network, positions, velocity, viscosity) -> jax.Array:
    """Push of the two rigid sector planes on each ball, along x and y; (2, N) [F]."""
    gap = plane_distances(positions, network.sector) - network.radius
    approach = -plane_distances(velocity, network.sector)
    push = wall_force(gap, approach, params.platen_stiffness, viscosity)
    cos, sin = (float(value) for value in network.sector.cos_sin(1))
    return jnp.stack([sin * push[1], push[0] - cos * push[1]])
