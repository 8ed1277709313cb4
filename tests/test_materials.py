"""The parameters of a test as a tree of parts: read and replaced by name, refused where they would do nothing, and
nothing compiled for what is not there."""

import copy
import pickle
from dataclasses import dataclass, replace
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from few_balls import SCENE, Pull, few_balls, hertz_params, no_load, record, run, unit_params

from axijax import (
    BackgroundDamping,
    Dashpot,
    Hertz,
    Linear,
    LocalDamping,
    Params,
    Sector,
    Specimen,
    TriaxialTest,
    fcc_octagon,
)  # fmt: skip
from axijax.core.quantity import present, quantity
from axijax.core.tree import pytree
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.dynamics import all_forces, initial_state
from axijax.mechanics.params import check_params
from axijax.theory import impact_maximum_overlap
from axijax.triaxial.paths import wave_speed

LOADING = {"confining_stress", "platen_speed"}
LINEAR = {"friction", "density", "normal_stiffness", "shear_stiffness"}
HERTZ = {"friction", "density", "shear_modulus", "poisson_ratio"}

# Parameters, and the names of all that are there.
TREES = {
    "paper": (Params(), LOADING | LINEAR | {"damping_ratio"}),
    "hertz": (Params(Hertz()), LOADING | HERTZ | {"damping_ratio"}),
    "frictionless": (Params(friction=None), LOADING | LINEAR - {"friction"} | {"damping_ratio"}),
    "undamped": (Params(damping=None), LOADING | LINEAR),
    "local": (Params(Hertz(damping=LocalDamping())), LOADING | HERTZ | {"local_damping"}),
    "background": (Params(damping=BackgroundDamping()), LOADING | LINEAR | {"background_damping"}),
    "rough platens": (Params(platen_friction=0.3), LOADING | LINEAR | {"damping_ratio", "platen_friction"}),
    "glued": (Params(platen_friction=float("inf")), LOADING | LINEAR | {"damping_ratio", "platen_friction"}),
    "a further term": (Params(terms=(Pull(0.5),)), LOADING | LINEAR | {"damping_ratio", "pull"}),
}
EVERY = set().union(*(names for _, names in TREES.values()))


@pytest.mark.parametrize("tree", TREES)
def test_a_name_finds_its_parameter_wherever_it_is(tree):
    """Read, replaced and given by name; the others, and the parameters that it was replaced in, stay as they were."""
    params, names = TREES[tree]
    assert set(present(params)) == names
    assert len(jax.tree.leaves(params)) == len(names), "what is not there is no leaf"
    check_params(params, 7)
    before = {name: getattr(params, name) for name in names}
    for name in names:
        changed = replace(params, **{name: 0.25})
        assert {each: getattr(changed, each) for each in names} == before | {name: 0.25}
        assert jax.tree.structure(changed) == jax.tree.structure(params)
    assert {name: getattr(params, name) for name in names} == before
    rest = {name: value for name, value in before.items() if name not in LOADING}
    again = Params(params.material, terms=params.terms, **{name: 2 * value for name, value in rest.items()})
    assert all(getattr(again, name) == 2 * value for name, value in rest.items())


@pytest.mark.parametrize("tree", TREES)
def test_what_would_do_nothing_is_refused(tree):
    params, names = TREES[tree]
    may_be_there = {"friction", "platen_friction"}  # a material has a place for them
    for name in EVERY - names - may_be_there:
        for act in (lambda name=name: replace(params, **{name: 0.5}), lambda name=name: with_given(params, name)):
            with pytest.raises(ValueError) as caught:
                act()
            message = str(caught.value)
            assert message.startswith(f"{name} = 0.5: no part of these parameters (") and "would do nothing" in message
            assert type(params.material).__name__ in message
            assert message.endswith((".", "?")) and "\n" not in message
        with pytest.raises(AttributeError, match=f"no '{name}'; they have .*density"):
            getattr(params, name)


def with_given(params, name):
    return Params(params.material, terms=params.terms, **{name: 0.5})


def test_a_traced_value_that_would_do_nothing_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^poisson_ratio: no part of these parameters \(Linear, Dashpot\)"):
        jax.jit(lambda nu: replace(Params(), poisson_ratio=nu).friction)(0.2)


def test_a_misspelt_name_gets_the_right_one():
    with pytest.raises(ValueError, match="did you mean 'shear_stiffness'"):
        Params(shear_stifness=1.0)


