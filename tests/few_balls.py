"""Scenes of a few balls for the tests: built from plain arrays, run with still platens, recorded.

A flat frictional plane is a ball of radius PLANE, whose mass keeps it at rest; gravity is a constant lateral load, so
that it and the plane's normal lie in x, y. Units here: ball radius, mass and normal stiffness 1.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from axijax import Hertz, Linear, Params, Scene, Sector, Specimen
from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.contact_list import ContactList, build_contact_list
from axijax.mechanics.dynamics import initial_state, make_step
from axijax.mechanics.membrane import Load
from axijax.mechanics.state import State
from axijax.mechanics.term import Push, Spent, Term, share_of_sector

PLANE = 1e6
UNIT_MASS = 3 / (4 * np.pi)  # density at which a ball of radius 1 has mass 1
FAR = (-1e8, 1e8)
SCENE = Scene()

# Many small programs that run briefly: not worth optimising.
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


def unit_params(**changes) -> Params:
    """Unit mass and normal stiffness, ks/kn = 0.8, friction 0.3, no damping, confining stress 1."""
    material = Linear(friction=0.3, density=UNIT_MASS, damping=None, normal_stiffness=1.0, shear_stiffness=0.8)
    return Params(material, **({"confining_stress": 1.0} | changes))


NU = 0.2  # at which the shear modulus below makes E* = G/(1 - nu) one


def hertz_params(**changes) -> Params:
    """The same of Hertzian balls with E* = 1."""
    material = Hertz(friction=0.3, density=UNIT_MASS, damping=None, shear_modulus=1 - NU, poisson_ratio=NU)
    return Params(material, **({"confining_stress": 1.0} | changes))


@pytree
@dataclass(frozen=True)
class Pull(Term):
    """A constant force along z on every ball: the least that a further term can be."""

    pull: jax.Array | float = quantity(0.0, "force along z on every ball", "F", coordinate="linear", least=-np.inf)

    stiffens = False

    def forces(self, params, network, dt, state, memory) -> Push:
        still = jnp.zeros_like(network.radius)
        return Push(Vector(still, still, still + self.pull))

    def spent(self, params, network, dt, state, memory, push, mean) -> Spent:
        return Spent(work=dt * share_of_sector(network, push.force.dot(mean.velocity)))


def few_balls(
    params: Params, positions, velocity, spin=None, radius=1.0, platens=FAR, **options
) -> tuple[ContactList, State]:
    """Contact list and first state of balls at positions (3, N) with velocities and spins (3, N), without a sector.

    params: of them only which parts are there matters, for what the state must hold.
    """
    positions = np.asarray(positions, float)
    count = positions.shape[1]
    specimen = Specimen(positions, np.broadcast_to(radius, (count,)), *platens, np.ones(count, bool))
    options.setdefault("skin", 1.0)
    network = build_contact_list(specimen, Sector(1), **options)
    state = initial_state(SCENE, params, network, platens)
    state = state._replace(velocity=from_rows(np.asarray(velocity, float)))
    if state.spin is not None and spin is not None:
        state = state._replace(spin=from_rows(np.asarray(spin, float)))
    return network, state


def constant_load(forces) -> Load:
    """Forces (2, N) along x, y on the balls, for a confining stress of 1."""
    return Load(-jnp.asarray(forces, float), jnp.ones(()))


def no_load(network: ContactList) -> Load:
    return Load(jnp.zeros(network.radius.size), jnp.ones(()))


def still(params, network, dt, state, push, section):
    """Platens that do not move."""
    return jnp.zeros(2)


@jit
def run(params: Params, network: ContactList, load: Load, dt, steps, state: State) -> State:
    """The state after so many steps."""
    step = make_step(SCENE, still)
    return jax.lax.fori_loop(0, steps, lambda _, s: step(params, network, load, dt, s), state)


BLOCK = 64


@partial(jit, static_argnums=5)
def record(params: Params, network: ContactList, load: Load, dt, state: State, steps: int) -> State:
    """All states, the first one included; every array has the steps + 1 moments in front."""
    step = make_step(SCENE, still)

    def one(state, _):
        return step(params, network, load, dt, state), state

    # In blocks: compiled in haste, a scan copies all that it has recorded with every step.
    def block(state, _):
        return jax.lax.scan(one, state, None, length=BLOCK)

    states = jax.lax.scan(block, state, None, length=-(-(steps + 1) // BLOCK))[1]
    return jax.tree.map(lambda some: some.reshape(-1, *some.shape[2:])[: steps + 1], states)


def order_of(steps, errors) -> float:
    """Slope of log error over log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
