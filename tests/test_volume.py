"""The volume of a specimen: the solids in it against independent counts, crystals, scaling; no memory, no zone."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, label

from axijax import Params
from axijax.core.sector import Sector
from axijax.core.vector import from_rows
from axijax.mechanics.contact_search import grid_for, rebuild_in_jit
from axijax.mechanics.dynamics import Scene, initial_state
from axijax.mechanics.membrane import build_membrane, membrane_load
from axijax.mechanics.observe import observe
from axijax.mechanics.volume import _outermost, void_ratio
from axijax.specimen.grading import sieve_curve
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.random_specimen import platen_speed, random_cylinder
from axijax.triaxial.test import TriaxialTest

FCC = 3 * 2**0.5 / np.pi - 1  # void ratio of touching equal balls in face-centred cubic order


@partial(jax.jit, static_argnames="sector")
def voids(places, radius, sector, platens, weight=1.0):
    return void_ratio(from_rows(places), radius, weight * jnp.ones_like(radius), sector, jnp.asarray(platens))


def crystal(rho=9.0, layers=26):
    """An FCC cylinder of unit balls, off its axis of symmetry, between planes half a layer outside the outer ones, so
    that no void is due to a wall."""
    sites = np.stack(np.meshgrid(*[np.arange(-20, 21)] * 3, indexing="ij")).reshape(3, -1)
    places = sites[:, sites.sum(axis=0) % 2 == 0] * 2**0.5
    places = places[:, np.abs(sites[2, sites.sum(axis=0) % 2 == 0] - 0.5) < layers / 2] + np.array(
        [[0.3], [0.2], [0.0]]
    )
    places = places[:, np.hypot(*places[:2]) < rho]
    half = 0.5 * 2**0.5
    return places, np.ones(places.shape[1]), np.array([places[2].min() - half, places[2].max() + half])


def thrown(sector, count=150, seed=0):
    """Balls of unequal sizes thrown into a sector of a cylinder; they overlap, but volumes are summed all the same."""
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.6, 1.4, count)
    wide = (sector.order * (4 / 3 * radius**3).sum() / 0.6 / 4) ** (1 / 3)
    rho, theta = (wide - radius) * np.sqrt(rng.random(count)), sector.angle * rng.random(count)
    places = np.stack([rho * np.cos(theta), rho * np.sin(theta), radius + (4 * wide - 2 * radius) * rng.random(count)])
    return places, radius, np.array([0.0, 4 * wide])


def test_a_crystal_has_its_void_ratio():
    assert float(voids(*crystal()[:2], Sector(1), crystal()[2])) == pytest.approx(FCC, abs=0.01)


@pytest.mark.parametrize(("across", "along"), [(1.1, 0.8), (1.05, 0.9), (1.0, 1.1)])
def test_a_crystal_deformed_by_a_known_amount(across, along):
    """Uniform strain: the volume changes by the strain's determinant, to 0.3 % of strain (the skin is a step finer)."""
    places, radius, platens = crystal()
    before = float(voids(places, radius, Sector(1), platens))
    after = float(voids(places * [[across], [across], [along]], radius, Sector(1), platens * along))
    assert 1 - (1 + after) / (1 + before) == pytest.approx(1 - across**2 * along, abs=3e-3)


@pytest.mark.parametrize("sector", [Sector(1), Sector(5), Sector(4, "rigid")], ids=str)
def test_scale_images_and_place_do_not_matter(sector):
    places, radius, platens = thrown(sector)
    found = float(voids(places, radius, sector, platens))
    assert float(voids(3 * places, 3 * radius, sector, 3 * platens)) == pytest.approx(found, rel=1e-11)
    lifted = places + np.array([[0.0], [0.0], [7.0]])
    assert float(voids(lifted, radius, sector, platens + 7.0)) == pytest.approx(found, rel=1e-11)
    order = np.random.default_rng(1).permutation(radius.size)
    assert float(voids(places[:, order], radius[order], sector, platens)) == pytest.approx(found, rel=1e-11)
    single = voids(*(jnp.asarray(part, jnp.float32) for part in (places, radius)), sector, jnp.float32(platens))
    assert single.dtype == jnp.float32 and float(single) == pytest.approx(found, abs=2e-5)
    if sector.boundary == "periodic":
        other = sector.rotate(places, np.random.default_rng(0).integers(0, sector.order, radius.size))
        assert float(voids(other, radius, sector, platens)) == pytest.approx(found, rel=1e-11)


