"""The Hertz-Mindlin law against closed forms: impacts, stiffness, energy, lattices, tangents, time step.

Units as in few_balls.py: ball radius and mass 1; the modulus E* = G/(1 - nu) is 1.
"""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import NU, PLANE, SCENE, few_balls, hertz_params, jit, no_load, record, run, still, unit_params
from jax.flatten_util import ravel_pytree
from scipy.integrate import quad, solve_ivp
from test_lattices import block, stress_after, unstrained

from axijax import Dashpot, Hertz, Params, Scene
from axijax.core.sector import Sector
from axijax.core.vector import Vector, from_rows, zeros
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.contacts import Geometry, contact_forces, elastic_force, frictional_law, frictionless_force
from axijax.mechanics.dynamics import initial_state, make_step
from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
from axijax.mechanics.hertz import OVERLOAD, confined_force
from axijax.mechanics.lattice_load import lattice_load
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import check_params
from axijax.mechanics.time_step import SAFE_STEP, critical_time_step
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon
from axijax.theory import (
    dashpot_restitution,
    elastic_constants,
    fcc_stress_ratio,
    gross_sliding_impact,
    hertz_impact_duration,
    hertz_impact_maximum_overlap,
)
from axijax.triaxial.records import raise_for_status
from axijax.triaxial.test import TriaxialTest
from calibrate.fit import fit_parameters
from calibrate.measured import MeasuredCurve
from calibrate.model import Model
from calibrate.parameters import ParameterSet

SHEAR = 4 * (1 - NU) / (2 - NU)  # 8 G* where E* is 1
SPEED = 1e-3


# Normal impact.


def test_the_constant_of_the_duration_is_the_integral_over_the_overlap():
    """t v / overlap = 2 int_0^1 dx / sqrt(1 - x^2.5), with x = 1 - u^2."""
    integral = quad(lambda u: 4 * u / np.sqrt(1 - (1 - u * u) ** 2.5), 0, 1)[0]
    assert float(hertz_impact_duration(1.0, 1.0, 1.0, 1.0)) == pytest.approx(
        integral * float(hertz_impact_maximum_overlap(1.0, 1.0, 1.0, 1.0)), rel=1e-9
    )
    with pytest.raises(ValueError, match="reduced_radius"):
        hertz_impact_duration(1.0, 1.0, 0.0, 1.0)


@pytest.mark.parametrize("partner", [1.0, 2.0, "platen", "plane"])
def test_normal_impact_lasts_and_presses_as_the_closed_form_says(partner):
    """Two balls, the second of radius 1 or 2; a ball on a platen, on a rigid sector plane: a flat of the same material,
    so that R* is the ball's radius."""
    params, gap = hertz_params(friction=None), 1.234e-6
    mass, radius = (1.0, 1.0) if isinstance(partner, str) else (partner**3 / (1 + partner**3), partner / (1 + partner))
    duration = float(hertz_impact_duration(SPEED, mass, radius, 1.0))
    dt, steps = duration / 2000, 2400
    if partner == "platen":
        network, state = few_balls(params, [[0.0], [0.0], [1 + gap]], [[0], [0], [-SPEED]], platens=(0, 10))
        moved = "z", 0
    elif partner == "plane":
        specimen = Specimen(np.array([[5.0], [1 + gap], [0.0]]), 1.0, -9.0, 9.0, np.ones(1, bool))
        network = build_contact_list(specimen, Sector(4, "rigid"))
        state = initial_state(SCENE, params, network, [-9.0, 9.0])
        state = state._replace(velocity=from_rows(np.array([[0.0], [-SPEED], [0.0]])))
        moved = "y", 0
    else:
        radii = np.array([1.0, partner])
        network, state = few_balls(
            params, [[0, 1 + partner + gap], [0, 0], [0, 0]], [[0, -SPEED], [0, 0], [0, 0]], radius=radii
        )
        moved = "x", 1
    states = record(params, network, no_load(network), dt, state, steps)
    away = np.asarray(getattr(states.displacement, moved[0]))
    overlap = away[:, 0] * moved[1] - away[:, moved[1]] - gap
    leaving = (overlap[-2] - overlap[-1]) / dt
    assert overlap.max() == pytest.approx(float(hertz_impact_maximum_overlap(SPEED, mass, radius, 1.0)), rel=1e-5)
    assert leaving == pytest.approx(SPEED, rel=1e-5)
    parted = steps * dt + overlap[-1] / leaving
    assert parted - gap / SPEED == pytest.approx(duration, rel=1e-4)


