"""The commands new, run and resume."""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from axijax.app.cli.errors import INTERRUPTED, complain
from axijax.app.cli.say import say, say_rows, width
from axijax.core.bars import Pace

if TYPE_CHECKING:
    from axijax.triaxial.packing_report import PackingReport
    from axijax.triaxial.test import Progress, Run, TriaxialTest

Json = Annotated[bool, typer.Option("--json", help="One JSON object a line on standard output, for programs.")]


def new(
    file: Annotated[Path, typer.Argument(help="Case file to write (TOML).")],
    kind: Annotated[
        str, typer.Option(help="Specimen: octagon, fcc, bcc, hcp, sc, random, or file for a packing of your own.")
    ] = "octagon",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file where it exists.")] = False,
) -> None:
    """Write a case file in which every field is set to its default, with its unit and what is allowed.

    Change what you like, delete what you do not care for, then `axijax check` and `axijax run` it.
    """
    from axijax.app.case import default_case
    from axijax.app.case_writing import to_toml
    from axijax.core.files import remove_leftovers, write_whole

    text = to_toml(default_case(kind))
    if file.exists() and not overwrite:
        raise ValueError(f"'{file}' exists: choose another name, or --overwrite.")
    remove_leftovers(file.parent)
    try:
        write_whole(file, lambda target: target.write_text(text))
    except OSError as error:
        raise ValueError(f"case file '{file}' cannot be written ({error.strerror}): choose another place.") from None
    typer.echo(f"Written: {file}")


