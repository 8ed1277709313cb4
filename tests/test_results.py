"""What a run leaves: read back and checked; every number against the state it came from."""

import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest
from small_result import CASE

from axijax.app import checks as checks_module
from axijax.app import labels, results
from axijax.app.case import Case
from axijax.app.checks import result_checks
from axijax.app.report import report_page
from axijax.app.results import open_result, open_results
from axijax.app.snapshot import snapshot
from axijax.core.vector import Vector
from axijax.mechanics.dynamics import all_forces, initial_state
from axijax.mechanics.membrane import membrane_load
from axijax.mechanics.observe import observe
from axijax.triaxial.records import Confinement, no_records, quantities_of
from axijax.triaxial.test import Progress
from calibrate import read_measured

pytest_plugins = ["small_result"]

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture
def copied(folder, tmp_path):
    """A copy of the result that a test may damage."""
    return Path(shutil.copytree(folder, tmp_path / "small"))


@pytest.fixture(scope="module")
def forces(result):
    """All forces of the last state, as a step finds them, and what the test observes there."""
    test, now = result.test, result.progress
    return found_in(test.scene, test.prepared.time_step, now.network, now.membrane, now.state, now.params)


@partial(jax.jit, static_argnums=(0, 1))
def found_in(scene, dt, network, membrane, state, params):
    """Forces, observation and load of a state."""
    load = membrane_load(membrane, network.positions + state.displacement, *state.platens)
    given = (scene, params, network)
    return all_forces(*given, load, dt, state), observe(*given, membrane, load, dt, state), load


# Reading back.


def test_curve_comes_back_from_every_file(result, folder):
    """NetCDF, CSV for spreadsheets and for calibrate, and the checkpoint's records hold the same numbers."""
    curve = result.curve
    assert result.status == "finished" and result.name == "small"
    assert curve.axial_strain.attrs["units"] == "1" and curve.membrane_radius.attrs["units"] == "L"
    lines = (folder / "curve.csv").read_text().splitlines()
    assert lines[0].startswith("# axijax") and "compression positive" in lines[0]
    heads = lines[1].split(",")
    assert heads[:2] == ["axial_strain [-]", "stress_ratio [-]"] and "membrane_radius [L]" in heads
    table = np.loadtxt(lines[2:], delimiter=",").T
    for head, column in zip(heads, table, strict=True):
        np.testing.assert_array_equal(curve[head.split(" ")[0]].values, column)
    measured = read_measured(folder / "curve.csv")
    np.testing.assert_array_equal(measured.stress_ratio, curve.stress_ratio.values)
    np.testing.assert_array_equal(measured.volumetric_strain, curve.volumetric_strain.values)
    seen = result.progress.records
    np.testing.assert_array_equal(seen.core_ratio[: curve.sizes["axial_strain"]], curve.core_ratio.values)
    assert float(curve.confinement_stress_error) == float(result.progress.confinement.stress_error) < 1e-6


def test_an_unfinished_run_has_the_curve_up_to_its_checkpoint(result, copied):
    (copied / "curve.nc").unlink()
    (copied / "run.json").write_text(json.dumps({"status": "interrupted", "message": "Ctrl-C"}))
    unfinished = open_result(copied)
    assert unfinished.status == "interrupted" and labels.labels([unfinished]) == ["small (interrupted)"]
    for name in quantities_of(result.curve):
        np.testing.assert_array_equal(unfinished.curve[name].values, result.curve[name].values)
    told = replace(unfinished, path=copied / "curve.nc")  # without the pictures
    told.__dict__["case"] = result.case
    assert "small (interrupted) has not finished (status: interrupted): Ctrl-C" in report_page([told])
    assert not result_checks(unfinished)[0].passed


def test_a_run_that_went_wrong_shows_its_curve(result, copied):
    (copied / "curve.nc").rename(copied / "partial_curve.nc")
    (copied / "run.json").write_text(json.dumps({"status": "failed", "message": "a ball has left"}))
    failed = open_result(copied)
    np.testing.assert_array_equal(failed.curve.stress_ratio, result.curve.stress_ratio)
    assert failed.status == "failed" and not result_checks(failed)[0].passed


def test_a_bare_file_of_curves_keeps_the_case(result, folder):
    bare = open_result(folder / "curve.nc")
    assert bare.case == result.case and not bare.has_state
    with pytest.raises(ValueError, match="no last state"):
        _ = bare.progress
    assert [check.name for check in result_checks(bare)] == [check.name for check in result_checks(result)][:-5]


