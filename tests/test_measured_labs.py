"""Measured files by the habits of laboratories: every way in which stresses, strains and volumes are kept gives the
same numbers, a mapping says what a header does not, and a material file of the Sand Triaxial Test Database is read as
it is. The sound curve is a closed form; what is not known or contradicts itself is refused."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from calibrate.facts import of_comments
from calibrate.measured import DataError, read_measured

STRAIN = np.arange(0, 0.101, 0.004)
RATIO = 1 + 3.2 * np.tanh(STRAIN / 0.012) * (1 - STRAIN)
VOLUME = 0.3 * STRAIN - 8 * STRAIN**2
S3, E0, HEIGHT = 200e3, 0.72, 0.100
Q = (RATIO - 1) * S3
P = S3 + Q / 3
VOID = (1 + E0) * (1 - VOLUME) - 1
S1 = RATIO * S3


def table(separator=";", **columns) -> str:
    names = [name.replace("__", " ") for name in columns]
    rows = zip(*columns.values(), strict=True)
    lines = [separator.join(names)] + [separator.join(f"{v:.12g}" for v in row) for row in rows]
    return "\n".join(lines) + "\n"


def columns(**more):
    return {"eps_a [%]": 100 * STRAIN, **more}


def read(tmp_path, text, *arguments, **options):
    path = tmp_path / "lab.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        curve = read_measured(path, *arguments, **options)
    assert tuple(str(one.message) for one in said) == curve.warnings
    return curve


def refused(tmp_path, text, *arguments, **options) -> str:
    with pytest.raises(DataError) as error:
        read(tmp_path, text, *arguments, **options)
    assert "\n" not in str(error.value) and len(str(error.value)) < 800
    return str(error.value)


KPA, PSI = 1e3, 6894.757
HELD = S3 + 0 * STRAIN
STRESSES = {
    "s1 and s3 in psi": ({"s1 [psi]": S1 / PSI, "s3 [psi]": HELD / PSI}, {}),
    "q and s3": ({"q [kPa]": Q / KPA, "s3 [MPa]": HELD / 1e6}, {}),
    "q and p": ({"q [kPa]": Q / KPA, "p' [kPa]": P / KPA}, {}),
    "q and p without units": ({"q": Q, "p": P}, {}),
    "s1 and p": ({"s1 [kPa]": S1 / KPA, "p [bar]": P / 1e5}, {}),
    "s1 and q": ({"s1 [kPa]": S1 / KPA, "q [kPa]": Q / KPA}, {}),
    "p and s3": ({"mean effective stress [kPa]": P / KPA, "s3 [kPa]": HELD / KPA}, {}),
    "q/p": ({"q/p": Q / P}, {}),
    "eta": ({"eta [-]": Q / P}, {}),
    "R": ({"R": RATIO}, {}),
    "q, and s3 as a number": ({"q [kPa]": Q / KPA}, {"confining_stress": "0.2 MPa"}),
    "p, and s3 as a number": ({"p [kPa]": P / KPA}, {"confining_stress": "200 kPa"}),
    "all of them": ({"R": RATIO, "s1 [kPa]": S1 / KPA, "s3 [kPa]": HELD / KPA, "q [kPa]": Q / KPA, "p [kPa]": P / KPA,
                     "q/p": Q / P}, {}),
    "tension positive": ({"s1 [kPa] (tension positive)": -S1 / KPA, "s3 [kPa] (tension positive)": -HELD / KPA}, {}),
}  # fmt: skip


@pytest.mark.parametrize("kind", STRESSES)
def test_every_pair_of_stresses_gives_the_ratio(tmp_path, kind):
    held, options = STRESSES[kind]
    curve = read(tmp_path, table(**columns(**held)), **options)
    np.testing.assert_allclose(curve.stress_ratio, RATIO, rtol=1e-6)
    assert curve.warnings == ()
    if "p" in kind and "units" not in kind and kind not in ("q/p", "eta"):
        assert curve.confining.value == pytest.approx(S3, rel=1e-5) and curve.confining.in_pascal


STRAINS = {
    "mm with a height": (table(**{"axial displacement [mm]": 1e3 * HEIGHT * STRAIN, "R": RATIO}), {"height": "10 cm"}),
    "strain in mm": (table(**{"eps_a [mm]": 1e3 * HEIGHT * STRAIN, "R": RATIO}), {"height": "100 mm"}),
    "inches": (table(**{"displacement (in)": HEIGHT / 0.0254 * STRAIN, "R": RATIO}), {"height": "100 mm"}),
    "mm and the strain": (
        table(**columns(**{"displacement [mm]": 1e3 * HEIGHT * STRAIN, "R": RATIO})), {"height": "100mm"},
    ),
    "mm, the strain and no height": (table(**columns(**{"displacement [mm]": 1e3 * HEIGHT * STRAIN, "R": RATIO})), {}),
    "blanks between": (table(" ", **{"eps_a [%]": 100 * STRAIN, "R": RATIO}), {}),
    "several blanks, names of two words": (table("   ", **{"Axial Strain (%)": 100 * STRAIN, "R": RATIO}), {}),
    "blanks and decimal commas": (table("  ", **{"eps_a [%]": 100 * STRAIN, "R": RATIO}).replace(".", ","), {}),
    "a line of words above": ("Dense sand, 3rd test\n" + table(" ", **{"eps_a [%]": 100 * STRAIN, "R": RATIO}), {}),
    "BOM, semicolons, decimal commas": (
        b"\xef\xbb\xbf" + table(**columns(R=RATIO)).replace(".", ",").replace("\n", "\r\n").encode(), {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", STRAINS)
def test_strains_as_lengths_and_blanks_between_columns(tmp_path, kind):
    text, options = STRAINS[kind]
    curve = read(tmp_path, text, **options)
    np.testing.assert_allclose(curve.axial_strain, STRAIN, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(curve.stress_ratio, RATIO, rtol=1e-9)
    assert curve.warnings == ()


VOLUMES = {
    "void ratio from strain zero": ({"e": VOID}, {}, E0),
    "void ratio with e0": ({"void ratio [-]": VOID}, {"void_ratio": E0}, E0),
    "dilation positive": ({"eps_v [%] (dilation positive)": -100 * VOLUME}, {}, None),
    "volume and void ratio": ({"eps_v [%]": 100 * VOLUME, "e": np.round(VOID, 3)}, {}, round(E0, 3)),
}


@pytest.mark.parametrize("kind", VOLUMES)
def test_void_ratio_becomes_volumetric_strain_and_comes_back(tmp_path, kind):
    held, options, start = VOLUMES[kind]
    curve = read(tmp_path, table(**columns(R=RATIO, **held)), **options)
    np.testing.assert_allclose(curve.volumetric_strain, VOLUME, rtol=1e-9, atol=1e-10)
    assert curve.facts.void_ratio == (None if start is None else pytest.approx(start))
    if start is not None:
        np.testing.assert_allclose(curve.void_ratio, VOID, atol=1e-6)
    else:
        assert np.isnan(curve.void_ratio).all()


def test_a_mapping_says_what_the_header_does_not(tmp_path):
    text = table(Weg=1e3 * HEIGHT * STRAIN, Kraft_A=Q / KPA, dV=-100 * VOLUME, R=0 * STRAIN)
    said = {"axial_displacement": "Weg [mm]", "q": "Kraft_A [kPa]", "eps_v": "dV [%] (dilation positive)", "R": "none"}
    with pytest.raises(DataError, match="no column 'none'; it has Weg, Kraft_A, dV, R"):
        read(tmp_path, text, said, height="100 mm", confining_stress="200 kPa")
    del said["R"]
    text = text.replace(";R\n", ";unused\n")
    curve = read(tmp_path, text, said, height="100 mm", confining_stress="200 kPa")
    np.testing.assert_allclose(curve.axial_strain, STRAIN, atol=1e-12)
    np.testing.assert_allclose(curve.stress_ratio, RATIO, rtol=1e-9)
    np.testing.assert_allclose(curve.volumetric_strain, VOLUME, atol=1e-12)
    # Only units, for names that are known; and a study file's table is the same as the arguments.
    plain = table(eps_a=100 * STRAIN, q=Q / PSI, s3=HELD / KPA, ev=100 * VOLUME)
    told = {"columns": {"eps_a": "[%]", "q": "[psi]", "s3": "[kPa]", "volumetric_strain": "[%]"}}
    np.testing.assert_allclose(read(tmp_path, plain, **told).stress_ratio, RATIO, rtol=1e-6)
    # One of two columns of one quantity.
    two = table(**columns(R=RATIO, stress_ratio=1.1 * RATIO))
    assert "say which" in refused(tmp_path, two)
    np.testing.assert_allclose(read(tmp_path, two, {"R": "stress_ratio"}).stress_ratio, 1.1 * RATIO)


PLAIN = table(**columns(R=RATIO))
REFUSED = {
    "no height": (table(**{"displacement [mm]": STRAIN, "R": RATIO}), {}, "give the specimen's height"),
    "a displacement without a unit": (table(displacement=STRAIN, R=RATIO), {"height": "1 m"}, "must have its unit"),
    "a height without a unit": (PLAIN, {"height": "100"}, "height = '100': must be a length with its unit"),
    "a stress without a unit": (PLAIN, {"confining_stress": 200}, "must be a stress with its unit, such as '200 kPa'"),
    "a stress in furlongs": (PLAIN, {"confining_stress": "2 furlong"}, "confining_stress = '2 furlong'"),
    "a void ratio in percent": (PLAIN, {"void_ratio": 72.0}, "void_ratio = 72.0: must be positive"),
    "q alone": (table(**columns(q=Q)), {}, "one of them and the confining stress as a number"),
    "q without a unit, s3 with": (table(**columns(q=Q)), {"confining_stress": "2 bar"}, "'q' is without a unit"),
    "q/p of 3": (table(**columns(**{"q/p": RATIO})), {}, "q/p must be below 3"),
    "q/p named R": (table(**columns(R=Q / P)), {}, "if q/p, name it q/p"),
    "p of another kind": (
        table(**columns(**{"q [kPa]": Q / KPA, "s3 [kPa]": HELD / KPA, "p [kPa]": (HELD + Q / 2) / KPA})), {},
        "here p is (s1 + 2 s3)/3",
    ),
    "two confining stresses": (
        table(**columns(**{"q [kPa]": Q / KPA, "s3 [kPa]": HELD / KPA})), {"confining_stress": "100 kPa"},
        "'s3 [kPa]' begins at 200000 Pa",
    ),
    "two units": (PLAIN, {"columns": {"eps_a": "[-]"}}, "is marked '%', but columns say '-'"),
    "two signs": (
        table(**columns(R=RATIO, **{"ev [%] (dilation positive)": VOLUME})),
        {"columns": {"eps_v": "(compression positive)"}}, "columns say the other one",
    ),
    "no such quantity": (PLAIN, {"columns": {"temperature": "T"}}, "'temperature' is no quantity known here"),
    "no such column": (PLAIN, {"columns": {"eps_v": "dV [%]"}}, "no column 'dV [%]'"),
    "an empty mapping": (PLAIN, {"columns": {"eps_v": " "}}, "must be the name of a column"),
    "e0 later": (
        "\n".join(line for n, line in enumerate(table(**columns(R=RATIO, e=VOID)).splitlines()) if n != 1), {},
        "--void-ratio",
    ),
    "e of nothing": (table(**columns(R=RATIO, e=VOID - 0.9)), {}, "a void ratio must be positive"),
    "e and eps_v apart": (
        table(**columns(R=RATIO, e=VOID, **{"ev [%]": -100 * VOLUME})), {}, "'ev [%]' and 'e' contradict each other",
    ),
    "a test that is not there": (PLAIN, {"test": "A"}, "there is no column 'test_id'"),
    "comments that contradict": ("# e0 0.7\n# e_0 = 0.72\n" + PLAIN, {}, "as 0.7 and 0.72"),
    "comment and argument": ("# e0 0.7\n" + PLAIN, {"void_ratio": 0.72}, "0.72 is given, but the file says 0.7"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_known_is_asked_for(tmp_path, kind):
    text, options, words = REFUSED[kind]
    assert words in refused(tmp_path, text, **options)


def test_comments_tell_void_ratio_and_confining_stress(tmp_path):
    curve = read(tmp_path, "# Some sand, drained TC\n# e0 0.584, sigma3 100 kPa\n" + PLAIN)
    assert (curve.facts.void_ratio, curve.facts.confining_stress) == (0.584, 1e5)
    assert curve.confining.unlike(1e5) is None and "100000 Pa" in curve.confining.unlike(2e5)
    # Where q stands alone the comment's confining stress makes the ratio.
    q = read(tmp_path, "# confining pressure = 0,2 MPa\n" + table(**columns(**{"q [kPa]": Q / KPA})))
    np.testing.assert_allclose(q.stress_ratio, RATIO, rtol=1e-9)
    assert of_comments("x", ["# sands 3 of 100", "# series 3, 100 rows"]).confining_stress is None


def test_mean_stress_of_another_definition_is_doubted(tmp_path):
    """Of (s1 + s3)/2 and (s1 - s3)/2 the s3 that p - q/3 gives is not held."""
    text = table(**columns(**{"q [kPa]": Q / 2 / KPA, "p [kPa]": (HELD + Q / 2) / KPA}))
    assert any("is p there (s1 + 2 s3)/3" in one for one in read(tmp_path, text).warnings)


def test_flat_padding_is_cut_and_coarse_readings_are_not(tmp_path):
    more = STRAIN[-1] + 0.004 * np.arange(1, 9)
    padded = np.r_[STRAIN, more], np.r_[RATIO, [RATIO[-1]] * 8], np.r_[VOLUME, [VOLUME[-1]] * 8]
    text = table(eps_a=padded[0], R=padded[1], ev=padded[2])
    curve = read(tmp_path, text)
    np.testing.assert_allclose(curve.axial_strain, STRAIN, atol=1e-12)
    assert "the last 8 rows only repeat R = " in curve.warnings[0] and "cut, the curve ends at 0.1" in curve.warnings[0]
    # Rows that repeat wholly, strain and all.
    whole = table(eps_a=np.r_[STRAIN, STRAIN[[-1, -1]]], R=np.r_[RATIO, RATIO[[-1, -1]]])
    assert len(read(tmp_path, whole)) == len(STRAIN)
    # R read to 0.5: it stands still on the way as well, so that nothing is cut; long standstills are doubted.
    coarse = table(eps_a=STRAIN, R=np.round(2 * RATIO) / 2)
    curve = read(tmp_path, coarse)
    assert len(curve) == len(STRAIN) and not any("cut" in one for one in curve.warnings)


DATABASE = """\
# Sand Triaxial Test Database
# ===== [1] FILE_INFO =====
key,value
material,"Some sand, fine"
license,CC-BY-4.0

