"""Sensitivities of formulas whose slopes, packing errors and null directions are known, and of a small lattice."""

import csv
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from cli_in_process import axijax, write

from axijax import Params
from axijax.app.case import Case
from calibrate.model import RunFailed
from calibrate.sensitivity import further_tests, sensitivity

END = 0.05


class Formula:
    """R = 1 + f^(2 + gain) x/(1 + x) and eps_v = -f x / 10, x = strain kn/s3 / 1e4: kn and s3 act by their ratio only,
    ks and the density not at all. broken: (name, side) of runs that fail. kink: of R against f, too small to see."""

    axial_strain = END

    def __init__(self, zone_rule="given", gain=0.0, broken=(), kink=0.0):
        self.specimen, self.params = SimpleNamespace(zone_rule=zone_rule), Params(friction=0.5)
        self.gain, self.broken, self.kink = gain, broken, kink

    def simulate(self, params):
        strain = jnp.linspace(0, END, 4001)
        x = strain * params.normal_stiffness / params.confining_stress / 1e4
        power = 2 + self.gain
        friction = params.friction**power + self.kink * jnp.sin(params.friction * 1e4)
        return SimpleNamespace(
            axial_strain=strain, stress_ratio=1 + friction * x / (1 + x), volumetric_strain=-params.friction * x / 10,
            status=0,
        )  # fmt: skip

    def run(self, params):
        for name, side in self.broken:
            if (getattr(params, name) - getattr(self.params, name)) * side > 0:
                raise RuntimeError("the test went wrong: a ball escaped")
        curve = self.simulate(params)
        return SimpleNamespace(curve=curve)


def exact(strain, power=2.0):
    """(R - 1, -eps_v, its slope by log kn of R) at the reference."""
    held = Params()
    x = strain * float(held.normal_stiffness) / float(held.confining_stress) / 1e4
    return 0.5**power * x / (1 + x), 0.5 * x / 10, 0.5**power * x / (1 + x) ** 2


@pytest.fixture(scope="module")
def formula():
    return sensitivity(Formula(), "f,kn,s3,ks,rho")


def only(found, *names):
    """The same of some of its parameters."""
    rows = [found.names.index(name) for name in names]
    parts = {name: getattr(found, name)[rows] for name in ("slopes", "errors", "differences", "steps")}
    return replace(found, names=names, **parts)


def test_tangents_of_a_formula(formula):
    rise, grown, stiff = exact(formula.strain)
    at = dict(zip(formula.names, formula.slopes, strict=True))
    np.testing.assert_allclose(at["friction"], [2 * rise, -grown], rtol=2e-5)
    np.testing.assert_allclose(at["normal_stiffness"], [stiff, -grown], rtol=2e-5)
    np.testing.assert_allclose(at["confining_stress"], -at["normal_stiffness"], rtol=1e-9)
    assert not at["shear_stiffness"].any() and not at["density"].any()
    np.testing.assert_allclose(formula.differences, formula.slopes, rtol=1e-5, atol=1e-12)
    assert formula.disagreement.max() < 1e-4 and formula.notes == () and np.isnan(formula.errors).all()
    np.testing.assert_allclose(formula.curve, [1 + rise, -grown], rtol=2e-5)


def test_directions_are_named_in_words(formula):
    *known, first, second = only(formula, "friction", "normal_stiffness", "confining_stress", "density").directions
    assert [one.standard_error < 1 for one in known] == [True, True]
    for null in (first, second):  # kn and s3 together, and the density, in any mixture
        assert null.standard_error > 1e6 and null.ratio < 1e-12
        assert null.vector[1] == pytest.approx(null.vector[2], abs=1e-9) and abs(null.vector[0]) < 1e-9
    two = only(formula, "normal_stiffness", "confining_stress")
    said = two.directions[-1].told(two.names)
    assert said.startswith("would not be known: ") and "(then R moves by" in said
    assert "normal_stiffness +10 %" in said and "confining_stress +10 %" in said
    # Uncertainty that a formula gives: of one parameter, 1 over the root of the sum of squares of slope over sigma.
    one = replace(only(formula, "friction"), sigma=(0.1, 0.02))
    rise, grown, _ = exact(one.strain)
    wanted = 1 / np.sqrt(((2 * rise / 0.1) ** 2).sum() + ((grown / 0.02) ** 2).sum())
    assert one.directions[0].standard_error == pytest.approx(wanted, rel=1e-4)


