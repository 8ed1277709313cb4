"""The library of runs: whole files, one run once, shared by processes, by similarity for every confining stress."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_standin import StandInTest, scene, stand_in

from axijax import Params
from calibrate.ensemble import design, one_run, run_all
from calibrate.library import Library, clean, library_folder, listed, read_run
from calibrate.scene import RandomScene


def jobs(world, count):
    return [(world.point({"friction": 0.2 + 0.01 * k}, world.stress), 100 + k) for k in range(count)]


def test_a_run_is_made_once_and_read_back_to_the_last_bit(tmp_path):
    world, made = scene(), []
    library = Library(world, tmp_path)
    first = run_all(world, jobs(world, 3), 0.05, library, workers=1, finished=made.append)
    again = run_all(world, jobs(world, 3), 0.05, Library(world, tmp_path), workers=1, finished=made.append)
    assert len(made) == 3
    for a, b in zip(first, again, strict=True):
        assert a.point == b.point and all((a.curve[name] == b.curve[name]).all() for name in a.curve)
    run_all(world, jobs(world, 3), 0.08, library, workers=1, finished=made.append)
    assert len(made) == 6 and {run.reach for run in library.runs()} == {0.08}, "a longer run takes the place"


def test_a_failed_run_is_kept_with_its_sentence_and_not_tried_again(tmp_path):
    world, made = scene(), []
    library = Library(world, tmp_path)
    job = (world.point({"friction": 1.3}, world.stress), 1)
    for _ in range(2):
        (run,) = run_all(world, [job], 0.05, library, workers=1, finished=made.append)
    assert len(made) == 1 and run.curve is None and "lower time_step" in run.failed
    assert [(each.runs, each.failed) for each in listed(tmp_path)] == [(0, 1)]
    assert clean(tmp_path, failed_only=True) == 1 and not library.runs()


def test_similarity_one_point_for_all_stresses():
    """The same balls at twice the stress, twice as stiff: one point, and its run has the stiffness in proportion."""
    world = scene()
    low = world.point({"normal_stiffness": 1e9, "shear_stiffness": 3e8}, 1e5)
    high = world.point({"normal_stiffness": 2e9, "shear_stiffness": 6e8}, 2e5)
    assert low == pytest.approx(high) and "confining_stress" not in low
    params = world.params_at(low)
    assert float(params.normal_stiffness) / world.stress == pytest.approx(1e9 / 1e5)
    assert float(params.damping_ratio) == float(world.params.damping_ratio)


def test_scenes_are_told_apart_and_parameters_are_not(tmp_path):
    world = scene()
    assert Library(replace(world, params=Params(friction=0.7)), tmp_path).folder == Library(world, tmp_path).folder
    others = [
        RandomScene(lambda seed, params: StandInTest(params, seed + 1), Params()),
        RandomScene(stand_in, Params(rolling_friction=0.1)),
        RandomScene(stand_in, Params(damping=None)),
    ]
    folders = {Library(each, tmp_path).folder for each in (world, *others)}
    assert len(folders) == 4


def test_a_damaged_file_is_a_run_that_is_not_there(tmp_path):
    world = scene()
    library = Library(world, tmp_path)
    run_all(world, jobs(world, 2), 0.05, library, workers=1)
    path = next(library.folder.glob("run-*.npz"))
    path.write_bytes(path.read_bytes()[:200])
    assert read_run(path) is None and len(library.runs()) == 1
    run_all(world, jobs(world, 2), 0.05, library, workers=1)
    assert len(library.runs()) == 2


def test_cleaning_leaves_what_no_library_wrote(tmp_path):
    world = scene()
    library = Library(world, tmp_path)
    run_all(world, jobs(world, 1), 0.05, library, workers=1)
    (library.folder / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"no library in .* has a name that begins so"):
        clean(tmp_path, "zzz")
    assert clean(tmp_path, library.folder.name[:4]) == 1
    assert (library.folder / "notes.txt").read_text() == "mine" and not list(listed(tmp_path))


def test_where_libraries_are(monkeypatch, tmp_path):
    monkeypatch.setenv("AXIJAX_LIBRARY", str(tmp_path / "runs"))
    assert library_folder() == tmp_path / "runs"
    monkeypatch.delenv("AXIJAX_LIBRARY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert library_folder() == tmp_path / "axijax" / "runs"


def test_worker_processes_give_the_same_runs(tmp_path):
    """Through pickle and in another process, to the last bit."""
    code = (
        "from random_standin import scene\n"
        "from calibrate.ensemble import run_all\n"
        "from calibrate.library import Library\n"
        "if __name__ == '__main__':\n"
        "    world = scene()\n"
        "    jobs = [(world.point({'friction': 0.2 + 0.01 * k}, world.stress), 100 + k) for k in range(3)]\n"
        f"    print(len(run_all(world, jobs, 0.05, Library(world, {str(tmp_path)!r}), workers=2)))\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(here.parent), str(here)])}
    told = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=False)
    assert told.stdout.strip() == "3", told.stderr
    world = scene()
    for run, job in zip(Library(world, tmp_path).runs(), jobs(world, 3), strict=True):
        own = one_run(world, job, 0.05)
        assert all((run.curve[name] == own.curve[name]).all() for name in own.curve)


def test_a_longer_design_begins_with_the_shorter():
    assert (design(40, 3)[:24] == design(24, 3)).all()
    points = design(64, 3)
    for k in range(3):  # a Sobol sequence: one point in each 64th
        assert (np.sort((points[:, k] * 64).astype(int)) == np.arange(64)).all()
