"""The tight list against a search of every pair, and runs with it against runs that see the whole contact list."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import Pull, jit
from test_neighbors import ANY_OVERLAP, every_pair, from_both_sides, listed, random_balls

from axijax import Params, Scene, Sector, Specimen, TriaxialTest, random_cylinder
from axijax.core.vector import Vector, from_rows
from axijax.mechanics import rebuild
from axijax.mechanics.contact_list import Room, build_contact_list
from axijax.mechanics.dynamics import initial_state, make_step, terms_of
from axijax.mechanics.membrane import Load
from axijax.mechanics.tight_list import Tight, allowances, near_pairs, tighten
from axijax.triaxial.engine import until_balls_moved
from axijax.triaxial.tight_steps import can_be_tight, fixed_steps, steps_until_worn, tight_list

same = partial(np.testing.assert_allclose, rtol=1e-11, atol=1e-13)
tightened = jit(tighten)


def moved_balls(order, seed=0, on_axis=2):
    """A list, a displacement of its balls that it outlasts, and where they are then."""
    specimen = random_balls(order, seed, on_axis)
    network = build_contact_list(specimen, Sector(order), 0.6, 250, 2600, largest_overlap=ANY_OVERLAP)
    shift = np.random.default_rng(seed + 1).uniform(-0.1, 0.1, specimen.positions.shape)
    shift[:2, np.hypot(*specimen.positions[:2]) == 0] = 0.0
    return network, from_rows(shift), replace(specimen, positions=specimen.positions + shift, bottom=-9.0, top=9.0)


@pytest.mark.parametrize("room", [Room(2000, 200), Room(2000, 1, 26, 199)])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 12])
def test_it_holds_every_pair_that_its_balls_may_close(order, room):
    """Images included, each once, in the order of the contact list; and its slots sum up the same on every ball, also
    where some of them stand in a second table."""
    network, shift, now = moved_balls(order)
    network = replace(network, tight=room)
    allowed = np.random.default_rng(9).uniform(0.0, 0.1, 25)
    tight = tightened(network, shift, jnp.asarray(allowed))
    assert bool(tight.fits)
    grown = replace(now, radius=now.radius + allowed)
    found, on_axis = listed(tight.network), (np.hypot(*now.positions[:2]) == 0) & (order > 1)
    assert set(from_both_sides(found, on_axis, order)) == set(every_pair(grown, order, 0.0))
    assert len(found) < len(listed(network))
    places = np.asarray(tight.place)[: len(found)]
    assert (np.diff(places) > 0).all() and (np.asarray(tight.found_at)[places] == np.arange(len(found))).all()
    # What a contact holds outside the tight list acts on no ball here.
    held = np.random.default_rng(3).normal(size=(3, 2600)) * np.isin(np.arange(2600), places)
    inside = from_rows(held[:, np.asarray(tight.place)])
    for reaction in (-1, 1):
        a, b = (np.asarray(each.sum_on_balls(v, reaction=reaction)) for each, v in
                ((network, from_rows(held)), (tight.network, inside)))  # fmt: skip
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


@pytest.mark.parametrize("room", [Room(8, 200), Room(2000, 2), Room(2000, 2, 5, 200), Room(2000, 2, 26, 3)])
def test_it_says_when_it_has_no_room(room):
    network, shift, _ = moved_balls(3)
    tight = tightened(replace(network, tight=room), shift, jnp.full(25, 0.1))
    assert not bool(tight.fits) and not bool(tight.holds(jnp.zeros(25)))


def test_it_holds_until_one_ball_has_moved_by_more_than_it_was_allowed():
    network, shift, _ = moved_balls(4)
    tight = tightened(replace(network, tight=Room(2000, 200)), shift, jnp.linspace(0.01, 0.02, 25))
    for ball in (0, 13, 24):
        for share, holds in ((0.999, True), (1.001, False)):
            away = np.zeros((3, 25))
            away[2, ball] = share * float(tight.allowed[ball])
            assert bool(tight.holds(tight.moved(shift + from_rows(away)))) is holds


def test_it_lasts_while_no_ball_is_likely_to_leave_what_it_was_allowed():
    """By what each ball has moved, and twice what it would move at its speed; and not where it had no room."""
    still, allowed = np.zeros((3, 25)), np.full(25, 0.01)
    nothing = jnp.zeros(1, jnp.int32)
    tight = Tight(None, nothing, nothing, from_rows(still), jnp.asarray(allowed), jnp.zeros(()), jnp.ones((), bool))
    for moved, speed, lasts in ((0.0, 0.0, True), (0.0, 4.9e-3, True), (0.0, 5.1e-3, False), (9e-3, 4e-4, True),
                                (9e-3, 6e-4, False), (1.1e-2, 0.0, False)):  # fmt: skip
        there, velocity = still.copy(), still.copy()
        there[2, 7], velocity[0, 7] = moved, speed
        assert bool(tight.lasts(from_rows(there), from_rows(velocity), 0.1, 10)) is lasts
    full = tight._replace(fits=jnp.zeros((), bool))
    assert not bool(full.lasts(from_rows(still), from_rows(still), 0.1, 1))


def shot(order, speed):
    """Balls at rest in a ring with a hole between them, and one that flies into it and hits the wall behind, which is
    listed and far from touching: the scene, and what steps it."""
    radius = np.ones(8)
    across, up = np.meshgrid([-1.2, 0.0, 1.2], [4.0, 6.4, 8.8], indexing="ij")
    kept = np.arange(9) != 4
    flat = np.stack([np.full(9, 20.0), across.ravel() * 1.8, up.ravel()])[:, kept]
    place = np.concatenate([flat, [[23.5], [0.0], [6.4]], [[16.9], [0.0], [6.4]]], axis=1)
    balls = Specimen(place, np.append(radius, [1.0, 1.0]), -9.0, 30.0, np.ones(10, bool))
    network = build_contact_list(balls, Sector(order), skin=6.0)
    network = replace(network, tight=Room(16, 6))
    params, scene = Params(friction=0.3), Scene()
    state = initial_state(scene, params, network, [-9.0, 30.0])
    velocity = np.zeros((3, 10))
    velocity[0, 8] = -speed
    load = Load(jnp.zeros(10), jnp.asarray(1.0))
    one = make_step(scene, lambda params, network, dt, state, push, section: jnp.zeros_like(state.platen_speeds))

    def step(network, state):
        return one(params, network, load, 1e-3, state)

    return network, state._replace(velocity=from_rows(velocity)), step


@pytest.mark.parametrize("order", [1, 5])
def test_a_ball_shot_into_a_hole_meets_what_is_behind_it(order):
    """With slow and fast flights: contacts come and go, and all is as with the whole list, to rounding."""
    network, _, step = shot(order, 0.0)
    dt, short = 1e-3, 175  # of the fast flight; the slow one is so many of them, so that one program does for both

    def until(state, most):
        return until_balls_moved(lambda s: step(network, s), network, dt, most, state)

    @jit
    def with_all(state, number):
        return jax.lax.fori_loop(0, number, lambda _, s: step(network, s), state)

    @jit
    def fixed(state):
        return fixed_steps(step, network, dt, tight_list(network, state, dt, 50), state, short)

    @jit
    def run(state, number):
        first = tight_list(network, state, dt, 50)
        return steps_until_worn(step, network, dt, first, state, number, 50, 10, 2 * network.skin, until)

    for speed, flights in ((2.0, 20), (40.0, 1)):
        _, start, _ = shot(order, speed)
        number = flights * short
        whole = with_all(start, number)
        assert float(np.abs(np.asarray(whole.velocity)[:, 9]).max()) > 0.1 * speed, "the wall was hit"
        in_blocks = start
        for _ in range(flights):
            in_blocks = fixed(in_blocks)
        state, taken, _ = run(start, number)
        assert int(taken) == number
        for other in (in_blocks, state):
            jax.tree.map(same, other, whole)


def test_a_kick_that_no_list_foresaw_is_caught():
    """A ball at rest that is suddenly driven moves by more than it was allowed: the steps are taken again."""
    network, start, step = shot(1, 0.0)

    def driven(network, state):
        after = step(network, state)
        x, y, z = after.velocity
        return after._replace(velocity=Vector(x - 2.0 * (jnp.arange(10) == 8), y, z))

    number = 75
    whole = jit(lambda s: jax.lax.fori_loop(0, number, lambda _, s: driven(network, s), s))(start)
    assert float(whole.velocity.x[9]) < 0, "it has hit the wall"
    tight = jit(lambda s: fixed_steps(driven, network, 1e-3, tight_list(network, s, 1e-3, 50), s, number))(start)
    jax.tree.map(same, tight, whole)


def test_members_of_a_vmap_are_caught_one_by_one_and_pay_for_the_whole_list_only_then():
    """One ball driven, the other member's let be: both as with the whole list, springs too; and what is taken again
    stays a branch, not a select of two results that are both computed."""
    network, start, step = shot(1, 0.0)
    number = 75

    def driven(kick):
        def one(network, state):
            after = step(network, state)
            x, y, z = after.velocity
            return after._replace(velocity=Vector(x - kick * (jnp.arange(10) == 8), y, z))

        return one

    def tightly(kick):
        first = tight_list(network, start, 1e-3, 50)
        return fixed_steps(driven(kick), network, 1e-3, first, start, number)

    @jit
    def loosely(kick):
        return jax.lax.fori_loop(0, number, lambda _, s: driven(kick)(network, s), start)

    kicks = jnp.array([0.0, 2.0, 1e-6])
    whole = [loosely(kick) for kick in kicks]
    assert float(whole[1].velocity.x[9]) < 0 and float(whole[0].velocity.x[9]) == 0
    together = jit(jax.vmap(tightly))(kicks)
    for member, alone in enumerate(whole):
        jax.tree.map(lambda many, one, member=member: same(many[member], one), together, alone)
    branches = [str(jax.make_jaxpr(f)(kicks)).count(" cond[") for f in (lambda k: tightly(k[0]), jax.vmap(tightly))]
    assert branches[0] == branches[1] > 0


def test_a_random_specimen_runs_as_with_the_whole_list():
    """Curves of `run` and `simulate` are equal to rounding to those of `simulate` without it, derivatives too."""
    specimen, report = random_cylinder(60, Sector(4), seed=3, tolerance=1e-2)
    test = TriaxialTest(
        specimen, Sector(4), params=Params(platen_speed=0.2), axial_strain=3e-3, tolerance=1e-2,
        confining_friction=report.compaction_friction,
    )  # fmt: skip
    assert can_be_tight(test.network, test.params) and test.network.tight.contacts < 0.8 * test.network.first.size
    prepared = test.prepared
    loose = replace(test)
    loose.__dict__["prepared"] = replace(prepared, network=replace(prepared.network, tight=None))
    direction = jax.tree.map(jnp.zeros_like, replace(test.params, friction=1.0))
    direction = replace(direction, friction=jnp.ones(()))
    (curve, slope), (whole, whole_slope) = (
        jax.jvp(each.simulate, (test.params,), (direction,)) for each in (test, loose)
    )
    ran = test.run().curve
    for name in ("stress_ratio", "core_ratio", "volumetric_strain", "coordination_number"):
        expected = getattr(whole, name)
        np.testing.assert_allclose(getattr(curve, name), expected, rtol=1e-12, atol=1e-14)
        found = getattr(ran, name)
        np.testing.assert_allclose(found, expected[: found.size], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(slope.stress_ratio, whole_slope.stress_ratio, rtol=1e-9, atol=1e-12)


def test_its_room_has_some_to_spare(monkeypatch):
    """A run whose contacts grew in number by a few per cent took a quarter of its first steps with the whole list."""
    monkeypatch.setattr(rebuild, "FEW", 1)
    network, _, _ = moved_balls(1)
    contacts, slots = near_pairs(network)
    crowd, most = int((slots > 1).sum()), int(slots.max())
    for room in (Room(8, 2), Room(contacts + 1, 1, crowd + 1, 3)):
        found = rebuild._tight_room(network, room)
        assert found.contacts > 1.05 * contacts and found.crowd > 1.1 * crowd and found.width + found.further >= most
        assert rebuild._tight_room(network, found) == found


def test_a_term_that_acts_at_a_distance_sees_the_whole_list():
    network = replace(moved_balls(1)[0], tight=Room(2000, 200))
    assert can_be_tight(network, Params()) and not can_be_tight(network, Params(terms=(Pull(1.0),)))
    assert not any(term.acts_apart for term in terms_of(Params()))
    assert partial(allowances, dt=1e-3, steps=50)(network, network.positions).shape == (25,)
