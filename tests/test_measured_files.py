"""Measured files as laboratories write them: the right numbers come back, or one sentence says what is wrong.

The sound curve is a closed form; every way of writing it must give the same numbers, without a warning. What cannot be
known is asked for, what contradicts itself is refused, what looks wrong is warned of with the number.
"""

import json
import warnings

import numpy as np
import pytest
from calibrate_standin import StandIn, measured
from cli_in_process import SMALL, axijax, write

from calibrate.file import calibrate_file
from calibrate.measured import DataError, read_measured

STRAIN = np.arange(0, 0.0051, 0.0002)
RATIO = 1 + 1.9 * np.tanh(STRAIN / 9e-4)
VOLUME = 0.3 * STRAIN - 120 * STRAIN**2  # contracts by 0.02 %, then dilates
S3 = 5e4


def table(*columns, separator=",", comma=False, end=""):
    """Columns ('name', values) as text."""
    lines = [separator.join(name for name, _ in columns) + end]
    for row in zip(*(values for _, values in columns), strict=True):
        cells = [value if isinstance(value, str) else f"{value:.12g}" for value in row]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells) + end)
    return "\n".join(lines) + "\n"


def strains(name="axial_strain [%]", size=0.01):
    return name, STRAIN / size


R = ("stress_ratio", RATIO)
PLAIN = table(strains(), R)


def read(tmp_path, content, **options):
    """(curve, warnings) of a file with this text or these bytes."""
    path = tmp_path / "lab.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        curve = read_measured(path, **options)
    assert tuple(str(one.message) for one in said) == curve.warnings
    return curve, curve.warnings


def refusal(tmp_path, content, **options) -> str:
    with pytest.raises(DataError) as error:
        read(tmp_path, content, **options)
    said = str(error.value)
    assert "lab.csv" in said and "\n" not in said and len(said) < 700, said
    return said


def with_volume(name, values, axial=None):
    return table(axial or strains(), R, (name, values))


def with_strain(name, size):
    return table(strains(name, size), R)


def with_stresses(axial, axial_size, confining, confining_size):
    held = np.full(len(STRAIN), S3)
    return table(strains(), (axial, RATIO * S3 / axial_size), (confining, held / confining_size))


