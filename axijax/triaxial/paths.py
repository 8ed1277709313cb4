"""Paths: how a stage of a test loads the specimen, and when it is done.

A path is a pytree of its own numbers. `axijax.triaxial.stage.Stage` joins a command for the platens to one for the
membrane; from outside the package: subclass `Path`, register it as a dataclass, and give it to
`TriaxialTest(stages=(..,))`, or to `axijax.triaxial.engine` itself.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from axijax.core.tree import pytree
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.damping import BackgroundDamping
from axijax.mechanics.dynamics import Scene
from axijax.mechanics.membrane import Load, Membrane
from axijax.mechanics.observe import Observation
from axijax.mechanics.params import Params
from axijax.mechanics.state import Loading, State


class Path:
    """What a path is to the engine; this one keeps the platens where they are and goes on for ever."""

    def scene(self, scene: Scene) -> Scene:
        """What is modelled during the stage, of a test's scene."""
        return scene

    def params(self, params: Params, network: ContactList, membrane: Membrane, platens: jax.Array) -> Params:
        """The parameters during the stage, of the test's; platens: (2,) heights when the lists were built [L]."""
        return params

    def platen_speeds(self, params: Params, network: ContactList, dt, state: State, push, section) -> jax.Array:
        """(2,) velocities of the platens at t + dt/2, upward positive [L/T].

        push: (2,) forces of the balls on bottom and top platen; section: area that the platens load, both at t.
        """
        return jnp.zeros_like(state.platen_speeds)

    def begin(self, params: Params, network: ContactList, load: Load, state: State, push) -> Loading | None:
        """What it remembers at its start, of a test in stages; `state.loading` has no memory yet. push: as above."""
        return state.loading

    def loading(
        self, params: Params, network: ContactList, load: Load, dt, state: State, push, speeds
    ) -> Loading | None:
        """What it remembers at t + dt, the lateral stress included. speeds: of the platens at t + dt/2, as above."""
        if state.loading is None:
            return None
        closed = (speeds[0] - speeds[1]) * dt / state.loading.height
        return state.loading._replace(path_length=state.loading.path_length + jnp.abs(closed))

    def recorded(self, seen: Observation, state: State, dt, most: int) -> tuple[Loading | None, jax.Array | int]:
        """What it remembers after a record, of what it remembered before; and the steps to the next record, at most so
        many, fewer where the stage is to end before."""
        return state.loading, most

    def fluid(self, state: State) -> Any:
        """Elastic energy of a pore fluid over the specimen's volume, for the energy ledger [F/L^2]."""
        return 0.0

    def watch(self, seen: Observation, state: State) -> Any:
        """What of a record decides whether it goes on; a pytree. Before the first all that is seen is infinite."""
        return None

    def going(self, watched: Any, steps: jax.Array | int) -> jax.Array | bool:
        """Whether it goes on after so many steps. watched: of the last record."""
        return True

    def failed(self, watched: Any) -> jax.Array | bool:
        """Whether it has ended because the specimen could not follow it; no further stage begins then."""
        return False

    def ended(self, watched: Any) -> str:
        """Of a stage that has ended: why it could not be followed to its end, as a sentence; empty where it could."""
        return ""

    def duration(self, start: "Expected") -> "Expected":
        """Where a stage leads, and after how long it has surely ended; for the number of records of `simulate`."""
        raise ValueError(
            f"{type(self).__name__} does not say how long it takes: give it a method `duration`, see "
            "axijax.triaxial.paths.Expected."
        )

    def check(self) -> None:
        """Raise ValueError for numbers that make no sense."""


class Expected(NamedTuple):
    """Where a stage starts, or leads, as far as is known before anything runs.

    height [L]; axial_strain: least and most [-]; axial_stress, lateral_stress [F/L^2], NaN where only the test tells.
    speed: platen speed [L/T]. stiffness: of the specimen against a wave [F/L^2]; ramp: time in which speeds are reached
    [T]. time: that the stage takes at most [T].
    """

    height: float
    axial_strain: tuple[float, float]
    axial_stress: float
    lateral_stress: float
    speed: float
    stiffness: float
    ramp: float
    time: float = 0.0


