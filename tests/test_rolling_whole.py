"""Rolling and torsional resistance in whole tests and in derivatives; closed forms of a pair are in test_rolling.py."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import SCENE, few_balls, jit, no_load, still, unit_params
from test_energy import sheared

from axijax import Dashpot, Hertz, Params, Rolling, Scene, Torsion, TriaxialTest, fcc_octagon
from axijax.mechanics.dynamics import make_step
from axijax.triaxial.checkpoint import load_progress
from calibrate.parameters import ParameterSet

SMALL = fcc_octagon(layers=5, half_width=3)


def small_test(params, axial_strain=0.004, **options):
    return TriaxialTest(SMALL, params=params, axial_strain=axial_strain, tolerance=1e-5, **options)


def ratios(test):
    """Stress ratios (T,) as a compiled function of the parameters."""
    return jit(lambda params: test.simulate(params).stress_ratio)


@pytest.fixture(scope="module")
def rolling():
    """A lattice test whose balls hardly roll."""
    test = small_test(Params(friction=0.3, platen_speed=0.03, rolling=Rolling(5.0, 5.0)))
    return test, ratios(test)


def test_the_lattice_goes_from_free_to_blocked_rotation(rolling):
    """eta = 0 is free rotation (test_rolling.py); a large one comes to the blocked one's peak, 37 % higher here."""
    test, rolled = rolling
    plain = replace(test.params, rolling=None)
    blocked = ratios(small_test(plain, time_step=test.prepared.time_step, scene=Scene(rotation=False)))(plain)
    free, between = (rolled(replace(test.params, rolling_friction=eta)).max() for eta in (0.0, 0.02))
    assert float(blocked.max()) > 1.3 * float(free)
    assert float(rolled(test.params).max()) == pytest.approx(float(blocked.max()), rel=5e-3)
    assert 1.02 * float(free) < float(between) < 0.9 * float(blocked.max())


@pytest.mark.slow
def test_tangents_of_a_whole_test_agree_with_differences(rolling):
    """Of the stress ratio by eta_r and alpha_r, where some contacts yield."""
    test, rolled = rolling
    params = replace(test.params, rolling_friction=0.02, rolling_stiffness=1.0)

    def at(eta, alpha):
        return replace(params, rolling_friction=eta, rolling_stiffness=alpha)

    def along(way):
        return jax.jvp(lambda eta, alpha: test.simulate(at(eta, alpha)).stress_ratio, (0.02, 1.0), tuple(way))[1]

    tangents = jit(jax.vmap(along))(jnp.eye(2))
    # So little that hardly a contact comes to its cap or leaves it in between.
    for tangent, h in zip(np.asarray(tangents), np.diag([1e-8, 1e-6]), strict=True):
        difference = (rolled(at(0.02 + h[0], 1 + h[1])) - rolled(at(0.02 - h[0], 1 - h[1]))) / (2 * h.sum())
        assert np.abs(difference).max() > 1e-3
        np.testing.assert_allclose(tangent, difference, rtol=0, atol=1e-3 * np.abs(difference).max())


NUMBERS = jnp.array([0.05, 0.5, 0.05, 0.8])  # eta, alpha, eta_tw, alpha_tw


def energy(numbers):
    """Of the spins of four balls, a while after they were set spinning."""
    eta, alpha, eta_tw, alpha_tw = numbers
    height = (8 / 3) ** 0.5
    place = 0.985 * np.array([[0, 2, 1, 1], [0, 0, 3**0.5, 3**-0.5], [0, 0, 0, height]])
    velocity, spin = 1e-3 * np.random.default_rng(0).normal(size=(2, 3, 4))
    params = unit_params(damping=Dashpot(0.1), rolling=Rolling(alpha, eta), torsion=Torsion(alpha_tw, eta_tw))
    network, state = few_balls(params, place, velocity, 20 * spin)
    step = make_step(SCENE, still)
    load = no_load(network)
    end = jax.lax.scan(lambda s, _: (step(params, network, load, 0.05, s), None), state, None, length=40)[0]
    return 1e3 * end.spin.dot(end.spin).sum()


def test_derivatives_of_a_few_balls_agree_with_differences():
    """By eta, alpha, eta_tw and alpha_tw, of balls that roll on one another past the cap; in reverse mode too."""
    along = jit(lambda at, way: jax.jvp(energy, (at,), (way,)))
    ways = np.eye(4)
    tangents = [float(along(NUMBERS, way)[1]) for way in ways]
    for tangent, way in zip(tangents, ways, strict=True):
        above, below = (along(NUMBERS + h * way, way)[0] for h in (1e-6, -1e-6))
        difference = float(above - below) / 2e-6
        assert abs(difference) > 1e-4
        assert tangent == pytest.approx(difference, rel=1e-3)
    np.testing.assert_allclose(np.asarray(jit(jax.grad(energy))(NUMBERS)), tangents, rtol=1e-9)


@pytest.mark.slow
def test_the_ledger_of_a_whole_test_closes():
    """Of Hertzian contacts, which close at second order in the step, with rolling as without; pairs of both laws are in
    test_rolling.py, a lattice of linear ones without rolling in test_energy.py."""
    parts = {"rolling": Rolling(0.5, 0.02), "torsion": Torsion(0.5, 0.02)}
    seen = sheared(small_test(Params(Hertz(friction=0.3), platen_speed=0.002, **parts), 0.0008), 1.0)
    error = np.abs(seen.unaccounted - seen.unaccounted[0])
    assert error.max() < 1e-6 * seen.platen_work[-1]
    assert seen.friction[-1] > 0.01 * seen.platen_work[-1]


def test_a_checkpoint_keeps_the_springs(tmp_path):
    """Stopped, saved, loaded and gone on with is the shear that never stopped, to the last bit."""
    parts = {"rolling": Rolling(0.5, 0.02), "torsion": Torsion(0.5, 0.02)}
    whole = small_test(Params(friction=0.3, platen_speed=0.03, **parts), 0.02)
    path = tmp_path / "shear.npz"
    replace(whole, axial_strain=0.01).run(checkpoint=path)
    start = load_progress(path, whole)
    springs = [memory.contact for memory in start.state.memory[3:]]
    assert len(springs) == 2 and all(np.abs(np.asarray(spring)).max() > 1e-9 for spring in springs)
    for one, other in zip(jax.tree.leaves(whole.run(start=start)), jax.tree.leaves(whole.run()), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def test_a_fit_of_the_rolling_stiffness_holds_the_time_step():
    """A reference's time step serves a larger alpha_r, whose balls are made so much heavier."""
    test = small_test(Params(rolling=Rolling(2.0, 0.1)))
    fitted = ParameterSet.of(test.params, "alpha_r,eta_r")
    params = fitted.params(test.params, fitted.coordinates({"rolling_stiffness": 8.0, "rolling_friction": 0.2}))
    assert params.density == pytest.approx(4 * test.params.density)
    assert replace(test, params=params, time_step=test.prepared.time_step).prepared.time_step > 0
    lighter = fitted.params(test.params, fitted.coordinates({"rolling_stiffness": 1.0, "rolling_friction": 0.2}))
    assert lighter.density == pytest.approx(test.params.density)
