"""The command line. Heavy imports happen inside the commands, so that --help is quick."""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from axijax.app.cli.batch import batch
from axijax.app.cli.calibrate import calibrate
from axijax.app.cli.check import check
from axijax.app.cli.errors import complain, filling, guarded
from axijax.app.cli.run import new, resume, run
from axijax.app.cli.show import cite, plot, report, snapshot
from axijax.app.cli.study import library

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Differentiable discrete element triaxial tests on an axisymmetric sector.",
)


def _tell_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"axijax {version('axijax')}, jax {version('jax')}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Versions of axijax and jax.")
    ] = False,
) -> None:
    """Differentiable discrete element triaxial tests on an axisymmetric sector."""


def table1(
    output: Annotated[Path, typer.Option(help="Folder for the table, the curves and the figures.")] = Path("table1"),
) -> None:
    """Run the seven triaxial tests of Cui & O'Sullivan (2005), Table 1, and draw their figure 4.

    Writes table1.csv, curves.nc (all curves, NetCDF), figure_4a.png and figure_4b.png into the output folder.
    Takes about half a minute on two cores.
    """
    import time

    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from axijax.app import table1 as paper
    from axijax.core.files import writable_folder

    started = time.perf_counter()
    folder = writable_folder(output)
    paper.refuse_to_overwrite(folder)
    console = Console()
    if not console.is_terminal:
        console.width = 120
    columns = (
        TextColumn("{task.description:28}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %  R = {task.fields[ratio]:.3f}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        tasks = {run: bars.add_task(run.name, total=1.0, ratio=1.0, start=False) for run in paper.PAPER_RUNS}

        def advance(run: paper.PaperRun, done: float, ratio: float) -> None:
            if not bars.tasks[tasks[run]].started:
                bars.start_task(tasks[run])
            bars.update(tasks[run], completed=done, ratio=ratio)

        def tell(row: paper.Row) -> None:
            if not console.is_terminal:
                print(f"{row.paper_run.name}: {row.peak.short} in {row.seconds:.1f} s", flush=True)

        with filling(folder, "run it again"):
            rows = paper.run_table(progress=advance, finished=tell)
    with filling(folder, "run it again"):
        written = paper.save(rows, folder)
    console.print(_table(rows))
    for row in rows:
        if not row.peak.reached:
            console.print(f"- {row.paper_run.name}: {row.peak}", highlight=False)
    for note in paper.NOTES:
        console.print(f"- {note}", highlight=False)
    confined = [row.run.curve.confinement for row in rows]
    console.print(
        f"Confined to an unbalanced force of {max(float(c.unbalanced_force) for c in confined):.1e} and a stress error "
        f"of {max(float(c.stress_error) for c in confined):.1e} at most, in {max(int(c.steps) for c in confined)} "
        f"steps at most; {time.perf_counter() - started:.1f} s in all.",
        highlight=False,
    )
    console.print("Written: " + ", ".join(str(path) for path in written), highlight=False, soft_wrap=True)


def _table(rows):
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(
        title="Peak stress ratio s1/s3 of the FCC octagon (Cui & O'Sullivan 2005, Table 1)",
        caption="core, virial: Love-Weber ratio of the inner core, area-free ratio of platens and membrane",
        box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    heads = ("boundary", "n", "f", "theory", "paper", "peak", "-theory", "-paper", "core", "virial", "strain", "s")
    for head in heads:
        table.add_column(head, justify="left" if head == "boundary" else "right", no_wrap=True)
    for row in rows:
        values = row.values()
        peak = values["peak_ratio"]
        table.add_row(
            values["boundary"],
            str(values["sectors"]),
            f"{values['friction']:g}",
            f"{values['theory']:.3f}",
            f"{values['paper']:.2f}",
            f"{peak:.3f}",
            f"{100 * (peak / values['theory'] - 1):+.1f}%",
            f"{100 * (peak / values['paper'] - 1):+.1f}%",
            f"{values['core_ratio']:.3f}",
            f"{values['virial_ratio']:.3f}",
            f"{100 * values['axial_strain_at_peak']:.2f}%",
            f"{values['seconds']:.1f}",
        )
    return table


# In the order of the help: each command with examples.
COMMANDS: dict[Callable[..., None], tuple[str, ...]] = {
    new: ("axijax new first.toml", "axijax new --kind fcc cylinder.toml"),
    check: ("axijax check first.toml", "axijax check results/first", "axijax check --json first.toml"),
    run: ("axijax run first.toml", "axijax run first.toml --output strong --json"),
    resume: ("axijax resume results/first", "axijax resume results/first --axial-strain 0.03"),
    plot: ("axijax plot results/first", "axijax plot results/first results/strong --output both.png"),
    report: ("axijax report results/first", "axijax report results/first --data measured.csv --output first.html"),
    snapshot: ("axijax snapshot results/first", "axijax snapshot results/first --full"),
    batch: ("axijax batch sweep.toml", "axijax batch sweep.toml --output strengths --workers 2"),
    calibrate: (
        "axijax calibrate measured.csv --fit friction,kn --case first.toml",
        "axijax calibrate karlsruhe.csv --test TMD18 --bounds friction=0.1,1.2 --uncertainty stress_ratio=0.05",
        "axijax calibrate study.toml --output sand",
        "axijax calibrate lab.csv --column 'axial_displacement=Weg [mm]' --height '10 cm' --confining-stress '2 bar'",
    ),
    library: ("axijax library list", "axijax library clean 3f2a"),
    cite: ("axijax cite", "axijax cite results/first"),
    table1: ("axijax table1", "axijax table1 --output paper"),
}
for command, examples in COMMANDS.items():
    shown = [example.replace("[", "\\[") for example in examples]  # brackets would be marks of the help's own
    app.command(epilog="\n\n".join(["Examples:", *shown]))(command)


def main(arguments: list[str] | None = None) -> int:
    """Entry point: a mistake of the user's, or a run that went wrong, ends in one sentence and an exit code.

    1: something went wrong, or a check failed. 2: the command line itself. 130: interrupted, with the way to go on.
    """
    given = sys.argv[1:] if arguments is None else arguments

    def work() -> int | None:
        warnings.showwarning = lambda message, *_: complain(f"warning: {message}")
        if given and "--help" not in given:  # help does without JAX, which takes a second to import
            from axijax.core.platform import fast_cpu_kernels, use_compilation_cache

            fast_cpu_kernels()
            use_compilation_cache()
        return app(given, standalone_mode=False)

    return guarded(work, given)
