"""Speed of the simulator, alone and beside LAMMPS and YADE: ball-steps a second, compile time, memory.

    python examples/benchmark.py --output benchmark [--parts random,kernel,peers,tangents,batch,scaling] [--repeats 3]

First the job that everybody has: dense random packings, sheared to 5 % strain by `TriaxialTest.run`, whole runs with
records and rebuilt lists, beside LAMMPS from the same state, in seconds of the processor. Then lattices, whose list
never changes: the steps alone.

Every code runs in a process of its own, pinned to one core or two, and the codes take turns, so that a slow moment of
the machine strikes all of them. Shears begin at the same confined specimen, with membrane forces fixed in size and a
record every 50 steps; compilation and set-up are noted apart. Median and range of the repeats; results are written
after each group as benchmark.json and benchmark.md in the output folder, and groups that are there already are not run
again (--fresh runs them). On another device (GPU) the same command measures that one.

Ours has dashpots in the contacts, its default; LAMMPS has the same and, to compare, local damping; YADE has local
damping. Peers that are not installed are named and left out (`pip install 'axijax[peers]'`, `apt-get install yade`).
"""

import argparse
import importlib.util
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent / "peers"))

from peers import LAMMPS, YADE, Ours, missing, run_peer

PARTS = ("random", "kernel", "peers", "tangents", "batch", "scaling")
SPECIMENS = {  # full cylinders by number of balls
    209: {"layers": 3},
    475: {"layers": 7},
    1672: {},
    7432: {"half_width": 19},
    31252: {"half_width": 39},
}
PACKINGS = {  # dense random packings by name: balls, radii from and to, axial strain of the shear
    "2016 random equal": (2016, (20.0, 20.0), 0.05),
    "2016 random 16-24": (2016, (16.0, 24.0), 0.05),
    "16128 random 16-24": (16128, (16.0, 24.0), 0.01),
}
INERTIAL_NUMBER = 1e-3  # of their shears
SHEAR = {"axial_strain": 0.006, "refresh": False}
BALL_STEPS = {"axijax": 8e6, LAMMPS: 8e6, YADE: 2e6}  # of one timing, a second or two each
LARGEST_BATCH = 256
ROW = ("part", "code", "dtype", "balls", "order", "cores", "tangents", "tests")


def blocks(balls: int, code: str = "axijax") -> int:
    """Records of a timed shear: 4000 steps, or fewer for many balls."""
    return int(np.clip(BALL_STEPS[code] / balls / 50, 2, 80))


