"""The membrane: Voronoi cells that tile the unfolded cylinder, and forces that point to the axis."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import Voronoi

from axijax import Scene
from axijax.core.sector import Sector
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.dynamics import initial_state, make_step, positions
from axijax.mechanics.membrane import (
    build_membrane,
    cell_areas,
    membrane_force,
    membrane_load,
    membrane_radius,
    stale_cells,
)
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_cylinder, fcc_octagon
from axijax.triaxial.test import TriaxialTest

HEIGHT = 12.0
COUNT = 12  # balls of most zones, and
TRIANGLES = 150  # as many triangles as they may need: arrays of one shape are compiled once
PERIODIC = [Sector(order) for order in (1, 2, 3, 4, 6, 12)]
RIGID = [Sector(order, "rigid") for order in (3, 4, 7)]


def zone_specimen(theta, height, rho=10.0):
    """Balls that all carry the membrane, between platens at 0 and HEIGHT."""
    rho = np.broadcast_to(rho, np.shape(theta))
    positions = np.stack([rho * np.cos(theta), rho * np.sin(theta), height])
    return Specimen(positions, 0.5, 0.0, HEIGHT, np.ones(positions.shape[1], bool))


def random_zone(sector, seed=0, count=COUNT):
    """Balls thrown on the sector's part of an uneven cylinder, none nearer to another than 0.6 of the mean spacing."""
    rng = np.random.default_rng(seed)
    spacing = np.sqrt(9.5 * sector.angle * HEIGHT / count)
    places = np.zeros((2, 0))
    while places.shape[1] < count:
        new = np.array([rng.uniform(0, sector.angle), rng.uniform(0.1, HEIGHT - 0.1)])
        across = np.abs(places[0] - new[0])
        if sector.boundary == "periodic":
            across = np.minimum(across, sector.angle - across)
        if (np.hypot(9.5 * across, places[1] - new[1]) > 0.6 * spacing).all():
            places = np.concatenate([places, new[:, None]], axis=1)
    return zone_specimen(*places, rng.uniform(9, 10, count))


fast_areas, fast_stale = jax.jit(cell_areas), jax.jit(stale_cells)


def membrane_of(specimen, sector):
    few = specimen.membrane_zone.sum() <= COUNT
    return build_membrane(specimen, sector, triangles=TRIANGLES if few else None)


def areas_of(specimen, sector, membrane=None):
    membrane = membrane_of(specimen, sector) if membrane is None else membrane
    return np.asarray(fast_areas(membrane, from_rows(specimen.positions), specimen.bottom, specimen.top))


def strip_area(specimen, sector):
    """Area of the strip (2 pi Rm / n) H that the cells tile, Rm through the middle of the zone."""
    rho = np.hypot(*specimen.positions[:2, specimen.membrane_zone])
    return sector.angle * (rho.min() + rho.max()) / 2 * specimen.height


def voronoi_areas(specimen, sector):
    """Areas of SciPy's Voronoi polygons around the zone's balls among two periods, and two mirror images, all round."""
    points = specimen.positions[:, specimen.membrane_zone]
    rho, theta = np.hypot(points[0], points[1]), np.mod(np.arctan2(points[1], points[0]), 2 * np.pi)
    middle = (rho.min() + rho.max()) / 2
    width, height, rigid = middle * sector.angle, specimen.height, sector.boundary == "rigid"

    def copies(values, length, mirrored):
        shifts = np.arange(-2, 3)[:, None] * length * (2 if mirrored else 1)
        return np.concatenate([values + shifts, -values + shifts]) if mirrored else values + shifts

    x = copies(middle * theta if rigid else np.mod(middle * theta, width), width, rigid)
    z = specimen.bottom + copies(points[2] - specimen.bottom, height, True)
    everywhere = np.stack([np.broadcast_to(a, (x.shape[0], z.shape[0], x.shape[1])) for a in (x[:, None], z[None])], -1)
    diagram = Voronoi(everywhere.reshape(-1, 2))
    areas = np.zeros(len(specimen))
    for place, ball in enumerate(np.flatnonzero(specimen.membrane_zone)):
        own = (2 * z.shape[0] + 2) * x.shape[1] + place  # the copy of shift zero, not mirrored
        corners = diagram.vertices[diagram.regions[diagram.point_region[own]]]
        turned = np.arctan2(*(corners - corners.mean(axis=0)).T)
        u, v = corners[np.argsort(turned)].T
        areas[ball] = 0.5 * abs(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1)))
    return areas


