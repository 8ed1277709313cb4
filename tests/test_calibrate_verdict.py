"""A fit says "converged" only where nothing speaks against it; doubts are warnings, and the best point comes back."""

import json
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from calibrate_standin import StandIn, measured
from cli_in_process import axijax, write

from axijax.core.status import ESCAPED, NOT_FINITE, REMEDIES, STALE_CELLS, STALE_LIST, UNSTABLE, described
from calibrate.descent import fit_by_descent
from calibrate.file import calibrate_file
from calibrate.fit import fit_parameters
from calibrate.measured import MeasuredCurve
from calibrate.model import Model, RunFailed
from calibrate.secant import fit_friction_to_peak, fit_one
from calibrate.targets import Datum, HardPeak, SmoothPeak, StrainAtPeak, WindowMean

TRUTH = {"friction": 0.21, "normal_stiffness": 2.4e9, "shear_stiffness": 2.4e9}


def not_converged(found, *words: str, tmp_path=None) -> str:
    """Asserts that a fit says so everywhere: status, standard errors, text and file. Returns its warnings."""
    assert not found.converged and found.status != "converged" and not str(found).startswith("fit converged")
    assert all(word in found.status for word in words), found.status
    assert np.isnan(list(found.standard_error.values())).all() and np.isnan(found.band).all()
    assert "+-" not in str(found) and "no standard error: the fit has not converged" in str(found)
    if tmp_path is not None:
        told = strict_json(found.save(tmp_path / "fit.json"))
        assert told["status"] == found.status and told["warnings"] == list(found.warnings) != []
        assert set(told["standard_error"].values()) == {None}
        assert found.draw(tmp_path / "fit.png").stat().st_size > 5000
    return " ".join(found.warnings)


def strict_json(path):
    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def misfits(found) -> list[float]:
    """Of every sound evaluation."""
    sound = [tried for tried in found.evaluations if not tried.failed]
    return [float((((tried.prediction - found.observed) / found.sigma) ** 2).sum()) for tried in sound]


def assert_best_is_returned(found):
    assert (((found.prediction - found.observed) / found.sigma) ** 2).sum() == min(misfits(found))


@dataclass
class Runaway(StandIn):
    """Sound curves with tangents that have run away, as of a long run of a chaotic system."""

    size: float = 1e12

    def simulate(self, params):
        curve = super().simulate(params)
        curve.stress_ratio = curve.stress_ratio + self.size * (params.friction - jax.lax.stop_gradient(params.friction))
        return curve


@pytest.mark.parametrize("jacobian", ["economical", "tangent"])
def test_tangents_that_ran_away(jacobian, tmp_path):
    """The fit that ended with 0.401693 +- 3.5e-24 for 0.55."""
    data = measured(StandIn(), friction=0.55)
    found = fit_parameters(Runaway(), data, "f", start={"f": 0.4}, jacobian=jacobian, by_rule=False)
    said = not_converged(found, "the tangents ran away", tmp_path=tmp_path)
    assert "|dR/d log p| = 2.4e+11; above 1000 they say nothing" in said  # 1e12 f (1 - f) at the start
    assert any("step was taken" in note and "friction = 0.4" in note for note in found.notes)
    assert "step was taken" in str(found)
    assert_best_is_returned(found)


def test_tangents_just_below_the_limit_are_no_doubt():
    data = measured(StandIn(), friction=0.21)
    start = {"f": 0.21}
    assert fit_parameters(Runaway(size=5e3), data, "f", start=start, by_rule=False).converged  # 5e3 f (1 - f) = 830
    assert not fit_parameters(Runaway(size=7e3), data, "f", start=start, by_rule=False).converged


def test_failed_runs_on_the_way(tmp_path):
    simulator = StandIn(broken=0.3)
    found = fit_parameters(simulator, measured(simulator, **TRUTH), "f,kn", start={"f": 0.45, "kn": 1e9}, by_rule=False)
    said = not_converged(found, "runs failed", tmp_path=tmp_path)
    assert (
        f"{found.failed_runs} of {len(found.evaluations)} runs failed on the way, the first at friction = 0.45" in said
    )
    assert "the run is unstable; lower time_step" in said


def test_failed_starts():
    simulator = StandIn(broken=0.3)
    found = fit_parameters(
        simulator, measured(simulator, **TRUTH), "f,kn", start="test", starts=12,
        bounds={"f": (0.02, 0.5), "kn": (3e8, 9e9)},
    )  # fmt: skip
    not_converged(found, "runs failed")
    assert_best_is_returned(found)


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda data: replace(data, stress_ratio=100 * data.stress_ratio),  # 1000 times is refused
        lambda data: replace(data, axial_strain=data.axial_strain / 20),
        lambda data: replace(data, stress_ratio=data.stress_ratio[::-1] + 2),
        lambda data: replace(data, stress_ratio=100 * data.stress_ratio, sigma_known=True),
    ],
)
def test_a_misfit_far_beyond_the_uncertainty(spoilt, tmp_path):
    found = fit_parameters(StandIn(), spoilt(measured(StandIn(), **TRUTH)), "f")
    assert "times the stated uncertainty (more than 5 is no fit)" in not_converged(found, tmp_path=tmp_path)
    assert found.scatter > 20 and f"{found.scatter:.3g} times" in " ".join(found.warnings)
    assert_best_is_returned(found)


