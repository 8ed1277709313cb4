"""Specimens made once and loaded in many ways, by several processes; for the studies beside it.

Every specimen and every run is a file of the study's own, so it may be stopped and started again at any time.
"""

import multiprocessing
import os
import time
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path

MARGIN = 5.0  # seconds before the limit, after which nothing is begun


class Late(Exception):  # noqa: N818 (no error)
    """The time is up."""


class Deadline:
    """A moment after which a study begins nothing and breaks off what it is at; travels to the processes."""

    def __init__(self, seconds: float) -> None:
        self.until = time.time() + seconds

    def near(self) -> bool:
        """Whether it is too late to begin something."""
        return time.time() > self.until - MARGIN

    def look(self, _: object = None) -> None:
        """For `TriaxialTest.run(progress=..)`: raises Late when the time is up."""
        if time.time() > self.until:
            raise Late


def work(
    processes: int,
    specimens: Iterable[tuple],
    make: Callable[..., str],
    made: Callable[..., bool],
    loadings: Callable[..., Iterable[Hashable]],
    load: Callable[..., str],
) -> None:
    """Make what is missing of the specimens, and load each as soon as it is there, specimen after specimen.

    make(*specimen), load(*specimen, loading): in a process of the pool; return a word for the log.
    made(*specimen): whether it is there. loadings(*specimen): those that are missing.
    """
    # One thread a process; the processes are begun with these.
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_multi_thread_eigen=false".strip()
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    started, spawn = time.time(), multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=spawn, initializer=_kernels) as pool:
        running: dict[Future, tuple] = {}
        making: set[Future] = set()
        missing = []

        def load_all(specimen: tuple) -> None:
            for loading in loadings(*specimen):
                running[pool.submit(load, *specimen, loading)] = (*specimen, loading)

        def make_more() -> None:
            """As many specimens at work as there are processes: what waits in the pool is not overtaken."""
            while missing and len(running) < processes:
                specimen = missing.pop(0)
                future = pool.submit(make, *specimen)
                running[future] = specimen
                making.add(future)

        for specimen in specimens:
            if made(*specimen):
                load_all(specimen)
            elif list(loadings(*specimen)):
                missing.append(specimen)
        make_more()
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                case = running.pop(future)
                try:
                    told = future.result()
                    if future in making and made(*case):
                        load_all(case)
                except (ValueError, RuntimeError) as error:
                    told = f"failed: {error}"
                print(f"{time.time() - started:5.0f} s: {' '.join(map(str, case))}: {told}", flush=True)
            make_more()


def _kernels() -> None:
    """What a process does before its first computation."""
    import axijax

    axijax.fast_cpu_kernels()
    axijax.use_compilation_cache()


def save_rows(path: Path, rows: list[dict]) -> None:
    """Write rows of the same names as CSV, numbers to four digits."""
    from axijax.app.results import save_table  # takes long to import

    rounded = [{name: f"{each:.4g}" if isinstance(each, float) else each for name, each in row.items()} for row in rows]
    save_table(path, list(rows[0]), rounded)
