"""Random specimens: gradings, generation and compaction, against brute force and identities of balance."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from axijax import Hertz, Params
from axijax.contacts import geometry
from axijax.dynamics import all_forces, initial_state, positions
from axijax.grading import linear, sieve_curve, two_sizes, uniform
from axijax.membrane import build_membrane, lateral_force, membrane_load
from axijax.neighbors import build_network
from axijax.packing import cut_to_sector
from axijax.random_packing import platen_speed, random_cylinder
from axijax.sector import Sector
from axijax.triaxial import TriaxialTest

BALLS = {1: 60, 3: 90, 4: 96, 12: 144}
TOLERANCE = 1e-3
DEEPEST = 0.05  # overlap in radii of the smaller ball that a specimen in balance may have


@lru_cache
def made(order=4, seed=0, friction=0.1):
    sector = Sector(order)
    specimen, report = random_cylinder(BALLS[order], sector, compaction_friction=friction, seed=seed)
    return sector, specimen, report


def overlaps_of_all(specimen):
    """Overlaps in radii of the smaller ball of every pair of the full cylinder's balls, by brute force."""
    i, j = np.triu_indices(len(specimen), 1)
    distance = np.linalg.norm(specimen.positions[:, i] - specimen.positions[:, j], axis=0)
    reach = specimen.radius[i] + specimen.radius[j]
    return (reach - distance) / np.minimum(specimen.radius[i], specimen.radius[j])


@pytest.mark.parametrize("order", BALLS)
def test_sector_comes_back_and_no_image_overlaps(order):
    sector, specimen, report = made(order)
    assert len(specimen) == report.balls == BALLS[order]
    cut = cut_to_sector(specimen, sector)
    assert len(cut) == BALLS[order] // order
    assert not sector.on_axis(cut.positions, cut.radius).any()
    np.testing.assert_allclose(np.sort(cut.radius), linear(16, 24).sample(len(cut)))
    depth = overlaps_of_all(specimen)
    assert 0 < depth.max() < DEEPEST, "in balance under stress: pressed together, but not deeply"
    assert (specimen.positions[2] - specimen.radius > specimen.bottom - DEEPEST * specimen.radius).all()
    assert (specimen.positions[2] + specimen.radius < specimen.top + DEEPEST * specimen.radius).all()
    touching = 2 * (depth > 0).sum() / len(specimen)
    assert report.coordination_number == pytest.approx(touching, abs=1e-12)
    assert report.height == pytest.approx(4 * report.membrane_radius, rel=0.2)
    assert max(report.unbalanced_force, report.stress_error) <= TOLERANCE


def test_same_seed_same_specimen_to_the_bit_and_another_seed_another():
    sector, specimen, report = made(4)
    again, same = random_cylinder(BALLS[4], sector, compaction_friction=0.1, seed=0)
    for name in ("positions", "radius", "membrane_zone"):
        assert (getattr(again, name) == getattr(specimen, name)).all()
    assert (again.bottom, again.top) == (specimen.bottom, specimen.top)
    assert str(same) == str(report)
    other = made(4, seed=1)[1]
    assert np.abs(other.positions - specimen.positions).max() > 1


