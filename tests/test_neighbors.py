"""The contact list against a search of every ball against every image of every other."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from axijax.core.sector import Sector
from axijax.core.vector import Vector, from_rows
from axijax.mechanics.contact_list import build_contact_list, carry_memory, closing
from axijax.mechanics.term import Memory
from axijax.specimen.specimen import Specimen

ANY_OVERLAP = 1e9


def random_balls(order, seed, on_axis=2, count=25):
    """Balls of unequal size thrown into a sector, many of them near the axis, the first few on it."""
    rng = np.random.default_rng([order, seed])
    rho = 6 * rng.uniform(size=count) ** 1.5
    rho[:on_axis] = 0.0
    theta = rng.uniform(0, 2 * np.pi / order, count)
    positions = np.stack([rho * np.cos(theta), rho * np.sin(theta), rng.uniform(-3, 3, count)])
    return Specimen(positions, rng.uniform(0.4, 1.0, count), -3.0, 3.0, np.ones(count, bool))


def turned(positions, angle):
    x, y, z = positions
    return np.array([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z])


def every_pair(specimen, images, skin):
    """All (i, j, k) nearer than touching plus the skin, with the vector from the image of j to i.

    A ball on the axis is its own image: it counts once as a neighbour, under k = 0.
    """
    positions, radius = specimen.positions, specimen.radius
    on_axis = (np.hypot(*positions[:2]) == 0) & (images > 1)
    found = {}
    for k in range(images):
        branches = positions[:, :, None] - turned(positions, 2 * np.pi * k / images)[:, None]
        near = np.sqrt((branches**2).sum(axis=0)) < radius[:, None] + radius + skin
        for i, j in np.argwhere(near).tolist():
            if (i, k) != (j, 0) and not (on_axis[j] and k > 0):
                found[i, j, k] = branches[:, i, j]
    return found


def listed(network):
    """(i, j, k) of every contact in the list, with its place in it."""
    columns = (np.asarray(a).tolist() for a in (network.first, network.second, network.image))
    keys = [(place, key) for place, key in enumerate(zip(*columns, strict=True)) if key[2] >= 0]
    assert len({key for _, key in keys}) == len(keys), "no contact twice"
    return {key: place for place, key in keys}


def from_both_sides(contacts, on_axis, images):
    """The directed contacts: (i, j, k) as it is, and (j, i, -k); a ball on the axis meets all images of another."""
    for i, j, k in contacts:
        yield i, j, k
        if (j, i, -k % images) != (i, j, k):  # a ball against its own image at 180 degrees has one side only
            yield from ((j, i, turn) for turn in (range(images) if on_axis[j] and not on_axis[i] else [-k % images]))


@pytest.mark.parametrize("order", [*range(1, 13), 16, 24, 36])
def test_list_holds_every_pair_of_images_within_reach_once(order):
    """Completed by (j, i, -k), the contacts are those of the search, and none comes up twice."""
    specimen, skin = random_balls(order, seed=0), 0.3
    network = build_contact_list(specimen, Sector(order), skin=skin, largest_overlap=ANY_OVERLAP)
    expected, found = every_pair(specimen, order, skin), listed(network)
    on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (order > 1)
    both_sides = list(from_both_sides(found, on_axis, order))
    assert len(both_sides) == len(set(both_sides))
    assert set(both_sides) == set(expected)
    if order > 1:
        assert {k for _, _, k in both_sides} == set(range(order)), "near the axis every image has neighbours"
    branch, overlap = np.asarray(network.branch), np.asarray(network.overlap)
    for (i, j, k), place in found.items():
        np.testing.assert_allclose(branch[:, place], expected[i, j, k], rtol=0, atol=1e-13)
        distance = np.linalg.norm(expected[i, j, k])
        assert overlap[place] == pytest.approx(specimen.radius[i] + specimen.radius[j] - distance, abs=1e-13)
    assert (np.delete(overlap, list(found.values())) < -100).all(), "what is no contact must never touch"


@pytest.mark.parametrize("order", [3, 4, 7])
def test_between_rigid_planes_a_ball_has_no_image(order):
    specimen, skin = random_balls(order, seed=1, on_axis=0), 0.3
    network = build_contact_list(specimen, Sector(order, "rigid"), skin=skin, largest_overlap=ANY_OVERLAP)
    assert set(from_both_sides(listed(network), np.zeros(25, bool), 1)) == set(every_pair(specimen, 1, skin))


@pytest.mark.parametrize("order", [*range(1, 13), 16, 24, 36])
def test_each_contact_acts_on_both_its_balls(order):
    """Summed on the balls, a vector of the contacts is what every ball finds looking round: for one that changes sign
    seen from the other side, as a force does, and for one that does not, as a moment."""
    specimen, skin = random_balls(order, seed=2), 0.3
    # One shape for all orders, so that nothing is compiled again.
    network = build_contact_list(
        specimen, Sector(order), skin, max_contacts_per_ball=250, contacts=2600, largest_overlap=ANY_OVERLAP
    )
    pairs = every_pair(specimen, order, skin)

    def expected(vector):
        total = np.zeros((3, len(specimen)))
        for (i, _, _), branch in pairs.items():
            total[:, i] += vector(branch)
        return total

    branch = network.branch
    listed_only = (network.image >= 0).astype(float)
    length = np.linalg.norm(np.asarray(branch), axis=0)
    odd = network.sum_on_balls(branch * (listed_only * length), reaction=-1)
    even = network.sum_on_balls(branch * (listed_only * branch.z), reaction=1)
    np.testing.assert_allclose(np.asarray(odd), expected(lambda b: b * np.linalg.norm(b)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.asarray(even), expected(lambda b: b * b[2]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", range(1, 7))
def test_shares_count_every_contact_of_the_full_cylinder_once(order):
    """The shares add up to 1/n of the contacts among all n copies of the balls."""
    specimen, skin = random_balls(order, seed=6), 0.3
    network = build_contact_list(specimen, Sector(order), skin=skin, largest_overlap=ANY_OVERLAP)
    on_axis = np.hypot(*specimen.positions[:2]) == 0
    copies = [(i, k) for i in range(len(specimen)) for k in range(1 if on_axis[i] else order)]
    places = np.stack([turned(specimen.positions[:, i], 2 * np.pi * k / order) for i, k in copies], axis=1)
    radius = specimen.radius[[i for i, _ in copies]]
    full = Specimen(places, radius, -3.0, 3.0, np.ones(radius.size, bool))
    assert float(network.share.sum()) == pytest.approx(len(every_pair(full, 1, skin)) / 2 / order, rel=1e-12)


def test_balls_on_the_axis_are_held_on_it_and_shared_by_all_sectors():
    """They may move along z only, and count 1/n in sums over a sector."""
    network = build_contact_list(random_balls(5, seed=3), Sector(5), largest_overlap=ANY_OVERLAP)
    on_axis = np.arange(25) < 2
    np.testing.assert_array_equal(np.asarray(network.free), np.stack([~on_axis, ~on_axis, np.ones(25)]))
    np.testing.assert_allclose(network.weight, np.where(on_axis, 0.2, 1.0))


@pytest.mark.parametrize("order", [1, 4, 6])
def test_springs_stay_with_their_contacts_through_a_rebuild(order):
    """After the balls have moved and the list is in another order, each contact has the spring it had; new contacts
    have none, and springs of contacts that are gone are dropped."""
    rng = np.random.default_rng(order)
    sector, skin = Sector(order), 0.3
    before = random_balls(order, seed=4)
    moves = 0.1 * rng.normal(size=before.positions.shape)
    moves[:, :2] = 0.0  # on the axis
    after = replace(before, positions=np.clip(before.positions + moves, [[-9], [-9], [-3]], [[9], [9], [3]]))
    old = build_contact_list(before, sector, skin=skin, largest_overlap=ANY_OVERLAP)
    new = build_contact_list(after, sector, skin=skin, contacts=old.first.size + 40, largest_overlap=ANY_OVERLAP)
    shuffle = rng.permutation(new.first.size)
    new = replace(new, first=new.first[shuffle], second=new.second[shuffle], image=new.image[shuffle])
    springs = rng.normal(size=(3, old.first.size))  # where no contact is, too: these must not go anywhere
    kept = object()  # what is not of the contacts is no business of theirs
    memory = carry_memory(old, new, (Memory(), Memory(from_rows(springs), kept)))
    assert memory[0] == Memory() and memory[1].ball is kept
    carried = np.asarray(memory[1].contact)
    had, has = listed(old), listed(new)
    assert had.keys() - has.keys() and has.keys() - had.keys() and len(had.keys() & has.keys()) > 20
    expected = np.zeros((3, new.first.size))
    for key in had.keys() & has.keys():
        expected[:, has[key]] = springs[:, had[key]]
    np.testing.assert_array_equal(carried, expected)


def test_a_padded_list_holds_the_same_contacts():
    """More slots and contacts than are needed change its shape only."""
    specimen, sector = random_balls(4, seed=5), Sector(4)
    tight = build_contact_list(specimen, sector, largest_overlap=ANY_OVERLAP)
    width, contacts = tight.slot.shape[0] + 3, tight.first.size + 24
    padded = build_contact_list(
        specimen, sector, max_contacts_per_ball=width, contacts=contacts, largest_overlap=ANY_OVERLAP
    )
    assert padded.slot.shape == (width, 25) and padded.first.shape == (contacts,)
    assert listed(padded) == listed(tight)
    sums = [np.asarray(network.sum_on_balls(network.branch, reaction=-1)) for network in (tight, padded)]
    np.testing.assert_allclose(*sums, rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 4, 12])
def test_no_contact_is_missed_while_the_balls_have_closed_by_less_than_the_skin(order):
    """Balls that move at random: whenever two touch that the list does not hold, `closing` is above the skin. And it is
    not simply always above: in some of the cases nothing is missed and `closing` says so."""
    specimen, skin = random_balls(order, seed=1), 1.0
    network = build_contact_list(specimen, Sector(order), skin=skin, largest_overlap=ANY_OVERLAP)
    on_axis = (np.hypot(*specimen.positions[:2]) == 0) & (order > 1)
    held = set(from_both_sides(listed(network), on_axis, order))
    rng, missed, sound, closed = np.random.default_rng(order), 0, 0, jax.jit(closing)
    for _ in range(400):
        moves = rng.normal(size=specimen.positions.shape) * np.where(on_axis, [[0], [0], [1]], 1)
        kind = rng.integers(3)
        if kind == 1:  # towards the axis, where images meet
            moves[:2], moves[2] = -specimen.positions[:2], 0
        if kind > 0:  # one ball alone, by up to twice the skin
            moves[:, np.arange(len(specimen)) != rng.integers(2, len(specimen))] = 0
        moves *= rng.uniform(0, 2 * skin) / np.linalg.norm(moves, axis=0).max()
        moved = replace(specimen, positions=specimen.positions + moves, bottom=-9.0, top=9.0)
        touching = {key for key in every_pair(moved, order, 0.0) if not on_axis[key[0]]}
        worn = float(closed(network, from_rows(moves))) > skin
        missed += not touching <= held
        sound += not worn
        assert touching <= held or worn
    assert missed > 20 and sound > 100


def test_what_two_balls_can_have_closed_by():
    """The sum of the two farthest; for a ball near the axis that of its own images as well, which meet it."""
    rho = np.array([1.2, 8.0, 8.0, 8.0])
    theta = np.array([0.3, 0.2, 0.8, 1.4])
    positions = np.stack([rho * np.cos(theta), rho * np.sin(theta), np.array([0.0, 0.0, 0.0, 0.0])])
    specimen = Specimen(positions, np.full(4, 0.8), -1.0, 1.0, np.ones(4, bool))
    moves = np.zeros((3, 4))
    for order, own_image in ((1, 1), (4, 2 * 0.8 / 1.1)):
        network = build_contact_list(specimen, Sector(order), skin=0.5)
        moves[:] = 0
        moves[:2, 0] = -0.1 * positions[:2, 0] / 1.2
        assert float(closing(network, from_rows(moves))) == pytest.approx(0.1 * own_image, rel=1e-12)
        moves[2, 1], moves[1, 3] = 0.4, -0.3
        assert float(closing(network, from_rows(moves))) == pytest.approx(0.7, rel=1e-15)


@pytest.mark.parametrize("order", [2, 3, 4, 12])
def test_a_ball_that_comes_slowly_near_the_axis_wears_the_list_on_the_way(order):
    """By steps of a thousandth of the skin, from where it cannot touch its own image to where it does: there is a step
    between worn and too late."""
    skin = 0.8
    for share in (0.3, 0.5, 0.59, 0.9):  # of the skin, to where they touch
        place = np.array([[1 / np.sin(np.pi / order) + share * skin], [0.0], [0.0]])
        network = build_contact_list(Specimen(place, np.ones(1), -9.0, 9.0, np.ones(1, bool)), Sector(order), skin=skin)
        ways = np.arange(0, place[0, 0], skin / 1000)[:1000, None]
        closed = np.asarray(jax.vmap(lambda way, to=network: closing(to, Vector(-way, 0 * way, 0 * way)))(ways))
        worn = np.flatnonzero(closed > 0.6 * skin)[0]
        assert closed[worn] < 0.61 * skin
