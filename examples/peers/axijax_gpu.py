"""One part of `examples/gpu_check.py`, a process of its own: measures, and appends its rows to a file as they come.

    python axijax_gpu.py PART FOLDER [--small]

Each function of MEASURES yields rows, {column: value}; what goes wrong in one row is a sentence in its column "failed".
"""

import gzip
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parent.parent)]

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from axijax_shear import make_test  # noqa: E402
from gpu_check import REFERENCE, append  # noqa: E402

import axijax  # noqa: E402
from axijax.batch import parameter_grid, run_batch  # noqa: E402
from axijax.mechanics.dynamics import initial_state, make_step  # noqa: E402
from axijax.triaxial.engine import fixed_load, march  # noqa: E402

EVERY = 50  # steps from record to record
SIZES = {31252: (39, 25), 261225: (79, 51), 1017595: (109, 103)}  # balls: half_width and layers of the octagon
SMALL_SIZES = {209: (9, 3), 475: (9, 7)}
ENOUGH = 0.5  # seconds of one timing, at least
IN_GRAPHS = "FUSION,CUSTOM_CALL,DYNAMIC_SLICE_FUSION,WHILE,CONDITIONAL"
VARIANTS: dict[str, dict] = {
    "as JAX sets it": {},
    "loops within graphs": {"xla_gpu_enable_command_buffer": IN_GRAPHS},
    "the same, unrolled": {
        "xla_gpu_enable_command_buffer": IN_GRAPHS,
        "xla_gpu_command_buffer_unroll_loops": True,
    },
    "graphs of one kernel too": {"xla_gpu_graph_min_graph_size": 1},
    "two steps a turn": {"xla_gpu_enable_while_loop_unrolling": "WHILE_LOOP_UNROLLING_DOUBLE_BUFFER"},
}
BOTH = (np.float32, np.float64)
Rows = Iterator[dict[str, Any]]


@dataclass
class Shear:
    """A specimen ready to be sheared from rest: lists, state and load, of one dtype."""

    test: axijax.TriaxialTest
    prepared: axijax.Prepared
    state: Any
    load: Any
    dtype: Any

    @property
    def balls(self) -> int:
        return len(self.test.cut)

    def values(self, tests: int) -> tuple:
        """Friction, one for each test, and both stiffnesses."""
        params, dtype = self.test.params, self.dtype
        friction = jnp.linspace(0.2, 0.4, tests, dtype=dtype) if tests > 1 else jnp.asarray(0.3, dtype)
        return friction, jnp.asarray(params.normal_stiffness, dtype), jnp.asarray(params.shear_stiffness, dtype)

    def params(self, values: tuple) -> axijax.Params:
        friction, normal, shear = values
        return replace(self.test.params, friction=friction, normal_stiffness=normal, shear_stiffness=shear)


def from_rest(test: axijax.TriaxialTest, dtype) -> Shear:
    """`test` is prepared in float64 once, which takes half a minute of the host for a million balls."""

    @jax.jit
    def begin(prepared):
        of_type = lambda x: x.astype(dtype) if x.dtype == jnp.float64 else x  # noqa: E731
        network, membrane = jax.tree.map(of_type, prepared.lists)
        state = initial_state(test.scene, test.params, network, prepared.platens)
        return network, membrane, state, fixed_load(False, None, (network, membrane), state)

    network, membrane, state, load = begin(test.prepared)
    return Shear(test, replace(test.prepared, network=network, membrane=membrane), state, load, dtype)


