"""Material files of the Sand Triaxial Test Database (H. Wang, doi 10.4121/086847a6-ba39-4d66-973b-6b93028c7ad8), read
as they are: one CSV of six sections, each a table under a line such as '# ===== [6] TEST_DATA ====='.

An empty cell means that the source does not report it. e_0 is that at the start of the shear.
"""

import csv
import re
from collections.abc import Mapping

from calibrate.facts import Facts
from calibrate.names import PASCAL, Head, plain_mark, taken_apart
from calibrate.table import DataError, short

_SECTION = re.compile(r"#\s*=+\s*(?:\[\d+\]\s*)?([A-Z][A-Z_ ]+?)\s*=*\s*")
DATA, PROGRAMME, INDEX, GRADING, INFO, SOURCES = (
    "TEST_DATA", "TEST_PROGRAMME", "INDEX_PROPERTIES", "PARTICLE_SIZE_DISTRIBUTION", "FILE_INFO", "SOURCES",
)  # fmt: skip
ID = "test_id"

Row = Mapping[str, str]


def sections(text: str) -> dict[str, list[str]] | None:
    """The lines of each section by its name; None for any other file."""
    found: dict[str, list[str]] = {}
    lines: list[str] | None = None
    for line in re.split("\r\n|\r|\n", text):
        if head := _SECTION.fullmatch(line.strip().strip(",;")):
            lines = found.setdefault(head[1].strip().replace(" ", "_"), [])
        elif lines is not None and line.strip(" ,;") and not line.startswith("#"):
            lines.append(line)
    return found if found.get(DATA) else None


def chosen(file: str, tests: list[str], wanted: str | None) -> str | None:
    """The test to read: the one wanted, or the only one; None where the file names none.

    Raises DataError, with the names, where one must be named, or the one wanted is not there.
    """
    names = list(dict.fromkeys(tests))
    listed = ", ".join(short(name, quoted=False) for name in names[:30])
    listed += f" and {len(names) - 30} more" if len(names) > 30 else ""
    if wanted is None:
        if len(names) > 1:
            raise DataError(
                f"{file}: holds {len(names)} tests, {listed}; say which one, by test = {names[0]!r} "
                f"(--test {names[0]})."
            )
        return names[0] if names else None
    for name in names:
        if name.strip().casefold() == wanted.strip().casefold():
            return name
    raise DataError(f"{file}: has no test {wanted!r}; " + (f"it has {listed}." if names else "it names none."))


def one_test(file: str, found: Mapping[str, list[str]], wanted: str | None) -> tuple[str, Facts]:
    """(table of one test as text, what the file says of it)."""
    header, *rows = found[DATA]
    columns = _cells(header)
    if ID not in columns:
        raise DataError(f"{file}: its section {DATA} has no column '{ID}'; it has {', '.join(columns[:12])}.")
    place = columns.index(ID)
    ids = [(_cells(row) + [""] * len(columns))[place] for row in rows]
    name = chosen(file, [each for each in ids if each], wanted)
    text = "\n".join([header, *(row for row, each in zip(rows, ids, strict=True) if each == name)])
    return text, _facts(file, found, name or "")


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]))]


def _rows(found: Mapping[str, list[str]], section: str) -> list[Row]:
    lines = found.get(section, [])
    if not lines:
        return []
    header = _cells(lines[0])
    return [dict(zip(header, _cells(line), strict=False)) for line in lines[1:]]


def _facts(file: str, found: Mapping[str, list[str]], test: str) -> Facts:
    programme = next((row for row in _rows(found, PROGRAMME) if row.get(ID) == test), {})
    by_name = {_head(name).name: (_head(name).mark, value) for name, value in programme.items()}

    def number(name: str, size: Mapping[str, float] | float = 1.0) -> float | None:
        mark, value = by_name.get(name, (None, ""))
        if not value:
            return None
        try:
            return float(value) * (size if isinstance(size, float) else size[str(mark)])
        except (ValueError, KeyError):
            raise DataError(
                f"{file}: {PROGRAMME} gives {short(name, quoted=False)} = {short(value)} for {test}; it must be a "
                "number in a unit that is known."
            ) from None

    density = number("dr0", 0.01)
    state = {label: value for label, name in (("s3/s1", "kc"), ("OCR", "ocr")) if (value := number(name)) is not None}
    return Facts(
        test, _info(found), number("e0"), number("sigmar0", PASCAL), density,
        {name: value for name, value in state.items() if abs(value - 1) > 0.01} or None,
        _index(found) or None, _grading(file, found), _source(found),
    )  # fmt: skip


def _head(name: str) -> Head:
    return taken_apart(0, name)


def _info(found) -> str:
    pairs = [_cells(line) for line in found.get(INFO, [])]
    material = re.compile("material([ _]name)?", re.IGNORECASE)
    return next((pair[1] for pair in pairs if len(pair) > 1 and material.fullmatch(pair[0])), "")


def _source(found) -> str:
    rows = [row for row in _rows(found, SOURCES) if "data source" in row.get("role", "").casefold()]
    told = [[value for name, value in row.items() if value and name.casefold() not in ("role", "id")] for row in rows]
    return "; ".join(" ".join(values) for values in told)


def _index(found) -> dict[str, float]:
    """The index properties that are numbers, by their symbols."""
    values = {}
    for row in _rows(found, INDEX):
        try:
            values[row.get("symbol") or next(iter(row.values()))] = float(row.get("value", ""))
        except (ValueError, StopIteration):
            continue
    return values


def _grading(file: str, found) -> tuple[tuple[float, float], ...]:
    """((diameter [mm], finer [%]), ..) of the first sieving."""
    rows = _rows(found, GRADING)
    if not rows:
        return ()
    marks = {name: _mark(name) for name in rows[0]}
    size = next((name for name, mark in marks.items() if mark == "mm"), None)
    finer = next((name for name, mark in marks.items() if mark == "%"), None)
    if size is None or finer is None:
        return ()
    first = next((row.get("sieving_id") for row in rows if row.get(size)), None)
    try:
        pairs = [(float(row[size]), float(row[finer])) for row in rows
                 if row.get("sieving_id") == first and row.get(size) and row.get(finer)]  # fmt: skip
    except ValueError:
        raise DataError(f"{file}: its section {GRADING} holds a cell that is no number; correct it.") from None
    return tuple(sorted(pairs))


def _mark(name: str) -> str | None:
    """The unit in a header, whatever its name."""
    inside = re.findall(r"[\[(]([^\])]*)[\])]", name)
    return plain_mark(inside[-1]) if inside else None