@pytest.mark.parametrize("beta", [0.05, 0.3])
def test_dashpots_restore_the_same_share_of_any_speed(beta):
    """The restitution of the linear law (Antypov & Elliott 2011), from speeds that differ by 1e4."""
    params = hertz_params(friction=None, damping=Dashpot(beta))
    expected = float(dashpot_restitution(beta))
    for speed in (1e-5, 1e-1):
        duration = float(hertz_impact_duration(speed, 0.5, 0.5, 1.0))
        network, state = few_balls(params, [[0, 2 + 0.01 * speed], [0, 0], [0, 0]], [[0, -speed], [0, 0], [0, 0]])
        state = run(params, network, no_load(network), duration / 4000, 8000, state)
        assert float(state.velocity.x[1] - state.velocity.x[0]) / speed == pytest.approx(expected, rel=1e-3)
    bottom = few_balls(params, [[0.0], [0.0], [1 + 1e-6]], [[0], [0], [-SPEED]], platens=(0, 10))
    duration = float(hertz_impact_duration(SPEED, 1.0, 1.0, 1.0))
    state = run(params, bottom[0], no_load(bottom[0]), duration / 4000, 8000, bottom[1])
    assert float(state.velocity.z[0]) / SPEED == pytest.approx(expected, rel=1e-3)


# One contact, led by the hand.


def pair(radius=(1.0, 1.0)):
    """A network of two touching balls along x."""
    place = [[0, sum(radius)], [0, 0], [0, 0]]
    return few_balls(hertz_params(), place, np.zeros((3, 2)), radius=np.array(radius))[0]


def led(network, paths, friction=1e6):
    """Forces (W, T, 2), normal and tangential, while overlap and slip follow W paths (W, T, 2) from nothing."""
    law = hertz_params(friction=friction).material.contact_law(network)
    nought = jnp.zeros(2)

    def one(carry, target):
        spring, before = carry
        there, speed = (Vector(*(nought.at[0].set(x) for x in pair), nought) for pair in (target, target - before))
        made = contact_forces(law, network, 1.0, there, speed, None, spring)
        return (made.spring, target), -jnp.stack([made.force.x[0], made.force.y[0]])

    start = zeros(network.first.shape, float), nought
    return np.asarray(jit(jax.vmap(lambda path: jax.lax.scan(one, start, path)[1]))(jnp.asarray(paths)))


def corners(*points, pieces=400):
    """(T, 2) path straight from point to point, and where each point is in it."""
    legs = [np.linspace(a, b, pieces + 1)[1:] for a, b in pairwise(points)]
    return np.concatenate([np.array(points[:1], float), *legs]), pieces * np.arange(len(points))


@pytest.mark.parametrize("radius", [(1.0, 1.0), (1.0, 3.0)])
def test_mindlins_stiffness_and_what_becomes_of_it_when_the_load_changes(radius):
    """F = 4/3 sqrt(R*) d^1.5 and 8 G* sqrt(R* d) a unit of slip; over the normal tangent stiffness 2 (1-nu)/(2-nu).
    Pressed harder the force stays, let go it falls with the contact radius."""
    reduced, d, s = radius[0] * radius[1] / sum(radius), 1e-4, 1e-7
    path, at = corners((0, 0), (d, 0), (d, s), (4 * d, s), (d, s), pieces=2000)
    force = led(pair(radius), path[None])[0, at]
    assert force[1, 0] == pytest.approx(4 / 3 * np.sqrt(reduced) * d**1.5, rel=1e-6)
    assert force[2, 1] == pytest.approx(SHEAR * np.sqrt(reduced * d) * s, rel=1e-3)
    assert force[3, 1] == pytest.approx(force[2, 1], rel=2e-3)
    assert force[4, 1] == pytest.approx(force[2, 1] / 2, rel=2e-3)
    stiffness = hertz_params().material.tangent_stiffness(reduced, force[1, 0])
    assert float(stiffness[0]) == pytest.approx(2 * np.sqrt(reduced * d), rel=1e-6)
    assert float(stiffness[1] / stiffness[0]) == pytest.approx(2 * (1 - NU) / (2 - NU), rel=1e-12)


