"""The sector against the full cylinder: what a ball feels must not depend on which image of it is simulated.

Units here: ball radius 1, ball mass 1, normal stiffness 1. A harmonic trap towards the axis, made with the
membrane's radial force on areas proportional to the distance from the axis, presses balls together and lets
them orbit at the rate TRAP_RATE whatever they do to one another.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Params, Scene
from axijax.core.sector import ON_AXIS, Sector, radial_distance
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import build_contact_list, carry_memory
from axijax.mechanics.dynamics import all_forces, initial_state, make_step, positions
from axijax.mechanics.membrane import Load
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon

TRAP_RATE = 0.1
STEP = 0.1
PARAMS = Params(
    friction=0.3,
    normal_stiffness=1.0,
    shear_stiffness=0.8,
    confining_stress=1.0,
    density=3 / (4 * np.pi),
    damping_ratio=0.05,
)
SCENE = Scene()
FAR_PLATENS = (-30.0, 30.0)
NO_LOAD = Load(jnp.zeros(2), jnp.ones(()))  # on two balls


class Motion(NamedTuple):
    """Ball by ball, (3, N) each."""

    positions: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def turned(sector, motion, k):
    """The motion of image k of each ball."""
    return Motion(*(sector.rotate(np.asarray(vectors), k) for vectors in motion))


def rotation(angle):
    """Matrix of a turn about z."""
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def specimen_of(positions, radius=1.0, platens=FAR_PLATENS):
    count = positions.shape[1]
    return Specimen(positions, np.broadcast_to(radius, (count,)), *platens, np.ones(count, bool))


def state_of(network, motion, platens):
    still = initial_state(SCENE, PARAMS, network, platens)
    return still._replace(velocity=from_rows(motion.velocity), spin=from_rows(motion.spin))


def motion_of(network, state):
    return Motion(*(np.asarray(v) for v in (positions(network, state), state.velocity, state.spin)))


forces_on = jax.jit(all_forces, static_argnums=0)


@jax.jit
def advance(steps, params, network, trap, state):
    """Steps with fixed platens in a harmonic trap of stiffness trap (N,)."""
    step = make_step(SCENE, lambda params, network, dt, state, push, area: jnp.zeros(2))

    def one(_, state):
        areas = trap * radial_distance(positions(network, state))
        return step(params, network, Load(areas, jnp.ones(())), STEP, state)

    return jax.lax.fori_loop(0, steps, one, state)


def moved(specimen, sector, motion, steps, params=PARAMS, skin=2.0, trap_rate=TRAP_RATE, **options):
    """The motion after so many steps, with the contact list of the start."""
    network = build_contact_list(specimen, sector, skin=skin, **options)
    state = state_of(network, motion, (specimen.bottom, specimen.top))
    state = advance(steps, params, network, trap_rate**2 * jnp.asarray(specimen.radius) ** 3, state)
    assert 2 * np.abs(np.asarray(state.displacement)).max() < skin, "the list of the start no longer holds"
    return motion_of(network, state)


def assert_same(found, expected, tolerance=1e-10):
    for name, one, other in zip(Motion._fields, found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=tolerance, err_msg=name)


# The sector's share of a cylinder.


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 12])
def test_home_image_lies_in_the_sector_and_a_ball_on_a_plane_belongs_to_theta_zero(order):
    """theta in [0, 2 pi / n), also for a centre on a plane that rounding puts on either side of it."""
    rng = np.random.default_rng(order)
    sector = Sector(order)
    theta = np.concatenate([rng.uniform(-7, 7, 200), np.arange(order) * sector.angle + 1e-15 * rng.normal(size=order)])
    rho = rng.uniform(1, 9, theta.size)
    positions = np.stack([rho * np.cos(theta), rho * np.sin(theta), rng.normal(size=theta.size)])
    home = sector.rotate(positions, sector.home_image(positions))
    np.testing.assert_allclose(np.hypot(home[0], home[1]), rho, rtol=1e-14)
    np.testing.assert_array_equal(home[2], positions[2])
    found = np.arctan2(home[1], home[0])
    within = (found >= -1e-14) & (found < sector.angle - 1e-9) if order > 1 else np.ones(theta.size, bool)
    assert within.all()
    np.testing.assert_allclose(found[200:], 0, atol=1e-14)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_sector_holds_its_share_of_every_ball(order):
    """Balls inside once, on a plane once, on the axis 1/n: n sectors make up the octagon."""
    octagon, sector = fcc_octagon(layers=3, half_width=5), Sector(order)
    cut = cut_to_sector(octagon, sector)
    on_axis = np.hypot(*cut.positions[:2]) == 0
    assert np.where(on_axis, 1 / order, 1.0).sum() * order == pytest.approx(len(octagon))
    network = build_contact_list(cut, sector)
    np.testing.assert_allclose(network.weight, np.where(on_axis, 1 / order, 1.0), rtol=1e-15)


def test_between_rigid_planes_a_random_specimen_keeps_the_balls_that_press_into_them():
    """A soft ball a third of its radius deep; a full cylinder is cut to the balls that lie wholly inside."""
    sector = Sector(4, "rigid")
    places = np.array([[13.4, 60.0, 60.0], [60.0, 60.0, 25.0], [30.0, 30.0, 30.0]])

    def random(places):
        count = places.shape[1]
        rest = {"membrane_zone": np.ones(count, bool), "zone_rule": "exposure", "bottom": 0.0, "top": 60.0}
        return Specimen(positions=places, radius=np.full(count, 20.0), name="random", **rest)

    assert len(cut_to_sector(random(places), sector)) == 3
    whole = np.concatenate([sector.rotate(places, turn) for turn in range(4)], axis=1)
    np.testing.assert_array_equal(cut_to_sector(random(whole), sector).positions, places[:, 1:])


# A pair that orbits the axis.

ORBIT_RADIUS = 12.0
BLOCKS, BLOCK_STEPS = 24, 27  # a little more than one turn
PLATEN_GAP = 2 - 1e-3


def orbiting_pair(spin):
    """Two balls side by side between lightly pressing platens, on a circular orbit in the trap. Moving on parallel
    paths they are pressed together by the trap, and their spins rub the contact."""
    overlap = TRAP_RATE**2 / (1 + TRAP_RATE**2 / 2)  # contact force against the trap's pull together
    along = np.array([np.cos(1.2), np.sin(1.2), 0.0])
    centre = ORBIT_RADIUS * np.array([np.cos(0.4), np.sin(0.4), 0.0])
    positions = np.stack([centre + along * (1 - overlap / 2), centre - along * (1 - overlap / 2)], axis=1)
    positions[2] = PLATEN_GAP / 2
    velocity = TRAP_RATE * np.cross([0.0, 0.0, 1.0], centre)
    return Motion(positions, np.stack([velocity, velocity], axis=1), np.outer(spin, [1.0, 1.0]))


class Record(NamedTuple):
    motion: Motion
    spring: np.ndarray  # (3,)
    image: int  # of the second ball


def is_sliding(params, record, network, state):
    """Whether the force of the pair's contact is at the Coulomb limit (without a sector)."""
    force = np.asarray(forces_on(SCENE, params, network, NO_LOAD, STEP, state).contacts.force)[:, 0]
    normal = record.motion.positions[:, 0] - record.motion.positions[:, 1]
    normal /= np.linalg.norm(normal)
    push = force @ normal
    return np.linalg.norm(force - push * normal) > (1 - 1e-9) * params.friction * push


