"""Commands that show what a run has left: plot, report, snapshot, cite. Heavy imports happen inside the commands."""

from pathlib import Path
from typing import Annotated

import typer

from axijax.app.cli.errors import filling
from axijax.app.cli.say import say

AGAIN = "run it again"
_RESULTS = typer.Argument(
    metavar="RESULT...", help="Folders that `axijax run` or `batch` made, or files of curves.", show_default=False
)
_DATA = typer.Option(help="Measured curve to overlay, CSV with columns such as 'axial_strain [%]' and 'stress_ratio'.")


def plot(
    result: Annotated[list[Path], _RESULTS],
    kind: Annotated[
        list[str] | None,
        typer.Option(
            help="Picture of all results in one: curve, q-eps, eps_v-eps, e-log-p, q-p, friction-dilatancy, "
            "stress-dilatancy, mohr; of each: force-network, fabric-rose, membrane-cells, section, specimen, or "
            "animation, a film (GIF) of the "
            "snapshots that `axijax run --snapshots` kept; or all, but for the film. "
            "May be given several times.",
            show_default="curve",
        ),
    ] = None,
    data: Annotated[Path | None, _DATA] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            help="PNG file for one picture, or folder.", show_default="RESULT/pictures, or ./pictures for several"
        ),
    ] = None,
) -> None:
    """Draw curves of one or several runs, compared with theory and data, and the balls, forces and membrane cells."""
    from axijax.app.figures import KINDS
    from axijax.app.overwrite import PICTURES
    from axijax.app.plot import CURVES, plot_result

    kinds = kind or ["curve"]
    if "all" in kinds:
        kinds = [*CURVES, *KINDS]
    results = _open(result)
    folder = output or (result[0] / PICTURES if len(result) == 1 and result[0].is_dir() else Path(PICTURES))
    measured = _measured(data)
    with filling(folder.parent if folder.suffix else folder, AGAIN):
        paths = plot_result(results, kinds, folder, measured)
    _tell(paths)


def report(
    result: Annotated[list[Path], _RESULTS],
    data: Annotated[Path | None, _DATA] = None,
    energy: Annotated[
        bool, typer.Option(help="Check the energy ledger too: shears the first 0.05 % of strain again.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(help="HTML file to write.", show_default="RESULT/report.html, or ./report.html for several"),
    ] = None,
) -> None:
    """Write one HTML page that stands alone: inputs, curves, checks, pictures and how to make it again.

    Several results are compared on one page. Nothing in the page is fetched from elsewhere.
    """
    from axijax.app.overwrite import REPORT
    from axijax.app.report import write_report
    from axijax.core.files import writable_folder

    results = _open(result)
    path = output or (result[0] / REPORT if len(result) == 1 and result[0].is_dir() else Path(REPORT))
    if path.is_dir():
        raise ValueError(f"output '{path}' is a folder: name an HTML file in it.")
    measured = _measured(data)
    with filling(writable_folder(path.parent), AGAIN):
        write_report(results, path, measured, energy)
    _tell([path])


def snapshot(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="Folder that `axijax run` made.", show_default=False)
    ],
    full: Annotated[bool, typer.Option("--full", help="Fill in the sector's images to the whole cylinder.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(help="Folder to write to.", show_default="RESULT/snapshots, or RESULT/snapshots-full"),
    ] = None,
) -> None:
    """Write the last state of a run for ParaView: balls, contacts, membrane cells and platens (VTK XML, .pvd indexes).

    In a folder that holds snapshots of the same run already, the last state is added, with axial strain as time.
    """
    from axijax.app.paraview import SnapshotWriter
    from axijax.app.results import open_result, snapshots_folder
    from axijax.core.files import writable_folder

    opened = open_result(result)
    progress = opened.progress
    folder = writable_folder(output or result / snapshots_folder(full))
    with filling(folder, AGAIN):
        paths = SnapshotWriter(folder, opened.test, full)(progress)
    _tell(paths)


def cite(
    result: Annotated[
        Path | None,
        typer.Argument(metavar="[RESULT]", help="Folder of a run: what it used is cited too.", show_default=False),
    ] = None,
) -> None:
    """Print what to cite as BibTeX: this version, the method's papers, and those of what a run used."""
    from axijax.app.cite import bibtex
    from axijax.app.results import open_result

    print(bibtex(None if result is None else open_result(result).test), end="")


def _open(paths: list[Path]):
    from axijax.app.results import open_results

    return [result for path in paths for result in open_results(path)]


def _measured(path: Path | None):
    if path is None:
        return None
    from calibrate import read_measured

    return read_measured(path)


def _tell(paths: list[Path]) -> None:
    say("Written: " + ", ".join(str(path) for path in paths))
