"""The benchmark's arithmetic, its runs of our own shear, and the peers where they are installed."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import axijax
from axijax.core.vector import from_rows

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
sys.path[:0] = [str(EXAMPLES), str(EXAMPLES / "peers")]

import axijax_gpu  # noqa: E402
import axijax_shear  # noqa: E402
import benchmark  # noqa: E402
import gpu_check  # noqa: E402
import peers  # noqa: E402
import speed_accuracy  # noqa: E402

SHORT = {"specimen": {"layers": 3}, "order": 1, "test": {"axial_strain": 0.004, "refresh": False}}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A short full cylinder: its program, and its scene file."""
    path = tmp_path_factory.mktemp("bench") / "scene.npz"
    return axijax_shear.Program(SHORT | {"blocks": 20, "scene": str(path)}), path


def test_our_shear_is_timed_and_described(scene):
    program, _ = scene
    facts = program.describe()
    assert (facts["balls"], facts["steps"]) == (2 * 76 + 57, 1000)
    assert facts["program_bytes"] > facts["balls"] * 100
    assert axijax_shear.timed(program, SHORT, None)["seconds"] > 0


def test_scene_carries_the_whole_membrane(scene):
    """The forces written for the peers are s3 on every part of the cylinder through the middle of the zone."""
    numbers = np.load(scene[1])
    radius = np.sqrt(numbers["section"] / np.pi)
    whole = numbers["confining_stress"] * 2 * np.pi * radius * np.ptp(numbers["platens"])
    assert numbers["membrane_force"].sum() == pytest.approx(whole, rel=1e-9)


def test_scene_of_a_sector_is_refused(tmp_path):
    test = axijax.TriaxialTest(axijax.fcc_octagon(layers=3), axijax.Sector(4))
    with pytest.raises(ValueError, match="full cylinder"):
        peers.write_scene(tmp_path / "scene.npz", test, None, None, None)


def test_scene_of_unequal_balls_is_that_of_the_list_it_is_given(tmp_path):
    """Each ball its radius, and positions from a list that was rebuilt in confinement."""
    radius, places = np.array([16.0, 24.0]), np.arange(6.0).reshape(3, 2)
    prepared = SimpleNamespace(time_step=1e-3, shear=SimpleNamespace(ramp_time=1.0))
    test = SimpleNamespace(
        sector=axijax.Sector(1), params=axijax.Params(), cut=SimpleNamespace(radius=radius), prepared=prepared
    )
    state = SimpleNamespace(displacement=from_rows(0.5 + 0 * places), platens=np.array([0.0, 90.0]))
    load = SimpleNamespace(lateral=np.array([0.0, 3.0]), section=2.0)
    peers.write_scene(tmp_path / "scene.npz", test, SimpleNamespace(positions=from_rows(places)), state, load)
    scene = np.load(tmp_path / "scene.npz")
    np.testing.assert_array_equal(scene["radius"], radius)
    np.testing.assert_array_equal(scene["positions"], places + 0.5)
    np.testing.assert_array_equal(scene["membrane_force"], float(axijax.Params().confining_stress) * load.lateral)


def test_lammps_follows_our_curve(scene):
    """The same specimen, dashpots, forces and platens in an independent code: the same curve, waves and all."""
    if peers.LAMMPS in peers.missing():
        pytest.skip(peers.missing()[peers.LAMMPS])
    program, path = scene
    theirs = peers.run_peer(peers.LAMMPS, path, 1000, benchmark.first_cores(1)).stress_ratio
    # Ours is recorded before each block of steps, theirs after it. Their platens lack dashpots and lag by half a step:
    # 0.4 % at the start.
    np.testing.assert_allclose(theirs[:-1], np.asarray(program())[1:], rtol=5e-3)


