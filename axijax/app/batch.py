"""Many triaxial tests at once: parameter sets, specimens, seeds, over the devices of a machine and over hosts.

    members = parameter_grid(test, friction=[0.1, 0.2, 0.3], normal_stiffness=[7.5e8, 1.5e9])
    result = run_batch(members, folder="sweep")       # run again after an interruption: nothing is computed twice
    print(result.failures)
    open_batch("sweep").stress_ratio                  # (member, record)

On a CPU every core takes the next test and runs it by itself (compiled programs run outside Python's lock, so threads
are parallel on one CPU device). A process that has used JAX must not be forked: JAX's threads do not survive it, and
the child hangs; where there must be processes, `multiprocessing.get_context("spawn")` makes them. On a GPU tests of
equal shape run together, by `jax.vmap`. Where `jax.distributed` has been initialised, its processes deal the members
out among them and write into one folder.
"""

import itertools
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from axijax.app.batch_files import (
    Stored,
    open_batch,
    open_folder,
    read_member,
    slug,
    write_failure,
    write_member,
    write_summary,
)
from axijax.app.executors import spread
from axijax.core.parallel import cores, parallel
from axijax.core.quantity import declared, optional_parts, parts_of, values_of
from axijax.core.shown import Card, shown
from axijax.mechanics.params import Params, check_params
from axijax.mechanics.time_step import check_step, critical_time_step
from axijax.triaxial.many import simulate_many
from axijax.triaxial.peak import peak_of
from axijax.triaxial.progress import Progress
from axijax.triaxial.records import Curve, records_of, warn_of_chatter
from axijax.triaxial.stages import simulate
from axijax.triaxial.test import TriaxialTest

__all__ = [
    "BatchResult", "Member", "Outcome", "open_batch", "parallel", "parameter_grid", "run_batch", "simulate_many",
]  # fmt: skip

Strategy = Literal["auto", "threads", "vmap"]
SHOWN = 20  # members in a notebook's table, at most
CHUNK = 128  # most tests in one vmap; about 1 MB each for 430 balls

Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Member:
    """One test of a batch.

    name: unique in its batch; also the name of its file.
    params: the parameters to run with; None takes the test's own.
    labels: further coordinates in tables and data sets, such as a seed.
    """

    name: str
    test: TriaxialTest
    params: Params | None = None
    labels: Mapping[str, float | int | str | bool] = field(default_factory=dict)

    @property
    def parameters(self) -> Params:
        return self.test.params if self.params is None else self.params


@dataclass(frozen=True)
class Outcome:
    """What became of a member: its curve, or the sentence that says why there is none.

    seconds: spent on it; a vmap's time is divided among its members.
    resumed: read from the folder, not computed.
    ended: of a test in stages, why it ended before its last one was done; empty where it did not.
    """

    member: Member
    curve: Curve | None
    failure: str | None
    seconds: float
    resumed: bool = False
    ended: str = ""


@shown
@dataclass(frozen=True)
class BatchResult:
    """The members of a batch that this process ran or found done, in their order."""

    outcomes: tuple[Outcome, ...]

    @property
    def curves(self) -> dict[str, Curve]:
        """The curves of the members that went well, by name."""
        return {o.member.name: o.curve for o in self.outcomes if o.curve is not None}

    @property
    def failures(self) -> dict[str, str]:
        """Why the others have none, by name."""
        return {o.member.name: o.failure for o in self.outcomes if o.failure is not None}

    @property
    def ended(self) -> dict[str, str]:
        """Why tests in stages ended before their last one was done, by name; those are no failures."""
        return {o.member.name: o.ended for o in self.outcomes if o.ended}

    def _card(self) -> Card:
        peaks = {name: peak_of(curve).short for name, curve in itertools.islice(self.curves.items(), SHOWN)}
        more = len(self.curves) - len(peaks)
        rows = {"members": str(len(self.outcomes)), "failed": str(len(self.failures)), **peaks}
        rows |= {"and": f"{more} more"} if more > 0 else {}
        rows |= dict(itertools.islice((self.ended | self.failures).items(), SHOWN))
        return Card("BatchResult", rows, brief=("members", "failed"))

    def dataset(self):
        """The curves as an xarray.Dataset with dimensions (member, record), as `open_batch` gives it."""
        return Stored.dataset([_stored(o) for o in self.outcomes if o.curve is not None])


