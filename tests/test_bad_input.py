"""Input that makes no sense is refused at once, in one sentence that names the field and its value."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from axijax import Dashpot, Hertz, LocalDamping, Params
from axijax.core.sector import Sector
from axijax.core.status import SENSELESS
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.membrane import Load, build_membrane
from axijax.mechanics.time_step import critical_time_step
from axijax.specimen.specimen import Specimen, cut_to_sector, fcc_cylinder, fcc_octagon
from axijax.triaxial.records import SimulationError, raise_for_status
from axijax.triaxial.test import TriaxialTest

NAN = float("nan")
OCTAGON = fcc_octagon(layers=3, half_width=3)
CUT = cut_to_sector(OCTAGON, Sector(4))


def octagon_with(**changes):
    return replace(OCTAGON, **changes)


def balls(*places, **options):
    """Specimen of balls of radius 1 at places (x, y, z)."""
    positions = np.array(places, float).reshape(-1, 3).T
    zone = np.ones(positions.shape[1], bool)
    return Specimen(
        **{"positions": positions, "radius": 1.0, "bottom": -5.0, "top": 5.0, "membrane_zone": zone, **options}
    )


def moved_to(ball, place):
    positions = np.array(OCTAGON.positions)
    positions[:, ball] = place
    return positions


def triaxial(**options):
    return TriaxialTest(OCTAGON, **options)


def prepared(**options):
    """What needs the specimen is looked at before the test runs."""
    return triaxial(**options).prepared


def loaded(lateral, section=2000.0):
    return prepared(lateral_load=Load(lateral, section))


def at_angle(degrees, rho):
    return rho * np.cos(np.deg2rad(degrees)), rho * np.sin(np.deg2rad(degrees)), 0.0


def too_long_a_step():
    test = triaxial()
    limit = critical_time_step(test.scene, test.params, test.network)
    return prepared(time_step=0.85 * limit)


# What is done, and the words that the sentence must hold.
CASES = {
    "no sector": (lambda: Sector(0), ["order = 0", "whole number"]),
    "negative sector": (lambda: Sector(-4), ["order = -4"]),
    "part of a sector": (lambda: Sector(2.5), ["order = 2.5"]),
    "a float": (lambda: Sector(4.0), ["order = 4.0"]),
    "not a number": (lambda: Sector(True), ["order = True"]),
    "unknown boundary": (lambda: Sector(4, "mirror"), ["boundary = 'mirror'", "'periodic'", "'rigid'"]),
    "rigid half": (lambda: Sector(2, "rigid"), ["order = 2", "rigid"]),
    "unknown damping": (lambda: prepared(params=Params(damping="viscous")), ["damping = 'viscous'", "Dashpot"]),
    "unknown material": (lambda: prepared(params=Params("soft")), ["material = 'soft'", "axijax.Linear()"]),
    "negative stiffness": (
        lambda: prepared(params=Params(normal_stiffness=-1.5)),
        ["normal_stiffness = -1.5", "positive"],
    ),
    "no shear stiffness": (lambda: prepared(params=Params(shear_stiffness=0.0)), ["shear_stiffness = 0", "positive"]),
    "negative friction": (lambda: prepared(params=Params(friction=-0.1)), ["friction = -0.1", "zero or positive"]),
    "one negative friction": (
        lambda: prepared(params=Params(friction=np.array([0.1, -0.2, 0.3]))),
        ["friction = -0.2", "zero or positive"],
    ),
    "negative stress": (lambda: prepared(params=Params(confining_stress=-5.0)), ["confining_stress = -5", "positive"]),
    "weightless": (lambda: prepared(params=Params(density=0.0)), ["density = 0", "positive"]),
    "negative damping": (lambda: prepared(params=Params(damping_ratio=-0.05)), ["damping_ratio = -0.05"]),
    "local damping of 1": (
        lambda: prepared(params=Params(damping=LocalDamping(1.0))),
        ["local_damping = 1", "below 1"],
    ),
    "local damping of nothing": (lambda: Params(local_damping=0.5), ["local_damping = 0.5", "would do nothing"]),
    "dashpots of nothing": (
        lambda: replace(Params(damping=None), damping_ratio=0.1),
        ["damping_ratio = 0.1", "would do nothing"],
    ),
    "stiffness of Hertzian balls": (lambda: Params(Hertz(), normal_stiffness=1.0), ["normal_stiffness = 1.0", "Hertz"]),
    "negative platen friction": (
        lambda: prepared(params=Params(platen_friction=-0.3)),
        ["platen_friction = -0.3", "zero or positive"],
    ),
    "no speed": (lambda: prepared(params=Params(platen_speed=0.0)), ["platen_speed = 0", "positive"]),
    "NaN friction": (lambda: prepared(params=Params(friction=NAN)), ["friction = nan", "finite"]),
    "NaN stiffness": (lambda: prepared(params=Params(normal_stiffness=NAN)), ["normal_stiffness = nan", "finite"]),
    "NaN stress": (lambda: prepared(params=Params(confining_stress=NAN)), ["confining_stress = nan", "finite"]),
    "infinite density": (lambda: prepared(params=Params(density=np.inf)), ["density = inf", "finite"]),
    "words": (lambda: prepared(params=Params(friction="rough")), ["friction = 'rough'", "number"]),
    "None": (lambda: prepared(params=Params(density=None)), ["density = None", "number"]),
    "no damping ratio": (lambda: prepared(params=Params(damping=Dashpot(None))), ["damping_ratio = None", "number"]),
    "friction of two balls only": (
        lambda: prepared(params=Params(friction=np.array([0.1, 0.2]))),
        ["friction", "2", "ball"],
    ),
    "stiffness of each ball": (
        lambda: prepared(params=Params(normal_stiffness=np.full(9, 1e9))),
        ["normal_stiffness", "number"],
    ),
    "bad parameters of a run": (lambda: triaxial().run(Params(friction=-0.1)), ["friction = -0.1", "zero or positive"]),
    "run with platens that go outward": (
        lambda: triaxial().run(Params(platen_speed=-0.01)),
        ["platen_speed = -0.01", "positive, inward"],
    ),
    "run with platens that stand still": (
        lambda: triaxial().run(Params(platen_speed=0.0)),
        ["platen_speed = 0", "positive, inward"],
    ),
    "simulate with platens that go outward": (
        lambda: triaxial().simulate(Params(platen_speed=-0.01)),
        ["platen_speed = -0.01", "positive, inward"],
    ),
    "simulate with NaN friction": (lambda: triaxial().simulate(Params(friction=NAN)), ["friction = nan", "finite"]),
    "confine without density": (lambda: triaxial().confine(Params(density=0.0)), ["density = 0", "positive"]),
    "load of one ball": (lambda: loaded(np.ones(1)), ["lateral", "shape (1,)", f"(2, {len(CUT)})", f"({len(CUT)},)"]),
    "load in three directions": (lambda: loaded(np.ones((3, len(CUT)))), [f"shape (3, {len(CUT)})"]),
    "NaN load": (lambda: loaded(CUT.positions[:2] * NAN), ["lateral", "finite"]),
    "load that pulls": (lambda: loaded(-CUT.positions[:2]), ["lateral", "does not confine", "sign"]),
    "load of nothing": (lambda: loaded(np.zeros(len(CUT))), ["lateral", "does not confine"]),
    "negative areas": (lambda: loaded(-np.ones(len(CUT))), ["area of -1", "zero or positive"]),
    "load on no section": (lambda: loaded(CUT.positions[:2], 0.0), ["section = 0", "positive"]),
    "load on two sections": (lambda: loaded(CUT.positions[:2], np.ones(2)), ["section = [1. 1.]", "one number"]),
    "NaN section": (lambda: loaded(CUT.positions[:2], NAN), ["section = nan", "finite"]),
    "load that is an array": (
        lambda: prepared(lateral_load=CUT.positions[:2]),
        ["lateral_load is a ndarray", "membrane.Load"],
    ),
    "step too long": (too_long_a_step, ["time_step = ", "critical time step"]),
    "negative step": (lambda: triaxial(time_step=-0.01), ["time_step = -0.01", "positive"]),
    "no step": (lambda: triaxial(time_step=0.0), ["time_step = 0", "positive"]),
    "NaN step": (lambda: triaxial(time_step=NAN), ["time_step = nan", "finite"]),
    "no strain": (lambda: triaxial(axial_strain=0.0), ["axial_strain = 0", "positive and below 0.5"]),
    "too much strain": (lambda: triaxial(axial_strain=1.0), ["axial_strain = 1", "below 0.5"]),
    "NaN strain": (lambda: triaxial(axial_strain=NAN), ["axial_strain = nan"]),
    "no records": (lambda: triaxial(record_every=0), ["record_every = 0", "whole number"]),
    "half a record": (lambda: triaxial(record_every=2.5), ["record_every = 2.5", "whole number"]),
    "no confinement": (lambda: triaxial(confine_steps=0), ["confine_steps = 0"]),
    "no tolerance": (lambda: triaxial(tolerance=0.0), ["tolerance = 0"]),
    "NaN tolerance": (lambda: triaxial(tolerance=NAN), ["tolerance = nan"]),
    "empty specimen": (lambda: balls(), ["positions", "at least one ball", "empty"]),
    "flat specimen": (lambda: octagon_with(positions=OCTAGON.positions[:2]), ["positions", "(3, N)"]),
    "NaN position": (lambda: octagon_with(positions=moved_to(0, NAN)), ["positions", "not finite"]),
    "negative radius": (lambda: octagon_with(radius=-20.0), ["radius", "-20", "positive"]),
    "NaN radius": (lambda: octagon_with(radius=NAN), ["radius", "nan", "positive"]),
    "radii of other balls": (lambda: octagon_with(radius=np.array([20.0, 20.0])), ["radius", "(2,)"]),
    "platens swapped": (lambda: octagon_with(bottom=100.0, top=0.0), ["bottom = 100", "top = 0"]),
    "ball outside": (lambda: octagon_with(positions=moved_to(0, [0, 0, 500.0])), ["outside the platens", "500"]),
    "no membrane": (lambda: octagon_with(membrane_zone=np.zeros(len(OCTAGON), bool)), ["membrane_zone", "0 balls"]),
    "membrane of others": (lambda: octagon_with(membrane_zone=np.ones(3, bool)), ["membrane_zone", "(3,)"]),
    "membrane on the axis": (
        lambda: build_membrane(balls((0, 0, 0), (3, 0, 0)), Sector(1)),
        ["membrane_zone", "ball 0", "axis"],
    ),
    "no membrane in the sector": (
        lambda: (
            TriaxialTest(
                balls((3, 3, 0), (-3, 3, 0), (-3, -3, 0), (3, -3, 0), (0, 0, 0), membrane_zone=np.arange(5) == 4)
            ).prepared
        ),
        ["membrane_zone", "axis"],
    ),
    "overlap": (
        lambda: build_contact_list(balls((3, 3, 0), (3, 3, 1)), Sector(4)),
        ["ball 0", "ball 1", "overlap by 1"],
    ),
    "overlap across a sector plane": (
        lambda: build_contact_list(balls(at_angle(5, 5), at_angle(85, 5)), Sector(4)),
        ["overlap by 1.13", "image 3"],
    ),
    "overlap with its own image": (
        lambda: build_contact_list(balls((0.5, 0.5, 0)), Sector(2)),
        ["overlap", "image 1 of ball 0"],
    ),
    "overlap in a test": (
        lambda: TriaxialTest(octagon_with(radius=21.5)).prepared,
        ["overlap by 0.14"],
    ),
    "negative skin": (lambda: build_contact_list(balls((3, 3, 0)), Sector(4), skin=-1.0), ["skin = -1.0"]),
    "NaN skin": (lambda: build_contact_list(balls((3, 3, 0)), Sector(4), skin=NAN), ["skin = nan"]),
    "list too narrow": (
        lambda: build_contact_list(OCTAGON, Sector(1), max_contacts_per_ball=2),
        ["max_contacts_per_ball = 2", "neighbours"],
    ),
    "list too short": (lambda: build_contact_list(OCTAGON, Sector(1), contacts=5), ["length = 5", "needed"]),
    "too few triangles": (lambda: build_membrane(OCTAGON, Sector(1), triangles=5), ["triangles = 5"]),
    "not that symmetric": (lambda: cut_to_sector(OCTAGON, Sector(3)), ["order = 3", "not the same after a turn"]),
    "nothing between the planes": (lambda: cut_to_sector(OCTAGON, Sector(40, "rigid")), ["order = 40", "no ball"]),
    "octagon of negative balls": (lambda: fcc_octagon(radius=-1.0), ["radius = -1.0", "positive"]),
    "octagon of no layers": (lambda: fcc_octagon(layers=0), ["layers = 0", "whole number"]),
    "octagon of even width": (lambda: fcc_octagon(half_width=4), ["half_width = 4", "odd"]),
    "cylinder too thin": (lambda: fcc_cylinder(radius=20.0, specimen_radius=30.0), ["specimen_radius = 30.0", "60"]),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused_in_one_clear_sentence(case):
    act, words = CASES[case]
    with pytest.raises(ValueError) as caught:
        act()
    message = str(caught.value)
    for word in words:
        assert word in message
    assert message.endswith(".") and "\n" not in message and len(message) < 300, "one sentence"


def test_the_longest_step_allowed_is_accepted():
    """The limit in the sentence is the one that is applied."""
    test = triaxial()
    limit = critical_time_step(test.scene, test.params, test.network)
    assert triaxial(time_step=0.8 * limit).prepared.time_step == pytest.approx(0.8 * limit)


@pytest.mark.parametrize("field, value", [("platen_speed", -0.01), ("platen_speed", 0.0), ("friction", -0.1)])
def test_traced_parameters_that_make_no_sense_set_a_status_bit(field, value):
    """Inside jit a number is not known before the run; `run`, which knows it, refuses it."""
    test = replace(triaxial(record_every=10), axial_strain=1e-5)
    simulate = jax.jit(lambda value: test.simulate(replace(test.params, **{field: value})))
    assert int(simulate(value).status) & SENSELESS
    assert not int(simulate(getattr(test.params, field)).status) & SENSELESS
    with pytest.raises(SimulationError, match="a parameter is negative, or zero"):
        raise_for_status(SENSELESS)
