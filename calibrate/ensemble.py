"""Runs of a random scene, each on a packing of its own, on all cores or wherever an executor sends them.

Each worker is a process: packing is Python and NumPy and holds Python's lock. It compiles once, or reads the compiled
programs from the cache. What comes back is in the library before anything else is done with it.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from axijax.core.parallel import cores, end_with_parent
from axijax.core.platform import fast_cpu_kernels, make_room_for_programs, use_compilation_cache
from calibrate.library import FIELDS, Library, StoredRun
from calibrate.scene import RandomScene

FIRST_SEED = 1_000_000  # packings of a library; far from the seeds that a user gives the specimen of the data

Job = tuple[Mapping[str, float], int]  # point, seed of the packing


def design(count: int, dims: int, seed: int = 0) -> np.ndarray:
    """(count, dims) points of the unit box, evenly spread; the first ones of a longer design are those of a shorter."""
    whole = 2 ** int(np.ceil(np.log2(max(count, 2))))
    return qmc.Sobol(dims, seed=seed).random(max(whole, 64))[:count]


def one_run(scene: RandomScene, job: Job, reach: float) -> StoredRun:
    """A run, or the sentence that says why there is none."""
    point, seed = job
    start = time.perf_counter()
    curve, failed = None, None
    make_room_for_programs()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of one packing among many; what spoils a run is raised
            found = scene.run(point, seed, reach)
        curve = {name: np.asarray(getattr(found, name, np.nan), float) for name in FIELDS}
        curve["void_ratio"] = np.broadcast_to(curve["void_ratio"], curve["axial_strain"].shape)
        sound = np.isfinite(curve["stress_ratio"]).all() and np.isfinite(curve["volumetric_strain"]).all()
        if not sound or (curve["stress_ratio"] <= 0).any():
            curve, failed = None, "its stress ratio or volumetric strain is no sensible number"
    except (RuntimeError, ValueError) as error:
        failed = str(error)
    return StoredRun(dict(point), seed, reach, curve, failed, time.perf_counter() - start)


def run_all(
    scene: RandomScene,
    jobs: Iterable[Job],
    reach: float,
    library: Library,
    executor: Executor | None = None,
    workers: int | None = None,
    finished: Callable[[StoredRun], object] | None = None,
) -> list[StoredRun]:
    """Make runs, those that the library has left out, and keep each as it comes; in the jobs' order.

    reach: axial strain of the data. executor: any of concurrent.futures; by default so many worker processes, one a
    core. With one worker the runs are made in this process. finished: called with each new run.

    Raises RuntimeError where a worker is ended from outside, by want of memory say; what was finished is kept.
    """
    jobs = list(jobs)
    held = [library.find(point, seed, reach) for point, seed in jobs]
    todo = [place for place, run in enumerate(held) if run is None]

    def done(place: int, run: StoredRun) -> None:
        library.keep(run)
        held[place] = run
        if finished is not None:
            finished(run)

    workers = min(workers or cores(), len(todo))
    if executor is None and workers <= 1:
        for place in todo:
            done(place, one_run(scene, jobs[place], reach))
        return [run for run in held if run is not None]
    pool = executor or worker_processes(workers)
    try:
        futures = {pool.submit(one_run, scene, jobs[place], reach): place for place in todo}
        for future in as_completed(futures):
            done(futures[future], future.result())
    except BrokenProcessPool:
        raise RuntimeError(
            "a worker process was ended from outside, by want of memory perhaps: run it again with fewer workers; "
            "the runs that were finished are in the library. A Python script that fits needs its calls below "
            "`if __name__ == '__main__':`, since each worker reads it."
        ) from None
    finally:
        if executor is None:
            pool.shutdown(wait=False, cancel_futures=True)
    return [run for run in held if run is not None]


def worker_processes(workers: int) -> ProcessPoolExecutor:
    """So many processes that share the compiled programs on disk; started afresh, as JAX does not survive a fork."""
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_begin, initargs=(_cache(),))


def _cache() -> Path | None:
    import jax

    given = jax.config.values["jax_compilation_cache_dir"]
    return Path(given) if given else None


def _begin(cache: Path | None) -> None:
    import jax

    end_with_parent()
    fast_cpu_kernels()
    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache))
    else:
        use_compilation_cache()
