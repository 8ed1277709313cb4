"""Options of `axijax calibrate`: bounds, start, priors, uncertainties, columns and units reach the fit; what cannot
work is said before a specimen is made; a friction above 1 where balls allow it."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from calibrate_standin import StandIn, measured
from cli_in_process import SMALL, axijax, write

from axijax import Params
from axijax.app.case import Case
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.test import TriaxialTest
from calibrate import Prior
from calibrate.fit import fit_parameters
from calibrate.model import Model
from calibrate.parameters import ParameterSet

STRAIN = np.linspace(0.0002, 0.009, 40)


class Sand(StandIn):
    """Balls whose strength goes on rising past a friction of 1."""

    def simulate(self, params):
        strain = jnp.linspace(0.0, self.axial_strain, 101)
        peak = 1 + 5 * params.friction / (0.4 + params.friction)
        return SimpleNamespace(axial_strain=strain, stress_ratio=1 + (peak - 1) * jnp.tanh(strain / 1e-3), status=0)


@pytest.mark.parametrize("hidden", [0.4, 1.1])
@pytest.mark.parametrize("start", ["rule", "test", {"f": 1.3}])
def test_a_friction_above_one_is_found(hidden, start):
    data = measured(Sand(), STRAIN, friction=hidden)
    found = fit_parameters(Sand(), data, "friction", bounds={"f": (0.05, 1.5)}, start=start)
    assert found.converged and found.estimate["friction"] == pytest.approx(hidden, rel=1e-3)
    low, high = found.interval["friction"] if np.isfinite(found.standard_error["friction"]) else (0.05, 1.5)
    assert 0 < low < high


def test_coordinates_of_a_friction_above_one():
    usual = ParameterSet.of(Params(), "f")
    assert usual.about_of("friction").coordinate == "logit" and usual.upper[0] == pytest.approx(0.999)
    wide = ParameterSet.of(Params(), "f", {"f": (0.1, 1.2)})
    assert wide.about_of("friction").coordinate == "log"
    assert wide.values(wide.coordinates({"f": 1.1}))["friction"] == pytest.approx(1.1)
    assert float(wide.params(Params(), wide.coordinates({"f": 1.1})).friction) == pytest.approx(1.1)
    strong = ParameterSet.of(Params(friction=1.1), "f")
    assert strong.coordinates()[0] == pytest.approx(np.log(1.1)) and strong.upper[0] == pytest.approx(3.3)


def test_a_lattice_locks_below_one():
    test = TriaxialTest(fcc_octagon(layers=5, half_width=5))
    model = Model(test, ParameterSet.of(test.params, "f", {"f": (0.1, 1.2)}))
    with pytest.raises(ValueError, match=r"upper bound of friction = 1\.2: a regular array locks at 1 and above"):
        model.check_stiffest()
    Model(SimpleNamespace(params=test.params, specimen=replace(test.specimen, zone_rule="exposure")),
          model.parameters).check_stiffest()  # fmt: skip


TEXT = "Weg,Spannung,dV\n" + "".join(f"{100 * e:.9g},{5e4 * (r - 1):.9g},{-1e-4:.9g}\n" for e, r in zip(
    STRAIN, 1 + 1.5 * np.tanh(STRAIN / 1e-3), strict=True))  # fmt: skip
OPTIONS = (
    "--column", "axial_displacement=Weg [mm]", "--column", "q=Spannung [Pa]", "--height", "10 cm",
    "--confining-stress", "50 kPa", "--bounds", "f=0.05,0.6", "--bounds", "kn=1e8,1e10", "--start", "f=0.2",
    "--start", "kn=1e9", "--prior", "kn=1.4e9,0.3", "--uncertainty", "stress_ratio=0.04", "--runs", "7",
)  # fmt: skip


def test_options_reach_the_fit(tmp_path, monkeypatch):
    seen = {}

    def calibrate_file(curve, names, test, folder, **options):
        seen.update(options, curve=curve, names=names, test=test)
        return SimpleNamespace(converged=True)

    monkeypatch.setattr("calibrate.calibrate_file", calibrate_file, raising=False)
    (tmp_path / "lab.csv").write_text(TEXT)
    case = write(tmp_path / "case.toml")
    called = axijax(
        "calibrate", tmp_path / "lab.csv", "--fit", "f,kn", "--case", case, "--output", tmp_path / "o", *OPTIONS
    )
    assert called.code == 0, called.err
    curve = seen["curve"]
    np.testing.assert_allclose(curve.axial_strain, STRAIN, rtol=1e-8)
    np.testing.assert_allclose(curve.stress_ratio, 1 + 1.5 * np.tanh(STRAIN / 1e-3), rtol=1e-6)
    assert curve.ratio_sigma == 0.04 and curve.sigma_known and curve.confining.value == 5e4
    assert seen["bounds"] == {"f": (0.05, 0.6), "kn": (1e8, 1e10)} and seen["start"] == {"f": 0.2, "kn": 1e9}
    assert seen["priors"] == {"kn": Prior(1.4e9, 0.3)} and seen["max_runs"] == 7 and seen["names"] == "f,kn"
    for start in ("test", "rule"):
        axijax("calibrate", tmp_path / "lab.csv", "--case", case, "--output", tmp_path / "o", *OPTIONS[:8],
               "--start", start)  # fmt: skip
        assert seen["start"] == start


def test_bounds_priors_and_start_act(tmp_path):
    from calibrate.file import calibrate_file

    data = measured(StandIn(), STRAIN, friction=0.3)
    quiet = {"check": False, "report": lambda line: None}
    found = calibrate_file(data, "f", StandIn(), tmp_path / "a", bounds={"f": (0.05, 0.2)}, **quiet)
    assert found.estimate["friction"] == pytest.approx(0.2, rel=0.02) and not found.converged
    pulled = calibrate_file(data, "f", StandIn(), tmp_path / "b", priors={"f": Prior(0.1, 1e-4)}, **quiet)
    assert pulled.estimate["friction"] == pytest.approx(0.1, rel=0.02)
    few = calibrate_file(data, "f,kn", StandIn(), tmp_path / "c", start={"f": 0.6}, max_runs=1, **quiet)
    assert few.status == "stopped: 1 runs are spent"


REFUSED = {
    "no such file": (("none.csv",), "none.csv: no such file"),
    "no such column": (("lab.csv",), "no column 'axial_strain'; it has Weg, Spannung, dV"),
    "no such parameter": (("good.csv", "--fit", "cohesion"), "parameter 'cohesion'"),
    "bounds that are none": (("good.csv", "--bounds", "friction"), "must be NAME=VALUE, such as friction=0.1,0.6"),
    "one bound": (("good.csv", "--bounds", "friction=0.1"), "--bounds friction = '0.1': must be 2 numbers"),
    "bounds of another": (("good.csv", "--bounds", "kn=1,2"), "bounds are given for 'normal_stiffness', which is not"),
    "bounds twice": (("good.csv", "--bounds", "f=0.1,0.2", "--bounds", "f=0.1,0.3"), "f is given twice"),
    "a prior without a spread": (("good.csv", "--prior", "f=0.3"), "--prior f = '0.3': must be 2 numbers"),
    "a prior of zero spread": (("good.csv", "--prior", "f=0.3,0"), "prior spread = 0.0"),
    "a start that is no number": (("good.csv", "--start", "f=high"), "--start f = 'high': must be a number"),
    "an uncertainty of another": (("good.csv", "--uncertainty", "e=1"), "must be of stress_ratio or volumetric_strain"),
    "an uncertainty of zero": (("good.csv", "--uncertainty", "R=0"), "ratio_sigma = 0.0: must be positive"),
    "no such quantity": (("good.csv", "--column", "colour=red"), "'colour' is no quantity known here"),
    "a height without unit": (("good.csv", "--height", "100"), "must be a length with its unit"),
    "data beyond the test": (("far.csv",), "goes to strain 0.05, but the test stops at axial_strain = 0.012"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_work_is_said_before_a_specimen_is_made(kind, tmp_path, monkeypatch):
    def build(self, specimen=None):
        raise AssertionError("a specimen was made")

    monkeypatch.setattr(Case, "build", build)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab.csv").write_text(TEXT)
    (tmp_path / "good.csv").write_text("axial_strain [%],R\n0,1\n0.1,1.5\n0.2,2\n0.4,1.9\n")
    (tmp_path / "far.csv").write_text("axial_strain [%],R\n0,1\n0.1,1.5\n0.5,2\n5,1.9\n")
    write(tmp_path / "case.toml", SMALL)
    arguments, words = REFUSED[kind]
    called = axijax("calibrate", *arguments, "--case", "case.toml", "--output", "out")
    assert called.code == 1 and words in called.err and "Traceback" not in called.err, called
    assert not (tmp_path / "out").exists()


def test_facts_stand_in_the_fit(tmp_path):
    from calibrate.file import calibrate_file

    data = measured(StandIn(), STRAIN, friction=0.3)
    rows = "".join(f"{100 * e:.9g},{r:.9g}\n" for e, r in zip(data.axial_strain, data.stress_ratio, strict=True))
    (tmp_path / "a.csv").write_text("# e0 0.72, s3 50 kPa\neps_a [%],R\n" + rows)
    said = []
    calibrate_file(tmp_path / "a.csv", "f", StandIn(), tmp_path / "o", check=False, report=said.append)
    assert "the file says: e0 = 0.72, confining stress 50 kPa" in said
    stored = json.loads((tmp_path / "o" / "fit.json").read_text())["data"]
    assert stored == [{"source": str(tmp_path / "a.csv"), "void_ratio": 0.72, "confining_stress": 5e4}]
