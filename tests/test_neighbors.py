"""The contact list against a search of every ball against every image of every other."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from axijax.neighbors import build_network, carry_springs
from axijax.packing import Specimen
from axijax.sector import Sector

ANY_OVERLAP = 1e9


def random_balls(order, seed, on_axis=2, count=25):
    """Balls of unequal size thrown into a sector, many of them near the axis, the first few on it."""
    rng = np.random.default_rng([order, seed])
    rho = 6 * rng.uniform(size=count) ** 1.5
    rho[:on_axis] = 0.0
    theta = rng.uniform(0, 2 * np.pi / order, count)
    positions = np.stack([rho * np.cos(theta), rho * np.sin(theta), rng.uniform(-3, 3, count)])
    return Specimen(positions, rng.uniform(0.4, 1.0, count), -3.0, 3.0, np.ones(count, bool))


def turned(position, angle):
    x, y, z = position
    return np.array([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z])


def every_pair(specimen, images, skin):
    """All (i, j, k) nearer than touching plus the skin, with the vector from the image of j to i, one by one.

    A ball on the axis is its own image: it counts once as a neighbour, under k = 0.
    """
    found = {}
    for i in range(len(specimen)):
        for j in range(len(specimen)):
            j_on_axis = np.hypot(*specimen.positions[:2, j]) == 0
            for k in range(1 if j_on_axis and images > 1 else images):
                branch = specimen.positions[:, i] - turned(specimen.positions[:, j], 2 * np.pi * k / images)
                reach = specimen.radius[i] + specimen.radius[j]
                if (i, k) != (j, 0) and np.linalg.norm(branch) < reach + skin:
                    found[i, j, k] = branch
    return found


def entries(network):
    """(i, j, k) of every entry in use, with its slot."""
    neighbor, image = np.asarray(network.neighbor), np.asarray(network.image)
    slots, balls = np.nonzero(neighbor >= 0)
    keys = [(int(i), int(neighbor[s, i]), int(image[s, i])) for s, i in zip(slots, balls, strict=True)]
    assert len(set(keys)) == len(keys), "no contact twice"
    return dict(zip(keys, slots, strict=True))


@pytest.mark.parametrize("order", range(1, 13))
def test_list_holds_every_pair_of_images_within_reach_and_no_other(order):
    specimen, skin = random_balls(order, seed=0), 0.3
    network = build_network(specimen, Sector(order), skin=skin, largest_overlap=ANY_OVERLAP)
    expected, found = every_pair(specimen, order, skin), entries(network)
    assert set(found) == set(expected)
    if order > 1:
        assert {k for _, _, k in found} == set(range(order)), "near the axis every image has neighbours"
    branch, reach = np.asarray(network.branch), np.asarray(network.reach)
    for (i, j, k), slot in found.items():
        np.testing.assert_allclose(branch[:, slot, i], expected[i, j, k], rtol=0, atol=1e-13)
        assert reach[slot, i] == pytest.approx(specimen.radius[i] + specimen.radius[j], rel=1e-15)


@pytest.mark.parametrize("order", [3, 4, 7])
def test_between_rigid_planes_a_ball_has_no_image(order):
    specimen, skin = random_balls(order, seed=1, on_axis=0), 0.3
    network = build_network(specimen, Sector(order, "rigid"), skin=skin, largest_overlap=ANY_OVERLAP)
    assert set(entries(network)) == set(every_pair(specimen, 1, skin))


@pytest.mark.parametrize("order", range(1, 13))
def test_each_contact_is_seen_from_both_balls(order):
    """(i, j, k) and (j, i, -k), branches opposite after the turn; a ball on the axis instead meets every image."""
    specimen = random_balls(order, seed=2)
    network = build_network(specimen, Sector(order), skin=0.3, largest_overlap=ANY_OVERLAP)
    found, branch = entries(network), np.asarray(network.branch)
    on_axis = np.hypot(*specimen.positions[:2]) == 0
    for (i, j, k), slot in found.items():
        if order > 1 and on_axis[j]:
            assert k == 0
            assert on_axis[i] or all((j, i, image) in found for image in range(order))
            continue
        back = (j, i, 0 if order > 1 and on_axis[i] else -k % order)
        opposite = -turned(branch[:, found[back], j], 2 * np.pi * k / order)
        np.testing.assert_allclose(branch[:, slot, i], opposite, rtol=0, atol=1e-13)


def test_balls_on_the_axis_are_held_on_it_and_shared_by_all_sectors():
    """They may move along z only, and count 1/n in sums over a sector."""
    network = build_network(random_balls(5, seed=3), Sector(5), largest_overlap=ANY_OVERLAP)
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
    old = build_network(before, sector, skin=skin, largest_overlap=ANY_OVERLAP)
    new = build_network(after, sector, skin=skin, width=old.neighbor.shape[0] + 4, largest_overlap=ANY_OVERLAP)
    shuffle = np.argsort(rng.uniform(size=new.neighbor.shape), axis=0)
    new = replace(
        new,
        neighbor=jnp.asarray(np.take_along_axis(np.asarray(new.neighbor), shuffle, axis=0)),
        image=jnp.asarray(np.take_along_axis(np.asarray(new.image), shuffle, axis=0)),
    )
    springs = rng.normal(size=old.branch.shape)  # in empty entries too: these must not go anywhere
    carried = np.asarray(carry_springs(old, new, springs))
    had, has = entries(old), entries(new)
    assert had.keys() - has.keys() and has.keys() - had.keys() and len(had.keys() & has.keys()) > 20
    expected = np.zeros(carried.shape)
    for i, j, k in had.keys() & has.keys():
        expected[:, has[i, j, k], i] = springs[:, had[i, j, k], i]
    np.testing.assert_array_equal(carried, expected)


def test_a_padded_list_holds_the_same_contacts():
    """More entries and copies than are needed change its shape only."""
    specimen, sector = random_balls(4, seed=5), Sector(4)
    tight = build_network(specimen, sector, largest_overlap=ANY_OVERLAP)
    width, copies = tight.neighbor.shape[0] + 3, tight.copy_of.size + 7
    padded = build_network(specimen, sector, width=width, copies=copies, largest_overlap=ANY_OVERLAP)
    assert padded.neighbor.shape == (width, 25) and padded.copy_of.shape == (copies,)
    assert entries(padded) == entries(tight)
