"""A study: several tests of one sand, fitted together on random packings, and tests held out that are predicted.

    fit = fit_study(
        [StudyTest("100 kPa", curve, scene, 1e5), StudyTest("200 kPa", other, scene, 2e5, held_out=True)],
        "friction,normal_stiffness,rolling_friction",
    )
    print(fit)

Runs are made on packings of their own, first evenly over the box of the parameters, then where the posterior is, until
the surface through them costs little beside what the data themselves leave open, or the runs are spent. All of them are
in the library (`calibrate.library`), so a study that was killed goes on where it was, and the next data set of the same
scene begins with them.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from axijax.core.bars import counting
from axijax.core.fingerprint import fingerprint
from calibrate.axes import Axis, axes_of, prior_density
from calibrate.ensemble import FIRST_SEED, design, run_all
from calibrate.ground import Ground, own_scene
from calibrate.library import Library, StoredRun
from calibrate.measured import DataError, MeasuredCurve
from calibrate.nodes import Nodes, nodes_of, of_a_laboratory
from calibrate.parameters import Prior
from calibrate.posterior import Compared, compared
from calibrate.sampling import Sample, sample
from calibrate.scene import RandomScene
from calibrate.study_result import StudyFit, concluded
from calibrate.study_verdict import open_ones
from calibrate.surrogate import least_runs

LABORATORY = float("inf")  # grains of a laboratory's test, over those of a packing
BATCH = 8  # runs that are placed at once
KNOWN = 0.8  # share of a parameter's variance that the data leave; above it, further runs would hardly narrow it
LEAST_POINTS = 5
UNLIKELY = 0.01  # chance below which a misfit is more than scatter


@dataclass(frozen=True)
class StudyTest:
    """One test of a study.

    curve: what was measured. scene: packings that stand for its specimen. confining_stress: of the test, in the scene's
    units; None takes the scene's.
    packings: that the data are the mean of: LABORATORY, or 1 for a curve of one simulated specimen.
    void_ratio: of the specimen at the beginning of the shear; None where it is not known, which costs precision, as
        packings differ most by it [-].
    held_out: predicted, never fitted. weight: on its log likelihood [-].

    Raises ValueError for numbers that make no sense.
    """

    name: str
    curve: MeasuredCurve
    scene: RandomScene
    confining_stress: float | None = None
    packings: float = 1.0
    void_ratio: float | None = None
    held_out: bool = False
    weight: float = 1.0

    def __post_init__(self) -> None:
        for name in ("confining_stress", "packings", "void_ratio", "weight"):
            value = getattr(self, name)
            if value is not None and not (value > 0 and (np.isfinite(value) or name == "packings")):
                raise ValueError(f"{name} = {value!r} of test '{self.name}': must be positive.")
        if self.packings < 1:
            raise ValueError(f"packings = {self.packings:g} of test '{self.name}': must be 1 or more.")

    @property
    def stress(self) -> float:
        return self.scene.stress if self.confining_stress is None else self.confining_stress


def first_runs(dims: int) -> int:
    """Runs before the first fit."""
    return max(8 * dims, least_runs(dims + 1))


def fit_study(
    tests: Sequence[StudyTest],
    names: Sequence[str] | str,
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, Prior] | None = None,
    own: Sequence[str] | str = (),
    runs: int = 40,
    further: int = 10,
    precision: float | None = None,
    seed: int = 0,
    library: Path | str | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    report: Callable[[str], object] = lambda text: None,
    progress: Callable[[int, int, StoredRun], object] | bool = False,
) -> StudyFit:
    """Fit parameters to the tests that are not held out, and predict all of them.

    names: parameters or symbols (friction, kn, ks/kn, eta_r..). bounds: {name: (lower, upper)} of the box in which they
        are sought, evenly likely in the log (logit of friction) beforehand. priors: {name: Prior} beyond that.
    own: those of the names that each test has for itself; the others are shared.
    runs: most runs of one packing for the first fit of a scene; further: for a fit of a scene whose library holds a
        first fit's runs already.
    precision: standard deviation of the logarithm of each parameter (of a rolling friction itself) that is enough;
        None stops where further runs would hardly narrow the answer.
    seed: of design and samples. library: folder of libraries, see `calibrate.library`.
    executor, workers: see `calibrate.ensemble.run_all`.
    report: called with lines of text. progress: True for a bar in the terminal or the notebook; or a function, called
        with runs made, runs wanted at most, and the run.

    Raises ValueError for what cannot be fitted, RuntimeError where too few runs are sound to lay a surface.
    """
    _check(tests, runs, further, precision)
    for test in tests:
        if len(test.curve) < LEAST_POINTS:
            raise DataError(f"'{test.name}': {len(test.curve)} points are too few for a fit on random packings.")
    axes, places = _layout(tests, names, bounds, own)
    priors = _priors(axes, priors)
    nodes = [nodes_of(test.curve) for test in tests]
    nodes = [each if np.isfinite(t.packings) else of_a_laboratory(each) for t, each in zip(tests, nodes, strict=True)]
    grounds = _grounds(tests, nodes, axes, places, library)
    with counting(progress) as count:
        spent = _Spent(runs, further, report, count, executor, workers)
        for ground in grounds:
            ground.read()
            spent.begin(ground)
        for ground in grounds:
            _first(ground, spent, seed)
        while True:
            fitted, held = _compared(tests, nodes, places, grounds)
            found = _sampled(fitted, axes, priors, seed)
            fitted, found = _slackened(fitted, found, axes, priors, seed)
            shares = _known_shares(fitted, axes, found)
            known = bool((shares >= KNOWN).all()) if precision is None else _precise(axes, found, precision)
            enough = known and not open_ones(found).any()
            report(_standing(axes, found, sum(len(g.ground.runs) for g in grounds)))
            if enough or not any(spent.left(g) for g in grounds):
                break
            for ground in grounds:
                _more(ground, spent, axes, found, tests, places, seed)
    return concluded(
        tests, fitted, held, axes, found, shares, known, precision, priors,
        made=spent.made, failed=[run for g in grounds for run in g.ground.failed],
        used=sum(len(g.ground.runs) for g in grounds), seconds=spent.seconds, seed=seed,
    )  # fmt: skip


def _check(tests: Sequence[StudyTest], runs: int, further: int, precision: float | None) -> None:
    if not tests or all(test.held_out for test in tests):
        raise ValueError("a study needs at least one test that is not held out.")
    names = [test.name for test in tests]
    if len(set(names)) < len(names):
        raise ValueError(f"tests are named {', '.join(names)}: each needs a name of its own.")
    for name, value in (("runs", runs), ("further", further)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise ValueError(f"{name} = {value!r}: must be a whole number, 0 or more.")
    if precision is not None and not (np.isfinite(precision) and precision > 0):
        raise ValueError(f"precision = {precision!r}: must be positive, 0.05 is about 5 %.")


def _layout(tests, names, bounds, own) -> tuple[list[Axis], list[list[int]]]:
    """All axes, and for each test the places of its parameters among them. Own ones are named with their test."""
    first = axes_of(tests[0].scene, names, bounds)
    known = {axis.name for axis in first}
    chosen = own.split(",") if isinstance(own, str) and own else list(own)
    alone = {axis.name for axis in axes_of(tests[0].scene, chosen)} if chosen else set()
    if alone - known:
        raise ValueError(f"own = {', '.join(alone - known)}: not among the fitted, {', '.join(known)}.")
    shared = [axis for axis in first if axis.name not in alone]
    axes, places = list(shared), []
    for test in tests:
        if test.held_out and alone:
            raise ValueError(
                f"test '{test.name}' is held out, so nothing tells its own {', '.join(alone)}: share them."
            )
        mine = {axis.name: k for k, axis in enumerate(shared)}
        for axis in first:
            if axis.name in alone:
                mine[axis.name] = len(axes)
                axes.append(replace(axis, label=f"{axis.name} of {test.name}"))
        places.append([mine[axis.name] for axis in first])
    return axes, places


def _priors(axes: Sequence[Axis], priors: Mapping[str, Prior] | None) -> dict[str, Prior]:
    found = {}
    for name, prior in (priors or {}).items():
        full = next((axis.name for axis in axes if name == axis.name or name in axis.about.symbols), None)
        if full is None:
            raise ValueError(f"a prior is given for '{name}', which is not fitted.")
        found[full] = prior
    return found


@dataclass
class _Shared:
    """A ground, the numbers of the tests that stand on it, and how far its runs must go."""

    ground: Ground
    tests: list[int]
    reach: float
    own: list[int]  # tests that are fitted

    def read(self) -> None:
        self.ground.read(self.reach)


def _grounds(tests, nodes: Sequence[Nodes], axes, places, library) -> list[_Shared]:
    together: dict[str, list[int]] = {}
    scenes = []
    for number, test in enumerate(tests):
        mine = [axes[place] for place in places[number]]
        scene = own_scene(test.scene, mine, test.stress)
        scenes.append(scene)
        together.setdefault(json.dumps([scene.parts, sorted(scene.values().items())]), []).append(number)
    found = []
    for numbers in together.values():
        first = numbers[0]
        mine = [axes[place] for place in places[first]]
        stresses = [tests[n].stress for n in numbers]
        ground = Ground(scenes[first], mine, stresses, Library(scenes[first], library))
        fitted = [n for n in numbers if not tests[n].held_out]
        found.append(_Shared(ground, numbers, max(nodes[n].reach for n in numbers), fitted))
    return found


class _Spent:
    """What a study may still run, and how it runs it."""

    def __init__(self, runs, further, report, progress, executor, workers) -> None:
        self.runs, self.further, self.report, self.progress = runs, further, report, progress
        self.executor, self.workers = executor, workers
        self.allowed: dict[int, int] = {}
        self.made, self.seconds, self.wanted = 0, 0.0, 0

    def begin(self, shared: _Shared) -> None:
        known, first = len(shared.ground.runs), min(first_runs(shared.ground.dims), self.runs)
        allowed = self.runs - known if known < first else self.further
        dims, least = shared.ground.dims, least_runs(shared.ground.dims + 1)
        if known + allowed < least:
            raise ValueError(
                f"runs = {self.runs}: a surface in {dims} parameter{'s' * (dims > 1)} needs at least {least} of one "
                f"scene, of which the library holds {known}: allow more."
            )
        self.allowed[id(shared)] = max(allowed, 0)
        self.wanted += max(allowed, 0)
        if known:
            self.report(f"the library holds {known} runs of this scene in {shared.ground.library.folder}")

    def left(self, shared: _Shared) -> int:
        return self.allowed[id(shared)]

    def run(self, shared: _Shared, jobs) -> None:
        self.allowed[id(shared)] -= len(jobs)

        def finished(run: StoredRun) -> None:
            self.made += 1
            self.seconds += run.seconds
            if run.failed:
                self.report(f"a run failed: {run.failed}")
            self.progress(self.made, self.wanted, run)

        ground = shared.ground
        run_all(ground.scene, jobs, shared.reach, ground.library, self.executor, self.workers, finished)
        shared.read()


def _first(shared: _Shared, spent: _Spent, seed: int) -> None:
    """Runs evenly over the box, until there are enough for a first surface."""
    ground = shared.ground
    wanted, place = first_runs(ground.dims), 0
    points = design(2 * wanted, ground.dims, seed)
    while len(ground.runs) < wanted and spent.left(shared) and place < len(points):
        count = min(wanted - len(ground.runs), spent.left(shared), len(points) - place)
        jobs = [(ground.point(points[k]), FIRST_SEED + k) for k in range(place, place + count)]
        place += count
        known = [ground.library.find(point, number, shared.reach) for point, number in jobs]
        spent.allowed[id(shared)] += sum(run is not None for run in known)
        spent.run(shared, jobs)
    least = least_runs(ground.dims + 1)
    if len(ground.runs) < least:
        told = f"; the last that failed: {ground.failed[-1].failed}" if ground.failed else ""
        raise RuntimeError(
            f"{len(ground.runs)} sound runs, of {least} that a surface in {ground.dims} parameter(s) needs "
            f"({len(ground.failed)} failed): allow more runs, or narrower bounds{told}."
        )


def _more(shared: _Shared, spent: _Spent, axes, found: Sample, tests, places, seed: int) -> None:
    """Runs where the posterior is, as far from one another and from what was run as there is room."""
    ground, count = shared.ground, min(BATCH, spent.left(shared))
    if not count:
        return
    values = _values(axes, found.points[found.draws(400, seed)])
    x = np.concatenate([ground.x(values[:, places[n]], tests[n].stress) for n in shared.tests])
    x = np.clip(x, -1, 1)
    spread = np.maximum(x.std(0), 0.02)
    taken, chosen = list(ground.run_x()), []
    for _ in range(count):
        apart = np.min([(((x - each) / spread) ** 2).sum(1) for each in taken], axis=0)
        best = x[int(apart.argmax())]
        taken.append(best)
        chosen.append(best)
    first = max(ground.used_seeds(), FIRST_SEED + 10_000)
    spent.run(shared, [(ground.point((point + 1) / 2), first + k) for k, point in enumerate(chosen)])


def _compared(tests, nodes, places, grounds) -> tuple[list[Compared], list[Compared]]:
    fitted: dict[int, Compared] = {}
    held: dict[int, Compared] = {}
    for shared in grounds:
        for number in shared.tests:
            test = tests[number]
            made = compared(
                test.name, nodes[number], shared.ground, test.stress, places[number], test.packings, test.void_ratio,
                sharing=max(len(shared.own), 1) if not test.held_out else 1, weight=test.weight,
            )  # fmt: skip
            (held if test.held_out else fitted)[number] = made
    return [fitted[n] for n in sorted(fitted)], [held[n] for n in sorted(held)]


def _values(axes: Sequence[Axis], shares: np.ndarray) -> np.ndarray:
    """(n, P) physical values at (n, P) shares of the box."""
    return np.stack([axis.from_unit(shares[:, k]) for k, axis in enumerate(axes)], axis=1)


def _sampled(fitted: Sequence[Compared], axes, priors, seed: int) -> Sample:
    def density(points):
        values = _values(axes, points)
        return prior_density(axes, priors, points) + sum(one.log_likelihood(values) for one in fitted)

    return sample(density, len(axes), seed=seed)


def _slackened(fitted: list[Compared], found: Sample, axes, priors, seed: int) -> tuple[list[Compared], Sample]:
    """Where the surface cannot reach data, their covariance is widened until it does, so that the intervals of what is
    fitted all the same say how far it can be trusted."""
    for _ in range(2):
        values = _values(axes, found.points[found.draws(200, seed)])
        best = _values(axes, found.points[[int(found.log_likelihood.argmax())]])
        slack = [
            max(1.0, float(one.misfit(best)[0][0]) / one.count) if one.chance(values) < UNLIKELY else 1.0
            for one in fitted
        ]
        if max(slack) == 1.0:
            break
        fitted = [replace(one, slack=one.slack * more) for one, more in zip(fitted, slack, strict=True)]
        found = _sampled(fitted, axes, priors, seed)
    return fitted, found


def _known_shares(fitted: Sequence[Compared], axes, found: Sample) -> np.ndarray:
    """(P,) share of each parameter's variance that would be left if the surface were known: 1 where further runs would
    not narrow it, 0 where they are all that is missing."""
    values = _values(axes, found.points)
    more = sum(one.log_likelihood(values, surface=False) - one.log_likelihood(values) for one in fitted)
    with np.errstate(over="ignore"):
        weights = found.weights * np.exp(np.clip(more - np.max(more), -700, 0))
    weights /= weights.sum()
    if 1 / (weights**2).sum() < 50:  # so much narrower that this sample cannot say how much
        return np.zeros(len(axes))
    centred = found.points - weights @ found.points
    return np.clip((weights @ centred**2) / np.diag(found.covariance), 0, 1)


def _precise(axes, found: Sample, precision: float) -> bool:
    return bool((spreads(axes, found) <= precision).all())


def spreads(axes: Sequence[Axis], found: Sample) -> np.ndarray:
    """(P,) standard deviation of the logarithm of each parameter, of the parameter itself where it may be zero."""
    values = _values(axes, found.points)
    logs = [v if axis.about.coordinate == "linear" else np.log(v) for axis, v in zip(axes, values.T, strict=True)]
    return np.array([np.sqrt(found.weights @ (each - found.weights @ each) ** 2) for each in logs])


def _standing(axes, found: Sample, used: int) -> str:
    low, middle, high = (_values(axes, row[None])[0] for row in found.quantiles([0.025, 0.5, 0.975]))
    told = ", ".join(
        f"{axis.label or axis.name} {m:.4g} ({a:.4g} to {b:.4g})"
        for axis, a, m, b in zip(axes, low, middle, high, strict=True)
    )
    return f"after {used} runs: {told}"


def identity(tests: Sequence[StudyTest], names: Sequence[str] | str, options: Mapping) -> dict[str, str]:
    """What is fitted to what, as parts; how many runs it may take does not count."""
    asked = {name: options.get(name) or None for name in ("bounds", "priors", "own")}
    names = names.split(",") if isinstance(names, str) else list(names)
    parts = fingerprint({"names": [name.strip() for name in names], **asked}, "fit")
    for number, test in enumerate(tests, 1):
        name = f"test.{number}"
        parts |= {f"{name}.scene.{part}": value for part, value in test.scene.parts.items()}
        parts |= fingerprint(test.scene.values(), f"{name}.parameters")
        data = fingerprint(test.curve, f"{name}.data")
        parts |= {part: value for part, value in data.items() if part != f"{name}.data.source"}
        told = (test.confining_stress, test.packings, test.void_ratio, test.held_out, test.weight)
        parts |= fingerprint(told, f"{name}.how")
    return parts