def test_in_balance_platens_membrane_and_contacts_carry_the_same_stress():
    """Sum of force times branch over the contacts is that of the forces from outside times where they act."""
    sector, specimen, report = made(4)
    test = TriaxialTest(specimen, sector, confining_friction=report.compaction_friction, tolerance=1e-5,
                        confine_steps=200_000)  # fmt: skip
    state, balance = test.confine()
    assert float(balance.worst) <= 1e-5
    place = positions(test.network, state)
    load = membrane_load(test.membrane, place, *state.platens)
    params = replace(test.params, friction=report.compaction_friction, damping=None)
    still = state._replace(velocity=place * 0.0, spin=place * 0.0)
    forces = all_forces(test.scene, params, test.network, load, test.prepared.time_step, still)
    platen = float(forces.platen_push[0].sum())
    assert platen == pytest.approx(float(forces.platen_push[1].sum()), rel=1e-3)
    assert platen == pytest.approx(params.confining_stress * float(load.section), rel=1e-3)

    branch, force = geometry(test.network, state.displacement).branch, forces.contacts.force
    share = test.network.share
    inner = {axis: float((getattr(force, axis) * getattr(branch, axis) * share).sum()) for axis in "xyz"}
    z = np.asarray(place.z)
    outer_z = float((forces.platen_push[1] * z - forces.platen_push[0] * z).sum())
    push = lateral_force(params.confining_stress, load, place)
    outer_xy = -float((push.x * place.x + push.y * place.y).sum())
    assert inner["z"] == pytest.approx(outer_z, rel=1e-3)
    assert inner["x"] + inner["y"] == pytest.approx(outer_xy, rel=1e-3)
    # Work of the membrane on a cylinder that swells is s3 dV: so the same mean stress from the cells' moments.
    volume = float(load.section) * float(state.platens[1] - state.platens[0])
    assert outer_xy / (2 * volume) == pytest.approx(params.confining_stress, rel=0.03)


def test_a_random_specimen_of_hertzian_balls_knows_no_units():
    """Stresses and density in other units, by a power of two: the same curve, but for the eigenvalue solver's last bits
    in the time step, which is given."""
    sector, specimen, report = made(4)
    curves = []
    for unit in (1.0, 8.0):
        params = Params(
            Hertz(friction=0.3, shear_modulus=1e9 * unit, density=2000.0 * unit),
            confining_stress=5e4 * unit, platen_speed=0.3,
        )  # fmt: skip
        test = TriaxialTest(
            specimen, sector, params=params, axial_strain=0.02, time_step=0.02,
            confining_friction=report.compaction_friction, tolerance=1e-3, confine_steps=100_000,
        )  # fmt: skip
        curves.append(test.run().curve)
    assert curves[0].stress_ratio.max() > 1.5
    np.testing.assert_allclose(curves[1].stress_ratio, curves[0].stress_ratio, rtol=1e-9)


def test_any_image_may_represent_a_ball():
    """Balls that have wandered into other sectors: the same forces, each turned with its ball."""
    sector, specimen, _ = made(4)
    cut = cut_to_sector(specimen, sector)
    turn = np.arange(len(cut)) % 4
    wandered = replace(cut, positions=sector.rotate(cut.positions, turn))
    test = TriaxialTest(specimen, sector, tolerance=1e-3)
    params, results = Params(friction=0.3), []
    for balls in (cut, wandered):
        network = build_network(balls, sector)
        membrane = build_membrane(balls, sector)
        state = initial_state(test.scene, params, network, [cut.bottom, cut.top])
        load = membrane_load(membrane, network.positions, cut.bottom, cut.top)
        results.append(np.asarray(all_forces(test.scene, params, network, load, 1e-3, state).resultant))
    scale = np.abs(results[0]).max()
    np.testing.assert_allclose(sector.rotate(results[0], turn), results[1], atol=1e-9 * scale)


def test_void_ratio_rises_with_the_compaction_friction():
    ratios = [made(1, friction=friction)[2].void_ratio for friction in (0.05, 0.2, 0.5)]
    assert ratios[0] < ratios[1] < ratios[2]


def test_void_ratio_is_reached_or_refused_with_the_range():
    low, high = (made(1, friction=friction)[2].void_ratio for friction in (0.05, 0.5))
    wanted = 0.5 * (low + high)
    _, report = random_cylinder(BALLS[1], Sector(1), void_ratio=wanted, void_ratio_tolerance=0.02, seed=0)
    assert report.void_ratio == pytest.approx(wanted, abs=0.02)
    with pytest.raises(ValueError, match=r"void_ratio = 3: .* reach 0\.\d+ .* to \d\.\d+"):
        random_cylinder(BALLS[1], Sector(1), void_ratio=3.0)