def test_the_cap_is_friction_times_normal_force_at_any_load():
    path, at = corners((0, 0), (1e-4, 0), (1e-4, 1e-4), (4e-4, 1e-4), (4e-4, 3e-4), (1e-4, 3e-4))
    normal, along = led(pair(), path[None], friction=0.3)[0, at].T
    np.testing.assert_allclose(along[[2, 4, 5]], 0.3 * normal[[2, 4, 5]], rtol=2e-3)
    assert along[3] == pytest.approx(along[2], rel=2e-3)


@pytest.mark.parametrize("friction", [1e6, 0.3])
def test_no_closed_way_gives_out_energy(friction):
    """Slip while pressed little and back while pressed much, and the other way round, each takes half of k s^2 at the
    lighter load; 20 ways at random give nothing. A force that is stiffness times slip would gain on the first, one that
    does not fall on unloading on the second."""
    d, s = 1e-4, 1e-5
    low, high, low_slipped, high_slipped = (d, 0.0), (4 * d, 0.0), (d, s), (4 * d, s)
    ways = [
        (low, low_slipped, high_slipped, high, high, high, low),
        (high, high_slipped, low_slipped, low, low, low, low),
    ]
    rng = np.random.default_rng(0)
    for _ in range(20):
        some = rng.uniform(0, 1, (6, 2)) * [4 * d, 10 * s]
        ways.append((*map(tuple, some), (some[-1][0], 0.0)))
    paths = np.stack([corners((0.0, 0.0), *way, (0.0, 0.0))[0] for way in ways])
    force = led(pair(), paths, friction)
    work = (0.5 * (force[:, 1:] + force[:, :-1]) * np.diff(paths, axis=1)).sum((1, 2))
    unit = SHEAR * np.sqrt(0.5 * d) * s**2
    np.testing.assert_allclose(work[:2], 0.5 * unit, rtol=2e-2)
    assert work[2:].min() > 0


# Oblique impact.


def against_plane(params, tangential_speed=0.0, gap=1e-6, normal_speed=SPEED):
    """A ball that flies at a flat ball of radius PLANE, which its mass keeps at rest; R* = 1 to 1e-6."""
    place = [[0.0, PLANE + 1 + gap], [0, 0], [0, 0]]
    return few_balls(params, place, [[0, -normal_speed], [0, tangential_speed], [0, 0]], radius=np.array([PLANE, 1.0]))


@pytest.mark.parametrize("beta", [0.0, 0.1])
def test_gross_sliding(beta):
    f = 0.2
    params = hertz_params(friction=f, damping=Dashpot(beta))
    e = float(dashpot_restitution(beta))
    lost, spin, least = (float(x) for x in gross_sliding_impact(f, e, SPEED, 1.0))
    network, state = against_plane(params, tangential_speed=3 * least)
    duration = float(hertz_impact_duration(SPEED, 1.0, 1.0, 1.0))
    state = run(params, network, no_load(network), duration / 4000, 8000, state)
    assert float(state.velocity.x[1]) == pytest.approx(e * SPEED, rel=1e-3)
    assert 3 * least - float(state.velocity.y[1]) == pytest.approx(lost, rel=1e-3)
    assert abs(float(state.spin.z[1])) == pytest.approx(spin, rel=1e-3)


