"""The folder that results go to: whole files, leftovers of killed writers, what may be replaced, and what is said."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from axijax.app import overwrite, table1
from axijax.app.batch import run_batch
from axijax.app.cli.errors import filling
from axijax.core import signals
from axijax.core.files import (
    FolderError,
    draw_afterwards,
    locked,
    printable,
    remove_leftovers,
    writable_folder,
    write_whole,
    writing_to,
)

fcntl = pytest.importorskip("fcntl")

KILLED_WRITER = """
import os, signal, sys
from pathlib import Path
from axijax.core.files import write_whole
def half(target):
    target.write_text("half a cur")
    os.kill(os.getpid(), signal.SIGKILL)
write_whole(Path(sys.argv[1]), half)
"""


def names(folder):
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


class TestLeftovers:
    def test_of_a_killed_writer_are_removed_by_whoever_takes_the_folder(self, tmp_path):
        (tmp_path / "curve.csv").write_text("whole")
        killed = subprocess.run([sys.executable, "-c", KILLED_WRITER, str(tmp_path / "curve.csv")])
        assert killed.returncode == -signal.SIGKILL
        assert (tmp_path / "curve.csv").read_text() == "whole"
        assert len(names(tmp_path)) == 2, "the killed one left a file"
        writable_folder(tmp_path)
        assert names(tmp_path) == {"curve.csv"}

    def test_of_a_living_writer_and_hidden_files_of_others_stay(self, tmp_path):
        (tmp_path / ".curve-notes.csv").write_text("mine")

        def while_writing(target):
            target.write_text("new")
            remove_leftovers(tmp_path)  # as another process would
            assert target.exists()

        write_whole(tmp_path / "curve.csv", while_writing)
        assert names(tmp_path) == {".curve-notes.csv", "curve.csv"} and (tmp_path / "curve.csv").read_text() == "new"

    def test_nothing_is_left_by_a_writer_that_fails(self, tmp_path):
        with pytest.raises(RuntimeError):
            write_whole(tmp_path / "curve.csv", lambda target: (_ for _ in ()).throw(RuntimeError))
        assert not names(tmp_path)


RUN_JSON = {"status": "finished", "axijax": "0.1.0", "command": [], "message": ""}


def result_folder(folder, status="finished", files=overwrite.FILES, info=RUN_JSON):
    """What a run leaves, without the run."""
    folder.mkdir(parents=True)
    for name in files:
        (folder / name).write_text("a run's")
    (folder / "run.json").write_text(json.dumps({**info, "status": status}))
    return folder


def add(folder, **texts):
    (folder / "snapshots").mkdir(exist_ok=True)
    for name in ("notes.txt", "snapshots/photo.txt", "snapshots/balls_notes.vtu"):
        (folder / name).write_text("mine")
    for name in ("snapshots/balls_0000.vtu", "snapshots/balls.pvd", "snapshots/confined.npy"):
        (folder / name).write_text("a run's")
    return folder


class TestOverwriting:
    def test_only_what_a_run_wrote_goes(self, tmp_path):
        folder = add(result_folder(tmp_path / "out"))
        overwrite.refuse_to_lose(folder, overwrite=True)
        overwrite.clear(folder)
        mine = {"notes.txt", "snapshots/photo.txt", "snapshots/balls_notes.vtu"}
        assert names(folder) == {"run.json", "snapshots", *mine}
        assert all((folder / name).read_text() == "mine" for name in mine)
        assert json.loads((folder / "run.json").read_text())["status"] == "interrupted", "it says that it goes"

    def test_an_empty_folder_of_snapshots_goes_too(self, tmp_path):
        folder = result_folder(tmp_path / "out")
        (folder / "snapshots").mkdir()
        (folder / "snapshots" / "platens.pvd").write_text("a run's")
        overwrite.clear(folder)
        assert names(folder) == {"run.json"}

    @pytest.mark.parametrize("status", ["finished", "failed", "interrupted", "running"])
    def test_the_refusal_lists_what_would_stay(self, tmp_path, status):
        folder = add(result_folder(tmp_path / "out", status))
        with pytest.raises(ValueError) as refused:
            overwrite.refuse_to_lose(folder, overwrite=False)
        assert "leaves notes.txt, snapshots/balls_notes.vtu, snapshots/photo.txt as they are" in str(refused.value)

    @pytest.mark.parametrize("name", [*overwrite.FILES, "run.json", "snapshots/balls_0003.vtu", "snapshots/balls.pvd"])
    @pytest.mark.parametrize("run_json", [None, "", "[1]", '{"status": "finished"}', '{"status": "mine", "axijax": 1}'])
    def test_without_a_run_of_axijax_nothing_of_its_names_is_replaced(self, tmp_path, name, run_json):
        folder = tmp_path / "mine"
        (folder / name).parent.mkdir(parents=True)
        if run_json is not None:
            (folder / "run.json").write_text(run_json)
        (folder / name).write_text("mine" if run_json is None or name != "run.json" else run_json)
        for asked in (True, False):
            with pytest.raises(ValueError, match=r"no sound run\.json") as refused:
                overwrite.refuse_to_lose(folder, overwrite=asked)
            assert name in str(refused.value) and "--output" in str(refused.value)
        before = names(folder)
        overwrite.clear(folder)
        assert names(folder) == before

    def test_other_files_are_no_hindrance(self, tmp_path):
        folder = tmp_path / "mine"
        (folder / "snapshots").mkdir(parents=True)
        (folder / "snapshots" / "photo.txt").write_text("mine")
        overwrite.refuse_to_lose(folder, overwrite=False)

    @pytest.mark.parametrize("kill", range(12))
    def test_killed_while_it_clears_it_never_says_finished_and_can_go_on(self, tmp_path, monkeypatch, kill):
        folder = add(result_folder(tmp_path / "out"))
        unlinked = []

        class Killed(BaseException):
            pass

        def unlink(path, missing_ok=False):
            if not path.name.startswith(".axijax-"):
                if len(unlinked) == kill:
                    raise Killed
                unlinked.append(path.name)
            os.unlink(path) if path.exists() else None

        with monkeypatch.context() as patch:
            patch.setattr(Path, "unlink", unlink)
            try:
                overwrite.clear(folder)
            except Killed:
                assert len(unlinked) == kill
            else:
                assert len(unlinked) == 10 <= kill
        assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
        overwrite.refuse_to_lose(folder, overwrite=True)
        if not names(folder) & {"checkpoint.npz", "case.toml", *overwrite.CURVES}:
            overwrite.refuse_to_lose(folder, overwrite=False)  # nothing is left to be lost

    def test_a_table_and_a_batch_leave_files_of_others_alone(self, tmp_path):
        (tmp_path / "curves.nc").write_text("mine")
        (tmp_path / "table1.csv").write_text("mine\n")
        with pytest.raises(ValueError, match=r"holds table1\.csv, curves\.nc"):
            table1.refuse_to_overwrite(tmp_path)
        (tmp_path / "table1.csv").write_text(",".join(table1.COLUMNS) + "\n")
        table1.refuse_to_overwrite(tmp_path)
        (tmp_path / "summary.csv").write_text("mine\n")
        with pytest.raises(ValueError, match=r"summary\.csv that no batch wrote"):
            run_batch([], tmp_path)
        (tmp_path / "summary.csv").unlink()
        run_batch([], tmp_path)
        run_batch([], tmp_path)


TROUBLES = {
    errno.ENOSPC: ("is full", "make room there, then run it again"),
    errno.EDQUOT: ("is full", "make room there, then run it again"),
    errno.EACCES: ("cannot be written", "see to its permissions, then run it again"),
    errno.EROFS: ("cannot be written", "see to its permissions, then run it again"),
    errno.EIO: ("cannot be written", "see to the disk, then run it again"),
}


class TestWords:
    @pytest.mark.parametrize("number", TROUBLES)
    def test_each_trouble_with_a_folder_has_its_own(self, tmp_path, number):
        with pytest.raises(FolderError) as told, writing_to(tmp_path, lambda: "run it again"):
            raise OSError(number, os.strerror(number))
        for words in (str(tmp_path), os.strerror(number), *TROUBLES[number]):
            assert words in str(told.value)
        assert ("make room" in str(told.value)) == (number in (errno.ENOSPC, errno.EDQUOT))

    def test_a_folder_that_is_gone(self, tmp_path):
        with pytest.raises(FolderError) as told, writing_to(tmp_path / "gone", lambda: "run it again"):
            write_whole(tmp_path / "gone" / "curve.csv", lambda target: target.write_text(""))
        assert "is gone" in str(told.value) and str(told.value).endswith("run it again.")
        assert "room" not in str(told.value)

    def test_a_closed_pipe_is_not_the_folder(self, tmp_path):
        with pytest.raises(BrokenPipeError), writing_to(tmp_path, lambda: "run it again"):
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    def test_the_words_are_said_once(self, tmp_path):
        with pytest.raises(FolderError) as told, writing_to(tmp_path, lambda: "B"), writing_to(tmp_path, lambda: "A"):
            raise OSError(errno.EIO, "no")
        assert str(told.value).count("output folder") == 1 and str(told.value).endswith("then A.")

    def test_ctrl_c_of_a_command_tells_the_way_on(self, tmp_path, capsys):
        with pytest.raises(BaseException) as stopped, filling(tmp_path, "run it again"):
            raise KeyboardInterrupt
        assert stopped.value.exit_code == 130 and capsys.readouterr().err == "axijax: interrupted: run it again.\n"

    def test_a_picture_that_fails_is_a_sentence(self):
        assert draw_afterwards("curve.png", lambda: None) is None
        told = draw_afterwards("curve.png", lambda: 1 / 0)
        assert told == "curve.png could not be drawn (division by zero)"

    def test_names_that_are_no_text(self):
        assert printable(os.fsdecode(b"caf\xe9")) == "caf?" and printable("café $5") == "café $5"


def test_output_that_nobody_reads_ends_without_a_traceback(tmp_path):
    """Not the one that Python adds at its end either, when it tries once more."""
    code = "import sys; from axijax.app.cli.main import main; sys.exit(main(['new', sys.argv[1]]))"
    command, pipe = [sys.executable, "-c", code, str(tmp_path / "a.toml")], subprocess.PIPE
    for buffered in ("", "1"):
        environment = {**os.environ, "PYTHONUNBUFFERED": buffered}
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment) as process:
            process.stdout.close()
            errors = process.stderr.read()
        assert process.returncode == 1
        assert errors == "axijax: standard output was closed by the program that read it\n"
        (tmp_path / "a.toml").unlink()


def test_a_hangup_is_heard_unless_nohup_asks_otherwise():
    before = signal.getsignal(signal.SIGHUP)
    try:
        for handler, heard_of in ((signal.SIG_DFL, True), (signal.SIG_IGN, False)):
            signal.signal(signal.SIGHUP, handler)
            with signals.signals_wait() as check:
                os.kill(os.getpid(), signal.SIGHUP)
                if heard_of:
                    with pytest.raises(KeyboardInterrupt):
                        check()
                else:
                    check()
            assert signal.getsignal(signal.SIGHUP) == handler
    finally:
        signal.signal(signal.SIGHUP, before)


def test_one_process_holds_a_folder(tmp_path):
    with locked(tmp_path), pytest.raises(ValueError, match="in use by a run"), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def test_table1_stops_within_a_moment_of_ctrl_c(monkeypatch):
    """Seven tests of a minute each; the signal comes to the main thread while two of them run."""

    class Slow:
        axial_strain = 0.01

        def run(self, progress):
            for _ in range(6000):
                time.sleep(0.01)
                progress(self)
            raise AssertionError("ran to its end")

        strain, stress_ratio = 0.0, 1.0

    monkeypatch.setattr(table1, "make_test", lambda *_: Slow())
    told = []

    def progress(run, done, ratio):
        told.append(run.name)
        if len(told) == 10:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    started = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            table1.run_table(progress=progress)
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - started < 5 and len(set(told)) == 2