def parameter_grid(test: TriaxialTest, **values: Sequence[float]) -> list[Member]:
    """Members for all combinations of these values of a test's parameters, the last one running fastest.

    All keep the time step of `test`: build it with the stiffest values that occur.

    Raises ValueError for a name that is no parameter, and for an empty list.
    """
    parts = parts_of(test.params)
    kinds = [*parts, *(kind for part in parts for kind in optional_parts(part).values())]
    known = list(dict.fromkeys(name for kind in kinds for name in declared(kind)))
    for name, sequence in values.items():
        if name not in known:
            raise ValueError(f"'{name}' is not a parameter of this test; it has {', '.join(known)}.")
        if np.ndim(sequence) != 1 or not len(sequence):
            raise ValueError(f"{name} = {sequence!r}: must be a list of at least one number.")
    points = itertools.product(*values.values())
    sets: list[dict[str, Any]] = [dict(zip(values, map(float, point), strict=True)) for point in points]
    return [Member(point_name(point), test, replace(test.params, **point), point) for point in sets]


def point_name(point: Mapping[str, object]) -> str:
    """The name of a point of a grid, such as 'friction=0.1 order=4'."""
    return " ".join(f"{name}={f'{v:g}' if isinstance(v, float) else v}" for name, v in point.items()) or "test"


def run_batch(
    members: Iterable[Member],
    folder: Path | str | None = None,
    progress: Callable[[str, float, float], object] | None = None,
    finished: Callable[[Outcome], object] | None = None,
    strategy: Strategy = "auto",
    workers: int | None = None,
    executor: Executor | None = None,
) -> BatchResult:
    """Run many tests; a member that fails is reported and the others are kept.

    folder: where results are written as they come, one whole file a member, with a summary.csv; members that are there
        already are not computed again, failed ones are tried again. Several processes share it.
    progress: called with name, share of the axial strain done and stress ratio, about once every 1000 steps.
    finished: called with each Outcome as it comes. Neither is ever called by two threads at once.
    strategy: "threads", each test by itself on a core; "vmap", tests of equal shape together; "auto" takes threads on
        a CPU and vmap on anything else.
    workers: threads; None takes one a core with "threads", and one a device with "vmap".
    executor: any `concurrent.futures.Executor`, whose processes or machines run the tests one by one in place of
        `strategy` and `workers`; `progress` is not called then.

    Under `jax.distributed`, process p of P takes every P-th member, from the p-th, and returns its own;
    `open_batch` reads all of them from the folder.

    Raises ValueError for names that are not unique, and for a folder that cannot be written or that holds a member of
    that name of another test, other parameters or another version. RuntimeError where the executor broke; what was
    done by then is in the folder.
    """
    chosen = list(members)
    _check_names([member.name for member in chosen])
    if strategy not in ("auto", "threads", "vmap"):
        raise ValueError(f"strategy = {strategy!r}: must be 'auto', 'threads' or 'vmap'.")
    if strategy == "auto":
        strategy = "threads" if jax.default_backend() == "cpu" else "vmap"
    store = None if folder is None else open_folder(Path(folder))
    mine = chosen[jax.process_index() :: jax.process_count()]
    lock, stop = threading.Lock(), threading.Event()
    outcomes: dict[str, Outcome] = {}

    def done(outcome: Outcome) -> None:
        with lock:
            outcomes[outcome.member.name] = outcome
            if store is not None and not outcome.resumed:
                if outcome.failure is None:
                    write_member(store, _stored(outcome))
                else:
                    write_failure(store, outcome.member.name, outcome.failure)
            if finished is not None:
                finished(outcome)

    def tell(name: str, share: float, ratio: float) -> None:
        if stop.is_set():
            raise _Stopped
        if progress is not None:
            with lock:
                progress(name, share, ratio)

    todo = []
    for member in mine:
        found = None if store is None else read_member(store, _unrun(member))
        if found is None:
            todo.append(member)
        else:
            done(Outcome(member, found.curve, None, found.seconds, resumed=True, ended=found.ended))

    def give_up(_: int, result: object) -> None:
        if isinstance(result, Exception):  # such as a full disk; a member's own failure does not get here
            raise result

    if executor is not None:
        own = {member.name: member for member in todo}  # what comes back holds copies
        spread(executor, _elsewhere, todo, lambda outcome: done(replace(outcome, member=own[outcome.member.name])))
    elif strategy == "threads":
        work = partial(_each, tell=tell, done=done)
        parallel(work, [[member] for member in todo], workers or cores(), give_up, stop)
    else:
        work, devices = partial(_together, tell=tell, done=done), jax.local_devices()
        parallel(work, _chunks(todo), workers or len(devices), give_up, stop, devices)
    if store is not None:
        write_summary(store)
    return BatchResult(tuple(outcomes[member.name] for member in mine))


def _elsewhere(member: Member) -> Outcome:
    """Run one member in a process of an executor; its curve as plain arrays."""
    outcomes: list[Outcome] = []
    _each([member], lambda name, share, ratio: None, outcomes.append)
    return replace(outcomes[0], curve=jax.tree.map(np.asarray, outcomes[0].curve))