def orbit(sector, params, motion, first_turns, sliding=None):
    """Records of the orbit after each block, every ball brought back into the sector between blocks.

    A ball that is replaced by its image k takes velocity, spin and springs along by the same turn, and its
    contacts are relabelled. The records are turned back, to where the balls would be without a sector.
    sliding: whether the contact must slide, or stick, after every block; None does not look.
    """
    platens = (0.0, PLATEN_GAP)
    build = partial(build_contact_list, sector=sector, skin=0.5)
    trap = TRAP_RATE**2 * jnp.ones(2)
    turns = np.array(first_turns)
    motion = turned(sector, motion, turns)
    network = build(specimen_of(motion.positions, platens=platens))
    state = state_of(network, motion, platens)
    records = []
    for _ in range(BLOCKS):
        state = advance(BLOCK_STEPS, params, network, trap, state)
        motion = motion_of(network, state)
        spring = np.asarray(state.spring)  # of the one contact, in the frame of its first ball, which is ball 0
        record = Record(turned(sector, motion, -turns), sector.rotate(spring, -turns[0])[:, 0], int(network.image[0]))
        records.append(record)
        if sliding is not None:
            assert is_sliding(params, record, network, state) == sliding
        # The pair moves as one, so that its list stays right however far it moves: without a sector it serves
        # the whole orbit. In a sector, bring the balls home.
        if sector.order == 1:
            continue
        home = sector.home_image(motion.positions)
        image = np.asarray(network.image)
        relabelled = np.where(image >= 0, (image + home[0] - home[1]) % sector.images, -1)
        old = replace(network, image=jnp.asarray(relabelled))
        motion, turns = turned(sector, motion, home), turns + home
        network = build(specimen_of(motion.positions, platens=platens))
        memory = carry_memory(old, network, state.with_spring(from_rows(sector.rotate(spring, home[0]))).memory)
        state = state_of(network, motion, state.platens)._replace(memory=memory, time=state.time)
    return records


