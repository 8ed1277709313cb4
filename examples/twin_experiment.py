"""Twin experiments: how many runs until hidden parameters are found again, by ours and by others.

    python examples/twin_experiment.py [--quick] [--starts N] [--specimen small|paper] [--problems 'f; f, kn']
        [--methods 'ours; differences'] [--output FOLDER] [--draw]

A curve R(eps) is made with hidden (f), (f, kn) and (f, kn, ks), bare, with 1 % noise and (f, kn) with 0.1 % scatter
from run to run. Each method begins at the same random starts, f in 0.02..0.5 and stiffness over a factor of 30,
searches in the same coordinates (logit f, log k) and box, and is counted in forward-equivalent runs, a tangent at its
measured cost. Solved: every parameter within 1 % (bare, scatter) or within two standard errors of the best possible fit
(noise: there even that fit itself misses now and then, by definition one time in eleven for two parameters; the dashed
line is the share of these starts in which it does not). GrainLearning draws its own first samples in the box, and its
20 samples of a round run together in one batch. Peers are used where importable: cma, grainlearning (development
extras). Written: twin_experiment.csv, one row a start, and twin_experiment.png, fraction solved against runs: for each
number of runs the share of starts whose best point so far is right, a dot where the method stopped by itself.

--quick: the small specimen, (f, kn) only, three starts; a few minutes on one core. --draw: only draw the table that is
in the folder. Each method may spend 200 runs, Adam 50 passes. Stopped and started again with the same folder, the
program goes on behind the last row of the table.
"""

import argparse
import contextlib
import csv
import importlib.util
import io
import time
import warnings
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import axijax

axijax.fast_cpu_kernels()  # forward mode only, four times as fast; before anything is computed

import jax  # noqa: E402
import numpy as np  # noqa: E402

from axijax import Params  # noqa: E402
from axijax.specimen.specimen import fcc_octagon  # noqa: E402
from axijax.triaxial.test import TriaxialTest  # noqa: E402
from calibrate import MeasuredCurve, Model, ParameterSet, RunFailed, fit_by_descent, fit_parameters  # noqa: E402
from calibrate.evaluate import Evaluator  # noqa: E402

HIDDEN = {"friction": 0.17, "normal_stiffness": 2.1e9, "shear_stiffness": 1.3e9}
BOX = {"friction": (0.02, 0.5), "normal_stiffness": (1.5e9 / 30**0.5, 1.5e9 * 30**0.5)}
BOX["shear_stiffness"] = BOX["normal_stiffness"]
PROBLEMS = {"f": "f", "f, kn": "f,kn", "f, kn, ks": "f,kn,ks"}
CONDITIONS = ("bare", "noise 1 %", "scatter 0.1 %")
STRAINS = np.linspace(2e-4, 0.005, 60)
LIMIT = 200  # runs
COLOURS = {
    "ours": "C3",
    "ours from the rule": "C1",
    "ours, fresh tangents": "C4",
    "differences": "C0",
    "Adam": "C2",
    "CMA-ES": "C5",
    "GrainLearning, tutorial": "C7",
    "GrainLearning, defaults": "C8",
}


class Batched(Model):
    """A model that can run many points in one program, for methods that ask for them together."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._together, self._ready = jax.jit(jax.vmap(self.curve)), {}

    def prepare(self, points) -> None:
        """Run (B, P) points at once; `run` then hands them out."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a vmap on a CPU is slow, but not for so few balls
            fields = self._finished(self._together, np.asarray(points, float))
        for place, z in enumerate(points):
            self._ready[np.asarray(z, float).tobytes()] = {name: values[place] for name, values in fields.items()}

    def run(self, coordinates):
        fields = self._ready.pop(np.asarray(coordinates, float).tobytes(), None)
        if fields is None:
            return super().run(coordinates)
        self.cost.runs += 1
        return self._sound(fields)


