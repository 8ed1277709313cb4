"""The engine: steps a stage of a test along its path and observes it. Pure functions for jit; one loop of either kind.

`march` takes a fixed number of records in a scan, for jvp, vmap and reverse mode. `march_until` goes on while its path
does, and stops where a list is worn so that it can be rebuilt on the host.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from axijax.core.platform import warn_where_slow
from axijax.core.sector import radial_distance
from axijax.core.status import ESCAPED, NOT_FINITE, STALE_CELLS, STALE_LIST
from axijax.mechanics.contact_list import ContactList, closing
from axijax.mechanics.contact_search import rebuild_in_jit
from axijax.mechanics.dynamics import Scene, make_step, positions
from axijax.mechanics.membrane import Load, Membrane, membrane_load
from axijax.mechanics.observe import Observation, Space, observe, space
from axijax.mechanics.params import Params
from axijax.mechanics.state import State
from axijax.triaxial.paths import Path
from axijax.triaxial.tight_steps import can_be_tight, fixed_steps, observed, steps_until_worn, tight_list

STALE = 1e-2  # largest share of the strip's area that may be counted to the wrong cell
WORN, WORN_CELLS = 0.6, 0.05  # shares of the skin, and of STALE, at which the lists need a rebuild
STRIDE = 10  # steps between looks at how far the balls have moved
# A ball farther out than this many times the mean of the membrane's has left it. A small specimen that barrels at 13 %
# strain has sound balls at 1.5.
OUTSIDE = 2.0

Lists = tuple[ContactList, Membrane]


def march(
    scene: Scene,
    path: Path,
    records: int,
    record_every: int,
    rebuild_every: int,
    lists: Lists,
    dt,
    params: Params,
    state: State,
    fixed: Load | None,
) -> tuple[State, Observation, jax.Array]:
    """So many records, each followed by `record_every` steps: the last state, the observations and status bits (T,).

    rebuild_every: renew contact list and membrane each time after so many records; zero keeps them.
    fixed: the lateral load where it does not follow the membrane's cells.
    """
    (_, state), seen, status, _ = march_stage(
        scene, path, records, record_every, rebuild_every, lists, dt, params, state, fixed
    )
    return state, seen, status


def march_stage(
    scene: Scene,
    path: Path,
    records: int,
    record_every: int,
    rebuild_every: int,
    lists: Lists,
    dt,
    params: Params,
    state: State,
    fixed: Load | None,
    begins: jax.Array | bool = True,
) -> tuple[tuple[Lists, State], Observation, jax.Array, Any]:
    """As `march`, of a path that may end before: from then on its state stays. The last lists and state, observations,
    status bits, and what the path has watched (T,). begins: whether it goes on at all."""
    if not rebuild_every:
        # Reverse mode keeps the state before each record and takes its steps again on the way back.
        block = _block(scene, path, record_every, lists, dt, params, state, fixed, begins)
        block = jax.checkpoint(block, prevent_cse=False)
        state, (seen, status, watched) = jax.lax.scan(block, state, None, length=records)
        return (lists, state), seen, status, watched

    def stretch(carry, _):
        (lists, state), seen, status, watched = march_stage(
            scene, path, rebuild_every, record_every, 0, carry[0], dt, params, carry[1], fixed, begins
        )
        *lists, state = rebuild_in_jit(*lists, state)
        return (tuple(lists), state), (seen, status | lists[0].status, watched)

    last, kept = jax.lax.scan(stretch, (lists, state), None, length=-(-records // rebuild_every))
    seen, status, watched = jax.tree.map(lambda values: values.reshape(-1, *values.shape[2:])[:records], kept)
    return last, seen, status, watched


def _block(scene: Scene, path: Path, record_every: int, lists: Lists, dt, params: Params, start: State, fixed, begins):
    """A scan's body: observes a state, and takes it `record_every` steps further."""
    network, membrane = lists
    step, see = _stepping(scene, path, lists, dt, params, start)
    tightly = can_be_tight(network, params)

    def block(state, _):
        load = current_load(membrane, network, state, fixed)
        tight = tight_list(network, state, dt, record_every) if tightly else None
        seen = observed(partial(see, load, space(network, membrane, state)), network, tight, state)
        status = status_bits(network, membrane, state, load)
        watched = path.watch(seen, state)

        def further(state):
            one = partial(step, load)
            loading, steps = path.recorded(seen, state, dt, record_every)
            state = state._replace(loading=loading)
            if steps is not record_every:
                # All are gone through, since reverse mode needs their number; those that are too many do nothing.
                end = state.time + (steps - 0.5) * dt

                def one(network, state):
                    return jax.lax.cond(state.time < end, partial(step, load, network), lambda state: state, state)

            return fixed_steps(one, network, dt, tight, state, record_every)

        if type(path).going is Path.going:
            return further(state), (seen, status, watched)
        on = begins & path.going(watched, jnp.rint(state.time / dt))
        return jax.lax.cond(on, further, lambda s: s, state), (seen, status, watched)

    return block