def test_several_runs_of_one_file(result, tmp_path):
    curve = results.curve_of(result.progress, result.test.axial_strain)
    dataset = results.curves_dataset({"a": curve, "b": curve}, {"friction": [0.1, 0.2]}, {})
    results.save_dataset(dataset, tmp_path / "curves.nc")
    assert [each.name for each in open_results(tmp_path / "curves.nc")] == ["a", "b"]
    with pytest.raises(ValueError, match="holds 2 runs"):
        open_result(tmp_path / "curves.nc")
    with pytest.raises(ValueError, match="keeps no case"):
        _ = open_results(tmp_path / "curves.nc")[0].case


DAMAGE = {
    "missing folder": (lambda path: shutil.rmtree(path), "does not exist"),
    "empty folder": (lambda path: (shutil.rmtree(path), path.mkdir()), "is no result"),
    "curve cut short": (lambda path: cut(path / "curve.nc"), "damaged or no file of curves"),
    "curve is text": (lambda path: (path / "curve.nc").write_text("axial_strain"), "damaged or no file of curves"),
    "empty curve": (lambda path: (path / "curve.nc").write_bytes(b""), "damaged or no file of curves"),
    "run.json cut short": (lambda path: cut(path / "run.json"), "run.json is damaged"),
    "unknown status": (lambda path: (path / "run.json").write_text('{"status": "well"}'), "run.json is damaged"),
    "nothing yet": (
        lambda path: [
            (path / "run.json").write_text('{"status": "failed", "message": "disk full"}'),
            (path / "curve.nc").unlink(),
            (path / "checkpoint.npz").unlink(),
        ],
        "disk full",
    ),
    "checkpoint cut short": (lambda path: cut(path / "checkpoint.npz"), "checkpoint.npz' is damaged"),
    "another case": (
        lambda path: (path / "case.toml").write_text(
            (path / "case.toml").read_text().replace("half_width = 5", "half_width = 3")
        ),
        "is of another test",
    ),
    "misspelt case": (
        lambda path: (path / "case.toml").write_text("[sectr]\norder = 4\n"),
        "did you mean 'sector'",
    ),
}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_results_are_refused_in_one_sentence(damage, copied):
    spoil, message = DAMAGE[damage]
    spoil(copied)
    with pytest.raises(ValueError, match=re.escape(message)) as error:
        _ = open_result(copied).progress
    assert "\n" not in str(error.value) and str(copied) in str(error.value)


# The moment.


def on_balls(moment, vectors):
    """Sum of the contacts' vectors on the sector's balls, with the other sign on second balls; (3, N)."""
    contacts, n = moment.contacts, moment.sector.images
    total = np.zeros((3, 1 + int(moment.balls.number.max())))
    on_axis = np.hypot(*moment.balls.positions[:2]) < 1e-6
    alone = (
        np.isin(contacts.first, moment.balls.number[on_axis]),
        np.isin(contacts.second, moment.balls.number[on_axis]),
    )
    turns = contacts.copy, (contacts.copy + contacts.image) % n
    for ball, turn, axis, sign in zip((contacts.first, contacts.second), turns, alone, (1, -1), strict=True):
        kept = (turn == 0) | axis
        np.add.at(total.T, ball[kept], sign * vectors[:, kept].T)
    return total


def test_contacts_platens_and_membrane_balance_as_the_step_finds_them(moment, forces, result):
    """Each ball's resultant is the sum of what the snapshot's contacts, platens and membrane put on it."""
    found, _, load = forces
    own = moment.balls.image == 0
    x, y, _ = moment.balls.positions[:, own]
    inward = -moment.confining_stress * moment.balls.membrane_area[own] / np.maximum(np.hypot(x, y), 1e-300)
    bottom, top = (np.asarray(push) for push in found.platen_push)
    total = on_balls(moment, moment.contacts.force) + np.stack([inward * x, inward * y, bottom - top])
    np.testing.assert_allclose(total, np.asarray(found.resultant), atol=1e-9 * moment.contacts.normal_force.max())
    np.testing.assert_allclose(moment.balls.membrane_area[own], load.lateral)
    np.testing.assert_allclose(
        moment.platens.forces, [4 * (b * result.progress.network.weight).sum() for b in (bottom, top)]
    )


def test_what_is_counted_is_what_the_test_observes(moment, forces):
    _, seen, _ = forces
    contacts, balls = moment.contacts, moment.balls
    assert balls.coordination.mean() == pytest.approx(float(seen.coordination_number), rel=1e-12)
    assert contacts.sliding.mean() == pytest.approx(float(seen.sliding_fraction), rel=1e-12)
    assert 0 < contacts.sliding.sum() < contacts.sliding.size
    assert moment.stress_ratio == pytest.approx(float(seen.stress_ratio), rel=1e-12)
    volume = 4 / 3 * np.pi * balls.radius**3
    middle, height = moment.platens.heights.mean(), np.ptp(moment.platens.heights)
    rho, z = np.hypot(*balls.positions[:2]), balls.positions[2]
    core = (rho < seen.membrane_radius / 2) & (np.abs(z - middle) < 0.3 * height)
    # Arms are radii there and lie on the branch here, an overlap apart.
    xx, yy, zz = ((balls.stress[a, a] * volume)[core].sum() for a in range(3))
    assert core.sum() == 6 and zz / (0.5 * (xx + yy)) == pytest.approx(float(seen.core_ratio), rel=5e-4)


