"""The columns of a measured file as strains, stress ratio and stresses in one kind of unit.

A unit that is not known, or a unit on one of two columns only, is asked for; columns that say one thing twice must
agree. So no number is scaled by a guess.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibrate import database
from calibrate.facts import Facts, agreed, of_comments
from calibrate.mapping import Request, found_columns, named_columns
from calibrate.names import (
    DILATION,
    METRE,
    OF_ONE,
    RATIO,
    SHORTENING,
    STRAIN,
    TEST,
    VOID,
    VOLUME,
    Head,
    is_unit,
    plain_mark,
)  # fmt: skip
from calibrate.stresses import AGREE, StressReader, known_from
from calibrate.table import DataError, Table, read_table, short, text_of

VOID_ROUNDING = 1e-3  # of volumetric strains made of void ratios, which are written with three decimals
START = 1e-5  # axial strain at which a void ratio is that of the start


@dataclass(frozen=True)
class Measured:
    """What a file says, (M,) each: strains as fractions, compression positive.

    confining_stress: in Pa where stress_marked, otherwise as written; None where the file has none.
    strain_marked: whether the axial strain carries a unit.
    facts: what the file says beside its columns. doubts: sentences on columns that may be others than they were taken
        for, and on what was left out.
    """

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    volumetric_strain: np.ndarray | None
    confining_stress: np.ndarray | None
    made_of: str
    stress_marked: bool
    strain_marked: bool
    facts: Facts
    doubts: tuple[str, ...]


def read_columns(path: Path, request: Request) -> Measured:
    """The columns of a file. Raises DataError, naming file, column and row."""
    file, text = path.name, text_of(path)
    sections = database.sections(text)
    facts = Facts()
    if sections is not None:
        text, facts = database.one_test(file, sections, request.test)
    named = named_columns(file, request.columns)

    def score(cells: list[str]) -> int:
        found = {quantity for quantity, _ in found_columns(file, cells, named)}
        return len(found) if found & {STRAIN, SHORTENING} else 0

    table = read_table(file, text, score)
    found: dict[str, list[Head]] = {}
    for quantity, head in found_columns(file, table.header, named):
        found.setdefault(quantity, []).append(head)
    if sections is None:
        table, facts = _one_test(table, found, request.test, of_comments(file, table.comments))
    found.pop(TEST, None)
    return _Reader(table, found, named, request, facts).read()


def _one_test(table: Table, found, wanted: str | None, facts: Facts) -> tuple[Table, Facts]:
    """The rows of one test of a table with a column of their names."""
    if TEST not in found:
        if wanted is not None:
            raise DataError(f"{table.file}: test = {wanted!r} is asked for, but there is no column 'test_id'.")
        return table, facts
    place = found[TEST][0].place
    name = database.chosen(table.file, [row[place] for row in table.rows if row[place]], wanted)
    if name is None:
        return table, facts
    rows = [row for row in table.rows if row[place] == name]
    return replace(table, rows=rows), replace(facts, test=name)


class _Reader:
    """Turns the columns found in a table into numbers of one kind."""

    def __init__(self, table: Table, found: dict[str, list[Head]], named, request: Request, facts: Facts):
        self.table, self.found, self.named, self.request, self.facts = table, found, named, request, facts
        self.file = table.file
        self.left_out: list[str] = []
        self.void_ratio = agreed(self.file, "void_ratio", request.void_ratio, facts.void_ratio, 2e-3)
        # What the file says beside its columns serves where they say nothing.
        given = request.confining_stress
        agreed(self.file, "confining_stress [Pa]", given, facts.confining_stress, 0.05)
        if given is None and not known_from(found, None):
            given = facts.confining_stress
        self.confining = given

    def read(self) -> Measured:
        self._check_there()
        self._take_row_of_units()
        self._leave_out_gaps()
        places = [head.place for heads in self.found.values() for head in heads]
        self.numbers = self.table.numbers(places)
        strain, marked = self._strain()
        volume = self._volume(strain)
        reader = StressReader(self.table, self.found, self.numbers, self._same, self._of_one, self.confining)
        stresses = reader.read()
        facts = replace(self.facts, void_ratio=self.void_ratio)
        if facts.confining_stress is None and self.request.confining_stress is not None:
            facts = replace(facts, confining_stress=self.request.confining_stress)
        doubts = (*self.left_out, *reader.total_stresses())
        return Measured(
            strain, stresses.ratio, volume, stresses.confining, stresses.made_of, stresses.in_pascal, marked, facts,
            doubts,
        )  # fmt: skip

    def title(self, head: Head) -> str:
        return short(self.table.header[head.place], quoted=False)

    def _check_there(self) -> None:
        has = [short(cell, quoted=False) for cell in self.table.header if cell]
        listed = ", ".join(has[:12]) + (f" and {len(has) - 12} more" if len(has) > 12 else "")
        if len(has) == 1:
            listed += " alone (commas, semicolons, tabs or blanks must stand between columns)"
        strain = STRAIN in self.found or SHORTENING in self.found
        missing = [] if strain else [STRAIN]
        missing += [quantity for quantity, (text, _) in self.named.items() if text and quantity not in self.found]
        if not known_from(self.found, self.confining):
            missing.append(RATIO)
        for quantity in missing:
            name = self.named.get(quantity, ("", None))[0] or quantity
            instead = "" if quantity != RATIO else (
                ", or give two of axial_stress, confining_stress, q = s1 - s3 and p, or one of them and the confining "
                "stress as a number with its unit (--confining-stress '100 kPa')"
            )  # fmt: skip
            raise DataError(
                f"{self.file}: no column '{short(name, quoted=False)}'; it has {listed}. Say which it is (columns, "
                f"--column '{quantity}=NAME [UNIT]'), or write '{quantity}' over the right column of the file{instead}."
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

    def _leave_out_gaps(self) -> None:
        """Volumes that were not measured: none at all, or rows without."""
        for quantity in (VOLUME, DILATION, VOID):
            for head in list(self.found.get(quantity, [])):
                # A lattice's curve, as this program writes it, has no void ratio.
                none = ("", "nan") if quantity == VOID and {VOLUME, DILATION} & set(self.found) else ("",)
                empty = [row[head.place].casefold() in none for row in self.table.rows]
                if all(empty):
                    self.found[quantity].remove(head)
                    if not self.found[quantity]:
                        del self.found[quantity]
                    if not {VOLUME, DILATION, VOID} & set(self.found):
                        self.left_out.append(f"column '{self.title(head)}' is empty: there is no volume to compare.")
                elif any(empty):
                    rows = [row for row, gap in zip(self.table.rows, empty, strict=True) if not gap]
                    self.left_out.append(
                        f"{sum(empty)} of {len(empty)} rows have no '{self.title(head)}' (the first is data row "
                        f"{empty.index(True) + 1}) and are left out."
                    )
                    self.table = replace(self.table, rows=rows)

    def _of_one(self, head: Head) -> float | None:
        """Size of the unit of a strain or ratio, None where unmarked."""
        if head.mark is None:
            return None
        if head.mark in METRE:
            raise DataError(
                f"{self.file}: column '{self.title(head)}' is marked {short(head.mark)}, a length: give the specimen's "
                "height, such as '100 mm' (height, --height), for the axial strain; other strains must be [-] or [%]."
            )
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
            apart = np.abs(column - columns[0]) > 0.1 * AGREE * np.abs(columns[0]).max()
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                raise DataError(
                    f"{self.file}: columns '{self.title(heads[0])}' and '{self.title(head)}' are both {quantity}, but "
                    f"give {columns[0][row]:g} and {column[row]:g} in data row {row + 1}, in one unit; remove or "
                    f"rename the wrong one, or say which (columns, --column '{quantity}=NAME [UNIT]')."
                )
        return columns[0]

    def _strain(self) -> tuple[np.ndarray, bool]:
        """The axial strain, and whether its unit is given; a shortening counts over the height."""
        ways: list[tuple[Head, np.ndarray]] = []
        for head in self.found.get(STRAIN, []) + self.found.get(SHORTENING, []):
            size = METRE.get(head.mark or "")
            shortening = head in self.found.get(SHORTENING, [])
            if shortening and size is None:
                raise DataError(
                    f"{self.file}: column '{self.title(head)}' is a length and must have its unit, [mm] say, behind "
                    "its name; a strain has another name, axial_strain."
                )
            if size is not None and self.request.height is not None:
                per_height = size / self.request.height
            elif shortening and STRAIN in self.found:
                continue  # no height, and no need of it
            else:
                per_height = self._of_one(head) or 1.0
            ways.append((head, head.turned * self.numbers[head.place] * per_height))
        (first, strain), *others = ways
        for other, again in others:
            apart = np.abs(again - strain) > 0.1 * AGREE * np.abs(strain).max()
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                raise DataError(
                    f"{self.file}: columns '{self.title(first)}' and '{self.title(other)}' are both axial_strain, but "
                    f"give {strain[row]:g} and {again[row]:g} in data row {row + 1}, in one unit; remove or rename the "
                    f"wrong one, or say which (columns, --column '{STRAIN}=NAME [UNIT]')."
                )
        return strain, first.mark is not None

    def _volume(self, axial: np.ndarray) -> np.ndarray | None:
        """Volumetric strain, by itself or made of void ratios."""
        ways = {}
        marked = (self.found.get(STRAIN) or self.found[SHORTENING])[0]
        for quantity in (VOLUME, DILATION):
            if quantity not in self.found:
                continue
            head = self.found[quantity][0]
            if (marked.mark is None) != (head.mark is None):
                bare, other = (marked, head) if marked.mark is None else (head, marked)
                raise DataError(
                    f"{self.file}: column '{self.title(other)}' is marked with a unit and '{self.title(bare)}' (up to "
                    f"{np.abs(self.numbers[bare.place]).max():g}) is not, so that its unit cannot be known; write [%] "
                    f"or [-] behind '{self.title(bare)}'."
                )
            sign = -1 if quantity == DILATION else 1
            columns = [
                (sign if each.sign is None else each.sign) * self.numbers[each.place] * (self._of_one(each) or 1.0)
                for each in self.found[quantity]
            ]
            ways[head] = self._same(quantity, columns), 0.0
        if VOID in self.found:
            head = self.found[VOID][0]
            ways[head] = self._of_void_ratio(axial), VOID_ROUNDING
        if not ways:
            return None
        (first, (volume, _)), *others = ways.items()
        for other, (again, rounding) in others:
            if np.abs(again - volume).max() > (0.1 + bool(rounding)) * AGREE * np.abs(volume).max() + rounding:
                raise DataError(
                    f"{self.file}: columns '{self.title(first)}' and '{self.title(other)}' contradict each other; "
                    "remove the wrong one."
                )
        return volume

    def _of_void_ratio(self, axial: np.ndarray) -> np.ndarray:
        columns = [self.numbers[head.place] * (self._of_one(head) or 1.0) for head in self.found[VOID]]
        void = self._same(VOID, columns)
        title = self.title(self.found[VOID][0])
        if not (void > 0).all():
            row = int(np.argmin(void))
            raise DataError(
                f"{self.file}: {title} = {void[row]:g} in data row {row + 1}: a void ratio must be positive."
            )
        if self.void_ratio is None:
            if axial[0] > START:
                raise DataError(
                    f"{self.file}: column '{title}' begins at axial strain {axial[0]:g}, so that the void ratio at the "
                    "start of the shear is not in it; give it (void_ratio, --void-ratio)."
                )
            self.void_ratio = float(void[0])
        return (self.void_ratio - void) / (1 + self.void_ratio)
