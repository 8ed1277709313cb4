"""One contact and few balls against the closed forms of axijax.theory.

Units: ball radius, mass and normal stiffness 1 (see few_balls.py). Impacts are those of Chung & Ooi (2011), tests 3 to
8, for a linear contact law.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import FAR, PLANE, constant_load, few_balls, jit, no_load, order_of, record, run, unit_params
from scipy.spatial.transform import Rotation

from axijax import Dashpot, LocalDamping
from axijax.core.vector import from_rows, zeros
from axijax.mechanics.contacts import Law, contact_forces
from axijax.theory import (
    dashpot_duration,
    dashpot_restitution,
    gross_sliding_impact,
    impact_duration,
    impact_maximum_overlap,
    incline_accelerations,
    local_damping_restitution,
    slide_to_roll,
    sticking_velocity_ratio,
)

SPEED = 1e-3


def dashpots(beta):
    return Dashpot(beta) if beta else None


def against_plane(params, normal_speed, tangential_speed=0.0, spin=0.0, gap=1e-4):
    """A ball that flies at a plane whose normal is x, tangentially along y, spinning about z."""
    place = [[0.0, PLANE + 1 + gap], [0, 0], [0, 0]]
    velocity = [[0, -normal_speed], [0, tangential_speed], [0, 0]]
    return few_balls(params, place, velocity, [[0, 0], [0, 0], [0, spin]], radius=np.array([PLANE, 1.0]))


def after_impact(params, dt, time, **how):
    """(normal speed away from the plane, tangential speed, spin) of a ball after its impact on a plane."""
    network, state = against_plane(params, SPEED, **how)
    state = run(params, network, no_load(network), dt, round(time / dt), state)
    _, _, overlap = overlaps(network, state)
    assert overlap[0] < 0, "the impact must be over"
    return float(state.velocity.x[1]), float(state.velocity.y[1]), 0.0 if state.spin is None else float(state.spin.z[1])


def overlaps(network, state):
    """Normals (3, ..., C), branch lengths and overlaps (..., C) of the real contacts, in double precision."""
    real = np.asarray(network.image) >= 0
    moved = np.asarray(state.displacement)
    change = moved[..., np.asarray(network.first)[real]] - moved[..., np.asarray(network.second)[real]]
    branch = np.asarray(network.branch)[:, real]
    branch = branch.reshape(3, *(1,) * (change.ndim - 2), -1)
    distance = np.linalg.norm(branch, axis=0)
    longer = (2 * (branch * change).sum(0) + (change**2).sum(0)) / (np.linalg.norm(branch + change, axis=0) + distance)
    return (branch + change) / (distance + longer), distance + longer, np.asarray(network.overlap)[real] - longer


# Normal impact.


@pytest.mark.parametrize("radius", [1.0, 2.0])
def test_normal_impact_lasts_and_presses_as_the_closed_form_says(radius):
    """Two balls, the second of radius 1 or 2: time in contact, greatest overlap, speed restored."""
    params, dt = unit_params(friction=None), 5e-3
    gap = 1.234e-4
    network, state = few_balls(
        params, [[0, 1 + radius + gap], [0, 0], [0, 0]], [[0, -SPEED], [0, 0], [0, 0]], radius=np.array([1.0, radius])
    )
    reduced = radius**3 / (1 + radius**3)
    states = record(params, network, no_load(network), dt, state, 1200)
    overlap = overlaps(network, states)[2][:, 0]
    closing = np.asarray(states.velocity.x[:, 0] - states.velocity.x[:, 1])
    assert overlap.max() == pytest.approx(float(impact_maximum_overlap(SPEED, reduced, 1.0)), rel=1e-4)
    assert closing[-1] == pytest.approx(-SPEED, rel=1e-4)
    # Apart they fly freely: the last overlap and speed tell when they parted.
    parted = 1200 * dt - overlap[-1] / closing[-1]
    assert parted - gap / SPEED == pytest.approx(float(impact_duration(reduced, 1.0)), rel=1e-4)
    momentum = np.asarray(states.velocity.x[-1]) @ np.array([1, radius**3])
    assert momentum == pytest.approx(-SPEED * radius**3, rel=1e-13)


PHASES = (np.arange(8) + 0.5) / 8


def impacts_at_all_phases(params, dt, duration):
    """Speeds restored (8,) and largest overlaps (8,), over what is expected without damping, of pairs that meet at
    eight places within a step."""
    count = PHASES.size
    gap = SPEED * dt * (1 + PHASES)
    nought, up = np.zeros(count), 10.0 * np.arange(count)
    place = [np.append(2 + gap, nought), np.zeros(2 * count), np.append(up, up)]
    velocity = [np.append(nought - SPEED, nought), np.zeros(2 * count), np.zeros(2 * count)]
    network, state = few_balls(params, place, velocity)
    states = record(params, network, no_load(network), dt, state, round((duration + 4 * dt) / dt))
    speed = np.asarray(states.velocity.x[-1])
    largest = overlaps(network, states)[2].max(axis=0)
    return (speed[:count] - speed[count:]) / SPEED, largest / float(impact_maximum_overlap(SPEED, 0.5, 1.0))


@pytest.mark.parametrize("beta", [0.05, 0.3, 1.0, 1.5])
def test_dashpots_that_never_pull_restore_the_closed_form(beta):
    """Restitution and time pressed with dashpots clamped at zero force. A dashpot's force jumps to c v in the midst of
    a step, so the worst error falls at first order; the mean over where the contact begins is nearer."""
    params = unit_params(friction=None, damping=Dashpot(beta))
    duration = float(dashpot_duration(beta, 0.5, 1.0))
    steps = duration / (np.array([100, 200, 400]) + 0.5)
    errors = []
    for dt in steps:
        restored, _ = impacts_at_all_phases(params, dt, duration)
        errors.append(np.abs(restored - float(dashpot_restitution(beta))).max())
        assert restored.mean() == pytest.approx(float(dashpot_restitution(beta)), abs=0.15 * dt)
    assert errors[-1] < 0.3 * steps[-1]
    assert order_of(steps, errors) == pytest.approx(1.0, abs=0.1)
    network, state = few_balls(params, [[0, 2 + 1e-5], [0, 0], [0, 0]], [[0, -SPEED], [0, 0], [0, 0]])
    states = record(params, network, no_load(network), steps[0], state, 200)
    pressed = (np.diff(np.asarray(states.velocity.x[:, 0])) != 0).sum() * steps[0]
    assert pressed == pytest.approx(duration, abs=2 * steps[0])


@pytest.mark.parametrize("friction", [0.3, None])
@pytest.mark.parametrize("beta", [0.1, 0.3])
def test_dashpots_of_platens_and_planes_restore_the_closed_form(beta, friction):
    """The same e for a ball on a platen, whose dashpot has the ball's whole mass, and on a ball that is a plane."""
    params, dt = unit_params(friction=friction, damping=Dashpot(beta)), 1e-3
    expected = float(dashpot_restitution(beta))
    network, state = few_balls(params, [[0.3], [0.4], [1 + 1e-4]], [[0], [0], [-SPEED]], platens=(0, 1e3))
    end = run(params, network, no_load(network), dt, 4000, state)
    assert float(end.velocity.z[0]) / SPEED == pytest.approx(expected, rel=1e-3)
    assert after_impact(params, dt, 4.0)[0] / SPEED == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("a", [0.3, 0.7])
