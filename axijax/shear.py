"""The pure part of a test: confinement with one contact list, and the shear, as functions for jit, vmap and jvp."""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from axijax.confinement import (
    STALE,
    Confinement,
    Limits,
    confine,
    confining_scene,
    current_load,
    repeat,
    unconfined,
    until_balls_moved,
    wear,
)
from axijax.curve import Curve, make_curve
from axijax.dynamics import Params, Scene, State, initial_state, make_step, positions
from axijax.membrane import Load, Membrane
from axijax.neighbors import Network, closing
from axijax.observe import observe
from axijax.sector import radial_distance
from axijax.status import ESCAPED, NOT_CONFINED, NOT_FINITE, STALE_CELLS, STALE_LIST
from axijax.update import Grid, renew

# A ball farther out than this many times the mean of the membrane's has left it. A small specimen that barrels at 13 %
# strain has sound balls at 1.5.
OUTSIDE = 2.0


@dataclass(frozen=True)
class Protocol:
    """The numbers of a test that are not physics; static.

    blocks, block_steps: the shear runs blocks * block_steps steps and records before each block.
    refresh: find the membrane's cells again with every record; otherwise they keep their first areas.
    limits: of confinement.
    rebuild_every, grid: make the lists anew each time after so many blocks, by this grid; zero keeps them.
    """

    blocks: int
    block_steps: int = 50
    refresh: bool = True
    limits: Limits = Limits()  # noqa: RUF009 (immutable)
    rebuild_every: int = 0
    grid: Grid | None = None


class Prepared(NamedTuple):
    """The numbers of a test that are traced; a pytree.

    platens: (2,) heights of the bottom and the top platen before confinement [L].
    time_step, ramp_time: of a step, and until the platens have their speed [T].
    lateral_load: a constant load in place of the membrane's, or None.
    """

    network: Network
    membrane: Membrane
    platens: jax.Array
    time_step: float
    ramp_time: float
    lateral_load: Load | None


def platen_ramp(ramp_time):
    """Platens moved inward at the platen speed, which is reached smoothly after ramp_time."""

    def drive(params, state, dt, push, section):
        x = jnp.clip((state.time + dt) / ramp_time, 0.0, 1.0).astype(push.dtype)
        return jnp.array([1.0, -1.0], push.dtype) * params.platen_speed * x * x * (3 - 2 * x)

    return drive


def fixed_load(protocol: Protocol, prepared: Prepared, start: State) -> Load | None:
    """The load that does not change during shear: one that was given, or the membrane's first where it is not
    refreshed. None where the membrane's cells are followed."""
    given = prepared.lateral_load
    if given is None and not protocol.refresh:
        return replace(current_load(prepared.membrane, prepared.network, start), stale=0.0)
    return given


@partial(jax.jit, static_argnums=(0, 1))
def shear(scene: Scene, protocol: Protocol, prepared: Prepared, params: Params, state: State, fixed: Load | None):
    """Shear on from a state: the state after all blocks, with the observation and the status before each block.

    fixed: the lateral load where it does not follow the membrane's cells.
    """
    if protocol.rebuild_every:
        return _shear_rebuilding(scene, protocol, prepared, params, state, fixed)
    # Reverse mode keeps the state before each block and runs the block again on the way back.
    block = jax.checkpoint(_shear_block(scene, protocol, prepared, params, fixed), prevent_cse=False)
    state, (seen, status) = jax.lax.scan(block, state, None, length=protocol.blocks)
    return state, seen, status


