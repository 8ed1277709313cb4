"""A case run into a folder: what the folder holds, stopping and going on, and whole files only."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib

import jax
import meshio
import numpy as np
import pytest
from cli_in_process import SMALL, axijax, write

from axijax.app import animation, runs
from axijax.app.case import Case, load_case
from axijax.app.results import open_result
from axijax.app.snapshot import snapshot

FILES = {"case.toml", "run.json", "checkpoint.npz", "curve.nc", "curve.csv", "curve.png"}
LONGER = SMALL.replace("0.012", "0.016")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a run that was never stopped, and what it printed."""
    folder = tmp_path_factory.mktemp("runs")
    called = axijax("run", write(folder / "small.toml"), "--output", folder / "small")
    assert called.code == 0, called.err
    return folder / "small", called


@pytest.fixture(scope="module")
def finished_longer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    assert axijax("run", write(folder / "longer.toml", LONGER), "--output", folder / "longer").code == 0
    return folder / "longer"


def status_of(folder):
    return json.loads((folder / "run.json").read_text())["status"]


def assert_same_result(folder, other):
    """Curves and last states, bit for bit."""
    one, two = open_result(folder), open_result(other)
    for name in one.curve.data_vars:
        np.testing.assert_array_equal(one.curve[name].values, two.curve[name].values, err_msg=name)
    for (name, a), b in zip(jax.tree.leaves_with_path(one.progress), jax.tree.leaves(two.progress), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=str(name))


def interrupted(folder, monkeypatch, case=SMALL, number=signal.SIGINT, after=1500):
    """A run that got a signal once it had taken so many steps; the call."""

    def noticing(self, test, now):
        if now is not None and now.records.height.size * test.record_every >= after:
            os.kill(os.getpid(), number)

    with monkeypatch.context() as patch:
        patch.setattr("axijax.app.cli.run._PlainLines.tell", noticing)
        return axijax("run", write(folder.parent / "small.toml", case), "--output", folder)


def test_the_folder_tells_what_was_run(finished):
    folder, _ = finished
    assert {path.name for path in folder.iterdir()} == FILES
    info = json.loads((folder / "run.json").read_text())
    assert info["status"] == "finished" and info["name"] == "small" and info["balls"] == 26
    assert info["jax"] == jax.__version__ and info["numpy"] == np.__version__ and info["machine"]["cores"] >= 1
    assert info["seconds"] > 0 and info["started"] <= info["ended"] and info["command"][0] == "axijax"
    case = load_case(folder / "case.toml")
    assert case.test.time_step == case.build().prepared.time_step, "every value is filled in"
    assert case.with_test(time_step=None) == Case.model_validate(tomllib.loads(SMALL))
    with open(folder / "curve.csv") as file:
        assert "axial_strain" in file.read(400)


def test_a_pipe_gets_a_few_plain_lines(finished):
    _, called = finished
    lines = called.out.strip().splitlines()
    assert len(lines) == 12 and "\x1b" not in called.out and called.err == ""
    assert "26 balls" in lines[0] and "confined in" in lines[1] and "peak stress ratio" in lines[-1]
    assert all(" [" in line and len(line) < 100 for line in lines[2:-1]), "the summary, with units"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_and_resumed_is_the_run_that_never_stopped(number, finished, tmp_path, monkeypatch):
    folder = tmp_path / "small"
    called = interrupted(folder, monkeypatch, number=number)
    assert called.code == 130
    assert f"axijax resume {folder}" in called.err and "Traceback" not in called.err
    assert status_of(folder) == "interrupted"
    assert {path.name for path in folder.iterdir()} == {"case.toml", "run.json", "checkpoint.npz"}, "no curve as yet"
    assert signal.getsignal(number) is not None and "_signals_wait" not in repr(signal.getsignal(number))
    called = axijax("resume", folder)
    assert called.code == 0 and "going on from" in called.out, called.err
    assert status_of(folder) == "finished" and json.loads((folder / "run.json").read_text())["resumed"] == 1
    assert_same_result(folder, finished[0])


def test_finished_and_taken_further_is_the_longer_run(finished, finished_longer, tmp_path):
    folder = shutil.copytree(finished[0], tmp_path / "small")
    called = axijax("resume", folder, "--axial-strain", "0.016")
    assert called.code == 0, called.err
    assert load_case(folder / "case.toml").test.axial_strain == 0.016
    assert_same_result(folder, finished_longer)


