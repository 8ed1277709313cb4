"""What a case will take: its numbers against closed forms, and a warning for each sharp bit and for nothing else."""

import json
import tomllib
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from cli_in_process import SMALL, axijax, write

from axijax.app.case import Case, load_case
from axijax.app.checks import _packing_checks
from axijax.app.forecast import forecast
from axijax.app.runs import packing_values
from axijax.mechanics.params import Params
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial import progress
from axijax.triaxial.test import TriaxialTest


def looked_at(**sections):
    return forecast(Case(**sections), measure=False)


def test_the_papers_quarter():
    """PHYSICS 1.2 and 1.3: inertial number 2.2e-4, s3 r/K = 1/1500, 25 layers sqrt(2) radii apart."""
    found = looked_at()
    height = 20 * (2 + 24 * np.sqrt(2))
    assert found.balls == 427 and found.height == pytest.approx(height)
    assert found.inertial_number == pytest.approx(2 * 0.01 / height * 40 * np.sqrt(2000 / 5e4))
    assert found.inertial_number == pytest.approx(2.2e-4, rel=0.02)
    assert found.softness == pytest.approx(5e4 * 20 / 1.5e9)
    assert found.time_step == pytest.approx(0.6 * found.critical_time_step)
    assert found.shear_steps == pytest.approx(0.01 * height / 0.02 / found.time_step, rel=0.1)
    assert found.warnings == []


SOFT = {"normal_stiffness": 2e8, "shear_stiffness": 2e8}
STIFF = {"normal_stiffness": 1.5e11, "shear_stiffness": 1.5e11}
STEP = 0.03257881449471202 / 0.6  # critical for the paper's quarter with dashpots

# A case, and the words of the one warning that it gets.
WARNED = {
    "fast": ({"parameters": {"platen_speed": 0.1}, "test": {"axial_strain": 0.02}}, "inertial number 2.23e-03"),
    "bcc": ({"specimen": {"kind": "bcc"}}, "does not stand without friction"),
    "soft": ({"parameters": SOFT}, "softness s3 r/kn = 5.0e-03"),
    "stiff": ({"parameters": STIFF}, "softness s3 r/kn = 6.7e-06"),
    "smooth": (
        {"parameters": {"friction": 0}, "specimen": {"kind": "sc"}, "test": {"axial_strain": 0.05}},
        "collapses",
    ),
    "rough": ({"parameters": {"friction": 0.9}}, "balls roll"),
    "full": (
        {"sector": {"order": 1}, "specimen": {"half_width": 5}, "test": {"axial_strain": 0.02}},
        "breaks its symmetry",
    ),
    "large": ({"test": {"axial_strain": 0.03}}, "on the axis"),
    "rigid": ({"sector": {"order": 4, "boundary": "rigid"}}, "18 % weaker"),
    "short": ({"specimen": {"layers": 7}}, "diameters high"),
    "local": ({"scene": {"damping": "local"}}, "meaningless derivatives"),
    "background": ({"scene": {"damping": "background"}}, "adds strength"),
    "undamped": ({"scene": {"damping": "none"}}, "nothing damps"),
    "brief": ({"test": {"axial_strain": 3e-4, "record_every": 10}}, "reach their speed only at"),
    "rarely recorded": ({"test": {"record_every": 1000}}, "records"),
    "long step": ({"test": {"time_step": 0.75 * STEP}}, "0.75 of the critical one"),
    "loose": ({"test": {"tolerance": 0.01}}, "far from equilibrium"),
    "slippery": (
        {"parameters": {"friction": 0.1}, "test": {"confining_friction": 0.3}},
        "friction 0.1 is below the confining_friction 0.3",
    ),
}


@pytest.mark.parametrize("case", WARNED)
def test_each_sharp_bit_has_its_warning(case):
    sections, words = WARNED[case]
    told = looked_at(**sections).warnings
    assert len(told) == 1 and words in told[0], told


def test_local_damping_at_a_long_step_has_two():
    """1/sqrt(1 + 0.7) = 0.77 of the critical step, which differs with the damping."""
    limit = looked_at(scene={"damping": "local"}).critical_time_step
    told = looked_at(scene={"damping": "local"}, test={"time_step": 0.79 * limit}).warnings
    assert any("0.77 of the critical one, and it is 0.79" in text for text in told)


GAP = """
[specimen]
kind = "random"
balls = 40
grading = "sand.csv"
[sector]
order = 2
[parameters]
friction = 0.04
platen_speed = 0.01
[test]
tolerance = 0.01
axial_strain = 0.02
confining_friction = 0.0
"""


