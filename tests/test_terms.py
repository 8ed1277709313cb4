"""Terms of the forces: the capped spring against a plain loop, and platens with friction against closed forms.

Units as in few_balls.py. A ball bears on one platen by a constant pull N along z, which stands for its weight, or is
held between both, which press it with N each.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import SCENE, Pull, constant_load, few_balls, hertz_params, jit, no_load, record, run, still, unit_params
from test_energy import balances, closing, spent

from axijax import Dashpot, LocalDamping, Params, Sector, TriaxialTest, fcc_octagon
from axijax.core.vector import from_rows
from axijax.mechanics.capped_spring import capped
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.dynamics import all_forces, initial_state
from axijax.specimen.specimen import Specimen
from axijax.theory import (
    dashpot_restitution,
    gross_sliding_impact,
    hertz_impact_duration,
    slide_to_roll,
    sticking_velocity_ratio,
)

INF = float("inf")
BOTH_LAWS = pytest.mark.parametrize("make", [unit_params, hertz_params], ids=["linear", "hertz"])

# The capped spring.

STEP = 0.05


def random_springs(seed, count=60):
    """Springs, rates (3, count) and limits, some of them none, no limit at all, or without any slip."""
    rng = np.random.default_rng(seed)
    spring, rate = rng.normal(size=(2, 3, count))
    limit = rng.uniform(0.1, 4.0, count)
    limit[:5], limit[5:10] = 0.0, np.inf
    spring[:, [0, 5, 10]] = rate[:, [0, 5, 10]] = 0.0
    rate[:, 11:15] = 0.0
    return spring, rate, limit


@pytest.mark.parametrize("viscosity", [None, 0.7])
def test_capped_spring_is_the_return_map(viscosity):
    """A loop over springs: the trial force is cut to the limit, and the spring is scaled with it."""
    spring, rate, limit = random_springs(0)
    force, after = jit(capped)(from_rows(spring), from_rows(rate), 1.3, viscosity, jnp.asarray(limit), STEP)
    cut = 0
    for k in range(limit.size):
        stretched = spring[:, k] + rate[:, k] * STEP
        trial = 1.3 * stretched + (viscosity or 0.0) * rate[:, k]
        size = np.linalg.norm(trial)
        if size > limit[k]:
            stretched, trial = stretched * limit[k] / size, trial * limit[k] / size
            cut += 1
        np.testing.assert_allclose(np.asarray(force)[:, k], trial, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.asarray(after)[:, k], stretched, rtol=0, atol=1e-14)
    assert 15 < cut < 45, "both below and above the cap"


def test_capped_spring_with_no_limit_and_with_none():
    """Glued: a linear spring and dashpot, to the last bit. A limit of zero: nothing at all."""
    spring, rate, _ = (from_rows(v) if v.ndim == 2 else v for v in random_springs(1))
    force, after = capped(spring, rate, 1.3, 0.7, INF, STEP)
    for made, expected in ((after, spring + rate * STEP), (force, (spring + rate * STEP) * 1.3 + rate * 0.7)):
        np.testing.assert_array_equal(np.asarray(made), np.asarray(expected))
    for nothing in capped(spring, rate, 1.3, 0.7, 0.0, STEP):
        np.testing.assert_array_equal(np.asarray(nothing), 0.0)


@pytest.mark.parametrize("viscosity", [None, 0.7])
@pytest.mark.parametrize("where", ["below", "above", "mixed", "glued"])
def test_tangents_of_the_capped_spring_agree_with_differences(where, viscosity):
    """With respect to spring, rate, stiffness, viscosity and limit, one of each for all."""
    spring, rate, limit = (v[..., 15:] for v in random_springs(2))
    size = np.linalg.norm(1.3 * (spring + rate * STEP) + (viscosity or 0.0) * rate, axis=0)
    limit = {"below": 1.2 * size, "above": 0.6 * size, "mixed": limit, "glued": np.full(size.size, np.inf)}[where]
    assert np.abs(limit / size - 1).min() > 1e-4, "no difference steps over the corner"
    rng = np.random.default_rng(3)
    ways = rng.normal(size=(2, *spring.shape)), rng.normal(size=3), rng.normal(size=size.size)

    def along(h):
        to_spring, to_rate = (from_rows(v + h * way) for v, way in zip((spring, rate), ways[0], strict=True))
        stiffness = 1.3 + h * ways[1][0]
        damped = None if viscosity is None else viscosity + h * ways[1][1]
        return capped(to_spring, to_rate, stiffness, damped, limit + h * ways[2], STEP)

    _, tangents = jax.jvp(along, (0.0,), (1.0,))
    h = 1e-6
    for tangent, more, less in zip(tangents, along(h), along(-h), strict=True):
        difference = (np.asarray(more) - np.asarray(less)) / (2 * h)
        assert np.abs(difference).max() > 0.1
        np.testing.assert_allclose(np.asarray(tangent), difference, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("limit", [0.0, 0.5, INF])
def test_tangents_of_the_capped_spring_at_rest_are_finite(limit):
    """No slip and no spring: stiffness times the step and the dashpot where there is a limit, nothing where it is 0."""
    nought = from_rows(np.zeros((3, 2)))
    way = from_rows(np.outer([1.0, 2.0, 3.0], [1.0, -1.0]))

    def moved(h):
        return capped(way * (0.0 * h), way * h, 1.3, 0.7, limit + h, STEP)

    _, (force_d, after_d) = jax.jvp(moved, (0.0,), (1.0,))
    share = 0.0 if limit == 0 else 1.0
    np.testing.assert_allclose(np.asarray(force_d), share * (1.3 * STEP + 0.7) * np.asarray(way), rtol=1e-14)
    np.testing.assert_allclose(np.asarray(after_d), share * STEP * np.asarray(way), rtol=1e-14)
    for still_d in jax.jvp(lambda k, c, m: capped(nought, nought, k, c, m, STEP), (1.3, 0.7, limit), (1.0,) * 3)[1]:
        np.testing.assert_array_equal(np.asarray(still_d), 0.0)


def test_a_limit_that_rises_from_nothing_holds_against_the_slip():
    """The one-sided derivative at a limit of zero is the unit vector of the trial force."""
    spring, rate, _ = (from_rows(v[:, 15:]) if v.ndim == 2 else v for v in random_springs(4))
    force_d, _ = jax.jvp(lambda limit: capped(spring, rate, 1.3, 0.7, limit, STEP), (0.0,), (1.0,))[1]
    trial = np.asarray((spring + rate * STEP) * 1.3 + rate * 0.7)
    np.testing.assert_allclose(np.asarray(force_d), trial / np.linalg.norm(trial, axis=0), rtol=1e-12)


# Platens with friction.

PUSH = 1e-4  # N


def indented(params) -> float:
    """Overlap at which a ball of radius 1 bears N on a plate."""
    return PUSH if "normal_stiffness" in params.material.__dataclass_fields__ else (0.75 * PUSH) ** (2 / 3)


def bearing(params, side, velocity, spin, radius=1.0):
    """A ball that bears on the bottom (0) or the top platen (1): parameters with the pull, contact list and state."""
    params = replace(params, terms=(Pull(PUSH * (-1, 1)[side]),))
    depth = indented(params)
    if radius != 1.0:
        assert depth == PUSH, "the Hertzian overlap goes with the radius too"
    place = np.array([[0.3], [-0.2], [radius - depth if side == 0 else 50 - radius + depth]])
    network, state = few_balls(params, place, velocity, spin, radius=radius, platens=(0, 50))
    return params, network, state


def held(params, network, state):
    """Normal forces (2, N) and tangential forces (2, 3, N) of the platens at a state."""
    found = all_forces(SCENE, params, network, no_load(network), 0.05, state).pushes[1].detail
    return np.asarray(found.normal), np.asarray([np.asarray(force) for force in found.held])


DIRECTION = np.array([0.6, -0.8, 0.0])


@BOTH_LAWS
@pytest.mark.parametrize("side", [0, 1])
def test_sliding_ball_begins_to_roll_on_a_platen(make, side):
    """It slows down at f N/m and spins up at 5 f N/(2 m r), to rounding, until at 2 v0 m/(7 f N) it rolls at 5/7 v0;
    what it turns about is the contact, about which its angular momentum stays what it was."""
    f, v0, dt = 0.25, 0.01, 0.05
    velocity = v0 * DIRECTION[:, None]
    params, network, state = bearing(make(platen_friction=f), side, velocity, np.zeros((3, 1)))
    time, speed, distance = (float(x) for x in slide_to_roll(v0, f, PUSH))
    states = record(params, network, no_load(network), dt, state, round(1.3 * time / dt))
    along = np.einsum("i,itk->tk", DIRECTION, np.asarray(states.velocity))[:, 0]
    up = np.array([0.0, 0.0, (1.0, -1.0)[side]])  # into the specimen
    about = np.cross(up, DIRECTION)  # in which it rolls
    turning = np.einsum("i,itk->tk", about, np.asarray(states.spin))[:, 0]
    sliding = slice(1, int(0.99 * time / dt))
    np.testing.assert_allclose(np.diff(along[sliding]), -f * PUSH * dt, rtol=1e-6)
    np.testing.assert_allclose(np.diff(turning[sliding]), 2.5 * f * PUSH * dt, rtol=1e-6)
    np.testing.assert_allclose(along + 0.4 * turning, v0, rtol=1e-12)
    rolling = np.flatnonzero(along - turning < 1e-4 * v0)[0]
    assert rolling * dt == pytest.approx(time, rel=1e-3)
    way = np.einsum("i,itk->tk", DIRECTION, np.asarray(states.displacement))[rolling, 0]
    assert way == pytest.approx(distance, rel=1e-3)
    assert np.mean(along[rolling + 100 :]) == pytest.approx(speed, rel=1e-3)
    assert np.abs((along - turning)[rolling:]).max() < 0.02 * v0, "what is left swings in the spring"
    sideways = np.array([-DIRECTION[1], DIRECTION[0], 0.0])
    np.testing.assert_allclose(np.einsum("i,itk->tk", sideways, np.asarray(states.velocity)), 0, atol=1e-12 * v0)


@pytest.mark.parametrize("radius", [1.0, 2.0])
def test_spinning_ball_drives_itself_along_a_platen(radius):
    """Set down spinning at w0 it ends rolling at 2/7 w0 r, at 2 w0 r m/(7 f N)."""
    f, w0, dt = 0.25, 0.01 / radius**2, 0.05 * radius**2  # as many steps for either
    params = unit_params(platen_friction=f, damping=Dashpot(0.3))
    params, network, state = bearing(params, 0, np.zeros((3, 1)), [[0.0], [w0], [0.0]], radius)
    time = 2 * w0 * radius * radius**3 / (7 * f * PUSH)
    states = record(params, network, no_load(network), dt, state, round(1.2 * time / dt))
    along, turning = np.asarray(states.velocity.x)[:, 0], np.asarray(states.spin.y)[:, 0]
    assert np.flatnonzero(radius * turning - along < 1e-4 * w0)[0] * dt == pytest.approx(time, rel=1e-3)
    assert along[-1] == pytest.approx(2 / 7 * w0 * radius, rel=1e-4)
    assert turning[-1] * radius == pytest.approx(along[-1], rel=1e-4)


def between(params, velocity, spin):
    """A ball that both platens press with N."""
    depth = indented(params)
    place = [[0.3], [-0.2], [1.0 - depth]]
    return few_balls(params, place, velocity, spin, platens=(0, 2 - 2 * depth))


@BOTH_LAWS
def test_two_platens_stop_a_ball_that_cannot_roll(make):
    """Their moments cancel: 2 f N slow it down, and it stays where it stops. Spun about a horizontal axis their forces
    cancel: 5 f N/m slow the spin. Spun about the vertical nothing slips."""
    f, v0, dt = 0.3, 0.01, 0.05
    params = make(platen_friction=f, damping=Dashpot(0.3))
    network, state = between(params, v0 * DIRECTION[:, None], np.zeros((3, 1)))
    stop = v0 / (2 * f * PUSH)
    half = run(params, network, no_load(network), dt, round(0.5 * stop / dt), state)
    end = run(params, network, no_load(network), dt, round(1.5 * stop / dt), state)
    np.testing.assert_allclose(np.asarray(half.velocity)[:, 0], 0.5 * v0 * DIRECTION, rtol=1e-3, atol=1e-16)
    np.testing.assert_allclose(np.asarray(end.velocity), 0, atol=1e-4 * v0)
    np.testing.assert_allclose(np.asarray(end.displacement)[:, 0], 0.5 * v0 * stop * DIRECTION, rtol=2e-3, atol=1e-12)
    np.testing.assert_allclose(np.asarray(end.spin), 0, atol=1e-14)

    spin = v0 * (DIRECTION + np.array([0, 0, 0.5]))[:, None]
    network, state = between(params, np.zeros((3, 1)), spin)
    stop = v0 / (5 * f * PUSH)
    half = run(params, network, no_load(network), dt, round(0.5 * stop / dt), state)
    end = run(params, network, no_load(network), dt, round(1.5 * stop / dt), state)
    np.testing.assert_allclose(np.asarray(half.spin)[:, 0], v0 * (0.5 * DIRECTION + [0, 0, 0.5]), rtol=2e-3)
    np.testing.assert_allclose(np.asarray(end.spin)[:, 0], [0, 0, 0.5 * v0], atol=1e-4 * v0)
    np.testing.assert_allclose(np.asarray(end.velocity), 0, atol=1e-14)


@BOTH_LAWS
@pytest.mark.parametrize("f", [0.3, INF])
def test_a_pushed_ball_sticks_up_to_twice_f_n_and_slides_above(make, f):
    """Held by the two springs, F/(2 ks) away, and by any force where it is glued; else (F - 2 f N)/m."""
    params = make(platen_friction=f, damping=Dashpot(0.3))
    network, state = between(params, np.zeros((3, 1)), np.zeros((3, 1)))
    depth = indented(params)
    shear = 0.8 if depth == PUSH else params.material.moduli[1] * depth**0.5
    for share in (0.5, 0.95, 1.05, 30.0):
        force = share * 2 * 0.3 * PUSH
        end = state
        for part in (0.5, 0.8, 0.95, 1.0):  # put on by and by, so that no swing goes beyond what sticks
            load = constant_load([[part * force], [0.0]])
            end = run(params, network, load, 0.05, 2000, end)
        if share < 1 or f == INF:
            assert float(end.displacement.x[0]) == pytest.approx(force / (2 * shear), rel=1e-6)
            assert abs(float(end.velocity.x[0])) < 1e-6 * force
        else:
            later = run(params, network, load, 0.05, 400, end)
            acceleration = float(later.velocity.x[0] - end.velocity.x[0]) / 20.0
            assert acceleration == pytest.approx(force - 2 * f * PUSH, rel=1e-6)


@BOTH_LAWS
def test_what_a_platen_holds_is_what_moves_the_ball(make):
    """Force and moment on the ball are those at its two contacts, at any state; none exceeds f times the push."""
    params = make(platen_friction=0.3, damping=Dashpot(0.1))
    network, state = between(params, [[3e-3], [-2e-3], [1e-6]], [[1e-3], [5e-4], [2e-3]])
    state = run(params, network, no_load(network), 0.05, 60, state)
    found = all_forces(SCENE, params, network, no_load(network), 0.05, state)
    normal, sideways = held(params, network, state)
    arms = [np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])]  # to where the platens touch
    pushes = [[0, 0, normal[0, 0]] - sideways[0, :, 0], [0, 0, -normal[1, 0]] - sideways[1, :, 0]]
    np.testing.assert_allclose(np.asarray(found.resultant)[:, 0], sum(pushes), rtol=1e-12)
    moment = sum(np.cross(arm, push) for arm, push in zip(arms, pushes, strict=True))
    np.testing.assert_allclose(np.asarray(found.moment)[:, 0], moment, rtol=1e-12, atol=1e-18)
    assert np.linalg.norm(sideways[:, :, 0], axis=1) == pytest.approx(0.3 * normal[:, 0], rel=1e-12), "both slide"
    assert np.abs(sideways[:, 2]).max() == 0


@BOTH_LAWS
@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_gross_sliding_impact_on_a_platen(make, beta):
    """f(1+e)v of tangential speed and 5f(1+e)v/(2r) of spin change hands; once apart no spring is left."""
    f, v = 0.2, 1e-3
    params = make(platen_friction=f, damping=Dashpot(beta))
    e = float(dashpot_restitution(beta))
    lost, gained, least = (float(x) for x in gross_sliding_impact(f, e, v, 1.0))
    duration = 4.0 if make is unit_params else 1.5 * float(hertz_impact_duration(v, 1.0, 1.0, 1.0))
    network, state = few_balls(
        params, [[0.0], [0.0], [1 + 1e-6]], [[3 * least], [0], [-v]], np.zeros((3, 1)), platens=(0, 10)
    )
    end = run(params, network, no_load(network), duration / 4000, 4000, state)
    assert float(end.velocity.z[0]) == pytest.approx(e * v, rel=1e-3)
    assert 3 * least - float(end.velocity.x[0]) == pytest.approx(lost, rel=1e-3)
    assert float(end.spin.y[0]) == pytest.approx(gained, rel=1e-3)
    assert all((np.asarray(spring) == 0).all() for spring in end.memory[1].ball)


@pytest.mark.parametrize("ratio", [2 / 7, 0.8])
def test_sticking_impact_on_a_glued_platen(ratio):
    """The surface velocity is turned round: cos(pi sqrt(3.5 ks/kn)) of it is left."""
    v = 1e-3
    params = unit_params(platen_friction=INF, shear_stiffness=ratio)
    network, state = few_balls(
        params, [[0.0], [0.0], [1 + 1e-4]], [[0.3 * v], [0], [-v]], [[0], [-0.2 * v], [0]], platens=(0, 10)
    )
    end = run(params, network, no_load(network), 1e-3, 3600, state)
    surface = float(end.velocity.x[0] - end.spin.y[0]) / (0.5 * v)
    assert surface == pytest.approx(float(sticking_velocity_ratio(ratio)), abs=1e-6 if ratio == 2 / 7 else 2e-3)


# Their energy.


def test_friction_of_a_platen_takes_a_seventh_of_m_v_squared_until_the_ball_rolls():
    f, v0 = 0.3, 0.01
    params, network, state = bearing(unit_params(platen_friction=f), 0, v0 * DIRECTION[:, None], np.zeros((3, 1)))
    duration = 1.2 * float(slide_to_roll(v0, f, PUSH)[0])
    _, start, end = balances(still, params, network, no_load(network), 0.05, round(duration / 0.05), state)
    change = spent(start, end)
    assert change.friction == pytest.approx(v0**2 / 7, rel=1e-3)
    assert change.translation + change.spin == pytest.approx(-(v0**2) / 7, rel=1e-3)
    assert abs(change.unaccounted) < 1e-12 * v0**2
    assert change.platen_work == 0 and abs(change.damping) < 1e-20


def rattling(params):
    """A ball that slides, sticks, spins and is squeezed by platens that close."""
    place, platens = [[0.3], [-0.2], [0.98]], (0, 1.95)
    return few_balls(params, place, [[0.01], [-0.02], [0.005]], [[0.02], [0.01], [0.005]], platens=platens)


@pytest.mark.parametrize("damping", [None, Dashpot(0.1), LocalDamping(0.3)])
@pytest.mark.parametrize("f", [0.3, INF])
def test_ledger_closes_to_rounding_between_rough_platens(damping, f):
    """Linear springs, that neither open nor turn: no term is an estimate."""
    params = unit_params(platen_friction=f, damping=damping, platen_speed=1e-4)
    network, state = rattling(params)
    _, start, end = balances(closing, params, network, no_load(network), 0.1, 400, state)
    change = spent(start, end)
    assert change.platen_work > 1e-4
    assert (change.friction > 1e-5) if f == 0.3 else (abs(change.friction) < 1e-15)
    assert (change.damping > 1e-6) == (damping is not None)
    assert abs(change.unaccounted) < 1e-11 * change.platen_work


@pytest.mark.parametrize("damping", [None, Dashpot(0.1)])
@pytest.mark.parametrize("f", [0.05, INF])
def test_ledger_closes_to_a_millionth_between_rough_hertzian_platens(damping, f):
    """At second order in the step; what the tangential springs lose by the change of contact radius is booked."""
    params = hertz_params(platen_friction=f, damping=damping, platen_speed=1e-4)
    network, state = rattling(params)
    missing = []
    for dt in (0.04, 0.02, 0.01, 0.005):
        _, start, end = balances(closing, params, network, no_load(network), dt, round(40 / dt), state)
        change = spent(start, end)
        missing.append(abs(change.unaccounted) / change.platen_work)
        assert change.friction > 1e-6
    assert missing[-1] < 1e-6
    assert missing[-1] < 0.1 * missing[0]


# In sectors and whole tests.


def test_an_image_on_a_rough_platen_is_held_as_the_ball_itself():
    """The forces on a turned copy are the turned forces; a ball on the axis is neither pushed aside nor tilted."""
    sector = Sector(4)
    place = np.array([[3.0, 0.0], [1.0, 0.0], [0.99, 0.99]])
    rng = np.random.default_rng(1)
    velocity, spin = rng.normal(size=(2, 3, 2)) * [[[1, 0], [1, 0], [1, 1]]]
    params = unit_params(platen_friction=0.3, damping=Dashpot(0.1))

    def forces(turns):
        turned = [sector.rotate(v, turns) for v in (place, velocity, spin)]
        network = build_contact_list(Specimen(turned[0], 1.0, 0.0, 1.98, np.ones(2, bool)), sector)
        state = initial_state(SCENE, params, network, [0.0, 1.98])
        state = state._replace(velocity=from_rows(turned[1]), spin=from_rows(turned[2]))
        made = all_forces(SCENE, params, network, no_load(network), 0.05, state)
        return [sector.rotate(np.asarray(v), -turns) for v in (made.resultant, made.moment)]

    own, image = forces(np.array([0, 0])), forces(np.array([3, 0]))
    for one, other in zip(own, image, strict=True):
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-14)
        assert np.abs(one[:2, 0]).min() > 1e-4 and (one[:2, 1] == 0).all()


@pytest.fixture(scope="module")
def rough():
    """Curve of a small test between rough platens, and its tangent, as a function of their friction."""
    test = TriaxialTest(
        fcc_octagon(layers=5, half_width=3), Sector(4), params=Params(platen_friction=0.2), axial_strain=0.001,
        record_every=20, tolerance=1e-5,
    )  # fmt: skip
    return jit(lambda f: jax.jvp(lambda f: test.simulate(replace(test.params, platen_friction=f)), (f,), (1.0,)))


def test_tangent_with_respect_to_platen_friction_agrees_with_differences(rough):
    """Of the stress ratio of a whole test, from its middle on."""
    h = 1e-5
    slope, more, less = rough(0.2)[1].stress_ratio[10:], *(rough(0.2 + d)[0].stress_ratio[10:] for d in (h, -h))
    assert np.abs(slope).max() > 0.01, "platen friction matters"
    np.testing.assert_allclose(slope, (more - less) / (2 * h), rtol=1e-3, atol=1e-5)


def test_the_shear_starts_from_the_balance_of_the_confinement(rough):
    """What rough platens held at its end they hold on."""
    assert float(rough(0.2)[0].unbalanced_force[0]) < 1e-4


def test_platens_without_friction_are_smooth_to_the_last_bit():
    """A coefficient of zero is none; the further springs and terms take nothing from the old numbers."""
    params = unit_params(friction=0.3, damping=Dashpot(0.1))
    place = [[0, 1.2, 0.1], [0, 0.3, -0.2], [0.99, 2.5, 4.3]]
    rng = np.random.default_rng(2)
    ends = []
    velocity, spin = 0.02 * rng.normal(size=(2, 3, 3))
    for more in (params, replace(params, platen_friction=0.0)):
        network, state = few_balls(more, place, velocity, spin, platens=(0, 5.25), largest_overlap=0.1)
        ends.append(run(more, network, no_load(network), 0.1, 300, state))
    for name in ("displacement", "velocity", "spin", "spring"):
        np.testing.assert_array_equal(*(np.asarray(getattr(end, name)) for end in ends), err_msg=name)