def lattice(sector, columns, rows, on_plate):
    """Balls on a rectangular grid (four cells meet in every corner), a column at theta = 0; rows on the platens too."""
    theta = np.arange(columns) * sector.angle / columns
    height = np.linspace(0, HEIGHT, rows) if on_plate else (np.arange(rows) + 0.5) * HEIGHT / rows
    return zone_specimen(*(grid.ravel() for grid in np.meshgrid(theta, height)))


def tilings():
    for sector in PERIODIC:
        yield f"random n={sector.order}", random_zone(sector), sector
        yield f"grid n={sector.order}", lattice(sector, 3, 4, on_plate=False), sector
        yield f"grid on the platens n={sector.order}", lattice(sector, 3, 4, on_plate=True), sector
    for sector in RIGID:
        yield f"random rigid n={sector.order}", random_zone(sector), sector
    octagon = fcc_octagon(layers=5, half_width=5)
    cylinder = fcc_cylinder(layers=4, specimen_radius=120.0)
    for sector in (Sector(1), Sector(4), Sector(4, "rigid")):
        for specimen in (octagon, cylinder):
            yield f"{specimen.name} n={sector.order} {sector.boundary}", cut_to_sector(specimen, sector), sector


TILINGS = {name: (specimen, sector) for name, specimen, sector in tilings()}


@pytest.mark.parametrize("name", TILINGS)
def test_cells_tile_the_strip_and_carry_its_whole_load(name):
    """The areas add up to (2 pi Rm / n) H to rounding, and the radial forces to s3 times that."""
    specimen, sector = TILINGS[name]
    areas = areas_of(specimen, sector)
    assert (areas[specimen.membrane_zone] > 0).all() and (areas[~specimen.membrane_zone] == 0).all()
    np.testing.assert_allclose(areas.sum(), strip_area(specimen, sector), rtol=1e-12)
    force = np.asarray(membrane_force(5.0e4, jnp.asarray(areas), from_rows(specimen.positions)))
    np.testing.assert_allclose(np.linalg.norm(force, axis=0).sum(), 5.0e4 * strip_area(specimen, sector), rtol=1e-12)


FEW = {
    "one ball": ([0.3], [4.0]),
    "one ball at theta = 0": ([0.0], [4.0]),
    "one ball on the bottom platen": ([0.3], [0.0]),
    "one ball on the top platen": ([0.0], [HEIGHT]),
    "two balls, one above the other": ([0.2, 0.2], [3.0, 8.0]),
    "two balls, one on either platen": ([0.2, 0.4], [0.0, HEIGHT]),
    "three balls of one height": ([0.0, 0.2, 0.4], [6.0, 6.0, 6.0]),
}


@pytest.mark.parametrize("sector", [Sector(1), Sector(4), Sector(4, "rigid")], ids=str)
@pytest.mark.parametrize("name", FEW)
def test_few_balls_tile_the_strip_or_are_refused(name, sector):
    """However few the balls, their cells tile the strip, or a sentence says that there are too few for a cell."""
    theta, height = (np.array(values, float) for values in FEW[name])
    specimen = zone_specimen(theta, height)
    try:
        membrane = membrane_of(specimen, sector)
    except ValueError as error:
        assert "membrane_zone" in str(error)
        return
    areas = areas_of(specimen, sector, membrane)
    np.testing.assert_allclose(areas.sum(), strip_area(specimen, sector), rtol=1e-12)
    assert (areas > 0).all()


def test_two_balls_at_one_place_are_refused():
    with pytest.raises(ValueError, match=r"membrane_zone: ball [01] .* same place"):
        build_membrane(zone_specimen(np.array([0.3, 0.3, 1.0]), np.array([4.0, 4.0, 6.0])), Sector(4))


