"""The text of a measured file as a table of cells, and its cells as numbers.

Laboratories write files in many ways: lines above the header, comments, semicolons with decimal commas, byte order
marks, trailing separators. What can be read in one way only is read; anything else ends in one sentence.
"""

import codecs
import csv
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

SEPARATORS = ("\t", ";", ",")
BLANKS = " "  # between columns, where no separator makes a header
HEADER_WITHIN = 200  # lines in which the header is looked for
_POINT = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_COMMA = re.compile(r"[+-]?([0-9]+,?[0-9]*|,[0-9]+)([eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(,[0-9]{3})+")
_NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
# First bytes of files that are often taken for tables.
_FOREIGN = {
    b"PK\x03\x04": "an Excel workbook (or another zip archive): save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook: save the sheet as CSV",
    b"\x1f\x8b": "compressed by gzip: unpack it",
    b"%PDF": "a PDF: give the numbers as a CSV file",
    b"CDF": "a NetCDF file: give the numbers as a CSV file",
    b"\x89HDF": "an HDF5 or NetCDF file: give the numbers as a CSV file",
}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


class DataError(ValueError):
    """Measured data that cannot be used; says which number, why and what to do."""


@dataclass(frozen=True)
class Table:
    """file: its name, for messages. header: cells of the header. rows: cells of the rows below it, as many each.
    comments: the lines that begin with #, and those above the header."""

    file: str
    header: list[str]
    rows: list[list[str]]
    comments: tuple[str, ...] = ()

    def numbers(self, places: Iterable[int]) -> dict[int, np.ndarray]:
        """Columns at these places as numbers. One decimal mark holds for all of them: a comma only where some cell
        cannot be a number with thousands separators instead."""
        places = sorted(set(places))
        decimal = self._decimal_mark(places)
        return {place: self._column(place, decimal) for place in places}

    def _decimal_mark(self, places) -> str:
        cells = [_plain_minus(row[place]) for row in self.rows for place in places]
        with_comma = [cell for cell in cells if "," in cell]
        if not with_comma:
            return "."
        doubtful = next((cell for cell in with_comma if not _COMMA.fullmatch(cell)), None)
        if doubtful is None and all(_THOUSANDS.fullmatch(cell) for cell in with_comma):
            doubtful = with_comma[0]
        with_point = next((cell for cell in cells if "." in cell), None)
        if doubtful is None and with_point is not None:
            raise DataError(
                f"{self.file}: both {short(with_comma[0])} and {short(with_point)} occur: a file must have one decimal "
                "mark; write all numbers with a decimal point and without thousands separators."
            )
        if doubtful is not None:
            raise DataError(
                f"{self.file}: {short(doubtful)} may hold a decimal comma or a thousands separator, or neither; write "
                "all numbers with a decimal point and without thousands separators."
            )
        return ","

    def _column(self, place: int, decimal: str) -> np.ndarray:
        values = np.empty(len(self.rows))
        form = _POINT if decimal == "." else _COMMA
        for number, row in enumerate(self.rows):
            cell = _plain_minus(row[place])
            if form.fullmatch(cell):
                values[number] = float(cell.replace(",", "."))
                if np.isfinite(values[number]):
                    continue
            where = f"in data row {number + 1}"
            name = short(self.header[place], quoted=False)
            if form.fullmatch(cell) or _NOT_FINITE.fullmatch(cell):
                raise DataError(
                    f"{self.file}: {name} = {short(cell, quoted=False)} {where}: must be a finite number; remove the "
                    "row or fill it."
                )
            raise DataError(
                f"{self.file}: {name} = {short(cell)} {where}: must be a number with a decimal point, without "
                "thousands separators; write it so, or remove the row."
            )
        return values


def read_table(name: str, text: str, score: Callable[[list[str]], int]) -> Table:
    """The table in the text of a file of this name.

    score: how many of the columns that are looked for a row of cells names; the row that names most is the header,
    whatever stands above it. Lines that start with # are comments.

    Raises DataError, naming the file, where there is no such table.
    """
    every = [line for line in re.split("\r\n|\r|\n", text) if line.strip()]
    comments = [line for line in every if line.lstrip("\ufeff \t").startswith("#")]
    lines = [line for line in every if not line.lstrip("\ufeff \t").startswith("#")]
    if not lines:
        raise DataError(f"{name}: holds no line beside comments; must have a header and at least one row.")
    place, separator = _header(name, lines, score)
    header = _without_end(_cells(name, lines[place], separator))
    rows: list[list[str]] = []
    for line in lines[place + 1 :]:
        cells = _cells(name, line, separator, below=True)
        if not any(cells):
            continue
        if len(cells) > len(header) and not any(cells[len(header) :]):
            cells = cells[: len(header)]
        if len(cells) != len(header):
            hint = (
                "columns are taken apart at blanks here: put semicolons or tabs between them"
                if separator == BLANKS
                else "numbers with a decimal comma need semicolons or tabs between the columns"
            )
            raise DataError(
                f"{name}: data row {len(rows) + 1} has {len(cells)} cells, the header {len(header)}; they must match "
                f"({hint})."
            )
        rows.append(cells)
    if not rows:
        raise DataError(f"{name}: holds a header and no row; must have a header and at least one row.")
    return Table(name, header, rows, (*comments, *lines[:place]))