def _shear_rebuilding(
    scene: Scene, protocol: Protocol, prepared: Prepared, params: Params, state: State, fixed: Load | None
):
    """As `shear`, with contact list and membrane made anew each time after protocol.rebuild_every blocks."""
    stretch = replace(protocol, blocks=protocol.rebuild_every, rebuild_every=0)

    def further(carry, _):
        network, membrane, state = carry
        lists = prepared._replace(network=network, membrane=membrane)
        state, seen, status = shear(scene, stretch, lists, params, state, fixed)
        network, membrane, state, bits = renew(protocol.grid, network, membrane, state)
        return (network, membrane, state), (seen, status | bits)

    start = prepared.network, prepared.membrane, state
    stretches = -(-protocol.blocks // protocol.rebuild_every)
    (_, _, state), (seen, status) = jax.lax.scan(further, start, None, length=stretches)
    seen, status = jax.tree.map(lambda values: values.reshape(-1, *values.shape[2:])[: protocol.blocks], (seen, status))
    return state, seen, status


@partial(jax.jit, static_argnums=(0, 1))
def shear_until_worn(
    scene: Scene,
    protocol: Protocol,
    prepared: Prepared,
    params: Params,
    state: State,
    fixed: Load | None,
    done,
    fresh,
):
    """As `shear`, but stops where a list is worn, in the middle of a block if need be.

    done: steps taken since the last record; other than zero in the middle of a block. fresh: the lists were just made
        anew, so that it goes on at least a little whatever they look like.
    Returns the state; what was observed, in arrays of protocol.blocks places; the status of these blocks and of the
    last state together; how many records were made; the steps done since the last one; whether a list is worn.
    """
    network, membrane, dt = prepared.network, prepared.membrane, prepared.time_step
    step = make_step(scene, platen_ramp(prepared.ramp_time))
    look = _look(scene, prepared, params)

    def going(carry):
        state, load, _, _, number, done_now = carry
        at_start = (number == 0) & (done_now == done)
        return (number < protocol.blocks) & ((fresh & at_start) | (wear(network, state, load) <= 1))

    def further(carry):
        state, load, records, bits, number, done = carry
        seen, status = look(state, load)
        place = jnp.where(done == 0, number, protocol.blocks)  # beyond the end: not written
        records = jax.tree.map(lambda values, value: values.at[place].set(value, mode="drop"), records, seen)
        state, taken = until_balls_moved(
            lambda s: step(params, network, load, dt, s), network, dt, protocol.block_steps - done, state
        )
        number, done = number + (done == 0), (done + taken) % protocol.block_steps
        return state, current_load(membrane, network, state, fixed), records, bits | status, number, done

    load = current_load(membrane, network, state, fixed)
    empty = jax.eval_shape(look, state, load)[0]
    records = jax.tree.map(lambda value: jnp.zeros((protocol.blocks, *value.shape), value.dtype), empty)
    nothing = jnp.zeros((), jnp.int32)
    start = state, load, records, nothing, nothing, jnp.asarray(done, jnp.int32)
    state, load, records, bits, number, done = jax.lax.while_loop(going, further, start)
    # The last state too, before its lists are made anew: a contact that was missed is not found again.
    return state, records, bits | _trouble(network, membrane, state, load), number, done, wear(network, state, load) > 1


def _shear_block(scene: Scene, protocol: Protocol, prepared: Prepared, params: Params, fixed: Load | None):
    """A function of a state that observes it, and takes it one block of steps further; a scan's body."""
    network, membrane, dt = prepared.network, prepared.membrane, prepared.time_step
    step = make_step(scene, platen_ramp(prepared.ramp_time))
    look = _look(scene, prepared, params)

    def block(state, _):
        load = current_load(membrane, network, state, fixed)
        seen = look(state, load)
        return repeat(lambda s: step(params, network, load, dt, s), protocol.block_steps, state), seen

    return block


def _look(scene: Scene, prepared: Prepared, params: Params):
    """A function of a state and its load: what is observed, and status bits."""
    network, membrane, dt = prepared.network, prepared.membrane, prepared.time_step

    def look(state, load):
        seen = observe(scene, params, network, membrane, load, dt, state)
        return seen, _trouble(network, membrane, state, load)

    return look


def _trouble(network: Network, membrane: Membrane, state: State, load: Load) -> jax.Array:
    """Status bits of one state."""
    place = positions(network, state)
    rho = radial_distance(place)
    zone = membrane.share > 0
    mean_rho = jnp.where(zone, rho[membrane.zone], 0.0).sum() / zone.sum()
    finite = jnp.stack([jnp.isfinite(part).all() for part in (*state.displacement, *state.velocity)]).all()
    bits = jnp.where(finite, 0, NOT_FINITE)
    bits |= jnp.where(closing(network, state.displacement) > network.skin, STALE_LIST, 0)
    bits |= jnp.where(load.stale > STALE, STALE_CELLS, 0)
    inside = (place.z > state.platens[0]) & (place.z < state.platens[1]) & (rho < OUTSIDE * mean_rho)
    return bits | jnp.where(inside.all(), 0, ESCAPED)


def confine_test(scene: Scene, protocol: Protocol, prepared: Prepared, params: Params) -> tuple[State, Confinement]:
    """Confinement with one contact list throughout."""
    network = prepared.network
    scene = confining_scene(scene, protocol.limits)
    start = initial_state(network, scene, prepared.platens), unconfined(network.dtype)
    lists = network, prepared.membrane
    load = prepared.lateral_load
    return confine(scene, False, protocol.limits, lists, prepared.time_step, load, params, start)


def start_shear(scene: Scene, network: Network, confined: State) -> State:
    """The test's friction on, balls and platens from rest; springs of a frictional confinement are kept, or else start
    from nothing."""
    rest = initial_state(network, scene, confined.platens)
    spring = rest.spring if confined.spring is None or rest.spring is None else confined.spring
    return rest._replace(displacement=confined.displacement, spring=spring)


@partial(jax.jit, static_argnums=(0, 1))
def simulate(scene: Scene, protocol: Protocol, prepared: Prepared, params: Params) -> Curve:
    """The curve of a test: confinement and shear. One contact list serves it all, but for protocol.rebuild_every."""
    confined, balance = confine_test(scene, protocol, prepared, params)
    start = start_shear(scene, prepared.network, confined)
    _, seen, status = shear(scene, protocol, prepared, params, start, fixed_load(protocol, prepared, start))
    settled = balance.worst <= protocol.limits.tolerance
    status = jnp.bitwise_or.reduce(status) | jnp.where(settled, 0, NOT_CONFINED)
    return make_curve(seen, balance, status)
