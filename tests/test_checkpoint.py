"""A shear stopped, saved, loaded and gone on with is the shear that never stopped, to the last bit."""

import json
import re
import zipfile
from dataclasses import fields, replace

import jax
import numpy as np
import pytest

from axijax import Dashpot, Linear, LocalDamping, Params, Scene
from axijax.core.sector import Sector
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial import progress
from axijax.triaxial import test as triaxial
from axijax.triaxial.checkpoint import VERSION, load_progress, save_progress
from axijax.triaxial.test import TriaxialTest

STOP, END = 0.03, 0.06


@pytest.fixture(scope="module")
def test_of():
    """A small specimen that is rebuilt a few times on the way to 6 %, stopped at a strain."""
    whole = TriaxialTest(
        fcc_octagon(layers=7, half_width=5), params=Params(platen_speed=0.06), axial_strain=END, tolerance=1e-5
    )
    return lambda strain: replace(whole, axial_strain=strain)


@pytest.fixture(scope="module")
def unbroken(test_of):
    """The run that never stopped, how often its lists were made anew, with nothing shown or saved."""
    rebuilt = []
    original = progress.rebuild_on_host

    def counted(*args):
        rebuilt.append(1)
        return original(*args)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "rebuild_on_host", counted)
        return test_of(END).run(), len(rebuilt)


@pytest.fixture(scope="module")
def stopped(test_of, tmp_path_factory):
    """The checkpoint of a run that stopped early, after its lists were made anew."""
    path = tmp_path_factory.mktemp("checkpoint") / "shear.npz"
    test_of(STOP).run(checkpoint=path)
    return path


def assert_same(run, other):
    """Every array of two runs, bit for bit."""
    for (name, a), (_, b) in zip(jax.tree.leaves_with_path(run), jax.tree.leaves_with_path(other), strict=True):
        assert np.asarray(a).dtype == np.asarray(b).dtype, name
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b), err_msg=str(name))


def test_n_and_m_steps_are_n_plus_m(test_of, unbroken, stopped):
    run, rebuilds = unbroken
    assert rebuilds >= 2, "the test must see lists that were made anew"
    test = test_of(END)
    start = load_progress(stopped, test)
    assert STOP <= start.strain < 0.6 * END
    assert_same(test.run(start=start), run)


def test_saving_twice_changes_nothing(test_of, stopped, tmp_path):
    """What is read is what was written, types of numbers included."""
    test = test_of(END)
    once = load_progress(stopped, test)
    save_progress(tmp_path / "again.npz", test, once)
    again = load_progress(tmp_path / "again.npz", test)
    assert_same(once, again)
    assert [type(a) for a in jax.tree.leaves(once)] == [type(a) for a in jax.tree.leaves(again)]
    assert isinstance(again.params.friction, float)


def test_output_changes_nothing(test_of, unbroken, tmp_path, monkeypatch):
    """Progress shown and a checkpoint after every segment, or neither."""
    monkeypatch.setattr(triaxial, "CHECKPOINT_SECONDS", 0.0)
    seen = []
    run = test_of(END).run(progress=lambda now: seen.append(now.strain), checkpoint=tmp_path / "shear.npz")
    assert len(seen) > 3
    assert_same(run, unbroken[0])


def test_an_interrupted_run_can_go_on(test_of, unbroken, tmp_path):
    path, test = tmp_path / "shear.npz", test_of(END)

    def interrupt(now):
        if now.strain > STOP:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        test.run(progress=interrupt, checkpoint=path)
    assert [file.name for file in tmp_path.iterdir()] == ["shear.npz"], "no leftovers beside it"
    assert_same(test.run(start=load_progress(path, test)), unbroken[0])


def test_a_failed_write_leaves_the_last_checkpoint(test_of, stopped, tmp_path, monkeypatch):
    test, path = test_of(END), tmp_path / "shear.npz"
    path.write_bytes(stopped.read_bytes())
    start = load_progress(path, test)

    def full(file, **arrays):
        file.write(b"half a checkpoint")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space"):
        save_progress(path, test, start)
    assert path.read_bytes() == stopped.read_bytes()
    assert [file.name for file in tmp_path.iterdir()] == ["shear.npz"]


def test_other_parameters_come_back(test_of, tmp_path):
    """Those of the run, not the test's; a friction per ball, a fixed load and no spins included."""
    base = test_of(STOP)
    friction = np.linspace(0.1, 0.3, len(base.cut))
    params = replace(base.params, friction=friction, platen_speed=0.05)
    test = replace(base, scene=Scene(rotation=False), refresh=False, axial_strain=0.002)
    test.run(params, checkpoint=tmp_path / "shear.npz")
    start = load_progress(tmp_path / "shear.npz", test)
    np.testing.assert_array_equal(start.params.friction, friction)
    assert start.params.platen_speed == 0.05
    assert start.state.spin is None and start.fixed is not None
    longer = replace(test, axial_strain=0.012)
    assert_same(longer.run(start=start), longer.run(params))


