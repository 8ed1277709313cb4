"""How laboratories name the columns of a triaxial test, mark their units and say which sign is positive.

Names are known in many spellings (axial_strain, eps_a, Sigma_1, q); units by the mark in brackets behind the name or
after it. What is not known is left for `columns` to refuse: nothing is taken for a fraction because it is unknown.
"""

import re
import unicodedata
from dataclasses import dataclass

STRAIN, RATIO, VOLUME, AXIAL, CONFINING = (
    "axial_strain", "stress_ratio", "volumetric_strain", "axial_stress", "confining_stress",
)  # fmt: skip
DEVIATOR, DILATION, MEAN, OBLIQUITY = "deviator_stress", "volumetric_dilation", "mean_stress", "q/p"
SHORTENING, VOID, TEST = "axial_displacement", "void_ratio", "test_id"
# Names without capitals, blanks, underscores, dots, primes and the word "effective"; Greek letters spelled out.
NAMES = {
    STRAIN: "axialstrain strainaxial verticalstrain epsa eps1 epsaxial epsilona epsilon1 epsilonaxial ea e1",
    SHORTENING: "axialdisplacement verticaldisplacement displacement axialdeformation axialshortening heightchange",
    RATIO: "r stressratio principalstressratio s1/s3 sig1/sig3 sigma1/sigma3 siga/sigr sigmaa/sigmar sigmav/sigmar",
    VOLUME: "volumetricstrain volumestrain volstrain strainvolumetric epsv epsvol epsilonv epsilonvol ev evol",
    DILATION: "volumetricdilation volumedilation dilation dilatation volumetricexpansion volumeexpansion",
    VOID: "voidratio e",
    AXIAL: "axialstress verticalstress majorprincipalstress s1 sig1 sigma1 siga sigmaa sigmaaxial sigv sigmav",
    CONFINING: "confiningstress confiningpressure radialstress minorprincipalstress s3 sig3 sigma3 sigr sigmar",
    DEVIATOR: "deviatorstress deviatoricstress devstress deviator principalstressdifference stressdifference q sigmad "
    "s1-s3 sig1-sig3 sigma1-sigma3 siga-sigr sigmaa-sigmar sigmav-sigmar",
    MEAN: "p meanstress meanpressure sigm sigmam",
    OBLIQUITY: "q/p eta stressobliquity",
    TEST: "testid testname testno testnumber",
}
PORE_PRESSURE = ["porepressure", "porewaterpressure", "excessporepressure", "pwp", "u", "backpressure", "cellpressure"]
_QUANTITY = {name: quantity for quantity, names in NAMES.items() for name in names.split()}

# Marks without capitals, blanks, ^, * and multiplication signs, behind the number that one unit is.
_OF_ONE = {
    1.0: "- 1 fraction m/m mm/mm cm/cm in/in",
    1e-2: "% percent pct percentage 1e-2 10-2 0.01",
    1e-3: "\u2030 permille permil promille o/oo mm/m 1e-3 10-3 0.001 millistrain",
    1e-6: "micro microstrain ustrain ue u um/m 1e-6 10-6 ppm",
}
_PASCAL = {
    1.0: "pa n/m2", 1e2: "hpa mbar", 1e3: "kpa kn/m2", 1e6: "mpa mn/m2 n/mm2", 1e9: "gpa", 1e5: "bar", 101325.0: "atm",
    6894.757: "psi", 6894757.0: "ksi", 47.88026: "psf", 47880.26: "ksf", 98066.5: "kgf/cm2 kg/cm2",
}  # fmt: skip
_METRE = {1.0: "m", 1e-2: "cm", 1e-3: "mm", 1e-6: "um", 0.0254: "in inch"}
METRE = {mark: size for size, marks in _METRE.items() for mark in marks.split()}
OF_ONE = {mark: size for size, marks in _OF_ONE.items() for mark in marks.split()}
PASCAL = {mark: size for size, marks in _PASCAL.items() for mark in marks.split()}
WORDS = {1.0: "fraction", 1e-2: "percent", 1e-3: "permille", 1e-6: "microstrain"}
_BRACKETS = re.compile(r"\[([^\]]*)\]|\(([^)]*)\)|\{([^}]*)\}")
_BEFORE_UNIT = re.compile(r"\s*[,/_:]\s*|\s+in\s+|\s+|(?=[%\u2030])")
_LONGEST = 200  # characters of a header that can be a name


