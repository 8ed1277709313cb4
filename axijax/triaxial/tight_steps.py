"""Steps that see a tight list (`axijax.mechanics.tight_list`) in place of the contact list, and what is observed by it.

The results are those of the contact list to rounding: where a tight list had no room, or a ball moved by more than
it was allowed, the steps are taken again with the contact list. Used where the list has room for it and no term acts
between balls that do not touch.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from axijax.core.together import all_of_batch
from axijax.mechanics.contact_list import ContactList, closing
from axijax.mechanics.dynamics import terms_of
from axijax.mechanics.params import Params
from axijax.mechanics.state import State
from axijax.mechanics.tight_list import STEPS, Tight, allowances, tighten

Step = Callable[[ContactList, State], State]


def can_be_tight(network: ContactList, params: Params) -> bool:
    """Whether steps may see a tight list."""
    return network.tight is not None and not any(term.acts_apart for term in terms_of(params))


def tight_list(network: ContactList, state: State, dt, steps: int) -> Tight:
    """The pairs that can touch during so many steps, of which STEPS are the most, or that are likely to."""
    return tighten(network, state.displacement, allowances(network, state.velocity, dt, min(steps, STEPS)))


def observed(see: Callable[[ContactList, State], Any], network: ContactList, tight: Tight | None, state: State) -> Any:
    """What is seen of a state with a tight list, or with the contact list where there is none or it does not hold."""
    if tight is None:
        return see(network, state)
    inside = state._replace(memory=tight.memory_in(state.memory))
    holds = tight.holds(tight.moved(state.displacement))
    return jax.lax.cond(all_of_batch(holds), lambda: see(tight.network, inside), lambda: see(network, state))


def fixed_steps(step: Step, network: ContactList, dt, tight: Tight | None, state: State, steps: int) -> State:
    """A state so many steps later, for jvp, vmap and reverse mode. tight: made for the state, or None for none."""
    if tight is None:
        return _with_all(step, network, state, steps)
    number = -(-steps // STEPS)
    if number == 1:
        return _block(step, network, tight, state, steps)

    def block(state, size):
        return _block(step, network, tight_list(network, state, dt, size), state, size)

    size, rest = divmod(steps, number)
    state, _ = jax.lax.scan(lambda state, _: (block(state, size), None), state, None, length=number)
    return block(state, rest) if rest else state


def _block(step: Step, network: ContactList, tight: Tight, state: State, steps: int) -> State:
    inside = state._replace(memory=tight.memory_in(state.memory))

    def further(carry, _):
        state, farthest = carry
        farthest = jnp.maximum(farthest, tight.moved(state.displacement))
        return (step(tight.network, state), farthest), None

    (after, farthest), _ = jax.lax.scan(further, (inside, jnp.zeros_like(tight.allowed)), None, length=steps)
    after = after._replace(memory=tight.memory_out(after.memory, state.memory))

    good = tight.holds(farthest)

    def mended():
        return jax.tree.map(partial(jnp.where, good), after, _with_all(step, network, state, steps))

    return jax.lax.cond(all_of_batch(good), lambda: after, mended)


def _with_all(step: Step, network: ContactList, state: State, steps: int) -> State:
    return jax.lax.scan(lambda state, _: (step(network, state), None), state, None, length=steps)[0]


def steps_until_worn(
    step: Step,
    network: ContactList,
    dt,
    tight: Tight,
    state: State,
    most,
    ahead: int,
    stride: int,
    worn: jax.Array | None,
    with_all: Callable[[State, jax.Array], tuple[State, jax.Array]],
) -> tuple[State, jax.Array, Tight]:
    """A state after `most` steps, or fewer where the contact list is worn before; how many it took; its tight list.

    tight: of this contact list; it is filtered again at the start, and where it will not last. ahead: steps for which,
    see `tight_list`. worn: two balls having come closer by more it ends, None for never [L]; stride: steps between
    looks. with_all: takes so many steps, or fewer where the list is worn, with the contact list.
    """

    def going(carry):
        state, taken, _ = carry
        return (taken < most) & ((taken == 0) | _lasting(network, state, worn))

    def further(carry):
        state, taken, tight = carry
        size = jnp.minimum(STEPS, most - taken)
        tight = _filtered_again(network, tight, state, dt, size, ahead)
        after, number, farthest = _until_worn(
            lambda state: step(tight.network, state), network, tight,
            state._replace(memory=tight.memory_in(state.memory)), jnp.where(tight.fits, size, 0), stride, worn,
        )  # fmt: skip
        good = tight.holds(farthest)
        after = after._replace(memory=tight.memory_out(after.memory, state.memory))
        state = jax.tree.map(lambda new, old: jnp.where(good, new, old), after, state)
        state, more = with_all(state, jnp.where(good, 0, size))
        return state, taken + jnp.where(good, number, more), tight

    # Never one from before the last record: a run that goes on from there must see the same list, to the last bit of
    # what is summed up over its contacts.
    tight = tight._replace(fits=jnp.zeros_like(tight.fits))
    return jax.lax.while_loop(going, further, (state, jnp.zeros((), jnp.int32), tight))


def _filtered_again(network: ContactList, tight: Tight, state: State, dt, steps, ahead: int) -> Tight:
    """The tight list where it is likely to last for so many steps, or a new one."""
    lasts = tight.lasts(state.displacement, state.velocity, dt, steps)
    # A loop of one turn or none: a branch would copy the list that is kept.
    new = lambda _: (tight_list(network, state, dt, ahead), jnp.ones((), bool))  # noqa: E731
    return jax.lax.while_loop(lambda carry: ~carry[1], new, (tight, lasts))[0]


def _lasting(network: ContactList, state: State, worn) -> jax.Array | bool:
    return True if worn is None else closing(network, state.displacement) <= worn


def _until_worn(step, network: ContactList, tight: Tight, state: State, most, stride: Any, worn):
    """As `steps_until_worn` with one tight list; and how far each ball was from where it was made, (N,) [L^2]."""
    # As long as the tight list holds the contact list is not worn, if it would not be at the worst.
    stride = most if worn is None else jnp.where(tight.closed <= worn, most, stride)

    def going(carry):
        state, taken, _ = carry
        return (taken < most) & ((taken == 0) | _lasting(network, state, worn))

    def further(carry):
        state, taken, farthest = carry
        end = jnp.minimum(taken + stride, most)

        def one(_, carry):
            state, farthest = carry
            return step(state), jnp.maximum(farthest, tight.moved(state.displacement))

        state, farthest = jax.lax.fori_loop(taken, end, one, (state, farthest))
        return state, end, farthest

    return jax.lax.while_loop(going, further, (state, jnp.zeros((), jnp.int32), jnp.zeros_like(tight.allowed)))
