"""The boundary study's statistics, on runs made up so that every figure is known."""

import sys
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "examples"))

import boundary_sensitivity as study

STRAIN = np.linspace(0, 0.15, 1501)
LEVELS = np.array([1.9, 2.05, 2.2, 2.0])


def run_of(level, peak_at=None):
    """A run at a constant ratio, or with a triangular peak of height 1 and half width 2 % above it."""
    ratio = np.full(STRAIN.size, level)
    if peak_at is not None:
        ratio += np.maximum(0, 1 - np.abs(STRAIN - peak_at) / 0.02)
    curve = dict.fromkeys(study.CURVES, ratio) | {"axial_strain": STRAIN, "volumetric_strain": -0.3 * STRAIN}
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


def test_error_of_a_mean_is_the_standard_error():
    """For a figure that is linear in the curves the jackknife gives the standard error of the mean, exactly."""
    row = study.with_errors([run_of(level) for level in LEVELS])
    error = LEVELS.std(ddof=1) / 2
    for field in ("early ratio", "critical ratio", "peak ratio", "mean of the runs' peaks"):
        assert row[field] == pytest.approx(LEVELS.mean(), rel=1e-12)
        assert row[field + " +-"] == pytest.approx(error, rel=1e-9)
    assert row["scatter of a run's early ratio"] == pytest.approx(LEVELS.std(ddof=1), rel=1e-9)
    assert row["scatter of a run at peak"] == pytest.approx(LEVELS.std(ddof=1), rel=1e-9)
    assert row["dilatancy at peak"] == pytest.approx(0.3, rel=1e-9)
    assert row["dilatancy at peak +-"] == pytest.approx(0, abs=1e-9)
    assert row["arc length [diameters]"] == pytest.approx(2 * np.pi * 100 / 4 / 40, rel=1e-12)


def test_peak_is_that_of_the_mean_curve():
    """Peaks at different strains: their own maxima stay, the mean curve has none of that height."""
    row = study.with_errors([run_of(2.0, at) for at in (0.03, 0.06, 0.09, 0.12)])
    own = 3 - np.abs(np.arange(-10, 11)).mean() * 5e-4 / 0.02  # a triangle averaged over +-0.5 % in steps of 0.05 %
    assert row["mean of the runs' peaks"] == pytest.approx(own, abs=1e-6)
    assert row["peak ratio"] == pytest.approx(2 + (own - 2) / 4, abs=1e-6)
    together = study.with_errors([run_of(2.0, 0.06)] * 3)
    assert together["peak ratio"] == pytest.approx(own, abs=1e-6)
    assert together["strain at peak [%]"] == pytest.approx(6, abs=1e-6)
    assert np.isnan(study.with_errors([run_of(2.0)])["peak ratio +-"])


def test_densities_and_profiles_weigh_as_they_should():
    """Solid fractions by area of the rings; parts of the fabric by contacts, empty bins left out."""
    density = study.densities_of(run_of(2.0))
    assert density["solid fraction, inner half"] == pytest.approx((1 * 0 + 3 * 0.5) / 4)
    assert density["solid fraction, outer half"] == pytest.approx((5 * 0.6 + 7 * 0.7) / 12)
    one, two = run_of(2.0), run_of(2.0)
    two["profiles"] = {"start axis": one["profiles"]["start axis"] | {"vertical": [np.nan, 0.1, np.nan, 0.2],
                                                                     "contacts": [0.0, 3.0, 0.0, 1.0]}}  # fmt: skip
    at, vertical = study.mean_profile([one, two], "start axis", "vertical")
    assert at == pytest.approx(np.array([0.5, 1.5, 2.5, 3.5]) / 40)
    assert np.isnan(vertical[0])
    assert vertical[1:] == pytest.approx([(0.5 + 3 * 0.1) / 4, 0.6, (3 * 0.7 + 0.2) / 4])


def test_seeds_of_an_order_follow_each_other():
    """Whatever shares a compilation is run together, and every order divides its size."""
    asked = Namespace(sizes=None, orders=None, frictions=None, seeds=10)
    first = list(study.cases(asked))[:90]
    assert all(size % order == 0 for size, order, *_ in study.cases(asked))
    assert [seed for *_, seed in first] == 9 * list(range(10))
    assert len({case[:4] for case in first}) == 9
    few = Namespace(sizes=[504], orders=[1, 4], frictions=[0.1, 0.3], seeds=2)
    assert len(list(study.cases(few))) == (2 + 1) * 2 * 2