def test_sticking_against_an_integration_of_the_two_equations():
    """d'' = -F/m and u' = -3.5 T/m, with the tangential force T = k(d) s: s' = u - s k'/k while pressed harder."""

    def motion(t, y):
        d, v, s, u = y
        d = max(d, 1e-30)
        k = SHEAR * np.sqrt(d)
        return [v, -4 / 3 * d**1.5, u - (s * v / (2 * d) if v > 0 else 0.0), -3.5 * k * s]

    def apart(t, y):
        return y[0] - 1e-12

    apart.terminal, apart.direction = True, -1
    u0 = 0.3 * SPEED
    start = 1e-10 / SPEED
    ode = solve_ivp(
        motion, (0, 1e4), [SPEED * start, SPEED, 2 / 3 * u0 * start, u0], events=apart, rtol=1e-9, atol=1e-16
    )
    params = hertz_params(friction=1e6)
    network, state = against_plane(params, tangential_speed=u0)
    duration = float(hertz_impact_duration(SPEED, 1.0, 1.0, 1.0))
    end = run(params, network, no_load(network), duration / 8000, 10000, state)
    surface = float(end.velocity.y[1] - end.spin.z[1])
    assert surface == pytest.approx(ode.y[3, -1], abs=1e-3 * u0)
    assert ode.y[3, -1] < 0.9 * u0


def grazing(params):
    """Kinetic energy after over before of 24 pairs that meet under all angles, spinning or not."""
    count = 24
    angle = np.linspace(0.02, 1.55, count)
    spin = np.where(np.arange(count) % 2, 0.0, 1.0) * SPEED
    nought, up = np.zeros(count), 10.0 * np.arange(count)
    place = [np.append(2 + 1e-6 + nought, nought), np.zeros(2 * count), np.append(up, up)]
    velocity = np.zeros((3, 2 * count))
    velocity[0, :count], velocity[1, :count] = -SPEED * np.cos(angle), SPEED * np.sin(angle)
    spins = np.zeros((3, 2 * count))
    spins[2, :count] = spin
    network, state = few_balls(params, place, velocity, spins)
    slowest = float(hertz_impact_duration(SPEED * np.cos(angle[-1]), 0.5, 0.5, 1.0))
    end = run(params, network, no_load(network), slowest / 8000, 16000, state)

    def kinetic(s):
        v, w = np.asarray(s.velocity), np.asarray(s.spin)
        each = 0.5 * (v**2).sum(0) + 0.2 * (w**2).sum(0)
        return each[:count] + each[count:]

    assert (np.asarray(end.velocity.x)[count:] < 0).all(), "all pairs have met"
    return kinetic(end) / kinetic(state)


def test_no_impact_gains_energy():
    """Undamped, from head-on to grazing: none with friction 0, 0.3 or with contacts that always stick."""
    sliding, sticking, smooth = (grazing(hertz_params(friction=f)) for f in (0.3, 1e6, 0.0))
    np.testing.assert_allclose(smooth, 1.0, rtol=2e-5)
    assert sliding.max() < 1 + 2e-5 and sticking.max() < 1 + 2e-5
    assert sliding.min() < 0.95 and sticking.min() < 0.99


# Energy ledger.


@jit
def ledger_after(params, network, dt, steps, state):
    step = make_ledger_step(SCENE, still)
    both = state, open_ledger()
    after = jax.lax.fori_loop(0, steps, lambda _, b: step(params, network, no_load(network), dt, b), both)
    return tuple(energy_balance(SCENE, params, network, no_load(network), dt, *b) for b in (both, after))


