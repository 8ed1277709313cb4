"""Random specimens that are uniform and isotropic, and of the density asked for: closed forms and exact statistics."""

from dataclasses import fields, replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from axijax.app.case import make_case
from axijax.core.sector import Sector
from axijax.core.vector import from_rows
from axijax.specimen.grading import linear
from axijax.specimen.specimen import Specimen
from axijax.triaxial.density import DENSEST, LOOSEST, Bounds, bounds, library, sought
from axijax.triaxial.packing_report import PackingReport
from axijax.triaxial.random_specimen import _grown, random_cylinder
from axijax.triaxial.uniformity import core_stress, trends


@pytest.mark.parametrize("order", [1, 3])
def test_a_cloud_has_its_share_of_balls_and_sizes_everywhere(order):
    """Independent places would leave the halves' solid volumes apart by the root of their number of balls, 6 %."""
    sector, radii = Sector(order), linear(10, 30).sample(600)
    apart, sizes = [], []
    for seed in range(3):
        cloud = _grown(radii, sector, 2.0, 0.52, np.random.default_rng(seed))
        rho, volume = np.hypot(*cloud.positions[:2]), cloud.radius**3
        half = np.median(rho)
        above = cloud.positions[2] > cloud.height / 2
        apart.append(volume[above].sum() / volume.sum() - 0.5)
        sizes.append(
            [cloud.radius[rho < half].mean() / radii.mean() - 1, cloud.radius[above].mean() / radii.mean() - 1]
        )
    assert np.abs(apart).max() < 0.02
    assert np.abs(sizes).max() < 0.03


def test_error_of_the_cores_stress_is_the_scatter_of_isotropic_contacts():
    """Forces along normals that have no direction: the ratio scatters about one by the error that is stated."""
    rng, contacts = np.random.default_rng(0), 300
    network = SimpleNamespace(
        radius=jnp.full(2, 20.0), share=jnp.ones(contacts),
        first=jnp.zeros(contacts, int), second=jnp.ones(contacts, int),
    )  # fmt: skip
    place, found = from_rows(np.zeros((3, 2))), []
    for _ in range(300):
        normal = rng.normal(size=(3, contacts))
        normal /= np.linalg.norm(normal, axis=0)
        force = normal * rng.exponential(size=contacts)
        found.append(core_stress(network, from_rows(force), from_rows(normal), place, 100.0, np.array([-50.0, 50.0])))
    ratios = np.array([each.ratio for each in found])
    assert found[0].contacts == contacts
    assert ratios.std() == pytest.approx(np.mean([each.error for each in found]), rel=0.12)
    assert ratios.mean() == pytest.approx(1, abs=4 * ratios.std() / len(ratios) ** 0.5 + found[0].error ** 2)


def test_cores_stress_of_forces_that_are_known():
    network = SimpleNamespace(
        radius=jnp.array([1.0, 2.0]), share=jnp.ones(3), first=jnp.array([0, 0, 0]), second=jnp.array([1, 1, 1])
    )
    axes, sizes = np.eye(3), np.array([2.0, 3.0, 4.0])
    inside, outside = from_rows(np.zeros((3, 2))), from_rows(np.array([[0.0, 90.0], [0, 0], [0, 0]]))
    for place in (inside, outside):  # of the second only one ball is in the core: its half of each branch
        found = core_stress(network, from_rows(axes * sizes), from_rows(axes), place, 100.0, np.array([-50.0, 50.0]))
        assert found.ratio == pytest.approx(4 / 2.5)
        assert found.contacts == 3


def test_trends_see_what_was_put_in_and_nothing_else():
    rng, side, height = np.random.default_rng(1), 200.0, 800.0
    count = 3000
    rho, angle = side * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    place = np.stack([rho * np.cos(angle), rho * np.sin(angle), height * rng.random(count)])
    even = rng.uniform(8, 12, count)
    skin = 2 * even.mean()
    outer = rho > (side - skin) / 2**0.5
    for radius, wanted in ((even, 0.0), (even * np.where(outer, 1.1, 1.0), 0.1)):
        cut = Specimen(place, radius, 0.0, height, rho > 190, "balls", "exposure")
        found = trends(cut, Sector(1), side)
        assert found.size[0] * radius.mean() / even.mean() == pytest.approx(wanted, abs=4 * found.size_error[0])
        assert abs(found.size[1]) < 4 * found.size_error[1]
        if wanted:
            assert found.void_ratio[0] < -0.1, "larger balls as close together leave less room"
    tiny = Specimen(place[:, :5], even[:5], 0.0, height, rho[:5] > 0, "balls", "exposure")
    assert np.isnan(trends(tiny, Sector(1), 30.0).void_ratio).all()


