"""The command sensitivity. Heavy imports happen inside the command."""

from pathlib import Path
from typing import Annotated

import typer

from axijax.app.cli.calibrate import Many, uncertainties
from axijax.app.cli.errors import filling
from axijax.app.cli.say import say, width


def sensitivity(
    case: Annotated[
        list[Path],
        typer.Argument(
            metavar="CASE...",
            help="Case files (TOML); with several, the first is the test "
            "that there is, the others are tests that might be made.",
            show_default=False,
        ),
    ],
    parameters: Annotated[
        str | None, typer.Option(show_default="all", help="Which, with commas: friction,kn,ks..")
    ] = None,
    packings: Annotated[
        int, typer.Option(min=1, max=1000, help="Of a random specimen: seeds from the case's on. A lattice has one.")
    ] = 4,
    uncertainty: Annotated[
        Many,
        typer.Option(
            metavar="NAME=NUMBER",
            show_default="0.02 of R, 1e-4 of volumetric strain",
            help="Of measured data, by which directions are judged. Several times.",
        ),
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for the tables and the pictures.")] = Path("sensitivity"),
) -> None:
    """Tell what each parameter of a case does to stress ratio and volumetric strain, and which a fit could tell apart.

    Of a lattice by exact tangents, each held against a difference of two runs; of a random specimen by differences of
    runs, the mean of a few packings with its standard error. Every parameter moves alone, kn without ks.

    With several cases, at other pressures or densities say, it ends with how much each would narrow the parameters,
    once the first has been measured; give what is to be fitted by --parameters.

    Writes sensitivity.csv and sensitivity.png into the output folder, of several cases in folders of their names.
    """
    from axijax.app.case import load_case
    from axijax.core.files import locked, writable_folder
    from calibrate.sensitivity import further_tests
    from calibrate.sensitivity import sensitivity as found_of

    sizes = {"ratio_sigma": 0.02, "volume_sigma": 1e-4} | uncertainties(uncertainty)
    for name, size in sizes.items():
        if not size > 0:
            raise ValueError(f"--uncertainty: {name} = {size:g} must be positive.")
    names = [path.stem for path in case]
    if len(set(names)) < len(names):
        raise ValueError(f"the cases {', '.join(map(str, case))} must have different names.")
    loaded = [load_case(path) for path in case]
    folder = writable_folder(output)
    found = {}
    with locked(folder), filling(folder, "run it again"):
        for name, one in zip(names, loaded, strict=True):
            within = folder if len(case) == 1 else writable_folder(folder / name)
            found[name] = found_of(
                _tests(one, packings), parameters, sigma=(sizes["ratio_sigma"], sizes["volume_sigma"]),
                report=say,
            )  # fmt: skip
            table = found[name].table(width())
            say(f"{name}:\n{table}" if len(case) > 1 else table)
            written = found[name].save(within / "sensitivity.csv"), found[name].draw(within / "sensitivity.png")
            say("Written: " + ", ".join(map(str, written)))
    if len(case) > 1:
        say("\n".join(further_tests(found)))


def _tests(case, packings: int) -> list:
    """The tests of a case: one of a lattice, of a random specimen one a packing."""
    if case.specimen.kind != "random":
        return [case.build()]
    tests = []
    for number in range(packings):
        seed = case.specimen.seed + number
        say(f"packing {number + 1} of {packings}: {case.specimen.balls} balls, seed {seed}")
        specimen = case.specimen.model_copy(update={"seed": seed})
        tests.append(case.model_copy(update={"specimen": specimen}).build())
    return tests
