"""What is said of a file's columns beside the file itself: a small mapping of quantities to names, units and signs.

    {"axial_displacement": "Weg [mm]", "q": "[kPa]", "volumetric_strain": "dV/V [%] (dilation positive)"}

The same in a study file, as a table, and on the command line, as --column 'q=[kPa]'.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from calibrate.names import (
    DILATION,
    NAMES,
    SHORTENING,
    STRAIN,
    VOLUME,
    Head,
    is_unit,
    plain_name,
    quantity_of,
    taken_apart,
)  # fmt: skip
from calibrate.table import DataError, short


@dataclass(frozen=True)
class Request:
    """How to read a file, beside what it says itself.

    columns: {quantity: "name of the column [unit] (sign)"}, any part of it left out. test: which of several.
    height: of the specimen [m]; void_ratio: at the start of the shear [-]; confining_stress [Pa].
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    test: str | None = None
    height: float | None = None
    void_ratio: float | None = None
    confining_stress: float | None = None


def named_columns(file: str, columns: Mapping[str, str]) -> dict[str, tuple[str, Head]]:
    """What is said of columns, by quantity: the text, and the text taken apart."""
    named: dict[str, tuple[str, Head]] = {}
    for key, text in columns.items():
        quantity = key if key in NAMES else quantity_of(key)
        if quantity is None:
            raise DataError(
                f"{file}: columns: {short(key)} is no quantity known here; it must be one of {', '.join(NAMES)}."
            )
        if not isinstance(text, str) or not text.strip():
            raise DataError(
                f"{file}: columns: {key} = {text!r}: must be the name of a column, its unit in brackets, or both, "
                "such as 'Weg [mm]' or '[mm]'."
            )
        if quantity in named:
            raise DataError(f"{file}: columns: {quantity} is named twice; name it once.")
        whole = re.match(r"\s*[\[({]", text) is not None  # only a unit or a sign: the known spellings are looked for
        named[quantity] = (text, taken_apart(0, f"x {text}" if whole else text))
        if whole:
            named[quantity] = ("", named[quantity][1])
    return named


def found_columns(file: str, cells: list[str], named: Mapping[str, tuple[str, Head]]) -> list[tuple[str, Head]]:
    """(quantity, head) of the cells of a header that are known, or named."""
    pairs = []
    heads = [taken_apart(place, cell) for place, cell in enumerate(cells)]
    taken: dict[int, str] = {}
    for asked, (text, wanted) in named.items():
        if not text:
            continue
        exact = [head.place for head, cell in zip(heads, cells, strict=True) if plain_name(cell) == plain_name(text)]
        for place in exact or [head.place for head in heads if head.name == wanted.name]:
            taken[place] = asked
    for head in heads:
        quantity = taken.get(head.place) or head.quantity
        if quantity is None or (head.place not in taken and _elsewhere(quantity, named)):
            continue
        said = named.get(quantity)
        pairs.append((quantity, head if said is None else _merged(file, cells[head.place], head, said[1])))
    return pairs


def _elsewhere(quantity: str, named: Mapping[str, tuple[str, Head]]) -> bool:
    """Whether the column of a quantity has been named, so that known spellings of it count no more."""
    alike = {DILATION: (DILATION, VOLUME), VOLUME: (VOLUME, DILATION), STRAIN: (STRAIN, SHORTENING)}
    return any(named.get(each, ("", None))[0] for each in alike.get(quantity, (quantity,)))


def _merged(file: str, cell: str, head: Head, said: Head) -> Head:
    """A head with the unit and the sign that are given for it."""
    mark, sign = said.mark or head.mark, head.sign if said.sign is None else said.sign
    if said.mark and head.mark and said.mark != head.mark and is_unit(head.mark):
        raise DataError(
            f"{file}: column '{short(cell, quoted=False)}' is marked {short(head.mark)}, but columns say "
            f"{short(said.mark)}; drop one of them."
        )
    if None not in (said.sign, head.sign) and said.sign != head.sign:
        raise DataError(
            f"{file}: column '{short(cell, quoted=False)}' says which sign is positive, and columns say the other one; "
            "drop one of them."
        )
    return replace(head, mark=mark, sign=sign)
