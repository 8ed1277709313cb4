"""Outer balls of a random specimen: what can be seen from outside, no more and no less, with cells that tile."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial import cKDTree

from axijax.core.sector import Sector
from axijax.core.vector import from_rows
from axijax.mechanics.membrane import build_membrane, cell_areas, membrane_radius, stale_cells
from axijax.mechanics.outer_balls import HOLE, cell_polygons, covered_to, outer_balls, visible_share, zone_found_again
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_octagon

SECTORS = [Sector(1), Sector(2), Sector(3), Sector(12), Sector(4, "rigid")]


def random_specimen(sector, seed=0, spread=0.5, rough=0.0):
    """Soft balls of unequal size thrown into a cylinder of the sector and pushed apart; rough: the cylinder is cut from
    a wider one, and its surface has holes."""
    rng = np.random.default_rng([seed, sector.order])
    count = 40 + 320 // sector.order
    radius = rng.uniform(1 - spread, 1 + spread, count)
    wide = (sector.order * (4 / 3 * radius**3).sum() / 0.62 / 4) ** (1 / 3)
    height = 4 * wide
    theta, rho = rng.uniform(0, sector.angle, count), (wide - radius) * np.sqrt(rng.uniform(size=count))
    place = np.stack([rho * np.cos(theta), rho * np.sin(theta), rng.uniform(1, height - 1, count)])
    ball, turn = np.tile(np.arange(count), sector.images), np.repeat(np.arange(sector.images), count)
    for _ in range(60):
        copies = sector.rotate(place[:, ball], turn)
        near = cKDTree(place.T).sparse_distance_matrix(cKDTree(copies.T), 2 * radius.max(), output_type="ndarray")
        near = near[(near["v"] > 0) & (near["v"] < radius[near["i"]] + radius[ball[near["j"]]])]
        i, j, distance = near["i"], near["j"], near["v"]
        push = (place[:, i] - copies[:, j]) * (0.4 * (radius[i] + radius[ball[j]] - distance) / distance)
        place = place + np.stack([np.bincount(i, row, count) for row in push])
        out = np.minimum(1, (wide - radius) / np.hypot(*place[:2]))
        place = place * np.stack([out, out, np.ones(count)])
        place[2] = np.clip(place[2], radius, height - radius)
        for x, y in ((0, 1), (np.sin(sector.angle), -np.cos(sector.angle))) if sector.boundary == "rigid" else ():
            inside = np.maximum(radius - (x * place[0] + y * place[1]), 0)
            place[:2] += inside * np.array([[x], [y]])
    kept = np.hypot(*place[:2]) + radius < (1 - rough) * wide + 1e-9
    place, radius = place[:, kept], radius[kept]
    zone = outer_balls(place, radius, 0.0, height, sector)
    return Specimen(place, radius, 0.0, height, zone, zone_rule="exposure")


@jax.jit
def radius_areas_and_staleness(membrane, place, bottom, top):
    areas, stale = cell_areas(membrane, place, bottom, top), stale_cells(membrane, place, bottom, top)
    return membrane_radius(membrane, place), areas, stale


def membrane_facts(specimen, sector, triangles=1500, balls=400):
    """Rm, cell areas and their staleness; everything padded to one size, so that one program is compiled."""
    membrane = build_membrane(specimen, sector, triangles, balls=balls)
    place = from_rows(np.pad(specimen.positions, ((0, 0), (0, 400 - len(specimen)))))
    radius, areas, stale = radius_areas_and_staleness(membrane, place, specimen.bottom, specimen.top)
    return float(radius), np.asarray(areas)[: len(specimen)], float(stale)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_octagons_zone_is_that_of_the_paper(order):
    """138 balls in the quarter, 552 in all, each ball the same; and the 126 of a quarter between rigid planes."""
    for boundary in ("periodic", "rigid") if order == 4 else ("periodic",):
        sector = Sector(order, boundary)
        cut = cut_to_sector(fcc_octagon(), sector)
        found = outer_balls(cut.positions, cut.radius, cut.bottom, cut.top, sector)
        np.testing.assert_array_equal(found, cut.membrane_zone)
        assert found.sum() == (552 // order if boundary == "periodic" else 126)


@pytest.mark.parametrize("order", [1, 3])
def test_visible_share_is_what_a_finer_look_sees(order):
    """Against the outermost ball along thousands of radial lines, images and all."""
    sector = Sector(order)
    specimen = random_specimen(sector, rough=0.2)
    rho, theta, z = np.hypot(*specimen.positions[:2]), np.arctan2(*specimen.positions[1::-1]), specimen.positions[2]
    share = visible_share(specimen.positions, specimen.radius, sector)
    rng = np.random.default_rng(0)
    some = rng.permutation(np.flatnonzero(rho > 1.5 * specimen.radius))[:60]
    for i in some:
        away, around = np.sqrt(rng.uniform(size=1500)), rng.uniform(0, 2 * np.pi, 1500)
        angle = theta[i] + np.arcsin(away * np.cos(around) * specimen.radius[i] / rho[i])
        height = z[i] + away * np.sin(around) * specimen.radius[i]
        farthest = np.full((1500, len(specimen)), -np.inf)
        for k in range(order):
            along = angle[:, None] - theta - k * sector.angle
            inside = specimen.radius**2 - (rho * np.sin(along)) ** 2 - (height[:, None] - z) ** 2
            met = rho * np.cos(along) + np.sqrt(np.maximum(inside, 0))
            farthest = np.maximum(farthest, np.where(inside > 0, met, -np.inf))
        seen = (farthest.argmax(axis=1) == i).mean()
        assert share[i] == pytest.approx(seen, abs=0.06) or share[i] == 0.0
        if share[i] == 0.0:
            along = theta[i] - theta - np.arange(order)[:, None] * sector.angle
            inside = specimen.radius**2 - (rho * np.sin(along)) ** 2 - (z[i] - z) ** 2
            met = np.where(inside > 0, rho * np.cos(along) + np.sqrt(np.maximum(inside, 0)), -np.inf)
            assert met.max() > rho[i] + specimen.radius[i], "its centre is hidden"


@pytest.mark.parametrize("order", [1, 4])
def test_what_surely_stands_before_a_ball_does(order):
    """Against every ball and image along the line through its centre, for radii that differ tenfold."""
    rng, sector = np.random.default_rng(2), Sector(order)
    theta = rng.uniform(0, sector.angle, 1500)
    rho, z, radius = 20 * np.sqrt(rng.uniform(size=1500)), rng.uniform(0, 40, 1500), 0.3 * 10 ** rng.uniform(size=1500)
    farthest = np.zeros(1500)
    for k in range(order):
        along = theta[:, None] - theta - k * sector.angle
        inside = radius**2 - (rho * np.sin(along)) ** 2 - (z[:, None] - z) ** 2
        met = np.where(inside > 0, rho * np.cos(along) + np.sqrt(np.maximum(inside, 0)), 0.0)
        farthest = np.maximum(farthest, met.max(axis=1))
    covered = covered_to(rho, theta, z, radius, sector.angle)
    assert (covered <= farthest).all()
    found, hidden = covered > rho + radius, farthest > rho + radius
    assert found.sum() > 0.3 * hidden.sum(), "many of those that are hidden"


@pytest.mark.parametrize("far", [1e15, np.inf, np.nan])
def test_a_ball_that_has_flown_away_takes_no_memory(far):
    """`simulate` goes on after a run has gone wrong, and finds its zone again."""
    z = np.array([1.0, 2.0, 3.0, far])
    for rho, height in ((np.ones(4), z), (z, np.arange(4.0))):
        assert covered_to(rho, np.zeros(4), height, np.ones(4), 2 * np.pi).shape == (4,)


@pytest.mark.parametrize("rough", [0.0, 0.2])
@pytest.mark.parametrize("sector", SECTORS, ids=str)
def test_cells_of_a_random_zone_tile_the_strip_and_are_well_shaped(sector, rough):
    """The areas add up to 2 pi Rm / n H to rounding, Rm the mean of rho; no cell is tiny and no hole is wide; the
    polygons are the same cells; an inner ball is never one of the zone."""
    specimen = random_specimen(sector, rough=rough)
    zone = specimen.membrane_zone
    found, areas, stale = membrane_facts(specimen, sector)
    radius = np.hypot(*specimen.positions[:2, zone]).mean()
    assert found == pytest.approx(radius, rel=1e-13) and stale < 1e-12
    np.testing.assert_allclose(areas.sum(), sector.angle * radius * specimen.height, rtol=1e-12)
    assert areas[zone].min() > 0.15 * areas[zone].mean() and areas[zone].max() < 4 * areas[zone].mean()
    seen = visible_share(specimen.positions, specimen.radius, sector) > 0
    assert seen[zone].all()
    cells = cell_polygons(specimen, sector)
    np.testing.assert_allclose(cells.areas, areas[cells.balls], rtol=1e-9)
    # A corner of a cell is as far from its ball as the hole there is wide: wide ones have no ball to line them.
    theta = sector.angle_of(specimen.positions)
    home = cells.radius * (theta if sector.boundary == "rigid" else np.mod(theta, sector.angle))
    for polygon, place in zip(cells.polygons, cells.places.T, strict=True):
        for corner in polygon:
            size = np.linalg.norm(corner - place)
            if size > 1.05 * HOLE * specimen.radius[zone].mean() and 0 < corner[1] < specimen.top:
                near = np.hypot(home - corner[0], specimen.positions[2] - corner[1]) < 0.5 * size
                assert not (near & seen & ~zone).any()


def test_the_zone_turns_with_the_specimen_and_does_not_know_its_images():
    """Any image of a ball may stand for it, and the sector may begin anywhere."""
    sector = Sector(3)
    specimen = random_specimen(sector, rough=0.2)
    rng = np.random.default_rng(0)
    other = sector.rotate(specimen.positions, rng.integers(0, 3, len(specimen)))
    turned = Sector(1).rotate(specimen.positions, 0)
    turned[:2] = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]) @ specimen.positions[:2]
    for positions in (other, turned):
        found = outer_balls(positions, specimen.radius, 0.0, specimen.top, sector)
        np.testing.assert_array_equal(found, specimen.membrane_zone)


def tiled_cylinder(rows=10, columns=24, rho=8.0, radius=1.0):
    """A wall of balls around a full cylinder with an empty inside; places (3, N), unit radii, height."""
    theta = (np.arange(columns)[None] + 0.5 * (np.arange(rows) % 2)[:, None]) * 2 * np.pi / columns
    z = np.broadcast_to(radius + 1.8 * np.arange(rows)[:, None], theta.shape)
    place = np.stack([rho * np.cos(theta), rho * np.sin(theta), z]).reshape(3, -1)
    return place, np.full(rows * columns, radius), 2 * radius + 1.8 * (rows - 1)


def zone_with(extra, extra_radius, before=None, without=None):
    """The zone of the wall, some balls left out, with others at (theta, rho, z): whether each of these is in it, and
    how many of the wall's are not."""
    place, radius, height = tiled_cylinder()
    if without is not None:
        kept = ~without(place)
        place, radius = place[:, kept], radius[kept]
    theta, rho, z = np.asarray(extra, float).T
    place = np.concatenate([place, [rho * np.cos(theta), rho * np.sin(theta), z]], axis=1)
    radius = np.concatenate([radius, extra_radius])
    found = outer_balls(place, radius, 0.0, height, Sector(1), before)
    count = theta.size
    return found[-count:], int((~found[:-count]).sum())


