"""Fits on random packings and studies from the command line, with packings that are real and tiny."""

import json
import tomllib

import numpy as np
import pytest
from cli_in_process import axijax

from axijax.app.case import Case, load_case
from axijax.app.random_scene import random_scene
from axijax.app.study_file import load_study
from calibrate.measured import MeasuredCurve
from calibrate.nodes import nodes_of, of_a_laboratory
from calibrate.study import LABORATORY

CASE = """
[specimen]
kind = "random"
balls = 40
[sector]
order = 2
[parameters]
friction = 0.4
platen_speed = 0.2
[test]
tolerance = 1e-2
confine_steps = 100000
axial_strain = 0.012
record_every = 20
"""

STUDY = """
case = "sand.toml"
fit = ["friction"]
runs = 14
[bounds]
friction = [0.15, 0.8]
[[test]]
name = "low"
data = "low.csv"
packings = "laboratory"
first_strain = 0.002
[[test]]
name = "high"
data = "low.csv"
confining_stress = 1.0e5
packings = 4
void_ratio = 0.6
held_out = true
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case, data that a study can read, and the folder of its library."""
    folder = tmp_path_factory.mktemp("random")
    (folder / "sand.toml").write_text(CASE)
    (folder / "study.toml").write_text(STUDY)
    strain = np.linspace(0, 0.0115, 60)
    ratio, volume = 1 + 1.4 * np.tanh(strain / 0.002), 0.2 * strain - 0.3 * strain**1.2
    table = np.column_stack([strain, ratio, volume])
    np.savetxt(
        folder / "low.csv", table, delimiter=",", header="axial_strain,stress_ratio,volumetric_strain", comments=""
    )
    return folder


