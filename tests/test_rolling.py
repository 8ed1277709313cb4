"""Rolling and torsional resistance against the closed forms of two balls, and what every term must keep.

Units as in few_balls.py: radius, mass and normal stiffness 1, ks = 0.8. A pair lies along x, pressed together by PUSH;
its spins are about z (rolling) or about its normal x (torsion).
"""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import (
    PLANE,
    SCENE,
    UNIT_MASS,
    constant_load,
    few_balls,
    hertz_params,
    jit,
    no_load,
    record,
    run,
    still,
    unit_params,
)
from test_energy import balances, spent

from axijax import Dashpot, Hertz, LocalDamping, Rolling, Torsion
from axijax.core.sector import Sector
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.contact_list import build_contact_list, carry_memory
from axijax.mechanics.dynamics import all_forces, initial_state
from axijax.mechanics.gravity import Gravity
from axijax.mechanics.time_step import critical_time_step
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon

PUSH, KS = 1e-3, 0.8
NO_CAP = 1e6
BOTH_LAWS = pytest.mark.parametrize("make", [unit_params, hertz_params], ids=["linear", "hertz"])
BOTH_KINDS = pytest.mark.parametrize("kind", ["rolling", "torsion"])
forces_of = jit(all_forces, static_argnums=0)


def resisting(kind, stiffness, friction, make=unit_params, **changes):
    """Parameters with one of the two parts."""
    part = {"rolling": Rolling, "torsion": Torsion}[kind](stiffness, friction)
    return make(**{kind: part}, **changes)


def both(rolling, torsion, make=unit_params, **changes):
    return make(rolling=Rolling(*rolling), torsion=Torsion(*torsion), **changes)


def pressed_pair(params, first, second, push=PUSH):
    """Two equal balls pressed together by a constant force, with spins; contact list, state, load."""
    hertz = isinstance(params.material, Hertz)
    depth = (push / (4 / 3 * 0.5**0.5)) ** (2 / 3) if hertz else push
    place = [[-1 + depth / 2, 1 - depth / 2], [0, 0], [0, 0]]
    network, state = few_balls(params, place, np.zeros((3, 2)), np.transpose([first, second]))
    return network, state, constant_load([[push, -push], [0, 0]])


def about(kind, rate):
    """A spin that the part resists."""
    return np.array([0.0, 0.0, rate]) if kind == "rolling" else np.array([rate, 0.0, 0.0])


# Closed forms of a pair of equal balls.


@BOTH_KINDS
def test_opposite_spins_swing(kind):
    """omega0^2 = 2 kr/I = 5 alpha ks/m. The leapfrog's second difference of the spin is -(omega0 dt)^2 times it."""
    alpha, dt, w0 = 0.7, 0.1, 1e-4
    params = resisting(kind, alpha, NO_CAP)
    network, state, load = pressed_pair(params, about(kind, w0), about(kind, -w0))
    spin = np.asarray(record(params, network, load, dt, state, 300).spin)[2 if kind == "rolling" else 0]
    np.testing.assert_allclose(spin[:, 0], -spin[:, 1], atol=1e-12 * w0)
    expected = -(5 * alpha * KS) * dt**2 * spin[1:-1, 0]
    np.testing.assert_allclose(np.diff(spin[:, 0], 2), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert (np.diff(np.sign(spin[:, 0])) != 0).sum() >= 15, "it must swing"


@BOTH_KINDS
def test_past_the_cap_spins_fall_evenly(kind):
    """dw/dt = -2.5 eta N/(m r) of both balls."""
    eta, dt, w0 = 0.2, 0.1, 0.1
    params = resisting(kind, 0.7, eta)
    network, state, load = pressed_pair(params, about(kind, w0), about(kind, -w0))
    spin = np.asarray(record(params, network, load, dt, state, 400).spin)[2 if kind == "rolling" else 0]
    fall = np.diff(spin, axis=0)[5:] / dt
    assert spin[-1, 0] > 0
    np.testing.assert_allclose(fall, np.outer(np.ones(len(fall)), [-1, 1]) * 2.5 * eta * PUSH, rtol=1e-9)


def test_equal_spins_and_the_other_part_make_no_moment():
    """Neither for balls that turn alike; rolling does not resist torsion, nor the reverse."""
    params = both((0.7, 0.2), (0.7, 0.2))
    for kind in ("rolling", "torsion"):
        for first, second in ((0.1, -0.1), (0.1, 0.1)):
            network, state, load = pressed_pair(params, about(kind, first), about(kind, second))
            pushes = forces_of(SCENE, params, network, load, 0.1, state).pushes
            found = [np.abs(np.asarray(push.moment)).max() for push in pushes[3:]]
            expected = [0.2 * PUSH * (part == kind and first != second) for part in ("rolling", "torsion")]
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-16)


