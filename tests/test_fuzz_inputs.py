"""Fuzz: whatever stands in a case file, a run.json or a checkpoint is accepted, or refused by one sentence.

Some two hundred inputs; AXIJAX_FUZZ=5000 tries as many of each kind. What is accepted is not run: the program is
stopped where the first step would be taken.
"""

import io
import json
import os
import resource
import shutil
import struct
import zipfile

import numpy as np
import pytest
from cli_in_process import SMALL, axijax, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from axijax.app.case import KINDS, SECTIONS
from axijax.app.results import INFO, STATUSES, open_results
from axijax.triaxial.test import TriaxialTest

COUNT = int(os.environ.get("AXIJAX_FUZZ", "50"))
MOST_MEMORY = 2 * 2**30  # by which the process may grow, whatever an input claims [bytes]
FUZZ = settings(
    max_examples=COUNT, deadline=None, derandomize=COUNT == 50, database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture, HealthCheck.data_too_large],
)  # fmt: skip
ACCEPTED = "the test was accepted"


@pytest.fixture(scope="module", autouse=True)
def nothing_runs():
    """No step is taken and no random specimen is packed; everything before that is done."""

    def run(self, *args, **options):
        raise ValueError(ACCEPTED)

    def packed(*args):
        raise ValueError(ACCEPTED)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("axijax.app.case._packed", packed)
        patch.setattr(TriaxialTest, "run", run)
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished result, to be copied and damaged; made without the patch above."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TriaxialTest, "run", RUN)
        assert axijax("run", write(folder / "small.toml"), "--output", folder / "small").code == 0
    return folder / "small"


RUN = TriaxialTest.run


def memory():
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def told(*arguments):
    """What a command says; that it is one sentence and an exit code, and takes no memory to speak of."""
    before = memory()
    called = axijax(*arguments)
    assert memory() - before < MOST_MEMORY
    assert "Traceback" not in called.err and "internal error" not in called.err, called.err[-2000:]
    lines = [line for line in called.err.splitlines() if not line.startswith("axijax: warning: ")]
    assert (called.code == 0) == (not lines), (called.code, called.err)
    assert called.code in (0, 1, 2) and len(lines) <= 1
    for line in lines:
        assert line.startswith("axijax: ") and len(line) > 20 and len(line) < 2000, line
    return called


# Values that TOML and JSON can hold, the awkward ones among them often.
AWKWARD = st.sampled_from(
    [0, -1, 1, 3, 10**20, -(10**20), 2**31, 2**63, 10**400, 99999, 1e300, -1e300, 1e-300, 5e-324, float("inf"),
     float("nan"), -0.0, True, False, "", "nan", "octagon", "../x", "\0", "\ud7ff", "x" * 5000, [], {}, [[]], [1, "a"]]
)  # fmt: skip
VALUES = st.one_of(
    AWKWARD, st.integers(), st.floats(), st.booleans(), st.text(max_size=20),
    st.lists(st.integers(), max_size=3), st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)  # fmt: skip
FIELDS = [(section, name) for section, (model, _) in SECTIONS.items() for name in model.model_fields]


def toml(value):
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return {"inf": "inf", "-inf": "-inf", "nan": "nan"}.get(str(value), repr(value))
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value).replace("\x7f", "\\u007f") if isinstance(value, str) else str(value)


@st.composite
def cases(draw):
    """A small case with a few fields changed to anything, or to a number that is allowed."""
    kind = draw(st.sampled_from(list(KINDS)))
    small = {"octagon": {"half_width": 3, "layers": 2}, "random": {}}.get(kind, {"specimen_radius": 80.0, "layers": 2})
    changed = {"specimen": {"kind": kind, **small}}
    if kind == "hcp":
        changed["sector"] = {"order": 3}
    for section, name in draw(st.lists(st.sampled_from(FIELDS), max_size=4)):
        scale = draw(st.sampled_from([1e-20, 1e-3, 1.0, 1e3, 1e20]))
        value = draw(st.one_of(VALUES, st.floats(0.1, 10).map(lambda number, scale=scale: number * scale)))
        changed.setdefault(section, {})[name] = value
    if draw(st.integers(0, 9)) == 0:
        changed[draw(st.text(max_size=8))] = draw(VALUES)
    lines = []
    for section, fields in changed.items():
        if isinstance(fields, dict):
            lines += [f"[{json.dumps(section)}]", *(f"{json.dumps(n)} = {toml(v)}" for n, v in fields.items())]
        else:
            lines.insert(0, f"{json.dumps(section)} = {toml(fields)}")
    return "\n".join(lines)


@FUZZ
@given(cases())
def test_any_case_file_is_accepted_or_refused(tmp_path_factory, text):
    folder = tmp_path_factory.mktemp("case", numbered=True)
    (folder / "case.toml").write_text(text, encoding="utf-8", errors="replace")
    assert told("run", folder / "case.toml", "--output", folder / "out").code != 0
    shutil.rmtree(folder)


