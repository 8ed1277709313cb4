"""The examples of examples/where_to_add.md: what is added from outside the package, each with its derivative against
central differences, and with its energy where it has one. The code under test is the page's own."""

import sys
import types
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Params, Scene, Sector, Specimen, TriaxialTest, fcc_octagon, stage
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import build_contact_list, carry_memory
from axijax.mechanics.dynamics import initial_state, make_step
from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import check_params
from axijax.mechanics.time_step import critical_time_step
from axijax.triaxial.stages import simulate, start_shear
from calibrate import Datum

PAGE = Path(__file__).parent.parent / "examples" / "where_to_add.md"
sys.path.insert(0, str(PAGE.parent / "guide"))
from run_pages import blocks  # noqa: E402


def code_of_the_page() -> types.ModuleType:
    module = types.ModuleType("where_to_add")
    sys.modules[module.__name__] = module  # where dataclasses look for it
    exec("\n".join(block.text for block in blocks(PAGE, "python")), vars(module))
    return module


page = code_of_the_page()


def still(params, network, dt, state, push, section):
    return jnp.zeros(2)


NO_LOAD = Load(jnp.zeros(2), jnp.ones(()))
UNIT = {"density": 3 / (4 * np.pi), "normal_stiffness": 1.0, "shear_stiffness": 0.8, "damping_ratio": 0.0}


def pair(gap, speed, sideways=0.0):
    """Two balls of radius and mass 1 with a gap, each with half of a closing speed and of a velocity across: the list,
    and the first state as a function of the parameters."""
    place = np.array([[-1 - gap / 2, 1 + gap / 2], [0, 0], [0, 0]])
    specimen = Specimen(place, 1.0, -1e6, 1e6, np.ones(2, bool))
    network = build_contact_list(specimen, Sector(1), skin=1.0)
    velocity = from_rows(np.array([[speed / 2, -speed / 2], [sideways / 2, -sideways / 2], [0, 0]]))

    def start(params):
        return initial_state(Scene(), params, network, (-1e6, 1e6))._replace(velocity=velocity)

    return network, start


def motion(params, network, state, dt, steps):
    """The state after so many steps."""
    step = make_step(Scene(), still)
    return jax.lax.fori_loop(0, steps, lambda _, s: step(params, network, NO_LOAD, dt, s), state)


after = jax.jit(motion)


@jax.jit
def derivative(params, tangent, network, state, dt, steps):
    """The state after so many steps, and its derivative."""
    return jax.jvp(lambda p: motion(p, network, state, dt, steps), (params,), (tangent,))


@jax.jit
def ledger(params, network, state, dt, steps):
    """The energy balance before the first and after so many steps."""
    step = make_ledger_step(Scene(), still)
    both = state, open_ledger()
    last = jax.lax.fori_loop(0, steps, lambda _, b: step(params, network, NO_LOAD, dt, b), both)
    return [energy_balance(Scene(), params, network, NO_LOAD, dt, *each) for each in (both, last)]


def check_derivative(make, at, h, scene, dt, steps, accuracy):
    """Of where the balls are, by the number of which `make` makes parameters, against central differences."""
    network, start = scene

    def place(number):
        params, tangent = jax.jvp(make, (number,), (1.0,))
        state, slope = derivative(params, tangent, network, start(params), dt, steps)
        return np.asarray(state.displacement), np.asarray(slope.displacement)

    difference = (place(at + h)[0] - place(at - h)[0]) / (2 * h)
    assert np.abs(difference).max() > 0
    np.testing.assert_allclose(place(at)[1], difference, rtol=0, atol=accuracy * np.abs(difference).max())


def stiffening(doubling, **more):
    return Params(page.Stiffening(doubling=doubling), **(UNIT | more))


