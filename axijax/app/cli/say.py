"""Text for people: as wide as the terminal, broken at words, never within a number, between it and its unit, or within
a path. In a pipe lines are 120 characters wide; what a program should read is behind --json."""

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable
from itertools import zip_longest

PIPE, LEAST = 120, 40
SHARE = 0.58  # of the width, for the names of a table of two columns, at most
# What belongs to the number before it, and the number to what is before it.
_UNITS = r"%|°|s|min|h|MB|MiB|mm|cm|kPa|MPa|bar|\[\S+\]|\+-"
_TOGETHER = re.compile(rf"(?<=[\d)]) (?=(?:{_UNITS})(?:[\s,;:.)]|$))|(?<=\+-) (?=\d)")
_KEPT = "\u00a0"


def width() -> int:
    """Characters in a line: what COLUMNS says, the terminal's, or 120 in a pipe."""
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit():
        return max(shutil.get_terminal_size((80, 24)).columns, LEAST)
    return PIPE


def wrapped(text: str, room: int, hanging: str = "") -> list[str]:
    """The lines of a text, broken at words where they are longer than the room; further ones begin with `hanging` and
    as far in as the first."""
    lines: list[str] = []
    for line in text.split("\n"):
        if len(line) <= room:
            lines.append(line)
            continue
        indent = line[: len(line) - len(line.lstrip())]
        kept = _TOGETHER.sub(_KEPT, line)
        parts = textwrap.wrap(
            kept, room, subsequent_indent=indent + hanging, break_long_words=False, break_on_hyphens=False
        )
        lines += [part.replace(_KEPT, " ") for part in parts]
    return lines


def say(text: object) -> None:
    """Print a text."""
    print("\n".join(wrapped(str(text), width(), "  ")), flush=True)


def say_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and values as two columns."""
    rows = list(rows)
    whole = width()
    left = min(max(len(name) for name, _ in rows), int(SHARE * whole))
    for name, value in rows:
        pairs = zip_longest(wrapped(name, left), wrapped(value, whole - left - 2), fillvalue="")
        print("\n".join(f"{a:{left}}  {b}".rstrip() for a, b in pairs))
    sys.stdout.flush()
