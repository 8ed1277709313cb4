"""One step of the discrete element method: forces, damping, integration.

Central differences with velocities half a step behind the positions (Cundall & Strack 1979): forces from the
positions at t and the velocities at t - dt/2 give the velocities at t + dt/2, these the positions at t + dt.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp

from axijax.core.quantity import parts_of
from axijax.core.vector import Vector, zeros
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.contacts import ContactForces, ContactTerm
from axijax.mechanics.lateral import LateralTerm
from axijax.mechanics.membrane import Load
from axijax.mechanics.membrane_surface import straightened
from axijax.mechanics.params import Params
from axijax.mechanics.state import Loading, State
from axijax.mechanics.term import Memory, Push, Term, total
from axijax.mechanics.walls import WallForces, WallTerm

MembraneKind = Literal["radial", "normal", "tied"]


@dataclass(frozen=True)
class Scene:
    """What is modelled that is not a number; static and hashable. The parts of `Params` say the rest.

    rotation: balls may spin.
    membrane: what its force is, "radial", towards the axis; "normal" to its surface rho(z), so that it pushes a
        specimen that barrels along z as well; or "tied", normal and with its ends tied to platens as wide as the
        specimen as made. See `axijax.mechanics.membrane_surface`.

    Raises ValueError for another membrane.
    """

    rotation: bool = True
    membrane: MembraneKind = "radial"

    def __post_init__(self) -> None:
        if self.membrane not in get_args(MembraneKind):
            allowed = ", ".join(f"'{kind}'" for kind in get_args(MembraneKind))
            raise ValueError(f"scene membrane = {self.membrane!r}: must be one of {allowed}.")


def spins(scene: Scene, params: Params) -> bool:
    """Whether balls spin: nothing turns them where neither contacts nor walls have friction."""
    return scene.rotation and (params.material.frictional or params.material.rough_walls)


def terms_of(params: Params, load: Load | None = None) -> tuple[Term, ...]:
    """The terms of a scene in their order: contacts, walls, lateral load, and what else is part of the parameters."""
    further = (each for each in parts_of(params) if isinstance(each, Term))
    return ContactTerm(), WallTerm(), LateralTerm(load), *further


class Forces(NamedTuple):
    """All forces at one moment.

    resultant: (N,) unbalanced force on each ball, before any damping but the dashpots' [F].
    moment: (N,) [F L], or None where nothing spins.
    pushes: of each term.
    """

    resultant: Vector
    moment: Vector | None
    pushes: tuple[Push, ...]

    @property
    def contacts(self) -> ContactForces:
        """What the law made of each contact."""
        return self.pushes[0].detail

    @property
    def walls(self) -> WallForces:
        """What each wall does."""
        return self.pushes[1].detail

    @property
    def platen_push(self) -> tuple[jax.Array, jax.Array]:
        """Push of the bottom and of the top platen on each ball, (N,) each, positive [F]."""
        bottom, top = self.walls.normal[:2]
        return bottom, top

    @property
    def memory(self) -> tuple[Memory, ...]:
        """Of each term, one step later."""
        return tuple(push.memory for push in self.pushes)

    def platen_forces(self, network: ContactList) -> jax.Array:
        """(2,) forces that the balls put on the platens of a sector [F]."""
        return jnp.stack([(push * network.weight).sum() for push in self.platen_push])


def initial_state(scene: Scene, params: Params, network: ContactList, platens) -> State:
    """Balls at rest at the reference positions, springs unstrained; platens: (2,) heights [L]."""
    still = zeros(network.radius.shape, network.dtype)
    return State(
        displacement=still,
        velocity=still,
        spin=still if spins(scene, params) else None,
        memory=tuple(term.init(params, network) for term in terms_of(params)),
        platens=jnp.asarray(platens, jnp.float64),
        platen_speeds=jnp.zeros(2, network.dtype),
        time=jnp.zeros((), jnp.float64),
    )


def positions(network: ContactList, state: State) -> Vector:
    """Ball centres (N,) [L]."""
    return network.positions + state.displacement


def all_forces(scene: Scene, params: Params, network: ContactList, load: Load, dt, state: State) -> Forces:
    """The sum of all terms at the positions of `state`."""
    terms = terms_of(params, load)
    pushes = tuple(
        term.forces(params, network, dt, state, memory) for term, memory in zip(terms, state.memory, strict=True)
    )
    force, moment = total(pushes, "force"), total(pushes, "moment")
    assert force is not None
    if network.sector.images > 1:
        force = Vector(force.x * network.free.x, force.y * network.free.y, force.z)
        if moment is not None:
            moment = Vector(moment.x * network.free.x, moment.y * network.free.y, moment.z)
    return Forces(force, moment if spins(scene, params) else None, pushes)


# A platen drive gives the platens' velocities at t + dt/2, see `axijax.triaxial.paths.Path.platen_speeds`.
PlatenDrive = Callable[[Params, ContactList, Any, State, jax.Array, jax.Array], jax.Array]


# What the path remembers at t + dt, from the same and the platens' new speeds: `axijax.triaxial.paths.Path.loading`.
LoadingRule = Callable[[Params, ContactList, Load, Any, State, jax.Array, jax.Array], Loading | None]


def make_step(scene: Scene, drive: PlatenDrive, loading: LoadingRule | None = None):
    """A pure function step(params, network, load, dt, state) -> state for one scene and one way to load the specimen.

    drive: moves the platens. loading: changes the lateral stress; None where that is the confining stress throughout.
    """

    def step(params: Params, network: ContactList, load: Load, dt, state: State) -> State:
        forces = all_forces(scene, params, network, load, dt, state)
        push = straightened(state.lateral_stress(params), load, forces.platen_forces(network))
        platen_speeds = drive(params, network, dt, state, push, load.section)
        velocity, spin = next_motion(params, network, dt, state, forces)
        return State(
            displacement=state.displacement + velocity * dt,
            velocity=velocity,
            spin=spin,
            memory=forces.memory,
            platens=state.platens + dt * platen_speeds,
            platen_speeds=platen_speeds,
            time=state.time + dt,
            loading=None if loading is None else loading(params, network, load, dt, state, push, platen_speeds),
        )

    return step


def next_motion(params: Params, network: ContactList, dt, state: State, forces: Forces):
    """Velocities and spins (or None) at t + dt/2 from the forces at t; (N,) vectors [L/T], [1/T]."""
    mass = params.material.mass(network)
    advance = partial(params.material.kind_of_damping.advance, dt, positions(network, state))
    velocity = advance(state.velocity, forces.resultant, 1 / mass)
    if state.spin is None or forces.moment is None:
        return velocity, None
    return velocity, advance(state.spin, forces.moment, 1 / (0.4 * mass * network.radius**2))
