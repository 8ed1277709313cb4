"""Where a test stands, as words and as a progress bar."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from axijax.core.bars import Pace, bar
from axijax.triaxial.progress import Progress

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest


def stage_of(test: "TriaxialTest", now: Progress) -> str:
    """What goes on, such as "shearing"."""
    return f"stage {min(now.stage + 1, len(test.stages))} of {len(test.stages)}" if test.stages else "shearing"


def strain_of(test: "TriaxialTest", now: Progress) -> str:
    """Axial strain so far of that asked for; stages ask for several things, so of these it is the strain alone. The
    last stretch of steps ends past what was asked for, which the curve does not."""
    if test.stages:
        return f"{100 * now.strain:.3f} % strain"
    return f"{100 * min(now.strain, test.axial_strain):.3f} of {100 * test.axial_strain:g} %"


@contextmanager
def watched(
    test: "TriaxialTest", progress: Callable[[Progress], None] | bool | None
) -> Iterator[Callable[[Progress], None]]:
    """The function that is told where a test stands: one that was given, a progress bar for True, or none."""
    if callable(progress):
        yield progress
        return
    if not progress:
        yield lambda now: None
        return
    pace = Pace()
    with bar() as show:
        show("preparing and confining")

        def tell(now: Progress) -> None:
            share = now.share(test)
            pace.mark(share)
            show(f"{stage_of(test, now)}  {strain_of(test, now)}  R {now.stress_ratio:.3f}", share, pace.left)

        yield tell
