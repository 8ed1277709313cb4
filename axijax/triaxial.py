"""The triaxial test of Cui & O'Sullivan (2005), section 4.2: confine, switch friction on, shear, record.

1. Confine: no friction, membrane and both platens at s3, until the unbalanced force and the stress error are small.
2. Shear: friction on, both platens move inward at the platen speed (reached by a smooth ramp: a sudden start sends
   a wave of rho c v through the specimen), the membrane's cells are refreshed with every record.

`TriaxialTest` prepares a test on the host; its `simulate` is a pure function Params -> Curve for jit, vmap and jvp;
its `run` adds checks and a sentence for whatever went wrong.
"""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.confinement import (
    STALE,
    Confinement,
    Limits,
    confine,
    confining_scene,
    current_load,
    farthest,
    rebuilt,
    repeat,
    roomy_lists,
    settle,
    unconfined,
    wave_speed,
    wear,
)
from axijax.dynamics import (
    Params,
    Scene,
    State,
    check_params,
    initial_state,
    make_step,
    positions,
)
from axijax.membrane import Load, Membrane, build_membrane, membrane_radius
from axijax.neighbors import Network, build_network
from axijax.observe import Observation, observe
from axijax.packing import Specimen, cut_to_sector
from axijax.platform import warn_where_batched
from axijax.sector import Sector, radial_distance
from axijax.time_step import DEFAULT_STEP, check_step, critical_time_step
from axijax.update import FULL_LIST, Grid, grid_for, renew

SEGMENT = 1000  # steps between looks at the run from outside: progress, rebuilding, errors
CHATTER = 1e-3  # `observe.chatter` of a sound run is below zero; above this, contacts chatter
CHECKPOINT_SECONDS = 60.0  # between checkpoints, where they are asked for

# Bits of the status code that a run carries; `raise_for_status` turns them into sentences.
NOT_FINITE, NOT_CONFINED, STALE_LIST, STALE_CELLS, ESCAPED, UNSTABLE = 1, 2, 4, 8, 16, 32

REMEDIES = {
    NOT_FINITE: "a position is no longer finite: the run is unstable; lower time_step or check the parameters",
    NOT_CONFINED: "confinement did not reach the stated equilibrium; raise confine_steps or the tolerance",
    STALE_LIST: (
        "a ball moved more than half the skin of the contact list before it was rebuilt, so a contact may have been "
        "missed; stop at a smaller axial_strain (past its peak a specimen may collapse), and beyond 2 % use `run`, "
        "which rebuilds the list, or a smaller rebuild_every for `simulate`, which keeps it if that is zero"
    ),
    STALE_CELLS: (
        "the membrane's balls have moved past one another since it was triangulated; stop at a smaller axial_strain, "
        "and beyond 2 % use `run`, which triangulates again, or a smaller rebuild_every for `simulate`"
    ),
    FULL_LIST: (
        "a ball has more neighbours, or the membrane more balls, than a list that is made anew inside `simulate` has "
        "room for; use `run`, which makes room, or stop at a smaller axial_strain"
    ),
    ESCAPED: "a ball has left the membrane or passed a platen; lower time_step or stop at a smaller axial_strain",
    UNSTABLE: (
        "contacts chatter from step to step at the peak of the stress ratio, which is then wrong: the time step is too "
        "long for these parameters; lower time_step"
    ),
}


class SimulationError(RuntimeError):
    """A run that went wrong; says what happened and what to do. `curve` holds what was computed."""

    def __init__(self, message: str, curve: "Curve | None"):
        super().__init__(message)
        self.curve = curve


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Curve:
    """The record of a test: fields of T values, compression positive. Stress ratios as in `observe.Observation`.

    axial_strain: shortening over the height at the end of confinement [-].
    volumetric_strain: loss of volume pi Rm^2 H over its value at the end of confinement [-].
    confinement: what was observed at the end of confinement; stress_error there is |s1 - s3| / s3.
    status: bits, zero for a sound run (see `raise_for_status`).
    """

    axial_strain: jax.Array
    stress_ratio: jax.Array
    virial_ratio: jax.Array
    core_ratio: jax.Array
    volumetric_strain: jax.Array
    coordination_number: jax.Array
    unbalanced_force: jax.Array
    sliding_fraction: jax.Array
    chatter: jax.Array
    membrane_radius: jax.Array
    confinement: Confinement
    status: jax.Array


