"""What must not be lost: finished results, files of others, and the numbers under a picture that fails."""

import io
import json
import os
import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from cli_in_process import Called, axijax, write

import axijax as package
from axijax.app import plot, report
from axijax.app.case import Case, load_case
from axijax.app.cli.main import main
from axijax.app.results import open_result
from axijax.specimen.specimen import fcc_octagon

TINY = """
[specimen]
layers = 3
half_width = 5
[parameters]
platen_speed = 0.05
[test]
axial_strain = 0.012
record_every = 50
tolerance = 1e-4
"""
FURTHER = 0.014


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lost")
    called = axijax("run", write(folder / "tiny.toml", TINY), "--output", folder / "tiny")
    assert called.code == 0, called.err
    return folder / "tiny"


@pytest.fixture(scope="module")
def further(finished, tmp_path_factory):
    """The same, taken further without a kill."""
    folder = Path(shutil.copytree(finished, tmp_path_factory.mktemp("lost") / "further"))
    assert axijax("resume", folder, "--axial-strain", FURTHER).code == 0
    return folder


def info_of(folder):
    return json.loads((folder / "run.json").read_text())


def assert_same_curve(folder, other):
    one, two = open_result(folder).curve, open_result(other).curve
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name].values, two[name].values, err_msg=name)


