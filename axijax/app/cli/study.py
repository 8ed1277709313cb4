"""Fits on random packings from the command line, and the command library. Heavy imports happen inside."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from axijax.app.cli.errors import filling
from axijax.app.cli.say import say

if TYPE_CHECKING:
    from axijax.app.case import Case
    from calibrate.measured import MeasuredCurve
    from calibrate.study import StudyTest


def fit_file(
    curve: "MeasuredCurve", names: str, case: "Case", output: Path, packings: str | None, void_ratio: float | None,
    **options: Any,
) -> bool:  # fmt: skip
    """Fit one measured curve on random packings of a case; whether it converged."""
    from axijax.app.random_scene import random_scene
    from calibrate.study import StudyTest

    if packings is None:
        say("the data are taken for the curve of one packing; --packings laboratory or =8 says otherwise")
    void_ratio = curve.facts.void_ratio if void_ratio is None else void_ratio
    name = Path(curve.source).stem or "data"
    test = StudyTest(name, curve, random_scene(case), None, _packings(packings or "1"), void_ratio)
    return _fit([test], names, output, **options)


def fit_study_file(path: Path, output: Path, **options: Any) -> bool:
    """Fit a study file; whether it converged."""
    from axijax.app.study_file import load_study

    study = load_study(path)
    given = {name: value for name, value in options.items() if value not in (None, {}, ())}
    return _fit(study.tests, study.names, output, **(study.options | given))


def _packings(text: str) -> float:
    from calibrate.study import LABORATORY

    if text == "laboratory":
        return LABORATORY
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not number >= 1:
        raise ValueError(f"--packings = '{text}': must be 'laboratory', or a number of packings, 1 or more.")
    return number


def _fit(tests: "list[StudyTest]", names, output: Path, executor: str | None = None, **options: Any) -> bool:
    from axijax.app.executors import open_executor
    from axijax.core.files import draw_afterwards, locked, writable_folder
    from calibrate.output import claim
    from calibrate.study import fit_study, identity

    folder = writable_folder(output)
    own = identity(tests, names, options)
    if claim(folder, own) and options.get("runs") is None:
        options["further"] = 0  # the same fit again: what it found is told without another run
    again = "run it again; the runs that were made are in the library"
    with locked(folder), filling(folder, again), ExitStack() as stack:
        pool = None if executor is None else stack.enter_context(open_executor(executor))
        progress = stack.enter_context(_shown())
        options = {name: value for name, value in options.items() if value is not None}
        found = fit_study(tests, names, executor=pool, report=say, progress=progress, **options)
        found.save(folder / "fit.json", own)
        found.save_samples(folder / "samples.csv")
        say(str(found))
        problem = draw_afterwards("fit.png", lambda: found.draw(folder / "fit.png"))
        if problem is not None:
            say(f"warning: {problem}")
        say(f"written: {folder / 'fit.json'}, {folder / 'samples.csv'}, {folder / 'fit.png'}")
    return found.converged


@contextmanager
def _shown() -> Iterator[Callable]:
    """What shows how many runs are made and how long the rest takes: a bar, and in a pipe a line a run."""
    from axijax.core.bars import counting

    with counting(True) as count:

        def progress(done: int, wanted: int, run) -> None:
            count(done, wanted)
            if not sys.stdout.isatty():
                say(f"run {done} of at most {wanted} {'failed' if run.failed else 'done'}, {run.seconds:.1f} s")

        yield progress


def library(
    action: Annotated[str, typer.Argument(metavar="list|clean", help="What to do.")] = "list",
    scene: Annotated[
        str | None, typer.Argument(help="Of one scene: the first letters of its name.", show_default="all")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("--library", help="Folder of libraries.", show_default="the user's")
    ] = None,
    failed: Annotated[
        bool, typer.Option("--failed", help="Clean away failed runs only, which are then tried again.")
    ] = False,
) -> None:
    """Tell what runs are kept for fits on random packings, or remove them.

    Every fit on random packings keeps its runs, so that the next data set of the same scene is fitted in seconds.
    """
    from calibrate.library import clean, library_folder, listed

    home = library_folder() if folder is None else folder
    if action == "clean":
        return say(f"{clean(home, scene, failed)} runs removed from {home}")
    if action != "list":
        raise ValueError(f"'{action}': must be list or clean.")
    found = [one for one in listed(home) if scene is None or one.folder.name.startswith(scene)]
    if not found:
        return say(f"no runs in {home}")
    for one in found:
        told = {name.rpartition(".")[2]: value.strip("'") for name, value in one.parts.items()}
        shown = ", ".join(f"{n} {told[n]}" for n in _SHOWN if told.get(n, "None") != "None")
        say(
            f"{one.folder.name}  {one.runs} runs, {one.failed} failed, {one.bytes / 1e6:.1f} MB, "
            f"{one.seconds / 60:.0f} minutes of computing; {shown or 'scene of a Python function'}"
        )
    return None


_SHOWN = ("balls", "compaction_friction", "void_ratio", "order", "boundary", "contact_law", "axijax")