def test_local_damping_along_z_restores_the_closed_form(a):
    """e = sqrt((1-a)/(1+a)): a ball on a platen, and two balls that meet with opposite speeds."""
    params, dt = unit_params(friction=None, damping=LocalDamping(a)), 2e-3
    expected = float(local_damping_restitution(a))
    network, state = few_balls(params, [[0.3], [0.4], [1 + 1e-4]], [[0], [0], [-SPEED]], platens=(0, 1e3))
    end = run(params, network, no_load(network), dt, 5000, state)
    assert float(end.velocity.z[0]) / SPEED == pytest.approx(expected, rel=1e-3)
    network, state = few_balls(params, [[0, 0], [0, 0], [0, 2 + 1e-4]], [[0, 0], [0, 0], [SPEED, -SPEED]])
    end = run(params, network, no_load(network), dt, 5000, state)
    np.testing.assert_allclose(np.asarray(end.velocity.z) / SPEED, [-expected, expected], rtol=1e-3)


def test_undamped_impact_converges_at_second_order():
    """Speed restored and greatest overlap; the worst over where in a step the contact begins."""
    duration = float(impact_duration(0.5, 1.0))
    # Each of these steps ends the contact at the same place within it.
    steps, errors = duration / (np.array([10, 20, 40, 80]) + 0.5), []
    for dt in steps:
        found = impacts_at_all_phases(unit_params(friction=None), dt, duration)
        errors.append([np.abs(ratios - 1).max() for ratios in found])
    speed_errors, overlap_errors = np.transpose(errors)
    assert speed_errors[-1] < 0.3 * steps[-1] ** 2
    assert order_of(steps, speed_errors) == pytest.approx(2.0, abs=0.1)
    assert order_of(steps, overlap_errors) == pytest.approx(2.0, abs=0.1)