@jit
def _led(params, network, state, way, dt):
    def one(state, rows):
        now, before = rows

        def first_ball(*vector):
            return Vector(*(jnp.stack([component, jnp.zeros(())]) for component in vector))

        state = state._replace(
            displacement=first_ball(now[0] - way[0, 0], *jnp.zeros(2)),
            velocity=first_ball((now[0] - before[0]) / dt, *jnp.zeros(2)),
            spin=first_ball(*(now[1:] - before[1:]) / dt),
        )
        forces = all_forces(SCENE, params, network, no_load(network), dt, state)
        moments = jnp.stack([jnp.stack([*push.moment])[:, 0] for push in forces.pushes[3:]])
        return state._replace(memory=forces.memory), moments.sum(0)

    return jax.lax.scan(one, state, (way, jnp.concatenate([way[:1], way[:-1]])))[1]


def moments_on_a_way(params, way):
    """Moments (T, 3) on the first ball of a pair that is led along overlaps and angles of its first ball (T, 4)."""
    way = np.asarray(way, float)
    network, state = few_balls(params, [[-1 + way[0, 0] / 2, 1 - way[0, 0] / 2], [0, 0], [0, 0]], np.zeros((3, 2)))
    return np.asarray(_led(params, network, state, jnp.asarray(way), 1.0))


def work_of(moments, angles):
    """Work done against the moments along angles (T, 3), by the mean of each step's ends."""
    return -(0.5 * (moments[1:] + moments[:-1]) * np.diff(angles, axis=0)).sum()


def corners(*places, between=400):
    """A way through these places, in straight lines."""
    parts = [np.linspace(a, b, between, endpoint=False) for a, b in pairwise(places)]
    return np.concatenate([*parts, [places[-1]]])


@pytest.mark.parametrize(("kind", "make"), [("rolling", hertz_params), ("torsion", unit_params)])
def test_loop_of_moment_and_rotation(kind, make):
    """Area 4 M_y (A - M_y/kr) of a settled cycle past yield, none inside it."""
    depth, alpha, eta = 1e-3, 0.5, 0.3
    params = resisting(kind, alpha, eta, make)
    network, state = few_balls(params, [[-1 + depth / 2, 1 - depth / 2], [0, 0], [0, 0]], np.zeros((3, 2)))
    law = params.material.contact_law(network)
    forces = forces_of(SCENE, params, network, no_load(network), 1.0, state)
    normal_force = float(np.abs(forces.contacts.force.x[0]))
    root = 1.0 if make is unit_params else depth**0.5
    ks = float(np.ravel(law.shear_stiffness if make is unit_params else law.shear)[0]) * root
    limit, stiffness = eta * normal_force, alpha * ks
    yielding = limit / stiffness
    for amplitude, expected in ((3 * yielding, 4 * limit * 2 * yielding), (0.99 * yielding, 0.0)):
        up, down = (np.append(depth, about(kind, sign * amplitude)) for sign in (1, -1))
        way = corners(np.append(depth, np.zeros(3)), up, down, up)
        moments = moments_on_a_way(params, way)
        assert np.abs(moments).max() == pytest.approx(min(limit, stiffness * amplitude), rel=1e-9)
        area = work_of(moments[400:], way[400:, 1:])
        assert area == pytest.approx(expected, rel=1e-3, abs=1e-12 * limit * yielding)


@pytest.mark.parametrize("friction", [NO_CAP, 0.3])
def test_no_closed_way_gives_out_energy(friction):
    """A Hertzian contact's overlap and all three angles go ten times round at random and come back."""
    params = both((0.5, friction), (0.8, friction), hertz_params)
    rng = np.random.default_rng(0)
    depth, angle = 1e-3, 2e-3
    lost = []
    for _ in range(10):
        some = rng.uniform(-1, 1, (6, 4)) * angle
        some[:, 0] = rng.uniform(0.05, 4, 6) * depth
        start = np.array([depth, 0.0, 0.0, 0.0])
        way = corners(start, *some, np.append(some[-1][0], np.zeros(3)), start, between=100)
        moments = moments_on_a_way(params, way)
        lost.append(work_of(moments, way[:, 1:]) / (np.abs(moments).max() * angle))
    assert min(lost) > 1e-3


