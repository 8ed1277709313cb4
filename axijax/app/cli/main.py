"""The command line. Heavy imports happen inside the commands, so that --help is quick."""

import inspect
import re
import sys
import warnings
from collections.abc import Callable
from inspect import get_annotations
from typing import Annotated

import typer

from axijax.app.cli.batch import batch
from axijax.app.cli.calibrate import calibrate
from axijax.app.cli.check import check
from axijax.app.cli.errors import complain, guarded
from axijax.app.cli.run import new, resume, run
from axijax.app.cli.sensitivity import sensitivity
from axijax.app.cli.show import cite, plot, report, snapshot
from axijax.app.cli.study import library
from axijax.app.cli.table1 import table1

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
    sensitivity: (
        "axijax sensitivity first.toml",
        "axijax sensitivity sand.toml --parameters friction,kn,ks --packings 8 --uncertainty stress_ratio=0.05",
        "axijax sensitivity 100kPa.toml 200kPa.toml 800kPa.toml --parameters friction,kn",
    ),
    cite: ("axijax cite", "axijax cite results/first"),
    table1: ("axijax table1", "axijax table1 --stiffness contact --output contact"),
}


def _flowing(text: str) -> str:
    """A docstring for the help, which keeps the ends of lines as they are: each paragraph one line."""
    return "\n\n".join(" ".join(part.split()) for part in inspect.cleandoc(text).split("\n\n"))


def _literal(text: str) -> str:
    """Brackets that look like the help's own marks, such as [mm], made to be shown."""
    return re.sub(r"(?<!\\)(\[[a-z#/@][^[]*?])", r"\\\1", text)


for command, examples in COMMANDS.items():
    told = "\n\n".join(["Examples:", *examples])
    for kind in get_annotations(command).values():
        for about in getattr(kind, "__metadata__", ()):
            about.help = about.help and _literal(about.help)
    app.command(help=_literal(_flowing(command.__doc__ or "")), epilog=_literal(told))(command)


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
        return app(given, prog_name="axijax", standalone_mode=False)

    return guarded(work, given)