@pytest.mark.parametrize("damping", [Dashpot(0.1), None])
def test_the_ledger_closes_at_second_order(damping):
    """Balls rattling and slipping between two platens, pressed throughout: what the tangential springs lose by the
    change of contact radius is booked, or the balance would miss it."""
    params = hertz_params(friction=0.05, damping=damping)
    place = [[0, 0, 0], [0, 0, 0], [0.99, 2.97, 4.95]]
    velocity, spin = [[0, 2e-4, 0], [0, 0, 1e-4], [0, 1e-3, 0]], [[0, 0, 1e-3], [0, 0, 0], [0, 0, 0]]
    network, state = few_balls(params, place, velocity, spin, platens=(0, 5.94))
    missing = []
    for steps in (200, 400, 800):
        start, end = ledger_after(params, network, 20.0 / steps, steps, state)
        missing.append(abs(float(end.unaccounted - start.unaccounted)))
        lost = float(end.friction + end.damping)
    assert lost > 1e-8
    assert missing[2] < 1e-3 * lost
    assert np.log2(missing[0] / missing[2]) / 2 == pytest.approx(2.0, abs=0.35)


# Tangents.


def test_tangents_of_an_oblique_impact_that_slips_and_sticks_agree_with_differences():
    """Of the velocities after it, with respect to friction, G, nu, beta and the speeds of the ball."""
    begun = hertz_params(damping=Dashpot())
    network, state = against_plane(begun)
    duration = float(hertz_impact_duration(SPEED, 1.0, 1.0, 1.0))
    names = ("friction", "shear_modulus", "poisson_ratio", "damping_ratio")

    def after(x):
        params = replace(begun, **dict(zip(names, x[:4], strict=True)))
        speeds = Vector(state.velocity.x.at[1].set(-x[4]), state.velocity.y.at[1].set(x[5]), state.velocity.z)
        begin = state._replace(velocity=speeds)
        end = run.__wrapped__(params, network, no_load(network), duration / 1000, 1600, begin)
        return jnp.stack([end.velocity.x[1], end.velocity.y[1], end.spin.z[1]]) / SPEED

    value, slopes = jit(after), jit(jax.jacfwd(after))
    for u in (0.2, 0.8):  # slips at the end only; slips, sticks and slips
        x = jnp.array([0.3, 1 - NU, NU, 0.1, SPEED, u * SPEED])
        tangents = slopes(x)
        for k in range(6):
            h = 1e-6 * x[k]
            difference = (value(x.at[k].add(h)) - value(x.at[k].add(-h))) / (2 * h)
            np.testing.assert_allclose(tangents[:, k] * x[k], difference * x[k], atol=2e-4, rtol=2e-4)


def test_tangents_are_finite_at_every_overlap_and_without_slip():
    """At no overlap, at the smallest ones and gaps, far apart as padding is; with and without slip."""
    overlap = jnp.array([0.0, 1e-300, 1e-30, 1e-18, 1e-9, 1e-4, -1e-300, -1e-18, -1e-9, -1.0, -1e9])
    row = jnp.ones(overlap.size)
    network = pair()
    for frictional, damped in ((True, True), (True, False), (False, True), (False, False)):

        def force(x, frictional=frictional, damped=damped):
            material = hertz_params(
                friction=x[0] if frictional else None,
                damping=Dashpot(x[3]) if damped else None,
                shear_modulus=x[1],
                poisson_ratio=x[2],
            ).material
            law, wall = material.contact_law(network), material.wall_law(network)
            place = Geometry(Vector(-2 * row, 0 * row, 0 * row), 0.5 * row, overlap + x[4])
            approach = Vector(x[5] * row, x[6] * row, 0 * row)
            now, pushed = law.at(place, approach, 1.0), wall._replace(**of_one(wall)).at(-place.overlap)
            if frictional:
                made = frictional_law(now, 1.0, place, approach, None, approach * x[7])
            elif damped:
                made = frictionless_force(now, place, approach)
            else:
                made = elastic_force(now, place)
            return ravel_pytree((made, pushed))[0]

        slopes = jit(jax.jacfwd(force))
        for slip in (0.0, 1e-7):
            assert np.isfinite(slopes(jnp.array([0.3, 0.8, 0.2, 0.1, 0.0, 0.0, slip, 1.0]))).all()


def of_one(wall):
    """The constants of the first ball."""
    return {name: value[0] for name, value in wall._asdict().items() if value is not None}


# Lattices.


