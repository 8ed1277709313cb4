"""The command line called in this process: its exit code and what it printed, in milliseconds."""

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

from axijax.app.cli.main import main

# A small case that is confined and sheared past its peak in about a second, once compiled.
SMALL = """
[specimen]
layers = 5
half_width = 5
[parameters]
platen_speed = 0.01
[test]
axial_strain = 0.012
record_every = 100
tolerance = 1e-5
"""


@dataclass(frozen=True)
class Called:
    code: int
    out: str
    err: str


def axijax(*arguments) -> Called:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return Called(code, out.getvalue(), err.getvalue())


def write(path: Path, text: str = SMALL) -> Path:
    path.write_text(text)
    return path
