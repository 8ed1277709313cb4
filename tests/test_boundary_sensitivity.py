"""The boundary study's statistics, on runs made up so that every figure is known."""

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

import boundary_sensitivity as study
import boundary_statistics as statistics
from boundary_pictures import mean_profile

STRAIN = np.linspace(0, 0.15, 1501)
LEVELS = np.array([1.9, 2.05, 2.2, 2.0])


def run_of(level, peak_at=None):
    """A run at a constant ratio, or with a triangular peak of height 1 and half width 2 % above it."""
    ratio = np.full(STRAIN.size, level)
    if peak_at is not None:
        ratio += np.maximum(0, 1 - np.abs(STRAIN - peak_at) / 0.02)
    curve = dict.fromkeys(statistics.CURVES, ratio) | {"axial_strain": STRAIN, "volumetric_strain": -0.3 * STRAIN}
    solid = [0.0, 0.5, 0.6, 0.7]
    contacts = [0.0, 1.0, 2.0, 3.0]
    profile = {"edges": [0.0, 1.0, 2.0, 3.0, 4.0], "solid_fraction": solid, "contacts": contacts, "vertical": solid}
    return {
        "case": {"order": 4},
        "report": {"void_ratio": 0.6, "membrane_radius": 100.0},
        "mean_radius": 20.0,
        "curve": curve,
        "profiles": {"start axis": profile},
    }


def sample_of(runs, friction=0.3, order=4):
    sample = statistics.Sample(504, friction, "periodic", order, dict(enumerate(runs)))
    statistics.find_numbers(sample)
    return sample


def test_error_of_a_mean_is_the_standard_error():
    """For a figure that is linear in the curves the jackknife gives the standard error of the mean, exactly."""
    sample = sample_of([run_of(level) for level in LEVELS])
    error = LEVELS.std(ddof=1) / 2
    for name in ("early ratio", "critical ratio", "peak ratio", "mean of the runs' peaks"):
        assert sample.numbers[name] == pytest.approx(LEVELS.mean(), rel=1e-12)
        assert sample.error(name) == pytest.approx(error, rel=1e-9)
    assert sample.scatter() == pytest.approx(LEVELS.std(ddof=1), rel=1e-9)
    assert sample.numbers["dilatancy at peak"] == pytest.approx(0.3, rel=1e-9)
    assert sample.error("dilatancy at peak") == pytest.approx(0, abs=1e-9)
    assert sample.numbers["arc length [diameters]"] == pytest.approx(2 * np.pi * 100 / 4 / 40, rel=1e-12)


def test_peak_is_that_of_the_mean_curve():
    """Peaks at different strains: their own maxima stay, the mean curve has none of that height."""
    numbers = sample_of([run_of(2.0, at) for at in (0.03, 0.06, 0.09, 0.12)]).numbers
    own = 3 - np.abs(np.arange(-10, 11)).mean() * 5e-4 / 0.02  # a triangle averaged over +-0.5 % in steps of 0.05 %
    assert numbers["mean of the runs' peaks"] == pytest.approx(own, abs=1e-6)
    assert numbers["peak ratio"] == pytest.approx(2 + (own - 2) / 4, abs=1e-6)
    together = sample_of([run_of(2.0, 0.06)] * 3).numbers
    assert together["peak ratio"] == pytest.approx(own, abs=1e-6)
    assert together["strain at peak [%]"] == pytest.approx(6, abs=1e-6)
    assert np.isnan(sample_of([run_of(2.0)]).error("peak ratio"))


