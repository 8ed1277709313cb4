"""The triaxial test of Cui & O'Sullivan (2005), section 4.2: confine, switch friction on, shear, record.

1. Confine: no friction, membrane and both platens at s3, until the unbalanced force and the stress error are small.
2. Shear: friction on, both platens move inward at the platen speed (reached by a smooth ramp: a sudden start sends
   a wave of rho c v through the specimen), the membrane's cells are refreshed with every record, and whenever the
   lists are made anew.

`TriaxialTest` prepares a test on the host; its `simulate` is a pure function Params -> Curve for jit, vmap and jvp;
its `run` adds checks and a sentence for whatever went wrong.
"""

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from axijax.confinement import (
    Confinement,
    Limits,
    confining_scene,
    rebuilt,
    roomy_lists,
    settle,
    wave_speed,
)
from axijax.curve import Curve, SimulationError, make_curve, no_records, raise_for_status, warn_of_chatter
from axijax.dynamics import Params, Scene, State, check_params, positions
from axijax.feasible import pressed_in
from axijax.membrane import Load, Membrane, build_membrane, membrane_radius
from axijax.neighbors import Network, build_network
from axijax.observe import Observation
from axijax.packing import Specimen, cut_to_sector
from axijax.platform import warn_where_batched
from axijax.sector import Sector
from axijax.shear import Prepared, Protocol, confine_test, fixed_load, shear_until_worn, simulate, start_shear
from axijax.status import NOT_CONFINED
from axijax.time_step import DEFAULT_STEP, check_step, critical_time_step
from axijax.update import grid_for