def test_peers_agree_in_local_damping(scene):
    if missing := peers.missing():
        pytest.skip(str(missing))
    lammps, yade = (
        peers.run_peer(code, scene[1], 1000, benchmark.first_cores(1), damping="local")
        for code in (peers.LAMMPS, peers.YADE)
    )
    assert (lammps.steps, yade.steps) == (1000, 1000)
    np.testing.assert_allclose(lammps.axial_strain, yade.axial_strain, rtol=1e-12)
    np.testing.assert_allclose(lammps.stress_ratio, yade.stress_ratio, rtol=5e-3)


def row(code, cores, speeds, **more):
    return {
        "part": "kernel", "code": code, "dtype": "float64", "balls": 1000, "order": 1, "cores": cores, "tangents": 0,
        "tests": 1, "ball_steps_per_second": speeds, "setup_seconds": 1.0, **more,
    }  # fmt: skip


def test_ratios_compare_runs_that_took_turns():
    """A moment in which the whole machine is slow leaves the ratio alone, where a ratio of medians would not."""
    ours, lammps = row("axijax", 1, [8e6, 4e6, 6e6]), row(peers.LAMMPS, 1, [4e6, 2e6, 1.5e6])
    assert benchmark.ratio(ours, lammps) == pytest.approx(2.0)
    text = benchmark.tables({"1000 balls": [ours, lammps]})
    assert "| lattice | 1000 | 1 | 1 | 1 | float64 | 2.00 | - |" in text and "6.00 (4.00 to 8.00)" in text


def test_pareto_front_and_fastest_within_a_tolerance(tmp_path):
    study = speed_accuracy.Study(tmp_path, 25, 1)
    # The second has no error by chance: the slower third has 2 %.
    made = [(0.1, 1.05), (0.15, 1.0), (0.2, 1.02), (0.3, 1.008), (0.4, 1.009), (0.5, 1.0005)]
    study.points = {
        f"ours: platen speed: speed {i}": {"seconds": s, "cold": s, "peak": 2 * p, "steps": 1, "setting": {"speed": i}}
        for i, (s, p) in enumerate(made)
    } | {"reference ours": {"peak": 2.0, "steps": 1, "seconds": 1.0, "setting": {}}}
    assert [point[0] for point in study.front("ours")] == [0.1, 0.15, 0.3, 0.5]
    assert study.fastest("ours", 1.0)[0] == 0.3 and study.fastest("ours", 0.1)[0] == 0.5
    assert study.fastest("ours", 0.01) is None
    speed_accuracy.draw(study)
    assert (tmp_path / "speed_accuracy.png").stat().st_size > 10_000
    assert "| 1 % | ours | 1 |" in (tmp_path / "fastest.md").read_text()


def test_gpu_check_measures_a_batch_and_says_what_fails(tmp_path):
    """A batch by vmap is timed; an option that XLA does not know is a sentence, and the rest goes on."""
    first, turn = axijax_gpu.device(tmp_path, True)
    assert first["copy GB/s"] > 0 and turn["us"] > 0
    test = axijax_shear.make_test({"specimen": {"layers": 3}, "order": 4, "test": {"axial_strain": 0.006}})
    shear = axijax_gpu.from_rest(test, np.float32)
    assert shear.load.lateral.dtype == shear.prepared.network.dtype == np.float32
    batch = axijax_gpu.Job({"what": "two"}, shear, 2, tests=2)
    row, failed = axijax_gpu.timed([batch, axijax_gpu.Job({"what": "none"}, shear, 2, options={"xla_nothing": 1})])
    assert row["balls"] == 2 * len(test.cut) and row["M ball-steps/s"] > 0 and "failed" not in row
    assert "xla_nothing" in failed["failed"] and "M ball-steps/s" not in failed
    for each in (first, row, failed):
        gpu_check.append(tmp_path, "batches", each)
    text = gpu_check.tables(gpu_check.read_rows(tmp_path))
    assert text.startswith("**batches**") and "xla_nothing" in text and f"| {row['balls']} |" in text