def short(text: str, quoted: bool = True) -> str:
    """A cell for a message: its beginning only where it is long, quoted, no control character left."""
    shown = repr(text if len(text) <= 40 else text[:40])
    return (shown if quoted else shown[1:-1]) + ("" if len(text) <= 40 else f"... ({len(text)} characters)")


def text_of(path: Path) -> str:
    """The text of a file, whatever its encoding. Raises DataError for what is no text."""
    try:
        if path.is_dir():
            raise DataError(f"{path}: is a folder; give the path of a CSV file.")
        if not path.is_file():
            raise DataError(f"{path}: no such file; give the path of a CSV file.")
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); give the path of a readable CSV file.") from None
    for start, what in _FOREIGN.items():
        if content.startswith(start):
            raise DataError(f"{path.name}: is {what}.")
    encoding = next((encoding for mark, encoding in _MARKS.items() if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            raise DataError(
                f"{path.name}: begins as {encoding} and does not go on so; save it again as UTF-8 text."
            ) from None
        # Older Windows programs. Names and numbers that count are ASCII, and the rest is not read; a letter that
        # comes out wrong in a unit is an unknown unit.
        text = content.decode("cp1252", errors="replace")
    if "\0" in text:
        raise DataError(f"{path.name}: is not text in UTF-8 (it holds zero bytes); save it as CSV, UTF-8.")
    return text


def _header(name: str, lines: list[str], score) -> tuple[int, str]:
    """(place, separator) of the row that names most columns, or else of the widest row above the numbers."""
    best, found = (0, 0), None
    blank: tuple[tuple[int, int], tuple[int, str] | None] = ((0, 0), None)
    widest, fallback = 0, (0, ",")
    for place, line in enumerate(lines[:HEADER_WITHIN]):
        split = {separator: _without_end(_cells(name, line, separator)) for separator in SEPARATORS}
        spaced = _cells(name, line, BLANKS)
        if any(len(cells) > 1 and all(_is_number(cell) for cell in cells) for cells in (*split.values(), spaced)):
            if found is None and place == 0:
                cells = max((*split.values(), spaced), key=len)
                raise DataError(
                    f"{name}: the first row holds numbers ({', '.join(short(cell, False) for cell in cells[:3])}); it "
                    "must name the columns (a header behind # counts as a comment)."
                )
            break
        for separator, cells in split.items():
            if (rank := (score(cells), len(cells))) > best and rank[0] > 0:
                best, found = rank, (place, separator)
            if len(cells) > widest:
                widest, fallback = len(cells), (place, separator)
        if (rank := (score(spaced), len(spaced))) > blank[0] and rank[0] > 0:
            blank = rank, (place, BLANKS)
    # A header that only blanks take apart names two columns at least; else it is a line of words.
    if blank[1] is not None and blank[0][0] > max(best[0], 1):
        return blank[1]
    return found or fallback


def _cells(name: str, line: str, separator: str, below: bool = False) -> list[str]:
    """The cells of a line. below: of a row of numbers and not of the header, whose names may hold single blanks."""
    if separator == BLANKS:
        text = line.strip().strip("\ufeff")
        if below or not re.search(r"\S\s{2,}\S", text):
            return text.split() if below else _words(text)
        return re.split(r"\s{2,}", text)
    try:
        return [cell.strip().strip("\ufeff") for cell in next(csv.reader([line], delimiter=separator))]
    except csv.Error:
        raise DataError(
            f"{name}: the line that begins with {short(line)} cannot be taken apart; is this a table of numbers?"
        ) from None


def _words(text: str) -> list[str]:
    """Words between single blanks, a unit in brackets with the word before it."""
    words: list[str] = []
    for word in text.split():
        if words and word[0] in "[({":
            words[-1] += f" {word}"
        else:
            words.append(word)
    return words


def _without_end(cells: list[str]) -> list[str]:
    """The cells without the empty ones that trailing separators make."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells


def _plain_minus(cell: str) -> str:
    return cell.replace("\N{MINUS SIGN}", "-")


def _is_number(cell: str) -> bool:
    cell = _plain_minus(cell)
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell) or _NOT_FINITE.fullmatch(cell))
