"""Studies on a formula with scatter: hidden truths, predictions that come true, verdicts that name what is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest
from random_standin import StandInTest, mean_curve, scene, stand_in

from calibrate.measured import DataError, MeasuredCurve
from calibrate.output import claim
from calibrate.parameters import Prior
from calibrate.study import LABORATORY, StudyTest, fit_study, identity

STRAIN = 2e-4 + (0.099 - 2e-4) * np.linspace(0, 1, 120) ** 1.5
BOUNDS = {"friction": (0.15, 0.8), "kn": (5e8, 5e9)}


def truth(packings=1, seed=5000, stress=5e4, noise=0.01, **values):
    """Data of packings that no fit has, or of none at all: the mean curve, as a laboratory's test would be."""
    world = scene(confining_stress=stress)
    params = replace(world.params, **values)
    if packings == LABORATORY:
        ratio, volume = mean_curve(params, STRAIN)
        ratio, void_ratio = np.exp(ratio), 0.6
    else:
        curves = [stand_in(seed + k, params).run().curve for k in range(packings)]
        ratio, volume = (
            np.mean([np.interp(STRAIN, c.axial_strain, getattr(c, name)) for c in curves], axis=0)
            for name in ("stress_ratio", "volumetric_strain")
        )
        void_ratio = float(np.mean([c.void_ratio[0] for c in curves]))
    rng = np.random.default_rng(seed)
    ratio = ratio * (1 + noise * rng.standard_normal(STRAIN.size))
    volume = volume + noise * np.abs(volume).max() * rng.standard_normal(STRAIN.size)
    return MeasuredCurve(STRAIN, ratio, volume), void_ratio


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return tmp_path_factory.mktemp("library")


@pytest.fixture(scope="module")
def study(library):
    """Fitted at two stresses, predicted at a third."""
    values = {"friction": 0.45, "normal_stiffness": 1.5e9, "shear_stiffness": 1.5e9}
    tests = []
    for number, stress in enumerate((5e4, 1e5, 7e4)):
        curve, void_ratio = truth(LABORATORY, seed=number, stress=stress, **values)
        tests.append(
            StudyTest(f"{stress:g}", curve, scene(), stress, LABORATORY, void_ratio, held_out=number == 2)
        )  # fmt: skip
    lines = []
    return fit_study(tests, "friction,kn", bounds=BOUNDS, library=library, workers=1, report=lines.append), lines


def test_a_study_finds_the_truth_within_its_intervals(study):
    fit, lines = study
    for name, true in (("friction", 0.45), ("normal_stiffness", 1.5e9)):
        low, middle, high = fit.intervals[name]
        assert low < true < high and abs(middle / true - 1) < 0.15, (name, low, middle, high)
    assert fit.runs <= 40 and fit.made == fit.runs and fit.effective > 200
    assert any("after" in line for line in lines)


def test_the_held_out_test_is_predicted(study):
    fit, _ = study
    held = fit.predictions[2]
    assert held.held_out and held.inside > 0.85 and held.ratio_rms < 0.05
    width = np.log(held.ratio_band[2] / held.ratio_band[0]).mean()
    assert 0.01 < width < 0.3
    assert held.peak[0] <= held.peak[1] <= held.peak[2]


def test_results_are_written_whole_and_read_back(study, tmp_path):
    fit, _ = study
    told = json.loads(fit.save(tmp_path / "fit.json").read_text())
    assert told["status"] == fit.status and told["tests"][2]["held_out"] and told["pareto_k"] < 0.7
    table = np.loadtxt(fit.save_samples(tmp_path / "samples.csv"), delimiter=",", skiprows=1)
    assert np.quantile(table[:, 0], 0.5) == pytest.approx(fit.intervals["friction"][1], rel=0.05)
    assert fit.draw(tmp_path / "fit.png").stat().st_size > 10_000
    assert "with 95 % between" in str(fit) and "standard error" not in str(fit)


def test_the_next_data_set_begins_with_the_library(study, library):
    """Another truth, at another stress: ten runs at most."""
    curve, void_ratio = truth(8, seed=900, stress=1.5e5, friction=0.6, normal_stiffness=3e9, shear_stiffness=3e9)
    fit = fit_study(
        [StudyTest("other", curve, scene(), 1.5e5, 8, void_ratio)], "friction,kn",
        bounds={"friction": (0.15, 0.8), "kn": (1.5e9, 1.5e10)}, library=library, workers=1,
    )  # fmt: skip
    assert fit.made <= 10
    low, _, high = fit.intervals["friction"]
    assert low < 0.6 < high