@pytest.mark.parametrize("sector", PERIODIC + RIGID, ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_areas_are_those_of_the_voronoi_polygons(sector, seed):
    specimen = random_zone(sector, seed)
    np.testing.assert_allclose(areas_of(specimen, sector), voronoi_areas(specimen, sector), rtol=1e-9)


@pytest.mark.parametrize("on_plate", [False, True])
@pytest.mark.parametrize("order", [1, 4])
def test_equal_balls_on_a_grid_have_equal_cells(order, on_plate):
    """Each cell is one mesh of the grid, half a mesh for a centre on a platen; theta = 0 is no exception."""
    sector = Sector(order)
    areas = areas_of(lattice(sector, 4, 5, on_plate), sector).reshape(5, 4)
    mesh = 10 * sector.angle / 4 * HEIGHT / (4 if on_plate else 5)
    share = np.where(on_plate & np.isin(np.arange(5), [0, 4]), 0.5, 1.0)
    np.testing.assert_allclose(areas, mesh * share[:, None] * np.ones(4), rtol=1e-12)


def test_the_section_is_that_of_the_sector_of_radius_rm():
    """What the platens carry: 1/n of the circle of radius Rm, which times H is the strip's area times Rm/2."""
    specimen, sector = random_zone(Sector(6)), Sector(6)
    load = jax.jit(membrane_load)(membrane_of(specimen, sector), from_rows(specimen.positions), 0.0, HEIGHT)
    radius = strip_area(specimen, sector) / (sector.angle * HEIGHT)
    assert float(load.section) == pytest.approx(np.pi * radius**2 / 6, rel=1e-12)
    np.testing.assert_allclose(load.lateral, areas_of(specimen, sector), rtol=1e-12)


@pytest.mark.parametrize("sector", [Sector(1), Sector(4), Sector(6, "rigid")], ids=str)
def test_derivatives_of_the_areas_against_differences(sector):
    """Exact tangents of every area, along a motion of all balls and both platens."""
    specimen = random_zone(sector, seed=3)
    membrane = membrane_of(specimen, sector)
    rng = np.random.default_rng(1)
    start = (from_rows(specimen.positions), 0.0, HEIGHT)
    along = (from_rows(rng.normal(size=specimen.positions.shape)), 0.4, -0.7)
    tangent = jax.jit(lambda start, along: jax.jvp(partial(cell_areas, membrane), start, along)[1])(start, along)

    def areas(h):
        return fast_areas(membrane, *jax.tree.map(lambda value, rate: value + h * rate, start, along))

    h = 1e-5
    difference = (areas(h) - areas(-h)) / (2 * h)
    assert np.abs(difference).max() > 1
    np.testing.assert_allclose(tangent, difference, rtol=0, atol=1e-7 * np.abs(difference).max())


@pytest.mark.parametrize("sector", [Sector(1), Sector(4), Sector(12), Sector(4, "rigid")], ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_stale_cells_tells_whether_the_old_triangulation_still_gives_the_areas(sector, seed):
    """Balls move step by step: as long as stale_cells is zero, the areas of the old triangulation are those of a
    fresh one; once they are not, it is positive and of the order of the error."""
    specimen = random_zone(sector, seed)
    membrane = membrane_of(specimen, sector)
    rng = np.random.default_rng(seed + 100)
    motion = rng.normal(size=specimen.positions.shape)
    motion[2] *= specimen.positions[2] * (HEIGHT - specimen.positions[2]) / 36  # stays between the platens
    spacing = np.sqrt(strip_area(specimen, sector) / len(specimen))
    seen = []
    for size in np.concatenate([[0.0], 0.001 * 1.4 ** np.arange(20)]) * spacing:
        positions = specimen.positions + size * motion
        inside = (positions[2] > 0) & (positions[2] < HEIGHT)
        if sector.boundary == "rigid":
            inside &= sector.angle_of(positions) < sector.angle
        if not inside.all() or sum(error > 1e-4 for _, error in seen) == 2:
            break
        now = replace(specimen, positions=positions)
        stale = float(fast_stale(membrane, from_rows(positions), 0.0, HEIGHT))
        old, fresh = areas_of(now, sector, membrane), areas_of(now, sector)
        error = np.abs(old - fresh).max() / strip_area(now, sector)
        seen.append((stale, error))
        np.testing.assert_allclose(old.sum(), strip_area(now, sector), rtol=1e-9)
    stale, error = np.array(seen).T
    assert error[1] < 1e-12 and error[-1] > 1e-4, "the motion must be small at first and large in the end"
    np.testing.assert_array_less(error, 4 * stale + 1e-12)
    assert (error[stale > 1e-3] > 1e-6).all(), "no false alarm"


def test_a_ball_squeezed_far_out_is_loaded_but_does_not_set_the_radius():
    """Rm stays that of the others, and with it the load; the ball keeps a cell."""
    sector = Sector(4)
    specimen = lattice(sector, 3, 4, on_plate=False)
    positions = np.array(specimen.positions)
    positions[:2, 4] *= 1.5
    squeezed = replace(specimen, positions=positions)
    assert float(membrane_radius(membrane_of(squeezed, sector), from_rows(positions))) == pytest.approx(10, rel=1e-12)
    np.testing.assert_allclose(areas_of(squeezed, sector), areas_of(specimen, sector), rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_cells_are_voronoi_cells_with_a_ball_squeezed_out_too(seed):
    """The triangulation is made for the radius that the areas are taken at."""
    sector = Sector(4)
    specimen = random_zone(sector, seed)
    positions = np.array(specimen.positions)
    positions[:2, 4] *= 1.6
    squeezed = replace(specimen, positions=positions)
    membrane = membrane_of(squeezed, sector)
    rho = np.delete(np.hypot(*positions[:2]), 4)
    middle = (rho.min() + rho.max()) / 2
    assert float(membrane_radius(membrane, from_rows(positions))) == pytest.approx(middle, rel=1e-12)
    assert float(fast_stale(membrane, from_rows(positions), 0.0, HEIGHT)) < 1e-12
    positions[:2, 4] *= rho.min() / np.hypot(*positions[:2, 4])  # to a place where it does not change Rm
    expected = voronoi_areas(replace(specimen, positions=positions), sector)
    np.testing.assert_allclose(areas_of(squeezed, sector, membrane), expected, rtol=1e-9)


def test_force_points_from_the_current_position_to_the_axis():
    """stress * area, horizontal, towards the axis, and none outside the zone or on the axis."""
    rng = np.random.default_rng(0)
    specimen = cut_to_sector(fcc_octagon(layers=3, half_width=3), Sector(4))
    positions = specimen.positions + rng.normal(size=specimen.positions.shape)
    positions[:2, 0] = 0.0
    areas = np.where(specimen.membrane_zone, rng.uniform(1, 2, len(specimen)), 0.0)
    force = np.asarray(membrane_force(3.0, jnp.asarray(areas), from_rows(positions)))
    rho = np.hypot(*positions[:2])
    expected = np.where(rho > 0, -3.0 * areas * positions / np.where(rho > 0, rho, 1), 0) * [[1], [1], [0]]
    np.testing.assert_allclose(force, expected, rtol=1e-13, atol=0)


def test_spin_of_the_specimen_is_not_driven():
    """A confined specimen given a small rigid swirl keeps its angular momentum about z. Membrane forces with frozen
    directions would drive it at the rate 2 sqrt(s3 / density) / R (PHYSICS.md 1.3)."""
    sector = Sector(4)
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), sector, tolerance=1e-4)
    network, membrane, params = test.network, test.membrane, test.params
    confined, _ = test.confine()
    scene = Scene()
    place = network.positions + confined.displacement
    swirl = 1e-4
    still = jnp.zeros_like(place.x)
    state = initial_state(scene, params, network, confined.platens)._replace(
        displacement=confined.displacement,
        velocity=Vector(-swirl * place.y, swirl * place.x, still),
        spin=Vector(still, still, still + swirl),
    )
    step = make_step(scene, lambda params, network, dt, state, push, section: jnp.zeros(2))
    mass = params.material.mass_per_cube * network.radius**3 * network.weight

    def momentum(state):
        x, y, _ = positions(network, state)
        orbital = mass * (x * state.velocity.y - y * state.velocity.x)
        return (orbital + 0.4 * mass * network.radius**2 * state.spin.z).sum()

    @jax.jit
    def run(state):
        def block(state, _):
            load = membrane_load(membrane, positions(network, state), *state.platens)
            dt = test.prepared.time_step
            state = jax.lax.fori_loop(0, 20, lambda _, s: step(params, network, load, dt, s), state)
            return state, momentum(state)

        return jax.lax.scan(block, state, None, length=40)

    final, history = run(state)
    rate = 2 * np.sqrt(params.confining_stress / params.density) / float(membrane_radius(membrane, place))
    assert rate * float(final.time) > 2, "long enough for several e-folds of the instability"
    np.testing.assert_allclose(history, momentum(state), rtol=0.01)
