"""Batches: equal to single runs, failures kept apart, resumed, shared by two processes; the cache of programs."""

import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
import time
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import axijax
from axijax.app.batch import Member, open_batch, parameter_grid, run_batch, simulate_many
from axijax.app.batch_files import identity
from axijax.app.cli.batch import load_sweep
from axijax.app.labels import Lines
from axijax.app.results import open_results
from axijax.core import platform
from axijax.core.parallel import parallel
from axijax.triaxial.records import records_of

sys.path.insert(0, str(Path(__file__).parent))
from batch_process import FRICTION, members, tiny

FAILING = "friction=-1"


def same(a: axijax.Curve, b: axijax.Curve) -> bool:
    """Whether two curves are equal to the last bit."""
    assert list(records_of(a)) == list(records_of(b))
    return all(np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True) for name in records_of(a))


@pytest.fixture(scope="module")
def singles():
    """The good members' curves, each from a run of its own."""
    return {m.name: m.test.run(m.params).curve for m in members() if m.name != FAILING}


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """The members and one of another specimen (of the same shape: nothing more to compile), in a folder."""
    folder = tmp_path_factory.mktemp("batch")
    other = Member("large", tiny(radius=40.0), labels={"radius": 40.0, "damping": "dashpot"})
    return folder, run_batch([*members(), other], folder), other


@pytest.fixture()
def runs(monkeypatch):
    """The frictions of the runs that are made."""
    made = []
    run = axijax.TriaxialTest.run

    def counted(self, params=None, **options):
        made.append(params.friction)
        return run(self, params, **options)

    monkeypatch.setattr(axijax.TriaxialTest, "run", counted)
    return made


def test_equals_single_runs_to_the_last_bit(batch, singles):
    _, result, other = batch
    assert all(same(result.curves[name], curve) for name, curve in singles.items())
    assert same(result.curves[other.name], other.test.run().curve)
    assert not same(singles["friction=0.1"], singles["friction=0.2"])


def test_a_failed_member_is_told_and_the_others_are_kept(batch):
    folder, result, _ = batch
    assert result.failures == {FAILING: "friction = -1: must be zero or positive."}
    assert len(result.curves) == len(FRICTION) + 1
    table = (folder / "summary.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in table] == [
        "member", "friction=0.1", "friction=0.2", "friction=0.3", "large", FAILING,
    ]  # fmt: skip
    assert table[-1].endswith("friction = -1: must be zero or positive.")


def test_one_data_set_of_all(batch):
    folder, result, other = batch
    data = open_batch(folder)
    assert set(data.member.values) == set(result.curves)
    for name, curve in result.curves.items():
        one = data.sel(member=name)
        assert np.array_equal(one.stress_ratio.dropna("record"), curve.stress_ratio)
        assert float(one.peak_ratio) == curve.stress_ratio.max()
    assert float(data.sel(member="friction=0.2").friction) == 0.2
    assert float(data.sel(member=other.name).radius) == 40
    assert data.sel(member=other.name).damping == "dashpot" and data.sel(member="friction=0.2").damping == ""
    (row,) = [line for line in (folder / "summary.csv").read_text().splitlines() if line.startswith("large,")]
    assert "40.0,dashpot," in row
    assert np.isnan(data.sel(member="friction=0.2").radius)
    assert data.sel(member=list(result.curves)).equals(result.dataset())


def test_its_members_are_drawn_by_what_they_differ_in(batch):
    """As many results, with the frictions for names; the folder is what `axijax plot` is given."""
    folder, result, _ = batch
    opened = open_results(folder)
    assert {each.name for each in opened} == set(result.curves)
    for each in opened:
        assert np.array_equal(each.curve.stress_ratio, result.curves[each.name].stress_ratio)
    varied = [each for each in opened if each.name != "large"]
    told = [name for _, name, _ in Lines(varied).each]
    assert told == [f"friction {float(each.curve.friction):g}" for each in varied]


def test_run_again_computes_only_what_is_missing(batch, runs):
    folder, result, other = batch
    again = run_batch([*members(), other], folder)
    assert runs == [-1.0]  # only the failed one is tried again
    assert all(same(again.curves[name], curve) for name, curve in result.curves.items())
    assert [o.resumed for o in again.outcomes] == [True, True, True, False, True]


def test_a_folder_of_something_else_is_refused(batch):
    folder, _, other = batch
    changed = dataclasses.replace(other, params=dataclasses.replace(other.parameters, density=2100.0))
    differing = r"parameters\.material\.density \(2100\.0 here, 2000\.0 there\); choose another folder"
    with pytest.raises(ValueError, match=differing):
        run_batch([changed], folder)


