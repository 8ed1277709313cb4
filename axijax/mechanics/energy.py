"""The energy ledger: where the work done on a specimen went, kept beside the motion only where it is asked for.

Work of the platens, of the lateral load, of further terms and on a pore fluid = gain of kinetic and elastic energy, the
fluid's included, + friction + damping.
Every term has a definition of its own and none is found by difference, so that what is missing measures the
integration.

The step is a leapfrog: over [t - dt/2, t + dt/2] the kinetic energy grows by exactly the forces at t times the mean
of the velocities before and after, times dt. All work is summed up with that mean, and every energy is that of a
half step: t - dt/2 for a state at t. The work on a linear spring is then exactly the change of its energy, if that
is k/2 times the stretch before times the stretch after the half step. So the balance closes to rounding, damping
included, but for contacts that open, close or turn during a step. A Hertzian contact has the energy of the geometric
mean of its overlaps before and after, which closes at second order in the step. Its tangential spring loses energy when
the contact radius changes (see `axijax.mechanics.hertz`); that is booked with the slip, exactly.

A pore fluid is no term: effective stresses load the balls, and what platens and membrane do beside that work is done on
the fluid, its pressure times the volume that the specimen loses. That volume is the one by which the path knows its
pore pressure, the corrections at its records included (`Stage.recorded`).

All terms are those of one sector: a ball on the axis counts 1/n, and each contact once.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.dynamics import LoadingRule, PlatenDrive, Scene, all_forces, make_step, positions, terms_of
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import Params
from axijax.mechanics.state import State
from axijax.mechanics.term import share_of_sector


class FluidWork(NamedTuple):
    """work: done on a pore fluid by platens and membrane [F L]. volume: of a sector at the first step [L^3]; strain: of
    the volume at the last step as the path knows it, natural [-]; NaN before the first."""

    work: jax.Array
    volume: jax.Array
    strain: jax.Array


class Ledger(NamedTuple):
    """Energy moved since the ledger was opened; scalars [F L].

    friction: lost to slip at the Coulomb limit, and by tangential springs whose stiffness changes; booked one half step
        late (see `energy_balance`).
    damping: lost to dashpots, or to local or background damping.
    platen_work, lateral_work: done on the balls by the platens and by the lateral load.
    other_work: done on them by all further terms.
    fluid: work on a pore fluid.
    """

    friction: jax.Array
    damping: jax.Array
    platen_work: jax.Array
    lateral_work: jax.Array
    other_work: jax.Array
    fluid: FluidWork


class EnergyBalance(NamedTuple):
    """All terms half a step before a state's positions; scalars [F L].

    translation, spin: kinetic energy of the balls.
    normal_springs, shear_springs: elastic energy of the contacts, walls included.
    friction, damping, platen_work, lateral_work, other_work: as in `Ledger`.
    fluid_work, fluid: done on a pore fluid, and its elastic energy.
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
    fluid_work: jax.Array
    fluid: jax.Array

    @property
    def stored(self) -> jax.Array:
        """Kinetic and elastic energy [F L]."""
        return self.translation + self.spin + self.normal_springs + self.shear_springs + self.fluid

    @property
    def unaccounted(self) -> jax.Array:
        """What is stored and lost, less the work done [F L]; its change is the error of the integration."""
        work = self.platen_work + self.lateral_work + self.other_work + self.fluid_work
        return self.stored + self.friction + self.damping - work


def open_ledger(dtype=jnp.float64) -> Ledger:
    """A ledger with nothing in it."""
    zero, unknown = jnp.zeros((), dtype), jnp.full((), jnp.nan, dtype)
    return Ledger(zero, zero, zero, zero, zero, FluidWork(zero, unknown, unknown))


# Energy of a pore fluid over the specimen's volume [F/L^2]: `axijax.triaxial.paths.Path.fluid`.
FluidEnergy = Callable[[State], Any]


def make_ledger_step(
    scene: Scene, drive: PlatenDrive, loading: LoadingRule | None = None, fluid: FluidEnergy | None = None
):
    """A pure function step(params, network, load, dt, (state, ledger)) -> (state, ledger). fluid: where the path has a
    pore fluid; of one that only has a pore pressure no work is booked.

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
            fluid=_fluid_work(load, state, after, ledger.fluid) if fluid else ledger.fluid,
        )

    return step


def _fluid_work(load: Load, state: State, after: State, known: FluidWork) -> FluidWork:
    """One step later. The strain is counted from that of the step before, so that a correction between two steps is
    booked too."""
    assert state.loading is not None and after.loading is not None
    height = state.platens[1] - state.platens[0]
    axial = jnp.log(state.loading.height / height)
    # A path's pore pressure after the step is that of positions before it, as is its lateral strain.
    now = axial + 2 * after.loading.lateral_strain
    before = jnp.where(jnp.isnan(known.strain), axial + 2 * state.loading.lateral_strain, known.strain)
    volume = _first_volume(load, state, known)
    pressure = 0.5 * (state.loading.pore_pressure + after.loading.pore_pressure)
    return FluidWork(known.work + volume * pressure * (now - before), volume, now)


def _first_volume(load: Load, state: State, known: FluidWork):
    return jnp.where(jnp.isnan(known.volume), load.section * (state.platens[1] - state.platens[0]), known.volume)


def _drag_power(params: Params, network: ContactList, forces, state: State, mean: State):
    """Power that the damping of the balls' own motion takes."""
    damping, place = params.material.kind_of_damping, positions(network, state)
    mass = params.material.mass(network)
    power = damping.power(place, state.velocity, mean.velocity, forces.resultant, mass)
    if state.spin is not None and mean.spin is not None and forces.moment is not None:
        inertia = 0.4 * mass * network.radius**2
        power = power + damping.power(place, state.spin, mean.spin, forces.moment, inertia)
    return share_of_sector(network, power)


def energy_balance(
    scene: Scene,
    params: Params,
    network: ContactList,
    load: Load,
    dt,
    state: State,
    ledger: Ledger,
    fluid: FluidEnergy | None = None,
) -> EnergyBalance:
    """All terms at t - dt/2 for a state at t, a fluid's at t; arguments as in `axijax.mechanics.dynamics.all_forces`,
    fluid as in `make_ledger_step`.

    The slip of the step before t is known only from the forces at t, which are found here once more.
    """
    mass = params.material.mass(network)
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
        friction=ledger.friction + pending,
        damping=ledger.damping,
        platen_work=ledger.platen_work,
        lateral_work=ledger.lateral_work,
        other_work=ledger.other_work,
        fluid_work=ledger.fluid.work,
        fluid=_first_volume(load, state, ledger.fluid) * fluid(state) if fluid else jnp.zeros_like(spin),
    )