@pytest.fixture(scope="module")
def fitted(folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("AXIJAX_LIBRARY", str(folder / "runs"))
        asked = "calibrate low.csv --case sand.toml --fit friction --bounds friction=0.15,0.8 --runs 14 --workers 1"
        return axijax(*asked.split(), "--output", "fit"), axijax("library", "list")


def test_a_random_case_is_fitted_on_packings(fitted, folder):
    called, _ = fitted
    told = json.loads((folder / "fit" / "fit.json").read_text())
    assert called.code == (0 if told["status"] == "converged" else 1), called.err
    assert "14 runs, each on a packing of its own, 14 of them new" in called.out
    assert "the data are taken for the curve of one packing" in called.out
    low, high = told["interval_95"]["friction"]
    assert 0.15 < low < told["estimate"]["friction"] < high < 0.8
    for name in ("samples.csv", "fit.png"):
        assert (folder / "fit" / name).stat().st_size > 1000


def test_its_runs_are_in_the_library(fitted):
    _, listed = fitted
    assert "14 runs, 0 failed" in listed.out and "balls 40" in listed.out


def test_the_same_fit_again_makes_no_run(fitted, folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("AXIJAX_LIBRARY", str(folder / "runs"))
    before = json.loads((folder / "fit" / "fit.json").read_text())
    asked = "calibrate low.csv --case sand.toml --fit friction --bounds friction=0.15,0.8 --workers 1 --output fit"
    called = axijax(*asked.split())
    assert "14 runs, each on a packing of its own, 0 of them new" in called.out
    assert json.loads((folder / "fit" / "fit.json").read_text())["interval_95"] == before["interval_95"]
    other = axijax(*asked.replace("friction=0.15,0.8", "friction=0.2,0.8").split())
    assert other.code == 1 and "is of another fit, which differs in fit.bounds" in other.err


def test_a_run_of_a_scene_is_that_of_the_case(folder):
    """The same packing at the same parameters by `Case.build().run()` and through the scene, to the last bit."""
    case = load_case(folder / "sand.toml")
    scene = random_scene(case)
    point = scene.point({}, scene.stress)
    through = scene.run(point, 3, 0.004)
    test = case.model_copy(update={"specimen": case.specimen.model_copy(update={"seed": 3})}).build()
    own = test.run().curve
    count = min(len(through.axial_strain), len(own.axial_strain))
    assert count > 5 and (through.stress_ratio[:count] == own.stress_ratio[:count]).all()
    assert through.axial_strain[-1] >= 0.004, "a record past the end of the data"


def test_one_scene_whatever_seed_parameters_and_strain(folder):
    case = load_case(folder / "sand.toml")
    other = case.model_copy(
        update={
            "specimen": case.specimen.model_copy(update={"seed": 9}),
            "parameters": case.parameters.model_copy(update={"friction": 0.7, "confining_stress": 1e5}),
        }
    ).with_test(axial_strain=0.1)
    assert random_scene(case).parts == random_scene(other).parts
    denser = case.model_copy(update={"specimen": case.specimen.model_copy(update={"compaction_friction": 0.02})})
    assert random_scene(case).parts != random_scene(denser).parts
    assert random_scene(case).least == {"friction": 0.05}


def test_a_study_file_is_read(folder):
    study = load_study(folder / "study.toml")
    low, high = study.tests
    assert low.packings == LABORATORY and low.stress == 5e4 and not low.held_out
    assert low.curve.axial_strain[0] >= 0.002 and high.curve.axial_strain[0] == 0
    assert (high.packings, high.stress, high.void_ratio, high.held_out) == (4, 1e5, 0.6, True)
    assert study.options["bounds"] == {"friction": (0.15, 0.8)} and study.options["runs"] == 14


@pytest.mark.parametrize(
    ("line", "instead", "told"),
    [
        ('fit = ["friction"]', 'fits = ["friction"]', "'fits' is no field of a study"),
        ("packings = 4", "packings = 0.5", "must be 1 or more"),
        ("held_out = true", "held_out = true\nstress = 3", "'test.2.stress' is no field of a study"),
        ('data = "low.csv"', "", "'test.1.data' is missing"),
        ("first_strain = 0.002", "first_strain = 0.4", "points of 5 needed"),
        ('"low.csv"', '"high.csv"', "high.csv"),
        ('"sand.toml"', '"clay.toml"', "clay.toml' cannot be read"),
        ("[bounds]\nfriction = [0.15, 0.8]", "[bounds]\nfriction = [0.01, 0.8]", "must be 0.05 or more"),
    ],
)
def test_a_study_file_that_makes_no_sense_is_refused_before_any_run(folder, tmp_path, monkeypatch, line, instead, told):
    assert line in STUDY
    for name in ("sand.toml", "low.csv"):
        (tmp_path / name).write_text((folder / name).read_text())
    (tmp_path / "study.toml").write_text(STUDY.replace(line, instead, 1))
    monkeypatch.chdir(tmp_path)
    called = axijax("calibrate", "study.toml", "--library", "runs", "--workers", "1")
    assert called.code == 1 and told in called.err and "Traceback" not in called.err
    assert not list(tmp_path.glob("runs/*/run-*"))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("low.csv --case sand.toml --packings none", "must be 'laboratory', or a number of packings"),
        ("low.csv --case sand.toml --start test", "looks everywhere within --bounds"),
        ("low.csv --packings 3", "--packings: would do nothing on a lattice"),
        ("none.csv --case sand.toml", "none.csv"),
        ("low.csv --case sand.toml --fit radius", "'radius' cannot be fitted on this specimen"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_anything_is_packed(folder, monkeypatch, options, told):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("AXIJAX_LIBRARY", str(folder / "none"))
    called = axijax("calibrate", *options.split(), "--output", "refused")
    assert called.code == 1 and told in called.err
    assert not list(folder.glob("none/*/run-*"))


def test_windows_of_a_measured_curve():
    """Means over windows of a straight line are its values at their mean strains; noise falls with the points."""
    strain = np.linspace(0.001, 0.1, 400)
    rng = np.random.default_rng(0)
    nodes = nodes_of(MeasuredCurve(strain, 2 + 10 * strain + 0.03 * rng.standard_normal(400), 0.5 * strain))
    ratio, volume = nodes.split(nodes.values)
    assert nodes.strain[0] < 0.0015 and np.diff(nodes.strain).min() > 0
    assert volume == pytest.approx(0.5 * nodes.strain)
    expected = np.sqrt(np.diag(nodes.noise)[: ratio.size])
    apart = np.log(ratio) - np.log(2 + 10 * nodes.strain)
    assert 0.5 < np.sqrt((apart**2 / expected**2).mean()) < 1.5
    wider = np.sqrt(np.diag(of_a_laboratory(nodes).noise))
    assert wider[ratio.size - 1] == pytest.approx(0.025 * np.log(ratio[-1]), rel=0.05)
    assert wider[-1] == pytest.approx(0.02 * nodes.strain[-1], rel=0.05)


def test_a_speed_that_the_case_leaves_out_is_that_of_each_specimen():
    """As `run` takes it; the parameters of a fit hold one number for all."""
    case = Case.model_validate(tomllib.loads(CASE.replace("platen_speed = 0.2\n", "")))
    made = random_scene(case).make(1, random_scene(case).params)
    given = case.model_copy(update={"parameters": case.parameters.model_copy(update={"platen_speed": 0.01})})
    assert random_scene(given).parts != random_scene(case).parts
    alone = case.model_copy(update={"specimen": case.specimen.model_copy(update={"seed": 1})}).build()
    assert float(made.params.platen_speed) == float(alone.params.platen_speed) != 0.01