# Oblique impact on a plane, and between balls.


@pytest.mark.parametrize("ratio", [2 / 7, 0.5, 0.8, 1.0])
def test_sticking_impact_turns_the_surface_velocity_round(ratio):
    """Surface velocity after over before, cos(pi sqrt(3.5 ks/kn)): exactly -1 at ks/kn = 2/7."""
    params = unit_params(shear_stiffness=ratio, friction=1e4)
    _, v, w = after_impact(params, 1e-3, 3.6, tangential_speed=0.3 * SPEED, spin=-0.2 * SPEED)
    # Where the spring is still stretched as they part, its force ends within a step: first order.
    tolerance = 1e-6 if ratio == 2 / 7 else 2e-3
    assert (v - w) / (0.5 * SPEED) == pytest.approx(float(sticking_velocity_ratio(ratio)), abs=tolerance)
    # The impulse acts at the contact: angular momentum about it does not change.
    assert v + 0.4 * w == pytest.approx((0.3 - 0.08) * SPEED, rel=1e-5)


def test_sticking_impact_converges_at_second_order():
    """ks/kn = 2/7; the worst over where in a step the contact begins."""
    params = unit_params(shear_stiffness=2 / 7, friction=1e4)
    steps, errors = 0.2 / 2.0 ** np.arange(4), []
    for dt in steps:
        found = [
            after_impact(params, dt, 4.0, tangential_speed=SPEED, gap=SPEED * dt * (1 + phase))
            for phase in np.linspace(0, 1, 9)[:-1]
        ]
        errors.append(max(abs((v - w) / SPEED + 1) for _, v, w in found))
    assert order_of(steps, errors) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("beta", [0.0, 0.1])
@pytest.mark.parametrize("tangential_speed, spin", [(5.0, 0.0), (-5.0, 0.0), (20.0, 3.0), (0.0, 6.0), (0.0, -6.0)])
def test_gross_sliding_impact_on_a_plane(beta, tangential_speed, spin):
    """Chung & Ooi 4, 5 (tangential speed) and 6 (spin only): f(1+e)v of tangential speed and 5f(1+e)v/(2r) of spin
    change hands, e being what the impact itself restored."""
    f, dt = 0.3, 1e-3
    params = unit_params(friction=f, damping=dashpots(beta))
    start = {"tangential_speed": tangential_speed * SPEED, "spin": spin * SPEED}
    u, v, w = after_impact(params, dt, 4.0, **start)
    e = u / SPEED
    assert e == pytest.approx(float(dashpot_restitution(beta)), rel=2e-4)
    lost, gained, least = map(float, gross_sliding_impact(f, e, SPEED, 1.0))
    sense = np.sign(tangential_speed - spin)
    assert abs(tangential_speed - spin) * SPEED > least
    assert v - start["tangential_speed"] == pytest.approx(-sense * lost, rel=1e-5)
    assert w - start["spin"] == pytest.approx(sense * gained, rel=1e-5)


def test_sliding_ends_at_the_least_speed_of_the_closed_form():
    """A surface speed of 3.5 f(1+e)v slides to the end; just below it the last part sticks and less is lost."""
    f = 0.1
    params = unit_params(friction=f, shear_stiffness=50.0)  # stiff, so that it sticks where it no longer slides
    lost, _, least = map(float, gross_sliding_impact(f, 1.0, SPEED, 1.0))
    _, above, _ = after_impact(params, 1e-3, 4.0, tangential_speed=1.02 * least)
    _, below, _ = after_impact(params, 1e-3, 4.0, tangential_speed=0.9 * least)
    assert 1.02 * least - above == pytest.approx(lost, rel=1e-5)
    assert 0.9 * least - below < 0.93 * lost


