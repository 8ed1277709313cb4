"""Stages: commands for platens and membrane, one after the other, on a small lattice."""

import re
import tomllib
from dataclasses import replace
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from finite_lattice import elastic, whole

import axijax
from axijax import Params, Sector, TriaxialTest, fcc_octagon, raise_for_status, stage
from axijax.app.case import Case, default_case, make_case
from axijax.app.case_writing import to_toml
from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
from axijax.mechanics.observe import observe
from axijax.triaxial import progress
from axijax.triaxial import stages as functions
from axijax.triaxial.checkpoint import load_progress, save_progress
from axijax.triaxial.commands import Fluid, Moving, towards
from axijax.triaxial.engine import current_load
from axijax.triaxial.progress import fit_for_stages
from axijax.triaxial.stage import Stage, Until

simulate = jax.jit(functions.simulate.__wrapped__)

# Friction that lets nothing slip on the way, so that the lattice is elastic.
STICKY = Params(friction=0.9, platen_speed=0.004)
SPECIMEN = fcc_octagon(layers=5, half_width=5)
SEGMENT = 110  # steps between looks from outside: stops in the middle of records


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
    """The test in all of these stages, its run, and where it stood after every hundred steps."""
    here, passed = test(*PROGRAMME), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "SEGMENT", SEGMENT)
        return here, here.run(progress=passed.append), passed


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


@pytest.mark.parametrize("ratio", [0.25, 0.1])
def test_a_lateral_strain_is_held_whatever_the_step(ratio):
    """K0 of few and light balls whose stable step is long beside a wave's: the damping of the servo, which lets a wave
    pass, was then more than a step can bear, and the specimen called liquefied. Held against steps a third as long."""
    params = replace(STICKY, shear_stiffness=ratio * float(STICKY.material.normal_stiffness))
    held = stage("compression", lateral="k0", axial_strain=2e-3)
    made = replace(test(held, params=params), tolerance=1e-5)
    runs = [replace(made, time_step=step).run() for step in (None, 0.025)]
    at = np.array([1e-3, 1.5e-3, 1.9e-3])
    ratios = []
    for run in runs:
        curve = run.curve
        assert not run.ended and float(np.max(curve.servo_error)) < 0.03
        radius = np.asarray(curve.membrane_radius)
        assert abs(np.log(radius[-1] / radius[0])) < 0.03 * curve.axial_strain[-1]
        ratios.append(np.interp(at, curve.axial_strain, curve.stress_ratio))
    np.testing.assert_allclose(ratios[0], ratios[1], rtol=0.01)
    assert ratios[1][0] > 1.3, "the specimen was sheared"


