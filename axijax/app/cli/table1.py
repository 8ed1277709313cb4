"""`axijax table1`: the paper's Table 1 in the terminal, as wide as it is."""

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from axijax.app.cli.errors import filling

if TYPE_CHECKING:
    from rich.table import Table

    from axijax.app.table1 import PaperRun, Row


def table1(
    output: Annotated[Path, typer.Option(help="Folder for the table, the curves and the figures.")] = Path("table1"),
    stiffness: Annotated[
        Literal["ball", "contact"],
        typer.Option(help="What the paper's stiffness is taken for: each ball's, two in series, or the contact's."),
    ] = "ball",
) -> None:
    """Run the seven triaxial tests of Cui & O'Sullivan (2005), Table 1, and draw their figure 4.

    Writes table1.csv, curves.nc (all curves, NetCDF), figure_4a.png and figure_4b.png into the output folder.
    Takes about half a minute on two processors.
    """
    import time

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from axijax.app import table1 as paper
    from axijax.core.files import writable_folder

    started = time.perf_counter()
    folder = writable_folder(output)
    paper.refuse_to_overwrite(folder)
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = 120
    columns = (
        TextColumn("{task.description:22}"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:3.0f} %  R = {task.fields[ratio]:.3f}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, expand=True) as bars:
        tasks = {run: bars.add_task(run.name, total=1.0, ratio=1.0, start=False) for run in paper.PAPER_RUNS}

        def advance(run: "PaperRun", done: float, ratio: float) -> None:
            if not bars.tasks[tasks[run]].started:
                bars.start_task(tasks[run])
            bars.update(tasks[run], completed=done, ratio=ratio)

        def tell(row: "Row") -> None:
            if not console.is_terminal:
                # One write a line, its end included: warnings come from other threads.
                sys.stdout.write(f"{row.paper_run.name}: {row.peak.short} in {row.seconds:.1f} s\n")
                sys.stdout.flush()

        with filling(folder, "run it again"):
            rows = paper.run_table(stiffness=stiffness, progress=advance, finished=tell)
    with filling(folder, "run it again"):
        written = paper.save(rows, folder)
    console.print("Peak stress ratio s1/s3 of the FCC octagon (Cui & O'Sullivan 2005, Table 1)")
    for table in tables(rows, console.width):
        console.print(table, "")
    console.print(
        "core, virial: Love-Weber ratio of the inner core, area-free ratio of platens and membrane; e: axial strain "
        "[%] at the peak; flat: where R is within 0.3 % of its peak."
    )
    for reading, assumed in paper.READINGS.items():
        used = "used here" if reading == stiffness else f"with --stiffness {reading}"
        console.print(f"- {reading} ({used}): {assumed}")
    distance, agreeing = paper.misfit(rows)
    console.print(
        f"- The paper's {2 * len(rows)} numbers are {100 * distance:.1f} % away in the mean, and {agreeing} of them "
        "agree: a peak as it is rounded, a strain within the flat top."
    )
    for row in rows:
        if not row.peak.reached:
            console.print(f"- {row.paper_run.name}: {row.peak}")
    for note in paper.NOTES:
        console.print(f"- {note}")
    confined = [row.run.curve.confinement for row in rows]
    console.print(
        f"Confined to an unbalanced force of {max(float(c.unbalanced_force) for c in confined):.1e} and a stress error "
        f"of {max(float(c.stress_error) for c in confined):.1e} at most, in {max(int(c.steps) for c in confined)} "
        f"steps at most; {time.perf_counter() - started:.1f} s in all."
    )
    console.print("Written: " + ", ".join(str(path) for path in written), soft_wrap=True)


NAMES = 3  # columns that name a row
BETWEEN = 2  # characters between two columns


def tables(rows: "Sequence[Row]", width: int) -> "list[Table]":
    """The table of the rows: in one piece where it fits so many characters, or else in several below each other, each
    with the columns that name a row. Cells are never broken."""
    cells = [_cells(row) for row in rows]
    widths = {head: max(len(head), *(len(line[head]) for line in cells)) + BETWEEN for head in cells[0]}
    names, rest = list(widths)[:NAMES], list(widths)[NAMES:]
    pieces: list[list[str]] = []
    left = 0
    for head in rest:
        if widths[head] > left:
            pieces.append(list(names))
            left = width - sum(widths[name] for name in names)
        pieces[-1].append(head)
        left -= widths[head]
    return [_table(piece, cells) for piece in pieces]


def _table(heads: Sequence[str], cells: Sequence[dict[str, str]]) -> "Table":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, BETWEEN - 1, 0, 0))
    for head in heads:
        table.add_column(head, justify="left" if head == "boundary" else "right", no_wrap=True)
    for line in cells:
        table.add_row(*(line[head] for head in heads))
    return table


def _cells(row: "Row") -> dict[str, str]:
    paper, peak = row.paper_run, row.peak
    values = row.values()
    start, end = ("" if math.isnan(strain) else f"{100 * strain:.2f}" for strain in row.flat)
    return {
        "boundary": paper.boundary,
        "n": str(paper.sectors),
        "f": f"{paper.friction:g}",
        "theory": f"{paper.theory:.3f}",
        "paper": f"{paper.paper:.2f}",
        "peak": f"{peak.stress_ratio:.3f}",
        "-theory": f"{100 * (peak.stress_ratio / paper.theory - 1):+.1f}%",
        "-paper": f"{100 * (peak.stress_ratio / paper.paper - 1):+.1f}%",
        "core": f"{values['core_ratio']:.3f}",
        "virial": f"{values['virial_ratio']:.3f}",
        "paper e": f"{100 * paper.paper_strain:.2f}",
        "e": f"{100 * peak.axial_strain:.2f}",
        "e-paper": f"{100 * (peak.axial_strain / paper.paper_strain - 1):+.0f}%",
        "flat": f"{start}..{end}",
        "s": f"{row.seconds:.1f}",
    }
