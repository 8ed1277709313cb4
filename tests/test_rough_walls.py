"""Friction of rigid sector planes against closed forms, and what rough platens feel: sum rules of momentum and of
angular momentum. Units as in few_balls.py; friction of platens against closed forms is in test_terms.py."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import FAR, SCENE, constant_load, hertz_params, jit, no_load, record, run, still, unit_params
from test_energy import balances, spent
from test_terms import PUSH, indented

from axijax import Dashpot, Params, Scene, Sector, TriaxialTest, fcc_octagon
from axijax.app.snapshot import snapshot
from axijax.core.sector import plane_normals
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.dynamics import all_forces, initial_state, make_step, positions
from axijax.mechanics.observe import platen_records
from axijax.mechanics.time_step import critical_time_step
from axijax.mechanics.walls import platen_loads
from axijax.specimen.specimen import Specimen, cut_to_sector
from axijax.theory import slide_to_roll
from axijax.triaxial.prepare import prepare

THIRD = Sector(3, "rigid")


def bearing_on_plane(params, side, speed):
    """A ball pressed onto a rigid sector plane by N, sliding upwards and along: contact list, state, load, its way."""
    normal = np.array([*plane_normals(THIRD)[side], 0.0])
    across = np.cross(normal, [0.0, 0.0, 1.0])
    across *= np.sign(across[:2] @ plane_normals(THIRD)[1 - side])  # away from the other plane
    place = 20 * across + (1 - indented(params)) * normal
    network = build_contact_list(Specimen(place[:, None], 1.0, *FAR, np.ones(1, bool)), THIRD, skin=1.0)
    way = 0.6 * across + np.array([0.0, 0.0, 0.8])
    state = initial_state(SCENE, params, network, FAR)._replace(velocity=from_rows(speed * way[:, None]))
    return network, state, constant_load(-PUSH * normal[:2, None]), way, np.cross(normal, way)


@pytest.mark.parametrize("side, make", [(0, unit_params), (1, hertz_params)], ids=["0-linear", "1-hertz"])
def test_sliding_ball_begins_to_roll_on_a_rigid_sector_plane(make, side):
    """As on a platen: slowed at f N/m, spun up at 5 f N/(2 m r) until it rolls at 5/7 v0, after 2 v0 m/(7 f N)."""
    f, v0, dt = 0.25, 0.01, 0.05
    params = make(plane_friction=f)
    network, state, load, way, about = bearing_on_plane(params, side, v0)
    time, speed, distance = (float(x) for x in slide_to_roll(v0, f, PUSH))
    states = record(params, network, load, dt, state, round(1.3 * time / dt))
    along = np.einsum("i,itk->tk", way, np.asarray(states.velocity))[:, 0]
    turning = np.einsum("i,itk->tk", about, np.asarray(states.spin))[:, 0]
    sliding = slice(1, int(0.99 * time / dt))
    np.testing.assert_allclose(np.diff(along[sliding]), -f * PUSH * dt, rtol=1e-6)
    np.testing.assert_allclose(np.diff(turning[sliding]), 2.5 * f * PUSH * dt, rtol=1e-6)
    np.testing.assert_allclose(along + 0.4 * turning, v0, rtol=1e-12)
    rolling = np.flatnonzero(along - turning < 1e-4 * v0)[0]
    assert rolling * dt == pytest.approx(time, rel=1e-3)
    moved = np.einsum("i,itk->tk", way, np.asarray(states.displacement))[rolling, 0]
    assert moved == pytest.approx(distance, rel=1e-3)
    assert np.mean(along[rolling + 100 :]) == pytest.approx(speed, rel=1e-3)


def test_a_rigid_plane_takes_a_seventh_of_m_v_squared_until_the_ball_rolls():
    f, v0, dt = 0.3, 0.01, 0.05
    params = unit_params(plane_friction=f)
    network, state, load, _, _ = bearing_on_plane(params, 1, v0)
    steps = round(1.2 * float(slide_to_roll(v0, f, PUSH)[0]) / dt)
    _, start, end = balances(still, params, network, load, dt, steps, state)
    change = spent(start, end)
    assert change.friction == pytest.approx(v0**2 / 7, rel=1e-3)
    assert abs(change.unaccounted) < 1e-12 * v0**2


def test_a_ball_sticks_to_a_glued_plane_and_smooth_platens_stay_smooth():
    """Glued it swings at sqrt(3.5 ks/m), so its spring holds it for ever; platens beside it hold nothing."""
    params = unit_params(plane_friction=float("inf"))
    network, state, load, way, _ = bearing_on_plane(params, 0, 1e-5)
    steps = round(2 * np.pi / np.sqrt(3.5 * 0.8) / 1e-3)
    end = run(params, network, load, 1e-3, steps, state)
    # Over a whole swing only the mode that rolls, 5/7 of the speed, gets on.
    np.testing.assert_allclose(np.asarray(end.displacement)[:, 0] @ way, 1e-5 * 5 / 7 * steps * 1e-3, rtol=1e-3)
    forces = all_forces(SCENE, params, network, load, 1e-3, end)
    assert [spring is None for spring in forces.walls.springs] == [True, True, False, False]


def test_friction_of_planes_that_are_not_rigid_is_refused():
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), params=Params(plane_friction=0.3))
    with pytest.raises(ValueError, match=r"plane_friction = 0\.3: would do nothing between periodic sector planes"):
        prepare(test)


def test_rough_planes_count_in_the_critical_time_step():
    """A lone ball on its plane, between smooth platens that press it with kn = 1 each: by hand, the largest omega^2 of
    sliding upwards with ks = 4 and spinning along, ((ks + 2 kn, s ks), (s ks, 5/2 ks))/m with s^2 = 5/2."""
    params = unit_params(friction=None, plane_friction=0.1, shear_stiffness=4.0, platen_friction=None)
    network = bearing_on_plane(params, 0, 0.0)[0]
    assert critical_time_step(Scene(), params, network, touching_within=1e-2) == pytest.approx(
        2 / (8 + 44**0.5) ** 0.5, rel=1e-6
    )


# What platens feel.

SMALL = fcc_octagon(layers=4, half_width=3)


def swirling(params, sector, seed=0):
    """A specimen squeezed by its platens that turns about the axis and drifts, every ball on a way of its own."""
    cut = cut_to_sector(SMALL, sector)
    network = build_contact_list(cut, sector)
    squeezed = [cut.bottom + 0.02, cut.top - 0.03]
    state = initial_state(SCENE, params, network, squeezed)
    place = np.asarray(network.positions)
    velocity = np.stack([-place[1], place[0], 0 * place[2]]) * 1e-3
    spin = np.zeros_like(place)
    spin[2] = 1e-3
    if sector.order == 1:
        rng = np.random.default_rng(seed)
        velocity += 0.02 * rng.normal(size=place.shape) + [[0.01], [0.02], [0.0]]
        spin += 1e-3 * rng.normal(size=place.shape)
    return network, state._replace(velocity=from_rows(velocity), spin=from_rows(spin))


def momenta(params, network, state):
    """Momentum and angular momentum about the origin, (3,) each; the latter from positions at t and velocities half a
    step before, whose change in a step is exactly the moment at t times the step."""
    mass = params.material.mass_per_cube * network.radius**3 * network.weight
    moving = positions(network, state).cross(state.velocity) * mass
    moving = moving + state.spin * (0.4 * mass * network.radius**2)
    linear = state.velocity * mass
    return [np.array([float(part.sum()) for part in vectors]) for vectors in (linear, moving)]


@pytest.mark.parametrize("friction", [0.3, float("inf")])
def test_platens_balance_momentum_and_angular_momentum_of_a_twisting_specimen(friction):
    """Sums over the balls are what platens feel, with the other sign, to 1e-12: at every step, and of the whole motion,
    whose turning they slow."""
    params = Params(platen_friction=friction, damping=Dashpot(0.1))
    network, state = swirling(params, Sector(1))
    dt = 0.2 * float(critical_time_step(SCENE, params, network))
    step = make_step(SCENE, still)
    load = no_load(network)

    @jit
    def twist(state):
        def one(state, _):
            forces = all_forces(SCENE, params, network, load, dt, state)
            felt = platen_loads(network, positions(network, state), forces.walls)
            return step(params, network, load, dt, state), jnp.stack([jnp.stack([*each]) for each in felt])

        return jax.lax.scan(one, state, None, length=300)

    end, felt = twist(state)
    impulse = dt * np.asarray(felt).sum(axis=(0, 3))  # over time and both platens
    before, after = momenta(params, network, state), momenta(params, network, end)
    scale = dt * np.abs(np.asarray(felt)).sum(axis=(0, 3)).max(axis=1)
    for change, first, last, size in zip(impulse, before, after, scale, strict=True):
        np.testing.assert_allclose(last - first, -change, rtol=0, atol=1e-12 * size)
    assert abs(after[1][2]) < 0.9 * abs(before[1][2]), "they slow its turning"
    records = platen_records(network, positions(network, end), all_forces(SCENE, params, network, load, dt, end).walls)
    last = np.asarray(
        platen_loads(network, positions(network, end), all_forces(SCENE, params, network, load, dt, end).walls)
    )
    found = [
        [float(records[f"{name}_{part}"]) for name in ("bottom", "top")] for part in ("shear_x", "shear_y", "torque")
    ]
    np.testing.assert_allclose(found, [*last[0, :2], last[1, 2]], rtol=1e-14)


@jit
def felt(params, network, state):
    forces = all_forces(SCENE, params, network, no_load(network), 0.05, state)
    return platen_records(network, positions(network, state), forces.walls)


def test_a_sector_feels_the_torque_of_the_whole_cylinder():
    """n times its own, and no horizontal force; a specimen that swells is held together, one that shrinks apart."""
    params = Params(platen_friction=0.3, damping=None)
    seen = []
    for sector in (Sector(1), Sector(4)):
        network, state = swirling(params, sector)
        place = np.asarray(network.positions)
        outward = np.stack([place[0], place[1], 0 * place[2]])
        swirl = np.stack([-place[1], place[0], 0 * place[2]])
        state = state._replace(velocity=from_rows(1e-3 * swirl + 2e-3 * outward), spin=from_rows(0 * place))
        seen.append({name: float(value) for name, value in felt(params, network, state).items()})
    full, quarter = seen
    assert quarter["end_restraint"] > 0.1 and full["top_torque"] > 0 and full["bottom_torque"] > 0
    for name in ("end_restraint", "top_torque", "bottom_torque"):
        assert quarter[name] == pytest.approx(full[name], rel=1e-9)
    assert quarter["top_shear_x"] == quarter["bottom_shear_y"] == 0
    assert abs(full["top_shear_x"]) < 1e-9 * abs(full["top_torque"])


@pytest.fixture(scope="module")
def rough_quarter():
    params = Params(friction=0.1, platen_friction=0.5, platen_speed=0.03)
    test = TriaxialTest(fcc_octagon(layers=5, half_width=3), params=params, tolerance=1e-5, axial_strain=0.02)
    progress = []
    return test, test.run(progress=progress.append), progress[-1]


def test_records_of_platens_are_there_where_they_are_rough(rough_quarter):
    """And smooth ones make a curve without them."""
    _, run, _ = rough_quarter
    assert run.curve.end_restraint.shape == run.curve.axial_strain.shape
    assert np.abs(run.curve.end_restraint[1:]).max() < 0.5 * (1 + 1e-9)
    assert float(np.abs(run.curve.top_torque).max()) > 0


def test_stress_of_the_balls_is_what_rough_platens_and_membrane_put_on_them(rough_quarter):
    """Love-Weber: the balls' stress summed over their volumes is the boundary forces times their places, the platens'
    friction included."""
    test, _, progress = rough_quarter
    seen = snapshot(test, progress)
    volume = 4 / 3 * np.pi * seen.balls.radius**3 * seen.balls.weight
    sideways = float(((seen.balls.stress[0, 0] + seen.balls.stress[1, 1]) * volume).sum())
    membrane = (
        seen.membrane.force * (np.hypot(*seen.balls.positions[:2]) + seen.balls.radius)[seen.membrane.number]
    ).sum()
    assert seen.platens.restraint > 0.015 * membrane
    assert sideways == pytest.approx(membrane + seen.platens.restraint, rel=2e-3)