def test_interrupted_by_hand(tmp_path, runs, singles):
    def interrupt(outcome):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_batch(members(), tmp_path, finished=interrupt, workers=1)
    assert set(open_batch(tmp_path).member.values) == {"friction=0.1"}
    result = run_batch(members(), tmp_path)
    assert sorted(runs) == [-1.0, *FRICTION]  # each once
    assert all(same(result.curves[name], curve) for name, curve in singles.items())


def test_what_is_hashed():
    test = tiny()
    one = identity(test, test.params)
    assert one == identity(tiny(), dataclasses.replace(test.params, friction=jnp.float64(test.params.friction)))
    others = [
        (dataclasses.replace(test, axial_strain=0.0007), test.params),
        (dataclasses.replace(test, scene=axijax.Scene(rotation=True)), test.params),
        (test, dataclasses.replace(test.params, damping=axijax.LocalDamping())),
        (test, dataclasses.replace(test.params, damping=axijax.LocalDamping(test.params.damping_ratio))),
        (test, dataclasses.replace(test.params, damping=None)),
        (dataclasses.replace(test, time_step=0.9 * test.prepared.time_step), test.params),
        (dataclasses.replace(test, sector=axijax.Sector(2)), test.params),
        (tiny(radius=40.0), test.params),
        (test, dataclasses.replace(test.params, friction=np.nextafter(test.params.friction, 1))),
    ]
    assert len({json.dumps(each) for each in (one, *(identity(*other) for other in others))}) == len(others) + 1


def test_progress_is_told(singles):
    told = []
    run_batch(members()[:2], progress=lambda *now: told.append(now))
    for name in ("friction=0.1", "friction=0.2"):
        shares = [share for who, share, _ in told if who == name]
        assert shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)


def test_all_at_once_equals_one_by_one(batch):
    """All in one program, which keeps each specimen's own numbers; a run that it cannot make fails by itself."""
    _, expected, other = batch
    told = []
    result = run_batch([*members(), other], strategy="vmap", finished=lambda outcome: told.append(outcome.seconds))
    assert result.failures == expected.failures
    assert len(set(told)) == 2  # one time for those that ran together, one for the failed one
    for name, curve in expected.curves.items():
        for field in records_of(curve):
            np.testing.assert_allclose(
                getattr(result.curves[name], field), getattr(curve, field), rtol=1e-9, atol=1e-12
            )


def test_simulate_many(singles):
    test = tiny()
    curves = simulate_many(test, dataclasses.replace(test.params, friction=jnp.array(FRICTION)))
    for number, curve in enumerate(singles.values()):
        ratio = curves.stress_ratio[number][: curve.stress_ratio.size]
        np.testing.assert_allclose(ratio, curve.stress_ratio, rtol=1e-10)
    with pytest.raises(ValueError, match="none has one"):
        simulate_many(test, test.params)
    with pytest.raises(ValueError, match="found 2, 3"):
        simulate_many(test, dataclasses.replace(test.params, friction=jnp.ones(3), density=jnp.ones(2)))