def spinning_pair(params, radius, spins):
    """Two balls, the second of this radius, that meet head-on along x spinning about z; velocities and spins after."""
    network, state = few_balls(
        params,
        [[0, 1 + radius + 1e-5], [0, 0], [0, 0]],
        [[SPEED, -SPEED], [0, 0], [0, 0]],
        [[0, 0], [0, 0], spins],
        radius=np.array([1.0, radius]),
    )
    state = run(params, network, no_load(network), 1e-3, 6000, state)
    assert overlaps(network, state)[2][0] < 0, "the impact must be over"
    return np.asarray(state.velocity), np.asarray(state.spin)[2]


@pytest.mark.parametrize("radius", [1.0, 2.0])
@pytest.mark.parametrize("friction", [0.3, 1e3])
@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_balls_whose_surfaces_roll_on_each_other_feel_no_friction(radius, friction, beta):
    """Chung & Ooi 7 and 8 with equal and opposite surface speeds: nothing tangential changes, not even by rounding."""
    params = unit_params(friction=friction, damping=dashpots(beta))
    spins = np.array([0.05, -0.05 / radius])
    velocity, spin = spinning_pair(params, radius, spins)
    assert velocity[0, 0] < SPEED, "they must have met"
    np.testing.assert_allclose(velocity[1:], 0, atol=1e-18)
    np.testing.assert_allclose(spin, spins, rtol=1e-14)


@pytest.mark.parametrize("radius", [1.0, 2.0])
@pytest.mark.parametrize("spins", [(0.05, 0.05), (0.05, 0.0), (-0.05, -0.02)])
def test_spinning_balls_in_gross_sliding(radius, spins):
    """Chung & Ooi 7 and 8: the tangential impulse is f times the normal one, 2 m* v (1+e), on either ball."""
    f = 0.2
    velocity, spin = spinning_pair(unit_params(friction=f), radius, spins)
    mass = np.array([1.0, radius**3])
    normal_impulse = 2 * SPEED * 2 * mass[1] / mass.sum()
    assert velocity[0, 1] - velocity[0, 0] == pytest.approx(2 * SPEED, rel=1e-4)
    sense = np.sign(spins[0] + radius * spins[1])  # of the surfaces' slip
    impulse = sense * f * normal_impulse
    # A positive spin moves the contact point of ball 0 up; held back there, the ball is pushed down, its spin slowed.
    np.testing.assert_allclose(velocity[1] * mass, [-impulse, impulse], rtol=2e-3)
    slowed = 2.5 * impulse / (mass * np.array([1.0, radius]))
    np.testing.assert_allclose(np.array(spins) - spin, slowed, rtol=2e-3)


# Planes under gravity.


@pytest.mark.parametrize("friction, rolls", [(0.5, True), (0.17, True), (0.16, False), (0.1, False), (0.0, False)])
def test_ball_on_an_incline(friction, rolls):
    """tan b = 0.577: the ball rolls for f > 0.165 with 5/7 g sin b, else it slides."""
    angle, gravity, dt = np.pi / 6, 1e-4, 0.1
    params = unit_params(friction=friction, damping=Dashpot(0.3))
    network, state = against_plane(params, 0.0, gap=-gravity * np.cos(angle))
    load = constant_load([[0, -gravity * np.cos(angle)], [0, gravity * np.sin(angle)]])
    half = run(params, network, load, dt, 3000, state)
    end = run(params, network, load, dt, 3000, half)
    acceleration = float(end.velocity.y[1] - half.velocity.y[1]) / 300
    spin_up = float(end.spin.z[1] - half.spin.z[1]) / 300
    expected = [float(value) for value in incline_accelerations(angle, friction, gravity, 1.0)]
    assert (np.tan(angle) < 3.5 * friction) == rolls
    np.testing.assert_allclose([acceleration, spin_up], expected, rtol=1e-4, atol=1e-12)
    assert (abs(float(end.velocity.y[1] - end.spin.z[1])) < 1e-6 * gravity * 600) == rolls


