"""How a command ends that did not go well: one sentence, the way on, and an exit code."""

import contextlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from axijax.folder import writing_to

INTERRUPTED = 130  # as shells say of Ctrl-C
UNHEARD = 141  # and of output that nobody reads any more


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


def complain(text: str) -> None:
    """Say what went wrong on standard error, where there is somebody to hear it."""
    with contextlib.suppress(OSError):
        print(f"axijax: {text}", file=sys.stderr, flush=True)


def heard(code: int) -> int:
    """The exit code of a command whose words are to reach standard output by now: 141 where nobody reads it."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except BrokenPipeError:
        code = code or UNHEARD
    except OSError as error:
        complain(f"what was to be printed could not be written ({error.strerror}): make room where it goes.")
        code = code or 1
    # Python flushes once more at its end.
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code