@dataclass
class Job:
    """A program to compile and to time: `records` records of a shear of `tests` tests at once, with so many tangents.

    facts: columns of its row. step: whether to look at a single step as well. options: of XLA.
    """

    facts: dict[str, Any]
    shear: Shear
    records: int
    tests: int = 1
    tangents: int = 0
    step: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    def program(self) -> tuple[Callable, tuple]:
        """The stress ratios, and the arguments."""
        shear, test = self.shear, self.shear.test

        def value(values, prepared, state, load):
            size = self.records, EVERY, 0, prepared.lists, prepared.time_step
            return march(test.scene, prepared.shear, *size, shear.params(values), state, load)[1].stress_ratio

        def with_tangents(values, *rest):
            if self.tangents == 0:
                return value(values, *rest)
            if self.tangents == 1:
                return jax.jvp(lambda f: value((f, *values[1:]), *rest), values[:1], (jnp.ones_like(values[0]),))
            units = tuple(jnp.eye(len(values), dtype=shear.dtype))
            return jax.vmap(lambda *d: jax.jvp(lambda *v: value(v, *rest), values, d), out_axes=(None, 0))(*units)

        function = with_tangents if self.tests == 1 else self.batched(with_tangents, None, None, None)
        return function, (shear.values(self.tests), shear.prepared, shear.state, shear.load)

    def batched(self, function: Callable, *axes: int | None) -> Callable:
        """Over frictions; the lists have no batch axis."""
        return jax.vmap(function, in_axes=((0, None, None), *axes))

    def compile(self) -> tuple[Any, float, Any]:
        """The program, the seconds it took to compile, and a single step where that is asked for."""
        began = time.perf_counter()
        function, arguments = self.program()
        lowered = jax.jit(function).lower(*arguments)
        compiled = lowered.compile(compiler_options=self.options) if self.options else lowered.compile()
        return compiled, time.perf_counter() - began, self.one_step() if self.step else None

    def measure(self, compiled, compile_seconds: float, step) -> dict[str, Any]:
        arguments, times = self.program()[1], []
        result = jax.block_until_ready(compiled(*arguments))
        while sum(times) < ENOUGH and len(times) < 50:
            began = time.perf_counter()
            jax.block_until_ready(compiled(*arguments))
            times.append(time.perf_counter() - began)
        seconds = float(np.median(times)) / (self.records * EVERY)
        balls, memory = self.shear.balls * self.tests, compiled.memory_analysis()
        held = memory.temp_size_in_bytes + memory.argument_size_in_bytes + memory.output_size_in_bytes
        row = self.facts | {
            "balls": balls, "numbers": np.dtype(self.shear.dtype).name, "M ball-steps/s": balls / seconds / 1e6,
            "us a step": seconds * 1e6, "spread": f"{(max(times) - min(times)) / float(np.median(times)):.0%}",
            "compile s": compile_seconds, "program bytes/ball": held / balls, **peak_memory(),
        }  # fmt: skip
        if not all(np.isfinite(np.asarray(part)).all() for part in jax.tree.leaves(result)):
            row["failed"] = "results that are not finite"
        return row | ({} if step is None else self.traffic(step, seconds))

    def traffic(self, compiled, seconds: float) -> dict[str, Any]:
        """Of one step: kernels, bytes a ball, and the share of the measured bandwidth that its least bytes reach."""
        cost, memory = compiled.cost_analysis() or {}, compiled.memory_analysis()
        cost = cost[0] if isinstance(cost, list) else cost  # in older versions of JAX
        least = memory.argument_size_in_bytes + memory.output_size_in_bytes
        balls = self.shear.balls * self.tests
        return {
            "kernels": kernels(compiled.as_text()), "compiled bytes": cost.get("bytes accessed", np.nan) / balls,
            "least bytes": least / balls, "of the floor": f"{least / seconds / bandwidth():.1%}",
        }  # fmt: skip

    def one_step(self):
        shear, prepared, state = self.shear, self.shear.prepared, self.shear.state
        step = make_step(shear.test.scene, prepared.shear.platen_speeds)

        def one(values, state, network, load, dt):
            return step(shear.params(values), network, load, dt, state)

        if self.tests > 1:
            one = self.batched(one, 0, None, None, None)
            state = jax.tree.map(lambda x: jax.ShapeDtypeStruct((self.tests, *x.shape), x.dtype), state)
        arguments = shear.values(self.tests), state, prepared.network, shear.load, prepared.time_step
        return jax.jit(one).lower(*arguments).compile()


def timed(jobs: list[Job]) -> Rows:
    """Rows of jobs that are compiled side by side and then timed one by one."""
    with ThreadPoolExecutor(10) as pool:
        futures = [pool.submit(job.compile) for job in jobs]
    for job, future in zip(jobs, futures, strict=True):
        try:
            yield job.measure(*future.result())
        except Exception as error:
            yield job.facts | {"numbers": np.dtype(job.shear.dtype).name, "failed": sentence(error)}


