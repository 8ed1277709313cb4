"""The energy ledger: where the work done on a specimen went, kept beside the motion only where it is asked for.

Work of the platens and of the lateral load = gain of kinetic and elastic energy + friction + damping. Every term has a
definition of its own and none is found by difference, so that what is missing measures the integration.

The step is a leapfrog: over [t - dt/2, t + dt/2] the kinetic energy grows by exactly the forces at t times the mean
of the velocities before and after, times dt. All work is summed up with that mean, and every energy is that of a
half step: t - dt/2 for a state at t. The work on a linear spring is then exactly the change of its energy, if that
is k/2 times the stretch before times the stretch after the half step. So the balance closes to rounding, damping
included, but for contacts that open, close or turn during a step. A Hertzian contact has the energy of the geometric
mean of its overlaps before and after, which closes at second order in the step. Its tangential spring loses energy when
the contact radius changes (see `axijax.hertz`); that is booked with the slip, exactly.

All terms are those of one sector: a ball on the axis counts 1/n, and each contact once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.contact import Law, geometry
from axijax.dynamics import (
    Forces,
    Params,
    PlatenDrive,
    Scene,
    State,
    all_forces,
    contact_laws,
    local_damping_force,
    make_step,
    mass_per_cube,
    positions,
)
from axijax.membrane import Load, lateral_force
from axijax.neighbors import Network
from axijax.platens import wall_force
from axijax.sector import plane_normals
from axijax.vector import Vector


class Ledger(NamedTuple):
    """Energy moved since the ledger was opened; scalars [F L].

    friction: lost to slip at the Coulomb limit, and by tangential springs whose stiffness changes; booked one half step
        late (see `energy_balance`).
    damping: lost to dashpots, or to local or background damping.
    platen_work, lateral_work: done on the balls by the platens and by the lateral load.
    """

    friction: jax.Array
    damping: jax.Array
    platen_work: jax.Array
    lateral_work: jax.Array


class EnergyBalance(NamedTuple):
    """All terms half a step before a state's positions; scalars [F L].

    translation, spin: kinetic energy of the balls.
    normal_springs, shear_springs: elastic energy of the contacts, walls included.
    friction, damping, platen_work, lateral_work: as in `Ledger`.
    """

    translation: jax.Array
    spin: jax.Array
    normal_springs: jax.Array
    shear_springs: jax.Array
    friction: jax.Array
    damping: jax.Array
    platen_work: jax.Array
    lateral_work: jax.Array

    @property
    def stored(self) -> jax.Array:
        """Kinetic and elastic energy [F L]."""
        return self.translation + self.spin + self.normal_springs + self.shear_springs

    @property
    def unaccounted(self) -> jax.Array:
        """What is stored and lost, less the work done [F L]; its change is the error of the integration."""
        return self.stored + self.friction + self.damping - self.platen_work - self.lateral_work


def open_ledger(dtype=jnp.float64) -> Ledger:
    """A ledger with nothing in it."""
    return Ledger(*(jnp.zeros((), dtype) for _ in Ledger._fields))


def make_ledger_step(scene: Scene, drive: PlatenDrive):
    """A pure function step(params, network, load, dt, (state, ledger)) -> (state, ledger).

    The state is advanced by `axijax.dynamics.make_step`; the compiler finds its forces and the ledger's to be the same.
    """
    advance = make_step(scene, drive)

    def step(params: Params, network: Network, load: Load, dt, both: tuple[State, Ledger]) -> tuple[State, Ledger]:
        state, ledger = both
        forces = all_forces(scene, params, network, load, dt, state)
        after = advance(params, network, load, dt, state)
        velocity = (state.velocity + after.velocity) * 0.5
        spin = None if state.spin is None or after.spin is None else (state.spin + after.spin) * 0.5
        platen_speeds = 0.5 * (state.platen_speeds + after.platen_speeds)
        if scene.damping == "dashpot":
            lost = _dashpot_power(scene, params, network, forces, dt, state, velocity, spin, platen_speeds)
        else:
            lost = _drag_power(scene, params, network, forces, state, velocity, spin)
        bottom, top = ((push * network.weight).sum() for push in forces.platen_push)
        sideways = lateral_force(params.confining_stress, load, positions(network, state)).dot(velocity)
        return after, Ledger(
            friction=ledger.friction + _slip_work(scene, params, network, forces, dt, state, both_ends=True),
            damping=ledger.damping + dt * lost,
            platen_work=ledger.platen_work + dt * (bottom * platen_speeds[0] - top * platen_speeds[1]),
            lateral_work=ledger.lateral_work + dt * (sideways * network.weight).sum(),
        )

    return step


def energy_balance(
    scene: Scene, params: Params, network: Network, load: Load, dt, state: State, ledger: Ledger
) -> EnergyBalance:
    """All terms at t - dt/2 for a state at t; arguments as in `axijax.dynamics.all_forces`.

    The slip of the step before t is known only from the forces at t, which are found here once more.
    """
    mass = mass_per_cube(params) * network.radius**3 * network.weight
    spin = jnp.zeros_like(ledger.friction)
    shear_springs = spin
    friction = ledger.friction
    forces = all_forces(scene, params, network, load, dt, state)
    if state.spin is not None:
        spin = 0.5 * (0.4 * mass * network.radius**2 * state.spin.dot(state.spin)).sum()
    if state.spring is not None and forces.contacts.spring is not None:
        stretch = state.spring.dot(forces.contacts.spring)
        before, _ = _laws_before_and_now(scene, params, network, dt, state)
        shear_springs = 0.5 * (before.shear_stiffness * stretch * network.share).sum()
        friction = friction + _slip_work(scene, params, network, forces, dt, state, both_ends=False)
    return EnergyBalance(
        translation=0.5 * (mass * state.velocity.dot(state.velocity)).sum(),
        spin=spin,
        normal_springs=_normal_energy(scene, params, network, dt, state),
        shear_springs=shear_springs,
        friction=friction,
        damping=ledger.damping,
        platen_work=ledger.platen_work,
        lateral_work=ledger.lateral_work,
    )


def _one_step_ago(dt, state: State) -> State:
    """The state with displacements and platens of t - dt."""
    return state._replace(
        displacement=state.displacement - state.velocity * dt, platens=state.platens - state.platen_speeds * dt
    )


def _laws_before_and_now(scene: Scene, params: Params, network: Network, dt, state: State) -> tuple[Law, Law]:
    """The constants of the contacts at t - dt and t."""
    law, _ = contact_laws(scene, params, network)
    before, now = (geometry(network, at.displacement) for at in (_one_step_ago(dt, state), state))
    return law.at(before, None, dt), law.at(now, None, dt)


def _normal_energy(scene: Scene, params: Params, network: Network, dt, state: State):
    """Energy of all normal springs at t - dt/2."""
    earlier = _one_step_ago(dt, state)
    law, wall = contact_laws(scene, params, network)

    def closed(moment):
        gaps = [gap for gap, _ in _walls(network, moment, moment.velocity, moment.platen_speeds)]
        pressed = [jnp.maximum(-gap, 0.0) for gap in gaps]
        return jnp.maximum(geometry(network, moment.displacement).overlap, 0.0), pressed

    (contacts, walls), (contacts_before, walls_before) = closed(state), closed(earlier)
    energy = (law.energy(contacts * contacts_before) * network.share).sum()
    for now, before in zip(walls, walls_before, strict=True):
        energy += (wall.energy(now * before) * network.weight).sum()
    return energy


def _slip_work(scene: Scene, params: Params, network: Network, forces: Forces, dt, state: State, *, both_ends: bool):
    """Work of the shear springs in what has been cut off them since t - dt: the mean of their forces at t - dt and t
    times what was cut off, and what their energy has lost by a change of stiffness; or, of the two ends of the step,
    only what belongs to the first."""
    if state.spring is None or forces.contacts.spring is None:
        return jnp.zeros((), network.dtype)
    normal, relative = _relative_motion(network, state, state.velocity, state.spin)
    along = normal * relative.dot(normal)
    slip = state.spring + (relative - along) * dt - forces.contacts.spring
    before, now = (law.shear_stiffness for law in _laws_before_and_now(scene, params, network, dt, state))
    work = before * state.spring.dot(slip)
    if both_ends:
        work += now * forces.contacts.spring.dot(slip) + (before - now) * state.spring.dot(forces.contacts.spring)
    return 0.5 * (work * network.share).sum()


def _relative_motion(network: Network, state: State, velocity: Vector, spin: Vector | None) -> tuple[Vector, Vector]:
    """Normals of the contacts, and the velocity of the first ball's surface against the second's; (C,) vectors."""
    place = geometry(network, state.displacement)
    normal = place.apart * (1 / jnp.sqrt(place.apart.dot(place.apart)))
    relative = network.of_first(velocity) - network.of_second(velocity)
    if spin is not None:
        surface = spin * network.radius
        rolling = network.of_first(surface) + network.of_second(surface)
        relative = relative - rolling.cross(place.apart) * place.per_reach
    return normal, relative


def _dashpot_power(scene: Scene, params, network, forces: Forces, dt, state: State, velocity, spin, platen_speeds):
    """Power that the dashpots take at these velocities: what the forces at t hold beside the springs."""
    normal, relative = _relative_motion(network, state, velocity, spin)
    laws, wall_law = contact_laws(scene, params, network)
    place = geometry(network, state.displacement)
    law = laws.at(place, None, dt)
    elastic = normal * (law.normal_stiffness * jnp.maximum(place.overlap, 0.0))
    if forces.contacts.spring is not None:
        elastic = elastic - forces.contacts.spring * law.shear_stiffness
    power = ((elastic - forces.contacts.force).dot(relative) * network.share).sum()
    before = _walls(network, state, state.velocity, state.platen_speeds)
    for (gap, closing_before), (_, closing) in zip(
        before, _walls(network, state, velocity, platen_speeds), strict=True
    ):
        wall = wall_law.at(gap)
        push = wall_force(gap, closing_before, *wall)
        spring = wall_force(gap, closing_before, wall.stiffness, None)
        power += ((push - spring) * closing * network.weight).sum()
    return power


def _drag_power(scene: Scene, params: Params, network: Network, forces: Forces, state: State, velocity, spin):
    """Power that local or background damping takes at these velocities."""
    mass = mass_per_cube(params) * network.radius**3
    power = jnp.zeros_like(mass)
    if scene.damping == "background":
        power = params.background_damping * mass * velocity.dot(velocity)
        if spin is not None:
            power += params.background_damping * 0.4 * mass * network.radius**2 * spin.dot(spin)
    if scene.damping == "local":
        place = positions(network, state)
        power = -local_damping_force(params, place, state.velocity, forces.resultant).dot(velocity)
        if spin is not None and state.spin is not None and forces.moment is not None:
            power -= local_damping_force(params, place, state.spin, forces.moment).dot(spin)
    return (power * network.weight).sum()


def _walls(network: Network, state: State, velocity: Vector, platen_speeds) -> Iterator[tuple[jax.Array, jax.Array]]:
    """Gap [L] and closing speed [L/T] of every ball at every wall: two platens, two rigid sector planes; (N,) each."""
    place = positions(network, state)
    yield place.z - state.platens[0] - network.radius, platen_speeds[0] - velocity.z
    yield state.platens[1] - place.z - network.radius, velocity.z - platen_speeds[1]
    if network.sector.boundary == "rigid":
        for inward_x, inward_y in plane_normals(network.sector):
            gap = inward_x * place.x + inward_y * place.y - network.radius
            yield gap, -(inward_x * velocity.x + inward_y * velocity.y)