class TestVmapByAUser:
    """That vmap itself is right is seen in `test_all_at_once_equals_one_by_one`."""

    @staticmethod
    def ratio(test):
        return lambda friction: test.simulate(dataclasses.replace(test.params, friction=friction)).stress_ratio

    def test_is_warned_of(self):
        with pytest.warns(UserWarning, match="jax.vmap over the parameters .*simulate_many"):
            jax.eval_shape(jax.vmap(self.ratio(tiny())), jnp.array(FRICTION))

    def test_not_where_only_tangents_are_batched(self):
        ratio = self.ratio(tiny())

        def along(direction):
            return jax.jvp(ratio, (0.1,), (direction,))

        with warnings.catch_warnings():
            warnings.simplefilter("error")
            value, tangent = jax.eval_shape(jax.vmap(along, out_axes=(None, 0)), jnp.ones(2))
        assert tangent.shape == (2, *value.shape)

    @pytest.mark.parametrize(
        ("wrap", "expected"),
        [
            (lambda f: jax.jit(jax.vmap(f)), [0.0, 1.0, 8.0]),
            (lambda f: jax.vmap(jax.jit(f)), [0.0, 1.0, 8.0]),
            (lambda f: jax.vmap(lambda x: jax.jvp(f, (x,), (1.0,))[1]), [0.0, 3.0, 12.0]),
            (lambda f: jax.vmap(jax.grad(f)), [0.0, 3.0, 12.0]),
        ],
    )
    def test_warned_of_through_other_transformations(self, wrap, expected):
        def cube(x):
            return platform.warn_where_batched({"x": x})["x"] ** 3

        with pytest.warns(UserWarning, match="jax.vmap over the parameters"):
            assert wrap(cube)(jnp.arange(3.0)).tolist() == expected

    def test_without_a_batch_nothing_happens(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert platform.warn_where_batched(0.5) == 0.5
            assert jax.grad(lambda x: platform.warn_where_batched(x) ** 3)(2.0) == 12.0


def test_parallel_runs_side_by_side_and_keeps_order():
    def work(number):
        time.sleep(0.2)
        if number == 2:
            raise ValueError("two")
        return number

    seen = []
    started = time.monotonic()
    results = parallel(work, range(8), workers=8, finished=lambda number, result: seen.append(number))
    assert time.monotonic() - started < 1.0
    assert [r for r in results if not isinstance(r, Exception)] == [0, 1, 3, 4, 5, 6, 7]
    assert str(results[2]) == "two" and sorted(seen) == list(range(8))


def test_grid():
    grid = parameter_grid(tiny(), friction=[0.1, 0.2], density=[2000, 2500])
    assert [m.name for m in grid] == [
        *("friction=0.1 density=2000", "friction=0.1 density=2500"),
        *("friction=0.2 density=2000", "friction=0.2 density=2500"),
    ]
    assert grid[1].params.density == 2500.0 and grid[1].labels == {"friction": 0.1, "density": 2500.0}
    (rolling,) = parameter_grid(tiny(), rolling_friction=[0.1])  # of a part that is not there until it is named
    assert rolling.params.rolling_friction == 0.1 and tiny().params.material.rolling is None
    with pytest.raises(ValueError, match=r"'frction' is not a parameter of this test; it has .*friction, .*normal_"):
        parameter_grid(tiny(), frction=[0.1])
    with pytest.raises(ValueError, match=r"friction = 0\.1: must be a list"):
        parameter_grid(tiny(), friction=0.1)
    with pytest.raises(ValueError, match=r"member 'friction=0\.1': its name must differ"):
        run_batch(parameter_grid(tiny(), friction=[0.1, 0.1]))


SWEEP = """
[specimen]
layers = 3
half_width = 3
[sweep]
parameters.friction = [0.1, 0.2]
sector.order = [4, 2]
"""


class TestSweepFile:
    def test_combinations(self, tmp_path):
        (tmp_path / "sweep.toml").write_text(SWEEP)
        found = load_sweep(tmp_path / "sweep.toml")
        assert [(m.parameters.friction, m.test.sector.order) for m in found] == [(0.1, 4), (0.1, 2), (0.2, 4), (0.2, 2)]
        assert found[1].labels == {"parameters.friction": 0.1, "sector.order": 2}

    @pytest.mark.parametrize(
        ("text", "sentence"),
        [
            ("[sector]\norder = 4", r"has no table \[sweep\]: write \[sweep\] with lists"),
            ("[sweep]\nparameters.friction = 0.1", r"parameters.friction = 0.1: must be a list"),
            ("[sweep]\nparameters.frction = [0.1]", r"'parameters.frction' is not a field; did you mean 'friction'"),
            ("[sweep]\nfriction = [0.1]", r"'friction' is no section"),
        ],
    )
    def test_mistakes(self, tmp_path, text, sentence):
        (tmp_path / "sweep.toml").write_text(text)
        with pytest.raises(ValueError, match=sentence):
            load_sweep(tmp_path / "sweep.toml")


def process(cache: Path | str, *arguments) -> subprocess.Popen:
    environment = {**os.environ, "AXIJAX_CACHE": str(cache), "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, str(Path(__file__).with_name("batch_process.py")), *map(str, arguments)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def answer(started: subprocess.Popen) -> dict:
    out, err = started.communicate(timeout=300)
    assert started.returncode == 0, err
    return json.loads(out)


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A cache folder, and the folder of a batch whose process was killed in the middle of its second file."""
    cache, folder = tmp_path_factory.mktemp("cache"), tmp_path_factory.mktemp("killed")
    victim = process(cache, "kill", folder)
    _, err = victim.communicate(timeout=300)
    assert victim.returncode == -signal.SIGKILL, err
    return cache, folder


def test_killed_while_writing_then_resumed_without_compiling(killed, singles):
    cache, folder = killed
    assert len(list((folder / "members").iterdir())) == 2  # one whole, one half written under a hidden name
    assert list(open_batch(folder).member.values) == ["friction=0.1"]
    done = answer(process(cache, "resume", folder))
    assert done["resumed"] == ["friction=0.1"]
    assert done["computed"] == ["friction=0.2", "friction=0.3", FAILING]
    assert done["misses"] == 0 and done["hits"] > 3
    assert not list((folder / "members").glob(".*")), "the half-written one is gone"
    data = open_batch(folder)
    for name, curve in singles.items():
        assert np.array_equal(data.stress_ratio.sel(member=name), curve.stress_ratio)


def test_two_processes_share_a_batch(killed, tmp_path, singles):
    cache, _ = killed
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    both = [process(cache, "share", tmp_path, port, number) for number in range(2)]
    first, second = map(answer, both)
    assert (first["computed"], second["computed"]) == (["friction=0.1", "friction=0.3"], ["friction=0.2", FAILING])
    data = open_batch(tmp_path)
    assert list(data.member.values) == list(singles)
    for name, curve in singles.items():
        assert np.array_equal(data.stress_ratio.sel(member=name), curve.stress_ratio)
    assert len((tmp_path / "summary.csv").read_text().splitlines()) == 1 + len(members())


class TestCache:
    @pytest.mark.parametrize("word", ["off", "0", "OFF"])
    def test_switched_off(self, monkeypatch, word):
        monkeypatch.setenv("AXIJAX_CACHE", word)
        before = jax.config.values["jax_compilation_cache_dir"]
        assert axijax.use_compilation_cache() is None
        assert jax.config.values["jax_compilation_cache_dir"] == before

    def test_a_folder_that_cannot_be_written_is_a_warning(self, tmp_path):
        (tmp_path / "file").touch()
        with pytest.warns(UserWarning, match="no compilation cache: folder .* AXIJAX_CACHE"):
            assert axijax.use_compilation_cache(tmp_path / "file") is None

    def test_in_the_users_cache_folder(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        monkeypatch.delenv("AXIJAX_CACHE", raising=False)
        changed = {}
        given = jax.config.values["jax_compilation_cache_dir"]
        jax.config.update("jax_compilation_cache_dir", None)
        try:
            with monkeypatch.context() as patch:
                patch.setattr(jax.config, "update", changed.__setitem__)
                folder = axijax.use_compilation_cache()
        finally:
            jax.config.update("jax_compilation_cache_dir", given)
        assert folder is not None and folder.parent == tmp_path / "axijax" and folder.is_dir()
        assert changed["jax_compilation_cache_dir"] == str(folder)

    def test_the_oldest_programs_go_where_there_are_too_many(self, tmp_path, monkeypatch):
        monkeypatch.setattr(platform, "CACHE_BYTES", 1000)
        for number in range(12):
            (tmp_path / f"{number}-cache").write_bytes(bytes(100))
            os.utime(tmp_path / f"{number}-cache", (number, number))
        platform._prune(tmp_path)
        assert {file.name for file in tmp_path.iterdir()} == {f"{number}-cache" for number in range(8, 12)}

    def test_programs_of_each_kind_are_kept_apart_and_one_cut_short_is_made_again(self, monkeypatch, tmp_path):
        """With the fast kernels none of those without is found. JAX itself warns of a program that was cut short at
        every start and keeps it, as there is a file of that name."""
        monkeypatch.delenv("XLA_FLAGS", raising=False)  # an earlier test of this process may have chosen the fast ones

        def compiled(kind: str) -> dict:
            return answer(process(tmp_path, "compile", tmp_path, kind))

        plain, fast = compiled("plain"), compiled("fast")
        assert (plain["hits"], fast["hits"]) == (0, 0) and plain["misses"] > 0 and fast["misses"] > 0
        for program in tmp_path.rglob("*-cache"):
            os.truncate(program, program.stat().st_size // 2)
        assert compiled("fast")["hits"] == 0
        again = compiled("fast")
        assert again["misses"] == 0 and again["hits"] == fast["misses"]

    def test_only_what_is_new_is_looked_at_and_what_is_whole_stays(self, tmp_path):
        from jax._src.compilation_cache import compress_executable

        whole = compress_executable(os.urandom(1000))
        for name, content in (("whole", whole), ("cut", whole[:-1]), ("empty", b"")):
            (tmp_path / f"{name}-cache").write_bytes(content)
        platform._remove_damaged(tmp_path)
        assert {file.name for file in tmp_path.glob("*-cache")} == {"whole-cache"}
        (tmp_path / "old-cache").write_bytes(whole[:-1])
        os.utime(tmp_path / "old-cache", (1, 1))
        platform._remove_damaged(tmp_path)
        assert (tmp_path / "old-cache").exists()