@pytest.mark.parametrize("backspin", [0.0, 0.5])
def test_sliding_ball_begins_to_roll(backspin):
    """5/7 of the speed is left, at 2 v0/(7 f g), after 12 v0^2/(49 f g); with backspin w the slip v0 + w r counts."""
    f, gravity, v0, dt = 0.25, 1e-4, 0.01, 0.05
    params = unit_params(friction=f, damping=Dashpot(0.3))
    network, state = against_plane(params, 0.0, v0, -backspin * v0, gap=-gravity)
    load = constant_load([[0, -gravity], [0, 0]])
    time, speed, distance = (float(value) for value in slide_to_roll(v0, f, gravity))
    time *= 1 + backspin
    states = record(params, network, load, dt, state, round(1.5 * time / dt))
    velocity, place = np.asarray(states.velocity.y[:, 1]), np.asarray(states.displacement.y[:, 1])
    slip = velocity - np.asarray(states.spin.z[:, 1])
    rolling = np.flatnonzero(slip < 1e-4 * v0)[0]
    assert rolling * dt == pytest.approx(time, rel=1e-3)
    assert velocity[-1] == pytest.approx(speed - 2 / 7 * backspin * v0, rel=1e-4)
    if backspin == 0:
        assert place[rolling] == pytest.approx(distance, rel=1e-3)
    np.testing.assert_allclose(slip[rolling + 200 :], 0, atol=1e-5 * v0)


@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_ball_falls_and_bounces(beta):
    """A parabola down from rest, exactly; on the plane e of the closed form; a parabola up to e^2 h."""
    gravity, height, dt = 1e-6, 0.5, 0.02
    params = unit_params(friction=None, damping=Dashpot(beta))
    network, state = against_plane(params, gap=height, normal_speed=-gravity * dt / 2)  # at rest half a step later
    load = constant_load([[0, -gravity], [0, 0]])
    fall = np.sqrt(2 * height / gravity)
    count = round(0.99 * fall / dt)
    lower = run(params, network, load, dt, count, state)
    assert float(lower.displacement.x[1]) == pytest.approx(-0.5 * gravity * (count * dt) ** 2, rel=1e-9)
    e = float(dashpot_restitution(beta))
    top = run(params, network, load, dt, round((fall * (1 + e) + 3) / dt) - count, lower)
    # Gravity adds a share of g sqrt(m/k)/v = 1e-3 to the contact's force, the step its error in the dashpot.
    assert height + float(top.displacement.x[1]) == pytest.approx(e**2 * height, rel=4e-3 if beta else 1e-4)
    assert abs(float(top.velocity.x[1])) < 5e-3 * gravity * fall


# Two stacked balls.


def test_stacked_balls_between_platens_vibrate_in_their_two_modes():
    """Equal springs: omega^2 = k/m in phase and 3k/m against each other, at second order."""
    params = unit_params(friction=None)
    squeeze, amplitude = 0.03, np.array([1e-3, 2e-3])
    place = np.array([[0, 0], [0, 0], [1.0 - squeeze / 3, 3.0 - 2 * squeeze / 3]])
    omega = np.array([1.0, np.sqrt(3.0)])
    shape = np.array([[1, 1], [1, -1]])

    def exact(t):
        return amplitude * np.cos(omega * t) @ shape, -amplitude * omega * np.sin(omega * t) @ shape

    steps, errors = 0.2 / 2.0 ** np.arange(4), []
    for dt in steps:
        start = exact(0.0)[0]
        # The velocity half a step before, from rest at the start: minus half a step of the acceleration.
        before = 0.5 * dt * amplitude * omega**2 @ shape
        network, state = few_balls(
            params, place + np.array([[0, 0], [0, 0], start]), [[0, 0], [0, 0], before], platens=(0, 4 - squeeze)
        )
        end = run(params, network, no_load(network), dt, round(10 / dt), state)
        found = np.asarray(network.positions.z + end.displacement.z) - place[2]
        errors.append(np.abs(found - exact(10.0)[0]).max() / amplitude.max())
    assert errors[-1] < 1e-2
    assert order_of(steps, errors) == pytest.approx(2.0, abs=0.1)