def test_change_from_the_full_cylinder_is_pooled_by_seed():
    """Seeds that shift the curves of all frictions together count once: more frictions bring no smaller error. It is
    that of a ratio of means, to first order in the scatter."""
    shifts = np.array([-0.02, 0.01, 0.03, -0.01])
    some, full = (
        [sample_of([run_of(level * (1 + s)) for s in shifts], friction, order) for friction, level in levels.items()]
        for order, levels in ((4, {0.1: 0.9 * 1.5, 0.3: 0.8 * 2.0}), (1, {0.1: 1.5, 0.3: 2.0}))
    )
    value, error = statistics.change(some, full, "early ratio")
    assert value == pytest.approx(-15, rel=1e-9)
    relative = shifts.std(ddof=1) / 2 / (1 + shifts.mean())
    assert error == pytest.approx(100 * 0.85 * relative * np.sqrt(2), rel=0.01)
    assert statistics.change(some[:1], full[:1], "early ratio")[1] == pytest.approx(error * 0.9 / 0.85, rel=1e-9)
    samples = {(s.size, s.friction, s.boundary, s.order): s for s in some + full}
    assert statistics.changes(samples, "early ratio") == {
        (504, "periodic", 4): (value, error, pytest.approx(np.pi * 5 / 4))
    }
    assert statistics.full_scatter(samples)[504] == pytest.approx(100 * relative * 2, rel=1e-9)


def test_changes_by_arc_are_weighted_means():
    """Two samples that agree, two that do not: then the error is what their spread says; rigid planes are left out."""
    found = {(504, "periodic", 2): (-1.0, 1.0, 9.0), (1008, "periodic", 2): (-0.5, 0.5, 12.0),
             (504, "periodic", 8): (0.0, 1.0, 2.0), (504, "periodic", 12): (-10.0, 1.0, 1.5),
             (504, "rigid", 4): (-10.0, 1.0, 9.0)}  # fmt: skip
    wide, narrow = statistics.by_arc(found)
    assert wide[:3] == (8.5, 20, 2) and narrow[:3] == (0, 2.8, 2)
    assert wide[3:5] == pytest.approx(((-1.0 - 0.5 * 4) / 5, 5**-0.5))
    assert narrow[3:] == pytest.approx((-5.0, 5.0, 50.0))


def test_the_narrowest_sector_is_the_last_before_one_that_differs():
    found = {("periodic", 2): (0.5, 9, 9), ("periodic", 3): (-0.9, 9, 9), ("periodic", 4): (1.1, 9, 9),
             ("periodic", 6): (0.1, 9, 9), ("rigid", 3): (5.0, 9, 9)}  # fmt: skip
    assert statistics.narrowest(found, 1.0) == 3
    assert statistics.narrowest(found, 2.0) == 6
    assert statistics.narrowest(found, 0.1) == 1


def test_densities_and_profiles_weigh_as_they_should():
    """Solid fractions by area of the rings; parts of the fabric by contacts, empty bins left out."""
    density = statistics.densities_of(run_of(2.0))
    assert density["solid fraction, inner half"] == pytest.approx((1 * 0 + 3 * 0.5) / 4)
    assert density["solid fraction, outer half"] == pytest.approx((5 * 0.6 + 7 * 0.7) / 12)
    one, two = run_of(2.0), run_of(2.0)
    two["profiles"] = {"start axis": one["profiles"]["start axis"] | {"vertical": [np.nan, 0.1, np.nan, 0.2],
                                                                     "contacts": [0.0, 3.0, 0.0, 1.0]}}  # fmt: skip
    at, vertical = mean_profile([one, two], "start axis", "vertical")
    assert at == pytest.approx(np.array([0.5, 1.5, 2.5, 3.5]) / 40)
    assert np.isnan(vertical[0])
    assert vertical[1:] == pytest.approx([(0.5 + 3 * 0.1) / 4, 0.6, (3 * 0.7 + 0.2) / 4])


def test_seeds_of_an_order_follow_each_other():
    """Whatever shares a compilation is run together, and every order divides its size."""
    asked = list(study.packings(Namespace(sizes=study.SIZES, orders=study.ORDERS, seeds=10)))
    assert all(size % order == 0 for size, order, *_ in asked)
    assert len(set(asked)) == len(asked) == 4 * (7 + 5) * 10
    assert [seed for *_, seed in asked] == 48 * list(range(10))
    assert len({case[:3] for case in asked[:10]}) == 1
