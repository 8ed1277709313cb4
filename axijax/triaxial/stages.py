"""The stages of a test, confinement and what follows, as functions of what is prepared and of the parameters."""

import jax
import jax.numpy as jnp

from axijax.core.gather import linear
from axijax.core.quantity import senseless
from axijax.core.status import NOT_CONFINED, SENSELESS, UNFINISHED, UNFOLLOWED
from axijax.mechanics.contact_list import closing
from axijax.mechanics.contact_search import rebuild_in_jit
from axijax.mechanics.dynamics import Scene, all_forces, initial_state
from axijax.mechanics.membrane import Load
from axijax.mechanics.membrane_surface import straightened
from axijax.mechanics.params import Params
from axijax.mechanics.rebuild import rebuild_on_host
from axijax.mechanics.state import Loading, State
from axijax.specimen.specimen import Specimen
from axijax.triaxial.engine import Lists, Stretch, current_load, fixed_load, march, march_stage, march_until
from axijax.triaxial.paths import Isotropic, Path
from axijax.triaxial.prepare import Prepared
from axijax.triaxial.records import Confinement, Curve, make_curve

CONFINE_EVERY = 50  # steps between looks at the balance, and between refreshes of the membrane, in confinement


def _ended(stretch: Stretch) -> tuple[State, Confinement]:
    balance = stretch.watched
    return stretch.state, Confinement(balance.unbalanced_force, balance.stress_error, stretch.steps)


def confine(prepared: Prepared, params: Params) -> tuple[State, Confinement]:
    """Confinement with one contact list throughout; pure."""
    path, lists = prepared.confinement, prepared.lists
    start = _at_rest(prepared.scene, path, lists, params, prepared.platens)
    return _ended(
        march_until(
            prepared.scene, None, CONFINE_EVERY, False, False, path, lists, prepared.time_step, params, start,
            prepared.lateral_load, CONFINE_EVERY, 0, True,
        )
    )  # fmt: skip


def _confine_rebuilding(prepared: Prepared, params: Params) -> tuple[Lists, State, Confinement]:
    """Confinement with its lists rebuilt inside jit where they are worn, as `settle` does on the host; pure."""
    path, scene, dt = prepared.confinement, prepared.scene, prepared.time_step

    def stretch(lists: Lists, state: State, steps) -> tuple[Lists, Stretch]:
        size = None, CONFINE_EVERY, True, True
        load = prepared.lateral_load
        return lists, march_until(scene, *size, path, lists, dt, params, state, load, CONFINE_EVERY, steps, True)

    def going(carry):
        _, reached = carry
        return path.going(reached.watched, reached.steps)

    def further(carry):
        lists, reached = carry
        *lists, state = rebuild_in_jit(*lists, reached.state)
        return stretch(tuple(lists), state, reached.steps)

    start = _at_rest(scene, path, prepared.lists, params, prepared.platens)
    lists, reached = jax.lax.while_loop(going, further, stretch(prepared.lists, start, 0))
    return lists, *_ended(reached)


def settle(
    scene: Scene,
    path: Isotropic,
    cut: Specimen,
    lists: Lists,
    dt,
    params: Params,
    fixed: Load | None = None,
    start: State | None = None,
) -> tuple[Lists, State, Confinement]:
    """Confinement, from rest or a state of these lists, with the lists rebuilt where they are worn (host loop).

    Returns the last lists, the state and its balance, which may be outside the tolerance after path.most_steps. Raises
    RuntimeError where a ball moves too fast for the lists.
    """
    state, steps = start, 0
    if state is None:
        state = _at_rest(scene, path, lists, params, jnp.asarray([cut.bottom, cut.top]))
    while True:
        reached = march_until(
            scene, None, CONFINE_EVERY, True, True, path, lists, dt, params, state, fixed, CONFINE_EVERY, steps, True
        )
        state, balance = _ended(reached)
        network, _ = lists
        if float(closing(network, state.displacement)) > float(network.skin):
            stiffness, _ = params.material.confined_stiffness(network, params.confining_stress)
            softness = float(params.confining_stress * network.radius.mean() / stiffness)
            raise RuntimeError(
                "confinement: two balls together moved by more than the skin of the contact list within a step or two, "
                f"so a contact may be missing (softness s3 r/kn = {softness:.2g}): lower confining_stress, or raise "
                "the stiffness of the balls."
            )
        if not path.going(reached.watched, reached.steps):
            return lists, state, balance
        lists, state = rebuild_on_host(cut, lists, state)
        steps = int(balance.steps)


def _at_rest(scene: Scene, path: Isotropic, lists: Lists, params: Params, platens) -> State:
    return initial_state(path.scene(scene), path.params(params, *lists, platens), lists[0], platens)