def test_a_sector_counts_what_the_full_cylinder_does():
    sector = Sector(4)
    places, radius, platens = thrown(sector)
    whole = np.concatenate([sector.rotate(places, k) for k in range(4)], axis=1)
    turned = Sector(7).rotate(whole, 1)
    found = [float(voids(here, np.tile(radius, 4), Sector(1), platens)) for here in (whole, turned)]
    assert found == pytest.approx([float(voids(places, radius, sector, platens))] * 2, abs=3e-3)


def test_derivative_is_that_of_a_difference():
    sector = Sector(5)
    places, radius, platens = thrown(sector)
    places = np.append(places, [[0.0], [0.0], [platens.mean()]], axis=1)  # one on the axis
    radius, weight = np.append(radius, 1.0), np.append(np.ones(radius.size), 0.2)
    way = np.random.default_rng(0).normal(size=places.shape) * (np.arange(places.shape[1]) < places.shape[1] - 1)

    def along(step):
        return voids(places + step * way, radius, sector, platens, weight)

    (_, tangent), (above, _), (below, _) = (jax.jvp(along, (at,), (1.0,)) for at in (0.0, 1e-6, -1e-6))
    slope = jax.grad(along)(0.0)
    assert float(tangent) == pytest.approx(float(slope), rel=1e-9)
    assert float(tangent) == pytest.approx(float(above - below) / 2e-6, rel=1e-3)


def test_a_ball_squeezed_out_does_not_lift_the_surface():
    """Four radii outside it adds the void of a tent at most, far less than the 1.5 % that a probe alone would count."""
    places, radius, platens = crystal()
    before = float(voids(places, radius, Sector(1), platens))
    middle = np.abs(places[2] - platens.mean()) + np.abs(np.hypot(*places[:2]) - 8.5)
    places[:2, middle.argmin()] *= 1.5
    assert float(voids(places, radius, Sector(1), platens)) == pytest.approx(before, rel=4e-3)


outermost = jax.jit(_outermost, static_argnums=(6, 7))


