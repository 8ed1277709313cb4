"""Work side by side: in threads of this process, and what processes of its own need."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, TypeVar

import jax

Item = TypeVar("Item")
Value = TypeVar("Value")


def parallel(
    work: Callable[[Item], Value],
    items: Iterable[Item],
    workers: int | None = None,
    finished: Callable[[int, "Value | Exception"], object] | None = None,
    stop: threading.Event | None = None,
    devices: Sequence[Any] | None = None,
) -> list["Value | Exception"]:
    """`work(item)` for every item, in threads; what it returned, or the Exception it raised, in the items' order.

    For work that spends its time in compiled programs, which run outside Python's lock.

    workers: threads; None takes one a core.
    finished: called with an item's number and result as they come, in the calling thread.
    stop: set when the work is given up (Ctrl-C), for work that can stop early; waiting items are dropped then.
    devices: JAX devices among which the items are dealt; None leaves JAX's default.
    """
    waiting = list(items)
    results: list[Any] = [None] * len(waiting)
    stop = stop or threading.Event()

    def attempt(number: int):
        if stop.is_set():
            return number, None
        try:
            if not devices:
                return number, work(waiting[number])
            with jax.default_device(devices[number % len(devices)]):
                return number, work(waiting[number])
        except Exception as error:
            return number, error
        except BaseException:
            stop.set()
            raise

    with ThreadPoolExecutor(max(1, min(workers or cores(), len(waiting)))) as pool:
        futures = [pool.submit(attempt, number) for number in range(len(waiting))]
        try:
            for future in as_completed(futures):
                number, results[number] = future.result()
                if finished is not None:
                    finished(number, results[number])
        except BaseException:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def end_with_parent() -> None:
    """In a process of a pool, as its initializer: end when the process that made the pool has been killed.

    Left to themselves the processes of `concurrent.futures` wait for further work for ever, each with its memory.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