def run(
    case: Annotated[Path, typer.Argument(help="Case file (TOML), see `axijax new`.")],
    output: Annotated[
        Path | None, typer.Option(help="Folder for the result; left out: results/ and the name of the case file.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the result that the folder holds.")] = False,
    snapshots: Annotated[
        int,
        typer.Option(
            min=0, max=100_000, help="Snapshots for ParaView, evenly over the shear, each at the first record there."
        ),
    ] = 0,
    full: Annotated[bool, typer.Option("--full", help="Snapshots of the whole cylinder, images filled in.")] = False,
    keep_confined: Annotated[
        Path | None, typer.Option(help="File for the confined specimen, from which other cases can go on.")
    ] = None,
    confined: Annotated[
        Path | None, typer.Option(help="Begin with a specimen kept so; the case may differ in its stages alone.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run the triaxial test of a case file into a folder.

    The folder gets the case as it was run, run.json (versions, times, status), the curve as curve.nc, curve.csv and
    curve.png, and checkpoint.npz. Ctrl-C, SIGTERM and a terminal that closes stop it with a checkpoint, from which
    `axijax resume` goes on. --overwrite replaces what a run wrote, and no other file.
    """
    from axijax.app.case import load_case
    from axijax.app.runs import run_case

    if full and not snapshots:
        raise ValueError("--full: no snapshots are asked for that it could fill in; add --snapshots NUMBER.")
    loaded = load_case(case)
    folder = Path("results") / case.stem if output is None else output
    with _live(folder, as_json) as live:
        command = ["axijax", *sys.argv[1:]]
        done = run_case(
            loaded, folder, case.stem, live.tell,
            overwrite=overwrite, snapshots=snapshots, full=full, command=command, packing=live.packing,
            packed=live.packed, confined=confined, keep_confined=keep_confined,
        )  # fmt: skip
        live.finished(done)


def resume(
    result: Annotated[Path, typer.Argument(help="Folder of an interrupted or finished run.")],
    axial_strain: Annotated[
        float | None, typer.Option(help="Go on to this axial strain [-] instead of the case's.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Go on with a run from its checkpoint: the result is that of a run that was never stopped, to the last bit."""
    from axijax.app import runs

    if axial_strain is not None and not 0 < axial_strain < 0.5:
        raise ValueError(f"--axial-strain = {axial_strain:g}: must lie between 0 and 0.5.")
    with _live(result, as_json) as live:
        live.finished(runs.resume(result, live.tell, axial_strain))


@contextmanager
def _live(folder: Path, as_json: bool) -> "Iterator[_Live]":
    from axijax.app.runs import Interrupted

    kind = _JsonLines if as_json else _LiveLine if sys.stdout.isatty() else _PlainLines
    try:
        with kind(folder) as live:
            yield live
    except Interrupted as stop:
        complain(str(stop))
        raise typer.Exit(INTERRUPTED) from None


class _Live:
    """What a run says of itself while it goes on; a context for the time of the run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started = time.perf_counter()
        self.pace = Pace()
        self.asked: float | None = None  # axial strain; stages end elsewhere

    def __enter__(self) -> "_Live":
        return self

    def __exit__(self, kind, error, trace) -> None:
        pass

    def tell(self, test: "TriaxialTest", now: "Progress | None") -> None:
        """Take note of where a run stands, and show it."""
        self.asked = None if test.stages else test.axial_strain
        if now is None:
            return self.show("preparing", f"{len(test.cut)} balls, {test.prepared.numerics.most_steps} steps")
        self.pace.mark(now.share(test), now.taken)
        if self.pace.first:
            balance, goal = now.confinement, f"shearing to {100 * test.axial_strain:g} %"
            if test.stages:
                goal = f"{len(test.stages)} stage{'s' if len(test.stages) > 1 else ''} to come"
            if now.taken > 0:
                self.show("resumed", f"going on from {100 * now.strain:.3g} % axial strain; {goal}")
            else:
                found = f"{int(balance.steps)} steps to an unbalanced force of {float(balance.unbalanced_force):.1e}"
                self.show("confined", f"confined in {found}; {goal}")
        steps = self.pace.rate
        self.advance(test, now, None if steps is None else steps * len(test.cut), self.pace.left)

    def packing(self, told: str) -> None:
        """What the packing of a random specimen is at."""

    def packed(self, report: "PackingReport") -> None:
        """What a random specimen has become."""
        self.show("packed", str(report))

    def show(self, event: str, text: str) -> None:
        """One thing that happened once."""

    def advance(self, test: "TriaxialTest", now: "Progress", rate: float | None, left: float | None) -> None:
        """Where the shear stands."""

    def finished(self, run: "Run") -> None:
        """The last word."""
        from axijax.triaxial.laboratory import laboratory

        found = laboratory(run.curve)
        say_rows(found.rows(self.asked).items())
        self.show("finished", f"{found.peak}; {time.perf_counter() - self.started:.1f} s; result in {self.folder}")


class _PlainLines(_Live):
    """A line for each thing that happened, no more: for logs and pipes."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.packs = False

    def packing(self, told: str) -> None:
        if not self.packs:
            self.show("packing", told)
        self.packs = True

    def show(self, event: str, text: str) -> None:
        say(text)


class _LiveLine(_Live):
    """One line of a terminal that is written again and again: stage, strain, a bar and the time left."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.stack = ExitStack()

    def __enter__(self) -> "_Live":
        from axijax.core.bars import bar

        self.bar = self.stack.enter_context(bar())
        self.bar("reading the case")
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.stack.close()

    def packing(self, told: str) -> None:
        self.bar(told)

    def show(self, event: str, text: str) -> None:
        if event == "preparing":
            self.bar(f"confining {text}")
        else:
            say(text)

    def advance(self, test: "TriaxialTest", now: "Progress", rate: float | None, left: float | None) -> None:
        self.bar(_line(test, now, rate, width()), now.share(test), left)


def _line(test: "TriaxialTest", now: "Progress", rate: float | None, room: int) -> str:
    """Stage and strain; in a wider terminal stress ratio, and then unbalanced force and speed."""
    from axijax.triaxial.watch import stage_of, strain_of

    parts = [stage_of(test, now) if rate else "compiling", strain_of(test, now)]
    if room >= 72:
        parts.append(f"s1/s3 {now.stress_ratio:.3f}")
    if room >= 112:
        parts.append(f"unbalanced {now.unbalanced_force:.0e}")
        if rate is not None:
            parts.append(f"{rate / 1e6:.1f}M ball-steps/s")
    return "  ".join(parts)


class _JsonLines(_Live):
    """One JSON object a line."""

    def say(self, **values) -> None:
        print(json.dumps({"seconds": round(time.perf_counter() - self.started, 3), **values}), flush=True)

    def show(self, event: str, text: str) -> None:
        if event != "finished":
            self.say(event=event)

    def packed(self, report: "PackingReport") -> None:
        from axijax.app.runs import packing_values

        self.say(event="packed", **packing_values(report))

    def advance(self, test: "TriaxialTest", now: "Progress", rate: float | None, left: float | None) -> None:
        from axijax.triaxial.watch import stage_of

        self.say(
            event="progress",
            stage=stage_of(test, now),
            axial_strain=now.strain,
            stress_ratio=now.stress_ratio,
            unbalanced_force=now.unbalanced_force,
            steps=now.taken,
            ball_steps_per_second=rate and round(rate),
            seconds_left=left and round(left, 1),
        )

    def finished(self, run: "Run") -> None:
        from axijax.triaxial.laboratory import laboratory

        found = laboratory(run.curve)
        warning = {} if found.peak.reached else {"warning": str(found.peak)}
        self.say(event="finished", result=str(self.folder), **found.values(), **warning)

    def __exit__(self, kind, error, trace) -> None:
        if error is not None:
            stopped = "interrupted" if kind.__name__ == "Interrupted" else "failed"
            with suppress(OSError):
                self.say(event=stopped, message=str(error))
