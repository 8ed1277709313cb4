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
from axijax.triaxial.checkpoint import load_progress, save_progress
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
    """eta = 0 is the free lattice to the last bit; a large one the blocked, whose peak is 37 % higher here, to 1 %."""
    test, rolled = rolling
    step = test.prepared.time_step
    plain = replace(test.params, rolling=None)
    free = ratios(small_test(plain, time_step=step))(plain)
    np.testing.assert_array_equal(rolled(replace(test.params, rolling_friction=0.0)), free)
    blocked = ratios(small_test(plain, time_step=step, scene=Scene(rotation=False)))(plain)
    assert float(blocked.max()) > 1.3 * float(free.max())
    assert float(rolled(test.params).max()) == pytest.approx(float(blocked.max()), rel=1e-2)
    between = float(rolled(replace(test.params, rolling_friction=0.02)).max())
    assert 1.02 * float(free.max()) < between < 0.9 * float(blocked.max())


def test_tangents_of_a_whole_test_agree_with_differences(rolling):
    """Of the stress ratio by eta_r and alpha_r, where some contacts yield."""
    test, rolled = rolling
    params = replace(test.params, rolling_friction=0.02, rolling_stiffness=1.0)

    def at(eta, alpha):
        return replace(params, rolling_friction=eta, rolling_stiffness=alpha)

    def along(way):
        return jax.jvp(lambda eta, alpha: test.simulate(at(eta, alpha)).stress_ratio, (0.02, 1.0), tuple(way))[1]

    tangents = jit(jax.vmap(along))(jnp.eye(2))
    for tangent, h in zip(np.asarray(tangents), 1e-5 * np.eye(2), strict=True):
        difference = (rolled(at(0.02 + h[0], 1 + h[1])) - rolled(at(0.02 - h[0], 1 - h[1]))) / 2e-5
        assert np.abs(difference).max() > 1e-3
        np.testing.assert_allclose(tangent, difference, rtol=0, atol=1e-3 * np.abs(difference).max())


def test_reverse_mode_agrees_with_the_tangents():
    """Of a few balls that roll past the cap on one another, by all four numbers."""
    place = np.array([[0.0, 1.97, 0.98, 1.0], [0.0, 0.0, 1.68, 0.6], [0.0, 0.0, 0.0, 1.6]])
    rng = np.random.default_rng(0)
    velocity, spin = 1e-3 * rng.normal(size=(2, 3, 4))
    params = unit_params(damping=Dashpot(0.1), rolling=Rolling(0.5, 0.05), torsion=Torsion(0.8, 0.05))
    network, state = few_balls(params, place, velocity, 20 * spin)
    step = make_step(SCENE, still)

    def energy(numbers):
        eta, alpha, eta_tw, alpha_tw = numbers
        here = replace(params, rolling=Rolling(alpha, eta), torsion=Torsion(alpha_tw, eta_tw))
        end = jax.lax.scan(lambda s, _: (step(here, network, no_load(network), 0.05, s), None), state, None, length=40)
        return 1e3 * end[0].spin.dot(end[0].spin).sum()

    numbers = jnp.array([0.05, 0.5, 0.05, 0.8])
    back = jit(jax.grad(energy))(numbers)
    ahead = jit(jax.vmap(lambda way: jax.jvp(energy, (numbers,), (way,))[1]))(jnp.eye(4))
    assert np.abs(np.asarray(back)).min() > 1e-4
    np.testing.assert_allclose(np.asarray(back), np.asarray(ahead), rtol=1e-9)


@pytest.mark.parametrize("material", [None, Hertz(friction=0.3)], ids=["linear", "hertz"])
def test_the_ledger_of_a_whole_test_closes(material):
    parts = {"rolling": Rolling(0.5, 0.02), "torsion": Torsion(0.5, 0.02)}
    params = Params(friction=0.3, platen_speed=0.01, **parts) if material is None else Params(material, **parts)
    seen = sheared(small_test(params, 0.004 if material is None else 0.0008), 1.0)
    error = np.abs(seen.unaccounted - seen.unaccounted[0])
    assert (error[1:] < 1e-6 * seen.platen_work[1:]).all(), "at every moment of the test"
    assert seen.friction[-1] > 0.01 * seen.platen_work[-1]


def test_a_checkpoint_keeps_the_springs(tmp_path):
    """Stopped, saved, loaded and gone on with is the shear that never stopped, to the last bit."""
    parts = {"rolling": Rolling(0.5, 0.02), "torsion": Torsion(0.5, 0.02)}
    whole = small_test(Params(friction=0.3, platen_speed=0.03, **parts), 0.02)
    path = tmp_path / "shear.npz"
    replace(whole, axial_strain=0.01).run(checkpoint=path)
    start = load_progress(path, whole)
    springs = [memory.contact for memory in start.state.memory[3:]]
    assert all(np.abs(np.asarray(spring)).max() > 1e-9 for spring in springs)
    save_progress(tmp_path / "again.npz", whole, start)
    for one, other in zip(
        jax.tree.leaves(whole.run(start=start)), jax.tree.leaves(whole.run()), strict=True
    ):
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