class _Stopped(BaseException):
    """Raised inside a run when its batch is given up."""


def _each(task: Sequence[Member], tell, done) -> None:
    """Run members one by one, with lists rebuilt where they are worn."""
    for member in task:
        started = time.perf_counter()
        test = member.test

        def advance(now: Progress, member=member) -> None:
            tell(member.name, now.share(member.test), now.stress_ratio)

        curve, failure, ended = None, None, ""
        try:
            tell(member.name, 0.0, 1.0)
            run = test.run(member.params, progress=advance)
            curve, ended = run.curve, run.ended
        except Exception as error:
            failure = str(error) if isinstance(error, ValueError | RuntimeError) else f"{type(error).__name__}: {error}"
        done(Outcome(member, curve, failure, time.perf_counter() - started, ended=ended))


def _together(task: Sequence[Member], tell, done) -> None:
    """Run members of equal shape in one vmap; those that end with a status, such as a worn list, run by themselves."""
    started = time.perf_counter()
    for member in task:
        tell(member.name, 0.0, 1.0)
    first = task[0].test
    try:
        inputs = [(_prepared(m.test), jax.tree.map(jnp.asarray, m.parameters)) for m in task]
        same = all(member.test is first for member in task)
        # A test that all share is not stored once for each of them.
        numbers = inputs[0][0] if same else _stacked([numbers for numbers, _ in inputs])
        curves = _many(same, numbers, _stacked([params for _, params in inputs]))
        curves = jax.tree.map(np.asarray, curves)
    except (ValueError, RuntimeError):  # such as memory: each by itself says what is wrong, or runs
        return _each(task, tell, done)
    acceptable = _acceptable()
    seconds = (time.perf_counter() - started) / len(task)
    for number, member in enumerate(task):
        curve = jax.tree.map(lambda values, number=number: values[number], curves)
        if curve.status or not acceptable(member):
            _each([member], tell, done)
            continue
        wanted = curve.axial_strain <= member.test.axial_strain
        if member.test.stages:
            wanted = _fresh([getattr(curve, name) for name in records_of(curve)])
        curve = replace(curve, **{name: getattr(curve, name)[wanted] for name in records_of(curve)})
        warn_of_chatter(curve)
        tell(member.name, 1.0, float(curve.stress_ratio[-1]))
        done(Outcome(member, curve, None, seconds))


def _fresh(records: Sequence[np.ndarray]) -> np.ndarray:
    """Which of T records do not repeat the one before, as `simulate` does once a stage has ended."""
    repeats = [np.equal(values[1:], values[:-1]) | np.isnan(values[1:]) for values in records]
    return np.concatenate([[True], ~np.all(repeats, axis=0)])


@partial(jax.jit, static_argnums=0)
def _many(same: bool, prepared, params):
    return jax.vmap(simulate, in_axes=(None if same else 0, 0))(prepared, params)


def _prepared(test: TriaxialTest):
    return jax.tree.map(jnp.asarray, test.prepared)


def _stacked(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _acceptable() -> Callable[[Member], bool]:
    """Whether a test takes a member's parameters at all (`run` says why not); the critical step is found once for
    parameters that differ in friction only, on which it does not depend.
    """
    limits: dict[Any, float] = {}

    def acceptable(member: Member) -> bool:
        test, params = member.test, member.parameters
        try:
            check_params(params, len(test.cut))
            if not test.allow_unsafe_step:
                values = (value for name, value in values_of(params).items() if name != "friction")
                known = (id(test), jax.tree.structure(params), *values)
                if known not in limits:
                    limits[known] = critical_time_step(test.scene, params, test.network)
                check_step(test.prepared.time_step, limits[known])
        except ValueError:
            return False
        return True

    return acceptable


def _chunks(members: Sequence[Member]) -> list[list[Member]]:
    """Members that one compiled program can run together: same structure and shapes."""
    groups: dict[Any, list[Member]] = {}
    for member in members:
        leaves, structure = jax.tree.flatten((_prepared(member.test), member.parameters))
        shapes = tuple((np.shape(leaf), str(jnp.result_type(leaf))) for leaf in leaves)
        groups.setdefault((structure, shapes), []).append(member)
    return [group[i : i + CHUNK] for group in groups.values() for i in range(0, len(group), CHUNK)]


def _check_names(names: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for name in names:
        if slug(name) in seen:
            raise ValueError(f"member '{name}': its name must differ from that of member '{seen[slug(name)]}'.")
        seen[slug(name)] = name


def _unrun(member: Member) -> Stored:
    return Stored(member.name, member.test, member.parameters, dict(member.labels))


def _stored(outcome: Outcome) -> Stored:
    return replace(_unrun(outcome.member), curve=outcome.curve, seconds=outcome.seconds, ended=outcome.ended)