def test_hidden_balls_are_not_outer_ones_and_the_front_one_of_two_is():
    """A ball behind the wall; one in front of it, small or large, which takes the place of the ball behind it."""
    inside, lost = zone_with([(0.0, 5.9, 9.0)], [1.0])
    assert not inside.any() and lost == 0
    columns = np.arange(24) * 2 * np.pi / 24
    small, lost = zone_with([(columns[3] + 0.5 * 2 * np.pi / 24, 9.3, 1 + 1.8 * 5)], [0.3])
    assert small.all() and lost == 1, "the ball behind its centre has no cell of its own"
    large, lost = zone_with([(columns[3], 11.0, 1 + 1.8 * 4)], [2.5])
    assert large.all() and lost >= 1


def test_two_balls_at_nearly_one_place_leave_the_outer_one():
    """A given zone of both has a tiny cell or none; the zone found again does not."""
    place, radius, height = tiled_cylinder()
    for apart in (0.0, 1e-13, 1e-9, 1e-4):
        ball = place[:, 30]
        front = np.append(ball[:2] * 1.26, ball[2] + apart)
        both = np.concatenate([place, front[:, None]], axis=1)
        everything = Specimen(both, 1.0, 0.0, height, np.ones(both.shape[1], bool), zone_rule="exposure")
        again = replace(everything, membrane_zone=zone_found_again(everything, Sector(1)))
        assert again.membrane_zone[-1] and not again.membrane_zone[30] and again.membrane_zone.sum() == radius.size
        areas = membrane_facts(again, Sector(1))[1]
        assert areas[again.membrane_zone].min() > 1.0