def test_a_misfit_of_the_uncertainty_is_none():
    found = fit_parameters(StandIn(), measured(StandIn(), noise=0.01, **TRUTH), "f,kn")
    assert found.converged and not found.warnings and 0.5 < found.scatter < 2
    assert all(np.isfinite(list(found.standard_error.values())))


@pytest.mark.parametrize("fit", ["fit_parameters", "fit_one", "fit_by_descent"])
def test_a_parameter_at_its_bound(fit, tmp_path):
    datum, bounds = Datum(HardPeak(), 2.9, 0.05), {"f": (0.05, 0.15)}
    if fit == "fit_by_descent":
        found = fit_by_descent(StandIn(), datum, "f", bounds=bounds)
    else:
        found = {"fit_parameters": fit_parameters, "fit_one": fit_one}[fit](StandIn(), datum, "friction", bounds=bounds)
    assert found.estimate["friction"] == pytest.approx(0.15, rel=0.02)
    if fit != "fit_by_descent":
        assert "friction is at its bound" in not_converged(found, tmp_path=tmp_path)
    assert not found.converged


PEAKS = [
    Datum(HardPeak(), 2.4, 0.05),
    Datum(SmoothPeak(), 2.4, 0.05),
    Datum(StrainAtPeak(temperature=0.3), 0.0015, 1e-4),
]


@pytest.mark.parametrize("datum", PEAKS, ids=lambda datum: datum.label)
def test_a_run_that_stops_before_its_peak(datum, tmp_path):
    """The friction of 0.166 for Rowe's peak: a run of 0.2 % strain only rises."""
    short = StandIn(axial_strain=0.002)
    if not isinstance(datum.functional, StrainAtPeak):
        found = fit_one(short, datum)
        said = not_converged(found, "the run does not reach '", tmp_path=tmp_path)
        assert "is at its end (strain 0.002 of 0.002): the curve still rises, and that is no peak" in said
        assert "larger axial_strain" in said
    assert not fit_parameters(short, datum, "f", start="test").converged
    assert not fit_by_descent(short, datum, "f").converged


def test_rowes_peak_of_a_run_that_passes_it():
    assert fit_friction_to_peak(StandIn(axial_strain=0.01)).converged
    assert not fit_friction_to_peak(StandIn(axial_strain=0.002)).converged
    assert fit_one(StandIn(axial_strain=0.002), Datum(WindowMean(0.001, 0.002), 2.2, 0.05)).converged  # claims no peak


@pytest.mark.parametrize("kind", [HardPeak, SmoothPeak, StrainAtPeak])
@pytest.mark.parametrize(("top", "passed"), [(0.5, True), (0.9, True), (0.96, False), (1.0, False), (1.5, False)])
def test_what_a_peak_is(kind, top, passed):
    strain = np.linspace(0, 0.01, 201)
    curve = StandIn().simulate(StandIn().params)
    curve.axial_strain, curve.stress_ratio = strain, 2 - (strain / 0.01 - top) ** 2
    assert (kind().trouble(curve) is None) is passed


def test_the_best_point_is_returned_where_runs_scatter():
    rough = StandIn(noise=0.02)
    for fit, options in (
        (fit_parameters, {"jacobian": "difference"}),
        (fit_parameters, {}),
        (fit_by_descent, {"steps": 8}),
    ):
        found = fit(rough, measured(StandIn(), **TRUTH), "f,kn", start={"f": 0.1, "kn": 1e9}, **options)
        assert_best_is_returned(found)
    assert_best_is_returned(fit_one(rough, Datum(HardPeak(), 2.4, 0.001)))


def test_the_best_point_is_returned_where_the_runs_are_spent():
    found = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", start={"f": 0.45, "kn": 4e8}, max_runs=2)
    not_converged(found, "stopped: 2 runs are spent")
    assert_best_is_returned(found)


def test_where_no_step_was_taken_it_says_so():
    data = measured(StandIn(), noise=0.01, friction=0.21)
    found = fit_parameters(StandIn(), data, "f", by_rule=False)
    again = fit_parameters(StandIn(), data, "f", start=found.estimate, by_rule=False)
    assert again.converged and again.notes[0].startswith(
        f"no step was taken: the answer is the start, friction = {0.21:.2f}"[:60]
    )
    assert not any("step was taken" in note for note in found.notes)


