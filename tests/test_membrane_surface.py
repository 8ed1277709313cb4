"""A membrane that is normal to its own surface rho(z): sum rules, cones, ends tied to the platens, derivatives."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import jit
from test_membrane import HEIGHT, PERIODIC, RIGID, TILINGS, lattice, membrane_of, random_zone

from axijax import Params, Scene, Sector, TriaxialTest, fcc_octagon
from axijax.core.vector import from_rows
from axijax.mechanics.contact_search import rebuild_in_jit
from axijax.mechanics.dynamics import initial_state
from axijax.mechanics.membrane import Load, lateral_force, membrane_load, membrane_radius, sloping
from axijax.mechanics.membrane_surface import straightened
from axijax.mechanics.outer_balls import cell_polygons
from axijax.mechanics.rebuild import rebuild_on_host
from axijax.specimen.specimen import cut_to_sector
from axijax.triaxial.checkpoint import load_progress, save_progress
from axijax.triaxial.engine import fixed_load
from axijax.triaxial.prepare import prepare
from axijax.triaxial.progress import Progress
from axijax.triaxial.records import Confinement, no_records

loads = jit(membrane_load)
# Of the lattices one: every other has a shape of its own, to be compiled.
SOME = [name for name in TILINGS if not name.startswith("FCC") or name == "FCC octagon, 5 layers n=4 periodic"]


def moved(specimen, radial):
    """The specimen with its zone's balls moved outwards by radial(z)."""
    rho = np.hypot(*specimen.positions[:2])
    stretch = 1 + np.where(specimen.membrane_zone, radial(specimen.positions[2]), 0) / np.where(rho > 0, rho, 1)
    return replace(specimen, positions=specimen.positions * np.stack([stretch, stretch, np.ones_like(stretch)]))


def load_of(made, now, sector, tied=False):
    """Load of a specimen that was made as `made` and is now as `now`."""
    membrane = sloping(membrane_of(now, sector), made, tied)
    return membrane, loads(membrane, from_rows(now.positions), now.bottom, now.top)


def barrel(made):
    """Wider at three quarters of the height than at half, narrower at the bottom than at the top [L]."""
    bottom, top = made.bottom, made.top

    def radial(z):
        x = (2 * z - bottom - top) / (top - bottom)
        return 0.06 * np.hypot(*made.positions[:2]).max() * (0.3 * x + 0.5 * x**2 - x**4)

    return radial


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("name", SOME)
def test_all_axial_forces_add_up_to_the_difference_of_the_ends(name, tied):
    """To rounding, for balls on platens and planes too; the horizontal forces are what they are without a slope."""
    made, sector = TILINGS[name]
    now = moved(made, barrel(made))
    membrane, load = load_of(made, now, sector, tied)
    plain = loads(replace(membrane, surface=None), from_rows(now.positions), now.bottom, now.top)
    section = float(load.section)
    assert float(jnp.abs(load.axial).sum()) > 1e-3 * section
    assert float(load.axial.sum()) == pytest.approx(float(load.ends[1] - load.ends[0]), rel=0, abs=1e-12 * section)
    if tied:
        rim = 0.5 * sector.angle * float(membrane_radius(membrane, from_rows(made.positions))) ** 2
        np.testing.assert_allclose(load.ends, [rim, rim], rtol=1e-13)
    np.testing.assert_array_equal(load.lateral, plain.lateral)
    forces = [np.asarray(lateral_force(5.0e4, each, from_rows(now.positions))) for each in (load, plain)]
    np.testing.assert_array_equal(forces[0][:2], forces[1][:2])
    np.testing.assert_allclose(forces[0][2], 5.0e4 * np.asarray(load.axial), rtol=1e-14)
    assert plain.axial is None and plain.ends is None and (forces[1][2] == 0).all()


