"""Sums over contacts and gathers by index: forward the plain ones, and backward the exact transposes of these."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import jit
from test_neighbors import ANY_OVERLAP, random_balls

from axijax.core.gather import gathered, taken
from axijax.core.sector import Sector
from axijax.core.vector import Vector
from axijax.mechanics.contact_list import Room, build_contact_list, carry
from axijax.mechanics.contact_search import contact_list, update
from axijax.mechanics.tight_list import tighten


def dense_list(order):
    """Of balls so dense that each touches its own images and two on the axis touch everything."""
    return build_contact_list(random_balls(order, 0), Sector(order), 0.6, 250, 2600, largest_overlap=ANY_OVERLAP)


def plain_ends(network, vectors: Vector):
    first, second = vectors.map(lambda part: part[network.first]), vectors.map(lambda part: part[network.second])
    return first, second.turned(network.cos, network.sin)


def plain_sum(network, vectors: Vector, reaction):
    factor = network.side if reaction < 0 else jnp.abs(network.side)
    there = vectors.map(lambda part: part[network.slot]).turned(network.slot_cos, network.slot_sin)
    return there.map(lambda part: (part * factor).sum(axis=0))


def random_like(tree, seed=0):
    leaves, structure = jax.tree.flatten(tree)
    keys = jax.random.split(jax.random.key(seed), len(leaves))
    return structure.unflatten([jax.random.normal(key, leaf.shape) for key, leaf in zip(keys, leaves, strict=True)])


def check(ours, plain, values, seen=1.0, exact=True):
    """Value, tangent and transpose of two linear functions, for two weights at once; seen: what counts of them."""

    @jit
    def of(function, values, weights):
        results, back = jax.vjp(function, values)
        _, tangent = jax.jvp(function, (values,), (values,))
        return results, tangent, jax.vmap(back)(weights)

    shapes = jax.eval_shape(ours, values)
    weights = jax.tree.map(lambda part: part * seen, jax.vmap(lambda seed: random_like(shapes, seed))(jnp.arange(2)))
    found, expected = (
        of(jax.tree_util.Partial(ours), values, weights),
        of(jax.tree_util.Partial(plain), values, weights),
    )
    near = partial(np.testing.assert_allclose, rtol=0, atol=1e-12)
    jax.tree.map(np.testing.assert_array_equal if exact else near, found[:2], expected[:2])
    jax.tree.map(near, found[2], expected[2])
    _, back = jax.vjp(ours, values)
    jaxpr = str(jax.make_jaxpr(back)(jax.tree.map(lambda part: part[0], weights)))
    assert "scatter" not in jaxpr and "axijax_linear" in jaxpr


@pytest.mark.parametrize("order", [1, 4])
def test_ends_and_sums_of_contacts(order):
    network = dense_list(order)
    balls, contacts = random_like(network.positions), random_like(network.branch)
    listed = np.asarray(network.image) >= 0  # padding never has a derivative
    assert (np.asarray(network.first == network.second)[listed].any()) == (order > 1)
    check(network.at_ends, lambda v: plain_ends(network, v), balls, listed)
    for reaction in (-1, 1):
        check(lambda v: network.sum_on_balls(v, reaction=reaction), lambda v: plain_sum(network, v, reaction), contacts)  # noqa: B023


@pytest.mark.parametrize("order", [1, 4])
def test_ends_and_sums_of_contacts_with_further_slots(order):
    """Of a crowd those of one table with all slots, to rounding: they are added up in another order."""
    network, still = dense_list(order), Vector(*jnp.zeros((3, 25)))
    near = lambda room: tighten(replace(network, tight=room), still, jnp.full(25, 0.1))  # noqa: E731
    whole, parted = near(Room(800, 30)).network, near(Room(800, 2, 26, 28)).network
    further, ends = np.asarray(parted.crowd.side) != 0, (np.asarray(whole.side) != 0).sum(axis=0)
    assert 0 < further.any(axis=0).sum() < 25 and ends.max() < 30
    assert further.sum() + (np.asarray(parted.side) != 0).sum() == ends.sum()
    balls, contacts = random_like(network.positions), random_like(whole.branch)
    check(parted.at_ends, lambda v: plain_ends(whole, v), balls, np.asarray(whole.image) >= 0)
    for reaction in (-1, 1):
        ours, plain = partial(parted.sum_on_balls, reaction=reaction), partial(plain_sum, whole, reaction=reaction)
        check(ours, plain, contacts, exact=False)


def test_batches_of_lists_and_of_values():
    """vmap over values, over lists, and over both; each element is what it is alone."""
    networks = [dense_list(4), replace(dense_list(4), side=-dense_list(4).side)]
    balls = [random_like(networks[0].positions, seed) for seed in range(2)]
    lists, many = (jax.tree.map(lambda *parts: jnp.stack(parts), *two) for two in (networks, balls))

    def slope(network, values):
        def loss(values):
            first, second = network.at_ends(values)
            return network.sum_on_balls(first.cross(second), reaction=-1).dot(values).sum()

        return jax.grad(loss)(values)

    @jit
    def of():
        axes = {(0, None): (lists, balls[1]), (None, 0): (networks[1], many), (0, 0): (lists, many)}
        batches = [jax.vmap(slope, in_axes=each)(*chosen) for each, chosen in axes.items()]
        return [jax.tree.map(lambda part: part[1], batch) for batch in batches], slope(networks[1], balls[1])

    batches, alone = of()
    for found in batches:
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12), found, alone)


def test_lists_that_change():
    """Tight lists, and lists made anew inside jit: what is carried over, branches and overlaps."""
    specimen = random_balls(4, 0)
    network = contact_list(Sector(4), 0.6, 2.0, ANY_OVERLAP).allocate(specimen)
    network = replace(network, tight=Room(2000, 200))
    springs, shift = random_like(network.branch), random_like(network.positions).map(lambda part: 0.1 * part)
    shift = Vector(shift.x * network.free.x, shift.y * network.free.y, shift.z)
    new = jit(update)(shift, network)
    pairs = lambda values: carry(network, new, values)  # noqa: E731
    place = {
        tuple(key): at for at, key in enumerate(np.stack([network.first, network.second, network.image], 1).tolist())
    }
    keys = np.stack([new.first, new.second, new.image], 1).tolist()
    index = np.array([place.get(tuple(key), -1) if key[2] >= 0 else -1 for key in keys])
    assert (index >= 0).sum() > 20 and ((index < 0) & (np.asarray(new.image) >= 0)).any()
    plain = lambda values: values.map(lambda part: jnp.where(index >= 0, part[index], 0.0))  # noqa: E731
    check(pairs, plain, springs)

    def anew(shift):
        made = update(shift, network)
        return made.branch, made.overlap, made.distance

    # Their transpose against their tangent, and that against differences.
    way, weights = random_like(shift, 3), random_like(anew(shift), 4)
    weights = jax.tree.map(lambda part: part * (new.image >= 0), weights)
    _, tangent = jit(lambda v, w: jax.jvp(anew, (v,), (w,)))(shift, way)
    dot = lambda a, b: sum(jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))  # noqa: E731
    back = jit(lambda v, w: jax.vjp(anew, v)[1](w)[0])(shift, weights)
    assert float(dot(back, way)) == pytest.approx(float(dot(weights, tangent)), rel=1e-11)
    ends = [jit(anew)(shift + way.map(lambda part: h * part)) for h in (1e-6, -1e-6)]  # noqa: B023
    slope = jax.tree.map(lambda a, b: (a - b) / 2e-6, *ends)
    assert float(dot(weights, slope)) == pytest.approx(float(dot(weights, tangent)), rel=1e-6)

    tight = jit(tighten)(network, shift, jnp.full(network.radius.size, 0.05))
    assert bool(tight.fits)
    inside = np.asarray(tight.place) < network.first.size - 1
    check(lambda v: Vector(*taken(tuple(v), tight.place, tight.found_at, tight.found_at < 1999)),
          lambda v: v.map(lambda part: part[tight.place]), springs, inside)  # fmt: skip


def test_a_table_with_a_tangent_of_its_own():
    network, values = dense_list(4), random_like(dense_list(4).branch)
    sums = lambda side: replace(network, side=side).sum_on_balls(values, reaction=-1).z.sum()  # noqa: E731
    slope = jit(jax.grad(sums))(network.side)
    np.testing.assert_allclose(slope, values.z[network.slot], rtol=1e-14)


def test_any_index():
    rng = np.random.default_rng(0)
    index = jnp.asarray(rng.integers(0, 40, (7, 30)), jnp.int32)
    values = [jnp.asarray(rng.normal(size=50)) for _ in range(2)]
    check(lambda v: gathered(v, index), lambda v: [each[index] for each in v], values)
    two = jnp.stack([index, index + 3])

    def slope(index):
        return jax.grad(lambda v: (gathered([v], index)[0] ** 3).sum())(values[0])

    np.testing.assert_allclose(jax.vmap(slope)(two)[1], slope(two[1]), rtol=1e-14)


def test_second_derivatives():
    """Forward over reverse, and reverse over reverse."""
    network = dense_list(4)

    def energy(z):
        first, second = network.at_ends(Vector(0.1 * z, z**2, z))
        return (network.sum_on_balls(first - second, reaction=-1).dot(Vector(z, z, z)) ** 2).sum()

    z = jnp.linspace(0.1, 1.0, 25)
    forward, backward = (jit(twice(jax.grad(energy)))(z) for twice in (jax.jacfwd, jax.jacrev))
    assert float(jnp.abs(forward).max()) > 1
    np.testing.assert_allclose(forward, backward, rtol=1e-9)
    np.testing.assert_allclose(forward, forward.T, rtol=1e-9, atol=1e-9 * float(jnp.abs(forward).max()))
