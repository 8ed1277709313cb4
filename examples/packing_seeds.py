"""How many seeds of a grading settle, and how isotropic they are when shear begins.

    python examples/packing_seeds.py --output packing_seeds --workers 2 --sizes 2000     # half an hour of one core

Every packing is a line of packings.jsonl in the output folder, so the study may be stopped and started again; it ends
with a table: of each kind the seeds that settled, the mean of the core's stress ratio and how it scatters.
"""

import argparse
import itertools
import json
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np

FRICTION = {"dense": 0.05, "loose": 0.5}  # during compaction
# Sieve openings over the mean radius and per cent passing: Cu = d60/d10 = 2.2.
WIDE = ((0.9, 0.0), (1.1, 10.0), (1.75, 30.0), (2.42, 60.0), (3.6, 100.0))
GRADINGS = ("16-24", "10-30", "Cu 2.2")


def grading_of(name: str, folder: Path):
    from axijax import grading

    if name != "Cu 2.2":
        return grading.linear(*map(float, name.split("-")))
    path = folder / "wide.csv"
    path.write_text("diameter,passing\n" + "".join(f"{20 * d},{share}\n" for d, share in WIDE))
    return grading.sieve_curve(path)


def packed(folder: Path, kind: tuple) -> dict:
    """Pack one specimen and begin its test."""
    import axijax
    from axijax.core.platform import use_compilation_cache

    axijax.fast_cpu_kernels()
    use_compilation_cache()
    grading, density, size, order, seed = kind
    found = dict(zip(("grading", "density", "size", "order", "seed"), kind, strict=True))
    started = time.perf_counter()
    sector = axijax.Sector(order)
    try:
        specimen, report = axijax.random_cylinder(
            size - size % order, sector, grading_of(grading, folder), compaction_friction=FRICTION[density], seed=seed
        )
        test = axijax.TriaxialTest(
            specimen, sector, params=axijax.Params(friction=0.5), axial_strain=1e-5,
            confining_friction=report.compaction_friction, tolerance=1e-3, confine_steps=100_000,
        )  # fmt: skip
        first = test.run().curve
        found |= {
            "void_ratio": report.counted_void_ratio, "core": report.core_stress_ratio,
            "error": report.core_stress_error, "sheared": float(first.core_ratio[0]),
            "trend": report.void_ratio_trend, "size_trend": report.size_trend,
        }  # fmt: skip
    except (ValueError, RuntimeError) as error:
        found["failed"] = str(error)
    return found | {"seconds": time.perf_counter() - started}


def table(lines: list[dict]) -> None:
    print("grading, density, balls, order: settled of seeds; core stress ratio, mean +- error, scatter; void ratio")
    key = ("grading", "density", "size", "order")
    for kind in sorted({tuple(line[name] for name in key) for line in lines}):
        mine = [line for line in lines if tuple(line[name] for name in key) == kind]
        sound = [line for line in mine if "failed" not in line]
        core = np.array([line["sheared"] for line in sound])
        scatter = core.std(ddof=1) if core.size > 1 else np.nan
        voids = np.mean([line["void_ratio"] for line in sound]) if sound else np.nan
        print(
            f"{', '.join(map(str, kind))}: {len(sound)} of {len(mine)}; {core.mean() if core.size else np.nan:.3f} "
            f"+- {scatter / max(core.size, 1) ** 0.5:.3f}, {scatter:.3f}; {voids:.3f}"
        )
        for line in mine:
            if "failed" in line:
                print(f"    seed {line['seed']}: {line['failed']}")


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--output", type=Path, default=Path("packing_seeds"))
    asked.add_argument("--sizes", type=int, nargs="+", default=(2000,), help="balls in the full cylinder")
    asked.add_argument("--orders", type=int, nargs="+", default=(4,), help="sectors in the full cylinder")
    asked.add_argument("--gradings", nargs="+", default=GRADINGS, choices=GRADINGS)
    asked.add_argument("--densities", nargs="+", default=tuple(FRICTION), choices=tuple(FRICTION))
    asked.add_argument("--seeds", type=int, default=20)
    asked.add_argument("--workers", type=int, default=1, help="processes")
    options = asked.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "packings.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {tuple(line[name] for name in ("grading", "density", "size", "order", "seed")) for line in lines}
    wanted = [
        (grading, density, size, order, seed)
        for seed, size, order, grading, density in itertools.product(
            range(options.seeds), options.sizes, options.orders, options.gradings, options.densities
        )
    ]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool, open(path, "a") as file:
        jobs = [pool.submit(packed, options.output, kind) for kind in wanted if kind not in known]
        for job in as_completed(jobs):
            lines.append(job.result())
            print(json.dumps(lines[-1]), file=file, flush=True)
            print(f"{lines[-1]['grading']}, {lines[-1]['density']}, seed {lines[-1]['seed']}: "
                  f"{lines[-1]['seconds']:.0f} s {lines[-1].get('failed', '')}", flush=True)  # fmt: skip
    table(lines)


if __name__ == "__main__":
    main()
