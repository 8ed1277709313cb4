"""Mass scaling ball by ball: masses by closed forms, motion as of balls of other densities, a curve that stays the
same, and what is refused."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import SCENE, few_balls, jit, no_load, still, unit_params

from axijax import BackgroundDamping, Dashpot, Hertz, Params, Scene
from axijax.app.case import make_case
from axijax.app.forecast import forecast
from axijax.core.sector import Sector
from axijax.mechanics.contact_list import build_contact_list, with_mass_factor
from axijax.mechanics.dynamics import initial_state, make_step
from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
from axijax.mechanics.gravity import Gravity
from axijax.mechanics.mass_scaling import QUASI_STATIC, inertial_numbers, own_stiffness, scaled, usual_stiffness
from axijax.mechanics.rebuild import rebuild_on_host
from axijax.mechanics.time_step import critical_time_step, springs_and_dashpots
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon
from axijax.theory import dashpot_duration, dashpot_restitution
from axijax.triaxial.checkpoint import load_progress, save_progress
from axijax.triaxial.progress import Progress
from axijax.triaxial.records import Confinement, no_records, raise_for_status
from axijax.triaxial.stages import simulate
from axijax.triaxial.test import TriaxialTest

RADIUS, STIFFNESS = 20.0, 1.5e9
HOLE = (2**0.5 - 1) * RADIUS  # radius of a ball that touches the six around an octahedral hole of an FCC array


def filled_octagon(layers=5, half_width=5) -> Specimen:
    """The paper's array with a small ball in every hole between six of its balls."""
    octagon = fcc_octagon(RADIUS, layers, half_width)
    pairs = np.array(list(itertools.combinations(range(len(octagon)), 2))).T
    ends = octagon.positions[:, pairs]
    opposite = np.abs(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0) - 8**0.5 * RADIUS) < 1e-6
    middles, times = np.unique(np.round(ends[:, :, opposite].mean(1), 6), axis=1, return_counts=True)
    holes = middles[:, times == 3]
    assert holes.shape[1] > 20
    small = np.zeros(holes.shape[1], bool)
    return replace(
        octagon,
        positions=np.concatenate([octagon.positions, holes], axis=1),
        radius=np.concatenate([octagon.radius, np.full(small.size, HOLE)]),
        membrane_zone=np.concatenate([octagon.membrane_zone, small]),
    )


@pytest.fixture(scope="module")
def specimen():
    return filled_octagon()


@pytest.fixture(scope="module")
def true_test(specimen):
    params = Params(platen_speed=0.004, damping_ratio=0.2)
    return TriaxialTest(specimen, params=params, axial_strain=0.005, tolerance=1e-4)


@pytest.fixture(scope="module")
def scaled_test(true_test):
    return replace(true_test, mass_scaling=2.0)


@pytest.fixture(scope="module")
def sheared(true_test, scaled_test):
    """Curve and tangent by stiffness and friction of the scaled test, and with true masses, h away from its parameters;
    one program for all."""
    params, prepared = scaled_test.params, scaled_test.prepared
    ones = with_mass_factor(prepared.network, jnp.ones_like(prepared.network.radius))
    true = replace(prepared, network=ones, time_step=true_test.prepared.time_step)
    direction = replace(
        jax.tree.map(lambda value: jnp.zeros(()), params),
        normal_stiffness=jnp.asarray(STIFFNESS),
        friction=jnp.asarray(0.1),
    )

    @jax.jit
    def curve(prepared, h):
        def moved(h):
            return simulate(prepared, jax.tree.map(lambda value, by: value + h * by, params, direction))

        return jax.jvp(moved, (h,), (1.0,))

    return lambda masses, h=0.0: curve(prepared if masses == "scaled" else true, h)


@pytest.fixture(scope="module")
def network(specimen):
    return build_contact_list(cut_to_sector(specimen, Sector(2)), Sector(2))


def stiffness_of(network, params, scene=SCENE):
    constants = params.material.stiffest(network, params.confining_stress, 1e-3)
    return own_stiffness(scene, params, network, constants, 1e-3)