# A ball on an incline.


def incline_run(angle, eta, damping, steps, friction=1.0):
    """A ball on a plane that is tilted by `angle`; its speed up to the end, downhill [L/T], and the end state.

    The plane is a ball of radius PLANE, whose weight a load bears. kr = alpha_r R1 R2 ks grows with its radius, so
    alpha_r is small; the cap goes by the smaller radius.
    """
    weight, dt = 1e-4, 0.1
    across, along = -weight * np.cos(angle), weight * np.sin(angle)
    params = unit_params(
        friction=friction, damping=damping, rolling=Rolling(0.5 / PLANE, eta), terms=(Gravity(0.0, across, along),)
    )
    place = [[0.0, PLANE + 1 + across], [0, 0], [0, 0]]
    network, state = few_balls(params, place, np.zeros((3, 2)), radius=np.array([PLANE, 1.0]))
    mass = UNIT_MASS * (4 / 3) * np.pi * PLANE**3
    load = constant_load([[-mass * across, 0], [-mass * along, 0]])
    half = run(params, network, load, dt, steps, state)
    end = run(params, network, load, dt, steps, half)
    return weight, dt, half, end


@pytest.mark.parametrize(("tangent", "eta"), [(0.577, 0.1), (0.577, 0.3), (0.306, 0.3)])
def test_a_steep_incline_sets_the_ball_rolling(tangent, eta):
    """a = 5/7 g (sin b - eta cos b), also 2 % above the angle at which it begins."""
    angle = np.arctan(tangent)
    weight, dt, half, end = incline_run(angle, eta, Dashpot(0.3), 3000)
    found = np.array([end.velocity.y[1] - half.velocity.y[1], end.spin.z[1] - half.spin.z[1]]) / (3000 * dt)
    expected = 5 / 7 * weight * (np.sin(angle) - eta * np.cos(angle))
    np.testing.assert_allclose(found, expected, rtol=1e-4 if tangent > 0.5 else 5e-3)
    assert abs(float(end.velocity.y[0])) < 1e-12, "the plane stands"


def test_a_ball_rests_on_an_incline_that_is_no_steeper_than_its_rolling_friction():
    """2 % below that angle. Local damping lets what swings come to rest and bears no weight."""
    _, _, half, end = incline_run(np.arctan(0.98 * 0.3), 0.3, LocalDamping(0.3), 4000)
    assert float(half.displacement.y[1]) > 1e-5
    assert abs(float(end.displacement.y[1] - half.displacement.y[1])) < 1e-12
    assert abs(float(end.spin.z[1])) < 1e-15


# What every term must keep.


def rough_pair(params, seed=0):
    """Two balls of unequal sizes, pressed together, that fly and spin at random."""
    rng = np.random.default_rng(seed)
    branch = np.array([0.6, -0.48, 0.64]) * 2.49
    velocity, spin = 1e-3 * rng.normal(size=(2, 3, 2))
    place = np.stack([np.zeros(3), branch], 1)
    return few_balls(params, place, velocity, 10 * spin, radius=np.array([1.0, 1.5]))


@BOTH_LAWS
def test_moments_of_a_pair_are_opposite_and_its_angular_momentum_stays(make):
    params = both((0.5, 0.05), (0.8, 0.02), make)
    network, state = rough_pair(params)
    mass = np.array([1.0, 1.5**3])
    inertia = 0.4 * mass * np.array([1.0, 1.5]) ** 2

    def angular_momentum(state, dt=0.02):
        # Momentum is known half a step before the positions.
        place = np.asarray(network.positions) + np.asarray(state.displacement) - 0.5 * dt * np.asarray(state.velocity)
        orbital = np.cross(place, mass * np.asarray(state.velocity), axis=0).sum(1)
        return orbital + (inertia * np.asarray(state.spin)).sum(1)

    for push in forces_of(SCENE, params, network, no_load(network), 0.02, state).pushes[3:]:
        assert np.abs(np.asarray(push.moment)).min(0).max() > 1e-8
        np.testing.assert_allclose(np.asarray(push.moment).sum(1), 0, atol=1e-18)
    end = run(params, network, no_load(network), 0.02, 100, state)
    before, after = angular_momentum(state), angular_momentum(end)
    plain = run(replace(params, rolling=None, torsion=None), network, no_load(network), 0.02, 100,
                state._replace(memory=state.memory[:3]))  # fmt: skip
    assert np.abs(np.asarray(plain.spin) - np.asarray(end.spin)).max() > 1e-4, "the moments must matter"
    np.testing.assert_allclose(after, before, atol=1e-12)