@pytest.fixture(scope="module", params=["sticking", "sliding"])
def free_orbit(request):
    """The orbit without a sector."""
    sliding = request.param == "sliding"
    params = replace(PARAMS, friction=0.02 if sliding else 0.6)
    motion = orbiting_pair(np.array([0.03, 0.0, 0.06]) if sliding else np.array([1e-3, 0.0, 1.5e-3]))
    records = orbit(Sector(1), params, motion, [0, 0], sliding)
    angles = np.unwrap([np.arctan2(*record.motion.positions[1::-1, 0]) for record in records])
    assert angles[-1] - angles[0] > 2 * np.pi * 0.95, "the pair must orbit once"
    assert max(np.abs(record.spring).max() for record in records) > 1e-4, "the contact must carry a spring"
    return params, motion, records


@pytest.mark.parametrize("order", [2, 3, 12])
def test_pair_orbiting_across_the_planes_moves_as_without_a_sector(free_orbit, order):
    """Position, velocity, spin and spring are those of the run without a sector, through all planes of a full turn."""
    params, motion, expected = free_orbit
    found = orbit(Sector(order), params, motion, [0, 1])
    assert len({record.image for record in found}) >= 2, "the contact must cross a plane"
    for one, other in zip(found, expected, strict=True):
        assert_same(one.motion, other.motion)
        np.testing.assert_allclose(one.spring, other.spring, rtol=0, atol=1e-10)


# Forces at one moment.


@pytest.mark.parametrize("order", [2, 3, 12])
def test_pair_near_a_plane_feels_the_force_of_the_pair_turned_into_the_interior(order):
    """Same force, moment and new spring, whatever velocities, spins and spring a pair across a plane has."""
    rng = np.random.default_rng(order)
    sector = Sector(order)
    straddling = (rng.normal(size=(3, 2)), 0.01 * rng.normal(size=(3, 2)), 0.01 * rng.normal(size=(3, 2)))
    branch = straddling[0][:, 0] / np.linalg.norm(straddling[0][:, 0]) * [1, 1, 0.3]
    branch *= 1.98 / np.linalg.norm(branch)
    spring = 0.002 * np.cross(branch, rng.normal(size=3))
    centre = np.array([15.0, 0.0, 0.0])  # on the plane theta = 0
    motion = Motion(np.stack([centre + branch / 2, centre - branch / 2], axis=1), *straddling[1:])

    def response(motion, first_turns, spring, expected_image):
        motion = turned(sector, motion, first_turns)
        network = build_contact_list(specimen_of(motion.positions), sector, skin=0.1)
        assert int(network.image[0]) == expected_image
        springs = np.zeros((3, network.first.size))
        springs[:, 0] = sector.rotate(spring, first_turns[0])
        state = state_of(network, motion, FAR_PLATENS).with_spring(from_rows(springs))
        forces = forces_on(SCENE, PARAMS, network, NO_LOAD, STEP, state)
        on_balls = [sector.rotate(np.asarray(v), -np.asarray(first_turns)) for v in (forces.resultant, forces.moment)]
        return *on_balls, sector.rotate(np.asarray(forces.contacts.spring), -first_turns[0])[:, 0]

    home = sector.home_image(motion.positions)
    assert home[0] != home[1]
    half = rotation(sector.angle / 2)
    inside = response(Motion(*(half @ vectors for vectors in motion)), [0, 0], half @ spring, 0)
    across = response(motion, home, spring, (home[0] - home[1]) % order)
    for found, expected in zip(across, inside, strict=True):
        assert np.abs(expected).max() > 1e-4
        np.testing.assert_allclose(half @ found, expected, rtol=0, atol=1e-13)


def pressed_octagon(radius=1.0):
    """A small octagonal specimen with all contacts pressed by 0.5 % of the radius, centred on z = 0."""
    octagon = fcc_octagon(radius=radius, layers=3, half_width=3)
    positions = 0.995 * (octagon.positions - [[0], [0], [octagon.height / 2]])
    return replace(octagon, positions=positions, bottom=-octagon.height / 2, top=octagon.height / 2)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("friction", [None, 0.3])