def test_fcc_is_as_stiff_as_the_tangent_stiffness_of_its_contacts():
    """Isotropic stress N0 = sqrt2 s r^2 from the overlap, and C11, C12, C44 of PHYSICS 3.3 with kn, ks tangent."""
    piece, squeeze = block("fcc"), 1e-4
    material = hertz_params(friction=1e6).material
    law = material.contact_law(piece.network)
    pressed = (1 - squeeze) * np.eye(3)
    start, _ = stress_after(law, piece, pressed, pressed, unstrained(piece))
    contact_force = 4 / 3 * 0.5**0.5 * (2 * squeeze) ** 1.5
    np.testing.assert_allclose(start, contact_force / 2**0.5 * np.eye(3), atol=1e-3 * contact_force)
    normal, shear = (float(k) for k in material.tangent_stiffness(0.5, contact_force))
    c11, c12, c44 = (float(c) for c in elastic_constants("fcc", normal, shear, 1.0))

    def change(strain):
        after, _ = stress_after(law, piece, pressed, pressed - 1e-8 * np.asarray(strain), unstrained(piece))
        return np.asarray(after - start) / 1e-8

    along_z = change(np.diag([0.0, 0.0, 1.0]))
    assert along_z[2, 2] == pytest.approx(c11, rel=1e-3)
    assert along_z[0, 0] == pytest.approx(c12, abs=1e-3 * c11)
    assert change([[0, 0, 0.5], [0, 0, 0], [0.5, 0, 0]])[0, 2] == pytest.approx(c44, rel=1e-3)


# The test.

SMALL = fcc_octagon(layers=5, half_width=3)


@pytest.fixture(scope="module")
def blocked() -> TriaxialTest:
    """A small prism of hard balls, rotation blocked, loaded like the infinite lattice."""
    return TriaxialTest(
        SMALL,
        Sector(4),
        scene=Scene(rotation=False),
        params=Params(Hertz(), platen_speed=0.004),
        axial_strain=0.0008,
        tolerance=1e-5,
        lateral_load=lattice_load(SMALL, Sector(4)),
    )


@pytest.mark.parametrize("friction", [0.12278, 0.3])
def test_lattice_without_rotation_reaches_thorntons_formula(blocked, friction):
    curve = blocked.simulate(replace(blocked.params, friction=friction))
    raise_for_status(curve.status)
    assert float(curve.stress_ratio.max()) == pytest.approx(float(fcc_stress_ratio(friction)), rel=1e-2)


def test_a_contact_across_a_sector_plane_is_the_same_as_in_the_full_cylinder():
    """Quarter and full cylinder of a lively specimen, pressed by the platens: one trajectory."""
    params = Params(Hertz(), platen_speed=5.0)
    half, step = 0.5 * SMALL.height, 0.005
    states = []
    for order in (1, 4):
        sector = Sector(order)
        cut = cut_to_sector(SMALL, sector)
        shrunk = 0.999 * (cut.positions - [[0], [0], [half]])
        network = build_contact_list(replace(cut, positions=shrunk, bottom=-0.999 * half, top=0.999 * half), sector)
        dt = 0.5 * critical_time_step(SCENE, params, network)
        state = initial_state(SCENE, params, network, np.array([-0.999, 0.999]) * half)
        swirl = np.asarray(network.free) * np.stack([-shrunk[1], shrunk[0], 20 * np.sin(shrunk[2])]) * 0.02
        spin = np.stack([0 * shrunk[0], 0 * shrunk[0], 0.05 * np.cos(shrunk[2])])
        state = state._replace(velocity=from_rows(swirl), spin=from_rows(spin))
        assert step < dt
        state = run(params, network, no_load(network), step, 12, state)
        across = np.abs(np.asarray(state.spring)[:, np.asarray(network.image) > 0])
        assert order == 1 or across.max() > 1e-6, "contacts across the planes carry springs"
        states.append((run(params, network, no_load(network), step, 300, state), shrunk))
    (full, place), (quarter, mine) = states
    same = np.array([np.argmin(np.linalg.norm(place - p[:, None], axis=0)) for p in mine.T])
    moved = np.asarray(quarter.displacement)
    assert np.abs(moved).max() > 0.01
    np.testing.assert_allclose(np.asarray(full.displacement)[:, same], moved, atol=1e-9 * np.abs(moved).max())
    np.testing.assert_allclose(np.asarray(full.spin)[:, same], np.asarray(quarter.spin), atol=1e-11)