def test_scatter_of_the_data_widens_the_answer_and_is_said(study, library):
    """The same curve as one packing's and as a laboratory's: packings are what is left of the uncertainty."""
    curve, void_ratio = truth(1, seed=77, friction=0.4)
    options = {"bounds": BOUNDS, "library": library, "workers": 1, "further": 0}
    one = fit_study([StudyTest("a", curve, scene(), None, 1, void_ratio)], "friction,kn", **options)
    eight = fit_study([StudyTest("a", curve, scene(), None, 8, void_ratio)], "friction,kn", **options)
    assert one.precisions["friction"].now > 1.3 * eight.precisions["friction"].now
    assert one.precisions["friction"].scatter > 0.7 * one.precisions["friction"].now
    assert "scatter of the data's 1 packing(s) alone leaves" in str(one)
    wanted = one.precisions["friction"].packings_for(0.5 * one.precisions["friction"].now)
    assert wanted is None or 3 < wanted < 60
    low, _, high = one.intervals["friction"]
    assert low < 0.4 < high


def test_a_precision_that_scatter_forbids(study, library):
    curve, void_ratio = truth(1, seed=78, friction=0.4)
    fit = fit_study([StudyTest("a", curve, scene(), None, 1, void_ratio)], "friction,kn", bounds=BOUNDS,
                    library=library, workers=1, further=0, precision=0.01)  # fmt: skip
    assert "scatter too large for friction" in fit.status and not fit.converged


def test_data_out_of_reach_are_named_with_their_miss(study, library):
    curve, void_ratio = truth(LABORATORY, friction=0.45)
    bent = MeasuredCurve(STRAIN, curve.stress_ratio * (1 + 3 * STRAIN), -3 * curve.volumetric_strain)
    fit = fit_study([StudyTest("bent", bent, scene(), None, LABORATORY, void_ratio)], "friction,kn", bounds=BOUNDS,
                    library=library, workers=1, further=0)  # fmt: skip
    assert "the model cannot reach these data" in fit.status
    (sentence,) = [each.sentence for each in fit.verdicts if each.name == "out of reach"]
    assert "'bent' is out of reach: the nearest curves miss R by" in sentence
    assert f"volumetric strain by {100 * fit.predictions[0].volume_rms:.2g} % of strain" in sentence


def test_what_the_data_do_not_hold_is_not_identified(tmp_path):
    """Data from 3 % strain on, where the formula no longer knows the stiffness."""
    curve, void_ratio = truth(LABORATORY, friction=0.45, normal_stiffness=3e9, shear_stiffness=3e9)
    late = STRAIN > 0.03
    curve = MeasuredCurve(STRAIN[late], curve.stress_ratio[late], curve.volumetric_strain[late])
    fit = fit_study([StudyTest("late", curve, scene(), None, LABORATORY, void_ratio)], "friction,ks/kn",
                    bounds={"friction": (0.15, 0.8)}, library=tmp_path, workers=1, runs=24)  # fmt: skip
    (verdict,) = [each for each in fit.verdicts if each.name == "not identified"]
    low, _, high = fit.intervals["stiffness_ratio"]
    assert verdict.words == f"not identified: stiffness_ratio, the data allow {low:.2g} to {high:.2g}"
    assert low < 1.0 < high and fit.intervals["friction"][0] < 0.45 < fit.intervals["friction"][2]
    assert fit.directions[0]["parts"]["stiffness_ratio"] ** 2 > 0.9


def test_a_prior_narrows_and_is_said_where_contradicted(study, library):
    curve, void_ratio = truth(8, seed=300, friction=0.5)
    test = StudyTest("a", curve, scene(), None, 8, void_ratio)
    options = {"bounds": BOUNDS, "library": library, "workers": 1, "further": 0}
    fit = fit_study([test], "friction,kn", priors={"f": Prior(0.2, 0.05)}, **options)
    assert any("the data contradict the prior of friction" in note for note in fit.notes) or (
        fit.intervals["friction"][2] < 0.35
    )
    narrow = fit_study([test], "friction,kn", priors={"kn": Prior(1.5e9, 0.02)}, **options)
    assert narrow.precisions["normal_stiffness"].now < 0.025


def test_a_killed_study_goes_on_where_it_was(tmp_path):
    curve, void_ratio = truth(8, seed=400, friction=0.5)
    tests, options = [StudyTest("a", curve, scene(), None, 8, void_ratio)], {"bounds": BOUNDS, "library": tmp_path}

    class KilledError(BaseException):
        pass

    def kill(done, wanted, run):
        if done == 9:
            raise KilledError

    with pytest.raises(KilledError):
        fit_study(tests, "friction,kn", workers=1, runs=20, progress=kill, **options)
    gone_on = fit_study(tests, "friction,kn", workers=1, runs=20, **options)
    assert gone_on.made == 20 - 9 and gone_on.runs == 20
    whole = fit_study(tests, "friction,kn", workers=1, runs=20, bounds=BOUNDS, library=tmp_path / "other")
    assert gone_on.intervals == whole.intervals


