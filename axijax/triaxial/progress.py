"""A shear in progress: its beginning, some steps further, and what it leaves."""

from typing import TYPE_CHECKING, NamedTuple

import jax
import numpy as np

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
from axijax.triaxial.prepare import warn_of_slipping
from axijax.triaxial.records import Confinement, Curve, make_curve, no_records, raise_for_status
from axijax.triaxial.stages import settle, start_shear

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest

SEGMENT = 1000  # steps between looks at the run from outside: progress, rebuilding, errors


class Progress(NamedTuple):
    """A shear in progress: all that `TriaxialTest.run` needs to go on.

    fixed: the lateral load where it does not follow the membrane's cells.
    height: distance of the platens at the end of confinement [L].
    records: what was observed so far, T values each.
    due: steps until the next record. taken: steps of the shear so far. worn: the lists need a rebuild before the next.
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
    if params is not test.params and not test.allow_unsafe_step:
        check_step(prepared.time_step, critical_time_step(test.scene, params, prepared.network))
    lists, confined, balance = settle(
        test.scene, prepared.confinement, test.cut, prepared.lists, prepared.time_step, params, prepared.lateral_load
    )
    if not float(balance.worst) <= test.tolerance:
        raise_for_status(NOT_CONFINED)
    state = start_shear(test.scene, params, lists, confined)
    fixed = fixed_load(test.refresh, prepared.lateral_load, lists, state)
    height = float(state.platens[1] - state.platens[0])
    return Progress(params, *lists, state, fixed, balance, height, no_records(params))


def go_on(test: "TriaxialTest", now: Progress) -> Progress:
    """About 1000 steps further, or until a list is worn; lists that are worn are rebuilt first.

    With `rebuild_every` they are rebuilt before the same records as by `simulate`.
    """
    prepared = test.prepared
    lists, state = now.lists, now.state
    if now.worn:
        lists, state = rebuild_on_host(test.cut, lists, state)
    widely_graded = bool(test.cut.radius.max() > 2 * test.cut.radius.min())
    places = -(-SEGMENT // test.record_every)
    every, number = test.rebuild_every, now.records.height.size
    left = places + 1
    if every:  # records before the rebuild that is due; none where only steps to the next record are left before it
        left = 0 if number and number % every == 0 and now.due else every - number % every
    reached = march_until(
        test.scene, places, test.record_every, True, widely_graded, prepared.shear, lists,
        prepared.time_step, now.params, state, now.fixed, now.due, now.taken, now.worn,
        min(places, left), left <= places,
    )  # fmt: skip
    seen = jax.tree.map(lambda values: np.asarray(values)[: int(reached.records)], reached.seen)
    joined = jax.tree.map(np.append, now.records, seen)
    if int(reached.status):
        raise_for_status(reached.status, make_curve(joined, now.confinement))
    network, membrane = lists
    on_time = every and not int(reached.due) and joined.height.size % every == 0
    return now._replace(
        network=network, membrane=membrane, state=reached.state, records=joined,
        due=int(reached.due), taken=int(reached.steps), worn=bool(reached.worn or on_time),
    )  # fmt: skip


def curve_of(progress: Progress, axial_strain: float) -> Curve:
    """The curve of what a shear has recorded up to this axial strain."""
    wanted = 1 - progress.records.height / progress.height <= axial_strain
    return make_curve(jax.tree.map(lambda values: values[wanted], progress.records), progress.confinement)


class Run(NamedTuple):
    """What a run leaves: its curve, and the last contact list, membrane and state."""

    curve: Curve
    network: ContactList
    membrane: Membrane
    state: State

    @property
    def positions(self) -> np.ndarray:
        """Ball centres at the end, (3, N) [L]; ball i is ball i of the test's `cut` throughout."""
        return np.asarray(positions(self.network, self.state))
