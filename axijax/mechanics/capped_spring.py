"""An elastic-plastic spring: it follows a rate of slip or turning, and its force is cut at a limit.

    trial force = stiffness * (spring + rate dt) + viscosity * rate
    force = trial * min(1, limit / |trial|),  spring = (spring + rate dt) * the same factor

The total is cut and the spring is scaled with it, so that a capped spring holds no more than its share (Cundall &
Strack 1979; Luding 2008, section 2.4: the return map). Friction between balls, friction on walls, and rolling and
torsional resistance are this one with their own rate, stiffness and limit.

The derivative is written out by hand: it shares the intermediate results of the value. `frictional_law` of
`axijax.mechanics.contacts` calls `value` and `tangent` from within its own derivative, all others call `capped`.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero

from axijax.core.vector import Vector, per_root


class Shared(NamedTuple):
    """Intermediate results that value and derivative share."""

    stretched: Vector  # the spring before it is cut
    trial: Vector
    sliding: jax.Array
    per_size: jax.Array
    scale: jax.Array


def value(spring: Vector, rate: Vector, stiffness, viscosity, limit, dt) -> tuple[Vector, Vector, Shared]:
    """Force, spring one step later, and what `tangent` shares.

    spring, rate: vectors of one shape [L], [L/T]. stiffness, viscosity: [F/L], [F T/L], the latter None without a
    dashpot. limit: the largest force [F], zero where there is no contact, inf for no limit.
    """
    stretched = spring + rate * dt
    trial = stretched * stiffness
    if viscosity is not None:
        trial = trial + rate * viscosity
    square = trial.dot(trial)
    # Without slip it would be 0/0, in value and tangent; a spring at rest is far below any limit but zero. The cap is a
    # minimum, not a choice by `sliding`: the compiler makes a condition anew wherever it is used, rounded differently,
    # so two choices by it need not agree.
    per_size = per_root(jnp.where(square > 0, square, jnp.finfo(square.dtype).tiny))
    scale = jnp.minimum(limit * per_size, 1.0)
    shared = Shared(stretched, trial, square > limit * limit, per_size, scale)
    return trial * scale, stretched * scale, shared


def tangent(
    shared: Shared, stiffness, limit_d, spring_d: Vector, rate_d: Vector, stiffness_d, viscosity_d, rate, viscosity, dt
):
    """Tangents of force and spring; x_d is the tangent of x, None or a symbolic zero where it has none."""
    stretched, trial, sliding, per_size, scale = shared
    stretched_d = spring_d + rate_d * dt
    trial_d = plus_vector(stretched_d * stiffness, stiffness_d, stretched)
    if viscosity is not None:
        trial_d = plus_vector(trial_d + rate_d * viscosity, viscosity_d, rate)
    size_d = per_size * trial.dot(trial_d)
    scale_d = jnp.where(sliding, per_size * (limit_d - scale * size_d), 0.0)
    return trial_d * scale + trial * scale_d, stretched_d * scale + stretched * scale_d


@partial(jax.custom_jvp)
def capped(spring: Vector, rate: Vector, stiffness, viscosity, limit, dt) -> tuple[Vector, Vector]:
    """Force and spring one step later; arguments as in `value`."""
    force, spring, _ = value(spring, rate, stiffness, viscosity, limit, dt)
    return force, spring


def _capped_jvp(primals, tangents):
    spring, rate, stiffness, viscosity, limit, dt = primals
    spring_d, rate_d, stiffness_d, viscosity_d, limit_d, _ = tangents  # dt is held
    force, after, shared = value(*primals)
    spring_d, rate_d, limit_d = moving(spring_d, spring), moving(rate_d, rate), moving(limit_d, jnp.asarray(limit))
    limit_d = jnp.where(jnp.isfinite(limit), limit_d, 0.0)
    return (force, after), tangent(
        shared, stiffness, limit_d, spring_d, rate_d, stiffness_d, viscosity_d, rate, viscosity, dt
    )


capped.defjvp(_capped_jvp, symbolic_zeros=True)


def moving(tangents, primals):
    """Tangents with arrays of zeros for symbolic ones."""
    return jax.tree.map(
        lambda d, p: jnp.zeros_like(p) if isinstance(d, SymbolicZero) else d,
        tangents, primals, is_leaf=lambda leaf: isinstance(leaf, SymbolicZero),
    )  # fmt: skip


def still(tangents) -> bool:
    return tangents is None or isinstance(tangents, SymbolicZero)


def plus(so_far, tangents, factor):
    """so_far + tangents * factor, without the work where a parameter is not differentiated."""
    return so_far if still(tangents) else so_far + factor * tangents


def plus_vector(so_far: Vector, tangents, factor: Vector) -> Vector:
    return so_far if still(tangents) else so_far + factor * tangents


def slip(spring: Vector, rate: Vector, dt, after: Vector) -> Vector:
    """What has been cut off a spring in a step that made it `after` [L]."""
    return spring + rate * dt - after


def lost_at_first_end(stiffness, spring: Vector, cut: Vector) -> jax.Array:
    """Half the work of the spring's force before the step in what was `cut` off it."""
    return 0.5 * (stiffness * spring.dot(cut))


def lost_at_last_end(stiffness_before, stiffness, spring: Vector, after: Vector, cut: Vector) -> jax.Array:
    """The other half, by the force after the step; and what the spring's energy lost by its change of stiffness."""
    return 0.5 * (stiffness * after.dot(cut) + (stiffness_before - stiffness) * spring.dot(after))