@pytest.mark.parametrize("order", [2, 3, 12])
def test_a_pair_across_a_sector_plane_moves_as_in_the_full_cylinder(order):
    """With the second ball as an image: motion and the springs of both parts."""
    params = both((0.5, 0.3), (0.8, 0.2), damping=Dashpot(0.05))
    rng = np.random.default_rng(order)
    branch = 1.98 * np.array([0.36, 0.48, 0.8])
    middle = np.array([15.0, 0.0, 0.0])
    place = np.stack([middle + branch / 2, middle - branch / 2], 1)
    velocity, spin = 2e-3 * rng.normal(size=(2, 3, 2))

    def after(sector, turns):
        turns = np.array(turns)
        build = partial(build_contact_list, sector=sector, skin=0.5)
        vectors = [sector.rotate(v, turns) for v in (place, velocity, 5 * spin)]
        network = build(Specimen(vectors[0], np.ones(2), -1e8, 1e8, np.ones(2, bool)))
        state = initial_state(SCENE, params, network, (-1e8, 1e8))
        state = state._replace(velocity=from_rows(vectors[1]), spin=from_rows(vectors[2]))
        end = run(params, network, no_load(network), 0.1, 8, state)
        found = [sector.rotate(np.asarray(v), -turns) for v in (end.displacement, end.velocity, end.spin)]
        springs = [sector.rotate(np.asarray(m.contact)[:, :1], -turns[:1]) for m in (end.memory[3], end.memory[4])]
        return int(network.image[0]), found + springs

    _, expected = after(Sector(1), [0, 0])
    image, found = after(Sector(order), [0, 1])
    assert image != 0, "the contact must cross a plane"
    assert all(np.abs(v).max() > 1e-4 for v in expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)


def test_without_cap_nothing_changes():
    """eta = 0: moments and springs are zero to the last bit, the motion that of a scene without the parts but for how
    the compiler rounds in two programs."""
    params = both((0.5, 0.0), (0.8, 0.0))
    network, state = rough_pair(params)
    for push in forces_of(SCENE, params, network, no_load(network), 0.02, state).pushes[3:]:
        for nothing in (push.moment, push.memory.contact):
            np.testing.assert_array_equal(np.asarray(nothing), 0.0)
    end = run(params, network, no_load(network), 0.02, 100, state)
    plain = replace(params, rolling=None, torsion=None)
    expected = run(plain, network, no_load(network), 0.02, 100, state._replace(memory=state.memory[:3]))
    for one, other in ((end.displacement, expected.displacement), (end.spin, expected.spin)):
        np.testing.assert_allclose(np.asarray(one), np.asarray(other), rtol=0, atol=1e-17)


@BOTH_LAWS
@pytest.mark.parametrize("cap", [NO_CAP, 0.05])
def test_the_ledger_of_a_pair_that_turns_and_breathes_closes(make, cap):
    """Balls pressed together spin about the normal and against each other along it; normal force, and with Hertz every
    stiffness, goes up and down. Nothing turns the normal: what is missing is rounding, or second order with Hertz."""
    params = both((0.5, cap), (0.8, cap), make)
    network, state, load = pressed_pair(params, [0.01, 0, 0.02], [-0.02, 0, -0.02], 1e-2)
    state = state._replace(velocity=from_rows(np.array([[1e-3, -1e-3], [0, 0], [0, 0]])))
    _, start, end = balances(still, params, network, load, 0.02, 1000, state)
    change = spent(start, end)
    energy = float(start.spin)
    if cap == NO_CAP:  # a Hertzian contact loses some as it is let go
        assert (abs(change.friction) < 1e-12 * energy) if make is unit_params else (change.friction > 0.01 * energy)
    else:
        assert change.friction > 0.3 * energy
    assert abs(change.unaccounted) < (1e-12 if make is unit_params else 1e-6) * energy