# The fields of a curve that hold one value a record.
RECORDS = tuple(f.name for f in fields(Curve) if f.name not in ("confinement", "status"))


@dataclass(frozen=True)
class Protocol:
    """The numbers of a test that are not physics; static.

    blocks, block_steps: the shear runs blocks * block_steps steps and records after each block.
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


@dataclass(frozen=True)
class TriaxialTest:
    """A triaxial test of a specimen's sector, ready to run.

    specimen: the full cylinder; the sector is cut from it.
    sector: order n and boundary, by default the paper's quarter between periodic planes.
    scene: what is modelled.
    params: reference parameters; the time step and the ramp are chosen for these.
    axial_strain: where the test stops, as a share of the confined height [-].
    time_step: length of a step [T]; left out, 0.6 of the critical one; more than 0.8 of it is refused.
    record_every: steps between records [-].
    refresh: whether the membrane's cells are found again with every record.
    confine_steps: most steps spent on confinement [-].
    tolerance: unbalanced force and stress error at which confinement ends [-].
    rebuild_every: records between which `simulate` makes contact list and membrane anew during shear, for large strain
        and for batches; zero keeps the first. `run` looks when they are worn instead.
    confining_friction: friction coefficient during confinement [-]; zero, the paper's, lets a packing become as dense
        as it can. A random specimen keeps its density under the friction with which it was compacted.
    lateral_load: a constant load in place of the membrane's (see `membrane.Load`).
    dtype: np.float64, or np.float32 (see the README's sharp bits).
    allow_unsafe_step: accept any time step, to study what it does to a result.

    Raises ValueError for parameters, specimens and steps that make no sense.
    """

    specimen: Specimen
    sector: Sector = field(default_factory=Sector)
    scene: Scene = field(default_factory=Scene)
    params: Params = field(default_factory=Params)
    axial_strain: float = 0.01
    time_step: float | None = None
    record_every: int = 50
    refresh: bool = True
    confine_steps: int = 20_000
    tolerance: float = 1e-7
    rebuild_every: int = 0
    confining_friction: float = 0.0
    lateral_load: Load | None = None
    dtype: type = np.float64
    allow_unsafe_step: bool = False
    network: Network = field(init=False, repr=False)
    membrane: Membrane = field(init=False, repr=False)
    cut: Specimen = field(init=False, repr=False)
    ramp_time: float = field(init=False)
    protocol: Protocol = field(init=False)

    def __post_init__(self) -> None:
        cut = cut_to_sector(self.specimen, self.sector)
        check_params(self.params, len(cut))
        if not (np.isfinite(self.axial_strain) and 0 < self.axial_strain < 0.5):
            raise ValueError(f"axial_strain = {self.axial_strain!r}: must lie between 0 and 0.5.")
        if not float(self.params.platen_speed) > 0:
            raise ValueError(f"platen_speed = {self.params.platen_speed!r}: must be positive, inward.")
        if isinstance(self.record_every, bool) or not isinstance(self.record_every, int) or self.record_every < 1:
            raise ValueError(f"record_every = {self.record_every!r}: must be a whole number of steps >= 1.")
        if isinstance(self.rebuild_every, bool) or not isinstance(self.rebuild_every, int) or self.rebuild_every < 0:
            raise ValueError(
                f"rebuild_every = {self.rebuild_every!r}: must be a whole number of records, or zero to keep the lists."
            )
        if not self.confine_steps >= 1:
            raise ValueError(f"confine_steps = {self.confine_steps!r}: must be at least 1 step.")
        if not (np.isfinite(self.tolerance) and self.tolerance > 0):
            raise ValueError(f"tolerance = {self.tolerance!r}: must be positive and finite [-].")
        if not (np.isfinite(self.confining_friction) and self.confining_friction >= 0):
            raise ValueError(f"confining_friction = {self.confining_friction!r}: must be zero or positive [-].")
        if cut.zone_rule == "exposure" or self.rebuild_every:
            network, membrane = roomy_lists(cut, self.sector, self.dtype)
        else:
            network = build_network(cut, self.sector, dtype=self.dtype)
            membrane = build_membrane(cut, self.sector, dtype=self.dtype)
        limit = critical_time_step(self.scene, self.params, network)
        step = DEFAULT_STEP * limit if self.time_step is None else self.time_step
        if not (np.isfinite(step) and step > 0):
            raise ValueError(f"time_step = {step!r}: must be positive and finite [T].")
        if not self.allow_unsafe_step:
            check_step(step, limit)
        ramp = 8 * cut.height / wave_speed(self.scene, self.params, network)
        speed = 2 * float(self.params.platen_speed)
        duration = self.axial_strain * cut.height / speed + ramp / 2
        prepared = {
            "cut": cut,
            "network": network,
            "membrane": membrane,
            "time_step": float(step),
            "ramp_time": float(ramp),
            "protocol": Protocol(
                blocks=int(np.ceil(duration / step / self.record_every)) + 1,  # a record at the start and at the end
                block_steps=self.record_every,
                refresh=self.refresh,
                limits=Limits(float(self.confining_friction), self.tolerance, self.confine_steps),
                rebuild_every=self.rebuild_every,
                grid=grid_for(network) if self.rebuild_every else None,
            ),
        }
        for name, value in prepared.items():
            object.__setattr__(self, name, value)

    def simulate(self, params: Params) -> Curve:
        """The whole test as a pure function of its parameters, for jax.jit, jax.vmap and jax.jvp.

        For many parameter sets see `axijax.batch.simulate_many`: on a CPU, vmap over parameters is slow, and warned of.
        One contact list serves the whole test, which is right up to about 2 % strain, unless `rebuild_every` asks for
        more. Look at `status` of what comes back, or call `raise_for_status`.
        """
        params = warn_where_batched(params)
        return _simulate(self.scene, self.protocol, self._numbers(self.network, self.membrane), params)

    def confine(self, params: Params | None = None) -> tuple[State, Confinement]:
        """The state at the end of confinement, and how well it is balanced."""
        numbers = self._numbers(self.network, self.membrane)
        return _confined(self.scene, self.protocol, numbers, self.params if params is None else params)

    def run(
        self,
        params: Params | None = None,
        progress: "Callable[[Progress], None] | None" = None,
        start: "Progress | None" = None,
        checkpoint: Path | None = None,
    ) -> "Run":
        """Run the test to its axial strain and return curve and final state; lists are rebuilt where needed.

        progress: called with where the test stands: once before the first step of the shear, then about every 1000.
        start: go on from here, see `axijax.checkpoint.load_progress`, instead of confining; its parameters are used.
        checkpoint: file to which the progress is written now and then, at the end and at an interruption (Ctrl-C).

        Raises ValueError for bad parameters, and SimulationError with the remedy for a run that went wrong.
        """
        from axijax.checkpoint import save_progress

        if start is not None and params is not None:
            raise ValueError("params: must be left out where a start is given, which brings its own.")
        now = self._begin(self.params if params is None else params) if start is None else start
        if checkpoint is not None:
            save_progress(checkpoint, self, now)
        written = time.monotonic()
        try:
            if progress is not None:
                progress(now)
            while now.strain < self.axial_strain:
                now = self._go_on(now)
                if progress is not None:
                    progress(now)
                if checkpoint is not None and time.monotonic() - written > CHECKPOINT_SECONDS:
                    save_progress(checkpoint, self, now)
                    written = time.monotonic()
        finally:
            # Whole segments only: after a failure or an interruption this is the last sound state.
            if checkpoint is not None:
                save_progress(checkpoint, self, now)
        curve = curve_of(now, self.axial_strain)
        raise_for_status(curve.status, curve)
        _warn_of_chatter(curve)
        return Run(curve, now.network, now.membrane, now.state)

    def _begin(self, params: Params) -> "Progress":
        """Confined, and nothing sheared yet."""
        check_params(params, len(self.cut))
        if params is not self.params and not self.allow_unsafe_step:
            check_step(self.time_step, critical_time_step(self.scene, params, self.network))
        limits = self.protocol.limits
        scene = confining_scene(self.scene, limits)
        network, membrane, confined, balance = settle(
            scene, self.cut, self.network, self.membrane, params, self.time_step, limits, self.lateral_load
        )  # fmt: skip
        if not float(balance.worst) <= self.tolerance:
            raise_for_status(NOT_CONFINED)
        state = _start_shear(self.scene, network, confined)
        fixed = _fixed_load(self.protocol, self._numbers(network, membrane), state)
        height = float(state.platens[1] - state.platens[0])
        return Progress(params, network, membrane, state, fixed, balance, height, no_records())

    def _go_on(self, now: "Progress") -> "Progress":
        """About 1000 steps further, or until a list is worn; lists that are worn are made anew first."""
        network, membrane, state = now.network, now.membrane, now.state
        swelling = now.swelling
        if float(wear(network, membrane, state).max()) > 1:
            radius_before = _radius_now(network, membrane, state)
            network, membrane, state = rebuilt(self.cut, network, membrane, state)
            if self.cut.zone_rule == "exposure":
                swelling *= radius_before / _radius_now(network, membrane, state)
        stretch = replace(self.protocol, blocks=-(-SEGMENT // self.record_every))
        numbers = self._numbers(network, membrane)
        state, seen, status, blocks = _shear_until_worn(self.scene, stretch, numbers, now.params, state, now.fixed)
        seen = jax.tree.map(lambda values: np.asarray(values)[: int(blocks)], seen)
        seen = seen._replace(membrane_radius=seen.membrane_radius * swelling)
        records = jax.tree.map(np.append, now.records, seen)
        if int(status):
            raise_for_status(status, make_curve(records, now.confinement))
        return now._replace(network=network, membrane=membrane, state=state, records=records, swelling=swelling)

    def _numbers(self, network: Network, membrane: Membrane):
        platens = jnp.asarray([self.cut.bottom, self.cut.top])
        return network, membrane, platens, self.time_step, self.ramp_time, self.lateral_load


class Progress(NamedTuple):
    """A shear in progress: all that `TriaxialTest.run` needs to go on.

    fixed: the lateral load where it does not follow the membrane's cells.
    height: distance of the platens at the end of confinement [L].
    records: what was observed so far, T values each.
    swelling: by which Rm is multiplied in the records of a zone found by exposure, so that balls that join or leave the
        zone are no change of volume; what is left is the work of the membrane over s3 [-].
    """

    params: Params
    network: Network
    membrane: Membrane
    state: State
    fixed: Load | None
    confinement: Confinement
    height: float
    records: Observation
    swelling: float = 1.0

    @property
    def strain(self) -> float:
        """Axial strain reached [-]."""
        return 1 - float(self.state.platens[1] - self.state.platens[0]) / self.height

    @property
    def stress_ratio(self) -> float:
        """Stress ratio at the last record, 1 before the first [-]."""
        return float(self.records.stress_ratio[-1]) if self.records.stress_ratio.size else 1.0

    @property
    def unbalanced_force(self) -> float:
        """Mean resultant over mean contact force at the last record, or at the end of confinement [-]."""
        last = self.records.unbalanced_force
        return float(last[-1] if last.size else self.confinement.unbalanced_force)


def curve_of(progress: Progress, axial_strain: float) -> "Curve":
    """The curve of what a shear has recorded up to this axial strain."""
    wanted = 1 - progress.records.height / progress.height <= axial_strain
    return make_curve(jax.tree.map(lambda values: values[wanted], progress.records), progress.confinement)


class Run(NamedTuple):
    """What a run leaves: its curve, and the last contact list, membrane and state."""

    curve: Curve
    network: Network
    membrane: Membrane
    state: State

    @property
    def positions(self) -> np.ndarray:
        """Ball centres at the end, (3, N) [L]; ball i is ball i of the test's `cut` throughout."""
        return np.asarray(positions(self.network, self.state))


def _radius_now(network: Network, membrane: Membrane, state: State) -> float:
    return float(jax.jit(membrane_radius)(membrane, positions(network, state)))


def raise_for_status(status, curve: Curve | None = None) -> None:
    """Raise SimulationError, naming what went wrong and what to do, unless a curve's status bits are all zero."""
    bits = int(np.bitwise_or.reduce(np.asarray(status).ravel()))
    if bits & NOT_FINITE:  # of which all others are consequences
        bits = NOT_FINITE
    if bits:
        reasons = [text for bit, text in REMEDIES.items() if bits & bit]
        raise SimulationError("the test went wrong: " + "; ".join(reasons) + ".", curve)


def no_records() -> Observation:
    """An observation of no moment at all."""
    empty: Any = np.zeros(0)
    return Observation(*[empty] * len(Observation._fields))


def _warn_of_chatter(curve: Curve) -> None:
    """Warn of chatter that has died out by the peak: the peak is right, the curve before it is not."""
    strain = curve.axial_strain[curve.chatter > CHATTER]
    if strain.size:
        warnings.warn(
            f"contacts chattered between {100 * strain.min():.3g} and {100 * strain.max():.3g} % axial strain, though "
            "not at the peak: the curve is inexact there; lower time_step.",
            stacklevel=3,
        )


def _ramp(ramp_time):
    """Platens moved inward at the platen speed, which is reached smoothly after ramp_time."""

    def drive(params, state, dt, push, section):
        x = jnp.clip((state.time + dt) / ramp_time, 0.0, 1.0).astype(push.dtype)
        return jnp.array([1.0, -1.0], push.dtype) * params.platen_speed * x * x * (3 - 2 * x)

    return drive


def _fixed_load(protocol: Protocol, numbers, start: State) -> Load | None:
    """The load that does not change during shear: one that was given, or the membrane's first where it is not
    refreshed. None where the membrane's cells are followed."""
    network, membrane, *_, given = numbers
    if given is None and not protocol.refresh:
        return current_load(membrane, network, start)
    return given


@partial(jax.jit, static_argnums=(0, 1))
def _shear(scene: Scene, protocol: Protocol, numbers, params: Params, state: State, fixed: Load | None):
    """Shear on from a state: the state after all blocks, with the observation and the status before each block.

    fixed: the lateral load where it does not follow the membrane's cells.
    """
    if protocol.rebuild_every:
        return _shear_rebuilding(scene, protocol, numbers, params, state, fixed)
    # Reverse mode keeps the state before each block and runs the block again on the way back.
    block = jax.checkpoint(_shear_block(scene, protocol, numbers, params, fixed), prevent_cse=False)
    state, (seen, status) = jax.lax.scan(block, state, None, length=protocol.blocks)
    return state, seen, status


def _shear_rebuilding(scene: Scene, protocol: Protocol, numbers, params: Params, state: State, fixed: Load | None):
    """As `_shear`, with contact list and membrane made anew each time after protocol.rebuild_every blocks."""
    network, membrane, *others = numbers
    stretch = replace(protocol, blocks=protocol.rebuild_every, rebuild_every=0)

    def further(carry, _):
        network, membrane, state = carry
        state, seen, status = _shear(scene, stretch, (network, membrane, *others), params, state, fixed)
        network, membrane, state, bits = renew(protocol.grid, network, membrane, state)
        return (network, membrane, state), (seen, status | bits)

    start = network, membrane, state
    stretches = -(-protocol.blocks // protocol.rebuild_every)
    (_, _, state), (seen, status) = jax.lax.scan(further, start, None, length=stretches)
    seen, status = jax.tree.map(lambda values: values.reshape(-1, *values.shape[2:])[: protocol.blocks], (seen, status))
    return state, seen, status


@partial(jax.jit, static_argnums=(0, 1))
def _shear_until_worn(scene: Scene, protocol: Protocol, numbers, params: Params, state: State, fixed: Load | None):
    """As `_shear`, but stops where a list is worn: a free ball may fly through half the skin within one stretch.

    Returns the number of blocks as well; what was observed fills so many places of arrays of protocol.blocks. The
    status is that of these blocks together.
    """
    network, membrane, *_ = numbers
    block = _shear_block(scene, protocol, numbers, params, fixed)
    empty = jax.eval_shape(block, state, None)[1][0]
    records = jax.tree.map(lambda value: jnp.zeros((protocol.blocks, *value.shape), value.dtype), empty)

    def going(carry):
        state, _, _, number = carry
        return (number < protocol.blocks) & ((number == 0) | (wear(network, membrane, state).max() <= 1))

    def further(carry):
        state, records, bits, number = carry
        state, (seen, status) = block(state, None)
        records = jax.tree.map(lambda values, value: values.at[number].set(value), records, seen)
        return state, records, bits | status, number + 1

    nothing = jnp.zeros((), jnp.int32)
    state, records, bits, number = jax.lax.while_loop(going, further, (state, records, nothing, nothing))
    return state, records, bits, number


def _shear_block(scene: Scene, protocol: Protocol, numbers, params: Params, fixed: Load | None):
    """A function of a state that observes it, and takes it one block of steps further; a scan's body."""
    network, membrane, _, dt, ramp_time, _ = numbers
    step = make_step(scene, _ramp(ramp_time))

    def block(state, _):
        load = current_load(membrane, network, state, fixed)
        seen = observe(scene, params, network, membrane, load, dt, state)
        status = _trouble(network, membrane, state, load)
        state = repeat(lambda s: step(params, network, load, dt, s), protocol.block_steps, state)
        return state, (seen, status)

    return block


def _trouble(network: Network, membrane: Membrane, state: State, load: Load) -> jax.Array:
    """Status bits of one state."""
    place = positions(network, state)
    rho = radial_distance(place)
    zone = membrane.share > 0
    mean_rho = jnp.where(zone, rho[membrane.zone], 0.0).sum() / zone.sum()
    finite = jnp.stack([jnp.isfinite(part).all() for part in (*state.displacement, *state.velocity)]).all()
    bits = jnp.where(finite, 0, NOT_FINITE)
    bits |= jnp.where(2 * farthest(state) > network.skin, STALE_LIST, 0)
    bits |= jnp.where(load.stale > STALE, STALE_CELLS, 0)
    inside = (place.z > state.platens[0]) & (place.z < state.platens[1]) & (rho < 1.5 * mean_rho)
    return bits | jnp.where(inside.all(), 0, ESCAPED)


def _confined(scene: Scene, protocol: Protocol, numbers, params: Params) -> tuple[State, Confinement]:
    """Confinement with one contact list throughout."""
    network, membrane, platens, dt, _, fixed = numbers
    scene = confining_scene(scene, protocol.limits)
    start = initial_state(network, scene, platens), unconfined(network.dtype)
    return confine(scene, False, protocol.limits, (network, membrane), dt, fixed, params, start)


def _start_shear(scene: Scene, network: Network, confined: State) -> State:
    """The test's friction on, balls and platens from rest; springs of a frictional confinement are kept, or else start
    from nothing."""
    rest = initial_state(network, scene, confined.platens)
    spring = rest.spring if confined.spring is None or rest.spring is None else confined.spring
    return rest._replace(displacement=confined.displacement, spring=spring)


@partial(jax.jit, static_argnums=(0, 1))
def _simulate(scene: Scene, protocol: Protocol, numbers, params: Params) -> Curve:
    network = numbers[0]
    confined, balance = _confined(scene, protocol, numbers, params)
    start = _start_shear(scene, network, confined)
    _, seen, status = _shear(scene, protocol, numbers, params, start, _fixed_load(protocol, numbers, start))
    settled = balance.worst <= protocol.limits.tolerance
    status = jnp.bitwise_or.reduce(status) | jnp.where(settled, 0, NOT_CONFINED)
    return make_curve(seen, balance, status)


def make_curve(seen: Observation, balance: Confinement, status=0) -> Curve:
    """A curve from T observations, strains counted from the first."""
    status = status | jnp.where(seen.chatter[jnp.argmax(seen.stress_ratio)] > CHATTER, UNSTABLE, 0)
    volume = seen.membrane_radius**2 * seen.height
    return Curve(
        axial_strain=1 - seen.height / seen.height[0],
        stress_ratio=seen.stress_ratio,
        virial_ratio=seen.virial_ratio,
        core_ratio=seen.core_ratio,
        volumetric_strain=1 - volume / volume[0],
        coordination_number=seen.coordination_number,
        unbalanced_force=seen.unbalanced_force,
        sliding_fraction=seen.sliding_fraction,
        chatter=seen.chatter,
        membrane_radius=seen.membrane_radius,
        confinement=balance,
        status=status,
    )