def contents(folder):
    return {path: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


def test_a_second_run_into_the_folder_is_refused_while_the_first_still_packs(tmp_path, monkeypatch):
    case, out = write(tmp_path / "tiny.toml", TINY), tmp_path / "out"
    made, second = Case.made, []

    def packing(self, *told):
        if not second:
            second.append(axijax("run", case, "--output", out, "--overwrite"))
        return made(self)

    monkeypatch.setattr(Case, "made", packing)
    assert axijax("run", case, "--output", out).code == 0
    assert second[0].code == 1 and "in use by a run" in second[0].err
    before = contents(out)
    refused = axijax("run", case, "--output", out)
    assert refused.code == 1 and "holds a finished result" in refused.err and contents(out) == before


def test_ctrl_c_while_packing_leaves_nothing(tmp_path, monkeypatch):
    def packing(self, *told):
        raise KeyboardInterrupt

    monkeypatch.setattr(Case, "made", packing)
    called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", tmp_path / "out")
    assert called.code == 130 and "before anything was written: run the case again" in called.err
    assert "resume" not in called.err and not (tmp_path / "out").exists()


def test_a_case_beside_its_result_is_not_replaced(tmp_path, monkeypatch):
    """`--output .` would write its own case.toml, of which the user's comments are no part."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "case.toml", TINY + "# why: see the notebook\n")
    for extra in ((), ("--overwrite",)):
        called = axijax("run", "case.toml", "--output", ".", *extra)
        assert called.code == 1 and "holds case.toml" in called.err
    assert "notebook" in (tmp_path / "case.toml").read_text()


def test_a_folder_of_others_is_left_alone_and_a_result_beside_other_files_replaced(finished, tmp_path):
    out = tmp_path / "mine"
    (out / "snapshots").mkdir(parents=True)
    (out / "curve.csv").write_text("my notes")
    (out / "snapshots" / "photo.txt").write_text("mine")
    before = contents(out)
    called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", out, "--overwrite")
    assert called.code == 1 and "holds curve.csv" in called.err and contents(out) == before
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    (out / "snapshots").mkdir()
    (out / "snapshots" / "photo.txt").write_text("mine")
    called = axijax("run", tmp_path / "tiny.toml", "--output", out)
    assert called.code == 1 and "leaves snapshots/photo.txt" in called.err
    called = axijax("run", tmp_path / "tiny.toml", "--output", out, "--overwrite", "--snapshots", 1)
    assert called.code == 0, called.err
    assert (out / "snapshots" / "photo.txt").read_text() == "mine" and (out / "snapshots" / "balls.pvd").exists()
    assert_same_curve(out, finished)


class TestAPictureThatFails:
    @pytest.mark.parametrize("friction", [1.0, 1.5])
    def test_friction_at_which_the_formula_locks(self, tmp_path, friction):
        case = write(tmp_path / "f.toml", TINY.replace("[parameters]", f"[parameters]\nfriction = {friction}"))
        called = axijax("run", case, "--output", tmp_path / "f")
        assert called.code == 0 and called.err == "" and info_of(tmp_path / "f")["status"] == "finished"
        assert (tmp_path / "f" / "curve.png").exists() and info_of(tmp_path / "f")["warnings"] == []
        assert plot.thornton_ratio(Case(parameters={"friction": 0.5})) == pytest.approx(2 * 1.5 / 0.5)
        assert plot.thornton_ratio(Case(parameters={"friction": friction})) is None
        assert plot.thornton_ratio(Case(scene={"friction": False})) == 2

    def test_costs_a_warning_and_no_number(self, finished, tmp_path, monkeypatch):
        def broken(*_):
            raise RuntimeError("no fonts")

        monkeypatch.setattr(plot, "curve_figure", broken)
        called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", tmp_path / "out")
        assert called.code == 0 and "warning: curve.png could not be drawn (no fonts)" in called.err
        assert info_of(tmp_path / "out")["status"] == "finished"
        assert info_of(tmp_path / "out")["warnings"] == ["curve.png could not be drawn (no fonts)"]
        assert not (tmp_path / "out" / "curve.png").exists() and (tmp_path / "out" / "curve.csv").exists()
        assert_same_curve(tmp_path / "out", finished)

    def test_costs_a_report_that_picture_alone(self, finished, monkeypatch):
        def broken(*_):
            raise RuntimeError("no fonts")

        monkeypatch.setitem(report.pictures.KINDS, "fabric-rose", broken)
        page = report.report_page([open_result(finished)])
        assert "the picture &#x27;fabric-rose&#x27; could not be drawn (no fonts)" in page
        assert page.count("<img") == 9 and "How to make it again" in page

    def test_costs_plot_that_picture_alone(self, finished, tmp_path, monkeypatch):
        def broken(*_):
            raise RuntimeError("no fonts")

        monkeypatch.setitem(plot.CURVES, "curve", broken)
        called = axijax("plot", finished, "--kind", "curve", "--kind", "fabric-rose", "--output", tmp_path)
        assert called.code == 0 and "warning: curve.png could not be drawn (no fonts)" in called.err
        assert {path.name for path in tmp_path.iterdir()} == {"fabric-rose.png"}
        called = axijax("plot", finished, "--output", tmp_path)
        assert called.code == 1 and called.err == "axijax: curve.png could not be drawn (no fonts).\n"

    def test_names_that_are_no_mathematics_and_no_text(self, finished, tmp_path):
        case = write(tmp_path / os.fsdecode(b"caf\xe9 $\\frac$.toml"), TINY)
        called = axijax("run", case, "--output", tmp_path / "out")
        assert called.code == 0 and called.err == "" and info_of(tmp_path / "out")["name"] == "caf? $\\frac$"
        assert (tmp_path / "out" / "curve.png").exists() and "$\\frac$" in (tmp_path / "out" / "curve.csv").read_text()
        figure = plot.curve_figure([replace(open_result(finished), name="$5 $\\frac$")])
        plot.save_figure(figure, tmp_path / "a.png")
        shown = figure.legends[0].get_texts()[0].get_text()
        assert shown.replace(r"\$", "$") == "$5 $\\frac$"


def test_a_run_never_says_running_for_ever(finished, tmp_path, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("out of memory")

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("axijax.app.runs.TriaxialTest.run", broken)
        called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", out)
    assert called.code == 1 and "out of memory" in called.err
    assert info_of(out)["status"] == "interrupted" and info_of(out)["message"] == "stopped by out of memory"
    with monkeypatch.context() as patch:  # and a snapshot that cannot be made costs a warning
        patch.setattr("axijax.app.paraview.snapshot", broken)
        called = axijax("run", tmp_path / "tiny.toml", "--output", out, "--overwrite", "--snapshots", 1)
    assert called.code == 0 and "axial strain could not be made (out of memory)" in called.err
    assert len(info_of(out)["warnings"]) == 1
    assert_same_curve(out, finished)


class Killed(BaseException):
    """In place of SIGKILL: nothing of the program's sees to it but `finally`."""


def killed_at(moment, monkeypatch, *arguments):
    """Call the command line and kill it before its so-many-th file is put in place or removed; whether it was."""
    done, replace_file, unlink = [], Path.replace, Path.unlink

    def step(path):
        if path.name.startswith(".axijax-"):  # a leftover
            return
        if len(done) == moment:
            done.append("killed")
        if "killed" in done:
            raise Killed
        done.append(path.name)

    def replacing(path, target):
        step(Path(target))
        return replace_file(path, target)

    def unlinking(path, missing_ok=False):
        step(path)
        return unlink(path, missing_ok=missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replacing)
        patch.setattr(Path, "unlink", unlinking)
        try:
            axijax(*arguments)
        except Killed:
            return True
    return False


def test_going_further_killed_between_any_two_files_is_consistent(finished, further, tmp_path, monkeypatch):
    moment, killed, reached = 0, True, float(open_result(finished).curve.axial_strain[-1])
    while killed:
        folder = Path(shutil.copytree(finished, tmp_path / str(moment)))
        killed = killed_at(moment, monkeypatch, "resume", folder, "--axial-strain", FURTHER)
        status, wanted = info_of(folder)["status"], load_case(folder / "case.toml").test.axial_strain
        curve = open_result(folder).curve  # at every moment there is one
        if status == "finished":
            assert (folder / "curve.nc").exists()
            assert_same_curve(folder, finished if wanted == 0.012 else further)
        else:
            assert status == "running" and float(curve.axial_strain[-1]) >= reached
        if killed:
            again = ("--axial-strain", FURTHER) if wanted == 0.012 else ()
            assert axijax("resume", folder, *again).code == (0 if status == "running" or again else 1)
        assert_same_curve(folder, further)
        moment += 1
    assert moment > 8, "run.json, case.toml, four curves, checkpoint, curve.nc, curve.csv, run.json, curve.png"


class TestWords:
    def test_output_that_nobody_reads_stops_at_a_checkpoint(self, finished, tmp_path):
        class Closed(io.StringIO):
            def write(self, text):
                if "confined" in text:
                    raise BrokenPipeError(32, "Broken pipe")
                return super().write(text)

        out = tmp_path / "out"
        called = self.called_with(Closed(), "run", write(tmp_path / "tiny.toml", TINY), "--output", out)
        assert called.code == 130 and f"axijax resume {out}" in called.err and "Broken pipe" in called.err
        assert "room" not in called.err and info_of(out)["status"] == "interrupted"
        assert axijax("resume", out).code == 0
        assert_same_curve(out, finished)

    def called_with(self, stdout, *arguments):
        errors = io.StringIO()
        with redirect_stdout(stdout), redirect_stderr(errors):
            code = main([str(argument) for argument in arguments])
        return Called(code, stdout.getvalue(), errors.getvalue())

    def test_a_folder_that_is_removed(self, tmp_path, monkeypatch):
        monkeypatch.setattr("axijax.app.cli.run._PlainLines.tell", lambda *_: shutil.rmtree(tmp_path / "out", True))
        called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", tmp_path / "out")
        assert called.code == 1 and "is gone" in called.err and called.err.endswith("run the case again.\n")
        assert "room" not in called.err and "resume" not in called.err

    def test_no_promise_where_nothing_was_written(self, tmp_path, monkeypatch):
        def full(path, write):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("axijax.app.runs.write_whole", full)
        called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", tmp_path / "out")
        assert called.code == 1 and "make room there, then run the case again" in called.err
        assert "resume" not in called.err

    def test_no_promise_without_a_run_json(self, finished, tmp_path):
        out = Path(shutil.copytree(finished, tmp_path / "out"))
        (out / "run.json").unlink()
        for command in ("resume", "run"):
            what = out if command == "resume" else write(tmp_path / "tiny.toml", TINY)
            called = axijax(command, what, *(() if command == "resume" else ("--output", out)))
            assert called.code == 1 and "`axijax resume" not in called.err

    def test_a_run_that_hardly_began_is_no_hindrance(self, finished, tmp_path, monkeypatch):
        out, case = tmp_path / "out", write(tmp_path / "tiny.toml", TINY)
        assert killed_at(1, monkeypatch, "run", case, "--output", out)
        assert {path.name for path in out.iterdir()} == {"run.json"} and info_of(out)["status"] == "running"
        assert axijax("run", case, "--output", out).code == 0
        assert_same_curve(out, finished)

    def test_32_bits_are_named(self, tmp_path):
        test = Case(specimen={"layers": 3, "half_width": 5}).build()
        jax.config.update("jax_enable_x64", False)
        try:
            for build in (
                lambda: Case().build(),
                test.run,
                lambda: test.simulate(test.params),
                lambda: package.random_cylinder(40, package.Sector(4)),
            ):
                with pytest.raises(ValueError, match=r"64-bit numbers are switched off.*jax_enable_x64"):
                    build()
            called = axijax("run", write(tmp_path / "tiny.toml", TINY), "--output", tmp_path / "out")
            assert called.code == 1 and "jax_enable_x64" in called.err and not (tmp_path / "out").exists()
        finally:
            jax.config.update("jax_enable_x64", True)


def test_a_specimen_is_its_own_whatever_becomes_of_the_arrays_it_was_made_from():
    like = fcc_octagon(layers=3, half_width=5)
    given = {name: np.array(getattr(like, name)) for name in ("positions", "radius", "membrane_zone")}
    mine = replace(like, **given)
    for array in given.values():
        array[...] = 0
    for name in given:
        np.testing.assert_array_equal(getattr(mine, name), getattr(like, name))