def test_own_stiffness_of_a_lattice(network):
    """z contacts alike in all directions: z (kn + 2 ks)/3 against translation, 2.5 z 2 ks/3 against spin."""
    place, radius = np.asarray(network.positions), np.asarray(network.radius)
    inside = np.hypot(*place[:2]) < 1.5 * RADIUS
    inside &= np.abs(place[2] - place[2].mean()) < 1.1 * RADIUS
    for ratio in (1.0, 0.5, 0.1):
        params = Params(shear_stiffness=ratio * STIFFNESS)
        for large, contacts in ((True, 18), (False, 6)):
            found = stiffness_of(network, params)[inside & ((radius == RADIUS) == large)] / STIFFNESS
            expected = max(contacts * (1 + 2 * ratio) / 3, 2.5 * contacts * 2 * ratio / 3)
            assert found.size and found == pytest.approx(expected, rel=1e-9)
        glide = stiffness_of(network, params, Scene(rotation=False))[inside & (radius == HOLE)] / STIFFNESS
        assert glide == pytest.approx(6 * (1 + 2 * ratio) / 3, rel=1e-9)


@pytest.mark.parametrize("sector", [Sector(1), Sector(4), Sector(4, "rigid")])
def test_own_stiffness_is_the_block_of_the_whole(specimen, sector):
    """Of the operator whose modes set the critical step, one ball moving at a time; platens and planes included."""
    params = Params(shear_stiffness=0.6 * STIFFNESS, platen_friction=0.3)
    network = build_contact_list(cut_to_sector(specimen, sector), sector)
    operators = springs_and_dashpots(SCENE, params, network, 1e-3)
    mass, own = np.asarray(params.material.mass(network)), stiffness_of(network, params)
    free = np.concatenate([np.asarray(network.free)] * 2).reshape(6, -1)
    count = mass.size
    first, second = (np.asarray(end) for end in (network.first, network.second))
    meets_itself = np.isin(np.arange(count), first[(first == second) & (np.asarray(network.image) >= 0)])
    balls = np.flatnonzero((free[0] > 0) & ~meets_itself)
    assert balls.size > 10
    for ball in np.random.default_rng(0).choice(balls, 10, replace=False):
        block = np.zeros((6, 6))
        for part in range(6):
            unit = np.zeros((6, count))
            unit[part, ball] = 1
            block[:, part] = operators.stiff(unit.ravel()).reshape(6, count)[:, ball]
        assert own[ball] == pytest.approx(np.linalg.eigvalsh(block)[-1] * mass[ball], rel=1e-9)


@pytest.mark.parametrize("params", [Params(), Params(Hertz(shear_modulus=3e7))])
def test_the_critical_step_is_so_many_times_as_long_and_only_those_that_set_it_are_heavier(network, params):
    before = critical_time_step(SCENE, params, network)
    for times in (1.5, 5.0) if isinstance(params.material, Hertz) else (1.5,):
        found = scaled(SCENE, params, network, times)
        assert critical_time_step(SCENE, params, found) == pytest.approx(times * before, rel=0.012)
        factor, small = np.asarray(found.mass_factor), np.asarray(network.radius) == HOLE
        assert factor.min() >= 1 and factor.max() <= 2 * times**2
        assert factor[small].min() > factor[~small].max()
        assert (factor[~small] == 1).all() == (times == 1.5)


def test_no_ball_is_taken_for_softer_than_is_usual_for_its_size(network, monkeypatch):
    """Balls at the edge have few contacts; and without a word on the stiffness there is the size alone."""
    params, radius = Params(), np.asarray(network.radius)
    own, usual = stiffness_of(network, params), usual_stiffness(SCENE, params, network)
    room = (radius + radius.mean()) ** 2
    np.testing.assert_allclose(usual, np.maximum(own, room * (own / room).mean()), rtol=1e-12)
    assert (usual > 1.2 * own).any() and (usual == own).any()
    monkeypatch.setattr(type(params.material), "stiffest", lambda *_: None)
    np.testing.assert_array_equal(usual_stiffness(SCENE, params, network), room)