def test_a_run_stopped_before_it_was_confined_starts_again(finished, tmp_path, monkeypatch):
    folder = tmp_path / "small"

    def stop(self, test, now):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("axijax.app.cli.run._PlainLines.tell", stop)
        called = axijax("run", write(tmp_path / "small.toml"), "--output", folder)
    assert called.code == 130 and "before it was confined" in called.err
    assert {path.name for path in folder.iterdir()} == {"case.toml", "run.json"}
    assert axijax("resume", folder).code == 0
    assert_same_result(folder, finished[0])


def test_overwriting_leaves_nothing_of_the_old(tmp_path, monkeypatch):
    folder = tmp_path / "small"
    assert axijax("run", write(tmp_path / "small.toml"), "--output", folder).code == 0
    (folder / "notes.txt").write_text("mine")
    with monkeypatch.context() as patch:
        patch.setattr("axijax.app.cli.run._PlainLines.tell", lambda *_: os.kill(os.getpid(), signal.SIGINT))
        assert axijax("run", tmp_path / "small.toml", "--output", folder, "--overwrite").code == 130
    assert not (folder / "curve.nc").exists() and (folder / "notes.txt").read_text() == "mine"


def test_a_failed_run_keeps_its_curve_under_another_name(tmp_path):
    """Platens that outrun the contact list between two looks at it."""
    case = write(tmp_path / "fast.toml", SMALL.replace("0.01\n", "2.0\n").replace("0.012", "0.3"))
    called = axijax("run", case, "--output", tmp_path / "fast")
    assert called.code == 1 and "went wrong" in called.err
    assert status_of(tmp_path / "fast") == "failed"
    assert {path.name for path in (tmp_path / "fast").iterdir()} == {
        "case.toml", "run.json", "checkpoint.npz", "partial_curve.nc",
    }  # fmt: skip
    again = axijax("resume", tmp_path / "fast")
    assert again.code == 1 and "failed" in again.err and "would again" in again.err


def test_a_full_disk_loses_nothing(finished, tmp_path, monkeypatch):
    folder = tmp_path / "small"

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(runs, "save_run", full)
        called = axijax("run", write(tmp_path / "small.toml"), "--output", folder)
    assert called.code == 1 and "No space left" in called.err and f"axijax resume {folder}" in called.err
    assert not (folder / "curve.nc").exists() and status_of(folder) != "finished"
    assert axijax("resume", folder).code == 0
    assert_same_result(folder, finished[0])


def test_json_lines_tell_every_stage(tmp_path):
    called = axijax("run", write(tmp_path / "small.toml"), "--output", tmp_path / "out", "--json")
    lines = [json.loads(line) for line in called.out.splitlines()]
    assert [line["event"] for line in lines[:3]] == ["preparing", "confined", "progress"]
    assert lines[-1]["event"] == "finished" and lines[-1]["result"] == str(tmp_path / "out")
    strains = [line["axial_strain"] for line in lines if line["event"] == "progress"]
    assert strains == sorted(strains) and strains[0] == 0 and strains[-1] >= 0.012
    last = next(line for line in reversed(lines) if line["event"] == "progress")
    assert last["ball_steps_per_second"] > 0 and last["seconds_left"] >= 0 and 0 <= last["unbalanced_force"] < 1
    best = open_result(tmp_path / "out").curve.stress_ratio.values.max()
    assert lines[-1]["peak_stress_ratio"] == best


def test_snapshots_are_spread_over_the_shear(finished, tmp_path):
    folder = tmp_path / "small"
    assert axijax("run", write(tmp_path / "small.toml"), "--output", folder, "--snapshots", 3, "--full").code == 0
    assert len(list((folder / "snapshots-full").glob("balls_*.vtu"))) == 3 and not (folder / "snapshots").exists()
    result = open_result(folder)
    made = meshio.read(folder / "snapshots-full" / "balls_0002.vtu")
    whole = snapshot(result.test, result.progress, full=True).balls
    assert len(made.points) == whole.number.size > len(result.test.cut)
    assert [place.shape[1] for _, place in animation._frames(result)] == 3 * [len(result.test.cut)], "for a film"
    assert_same_result(folder, finished[0])
    assert runs._snapshot_strains(3, 0.01, 0.0) == [0.0, 0.005, 0.01]
    assert runs._snapshot_strains(3, 0.01, 0.006) == [0.01] and runs._snapshot_strains(1, 0.01, 0.0) == [0.01]


