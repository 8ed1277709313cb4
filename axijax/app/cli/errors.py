"""What the command line makes of whatever goes wrong: one sentence and an exit code, never a traceback.

With AXIJAX_TRACEBACK=1 in the environment a fault that is nobody's mistake shows its traceback instead.
"""

import contextlib
import os
import shlex
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer

from axijax.core.files import writing_to

VARIABLE = "AXIJAX_TRACEBACK"
INTERRUPTED = 128 + signal.SIGINT  # as shells say of Ctrl-C

# XLA and its compiler end the process, without an exception, where they find less address space than this [bytes].
LEAST_MEMORY = 2 * 10**9


def guarded(work: Callable[[], int | None], given: Sequence[str]) -> int:
    """Do the work of a command line; its exit code. 1: something is wrong, or a check failed. 2: the command line
    itself. 130: interrupted."""
    try:
        _standard_streams()
        _enough_memory()
        code = work() or 0
        try:
            sys.stdout.flush()
        except OSError:
            _drop_output()
            raise
        return code
    except KeyboardInterrupt:
        return _told("interrupted", INTERRUPTED)
    except (BrokenPipeError, SystemExit):  # the latter is the command line's library's answer to a closed pipe
        _drop_output()
        return _told("standard output was closed by the program that read it")
    except MemoryError as error:
        return _told(f"this machine has not enough memory for it{_reason(error)}: take fewer balls or records")
    except RecursionError:
        return _told("an input is nested too deeply to be read: it is no file of axijax")
    except OSError as error:
        return _told(_of_the_system(error))
    except Exception as error:
        if type(error).__name__ == "Abort":  # how the command line's library passes Ctrl-C on
            return _told("interrupted", INTERRUPTED)
        if hasattr(error, "format_message"):  # the command line's own kind
            message = error.format_message().rstrip(".")  # nothing after a bare `axijax`, which shows its help
            return _told(f"{message}; given was: axijax {shlex.join(given)}" if message else "", 2)
        if "RESOURCE_EXHAUSTED" in str(error):
            return _told("this device has not enough memory for it: take fewer balls, records or tests at a time")
        device = _device(error)
        if device:
            return _told(device)
        if isinstance(error, ValueError | RuntimeError):
            return _told(str(error))
        if os.environ.get(VARIABLE):
            raise
        return _told(
            f"internal error, {type(error).__name__}{_reason(error)}: this is a fault of axijax, please report it; "
            f"{VARIABLE}=1 shows where it happened"
        )


@contextmanager
def filling(folder: Path, way_on: str) -> Iterator[None]:
    """For a command that fills a folder: Ctrl-C, or a folder that cannot be written, ends in one sentence that tells
    the way on, such as "run it again"."""
    try:
        with writing_to(folder, lambda: way_on):
            yield
    except KeyboardInterrupt:
        complain(f"interrupted: {way_on}.")
        raise typer.Exit(INTERRUPTED) from None


def complain(message: str) -> None:
    """Say what is wrong on standard error, where there is somebody to hear it."""
    with contextlib.suppress(OSError):
        print(f"axijax: {' '.join(message.split())}", file=sys.stderr, flush=True)


def _told(message: str, code: int = 1) -> int:
    if message:
        complain(message)
    return code


def _drop_output() -> None:
    """What is still in the buffer of standard output goes nowhere, or Python would try once more at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _reason(error: BaseException) -> str:
    return f" ({' '.join(str(error).split())[:200]})" if str(error) else ""


def _of_the_system(error: OSError) -> str:
    """An error of the operating system; one that says what it means already stays as it is."""
    if not error.strerror:
        return str(error)
    what = "standard output" if error.filename is None else f"'{error.filename}'"
    return f"{what} cannot be read or written ({error.strerror})."


def _device(error: Exception) -> str:
    """What to say where JAX finds no device of the kind that it is told to use; nothing for any other error."""
    wanted = os.environ.get("JAX_PLATFORMS", "")
    if not wanted or wanted == "cpu":
        return ""
    from jax._src import xla_bridge

    if xla_bridge.backends_are_initialized() and "initialize backend" not in str(error):
        return ""
    if isinstance(error, AssertionError) or "initialize backend" in str(error):
        return (
            f"JAX_PLATFORMS = '{wanted}' asks for a device that this machine, or this jaxlib, does not have: unset it, "
            "or set it to 'cpu'."
        )
    return ""


def _standard_streams() -> None:
    """Standard streams that were closed lead nowhere, so that no file that is opened takes their place; a name that the
    terminal cannot show is escaped."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 (for the rest of the process)
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _enough_memory() -> None:
    try:
        import resource
    except ImportError:  # not a POSIX system
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY:
        raise RuntimeError(
            f"the memory limit of {limit / 1e9:.2g} GB (ulimit -v) is too low: JAX and its compiler need at least "
            f"{LEAST_MEMORY / 1e9:.2g} GB of address space; raise or lift it."
        )