Q, P = (RATIO - 1) * S3, (RATIO + 2) * S3 / 3
SOUND = {
    "as it should be": PLAIN,
    "fractions, marked": with_strain("axial_strain [-]", 1),
    "fractions, not marked": with_strain("axial_strain", 1),
    "semicolons, decimal commas": table(strains(), R, separator=";", comma=True),
    "tabs, decimal commas": table(strains(), R, separator="\t", comma=True),
    "tabs": table(strains(), R, separator="\t"),
    "quoted decimal commas": "\n".join(
        ",".join(f'"{cell}"' for cell in line.split(";"))
        for line in table(strains(), R, separator=";", comma=True).splitlines()
    ),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "UTF-16": PLAIN.encode("utf-16"),
    "UTF-16, big end first": b"\xfe\xff" + PLAIN.encode("utf-16-be"),
    "Latin-1 beside it": table(strains(), R, ("Temperature [°C]", 20 + 0 * STRAIN)).encode("latin-1"),
    "carriage returns": PLAIN.replace("\n", "\r\n"),
    "old Macintosh": PLAIN.replace("\n", "\r"),
    "trailing separators": table(strains(), R, end=",,"),
    "trailing separators below only": PLAIN.replace("\n", ",\n").replace(",\n", "\n", 1),
    "blank and empty lines": PLAIN.replace("\n", "\n\n , \n"),
    "comments": "# a test\n" + PLAIN.replace("\n", "\n# pause\n", 5),
    "lines above the header": "Test: TMD18, dense\nDate;2026-11-27\n\nOperator,N. N.,strain gauge 3\n" + PLAIN,
    "units in a second row": PLAIN.replace(" [%]", "").replace("\n", "\n%,-\n", 1),
    "units in a second row, in brackets": PLAIN.replace(" [%]", "").replace("\n", "\n[%],[-]\n", 1),
    "text in another column": table(strains(), R, ("remark", ["ok"] * len(STRAIN))),
    "a column of gaps beside": table(strains(), ("temperature", [""] * len(STRAIN)), R),
    "two columns that agree": table(strains(), R, ("axial_strain [-]", STRAIN)),
    "capitals and blanks": table(strains("  Axial Strain (%)"), ("Stress Ratio", RATIO)),
    "a user's names": table(
        strains("Axial_Strain [%]"), ("dev_stress [kPa]", Q / 1e3), ("p [kPa]", P / 1e3), ("Sigma_1 [kPa]", RATIO * 50),
        ("Sigma_3 [kPa]", 50 + 0 * STRAIN),
    ),
    "Greek": table(strains("ε₁ [%]"), ("σ₁ [kPa]", RATIO * 50), ("σ₃ [kPa]", 50 + 0 * STRAIN)),
    "the sand database's": table(
        ("test_id", ["TMD3"] * len(STRAIN)), strains("eps_a[%]"), ("eps_v[%]", 100 * VOLUME),
        ("sigma_r[kPa]", 50 + 0 * STRAIN), ("sigma_v[kPa]", RATIO * 50),
    ),
    "R by its symbols": table(strains("eps1 [%]"), ("s1/s3", RATIO)),
    "effective stresses": table(
        strains(), ("s1' [kPa]", RATIO * 50), ("s3' [kPa]", 50 + 0 * STRAIN), ("u [kPa]", 200 + 0 * STRAIN)
    ),
    "q and s3": table(strains(), ("q [kPa]", Q / 1e3), ("s3 [kPa]", 50 + 0 * STRAIN)),
    "q by its formula": table(strains(), ("(s1-s3) [kPa]", Q / 1e3), ("confining pressure [MPa]", 0.05 + 0 * STRAIN)),
    "stresses without units": with_stresses("axial_stress", 1, "confining_stress", 1),
    "stresses in one unknown unit": with_stresses("axial_stress [M/L/T2]", 1, "confining_stress [M/L/T2]", 1),
    "volume, dilation positive by its mark": with_volume("volumetric_strain [%] (dilation positive)", -100 * VOLUME),
    "volume, dilation positive by its name": with_volume("dilation [%]", -100 * VOLUME),
    "volume in other units than strain": with_volume("epsv [mm/m]", 1000 * VOLUME),
    "numbers with exponents and true minus signs": table(
        ("axial_strain [%]", [f"{100 * e:.12E}" for e in STRAIN]), R,
        ("volumetric_strain [%]", [f"{100 * v:.12g}".replace("-", "\N{MINUS SIGN}") for v in VOLUME]),
    ),
}  # fmt: skip
SOUND |= {
    f"strain marked {mark}": with_strain(f'"axial_strain {mark}"', size)
    for mark, size in {
        "[permille]": 1e-3, "[‰]": 1e-3, "[mm/m]": 1e-3, "[1e-3]": 1e-3, "[10^-3]": 1e-3, "(pct)": 0.01,
        "[percent]": 0.01, "[m/m]": 1, "[micro]": 1e-6, "[microstrain]": 1e-6, "[µε]": 1e-6, "[10⁻⁶]": 1e-6, "%": 0.01,
        ", %": 0.01, "in percent": 0.01, "/ %": 0.01,
    }.items()
}  # fmt: skip
SOUND |= {
    f"stresses in {one} and {other}": with_stresses(f"axial_stress [{one}]", a, f"confining_stress_{other}", c)
    for one, a, other, c in (
        ("kPa", 1e3, "MPa", 1e6), ("bar", 1e5, "Pa", 1), ("psi", 6894.757293168, "kPa", 1e3),
        ("kN/m²", 1e3, "hPa", 1e2), ("N/mm^2", 1e6, "GPa", 1e9), ("kgf/cm2", 98066.5, "ksf", 47880.25898),
    )
}  # fmt: skip