def test_a_real_process_stops_and_goes_on(finished, tmp_path):
    """Ctrl-C from outside, as a shell sends it."""
    case = write(tmp_path / "small.toml", SMALL.replace("0.012", "0.3"))
    command = [sys.executable, "-m", "axijax", "run", str(case), "--output", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        limit = time.monotonic() + 100
        while not (tmp_path / "out" / "checkpoint.npz").exists() and time.monotonic() < limit:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=100)
    finally:
        process.kill()
    assert process.returncode == 130, errors
    assert "axijax resume" in errors and "Traceback" not in errors
    assert status_of(tmp_path / "out") == "interrupted"


RANDOM = """
[specimen]
kind = "random"
balls = 48
compaction_friction = 0.3
[sector]
order = 3
[parameters]
platen_speed = 0.01
[test]
axial_strain = 0.004
tolerance = 1e-3
"""


@pytest.fixture(scope="module")
def random_run(tmp_path_factory):
    """The folder of a random specimen's run, and what it printed."""
    folder = tmp_path_factory.mktemp("runs")
    called = axijax("run", write(folder / "random.toml", RANDOM), "--output", folder / "random")
    assert called.code == 0, called.err
    return folder / "random", called


COMMANDS = (("resume", "--axial-strain", "0.006"), ("check",), ("snapshot",), ("report",))


class TestRandomSpecimen:
    def test_its_report_is_printed_and_kept(self, random_run):
        folder, called = random_run
        assert {path.name for path in folder.iterdir()} == FILES | {"specimen.npz"}
        packing = json.loads((folder / "run.json").read_text())["packing"]
        assert packing["balls"] == 48 and packing["order"] == 3 and packing["compaction_friction"] == 0.3
        assert f"{packing['void_ratio']:.4f} in pi Rm^2 H" in called.out and "48 balls, 16 in a sector" in called.out
        assert len(packing["sieves"]["radius"]) == 5

    def test_it_is_confined_with_the_friction_of_its_compaction(self, random_run):
        assert load_case(random_run[0] / "case.toml").test.confining_friction == 0.3
        assert open_result(random_run[0]).test.confining_friction == 0.3
        assert Case().build().confining_friction == 0

    def test_it_is_kept_to_the_last_bit_and_not_made_again(self, random_run, monkeypatch):
        folder, _ = random_run
        _, specimen, _ = load_case(folder / "case.toml").made()
        monkeypatch.setattr("axijax.triaxial.random_specimen.random_cylinder", None)
        monkeypatch.setattr("axijax.app.case._packed", None)
        kept = open_result(folder).test.specimen
        for field in ("positions", "radius", "membrane_zone"):
            np.testing.assert_array_equal(getattr(kept, field), getattr(specimen, field))
        same = [(each.bottom, each.top, each.name, each.zone_rule) for each in (kept, specimen)]
        assert same[0] == same[1] and kept.zone_rule == "exposure"

    def test_it_goes_on_without_being_made_again(self, random_run, tmp_path, monkeypatch):
        whole = tmp_path / "whole"
        longer = write(tmp_path / "longer.toml", RANDOM.replace("0.004", "0.006"))
        assert axijax("run", longer, "--output", whole).code == 0
        folder = shutil.copytree(random_run[0], tmp_path / "out")
        monkeypatch.setattr("axijax.app.case._packed", None)
        assert axijax("resume", folder, "--axial-strain", "0.006").code == 0
        assert_same_result(folder, whole)

    @pytest.mark.parametrize(
        ("damage", "words", "commands"),
        [
            (lambda path: path.unlink(), "has lost its specimen.npz", COMMANDS),
            (lambda path: path.write_bytes(path.read_bytes()[:200]), "specimen.npz is damaged", COMMANDS[:1]),
            (lambda path: path.write_bytes(b""), "specimen.npz is damaged", COMMANDS[1:2]),
            (lambda path: np.savez(path, positions=np.zeros((3, 4))), "specimen.npz is damaged", COMMANDS[2:3]),
        ],
    )
    def test_a_lost_or_damaged_one_is_one_sentence(self, random_run, tmp_path, damage, words, commands):
        folder = shutil.copytree(random_run[0], tmp_path / "out")
        damage(folder / "specimen.npz")
        for command in commands:
            called = axijax(*command, folder)
            assert called.code == 1 and words in called.err and called.err.count("\n") == 1, (command, called.err)

    def test_another_case_than_it_was_made_from(self, random_run, tmp_path):
        folder = shutil.copytree(random_run[0], tmp_path / "out")
        text = (folder / "case.toml").read_text()
        (folder / "case.toml").write_text(text.replace("seed = 0", "seed = 1"))
        called = axijax("check", folder)
        assert called.code == 1 and "says another [specimen]" in called.err