@pytest.mark.parametrize(
    ("params", "unused"),
    [
        (unit_params(damping=Dashpot(0.1)), ("shear_modulus", "poisson_ratio")),
        (hertz_params(damping=Dashpot(0.1)), ("normal_stiffness", "shear_stiffness")),
    ],
)
def test_what_the_material_does_not_use_does_not_enter(params, unused):
    """It is refused, wherever it is given; what is there suffices for a run."""
    for name in unused:
        with pytest.raises(ValueError, match=f"{name} = nan: no part of these parameters .* so it would do nothing"):
            replace(params, **{name: float("nan")})
        with pytest.raises(ValueError, match=f"{name} = nan: no part of these parameters .* so it would do nothing"):
            Params(params.material, **{name: float("nan")})
        with pytest.raises(AttributeError, match=name):
            getattr(params, name)
    network, state = against_plane(params, tangential_speed=SPEED, gap=-1e-4)
    end = run(params, network, no_load(network), 0.01, 50, state)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(end))


@pytest.fixture(scope="module")
def model(blocked) -> Model:
    return Model(blocked, "friction,G")


def test_tangents_of_the_whole_test_agree_with_differences(model):
    """d peak / d logit friction and d peak / d log G."""
    z = model.parameters.coordinates({"friction": 0.2})
    curve, tangents = model.run_with_tangents(z)
    top = curve.stress_ratio.argmax()
    assert curve.stress_ratio[top] == pytest.approx(float(fcc_stress_ratio(0.2)), rel=1e-2)
    for tangent, h in zip(tangents.stress_ratio, 1e-4 * np.eye(2), strict=True):
        ends = [model.run(z + sign * h).stress_ratio.max() for sign in (1, -1)]
        assert tangent[top] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-2, abs=1e-4)


def test_friction_and_shear_modulus_are_fitted(model):
    truth = {"friction": 0.2, "shear_modulus": 1.7e10}
    curve = model.run(model.parameters.coordinates(truth))
    strain = np.linspace(5e-5, 7.5e-4, 15)
    measured = MeasuredCurve(strain, np.interp(strain, curve.axial_strain, curve.stress_ratio))
    found = fit_parameters(model, measured, "friction,G", start="test")
    assert found.estimate["friction"] == pytest.approx(0.2, rel=1e-3)
    assert found.estimate["shear_modulus"] == pytest.approx(1.7e10, rel=5e-3)


def test_what_the_law_does_not_use_is_not_fitted(blocked):
    with pytest.raises(ValueError, match=r"parameter 'kn': this test has no such number, .* shear_modulus, poisson"):
        Model(blocked, "friction,kn")
    linear = replace(blocked, params=Params())
    with pytest.raises(ValueError, match=r"parameter 'nu': this test has no such number, .* normal_stiffness, shear"):
        Model(linear, "friction,nu")
    with pytest.raises(ValueError, match="bounds of poisson_ratio"):
        ParameterSet.of(blocked.params, "nu", bounds={"nu": (0.1, 0.6)})


# Time step.