class Stretch(NamedTuple):
    """What `march_until` has reached.

    state: the last. seen: observations, in arrays with places for all records that may be; None where none are kept.
    records: how many there are.
    due: steps until the next one. steps: taken since the stage began. watched: of the last observation, by the path.
    status: bits of all states that were looked at, the last one included. worn: whether a list needs a rebuild.
    """

    state: State
    seen: Observation | None
    records: jax.Array
    due: jax.Array
    steps: jax.Array
    watched: Any
    status: jax.Array
    worn: jax.Array


@partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))
def march_until(
    scene: Scene,
    records: int | None,
    record_every: int,
    until_worn: bool,
    every_step: bool,
    path: Path,
    lists: Lists,
    dt,
    params: Params,
    state: State,
    fixed: Load | None,
    due,
    steps,
    fresh,
    limit=0,
    past_last=False,
) -> Stretch:
    """A stage from a state as long as its path goes on, with a record whenever one is due.

    records: places for records, see `limit`; None for no such end, and none are kept.
    until_worn: stop as well where a list is worn, in the middle of a record's steps if need be. Where it is not, `due`
        is `record_every`, a number of steps that is known to the compiler: on a GPU the host then need not ask after
        each step whether there is another, and a vmap need not choose between old and new after each.
    every_step: look at every step how far the balls have moved, see `until_balls_moved`.
    due: steps until the next record is due, zero for now. steps: taken before. fresh: the lists were just rebuilt, so
        that it goes on at least a little whatever they look like.
    limit: stop after so many records, at most as many as there are places. past_last: but take the steps to the next
        record still, and stop before it.
    """
    network, membrane = lists
    step, see = _stepping(scene, path, lists, dt, params, state)
    tightly = can_be_tight(network, params)

    def going(carry):
        now, *_ = carry
        on = path.going(now.watched, now.steps) | (now.due == 0)
        if records is not None:
            on &= (now.records < limit) | (past_last & (now.due > 0))
        return on & (at_start(now) & fresh | (now.due == 0) | ~now.worn) if until_worn else on

    def at_start(now):
        return now.steps == steps

    def further(carry):
        now, load, tight = carry
        state, taken = now.state, now.due

        def with_all(state, most):
            return until_balls_moved(lambda s: step(load, network, s), network, dt, most, state, every_step)

        if not until_worn:
            state = fixed_steps(partial(step, load), network, dt, tight, state, record_every)
            tight = tight_list(network, state, dt, record_every) if tightly else None
        elif tightly:
            worn = WORN * network.skin
            state, taken, tight = steps_until_worn(
                partial(step, load), network, dt, tight, state, now.due, record_every, STRIDE, worn, with_all
            )
        else:
            state, taken = with_all(state, now.due)
        load = current_load(membrane, network, state, fixed)
        found = observed(partial(see, load, space(network, membrane, state)), network, tight, state)
        due = now.due - taken
        recorded = due == 0
        seen = now.seen
        if records is not None:
            recorded &= now.records < limit
            place = jnp.where(recorded, now.records, records)  # beyond the end: not written
            seen = jax.tree.map(lambda values, value: values.at[place].set(value, mode="drop"), seen, found)
        steps = now.steps + taken
        watched = jax.tree.map(lambda old, new: jnp.where(due == 0, new, old), now.watched, path.watch(found, state))
        ahead = record_every
        if state.loading is not None:
            on = (due == 0) & path.going(watched, steps)
            loading, ahead = path.recorded(found, state, dt, record_every)
            state = state._replace(loading=jax.tree.map(partial(jnp.where, on), loading, state.loading))
        return Stretch(
            state=state,
            seen=seen,
            records=now.records + recorded,
            due=jnp.where(recorded, ahead, due),
            steps=steps,
            watched=watched,
            status=now.status | status_bits(network, membrane, state, load),
            worn=wear(network, state, load) > 1,
        ), load, tight

    load = current_load(membrane, network, state, fixed)
    tight = tight_list(network, state, dt, record_every) if tightly else None
    shape = jax.eval_shape(lambda: see(load, space(network, membrane, state), network, state))
    empty = None
    if records is not None:
        empty = jax.tree.map(lambda value: jnp.zeros((records, *value.shape), value.dtype), shape)
    unseen = jax.tree.map(lambda value: jnp.full(value.shape, jnp.inf, value.dtype), shape)
    nothing = jnp.zeros((), jnp.int32)
    begun = Stretch(
        state, empty, nothing, jnp.asarray(due, jnp.int32), jnp.asarray(steps, jnp.int32),
        path.watch(unseen, state), nothing, wear(network, state, load) > 1,
    )  # fmt: skip
    return jax.lax.while_loop(going, further, (begun, load, tight))[0]


