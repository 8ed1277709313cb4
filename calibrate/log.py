"""The log of a fit: JSON lines, a header that says what is fitted to what, then one line an evaluation.

A line holds what a run gave, its curve and tangents, and not what follows from them and the data, so that its length
does not depend on how many numbers were measured. Numbers are written so that they read back exactly. Each line ends
with a checksum: a line that was cut short by a kill is the last one and is dropped, any other damage is refused.
"""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from axijax.core.files import write_whole
from axijax.core.fingerprint import differences
from calibrate.model import FIELDS

KIND = "axijax log of a fit"
VERSION = 2
MARK = ', "crc32": "'

Key = tuple[tuple[float, ...], tuple[int, ...]]  # coordinates, and the places of the tangents


class FitLog:
    """Evaluations on file.

    path: of the log, continued where it exists. identity: the parts of what is fitted to what, as `fingerprint` makes
    them; a log with others is refused.

    Raises ValueError, naming what differs or the line that is damaged, for a log that cannot be used.
    """

    def __init__(self, path: Path, identity: Mapping[str, str]):
        self.path = Path(path)
        self.known: dict[Key, dict] = {}
        if not self._there():
            header = {"kind": KIND, "version": VERSION, "identity": dict(identity)}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, lambda target: target.write_text(_line(header)))
            return
        content = self._content()
        lines, _, cut = content.rpartition(b"\n")
        head, *rest = lines.split(b"\n")
        self._check(_entry(head), identity)
        for number, line in enumerate(rest, 2):
            entry = _entry(line)
            if entry is None or not _complete(entry):
                raise ValueError(
                    f"log '{self.path}' is damaged in line {number}: {self._remedy('to lose what it holds')}"
                )
            self.known[tuple(entry["z"]), tuple(entry["along"])] = entry
        if cut:  # what follows must begin a line of its own
            write_whole(self.path, lambda target: target.write_bytes(lines + b"\n"))

    def write(self, entry: Mapping) -> None:
        """Add an evaluation: values, z, along, failed, and of a sound one curve and tangents by field."""
        with self.path.open("a") as file:
            file.write(_line(entry))

    def _there(self) -> bool:
        try:
            return self.path.stat().st_size > 0
        except FileNotFoundError:
            return False
        except OSError as error:
            raise self._unreadable(error) from None

    def _content(self) -> bytes:
        try:
            return self.path.read_bytes()
        except OSError as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: OSError) -> ValueError:
        return ValueError(f"log '{self.path}' cannot be read ({error.strerror}): {self._remedy('to begin anew')}")

    def _check(self, header: dict | None, identity: Mapping[str, str]) -> None:
        if header is None or header.get("kind") != KIND:
            raise ValueError(
                f"log '{self.path}' has no header that can be read: it is damaged, of an earlier version or no log of "
                f"a fit; {self._remedy('to begin anew')}"
            )
        if header.get("version") != VERSION:
            raise ValueError(
                f"log '{self.path}' has format version {header.get('version')!r}, this program reads {VERSION}: "
                f"{self._remedy('to begin anew')}"
            )
        other = differences(identity, header.get("identity"))
        if other:
            raise ValueError(
                f"log '{self.path}' belongs to another fit, which differs in {other}: {self._remedy('to begin anew')}"
            )

    @staticmethod
    def _remedy(purpose: str) -> str:
        return f"name another file (another --output), or delete it {purpose}."


def curve_entry(curve) -> dict[str, list]:
    """The fields of a curve, or of its tangents, as a line holds them; what it has not, a lattice's void ratio, is left
    out."""
    fields = {name: np.asarray(getattr(curve, name), float) for name in FIELDS if hasattr(curve, name)}
    return {name: values.tolist() for name, values in fields.items() if not np.isnan(values).all()}


def curve_of_entry(entry: Mapping[str, list]) -> SimpleNamespace:
    """What `curve_entry` was made from, in float64."""
    return SimpleNamespace(**{name: np.array(values, float) for name, values in entry.items()})


def _line(entry: Mapping) -> str:
    text = json.dumps(entry)
    return f'{text[:-1]}{MARK}{zlib.crc32(text.encode()):08x}"}}\n'


def _entry(line: bytes) -> dict | None:
    """What a line holds; None where it is not as it was written."""
    try:
        text, mark, check = line.decode().rpartition(MARK)
        if not mark or check != f'{zlib.crc32((text + "}").encode()):08x}"}}':
            return None
        entry = json.loads(text + "}")
    except (ValueError, RecursionError):
        return None
    return entry if isinstance(entry, dict) else None


def _complete(entry: dict) -> bool:
    """Whether an entry holds all that an evaluation is made from."""
    wanted = {"z", "along", "failed"} if entry.get("failed") else {"z", "along", "failed", "curve", "tangents"}
    return wanted <= set(entry)