def damaged(stopped, tmp_path, **changes):
    """A copy of a checkpoint with arrays added, replaced or (None) left out."""
    with np.load(stopped) as archive:
        arrays = {**archive, **changes}
    path = tmp_path / "damaged.npz"
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def of_header(stopped, **changes):
    with np.load(stopped) as archive:
        return np.array(json.dumps({**json.loads(str(archive["header"])), **changes}))


def written(tmp_path, content):
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    return path


def flipped(path):
    """With one bit of its largest array turned; between the arrays there are bytes that mean nothing."""
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda each: each.file_size)
    content = path.read_bytes()
    middle = largest.header_offset + largest.file_size // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


# What lies where the checkpoint should be, and the words that the sentence must hold.
FOREIGN = {
    "nothing": (lambda stopped, tmp: tmp / "none.npz", ["cannot be read", "No such file"]),
    "a folder": (lambda stopped, tmp: tmp, ["cannot be read"]),
    "an empty file": (lambda stopped, tmp: written(tmp, b""), ["damaged or no checkpoint"]),
    "text": (lambda stopped, tmp: written(tmp, b"axial_strain,stress_ratio\n0,1\n"), ["damaged or no checkpoint"]),
    "half of one": (
        lambda stopped, tmp: written(tmp, stopped.read_bytes()[: stopped.stat().st_size // 2]),
        ["damaged or no checkpoint"],
    ),
    "all but the end": (lambda stopped, tmp: written(tmp, stopped.read_bytes()[:-30]), ["damaged or no checkpoint"]),
    "one flipped bit": (lambda stopped, tmp: written(tmp, flipped(stopped)), ["damaged or no checkpoint"]),
    "other arrays": (lambda stopped, tmp: damaged(stopped, tmp, header=None), ["damaged or no checkpoint"]),
    "another header": (
        lambda stopped, tmp: damaged(stopped, tmp, header=of_header(stopped, format="a novel")),
        ["damaged or no checkpoint"],
    ),
    "a header that is a list": (
        lambda stopped, tmp: damaged(stopped, tmp, header=np.array("[1, 2]")),
        ["damaged or no checkpoint"],
    ),
    "a later version": (
        lambda stopped, tmp: damaged(stopped, tmp, header=of_header(stopped, version=99)),
        ["format version 99", f"reads {VERSION}"],
    ),
    "an array short": (lambda stopped, tmp: damaged(stopped, tmp, **{"state.time": None}), ["'state.time'"]),
    "an array too many": (lambda stopped, tmp: damaged(stopped, tmp, poem=np.zeros(3)), ["'poem'"]),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_foreign_file_is_refused_in_one_clear_sentence(case, test_of, stopped, tmp_path):
    make, words = FOREIGN[case]
    with pytest.raises(ValueError) as caught:
        load_progress(make(stopped, tmp_path), test_of(END))
    message = str(caught.value)
    for word in ("checkpoint '", *words):
        assert word in message
    assert message.endswith(".") and "\n" not in message and len(message.replace(str(tmp_path), "")) < 200


OTHER_TESTS = {
    "specimen": {"specimen": fcc_octagon(layers=5, half_width=5)},
    "sector": {"sector": Sector(1)},
    "scene": {"scene": Scene(rotation=False)},
    "params": {"params": Params(platen_speed=0.06, damping=LocalDamping())},
    "time_step": {"time_step": 0.02},
    "record_every": {"record_every": 25},
    "tolerance (1e-06 here, 1e-05 there)": {"tolerance": 1e-6},
    "confining_friction (0.1 here, 0.0 there)": {"confining_friction": 0.1},
    "confine_steps": {"confine_steps": 30_000},
}


@pytest.mark.parametrize("name", OTHER_TESTS)
def test_another_test_is_refused_by_name(name, test_of, stopped):
    with pytest.raises(ValueError, match=re.escape(name)) as caught:
        load_progress(stopped, replace(test_of(END), **OTHER_TESTS[name]))
    assert "of another test" in str(caught.value)


def test_parameters_beside_a_start_are_refused(test_of, stopped):
    test = test_of(END)
    with pytest.raises(ValueError, match="params"):
        test.run(Params(), start=load_progress(stopped, test))


def test_every_part_of_a_progress_is_written(stopped):
    with np.load(stopped) as archive:
        parts = {name.split(".")[0] for name in archive.files}
        params = {name for name in archive.files if name.startswith("params.")}
    assert parts == {*progress.Progress._fields, "header"} - {"fixed"}
    names = {"material." + each.name for each in fields(Linear)} | {each.name for each in fields(Params)}
    parts_or_not_there = ("platen_friction", "plane_friction", "damping", "rolling", "torsion")
    gone = {"material", "terms", *(f"material.{name}" for name in parts_or_not_there)}
    expected = names - gone | {"material.damping." + each.name for each in fields(Dashpot)}
    assert params == {"params." + name for name in expected}, "the names in the file are the fields' names"