def test_too_few_runs_are_refused_before_the_first(tmp_path):
    curve, void_ratio = truth(8, seed=400, friction=0.5)
    tests, made = [StudyTest("a", curve, scene(), None, 8, void_ratio)], []
    with pytest.raises(ValueError, match="runs = 16: a surface in 2 parameters needs at least 17 of one scene, of "
                                         "which the library holds 0: allow more"):  # fmt: skip
        fit_study(tests, "friction,kn", workers=1, runs=16, bounds=BOUNDS, library=tmp_path,
                  progress=lambda *run: made.append(run))  # fmt: skip
    assert not made


def test_failed_runs_are_counted_and_said(tmp_path):
    """Bounds of friction that reach where the formula fails."""
    curve, void_ratio = truth(8, seed=500, friction=0.5)
    fit = fit_study([StudyTest("a", curve, scene(), None, 8, void_ratio)], "friction,kn", workers=1, library=tmp_path,
                    bounds={"friction": (0.15, 1.5), "kn": (5e8, 5e9)}, runs=24)  # fmt: skip
    assert fit.failed and f"{len(fit.failed)} runs failed and are left out" in str(fit)
    low, _, high = fit.intervals["friction"]
    assert low < 0.5 < high


def test_own_parameters_of_each_test(library, study):
    tests = []
    for number, friction in enumerate((0.3, 0.6)):
        curve, void_ratio = truth(8, seed=600 + 10 * number, friction=friction)
        tests.append(StudyTest(f"sand {number}", curve, scene(), None, 8, void_ratio))
    fit = fit_study(tests, "friction,kn", own="friction", bounds=BOUNDS, library=library, workers=1, further=0)
    assert set(fit.intervals) == {"normal_stiffness", "friction of sand 0", "friction of sand 1"}
    assert fit.intervals["friction of sand 0"][2] < fit.intervals["friction of sand 1"][0]


def test_senseless_studies_are_refused_before_any_run(tmp_path):
    curve, _ = truth()
    test = StudyTest("a", curve, scene())
    for words, given, names in (
        ("at least one test that is not held out", [replace(test, held_out=True)], "friction"),
        ("each needs a name of its own", [test, test], "friction"),
        ("'density' cannot be fitted", [test], "friction,density"),
        ("both named", [test], "ks,ks/kn"),
    ):
        with pytest.raises(ValueError, match=words):
            fit_study(given, names, library=tmp_path)
    with pytest.raises(ValueError, match="lower < upper"):
        fit_study([test], "friction", bounds={"friction": (0.5, 0.2)}, library=tmp_path)
    short = MeasuredCurve([0.001, 0.02], [1.5, 2.5])
    with pytest.raises(DataError, match="2 points are too few"):
        fit_study([replace(test, curve=short)], "friction", library=tmp_path)
    with pytest.raises(ValueError, match=r"packings = 0\.5"):
        StudyTest("a", curve, scene(), packings=0.5)
    assert not list(tmp_path.glob("*/run-*"))


def test_a_fit_replaces_its_own_result_alone(tmp_path):
    curve, _ = truth()
    mine = identity([StudyTest("a", curve, scene())], "friction", {})
    assert not claim(tmp_path, mine)
    (tmp_path / "fit.json").write_text('{"mine": 1}')
    with pytest.raises(ValueError, match="is no file of a fit and would be replaced"):
        claim(tmp_path, mine)
    (tmp_path / "fit.json").write_text(json.dumps({"status": "converged", "estimate": {}, "identity": mine}))
    assert claim(tmp_path, mine)
    other = identity([StudyTest("a", curve, scene())], "friction,kn", {})
    with pytest.raises(ValueError, match="is of another fit, which differs in "):
        claim(tmp_path, other)
    with pytest.raises(ValueError, match="is of another kind of fit"):
        claim(tmp_path)


def test_the_stand_in_scatters_as_it_says():
    """Without which the coverage above would mean nothing: the spread of log R between packings at 5 % strain."""
    world = scene()
    found = [np.log(np.interp(0.05, (c := stand_in(k, world.params).run().curve).axial_strain, c.stress_ratio))
             for k in range(300)]  # fmt: skip
    without = StandInTest(world.params, 0, 0.0).run().curve
    assert np.std(found) == pytest.approx(0.036, rel=0.25) and np.isfinite(without.stress_ratio).all()