def test_run_and_simulate_are_one():
    """What `simulate` records more often, since it knows no end, repeats the last record of its stage."""
    here, run, _ = programme()
    curve = simulate(here.prepared, here.params)
    raise_for_status(curve.status)
    for mine, theirs in zip(split(run.curve), split(curve), strict=True):
        size = mine.shape[1]
        np.testing.assert_allclose(theirs[:, :size], mine, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(theirs[:, size:], np.repeat(mine[:, -1:], theirs.shape[1] - size, 1), rtol=1e-9)


def test_a_stage_ends_where_the_strength_does(monkeypatch):
    """A stress ratio far beyond strength: what was recorded stays, with a sentence; nothing further begins."""
    monkeypatch.setattr(progress, "SEGMENT", SEGMENT)
    weak = test(stage("anisotropic", lateral_stress=6e4, k=0.02), PROGRAMME[1], params=replace(STICKY, friction=0.05))
    run = weak.run()
    assert "stage 1 of 2" in run.ended and "outside its strength" in run.ended
    assert set(np.asarray(run.curve.stage)) == {1.0} and run.curve.stress_ratio.max() > 1.8


def test_a_stage_that_never_comes_to_its_end_is_given_up(monkeypatch):
    """A servo that does not settle: here none is ever near enough."""
    monkeypatch.setattr(progress, "SEGMENT", SEGMENT)
    monkeypatch.setattr(progress, "LONGEST", 0.05)
    run = test(PROGRAMME[0]).run()
    assert "stage 1 of 1" in run.ended and "does not settle; lower time_step" in run.ended
    assert run.curve.axial_strain.size > 3


@pytest.mark.parametrize("number", range(len(PROGRAMME)))
def test_a_restart_in_the_middle_of_a_stage_changes_no_bit(number, tmp_path, monkeypatch):
    """Written, read, and gone on with; whatever kind of stage it is."""
    monkeypatch.setattr(progress, "SEGMENT", SEGMENT)
    here, run, passed = programme()
    middle = next(now for now in passed if now.stage == number and now.begun and now.due)
    save_progress(tmp_path / "middle.npz", here, middle)
    start = load_progress(tmp_path / "middle.npz", here)
    for part, other in zip(jax.tree.leaves(start), jax.tree.leaves(middle), strict=True):
        np.testing.assert_array_equal(part, other)
    again = here.run(start=start)
    for (name, part), other in zip(jax.tree.leaves_with_path(again), jax.tree.leaves(run), strict=True):
        np.testing.assert_array_equal(part, other, err_msg=str(name))


def test_a_confined_specimen_is_sheared_in_many_ways(tmp_path, monkeypatch):
    """What was kept by a test in other stages, or in none; but not what has been sheared, nor another specimen's."""
    monkeypatch.setattr(progress, "SEGMENT", SEGMENT)
    here, run, passed = programme()
    path = tmp_path / "confined.npz"
    plain = test()
    save_progress(path, plain, fit_for_stages(plain, passed[0]))
    start = load_progress(path, here)
    assert start.records.stage.size == 0 and float(start.state.loading.lateral_stress) == STICKY.confining_stress
    shorter = replace(here, stages=PROGRAMME[:1])
    np.testing.assert_array_equal(
        shorter.run(start=load_progress(path, shorter)).curve.stress_ratio, split_ratio(run.curve, 1)
    )
    save_progress(path, here, passed[3])
    with pytest.raises(ValueError, match="of another test: it differs in stages"):
        load_progress(path, replace(here, stages=PROGRAMME[1:]))
    with pytest.raises(ValueError, match="of another test: it differs in stages"):
        load_progress(path, plain)


def split_ratio(curve, number):
    return np.asarray(curve.stress_ratio)[np.asarray(curve.stage) == number]


# ---- Elastic paths ----


@lru_cache
def elastic_lattice(stiffness_ratio):
    """A test in which nothing slips, sheared slowly, and its confined specimen, as statics see it too."""
    # The servo of a lattice with soft tangential springs follows more slowly, see guide/stress_paths.md.
    params = replace(STICKY, friction=50.0, platen_speed=1e-4 if stiffness_ratio == 1 else 2.5e-5)
    plain = test(params=replace(params, shear_stiffness=stiffness_ratio * float(params.normal_stiffness)))
    confined = plain.confined()
    return plain, confined, statics(plain, confined)


def statics(test, stands):
    """What statics make of a test where it stands: its closed bonds, all of them sticking."""
    load = current_load(stands.membrane, stands.network, stands.state)
    zone = np.isin(np.arange(len(test.cut)), np.asarray(stands.membrane.zone))
    specimen, cells, bonds, held = whole(stands.network, stands.state, np.asarray(load.lateral), zone)
    stiffness = float(test.params.normal_stiffness), float(test.params.shear_stiffness)
    return elastic(specimen, cells, *stiffness, bonds, held, STICKY.confining_stress)[0]


def changes(curve, first, last):
    """Of both natural strains and both stresses between two records."""
    kept = curve.membrane_radius, curve.stress_ratio, curve.lateral_stress
    radius, ratio, s3 = (np.asarray(values)[[first, last]] for values in kept)
    axial = -np.diff(np.log1p(-np.asarray(curve.axial_strain)[[first, last]]))[0]
    return np.array([axial, -np.diff(np.log(radius))[0]]), np.diff([ratio * s3, s3], axis=1)[:, 0]


@pytest.mark.parametrize(
    "path, lateral, ratio",
    [
        (stage("compression", lateral="constant_volume", axial_strain=1e-4), -0.5, 1.0),
        (stage("compression", lateral="constant_volume", axial_strain=1e-4), -0.5, 0.25),
        (stage("compression", lateral="constant_p", axial_strain=1e-4), None, 1.0),
        (stage("compression", lateral="k0", axial_strain=1e-4), None, 0.25),
        (stage("isotropic", lateral_stress=5.5e4), None, 1.0),
    ],
)
def test_an_elastic_path_is_that_of_the_finite_lattice(path, lateral, ratio):
    """Both stresses follow from both strains by the statics of the same bonds, to 0.5 % of the larger stress; moduli of
    this small lattice are a third to two thirds below the closed forms of the infinite one, see tests/validation."""
    plain, confined, answer = elastic_lattice(ratio)
    run = replace(plain, stages=(path,)).run(start=confined)
    assert not run.ended
    strains, stresses = changes(run.curve, 0, -1)
    np.testing.assert_allclose(answer.matrix @ strains, stresses, atol=5e-3 * np.abs(stresses).max())
    if lateral is not None:
        assert strains[1] == pytest.approx(lateral * strains[0], rel=0.02)


def test_the_first_unloading_is_elastic_again():
    """After slip: what turns back does so by the statics of the bonds that are then closed, all of them sticking."""
    there, back = stage("compression", axial_strain=2e-3), stage("extension", axial_strain=1.7e-3)
    slipped, looks = test(there, back, params=replace(STICKY, friction=0.15, platen_speed=1e-3)), []
    curve = slipped.run(progress=looks.append).curve
    top = int(np.argmax(curve.axial_strain))
    assert curve.stress_ratio[top] > 2.3  # 1.5 where the first contacts slip
    stands = [look for look in looks if look.records.stage.size <= top][-1]
    strains, stresses = changes(curve, top + 5, top + 20)  # the platens have turned back
    assert strains[0] < -1e-4
    np.testing.assert_allclose(statics(slipped, stands).matrix @ strains, stresses, atol=1e-2 * np.abs(stresses).max())
    # Bonds have opened: those of the specimen at rest would hold the sides otherwise.
    rested = elastic_lattice(1.0)[2].matrix @ strains
    assert abs(rested[1] - stresses[1]) > 0.1 * np.abs(stresses).max()


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
        (
            lambda: (
                test(stage("compression", lateral="fluid", fluid_modulus=1e9, porosity=0.3, axial_strain=0.1)).prepared
            ),
            "fluid_modulus over porosity is .* at most 4 can be followed",
        ),
        (lambda: test(Stage(Moving(), until=Until(time=-1.0))).prepared, "stage 1: time = -1: must be positive"),
    ],
)
def test_senseless_stages_are_refused_in_one_sentence(made, told):
    with pytest.raises(ValueError, match=told):
        made()