def test_sheared_dense_specimen_is_stronger_than_it_ends():
    """To 15 %, with lists made anew; stress ratio in the range of spheres with f = 0.5."""
    sector, specimen, report = made(4)
    params = Params(friction=0.5)
    params = replace(params, platen_speed=platen_speed(4e-3, specimen, params))
    rate = 2 * params.platen_speed / specimen.height
    assert rate * 2 * specimen.radius.mean() * (2000 / 5e4) ** 0.5 == pytest.approx(4e-3)
    options = {"axial_strain": 0.15, "tolerance": 1e-3, "confining_friction": report.compaction_friction}
    curve = TriaxialTest(specimen, sector, params=params, **options).run().curve
    strain, ratio = np.asarray(curve.axial_strain), np.asarray(curve.stress_ratio)
    assert 0.149 < strain[-1] <= 0.15
    assert 2.0 < ratio[strain < 0.06].max() < 4.5
    assert float(curve.volumetric_strain[-1]) < -0.01, "it dilates"


# Gradings


def passing_by_mass(radii, at):
    return 100 * (radii**3 * (radii <= at)).sum() / (radii**3).sum()


def test_gradings_are_met():
    assert (uniform(20.0).sample(7) == 20.0).all()
    radii = linear(16, 24).sample(200)
    steps = np.arange(201) / 200
    exact = np.clip((radii - 16) / 8, 0, 1)
    assert max(np.abs(exact - steps[1:]).max(), np.abs(exact - steps[:-1]).max()) <= 1 / 400 + 1e-12
    radii = two_sizes(10.0, 20.0, 0.25).sample(20_000)
    assert set(radii) == {10.0, 20.0}
    assert passing_by_mass(radii, 15.0) == pytest.approx(25, abs=0.02)


def test_sieve_curve_is_met(tmp_path):
    path = tmp_path / "sand.csv"
    path.write_text("diameter,passing\n20,0\n30,20\n40,70\n60,100\n")
    radii = sieve_curve(path).sample(50_000)
    for opening, passing in ((20, 0), (30, 20), (40, 70), (60, 100)):
        assert passing_by_mass(radii, opening / 2 * (1 + 1e-9)) == pytest.approx(passing, abs=0.1)
    # Between sieves the mass is spread over log(diameter).
    assert passing_by_mass(radii, np.sqrt(30 * 40) / 2) == pytest.approx(45, abs=0.2)
    few = sieve_curve(path).sample(500)
    assert passing_by_mass(few, 20) == pytest.approx(70, abs=1)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("d,p\n20,0\n30,x\n", "line 3 is '30,x': must be two numbers"),
        ("d,p\n20,0\n30,120\n", "line 3 .* between 0 and 100"),
        ("d,p\n20,0\n30\n", "line 3"),
        ("d,p\n20,0\n", "has 1 sieves"),
        ("d,p\n20,0\n30,60\n40,50\n50,100\n", "must rise"),
        ("d,p\n20,10\n30,100\n", "goes from 10 to 100"),
    ],
)
def test_bad_sieve_curve_is_refused(tmp_path, text, match):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=match):
        sieve_curve(path)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"balls": 61, "sector": Sector(4)}, "balls = 61: must be a whole multiple"),
        ({"balls": 24, "sector": Sector(12)}, "at least 120"),
        ({"aspect_ratio": -1.0}, "aspect_ratio = -1"),
        ({"compaction_friction": 2.0}, "compaction_friction = 2"),
        ({"void_ratio": np.nan}, "void_ratio = nan"),
    ],
)
def test_bad_arguments_are_refused(options, match):
    with pytest.raises(ValueError, match=match):
        random_cylinder(**options)


def test_missing_sieve_curve_is_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot be read"):
        sieve_curve(tmp_path / "nowhere.csv")
