"""A shear in progress: its beginning, some steps further, and what it leaves."""

import math
from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

from axijax.core.shown import Card, per_cent, shown
from axijax.core.status import NOT_CONFINED
from axijax.mechanics.contact_list import ContactList
from axijax.mechanics.dynamics import positions
from axijax.mechanics.membrane import Load, Membrane
from axijax.mechanics.observe import Observation
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.rebuild import rebuild_on_host
from axijax.mechanics.state import State
from axijax.mechanics.time_step import check_step, critical_time_step
from axijax.triaxial.engine import fixed_load, march_until
from axijax.triaxial.prepare import check_masses, warn_of_slipping
from axijax.triaxial.records import Confinement, Curve, make_curve, no_records, raise_for_status
from axijax.triaxial.stages import settle, start_loading, start_shear, start_stage

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest

LONGEST = 3  # times what a stage is expected to take at most, after which it is given up
SEGMENT = 1000  # steps between looks at the run from outside: progress, rebuilding, errors


@shown
class Progress(NamedTuple):
    """A shear in progress: all that `TriaxialTest.run` needs to go on.

    fixed: the lateral load where it does not follow the membrane's cells.
    height: distance of the platens at the end of confinement [L].
    records: what was observed so far, T values each.
    due: steps until the next record. taken: steps of the shear so far. worn: the lists need a rebuild before the next.

    Of a test in stages:
    stage: the place of the one that comes next, or goes on, in the test's; begun: whether it does, steps: taken in it.
    first: the place of its first record. over: a stage could not be followed, and no further one begins.
    """

    params: Params
    network: ContactList
    membrane: Membrane
    state: State
    fixed: Load | None
    confinement: Confinement
    height: float
    records: Observation
    due: int = 0
    taken: int = 0
    worn: bool = False
    stage: int = 0
    begun: bool = False
    steps: int = 0
    first: int = 0
    over: bool = False

    def ended(self, test: "TriaxialTest") -> bool:
        """Whether nothing is left of the test."""
        if test.stages:
            return self.over or self.stage == len(test.stages)
        return self.strain >= test.axial_strain

    def share(self, test: "TriaxialTest") -> float:
        """How much of the test is done, from 0 to 1, as far as that is known."""
        if not test.stages:
            return min(self.strain / test.axial_strain, 1.0)
        if self.ended(test):
            return 1.0
        most = test.prepared.numerics.stage_records[self.stage] * test.record_every
        return (self.stage + min(self.steps / most, 1.0) * self.begun) / len(test.stages)

    def _card(self) -> Card:
        rows = {
            "axial strain": per_cent(self.strain),
            "stress ratio s1/s3 [-]": f"{self.stress_ratio:.4f}",
            "unbalanced force [-]": f"{self.unbalanced_force:.1e}",
            "steps": str(self.taken),
            "records": str(self.records.height.size),
        }
        return Card("Progress", rows | ({"stage": str(self.stage + 1)} if self.begun else {}))

    @property
    def path_length(self) -> float:
        """Axial strain travelled, to and fro [-]."""
        return self.strain if self.state.loading is None else float(self.state.loading.path_length)

    @property
    def lists(self) -> tuple[ContactList, Membrane]:
        return self.network, self.membrane

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


def begin(test: "TriaxialTest", params: Params) -> Progress:
    """Confined, and nothing sheared yet. Raises ValueError for bad parameters, SimulationError where it finds no
    equilibrium."""
    prepared = test.prepared
    check_params(params, len(test.cut))
    if params is not test.params:
        warn_of_slipping(params, test.confining_friction)
        check_masses(test, params, prepared.network)
    if params is not test.params and not test.allow_unsafe_step:
        check_step(prepared.time_step, critical_time_step(test.scene, params, prepared.network))
    lists, confined, balance = settle(
        test.scene, prepared.confinement, test.cut, prepared.lists, prepared.time_step, params, prepared.lateral_load
    )
    if not float(balance.worst) <= test.tolerance:
        raise_for_status(NOT_CONFINED)
    state = start_shear(test.scene, params, lists, confined)
    if test.stages:
        state = start_loading(params, state)
    fixed = fixed_load(test.refresh, prepared.lateral_load, lists, state)
    height = float(state.platens[1] - state.platens[0])
    return Progress(params, *lists, state, fixed, balance, height, no_records(params, bool(test.stages)))


def fit_for_stages(test: "TriaxialTest", now: Progress) -> Progress:
    """A confined specimen for a test in stages, or for one without. Raises ValueError where it has been sheared."""
    if (now.records.stage is not None) == bool(test.stages):
        return now
    if now.taken:
        raise ValueError("start: has been sheared by a test in stages, and this one has none, or the other way round.")
    state = now.state._replace(loading=None)
    if test.stages:
        state = start_loading(now.params, state)
    return now._replace(state=state, records=no_records(now.params, bool(test.stages)))