def test_a_stiffening_contact_turns_where_its_energy_is_that_of_the_impact():
    """1/2 m* v^2 = kn d^2 (1/2 + d/(3 doubling)) at the deepest overlap d, with m* = 1/2."""
    network, start = pair(0.0, 0.2)
    doubling = 0.05
    deepest = np.roots([1 / (3 * doubling), 0.5, 0, -0.25 * 0.2**2])
    deepest = float(deepest[(deepest.imag == 0) & (deepest.real > 0)].real[0])
    params, found = stiffening(doubling), 0.0
    for steps in range(40, 100):  # around the turn, of steps of 0.01
        state = after(params, network, start(params), 0.01, steps)
        found = max(found, float(state.displacement.x[0] - state.displacement.x[1]))
    assert found == pytest.approx(deepest, rel=1e-4)
    assert deepest < 0.8 * 0.2 * 0.5**0.5  # where a linear one turns


@pytest.mark.parametrize("dt", [0.02, 0.01])
def test_energy_of_a_stiffening_contact(dt):
    """An oblique impact with slip, from gap to gap: to second order in the step, as a Hertzian one."""
    network, start = pair(0.0, 0.2, sideways=0.15)
    params = stiffening(0.05, friction=0.2, damping_ratio=0.02)
    first, last = ledger(params, network, start(params), dt, int(3 / dt))
    assert abs(float(last.unaccounted - first.unaccounted)) < 2 * dt**2 * 0.01
    assert float(last.friction) > 1e-4 and float(last.damping) > 1e-4


def test_derivative_of_a_stiffening_contact():
    check_derivative(
        lambda doubling: stiffening(doubling, friction=0.2), 0.05, 1e-5, pair(0.0, 0.2, sideways=0.15), 0.02, 60, 1e-6
    )


def test_a_parameter_of_ones_own_is_known_by_its_name():
    params = replace(stiffening(0.05), doubling=0.1, friction=0.4)
    assert (params.doubling, params.material.doubling, params.friction) == (0.1, 0.1, 0.4)
    with pytest.raises(ValueError, match="doubling = 0: must be positive"):
        check_params(replace(params, doubling=0.0), 2)
    with pytest.raises(ValueError, match=r"doublin.*would do nothing; did you mean 'doubling'"):
        replace(params, doublin=1.0)


def test_the_critical_step_of_a_stiffening_contact():
    """A deep overlap D makes it 1 + 2 D/doubling times stiffer: omega^2 = 2 k/m of a pair."""
    network, _ = pair(-0.04, 0.0)
    params = stiffening(0.05, friction=None, confining_stress=1e-9)
    expected = 2 / (2 * (1 + 2 * 0.04 / 0.05)) ** 0.5
    assert critical_time_step(Scene(), params, network) == pytest.approx(expected, rel=1e-3)


def bonded(pull, **more):
    return Params(terms=(page.Bonds(pull, 0.1),), **(UNIT | more))


# Of a bond of pull 0.1 between balls that touch: pull times half the longest gap.
DEPTH = 0.1 * 0.1 / 2


@pytest.mark.parametrize("energy", [0.8, 1.2])
def test_a_bond_holds_what_it_has_energy_for(energy):
    """Two balls that fly apart with so much of the bond's energy: held, or gone with the rest of it."""
    dt = 0.01
    network, start = pair(0.0, -2 * (energy * DEPTH) ** 0.5 - 0.1 * dt)  # the speed half a step before
    state = after(bonded(0.1), network, start(bonded(0.1)), dt, 400)
    apart = float(state.displacement.x[1] - state.displacement.x[0])
    broken = float(state.memory[3].contact.sum()) == 0
    assert broken == (energy > 1) and (apart > 0.1) == broken
    if broken:
        speed = float(state.velocity.x[1] - state.velocity.x[0])
        assert speed == pytest.approx(2 * ((energy - 1) * DEPTH) ** 0.5, rel=1e-3)