@pytest.mark.parametrize("sector", [Sector(1), Sector(6), Sector(4, "rigid")], ids=str)
def test_balls_between_two_heights_bear_the_difference_of_the_sections_there(sector):
    """On a grid, whose cells end at known heights; the sections are those of the quartic by which it was widened."""
    made = lattice(sector, 4, 8, on_plate=False)
    radial = barrel(made)
    now = moved(made, radial)
    _, load = load_of(made, now, sector)
    edges = np.linspace(0, HEIGHT, 9)
    mean = np.average(radial((edges[1:] + edges[:-1]) / 2))
    x, w = np.polynomial.legendre.leggauss(5)
    over_height = (w * radial(HEIGHT / 2 * (1 + x))).sum() / 2
    rho = 10 + radial(edges)
    middle = (np.hypot(*now.positions[:2]).min() + np.hypot(*now.positions[:2]).max()) / 2
    assert abs(mean - over_height) > 1e-3, "the mean is one over the height"
    sections = sector.angle / 2 * (rho - 10 - over_height + middle) ** 2
    rows = np.asarray(load.axial).reshape(8, 4).sum(axis=1)
    np.testing.assert_allclose(rows, np.diff(sections), rtol=0, atol=1e-10 * sections[0])
    np.testing.assert_allclose(load.ends, sections[[0, -1]], rtol=1e-11)


@pytest.mark.parametrize("sector", PERIODIC + RIGID, ids=str)
def test_on_a_cone_every_ball_bears_the_integral_of_the_slope_over_its_cell(sector):
    """s3 times rho rho' over Rm, at the centroid of the cell's polygon, times its area: normal to the surface."""
    made = random_zone(sector)
    now = moved(made, lambda z: 0.05 * z)
    membrane, load = load_of(made, now, sector)
    cells = cell_polygons(now, sector)
    middle = float(membrane_radius(membrane, from_rows(now.positions)))
    heights = []
    for polygon in cells.polygons:
        (x, z), (x1, z1) = polygon.T, np.roll(polygon, -1, 0).T
        cross = x * z1 - x1 * z
        heights.append(((z + z1) * cross).sum() / (3 * cross.sum()))
    rho = middle + 0.05 * (np.array(heights) - HEIGHT / 2)
    expected = cells.areas * rho * 0.05 / middle
    np.testing.assert_allclose(np.asarray(load.axial)[cells.balls], expected, rtol=1e-8)


@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("shape", ["octagon", "random"])
def test_a_specimen_as_made_is_a_cylinder(shape, tied):
    """Layers that differ in width, or a rough surface, are no slope."""
    sector = Sector(4)
    made = cut_to_sector(fcc_octagon(layers=5, half_width=5), sector) if shape == "octagon" else random_zone(sector)
    _, load = load_of(made, made, sector, tied)
    assert float(jnp.abs(load.axial).max()) < 1e-11 * float(load.section)
    np.testing.assert_allclose(load.ends, load.section, rtol=1e-11)


def test_tied_ends_press_the_ring_that_stands_out_onto_the_end_balls():
    """A cylinder that has widened evenly: s3 times the ring on the first and last layers, nothing between."""
    sector = Sector(4)
    made = lattice(sector, 4, 8, on_plate=False)
    _, load = load_of(made, moved(made, lambda z: 0.7 + 0 * z), sector, tied=True)
    rows = np.asarray(load.axial).reshape(8, 4).sum(axis=1)
    ring = sector.angle / 2 * (10.7**2 - 10.0**2)
    np.testing.assert_allclose(rows, [ring, 0, 0, 0, 0, 0, 0, -ring], rtol=0, atol=1e-10 * ring)


@pytest.mark.parametrize(("sector", "tied"), [(Sector(1), False), (Sector(6, "rigid"), True)], ids=str)
def test_derivatives_of_the_axial_forces_against_differences(sector, tied):
    """Along a motion of all balls and both platens."""
    made = random_zone(sector, seed=3)
    now = moved(made, barrel(made))
    membrane = sloping(membrane_of(now, sector), made, tied)
    rng = np.random.default_rng(1)
    start = (from_rows(now.positions), 0.0, HEIGHT)
    along = (from_rows(rng.normal(size=now.positions.shape)), 0.4, -0.7)

    def axial(place, bottom, top):
        load = membrane_load(membrane, place, bottom, top)
        return load.axial, load.ends

    tangent = jit(lambda start, along: jax.jvp(axial, start, along)[1])(start, along)
    fast = jit(axial)
    h = 1e-6
    high, low = (fast(*jax.tree.map(lambda value, rate, d=d: value + d * rate, start, along)) for d in (h, -h))
    for slope, more, less in zip(tangent, high, low, strict=True):
        difference = np.asarray(more - less) / (2 * h)
        assert np.abs(difference).max() > 0.1 or (tied and difference.size == 2)
        np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-6 * np.abs(difference).max())


