"""A case file and a CSV file in, an answer out; and one sentence for each kind of data that cannot be used."""

import json
from dataclasses import replace

import numpy as np
import pytest
from calibrate_standin import StandIn, measured

from axijax.app.case import load_case
from calibrate.file import calibrate_file
from calibrate.measured import DataError

CASE = """
[specimen]
kind = "octagon"
layers = 5
half_width = 5
[parameters]
platen_speed = 0.02
damping_ratio = 0.2
[test]
axial_strain = 0.005
tolerance = 1e-6
record_every = 20
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    path = tmp_path_factory.mktemp("case") / "case.toml"
    path.write_text(CASE)
    return load_case(path).build()


def refused(tmp_path, case, text, names="f,kn", kind=DataError, **columns) -> str:
    (tmp_path / "data.csv").write_text(text)
    with pytest.raises(kind) as error:
        calibrate_file(tmp_path / "data.csv", names, case, tmp_path / "out", report=lambda line: None, **columns)
    assert "\n" not in str(error.value)
    return str(error.value)


HEAD = "axial_strain,stress_ratio\n"


@pytest.mark.parametrize(
    "text, words",
    [
        (HEAD + "0,1\n0.002,2\n0.001,1.5\n", "falls back to 0.001 after 0.002 in data row 3: must increase"),
        (HEAD + "0,1\n0.001,2\n0.001,1.5\n", "repeats 0.001"),
        ("axial_strain,q\n0,1\n0.002,2\n", "no column 'stress_ratio'; it has axial_strain, q"),
        (HEAD + "-0.001,1.2\n-0.002,2\n", "looks tension-positive; compression must be positive"),
        (HEAD + "0,1\n0.001,nan\n", "stress_ratio = nan in data row 2: must be a finite number"),
        (HEAD + "0,1\n0.001,\n", "stress_ratio = '' in data row 2"),
        (HEAD + "0.001,2\n", "must have a header and at least one row|at least two points"),
        (HEAD + "0,1\n0.9,2\n", "is the file in percent"),
    ],
)
def test_bad_data_get_one_sentence_with_the_file(tmp_path, case, text, words):
    said = refused(tmp_path, case, text)
    assert any(part in said for part in words.split("|")), said
    assert "data.csv" in said


def test_what_data_and_case_cannot_do_together(tmp_path, case):
    two = HEAD + "0.001,1.5\n0.002,2\n"
    said = refused(tmp_path, case, two, "f,kn,ks", ValueError)
    assert "2 measured number(s) for 3 parameters" in said
    assert "stops at axial_strain = 0.005" in refused(tmp_path, case, HEAD + "0,1\n0.02,2\n", "f", ValueError)
    assert "parameter 'g'" in refused(tmp_path, case, two, "g", ValueError)
    with pytest.raises(DataError, match="no such file"):
        calibrate_file(tmp_path / "none.csv", "f", case, tmp_path / "out")


def test_a_peak_at_the_last_point_is_said(tmp_path):
    data = measured(StandIn(), np.linspace(2e-4, 8e-4, 10), friction=0.2)
    rows = "\n".join(f"{e:.9g},{r:.9g}" for e, r in zip(data.axial_strain, data.stress_ratio, strict=True))
    (tmp_path / "data.csv").write_text(HEAD + rows)
    said = []
    calibrate_file(tmp_path / "data.csv", "f", StandIn(), tmp_path, check=False, report=said.append)
    words = "the data still rise at the last point (R = "
    assert f"warning: {words}" in "\n".join(said)
    assert any(text.startswith(words) for text in json.loads((tmp_path / "fit.json").read_text())["warnings"])


@pytest.mark.slow
def test_case_and_file_to_answer(tmp_path, case):
    hidden = case.simulate(replace(case.params, friction=0.17, normal_stiffness=2e9, shear_stiffness=2e9))
    assert int(hidden.status) == 0
    strain = np.linspace(2e-4, 0.0047, 40)
    ratio = np.interp(strain, hidden.axial_strain, hidden.stress_ratio)
    rows = "\n".join(f"{100 * e:.6g};{r:.6g}" for e, r in zip(strain, ratio, strict=True))
    (tmp_path / "data.csv").write_text("# made by the program itself\nAxial_Strain [%];stress_ratio\n" + rows)
    said = []
    found = calibrate_file(tmp_path / "data.csv", "friction,kn", case, tmp_path / "out", report=said.append)
    assert found.estimate["friction"] == pytest.approx(0.17, rel=0.01)
    assert found.estimate["normal_stiffness"] == pytest.approx(2e9, rel=0.03)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"fit.json", "fit.png", "evaluations.jsonl"}
    assert any("health:" in text for text in said)