def test_rigid_swirl_makes_no_force(order, friction):
    """A pressed specimen that spins rigidly about its axis feels the forces of one at rest, turned with it.

    Images that were mirrored would collide with the swirl. With friction nothing slips either.
    """
    sector, params = Sector(order), replace(PARAMS, friction=friction)
    network = build_contact_list(cut_to_sector(pressed_octagon(), sector), sector)
    place = np.asarray(network.positions)
    rate, angle = 0.1, 0.02
    turn = rotation(angle)
    axis = np.array([[0.0], [0.0], [1.0]])
    rest = initial_state(SCENE, params, network, [-9.0, 9.0])
    swirl = rest._replace(
        displacement=from_rows(turn @ place - place),
        velocity=from_rows(rate * np.cross(axis, turn @ place, axis=0)),
        spin=from_rows(rate * axis * np.ones_like(place)) if friction is not None else None,
    )
    no_load = Load(jnp.zeros(place.shape[1]), jnp.ones(()))
    expected, found = (forces_on(SCENE, params, network, no_load, STEP, state) for state in (rest, swirl))
    assert np.abs(np.asarray(expected.resultant)).max() > 1e-3
    resultants = [np.asarray(forces.resultant) for forces in (found, expected)]
    np.testing.assert_allclose(resultants[0], turn @ resultants[1], rtol=0, atol=1e-14)
    if friction is not None:
        np.testing.assert_allclose(np.asarray(found.moment), 0, atol=1e-14)


# Balls near the axis, and whole specimens, each against all n turned copies without a sector.


def assert_moves_as_full_cylinder(specimen, sector, steps, seed=0, speed=0.01, **options):
    """Random velocities and spins: every copy in the full cylinder moves as the turned ball of the sector."""
    rng = np.random.default_rng(seed)
    on_axis = sector.on_axis(specimen.positions, specimen.radius)
    allowed = np.where(on_axis, [[0.0], [0.0], [1.0]], 1.0)
    velocity, spin = speed * allowed * rng.normal(size=(2, 3, len(specimen)))
    start = Motion(specimen.positions, velocity, spin)

    which, k = np.divmod(np.arange(len(specimen) * sector.order), sector.order)
    single = (k == 0) | ~on_axis[which]
    which, k = which[single], k[single]

    def unfolded(motion):
        return Motion(*(sector.rotate(vectors[:, which], k) for vectors in motion))

    full = replace(specimen.select(which), positions=unfolded(start).positions)
    expected = moved(full, Sector(1), unfolded(start), steps, **options)
    found = moved(specimen, sector, start, steps, **options)
    change = np.linalg.norm(found.velocity - start.velocity, axis=0)
    assert change.min() > 1e-4, "every ball must feel something"
    assert_same(unfolded(found), expected)
    # Exactly, or rounding would grow on an axis that is no stable place.
    assert (found.positions[:2, on_axis] == 0).all() and (found.spin[:2, on_axis] == 0).all()


def contact_images(specimen, sector, i, j, **options):
    """The images of ball j that ball i, which is not on the axis, may touch; j = i for its own."""
    network = build_contact_list(specimen, sector, skin=0.0, **options)
    listed = zip(*(np.asarray(a).tolist() for a in (network.first, network.second, network.image)), strict=True)
    images = set()
    for first, second, k in listed:
        if (first, second) == (i, j) and k >= 0:
            images.add(k)
        if (second, first) == (i, j) and k >= 0:
            images.add(-k % sector.order)
    return sorted(images)


def polar(*balls):
    """Positions (3, N) from (rho, theta in degrees, z)."""
    rho, theta, z = np.array(balls, float).T
    return np.stack([rho * np.cos(np.deg2rad(theta)), rho * np.sin(np.deg2rad(theta)), z])


@pytest.mark.parametrize("order", [3, 6])
def test_ball_protruding_from_both_planes(order):
    """Type B: it presses on its own two neighbouring images, and on other balls across either plane."""
    sector = Sector(order)
    half = 180 / order
    rho = 0.99 / np.sin(np.pi / order)
    above = np.sqrt(1.98**2 - (rho * 2 * np.sin(np.pi / order / 2)) ** 2)  # over the gap between two images
    specimen = specimen_of(polar((rho, half, 0), (rho, 0.0, above), (rho + 1.97, half, 0.1)))
    assert contact_images(specimen, sector, 0, 0) == sorted({1, order - 1})
    assert contact_images(specimen, sector, 0, 1) == [0, 1]
    assert_moves_as_full_cylinder(specimen, sector, 60)


