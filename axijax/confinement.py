"""Confinement: membrane and platens at s3 until forces balance, with contact list and membrane made anew where worn.

Used by the test for its first stage, and by `random_packing` to compact a loose packing.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.dynamics import Params, Scene, State, confined_stiffness, initial_state, make_step, mass_per_cube, positions
from axijax.membrane import Load, Membrane, build_membrane, membrane_load
from axijax.neighbors import Network, build_network, carry_springs, closing
from axijax.observe import observe
from axijax.packing import Specimen
from axijax.sector import Sector
from axijax.vector import zeros
from axijax.zone import zone_found_again

STALE = 1e-2  # largest share of the strip's area that may be counted to the wrong cell
WORN, WORN_CELLS = 0.6, 0.05  # shares of the skin, and of STALE, at which the lists are made anew
CONFINE_BLOCK = 50  # steps between looks at the balance, and between refreshes of the membrane, in confinement
STRIDE = 10  # steps between looks at how far the balls have moved
# A random packing has much softer modes than half a wave along the specimen; at a tenth of that wave's critical damping
# it settles five to ten times sooner, equally dense.
RANDOM_DAMPING = 0.1


class Confinement(NamedTuple):
    """How confinement ended: mean unbalanced force over mean contact force, |s1 - s3|/s3, steps taken."""

    unbalanced_force: jax.Array
    stress_error: jax.Array
    steps: jax.Array

    @property
    def worst(self) -> jax.Array:
        """The larger of the two errors [-]."""
        return jnp.maximum(self.unbalanced_force, self.stress_error)


def unconfined(dtype=np.float64) -> Confinement:
    """Before the first step."""
    one = jnp.ones((), dtype)
    return Confinement(one, one, jnp.zeros((), jnp.int32))


class Limits(NamedTuple):
    """Friction coefficient in confinement [-], unbalanced force and stress error that end it [-], most steps."""

    friction: float = 0.0
    tolerance: float = 1e-7
    most_steps: int = 20_000

    @property
    def rubbing(self) -> bool:
        return self.friction > 0


def confining_scene(scene: Scene, limits: Limits) -> Scene:
    """What is modelled in confinement: the scene's contact law, background damping, and springs and spins only where
    there is friction."""
    return Scene(rotation=limits.rubbing, friction=limits.rubbing, damping="background", contact_law=scene.contact_law)


@partial(jax.jit, static_argnums=(0, 1))
def confine(
    scene: Scene,
    until_worn: bool,
    limits: Limits,
    lists: tuple[Network, Membrane],
    dt,
    fixed: Load | None,
    params: Params,
    start: tuple[State, Confinement],
    inertia: jax.Array | None = None,
) -> tuple[State, Confinement]:
    """Membrane and platens at the confining stress until balance and stress are within tolerance, or most_steps.

    scene: of `confining_scene`.
    until_worn: stop as well where a list is worn, so that it can be made anew.
    dt: time step [T]. fixed: a lateral load in place of the membrane's.
    inertia: (N,) by which the balls' true masses are multiplied, as balance knows no masses; None for true ones [-].
    """
    network, membrane = lists
    platens = start[0].platens
    # In a lattice the slowest mode, half a wave along the specimen, is damped critically; the others settle within it.
    share = RANDOM_DAMPING if membrane.zone_rule == "exposure" else 1.0
    rate = share * 2 * jnp.pi * wave_speed(scene, params, network) / (platens[1] - platens[0]).astype(network.dtype)
    true = params = replace(params, background_damping=rate)
    if inertia is not None:
        params = replace(params, density=params.density * inertia)
    if scene.friction:
        params = replace(params, friction=limits.friction)
    step = make_step(scene, _servo(network, true))

    def unsettled(carry):
        state, balance, load = carry
        going = (balance.worst > limits.tolerance) & (balance.steps < limits.most_steps)
        fresh = balance.steps == before
        return going & (fresh | (wear(network, state, load) <= 1)) if until_worn else going

    def block(carry):
        state, balance, load = carry

        def further(state):
            return step(params, network, load, dt, state)

        if until_worn:
            state, taken = until_balls_moved(further, network, dt, CONFINE_BLOCK, state)
        else:
            state, taken = repeat(further, CONFINE_BLOCK, state), CONFINE_BLOCK
        seen = observe(scene, params, network, membrane, load, dt, state)
        stress_error = jnp.abs(seen.stress_ratio - 1).astype(network.dtype)
        balance = Confinement(seen.unbalanced_force, stress_error, balance.steps + taken)
        return state, balance, current_load(membrane, network, state, fixed)

    before = start[1].steps
    load = current_load(membrane, network, start[0], fixed)
    return jax.lax.while_loop(unsettled, block, (*start, load))[:2]


def settle(
    scene: Scene,
    specimen: Specimen,
    network: Network,
    membrane: Membrane,
    params: Params,
    dt: float | None,
    limits: Limits,
    fixed: Load | None = None,
    inertia: jax.Array | None = None,
) -> tuple[Network, Membrane, State, Confinement]:
    """Confinement, from rest, with contact list and membrane made anew where they are worn (host loop).

    Arguments as in `confine`. Returns the last lists, the state and its balance, which may be outside the tolerance
    after limits.most_steps. Raises RuntimeError where a ball moves too fast for the lists.
    """
    state = initial_state(network, scene, jnp.asarray([specimen.bottom, specimen.top]))
    balance = unconfined(network.dtype)
    while True:
        lists = network, membrane
        state, balance = confine(scene, True, limits, lists, dt, fixed, params, (state, balance), inertia)
        if float(closing(network, state.displacement)) > float(network.skin):
            stiff = confined_stiffness(scene, params, network)[0]
            softness = float(params.confining_stress * network.radius.mean() / stiff)
            stiffness = "shear_modulus" if scene.contact_law == "hertz" else "normal_stiffness"
            raise RuntimeError(
                "confinement: two balls together moved by more than the skin of the contact list within a step or two, "
                f"so a contact may be missing (softness s3 r/kn = {softness:.2g}): lower confining_stress or raise "
                f"{stiffness}."
            )
        if float(balance.worst) <= limits.tolerance or int(balance.steps) >= limits.most_steps:
            return network, membrane, state, balance
        network, membrane, state = rebuilt(specimen, network, membrane, state)


def wave_speed(scene: Scene, params: Params, network: Network):
    """P-wave speed of a close packing with stuck contacts, 2 r sqrt((kn + ks)/m) [L/T]; sets ramps and damping."""
    radius = network.radius.mean()
    mass = params.density * (4 / 3) * np.pi * radius**3
    normal, shear = confined_stiffness(scene, params, network)
    return 2 * radius * ((normal + shear) / mass) ** 0.5


def _servo(network: Network, true: Params):
    """Platens carried by s3: each has the mass of one layer of balls and is damped like them.

    true: parameters with the balls' true density.
    """

    layers = (network.positions.z.max() - network.positions.z.min()) / (2 * network.radius.mean()) + 1
    cubes = (network.weight * network.radius**3).sum() / layers

    def drive(params, state, dt, push, section):
        load = params.confining_stress * section
        mass = mass_per_cube(true) * cubes
        half = 0.5 * dt * params.background_damping
        inward = jnp.array([1.0, -1.0], push.dtype) * (load - push) / mass
        return ((1 - half) * state.platen_speeds + dt * inward) / (1 + half)

    return drive


def repeat(function, times: int, state: State) -> State:
    """A state after so many steps."""
    return jax.lax.scan(lambda s, _: (function(s), None), state, None, length=times)[0]


def current_load(membrane: Membrane, network: Network, state: State, fixed: Load | None = None) -> Load:
    """The load of the membrane at the current positions, or the one that is given."""
    if fixed is not None:
        return fixed
    bottom, top = state.platens.astype(network.dtype)
    return membrane_load(membrane, positions(network, state), bottom, top)


def wear(network: Network, state: State, load: Load) -> jax.Array:
    """How far the lists have aged, contact list or membrane, as a share of where they are made anew."""
    return jnp.maximum(_list_wear(network, state), load.stale / (WORN_CELLS * STALE))


def _list_wear(network: Network, state: State) -> jax.Array:
    return closing(network, state.displacement) / (WORN * network.skin)


def until_balls_moved(step, network: Network, dt, most: int, state: State) -> tuple[State, jax.Array]:
    """A state after `most` steps, or fewer where the contact list is worn before; and how many it took, at least one.

    It looks once a stride, but a ball that flies fast (a small one that the membrane drives into a pore) ends the
    stride before the list is worn out.
    """

    def going(carry):
        state, taken = carry
        return (taken < most) & ((taken == 0) | (_list_wear(network, state) <= 1))

    def outlasts(state):
        """Whether the list holds for this step and the next, of which the next may be faster."""
        return closing(network, state.displacement + state.velocity * (2 * dt)) <= network.skin

    def stride(carry):
        def going(carry):
            state, steps = carry
            return (steps < end) & ((steps == taken) | outlasts(state))

        taken = carry[1]
        end = jnp.minimum(taken + STRIDE, most)
        return jax.lax.while_loop(going, lambda c: (step(c[0]), c[1] + 1), carry)

    return jax.lax.while_loop(going, stride, (state, jnp.zeros((), jnp.int32)))


def rebuilt(cut: Specimen, network: Network, membrane: Membrane, state: State, largest_overlap: float = 0.5):
    """Contact list and membrane built again from the current positions, springs carried over (host).

    Every ball keeps its number and its image. The arrays keep their shapes where they are large enough, or else are
    made with room to spare: a new shape is compiled anew.
    """
    sector = network.sector
    now = specimen_now(cut, network, membrane, state)
    now = replace(now, membrane_zone=zone_found_again(now, sector))
    skin, dtype = float(network.skin), network.dtype
    new = _list_in(network.slot.shape[0], network.first.size, now, sector, skin, largest_overlap, dtype)
    surface = _membrane_in(membrane.corner.shape[1], membrane.zone.size, now, sector, dtype)
    state = state._replace(displacement=zeros(network.radius.shape, network.dtype))
    if state.spring is not None:
        state = state._replace(spring=carry_springs(network, new, state.spring))
    return new, surface, state


def specimen_now(cut: Specimen, network: Network, membrane: Membrane, state: State) -> Specimen:
    """A test's balls, platens and membrane zone as they are in a state (host)."""
    bottom, top = (float(height) for height in state.platens)
    zone = np.isin(np.arange(len(cut)), np.asarray(membrane.zone))
    place = np.asarray(positions(network, state))
    return replace(cut, positions=place, bottom=bottom, top=top, membrane_zone=zone)