def test_a_pair_of_scaled_balls_bounces_as_one_of_such_masses():
    """Masses of 9 and 4: momentum, restitution and duration of the impact by the closed forms."""
    params = unit_params(friction=None, damping=Dashpot(0.1))
    speed, dt = 1e-3, 5e-3
    network, state = few_balls(params, [[0, 0], [0, 0], [0, 2]], [[0, 0], [0, 0], [speed, 0]])
    assert network.mass_factor is None and network.pair_cube.ndim == 0
    network = with_mass_factor(network, jnp.array([9.0, 4.0]))
    np.testing.assert_allclose(params.material.mass(network), [9.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(params.material.reduced_mass(network)[0], 36 / 13, rtol=1e-12)
    duration = float(dashpot_duration(0.1, 36 / 13, 1.0))
    step = make_step(SCENE, still)

    @jit
    def velocity(steps):
        end = jax.lax.fori_loop(0, steps, lambda _, s: step(params, network, no_load(network), dt, s), state)
        return end.velocity.z

    before, after = (np.asarray(velocity(round(share * duration / dt))) for share in (0.99, 1.01))
    assert np.abs(np.diff(after)) == pytest.approx(speed * float(dashpot_restitution(0.1)), rel=3e-3)
    assert np.diff(before) != pytest.approx(np.diff(after), rel=1e-6)  # it was still going on
    assert 9 * after[0] + 4 * after[1] == pytest.approx(9 * speed, rel=1e-9)


def test_the_ledger_closes_and_weights_are_the_true_ones():
    """Two scaled balls that spin, slip and fall: kinetic energies are of the scaled masses, weights not."""
    params = replace(unit_params(friction=0.3, damping=Dashpot(0.05)), terms=(Gravity(-1e-3),))
    place, velocity = [[0, 1.2], [0, 0], [0, 1.59]], [[0, 0], [0, 0.01], [0, -0.01]]
    network, state = few_balls(params, place, velocity, spin=[[0, 0.02], [0, 0], [0, 0]], radius=np.array([1.0, 1.0]))
    factor = jnp.array([3.0, 7.0])
    network, unscaled = with_mass_factor(network, factor), network
    load, dt, step = no_load(network), 0.01, make_ledger_step(SCENE, still)
    weights = [params.terms[0].forces(params, each, dt, state, None).force.z for each in (network, unscaled)]
    np.testing.assert_array_equal(*weights)
    start = state, open_ledger()
    end = jit(lambda b: jax.lax.fori_loop(0, 1500, lambda _, b: step(params, network, load, dt, b), b))(start)
    balance = jit(energy_balance, static_argnums=0)
    first, last = (balance(SCENE, params, network, load, dt, *both) for both in (start, end))
    assert float(first.translation) == pytest.approx(0.5 * 7 * 2e-4, rel=1e-9)
    assert float(first.spin) == pytest.approx(0.5 * 0.4 * 7 * 4e-4, rel=1e-9)
    moved = abs(float(last.other_work)) + abs(float(last.friction)) + float(last.damping)
    assert float(last.friction) > 1e-6 and float(last.damping) > 1e-6
    assert abs(float(last.unaccounted - first.unaccounted)) < 1e-3 * moved


def test_lists_that_are_rebuilt_keep_the_masses_and_so_does_a_checkpoint(scaled_test, tmp_path):
    network, factor = scaled_test.network, np.asarray(scaled_test.network.mass_factor)
    cube = np.asarray(network.radius) ** 3 * factor
    path = tmp_path / "confined.npz"
    state = initial_state(SCENE, scaled_test.params, network, scaled_test.prepared.platens)
    zero = np.zeros(())
    height, records = scaled_test.cut.height, no_records(scaled_test.params)
    now = Progress(
        scaled_test.params, *scaled_test.prepared.lists, state, None, Confinement(zero, zero, zero), height, records
    )
    save_progress(path, scaled_test, now)
    state = state._replace(displacement=network.free * (0.01 * RADIUS))
    (again, _), _ = rebuild_on_host(scaled_test.cut, scaled_test.prepared.lists, state)
    for each in (network, again, load_progress(path, scaled_test).network):
        np.testing.assert_array_equal(each.mass_factor, factor)
        real = np.asarray(each.image) >= 0
        a, b = cube[np.asarray(each.first)], cube[np.asarray(each.second)]
        np.testing.assert_allclose(np.asarray(each.pair_cube)[real], (a * b / (a + b))[real], rtol=1e-12)
    for other in (replace(scaled_test, mass_scaling=None), replace(scaled_test, mass_scaling=1.9)):
        with pytest.raises(ValueError, match="mass_scaling"):
            load_progress(path, other)


def test_half_the_steps_and_the_same_curve(sheared, true_test, scaled_test):
    """As many steps of true masses go half as far."""
    true, fast = (sheared(masses)[0] for masses in ("true", "scaled"))
    for curve in (true, fast):
        raise_for_status(curve.status, curve)
    end = float(true.axial_strain[-1])
    assert float(fast.axial_strain[-1]) > 2 * end > 0.003
    at = np.linspace(0.0002, end, 30)
    for name in ("stress_ratio", "volumetric_strain"):
        a, b = (np.interp(at, each.axial_strain, getattr(each, name)) for each in (true, fast))
        assert np.abs(a - b).max() < 0.01 * np.abs(a).max()
    assert np.ptp(true.stress_ratio) > 0.5  # something happens
    rate = 2 * true_test.params.platen_speed / true_test.cut.height
    assert inertial_numbers(scaled_test.params, scaled_test.network, rate).max() < QUASI_STATIC


def test_derivatives_hold_the_masses(sheared):
    """Against central differences of tests of the same masses."""
    h = 1e-5
    (_, slope), (above, _), (below, _) = (sheared("scaled", each) for each in (0.0, h, -h))
    early = np.asarray(above.axial_strain) < 0.002  # later neighbouring trajectories part
    difference = np.asarray(above.stress_ratio - below.stress_ratio)[early] / (2 * h)
    assert np.abs(difference).max() > 0.05
    assert np.abs(slope.stress_ratio[early] - difference).max() < 1e-3 * np.abs(difference).max()


def test_without_it_nothing_is_there(true_test):
    assert true_test.network.mass_factor is None
    assert not any("mass" in str(path) for path, _ in jax.tree.leaves_with_path(true_test.prepared))
    assert "mass_factor" not in true_test.derived


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"params": Params(platen_speed=0.3)}, "radius .* inertial number of .* not quasi-static: lower mass_scaling"),
        ({"params": Params(damping=BackgroundDamping())}, "mass_scaling = 2: damping in proportion to mass"),
    ],
)
def test_what_is_refused(scaled_test, changes, said):
    with pytest.raises(ValueError, match=said):
        replace(scaled_test, **changes).prepared  # noqa: B018


def test_parameters_of_one_run_are_held_to_the_same_limit(scaled_test):
    with pytest.raises(ValueError, match="not quasi-static"):
        scaled_test.run(replace(scaled_test.params, platen_speed=0.3))
    for value in (1.0, -2, float("nan"), 1e3):
        with pytest.raises(ValueError, match="mass_scaling"):
            replace(scaled_test, mass_scaling=value)


def test_case_files_and_check_know_it():
    small = {"specimen": {"layers": 5, "half_width": 5}, "parameters": {"platen_speed": 0.003}}
    case = make_case({**small, "test": {"mass_scaling": 1.5}}, "here")
    found = forecast(case, measure=False)
    assert found.heaviest > 1
    expected = 2 * 20 * 0.006 / found.height * (0.04 * found.heaviest) ** 0.5
    assert found.inertial_number == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match="mass_scaling"):
        make_case({"test": {"mass_scaling": 0.5}}, "here")