def test_stress_of_the_balls_is_the_love_weber_sum(moment, forces):
    """Balls' stress times volume adds up to force times branch of the contacts, and arm times push at the
    boundaries; its vertical part to platen force times height."""
    contacts, balls = moment.contacts, moment.balls
    total = (balls.stress * 4 / 3 * np.pi * balls.radius**3).sum(-1)
    love_weber = np.einsum("ac,bc->ab", contacts.start - contacts.end, contacts.force)
    rho = np.hypot(*balls.positions[:2])
    push = moment.confining_stress * balls.membrane_area * balls.radius
    unit = balls.positions[:2] / np.where(rho > 0, rho, 1)
    love_weber[:2, :2] += np.einsum("ai,bi,i->ab", unit, unit, push)
    bottom, top = (np.asarray(push)[balls.number] for push in forces[0].platen_push)
    low, high = moment.platens.heights
    love_weber[2, 2] += (bottom * (balls.positions[2] - low) + top * (high - balls.positions[2])).sum()
    np.testing.assert_allclose(total, love_weber, atol=1e-12 * total[2, 2])
    height = np.ptp(moment.platens.heights)
    assert total[2, 2] == pytest.approx(moment.platens.forces.mean() * height, rel=1e-4)
    assert float(forces[1].unbalanced_force) < 1e-2


def test_rigid_planes_take_their_part_in_the_stress():
    """A specimen shrunk away from equilibrium: all inner stress is what platens and membrane do, and what moves the
    balls (virial theorem). The planes meet at the axis, so that their part drops out but for the arms."""
    test = Case.model_validate(CASE | {"sector": {"boundary": "rigid"}}).build()
    network, zero = test.network, np.zeros(())
    platens = np.array([test.cut.bottom, test.cut.top])
    state = initial_state(test.scene, test.params, network, platens)._replace(displacement=network.positions * -1e-3)
    balance = Confinement(zero, zero, zero)
    now = Progress(test.params, network, test.membrane, state, None, balance, test.cut.height, no_records())
    moment = snapshot(test, now, full=True)
    balls = moment.balls
    assert balls.number.size == len(test.cut) and not balls.image.any()
    found, _, _ = found_in(test.scene, test.prepared.time_step, network, now.membrane, state, now.params)
    xx, yy, zz = (np.sum(balls.stress[a, a] * 4 / 3 * np.pi * balls.radius**3) for a in range(3))
    x, y, z = balls.positions * np.asarray(found.resultant)
    inward = moment.confining_stress * balls.membrane_area * (np.hypot(*balls.positions[:2]) + balls.radius)
    assert xx + yy == pytest.approx(np.sum(inward + x + y), rel=1e-10)
    (low, high), (bottom, top) = platens, moment.platens.forces
    assert zz == pytest.approx(np.sum(z) + top * high - bottom * low, rel=1e-10)
    assert np.sum(balls.positions[1] < balls.radius) > 3, "balls press on the planes"
    assert xx == pytest.approx(yy, rel=1e-9)


def test_images_are_turned_with_all_they_carry(moment):
    """A quarter turn is (x, y, z) -> (-y, x, z), for vectors, and on both sides of a tensor."""
    balls, contacts = moment.balls, moment.contacts
    assert np.unique(balls.image).tolist() == [0, 1, 2, 3]
    off_axis = np.flatnonzero(np.hypot(*balls.positions[:2, balls.image == 0]) > 1e-6)
    for number in off_axis[[0, 7, -1]]:
        first, second = (np.flatnonzero((balls.number == number) & (balls.image == k))[0] for k in (0, 1))
        for vectors in (balls.positions, balls.velocity, balls.spin, balls.displacement):
            np.testing.assert_allclose(vectors[:, second], QUARTER @ vectors[:, first], rtol=1e-13, atol=1e-300)
            assert np.abs(vectors[:, first]).max() > 0
        turned = QUARTER @ balls.stress[..., first] @ QUARTER.T
        np.testing.assert_allclose(balls.stress[..., second], turned, atol=1e-9 * np.abs(turned).max())
    # Every contact ends at balls that are there, and no two are the same.
    place = {tuple(np.round(p, 6)) for p in balls.positions.T}
    ends = [
        frozenset((tuple(np.round(a, 6)), tuple(np.round(b, 6))))
        for a, b in zip(contacts.start.T, contacts.end.T, strict=True)
    ]
    assert all(pair <= place for pair in ends) and len(set(ends)) == len(ends)
    distance = np.linalg.norm(contacts.start - contacts.end, axis=0)
    assert (distance < balls.radius[0] * 2).all()
    everywhere = np.linalg.norm(balls.positions[:, :, None] - balls.positions[:, None], axis=0)
    assert (np.triu(everywhere < 2 * balls.radius[0], 1)).sum() == len(ends)


