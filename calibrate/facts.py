"""What a measured file says of its specimen beside the columns: name of the test, void ratio, grading and so on.

It is taken over and shown, and used only where the file says nothing else: a confining stress where there is no column
of it, a void ratio at the start of the shear where the file counts void ratios.
"""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from calibrate.names import METRE, PASCAL, plain_mark
from calibrate.table import DataError

_NUMBER = r"([0-9]+(?:[.,][0-9]+)?(?:[eE][+-]?[0-9]+)?)"
_VOID = re.compile(r"(?:\be_?0\b|initial void ratio)\s*[=:,]?\s*" + _NUMBER, re.IGNORECASE)
_CONFINING = re.compile(
    r"(?:\b(?:sigma|sig|s)'?_?[3r]0?'?|\u03c3'?_?3'?|confining (?:stress|pressure)|cell pressure)\s*[=:,]?\s*"
    + _NUMBER + r"\s*\[?([A-Za-z]+[A-Za-z0-9/^\u00b2]*)",
    re.IGNORECASE,
)  # fmt: skip


@dataclass(frozen=True)
class Facts:
    """Each as the file, or the caller, gives it; None or empty where it is not given.

    test, material: names. void_ratio: at the start of the shear [-]. confining_stress: there [Pa].
    relative_density: likewise [-]. consolidation: s3/s1 of the consolidation and OCR, where they are not 1.
    index: {symbol: value} such as d50 [mm], Cu, Gs, e_max, e_min, phi_c [degrees].
    grading: ((diameter [mm], finer by mass [%]), ..). source: to be cited.
    """

    test: str = ""
    material: str = ""
    void_ratio: float | None = None
    confining_stress: float | None = None
    relative_density: float | None = None
    consolidation: Mapping[str, float] | None = None
    index: Mapping[str, float] | None = None
    grading: tuple[tuple[float, float], ...] = ()
    source: str = ""

    def as_dict(self) -> dict[str, Any]:
        """What is there, for JSON."""
        return {name: value for name, value in asdict(self).items() if value not in (None, "", (), {})}

    def __str__(self) -> str:
        told = [self.test, self.material]
        if self.void_ratio is not None:
            told.append(f"e0 = {self.void_ratio:g}")
        if self.confining_stress is not None:
            told.append(f"confining stress {self.confining_stress / 1e3:g} kPa")
        if self.relative_density is not None:
            told.append(f"relative density {100 * self.relative_density:.4g} %")
        if self.grading:
            told.append(f"grading of {len(self.grading)} sieves from {self.grading[0][0]:g} to "
                        f"{self.grading[-1][0]:g} mm")  # fmt: skip
        return ", ".join(text for text in told if text)


def of_comments(file: str, comments) -> Facts:
    """The void ratio and the confining stress that lines of comment give, such as '# e0 0.584, sigma3 100 kPa'.

    Raises DataError where two lines contradict each other.
    """
    voids, stresses = set(), set()
    for line in comments:
        voids |= {float(found[1].replace(",", ".")) for found in _VOID.finditer(line)}
        for found in _CONFINING.finditer(line):
            if (mark := plain_mark(found[2])) in PASCAL:
                stresses.add(float(found[1].replace(",", ".")) * PASCAL[mark])
    for name, values in (("void ratio at the start", voids), ("confining stress [Pa]", stresses)):
        if len(values) > 1:
            shown = " and ".join(f"{value:g}" for value in sorted(values))
            raise DataError(f"{file}: its comments give the {name} as {shown}; keep one of them.")
    return Facts(void_ratio=min(voids, default=None), confining_stress=min(stresses, default=None))


def length(name: str, text: str | None) -> float | None:
    """A length given as '100 mm', in metres. Raises DataError where number or unit are missing."""
    return _sized(name, text, METRE, "a length with its unit, such as '100 mm'")


def stress(name: str, text: str | None) -> float | None:
    """A stress given as '200 kPa', in Pa. Raises DataError where number or unit are missing."""
    return _sized(name, text, PASCAL, "a stress with its unit, such as '200 kPa'")


def _sized(name: str, text: str | None, units: Mapping[str, float], wanted: str) -> float | None:
    if text is None:
        return None
    found = re.fullmatch(r"\s*" + _NUMBER + r"\s*\[?([^\d\s\]]+[^\s\]]*)\]?\s*", str(text))
    if not found or plain_mark(found[2]) not in units or not float(found[1].replace(",", ".")) > 0:
        raise DataError(f"{name} = {text!r}: must be {wanted}.")
    return float(found[1].replace(",", ".")) * units[plain_mark(found[2])]


def agreed(file: str, name: str, given: float | None, says: float | None, tolerance: float) -> float | None:
    """What is given, or else what the file says. Raises DataError where they are further apart than a share."""
    if given is not None and says is not None and abs(given - says) > tolerance * abs(says):
        raise DataError(
            f"{file}: {name} = {given:g} is given, but the file says {says:g}; leave out one of them, or mend the file."
        )
    return says if given is None else given
