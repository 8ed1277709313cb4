"""Samples of distributions whose moments and evidence are known in closed form."""

import numpy as np
import pytest

from calibrate.sampling import pareto_smoothed, sample


def gaussian(mean, spread):
    return lambda u: -0.5 * (((u - mean) / spread) ** 2).sum(1)


@pytest.mark.parametrize("dims", [1, 3, 5])
def test_a_normal_distribution(dims):
    mean, spread = np.linspace(0.4, 0.6, dims), np.linspace(0.02, 0.05, dims)
    found = sample(gaussian(mean, spread), dims)
    assert (np.abs(found.mean - mean) < 0.06 * spread).all()
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx(spread, rel=0.05)
    assert found.evidence == pytest.approx(np.log(spread * np.sqrt(2 * np.pi)).sum(), abs=0.03)
    assert found.effective > 1000 and found.pareto_k < 0.7


def test_what_nothing_tells_stays_the_box():
    found = sample(lambda u: -0.5 * ((u[:, 0] - 0.3) / 0.01) ** 2, 3)
    low, high = found.quantiles([0.025, 0.975])
    assert low[1:] == pytest.approx([0.025, 0.025], abs=0.01) and high[1:] == pytest.approx([0.975, 0.975], abs=0.01)
    assert (high - low)[0] == pytest.approx(3.92 * 0.01, rel=0.06)


def test_two_maxima_are_both_found():
    def two(u):
        return np.logaddexp(gaussian(0.2, 0.01)(u), np.log(3) + gaussian(0.8, 0.01)(u))

    found = sample(two, 1)
    assert found.weights[found.points[:, 0] > 0.5].sum() == pytest.approx(0.75, abs=0.03)


def test_a_bent_ridge():
    """x normal, y = x^2 to 0.05: the mean of y is that of x^2, one."""

    def ridge(u):
        x, y = 6 * u[:, 0] - 3, 8 * u[:, 1] - 1
        return -0.5 * (x**2 + ((y - x**2) / 0.05) ** 2)

    found = sample(ridge, 2)
    x, y = 6 * found.points[:, 0] - 3, 8 * found.points[:, 1] - 1
    inside = 0.991  # of the variance that the box leaves of x^2, whose top is 7
    assert found.weights @ x**2 == pytest.approx(0.98 * inside, abs=0.08)
    assert found.weights @ (y - x**2) ** 2 == pytest.approx(0.05**2, rel=0.15)


def test_draws_have_the_weights():
    found = sample(gaussian(np.array([0.5]), 0.1), 1)
    drawn = found.points[found.draws(2000)]
    assert drawn.mean() == pytest.approx(0.5, abs=0.01) and drawn.std() == pytest.approx(0.1, rel=0.05)


def test_no_density_anywhere_is_told():
    with pytest.raises(ValueError, match="no point of the box has a density"):
        sample(lambda u: np.full(len(u), -np.inf), 2)


@pytest.mark.parametrize("shape", [0.2, 0.9])
def test_pareto_shape(shape):
    """Weights drawn from a Pareto distribution have its shape."""
    weights = np.random.default_rng(0).random(40_000) ** -shape
    smoothed, k = pareto_smoothed(np.log(weights))
    assert k == pytest.approx(shape, abs=0.15)
    assert smoothed.max() <= np.log(weights).max() and np.isfinite(smoothed).all()