def test_a_standard_error_holds_the_simulators_own_accuracy():
    """Data that the program made itself: 0.1 % of R is left, by the closed form of the peak, R = 2 (1 + f)/(1 - f)."""
    exact = measured(StandIn(), np.linspace(6e-3, 9.5e-3, 50), friction=0.21)
    found = fit_parameters(StandIn(), exact, "f", start={"f": 0.21}, by_rule=False)
    ratio, slope = 0.97 * 2 * 1.21 / 0.79, 0.97 * 4 / 0.79**2
    assert found.converged and found.standard_error["friction"] == pytest.approx(1e-3 * ratio / slope, rel=0.05)


def test_no_standard_error_where_there_is_none():
    plateau = Datum(WindowMean(0.008, 0.009), 2.5, 0.05)
    found = fit_one(StandIn(), plateau, "kn", start=6e9)
    assert "+-" not in str(found)


@pytest.mark.parametrize("bit", REMEDIES)
def test_a_status_is_told_as_a_sentence(bit):
    @dataclass
    class Ended(StandIn):
        status: int = 0

        def simulate(self, params):
            curve = super().simulate(params)
            curve.status = jnp.asarray(self.status)
            return curve

    model = Model(Ended(status=bit), "f")
    with pytest.raises(RunFailed) as error:
        model.run(model.parameters.coordinates())
    assert str(error.value) == f"the run went wrong: {REMEDIES[bit]}"


def test_several_bits_and_unknown_ones():
    assert described(0) == ""
    assert described(29) == REMEDIES[NOT_FINITE]  # of which the others are consequences
    assert described(284) == "; ".join(REMEDIES[bit] for bit in (STALE_LIST, STALE_CELLS, 256, ESCAPED))
    assert described(UNSTABLE | 4096).endswith("status 4096") and described(4096).endswith("know, status 4096")


def test_warnings_reach_the_terminal_and_the_file(tmp_path):
    data = measured(StandIn(), **TRUTH)
    rows = "".join(f"{e:.9g},{100 * r:.9g}\n" for e, r in zip(data.axial_strain, data.stress_ratio, strict=True))
    (tmp_path / "data.csv").write_text("axial_strain,stress_ratio\n" + rows)
    lines: list[str] = []
    found = calibrate_file(tmp_path / "data.csv", "f", StandIn(), tmp_path, check=False, report=lines.append)
    said, told = "\n".join(lines), strict_json(tmp_path / "fit.json")
    assert not found.converged and not told["status"].startswith("converged")
    assert all(warning in said for warning in told["warnings"]) and "no fit" in said


def test_a_gradient_that_falls_back_takes_the_word_converged(tmp_path):
    class Wrong(StandIn):
        """Tangents of a tenth, which the runs do not show."""

        def simulate(self, params):
            friction = 0.9 * jax.lax.stop_gradient(params.friction) + 0.1 * params.friction
            return super().simulate(replace(params, friction=friction))

    data = measured(StandIn(), noise=0.01, friction=0.21)
    rows = "".join(f"{e:.9g},{r:.9g}\n" for e, r in zip(data.axial_strain, data.stress_ratio, strict=True))
    (tmp_path / "data.csv").write_text("axial_strain,stress_ratio\n" + rows)
    lines: list[str] = []
    found = calibrate_file(tmp_path / "data.csv", "f", Wrong(), tmp_path, report=lines.append)
    not_converged(found, "the tangents disagree with differences of the runs")
    assert strict_json(tmp_path / "fit.json")["status"] == found.status and f"fit {found.status}" in lines


@pytest.mark.parametrize("converged", [True, False])
def test_the_exit_code_tells(converged, tmp_path, monkeypatch):
    class Found:
        pass

    Found.converged = converged
    monkeypatch.setattr("calibrate.calibrate_file", lambda *_, **__: Found, raising=False)
    (tmp_path / "d.csv").write_text("axial_strain,stress_ratio\n0,1\n0.001,1.5\n0.002,2\n")
    called = axijax("calibrate", tmp_path / "d.csv", "--case", write(tmp_path / "a.toml"), "--output", tmp_path / "out")
    assert called.code == (0 if converged else 1)


def test_a_measured_curve_that_still_rises_is_warned_of():
    strains = np.linspace(2e-4, 8e-4, 10)
    found = fit_parameters(StandIn(), measured(StandIn(), strains, friction=0.2), "f")
    assert any("still rise at the last point" in text for text in found.warnings)
    whole = MeasuredCurve([0.001, 0.002, 0.003], [2.0, 2.4, 2.3])
    assert not any("still rise" in text for text in fit_parameters(StandIn(), whole, "f").warnings)
