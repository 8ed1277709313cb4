"""axijax as a process of its own, apart from its harness: sets up and compiles once, then runs whenever it is told.

    python axijax_shear.py '{"specimen": {"layers": 7}, "order": 1}'

Started by `peers.Ours`, pinned to its cores before JAX counts them. Prints a line of JSON when it is ready, and one for
every line of JSON on its standard input: {} runs once more, {"friction": 0.2} with that friction.

Options: specimen (of fcc_octagon, or of a random packing: balls, radii from and to, seed, friction of its compaction),
inertial_number (of the shear, in place of a platen speed), order, test (of TriaxialTest), params, damping ("dashpot" or
"local"), dtype, share (of the critical time step), lattice (rotation blocked, stiffness times ten, loaded as the
infinite lattice), and
what: "shear" is the shear alone from the confined state, `blocks` records of 50 steps with fixed cells, as the peers do
    it; "run" is that by `TriaxialTest.run` to the test's strain, for random packings, whose lists have to be rebuilt;
    "whole" is confinement and shear, what a user waits for; "slopes" is the shear of the test, read by peak
    functionals, for derivatives with respect to friction, on which the confined state does not depend.
tangents: 0, 1 (friction) or 3 (and both stiffnesses), forward mode. reverse: for "slopes", the gradient of the window
    mean in reverse mode.
tests: for "shear", so many at once: in as many threads as cores on a CPU, by vmap elsewhere; for "batch", members of an
    `axijax.app.batch.run_batch` of whole tests, friction from 0.05 to 0.3.
least_seconds: repeat the run until so much time has passed, and report the time of one.
scene: file for the peers, written once confined.
"""

import json
import os
import resource
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

BEGAN = time.perf_counter()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import peers  # noqa: E402

import axijax  # noqa: E402
from axijax.mechanics.time_step import DEFAULT_STEP  # noqa: E402
from axijax.triaxial.engine import fixed_load, march  # noqa: E402
from axijax.triaxial.progress import begin  # noqa: E402
from axijax.triaxial.records import make_curve  # noqa: E402
from axijax.triaxial.stages import start_shear  # noqa: E402

LARGE = 3000  # balls from which the search for the critical step takes longer than what is timed
DIRECTIONS = ("friction", "normal_stiffness", "shear_stiffness")


def make_specimen(options, sector):
    """The lattice, or a random packing; and the friction with which it was compacted."""
    asked = dict(options.get("specimen", {}))
    if "balls" not in asked:
        return axijax.fcc_octagon(**asked), 0.0
    smallest, largest = asked.pop("radii", (20.0, 20.0))
    grading = axijax.grading.uniform(smallest) if smallest == largest else axijax.grading.linear(smallest, largest)
    friction = asked.pop("friction", 0.05)
    specimen, _ = axijax.random_cylinder(asked.pop("balls"), sector, grading, compaction_friction=friction, **asked)
    return specimen, friction


def make_test(options) -> axijax.TriaxialTest:
    sector = axijax.Sector(options.get("order", 4))
    specimen, compacted_with = make_specimen(options, sector)
    scene = axijax.Scene()
    damping = {"dashpot": {}, "local": {"damping": axijax.LocalDamping()}}[options.get("damping", "dashpot")]
    params = axijax.Params(**damping, **options.get("params", {}))
    if "inertial_number" in options:
        params = replace(params, platen_speed=axijax.platen_speed(options["inertial_number"], specimen, params))
    keywords = {"tolerance": 1e-2, "dtype": np.dtype(options.get("dtype", "float64")).type, **options.get("test", {})}
    keywords["confining_friction"] = compacted_with
    if options.get("lattice"):
        from axijax.mechanics.lattice_load import lattice_load

        scene = replace(scene, rotation=False)
        stiffness = 10 * params.normal_stiffness
        params = replace(params, normal_stiffness=stiffness, shear_stiffness=stiffness)
        keywords["lateral_load"] = lattice_load(specimen, sector)
    if len(specimen) // sector.order >= LARGE and not compacted_with:
        # The critical step of the lattice is that of a few layers of it.
        small = axijax.TriaxialTest(axijax.fcc_octagon(layers=7), axijax.Sector(4), scene, params)
        known = {"time_step": small.prepared.time_step, "allow_unsafe_step": True}
        return axijax.TriaxialTest(specimen, sector, scene, params, **known, **keywords)
    test = axijax.TriaxialTest(specimen, sector, scene, params, **keywords)
    share = options.get("share", DEFAULT_STEP)
    return test if share == DEFAULT_STEP else replace(test, time_step=test.prepared.time_step * share / DEFAULT_STEP)