def test_stacked_balls_settle_under_gravity_between_planes():
    """Overlaps at rest: squeeze/3 in the middle, m g/k more below and less above."""
    params = unit_params(friction=None, damping=Dashpot(0.3))
    squeeze, gravity = 0.03, 1e-3
    place = np.array([[0, PLANE + 1, PLANE + 3, 2 * PLANE + 4 - squeeze], np.zeros(4), np.zeros(4)])
    place[0, 1:3] -= squeeze / 2
    network, state = few_balls(
        params, place, np.zeros((3, 4)), radius=np.array([PLANE, 1.0, 1.0, PLANE]), largest_overlap=0.05
    )
    load = constant_load([[0, -gravity, -gravity, 0], [0, 0, 0, 0]])
    state = run(params, network, load, 0.1, 2000, state)
    assert np.asarray(network.first)[:3].tolist() == [0, 1, 2] and np.asarray(network.second)[:3].tolist() == [1, 2, 3]
    np.testing.assert_allclose(overlaps(network, state)[2], squeeze / 3 + gravity * np.array([1, 0, -1]), rtol=1e-7)


# The tangential spring around a closed way.


@jit
def work_along(law, network, way):
    """Work that the contact of two balls takes, and its forces (T,), while ball 0 is moved along a way (3, T)."""

    def move(carry, there):
        here, spring, force = carry
        moved = from_rows([jnp.stack([there[i], jnp.zeros(())]) for i in range(3)])
        velocity = from_rows([jnp.stack([there[i] - here[i], jnp.zeros(())]) for i in range(3)])
        now = contact_forces(law, network, 1.0, moved, velocity, None, spring)
        new = jnp.stack([component[0] for component in now.force])
        return (there, now.spring, new), (-0.5 * (force + new) @ (there - here), new)

    start = way[:, 0]
    still = zeros((2,), way.dtype)
    moved = from_rows([still.x.at[0].set(start[i]) for i in range(3)])
    none = zeros(network.first.shape, way.dtype)
    at_rest = contact_forces(law, network, 1.0, moved, still, None, none)
    force = jnp.stack([component[0] for component in at_rest.force])
    _, (work, forces) = jax.lax.scan(move, (start, none, force), way.T[1:])
    return work.sum(), forces.T, force


def pressed_contact(friction):
    """A ball on a plane whose normal is x, pressed in by 0.01: contact list and law."""
    positions = [[PLANE + 0.99, 0.0], [0, 0], [0, 0]]
    network, _ = few_balls(unit_params(), positions, np.zeros((3, 2)), radius=np.array([1.0, PLANE]))
    return network, Law(1.0, 0.8, friction, None, None)


@pytest.mark.parametrize("turns", [1, 5])
def test_closed_tangential_way_that_sticks_costs_nothing(turns):
    """Around an ellipse in the contact plane, the overlap breathing: spring and force return, the work is zero."""
    network, law = pressed_contact(friction=10.0)
    t = np.linspace(0, 2 * np.pi * turns, 1000 * turns + 1)
    way = np.stack([1e-3 * np.sin(t), 2e-3 * (1 - np.cos(t)), 1e-3 * np.sin(t + 1) - 1e-3 * np.sin(1)])
    work, forces, start = work_along(law, network, jnp.asarray(way))
    scale = 0.8 * 2e-3**2
    assert np.abs(forces[1:]).max() > 2e-3
    np.testing.assert_allclose(forces[:, -1], start, atol=1e-8)
    assert abs(float(work)) < 1e-5 * scale


def test_way_to_and_fro_with_slip_costs_the_area_of_the_loop():
    """Steady cycles of amplitude A: 4 f N (A - f N/ks) each."""
    f, amplitude, push = 0.2, 8e-3, 0.01
    network, law = pressed_contact(friction=f)
    t = np.linspace(0, 1, 8001)
    zigzag = amplitude * np.concatenate([t[::4], 1 - 2 * t[::2][1:], -1 + 2 * t[::2][1:]])

    def work(cycles):
        along = np.concatenate([zigzag] + [zigzag[2001:]] * (cycles - 1))
        return float(work_along(law, network, jnp.asarray(np.stack([0 * along, along, 0 * along])))[0])

    expected = 4 * f * push * (amplitude - f * push / 0.8)
    assert work(3) - work(2) == pytest.approx(expected, rel=1e-3)