@pytest.mark.parametrize("order", [2, 5])
def test_balls_with_their_centre_on_the_axis(order):
    """Type F: two of them on the axis meet each other once, each neighbour under all n images, and stay there."""
    sector = Sector(order)
    height = np.sqrt(1.99**2 - 1.8**2)
    specimen = specimen_of(polar((0, 0, 0), (0, 0, 1.99), (1.8, 20, -height), (1.8, 30, 1.99 + height)))
    assert contact_images(specimen, sector, 0, 0) == []
    assert contact_images(specimen, sector, 0, 1) == [0]
    assert contact_images(specimen, sector, 2, 0) == contact_images(specimen, sector, 3, 1) == [0]
    assert_moves_as_full_cylinder(specimen, sector, 60)


def test_ball_that_touches_its_own_image_at_180_degrees():
    """With n = 2 a ball near the axis presses on its opposite self, and on both images of a ball above the gap."""
    sector = Sector(2)
    specimen = specimen_of(polar((0.99, 30, 0), (0.99, 120, np.sqrt(1.98**2 - 2 * 0.99**2))))
    assert contact_images(specimen, sector, 0, 0) == [1]
    assert contact_images(specimen, sector, 0, 1) == [0, 1]
    assert_moves_as_full_cylinder(specimen, sector, 60)


def test_ball_that_touches_all_its_images_at_once():
    """Soft balls pushed far into one another at the axis of a quarter: the image at 180 degrees counts too."""
    sector = Sector(4)
    specimen = specimen_of(polar((0.8, 40, 0), (0.75, 10, 1.2)))
    assert contact_images(specimen, sector, 0, 0, largest_overlap=2.0) == [1, 2, 3]
    assert contact_images(specimen, sector, 0, 1, largest_overlap=2.0) == [0, 1, 2, 3]
    assert_moves_as_full_cylinder(specimen, sector, 8, skin=4.0, largest_overlap=2.0)


@pytest.mark.parametrize("order", [2, 4])
def test_octagon_sector_moves_as_the_full_octagon(order):
    """All kinds of balls at once: on the axis, on a plane, protruding, inside; in the platens' grip."""
    sector = Sector(order)
    assert_moves_as_full_cylinder(cut_to_sector(pressed_octagon(), sector), sector, 100, seed=order)


@pytest.mark.parametrize("order", [4, 6])
def test_any_choice_of_representatives_runs_identically(order):
    """Each ball replaced by a random image of itself: the same motion, turned."""
    rng = np.random.default_rng(order)
    sector = Sector(order)
    specimen = cut_to_sector(pressed_octagon(), sector) if order == 4 else crowded(order, rng)
    on_axis = sector.on_axis(specimen.positions, specimen.radius)
    allowed = np.where(on_axis, [[0.0], [0.0], [1.0]], 1.0)
    start = Motion(specimen.positions, *(0.01 * allowed * rng.normal(size=(2, 3, len(specimen)))))
    run = partial(moved, sector=sector, steps=60, skin=3.0)
    expected = run(specimen, motion=start)
    assert np.linalg.norm(expected.velocity - start.velocity, axis=0).min() > 1e-4, "every ball must feel something"
    k = rng.integers(order, size=len(specimen))
    start_turned = turned(sector, start, k)
    other = replace(specimen, positions=start_turned.positions)
    images = np.asarray(build_contact_list(other, sector, skin=0.1).image)
    assert set(range(2, order - 1)) & set(images.tolist()), "images beyond the next ones must come up"
    assert_same(turned(sector, run(other, motion=start_turned), -k), expected)


def crowded(order, rng):
    """Unequal balls thrown one by one into a sector, none overlapping another by more than 3 % of the radius."""
    sector = Sector(order)
    positions, radius = polar((0, 0, 0), (1.5, 10, 0)), np.array([0.8, 0.72])
    while radius.size < 14:
        new = polar((5 * np.sqrt(rng.uniform()), rng.uniform(0, 360 / order), rng.uniform(-2, 2)))
        size = rng.uniform(0.5, 1.0)
        trial = specimen_of(np.concatenate([positions, new], axis=1), np.append(radius, size))
        try:
            build_contact_list(trial, sector, largest_overlap=0.03)
        except ValueError:
            continue
        positions, radius = trial.positions, trial.radius
    return specimen_of(positions, radius)


@pytest.mark.parametrize(("distance", "on"), [(0.0, True), (0.9, True), (1.1, False)])
def test_a_ball_is_on_the_axis_within_a_millionth_of_its_radius(distance, on):
    radius = 20.0
    place = np.array([[distance * 1e-6 * radius], [0.0], [5.0]])
    assert Sector(4).on_axis(place, radius)[0] == on and ON_AXIS == 1e-6