def functionals(curve):
    from calibrate.targets import HardPeak, WindowMean

    return jnp.stack([HardPeak()(curve), WindowMean()(curve)])


def _steps(run, test) -> int:
    """How many a run's shear took."""
    return round(float(run.state.time) / test.prepared.time_step)


class Program:
    """A compiled run: arguments kept, called with a friction."""

    def __init__(self, options):
        self.test = test = make_test(options)
        self.options = options
        params = jax.tree.map(lambda x: jnp.asarray(x, test.dtype), test.params)
        if options.get("what") == "run":
            self._run(options, test)
            return
        if options.get("what", "shear") in ("whole", "batch"):
            function, rest = (lambda params: test.simulate(params)), ()
        else:
            function, rest = self._shear(options, test)
        self.arguments = (params, *rest)
        began = time.perf_counter()
        self.compiled = jax.jit(self._many(self._differentiated(function))).lower(*self.arguments).compile()
        self.compile_seconds = time.perf_counter() - began

    def _run(self, options, test):
        """The shear by `run`, from the confined state without springs."""
        start = begin(test, test.params)
        state = start.state._replace(memory=jax.tree.map(jnp.zeros_like, start.state.memory))
        start = start._replace(state=state)
        if "scene" in options:
            peers.write_scene(Path(options["scene"]), test, start.network, state, start.fixed)
        self.compiled, self.arguments = lambda params: test.run(start=start), (None,)
        began = time.perf_counter()
        self.steps = _steps(self(), test)
        self.compile_seconds = time.perf_counter() - began

    def _shear(self, options, test):
        confined, balance = test.confine()
        prepared = test.prepared
        state = start_shear(test.scene, test.params, prepared.lists, confined)
        slopes = options.get("what") == "slopes"
        records = prepared.numerics.records if slopes else options["blocks"]
        fixed = fixed_load(slopes and test.refresh, prepared.lateral_load, prepared.lists, state)
        if "scene" in options:
            peers.write_scene(Path(options["scene"]), test, prepared.network, state, fixed)
        self.steps = records * test.record_every

        def function(params, prepared, state, fixed):
            lists, dt = prepared.lists, prepared.time_step
            size = records, test.record_every, 0
            seen = march(test.scene, prepared.shear, *size, lists, dt, params, state, fixed)[1]
            return functionals(make_curve(seen, balance)) if slopes else seen.stress_ratio

        return function, (prepared, state, fixed)

    def _many(self, function):
        """All tests in one program, off the CPU."""
        tests = self.options.get("tests", 1)
        if tests == 1 or jax.default_backend() == "cpu":
            return function

        def many(params, *rest):
            frictions = jnp.full(tests, params.friction)
            return jax.vmap(lambda friction: function(replace(params, friction=friction), *rest))(frictions)

        return many

    def _differentiated(self, function):
        tangents = self.options.get("tangents", 0)
        if self.options.get("reverse"):
            return jax.value_and_grad(lambda params, *rest: function(params, *rest)[1])
        if not tangents:
            return function

        def along(params, rest, direction):
            return jax.jvp(lambda p: function(p, *rest), (params,), (direction,))

        def unit(params, name):
            return replace(jax.tree.map(jnp.zeros_like, params), **{name: jnp.ones_like(getattr(params, name))})

        def with_tangents(params, *rest):
            units = [unit(params, name) for name in DIRECTIONS[:tangents]]
            if tangents == 1:
                return along(params, rest, units[0])
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *units)
            return jax.vmap(lambda d: along(params, rest, d), out_axes=(None, 0))(stacked)

        return with_tangents

    def __call__(self, friction=None):
        params, *rest = self.arguments
        if friction is not None:
            params = replace(params, friction=jnp.asarray(friction, self.test.dtype))
        return jax.block_until_ready(self.compiled(params, *rest))

    def describe(self):
        """What is known before a run: balls, steps, seconds, memory, the program's traffic."""
        held = {}
        if hasattr(self.compiled, "memory_analysis"):
            memory = self.compiled.memory_analysis()
            sizes = memory.temp_size_in_bytes, memory.argument_size_in_bytes, memory.output_size_in_bytes
            held = {"program_bytes": sum(sizes)}
        return {
            "version": f"axijax, jax {jax.__version__}",
            "device": jax.devices()[0].device_kind,
            "platform": jax.default_backend(),
            "balls": len(self.test.cut),
            "steps": getattr(self, "steps", 0),
            "time_step": self.test.prepared.time_step,
            "compile_seconds": self.compile_seconds,
            "setup_seconds": time.perf_counter() - BEGAN - self.compile_seconds,
            **held,
            "resident_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            **({"traffic": self.traffic()} if self.options.get("traffic") else {}),
        }

    def traffic(self):
        """Bytes moved per ball-step: as the compiled step does it, and at the least (everything once); and the
        device's bandwidth [bytes/s], measured by a copy far larger than its caches."""
        from axijax.mechanics.dynamics import make_step

        params, prepared, state, fixed = self.arguments
        network = prepared.network
        step = jax.jit(make_step(self.test.scene, prepared.shear.platen_speeds))
        cost = step.lower(params, network, fixed, prepared.time_step, state).compile().cost_analysis()
        nbytes = [sum(x.nbytes for x in jax.tree.leaves(tree) if hasattr(x, "nbytes")) for tree in (network, state)]
        big = jnp.zeros(2**27 if jax.default_backend() != "cpu" else 2**25, jnp.float32)
        copy = jax.jit(lambda x: x + 1)
        copy(big).block_until_ready()
        best = np.inf
        for _ in range(5):
            began = time.perf_counter()
            copy(big).block_until_ready()
            best = min(best, time.perf_counter() - began)
        balls = len(self.test.cut)
        return {
            "compiled": cost["bytes accessed"] / balls,
            "least": (nbytes[0] + 2 * nbytes[1]) / balls,
            "bandwidth": 2 * big.nbytes / best,
        }


