"""Whatever goes wrong around a command, it ends in one sentence and an exit code."""

import os
import resource
import subprocess
import sys
import warnings

import pytest
from cli_in_process import axijax, write

from axijax.app.cli import main as cli
from axijax.app.cli.errors import LEAST_MEMORY, guarded
from axijax.core import platform


def process(folder, *arguments, **options):
    """The command line in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "axijax", *arguments], cwd=folder, capture_output=True, text=True, timeout=120, **options
    )


def sentence(text):
    lines = text.splitlines()
    assert len(lines) == 1 and lines[0].startswith("axijax: "), text
    return lines[0]


@pytest.mark.parametrize("platforms", ["cuda", "banana"])
def test_a_device_that_is_not_there(tmp_path, platforms):
    write(tmp_path / "a.toml")
    called = process(tmp_path, "check", "a.toml", env={**os.environ, "JAX_PLATFORMS": platforms})
    assert called.returncode == 1 and f"JAX_PLATFORMS = '{platforms}'" in sentence(called.stderr)


def test_closed_standard_streams(tmp_path):
    """`>&-` and `2>&-`: Python has no stream there, and the next file that is opened would take its number."""
    write(tmp_path / "a.toml")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "curve.csv").write_text("mine")
    command = f"{sys.executable} -m axijax run a.toml --output out"
    for closed, told in ((">&-", True), ("<&- >&- 2>&-", False)):
        called = subprocess.run(f"{command} {closed}", shell=True, cwd=tmp_path, capture_output=True, text=True)
        assert called.returncode == 1 and called.stdout == ""
        assert "holds curve.csv but no sound run.json" in sentence(called.stderr) if told else called.stderr == ""
    assert (tmp_path / "out" / "curve.csv").read_text() == "mine"
    assert subprocess.run(f"{sys.executable} -m axijax new b.toml >&-", shell=True, cwd=tmp_path).returncode == 0
    assert (tmp_path / "b.toml").read_text().startswith("# A triaxial test")


def test_a_full_standard_output(tmp_path):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "axijax", "new", "a.toml"]
        called = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True)
    assert called.returncode == 1 and "standard output cannot be" in sentence(called.stderr)


def test_a_memory_limit_below_what_jax_needs(tmp_path):
    write(tmp_path / "a.toml")

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, (LEAST_MEMORY // 2, resource.RLIM_INFINITY))

    called = process(tmp_path, "check", "a.toml", preexec_fn=limit)
    assert called.returncode == 1 and "memory limit of 1 GB" in sentence(called.stderr)


def test_no_home(monkeypatch):
    """A user without a home folder, as in a container: no cache, and a warning."""

    def homeless(path):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(platform.Path, "expanduser", homeless)
    for name in ("XDG_CACHE_HOME", platform.CACHE_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    before = platform.jax.config.jax_compilation_cache_dir  # another test of this process may have set one
    platform.jax.config.update("jax_compilation_cache_dir", None)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            assert platform.use_compilation_cache() is None
    finally:
        platform.jax.config.update("jax_compilation_cache_dir", before)
    assert "no home folder" in str(caught[0].message)


class OtherError(Exception):
    pass


WRONG = {
    "no memory": (MemoryError("Unable to allocate 745. GiB"), 1, "not enough memory for it (Unable to allocate 745"),
    "no memory on a device": (RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nallocating 5"), 1, "not enough memory"),
    "nested": (RecursionError(), 1, "nested too deeply"),
    "interrupted": (KeyboardInterrupt(), 130, "interrupted"),
    "a fault of ours": (OtherError("two\nlines"), 1, "internal error, OtherError (two lines): this is a fault of"),
    "number too large": (OverflowError("int too large"), 1, "internal error, OverflowError"),
    "of the system": (PermissionError(13, "Permission denied", "x.csv"), 1, "'x.csv' cannot be read or written (Perm"),
    "two lines": (ValueError("one\ntwo."), 1, "one two."),
}


@pytest.mark.parametrize("case", WRONG)
def test_one_sentence_for(case, capsys, monkeypatch):
    error, code, words = WRONG[case]

    def work():
        raise error

    monkeypatch.delenv("AXIJAX_TRACEBACK", raising=False)
    assert guarded(work, []) == code
    assert words in sentence(capsys.readouterr().err)


def test_the_traceback_of_a_fault_of_ours_can_be_seen(monkeypatch):
    monkeypatch.setenv("AXIJAX_TRACEBACK", "1")

    def work():
        raise OtherError

    with pytest.raises(OtherError):
        guarded(work, [])


def test_ctrl_c_between_two_moments(monkeypatch, tmp_path):
    """The library of the command line catches it first."""

    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("axijax.app.forecast.forecast", interrupted)
    called = axijax("check", write(tmp_path / "a.toml"))
    assert called.code == 130 and "Traceback" not in called.err
    assert cli.main(["--version"]) == 0
