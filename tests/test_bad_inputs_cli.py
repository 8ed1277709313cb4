"""Files, fields, values, damaged results that make no sense: one sentence, a non-zero exit code, nothing half-written.

With AXIJAX_BAD_INPUTS=FILE the table of what was tried and what it was told is written to FILE (Markdown).
"""

import fcntl
import json
import os
import shutil
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from bad_input_cases import CASES, USAGE
from bad_input_ways import status
from cli_in_process import axijax, write

TOLD: dict[str, tuple[str, int]] = {}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished result, to be copied and damaged."""
    folder = tmp_path_factory.mktemp("finished")
    assert axijax("run", write(folder / "small.toml"), "--output", folder / "small").code == 0
    return folder / "small"


@pytest.fixture(scope="module", autouse=True)
def table():
    yield
    if "AXIJAX_BAD_INPUTS" in os.environ:
        rows = [f"| {what} | {message.replace('|', '/')} | {code} |" for what, (message, code) in TOLD.items()]
        text = ["| input | message | exit code |", "|---|---|---|", *rows]
        Path(os.environ["AXIJAX_BAD_INPUTS"]).write_text("\n".join(text) + "\n")


def told(called, folder):
    """The sentence without the folders of this test run."""
    return called.err.strip().replace(f"{folder}/", "").replace(str(folder), ".").removeprefix("axijax: ")


def assert_nothing_looks_whole(folder, before):
    """What is new beside a run that did not finish: no curve, no leftovers of writing."""
    for path in set(folder.rglob("*")) - before:
        assert not path.name.startswith("."), f"{path} was left over"
        if path.name.startswith("curve."):
            assert json.loads((path.parent / "run.json").read_text())["status"] == "finished", path


@dataclass(frozen=True)
class Packed:
    """What a sought void ratio is compared with, of a packing that is not made: test_random_packing.py makes them."""

    counted_void_ratio: float = 0.5
    grading: str = ""
    seed: int = 0
    fractions: tuple = ()
    warnings: tuple = ()
    sieves: tuple = ()


@pytest.mark.parametrize("case", CASES)
def test_one_sentence_and_nothing_half_written(case, tmp_path, finished, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("axijax.triaxial.random_specimen._compacted", lambda *_: (None, Packed()))
    make, words = CASES[case]
    arguments = make(tmp_path, finished)
    before = set(tmp_path.rglob("*"))
    old = {path: path.read_bytes() for path in before if path.is_file()}
    called = axijax(*arguments)
    message = called.err.strip()
    shown = told(called, tmp_path)
    TOLD[case] = shown, called.code
    assert called.code == (2 if case in USAGE else 1)
    for word in words:
        assert word in message
    assert message.startswith("axijax: ") and "Traceback" not in message
    assert "\n" not in message and len(shown) < 360, "one sentence"
    assert_nothing_looks_whole(tmp_path, before)
    assert all(path.read_bytes() == content for path, content in old.items()), "what was there is as it was"


@contextmanager
def held(folder):
    handle = os.open(folder, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        os.close(handle)


def test_a_folder_in_use_is_left_alone(finished, tmp_path):
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    status("running")(out)
    with held(out):
        for arguments in (("run", write(tmp_path / "a.toml"), "--output", out), ("resume", out)):
            called = axijax(*arguments)
            TOLD["a folder that another run is using"] = told(called, tmp_path), called.code
            assert called.code == 1 and "in use by a run" in called.err
    assert (out / "curve.nc").exists()


def test_a_full_disk_during_a_checkpoint(tmp_path, monkeypatch):
    def full(file, **arrays):
        file.write(b"half a checkpoint")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        called = axijax("run", write(tmp_path / "a.toml"), "--output", tmp_path / "out")
    TOLD["a disk that is full"] = told(called, tmp_path), called.code
    assert called.code == 1 and "No space left" in called.err and "axijax resume" in called.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"case.toml", "run.json"}