@pytest.mark.parametrize("kind", SOUND)
def test_every_way_of_writing_gives_the_same_numbers(tmp_path, kind):
    curve, said = read(tmp_path, SOUND[kind])
    assert said == ()
    np.testing.assert_allclose(curve.axial_strain, STRAIN, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(curve.stress_ratio, RATIO, rtol=1e-6)
    if any(word in kind for word in ("volume", "database", "minus")):
        np.testing.assert_allclose(curve.volumetric_strain, VOLUME, rtol=1e-9, atol=1e-12)
    else:
        assert curve.volumetric_strain is None
    if curve.confining is not None:
        unknown = "without" in kind or "unknown" in kind
        assert curve.confining.value == pytest.approx(S3, rel=1e-6) and curve.confining.in_pascal is not unknown


def changed(old, new, text=PLAIN, count=1):
    assert old in text
    return text.replace(old, new, count)


NUMBER = f"{RATIO[1]:.12g}"
REFUSED = {
    "unknown unit": (with_strain("axial_strain [furlong]", 1), ["'axial_strain [furlong]'", "[permille]"]),
    "a length without a height": (with_strain("axial_strain [mm]", 1), ["'mm', a length", "height, such as '100 mm'"]),
    "two units": (with_strain("axial_strain [%] [-]", 1), ["which is no unit"]),
    "a unit above and another below": (changed("\n", "\n-,-\n"), ["another unit, '-'"]),
    "a ratio in kPa": (changed("stress_ratio", "stress_ratio [kPa]"), ["'stress_ratio [kPa]'", "'kpa'"]),
    "volume not marked, strain marked": (
        with_volume("volumetric_strain", 100 * VOLUME),
        ["'volumetric_strain'", "0.15", "cannot be known", "[%] or [-]"],
    ),
    "strain not marked, volume marked": (
        with_volume("volumetric_strain [%]", 100 * VOLUME, strains("axial_strain")),
        ["behind 'axial_strain'"],
    ),
    "one stress marked": (with_stresses("axial_stress [kPa]", 1e3, "confining_stress", 1), ["without a unit", "[kPa]"]),
    "millipascal or megapascal": (
        with_stresses("axial_stress [mPa]", 1e6, "confining_stress [kPa]", 1e3),
        ["'axial_stress [mPa]'", "no unit of stress known"],
    ),
    "kPa beside MPa, not marked": (
        with_stresses("axial_stress", 1, "confining_stress", 1e6),
        ["2.89994e+06 in data row 26", "behind each stress"],
    ),
    "MPa beside kPa, not marked": (
        with_stresses("axial_stress", 1e6, "confining_stress", 1),
        ["1e-06 in data row 1", "different units"],
    ),
    "q under the name axial_stress": (
        table(strains(), ("axial_stress [Pa]", Q), ("confining_stress [Pa]", S3 + 0 * STRAIN)),
        ["stress_ratio = 0 in data row 1", "name it q"],
    ),
    "q under that name, after the first row": (
        table(strains(), ("axial_stress [Pa]", Q + 100), ("confining_stress [Pa]", S3 + 0 * STRAIN)),
        ["stress_ratio = 0.002 in data row 1", "name it q"],
    ),
    "s1 and s3 exchanged": (with_stresses("confining_stress", 1, "axial_stress", 1), ["exchanged"]),
    "R that contradicts the stresses": (
        table(strains(), R, ("s1 [kPa]", RATIO * 60), ("s3 [kPa]", 50 + 0 * STRAIN)),
        ["is 1 by 'stress_ratio'", "1.2 by 's1 [kPa]' over 's3 [kPa]'"],
    ),
    "q that contradicts the stresses": (
        table(strains(), ("q [kPa]", Q / 2e3), ("s1 [kPa]", RATIO * 50), ("s3 [kPa]", 50 + 0 * STRAIN)),
        ["'q [kPa]' is 10385.2 in data row 2", "make it 20770.3"],
    ),
    "two columns that do not agree": (
        table(strains(), R, ("Axial Strain [%]", 110 * STRAIN)),
        ["'axial_strain [%]' and 'Axial Strain [%]'", "0.0002 and 0.00022 in data row 2"],
    ),
    "volume twice": (
        table(strains(), R, ("epsv [%]", 100 * VOLUME), ("dilation [%]", 100 * VOLUME)),
        ["'epsv [%]' and 'dilation [%]' contradict"],
    ),
    "all R below 1": (
        "axial_strain [%],stress_ratio\n0.05,0.5\n0.1,0.8\n0.2,0.9\n0.4,0.95\n",
        ["stress_ratio = 0.5 in data row 1"],
    ),
    "R that never rises": (changed(NUMBER, "1", "axial_strain [%],stress_ratio\n0,1\n1," + NUMBER), ["1 at most"]),
    "zero confining stress": (
        table(strains(), ("s1", RATIO), ("s3", np.where(STRAIN == 0.001, 0.0, 1.0))),
        ["'s3' = 0 in data row 6"],
    ),
    "tension positive": (
        table(("axial_strain", -STRAIN), ("s1", -RATIO), ("s3", -1 + 0 * STRAIN)),
        ["tension-positive", "turn the signs"],
    ),
    "1_0": (changed(NUMBER, "1_0"), ["stress_ratio = '1_0' in data row 2"]),
    "other digits": (changed(NUMBER, "\N{ARABIC-INDIC DIGIT ONE}"), ["in data row 2"]),
    "nan": (changed(NUMBER, "NaN"), ["stress_ratio = NaN in data row 2", "finite"]),
    "inf": (changed(NUMBER, "-inf"), ["stress_ratio = -inf in data row 2", "finite"]),
    "a number that overflows": (changed(NUMBER, "1e999"), ["stress_ratio = 1e999 in data row 2", "finite"]),
    "a number of 20 digits": (changed(NUMBER, "12345678901234567890"), ["1.23457e+19 in data row 2"]),
    "a number of 5000 digits": (changed(NUMBER, "9" * 5000), ["(5000 characters)", "data row 2"]),
    "a cell of 100,000 characters": (changed(NUMBER, "x" * 100_000), ["(100000 characters)"]),
    "a cell of 200,000 characters": (changed(NUMBER, "1" * 200_000), ["cannot be taken apart"]),
    "a header of 100,000 brackets": (changed("stress_ratio", "[" * 100_000), ["no column 'stress_ratio'"]),
    "an empty cell": (changed(NUMBER, ""), ["stress_ratio = '' in data row 2"]),
    "a missing cell": (changed("," + NUMBER, ""), ["data row 2 has 1 cells, the header 2"]),
    "a stray quote": (changed("\n0.02", '\n"0.02'), ["data row 2 has 1 cells"]),
    "decimal commas between commas": (table(strains(), R, comma=True), ["decimal comma need semicolons"]),
    "two decimal marks": (
        changed("1,4", "1.4", table(strains(), R, separator=";", comma=True)),
        ["one decimal mark", "'1.4"],
    ),
    "thousands with points": (
        table(strains(), ("s1", ['"1,234.5"'] * len(STRAIN)), ("s3", S3 + 0 * STRAIN)),
        ["'1,234.5'", "thousands"],
    ),
    "thousands or decimals": (
        "axial_strain;s1;s3\n0;100,000;100,000\n1;250,500;100,000\n",
        ["'100,000' may hold"],
    ),
    "thousands with blanks": (changed(NUMBER, "1 234"), ["'1 234'"]),
    "unloading": (PLAIN + "0.4,2.0\n", ["falls back to 0.004 after 0.005", "unloading"]),
    "strain before the shear": (changed("\n0,", "\n-0.01,"), ["starts at -0.0001", "subtract"]),
    "no header": ("0,1\n0.1,2\n", ["first row holds numbers (0, 1)"]),
    "header in a comment": ("# " + PLAIN, ["# counts as a comment"]),
    "no stress": (table(strains(), ("load", RATIO)), ["no column 'stress_ratio'; it has axial_strain [%], load"]),
    "bars between": (PLAIN.replace(",", "|"), ["semicolons, tabs or blanks must stand between"]),
    "blanks between, one cell short": (changed("\n0.02 ", "\n", PLAIN.replace(",", " ")), ["taken apart at blanks"]),
    "no confining stress": (table(strains(), ("q [kPa]", Q)), ["two of axial_stress", "--confining-stress"]),
    "only units below": ("axial_strain,stress_ratio\n%,-\n", ["a header and at least one row"]),
    "nothing": ("", ["no line"]),
    "comments only": ("# a\n# b\n", ["no line"]),
    "Excel": (b"PK\x03\x04\x14\0", ["Excel", "save the sheet as CSV"]),
    "old Excel": (b"\xd0\xcf\x11\xe0\xa1\xb1", ["Excel"]),
    "UTF-16 without its mark": (PLAIN.encode("utf-16-le"), ["not text in UTF-8"]),
    "half of a UTF-16 file": (PLAIN.encode("utf-16")[:-1], ["begins as utf-16", "UTF-8"]),
    "zero bytes": (PLAIN.encode() + b"\0\0", ["zero bytes"]),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_contradicts_itself_or_cannot_be_known_is_refused(tmp_path, kind):
    content, words = REFUSED[kind]
    said = refusal(tmp_path, content)
    for word in words:
        assert any(one in said for one in word.split("|")), said
    assert "unit=" not in said and "sign=" not in said and "Name the right one" not in said


LOOKS_WRONG = {
    "dilation positive": (
        with_volume("volumetric_strain [%]", -100 * VOLUME),
        ["grows from the start", "write (dilation positive)"],
    ),
    "volume in %, marked a fraction": (with_volume("volumetric_strain [-]", 100 * VOLUME), ["out of proportion"]),
    "volume a fraction, marked %": (with_volume("volumetric_strain [%]", VOLUME), ["out of proportion"]),
    "volume that begins elsewhere": (
        with_volume("volumetric_strain [%]", 100 * VOLUME + 0.7),
        ["volumetric_strain begins at 0.007 (0.7 %)"],
    ),
    "percent, not marked": (
        "\n".join(with_strain("axial_strain", 0.01).splitlines()[:-1]),
        ["has no unit", "write [%]"],
    ),
    "fractions, marked %": (with_strain("axial_strain [%]", 1), ["is the unit right?"]),
    "strain that begins elsewhere": (
        table(("axial_strain [%]", 100 * STRAIN + 0.5), R),
        ["axial_strain begins at 0.005 (0.5 %) where R = 1"],
    ),
    "strain that runs before the shear": (
        table(("axial_strain [%]", np.r_[0, 0.25, 100 * STRAIN + 0.5]), ("stress_ratio", np.r_[1, 1, RATIO])),
        ["R is still 1 at axial strain 0.005 (0.5 %) in data row 3"],
    ),
    "psi beside kPa, not marked": (with_stresses("axial_stress", 1, "confining_stress", 6.894757), ["begins at 6.895"]),
    "stresses not zeroed": (
        table(strains(), ("stress_ratio", RATIO - np.where(STRAIN == 0, 0.05, 0))),
        ["stress_ratio = 0.95 in data row 1 is below 1"],
    ),
    "R of no sand": (changed(NUMBER, "24"), ["stress_ratio = 24 in data row 2"]),
    "confining stress that is not held": (
        table(strains(), ("q [kPa]", Q / 1e3), ("s3 [kPa]", np.where(STRAIN > 0.004, 40, 50))),
        ["runs from 40000 to 50000 Pa"],
    ),
    "total stresses": (
        table(strains(), ("s1 [kPa]", RATIO * 50), ("s3 [kPa]", 50 + 0 * STRAIN), ("u [kPa]", 200 + 0 * STRAIN)),
        ["'u [kPa]' (200 in data row 1) stands beside 's3 [kPa]' and 's1 [kPa]'"],
    ),
    "padding": (
        table(
            ("axial_strain [%]", np.r_[100 * STRAIN, 0.6 + 0.1 * np.arange(8)]),
            ("stress_ratio", np.r_[RATIO, [2.5] * 8]),
        ),
        ["the last 7 rows only repeat R = 2.5"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", LOOKS_WRONG)
def test_what_looks_wrong_is_read_and_said(tmp_path, kind):
    content, words = LOOKS_WRONG[kind]
    _, said = read(tmp_path, content)
    assert said and all(text.startswith("lab.csv: ") and "\n" not in text for text in said)
    for word in words:
        assert any(word in text for text in said), said


def test_a_confining_stress_that_is_not_the_cases(tmp_path):
    """R is the same at twice the confining stress, the stiffness fitted is not: it follows s3 (PHYSICS 3.3)."""
    held = 5e4 + 0 * STRAIN
    columns = {
        "[kPa]": (held / 1e3, True), "[MPa]": (held / 1e6, True), "": (held, True), "[Pa]": (2 * held, False),
        "[bar]": (held, False), " ": (held / 1e3, False),
    }  # fmt: skip
    for mark, (confining, same) in columns.items():
        curve, _ = read(tmp_path, table(strains(), R, (f"confining_stress {mark}", confining)))
        told = curve.confining.unlike(5e4)
        assert (told is None) is same, (mark, told)
    assert "100000 Pa" in read(tmp_path, table(strains(), R, ("s3 [Pa]", 2 * held)))[0].confining.unlike(5e4)


def test_warnings_reach_the_fit_and_its_file(tmp_path):
    data = measured(StandIn(), np.linspace(2e-4, 8e-3, 30), friction=0.2)
    held = np.full(len(data), 100.0)
    deviator = ("q [kPa]", held * (data.stress_ratio - 1))
    text = table(("axial_strain [%]", 100 * data.axial_strain), deviator, ("s3 [kPa]", held))
    (tmp_path / "lab.csv").write_text(text)
    said = []
    with pytest.warns(UserWarning, match="confining stress of the data is 100000 Pa"):
        fit = calibrate_file(tmp_path / "lab.csv", "f", StandIn(), tmp_path / "out", check=False, report=said.append)
    assert fit.estimate["friction"] == pytest.approx(0.2, rel=1e-3)
    stored = json.loads((tmp_path / "out" / "fit.json").read_text())["warnings"]
    assert stored == list(fit.warnings) and "the simulated test 50000" in stored[0] and "a factor 2;" in stored[0]
    assert any("warning: lab.csv: the confining stress" in line for line in said)
    assert any(line.startswith("read 30 rows: axial strain 0.02 to 0.8 %") for line in said)


def test_the_command_line_says_one_sentence(tmp_path):
    case = write(tmp_path / "case.toml", SMALL)
    for name, content, words in (
        ("below.csv", REFUSED["all R below 1"][0].encode(), "below.csv: stress_ratio = 0.5 in data row 1"),
        ("long.csv", REFUSED["a cell of 200,000 characters"][0].encode(), "long.csv: the line that begins"),
        ("book.xlsx", b"PK\x03\x04", "book.xlsx: is an Excel workbook"),
        ("far.csv", PLAIN.replace(" [%]", "").encode(), "write [%] behind the name"),
    ):
        (tmp_path / name).write_bytes(content)
        called = axijax("calibrate", tmp_path / name, "--case", case, "--output", tmp_path / "out")
        assert called.code == 1 and words in called.err and called.err.splitlines()[-1].startswith("axijax: "), called
        assert "Traceback" not in called.err
        assert not (tmp_path / "out" / "fit.json").exists()
    # A doubt is printed at once, before anything is run, here before a refusal.
    doubtful = table(("axial_strain [%]", 1000 * STRAIN), R, ("volumetric_strain [%]", -1000 * VOLUME))
    (tmp_path / "dilation.csv").write_text(doubtful)
    told = axijax("calibrate", tmp_path / "dilation.csv", "--case", case, "--output", tmp_path / "out").err.splitlines()
    assert told[0].startswith("axijax: warning: dilation.csv: volumetric_strain = -0.00") and "dilation pos" in told[0]
    assert told[-1].startswith("axijax: dilation.csv: 'curves R and volumetric strain' goes to strain 0.05")
    assert "is a folder" in axijax("calibrate", tmp_path, "--output", tmp_path / "out").err
