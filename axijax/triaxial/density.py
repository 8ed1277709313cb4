"""How dense and how loose a grading packs, found once and kept: what a relative density is measured between.

Both states are compacted like any specimen, at the test's own confining stress and with its stiffness, the densest with
hardly any friction, the loosest with as much as helps. They are counted as every record counts a void ratio.
"""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from axijax.core.files import write_whole
from axijax.core.fingerprint import fingerprint
from axijax.core.platform import CACHE_VARIABLE

if TYPE_CHECKING:
    from axijax.specimen.specimen import Specimen
    from axijax.triaxial.packing_report import PackingReport

# Compaction frictions between which a void ratio is sought. With none a packing may never settle.
DENSEST, LOOSEST = 0.02, 1.0
TRIALS = 12  # compactions at most
SEEDS = 0.02  # in void ratio, by which two seeds' densest or loosest packings may be apart
PROTOCOL = 1  # of the compaction; raise it whenever packings change


class Bounds(NamedTuple):
    """Void ratios of a grading's densest and loosest packing, counted below the skin [-]."""

    densest: float
    loosest: float

    def void_ratio(self, relative_density: float) -> float:
        """That of a relative density (e_max - e)/(e_max - e_min)."""
        return self.loosest - relative_density * (self.loosest - self.densest)

    def relative_density(self, void_ratio: float) -> float:
        return (self.loosest - void_ratio) / (self.loosest - self.densest)


Compacted = Callable[[float], "tuple[Specimen, PackingReport]"]


def bounds(compacted: Compacted, asked: Any, folder: Path | None) -> Bounds:
    """Bounds of a grading, from the library in `folder` where they are known, or else found and put there.

    compacted: makes a packing with a friction. asked: what the packings are made from, any tree of dataclasses, numbers
    and words; with another of these they are others.
    """
    key = fingerprint({"asked": asked, "protocol": PROTOCOL})
    name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:24] + ".json"
    known = _read(folder / name) if folder else None
    if known is None:
        known = Bounds(*(compacted(friction)[1].counted_void_ratio for friction in (DENSEST, LOOSEST)))
        if folder:
            _keep(folder / name, known, key)
    return known


def library() -> Path | None:
    """Folder of the bounds found, beside the compiled programs; None where AXIJAX_CACHE is "off" or without a home."""
    asked = os.environ.get(CACHE_VARIABLE, "")
    if asked.lower() in ("0", "off", "no", "false"):
        return None
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~").expanduser() / ".cache")
        return (Path(asked).expanduser() if asked else home / "axijax") / "densities"
    except RuntimeError:  # a user without a home
        return None


def _read(path: Path) -> Bounds | None:
    """None where it is missing or damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        known = Bounds(float(found["densest"]), float(found["loosest"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return known if 0 < known.densest < known.loosest else None


def _keep(path: Path, known: Bounds, key: dict[str, str]) -> None:
    """A library that cannot be written is none: the bounds are found again."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(known._asdict() | {"of": key}, indent=1) + "\n"
        write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))
    except OSError:
        return


def sought(compacted: Compacted, void_ratio: float, tolerance: float, asked: str, slack: float = 0.0):
    """A packing of this void ratio: regula falsi in the compaction friction, which the void ratio rises with.

    asked: how the user has said it. slack: by which it may lie beyond what this seed reaches, whose end is then taken.

    Raises ValueError where it cannot be reached, with the range that can.
    """
    low, high = DENSEST, LOOSEST
    ends = compacted(low), compacted(high)
    below, above = (report.counted_void_ratio for _, report in ends)
    best = min(ends, key=lambda end: abs(end[1].counted_void_ratio - void_ratio))
    if not below - tolerance <= void_ratio <= above + tolerance:
        if below - slack <= void_ratio <= above + slack:
            return best
        raise ValueError(
            f"{asked}: this grading, size and seed reach {below:.4f} (compaction friction {low:g}) "
            f"to {above:.4f} ({high:g}); ask for one between."
        )
    for trial in range(2, TRIALS + 1):
        if abs(best[1].counted_void_ratio - void_ratio) <= tolerance:
            return best
        if trial == TRIALS:
            break
        # The rise is steep at small frictions: every second trial halves the interval.
        weight = 0.5 if trial % 2 else min(max((void_ratio - below) / max(above - below, 1e-12), 0.1), 0.9)
        friction = low * (high / low) ** weight
        now = compacted(friction)
        if now[1].counted_void_ratio < void_ratio:
            low, below = friction, now[1].counted_void_ratio
        else:
            high, above = friction, now[1].counted_void_ratio
        best = min((best, now), key=lambda end: abs(end[1].counted_void_ratio - void_ratio))
    nearest = best[1].counted_void_ratio
    raise ValueError(
        f"{asked}: the nearest that was reached in {TRIALS} compactions is {nearest:.4f}; allow a void_ratio_tolerance "
        f"above {abs(nearest - void_ratio):.4f}, or take another seed."
    )
