"""How results are named, coloured and compared with theory, in every picture and in the report."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from axijax import theory
from axijax.app.results import Result
from axijax.core.files import printable
from axijax.core.palette import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from axijax.app.case import Case

LETTERS = 10.5  # points; 7 at the width of a telephone for a picture of 5.6 inches


def readable(figure: "Figure") -> "Figure":
    """The figure with all letters along its axes large enough, and titles no larger."""
    for axes in figure.axes:
        axes.tick_params(labelsize=LETTERS)
        for text in (axes.xaxis.label, axes.yaxis.label, axes.title):
            text.set_fontsize(LETTERS)
    return figure


def line_of(number: int) -> dict[str, Any]:
    """Colour and style of the line of result number 0, 1.."""
    return {"color": COLOURS[number % len(COLOURS)], "ls": STYLES[number // len(COLOURS) % len(STYLES)]}


class Measured(Protocol):
    """A measured curve: strains are fractions, compression positive; see `calibrate.MeasuredCurve`."""

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    volumetric_strain: np.ndarray | None
    source: str


def case_of(result: Result) -> "Case | None":
    """The case of a result, None where it has kept none."""
    try:
        return result.case
    except ValueError:
        return None


def labels(results: Sequence[Result]) -> list[str]:
    """A name for each of several results: the fields in which their cases differ, or else what they are called."""
    names = [result.name for result in results]
    cases = [case_of(result) for result in results]
    if len(results) > 1 and all(case is not None for case in cases):
        flat = [
            {
                f"{section}.{field}": value
                for section, fields in case.sections().items()
                for field, value in fields.items()
            }
            for case in cases
            if case is not None
        ]
        known = dict.fromkeys(field for fields in flat for field in fields)
        # The time step that a run has chosen follows from the rest.
        known.pop("test.time_step", None)
        # A field that only some have follows from one that differs, such as contact_law.
        differing = [field for field in known if len({repr(fields[field]) for fields in flat if field in fields}) > 1]
        told = [
            ", ".join(
                f"{field.split('.')[1].replace('_', ' ')} {_short(fields[field])}"
                for field in differing
                if field in fields
            )
            for fields in flat
        ]
        if len(set(told)) == len(told) and max(map(len, told)) <= 60:
            names = told
    return [
        name if result.status == "finished" else f"{name} ({result.status})"
        for name, result in zip(names, results, strict=True)
    ]


def thornton_ratio(case: "Case") -> float | None:
    """Thornton's stress ratio of the ideal array where the specimen is an FCC one, 2 (1 + f) / (1 - f) [-].

    None for other specimens, and for a friction of 1 or more."""
    friction = case.parameters.friction if case.scene.friction else 0.0
    if case.specimen.kind not in ("octagon", "fcc") or friction >= 1:  # where the ideal array locks
        return None
    return float(theory.fcc_stress_ratio(friction))


def plain(text: str) -> str:
    """A name as it is: matplotlib would read what is between two $ as mathematics."""
    return printable(text).replace("$", r"\$")


def _short(value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