def test_what_a_small_packing_cannot_tell_is_said():
    """Of 120 balls the report printed "+nan"; of a narrow sector of few "inf" and "nan" for an empty core."""
    known = {name.name: 1.0 for name in fields(PackingReport)} | {"radii": np.ones(20), "sieves": np.ones((5, 3))}
    known |= {"grading": "balls", "fractions": [], "warnings": [], "bounds": None, "core_contacts": 40, "seed": 1}
    known |= dict.fromkeys(("void_ratio_trend", "size_trend", "size_trend_error"), (0.01, 0.02))
    whole = PackingReport(**known)
    assert "+0.010 outer less inner half" in str(whole) and "1.000 +- 1.000" in whole._card().rows.values()
    small = replace(whole, void_ratio_trend=(np.nan, np.nan), size_trend=(np.nan,) * 2, size_trend_error=(np.nan,) * 2)
    empty = replace(small, core_void_ratio=np.inf, core_contacts=0, core_stress_ratio=np.nan, core_stress_error=np.nan)
    for report, told in ((small, "too few balls lie deep enough"), (empty, "no contact of the inner core")):
        text = str(report) + " ".join(report._card().rows.values())
        assert told in text and "nan" not in text and "inf" not in text


def packer(made, least=0.5, most=0.8):
    """Packings whose void ratio rises from least to most with the logarithm of the friction."""

    def compacted(friction):
        made.append(friction)
        share = np.log(friction / DENSEST) / np.log(LOOSEST / DENSEST)
        return "specimen", SimpleNamespace(counted_void_ratio=least + (most - least) * share**1.5)

    return compacted


def test_bounds_of_a_grading_are_found_once_and_again_where_the_file_is_damaged(tmp_path, monkeypatch):
    made = []
    assert bounds(packer(made), [linear(16, 24), 500], tmp_path) == Bounds(0.5, 0.8)
    assert made == [DENSEST, LOOSEST]
    assert bounds(packer(made), [linear(16, 24), 500], tmp_path) == Bounds(0.5, 0.8)
    assert len(made) == 2, "known"
    bounds(packer(made), [linear(16, 24), 600], tmp_path)
    assert len(made) == 4, "of another number of balls they are others"
    for file in tmp_path.iterdir():
        file.write_text(file.read_text()[:20])
    assert bounds(packer(made), [linear(16, 24), 500], tmp_path) == Bounds(0.5, 0.8)
    assert len(made) == 6
    assert bounds(packer(made), [], tmp_path / "x" / "y") == bounds(packer(made), [], None), "a folder that it makes"
    monkeypatch.setenv("AXIJAX_CACHE", "off")
    assert library() is None
    monkeypatch.setenv("AXIJAX_CACHE", str(tmp_path))
    assert library() == tmp_path / "densities"


@pytest.mark.parametrize("relative", [0.0, 0.3, 0.6, 1.0])
def test_a_relative_density_is_a_void_ratio_between_the_bounds(relative):
    known = Bounds(0.5, 0.8)
    wanted = known.void_ratio(relative)
    assert wanted == pytest.approx(0.8 - 0.3 * relative)
    assert known.relative_density(wanted) == pytest.approx(relative, abs=1e-12)
    _, report = sought(packer([]), wanted, 0.001, "relative_density", 0.02)
    assert report.counted_void_ratio == pytest.approx(wanted, abs=0.001)


def test_what_a_seed_does_not_reach_is_its_end_or_refused():
    _, report = sought(packer([]), 0.81, 0.001, "relative_density = 0", 0.02)
    assert report.counted_void_ratio == 0.8
    with pytest.raises(ValueError, match=r"relative_density = 0: .* reach 0.5000 .* to 0.8000"):
        sought(packer([]), 0.83, 0.001, "relative_density = 0", 0.02)


def test_a_specimen_by_relative_density_begins_with_its_void_ratio(tmp_path, monkeypatch):
    monkeypatch.setenv("AXIJAX_CACHE", str(tmp_path))
    _, report = random_cylinder(60, Sector(1), relative_density=0.5, void_ratio_tolerance=0.04, tolerance=1e-2, seed=0)
    densest, loosest = report.bounds
    assert 0.4 < densest < report.counted_void_ratio < loosest < 1.0
    assert abs(report.relative_density - 0.5) * (loosest - densest) <= 0.04
    assert len(list((tmp_path / "densities").iterdir())) == 1
    assert "relative density" in str(report)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"relative_density": 1.2}, "relative_density"),
        (
            {"relative_density": 0.5, "void_ratio": 0.6},
            "void_ratio = 0.6, relative_density = 0.5: give one of them only",
        ),
    ],
)
def test_a_case_says_one_density(fields, told):
    with pytest.raises(ValueError, match=told):
        make_case({"specimen": {"kind": "random", **fields}}, "x.toml")
