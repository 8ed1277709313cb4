"""Stages: commands for platens and membrane, one after the other, on a small lattice."""

from dataclasses import replace
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import axijax
from axijax import Params, Sector, TriaxialTest, fcc_octagon, raise_for_status, stage
from axijax.triaxial import stages as functions
from axijax.triaxial.commands import Moving, towards
from axijax.triaxial.stage import Stage, Until

# Small programs that run briefly: not worth optimising.
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
simulate = jit(functions.simulate.__wrapped__)

# Friction that lets nothing slip on the way, so that the lattice is elastic.
STICKY = Params(friction=0.9, platen_speed=0.01)
SPECIMEN = fcc_octagon(layers=5, half_width=5)


def test(*stages, params=STICKY, order=4):
    return TriaxialTest(SPECIMEN, Sector(order), params=params, stages=stages, tolerance=1e-6, record_every=25)


test.__test__ = False


# ---- What leads a quantity to a value ----


@pytest.mark.parametrize("way", [3.0, -3.0, 0.02])
def test_what_is_led_arrives_without_overshoot(way):
    """At rest, in the time that top speed and gain of speed allow, never beyond; speed 1, gained within 2/3 ramp."""
    dt, ramp = 0.01, 1.0

    def step(carry, _):
        place, rate = carry
        rate, there = towards(way - place, rate, 1.0, ramp, dt)
        after = place + rate * dt
        return (after, jnp.where(there, 0.0, rate)), (after, rate)

    _, (place, rate) = jax.lax.scan(step, (0.0, 0.0), None, length=800)
    place, rate = np.asarray(place), np.asarray(rate)
    assert place[-1] == pytest.approx(way, abs=1e-15)
    assert (np.sign(way) * place <= abs(way) + 1e-15).all() and np.abs(rate).max() <= 1 + 1e-12
    assert np.abs(np.diff(rate)).max() <= 3 * 1.5 / ramp * dt  # the last step takes what is left
    arrival = np.argmax(np.abs(place - way) < 1e-12) * dt
    least = abs(way) + 2 / 3 * ramp if abs(way) > 2 / 3 else 2 * (abs(way) / 1.5) ** 0.5
    assert least - 2 * dt <= arrival < 1.2 * least + 4 * dt


# ---- One stage after another ----

PROGRAMME = (
    stage("isotropic", lateral_stress=7e4),
    stage("compression", lateral="constant_p", axial_strain=8e-4),
    stage("extension", deviator_stress=0.0, axial_strain=-1e-3),
    stage("compression", lateral="constant_volume", axial_strain=1.1e-3),
)


@lru_cache
def programme():
    """The run of all of these, and what `simulate` makes of them; by stage."""
    here = test(*PROGRAMME)
    return here, here.run(), simulate(here.prepared, here.params)


def split(curve):
    """Strain, volumetric strain, s1, s3 and the rest of each stage."""
    s3 = np.asarray(curve.lateral_stress)
    columns = np.stack([curve.axial_strain, curve.volumetric_strain, s3 * np.asarray(curve.stress_ratio), s3])
    return [columns[:, np.asarray(curve.stage) == number] for number in range(1, int(curve.stage[-1]) + 1)]


def test_each_stage_goes_where_it_leads():
    _, run, _ = programme()
    assert run.ended == ""
    isotropic, constant_p, extension, undrained = split(run.curve)
    np.testing.assert_allclose(isotropic[2:, -1], 7e4, rtol=2e-3)
    p = (constant_p[2] + 2 * constant_p[3]) / 3
    np.testing.assert_allclose(p, 7e4, rtol=0.02)
    assert constant_p[0, -1] >= 8e-4 > constant_p[0, -2] and constant_p[2, -1] > 1.4 * constant_p[3, -1]
    assert extension[2, -1] <= extension[3, -1] and extension[2, -2] > extension[3, -2]
    np.testing.assert_array_equal(extension[3], extension[3, 0])
    assert np.ptp(undrained[1]) < 0.05 * np.ptp(undrained[0])
    assert float(np.max(run.curve.servo_error)) < 0.03
    assert run.curve.path_length[-1] > run.curve.axial_strain[-1]