@pytest.mark.parametrize("boundary", ["periodic", "rigid"])
@pytest.mark.parametrize("damping", [Dashpot(), None])
def test_the_step_itself_amplifies_just_above_the_limit_and_not_below(boundary, damping):
    """The largest eigenvalue of the linearised step of a squeezed prism, its overlaps deeper than those to come. The
    platens, whose overlaps a contact list does not know, keep off."""
    sector = Sector(4, boundary)
    cut = cut_to_sector(SMALL, sector)
    half = 0.5 * SMALL.height + 1
    place = cut.positions - [[0], [0], [half - 1]]
    # Little enough that the prism does not buckle: growth of a static kind goes with the root of the overlap.
    squeezed = replace(cut, positions=place, radius=cut.radius * (1 + 1e-6), bottom=-half, top=half)
    network = build_contact_list(squeezed, sector)
    params = Params(Hertz(damping=damping), friction=1e6, confining_stress=1e-6)
    state = initial_state(SCENE, params, network, [-half, half])
    step = make_step(SCENE, still)
    flat, shape = ravel_pytree((state.displacement, state.velocity, state.spin, state.spring))

    @jax.jit
    def matrix(dt):
        def one_step(moved):
            displacement, velocity, spin, spring = shape(moved)
            before = state._replace(displacement=displacement, velocity=velocity, spin=spin).with_spring(spring)
            after = step(params, network, Load(jnp.zeros(network.radius.shape), jnp.ones(())), dt, before)
            return ravel_pytree((after.displacement, after.velocity, after.spin, after.spring))[0]

        return jax.jacfwd(one_step)(flat)

    def growth(dt):
        return np.abs(np.linalg.eigvals(np.asarray(matrix(dt)))).max()

    critical = critical_time_step(SCENE, params, network)
    assert growth(0.99 * critical) < 1.005
    assert growth(1.02 * critical) > 1.015


def test_the_limit_is_that_of_the_loaded_specimen_and_unsafe_steps_are_refused(blocked):
    """Contacts that merely touch have no stiffness. The forecast at OVERLOAD times the mean force is below the limit at
    the overlaps of failure, and not by much; it falls as G^(-1/3) s3^(-1/6)."""
    params = replace(blocked.params, friction=0.3)
    final = blocked.run(params)
    place = final.positions
    bottom, top = (float(z) for z in final.state.platens)
    network = build_contact_list(replace(blocked.cut, positions=place, bottom=bottom, top=top), Sector(4))
    actual = critical_time_step(blocked.scene, replace(params, confining_stress=1e-3), network)
    forecast = critical_time_step(blocked.scene, params, blocked.network)
    assert 0.7 * actual < forecast < actual
    harder = critical_time_step(blocked.scene, replace(params, shear_modulus=8 * 2.9e10), blocked.network)
    assert forecast / harder == pytest.approx(2.0, rel=1e-3)
    pressed = critical_time_step(blocked.scene, replace(params, confining_stress=64 * 5e4), blocked.network)
    assert forecast / pressed == pytest.approx(2.0, rel=1e-3)
    with pytest.raises(ValueError, match="critical time step"):
        replace(blocked, time_step=1.01 * SAFE_STEP * forecast).run()
    with pytest.raises(ValueError, match="critical time step"):
        blocked.run(replace(params, shear_modulus=100 * 2.9e10))


def test_the_mean_force_under_the_confining_stress_is_at_least_the_true_one():
    """FCC: N0 = sqrt2 s3 r^2; the cylinder around the balls is larger than the membrane's, at most by a half here."""
    network = build_contact_list(cut_to_sector(fcc_octagon(), Sector(4)), Sector(4))
    force = float(confined_force(network, Params().confining_stress))
    assert 1 < force / (2**0.5 * 5e4 * 400) < 2
    assert OVERLOAD >= 2 / (1 - 0.5)


# Bad input.


@pytest.mark.parametrize(
    ("field", "value", "part"),
    [
        ("poisson_ratio", 0.5, "below 0.5"),
        ("poisson_ratio", -0.1, "zero or positive"),
        ("shear_modulus", 0.0, "must be positive"),
        ("shear_modulus", float("inf"), "finite"),
    ],
)
def test_bad_material_is_refused(field, value, part):
    with pytest.raises(ValueError, match=field) as caught:
        check_params(replace(Params(Hertz()), **{field: value}), 10)
    assert part in str(caught.value)


def test_what_is_no_material_is_refused():
    with pytest.raises(ValueError, match="material = 'hooke': must be a material"):
        check_params(Params("hooke"), 10)
