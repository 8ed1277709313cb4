"""Ctrl-C, SIGTERM and SIGHUP wait for a moment at which a run can stop."""

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def signals_wait() -> Iterator[Callable[[], None]]:
    """Let Ctrl-C, SIGTERM and SIGHUP (a terminal that closes) wait for a moment between two stretches of the run, when
    what is yielded is called: it raises KeyboardInterrupt if there was one. A second Ctrl-C does not wait.

    An exception thrown into the middle of a compilation can end the process in a crash.
    """
    asked: list[int] = []

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    def stop(number: int, _) -> None:
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked.append(number)
        with contextlib.suppress(OSError):  # the terminal may be gone
            print("axijax: stopping at the next checkpoint (Ctrl-C once more: at once)", file=sys.stderr, flush=True)

    if threading.current_thread() is not threading.main_thread():  # only the main thread may handle signals
        yield check
        return
    numbers = [signal.SIGINT, signal.SIGTERM]
    hangup = getattr(signal, "SIGHUP", None)  # not on Windows
    if hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:  # `nohup` asks to go on
        numbers.append(hangup)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