def test_spring_turns_with_the_contact_plane():
    """A sheared pair turned rigidly, by 90 degrees about an axis across the line of centres: the force turns with it,
    with an error of at least first order in the turn of one step."""
    place = np.array([[0.99, -0.99], [0, 0], [0, 0]])
    network, _ = few_balls(unit_params(), place, np.zeros((3, 2)))
    law, axis = Law(1.0, 0.8, 10.0, None, None), np.array([0.0, 0.6, 0.8])
    sheared = 1e-3 * np.array([0.0, 1.0, -0.3])  # along the axis and across it
    move = jit(contact_forces)

    def turned(angle, vectors):
        return Rotation.from_rotvec(angle * axis).as_matrix() @ vectors

    def error(count):
        spring = from_rows(np.outer(sheared, np.arange(network.first.size) == 0))
        angle = np.pi / 2 / count
        surface_speed = from_rows(np.outer(angle * axis, [1.0, 1.0]))
        for i in range(count):
            before, now = turned(i * angle, place), turned((i + 1) * angle, place)
            made = move(law, network, 1.0, from_rows(now - place), from_rows(now - before), surface_speed, spring)
            spring = made.spring
        expected = turned(np.pi / 2, [0.02, 0, 0] - 0.8 * sheared)
        return np.abs(np.asarray(made.force)[:, 0] - expected).max()

    counts = [200, 400, 800]
    errors = [error(count) for count in counts]
    assert errors[-1] < 5e-3 * 0.8e-3
    assert order_of(counts, errors) < -0.9


# Energy.


@pytest.mark.parametrize("damping", [None, Dashpot(0.1), LocalDamping(0.5)])
@pytest.mark.parametrize("ratio", [0.2, 2 / 7, 0.8, 1.0])
def test_no_impact_gains_energy(damping, ratio):
    """From head-on to grazing, on a plane and on a ball, spinning or not, at two frictions: never more than before,
    beyond the integrator's error."""
    params, dt = unit_params(damping=damping), 0.02
    angles = np.deg2rad(np.concatenate([np.arange(0, 88, 4), [88, 89, 89.5, 89.9]]))
    spins = np.array([0.0, 2.0, -2.0]) * SPEED
    angle, spin = (values.ravel() for values in np.meshgrid(angles, spins))
    count = angle.size
    # Ball i of the first half flies at ball i of the second half, of radius 1 or 1.5; pairs are far apart in z.
    other = np.where(np.arange(count) % 2 == 0, 1.0, 1.5)
    height = 10.0 * np.arange(count)
    still = np.zeros(count)
    place = np.stack([np.concatenate([1 + other + 1e-6, still]), np.zeros(2 * count), np.concatenate([height, height])])
    # Along the line of centres by cos, across it by sin, half of it up.
    speed = SPEED * np.stack([-np.cos(angle), np.sin(angle) * np.sqrt(0.5), np.sin(angle) * np.sqrt(0.5)])
    velocity = np.concatenate([speed, np.zeros_like(speed)], axis=1)
    spin = np.stack([np.concatenate([spin * 0.3, -spin]), np.zeros(2 * count), np.concatenate([spin, 0.5 * spin])])
    radius = np.concatenate([np.ones(count), other])
    place[2] -= height.max() / 2
    network, state = few_balls(params, place, velocity, spin, radius=radius, platens=FAR)
    start = overlaps(network, state)[2]
    assert start.size == count and (start < 0).all()
    mass = radius**3

    def energy(state):
        speeds, rates = (np.asarray(v) for v in (state.velocity, state.spin))
        each = 0.5 * mass * ((speeds**2).sum(0) + 0.4 * radius**2 * (rates**2).sum(0))
        return each[:count] + each[count:]

    for friction in (0.1, 0.5):
        params = unit_params(friction=friction, shear_stiffness=ratio, damping=damping)
        after = run(params, network, no_load(network), dt, 3000, state)
        met = np.abs(np.asarray(after.velocity.x)[:count] - speed[0]) > 0
        parted = overlaps(network, after)[2] < 0
        assert met.sum() > 0.9 * count and parted.all()
        gain = energy(after) / energy(state) - 1
        assert gain.max() < (1e-4 if damping is None else 1e-5)
        assert gain.min() < -0.02
