"""The contact list found again inside jit, against the search of every ball against every image of every other."""

from dataclasses import fields, replace
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_neighbors import ANY_OVERLAP, every_pair, from_both_sides, listed, random_balls

from axijax import Params
from axijax.core.sector import Sector
from axijax.core.status import FULL_LIST, NOT_FINITE, STALE_LIST
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import Grid, build_contact_list, carry, carry_memory
from axijax.mechanics.contact_search import contact_list, update
from axijax.mechanics.term import Memory
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial import progress
from axijax.triaxial.engine import current_load
from axijax.triaxial.records import SimulationError
from axijax.triaxial.test import TriaxialTest

SKIN = 0.3
WIDTH, CONTACTS = 124, 624  # enough for every order: few programs are compiled
GRID = Grid((5, 5, 4), 90)
ORDERS = [1, 2, 5, 12]  # none, a ball and its one image, odd and even, and more images than a ball has neighbours



def found_again(grid, network, displacement, springs):
    """The list found again with this grid, the springs carried to it, and the status."""
    made = update(displacement, replace(network, grid=grid))
    return made, carry(network, made, springs), made.status


plain, found_again = found_again, jax.jit(found_again, static_argnums=0)


def scene(order, dtype=np.float64, boundary="periodic", seed=0):
    """Balls of unequal size, some on the axis and many near it, and a motion of 0.4 skins at most."""
    sector = Sector(order, boundary)
    specimen = random_balls(order, seed, on_axis=2 if boundary == "periodic" else 0)
    rng = np.random.default_rng(seed + 1)
    moves = rng.normal(size=specimen.positions.shape)
    moves *= 0.4 * SKIN * rng.uniform(size=25) / np.linalg.norm(moves, axis=0)
    moves[2] = np.clip(specimen.positions[2] + moves[2], -3, 3) - specimen.positions[2]
    moves[:, (np.hypot(*specimen.positions[:2]) == 0) & (sector.images > 1)] *= [[0], [0], [1]]
    network = build_contact_list(specimen, sector, SKIN, WIDTH, CONTACTS, ANY_OVERLAP, dtype)
    return specimen, sector, network, moves.astype(dtype).astype(float)


