"""The hand-written operators of the critical time step against JAX's linearisation of the forces, and scenes that only
the latter knows."""

from dataclasses import dataclass, replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Hertz, Params, Rolling, Scene, Sector, Specimen, Torsion, TriaxialTest, fcc_octagon
from axijax.core.quantity import quantity
from axijax.core.tree import pytree
from axijax.core.vector import Vector
from axijax.mechanics.capped_spring import capped
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.linear import Linear
from axijax.mechanics.linearised import linearised
from axijax.mechanics.term import Push, Term
from axijax.mechanics.time_step import critical_time_step, springs_and_dashpots
from axijax.specimen.specimen import cut_to_sector

RADIUS, STIFFNESS = 20.0, 1.5e9
QUARTER, HALF, FULL, RIGID = Sector(4), Sector(2), Sector(1), Sector(4, "rigid")
PLAIN = Scene()
# So little load that a contact's own force, which turns with it, counts for nothing beside its stiffness.
SLIGHT = {"confining_stress": 1e-3}


@lru_cache
def lattice(sector):
    return build_contact_list(cut_to_sector(fcc_octagon(RADIUS, 3, 3), sector), sector)


@lru_cache
def heap():
    """Balls of all sizes at random places, each grown until it touches the nearest."""
    random = np.random.default_rng(3)
    place = random.uniform(-60, 60, (3, 60))
    apart = np.linalg.norm(place[:, :, None] - place[:, None], axis=0) + np.diag(np.full(60, np.inf))
    radius = 0.4 * apart.min(1)  # no two overlap
    for ball in range(60):
        radius[ball] = (apart[ball] - radius).min()
    return build_contact_list(Specimen(place, radius, -100.0, 100.0, np.ones(60, bool)), FULL)