class Balance(NamedTuple):
    """Mean unbalanced force over mean contact force, and |s1 - s3|/s3 [-]."""

    unbalanced_force: jax.Array
    stress_error: jax.Array

    @property
    def worst(self) -> jax.Array:
        """The larger of the two errors [-]."""
        return jnp.maximum(self.unbalanced_force, self.stress_error)


# A random packing has much softer modes than half a wave along the specimen; at a tenth of that wave's critical damping
# it settles five to ten times sooner, equally dense.
RANDOM_DAMPING = 0.1


@pytree
@dataclass(frozen=True)
class Isotropic(Path):
    """Membrane and both platens at the confining stress until forces balance.

    friction: in confinement; None, the paper's, lets a packing become as dense as it can [-].
    tolerance: unbalanced force and stress error that end it [-].
    most_steps: after which it ends in any case.
    """

    friction: jax.Array | float | None = None
    tolerance: jax.Array | float = 1e-7
    most_steps: jax.Array | int = 20_000

    def scene(self, scene):
        """Spins only where there is friction."""
        return replace(scene, rotation=self.friction is not None)

    def params(self, params, network, membrane, platens):
        """Background damping; tangential springs only where there is friction."""
        # In a lattice the slowest mode, half a wave along the specimen, is damped critically; others settle within it.
        share = RANDOM_DAMPING if membrane.zone_rule == "exposure" else 1.0
        height = (platens[1] - platens[0]).astype(network.dtype)
        # How fast it settles is no property of where it settles, so it has no tangent.
        rate = jax.lax.stop_gradient(share * 2 * jnp.pi * wave_speed(params, network) / height)
        return replace(params, damping=BackgroundDamping(rate), friction=self.friction)

    def platen_speeds(self, params, network, dt, state, push, section):
        """Platens carried by s3: each has the mass of one layer of balls and is damped like them."""
        mass = self.platen_mass(params, network)
        load = params.confining_stress * section
        half = 0.5 * dt * params.background_damping
        inward = jnp.array([1.0, -1.0], push.dtype) * (load - push) / mass
        return ((1 - half) * state.platen_speeds + dt * inward) / (1 + half)

    def platen_mass(self, params: Params, network: ContactList):
        """Of one layer of balls, () [M]."""
        return params.material.mass_per_cube * ((network.weight * network.mass_cube).sum() / layers(network))

    def watch(self, seen, state):
        return Balance(seen.unbalanced_force, jnp.abs(seen.stress_ratio - 1).astype(state.displacement.x.dtype))

    def going(self, watched, steps):
        return (watched.worst > self.tolerance) & (steps < self.most_steps)


@pytree
@dataclass(frozen=True)
class Compression(Path):
    """Both platens move inward at the platen speed, which is reached smoothly after `ramp_time` [T]: a sudden start
    sends a wave of rho c v through the specimen."""

    ramp_time: jax.Array | float

    def platen_speeds(self, params, network, dt, state, push, section):
        x = jnp.clip((state.time + dt) / self.ramp_time, 0.0, 1.0).astype(push.dtype)
        return jnp.array([1.0, -1.0], push.dtype) * params.platen_speed * x * x * (3 - 2 * x)


def layers(network: ContactList):
    """Number of layers of mean balls, one upon the other, () [-]."""
    return (network.positions.z.max() - network.positions.z.min()) / (2 * network.radius.mean()) + 1


def wave_speed(params: Params, network: ContactList):
    """P-wave speed of a close packing with stuck contacts, 2 r sqrt((kn + ks)/m) [L/T]; sets ramps and damping."""
    radius = network.radius.mean()
    mass = params.material.mass_per_cube * radius**3
    if network.mass_factor is not None:  # of a wave many balls long, whose density counts
        mass *= (network.weight * network.mass_cube).sum() / (network.weight * network.radius**3).sum()
    normal, shear = params.material.confined_stiffness(network, params.confining_stress)
    return 2 * radius * ((normal + shear) / mass) ** 0.5