def test_parts_are_replaced_by_name_with_what_is_in_them():
    params = replace(Params(), damping=LocalDamping(0.3), friction=0.4)
    assert (params.local_damping, params.friction) == (0.3, 0.4)
    assert replace(params, damping=Dashpot()).damping_ratio == Dashpot().damping_ratio
    assert Params(Hertz(friction=0.1), friction=0.2).friction == 0.2, "a name beside goes before what is in it"
    swapped = replace(params, material=Hertz())
    assert swapped.shear_modulus == Hertz().shear_modulus and swapped.friction == Hertz().friction


@pytest.mark.parametrize("tree", TREES)
def test_a_tree_goes_apart_and_together(tree):
    """jax.tree's round trip, and a map over all numbers."""
    params, names = TREES[tree]
    leaves, structure = jax.tree.flatten(params)
    assert jax.tree.unflatten(structure, leaves) == params
    doubled = jax.tree.map(lambda x: 2 * x, params)
    assert {name: getattr(doubled, name) for name in names} == {name: 2 * getattr(params, name) for name in names}


def test_trees_of_other_parts_are_other_trees():
    """JAX finds a compiled program by the structure of what it is given: if those of two kinds of damping or material
    were equal, one would now and then be run with the program of the other."""
    kinds = {key: jax.tree.structure(params) for key, (params, _) in TREES.items() if key != "glued"}
    same = [(a, b) for a, b in combinations(kinds, 2) if kinds[a] == kinds[b]]
    assert not same
    assert kinds["rough platens"] == jax.tree.structure(TREES["glued"][0]), "the same parts with other numbers"


# Only what is there is stored and compiled.


@pytest.mark.parametrize("boundary, planes", [("periodic", 2), ("rigid", 4)])
@pytest.mark.parametrize("make", [unit_params, hertz_params])
def test_a_state_remembers_only_what_a_part_needs(make, boundary, planes):
    """Contact springs and spins with friction, platen springs with platen friction; sector planes are smooth."""
    ball = Specimen(np.array([[5.0], [5.0], [0.0]]), 1.0, -9.0, 9.0, np.ones(1, bool))
    network = build_contact_list(ball, Sector(4, boundary), contacts=3)
    for friction in (None, 0.3):
        for platens in (None, 0.3):
            params = make(friction=friction, platen_friction=platens)
            state = initial_state(SCENE, params, network, [-9.0, 9.0])
            contacts, walls, lateral = state.memory
            assert (contacts.contact is None) == (state.spring is None) == (friction is None)
            assert (state.spin is None) == (friction is None and platens is None), "rough platens turn balls too"
            shapes = [None if spring is None else spring.x.shape for spring in walls.ball or [None] * planes]
            assert shapes == [None if platens is None else (1,)] * 2 + [None] * (planes - 2)
            assert jax.tree.leaves(lateral) == [] and walls.contact is None
            assert (len(jax.tree.leaves(state.memory)) == 0) == (friction is None and platens is None)


def operations(params) -> int:
    """Lines of the program that finds the forces on two balls between platens."""
    network, state = few_balls(params, [[0, 0], [0, 0], [1.0, 3.0]], np.zeros((3, 2)), platens=(0, 4))
    program = jax.make_jaxpr(all_forces, static_argnums=0)(SCENE, params, network, no_load(network), 0.1, state)
    return str(program).count("\n")


@pytest.mark.parametrize("make", [unit_params, hertz_params])
def test_what_is_not_there_is_not_compiled(make):
    full = operations(make(damping=Dashpot(0.0), platen_friction=0.0, terms=(Pull(0.0),)))
    for absent in ("friction", "damping", "platen_friction"):
        assert operations(make(**{"damping": Dashpot(0.0), "platen_friction": 0.0} | {absent: None})) < full - 5
    assert operations(make(damping=Dashpot(0.0), platen_friction=0.0)) < full


# Functions of a whole tree.


def test_gradient_over_all_parameters_at_once():
    """c = 2 r sqrt((kn + ks)/m): the tree of derivatives by closed form, zero where it does not enter."""
    params = Params()
    network, _ = few_balls(params, [[0, 2], [0, 0], [0, 0]], np.zeros((3, 2)))
    speed, slopes = jax.jit(jax.value_and_grad(lambda params: wave_speed(params, network)))(params)
    assert isinstance(slopes, Params) and isinstance(slopes.material, Linear)
    both = params.normal_stiffness + params.shear_stiffness
    expected = {"normal_stiffness": speed / (2 * both), "shear_stiffness": speed / (2 * both)}
    expected["density"] = -speed / (2 * params.density)
    for name in present(params):
        assert float(getattr(slopes, name)) == pytest.approx(float(expected.get(name, 0.0)), rel=1e-12), name