def test_which_further_test_tells_most(formula):
    """One parameter: information adds, with that of the prior, and the gain is half the log of their ratio."""
    one = only(formula, "friction")
    poor, rich = replace(one, slopes=1e-3 * one.slopes), replace(one, slopes=3 * one.slopes)
    first, second, third = further_tests({"a": one, "poor": poor, "rich": rich})
    held = ((one.slopes[0] / np.array([[0.02], [1e-4]])) ** 2).sum()
    assert f"a alone: friction {100 / np.sqrt(held + 1):.2g} %" in first
    assert second.startswith(f"  with rich: friction {100 / np.sqrt(10 * held + 1):.2g} %")
    assert f"(gains {0.5 * np.log((10 * held + 1) / (held + 1)):.2g} nats)" in second and "with poor" in third
    # What packings scatter is no information.
    noisy = replace(one, errors=np.abs(one.slopes))
    assert noisy.information == pytest.approx(0.0, abs=1e-6 * held)
    with pytest.raises(ValueError, match="'b' has the parameters normal_stiffness, 'a' friction"):
        further_tests({"a": one, "b": only(formula, "normal_stiffness")})


def test_packings_scatter_and_their_errors():
    """The slope by log f of R is (2 + gain) f^(2 + gain) g for each packing: mean and standard error are known."""
    gains = [-0.2, 0.0, 0.1, 0.3]
    tests = [Formula("exposure", gain) for gain in gains]
    lines = []
    found = sensitivity(tests, "f,kn", strains=[0.01, 0.02, 0.04], report=lines.append)
    step = 0.1  # f = 0.5 by 0.05
    assert found.steps == pytest.approx([0.1, 0.1]) and found.packings == 4 and found.differences is None
    share = exact(found.strain)[0] / 0.25
    each = np.array([0.5 ** (2 + g) * np.sinh((2 + g) * step) / step for g in gains])
    np.testing.assert_allclose(found.slopes[0, 0], each.mean() * share, rtol=2e-3)
    np.testing.assert_allclose(found.errors[0, 0], each.std(ddof=1) / 2 * share, rtol=2e-3)
    assert lines == [f"packing {n} of 4: 5 runs, 0 failed" for n in (1, 2, 3, 4)]
    assert "mean of 4 packings" in str(found) and " +- " in str(found)
    one = sensitivity(tests[:1], "f,kn", strains=[0.01, 0.02])
    assert np.isnan(one.errors).all() and " +- " not in str(one)


def test_noise_of_packings_hides_a_direction():
    rough = [Formula("exposure", gain) for gain in (-30.0, -1.0, 0.0, 3.0, 30.0)]
    said = [one.told(("friction",)) for one in sensitivity(rough, "f").directions]
    assert said[0].startswith("not told from no effect by these packings: friction")


def test_failed_runs_are_left_out_and_told():
    tests = [Formula("exposure", 0.1), Formula("exposure", -0.1, [("friction", 1)]), Formula("exposure", 0.0)]
    found = sensitivity(tests, "f,kn", strains=[0.02])
    assert "1 of 15 runs failed and are left out, the first: friction = 0.5526: the test went wrong" in found.notes[0]
    share = exact(found.strain)[0] / 0.25
    each = [0.5 ** (2 + g) * np.sinh((2 + g) * 0.1) / 0.1 for g in (0.1, 0.0)]
    np.testing.assert_allclose(found.slopes[0, 0], np.mean(each) * share, rtol=2e-3)
    with pytest.raises(RunFailed, match="no packing has all runs"):
        sensitivity([Formula("exposure", 0.0, [("friction", 1)])], "f")