def test_run_and_simulate_are_one():
    """What `simulate` records more often, since it knows no end, repeats the last record of its stage."""
    _, run, curve = programme()
    raise_for_status(curve.status)
    for mine, theirs in zip(split(run.curve), split(curve), strict=True):
        size = mine.shape[1]
        np.testing.assert_allclose(theirs[:, :size], mine, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(theirs[:, size:], np.repeat(mine[:, -1:], theirs.shape[1] - size, 1), rtol=1e-9)


def test_a_stage_ends_where_the_strength_does():
    """An axial stress far beyond strength: what was recorded stays, with a sentence; nothing further begins."""
    weak = test(
        stage("axial_stress", axial_stress=5e5, time=400.0), stage("hold", time=1.0),
        params=Params(friction=0.05, platen_speed=0.02),
    )  # fmt: skip
    run = weak.run()
    assert "stage 1 of 2" in run.ended and "outside its strength" in run.ended
    assert set(np.asarray(run.curve.stage)) == {1.0} and run.curve.stress_ratio.max() > 1.8


# ---- What makes no sense ----


@pytest.mark.parametrize(
    "made, told",
    [
        (lambda: stage("compresion"), "type = 'compresion': must be one of compression"),
        (lambda: stage("compression", lateral="k1"), "lateral = 'k1': must be one of constant"),
        (lambda: stage("isotropic"), "type = 'isotropic' needs its lateral_stress"),
        (lambda: stage("isotropic", lateral="k0", lateral_stress=1.0), "leads the lateral stress itself"),
        (lambda: stage("compression", speed=-1.0), "speed = -1: must be positive"),
        (lambda: stage("compression", lateral="line", dq_dp=-2.0), "dq_dp = -2: must be zero or more"),
        (lambda: stage("cycles", first=0.1, second=0.1), "two limits that differ"),
        (lambda: stage("compression", cycles=3), "cycles = 3: a stage of type 'compression' takes speed"),
        (lambda: test(3), r"stages = \(3,\): must be a tuple"),
        (lambda: test(stage("compression", stress_ratio=2.0)).prepared, "stage 1: .* needs a bound as well"),
        (lambda: test(Stage(Moving(), until=Until(time=-1.0))).prepared, "stage 1: time = -1: must be positive"),
    ],
)
def test_senseless_stages_are_refused_in_one_sentence(made, told):
    with pytest.raises(ValueError, match=told):
        made()


def test_the_public_names():
    assert {"stage", "Stage"} <= set(dir(axijax))


# ---- Derivatives ----

# A criterion in strain, so that a number changes what is recorded, and not how often.
DRIVEN = {
    "drained": (stage("compression", axial_strain=3e-4), stage("extension", axial_strain=1e-4)),
    "constant_p": (stage("compression", lateral="constant_p", axial_strain=3e-4),),
    "constant_volume": (stage("compression", lateral="constant_volume", axial_strain=3e-4),),
}


def check_derivatives(stages, params, names, h=1e-4, accuracy=5e-3):
    """Of axial and lateral stress over the last third of a test, by each number's logarithm, against differences."""
    here = test(*stages, params=params)

    def seen(logs):
        changed = {name: getattr(params, name) * jnp.exp(log) for name, log in zip(names, logs, strict=True)}
        at = replace(params, **changed)
        curve = functions.simulate.__wrapped__(here.prepared, at)
        last = curve.lateral_stress[-curve.lateral_stress.size // 3 :]
        return jnp.stack([(last * curve.stress_ratio[-last.size :]).mean(), last.mean()])

    program = jit(lambda at, along: jax.jvp(seen, (at,), (along,)))
    for number in range(len(names)):
        along = jnp.eye(len(names))[number]
        _, slope = program(jnp.zeros(len(names)), along)
        up, down = (program(sign * h * along, along)[0] for sign in (1, -1))
        difference = np.asarray(up - down) / (2 * h)
        np.testing.assert_allclose(slope, difference, rtol=0, atol=accuracy * np.abs(difference).max())
        assert np.abs(difference).max() > 0


@pytest.mark.parametrize("path", ["constant_volume"])
def test_derivatives_along_a_path(path):
    names = ("friction", "normal_stiffness", "confining_stress")
    check_derivatives(DRIVEN[path], Params(friction=0.2, platen_speed=0.01), names)