def _stepping(scene: Scene, path: Path, lists: Lists, dt, params: Params, start: State):
    """A step of the stage, (load, network, state) -> state; and what is observed of a state, (load, room, network,
    state) -> observation. `network` is the contact list, or a tight one filtered from it."""
    warn_where_slow()
    network, membrane = lists
    scene, params = path.scene(scene), path.params(params, network, membrane, start.platens)
    one = make_step(scene, path.platen_speeds, None if start.loading is None else path.loading)

    def step(load: Load, network: ContactList, state: State) -> State:
        return one(params, network, load, dt, state)

    def see(load: Load, room: Space, network: ContactList, state: State) -> Observation:
        return observe(scene, params, network, membrane, load, dt, state, room)

    return step, see


def current_load(membrane: Membrane, network: ContactList, state: State, fixed: Load | None = None) -> Load:
    """The load of the membrane at the current positions, or the one that is given."""
    if fixed is not None:
        return fixed
    bottom, top = state.platens.astype(network.dtype)
    return membrane_load(membrane, positions(network, state), bottom, top)


def fixed_load(refresh: bool, given: Load | None, lists: Lists, start: State) -> Load | None:
    """The load that does not change during a stage: one that was given, or the membrane's first where it is not
    refreshed. None where the membrane's cells are followed."""
    if given is None and not refresh:
        network, membrane = lists
        return replace(current_load(membrane, network, start), stale=0.0)
    return given


def wear(network: ContactList, state: State, load: Load) -> jax.Array:
    """How far the lists have aged, contact list or membrane, as a share of where they need a rebuild."""
    return jnp.maximum(_list_wear(network, state), load.stale / (WORN_CELLS * STALE))


def _list_wear(network: ContactList, state: State) -> jax.Array:
    return closing(network, state.displacement) / (WORN * network.skin)


def until_balls_moved(
    step, network: ContactList, dt, most, state: State, every: bool = True
) -> tuple[State, jax.Array]:
    """A state after `most` steps, or fewer where the contact list is worn before; and how many it took, at least one.

    It looks once a stride. every: it looks at every step whether a ball flies so fast (a small one that the membrane
    drives into a pore) that the stride must end before the list is worn out; that costs 2 to 4 % of a step.
    """

    def going(carry):
        state, taken = carry
        return (taken < most) & ((taken == 0) | (_list_wear(network, state) <= 1))

    def stride(carry):
        state, taken = carry
        end = jnp.minimum(taken + STRIDE, most)
        if not every:
            return jax.lax.fori_loop(taken, end, lambda _, s: step(s), state), end

        def outlasts(carry):
            """Whether the list holds for this step and the next, of which the next may be faster."""
            state, steps = carry
            soon = closing(network, state.displacement + state.velocity * (2 * dt)) <= network.skin
            return (steps < end) & ((steps == taken) | soon)

        return jax.lax.while_loop(outlasts, lambda carry: (step(carry[0]), carry[1] + 1), carry)

    return jax.lax.while_loop(going, stride, (state, jnp.zeros((), jnp.int32)))


def status_bits(network: ContactList, membrane: Membrane, state: State, load: Load) -> jax.Array:
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