def in_hole(place, theta, z, size):
    across = 8 * ((np.arctan2(place[1], place[0]) - theta + np.pi) % (2 * np.pi) - np.pi)
    return np.hypot(across, place[2] - z) < size


def test_a_ball_deep_in_a_narrow_pore_is_not_loaded_but_a_wide_hole_is_lined():
    middle = 1 + 1.8 * 4.5
    narrow, lost = zone_with([(1.0, 5.0, middle)], [1.0], without=lambda place: in_hole(place, 1.0, middle, 2.0))
    assert not narrow.any() and lost == 0, "3 radii below the surface, in a pore of 2"
    shallow, _ = zone_with([(1.0, 6.6, middle)], [1.0], without=lambda place: in_hole(place, 1.0, middle, 2.0))
    assert shallow.all()
    wide, lost = zone_with([(1.0, 4.0, middle)], [1.0], without=lambda place: in_hole(place, 1.0, middle, 4.2))
    assert wide.all() and lost == 0, "4 radii below the surface, in a hole of 4"


def test_a_zone_ball_stays_down_to_a_smaller_part_in_sight():
    """Half hidden, a ball stays in the zone if it was in it, and does not come into it otherwise."""
    place, radius, height = tiled_cylinder()
    ball = place[:, 30]
    theta, rho = np.arctan2(ball[1], ball[0]) + np.array([-1.25, 1.25]) / 9.6, 9.6
    front = np.stack([rho * np.cos(theta), rho * np.sin(theta), [ball[2]] * 2])
    both, size = np.concatenate([place, front], axis=1), np.append(radius, [1.0, 1.0])
    assert 0.4 < visible_share(both, size, Sector(1))[30] < 0.6
    fresh = outer_balls(both, size, 0.0, height, Sector(1))
    kept = outer_balls(both, size, 0.0, height, Sector(1), before=np.ones(size.size, bool))
    assert not fresh[30] and kept[30]