# ===== [2] SOURCES =====
role,citation,doi
data source,"A and B (2016)",10.0/x
related publication,C (2017),10.0/y
# ===== [3] INDEX_PROPERTIES =====
property,symbol,value,unit
median diameter,d50,0.14,mm
uniformity,Cu,1.5,-
specific gravity,Gs,,-
# ===== [4] PARTICLE_SIZE_DISTRIBUTION =====
sieving_id,label,diameter[mm],finer_by_weight[%]
1,2010,0.0631,1.53
1,2010,0.1249,28.24
1,2010,0.3135,100
2,2012,0.1,0
2,2012,0.3,100
# ===== [5] TEST_PROGRAMME =====
test_id,consolidation,K_c[-],OCR[-],sigma_r0[kPa],sigma_v0[kPa],e_0[-],Dr_0[%],data_points,notes
TMD1,isotropic,1,1,200,200,0.72,80.5,26,
TMD2,K0,0.5,2,200,400,,,26,loose
# ===== [6] TEST_DATA =====
test_id,eps_a[%],eps_v[%],sigma_r[kPa],sigma_v[kPa]
"""


def records(test, volume, rows=slice(None)):
    columns = zip(STRAIN[rows], volume[rows], RATIO[rows], strict=True)
    return "".join(f"{test},{100 * e:.12g},{v},{S3 / KPA:.2f},{r * S3 / KPA:.12g}\n" for e, v, r in columns)


MEASURED = [f"{100 * v:.12g}" for v in VOLUME]
GAPS = ["" if n in (3, 4) else cell for n, cell in enumerate(MEASURED)]


def test_a_material_file_of_the_sand_database_is_read_as_it_is(tmp_path):
    text = DATABASE + records("TMD1", np.array(MEASURED)) + records("TMD2", np.array([""] * len(STRAIN)))
    curve = read(tmp_path, text, test="tmd1")
    np.testing.assert_allclose(curve.axial_strain, STRAIN, atol=1e-12)
    np.testing.assert_allclose(curve.stress_ratio, RATIO, rtol=1e-9)
    np.testing.assert_allclose(curve.volumetric_strain, VOLUME, atol=1e-12)
    np.testing.assert_allclose(curve.void_ratio, VOID, atol=1e-9)
    assert curve.warnings == ()
    facts = curve.facts
    assert (facts.test, facts.material, facts.void_ratio) == ("TMD1", "Some sand, fine", 0.72)
    assert facts.confining_stress == 2e5 and facts.relative_density == pytest.approx(0.805)
    assert facts.index == {"d50": 0.14, "Cu": 1.5} and "A and B (2016)" in facts.source
    assert facts.grading == ((0.0631, 1.53), (0.1249, 28.24), (0.3135, 100.0))
    assert json.loads(json.dumps(facts.as_dict()))["grading"][1] == [0.1249, 28.24]
    assert "TMD1, Some sand, fine, e0 = 0.72, confining stress 200 kPa, relative density 80.5 %" in str(facts)
    second = read(tmp_path, text, test="TMD2")
    assert second.volumetric_strain is None and second.facts.void_ratio is None
    for words in ("'eps_v[%]' is empty", "s3/s1 = 0.5", "OCR = 2"):
        assert any(words in one for one in second.warnings)
    assert "holds 2 tests, TMD1, TMD2; say which one" in refused(tmp_path, text)
    assert "has no test 'TMD3'; it has TMD1, TMD2" in refused(tmp_path, text, test="TMD3")


def test_rows_without_a_volume_are_left_out_with_a_word(tmp_path):
    curve = read(tmp_path, DATABASE + records("TMD1", np.array(GAPS)))  # one test, so that it need not be named
    assert len(curve) == len(STRAIN) - 2 and curve.facts.test == "TMD1"
    assert any("2 of 26 rows have no 'eps_v[%]' (the first is data row 4)" in one for one in curve.warnings)


def test_several_tests_in_a_plain_table(tmp_path):
    text = table(**columns(R=RATIO)).splitlines()
    rows = [f"{name};{line}" for name in ("A1", "A2") for line in text[1:]]
    whole = "\n".join(["Test ID;" + text[0], *rows])
    assert "holds 2 tests, A1, A2" in refused(tmp_path, whole)
    curve = read(tmp_path, whole, test="A2")
    assert len(curve) == len(STRAIN) and curve.facts.test == "A2"


def test_no_test_reads_the_laboratorys_own_files():
    """They are no part of the project: tests make their own texts in the same format."""
    here = Path(__file__).read_text()
    assert "/" + "work" + "/shared" not in here