SEGMENT = 1000  # steps between looks at the run from outside: progress, rebuilding, errors
CHECKPOINT_SECONDS = 60.0  # between checkpoints, where they are asked for


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
        _warn_of_slipping(self.scene, self.params, self.confining_friction)
        if cut.zone_rule == "exposure" or self.rebuild_every:
            # A random specimen was made under stress, which presses soft balls into one another.
            soft = cut.zone_rule == "exposure"
            overlap = max(0.05, 6 * pressed_in(cut.radius, self.params)) if soft else 0.05
            network, membrane = roomy_lists(cut, self.sector, self.dtype, overlap)
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
        if self.lateral_load is not None:
            prepared["lateral_load"] = replace(self.lateral_load, stale=0.0)  # what is constant does not age
        for name, value in prepared.items():
            object.__setattr__(self, name, value)

    def simulate(self, params: Params) -> Curve:
        """The whole test as a pure function of its parameters, for jax.jit, jax.vmap and jax.jvp.

        For many parameter sets see `axijax.batch.simulate_many`: on a CPU, vmap over parameters is slow, and warned of.
        One contact list serves the whole test, which is right up to about 2 % strain, unless `rebuild_every` asks for
        more. Look at `status` of what comes back, or call `raise_for_status`.
        """
        params = warn_where_batched(params)
        return simulate(self.scene, self.protocol, self.prepared(self.network, self.membrane), params)

    def confine(self, params: Params | None = None) -> tuple[State, Confinement]:
        """The state at the end of confinement, and how well it is balanced."""
        prepared = self.prepared(self.network, self.membrane)
        return confine_test(self.scene, self.protocol, prepared, self.params if params is None else params)

    def run(
        self,
        params: Params | None = None,
        progress: "Callable[[Progress], None] | None" = None,
        start: "Progress | None" = None,
        checkpoint: Path | None = None,
    ) -> "Run":
        """Run the test to its axial strain and return curve and final state; lists are rebuilt where needed.

        progress: called with where the test stands: once before the first step of the shear, then about every 1000, and
            whenever the lists are made anew.
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
        if curve.axial_strain.size < 3:
            raise SimulationError(
                f"the test went wrong: the platens passed axial_strain = {self.axial_strain:g} before the third "
                "record: lower platen_speed or record_every.",
                curve,
            )
        warn_of_chatter(curve)
        return Run(curve, now.network, now.membrane, now.state)

    def _begin(self, params: Params) -> "Progress":
        """Confined, and nothing sheared yet."""
        check_params(params, len(self.cut))
        if params is not self.params:
            _warn_of_slipping(self.scene, params, self.confining_friction)
        if params is not self.params and not self.allow_unsafe_step:
            check_step(self.time_step, critical_time_step(self.scene, params, self.network))
        limits = self.protocol.limits
        scene = confining_scene(self.scene, limits)
        network, membrane, confined, balance = settle(
            scene, self.cut, self.network, self.membrane, params, self.time_step, limits, self.lateral_load
        )  # fmt: skip
        if not float(balance.worst) <= self.tolerance:
            raise_for_status(NOT_CONFINED)
        state = start_shear(self.scene, network, confined)
        fixed = fixed_load(self.protocol, self.prepared(network, membrane), state)
        height = float(state.platens[1] - state.platens[0])
        return Progress(params, network, membrane, state, fixed, balance, height, no_records())

    def _go_on(self, now: "Progress") -> "Progress":
        """About 1000 steps further, or until a list is worn; lists that are worn are made anew first."""
        network, membrane, state = now.network, now.membrane, now.state
        swelling = now.swelling
        if now.worn:
            radius_before = _radius_now(network, membrane, state)
            network, membrane, state = rebuilt(self.cut, network, membrane, state)
            if self.cut.zone_rule == "exposure":
                swelling *= radius_before / _radius_now(network, membrane, state)
        stretch = replace(self.protocol, blocks=-(-SEGMENT // self.record_every))
        prepared = self.prepared(network, membrane)
        state, seen, status, records, done, worn = shear_until_worn(
            self.scene, stretch, prepared, now.params, state, now.fixed, now.done, now.worn
        )
        seen = jax.tree.map(lambda values: np.asarray(values)[: int(records)], seen)
        seen = seen._replace(membrane_radius=seen.membrane_radius * swelling)
        joined = jax.tree.map(np.append, now.records, seen)
        if int(status):
            raise_for_status(status, make_curve(joined, now.confinement))
        return now._replace(
            network=network, membrane=membrane, state=state, records=joined, swelling=swelling,
            done=int(done), worn=bool(worn),
        )  # fmt: skip

    def prepared(self, network: Network, membrane: Membrane) -> Prepared:
        """What the pure functions of `axijax.shear` take, with these lists."""
        platens = jnp.asarray([self.cut.bottom, self.cut.top])
        return Prepared(network, membrane, platens, float(self.time_step or 0), self.ramp_time, self.lateral_load)


class Progress(NamedTuple):
    """A shear in progress: all that `TriaxialTest.run` needs to go on.

    fixed: the lateral load where it does not follow the membrane's cells.
    height: distance of the platens at the end of confinement [L].
    records: what was observed so far, T values each.
    swelling: by which Rm is multiplied in the records of a zone found by exposure, so that balls that join or leave the
        zone are no change of volume; what is left is the work of the membrane over s3 [-].
    done: steps taken since the last record. worn: the lists must be made anew before the next step.
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
    done: int = 0
    worn: bool = False

    def steps(self, record_every: int) -> int:
        """Steps of the shear that were taken."""
        return (self.records.height.size - (self.done > 0)) * record_every + self.done

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


def _warn_of_slipping(scene: Scene, params: Params, confining_friction: float) -> None:
    """Warn of a shear that begins with less friction than the specimen was confined with."""
    friction = float(np.min(np.asarray(params.friction))) if scene.friction else 0.0
    if friction < confining_friction:
        warnings.warn(
            f"friction {friction:g} is below the confining_friction {confining_friction:g}: the contacts that hold the "
            "confined specimen slip as soon as the shear begins, and the stress ratio may fall below 1; lower "
            "confining_friction, and for a random specimen compaction_friction, to at most the friction.",
            stacklevel=4,
        )


def _radius_now(network: Network, membrane: Membrane, state: State) -> float:
    return float(jax.jit(membrane_radius)(membrane, positions(network, state)))