def first_cores(count: int) -> tuple[int, ...]:
    """The last `count` cores of those that this process may use: the first one serves interrupts more often."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    return tuple(cores[-count:])


class Bench:
    """Groups of measurements: each is run, kept and written as it ends."""

    def __init__(self, folder: Path, repeats: int, budget: float, cores: tuple[int, ...], fresh: bool):
        self.folder, self.repeats, self.cores = folder, repeats, cores
        self.ends = time.monotonic() + budget
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "benchmark.json"
        found = json.loads(self.file.read_text()) if self.file.exists() and not fresh else {}
        self.groups: dict[str, list[dict]] = found.get("groups", {})

    def group(self, name: str, measure: Callable[[], list[dict]]) -> None:
        if name in self.groups:
            return print(f"{name}: found in {self.file}", flush=True)
        if time.monotonic() > self.ends:
            return print(f"{name}: left out, the budget is spent", flush=True)
        began = time.monotonic()
        try:
            self.groups[name] = measure()
        except RuntimeError as error:
            return print(f"{name}: failed and left out: {error}", flush=True)
        self.write()
        print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)

    def write(self) -> None:
        self.file.write_text(json.dumps({"machine": machine(), "groups": self.groups}, indent=1))
        (self.folder / "benchmark.md").write_text(tables(self.groups))

    def alternate(self, codes: dict[str, Callable[[], dict]], rows: dict[str, dict]) -> list[dict]:
        """Run every code `repeats` times in turn; a row of each, with ball-steps a second."""
        seconds: dict[str, list[float]] = {label: [] for label in codes}
        for _ in range(self.repeats):
            for label, once in codes.items():
                reply = once()
                rows[label] |= {key: reply[key] for key in ("steps", "version", "setup_seconds") if key in reply}
                seconds[label].append(reply["cpu_seconds"] if rows[label]["part"] == "random" else reply["seconds"])
        for label, row in rows.items():
            work = row["balls"] * row["steps"] * row["tests"]
            row["seconds"] = seconds[label]
            row["ball_steps_per_second"] = [work / s for s in seconds[label]]
        return list(rows.values())

    def ours(self, stack: ExitStack, part: str, configurations: list[dict]) -> tuple[dict, dict]:
        """Processes of ours, set up and waiting, and their rows."""
        codes, rows = {}, {}
        for options in configurations:
            options = {"what": "shear", "least_seconds": 0.5, **options}
            cores = first_cores(options.pop("cores", 1))
            one = stack.enter_context(Ours(cores, **options))
            label = json.dumps(options) + str(len(cores))
            rows[label] = {
                "part": part, "code": "axijax", "dtype": options.get("dtype", "float64"), "cores": len(cores),
                "order": options["order"], "tangents": options.get("tangents", 0), "tests": options.get("tests", 1),
                **one.ready,
            }  # fmt: skip
            codes[label] = one.run
        return codes, rows

    def kernel(self, balls: int, with_peers: bool) -> list[dict]:
        """Values alone: float64 and float32, on each number of cores, with the peers in turn."""
        full = {"specimen": SPECIMENS[balls], "order": 1, "test": SHEAR, "blocks": blocks(balls)}
        shapes = [full | {"dtype": dtype, "cores": n} for n in self.cores for dtype in ("float64", "float32")]
        if balls == 475:  # beside it the paper's quarter, of about as many balls
            quarter = {"specimen": {}, "order": 4, "test": SHEAR, "blocks": 80}
            shapes += [quarter | {"dtype": dtype} for dtype in ("float64", "float32")]
        if balls == 1672:  # and as many quarters as make eight full cylinders
            many = {"specimen": {}, "order": 4, "test": SHEAR, "blocks": 20, "tests": 32, "cores": self.cores[-1]}
            shapes += [many | {"dtype": dtype} for dtype in ("float64", "float32")]
        with ExitStack() as stack:
            scene = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "scene.npz"
            shapes[0] |= {"scene": str(scene), "traffic": True}
            codes, rows = self.ours(stack, "kernel", shapes)
            for code in (LAMMPS, YADE) if with_peers else ():
                if code in missing():
                    continue
                for count in self.cores:
                    label = f"{code} {count}"
                    rows[label] = {
                        "part": "kernel", "code": code, "dtype": "float64", "balls": balls, "order": 1,
                        "cores": count, "tangents": 0, "tests": 1,
                    }  # fmt: skip

                    def once(code=code, count=count):
                        damping = "dashpot" if code == LAMMPS else "local"
                        steps = 50 * blocks(balls, code)
                        done = run_peer(code, scene, steps, first_cores(count), damping=damping)
                        return {k: getattr(done, k) for k in ("seconds", "steps", "version", "setup_seconds")}

                    codes[label] = once
            return self.alternate(codes, rows)

    def packing(self, name: str, with_peers: bool) -> list[dict]:
        """Whole shears of a random packing on one core, in seconds of the processor, and LAMMPS in turn."""
        balls, radii, strain = PACKINGS[name]
        shape = {
            "what": "run", "specimen": {"balls": balls, "radii": radii}, "order": 1, "least_seconds": 0.0,
            "inertial_number": INERTIAL_NUMBER,
            "test": {"axial_strain": strain, "refresh": False, "tolerance": 1e-3},
        }  # fmt: skip
        with ExitStack() as stack:
            scene = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "scene.npz"
            codes, rows = self.ours(stack, "random", [shape | {"scene": str(scene)}])
            steps = next(iter(rows.values()))["steps"]
            if with_peers and LAMMPS not in missing():
                rows[LAMMPS] = {
                    "part": "random", "code": LAMMPS, "dtype": "float64", "balls": balls, "order": 1, "cores": 1,
                    "tangents": 0, "tests": 1,
                }  # fmt: skip
                codes[LAMMPS] = lambda: run_peer(LAMMPS, scene, steps, first_cores(1))._asdict()
            return self.alternate(codes, rows)

    def tangents(self, order: int, dtype: str) -> list[dict]:
        """Value alone, with one tangent and with three, on one core."""
        with ExitStack() as stack:
            same = {"specimen": {}, "order": order, "test": SHEAR, "blocks": 20, "dtype": dtype}
            return self.alternate(*self.ours(stack, "tangents", [same | {"tangents": n} for n in (0, 1, 3)]))

    def batches(self, dtype: str, largest: int) -> list[dict]:
        """Shears of the quarter, so many at once, on all cores."""
        sizes = [size for size in (1, 2, 8, 32, 128, 256) if size <= largest]
        same = {"specimen": {}, "order": 4, "test": SHEAR, "blocks": 20, "dtype": dtype, "cores": self.cores[-1]}
        with ExitStack() as stack:
            return self.alternate(*self.ours(stack, "batch", [same | {"tests": size} for size in sizes]))

    def whole_batches(self) -> list[dict]:
        """Whole tests by `axijax.app.batch.run_batch`, against one at a time."""
        same = {"what": "batch", "specimen": {}, "order": 4, "test": {"axial_strain": 0.005}, "cores": self.cores[-1]}
        with ExitStack() as stack:
            rows = self.alternate(*self.ours(stack, "run_batch", [same | {"tests": size} for size in (1, 8, 32)]))
        return rows

    def strains(self) -> list[dict]:
        """Whole tests of the quarter to different strains."""
        with ExitStack() as stack:
            shapes = [
                {"what": "whole", "specimen": {}, "order": 4, "test": {"axial_strain": strain}}
                for strain in (0.002, 0.004, 0.008, 0.016)
            ]
            rows = self.alternate(*self.ours(stack, "strain", shapes))
        for row, shape in zip(rows, shapes, strict=True):
            row["axial_strain"] = shape["test"]["axial_strain"]
        return rows


def machine() -> dict:
    cpu = [line.split(":")[1].strip() for line in _read("/proc/cpuinfo").splitlines() if line.startswith("model name")]
    import importlib.metadata as metadata

    versions = {}
    for name in ("axijax", "jax", "jaxlib", "numpy", "scipy", "lammps"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "processor": cpu[0] if cpu else platform.processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "load_at_end": os.getloadavg()[0],
        "versions": versions,
    }


def _read(path: str) -> str:
    return Path(path).read_text() if Path(path).exists() else ""


def rate(row: dict) -> float:
    """Median ball-steps a second."""
    return float(np.median(row["ball_steps_per_second"]))


def ratio(row: dict, other: dict) -> float:
    """Median over the repeats of how many times faster a row is than another that ran in turn with it."""
    return float(np.median(np.array(row["ball_steps_per_second"]) / np.array(other["ball_steps_per_second"])))


def tables(groups: dict[str, list[dict]]) -> str:
    """All results as Markdown."""
    facts = machine()
    lines = [
        f"{facts['processor']}, {facts['cores']} cores, {facts['system']}, Python {facts['python']}; "
        + ", ".join(f"{name} {version}" for name, version in facts["versions"].items()),
        "",
        "Million ball-steps a second after compilation: median (lowest to highest) of the repeats.",
        "",
        "| part | code | numbers | balls | n | cores | tangents | tests | M ball-steps/s | compile s | set-up s "
        "| program bytes/ball |",
        "|" + "---|" * 12,
    ]
    for row in (row for rows in groups.values() for row in rows):
        speeds = np.array(row["ball_steps_per_second"]) / 1e6
        compiled = f"{row['compile_seconds']:.1f}" if "compile_seconds" in row else "-"
        held = f"{row['program_bytes'] / row['balls']:.0f}" if "program_bytes" in row else "-"
        lines.append(
            "| " + " | ".join(str(row[name]) for name in ROW)
            + f" | {np.median(speeds):.2f} ({speeds.min():.2f} to {speeds.max():.2f}) | {compiled} "
            f"| {row['setup_seconds']:.1f} | {held} |"
        )  # fmt: skip
    return "\n".join([*lines, *ratios(groups), *costs(groups)]) + "\n"


def ratios(groups) -> list[str]:
    """How many times faster than the peers, size by size and core by core."""
    lines = ["", "Times faster than a peer on as many cores, per ball-step, medians of alternating runs:", ""]
    lines += ["| what | balls | n | tests | cores | numbers | LAMMPS | YADE |", "|" + "---|" * 8]
    start = len(lines)
    for name, rows in groups.items():
        peers = {(row["code"], row["cores"]): row for row in rows if row["code"] != "axijax"}
        for row in rows:
            if row["code"] == "axijax" and peers and row["part"] in ("random", "kernel"):
                found = [peers.get((code, row["cores"])) for code in (LAMMPS, YADE)]
                shown = [f"{ratio(row, other):.2f}" if other else "-" for other in found]
                what = "lattice" if row["part"] == "kernel" else name.split(" ", 1)[1]
                lines.append(
                    f"| {what} | {row['balls']} | {row['order']} | {row['tests']} | {row['cores']} | {row['dtype']} | "
                    + " | ".join(shown) + " |"
                )  # fmt: skip
    return lines if len(lines) > start else []


def costs(groups) -> list[str]:
    """Seconds against balls and against strain, slopes fitted; tangents against values; memory; traffic."""
    lines = ["", "Cost against work:", ""]
    for code, dtype in (("axijax", "float64"), ("axijax", "float32"), (LAMMPS, "float64"), (YADE, "float64")):
        rows = [
            row for rows in groups.values() for row in rows
            if (row["part"], row["code"], row["dtype"], row["cores"], row["order"]) == ("kernel", code, dtype, 1, 1)
        ]  # fmt: skip
        if len(rows) > 2:
            balls, per_step = np.array([[row["balls"], row["balls"] / rate(row)] for row in rows]).T
            slope = np.polyfit(np.log(balls), np.log(per_step), 1)[0]
            lines.append(f"- {code} {dtype}, one core: seconds a step grow as balls to the power {slope:.2f}.")
    full = [row for rows in groups.values() for row in rows if row["part"] == "kernel" and "resident_bytes" in row]
    full = [row for row in full if row["order"] == 1 and row["dtype"] == "float64" and row["cores"] == 1]
    if len(full) > 2:
        balls, resident = np.array([[row["balls"], row["resident_bytes"]] for row in full]).T
        slope, start = np.polyfit(balls, resident, 1)
        lines.append(f"- axijax float64: {slope / 1e3:.1f} kB resident a ball beside {start / 1e6:.0f} MB.")
    if strains := groups.get("strain"):
        strain, seconds = np.array([[row["axial_strain"], np.median(row["seconds"])] for row in strains]).T
        slope, start = np.polyfit(strain, seconds, 1)
        balls = strains[0]["balls"]
        lines.append(f"- A whole test of {balls} balls: {start:.3f} s and {slope / 100:.3f} s per 1 % strain.")
    for name, rows in groups.items():
        if name.startswith("tangents"):
            value = rows[0]
            parts = [f"{row['tangents']} tangent(s) x{1 / ratio(row, value):.2f}" for row in rows[1:]]
            lines.append(f"- {name}, {value['balls']} balls: value and {', '.join(parts)} the time of the value.")
    for name, rows in groups.items():
        if "traffic" in rows[0]:
            row, traffic = rows[0], rows[0]["traffic"]
            limit = traffic["bandwidth"] / traffic["least"]
            lines.append(
                f"- {name} on {row['device']}: {traffic['compiled']:.0f} bytes a ball-step as compiled, "
                f"{traffic['least']:.0f} if everything were read and written once; at "
                f"{traffic['bandwidth'] / 1e9:.1f} GB/s from memory that allows {limit / 1e6:.1f} M ball-steps/s, of "
                f"which {rate(row) / limit:.0%} is reached (caches allow more)."
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("benchmark"), help="folder")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--sizes", default="475,1672,7432,31252", help=f"balls, of {', '.join(map(str, SPECIMENS))}")
    parser.add_argument("--packings", default=",".join(PACKINGS), help="random packings, of these")
    parser.add_argument("--cores", default="1,2", help="numbers of cores")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--budget", type=float, default=np.inf, help="seconds after which no further group is begun")
    parser.add_argument("--fresh", action="store_true", help="run groups again that the output folder holds")
    options = parser.parse_args()
    parts = options.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"--parts {', '.join(sorted(unknown))}: known are {', '.join(PARTS)}")
    sizes = [int(size) for size in options.sizes.split(",")]
    if unknown := set(sizes) - set(SPECIMENS):
        parser.error(f"--sizes {unknown}: known are {', '.join(map(str, SPECIMENS))}")
    if unknown := set(options.packings.split(",")) - set(PACKINGS):
        parser.error(f"--packings {', '.join(sorted(unknown))}: known are {', '.join(PACKINGS)}")
    available = len(first_cores(10**6))
    cores = tuple(n for n in map(int, options.cores.split(",")) if n <= available)
    bench = Bench(options.output, options.repeats, options.budget, cores, options.fresh)
    if "peers" in parts:
        for code, why in missing().items():
            print(f"{code} {why}")
    if "random" in parts:
        for name in options.packings.split(","):
            bench.group(name, lambda name=name: bench.packing(name, "peers" in parts))
    if {"kernel", "peers"} & set(parts):
        for balls in sizes:
            bench.group(f"{balls} balls", lambda balls=balls: bench.kernel(balls, "peers" in parts))
    if "batch" in parts:
        for dtype in ("float64", "float32"):
            bench.group(f"batch {dtype}", lambda dtype=dtype: bench.batches(dtype, LARGEST_BATCH))
        if importlib.util.find_spec("axijax.app.batch") is None:
            print("run_batch: left out, this axijax has no batch module")
        else:
            bench.group("run_batch", bench.whole_batches)
    if "tangents" in parts:
        for order, dtype in ((4, "float64"), (4, "float32"), (1, "float64")):
            bench.group(f"tangents n={order} {dtype}", lambda o=order, d=dtype: bench.tangents(o, d))
    if "scaling" in parts:
        bench.group("strain", bench.strains)
    bench.write()
    print((options.output / "benchmark.md").read_text())


if __name__ == "__main__":
    main()