# In whole tests.

SMALL = fcc_octagon(layers=5, half_width=3)


def small_test(kind, **options):
    params = Params(friction=0.3, platen_speed=0.03)
    return TriaxialTest(SMALL, scene=Scene(membrane=kind), params=params, tolerance=1e-5, **options)


def test_platens_are_judged_by_the_force_beyond_the_confining_stress_on_their_own_ends():
    """Under s3 all round, platens bear s3 times the ends' sections, and that is a stress ratio of one."""
    made = random_zone(Sector(4))
    _, load = load_of(made, moved(made, barrel(made)), Sector(4))
    assert abs(float(load.ends[0] / load.section) - 1) > 0.01
    np.testing.assert_allclose(straightened(5e4, load, 5e4 * load.ends), 5e4 * load.section * np.ones(2), rtol=1e-12)
    more = jnp.array([1e3, 2e3])
    np.testing.assert_allclose(
        straightened(5e4, load, 5e4 * load.ends + more), 5e4 * float(load.section) + more, rtol=1e-12
    )


def test_the_surface_goes_through_rebuilt_lists_and_checkpoints(tmp_path):
    """The specimen as made is remembered; a load that keeps its first cells is part of the progress."""
    test = small_test("tied", refresh=False, rebuild_every=8)
    prepared, lists = test.prepared, test.prepared.lists
    state = initial_state(test.scene, test.params, test.network, prepared.platens)
    np.testing.assert_allclose(test.membrane.surface.made, np.hypot(*test.cut.positions[:2]), rtol=1e-15)
    _, on_host = rebuild_on_host(test.cut, lists, state)[0]
    _, in_jit, _ = jit(rebuild_in_jit)(*lists, state)
    fixed = jit(lambda lists, state: fixed_load(False, None, lists, state))(lists, state)
    assert fixed.axial.shape == (len(test.cut),)
    nothing = Confinement(*[jnp.zeros(())] * 3)
    now = Progress(test.params, *lists, state, fixed, nothing, test.cut.height, no_records())
    save_progress(tmp_path / "progress.npz", test, now)
    read = load_progress(tmp_path / "progress.npz", test)
    for each in (on_host, in_jit, read.membrane):
        jax.tree.map(np.testing.assert_array_equal, each.surface, test.membrane.surface)
    jax.tree.map(np.testing.assert_array_equal, read.fixed, fixed)


@pytest.mark.slow
def test_tangents_of_a_whole_test_agree_with_differences():
    """Of the stress ratio by the friction, past the first slip."""
    test = small_test("tied", axial_strain=0.004)
    curve = jit(lambda f: jax.jvp(lambda f: test.simulate(replace(test.params, friction=f)), (f,), (1.0,)))
    h = 1e-5
    slope, more, less = curve(0.3)[1].stress_ratio, *(curve(0.3 + d)[0].stress_ratio for d in (h, -h))
    difference = (more - less) / (2 * h)
    assert float(jnp.abs(difference).max()) > 0.5
    np.testing.assert_allclose(slope[5:], difference[5:], rtol=1e-3, atol=1e-4)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match=r"scene membrane = 'slope': must be one of 'radial', 'normal', 'tied'\."):
        Scene(membrane="slope")
    test = small_test("radial")
    load = Load(jnp.ones(len(test.cut)), jnp.ones(()))
    with pytest.raises(ValueError, match=r"scene membrane = 'tied': would do nothing beside a lateral_load"):
        prepare(replace(test, scene=Scene(membrane="tied"), lateral_load=load))
    with pytest.raises(ValueError, match=r"lateral_load\.axial"):
        prepare(replace(test, lateral_load=replace(load, axial=jnp.zeros_like(load.lateral))))
