"""What a case will take: its numbers against closed forms, and a warning for each sharp bit and for nothing else."""

import json
import tomllib

import numpy as np
import pytest
from cli_in_process import SMALL, axijax, write

from axijax.case import Case
from axijax.forecast import forecast


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
}


@pytest.mark.parametrize("case", WARNED)
def test_each_sharp_bit_has_its_warning(case):
    sections, words = WARNED[case]
    warnings = looked_at(**sections).warnings
    assert len(warnings) == 1 and words in warnings[0], warnings


def test_local_damping_at_a_long_step_has_two():
    """1/sqrt(1 + 0.7) = 0.77 of the critical step, which differs with the damping."""
    limit = looked_at(scene={"damping": "local"}).critical_time_step
    warnings = looked_at(scene={"damping": "local"}, test={"time_step": 0.79 * limit}).warnings
    assert any("0.77 of the critical one, and it is 0.79" in text for text in warnings)


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