@pytest.mark.parametrize("order, boundary", [*((order, "periodic") for order in ORDERS), (3, "rigid")])
def test_updated_list_is_that_of_every_pair_and_of_the_host(order, boundary):
    """The same pairs as a search over all images; in every array the list that the host builds; springs as it carries
    them; and each contact acts on both its balls."""
    specimen, sector, network, moves = scene(order, boundary=boundary, seed=2 if boundary == "rigid" else 0)
    springs = from_rows(np.random.default_rng(5).normal(size=(3, CONTACTS)))
    made, carried, bits = found_again(GRID, network, from_rows(moves), springs)
    assert int(bits) == 0
    after = replace(specimen, positions=specimen.positions + moves)
    pairs = every_pair(after, sector.images, SKIN)
    on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (sector.images > 1)
    both = list(from_both_sides(listed(made), on_axis, sector.images))
    assert len(both) == len(set(both)) and set(both) == set(pairs)
    assert set(listed(made)) != set(listed(network)), "the motion must change the list"
    host = build_contact_list(after, sector, SKIN, WIDTH, CONTACTS, ANY_OVERLAP)
    arrays = {field.name for field in fields(host)} - {"sector", "grid", "tight", "mass_factor", "crowd"}
    assert made.mass_factor is host.mass_factor is made.crowd is host.crowd is None
    for name in arrays:
        ours, theirs = np.asarray(getattr(made, name)), np.asarray(getattr(host, name))
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14, err_msg=name)
    by_host = carry_memory(network, host, (Memory(springs),))[0].contact
    np.testing.assert_array_equal(np.asarray(carried), np.asarray(by_host))
    force = made.sum_on_balls(made.branch * (made.image >= 0), reaction=-1)
    expected = np.zeros((3, len(specimen)))
    for (i, _, _), branch in pairs.items():
        expected[:, i] += branch
    np.testing.assert_allclose(np.asarray(force), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", [1, 12])
def test_float32_finds_the_same_contacts_and_keeps_overlaps(order):
    """All but pairs within rounding of the reach are those of the search; overlaps of listed contacts follow the motion
    to float32 rounding of the motion, not of the coordinates, here far from the origin."""
    specimen, sector, network, moves = scene(order, np.float32)
    lifted = specimen.positions + np.array([[0], [0], [5000]])
    high = replace(specimen, positions=lifted, bottom=4990.0, top=5010.0)
    network = build_contact_list(high, sector, SKIN, WIDTH, CONTACTS, ANY_OVERLAP, np.float32)
    made, _, bits = found_again(GRID, network, from_rows(moves.astype(np.float32)), None)
    assert int(bits) == 0
    after = replace(specimen, positions=specimen.positions + moves)
    on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (sector.images > 1)
    both = set(from_both_sides(listed(made), on_axis, sector.images))
    # Coordinates near 5000 are known to 2.4e-4.
    assert (
        set(every_pair(after, sector.images, SKIN - 2e-3)) <= both <= set(every_pair(after, sector.images, SKIN + 2e-3))
    )
    pairs = every_pair(after, sector.images, SKIN + 2e-3)
    before, now = listed(network), listed(made)
    overlap = np.asarray(made.overlap)
    assert len(before.keys() & now.keys()) > 10
    for i, j, k in before.keys() & now.keys():
        exact = specimen.radius[i] + specimen.radius[j] - np.linalg.norm(pairs[i, j, k])
        assert overlap[now[i, j, k]] == pytest.approx(exact, abs=2e-6)


@pytest.mark.parametrize("order", [1, 4])
def test_updates_in_a_row_are_one_update(order):
    """Ten small moves, the list made again after each, end where one large move does: springs that stayed listed are
    kept and those that left it are gone for good."""
    specimen, sector, network, moves = scene(order, seed=3)
    springs = from_rows(np.random.default_rng(5).normal(size=(3, CONTACTS)))
    now, kept = network, springs
    always = set(listed(network))
    for _ in range(10):
        now, kept, bits = found_again(GRID, now, from_rows(moves), kept)
        assert int(bits) == 0
        always &= set(listed(now))
    after = replace(specimen, positions=np.asarray(now.positions), bottom=-9.0, top=9.0)
    np.testing.assert_allclose(np.asarray(now.positions), specimen.positions + 10 * moves, rtol=0, atol=1e-13)
    host = build_contact_list(after, sector, SKIN, WIDTH, CONTACTS, ANY_OVERLAP)
    assert listed(host) == listed(now)
    np.testing.assert_allclose(np.asarray(now.branch), np.asarray(host.branch), rtol=0, atol=1e-12)
    before, places = listed(network), listed(now)
    expected = np.zeros((3, CONTACTS))
    for key in always:
        expected[:, places[key]] = np.asarray(springs)[:, before[key]]
    np.testing.assert_array_equal(np.asarray(kept), expected)
    assert 5 < len(always) < len(before)


def test_whatever_goes_wrong_sets_a_bit():
    specimen, sector, network, moves = scene(4)
    springs, moves, still = (from_rows(values) for values in (np.zeros((3, CONTACTS)), moves, np.zeros((3, 25))))

    def bits(network, moves, springs=springs, grid=GRID):
        return int(found_again(grid, network, moves, springs)[2])

    assert bits(network, replace(moves, x=moves.x.at[7].set(jnp.nan))) & NOT_FINITE
    assert bits(network, replace(still, z=still.z.at[7].set(0.51 * SKIN))) == 0, "alone it meets nobody too early"
    assert bits(network, replace(still, z=still.z.at[7].set(0.51 * SKIN).at[8].set(-0.51 * SKIN))) == STALE_LIST
    assert bits(network, moves, grid=Grid((5, 5, 4), 2)) == FULL_LIST

    tight = build_contact_list(specimen, sector, SKIN, largest_overlap=ANY_OVERLAP)
    width, contacts = tight.slot.shape[0], int((np.asarray(tight.image) >= 0).sum())
    larger = replace(specimen, radius=specimen.radius * 1.02)
    more = build_contact_list(larger, sector, SKIN, largest_overlap=ANY_OVERLAP)
    assert more.slot.shape[0] > width and int((more.image >= 0).sum()) > contacts
    for wide, length in ((width + 40, contacts + 1), (width, contacts + 90)):
        enough = build_contact_list(specimen, sector, SKIN, wide, length, ANY_OVERLAP)
        assert bits(enough, still, None) == 0, "what is just enough is enough"
        assert bits(replace(enough, radius=jnp.asarray(larger.radius)), still, None) == FULL_LIST


def test_a_specimen_may_outgrow_its_grid():
    """Cells at the border take what is outside: the contacts are still found."""
    specimen, sector, network, moves = scene(4)
    made, _, bits = found_again(Grid((3, 2, 1), 95), network, from_rows(moves), None)
    assert int(bits) == 0
    host = build_contact_list(
        replace(specimen, positions=specimen.positions + moves), sector, SKIN, largest_overlap=1e9
    )
    assert listed(made) == listed(host)


def test_allocate_leaves_room():
    specimen, sector, _, _ = scene(4)
    network = contact_list(sector, SKIN, capacity_multiplier=1.5, largest_overlap=ANY_OVERLAP).allocate(specimen)
    grid = network.grid
    tight = build_contact_list(specimen, sector, SKIN, largest_overlap=ANY_OVERLAP)
    assert network.slot.shape[0] >= 1.5 * tight.slot.shape[0] and network.first.size >= 1.5 * tight.first.size
    assert listed(network) == listed(tight)
    assert np.prod(grid.cells) > 1 and grid.capacity >= 3


class InFreeSpace:
    """jax-md's neighbour list of all images of the balls as so many particles in free space; a ball on the axis is one
    particle. Two are near where the gap between them, which jax-md takes for their distance, is below the skin."""

    def __init__(self, specimen, images):
        from jax_md import partition, space  # takes seconds

        self.count, free = len(specimen), space.free()[0]
        on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (images > 1)
        image, ball = np.divmod(np.arange(self.count * images), self.count)  # the balls themselves come first
        distinct = (image == 0) | ~on_axis[ball]
        self.ball, self.image = ball[distinct], image[distinct]
        self.angle, self.radius = 2 * np.pi * self.image / images, specimen.radius[self.ball]
        widest = 2 * self.radius.max()
        self.distance = lambda a, b: space.distance(free(a[..., :-1], b[..., :-1]))
        self.functions = partition.neighbor_list(
            lambda a, b, **_: self.distance(a, b) - a[..., -1] - b[..., -1] + widest, box=1e3, r_cutoff=widest + SKIN,
            capacity_multiplier=1.5, disable_cell_list=True, format=partition.Sparse,
        )  # fmt: skip

    def particles(self, positions):
        """(P, 4) places of all images of the balls (3, N), and their radii."""
        x, y, z = jnp.asarray(positions)[:, self.ball]
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return jnp.stack([cos * x - sin * y, sin * x + cos * y, z, self.radius], axis=1)

    def pairs(self, neighbors):
        """The directed pairs (i, j, k) with a ball itself for their first, and their places in jax-md's list."""
        there, here = (index.tolist() for index in np.asarray(neighbors.idx))
        pairs = [
            ((i, int(self.ball[p]), int(self.image[p])), place)
            for place, (i, p) in enumerate(zip(here, there, strict=True))
            if i < self.count and p < self.ball.size
        ]
        assert len(dict(pairs)) == len(pairs)
        return dict(pairs)


def oracle(order):
    """A random packing, its next moves, our functions and list, and jax-md's."""
    specimen, sector, network, _ = scene(order, seed=4)
    ours = contact_list(sector, SKIN, largest_overlap=ANY_OVERLAP)
    theirs = InFreeSpace(specimen, sector.images)
    rng = np.random.default_rng(order)
    free = np.asarray(network.free)  # what is on the axis stays on it
    moves = [0.4 * SKIN / np.sqrt(3) * free * rng.uniform(-1, 1, (3, 25)) for _ in range(3)]
    neighbors = theirs.functions.allocate(theirs.particles(specimen.positions))
    return specimen, moves, ours, ours.allocate(specimen), theirs, neighbors


@pytest.mark.parametrize("order", ORDERS)
def test_jax_md_finds_the_same_pairs_and_tangents_among_all_images(order):
    """After `allocate`, and after each of three updates of a packing that moves; with tangents of all distances."""
    specimen, moves, ours, network, theirs, neighbors = oracle(order)
    on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (order > 1)
    along = np.random.default_rng(8).normal(size=(3, 25)) * np.asarray(network.free)

    def our_update(move, network):
        made = ours.update(move, network)
        return made.distance, made

    def their_update(positions, neighbors):
        places = theirs.particles(positions)
        renewed = neighbors.update(places)
        there, here = renewed.idx
        return jax.vmap(theirs.distance)(places.at[here].get(mode="clip"), places.at[there].get(mode="clip")), renewed

    def with_tangents(function):
        return jax.jit(lambda at, of, by: jax.jvp(lambda at: function(at, of), (at,), (by,), has_aux=True))

    our_update, their_update = with_tangents(our_update), with_tangents(their_update)

    def same_pairs():
        assert not bool(network.did_buffer_overflow) and not bool(neighbors.did_buffer_overflow)
        both, pairs = list(from_both_sides(listed(network), on_axis, order)), theirs.pairs(neighbors)
        assert len(both) == len(set(both)) and set(both) == pairs.keys()
        return pairs

    before, positions, changed = same_pairs(), specimen.positions, 0
    for move in moves:
        positions = positions + move
        *found, network = our_update(from_rows(move), network, from_rows(along))
        *expected, neighbors = their_update(positions, neighbors, along)
        assert int(network.status) == 0
        pairs, places = same_pairs(), listed(network)
        changed += pairs.keys() != before.keys()
        at, at_theirs = list(places.values()), [pairs[pair] for pair in places]
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(np.asarray(one)[at], np.asarray(other)[at_theirs], rtol=0, atol=1e-12)
        assert np.abs(np.asarray(found[1])[at]).max() > 0.1
        before = pairs
    assert changed > 1, "the motions must change the list"


def test_an_overflow_sticks_as_in_jax_md():
    """Balls pushed together until neither list holds their pairs, and back again: both still say so; they would not
    have, had the balls stayed."""
    specimen, _, ours, network, theirs, neighbors = oracle(4)
    together = jnp.asarray(-0.9 * specimen.positions)
    updated = jax.jit(ours.update)
    renewed = jax.jit(lambda positions, neighbors: neighbors.update(theirs.particles(positions)))
    still = updated(from_rows(0 * together), network), renewed(specimen.positions, neighbors)
    assert [bool(each.did_buffer_overflow) for each in still] == [False, False]
    full = updated(from_rows(together), network), renewed(specimen.positions + together, neighbors)
    assert [bool(each.did_buffer_overflow) for each in full] == [True, True]
    back = updated(from_rows(-together), full[0]), renewed(specimen.positions, full[1])
    assert [bool(each.did_buffer_overflow) for each in back] == [True, True]


def test_derivatives_pass_through_an_update():
    """Branches, overlaps, distances and springs have the tangents that central differences find, for listed contacts
    and for new ones."""
    _, _, network, moves = scene(4)
    rng = np.random.default_rng(8)
    along = rng.normal(size=moves.shape) * np.asarray(network.free)
    springs, springs_along = (from_rows(rng.normal(size=(3, CONTACTS))) for _ in range(2))

    def results(h):
        displacement = from_rows(moves) + from_rows(along) * h
        made, kept, _ = plain(GRID, network, displacement, springs + springs_along * h)
        return made.branch, made.distance, made.overlap, made.positions, kept

    value_and_tangent = jax.jit(lambda h: jax.jvp(results, (h,), (1.0,)))
    h = 1e-6
    tangent, ahead, behind = value_and_tangent(0.0)[1], value_and_tangent(h)[0], value_and_tangent(-h)[0]
    names = "branch", "distance", "overlap", "positions", "springs"
    for name, exact, above, below in zip(names, tangent, ahead, behind, strict=True):
        difference = (np.asarray(above) - np.asarray(below)) / (2 * h)
        assert np.abs(difference).max() > 0.1, name
        np.testing.assert_allclose(np.asarray(exact), difference, rtol=0, atol=1e-7, err_msg=name)


@pytest.fixture(scope="module")
def shear():
    """A small FCC test to 5 %: as `run` makes it, with lists made anew on the host, and value and tangent of `simulate`
    with and without lists made anew inside."""
    specimen, params = fcc_octagon(layers=7, half_width=3), Params(platen_speed=0.05)
    kept = TriaxialTest(specimen, Sector(4), params=params, axial_strain=0.05, tolerance=1e-4)
    renewed = replace(kept, rebuild_every=4)

    def curve_and_tangent(test):
        return jax.jit(lambda f: jax.jvp(lambda f: test.simulate(replace(params, friction=f)), (f,), (1.0,)))(0.12278)

    with pytest.MonkeyPatch.context() as patch:
        rebuilt = mock.Mock(side_effect=progress.rebuild_on_host)
        patch.setattr(progress, "rebuild_on_host", rebuilt)
        run = kept.run().curve
    assert rebuilt.call_count > 0, "the host must have made its lists anew"
    return run, curve_and_tangent(kept), curve_and_tangent(renewed)


def test_a_test_with_lists_made_anew_inside_is_that_of_the_host(shear):
    """Up to 3.5 % strain, where a ball comes out between those of the membrane: it carries load from the next time that
    the membrane is made anew, and the host looks at other times."""
    run, _, (renewed, _) = shear
    assert int(renewed.status) == 0
    assert run.axial_strain[-1] > 0.049
    valid = np.asarray(run.axial_strain) < 0.035
    for name, accuracy in (("stress_ratio", 1e-9), ("membrane_radius", 1e-12)):
        ours, theirs = (np.asarray(getattr(curve, name))[: valid.size] for curve in (renewed, run))
        np.testing.assert_allclose(ours[valid], theirs[valid], rtol=accuracy)
        np.testing.assert_allclose(ours, theirs, rtol=1e-3)


def test_lists_are_made_anew_between_records():
    """Records 1000 steps apart, between which the lists are worn, are among those 50 steps apart."""
    often = TriaxialTest(
        fcc_octagon(layers=7, half_width=3), Sector(4), params=Params(platen_speed=0.05), axial_strain=0.1,
        tolerance=1e-4, refresh=False,
    )  # fmt: skip
    within = []
    seldom = replace(often, record_every=1000).run(progress=lambda now: within.append(now.due % 1000)).curve
    assert max(within) > 0, "a list must have been worn in the middle of a block"
    found = often.run().curve.stress_ratio[::20]
    assert seldom.stress_ratio.size > 4
    np.testing.assert_allclose(seldom.stress_ratio, found[: seldom.stress_ratio.size], rtol=1e-9)


def test_a_run_without_a_curve_is_refused():
    """Records so far apart that there are two of them are no curve."""
    test = TriaxialTest(
        fcc_octagon(layers=7, half_width=3), Sector(4), params=Params(platen_speed=0.05), axial_strain=0.02,
        tolerance=1e-3, record_every=100_000,
    )  # fmt: skip
    with pytest.raises(SimulationError, match="before the third record: lower platen_speed or record_every"):
        test.run()


def test_a_ball_that_has_left_the_membrane_stops_the_run():
    """One ball more, off the specimen and free: twice as far out as the membrane's mean it has left; nearer it may be a
    ball of a specimen that barrels."""
    small = fcc_octagon(layers=5, half_width=3)
    middle = np.hypot(*small.positions[:2, small.membrane_zone]).mean()

    def with_one_more(rho):
        place = np.array([[rho], [0.0], [small.height / 2]])
        return TriaxialTest(
            replace(
                small, positions=np.concatenate([small.positions, place], 1), radius=np.append(small.radius, 20.0),
                membrane_zone=np.append(small.membrane_zone, False),
            ),
            Sector(1), params=Params(platen_speed=0.1), axial_strain=0.004, tolerance=1e-2, record_every=10,
        )  # fmt: skip

    assert with_one_more(1.9 * middle).run().curve.axial_strain.size > 2
    with pytest.raises(SimulationError, match="has left the membrane"):
        with_one_more(2.1 * middle).run()


def test_a_given_load_does_not_age():
    """A constant load measured where the cells were stale would have the lists made anew for ever."""
    small = TriaxialTest(
        fcc_octagon(layers=7, half_width=3), Sector(4), params=Params(platen_speed=0.05), axial_strain=0.002,
        tolerance=1e-3, record_every=20,
    )  # fmt: skip
    load = current_load(small.membrane, small.network, small.confine()[0])
    fresh, aged = (replace(small, lateral_load=replace(load, stale=stale)).run() for stale in (0.0, 1.0))
    assert fresh.curve.stress_ratio.max() > 1.2
    np.testing.assert_array_equal(aged.curve.stress_ratio, fresh.curve.stress_ratio)


def test_tangents_pass_through_lists_made_anew(shear):
    """As long as one list would do, value and tangent are those of the test that keeps it."""
    _, (kept, kept_tangent), (renewed, tangent) = shear
    valid = np.asarray(kept.axial_strain) < 0.008
    assert valid.sum() > 8, "after several updates"
    for ours, theirs in ((renewed, kept), (tangent, kept_tangent)):
        for name in ("stress_ratio", "volumetric_strain"):
            expected = np.asarray(getattr(theirs, name))[valid]
            scale = np.abs(expected).max()
            np.testing.assert_allclose(np.asarray(getattr(ours, name))[valid], expected, rtol=0, atol=1e-10 * scale)