def go_on(test: "TriaxialTest", now: Progress, until: float | None = None) -> Progress:
    """About 1000 steps further, or until a list is worn, or to the first record at an axial strain, that where the test
    ends if none is given; lists that are worn are rebuilt first.

    With `rebuild_every` they are rebuilt before the same records as by `simulate`.
    """
    prepared = test.prepared
    lists, state = now.lists, now.state
    if now.worn:
        lists, state = rebuild_on_host(test.cut, lists, state)
    path = prepared.shear
    if test.stages:
        path = prepared.stages[now.stage]
        if not now.begun:
            state = _start_stage(prepared.scene, path, lists, prepared.time_step, now.params, state, now.fixed)
            now = now._replace(begun=True, due=0, steps=0, first=now.records.height.size)
    widely_graded = bool(test.cut.radius.max() > 2 * test.cut.radius.min())
    places = -(-SEGMENT // test.record_every)
    every, number = test.rebuild_every, now.records.height.size - now.first
    left = places + 1
    if every:  # records before the rebuild that is due; none where only steps to the next record are left before it
        left = 0 if number and number % every == 0 and now.due else every - number % every
    most = min(places, _records_left(test, now, test.axial_strain if until is None else until))
    reached = march_until(
        test.scene, places, test.record_every, True, widely_graded, path, lists,
        prepared.time_step, now.params, state, now.fixed, now.due, now.steps, now.worn,
        min(most, left), left <= most,
    )  # fmt: skip
    seen = jax.tree.map(lambda values: np.asarray(values)[: int(reached.records)], reached.seen)
    joined = jax.tree.map(np.append, now.records, seen)
    if int(reached.status):
        raise_for_status(reached.status, make_curve(joined, now.confinement))
    network, membrane = lists
    on_time = every and not int(reached.due) and (joined.height.size - now.first) % every == 0
    after = now._replace(
        network=network, membrane=membrane, state=reached.state, records=joined,
        due=int(reached.due), taken=now.taken + int(reached.steps) - now.steps, steps=int(reached.steps),
        worn=bool(reached.worn or on_time),
    )  # fmt: skip
    if test.stages:
        most = LONGEST * prepared.numerics.stage_records[now.stage] * test.record_every
        going = bool(path.going(reached.watched, after.steps))
        if not going or after.steps > most:
            after = after._replace(stage=now.stage + 1, begun=False, over=going or bool(path.failed(reached.watched)))
    return after


def _records_left(test: "TriaxialTest", now: Progress, until: float) -> int:
    """Records until the strain is reached at full speed, the first one there included; of a test in stages, each of
    which knows its end, more than there are in a segment."""
    if test.stages:
        return SEGMENT + 1
    each = 2 * float(now.params.platen_speed) * test.prepared.time_step * test.record_every / now.height
    return max(math.ceil((until - now.strain) / each - now.due / test.record_every + 1 - 1e-6), 1)


_start_stage = jax.jit(start_stage, static_argnums=0)


def why_over(test: "TriaxialTest", now: Progress) -> str:
    """Why a test in stages has ended before its last one was done, as a sentence; empty where it has not."""
    if not now.over:
        return ""
    path = test.stages[now.stage - 1]
    last = jax.tree.map(lambda values: values[-1], now.records)
    told = path.ended(path.watch(last, now.state)) or (
        f"it has not come to where it leads in {LONGEST} times the steps that it should take at most: its servo does "
        "not settle; lower time_step, or give the stage a time"
    )
    return f"stage {now.stage} of {len(test.stages)} ended at {100 * now.strain:.3g} % axial strain: {told}"


def curve_of(progress: Progress, axial_strain: float) -> Curve:
    """The curve of what a shear has recorded up to this axial strain; of a test in stages, all of it."""
    if progress.records.stage is not None:
        return make_curve(progress.records, progress.confinement)
    wanted = 1 - progress.records.height / progress.height <= axial_strain
    return make_curve(jax.tree.map(lambda values: values[wanted], progress.records), progress.confinement)


@shown
class Run(NamedTuple):
    """What a run leaves: its curve, and the last contact list, membrane and state.

    ended: of a test in stages, why it ended before its last one was done; empty where it did not.
    """

    curve: Curve
    network: ContactList
    membrane: Membrane
    state: State
    ended: str = ""

    @property
    def positions(self) -> np.ndarray:
        """Ball centres at the end, (3, N) [L]; ball i is ball i of the test's `cut` throughout."""
        return np.asarray(positions(self.network, self.state))

    def _card(self) -> Card:
        card = self.curve._card()
        last = {"balls in the sector": str(self.network.radius.size)} | ({"ended": self.ended} if self.ended else {})
        return card._replace(title="Run", rows={**card.rows, **last})