def test_a_grading_that_is_not_met_and_friction_below_that_of_the_compaction(tmp_path):
    """As `axijax check` tells them, and as a result keeps them."""
    (tmp_path / "sand.csv").write_text("opening,passing\n20,0\n25,30\n80,30\n100,100\n")
    path = write(tmp_path / "gap.toml", GAP)
    case = load_case(path)
    told = forecast(case, measure=False).warnings
    filled, specimen, report = case.made()
    radii = filled.build(specimen).cut.radius
    got = 100 * (radii[radii < 20] ** 3).sum() / (radii**3).sum()
    assert sum(f"have {got:.3g} % of the mass, where 30 % is asked for" in text for text in told) == 1, told
    assert sum("friction 0.04 is below the friction 0.05 of the compaction" in text for text in told) == 1, told
    kept = packing_values(report)
    assert kept["deviation"] == pytest.approx(abs(got - 30) / 100) and kept["warnings"][0] in told
    even = SimpleNamespace(core_ratio=np.ones(1))
    checks = {each.name: each for each in _packing_checks(SimpleNamespace(info={"packing": kept}, curve=even))}
    check = checks.pop("grading met")
    assert all(each.passed for each in checks.values())
    assert check.passed is False and check.value == pytest.approx(abs(got - 30) / 100)


def test_a_gap_graded_sand_of_size_ratio_11_is_refused_at_once(tmp_path):
    """30 % fines asked, 400 balls: what cannot be supported, what would be missed, and the balls that would do."""
    (tmp_path / "sand.csv").write_text("opening,passing\n0.2,0\n0.25,30\n2.0,30\n2.5,100\n")
    sections = GAP.replace("balls = 40", "balls = 400").replace("order = 2", "order = 4")
    for command in ("check", "run"):
        called = axijax(command, write(tmp_path / "gap.toml", sections))
        assert called.code == 1 and "Traceback" not in called.err
        for words in ("size ratio is 11", "up to 6", "where 30 % is asked for", "balls come within 5 %"):
            assert words in called.err


def test_every_shear_with_less_friction_than_the_confinement_is_warned_of(monkeypatch):
    """Of the test's own parameters, of those that it is run with, and of a scene without friction."""
    monkeypatch.setattr(progress, "settle", nothing_runs)
    specimen = fcc_octagon(layers=5, half_width=3)
    with pytest.warns(UserWarning, match=r"friction 0\.1 is below the confining_friction 0\.3"):
        TriaxialTest(specimen, params=Params(friction=0.1), confining_friction=0.3).prepared  # noqa: B018
    with pytest.warns(UserWarning, match="friction 0 is below"):
        TriaxialTest(specimen, params=Params(friction=None), confining_friction=0.3).prepared  # noqa: B018
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        test = TriaxialTest(specimen, params=Params(friction=0.3), confining_friction=0.3)
        assert test.prepared
    with pytest.warns(UserWarning, match=r"friction 0\.2 is below"), pytest.raises(AssertionError):
        test.run(Params(friction=0.2))


def nothing_runs(*_):
    raise AssertionError("no confinement here")


def test_measured_from_the_command_line(tmp_path):
    """Both ways of printing; the steps and records are those that a run then takes."""
    path = write(tmp_path / "small.toml")
    called = axijax("check", path, "--json")
    assert called.code == 0, called.err
    found = json.loads(called.out)
    assert found["ball_steps_per_second"] > 1e4 and found["seconds"] > 0 and found["memory"] > 1e7
    test = Case.model_validate(tomllib.loads(SMALL)).build()
    records = test.run().curve.stress_ratio.size
    assert found["records"] - 2 <= records <= found["records"]
    told = axijax("check", path)
    assert told.code == 0 and f"{found['critical_time_step']:.4g}" in told.out
    assert "measured now, over some 1000 steps" in told.out and "28 records" in told.out


def test_balls_that_do_not_stay_are_told(tmp_path):
    """Platens so fast that the specimen is crushed in 1000 steps: no rate, but a warning."""
    path = write(tmp_path / "fast.toml", SMALL.replace("platen_speed = 0.01", "platen_speed = 2.0"))
    found = json.loads(axijax("check", path, "--json").out)
    assert found["ball_steps_per_second"] is None and found["seconds"] is None
    assert any("do not stay" in text for text in found["warnings"])
