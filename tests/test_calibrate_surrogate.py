"""The surface and its covariance, against a linear model with normal scatter, whose posterior is known."""

import numpy as np
import pytest

from calibrate.ensemble import design
from calibrate.surrogate import least_runs, surrogate

STRAINS = np.linspace(0, 1, 12)


def world(seed, count, dims=2, scatter=0.05, bend=0.0):
    """Runs of y = a(s) + B(s) x + bend x0^2 + scatter of three smooth shapes and of each number."""
    rng = np.random.default_rng(seed)
    slopes = np.stack([np.sin((k + 1) * STRAINS * 2) for k in range(dims)])
    shapes = np.stack([np.cos(k * 2.5 * STRAINS) for k in range(3)])

    shapes = np.concatenate([scatter * shapes, 0.2 * scatter * np.eye(STRAINS.size)])

    def curves(x, noise):
        return 1 + x @ slopes + bend * x[:, :1] ** 2 * STRAINS + noise @ shapes

    x = 2 * design(count, dims, seed) - 1
    return x, curves(x, rng.standard_normal((count, len(shapes)))), curves, rng, slopes, shapes


def test_mean_and_scatter_of_a_plane():
    x, y, curves, rng, _, shapes = world(0, 60)
    surface = surrogate(x, y)
    at = rng.uniform(-1, 1, (50, 2))
    mean, variance = surface.predict(at)
    apart = surface.numbers(mean) - curves(at, np.zeros((50, 15)))
    assert np.sqrt((apart**2).mean()) < 0.03  # scatter 0.06 to 0.09 over the root of 60 runs, times that of a plane
    # The scatter, brought back from the components, is the sum over the three shapes.
    made = (
        surface.back.T
        @ np.diag(surface.scatter / surface.inflation)
        @ surface.back
        * np.outer(surface.scale, surface.scale)
    )
    assert np.sqrt(np.diag(made)) == pytest.approx(np.sqrt((shapes**2).sum(0)), rel=0.3)
    assert (np.abs(surface.left_out).mean() < 1.1) and np.isfinite(variance).all()


def test_its_own_variance_is_right():
    """Over 8 worlds the distance of the surface from the truth is what its variance says."""
    squared = []
    for seed in range(8):
        x, y, curves, rng, _, _ = world(seed, 30, bend=0.15)
        surface = surrogate(x, y)
        at = rng.uniform(-0.9, 0.9, (20, 2))
        mean, variance = surface.predict(at)
        apart = surface.components(curves(at, np.zeros((20, 15)))) - mean
        squared.append((apart**2 / variance)[:, :2].mean())
    assert 0.3 < np.mean(squared) < 1.25, np.mean(squared)


def test_intervals_hold_the_truth():
    """Of 20 hidden truths, each one curve with its own scatter, 95 % intervals hold 88 to 100 % per parameter, and are
    no wider than twice those of one who knows slopes and scatter exactly."""
    inside, widths = [], []
    for seed in range(20):
        x, y, curves, rng, slopes, shapes = world(seed, 30)
        surface = surrogate(x, y)
        truth = rng.uniform(-0.7, 0.7, 2)
        data = curves(truth[None], rng.standard_normal((1, 15)))[0]
        grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 61)] * 2, indexing="ij"), -1).reshape(-1, 2)
        mean, variance = surface.predict(grid)
        spread = variance + surface.scatter
        squared = ((surface.components(data) - mean) ** 2 / spread).sum(1)
        free, count = surface.freedom, len(surface.scatter)
        log = -0.5 * np.log(spread).sum(1) - (free + count) / 2 * np.log1p(squared / free)
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        for k in range(2):
            marginal = weights.reshape(61, 61).sum(1 - k)
            low, high = np.interp([0.025, 0.975], np.cumsum(marginal) - marginal / 2, np.linspace(-1, 1, 61))
            inside.append((low < truth[k] < high, k))
            known = np.linalg.inv(slopes @ np.linalg.inv(shapes.T @ shapes) @ slopes.T)
            widths.append((high - low) / (2 * 1.96 * np.sqrt(known[k, k])))
    for k in range(2):
        share = np.mean([held for held, place in inside if place == k])
        assert 0.88 <= share <= 1.0, share
    assert 0.8 < np.median(widths) < 2.0, np.median(widths)


def test_too_few_runs_are_refused():
    x, y, *_ = world(0, 64)
    with pytest.raises(ValueError, match="a surface through them needs 14"):
        surrogate(x[: least_runs(2) - 1], y[: least_runs(2) - 1])
