"""Curves that turn back: reading them, comparing them branch by branch, and a fit to a loop."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from axijax import Params, Sector, TriaxialTest, fcc_octagon, stage
from calibrate import DataError, InitialSlope, MeasuredCurve, Model, OnBranch, fit_parameters, read_measured
from calibrate.branches import TURN, first_reversals, reversals

UP, DOWN = 0.003, 0.0027  # where the strain turns


def way(*limits, points=50):
    """Strains from 0 to each limit in turn."""
    legs = [np.linspace(a, b, points + 1)[1:] for a, b in zip((0.0, *limits), limits, strict=False)]
    return np.concatenate([[0.0], *legs])


def loop(strain, over=0.0, stiffness=900.0):
    """R of a specimen that loads along a line, and unloads and reloads six times as steeply, from where it turns; and a
    volume that does not turn with it. over: how much farther than UP it goes before."""
    turn, low = UP + over, DOWN + over
    ratio, steep = np.empty(strain.size), 6 * stiffness
    branch = np.searchsorted(reversals(strain, 1e-5), np.arange(strain.size))
    top = 1 + stiffness * turn
    ratio = np.select(
        [branch == 0, branch == 1], [1 + stiffness * strain, top - steep * (turn - strain)],
        top - steep * (turn - low) + steep * (strain - low),
    )  # fmt: skip
    return ratio, 0.1 * strain


@pytest.mark.parametrize("seed", range(3))
def test_reversals_are_found_through_scatter(seed):
    """Those of the strain and no others, on the host and inside jit alike."""
    strain = way(0.003, 0.001, 0.004, 0.0035, 0.005, points=40)
    scatter = 0.3 * TURN * np.ptp(strain) * np.random.default_rng(seed).uniform(-1, 1, strain.size)
    found = reversals(strain + scatter, TURN * np.ptp(strain + scatter))
    assert np.abs(np.array(found) - [40, 80, 120, 160]).max() <= 1
    traced = jax.jit(partial(first_reversals, number=6))(strain + scatter)
    np.testing.assert_array_equal(traced, [*found, strain.size - 1, strain.size - 1])


@pytest.mark.parametrize("over", [0.0, 2e-5])
def test_branches_are_compared_from_their_own_reversals(over):
    """A run that turns a little late, at records of its own, gives the measured loop from where it turned."""
    strain = way(UP, DOWN, UP)
    data = MeasuredCurve(strain, loop(strain)[0], 0.1 * strain, unloading=True)
    run = way(UP + over, DOWN + over, UP + 2 * over, points=73)
    ratio, volume = loop(run, over)
    found = np.asarray(data.predict(SimpleNamespace(axial_strain=run, stress_ratio=ratio, volumetric_strain=volume)))
    raised = np.where(data.places.branch > 0, 900 * over, 0.0)
    np.testing.assert_allclose(found[: len(data)], data.stress_ratio + raised, atol=1e-9)
    np.testing.assert_allclose(found[len(data) :], 0.1 * (strain + np.where(raised > 0, over, 0)), atol=1e-12)


def test_what_a_run_does_not_reach_is_no_number():
    strain = way(UP, DOWN, UP)
    data = MeasuredCurve(strain, loop(strain)[0], unloading=True)
    short = way(UP, (UP + DOWN) / 2)
    found = np.asarray(data.predict(SimpleNamespace(axial_strain=short, stress_ratio=loop(short)[0])))
    assert np.isfinite(found[:75]).all() and np.isnan(found[-50:]).all()


def test_the_slope_of_an_unloading():
    strain = way(UP, DOWN, UP)
    curve = SimpleNamespace(axial_strain=strain, stress_ratio=loop(strain)[0])
    for branch, slope in ((0, 900.0), (1, -5400.0), (2, 5400.0)):
        assert OnBranch(InitialSlope(1e-5, 2.5e-4), branch)(curve) == pytest.approx(slope, rel=1e-6)
    assert "turns back 2 time(s)" in OnBranch(InitialSlope(1e-5, 2.5e-4), 3).trouble(curve)
    with pytest.raises(ValueError, match="branch = -1: must be a whole number"):
        OnBranch(InitialSlope(), -1)


def test_a_file_with_an_unloading_branch(tmp_path):
    """Refused unless it is said to turn back, for it may as well hold two tests."""
    strain = way(UP, DOWN, 1.2 * UP, points=20)
    rows = "\n".join(f"{100 * e:.5f},{r:.6f}" for e, r in zip(strain, loop(strain)[0], strict=True))
    file = tmp_path / "loop.csv"
    file.write_text(f"axial_strain [%],stress_ratio\n{rows}\n")
    with pytest.raises(DataError, match=r"falls back to .* or read them too \(unloading, --unloading\)"):
        read_measured(file)
    curve = read_measured(file, unloading=True)
    assert not curve.warnings and len(curve) == strain.size and curve.last_strain == pytest.approx(1.2 * UP)
    np.testing.assert_array_equal(np.bincount(curve.places.branch), [21, 20, 20])
    assert len(curve.advancing) == 21 + 14 and curve.advancing.places is None
    cycle, onward = curve.stages()
    assert (cycle.platens.first, cycle.platens.second) == (pytest.approx(UP), pytest.approx(DOWN))
    assert onward.platens.direction > 0 and onward.until.axial_strain == pytest.approx(1.2 * UP)
    (plain,) = replace(curve, axial_strain=strain[:21], stress_ratio=curve.stress_ratio[:21]).stages()
    assert plain.until.axial_strain == pytest.approx(UP)


# ---- A fit to a loop, on the lattice ----

TRUTH = {"normal_stiffness": 1.15e9, "shear_stiffness": 0.7e9}


@pytest.fixture(scope="module")
def looped():
    """A small lattice that turns at 0.08 and 0.03 %, with its measured loop at hidden stiffnesses."""
    params = Params(friction=0.25, platen_speed=0.01)
    stages = (stage("cycles", first=8e-4, second=3e-4), stage("compression", axial_strain=1e-3))
    specimen = fcc_octagon(layers=5, half_width=5)
    test = TriaxialTest(specimen, Sector(4), params=params, stages=stages, tolerance=1e-6, record_every=25)
    model = Model(test, "kn,ks/kn")
    curve = model.run(model.parameters.coordinates({"kn": TRUTH["normal_stiffness"], "ks/kn": 0.7 / 1.15}))
    path = np.concatenate([[0.0], np.abs(np.diff(curve.axial_strain)).cumsum()])
    turns = path[reversals(curve.axial_strain, 1e-5)]  # which a laboratory records too
    at = np.sort(np.concatenate([np.linspace(2e-5, path[-1] * 0.999, 60), turns]))
    strain, ratio = (np.interp(at, path, values) for values in (curve.axial_strain, curve.stress_ratio))
    return model, MeasuredCurve(strain, ratio, unloading=True)


def test_hidden_stiffnesses_come_back_from_a_loop(looped):
    model, data = looped
    assert data.places.branch.max() == 2
    found = fit_parameters(model, data, "kn,ks/kn", start="test")
    assert found.converged, found.status
    assert found.estimate["normal_stiffness"] == pytest.approx(TRUTH["normal_stiffness"], rel=5e-3)
    assert found.estimate["stiffness_ratio"] == pytest.approx(0.7 / 1.15, rel=2e-2)


def test_a_loop_needs_a_test_that_turns(looped):
    model, data = looped
    with pytest.raises(ValueError, match=r"turns back at strain 0\.000(8|7999), but the test has no stages"):
        fit_parameters(replace(model.simulator, stages=()), data, "kn")
