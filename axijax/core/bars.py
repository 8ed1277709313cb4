"""A progress bar in a terminal or a notebook, with rich; silent in a pipe.

    with bar() as show:
        show("confining")                                       # how far is not known: the bar moves to and fro
        show("shearing 0.33 of 1 %", share=0.33, left=12.0)     # ends at the right with 0:12 left
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rich.console import Console

STRETCHES = 20  # of the last marks from which the time left is told


class Show(Protocol):
    def __call__(self, told: str, share: float | None = None, left: float | None = None) -> None:
        """told: stage and how far. share: done, from 0 to 1, None where that is not known. left: seconds."""


@contextmanager
def bar(console: "Console | None" = None) -> Iterator[Show]:
    """One line with text, bar and time left, as wide as the terminal, that is gone at the end."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn
    from rich.table import Column

    console = Console(highlight=False) if console is None else console
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis")),
        BarColumn(bar_width=None, table_column=Column(ratio=1, min_width=8)),
        TextColumn("{task.fields[left]}", markup=False, table_column=Column(no_wrap=True)),
    )
    visible = console.is_terminal or console.is_jupyter
    bars = Progress(
        *columns, console=console, disable=not visible, transient=True, expand=True, refresh_per_second=8
    )
    bars.start()
    try:
        task = bars.add_task("", total=None, left="")

        def show(told: str, share: float | None = None, left: float | None = None) -> None:
            after = "" if left is None else f"{100 * (share or 0.0):.0f} %  {duration(left)} left"
            bars.update(
                task, description=told, total=None if share is None else 1.0, completed=share or 0.0, left=after
            )

        yield show
    finally:
        with suppress(OSError):  # the terminal may be gone
            bars.stop()


@contextmanager
def telling(progress: Callable[[str], None] | bool) -> Iterator[Callable[[str], None]]:
    """The function that is told what goes on: one that was given, a line with a moving bar for True, or none."""
    if callable(progress):
        yield progress
    elif progress:
        with bar() as show:
            yield show
    else:
        yield lambda told: None


@contextmanager
def counting(progress: Callable[..., object] | bool) -> Iterator[Callable[..., object]]:
    """The function that is told how many runs are made and how many are allowed: one that was given, a bar for True, or
    none. The time left is that of all that are allowed, so at most."""
    if callable(progress) or not progress:
        yield progress or (lambda *_: None)
        return
    pace = Pace()
    with bar() as show:
        show("the first run")

        def tell(done: float, most: float, *_: object) -> None:
            pace.mark(done / most)
            show(f"fitting  {done:.0f} of at most {most:g} runs", done / most, pace.left)

        yield tell


def duration(seconds: float) -> str:
    """Minutes and seconds, or hours before them."""
    minutes, rest = divmod(int(seconds + 0.5), 60)
    return f"{minutes}:{rest:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


class Pace:
    """How fast something goes, from when and where it was marked; the first stretch, which compiles, is left out."""

    def __init__(self) -> None:
        self._marks: list[tuple[float, float, int]] = []

    def mark(self, share: float, steps: int = 0) -> None:
        """Now so much is done, from 0 to 1, in so many steps."""
        self._marks.append((time.perf_counter(), share, steps))

    @property
    def first(self) -> bool:
        """Whether there is one mark only."""
        return len(self._marks) == 1

    def _stretch(self) -> tuple[tuple[float, float, int], tuple[float, float, int]] | None:
        last = self._marks[1:][-STRETCHES:]
        return None if len(last) < 2 else (last[0], last[-1])

    @property
    def rate(self) -> float | None:
        """Steps a second, None before the third mark."""
        found = self._stretch()
        return None if found is None else (found[1][2] - found[0][2]) / (found[1][0] - found[0][0])

    @property
    def left(self) -> float | None:
        """Seconds left, None where that cannot be said yet."""
        found = self._stretch()
        if found is None or found[1][1] <= found[0][1]:
            return None
        (start, share, _), (end, reached, _) = found
        return (1 - reached) * (end - start) / (reached - share)