def sentence(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


def kernels(text: str) -> int:
    """About how many instructions of a compiled program's entry start a kernel or a copy."""
    entry = text[text.rfind("\nENTRY") :]
    return len(re.findall(r" (?:fusion|copy|reduce|gather|scatter|custom-call|convert|while|call|sort)\(", entry))


def peak_memory() -> dict[str, float]:
    stats = jax.devices()[0].memory_stats() or {}  # a CPU has none
    return {"peak GB so far": stats["peak_bytes_in_use"] / 1e9} if "peak_bytes_in_use" in stats else {}


@cache
def bandwidth() -> float:
    """Bytes a second of a copy within the device's memory, those read and those written."""
    big = jnp.ones(2**24 if jax.default_backend() == "cpu" else 2**28, jnp.float32)
    copy, times = jax.jit(lambda x: x + 1), []
    for _ in range(10):
        began = time.perf_counter()
        copy(big).block_until_ready()
        times.append(time.perf_counter() - began)
    return 2 * big.nbytes / float(np.median(times[2:]))


def quarter(dtype) -> Shear:
    return from_rest(make_test({"test": {"axial_strain": 0.006}}), dtype)


def full(half_width: int, layers: int) -> axijax.TriaxialTest:
    shape = {"half_width": half_width, "layers": layers}
    return make_test({"specimen": shape, "order": 1, "test": {"axial_strain": 0.006}})


def device(folder: Path, small: bool) -> Rows:
    """The card, its memory's bandwidth, and what a turn of a loop costs that does next to nothing."""
    card = jax.devices()[0]
    row = {"what": card.device_kind, "platform": card.platform, "jax": jax.__version__, "cores": os.cpu_count()}
    query = ["nvidia-smi", "--query-gpu=memory.total,driver_version", "--format=csv,noheader"]
    try:
        row["memory, driver"] = subprocess.run(query, capture_output=True, text=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        row["memory, driver"] = "-"
    yield row | {"copy GB/s": bandwidth() / 1e9}
    turns = 2000
    loop = jax.jit(lambda x: jax.lax.scan(lambda x, _: (jnp.roll(x, 1) + 1, None), x, None, length=turns)[0])
    x = jax.block_until_ready(loop(jnp.ones(1000)))
    began = time.perf_counter()
    jax.block_until_ready(loop(x))
    yield {"what": "a turn of a scan with one small kernel", "us": (time.perf_counter() - began) / turns * 1e6}


def batches(folder: Path, small: bool) -> Rows:
    """Quarters by vmap."""
    shears = [quarter(dtype) for dtype in BOTH]
    for group in ((2,),) if small else ((512, 1), (64, 4096)):
        each = [(tests, shear) for tests in group for shear in shears]
        jobs = [Job({"what": f"{n} quarters"}, shear, 4 if n > 1 else 20, n, step=n != 64) for n, shear in each]
        yield from timed(jobs)


def sizes(folder: Path, small: bool) -> Rows:
    """One large lattice."""
    for balls, shape in (SMALL_SIZES if small else SIZES).items():
        facts, began = {"what": f"one cylinder of {balls}"}, time.perf_counter()
        try:
            test = full(*shape)
            jobs = [Job(facts, from_rest(test, dtype), 4, step=True) for dtype in BOTH]
        except Exception as error:
            yield facts | {"failed": sentence(error)}
            continue
        setup = time.perf_counter() - began
        yield from (row | {"set-up s": setup} for row in timed(jobs))


def tangents(folder: Path, small: bool) -> Rows:
    """Value alone, with the tangent of friction, and with those of both stiffnesses besides."""
    many = 512
    jobs, value = [], None
    for dtype, tests in ((np.float64, 1),) if small else ((np.float64, 1), (np.float32, many), (np.float64, many)):
        shear = quarter(dtype)
        jobs += [Job({"what": f"{tests} quarters", "tangents": n}, shear, 4, tests, n) for n in (0, 1, 3)]
    for row in timed(jobs):
        value = row.get("us a step") if row["tangents"] == 0 else value
        yield row | ({"times the value": row["us a step"] / value} if value and "us a step" in row else {})


def options(folder: Path, small: bool) -> Rows:
    """The same programs with other options of XLA."""
    shapes = ((1, quarter(np.float64)),) if small else ((1, quarter(np.float64)), (512, quarter(np.float32)))
    chosen = list(VARIANTS.items())[: 2 if small else None]
    yield from timed(
        [
            Job({"what": f"{tests} quarters", "options": name}, shear, 4 if tests > 1 else 20, tests, options=values)
            for tests, shear in shapes
            for name, values in chosen
        ]
    )


def random_batch(folder: Path, small: bool) -> Rows:
    """A random specimen with friction and rolling, alone and in a batch, with and without tight lists."""
    test = random_test(folder)
    for dtype in BOTH[:1] if small else BOTH:
        tight = from_rest(test, dtype)
        network = replace(tight.prepared.network, tight=None)
        lists = {"on": tight, "off": replace(tight, prepared=replace(tight.prepared, network=network))}
        each = [(tests, name) for tests in (1, 2 if small else 256) for name in lists]
        facts = [{"what": f"{tests} random specimens", "tight lists": name} for tests, name in each]
        yield from timed([Job(f, lists[name], 4, n) for f, (n, name) in zip(facts, each, strict=True)])


def whole(folder: Path, small: bool) -> Rows:
    """Whole tests by `run_batch`, confinement included."""
    test = axijax.TriaxialTest(axijax.fcc_octagon(), axijax.Sector(4), axial_strain=0.001 if small else 0.005)
    members = parameter_grid(test, friction=np.linspace(0.2, 0.4, 2 if small else 128).tolist())
    for what in ("with compilation", "again"):
        began = time.perf_counter()
        result = run_batch(members, strategy="vmap")
        seconds = time.perf_counter() - began
        steps = [int(curve.confinement.steps) + test.prepared.numerics.most_steps for curve in result.curves.values()]
        yield {
            "what": f"run_batch of {len(members)} quarters, {what}", "seconds": seconds,
            "failures": len(result.failures), "steps a test": sum(steps) / len(members),
            "M ball-steps/s": sum(steps) * len(test.cut) / seconds / 1e6,
        }  # fmt: skip


def hot_kernels(folder: Path, small: bool) -> Rows:
    """Which kernels of a batch and of a large lattice take the time; what they do is in the text of the program."""
    cases = {
        "batch": Job({}, quarter(np.float32), 2, 2 if small else 512),
        "large": Job({}, from_rest(full(*(SMALL_SIZES[209] if small else SIZES[261225])), np.float64), 2),
    }
    for name, job in cases.items():
        compiled = job.compile()[0]
        with gzip.open(folder / f"{name}.hlo.txt.gz", "wt") as file:
            file.write(compiled.as_text())
        arguments = job.program()[1]
        jax.block_until_ready(compiled(*arguments))
        with tempfile.TemporaryDirectory() as traces:
            with jax.profiler.trace(traces):
                jax.block_until_ready(compiled(*arguments))
            trace = next(Path(traces).rglob("*.xplane.pb"))
            spent, times = kernel_times(jax.profiler.ProfileData.from_file(str(trace)))
        if not spent:
            yield {"what": name, "failed": "the profiler saw no kernel of a GPU"}
        whole = max(sum(spent.values()), 1)
        for kernel, nanoseconds in spent.most_common(12):
            each = nanoseconds / times[kernel] / 1e3
            yield {"what": name, "kernel": kernel, "times": times[kernel], "us each": each,
                   "share": f"{nanoseconds / whole:.1%}"}  # fmt: skip


def kernel_times(profile) -> tuple[Counter, Counter]:
    """Nanoseconds and number of runs of each kernel of a device; none on a CPU, which has no such plane."""
    spent: Counter = Counter()
    times: Counter = Counter()
    for plane in profile.planes:
        lines = [line for line in plane.lines if "/device:GPU" in plane.name and "Stream" in line.name]
        for event in (event for line in lines for event in line.events):
            spent[event.name] += event.duration_ns
            times[event.name] += 1
    return spent, times


def random_test(folder: Path) -> axijax.TriaxialTest:
    """A dense random specimen that the CPU's process made, with friction and rolling."""
    path, ends = folder / "specimen.npz", time.monotonic() + 90
    while not path.exists():
        if time.monotonic() > ends:
            raise TimeoutError("the CPU's process has made no random specimen in 90 seconds; see log.txt")
        time.sleep(0.5)
    with np.load(path) as kept:
        arrays = {name: kept[name] for name in ("positions", "radius", "membrane_zone")}
        bottom, top = float(kept["bottom"]), float(kept["top"])
    specimen = axijax.Specimen(**arrays, bottom=bottom, top=top, name="random", zone_rule="exposure")
    params = axijax.Params(friction=0.3, rolling=axijax.Rolling(rolling_friction=0.1))
    keywords = {"axial_strain": 0.003, "tolerance": 1e-3, "confining_friction": 0.05}
    return axijax.TriaxialTest(specimen, axijax.Sector(1), params=params, **keywords)


def cases(folder: Path, small: bool) -> dict[str, axijax.TriaxialTest]:
    quarter = axijax.TriaxialTest(axijax.fcc_octagon(), axijax.Sector(4), axial_strain=0.001 if small else 0.005)
    random = random_test(folder)
    if small:
        random = replace(random, axial_strain=0.0005, tolerance=1e-2)
    rebuilt = {} if small else {"the same, lists rebuilt inside jit": replace(random, rebuild_every=20)}
    return {"FCC quarter": quarter, "random, friction and rolling": random, **rebuilt}


def curves_of(test: axijax.TriaxialTest, *frictions: float) -> list[dict[str, np.ndarray]]:
    simulate, names = jax.jit(test.simulate), ("stress_ratio", "volumetric_strain", "coordination_number", "status")
    found = [simulate(replace(test.params, friction=friction)) for friction in frictions]
    return [{name: np.asarray(getattr(curve, name), float) for name in names} for curve in found]


def reference(folder: Path, small: bool) -> Rows:
    """The random specimen, and the CPU's curves: as they are, and with friction changed in its last bit."""
    specimen, _ = axijax.random_cylinder(150 if small else 500, axijax.Sector(1), seed=1)
    names = ("positions", "radius", "membrane_zone", "bottom", "top")
    save(folder / "specimen.npz", {name: getattr(specimen, name) for name in names})
    found = {}
    for name, test in cases(folder, small).items():
        for which, curve in zip(("", "last bit"), curves_of(test, 0.3, float(np.nextafter(0.3, 1))), strict=True):
            found |= {f"{name}/{which}/{key}": values for key, values in curve.items()}
    save(folder / "reference.npz", found)
    yield from ()


def save(path: Path, arrays: dict[str, Any]) -> None:
    """Whole or not at all: other processes wait for it."""
    making = path.with_name("making.npz")
    np.savez(making, **arrays)
    making.rename(path)


def curves(folder: Path, small: bool) -> Rows:
    """How far the device's curves are from the CPU's, at most, over the largest value of the CPU's."""
    with np.load(folder / "reference.npz") as kept:
        cpu = dict(kept)

    def compared(name: str, curve: dict[str, np.ndarray]) -> dict[str, Any]:
        row: dict[str, Any] = {"records": curve["stress_ratio"].size, "status": int(curve.pop("status"))}
        for key, values in curve.items():
            expected = cpu[f"{name}//{key}"]
            off = np.abs(values - expected) / np.nanmax(np.abs(expected))
            row |= {f"{key}, first tenth": float(off[: max(2, off.size // 10)].max())} if key == "stress_ratio" else {}
            row[key] = float(off.max())
        return row

    for name, test in cases(folder, small).items():
        again = {key.rpartition("/")[2]: v for key, v in cpu.items() if key.startswith(f"{name}/last bit/")}
        yield {"what": name, "numbers": "CPU, friction's last bit changed"} | compared(name, again)
        single = replace(test, dtype=np.float32, tolerance=max(test.tolerance, 1e-3))
        for numbers, one in (("float64", test), *(() if test.rebuild_every else (("float32", single),))):
            try:
                yield {"what": name, "numbers": numbers} | compared(name, *curves_of(one, 0.3))
            except Exception as error:
                yield {"what": name, "numbers": numbers, "failed": sentence(error)}


MEASURES: dict[str, Callable[[Path, bool], Rows]] = {
    "device": device, "batches": batches, "curves": curves, "sizes": sizes, "tangents": tangents, "options": options,
    "kernels": hot_kernels, "random": random_batch, "whole": whole, REFERENCE: reference,
}  # fmt: skip


def main(part: str, folder: str, small: bool) -> None:
    # The curves of a CPU are compared with those of its other kernels: else they would be of the same program.
    if (small or os.environ.get("JAX_PLATFORMS") == "cpu") and part != "curves":
        axijax.fast_cpu_kernels()
    try:
        for row in MEASURES[part](Path(folder), small):
            append(Path(folder), part, row)
    except Exception as error:
        append(Path(folder), part, {"what": part, "failed": sentence(error)})
        raise


if __name__ == "__main__":
    main(*sys.argv[1:3], small="--small" in sys.argv[3:])