@pytest.mark.parametrize("value", [10**20, 2**31, 1e300, "\0"])
def test_the_same_awkward_value_in_each_field(tmp_path, value):
    """What the fuzz meets only now and then."""
    kinds = {name: kind for kind, (names, _) in KINDS.items() for name in names}
    for section, name in FIELDS:
        kind = kinds.get(name, "octagon") if section == "specimen" else "octagon"
        lines = [f"kind = '{kind}'", *(["half_width = 3", "layers = 2"] if kind == "octagon" else [])]
        lines = [line for line in lines if not line.startswith(f"{name} ")]
        head = "" if section == "specimen" else f"[{section}]\n"
        text = "[specimen]\n" + "\n".join(lines) + f"\n{head}{name} = {toml(value)}\n"
        assert told("run", write(tmp_path / "case.toml", text), "--output", tmp_path / "out").code != 0


@FUZZ
@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace"))))
def test_any_bytes_are_no_case_file(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("bytes", numbered=True)
    (folder / "case.toml").write_bytes(content)
    assert told("run", folder / "case.toml", "--output", folder / "out").code != 0
    shutil.rmtree(folder)


NAMES = st.sampled_from([*INFO, "packing", "balls"])


@FUZZ
@given(
    st.dictionaries(NAMES, st.one_of(VALUES, st.sampled_from(STATUSES)), max_size=3),
    st.sets(NAMES, max_size=1),
    st.sampled_from(["resume", "resume --axial-strain 0.02", "open"]),
)
def test_any_run_json_is_accepted_or_refused(finished, tmp_path_factory, changes, without, command):
    folder = tmp_path_factory.mktemp("json", numbered=True) / "out"
    shutil.copytree(finished, folder)
    info = {**json.loads((folder / "run.json").read_text()), **changes}
    (folder / "run.json").write_text(json.dumps({name: value for name, value in info.items() if name not in without}))
    if command == "open":  # what `check`, `report` and `plot` read of it, without a picture of each
        try:
            open_results(folder)
        except ValueError as error:
            assert "\n" not in str(error)
    else:
        name, *options = command.split()
        told(name, folder, *options)
    shutil.rmtree(folder.parent)


def packed_again(path, arrays):
    """An archive as numpy.savez writes it, of bytes."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)


def npy(array):
    target = io.BytesIO()
    np.save(target, array)
    return target.getvalue()


ARRAYS = st.one_of(
    st.sampled_from([np.zeros(()), np.zeros(0), np.zeros((3, 0)), np.full(3, np.nan), np.zeros((26, 26))]),
    st.sampled_from([np.zeros(26), np.zeros(88), np.full(26, 1e300), np.arange(26), np.full(88, -7, np.int32)]),
    st.just(np.array("a")),
    st.floats().map(np.array), st.integers(-(2**62), 2**62).map(np.array), st.booleans().map(np.array),
)  # fmt: skip


@FUZZ
@given(st.data())
def test_any_checkpoint_is_accepted_or_refused(finished, tmp_path_factory, data):
    """Arrays exchanged, added and left out; headers that claim anything; bytes changed."""
    folder = tmp_path_factory.mktemp("checkpoint", numbered=True) / "out"
    shutil.copytree(finished, folder)
    path = folder / "checkpoint.npz"
    with zipfile.ZipFile(path) as archive:
        arrays = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    way = data.draw(st.sampled_from(["array", "header", "claim", "bytes", "cut"]))
    if way == "array":
        name = data.draw(st.sampled_from([*arrays, "poem"]))
        arrays[name] = npy(data.draw(ARRAYS))
        packed_again(path, arrays)
    elif way == "header":
        header = json.loads(str(np.load(io.BytesIO(arrays["header"]))[()]))
        header[data.draw(st.sampled_from(list(header)))] = data.draw(VALUES.filter(lambda v: v != 10**400))
        arrays["header"] = npy(np.array(json.dumps(header)))
        packed_again(path, arrays)
    elif way == "claim":
        shape = data.draw(st.lists(st.integers(-1, 10**12), max_size=3))
        kind = data.draw(st.sampled_from(["<f8", "<i4", "|O", "<U9", "|V0", "nonsense"]))
        text = str({"descr": kind, "fortran_order": False, "shape": tuple(shape)}).encode() + b"\n"
        name = data.draw(st.sampled_from(list(arrays)))
        arrays[name] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(16)
        packed_again(path, arrays)
    else:
        content = bytearray(path.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1))
        if way == "cut":
            del content[place:]
        else:
            content[place] ^= data.draw(st.integers(1, 255))
        path.write_bytes(content)
    told("resume", folder, "--axial-strain", "0.02")
    shutil.rmtree(folder.parent)


def test_what_is_sound_is_accepted(finished, tmp_path):
    """Without which the fuzz could refuse everything."""
    folder = shutil.copytree(finished, tmp_path / "out")
    assert ACCEPTED in told("resume", folder, "--axial-strain", "0.02").err
    assert ACCEPTED in told("run", write(tmp_path / "case.toml", SMALL), "--output", tmp_path / "new").err


def test_a_header_that_claims_800_gigabytes(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "out")
    with zipfile.ZipFile(folder / "checkpoint.npz") as archive:
        arrays = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000,)}\n"
    arrays["state.time"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text
    packed_again(folder / "checkpoint.npz", arrays)
    before = memory()
    assert "damaged or no checkpoint" in told("resume", folder, "--axial-strain", "0.02").err
    assert memory() - before < 2**28