def roomy_lists(
    specimen: Specimen, sector: Sector, dtype=np.float64, largest_overlap: float = 0.05
) -> tuple[Network, Membrane]:
    """Contact list and membrane with room for what a random packing will become (host).

    Rooms are those of a usual dense packing where these are enough, so that specimens of a kind, loose and dense, share
    one shape, and one compiled program.
    """
    count = len(specimen)
    outer = int(5 * (count * sector.order) ** (2 / 3) / sector.order) + 8
    return (
        _list_in(18, 64 * -(-count // 10), specimen, sector, None, largest_overlap, dtype),
        _membrane_in(3 * outer + 80, outer, specimen, sector, dtype),
    )


def _list_in(width: int, contacts: int, specimen: Specimen, sector: Sector, skin, largest_overlap, dtype) -> Network:
    """Contact list of this shape where it fits, or else of one with room to spare."""
    try:
        return build_network(specimen, sector, skin, width, contacts, largest_overlap, dtype)
    except ValueError:  # what else may be wrong is wrong again here
        exact = build_network(specimen, sector, skin, largest_overlap=largest_overlap, dtype=dtype)
        rooms = _room(exact.slot.shape[0], width, 1), _room(exact.first.size, contacts, 64)
        return build_network(specimen, sector, skin, *rooms, largest_overlap, dtype)


def _membrane_in(triangles: int, balls: int, specimen: Specimen, sector: Sector, dtype) -> Membrane:
    """Membrane of this shape where it fits, or else of one with room to spare."""
    try:
        return build_membrane(specimen, sector, triangles, dtype, balls)
    except ValueError:
        exact = build_membrane(specimen, sector, dtype=dtype)
        rooms = _room(exact.corner.shape[1], triangles, 32), _room(exact.zone.size, balls, 16)
        return build_membrane(specimen, sector, rooms[0], dtype, rooms[1])


def _room(needed: int, room: int, step: int) -> int:
    """The room there is where it is enough, or else a fifth more than is needed, a multiple of `step`."""
    return room if needed <= room else -(-int(1.2 * needed) // step) * step