def final_speed(params, network, state):
    """Of ball 0, after ten steps of 0.1."""
    return run.__wrapped__(params, network, no_load(network), 0.1, 10, state).velocity.z[0]


def test_tangents_through_a_run_are_a_tree():
    """A free ball under a constant force: v = pull t/m, m = density 4/3 pi."""
    params = unit_params(terms=(Pull(2e-3),))
    network, state = few_balls(params, np.zeros((3, 1)), np.zeros((3, 1)))
    slopes = jax.jit(jax.jacfwd(final_speed))(params, network, state)
    expected = {name: 0.0 for name in present(params)} | {"pull": 1.0, "density": -2e-3 / params.density}
    assert {name: float(getattr(slopes, name)) for name in expected} == pytest.approx(expected, rel=1e-12)


def test_a_batch_of_trees_is_a_tree_of_batches():
    """vmap over stacked parameters is one run after the other; and over one of them by its name."""
    several = [hertz_params(friction=0.1 * k, shear_modulus=0.5 + k, damping=Dashpot(0.1 * k)) for k in range(3)]
    place, velocity = [[0, 1.2], [0, 1.58], [0, 0]], [[0.1, 0], [0, 0], [0, 0]]
    network, state = few_balls(several[0], place, velocity, largest_overlap=0.1)

    def after(params):
        end = run.__wrapped__(params, network, no_load(network), 0.05, 40, state)
        return jnp.stack([end.velocity.x[1], end.velocity.y[0], end.spin.z[0]])

    stacked = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf, float) for leaf in leaves]), *several)
    together = jax.jit(jax.vmap(after))(stacked)
    one = jax.jit(after)
    alone = np.array([one(params) for params in several])
    assert np.ptp(alone, axis=0).min() > 1e-3, "the parameters matter"
    np.testing.assert_allclose(together, alone, rtol=1e-12, atol=1e-15)
    frictions = jnp.array([0.0, 0.2])
    by_name = jax.jit(jax.vmap(lambda f: after(replace(several[1], friction=f))))(frictions)
    expected = [one(replace(several[1], friction=f)) for f in frictions]
    np.testing.assert_allclose(by_name, expected, rtol=1e-12, atol=1e-15)


# A material from outside.


@pytree
@dataclass(frozen=True)
class Swollen(Linear):
    """Linear contacts that are stiffer by a factor of their own."""

    swelling: jax.Array | float = quantity(4.0, "factor of the stiffness", "-", above=0.0)

    def contact_law(self, network):
        law = super().contact_law(network)
        return law._replace(normal_stiffness=self.swelling * law.normal_stiffness)


def test_a_material_from_outside_is_a_material():
    """Its parameter has a name, is checked by its declaration, and acts: greatest overlap of an impact."""
    params = Params(Swollen(friction=None, density=3 / (4 * np.pi), damping=None, normal_stiffness=1.0))
    assert params.swelling == 4.0 and Params(params.material, swelling=9.0).swelling == 9.0
    with pytest.raises(ValueError, match="swelling = 0: must be positive"):
        check_params(replace(params, swelling=0.0), 2)
    with pytest.raises(ValueError, match="swelling"):
        replace(Params(), swelling=2.0)
    network, state = few_balls(params, [[0, 2], [0, 0], [0, 0]], [[0, -1e-3], [0, 0], [0, 0]])
    states = record(replace(params, swelling=9.0), network, no_load(network), 2e-3, state, 500)
    overlap = np.asarray(states.displacement.x[:, 0] - states.displacement.x[:, 1]).max()
    assert overlap == pytest.approx(float(impact_maximum_overlap(1e-3, 0.5, 9.0)), rel=1e-4)


def test_a_test_goes_through_pickle_and_copy():
    """As executors of processes and of other machines send it."""
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), Sector(4), params=Params(rolling_friction=0.1))
    step = test.prepared.time_step
    for again in (pickle.loads(pickle.dumps(test)), copy.deepcopy(test)):
        assert again.params == test.params and again.prepared.time_step == step
        assert jax.tree.structure(again.params) == jax.tree.structure(test.params)