@pytest.mark.parametrize("sector", [Sector(1), Sector(4), Sector(5, "rigid")], ids=str)
@pytest.mark.parametrize(
    ("count", "ratio", "stretch", "dtype"),
    [(300, 1, 1, float), (300, 6, 1, float), (300, 6, 1, np.float32), (9, 6, 1, float), (9, 1, 5, float)],
)
def test_the_skin_is_made_by_the_outermost_of_all_balls(sector, count, ratio, stretch, dtype):
    """In a bulging specimen, against all balls and images on every line; of nine, big ones reach past the ends of the
    surface, and small ones that are far apart leave lines that meet none."""
    places, radius, (_, top) = thrown(sector, count)
    places[2], top = stretch * places[2], stretch * top
    radius = radius * np.exp(np.random.default_rng(1).random(count) ** 3 * np.log(ratio))
    places[:2] *= 1.3 - 0.3 * (2 * places[2] / top - 1) ** 2
    places[:2, 0] = 0.0  # one on the axis
    places, reach = places.astype(dtype), (radius + radius.mean()).astype(dtype)

    columns, rows = 17, 19
    angle, height = (np.arange(columns) + 0.5) * sector.angle / columns, top * (np.arange(rows) + 0.5) / rows
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    distance = np.zeros((columns, rows, count))
    for image in range(sector.images):
        x, y, z = sector.rotate(places, image)
        middle, square = x * cos + y * sin, reach**2 - (x * sin - y * cos) ** 2 - (height[:, None] - z) ** 2
        met = (middle > 0) & (square > 0)
        distance = np.maximum(distance, np.where(met, middle + np.sqrt(np.where(met, square, 0)), 0))

    vector = from_rows(jnp.asarray(places))
    polar = jnp.hypot(vector.x, vector.y), jnp.arctan2(vector.y, vector.x)
    ball = np.asarray(outermost(vector, *polar, jnp.asarray(reach), 0.0, top, (columns, rows), sector))
    found = np.take_along_axis(distance, ball[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(found, distance.max(axis=2), rtol=1e-4 if dtype == np.float32 else 1e-11)
    assert stretch == 1 or (found == 0).any()


def test_nothing_deep_enough_has_no_void_ratio():
    places = np.array([[1.0, -1.0], [0.0, 0.0], [10.0, 10.0]])
    assert np.isnan(float(voids(places, np.ones(2), Sector(1), np.array([0.0, 20.0]))))


# In a test


SECTOR = Sector(5)
SAND = "opening,passing\n20,0\n25,10\n40,35\n55,60\n65,100\n"  # Cu = 2.2


@pytest.fixture(scope="module")
def sheared(tmp_path_factory):
    """A loose, widely graded specimen and its run to 10 %; fast, since a volume knows no rate."""
    path = tmp_path_factory.mktemp("sand") / "sand.csv"
    path.write_text(SAND)
    made, report = random_cylinder(
        1000, SECTOR, grading=sieve_curve(path), compaction_friction=0.5, seed=2, tolerance=1e-2
    )
    assert report.compaction_friction == 0.5
    params = Params(friction=0.5)
    params = replace(params, platen_speed=platen_speed(2e-2, made, params))
    test = TriaxialTest(made, SECTOR, params=params, axial_strain=0.1, confining_friction=0.5, tolerance=1e-2)
    return test, test.run()


@partial(jax.jit, static_argnums=0)
def observed(scene, params, network, membrane, dt, state):
    load = membrane_load(membrane, network.positions + state.displacement, *state.platens)
    return observe(scene, params, network, membrane, load, dt, state)


def seen_with(test, membrane):
    state = initial_state(Scene(), test.params, test.network, [test.cut.bottom, test.cut.top])
    return observed(test.scene, test.params, test.network, membrane, test.prepared.time_step, state)


def test_a_change_of_the_zone_is_no_change_of_volume(sheared):
    """Half the zone left out moves Rm, but not the volume of a random specimen, to the last bit; the solids are all."""
    test, _ = sheared
    zone = test.cut.membrane_zone
    fewer = replace(test.cut, membrane_zone=zone & (np.cumsum(zone) % 2 == 0))
    shape = test.membrane.corner.shape[1], np.float64, test.membrane.zone.size
    one, other = (seen_with(test, build_membrane(cut, SECTOR, *shape)) for cut in (test.cut, fewer))
    assert float(one.volume) == float(other.volume) and float(one.void_ratio) == float(other.void_ratio)
    assert abs(float(one.membrane_radius / other.membrane_radius) - 1) > 1e-6
    solids = SECTOR.order * (4 / 3) * np.pi * (test.cut.radius**3).sum()
    assert float(one.volume) == pytest.approx((1 + float(one.void_ratio)) * solids, rel=1e-12)


def test_the_volume_of_a_run_does_not_jump(sheared):
    """Lists and zone are made anew many times on the way; test_run_and_simulate.py holds `simulate` to the same."""
    test, run = sheared
    assert run.network is not test.network
    curve = run.curve
    assert curve.axial_strain.size > 20
    assert np.abs(np.diff(curve.volumetric_strain)).max() < 2.5e-3
    expected = 1 - (1 + curve.void_ratio) / (1 + curve.void_ratio[0])
    np.testing.assert_allclose(curve.volumetric_strain, expected, rtol=0, atol=1e-12)


def test_lists_made_anew_keep_the_volume_to_rounding(sheared):
    """`rebuild_in_jit`, as inside `simulate`, at displaced balls: the same places seen from other references."""
    test, _ = sheared
    state = initial_state(Scene(), test.params, test.network, [test.cut.bottom, test.cut.top])
    moved = jnp.asarray(np.random.default_rng(0).normal(size=test.cut.positions.shape) * 0.5)
    state = state._replace(displacement=from_rows(moved))
    network = replace(test.network, grid=grid_for(test.network))
    network, membrane, after = jax.jit(rebuild_in_jit)(network, test.membrane, state)

    def volume(network, membrane, state):
        return float(observed(test.scene, test.params, network, membrane, test.prepared.time_step, state).volume)

    assert volume(network, membrane, after) == pytest.approx(volume(test.network, test.membrane, state), rel=1e-12)


def test_a_lattice_keeps_the_cylinder_of_its_zone(monkeypatch):
    """Its volume is that of this cylinder; nothing is counted below a skin, which takes time."""
    lattice = fcc_octagon(layers=9, half_width=7)
    test = TriaxialTest(lattice, Sector(4))
    monkeypatch.setattr("axijax.mechanics.observe.void_ratio", None)
    seen = seen_with(test, test.membrane)
    assert float(seen.volume) == pytest.approx(np.pi * float(seen.membrane_radius) ** 2 * float(seen.height), rel=1e-14)
    assert np.isnan(float(seen.void_ratio)), "its cylinder is smaller than its balls: no void ratio is claimed"


# Against a count of the solids in a sheared specimen


def counted(places, radius, platens, step):
    """Void ratio below the skin by points on a grid, each in a ball or in none. The skin is what a probe of the mean
    radius by mass cannot enter from outside, and depth below it the distance to its nearest point; the weight of a
    point rises from one to two radii, as in the definition."""
    probe = mean = (radius**4).sum() / (radius**3).sum()
    (bottom, top), far = platens, np.hypot(*places[:2]).max() + radius.max() + probe + 3 * step
    flat, high = np.arange(-far, far, step), np.arange(bottom + step / 2, top, step)
    nearest = np.full((flat.size, flat.size, high.size), np.inf)
    for (x, y, z), size in zip(places.T, radius, strict=True):
        near = [slice(*np.searchsorted(axis, [at - size - probe - step, at + size + probe + step]))
                for axis, at in ((flat, x), (flat, y), (high, z))]  # fmt: skip
        a, b, c = flat[near[0]], flat[near[1]], high[near[2]]
        distance = np.sqrt((a[:, None, None] - x) ** 2 + (b[:, None] - y) ** 2 + (c - z) ** 2) - size
        nearest[tuple(near)] = np.minimum(nearest[tuple(near)], distance)
    outside = label(nearest >= probe)[0]
    outside = outside == outside[0, 0, 0]
    inside = distance_transform_edt(~outside, sampling=step) > probe
    weight = np.clip(distance_transform_edt(inside, sampling=step) / mean - 1, 0, 1)
    return weight.sum() / weight[nearest < 0].sum() - 1


@pytest.mark.slow
def test_a_widely_graded_specimen_against_its_solids(sheared):
    """Loose, Cu = 2.2, to 10 %: within 0.7 % of strain of the count, which finds its own skin; two counts differ by
    half a per cent with how deep they begin. The mean distance of the outer balls was wrong by 4 to 5 %."""
    test, run = sheared

    def count(places, platens):
        whole = np.concatenate([SECTOR.rotate(places, k) for k in range(5)], axis=1)
        return counted(whole, np.tile(test.cut.radius, 5), platens, 4.0)

    first = count(test.cut.positions, (test.cut.bottom, test.cut.top))
    last = count(run.positions, run.state.platens)
    expected = 1 - (1 + last) / (1 + first)
    assert float(run.curve.volumetric_strain[-1]) == pytest.approx(expected, abs=0.007), (first, last)