def test_cells_are_those_that_are_loaded(moment):
    membrane = moment.membrane
    areas = [0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) for x, y in (p.T for p in membrane.polygons)]
    np.testing.assert_allclose(areas, membrane.area, rtol=1e-9)
    np.testing.assert_allclose(membrane.force, moment.confining_stress * membrane.area)
    strip = 2 * np.pi * membrane.radius * np.ptp(moment.platens.heights)
    assert membrane.area.sum() == pytest.approx(strip, rel=1e-12)


# Checks.


CORE = "platen against core stress ratio at the largest stress ratio"


def test_checks_of_a_sound_run(result):
    """Five layers of seventeen balls are no continuum: their platens bear on all of them, which has no limit. The test
    stops while its curve still rises."""
    checks = {check.name: check for check in result_checks(result, energy=True)}
    assert [name for name, check in checks.items() if not check.passed] == ["peak stress ratio", CORE]
    assert checks["peak stress ratio"].passed is None and checks["peak stress ratio"].value == "none within the test"
    assert "at the last record: the curve still rises" in checks["peak stress ratio"].meaning
    assert not any("at the peak" in name for name in checks)
    assert checks[CORE].passed is None and "diameters high" in checks[CORE].limit
    assert checks["platen against internal stress"].value < 1e-4
    assert 0 < checks["energy ledger closes"].value < 1e-5
    assert checks["membrane cells tile the strip"].value < 1e-12
    assert checks["unbalanced force after confinement"].limit == 1e-6
    assert all(check.meaning and "\n" not in check.meaning for check in checks.values())


def test_checks_find_what_is_wrong(result):
    """Chatter at the peak, motion, and balls lifted off the bottom platen by a quarter of an overlap."""
    curve = result.curve.copy(deep=True)
    curve["chatter"][int(curve.stress_ratio.values.argmax())] = 0.1
    curve["unbalanced_force"][:] = 0.5
    curve["virial_ratio"] *= 0.7  # as if Rm were 16 % too small
    spoilt = replace(result, curve=curve)
    state = result.progress.state
    lifted = state.displacement + Vector(0.0, 0.0, 0.005)
    faulty = result.progress._replace(state=state._replace(displacement=lifted))
    spoilt.__dict__.update(case=result.case, test=result.test, progress=faulty)
    failed = {check.name for check in result_checks(spoilt) if not check.passed}
    assert failed >= {
        "chatter at the largest stress ratio", "chatter of the whole curve",
        "unbalanced force around the largest stress ratio", "bottom against top platen force",
        "platen against virial stress ratio at the largest stress ratio",
    }  # fmt: skip


def test_a_peak_that_was_reached_is_checked_at_the_peak(result):
    """The same run with a curve that goes down again."""
    curve = result.curve.copy(deep=True)
    strain = curve.axial_strain.values
    curve["stress_ratio"] = curve.stress_ratio.dims, 2 - ((strain - 0.001) / 0.001) ** 2
    humped = replace(result, curve=curve)
    humped.__dict__.update(case=result.case, test=result.test, progress=result.progress)
    checks = {check.name: check for check in result_checks(humped)}
    assert checks["peak stress ratio"].passed and checks["peak stress ratio"].value == pytest.approx(2, abs=0.01)
    assert "chatter at the peak" in checks and not any("largest" in name for name in checks)
    text = report_page([humped])
    assert ">peak stress ratio s1/s3 [-]<" in text and "so far" not in text


def test_the_papers_quarter_is_held_to_strict_limits(result):
    quarter, radius = Case().build(), 167.0
    assert checks_module._radius_limit(quarter, radius) == 0.05
    good, bad = (checks_module._core_check(quarter, 2.5, core, radius) for core in (2.4, 2.2))
    assert good.passed is True and bad.passed is False and good.limit == 0.1
    rigid = Case(sector={"order": 4, "boundary": "rigid"}).build()
    assert checks_module._core_check(rigid, 2.0, 2.5, radius).passed is None
