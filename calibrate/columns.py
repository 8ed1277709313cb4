"""The columns of a measured file as strains, stress ratio and stresses in one kind of unit.

A unit that is not known, or a unit on one of two columns only, is asked for; columns that say one thing twice must
agree. So no number is scaled by a guess.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibrate.names import (
    AXIAL,
    CONFINING,
    DEVIATOR,
    DILATION,
    OF_ONE,
    PASCAL,
    PORE_PRESSURE,
    RATIO,
    STRAIN,
    VOLUME,
    WORDS,
    Head,
    is_unit,
    plain_mark,
    plain_name,
    taken_apart,
)
from calibrate.table import DataError, Table, read_table, short

_AGREE = 0.01  # of stress ratios made in two ways from one file; of equal columns a tenth of it


@dataclass(frozen=True)
class Measured:
    """What a file says, (M,) each: strains as fractions, compression positive.

    confining_stress: in Pa where stress_marked, otherwise as written; None where the file has none.
    strain_marked: whether the axial strain carries a unit.
    doubts: sentences on columns that may be others than they were taken for.
    """

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    volumetric_strain: np.ndarray | None
    confining_stress: np.ndarray | None
    stress_marked: bool
    strain_marked: bool
    doubts: tuple[str, ...]


def read_measured(path: Path, wanted: dict[str, str], unit: float | None, sign: int) -> Measured:
    """Columns of a file.

    wanted: {STRAIN, RATIO or VOLUME: header name to take instead of the known spellings}.
    unit: of the strains, as a fraction, where the header does not say. sign: -1 for a tension-positive file.
    """
    named = {plain_name(taken_apart(0, name).name): quantity for quantity, name in wanted.items()}

    def quantity(head: Head) -> str | None:
        known = named.get(head.name, head.quantity)
        asked = VOLUME if known == DILATION else known
        return None if asked in wanted and head.name not in named else known

    def score(cells: list[str]) -> int:
        found = {quantity(taken_apart(place, cell)) for place, cell in enumerate(cells)}
        return len(found - {None}) if STRAIN in found else 0

    table = read_table(path, score)
    found: dict[str, list[Head]] = {}
    for place, cell in enumerate(table.header):
        head = taken_apart(place, cell)
        if (known := quantity(head)) is not None:
            found.setdefault(known, []).append(head)
    return _Reader(table, found, wanted, unit, sign).read()


class _Reader:
    """Turns the columns found in a table into numbers of one kind."""

    def __init__(self, table: Table, found: dict[str, list[Head]], wanted, unit: float | None, sign: int):
        self.table, self.found, self.wanted, self.unit, self.sign = table, found, wanted, unit, sign
        self.file = table.file

    def read(self) -> Measured:
        self._check_there()
        self._take_row_of_units()
        places = [head.place for heads in self.found.values() for head in heads]
        self.numbers = self.table.numbers(places)
        strain = self._strain(STRAIN)
        volume = self._volume()
        ratio, confining, marked = self._ratio()
        return Measured(
            strain, ratio, volume, confining, marked, self.found[STRAIN][0].mark is not None, self._total_stresses()
        )

    def title(self, head: Head) -> str:
        return short(self.table.header[head.place], quoted=False)

    def _check_there(self) -> None:
        has = [short(cell, quoted=False) for cell in self.table.header if cell]
        listed = ", ".join(has[:12]) + (f" and {len(has) - 12} more" if len(has) > 12 else "")
        if len(has) == 1:
            listed += " alone (commas, semicolons or tabs must stand between columns)"
        stresses = CONFINING in self.found and (AXIAL in self.found or DEVIATOR in self.found)
        for quantity in (STRAIN, RATIO, VOLUME):
            name = self.wanted.get(quantity, quantity)
            needed = quantity == STRAIN or quantity in self.wanted or (quantity == RATIO and not stresses)
            if quantity not in self.found and needed:
                instead = "" if quantity != RATIO else (
                    ", or give two columns, confining_stress with axial_stress or with q = s1 - s3"
                )  # fmt: skip
                raise DataError(
                    f"{self.file}: no column '{name}'; it has {listed}. Write '{name}' over the right column of the "
                    f"file{instead}."
                )

    def _take_row_of_units(self) -> None:
        """Where the first row holds units instead of numbers, they are the marks of the columns."""
        first = self.table.rows[0]
        used = [head for heads in self.found.values() for head in heads]
        cells = [re.sub(r"^[\[({]\s*|\s*[\])}]$", "", first[head.place]) for head in used]
        said = [cell for cell in cells if cell]
        if not all(is_unit(cell) for cell in said) or all(re.fullmatch("[0-9.e-]*[0-9]", cell) for cell in said):
            return
        for head, cell in zip(used, cells, strict=True):
            if not cell:
                continue
            if head.mark is not None and head.mark != plain_mark(cell):
                raise DataError(
                    f"{self.file}: column '{self.title(head)}' has another unit, {short(cell)}, in the row below; "
                    "keep one of them."
                )
            heads = self.found[next(quantity for quantity, heads in self.found.items() if head in heads)]
            heads[heads.index(head)] = replace(head, mark=plain_mark(cell))
        self.table = replace(self.table, rows=self.table.rows[1:])
        if not self.table.rows:
            raise DataError(f"{self.file}: holds a header and no row; must have a header and at least one row.")

    def _of_one(self, head: Head) -> float | None:
        """Size of the unit of a strain or ratio, None where unmarked."""
        if head.mark is None:
            return None
        if head.mark not in OF_ONE:
            raise DataError(
                f"{self.file}: column '{self.title(head)}' is marked {short(head.mark)}, which is no unit of it known "
                "here; write [-], [%], [permille] or [microstrain], and change the numbers where they are another."
            )
        return OF_ONE[head.mark]

    def _same(self, quantity: str, columns: list[np.ndarray]) -> np.ndarray:
        """The first of columns of one quantity, which must agree."""
        heads = self.found[quantity]
        for head, column in zip(heads[1:], columns[1:], strict=True):
            apart = np.abs(column - columns[0]) > 0.1 * _AGREE * np.abs(columns[0]).max()
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                raise DataError(
                    f"{self.file}: columns '{self.title(heads[0])}' and '{self.title(head)}' are both {quantity}, but "
                    f"give {columns[0][row]:g} and {column[row]:g} in data row {row + 1}, in one unit; remove or "
                    "rename the wrong one."
                )
        return columns[0]

    def _strain(self, quantity: str) -> np.ndarray:
        columns = []
        for head in self.found[quantity]:
            said = self._of_one(head)
            if self.unit is not None and said is not None and said != self.unit:
                raise DataError(
                    f"{self.file}: column '{self.title(head)}' is marked in {WORDS[said]}, but unit = "
                    f"{WORDS[self.unit]!r}; drop one of them."
                )
            sign = (-1 if quantity == DILATION else self.sign) if head.sign is None else head.sign
            size = said or self.unit or 1.0
            columns.append(sign * self.numbers[head.place] * size)
        return self._same(quantity, columns)

    def _volume(self) -> np.ndarray | None:
        given = [quantity for quantity in (VOLUME, DILATION) if quantity in self.found]
        if not given:
            return None
        strain, volume = self.found[STRAIN][0], self.found[given[0]][0]
        if self.unit is None and (strain.mark is None) != (volume.mark is None):
            bare, marked = (strain, volume) if strain.mark is None else (volume, strain)
            raise DataError(
                f"{self.file}: column '{self.title(marked)}' is marked with a unit and '{self.title(bare)}' (up to "
                f"{np.abs(self.numbers[bare.place]).max():g}) is not, so that its unit cannot be known; write [%] or "
                f"[-] behind '{self.title(bare)}'."
            )
        columns = [self._strain(quantity) for quantity in given]
        if np.abs(columns[-1] - columns[0]).max() > 0.1 * _AGREE * np.abs(columns[0]).max():
            raise DataError(
                f"{self.file}: columns '{self.title(volume)}' and '{self.title(self.found[DILATION][0])}' contradict "
                "each other; remove the wrong one."
            )
        return columns[0]

    def _ratio(self) -> tuple[np.ndarray, np.ndarray | None, bool]:
        """(stress ratio, confining stress or None, whether that is in Pa)."""
        ways: dict[str, np.ndarray] = {}
        if RATIO in self.found:
            columns = [self.numbers[head.place] * (self._of_one(head) or 1.0) for head in self.found[RATIO]]
            ways[f"'{self.title(self.found[RATIO][0])}'"] = self._same(RATIO, columns)
        confining, marked = None, False
        if CONFINING in self.found:
            stresses = [quantity for quantity in (CONFINING, AXIAL, DEVIATOR) if quantity in self.found]
            sizes, marked = self._stress_units([head for quantity in stresses for head in self.found[quantity]])
            value = {
                quantity: self._same(
                    quantity, [self.numbers[head.place] * sizes[head.place] for head in self.found[quantity]]
                )
                for quantity in stresses
            }
            confining = self.sign * value[CONFINING]
            self._check_pressed(confining, {q: self.sign * value[q] for q in stresses[1:]})
            under = self.title(self.found[CONFINING][0])
            if AXIAL in value:
                ways[f"'{self.title(self.found[AXIAL][0])}' over '{under}'"] = self.sign * value[AXIAL] / confining
            if DEVIATOR in value:
                over = self.title(self.found[DEVIATOR][0])
                ways[f"1 + '{over}' over '{under}'"] = 1 + self.sign * value[DEVIATOR] / confining
        (first, ratio), *others = ways.items()
        for other, again in others:
            apart = np.abs(again - ratio) > _AGREE * np.abs(ratio)
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                raise DataError(
                    f"{self.file}: the stress ratio s1/s3 in data row {row + 1} is {ratio[row]:g} by {first}, but "
                    f"{again[row]:g} by {other}; remove or rename the wrong column."
                )
        return ratio, confining, marked

    def _total_stresses(self) -> tuple[str, ...]:
        """A sentence where a column of pore pressure, not zero, stands beside stresses not said to be effective."""
        stresses = [self.title(head) for kind in (CONFINING, AXIAL) for head in self.found.get(kind, [])]
        effective = re.compile("effective|['\u2019\u2032]", re.IGNORECASE)
        if RATIO in self.found or all(effective.search(one) for one in stresses):
            return ()
        return tuple(
            f"'{short(cell, quoted=False)}' ({short(first, quoted=False)} in data row 1) stands beside "
            f"{' and '.join(map(repr, stresses))}: s1/s3 is made of them as they are; if they are total stresses, "
            "subtract the pore pressure in the file."
            for cell, first in zip(self.table.header, self.table.rows[0], strict=True)
            if taken_apart(0, cell).name in PORE_PRESSURE and first.strip("+-0.,")
        )

    def _check_pressed(self, confining: np.ndarray, others: dict[str, np.ndarray]) -> None:
        """Stresses, compression positive by now, must be so."""
        title = self.title(self.found[CONFINING][0])
        row = int(np.argmin(confining))
        if (confining < 0).all():
            other = next(iter(others), None)
            also = "" if other is None else f" and '{self.title(self.found[other][0])}'"
            raise DataError(
                f"{self.file}: '{title}'{also} look tension-positive ('{title}' is {self.sign * confining[0]:g} in "
                "data row 1); compression must be positive: turn the signs of strains and stresses in the file."
            )
        if not confining[row] > 0:
            raise DataError(
                f"{self.file}: '{title}' = {self.sign * confining[row]:g} in data row {row + 1}: must be positive to "
                "divide by; correct or remove the row."
            )

    def _stress_units(self, heads: list[Head]) -> tuple[dict[int, float], bool]:
        """({place: size in Pa}, True), or sizes of 1 where all columns share one unknown unit or none."""
        marks = [head.mark for head in heads]
        if all(mark in PASCAL for mark in marks):
            return {head.place: PASCAL[head.mark] for head in heads if head.mark is not None}, True
        if len(set(marks)) == 1:
            return {head.place: 1.0 for head in heads}, False
        odd = next(head for head in heads if head.mark not in PASCAL)
        mark = "without a unit" if odd.mark is None else f"marked {short(odd.mark)}, which is no unit of stress known"
        raise DataError(
            f"{self.file}: column '{self.title(odd)}' is {mark}, beside "
            f"{', '.join(repr(self.title(head)) for head in heads if head is not odd)}: the stress ratio cannot be "
            "known; write [Pa], [kPa], [MPa], [bar] or [psi] behind every stress."
        )
