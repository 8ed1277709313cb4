"""The command calibrate, and how options of its kind are read. Heavy imports happen inside the command."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from axijax.app.cli.errors import filling
from axijax.app.cli.say import say

if TYPE_CHECKING:
    from calibrate import MeasuredCurve

READING, SEARCH, PACKINGS = "The data", "The fit", "On random packings"  # headings of the help
Many = list[str] | None


def calibrate(
    data: Annotated[Path, typer.Argument(help="Measured curve: text with named columns, see below.")],
    fit: Annotated[str, typer.Option(help="Parameters to fit, with commas: friction,kn,ks..")] = "friction",
    case: Annotated[Path | None, typer.Option(help="Case file of the test; left out: the paper's quarter.")] = None,
    output: Annotated[Path, typer.Option(help="Folder for the fit, its picture and its log.")] = Path("calibration"),
    check: Annotated[bool, typer.Option(help="End with the health of the gradient at the answer.")] = True,
    column: Annotated[
        Many,
        typer.Option(
            metavar="NAME=COLUMN",
            rich_help_panel=READING,
            show_default=False,
            help="A column's name, unit, sign, or part of it, where the header does not say: 's1=Druck "
            "[bar]', 'q=[kPa]', 'eps_v=dV/V (dilation positive)'. Several times.",
        ),
    ] = None,
    test: Annotated[
        str | None,
        typer.Option(rich_help_panel=READING, show_default=False, help="Which test, where the file holds several."),
    ] = None,
    height: Annotated[
        str | None,
        typer.Option(rich_help_panel=READING, show_default=False, help="Of the specimen, for strains in mm: '100 mm'."),
    ] = None,
    void_ratio: Annotated[
        float | None,
        typer.Option(rich_help_panel=READING, show_default=False, help="At the start, for volumes as void ratios [-]."),
    ] = None,
    confining_stress: Annotated[
        str | None,
        typer.Option(rich_help_panel=READING, show_default=False, help="Where no column holds it: '200 kPa'."),
    ] = None,
    unloading: Annotated[
        bool,
        typer.Option(
            "--unloading",
            rich_help_panel=READING,
            help="The strain turns back: keep unloading branches. A case without stages turns where the data do.",
        ),
    ] = False,
    uncertainty: Annotated[
        Many,
        typer.Option(
            metavar="NAME=NUMBER",
            rich_help_panel=READING,
            show_default=False,
            help="Standard uncertainty of stress_ratio or volumetric_strain (a fraction), such as "
            "R=0.05; left out, only the proportion 0.02 to 1e-4 counts.",
        ),
    ] = None,
    bounds: Annotated[
        Many,
        typer.Option(
            metavar="NAME=LOW,HIGH",
            rich_help_panel=SEARCH,
            show_default=False,
            help="Limits of a parameter: friction=0.1,1.2 (above 1 for random specimens only). Several times.",
        ),
    ] = None,
    start: Annotated[
        Many,
        typer.Option(
            metavar="NAME=VALUE",
            rich_help_panel=SEARCH,
            show_default="by rule from the data",
            help="Where the search begins; 'test' for the case's own values. Several times.",
        ),
    ] = None,
    prior: Annotated[
        Many,
        typer.Option(
            metavar="NAME=VALUE,SPREAD",
            rich_help_panel=SEARCH,
            show_default=False,
            help="What is known before: most likely value and standard deviation of its log (of its logit, for "
            "friction below 1): kn=1e9,0.3. Several times.",
        ),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(
            min=1, rich_help_panel=SEARCH, show_default="60, on random packings 40",
            help="Runs after which to stop, a tangent counted as one.",
        ),
    ] = None,
    packings: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=PACKINGS, show_default="1",
            help="Packings that the data are the mean of, or 'laboratory': how far their curve scatters.",
        ),
    ] = None,
    library: Annotated[
        Path | None,
        typer.Option(rich_help_panel=PACKINGS, show_default="the user's", help="Folder where all runs are kept."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, rich_help_panel=PACKINGS, show_default="one a processor", help="Runs at a time."),
    ] = None,
    executor: Annotated[
        str | None,
        typer.Option(rich_help_panel=PACKINGS, show_default=False, help="Where they are made, as of `axijax batch`."),
    ] = None,
) -> None:
    """Fit friction and stiffness of a triaxial test to a measured curve, or a study of several tests.

    On a lattice by derivatives of the simulation. With a case whose specimen is random, on many packings: with honest
    intervals, a library of runs that later fits begin with, and a verdict. A study file (TOML) holds several tests.

    The data need axial_strain (eps_a), or axial_displacement with --height; and stress_ratio (R), or q/p, or two of
    s1, s3, q = s1 - s3 and p; volumetric_strain (eps_v), or void_ratio (e), is fitted too where it is there. Write
    units in brackets behind the names, percent or kPa say; strains without are fractions. Compression is positive;
    "(dilation positive)" behind a name turns its sign. Material files of the Sand Triaxial Test Database are read as
    they are.

    Writes fit.json, fit.png and evaluations.jsonl into the output folder; an interrupted fit resumes from the latter.
    Ends with exit code 1 where the fit has not converged; what was found is written all the same.
    """
    from axijax.app.case import Case, load_case
    from axijax.core.files import locked, writable_folder
    from calibrate import Prior, calibrate_file, read_measured

    given = {
        "bounds": {name: numbers(f"--bounds {name}", text, 2) for name, text in pairs("--bounds", bounds).items()},
        "priors": {name: Prior(*numbers(f"--prior {name}", text, 2)) for name, text in pairs("--prior", prior).items()},
        "start": _start(start),
    }
    on_packings = {"library": library, "workers": workers, "executor": executor, "runs": runs}
    if data.suffix == ".toml":
        from axijax.app.cli.study import fit_study_file

        if not fit_study_file(data, output, **on_packings):
            raise typer.Exit(1)
        return
    loaded = Case() if case is None else load_case(case)
    curve = read_measured(
        data, pairs("--column", column), test=test, height=height, void_ratio=void_ratio,
        confining_stress=confining_stress, unloading=unloading, **_uncertainties(uncertainty),
    )  # fmt: skip
    if loaded.specimen.kind == "random":
        if curve.places is not None:
            raise ValueError(
                "--unloading: fits on random packings compare the first loading only; leave it out and drop the "
                "unloading branches, or fit a lattice."
            )
        from axijax.app.cli.study import fit_file

        if start:
            raise ValueError("--start: a fit on random packings looks everywhere within --bounds; leave it out.")
        given.pop("start")
        if not fit_file(curve, fit, loaded, output, packings, void_ratio, **on_packings, **given):
            raise typer.Exit(1)
        return
    idle = [name for name, value in on_packings.items() if value is not None and name != "runs"]
    if idle or packings is not None:
        raise ValueError(f"--{(idle or ['packings'])[0]}: would do nothing on a lattice; leave it out.")
    _before_packing(loaded, curve, fit, given)
    built = loaded.build()  # no random specimen, which would take its time
    if curve.places is not None and not built.stages:
        built = replace(built, stages=curve.stages())
    folder = writable_folder(output)
    with locked(folder), filling(folder, "run it again, and what is in evaluations.jsonl is not computed again"):
        found = calibrate_file(
            curve, fit, built, folder, check=check, max_runs=60 if runs is None else runs, report=say, progress=True,
            **given,
        )  # fmt: skip
    if not found.converged:
        raise typer.Exit(1)


def _before_packing(case, curve: "MeasuredCurve", names: str, given: dict[str, Any]) -> None:
    """What cannot work is said before a specimen is made."""
    from axijax.app.case_parts import build_params
    from calibrate import ParameterSet
    from calibrate.file import check_reach

    ParameterSet.of(build_params(case.scene, case.parameters), names, given["bounds"])
    if curve.places is None and not case.stage:
        check_reach(curve, case.test.axial_strain)


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """NAME=VALUE options as a dict. Raises ValueError for what is none, and for a name that is given twice."""
    found: dict[str, str] = {}
    for text in texts or ():
        name, mark, value = (part.strip() for part in text.partition("="))
        if not (name and mark and value):
            raise ValueError(f"{option} '{text}': must be NAME=VALUE, such as {_EXAMPLES.get(option, 'friction=0.3')}.")
        if name in found:
            raise ValueError(f"{option} '{text}': {name} is given twice; give it once.")
        found[name] = value
    return found


_EXAMPLES = {
    "--column": "'axial_strain=eps1 [%]'", "--bounds": "friction=0.1,0.6", "--prior": "kn=1e9,0.3",
    "--uncertainty": "stress_ratio=0.05",
}  # fmt: skip


def numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """So many numbers with commas between them. Raises ValueError for anything else."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        wanted = "a number" if count == 1 else f"{count} numbers with a comma between them"
        raise ValueError(f"{option} = '{text}': must be {wanted}.")
    return found


def _start(texts: Sequence[str] | None):
    if not texts:
        return "rule"
    if list(texts) in (["rule"], ["test"]):
        return texts[0]
    return {name: numbers(f"--start {name}", text, 1)[0] for name, text in pairs("--start", texts).items()}


def uncertainties(texts: Sequence[str] | None) -> dict[str, float]:
    """Standard uncertainties by the names of MeasuredCurve's fields. Raises ValueError."""
    fields = {"stress_ratio": "ratio_sigma", "R": "ratio_sigma", "volumetric_strain": "volume_sigma"}
    found = {}
    for name, text in pairs("--uncertainty", texts).items():
        if name not in fields:
            raise ValueError(f"--uncertainty '{name}': must be of stress_ratio or volumetric_strain.")
        found[fields[name]] = numbers(f"--uncertainty {name}", text, 1)[0]
    return found


def _uncertainties(texts: Sequence[str] | None) -> dict[str, Any]:
    found: dict[str, Any] = dict(uncertainties(texts))
    return found | {"sigma_known": True} if found else {}
