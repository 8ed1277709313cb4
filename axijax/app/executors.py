"""Tests run elsewhere: in other processes or on other machines, by any `concurrent.futures.Executor`.

Process pools, Dask (`Client.get_executor()`), mpi4py.futures and submitit all are such executors: none needs code here.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import contextmanager
from typing import Any, TypeVar

Item = TypeVar("Item")

ALLOWED = "'processes', 'processes:4' for four of them, or 'dask://HOST:PORT' for a running Dask scheduler"


def run_elsewhere(work: Callable[[Item], Any], item: Item) -> Any:
    """`work(item)` in a process of an executor, with the kernels and the cache that the command line has."""
    from axijax.core.platform import fast_cpu_kernels, use_compilation_cache

    fast_cpu_kernels()
    use_compilation_cache()
    return work(item)


def spread(
    executor: Executor, work: Callable[[Item], Any], items: Iterable[Item], finished: Callable[[Any], object]
) -> None:
    """Have an executor do `work(item)` for every item; finished: called with each result as it comes, in this thread.

    `work` and the items go through pickle. Raises RuntimeError where the executor broke, as a process pool does when
    one of its processes is killed; Dask does the killed process's work again instead.
    """
    futures: list[Any] = []
    try:
        for item in items:
            futures.append(executor.submit(run_elsewhere, work, item))
        for future in as_completed(futures):
            finished(future.result())
    except BrokenExecutor as error:
        raise RuntimeError(
            f"a process of the executor died ({str(error).split('.')[0]}): what was done before is kept in the batch's "
            "folder; run it again."
        ) from None
    except BaseException:
        for future in futures:
            future.cancel()
        raise


@contextmanager
def open_executor(asked: str) -> Iterator[Executor]:
    """The executor that a command line asks for. Raises ValueError, saying what is allowed, and where there is none."""
    kind, _, rest = asked.partition(":")
    if kind == "processes" and (not rest or (rest.isdecimal() and 0 < int(rest) <= 10_000)):
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        from axijax.core.parallel import cores, end_with_parent

        # JAX's threads do not survive a fork.
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(int(rest or cores()), mp_context=spawn, initializer=end_with_parent) as pool:
            yield pool
    elif kind == "dask" and rest.startswith("//") and rest.count(":") == 1:
        try:
            from distributed import Client
        except ImportError:
            raise ValueError(f"executor = '{asked}' needs Dask: pip install distributed.") from None
        try:
            client = Client(f"tcp:{rest}", timeout="10s")
        except (OSError, ValueError) as error:
            raise ValueError(
                f"executor = '{asked}': no Dask scheduler answers there ({type(error).__name__}); start one with "
                "`dask scheduler`, and workers with `dask worker HOST:PORT --nthreads 1`."
            ) from None
        with client:
            yield client.get_executor()
    else:
        raise ValueError(f"executor = '{asked}': must be {ALLOWED}.")