@pytest.mark.parametrize("dt", [0.02, 0.01])
@pytest.mark.parametrize("energy", [0.8, 1.2])
def test_energy_of_a_bond(energy, dt):
    network, start = pair(0.0, -2 * (energy * DEPTH) ** 0.5)
    first, last = ledger(bonded(0.1), network, start(bonded(0.1)), dt, int(4 / dt))
    assert abs(float(last.unaccounted - first.unaccounted)) < dt**2 * DEPTH


@pytest.mark.parametrize("energy", [0.8, 1.2])
def test_derivative_of_a_bond(energy):
    check_derivative(bonded, 0.1, 1e-6, pair(0.0, -2 * (energy * DEPTH) ** 0.5), 0.01, 400, 1e-5)


def test_a_broken_bond_stays_broken_in_a_new_list_and_a_new_contact_has_none():
    place = np.array([[0.0, 2, 4.05, 30], [0, 0, 0, 0], [0, 0, 0, 0]])

    def near(skin):
        return build_contact_list(Specimen(place, 1.0, -9.0, 9.0, np.ones(4, bool)), Sector(1), skin=skin)

    old, new = near(0.5), near(3.0)
    bonds = page.Bonds(1.0, 0.1).init(Params(), old)
    pairs = list(zip(np.asarray(old.first), np.asarray(old.second), strict=True))
    bonds = bonds._replace(contact=bonds.contact.at[pairs.index((1, 2))].set(0.0))
    carried = carry_memory(old, new, (bonds,))[0].contact
    listed = [np.asarray(part)[np.asarray(new.image) >= 0] for part in (new.first, new.second, carried)]
    found = {(int(i), int(j)): float(bond) for i, j, bond in zip(*listed, strict=True)}
    assert found == {(0, 1): 1.0, (1, 2): 0.0, (0, 2): 0.0}


def test_what_goes_out_with_a_part_is_not_proposed():
    with pytest.raises(ValueError, match=r"damping_ratio = 0.1: .*would do nothing; there are friction, density"):
        Params(damping=None, damping_ratio=0.1)


TARGET = Datum(page.DilationAt(2e-5), 1e-5, 1e-6)
RATIO, DOUBLING, PULL = 1.3, 0.2, 1e6


@lru_cache
def whole_test():
    """A small octagon of bonded, stiffening balls whose platens carry a ratio of stresses: parameters, and prepared."""
    material = page.Stiffening(doubling=DOUBLING, friction=0.4)
    params = Params(material, terms=(page.Bonds(PULL, 0.01),), damping_ratio=0.3)
    prepared = TriaxialTest(fcc_octagon(layers=3, half_width=3), params=params, tolerance=1e-8).prepared
    numerics = replace(prepared.numerics, records=10)
    return params, replace(prepared, shear=page.StressRatio(RATIO, 5.0, 4.0), numerics=numerics)


def mean_overlap(params, network, state):
    """Mean overlap of the contacts [L]."""
    overlap = page.geometry(network, state.displacement).overlap
    touching = jnp.where(overlap > 0, network.share, 0.0)
    return (touching * overlap).sum() / touching.sum()


@lru_cache
def measured():
    """Program of (ratio of stresses, factor on doubling, factor on pull) and a direction: curve, measurement and target
    of a fit, and their derivatives."""
    params, prepared = whole_test()

    def values(at):
        path = replace(prepared.shear, ratio=RATIO * at[0])
        here = replace(params, doubling=DOUBLING * at[1], pull=PULL * at[2])
        curve, found = page.simulate_measuring(replace(prepared, shear=path), here, mean_overlap)
        return curve, found, TARGET.predict(curve)

    return jax.jit(lambda at, along: jax.jvp(values, (at,), (along,)))