def test_given_zones_only_grow():
    """A lattice's zone is kept, whatever is in sight, and gets the balls that came through it."""
    sector = Sector(4)
    cut = cut_to_sector(fcc_octagon(layers=5, half_width=5), sector)
    np.testing.assert_array_equal(zone_found_again(cut, sector), cut.membrane_zone)
    inner = np.flatnonzero(~cut.membrane_zone)[-1]
    positions = np.array(cut.positions)
    positions[:2, inner] *= 1.5 * np.hypot(*positions[:2]).max() / np.hypot(*positions[:2, inner])
    found = zone_found_again(replace(cut, positions=positions), sector)
    assert found[inner] and found.sum() == cut.membrane_zone.sum() + 1


@pytest.mark.parametrize("sector", [Sector(1), Sector(2), Sector(12), Sector(4, "rigid")], ids=str)
def test_few_balls_have_a_zone_or_are_refused(sector):
    theta = 0.3 / sector.order
    for rho, z in (([5.0], [3.0]), ([5.0, 5.0], [1.0, 5.0]), ([5.0, 5.0, 0.0], [0.0, 6.0, 3.0])):
        place = np.stack([np.cos(theta) * np.array(rho), np.sin(theta) * np.array(rho), z])
        found = outer_balls(place, 1.0, 0.0, 6.0, sector)
        np.testing.assert_array_equal(found, np.array(rho) > 0)
    with pytest.raises(ValueError, match="on the axis"):
        outer_balls(np.array([[0.0], [0.0], [3.0]]), 1.0, 0.0, 6.0, sector)


def test_a_ball_squeezed_far_out_does_not_set_the_radius_of_a_random_zone():
    sector = Sector(3)
    specimen = random_specimen(sector)
    ball = np.flatnonzero(specimen.membrane_zone)[5]
    positions = np.array(specimen.positions)
    positions[:2, ball] *= 2.0
    moved = replace(specimen, positions=positions)
    moved = replace(moved, membrane_zone=zone_found_again(moved, sector))
    radius, areas, _ = membrane_facts(moved, sector)
    others = moved.membrane_zone & (np.arange(len(moved)) != ball)
    mean = np.hypot(*positions[:2, others]).mean()
    assert moved.membrane_zone[ball] and areas[ball] > 0
    assert radius == pytest.approx(mean, rel=1e-13)


def test_padding_of_the_zone_changes_nothing():
    sector = Sector(3)
    specimen = random_specimen(sector)
    needed = build_membrane(specimen, sector)
    triangles, balls = needed.corner.shape[1], needed.zone.size
    radius, areas, stale = membrane_facts(specimen, sector, triangles, balls)
    padded = membrane_facts(specimen, sector, triangles + 20, balls + 7)
    np.testing.assert_allclose(padded[1], areas, rtol=1e-13)
    assert padded[0] == pytest.approx(radius, rel=1e-15) and max(padded[2], stale) < 1e-12
    with pytest.raises(ValueError, match=f"balls = 3: the membrane zone holds {balls}"):
        build_membrane(specimen, sector, balls=3)
