"""The triaxial test of Cui & O'Sullivan (2005), section 4.2: confine, switch friction on, shear, record.

1. Confine: no friction, membrane and both platens at s3, until the unbalanced force and the stress error are small.
2. Shear: friction on, both platens move inward at the platen speed (reached by a smooth ramp: a sudden start sends
   a wave of rho c v through the specimen), the membrane's cells are refreshed with every record, and whenever the
   lists are made anew.

`TriaxialTest` is what was asked, and cheap to make and to replace. `axijax.triaxial.prepare` makes lists and time step
of it; its `simulate` is a pure function Params -> Curve for jit, vmap and jvp; its `run` rebuilds lists where needed,
and adds checks and a sentence for whatever went wrong.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np

from axijax.core.platform import require_64_bits, warn_where_batched
from axijax.core.quantity import setting, settings, values_of
from axijax.core.sector import Sector
from axijax.core.shown import Card, per_cent, shown
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.dynamics import Scene
from axijax.mechanics.membrane import Load, Membrane
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.state import State
from axijax.specimen.specimen import Specimen, cut_to_sector
from axijax.triaxial.checkpoint import save_progress
from axijax.triaxial.paths import Path as LoadingPath
from axijax.triaxial.prepare import Prepared, prepare
from axijax.triaxial.progress import Progress, Run, begin, curve_of, fit_for_stages, go_on, why_over
from axijax.triaxial.records import Confinement, Curve, SimulationError, raise_for_status, warn_of_chatter
from axijax.triaxial.stages import confine, simulate
from axijax.triaxial.watch import watched

CHECKPOINT_SECONDS = 60.0  # between checkpoints, where they are asked for


@shown
@dataclass(frozen=True)
class TriaxialTest:
    """A triaxial test of a specimen's sector: what is asked, and nothing that is computed from it.

    specimen: the full cylinder; the sector is cut from it.
    sector: order n and boundary, by default the paper's quarter between periodic planes.
    scene: what is modelled.
    params: reference parameters; time step and ramp are chosen for these.
    stages: what follows confinement, one after the other, see `axijax.triaxial.stage`; none: compression at the platen
        speed and constant lateral stress, to the axial strain.
    lateral_load: a constant load in place of the membrane's (see `membrane.Load`).
    dtype: np.float64, or np.float32 (see examples/guide/limits.md).
    allow_unsafe_step: accept any time step, to study what it does to a result.
    The other fields are settings; `axijax new` writes each with its meaning.

    Raises ValueError for settings that make no sense by themselves; `prepared`, which all that runs a test needs, for
    what does not fit together.
    """

    specimen: Specimen
    sector: Sector = field(default_factory=Sector)
    scene: Scene = field(default_factory=Scene)
    params: Params = field(default_factory=Params)
    axial_strain: float = setting(
        0.01, "where the test stops, as a share of the confined height", "-", above=0.0, below=0.5
    )
    time_step: float | None = setting(
        None, "length of a step; left out, 0.6 of the critical one; more than 0.8 of it is refused", "T", above=0.0
    )
    record_every: int = setting(50, "steps between records", "-", least=1, most=1e6, whole=True)
    refresh: bool = setting(True, "whether the membrane's cells are found again with every record")
    confine_steps: int = setting(20_000, "most steps spent on confinement", "-", least=1, most=1e9, whole=True)
    tolerance: float = setting(1e-7, "unbalanced force and stress error at which confinement ends", "-", above=0.0)
    rebuild_every: int = setting(
        0,
        "records between which `simulate` rebuilds contact list and membrane during shear, for large strain and for "
        "batches; zero keeps the first. `run` rebuilds them then, and wherever they are worn",
        "-",
        most=1e6,
        whole=True,
    )
    confining_friction: float = setting(
        0.0,
        "friction coefficient during confinement; zero, the paper's, lets a packing become as dense as it can. A "
        "random specimen keeps its density under the friction with which it was compacted",
        "-",
    )
    mass_scaling: float | None = setting(
        None,
        "how many times longer the critical time step becomes by making the balls that set it heavier, the small ones "
        "of a wide grading; refused where a ball's inertial number would be above 1e-3; left out, masses are true",
        "-",
        above=1.0,
        most=100.0,
    )
    stages: tuple[LoadingPath, ...] = ()
    lateral_load: Load | None = None
    dtype: type = np.float64
    allow_unsafe_step: bool = False

    def __post_init__(self) -> None:
        require_64_bits()
        if not isinstance(self.stages, tuple) or not all(isinstance(each, LoadingPath) for each in self.stages):
            raise ValueError(f"stages = {self.stages!r}: must be a tuple, such as (axijax.stage('hold', time=9),).")
        for name, about in settings(self).items():
            value = getattr(self, name)
            if isinstance(value, bool) and (about.unit or about.whole):
                raise ValueError(f"{name} = {value}: must be a number.")
            trouble = None if value is None or isinstance(value, bool) else about.trouble(name, value)
            if trouble:
                raise ValueError(trouble)

    @cached_property
    def cut(self) -> Specimen:
        """The sector's part of the specimen."""
        return cut_to_sector(self.specimen, self.sector)

    @cached_property
    def prepared(self) -> Prepared:
        """Lists, time step and paths, made once; see `axijax.triaxial.prepare`."""
        with jax.ensure_compile_time_eval():  # or a first `simulate` inside jit would keep that trace's values
            return prepare(self)

    @property
    def derived(self) -> dict[str, Any]:
        """What follows from the settings by a rule of this program, for `axijax.core.fingerprint`."""
        found = {"time_step": float(self.prepared.time_step), "ramp_time": float(self.prepared.ramp_time)}
        factor = self.prepared.network.mass_factor
        return found if factor is None else found | {"mass_factor": factor}

    @property
    def network(self) -> ContactList:
        """The contact list before the first step."""
        return self.prepared.network

    @property
    def membrane(self) -> Membrane:
        """The membrane before the first step."""
        return self.prepared.membrane

    def simulate(self, params: Params) -> Curve:
        """The whole test as a pure function of its parameters, for jax.jit, jax.vmap and jax.jvp.

        For many parameter sets see `axijax.app.batch.simulate_many`: on a CPU, vmap over parameters is slow, and warned
        of. One contact list serves the whole test, to about 2 % strain of a regular array and less than 1 % of many
        random balls, unless `rebuild_every` asks for more. Look at `status` of what comes back, or call
        `raise_for_status`; parameters that make no sense raise ValueError, or set a status bit where they are traced.
        """
        require_64_bits()
        check_params(params, len(self.cut))
        return simulate(self.prepared, warn_where_batched(params))

    def confine(self, params: Params | None = None) -> tuple[State, Confinement]:
        """The state at the end of confinement, and how well it is balanced."""
        params = self.params if params is None else params
        check_params(params, len(self.cut))
        return confine(self.prepared, params)

    def confined(self, params: Params | None = None, checkpoint: Path | None = None) -> Progress:
        """The confined specimen, from which `run(start=..)` of this test goes on, and of tests that differ in their
        stages alone. checkpoint: file to keep it in, see `axijax.triaxial.checkpoint`.

        Raises ValueError for bad parameters, and SimulationError where it finds no equilibrium.
        """
        now = begin(self, self.params if params is None else params)
        if checkpoint is not None:
            save_progress(checkpoint, self, now)
        return now

    def run(
        self,
        params: Params | None = None,
        progress: Callable[[Progress], None] | bool | None = None,
        start: Progress | None = None,
        checkpoint: Path | None = None,
        stops: Sequence[float] = (),
    ) -> Run:
        """Run the test to its end and return curve and final state; lists are rebuilt where needed.

        progress: True for a bar in the terminal or the notebook; or a function, called with where the test stands: once
            before the first step of the shear, then about every 1000, and whenever the lists are made anew.
        start: go on from here, see `axijax.triaxial.checkpoint.load_progress`, instead of confining; its parameters are
            used.
        checkpoint: file to which the progress is written now and then, at the end and at an interruption (Ctrl-C).
        stops: axial strains at whose first record `progress` is called too, as for snapshots; not of a test in stages.

        Raises ValueError for bad parameters, and SimulationError with the remedy for a run that went wrong.
        """
        require_64_bits()
        if start is not None and params is not None:
            raise ValueError("params: must be left out where a start is given, which brings its own.")
        with watched(self, progress) as tell:
            if start is None:
                now = begin(self, self.params if params is None else params)
            else:
                now = fit_for_stages(self, start)
            now = self._sheared(now, tell, checkpoint, stops)
        curve = curve_of(now, self.axial_strain)
        raise_for_status(curve.status, curve)
        if self.stages:
            warn_of_chatter(curve)
            return Run(curve, now.network, now.membrane, now.state, why_over(self, now))
        if curve.axial_strain.size < 3:
            raise SimulationError(
                f"the test went wrong: the platens passed axial_strain = {self.axial_strain:g} before the third "
                "record: lower platen_speed or record_every.",
                curve,
            )
        warn_of_chatter(curve)
        return Run(curve, now.network, now.membrane, now.state)

    def _sheared(
        self, now: Progress, tell: Callable[[Progress], None], checkpoint: Path | None, stops: Sequence[float]
    ) -> Progress:
        """From here to the end of the test."""
        if checkpoint is not None:
            save_progress(checkpoint, self, now)
        written = time.monotonic()
        try:
            tell(now)
            while not now.ended(self):
                ahead = (strain for strain in stops if now.strain < strain < self.axial_strain)
                now = go_on(self, now, min(ahead, default=None))
                tell(now)
                if checkpoint is not None and time.monotonic() - written > CHECKPOINT_SECONDS:
                    save_progress(checkpoint, self, now)
                    written = time.monotonic()
        finally:
            # Whole segments only: after a failure or an interruption this is the last sound state.
            if checkpoint is not None:
                save_progress(checkpoint, self, now)
        return now

    def _card(self) -> Card:
        specimen, sector = self.specimen._card(), self.sector
        goal = f"{len(self.stages)} stages" if self.stages else f"compression to {per_cent(self.axial_strain)}"
        given = {name: np.asarray(value) for name, value in values_of(self.params).items()}
        rows = {
            "specimen": f"{self.specimen.name}, {len(self.specimen)} balls",
            "sector": f"1/{sector.order}, {sector.boundary} planes" if sector.order > 1 else "full cylinder",
            "loading": goal,
        }
        told = {n: f"{value:g}" if value.shape == () else f"{value.size} values" for n, value in given.items()}
        return Card("TriaxialTest", rows | told, specimen.picture, (*rows, "friction", "confining_stress"))