@dataclass(frozen=True)
class Head:
    """A column's header taken apart: name as in NAMES, mark of the unit or None, sign +1, -1 or None where not said."""

    place: int
    name: str
    mark: str | None
    sign: int | None

    @property
    def quantity(self) -> str | None:
        return _QUANTITY.get(self.name)

    @property
    def turned(self) -> int:
        """-1 where the header says that its positive numbers are dilation or tension, else 1."""
        return -1 if self.sign == -1 else 1


def plain_name(text: str) -> str:
    """A name as in NAMES."""
    text = unicodedata.normalize("NFKC", text).casefold()
    text = text.replace("\u03b5", "eps").replace("\u03c3", "sigma").replace("effective", "")
    text = re.sub(r"[\s_.'\u2019\u2032]", "", text)
    return re.sub(r"(?<=[a-z])-(?=[a-z])", "", text) if not re.search("[0-9]|^sig", text) else text


def plain_mark(text: str) -> str:
    """A unit's mark as in OF_ONE and PASCAL."""
    text = unicodedata.normalize("NFKC", text).strip()
    if re.sub(r"\s", "", text) == "mPa":
        return "mPa"  # millipascal, or MPa mistyped: not to be known
    text = re.sub(r"[\s^*\u00d7]", "", text.casefold()).replace("\u03bc", "u").replace("\u03b5", "e")
    return re.sub(r"[\u2212\u2013\u2014]", "-", re.sub(r"^x(?=10)", "", text))


def is_unit(text: str) -> bool:
    return any(plain_mark(text) in known for known in (OF_ONE, PASCAL, METRE))


def quantity_of(name: str) -> str | None:
    """The quantity of a name in any of its spellings, None for one that is not known."""
    return _QUANTITY.get(plain_name(name))


def taken_apart(place: int, cell: str) -> Head:
    """'Axial strain [%] (compression positive)' is axialstrain, '%', +1."""
    if len(cell) > _LONGEST:
        return Head(place, "", None, None)
    name, mark, sign = cell, None, None
    insides = [next(part for part in match.groups() if part is not None) for match in _BRACKETS.finditer(cell)]
    outside = _BRACKETS.sub(" ", cell).strip()
    if insides and not outside:
        name, insides = insides[0], insides[1:]
    elif insides:
        name = outside
    unknown = []
    for inside in insides:
        said = _sign_of(inside)
        if said is not None:
            sign = said
        elif is_unit(inside):  # two different ones together are none that is known
            mark = plain_mark(inside) if mark in (None, plain_mark(inside)) else f"{mark}] [{inside}"
        elif inside.strip():
            unknown.append(inside.strip())
    if plain_name(name) not in _QUANTITY and mark is None:
        name = name.strip()
        for between in _BEFORE_UNIT.finditer(name):
            tail = name[between.end() :]
            if is_unit(tail) and tail not in ("-", "1", "m", "in"):  # letters that mean other things in a name
                name, mark = name[: between.start()], plain_mark(tail)
                break
    if mark is None and unknown:
        mark = unknown[-1]
    return Head(place, plain_name(name), mark, sign)


def _sign_of(text: str) -> int | None:
    """Sign that words such as 'dilation positive' or 'compression +' give to positive numbers."""
    text = text.casefold()
    if not ("positive" in text or re.search(r"\+(?!-)", text) or text.strip() in ("dilation", "expansion")):
        return None
    if re.search("dilat|expan|tension|extension", text):
        return -1
    return 1 if re.search("compress|contract|shorten", text) else None