class Scattered(Batched):
    """A model whose runs scatter by 0.1 %, the same for the same parameters; tangents are smooth."""

    def _sound(self, fields):
        curve = super()._sound(fields)
        seed = zlib.crc32(curve.stress_ratio.tobytes())
        wave = np.random.default_rng(seed).standard_normal(curve.stress_ratio.shape)
        curve.stress_ratio = curve.stress_ratio * (1 + 1e-3 * wave)
        return curve


@dataclass
class Problem:
    """One hidden curve to be found again."""

    label: str
    condition: str
    model: Model
    data: MeasuredCurve
    hidden: np.ndarray
    spread: np.ndarray  # standard errors of the coordinates in the best possible fit (noise)
    best: np.ndarray  # coordinates of the best possible fit

    def solved(self, z) -> bool:
        if self.condition.startswith("noise"):
            return bool((np.abs(z - self.hidden) <= 2 * self.spread).all())
        pair = [np.array(list(self.model.parameters.values(at).values())) for at in (z, self.hidden)]
        return bool((np.abs(pair[0] / pair[1] - 1) <= 0.01).all())


def history(evaluations, tangent_cost: float, data: MeasuredCurve):
    """(cost, coordinates) of the best point so far after each evaluation."""
    cost, best, least, rows = 0.0, None, np.inf, []
    for one in evaluations:
        cost += 1 + (tangent_cost * one.jacobian.shape[1] if one.jacobian is not None else 0)
        misfit = np.sum(((one.prediction - data.observed) / data.sigma) ** 2)
        if np.isfinite(misfit) and misfit < least:
            best, least = one.coordinates, misfit
        rows.append((cost, best))
    return rows


# ---- The methods: (problem, start, seed, most runs) -> (history, z at its own stop) ----


def by_fit(rule: bool = False, adam: bool = False, **options):
    def method(problem: Problem, start: dict, seed: int, limit: int):
        model = problem.model
        if adam:
            found = fit_by_descent(model, problem.data, "", start=start, learning_rate=0.15, steps=50)
        else:
            begin = "rule" if rule else start
            found = fit_parameters(model, problem.data, "", start=begin, max_runs=limit, **options)
        return history(found.evaluations, model.cost.tangent_cost, problem.data), found.coordinates

    return method


def by_cma(problem: Problem, start: dict, seed: int, limit: int):
    import cma

    low, high = problem.model.parameters.limits()
    evaluator = Evaluator(problem.model, problem.data)

    def misfit(x):
        one = evaluator.value(low + np.asarray(x) * (high - low))
        value = float(np.sum((one.prediction - problem.data.observed) ** 2))
        return value if np.isfinite(value) else 1e6

    begin = (problem.model.parameters.coordinates(start) - low) / (high - low)
    options = {"bounds": [0, 1], "seed": seed + 1, "verbose": -9, "maxfevals": limit, "tolx": 3e-4, "tolfun": 1e-10}
    search = cma.CMAEvolutionStrategy(begin, 0.25, options)
    search.optimize(misfit)
    rows = history(evaluator.evaluations, 0.0, problem.data)
    return rows, low + np.asarray(search.result.xbest) * (high - low)


