"""The command line. Heavy imports happen inside the commands, so that --help is quick."""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from axijax.app.cli.batch import batch
from axijax.app.cli.check import check
from axijax.app.cli.errors import complain, filling, guarded
from axijax.app.cli.run import new, resume, run
from axijax.app.cli.show import cite, plot, report, snapshot
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


def calibrate(
    data: Annotated[Path, typer.Argument(help="Measured curve: text with named columns, see below.")],
    fit: Annotated[str, typer.Option(help="Parameters to fit, with commas: friction,kn,ks..")] = "friction",
    case: Annotated[Path | None, typer.Option(help="Case file of the test; left out: the paper's quarter.")] = None,
    output: Annotated[Path, typer.Option(help="Folder for the fit, its picture and its log.")] = Path("calibration"),
    check: Annotated[bool, typer.Option(help="End with the health of the gradient at the answer.")] = True,
) -> None:
    """Fit friction and stiffness of a triaxial test to a measured curve, by derivatives of the simulation.

    The data need axial_strain (or eps_a), and stress_ratio, or confining_stress (sigma_3) with axial_stress (sigma_1)
    or q = s1 - s3; volumetric_strain (eps_v) is fitted too where it is there. Write units in brackets behind the
    names, percent or kPa say; strains without are fractions. Compression is positive; "(dilation positive)" behind a
    name turns its sign.

    Writes fit.json, fit.png and evaluations.jsonl into the output folder; an interrupted fit resumes from the latter.
    Ends with exit code 1 where the fit has not converged; what was found is written all the same.
    """
    from axijax.app.case import Case, load_case
    from axijax.core.files import locked, writable_folder
    from calibrate import calibrate_file

    test = (Case() if case is None else load_case(case)).build()
    folder = writable_folder(output)
    with locked(folder), filling(folder, "run it again, and what is in evaluations.jsonl is not computed again"):
        found = calibrate_file(data, fit, test, folder, check=check)
    if not found.converged:
        raise typer.Exit(1)


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
    calibrate: ("axijax calibrate measured.csv", "axijax calibrate measured.csv --fit friction,kn --case first.toml"),
    cite: ("axijax cite", "axijax cite results/first"),
    table1: ("axijax table1", "axijax table1 --stiffness contact --output contact"),
}
for command, examples in COMMANDS.items():
    app.command(epilog="\n\n".join(["Examples:", *examples]))(command)


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
