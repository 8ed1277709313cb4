"""The map from parameters to a curve under jit, vmap, jvp and grad, against central differences of the same run."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hasty import hasty

from axijax import Params, Sector, TriaxialTest, fcc_octagon


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
    with hasty(False):  # as users have it; the small tests' programs are not worth optimising
        _, slope = jax.jvp(top, (friction,), (1.0,))
        differences = (top(friction + h) - top(friction - h)) / (2 * h)
    assert float(slope) == pytest.approx(float(differences), rel=5e-3)
    assert float(slope) == pytest.approx(4 / (1 - friction) ** 2, rel=0.05)


@pytest.fixture(scope="module")
def small():
    return TriaxialTest(fcc_octagon(layers=5, half_width=3), Sector(4), axial_strain=0.002, record_every=20)


NAMES = ("friction", "normal_stiffness", "shear_stiffness", "confining_stress", "damping_ratio", "density")
EARLY = 20  # record before anything slips for good


@pytest.fixture(scope="module")
def ratios(small):
    """The stress ratios, as a function of the logs of the factors of all parameters."""
    values = np.array([float(getattr(small.params, name)) for name in NAMES])

    def of(log_factors):
        scaled = dict(zip(NAMES, values * jnp.exp(log_factors), strict=True))
        return small.simulate(replace(small.params, **scaled)).stress_ratio

    return of


@pytest.fixture(scope="module")
def compiled(ratios):
    return jax.jit(ratios)


@pytest.fixture(scope="module")
def slopes(ratios):
    return jax.jit(jax.jacfwd(lambda log_factors: ratios(log_factors)[EARLY]))(jnp.zeros(len(NAMES)))


def test_batch_equals_one_at_a_time(ratios, compiled):
    many = jnp.zeros((3, len(NAMES))).at[:, 0].set(jnp.log(jnp.array([0.8, 1.6, 2.4])))
    for one, curve in zip(many, jax.jit(jax.vmap(ratios))(many), strict=True):
        np.testing.assert_allclose(curve, compiled(one), rtol=1e-9)


def test_derivatives_in_every_parameter(compiled, slopes):
    """Tangents of the stress ratio before anything slips for good equal central differences of the same run."""
    h = 1e-5
    for place, name in enumerate(NAMES):
        step = jnp.zeros(len(NAMES)).at[place].set(h)
        differences = float(compiled(step)[EARLY] - compiled(-step)[EARLY]) / (2 * h)
        assert float(slopes[place]) == pytest.approx(differences, rel=1e-3, abs=1e-5), name
    assert np.abs(slopes[:4]).min() > 1e-3  # friction, stiffnesses and stress do matter here


def test_friction_per_ball_adds_up_to_the_scenes(small, compiled, slopes):
    """With one friction per ball, the derivatives along all balls sum to the derivative in the common friction."""
    base, common = small.params, float(small.params.friction)

    def early(friction):
        return small.simulate(replace(base, friction=friction)).stress_ratio[EARLY]

    at = jnp.full(len(small.cut), common)
    each, along = jax.jit(lambda at: jax.jvp(early, (at,), (at,)))(at)
    assert float(each) == pytest.approx(float(compiled(jnp.zeros(len(NAMES)))[EARLY]), rel=1e-12)
    assert float(along) == pytest.approx(float(slopes[0]), rel=1e-9)


def test_without_friction_there_is_no_coefficient_and_no_tangential_spring(small):
    params = Params(friction=None)
    assert len(jax.tree.leaves(params)) == len(jax.tree.leaves(small.params)) - 1
    lean = TriaxialTest(small.specimen, small.sector, params=params, axial_strain=0.001, record_every=20)

    def last(ks):
        return lean.simulate(replace(params, shear_stiffness=ks)).stress_ratio[-1]

    assert float(jax.jit(lambda ks: jax.jvp(last, (ks,), (1.5e8,))[1])(1.5e9)) == 0.0
