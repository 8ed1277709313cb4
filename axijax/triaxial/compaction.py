"""How a loose cloud of balls becomes a packing that is uniform and isotropic: it contracts as a whole first.

Pressed from outside, balls that do not touch yet are swept up by membrane and platens: a dense shell forms round a
loose core; and as a specimen is higher than wide, its radius is closed in on first, so that contacts come to bear
sideways. So the cloud is first contracted in a stiff container, alike in all directions, while a medium draws all balls
along, until they bear on one another and on the platens. Only then membrane and platens take over, at the same stress.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from axijax.core.sector import radial_distance
from axijax.core.tree import pytree
from axijax.core.vector import Vector
from axijax.mechanics.term import Push, Term
from axijax.mechanics.walls import wall_force
from axijax.triaxial.paths import Balance, Isotropic, layers

PACE = 2e-3  # inertial number of the contraction
BEARING = 0.7  # of the confining stress, felt by the platens, at which membrane and platens take over
LIGHT = 1e-3  # of the confining stress, by which the membrane presses meanwhile


@pytree
@dataclass(frozen=True)
class Container(Term):
    """A smooth cylindrical wall that keeps its proportions as the platens approach, and a medium that moves like it.

    per_height: its radius over its height [-]. speed: of the linear contraction [1/T]. The medium's drag on a ball at
    rest is a force; the rest of it, against a motion, is the stage's background damping.
    """

    per_height: jax.Array | float
    speed: jax.Array | float

    stiffens = False

    def forces(self, params, network, dt, state, memory) -> Push:
        place = network.positions + state.displacement
        middle, height = state.platens.mean(), state.platens[1] - state.platens[0]
        rho = radial_distance(place)
        gap = (self.per_height * height).astype(network.dtype) - network.radius - rho
        wall = params.material.wall_law(network).at(gap)
        pressed = wall_force(gap, 0.0, wall.stiffness, None) / jnp.where(rho > 0, rho, 1.0)
        drawn = params.material.mass(network) * (params.background_damping * self.speed)
        inward = drawn + pressed
        above = place.z - middle.astype(network.dtype)
        return Push(Vector(-place.x * inward, -place.y * inward, -above * drawn))


@pytree
@dataclass(frozen=True)
class Compaction(Isotropic):
    """Small balls are made heavier, since balance knows no masses; platens, and the rate at which balls are damped, are
    those of true masses."""

    def params(self, params, network, membrane, platens):
        return super().params(params, replace(network, mass_factor=None), membrane, platens)

    def platen_mass(self, params, network):
        if network.mass_factor is None:
            return super().platen_mass(params, network)
        return (params.material.mass(network) * network.weight / network.mass_factor).sum() / layers(network)


@pytree
@dataclass(frozen=True)
class Contraction(Compaction):
    """Balls, platens and a container contract alike until the platens feel nearly the confining stress.

    per_height: radius of the container over its height [-]. The other fields are those of `Compaction`.
    """

    per_height: jax.Array | float = 0.25

    def params(self, params, network, membrane, platens):
        """A container, and hardly any pressure of the membrane."""
        stress = params.confining_stress
        speed = PACE * jnp.sqrt(stress / params.density) / (2 * network.radius.mean())
        params = super().params(params, network, membrane, platens)
        terms = *params.terms, Container(self.per_height, speed)
        return replace(params, confining_stress=LIGHT * stress, terms=terms)

    def platen_speeds(self, params, network, dt, state, push, section):
        """Those of balls that the medium sets in motion."""
        speed = params.terms[-1].speed * (1 - jnp.exp(-params.background_damping * state.time))
        return (speed * (state.platens.mean() - state.platens)).astype(push.dtype)

    def watch(self, seen, state):
        """What is missing of the stress on the platens; infinite where nothing has been seen."""
        missing = jnp.maximum(1 - LIGHT / BEARING * seen.stress_ratio, 0.0)
        missing = jnp.where(jnp.isfinite(seen.stress_ratio), missing, jnp.inf)
        return Balance(seen.unbalanced_force, missing)

    def going(self, watched, steps):
        return (watched.stress_error > 0) & (steps < self.most_steps)