def batch(program: Program, tests: int) -> dict:
    """One reply for a batch of whole tests."""
    from axijax.app.batch import parameter_grid, run_batch

    test = program.test
    members = parameter_grid(test, friction=np.linspace(0.05, 0.3, tests).tolist())
    began = time.perf_counter()
    result = run_batch(members)
    seconds = time.perf_counter() - began
    if result.failures:
        raise RuntimeError(f"batch: {result.failures}")
    shear = test.prepared.numerics.records * test.record_every
    steps = sum(float(curve.confinement.steps) + shear for curve in result.curves.values())
    return {"seconds": seconds, "steps": steps / tests}


def timed(program: Program, options, friction):
    """One reply: seconds of one run (of all its tests), and what came out."""
    tests, least = options.get("tests", 1), options.get("least_seconds", 0.0)
    if options.get("what") == "batch":
        return batch(program, tests)
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1
    together = tests > 1 and jax.default_backend() == "cpu"
    runs, began, spent = 0, time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(threads) as pool:
        while True:
            results = list(pool.map(program, [friction] * tests)) if together else [program(friction)]
            runs += 1
            seconds = time.perf_counter() - began
            if seconds > least:
                break
    reply, result = {"seconds": seconds / runs, "cpu_seconds": (time.process_time() - spent) / runs}, results[0]
    what = options.get("what", "shear")
    if what == "run":
        curve = result.curve
        steps = _steps(result, program.test)
        shown = {name: np.asarray(getattr(curve, name)).tolist() for name in ("axial_strain", "stress_ratio")}
        return reply | {"steps": steps, "records": len(curve.axial_strain)} | shown
    if what == "slopes" and options.get("reverse"):
        value, gradient = result
        reply |= {"window": value, "window_slope": gradient.friction}
    elif what == "slopes" and options.get("tangents"):
        (peak, window), (peak_slope, window_slope) = result
        reply |= {"peak": peak, "window": window, "peak_slope": peak_slope, "window_slope": window_slope}
    elif what == "slopes":
        reply |= {"peak": result[0], "window": result[1]}
    elif what == "whole":
        spent = int(result.confinement.steps)
        reply |= {
            "peak": result.stress_ratio.max(),
            "strain_at_peak": result.axial_strain[result.stress_ratio.argmax()],
            "steps": spent + program.test.prepared.numerics.records * program.test.record_every,
            "confine_steps": spent,
            "status": result.status,
        }
    return {key: float(value) for key, value in reply.items()}


def main() -> None:
    options = json.loads(sys.argv[1])
    axijax.fast_cpu_kernels()
    program = Program(options)
    if options.get("what") == "batch":
        batch(program, 1)  # compiles what a run needs
    print(json.dumps(program.describe()), flush=True)
    for line in sys.stdin:
        print(json.dumps(timed(program, options, json.loads(line).get("friction"))), flush=True)


if __name__ == "__main__":
    main()