def test_memory_goes_through_a_rebuilt_list():
    """Every contact keeps its own angles; those that are new have none."""
    sector, params = Sector(4), both((0.5, 0.3), (0.8, 0.3))
    specimen = cut_to_sector(fcc_octagon(1.0, 5, 3), sector)
    old, new = (build_contact_list(specimen, sector, skin=skin) for skin in (0.1, 0.9))
    rng = np.random.default_rng(0)
    state = initial_state(SCENE, params, old, (-10.0, 10.0))
    memory = tuple(
        m._replace(contact=from_rows(rng.normal(size=(3, old.first.size)))) if m.contact is not None else m
        for m in state.memory
    )
    carried = carry_memory(old, new, memory)

    def by_name(network, contact):
        names = zip(*(np.asarray(a).tolist() for a in (network.first, network.second, network.image)), strict=True)
        return {name: row for name, row in zip(names, np.asarray(contact).T, strict=True) if name[2] >= 0}

    assert len(carried) == 5
    for term in (3, 4):
        before, after = by_name(old, memory[term].contact), by_name(new, carried[term].contact)
        assert len(after) > len(before) > 30
        for name, row in after.items():
            np.testing.assert_array_equal(row, before.get(name, np.zeros(3)))


# The critical time step.


def pair_limit(**parts):
    place = np.array([[-1, 1, 0, 0], [0, 0, 0, 0], [0, 0, -100, 100.0]])
    network = build_contact_list(Specimen(place, 1.0, -101.0, 101.0, np.ones(4, bool)), Sector(1))
    return critical_time_step(SCENE, unit_params(**parts), network)


def test_the_limit_of_a_pair():
    """2/omega of the gear and of the torsion mode where they are the fastest; else of rolling on each other, 7 ks/m."""
    plain = pair_limit()
    assert plain == pytest.approx(2 / (7 * KS) ** 0.5, rel=1e-9)
    assert pair_limit(rolling=Rolling(3.0, 0.1)) == pytest.approx(2 / (15 * KS) ** 0.5, rel=1e-9)
    assert pair_limit(torsion=Torsion(4.0, 0.1)) == pytest.approx(2 / (20 * KS) ** 0.5, rel=1e-9)
    assert pair_limit(rolling=Rolling(0.5, 0.1), torsion=Torsion(0.5, 0.0)) == pytest.approx(plain, rel=1e-9)


def checkerboard(size=6, overlap=1e-5):
    """Simple cubic lattice: list, and the sign of each ball, the opposite of its neighbours'."""
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij")).reshape(3, -1)
    place = (2 - overlap) * (grid - (size - 1) / 2)
    specimen = Specimen(place, np.ones(size**3), -1e4, 1e4, np.ones(size**3, bool))
    return build_contact_list(specimen, Sector(1), skin=0.1), 1.0 - 2.0 * (grid.sum(0) % 2), (np.abs(place) < 2).all(0)


def test_spin_modes_of_a_lattice():
    """Simple cubic: all alike, omega^2 = (10/3) z ks/m as without the parts; each against its neighbours, which do not
    slip then, (8 kr + 4 ktw)/I = (20 alpha_r + 10 alpha_tw) ks/m."""
    network, sign, inner = checkerboard()
    params, dt, angle = both((0.5, NO_CAP), (0.8, NO_CAP), friction=1e6), 0.1, 1e-9
    state = initial_state(SCENE, params, network, (-1e4, 1e4))
    for axis in np.eye(3):
        for pattern, square in ((np.ones_like(sign), 20 * KS), (sign, (10 + 8) * KS)):
            turning = state._replace(spin=from_rows(np.outer(axis, pattern * angle / dt)))
            moment = np.asarray(forces_of(SCENE, params, network, no_load(network), dt, turning).moment)
            expected = -0.4 * square * angle * np.outer(axis, pattern)
            np.testing.assert_allclose(moment[:, inner], expected[:, inner], atol=2e-5 * 0.4 * square * angle)


def test_a_disturbance_grows_above_the_limit_and_not_below():
    """A square of balls whose contacts never yield, held in its plane by constant forces; spins at random."""
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 2, [0], indexing="ij")).reshape(3, -1)
    network, state = few_balls(both((3.0, NO_CAP), (3.0, NO_CAP)), (2 - 1e-3) * grid, np.zeros((3, 16)), skin=0.1)
    params = both((3.0, NO_CAP), (3.0, NO_CAP), friction=1e6)
    resultant = forces_of(SCENE, params, network, no_load(network), 0.1, state).resultant
    load = constant_load(-np.asarray(resultant)[:2])
    noise = 1e-9 * np.random.default_rng(0).normal(size=(3, 16))
    critical = critical_time_step(SCENE, params, network)
    assert critical < 0.7 * critical_time_step(SCENE, replace(params, rolling=None, torsion=None), network)

    def grown(dt):
        end = run(params, network, load, dt, 300, state._replace(spin=from_rows(noise)))
        return np.abs(np.asarray(end.spin)).max() / np.abs(noise).max()

    assert grown(0.99 * critical) < 30
    assert not grown(1.01 * critical) < 1e6