def test_a_path_of_ones_own_reaches_its_ratio():
    curve, overlaps, target = measured()(jnp.ones(3), jnp.zeros(3))[0]
    assert int(curve.status) == 0
    assert float(curve.stress_ratio[0]) == pytest.approx(1, abs=1e-6)
    assert float(curve.stress_ratio[-1]) == pytest.approx(RATIO, rel=2e-4)
    assert float(curve.axial_strain[-1]) > 0 and 1.0 < float(overlaps[-1] / overlaps[0]) < RATIO
    strains = np.asarray(curve.axial_strain), np.asarray(curve.volumetric_strain)
    assert float(target[0]) == pytest.approx(np.interp(2e-5, *strains), rel=1e-12)


def test_a_path_of_ones_own_is_a_stage_among_others():
    """The ratio is reached where it alone is the test, and kept while the platens of the next stage stand."""
    params, _ = whole_test()
    specimen = fcc_octagon(layers=3, half_width=3)
    stages = page.StressRatio(RATIO, 5.0, 4.0), stage("hold", time=2.0)
    test = TriaxialTest(specimen, params=params, stages=stages, tolerance=1e-8)
    curve = jax.jit(simulate.__wrapped__)(test.prepared, params)
    assert int(curve.status) == 0
    own, held = (np.asarray(curve.stage) == number for number in (1, 2))
    ratio, strain = np.asarray(curve.stress_ratio), np.asarray(curve.axial_strain)
    assert ratio[own][-1] == pytest.approx(RATIO, rel=1e-4) and ratio[held][-1] == pytest.approx(RATIO, rel=1e-3)
    np.testing.assert_allclose(strain[held], strain[own][-1], rtol=1e-3)
    np.testing.assert_allclose(curve.path_length[-1], np.abs(np.diff(strain[own])).sum(), rtol=0.2)
    alone = measured()(jnp.ones(3), jnp.zeros(3))[0][0]
    np.testing.assert_allclose(strain[own][:10], alone.axial_strain, rtol=1e-9)


@pytest.mark.parametrize("number", [0, 1, 2], ids=["path", "contact law", "bonds"])
def test_derivative_of_a_whole_test(number):
    """Of the strains, of what is recorded besides and of the target of a fit, by a number of each of ones own."""
    h, along = 1e-3, jnp.eye(3)[number]
    program = measured()

    def seen(results):
        curve, overlaps, target = results
        return [np.asarray(part) for part in (curve.axial_strain, curve.volumetric_strain, overlaps, target)]

    slopes = seen(program(jnp.ones(3), along)[1])
    up, down = (seen(program(jnp.ones(3) + sign * h * along, along)[0]) for sign in (1, -1))
    for slope, high, low in zip(slopes, up, down, strict=True):
        difference = (high - low) / (2 * h)
        np.testing.assert_allclose(slope, difference, rtol=0, atol=2e-4 * np.abs(difference).max())
        assert np.abs(difference).max() > 0


def test_simulate_takes_the_path():
    """The same curve with what is recorded besides as without."""
    params, prepared = whole_test()
    plain = jax.jit(simulate.__wrapped__)(prepared, params)
    beside = measured()(jnp.ones(3), jnp.zeros(3))[0][0]
    np.testing.assert_allclose(plain.axial_strain, beside.axial_strain, atol=1e-12)
    np.testing.assert_allclose(plain.stress_ratio, beside.stress_ratio, atol=1e-9)


def test_what_a_term_carries_survives_confinement():
    """A bond that broke in confinement is broken in the shear; springs that were not there start from nothing."""
    params, prepared = whole_test()
    confining = prepared.confinement.params(params, *prepared.lists, prepared.platens)
    state = initial_state(Scene(rotation=False), confining, prepared.network, prepared.platens)
    broken = state.memory[3].contact.at[0].set(0.0)
    confined = state._replace(memory=(*state.memory[:3], state.memory[3]._replace(contact=broken)))
    start = start_shear(prepared.scene, params, prepared.lists, confined)
    np.testing.assert_array_equal(start.memory[3].contact, broken)
    assert state.spring is None and not np.asarray(start.spring).any()
