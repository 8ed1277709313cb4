"""Fits on a formula that stands in for the simulator (the logic), and on the small specimen (the physics)."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from calibrate_standin import StandIn, measured

from axijax import Gravity, Params, Rolling
from axijax.specimen.specimen import fcc_octagon
from axijax.theory import fcc_stress_ratio, stretched_stress_ratio
from axijax.triaxial.test import TriaxialTest
from calibrate.descent import fit_by_descent
from calibrate.file import calibrate_file
from calibrate.fit import fit_parameters
from calibrate.measured import ROWE, MeasuredCurve
from calibrate.model import Model, RunFailed
from calibrate.parameters import ParameterSet, Prior
from calibrate.secant import fit_friction_to_peak, fit_one
from calibrate.start import similar_curve
from calibrate.targets import Datum, HardPeak, WindowMean

TRUTH = {"friction": 0.21, "normal_stiffness": 2.4e9, "shear_stiffness": 2.4e9}


def test_a_run_is_carried_over_by_similarity():
    curve = StandIn().simulate(StandIn().params)
    curve.axial_strain, curve.stress_ratio = np.asarray(curve.axial_strain), np.asarray(curve.stress_ratio)
    curve.volumetric_strain = np.asarray(curve.volumetric_strain)
    softer = similar_curve(curve, 0.12278, 0.12278, 0.5)
    wanted = np.asarray(stretched_stress_ratio(curve.axial_strain, 0.5, curve.axial_strain, curve.stress_ratio))
    assert softer.stress_ratio == pytest.approx(wanted, rel=1e-12)
    assert softer.volumetric_strain[40] == pytest.approx(2 * curve.volumetric_strain[20], rel=1e-12)
    # Another friction: Thornton's peaks, at the strain where the horizontal contacts open.
    rougher, top = similar_curve(curve, 0.12278, 0.3, 1.0), curve.stress_ratio.argmax()
    assert rougher.stress_ratio.max() == pytest.approx(
        curve.stress_ratio.max() * fcc_stress_ratio(0.3) / fcc_stress_ratio(0.12278), rel=1e-3
    )
    at = curve.axial_strain[top] * (3.3 / 0.7) / (3.12278 / 0.87722)
    assert curve.axial_strain[rougher.stress_ratio.argmax()] == pytest.approx(at, abs=1e-4)


@pytest.mark.parametrize(
    ("start", "jacobian"),
    [
        ("rule", "economical"), ("test", "tangent"), ({"f": 0.45, "kn": 4e8}, "economical"),
        ({"f": 0.45, "kn": 4e8}, "difference"), ({"f": 0.03, "kn": 7e9}, "economical"),
        ({"f": 0.03, "kn": 7e9}, "tangent"),
    ],
)  # fmt: skip
def test_friction_and_stiffness_are_recovered(jacobian, start):
    found = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", start=start, jacobian=jacobian)
    assert found.converged
    assert found.estimate["friction"] == pytest.approx(0.21, rel=2e-3)
    assert found.estimate["normal_stiffness"] == pytest.approx(2.4e9, rel=5e-3)
    assert not found.warnings
    if jacobian == "economical" and start == "rule":
        assert found.cost.forward_equivalents <= 7


def test_three_parameters_need_what_tells_them_apart():
    truth = TRUTH | {"shear_stiffness": 1.2e9}
    found = fit_parameters(StandIn(), measured(StandIn(), **truth), "f,kn,ks", start="test")
    # The stand-in feels kn and ks through one product only.
    assert any("not told apart" in text or "not identified" in text for text in found.warnings)
    assert found.estimate["friction"] == pytest.approx(0.21, rel=5e-3)


def test_standard_errors_cover_the_truth():
    inside, model = [], Model(StandIn(), "f,kn")
    for seed in range(12):
        found = fit_parameters(model, measured(StandIn(), noise=0.01, seed=seed, **TRUTH), "f,kn")
        z = found.parameters.coordinates({"f": 0.21, "kn": 2.4e9})
        inside.append(np.abs(found.coordinates - z) <= 2 * np.sqrt(np.diag(found.covariance)))
    share = np.mean(inside, axis=0)
    assert (share > 0.85).all(), share


def test_stiffness_from_the_peak_alone_is_flagged():
    datum = Datum(WindowMean(0.008, 0.009), 2.5, 0.05)
    found = fit_one(StandIn(), datum, "kn", start=6e9)
    assert any("normal_stiffness is not identified" in text for text in found.warnings)
    two = [datum, Datum(HardPeak(), 2.5, 0.05)]
    found = fit_parameters(StandIn(), two, "f,kn", start={"kn": 6e9, "f": 0.15}, max_runs=20)
    assert any("identified" in text or "told apart" in text for text in found.warnings)


def test_too_few_numbers_and_too_long_data():
    with pytest.raises(ValueError, match=r"1 measured number\(s\) for 2 parameters"):
        fit_parameters(StandIn(), Datum(HardPeak(), 2.4, 0.05), "f,kn")
    long = MeasuredCurve([0.001, 0.02], [1.5, 2.5])
    with pytest.raises(ValueError, match=r"goes to strain 0\.02, but the test stops at"):
        fit_parameters(StandIn(), long, "f")
    with pytest.raises(ValueError, match="jacobian = 'exact'"):
        fit_parameters(StandIn(), Datum(HardPeak(), 2.4, 0.05), "f", jacobian="exact")
    with pytest.raises(ValueError, match="bounds of friction"):
        fit_parameters(StandIn(), Datum(HardPeak(), 2.4, 0.05), "f", bounds={"f": (0.4, 0.1)})
    with pytest.raises(ValueError, match="a secant fits one"):
        fit_one(StandIn(), measured(StandIn()), "f")


def test_an_estimate_at_its_bound_is_flagged():
    found = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", bounds={"f": (0.05, 0.15)})
    assert found.estimate["friction"] == pytest.approx(0.15, rel=1e-3)
    assert any("friction is at its bound" in text for text in found.warnings)


def test_prior_makes_up_for_a_missing_number():
    found = fit_parameters(
        StandIn(), Datum(HardPeak(), 2.6, 0.02), "f,kn", priors={"kn": Prior(1.5e9, 0.1)}, jacobian="tangent"
    )
    assert found.estimate["normal_stiffness"] == pytest.approx(1.5e9, rel=0.02)
    assert found.prediction[0] == pytest.approx(2.6, abs=2e-3)


def test_a_failed_run_is_a_rejected_step():
    simulator = StandIn(broken=0.3)
    found = fit_parameters(
        simulator, measured(simulator, **TRUTH), "f,kn", start={"f": 0.02, "kn": 5e8}, jacobian="tangent"
    )
    assert found.estimate["friction"] == pytest.approx(0.21, rel=2e-3)
    # A start that fails moves towards the test's own parameters.
    found = fit_parameters(simulator, measured(simulator, **TRUTH), "f,kn", start={"f": 0.45, "kn": 1e9}, by_rule=False)
    assert found.failed_runs >= 1
    assert found.estimate["friction"] == pytest.approx(0.21, rel=2e-3)
    with pytest.raises(RunFailed, match="not even the test's own"):
        fit_parameters(StandIn(broken=0.01), measured(StandIn()), "f,kn")


def test_log_resumes_without_a_run(tmp_path):
    log, data = tmp_path / "log.jsonl", measured(StandIn(), **TRUTH)
    first = fit_parameters(StandIn(), data, "f,kn", log=log)
    lines = log.read_text().splitlines()
    assert len(lines) == 1 + first.cost.runs + first.cost.passes
    again = fit_parameters(StandIn(), data, "f,kn", log=log)
    assert again.cost.runs == again.cost.passes == 0
    assert again.estimate == first.estimate
    # Cut short in the middle of a line: what is left is used, the rest is run.
    log.write_text("\n".join(lines[:3]) + "\n" + lines[3][:40])
    resumed = fit_parameters(StandIn(), data, "f,kn", log=log)
    assert resumed.estimate == first.estimate
    assert 0 < resumed.cost.runs + resumed.cost.passes < first.cost.runs + first.cost.passes
    with pytest.raises(ValueError, match="belongs to another fit"):
        fit_parameters(StandIn(), measured(StandIn()), "f,kn", log=log)


def test_tangents_survive_scatter_that_spoils_differences():
    class Scatter(StandIn):
        """Scatter between runs that a tangent does not see, as from rounding in a chaotic run."""

        def simulate(self, params):
            import jax

            fixed = jax.lax.stop_gradient(params)
            rough, smooth = StandIn(noise=1e-3).simulate(fixed), StandIn().simulate(fixed)
            curve = StandIn().simulate(params)
            curve.stress_ratio = curve.stress_ratio + rough.stress_ratio - smooth.stress_ratio
            return curve

    data = measured(StandIn(), **TRUTH)
    bad = 0
    for k, friction in enumerate((0.05, 0.3)):
        start = {"f": friction, "kn": 1e9 * (1 + k)}
        found = fit_parameters(Scatter(), data, "f,kn", start=start, jacobian="tangent", max_runs=60)
        assert found.estimate["friction"] == pytest.approx(0.21, rel=1e-2)
        other = fit_parameters(Scatter(), data, "f,kn", start=start, jacobian="difference", max_runs=60)
        bad += abs(other.estimate["friction"] / 0.21 - 1) > 1e-2
    assert bad == 2


def test_multi_start_and_descent(tmp_path):
    data = measured(StandIn(), **TRUTH)
    bounds = {"f": (0.02, 0.5), "kn": (3e8, 9e9)}
    found = fit_parameters(StandIn(), data, "f,kn", start="test", bounds=bounds, starts=3, jacobian="tangent")
    assert found.estimate["friction"] == pytest.approx(0.21, rel=2e-3)
    assert found.cost.runs >= 3
    # A start that fails is passed over, each start is logged, and the log holds them all when it is named again.
    log, fragile = tmp_path / "log.jsonl", StandIn(broken=0.3)
    options = {"start": "test", "bounds": bounds, "starts": 5, "log": log}
    found = fit_parameters(fragile, measured(fragile, **TRUTH), "f,kn", **options)
    assert found.estimate["friction"] == pytest.approx(0.21, rel=2e-3)
    assert 0 < found.failed_runs < 5 <= len(found.evaluations)
    again = fit_parameters(fragile, measured(fragile, **TRUTH), "f,kn", **options)
    assert again.cost.forward_equivalents == 0
    assert again.estimate == found.estimate
    slow = fit_by_descent(StandIn(), data, "f,kn", bounds=bounds, steps=60)
    assert slow.estimate["friction"] == pytest.approx(0.21, rel=1e-2)
    assert slow.cost.passes > 10


def test_secant_takes_few_runs():
    found = fit_friction_to_peak(StandIn())
    rise = np.tanh(0.02 * 0.003 * 1.5e9 / 5e4)
    assert rise > 0.9
    assert found.converged
    assert found.cost.runs <= 4
    assert found.prediction[0] == pytest.approx(2.4, abs=1e-3)
    slope = float(found.jacobian[0, 0])
    # The datum's uncertainty, and 0.1 % of R for the simulator's own; a strain stretch does not move a flat top.
    friction, of_ratio = found.estimate["friction"], np.hypot(0.05, 1e-3 * found.prediction[0])
    assert found.standard_error["friction"] == pytest.approx(of_ratio / slope * friction * (1 - friction), rel=1e-6)
    low, high = found.interval["friction"]
    assert low < found.estimate["friction"] < high
    failing = fit_friction_to_peak(StandIn(broken=0.13), replace(ROWE.datum(), value=2.48))
    assert failing.prediction[0] == pytest.approx(2.48, abs=1e-3)


def test_result_is_drawn_and_saved(tmp_path):
    data = measured(StandIn(), noise=0.01, **TRUTH)
    found = fit_parameters(StandIn(), [data, Datum(HardPeak(), 2.9, 0.05)], "f,kn")
    assert found.draw(tmp_path / "fit.png").stat().st_size > 5000
    assert '"estimate"' in found.save(tmp_path / "fit.json").read_text()
    assert "friction = " in str(found)
    assert found.band.shape == found.observed.shape == (51,)


def test_file_to_answer(tmp_path):
    data = measured(StandIn(), noise=0.005, **TRUTH)
    rows = "\n".join(f"{100 * e:.6g},{r:.6g}" for e, r in zip(data.axial_strain, data.stress_ratio, strict=True))
    (tmp_path / "data.csv").write_text("axial_strain [%],stress_ratio\n" + rows)
    said = []
    found = calibrate_file(tmp_path / "data.csv", "friction,kn", StandIn(), tmp_path / "out", report=said.append)
    assert found.estimate["friction"] == pytest.approx(0.21, rel=0.02)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"fit.json", "fit.png", "evaluations.jsonl"}
    assert any("health: use" in text for text in said)


def test_import_is_light():
    code = (
        "import axijax, time, sys; t = time.perf_counter(); import calibrate; t = time.perf_counter() - t; "
        "assert t < 0.3, t; assert not {'scipy', 'optax', 'matplotlib'} & set(sys.modules) - before"
    ).replace("import axijax,", "import axijax; import sys; before = set(sys.modules); import")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_stiffness_is_recovered_where_the_material_has_no_friction():
    class Frictionless(StandIn):
        def simulate(self, params):
            assert params.friction is None
            return super().simulate(replace(params, friction=0.0))

    simulator = Frictionless(params=Params(friction=None))
    stiff = {"normal_stiffness": 2.4e9, "shear_stiffness": 2.4e9}
    for start in ("rule", "test"):
        found = fit_parameters(simulator, measured(simulator, **stiff), "kn", start=start)
        assert found.converged and found.estimate["normal_stiffness"] == pytest.approx(2.4e9, rel=5e-3)
    with pytest.raises(ValueError, match="parameter 'f': this test has no such number, so no data can tell it; it has"):
        fit_parameters(simulator, measured(simulator, **stiff), "f,kn")


def test_parameters_of_a_material_with_rolling_by_name():
    """Friction in logits between 0 and 1, rolling friction, which has no upper bound, in logs."""
    params = Params(friction=0.4, rolling=Rolling(rolling_friction=0.2))
    parameters = ParameterSet.of(params, "f,eta_r")
    assert parameters.names == ("friction", "rolling_friction")
    assert parameters.reference["rolling_friction"] == 0.2 and parameters.reference["friction"] == 0.4
    np.testing.assert_allclose(parameters.lower, [1e-3, 2e-4])
    np.testing.assert_allclose(parameters.upper, [0.999, 200.0])
    np.testing.assert_allclose(parameters.coordinates(), [np.log(0.4 / 0.6), np.log(0.2)], rtol=1e-12)
    z = parameters.coordinates({"eta_r": 0.1, "friction": 0.3})
    np.testing.assert_allclose(z, [np.log(0.3 / 0.7), np.log(0.1)], rtol=1e-12)
    for limit, physical in zip(parameters.limits(), (parameters.lower, parameters.upper), strict=True):
        np.testing.assert_allclose(limit, [np.log(physical[0] / (1 - physical[0])), np.log(physical[1])], rtol=1e-9)
    made = parameters.params(params, z)
    assert (float(made.friction), float(made.rolling_friction)) == pytest.approx((0.3, 0.1), rel=1e-12)
    assert replace(made, friction=0.4, rolling_friction=0.2) == params, "nothing else changes, the density neither"

    bounded = ParameterSet.of(params, "eta_r,f", {"eta_r": (0.05, 0.5), "f": (0.1, 0.6)})
    np.testing.assert_allclose(bounded.lower, [0.05, 0.1])
    np.testing.assert_allclose(bounded.upper, [0.5, 0.6])
    for names, bounds, words in (
        ("f,eta_r", {"eta_r": (0.0, 0.5)}, r"bounds of rolling_friction = \(0\.0, 0\.5\): .* 0 < lower < upper\."),
        ("f,eta_r", {"alpha_r": (0.1, 0.5)}, "bounds are given for 'rolling_stiffness', which is not fitted"),
        ("f,eta_tw", None, "parameter 'eta_tw': this test has no such number"),
        ("eta_r,rolling_friction", None, "'rolling_friction' is named twice"),
    ):
        with pytest.raises(ValueError, match=words):
            ParameterSet.of(params, names, bounds)
    with pytest.raises(ValueError, match="parameter 'eta_r': this test has no such number"):
        ParameterSet.of(Params(), "f,eta_r")
    smooth = replace(params, rolling_friction=0.0)
    with pytest.raises(ValueError, match=r"rolling_friction = 0 in this test, .*: give bounds"):
        ParameterSet.of(smooth, "f,eta_r")
    assert len(ParameterSet.of(smooth, "f,eta_r", {"eta_r": (0.05, 0.5)})) == 2


def test_what_has_no_range_of_its_own_is_fitted_within_bounds():
    """Gravity may be negative, a glued platen's friction is infinite: no factor of these is a range."""

    class Falling(StandIn):
        def simulate(self, params):
            curve = super().simulate(params)
            curve.stress_ratio = curve.stress_ratio - 0.02 * (params.gravity_z + 9.81)
            return curve

    simulator = Falling(params=Params(terms=(Gravity(),)))
    data = measured(simulator, gravity_z=-4.0)
    with pytest.raises(ValueError, match=r"gravity_z = -9\.81 in this test, .*: give bounds"):
        fit_parameters(simulator, data, "gravity_z")
    with pytest.raises(ValueError, match=r"platen_friction = inf in this test, .*: give bounds"):
        ParameterSet.of(Params(platen_friction=np.inf), "platen_friction")
    for start in ("rule", "test", {"gravity_z": 3.0}):
        found = fit_parameters(simulator, data, "gravity_z", bounds={"gravity_z": (-20.0, 5.0)}, start=start)
        assert found.estimate["gravity_z"] == pytest.approx(-4.0, abs=1e-3)


@pytest.mark.slow
def test_small_specimen_twin():
    test = TriaxialTest(fcc_octagon(layers=9, half_width=5), params=Params(platen_speed=0.02), axial_strain=0.0055)
    model = Model(test, ParameterSet.of(test.params, "f,kn", {"f": (0.01, 0.6), "kn": (2.5e8, 9e9)}))
    hidden = model.run(model.parameters.coordinates({"f": 0.2, "kn": 2.2e9}))
    strains = np.linspace(3e-4, 0.005, 60)
    data = MeasuredCurve(strains, np.interp(strains, hidden.axial_strain, hidden.stress_ratio))
    for start in ("rule", {"f": 0.45, "kn": 3e8}):
        found = fit_parameters(model, data, "f,kn", start=start)
        assert found.estimate["friction"] == pytest.approx(0.2, rel=1e-2)
        assert found.estimate["normal_stiffness"] == pytest.approx(2.2e9, rel=1e-2)
        assert found.cost.runs + 2 * found.cost.passes <= 8