def test_a_tangent_that_disagrees_is_told():
    found = sensitivity(Formula(kink=0.01), "f")
    assert "the tangent of friction disagrees with its difference" in found.notes[0]


def test_all_parameters_by_default_and_what_has_no_logarithm():
    test = Formula()
    test.params = Params(friction=0.5, platen_friction=np.inf, damping_ratio=0.0)
    found = sensitivity(test)
    assert {"friction", "normal_stiffness", "shear_stiffness", "density", "platen_speed"} <= set(found.names)
    assert found.notes == ("damping_ratio, platen_friction: not one positive number, left out.",) or set(
        found.notes[0].split(":")[0].split(", ")) == {"damping_ratio", "platen_friction"}  # fmt: skip
    for names, words in (
        ("cohesion", "parameter 'cohesion': must be one positive number"),
        ("damping_ratio", "parameter 'damping_ratio'"),
        ("f,friction", "parameter 'friction' is named twice"),
    ):
        with pytest.raises(ValueError, match=words):
            sensitivity(test, names)
    with pytest.raises(ValueError, match=r"strains = \[0\.2\]"):
        sensitivity(test, "f", strains=[0.2])


def test_the_command_on_packings(tmp_path, monkeypatch):
    seeds = []

    def build(self, specimen=None):
        seeds.append(self.specimen.seed)
        return Formula("exposure", 0.1 * len(seeds))

    monkeypatch.setattr(Case, "build", build)
    case = write(tmp_path / "sand.toml", '[specimen]\nkind = "random"\nseed = 7\n')
    called = axijax("sensitivity", case, "--parameters", "f,kn", "--packings", "3", "--output", tmp_path / "out")
    assert called.code == 0 and seeds == [7, 8, 9], called
    assert "packing 3 of 3: 400 balls, seed 9" in called.out and "directions, best known first" in called.out
    assert (tmp_path / "out" / "sensitivity.png").read_bytes().startswith(b"\x89PNG")
    with open(tmp_path / "out" / "sensitivity.csv") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    assert len(rows) == 1 + 2 * 10 and rows[1][0] == "friction" and rows[-1][0] == "normal_stiffness"
    assert float(rows[1][5]) > 0 and rows[1][6] == ""
    other = write(tmp_path / "other.toml", case.read_text())
    several = axijax("sensitivity", case, other, "--parameters", "f", "--packings", "2", "--output", tmp_path / "two")
    told = " ".join(several.out.split())
    assert several.code == 0 and "sand alone: friction" in told and "with other: friction" in told
    assert (tmp_path / "two" / "other" / "sensitivity.csv").exists()
    for options, words in (
        ((case,), "must have different names"),
        (("--uncertainty", "R=0"), "must be positive"),
        (("--parameters", "cohesion"), "parameter 'cohesion'"),
    ):
        refused = axijax("sensitivity", case, *options, "--output", tmp_path / "out")
        assert refused.code == 1 and words in refused.err and "Traceback" not in refused.err


LATTICE = """
[specimen]
layers = 5
half_width = 5
[parameters]
platen_speed = 0.02
damping_ratio = 0.2
[test]
axial_strain = 0.004
record_every = 20
tolerance = 1e-6
"""


@pytest.mark.slow
def test_the_command_on_a_lattice(tmp_path):
    """Density, both stiffnesses and the confining stress together are another unit of mass: nothing moves."""
    case = write(tmp_path / "case.toml", LATTICE)
    called = axijax("sensitivity", case, "--parameters", "rho,kn,ks,s3", "--output", tmp_path / "out")
    assert called.code == 0, called
    last = " ".join(called.out.split()).rpartition("would not be known")[2]
    assert all(f"{name} +10 %" in last for name in ("density", "confining_stress", "normal_stiffness"))
    moved = float(last.split("R moves by ")[1].split()[0])
    assert moved < 1e-9 and "tangents" in called.out
