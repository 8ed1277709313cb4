"""Tests in stages: many at once, in float32, and by reverse mode; in other processes: test_executors.py."""

import csv
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cli_in_process import axijax as command

from axijax import Params, Sector, TriaxialTest, fcc_octagon
from axijax.batch import Member, open_batch, parameter_grid, run_batch
from axijax.triaxial.records import records_of
from axijax.triaxial.stage_types import stage

TEST = TriaxialTest(
    fcc_octagon(layers=3, half_width=3),
    Sector(4),
    params=Params(friction=0.2, platen_speed=0.05),
    stages=(
        stage("compression", lateral="constant_volume", axial_strain=4e-4),
        stage("extension", deviator_stress=0.0, axial_strain=-1e-3),
    ),
    tolerance=1e-4,
    record_every=20,
)
FRICTIONS = [0.1, 0.3]
UNABLE = Member(
    "unable",
    replace(TEST, stages=(stage("anisotropic", lateral_stress=6e4, k=0.02),)),
    replace(TEST.params, friction=0.05),
)


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    """Two members and one that cannot follow its stage, in threads."""
    folder = tmp_path_factory.mktemp("batch")
    return folder, run_batch([*parameter_grid(TEST, friction=FRICTIONS), UNABLE], folder)


def test_a_stage_that_cannot_be_followed_is_told_and_no_failure(batch):
    folder, result = batch
    assert not result.failures and list(result.ended) == ["unable"]
    assert "stage 1 of 1" in result.ended["unable"] and "outside its strength" in result.ended["unable"]
    with open(folder / "summary.csv", newline="") as file:
        told = {row["member"]: row["ended"] for row in csv.DictReader(file)}
    assert told == {"friction=0.1": "", "friction=0.3": "", "unable": result.ended["unable"]}
    again = run_batch([UNABLE], folder)
    assert again.ended == result.ended and again.outcomes[0].resumed
    curves = open_batch(folder)
    assert set(np.unique(curves.stage.sel(member="friction=0.1").dropna("record"))) == {1.0, 2.0}


@pytest.mark.slow
def test_all_at_once_are_the_same_records(batch):
    """By vmap: what repeats after the end of a stage is left out."""
    many = run_batch(parameter_grid(TEST, friction=FRICTIONS), strategy="vmap")
    assert not many.failures
    for name, curve in many.curves.items():
        alone = batch[1].curves[name]
        for field in records_of(curve):
            np.testing.assert_allclose(
                getattr(curve, field), getattr(alone, field), rtol=1e-7, atol=1e-7, err_msg=f"{name} {field}"
            )


def test_from_a_sweep_file(tmp_path):
    """Stages of a case file, swept over a friction."""
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(
        "[specimen]\nlayers = 3\nhalf_width = 3\n[test]\ntolerance = 1e-4\nrecord_every = 20\n"
        "[parameters]\nplaten_speed = 0.05\n"
        '[[stage]]\ntype = "compression"\naxial_strain = 4e-4\n'
        '[[stage]]\ntype = "extension"\ndeviator_stress = 0.0\naxial_strain = -1e-3\n'
        "[sweep]\nparameters.friction = [0.1, 0.3]\n"
    )
    done = command("batch", sweep, "--output", tmp_path / "out")
    assert done.code == 0, done.err
    curves = open_batch(tmp_path / "out")
    assert curves.sizes["member"] == 2 and float(curves.stage.max()) == 2


@pytest.mark.slow
def test_float32_follows_the_same_stages():
    """To a share of the confining stress that single precision leaves."""
    run = replace(TEST, dtype=np.float32, tolerance=1e-3).run()
    single, double = run.curve, TEST.run().curve
    assert run.state.displacement.x.dtype == np.float32
    for number in (1, 2):
        last = [np.flatnonzero(curve.stage == number)[-1] for curve in (single, double)]
        for field, most in (("axial_strain", 2e-6), ("stress_ratio", 5e-3), ("volumetric_strain", 5e-6)):
            one, other = (getattr(curve, field)[at] for curve, at in zip((single, double), last, strict=True))
            assert abs(one - other) < most, (number, field)


@pytest.mark.slow
def test_reverse_mode_is_the_tangent_along_a_path():
    """A mean of the stresses, derived by the friction of each ball: along a direction it must be the tangent."""

    def mean_stress(friction):
        curve = TEST.simulate(replace(TEST.params, friction=friction))
        s3 = curve.lateral_stress / TEST.params.confining_stress
        return (s3 * (curve.stress_ratio + 2)).mean() + 1e3 * curve.axial_strain.mean()

    count = len(TEST.cut)
    friction = 0.2 + 0.02 * jnp.sin(jnp.arange(count))
    way = jnp.asarray(np.random.default_rng(0).normal(size=count))
    back = np.asarray(jax.jit(jax.grad(mean_stress))(friction))
    ahead = float(jax.jit(lambda f: jax.jvp(mean_stress, (f,), (way,))[1])(friction))
    assert np.isfinite(back).all() and abs(ahead) > 1e-3
    np.testing.assert_allclose(back @ np.asarray(way), ahead, rtol=1e-8)