SCENES = {
    "quarter": (lattice(QUARTER), PLAIN, Params()),
    "strong dashpots, soft shear": (lattice(QUARTER), PLAIN, Params(damping_ratio=0.3, shear_stiffness=0.3e9)),
    "stiff shear": (lattice(QUARTER), PLAIN, Params(damping_ratio=0.0, shear_stiffness=3 * STIFFNESS)),
    "full": (lattice(FULL), PLAIN, Params(shear_stiffness=0.5 * STIFFNESS)),
    "rigid planes": (lattice(RIGID), PLAIN, Params(shear_stiffness=0.5 * STIFFNESS)),
    "random": (heap(), PLAIN, Params(shear_stiffness=0.5 * STIFFNESS)),
    "no spins": (lattice(QUARTER), Scene(rotation=False), Params()),
    "no friction": (lattice(QUARTER), PLAIN, Params(friction=None)),
    "no friction, no dashpots": (lattice(QUARTER), PLAIN, Params(friction=None, damping=None)),
    "rough platens": (lattice(QUARTER), PLAIN, Params(platen_friction=0.3, shear_stiffness=2 * STIFFNESS)),
    "rough platens, no friction between balls": (lattice(HALF), PLAIN, Params(platen_friction=0.3, friction=None)),
    "rolling": (lattice(QUARTER), PLAIN, Params(rolling=Rolling(0.7, 0.1), shear_stiffness=0.5 * STIFFNESS)),
    "rolling and torsion, random": (heap(), PLAIN, Params(rolling=Rolling(0.7, 0.1), torsion=Torsion(2.0, 0.0))),
    "Hertz, torsion": (lattice(HALF), PLAIN, Params(Hertz(torsion=Torsion(2.0, 0.1)), **SLIGHT)),
    "Hertz, random, rough platens": (heap(), PLAIN, Params(Hertz(platen_friction=np.inf), **SLIGHT)),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_operators_written_by_hand_are_the_derivative_of_the_forces(name):
    network, scene, params = SCENES[name]
    hertz = isinstance(params.material, Hertz)
    squeeze, accuracy = (None, 1e-6) if hertz else (1e-11, 1e-9)
    found = linearised(scene, params, network, squeeze=squeeze)
    expected = springs_and_dashpots(scene, params, network, 1e-3)
    assert found.size == expected.size
    first, second = np.random.default_rng(0).standard_normal((2, found.size))
    for ours, hands in ((found.stiff, expected.stiff), (found.viscous, expected.viscous)):
        of_first, of_second = ours(first), ours(second)
        scale = np.abs(hands(first)).max()
        np.testing.assert_allclose(of_first, hands(first), atol=accuracy * scale, rtol=0)
        assert first @ of_second == pytest.approx(second @ of_first, abs=10 * accuracy * abs(first @ of_first))
    damped = params.material.damping is not None and params.damping_ratio > 0
    assert (np.abs(expected.viscous(first)).max() > 0) == damped


def by_forces(scene, params, network):
    """The step where no operator is written by hand: that of a subclass which says so."""
    return critical_time_step(scene, replace(params, material=Untold(**vars(params.material))), network)


@pytree
@dataclass(frozen=True)
class Untold(Linear):
    def stiffest(self, network, stress, touching_within):
        return None


@pytest.mark.parametrize("name", ["strong dashpots, soft shear", "rough platens"])
def test_the_step_of_a_material_that_does_not_say_how_stiff_it_is(name):
    """Under the load to come, whose share in the stiffness is that of the overlap in the radius."""
    network, scene, params = SCENES[name]
    params = replace(params, confining_stress=5e2)
    assert by_forces(scene, params, network) == pytest.approx(critical_time_step(scene, params, network), rel=1e-3)


@pytree
@dataclass(frozen=True)
class Tethers(Term):
    """A spring from every ball to its place at the start, and a dashpot beside it."""

    tether: jax.Array | float = quantity(1.0, "stiffness", "F/L")
    drag: jax.Array | float = quantity(0.0, "viscosity", "F T/L")

    def forces(self, params, network, dt, state, memory):
        return Push((state.displacement * self.tether + state.velocity * self.drag) * -1.0)


def lone_ball():
    """A ball far from everything, on which only terms act, and one near each platen."""
    place = np.array([[0.0, 0, 0], [0, 0, 0], [-100, 0, 100.0]])
    return build_contact_list(Specimen(place, 1.0, -101.0, 101.0, np.ones(3, bool)), FULL, skin=0.5)


@pytest.mark.parametrize("viscosity", [0.0, 0.6])
def test_a_term_that_stiffens_sets_the_step(viscosity):
    """omega^2 = (k + tether)/m of a ball at a platen, damping ratio xi = drag/(2 m omega)."""
    plain = {"density": 3 / (4 * np.pi), "normal_stiffness": 1.0, "shear_stiffness": 1.0, "damping_ratio": 0.0}
    params = Params(terms=(Tethers(8.0, viscosity),), confining_stress=1e-9, **plain)
    omega, xi = 3.0, viscosity / 6.0
    expected = 2 / omega * ((1 + xi**2) ** 0.5 - xi)
    assert critical_time_step(Scene(), params, lone_ball()) == pytest.approx(expected, rel=1e-9)
    without = critical_time_step(Scene(), replace(params, terms=()), lone_ball())
    assert without == pytest.approx(2.0, rel=1e-9)


def test_a_test_with_a_stiffening_term_is_refused_a_step_that_its_contacts_alone_would_allow():
    test = TriaxialTest(fcc_octagon(RADIUS, 3, 3))
    step = test.prepared.time_step
    stiff = replace(test, params=Params(terms=(Tethers(200 * STIFFNESS),)), time_step=step)
    with pytest.raises(ValueError, match="of the critical time step"):
        _ = stiff.prepared
    assert replace(stiff, time_step=None).prepared.time_step < 0.5 * step


def test_rough_platens_shorten_the_step_of_a_ball_between_them():
    """A ball that rolls on one platen: omega^2 = 3.5 ks/m, by both ways; a smooth one leaves kn/m."""
    params = Params(
        density=3 / (4 * np.pi), normal_stiffness=1.0, shear_stiffness=1.0, damping=None, platen_friction=0.1,
        confining_stress=1e-9,
    )  # fmt: skip
    for step in (critical_time_step, by_forces):
        assert step(Scene(), params, lone_ball()) == pytest.approx(2 / 3.5**0.5, rel=1e-9)
    assert critical_time_step(Scene(), replace(params, platen_friction=None), lone_ball()) == pytest.approx(2, rel=1e-9)


def test_a_spring_that_rests_has_its_whole_stiffness_whatever_its_limit():
    """Also where the limit is a small number in the units at hand, and at none at all."""
    rest = Vector(*[jnp.zeros(1)] * 3)
    along = Vector(jnp.ones(1), *[jnp.zeros(1)] * 2)

    def force(limit):
        return jax.jvp(lambda rate: capped(rest, rate, 5.0, 2.0, limit, 0.1)[0].x, (rest,), (along,))[1]

    assert float(force(1e-6)[0]) == pytest.approx(2.5)
    assert float(force(np.inf)[0]) == pytest.approx(2.5)
    assert float(force(0.0)[0]) == 0.0
