"""Gravity as a term: free fall, its work in the ledger, its derivative, and where it is refused."""


import jax
import numpy as np
import pytest

from axijax.core.sector import Sector
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.dynamics import Scene, initial_state, make_step
from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
from axijax.mechanics.gravity import Gravity
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import Params
from axijax.specimen.specimen import Specimen


def scene_of(gravity, heights=(1.0,), platens=(-1e6, 1e6), **named):
    place = np.array([[0.0] * len(heights), [0.0] * len(heights), heights], float)
    specimen = Specimen(place, np.ones(len(heights)), *platens, np.ones(len(heights), bool))
    network = build_contact_list(specimen, Sector(1), skin=1.0)
    params = Params(normal_stiffness=1.0, shear_stiffness=0.8, density=3 / (4 * np.pi), terms=(gravity,), **named)
    load = Load(np.zeros((2, len(heights))), np.ones(()))
    return params, network, load, initial_state(Scene(), params, network, platens)


def held(params, network, dt, state, push, section):
    return state.platen_speeds


@pytest.mark.parametrize("acceleration", [(0.0, 0.0, -2e-3), (1e-3, -2e-3, 5e-4)])
def test_free_fall(acceleration):
    x, y, z = acceleration
    params, network, load, state = scene_of(Gravity(z, x, y))
    step, dt, steps = make_step(Scene(), held), 0.1, 200
    state = jax.jit(lambda s: jax.lax.fori_loop(0, steps, lambda _, s: step(params, network, load, dt, s), s))(state)
    # Velocities are half a step behind and start from rest there: the sum of 1 + 2 + ... is n (n + 1)/2.
    fallen = np.array(acceleration) * dt**2 * steps * (steps + 1) / 2
    np.testing.assert_allclose(np.asarray(state.displacement)[:, 0], fallen, rtol=1e-12)


def test_work_of_gravity_closes_the_ledger_of_a_bouncing_pair():
    params, network, load, state = scene_of(Gravity(-1e-4), (1.0, 3.0), (0.0, 1e6), damping_ratio=0.05)
    step, dt = make_ledger_step(Scene(), held), 0.05
    both = state, open_ledger()
    first = energy_balance(Scene(), params, network, load, dt, *both)
    both = jax.jit(lambda b: jax.lax.fori_loop(0, 2000, lambda _, b: step(params, network, load, dt, b), b))(both)
    last = energy_balance(Scene(), params, network, load, dt, *both)
    assert float(last.other_work) > 1e-8  # it came down
    assert float(last.damping) > 0.1 * float(last.other_work)
    assert abs(float(last.unaccounted - first.unaccounted)) < 1e-6 * float(last.other_work)


def test_derivative_by_gravity():
    @jax.jit
    def height(gravity):
        params, network, load, state = scene_of(Gravity(gravity), (1.0, 3.0), (0.0, 1e6))
        step = make_step(Scene(), held)
        state = jax.lax.fori_loop(0, 300, lambda _, s: step(params, network, load, 0.1, s), state)
        return state.displacement.z[1]

    _, slope = jax.jvp(height, (-1e-4,), (1.0,))
    h = 1e-8
    assert float(slope) == pytest.approx(float(height(-1e-4 + h) - height(-1e-4 - h)) / (2 * h), rel=1e-5)


def test_gravity_across_the_axis_is_refused_in_a_sector():
    with pytest.raises(ValueError, match="gravity across the axis in a sector of order 4"):
        Gravity(-1.0, 0.5).check(Sector(4))
    Gravity(-1.0).check(Sector(4))
