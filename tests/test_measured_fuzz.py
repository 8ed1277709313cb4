"""Random measured files: each is read, or refused by one sentence of DataError, and never ends in anything else.

Valid tables, written in a random way out of those of laboratories, come back with their numbers. AXIJAX_FUZZ is the
number of files of each kind, 150 unless set; thousands take minutes and are then not the same from run to run.
"""

import os
import re
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, event, given, settings
from hypothesis import strategies as st

from calibrate.evaluate import half_rise_strain
from calibrate.measured import DataError, read_measured

CASES = int(os.environ.get("AXIJAX_FUZZ", "150"))
FUZZ = settings(
    max_examples=CASES,
    deadline=None,
    database=None,
    derandomize="AXIJAX_FUZZ" not in os.environ,
    suppress_health_check=list(HealthCheck),
)
STRAIN_MARKS = {"%": 0.01, "percent": 0.01, "permille": 1e-3, "mm/m": 1e-3, "-": 1.0, "microstrain": 1e-6}
STRESS_MARKS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "N/mm2": 1e6}
NAMES = {
    "strain": ["axial_strain", "Axial Strain", "eps_a", "epsilon_1", "ε1"],
    "ratio": ["stress_ratio", "Stress Ratio", "s1/s3", "sigma_1/sigma_3"],
    "volume": ["volumetric_strain", "epsv", "Volumetric Strain"],
    "axial": ["axial_stress", "Sigma_1", "s1", "\N{GREEK SMALL LETTER SIGMA}1"],
    "confining": ["confining_stress", "Sigma_3", "Confining Pressure", "s3"],
    "deviator": ["q", "dev_stress", "s1-s3"],
    "mean": ["p", "p'", "Mean Stress", "mean effective stress"],
    "void": ["e", "void_ratio", "Void Ratio"],
}


@st.composite
def tables(draw):
    """(bytes of a file, what it says: strain, ratio, volume or None) for a sound test written in some way."""
    size = draw(st.integers(2, 12))
    steps = draw(st.lists(st.integers(1, 40), min_size=size, max_size=size))
    strain = np.cumsum([0, *steps[1:]]) / 40 / size * draw(st.sampled_from([1e-3, 5e-3, 0.05, 0.3]))
    height = np.array(draw(st.lists(st.integers(0, 3000), min_size=size, max_size=size))) / 1000
    ratio = 1 + np.maximum.accumulate(height)
    ratio[-1] += 0.01
    volume = strain * draw(st.integers(-90, 90)) / 100
    confining = np.full(size, draw(st.integers(1, 999)) * 1e3)
    values = {
        "strain": strain, "ratio": ratio, "volume": volume, "axial": ratio * confining, "confining": confining,
        "deviator": (ratio - 1) * confining, "mean": (ratio + 2) / 3 * confining, "void": 1.7 * (1 - volume) - 1,
    }  # fmt: skip
    pairs = ["axial confining", "deviator confining", "deviator mean", "axial mean", "mean confining", "axial deviator"]
    wanted = ["strain", *draw(st.sampled_from(["ratio", *pairs, "ratio axial confining deviator mean"])).split()]
    wanted += draw(st.sampled_from([[], ["volume"], ["void"]]))
    separator, comma = draw(st.sampled_from([(",", False), (";", False), ("\t", False), (";", True), ("\t", True)]))
    below = draw(st.booleans())
    columns = []
    for kind in draw(st.permutations(wanted)):
        pure = {"ratio": {"-": 1.0}, "void": {"-": 1.0}}
        marks = pure.get(kind, STRAIN_MARKS if kind in ("strain", "volume") else STRESS_MARKS)
        mark = draw(st.sampled_from(sorted(marks)))
        cells = [f"{value / marks[mark]:.14g}" for value in values[kind]]
        columns.append((draw(st.sampled_from(NAMES[kind])), mark, cells))
    if draw(st.booleans()):
        remark = (draw(st.sampled_from(["remark", "Temperature", "B"])), "", draw(st.sampled_from(["ok", "20", ""])))
        columns.insert(draw(st.integers(0, len(columns))), (remark[0], remark[1], [remark[2]] * size))
    heads = [name if below or not mark else f"{name} [{mark}]" for name, mark, _ in columns]
    rows = [heads, *([[mark for _, mark, _ in columns]] if below else []), *zip(*(c for *_, c in columns), strict=True)]
    end = separator * draw(st.integers(0, 2))
    lines = [separator.join(row) + end for row in rows]
    if comma:  # of the numbers; no mark or name above holds a point
        # Where every cell with a comma could as well have thousands separators the file is refused, rightly.
        pointed = [cell for *_, cells in columns for cell in cells if "." in cell]
        assume(not pointed or not all(re.fullmatch(r"-?[1-9][0-9]{0,2}\.[0-9]{3}", cell) for cell in pointed))
        lines = [line.replace(".", ",") for line in lines]
    lines = draw(st.sampled_from([[], ["# a comment"], ["Test no. 7"], ["Test; dense, dry", ""]])) + lines
    for _ in range(draw(st.integers(0, 2))):
        lines.insert(draw(st.integers(0, len(lines))), draw(st.sampled_from(["", "# pause", "  "])))
    text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join(lines)
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))
    return text.encode(encoding), (strain, ratio, volume if {"volume", "void"} & set(wanted) else None)


