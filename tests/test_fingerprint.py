"""One identity of a test for log, checkpoint and batch: what decides a number is in it, by name."""

import functools
import json
from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax.core.fingerprint import differences, fingerprint
from axijax.core.sector import Sector
from axijax.mechanics.damping import LocalDamping
from axijax.mechanics.dynamics import Scene
from axijax.mechanics.gravity import Gravity
from axijax.mechanics.hertz import Hertz
from axijax.mechanics.params import Params
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.test import TriaxialTest


@pytest.fixture(scope="module")
def test():
    return TriaxialTest(fcc_octagon(layers=5, half_width=3), params=Params(platen_speed=0.05), axial_strain=0.002)


# A change of every kind of thing that decides a number, and the part that must be named.
CHANGES = {
    "specimen.positions": lambda test: {"specimen": fcc_octagon(layers=3, half_width=3)},
    "specimen.membrane_zone": lambda test: {"specimen": replace(test.specimen, membrane_zone=thinned(test.specimen))},
    "sector.boundary ('rigid' here, 'periodic' there)": lambda test: {"sector": Sector(4, "rigid")},
    "sector.order (2.0 here, 4.0 there)": lambda test: {"sector": Sector(2)},
    "scene.rotation (False here, True there)": lambda test: {"scene": Scene(rotation=False)},
    "params.material.damping (LocalDamping here, Dashpot there)": lambda test: {
        "params": replace(test.params, damping=LocalDamping())
    },
    "params.material (Hertz here, Linear there)": lambda test: {"params": Params(Hertz()), "time_step": 1e-3},
    "params.material.friction (None here, 0.12278 there)": lambda test: {"params": replace(test.params, friction=None)},
    "params.material.rolling (Rolling here, None there)": lambda test: {
        "params": replace(test.params, rolling_friction=0.1)
    },
    "params.terms": lambda test: {"params": replace(test.params, terms=(Gravity(),))},
    "params.material.friction (0.2 here, 0.12278 there)": lambda test: {"params": replace(test.params, friction=0.2)},
    "params.material.damping.damping_ratio (0.1 here, 0.05 there)": lambda test: {
        "params": replace(test.params, damping_ratio=0.1)
    },
    "params.material.friction": lambda test: {"params": replace(test.params, friction=np.full(len(test.cut), 0.12278))},
    "ramp_time": lambda test: {"params": replace(test.params, density=test.params.density * 2)},
    "axial_strain (0.003 here, 0.002 there)": lambda test: {"axial_strain": 0.003},
    "time_step": lambda test: {"time_step": 0.9 * test.prepared.time_step},
    "tolerance (1e-06 here, 1e-07 there)": lambda test: {"tolerance": 1e-6},
    "confining_friction (0.1 here, 0.0 there)": lambda test: {"confining_friction": 0.1},
    "confine_steps": lambda test: {"confine_steps": 30_000},
    "record_every": lambda test: {"record_every": 25},
    "refresh (False here, True there)": lambda test: {"refresh": False},
    "rebuild_every (4.0 here, 0.0 there)": lambda test: {"rebuild_every": 4},
    "dtype (numpy.float32 here, numpy.float64 there)": lambda test: {"dtype": np.float32},
    "lateral_load": lambda test: {"lateral_load": load(test, 1.0)},
}


def thinned(specimen):
    zone = specimen.membrane_zone.copy()
    zone[np.flatnonzero(zone)[0]] = False
    return zone


def load(test, size):
    from axijax.mechanics.membrane import Load

    return Load(jnp.full((2, len(test.cut)), size), jnp.asarray(1.0))


@pytest.mark.parametrize("name", CHANGES)
def test_whatever_decides_a_number_is_named(name, test):
    other = replace(test, **CHANGES[name](test))
    assert name in differences(fingerprint(other), fingerprint(test))


def test_a_changed_load_differs_from_a_load(test):
    one, two = (fingerprint(replace(test, lateral_load=load(test, size))) for size in (1.0, 1.0 + 1e-15))
    assert differences(one, two) == "lateral_load.lateral"


def test_every_field_of_a_test_is_in_it(test):
    parts = {name.split(".")[0] for name in fingerprint(test)}
    assert {each.name for each in fields(test) if each.init} | {"ramp_time"} <= parts


def test_a_time_step_that_is_given_is_the_computed_one(test):
    """As when a result's case file, which holds the step, goes on with a run whose case left it out."""
    step = test.prepared.time_step
    assert test.time_step is None
    assert differences(fingerprint(replace(test, time_step=step)), fingerprint(test)) == ""
    other = differences(fingerprint(replace(test, time_step=0.9 * step)), fingerprint(test))
    assert other == f"time_step ({0.9 * step!r} here, {step!r} there)"


def test_equal_tests_are_one(test):
    again = replace(test, params=replace(test.params, friction=jnp.float64(0.12278), platen_speed=np.float64(0.05)))
    rebuilt = TriaxialTest(fcc_octagon(layers=5, half_width=3), params=again.params, axial_strain=0.002)
    assert differences(fingerprint(rebuilt), json.loads(json.dumps(fingerprint(test)))) == ""


def test_what_a_file_holds_instead_is_told():
    here = {"a": "1.0", "b": "2.0"}
    for there in (None, 3, "text", [1], {}):
        assert differences(here, there) == "a, b"
    assert differences(here, {"a": 1, "b": "2.0"}) == "a"
    assert differences(here, {**here, "line\nbreak": "1"}) == "a name that makes no sense"
    assert differences({}, {str(k): "1" for k in range(9)}) == "0, 1, 2 and 6 more"


def mean(curve, power):
    return (curve**power).mean()


def made_by(power):
    return lambda curve: (curve**power).mean()


class Plain:
    def __init__(self, **values):
        vars(self).update(values)


@pytest.mark.parametrize(
    ("one", "same", "other"),
    [
        (made_by(2), made_by(2), made_by(3)),  # what a function carries along
        (lambda x: x + 1, lambda x: x + 1, lambda x: x + 2),
        (functools.partial(mean, power=2), functools.partial(mean, power=2), functools.partial(mean, power=3)),
        (jax.jit(made_by(2)), jax.jit(made_by(2)), jax.jit(made_by(3))),
        (Plain(noise=0.0), Plain(noise=0), Plain(noise=0.1)),
        ({"a": [1, 2]}, {"a": [1, 2.0]}, {"a": (1, 2)}),
        (np.arange(3), np.arange(3), np.arange(3.0)),
        (True, np.True_, 1),
    ],
)
def test_functions_and_objects(one, same, other):
    assert fingerprint(one, "it") == fingerprint(same, "it") != fingerprint(other, "it")


@dataclass
class Holder:
    it: object


def test_what_cannot_be_recognised_again_is_refused():
    holder = Holder(None)
    holder.it = holder
    for odd in (holder, Holder(np.array([object()])), Holder(iter([1])), Holder(b"text")):
        with pytest.raises(ValueError, match=r"cannot be recognised again.*leave out the file or folder"):
            fingerprint(odd)