def start_shear(scene: Scene, params: Params, lists: Lists, confined: State) -> State:
    """The test's friction on, balls and platens from rest; the terms' memory of a confinement is kept where it had the
    same, as springs of a frictional one, or else starts from nothing."""
    rest = initial_state(scene, params, lists[0], confined.platens)
    memory = tuple(
        kept if jax.tree.structure(kept) == jax.tree.structure(new) else new  # type: ignore[operator]
        for kept, new in zip(confined.memory, rest.memory, strict=True)
    )
    return rest._replace(displacement=confined.displacement, memory=memory)


def start_loading(params: Params, state: State) -> State:
    """The state at the end of confinement with what the paths of a test in stages remember."""
    zero = jnp.zeros(())
    stress = jnp.asarray(params.confining_stress, jnp.result_type(float))
    height = state.platens[1] - state.platens[0]
    return state._replace(loading=Loading(stress, zero, zero, zero, zero, height, jnp.zeros((), jnp.int32)))


def start_stage(scene: Scene, path: Path, lists: Lists, dt, params: Params, state: State, fixed: Load | None) -> State:
    """A state at the start of a stage: its clock at zero, and its path's memory in place of the last one's."""
    network, membrane = lists
    assert state.loading is not None
    loading = state.loading._replace(stage=state.loading.stage + 1, memory=None)
    state = state._replace(time=jnp.zeros_like(state.time), loading=loading)
    load = current_load(membrane, network, state, fixed)
    push = all_forces(scene, params, network, load, dt, state).platen_forces(network)
    push = straightened(state.lateral_stress(params), load, push)
    return state._replace(loading=path.begin(params, network, load, state, push))


def _march_stages(prepared: Prepared, lists: Lists, params: Params, state: State, fixed: Load | None):
    """All stages, one after the other, up to one that could not be followed: observations and status bits (T,)."""
    numerics, kept, over = prepared.numerics, [], jnp.zeros((), bool)
    state = start_loading(params, state)
    for path, records in zip(prepared.stages, numerics.stage_records, strict=True):
        state = start_stage(prepared.scene, path, lists, prepared.time_step, params, state, fixed)
        size = records, numerics.record_every, numerics.rebuild_every
        (lists, state), seen, status, watched = march_stage(
            prepared.scene, path, *size, lists, prepared.time_step, params, state, fixed, ~over
        )
        last = jax.tree.map(lambda values: values[-1], watched)
        status = status.at[-1].set(
            status[-1]
            | jnp.where(~over & path.going(last, records * numerics.record_every), UNFINISHED, 0)
            | jnp.where(~over & path.failed(last), UNFOLLOWED, 0)
        )
        over |= path.failed(last)
        kept.append((seen, status))
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *kept)


def _end_of_reverse_mode(tree):
    """The same tree, through whose numbers no derivative passes backwards: confinement takes as many steps as it needs.

    The friction of the shear is no matter of confinement, and forward mode passes it.
    """
    # One by one, so that what has no tangent is not given one of zeros.
    return jax.tree.map(lambda leaf: linear(_same, _refuse, (), [leaf])[0], tree)


def _same(_, values):
    return values


def _refuse(_, cotangents):
    raise ValueError(
        "reverse mode (jax.grad, jax.vjp) ends at confinement, which takes as many steps as it needs: it is for what "
        "confinement does not depend on, as friction; for a stiffness, the density, the damping or the confining "
        "stress take jax.jvp or jax.jacfwd."
    )


@jax.jit
def simulate(prepared: Prepared, params: Params) -> Curve:
    """The curve of a test, a pure function of its lists and parameters: confinement and shear.

    One contact list serves it all; with `rebuild_every` lists are rebuilt inside jit. Tests of one shape share the
    compiled program.
    """
    numerics, lists, dt = prepared.numerics, prepared.lists, prepared.time_step
    if numerics.rebuild_every:
        lists, confined, balance = _confine_rebuilding(prepared, params)
    else:
        confined, balance = confine(prepared, params)
    lists, confined = _end_of_reverse_mode((lists, confined))
    start = start_shear(prepared.scene, params, lists, confined)
    fixed = fixed_load(numerics.refresh, prepared.lateral_load, lists, start)
    if prepared.stages:
        seen, status = _march_stages(prepared, lists, params, start, fixed)
    else:
        size = numerics.records, numerics.record_every, numerics.rebuild_every
        _, seen, status = march(prepared.scene, prepared.shear, *size, lists, dt, params, start, fixed)
    settled = balance.worst <= prepared.confinement.tolerance
    status = jnp.bitwise_or.reduce(status) | jnp.where(settled, 0, NOT_CONFINED)
    status |= jnp.where(senseless(params), SENSELESS, 0)
    return make_curve(seen, balance, status)