def by_grainlearning(tutorial: bool):
    def method(problem: Problem, start: dict, seed: int, limit: int):
        from grainlearning import BayesianCalibration

        low, high = problem.model.parameters.limits()
        evaluator = Evaluator(problem.model, problem.data)

        def run(calibration):
            runs = []
            problem.model.prepare(calibration.system.param_data)
            for z in calibration.system.param_data:
                one = evaluator.value(z)
                sound = np.nan_to_num(one.prediction, nan=1e3)
                runs.append(np.array(sound, ndmin=2))
            calibration.system.set_sim_data(runs)

        # The package's linear regression tutorial; and what its classes take where nothing is said, in as many rounds.
        sampling = {"max_num_components": 1, "n_init": 1, "slice_sampling": True} if tutorial else {}
        system = {"sigma_tol": 0.01} if tutorial else {}
        calibration = BayesianCalibration.from_dict(
            {
                "num_iter": max(1, min(10, limit // 20)),
                "callback": run,
                "save_fig": -1,
                "threads": 1,
                "system": {
                    "param_min": low.tolist(),
                    "param_max": high.tolist(),
                    "param_names": list(problem.model.parameters.names),
                    "num_samples": 20,
                    "obs_names": ["R"],
                    "ctrl_name": "strain",
                    "obs_data": problem.data.observed,
                    "ctrl_data": problem.data.axial_strain,
                    "sim_name": "twin",
                    **system,
                },
                "inference": {"Bayes_filter": {"ess_target": 0.3}, "sampling": {**sampling, "random_state": seed}},
            }
        )
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                calibration.run()
                end = np.asarray(calibration.get_most_prob_params())
            except ValueError:  # its mixture model takes no NaN, into which its weights may have collapsed
                end = np.full(len(low), np.nan)
        return history(evaluator.evaluations, 0.0, problem.data), end

    return method


METHODS = {
    "ours": by_fit(),
    "ours from the rule": by_fit(rule=True),
    "ours, fresh tangents": by_fit(jacobian="tangent"),
    "differences": by_fit(jacobian="difference"),
    "Adam": by_fit(adam=True),
    "CMA-ES": by_cma,
    "GrainLearning, tutorial": by_grainlearning(True),
    "GrainLearning, defaults": by_grainlearning(False),
}
NEEDS = {"CMA-ES": "cma", "GrainLearning, tutorial": "grainlearning", "GrainLearning, defaults": "grainlearning"}
BEST = "best possible fit"
HEADER = ("problem", "condition", "method", "start", "runs_until_solved", "runs_at_stop", "solved_at_stop", "seconds")
IN_SCATTER = ("ours", "ours from the rule", "ours, fresh tangents", "differences")


def make_test(specimen: str) -> TriaxialTest:
    chosen = fcc_octagon() if specimen == "paper" else fcc_octagon(layers=5, half_width=5)
    test = TriaxialTest(
        chosen,
        params=Params(platen_speed=0.02, damping_ratio=0.2),
        axial_strain=0.0055,
        tolerance=1e-6,
        confine_steps=6000,
        record_every=20,
    )
    return replace(test, time_step=0.75 / 0.6 * test.prepared.time_step)


def make_problem(label: str, condition: str, models: dict, noise_seed: int) -> Problem:
    model = models[label, condition.startswith("scatter")]
    parameters = model.parameters
    hidden = parameters.coordinates({name: HIDDEN[name] for name in parameters.names})
    clean = models[label, False].run(hidden)
    ratio = np.interp(STRAINS, clean.axial_strain, clean.stress_ratio)
    noise = 0.01 if condition.startswith("noise") else 0.0
    ratio = ratio * (1 + noise * np.random.default_rng(1000 + noise_seed).standard_normal(ratio.size))
    spread, best = np.zeros(len(hidden)), hidden
    data = MeasuredCurve(STRAINS, ratio, ratio_sigma=0.01 * ratio, sigma_known=False)
    if noise:
        evaluator = Evaluator(models[label, False], data)
        for _ in range(3):  # Gauss-Newton from the answer, which is near
            one = evaluator.tangents(best, range(len(hidden)))
            slopes = one.jacobian / data.sigma[:, None]
            best = best - np.linalg.lstsq(slopes, (one.prediction - data.observed) / data.sigma)[0]
        spread = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    return Problem(label, condition, model, data, hidden, spread, best)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small specimen, (f, kn) only, three starts")
    parser.add_argument("--starts", type=int, help="random starts, 20 or 3 with --quick")
    parser.add_argument("--specimen", choices=("small", "paper"), default="small")
    parser.add_argument("--methods", help="separated by ';', part of: " + "; ".join(METHODS))
    parser.add_argument("--problems", default="; ".join(PROBLEMS), help="separated by ';', by default all: %(default)s")
    parser.add_argument("--output", default=".", help="folder for the table and the picture")
    parser.add_argument("--draw", action="store_true", help="only draw what twin_experiment.csv of that folder holds")
    options = parser.parse_args()
    if options.draw:
        redraw(Path(options.output))
        return
    starts = options.starts or (3 if options.quick else 20)
    wanted = [name.strip() for name in options.methods.split(";")] if options.methods else list(METHODS)
    unknown = [name for name in wanted if name not in METHODS]
    if unknown:
        parser.error(f"--methods: unknown {unknown}; take from {list(METHODS)}")
    for name in [name for name in wanted if name in NEEDS and importlib.util.find_spec(NEEDS[name]) is None]:
        print(f"{name}: package {NEEDS[name]} is not installed, left out")
        wanted.remove(name)

    test = make_test("small" if options.quick else options.specimen)
    labels = ["f, kn"] if options.quick else [name.strip() for name in options.problems.split(";")]
    if set(labels) - set(PROBLEMS):
        parser.error(f"--problems: take from {list(PROBLEMS)}, separated by ';'")
    models = {}
    for label in labels:
        names = PROBLEMS[label]
        base = (
            test
            if "k" in names
            else replace(
                test,
                params=replace(
                    test.params, normal_stiffness=HIDDEN["normal_stiffness"], shear_stiffness=HIDDEN["shear_stiffness"]
                ),
            )
        )
        parameters = ParameterSet.of(base.params, names, {n: BOX[n] for n in ParameterSet.of(base.params, names).names})
        model = Batched(base, parameters)
        cost = model.measure_tangent_cost(repeats=20)
        # The economical way runs fewer tangents in a pass, another program: compiled here, not within a fit.
        model.run_with_tangents(parameters.coordinates(), np.eye(len(parameters))[:1])
        model.run_with_tangents(parameters.coordinates(), np.eye(len(parameters))[: max(1, len(parameters) - 1)])
        print(f"({label}): {len(test.cut)} balls, a tangent costs {cost:.2f} runs when {len(parameters)} go together")
        rough = Scattered(base, parameters)
        rough._value, rough._pass, rough._together = model._value, model._pass, model._together
        rough.cost.tangent_cost = cost
        models[label, False], models[label, True] = model, rough

    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "twin_experiment.csv"
    curves = read_table(table) if table.exists() else {}
    with table.open("a", newline="") as file:
        writer = csv.writer(file)
        if not curves:
            writer.writerow(HEADER)
        for label, condition in [(label, condition) for label in labels for condition in CONDITIONS]:
            if condition.startswith("scatter") and label != "f, kn":
                continue
            methods = curves.setdefault((label, condition), {})
            for k in range(starts):
                problem = make_problem(label, condition, models, k)
                random = np.random.default_rng(k)
                values = {n: float(np.exp(random.uniform(*np.log(BOX[n])))) for n in problem.model.parameters.names}
                if "friction" in values:
                    values["friction"] = float(random.uniform(*BOX["friction"]))
                for name in [BEST, *wanted] if condition.startswith("noise") else wanted:
                    if (condition.startswith("scatter") and name not in IN_SCATTER) or (
                        name == "CMA-ES" and len(problem.hidden) == 1  # the package takes two parameters or more
                    ):
                        continue
                    rows = methods.setdefault(name, [])
                    if any(row[3] == k for row in rows):
                        continue
                    rows.append(row := one_row(problem, name, values, k))
                    writer.writerow([*row[:4], *(f"{x:.2f}" for x in row[4:6]), int(row[6]), f"{row[7]:.2f}"])
                    file.flush()
            report(label, condition, methods)
            draw(curves, folder / "twin_experiment.png")
    print(f"written: {table}, {folder / 'twin_experiment.png'}")


def one_row(problem: Problem, name: str, start: dict, k: int) -> list:
    """One method from one start: what a row of the table holds."""
    if name == BEST:
        path, end, seconds = [(0.0, problem.best)], problem.best, 0.0
    else:
        clock = time.perf_counter()
        try:
            path, end = METHODS[name](problem, start, k, LIMIT)
        except RunFailed:  # no start of its own gave a sound run
            path, end = [(float(LIMIT), None)], np.full(len(problem.hidden), np.nan)
        seconds = time.perf_counter() - clock
    right = [cost for cost, z in path if z is not None and problem.solved(z)]
    first = right[0] if right else np.inf
    return [problem.label, problem.condition, name, k, first, path[-1][0], problem.solved(end), seconds]


def read_table(path: Path) -> dict:
    """{(problem, condition): {method: rows}} of a table written before."""
    curves: dict = {}
    with path.open(newline="") as file:
        for label, condition, name, k, first, stop, right, seconds in list(csv.reader(file))[1:]:
            row = [label, condition, name, int(k), float(first), float(stop), bool(int(right)), float(seconds)]
            curves.setdefault((label, condition), {}).setdefault(name, []).append(row)
    return curves


def redraw(folder: Path) -> None:
    curves = read_table(folder / "twin_experiment.csv")
    for (label, condition), methods in curves.items():
        report(label, condition, methods)
    draw(curves, folder / "twin_experiment.png")


def report(label, condition, methods) -> None:
    print(f"\n({label}), {condition}")
    heads = {
        "method": -26,
        "starts": 7,
        "median runs": 12,
        "at stop": 9,
        "solved": 8,
        "right at stop": 15,
        "s a fit": 9,
    }
    print("".join(f"{head:>{width}s}" if width > 0 else f"{head:{-width}s}" for head, width in heads.items()))
    for name, rows in methods.items():
        first, stop = np.array([row[4] for row in rows]), np.array([row[5] for row in rows])
        solved, right = np.isfinite(first).mean(), np.mean([row[6] for row in rows])
        seconds = np.median([row[7] for row in rows])
        middle = np.median(first)
        print(
            f"{name:26s}{len(rows):7d}{middle:12.1f}{np.median(stop):9.1f}{solved:8.0%}{right:15.0%}{seconds:9.1f}",
            flush=True,
        )


def draw(curves, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(3, len(curves))
    lines = -(-len(curves) // columns)
    figure = Figure(figsize=(4.6 * columns, 3.6 * lines + 1), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in panels[len(curves) :]:
        axes.set_axis_off()
    shown: dict = {}
    for place, (axes, ((label, condition), methods)) in enumerate(zip(panels, curves.items(), strict=False)):
        starts = max(map(len, methods.values()))
        if BEST in methods:
            share = np.mean([row[6] for row in methods[BEST]])
            shown[BEST] = axes.axhline(share, color="k", ls="--", lw=1)
        for name in [name for name in COLOURS if name in methods]:
            rows = methods[name]
            first = np.sort([row[4] for row in rows])
            solved = np.isfinite(first)
            share = np.arange(1, len(first) + 1) / len(first)
            x, y = np.concatenate([[1], first[solved], [250]]), np.concatenate([[0], share[solved], [solved.mean()]])
            # Two peers of one package differ by dashes; ours lie on top.
            style = "--" if name.endswith("defaults") else "-"
            ours = name.startswith("ours")
            (shown[name],) = axes.step(
                x, y, where="post", color=COLOURS[name], ls=style, lw=2 if ours else 1.3, zorder=3 if ours else 2
            )
            stop, right = np.median([row[5] for row in rows]), np.mean([row[6] for row in rows])
            axes.plot(stop, right, "o", color=COLOURS[name], ms=5, mec="w", mew=0.6, zorder=4, clip_on=False)
        axes.set(
            xscale="log",
            xlim=(1, 250),
            ylim=(0, 1.04),
            xticks=(1, 2, 5, 10, 20, 50, 100, 200),
            title=f"({label}), {condition}, {starts} starts",
        )
        axes.set_xticklabels(["1", "2", "5", "10", "20", "50", "100", "200"])
        axes.minorticks_off()
        axes.grid(alpha=0.25)
        if place % columns == 0:
            axes.set_ylabel("fraction of starts solved")
        if place + columns >= len(curves):
            axes.set_xlabel("runs, a tangent at its cost")
    figure.suptitle("dots: median runs at the method's own stop, fraction right there", fontsize="medium")
    figure.legend(
        list(shown.values()), list(shown), frameon=False, loc="outside lower center", ncols=2 if columns == 1 else 5
    )
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