DATABASE = """\
# ===== [4] PARTICLE_SIZE_DISTRIBUTION =====
sieving_id,diameter[mm],finer[%]
1,0.1,0
1,0.3,100
# ===== [5] TEST_PROGRAMME =====
test_id,K_c[-],sigma_r0[kPa],e_0[-],Dr_0[%]
TMD1,1,200,0.72,80.5
# ===== [6] TEST_DATA =====
test_id,eps_a[%],eps_v[%],sigma_r[kPa],sigma_v[kPa]
TMD1,0,0,200,200
TMD1,1,0.2,200,500
TMD1,5,-1,200,400
"""
NASTY = [
    "", " ", "nan", "-inf", "1e999", "-1", "0", "1_0", "0x10", "1,234.5", "1.234,5", "1 234", "--3", "1e", "e5", "1D3",
    "%", "[%]", "kPa", "[", ")(", '"', '""', "'", "#", ";", ",", "\t", "\0", "\r", "\n", "\x0b", "\ufeff", "\u2028",
    "\xa0", "²", "½", "\u0661", "\U0001d7d9", "\U0001f4c8", "axial_strain", "stress_ratio [MPa]", "q", "s3", "dilation",
    "volumetric_strain (+)", "# e0 0.7", "# s3 100 kPa", "test_id", "p", "e", "mm", "displacement [mm]",
    "\nTMD2,1,1,1,1",
    "# ===== [6] TEST_DATA", "1" * 140_000, "9" * 400, "(" * 500, "_" * 500, "5e-324", "1.7e308", "-0", "+1", ".5",
    "5.", "=A1+B2", "#N/A",
]  # fmt: skip
NASTY_CELLS = st.integers(0, len(NASTY) - 1).map(NASTY.__getitem__)


@st.composite
def damaged(draw):
    """Bytes of a sound file after some accidents."""
    content, _ = draw(tables())
    if draw(st.booleans()):
        text = content.decode("utf-16" if content.startswith(b"\xff\xfe") else "utf-8-sig")
        text = draw(st.sampled_from([text, DATABASE, re.sub("[,;\t]", "  ", text)]))
        for _ in range(draw(st.integers(1, 4))):
            start = draw(st.integers(0, len(text)))
            stop = min(len(text), start + draw(st.sampled_from([0, 0, 1, 2, 5, 40])))
            text = text[:start] + draw(NASTY_CELLS) + text[stop:]
        content = text.encode("utf-8", "surrogatepass")
    else:
        for _ in range(draw(st.integers(1, 4))):
            start = draw(st.integers(0, len(content)))
            stop = min(len(content), start + draw(st.sampled_from([0, 1, 3, 60])))
            content = content[:start] + draw(st.binary(max_size=4)) + content[stop:]
    return content


def words(*choices):
    return st.lists(st.sampled_from(choices), max_size=60).map("".join)


ANYTHING = st.one_of(
    st.binary(max_size=300),
    st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")),
    words(",", ";", "\n", "1", "0.5", "axial_strain", "stress_ratio", "q", "s3", "[%]", "-", "kPa").map(str.encode),
    st.lists(NASTY_CELLS, max_size=12).map(
        lambda cells: ("axial_strain [%],stress_ratio\n0,1\n" + ",".join(cells)).encode()
    ),
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "lab.csv"


def opened(file, content, columns=None):
    file.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return read_measured(file, columns)


MAPPINGS = st.dictionaries(
    st.sampled_from(["axial_strain", "R", "eps_v", "q", "s3", "p", "e", "axial_displacement", "colour", "test_id"]),
    st.one_of(st.sampled_from(["[%]", "[kPa]", "axial_strain [%]", "q", "(dilation positive)", "p [mm]"]), NASTY_CELLS),
    max_size=3,
)


@FUZZ
@given(tables())
def test_valid_tables_come_back_with_their_numbers(file, written):
    content, (strain, ratio, volume) = written
    curve = opened(file, content)
    np.testing.assert_allclose(curve.axial_strain, strain, rtol=1e-12)
    np.testing.assert_allclose(curve.stress_ratio, ratio, rtol=1e-9)  # stresses made of others lose some digits
    if volume is None:
        assert curve.volumetric_strain is None
    else:
        np.testing.assert_allclose(curve.volumetric_strain, volume, rtol=1e-12, atol=1e-13)


@FUZZ
@given(st.one_of(damaged(), ANYTHING), st.one_of(st.none(), MAPPINGS))
def test_any_file_is_read_or_refused_by_one_sentence(file, content, columns):
    try:
        curve = opened(file, content, columns)
    except DataError as error:
        said = str(error)
        assert said.startswith(("lab.csv: ", str(file))) and said.endswith((".", "?")), said
        assert said.isprintable() and 20 < len(said) < 2000, said
        event("refused")
        return
    event("read")
    assert len(curve) >= 2 and (np.diff(curve.axial_strain) > 0).all()
    assert np.isfinite(curve.observed).all() and curve.axial_strain[0] >= 0 and curve.axial_strain[-1] < 0.5
    assert curve.stress_ratio.min() >= 0.9 and curve.stress_ratio.max() > 1
    assert 0 <= half_rise_strain(curve.axial_strain, curve.stress_ratio) <= curve.last_strain  # what a fit begins with
