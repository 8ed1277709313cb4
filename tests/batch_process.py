"""A process of its own for test_batch.py: arguments are what to do, a folder for results, and the rest.

kill FOLDER: run the members, and die by SIGKILL halfway through writing the second one's file.
resume FOLDER: run them again; prints what was computed, what was found, and the compiled programs read from the cache.
share FOLDER PORT P: be process P of two.
compile FOLDER fast|plain: compile something small with or without the fast kernels; prints hits and misses.
"""

import json
import os
import signal
import sys
from collections import Counter
from pathlib import Path

import axijax  # isort: skip  (before jax: it quietens XLA)
import jax

from axijax.app.batch import Member, parameter_grid, run_batch

FRICTION = (0.1, 0.2, 0.3)


def tiny(radius: float = 20.0) -> axijax.TriaxialTest:
    specimen = axijax.fcc_octagon(radius, layers=3, half_width=3)
    return axijax.TriaxialTest(specimen, scene=axijax.Scene(rotation=False), axial_strain=0.0006, record_every=25)


def members() -> list[Member]:
    """Three that go well and one whose negative friction does not."""
    test = tiny()
    return parameter_grid(test, friction=FRICTION) + parameter_grid(test, friction=[-1.0])


def count_programs() -> Counter:
    seen: Counter = Counter()
    jax.monitoring.register_event_listener(lambda event, **_: seen.update([event.rsplit("/", 1)[-1]]))
    return seen


def die_in_the_second_write() -> None:
    import xarray

    writing, to_netcdf = Counter(), xarray.Dataset.to_netcdf

    def write(data, target, **options):
        writing.update(["file"])
        to_netcdf(data, target, **options)
        if writing["file"] == 2:
            os.truncate(target, Path(target).stat().st_size // 2)
            os.kill(os.getpid(), signal.SIGKILL)

    xarray.Dataset.to_netcdf = write  # type: ignore[method-assign, assignment]


def main(what: str, folder: str, *rest: str) -> None:
    if rest[-1:] != ("plain",):
        axijax.fast_cpu_kernels()
    axijax.use_compilation_cache()
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    seen = count_programs()
    told: dict[str, object] = {}
    if what == "share":
        jax.distributed.initialize(f"localhost:{rest[0]}", num_processes=2, process_id=int(rest[1]))
    if what == "kill":
        die_in_the_second_write()
    if what == "compile":
        jax.jit(lambda x: (x * x).sum())(jax.numpy.arange(3.0)).block_until_ready()
    else:
        result = run_batch(members(), folder, workers=1)
        told["resumed"] = [o.member.name for o in result.outcomes if o.resumed]
        told["computed"] = [o.member.name for o in result.outcomes if not o.resumed]
    print(json.dumps(told | {"hits": seen["cache_hits"], "misses": seen["cache_misses"]}))


if __name__ == "__main__":
    main(*sys.argv[1:])
