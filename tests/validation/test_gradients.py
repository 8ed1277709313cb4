"""The map from parameters to a curve under jit, vmap, jvp and grad, against central differences of the same run."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Params, Sector, TriaxialTest, fcc_octagon

# Of the small test, which runs briefly: not worth optimising.
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


def window_mean(curve, low, high):
    inside = (curve.axial_strain > low) & (curve.axial_strain < high)
    return (curve.stress_ratio * inside).sum() / inside.sum()


@pytest.mark.slow
def test_friction_derivative_of_the_peak_of_the_quarter():
    """dR/df of the mean over the flat top: jvp against central differences to 5e-3, and near the lattice's."""
    test = TriaxialTest(fcc_octagon(), Sector(4), axial_strain=0.0055)

    @jax.jit
    def top(friction):
        return window_mean(test.simulate(replace(test.params, friction=friction)), 0.0025, 0.005)

    friction, h = 0.12278, 1e-4
    _, slope = jax.jvp(top, (friction,), (1.0,))
    differences = (top(friction + h) - top(friction - h)) / (2 * h)
    assert float(slope) == pytest.approx(float(differences), rel=5e-3)
    assert float(slope) == pytest.approx(4 / (1 - friction) ** 2, rel=0.05)


@pytest.fixture(scope="module")
def small():
    return TriaxialTest(fcc_octagon(layers=5, half_width=3), Sector(4), axial_strain=0.002, record_every=20)


def test_batch_equals_one_at_a_time(small):
    def ratios(friction):
        return small.simulate(replace(small.params, friction=friction)).stress_ratio

    frictions, one = jnp.asarray([0.1, 0.2, 0.3]), jit(ratios)
    for friction, curve in zip(frictions, jit(jax.vmap(ratios))(frictions), strict=True):
        np.testing.assert_allclose(curve, one(friction), rtol=1e-9)


def test_derivatives_in_every_parameter(small):
    """Tangents of the stress ratio before anything slips for good equal central differences of the same run."""
    names = ("friction", "normal_stiffness", "shear_stiffness", "confining_stress", "damping_ratio", "density")
    values = np.array([float(getattr(small.params, name)) for name in names])

    def early(log_factors):
        scaled = dict(zip(names, values * jnp.exp(log_factors), strict=True))
        return small.simulate(replace(small.params, **scaled)).stress_ratio[20]

    slopes, value = jit(jax.jacfwd(early))(jnp.zeros(len(names))), jit(early)
    h = 1e-5
    for place, name in enumerate(names):
        step = jnp.zeros(len(names)).at[place].set(h)
        differences = float(value(step) - value(-step)) / (2 * h)
        assert float(slopes[place]) == pytest.approx(differences, rel=1e-3, abs=1e-5), name
    assert np.abs(slopes[:4]).min() > 1e-3  # friction, stiffnesses and stress do matter here


def test_friction_per_ball_adds_up_to_the_scenes(small):
    """With one friction per ball, the derivatives along all balls sum to the derivative in the common friction."""
    base, count = small.params, len(small.cut)

    def early(friction):
        return small.simulate(replace(base, friction=friction)).stress_ratio[20]

    tangent = jit(lambda at, by: jax.jvp(early, (at,), (by,)))
    value, common = tangent(0.1, 1.0)
    each, along = tangent(jnp.full(count, 0.1), jnp.ones(count))
    assert float(each) == pytest.approx(float(value), rel=1e-12)
    assert float(along) == pytest.approx(float(common), rel=1e-9)


def test_without_friction_there_is_no_coefficient_and_no_tangential_spring(small):
    params = Params(friction=None)
    assert len(jax.tree.leaves(params)) == len(jax.tree.leaves(small.params)) - 1
    lean = TriaxialTest(small.specimen, small.sector, params=params, axial_strain=0.001, record_every=20)

    def last(ks):
        return lean.simulate(replace(params, shear_stiffness=ks)).stress_ratio[-1]

    assert float(jit(lambda ks: jax.jvp(last, (ks,), (1.5e8,))[1])(1.5e9)) == 0.0