STAGES = """
[[stage]]
type = "isotropic"
lateral_stress = 1e5
[[stage]]
type = "cycles"
lateral = "fluid"
fluid_modulus = 1e8
porosity = 0.3
first = 0.01
second = 0.0
cycles = 3
"""


def test_stages_of_a_case_file():
    """The same as from Python, read and written; without any, what case files always meant."""
    case = make_case(tomllib.loads(STAGES), "a.toml")
    numbers = {"fluid_modulus": 1e8, "porosity": 0.3, "first": 0.01, "second": 0.0, "cycles": 3}
    assert case.build().stages == (stage("isotropic", lateral_stress=1e5), stage("cycles", lateral="fluid", **numbers))
    assert make_case(tomllib.loads(to_toml(case)), "b.toml") == case
    assert Case.model_validate_json(case.model_dump_json()) == case
    assert default_case().build().stages == () and "stage" not in default_case().model_dump()


@pytest.mark.parametrize(
    "text, told",
    [
        ("[[stage]]\ntype = 'isotropi'", "[[stage]] 1: type = 'isotropi': must be 'compression'"),
        (STAGES + "spee = 3", "[[stage]] 2: 'spee' is not a field; did you mean 'speed'?"),
        ("[[stage]]\ntype = 'hold'\nspeed = 1.0", "[[stage]] 1: speed = 1.0: a stage of type 'hold' takes"),
        ("[[stage]]\nlateral = 'k0'", "[[stage]] 1: type is missing"),
        ("[stage]\ntype = 'hold'", "stage: must be tables, each headed [[stage]]"),
        ("[test]\naxial_strain = 0.1\n" + STAGES, "test.axial_strain would do nothing beside [[stage]]"),
    ],
)
def test_a_senseless_stage_of_a_case_file(text, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        make_case(tomllib.loads(text), "a.toml")


def test_the_public_names():
    assert {"stage", "Stage"} <= set(dir(axijax))


# ---- Derivatives ----

# All kinds of commands; criteria in strain, so that a number changes what is recorded, not how often.
PATHS = {
    "drained": (stage("compression", axial_strain=3e-4), stage("extension", axial_strain=1e-4)),
    "cycles": (stage("cycles", first=3e-4, second=1e-4),),
    "constant p": (stage("compression", lateral="constant_p", axial_strain=3e-4),),
    "line": (stage("compression", lateral="line", dq_dp=1.0, axial_strain=3e-4),),
    "constant volume": (stage("compression", lateral="constant_volume", axial_strain=3e-4),),
    "fluid": (stage("compression", lateral="fluid", fluid_modulus=3e7, porosity=0.3, axial_strain=3e-4),),
    "k0": (stage("compression", lateral="k0", axial_strain=3e-4),),
    "isotropic": (stage("isotropic", lateral_stress=6e4, time=20.0),),
    "axial stress": (stage("axial_stress", axial_stress=6e4, time=20.0),),
}
NAMES = ("friction", "normal_stiffness", "confining_stress")


def worst_derivative(stages, params, h=1e-4):
    """Of axial strain, axial and lateral stress, means over the last third of a test, by each number's logarithm: how
    far the exact one is from central differences, over the largest of them."""
    here = test(*stages, params=params)

    def seen(logs):
        changed = {name: getattr(params, name) * jnp.exp(log) for name, log in zip(NAMES, logs, strict=True)}
        curve = functions.simulate.__wrapped__(here.prepared, replace(params, **changed))
        kept = slice(-curve.axial_strain.size // 3, None)
        s3 = curve.lateral_stress[kept] / params.confining_stress
        found = curve.axial_strain[kept] * 1e3, s3, s3 * curve.stress_ratio[kept]
        return jnp.stack([values.mean() for values in found])

    program = jax.jit(lambda at, along: jax.jvp(seen, (at,), (along,)))
    errors = []
    for along in np.eye(len(NAMES)):
        _, slope = program(jnp.zeros(len(NAMES)), along)
        up, down = (program(sign * h * along, along)[0] for sign in (1, -1))
        difference = np.asarray(up - down) / (2 * h)
        # Friction does nothing where nothing slips.
        size = np.abs(difference).max()
        errors.append(np.abs(slope - difference).max() / size if size > 1e-9 else np.abs(slope).max())
    assert size > 0
    return max(errors)


@pytest.mark.parametrize("path", ["constant volume"])
def test_derivatives_along_a_path(path):
    """One here; all of PATHS by `python tests/test_stages.py`."""
    assert worst_derivative(PATHS[path], Params(friction=0.2, platen_speed=0.01)) < 5e-3


# ---- Energy ----


def unaccounted(path, steps, params=STICKY):
    """What the ledger does not account for over a stage, over the platens' work forth and back."""
    here = test(path, params=params)
    prepared, scene, dt = here.prepared, here.scene, here.prepared.time_step
    network, membrane = prepared.lists
    fluid = path.fluid if isinstance(path.membrane, Fluid) else None
    one = make_ledger_step(scene, path.platen_speeds, path.loading, fluid)

    def loop(confined):
        state = functions.start_loading(params, functions.start_shear(scene, params, prepared.lists, confined))
        state = functions.start_stage(scene, path, prepared.lists, dt, params, state, None)

        def block(both, _):
            state, ledger = both
            load = current_load(membrane, network, state)
            seen = energy_balance(scene, params, network, load, dt, *both, fluid)
            observed = observe(scene, params, network, membrane, load, dt, state)
            both = state._replace(loading=path.recorded(observed, state, dt, 25)[0]), ledger
            both = jax.lax.fori_loop(0, 25, lambda _, b: one(params, network, load, dt, b), both)
            return both, (seen, state.loading.pore_pressure)

        return jax.lax.scan(block, (state, open_ledger()), None, length=steps // 25)[1]

    seen, pressure = jax.tree.map(np.asarray, jax.jit(loop)(here.confine()[0]))
    work = np.abs(np.diff(seen.platen_work)).sum()
    return np.abs(seen.unaccounted - seen.unaccounted[0]).max() / work, seen, pressure


def test_energy_of_a_cycle_is_accounted_for():
    """Undrained, to and fro: platens and membrane together do little work on what gives it back, and on a pore fluid
    too, by the corrections of its volume at the records as well."""
    path = stage("cycles", lateral="fluid", first=4e-4, second=0.0, fluid_modulus=1e8, porosity=0.4)
    error, seen, pressure = unaccounted(path, 4000)
    assert error < 1e-6
    assert np.ptp(seen.lateral_work) > 0.1 * np.ptp(seen.platen_work) > 0
    assert np.ptp(seen.fluid_work) > 1e-3 * np.ptp(seen.platen_work) and np.ptp(pressure) > 0


if __name__ == "__main__":
    for name, stages in PATHS.items():
        print(f"{name}: {worst_derivative(stages, Params(friction=0.2, platen_speed=0.01)):.1e}", flush=True)
