"""How results are named, coloured and compared with theory, in every picture and in the report."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from axijax import theory
from axijax.app.results import Result, numbers_beside
from axijax.core.files import printable
from axijax.core.palette import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from axijax.app.case import Case

MISSING = object()  # in place of a field that a case does not have
FEW = 5  # results that are told apart by a line each

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


def _differing(results: Sequence[Result]) -> dict[str, list[Any]]:
    """The fields in which the results' cases differ, "section.field", and each result's value, MISSING where it has no
    such field; empty for one result, and where one says nothing of itself."""
    flat = [fields for result in results if (fields := _fields(result))]
    if len(results) < 2 or len(flat) < len(results):
        return {}
    known = dict.fromkeys(field for fields in flat for field in fields)
    # The time step that a run has chosen follows from the rest.
    known.pop("test.time_step", None)
    # A field that only some have follows from one that differs, such as contact_law.
    differing = [field for field in known if len({repr(fields[field]) for fields in flat if field in fields}) > 1]
    return {field: [fields.get(field, MISSING) for fields in flat] for field in differing}


def _fields(result: Result) -> dict[str, Any]:
    """"section.field" and value of a result's case; where it has kept none, the numbers that stand beside its curve, as
    beside those of a batch."""
    case = case_of(result)
    if case is None:
        return {f"batch.{name}": value for name, value in numbers_beside(result.curve).items()}
    return {f"{part}.{name}": value for part, fields in case.sections().items() for name, value in fields.items()}


def labels(results: Sequence[Result]) -> list[str]:
    """A name for each of several results: the fields in which their cases differ, or else what they are called."""
    names = [result.name for result in results]
    if differing := _differing(results):
        told = [
            ", ".join(
                f"{field.split('.')[1].replace('_', ' ')} {_short(values[number])}"
                for field, values in differing.items()
                if values[number] is not MISSING
            )
            for number in range(len(results))
        ]
        if len(set(told)) == len(told) and max(map(len, told)) <= 60:
            names = told
    return [
        name if result.status == "finished" else f"{name} ({result.status})"
        for name, result in zip(names, results, strict=True)
    ]


class Lines:
    """How the curves of several results are told apart: by a line and a name each; or, where more than `FEW` differ in
    one number alone, by a scale of colours for that number.

    each: result, name for a legend, empty where there is a scale, and colour and style of its line.
    """

    def __init__(self, results: Sequence[Result]):
        named = zip(results, labels(results), strict=True)
        self.each = [(result, plain(name), line_of(number)) for number, (result, name) in enumerate(named)]
        self.scale: Any = None  # a ScalarMappable
        differing = _differing(results)
        if len(results) <= FEW or len(differing) != 1:
            return
        (field, values), *_ = differing.items()
        if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
            return
        from matplotlib import colormaps
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm, Normalize

        low, high = min(values), max(values)
        norm = LogNorm(low, high) if low > 0 and high > 10 * low else Normalize(low, high)
        self.scale = ScalarMappable(norm, colormaps["viridis"].resampled(256))
        self.told = field.split(".")[1].replace("_", " ")
        colours = [self.scale.to_rgba(value) for value in values]
        self.each = [(result, "", {"color": c, "ls": "-"}) for result, c in zip(results, colours, strict=True)]

    def bar(self, figure: "Figure") -> None:
        """The scale beside the axes, where there is one."""
        if self.scale is not None:
            figure.colorbar(self.scale, ax=figure.axes, pad=0.02).set_label(self.told, fontsize=LETTERS)


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
