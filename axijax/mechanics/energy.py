"""The energy ledger: where the work done on a specimen went, kept beside the motion only where it is asked for.

Work of the platens, of the lateral load and of further terms = gain of kinetic and elastic energy + friction + damping.
Every term has a definition of its own and none is found by difference, so that what is missing measures the
integration.

The step is a leapfrog: over [t - dt/2, t + dt/2] the kinetic energy grows by exactly the forces at t times the mean
of the velocities before and after, times dt. All work is summed up with that mean, and every energy is that of a
half step: t - dt/2 for a state at t. The work on a linear spring is then exactly the change of its energy, if that
is k/2 times the stretch before times the stretch after the half step. So the balance closes to rounding, damping
included, but for contacts that open, close or turn during a step. A Hertzian contact has the energy of the geometric
mean of its overlaps before and after, which closes at second order in the step. Its tangential spring loses energy when
the contact radius changes (see `axijax.mechanics.hertz`); that is booked with the slip, exactly.

All terms are those of one sector: a ball on the axis counts 1/n, and each contact once.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.dynamics import LoadingRule, PlatenDrive, Scene, all_forces, make_step, positions, terms_of
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import Params
from axijax.mechanics.state import State
from axijax.mechanics.term import share_of_sector


class Ledger(NamedTuple):
    """Energy moved since the ledger was opened; scalars [F L].

    friction: lost to slip at the Coulomb limit, and by tangential springs whose stiffness changes; booked one half step
        late (see `energy_balance`).
    damping: lost to dashpots, or to local or background damping.
    platen_work, lateral_work: done on the balls by the platens and by the lateral load.
    other_work: done on them by all further terms.
    """

    friction: jax.Array
    damping: jax.Array
    platen_work: jax.Array
    lateral_work: jax.Array
    other_work: jax.Array


class EnergyBalance(NamedTuple):
    """All terms half a step before a state's positions; scalars [F L].

    translation, spin: kinetic energy of the balls.
    normal_springs, shear_springs: elastic energy of the contacts, walls included.
    friction, damping, platen_work, lateral_work, other_work: as in `Ledger`.
    """

    translation: jax.Array
    spin: jax.Array
    normal_springs: jax.Array
    shear_springs: jax.Array
    friction: jax.Array
    damping: jax.Array
    platen_work: jax.Array
    lateral_work: jax.Array
    other_work: jax.Array

    @property
    def stored(self) -> jax.Array:
        """Kinetic and elastic energy [F L]."""
        return self.translation + self.spin + self.normal_springs + self.shear_springs

    @property
    def unaccounted(self) -> jax.Array:
        """What is stored and lost, less the work done [F L]; its change is the error of the integration."""
        work = self.platen_work + self.lateral_work + self.other_work
        return self.stored + self.friction + self.damping - work


def open_ledger(dtype=jnp.float64) -> Ledger:
    """A ledger with nothing in it."""
    return Ledger(*(jnp.zeros((), dtype) for _ in Ledger._fields))


def make_ledger_step(scene: Scene, drive: PlatenDrive, loading: LoadingRule | None = None):
    """A pure function step(params, network, load, dt, (state, ledger)) -> (state, ledger).

    The state is advanced by `axijax.mechanics.dynamics.make_step`; the compiler finds its forces and the ledger's to be
    the same.
    """
    advance = make_step(scene, drive, loading)

    def step(params: Params, network: ContactList, load: Load, dt, both: tuple[State, Ledger]) -> tuple[State, Ledger]:
        state, ledger = both
        forces = all_forces(scene, params, network, load, dt, state)
        after = advance(params, network, load, dt, state)
        mean = state._replace(
            velocity=(state.velocity + after.velocity) * 0.5,
            spin=None if state.spin is None or after.spin is None else (state.spin + after.spin) * 0.5,
            platen_speeds=0.5 * (state.platen_speeds + after.platen_speeds),
        )
        spent = [
            term.spent(params, network, dt, state, memory, push, mean)
            for term, memory, push in zip(terms_of(params, load), state.memory, forces.pushes, strict=True)
        ]
        drag = dt * _drag_power(params, network, forces, state, mean)
        return after, Ledger(
            friction=ledger.friction + sum(each.friction for each in spent),
            damping=ledger.damping + drag + sum(each.damping for each in spent),
            platen_work=ledger.platen_work + spent[1].work,
            lateral_work=ledger.lateral_work + spent[2].work,
            other_work=ledger.other_work + sum(each.work for each in spent[3:]),
        )

    return step


def _drag_power(params: Params, network: ContactList, forces, state: State, mean: State):
    """Power that the damping of the balls' own motion takes."""
    damping, place = params.material.kind_of_damping, positions(network, state)
    mass = params.material.mass_per_cube * network.radius**3
    power = damping.power(place, state.velocity, mean.velocity, forces.resultant, mass)
    if state.spin is not None and mean.spin is not None and forces.moment is not None:
        inertia = 0.4 * mass * network.radius**2
        power = power + damping.power(place, state.spin, mean.spin, forces.moment, inertia)
    return share_of_sector(network, power)


def energy_balance(
    scene: Scene, params: Params, network: ContactList, load: Load, dt, state: State, ledger: Ledger
) -> EnergyBalance:
    """All terms at t - dt/2 for a state at t; arguments as in `axijax.mechanics.dynamics.all_forces`.

    The slip of the step before t is known only from the forces at t, which are found here once more.
    """
    mass = params.material.mass_per_cube * network.radius**3
    spin = jnp.zeros_like(ledger.friction)
    forces = all_forces(scene, params, network, load, dt, state)
    if state.spin is not None:
        spin = 0.5 * share_of_sector(network, 0.4 * mass * network.radius**2 * state.spin.dot(state.spin))
    each = list(zip(terms_of(params, load), state.memory, forces.pushes, strict=True))
    stored = [term.stored(params, network, dt, state, memory, push) for term, memory, push in each]
    pending = sum(term.pending(params, network, dt, state, memory, push) for term, memory, push in each)
    return EnergyBalance(
        translation=0.5 * share_of_sector(network, mass * state.velocity.dot(state.velocity)),
        spin=spin,
        normal_springs=sum(part.normal_springs for part in stored),
        shear_springs=sum(part.shear_springs for part in stored),
        **ledger._replace(friction=ledger.friction + pending)._asdict(),
    )
