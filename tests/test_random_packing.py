"""Random specimens: gradings, generation and compaction, against brute force and identities of balance."""

import re
from dataclasses import replace
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Hertz, Params, Scene
from axijax.core.sector import Sector
from axijax.core.vector import from_rows
from axijax.mechanics.contact_list import build_contact_list
from axijax.mechanics.contacts import geometry
from axijax.mechanics.dynamics import all_forces, initial_state, positions
from axijax.mechanics.membrane import build_membrane, lateral_force, membrane_load
from axijax.specimen.grading import linear, sieve_curve, two_sizes, uniform
from axijax.specimen.specimen import cut_to_sector, fcc_octagon
from axijax.triaxial import random_specimen as random_packing
from axijax.triaxial.engine import until_balls_moved
from axijax.triaxial.random_specimen import platen_speed, random_cylinder
from axijax.triaxial.test import TriaxialTest

BALLS = {1: 60, 4: 96, 12: 144}
TOLERANCE, ROUGH = 1e-3, 1e-2  # the default, and what does where only the void ratio is looked at
DEEPEST = 0.05  # overlap in radii of the smaller ball that a specimen in balance may have


@lru_cache
def made(order=4, seed=0, friction=0.1, tolerance=TOLERANCE):
    sector = Sector(order)
    specimen, report = random_cylinder(
        BALLS[order], sector, compaction_friction=friction, seed=seed, tolerance=tolerance
    )
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
            specimen, sector, params=params, axial_strain=0.01, time_step=0.02,
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
        network = build_contact_list(balls, sector)
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
    low, high = (made(1, friction=f, tolerance=ROUGH)[2].counted_void_ratio for f in (0.05, 0.5))
    wanted = 0.5 * (low + high)
    _, report = random_cylinder(
        BALLS[1], Sector(1), void_ratio=wanted, void_ratio_tolerance=0.02, seed=0, tolerance=ROUGH
    )
    assert report.counted_void_ratio == pytest.approx(wanted, abs=0.02)
    with pytest.raises(ValueError, match=r"void_ratio = 3: .* reach 0\.\d+ .* to \d\.\d+"):
        random_cylinder(BALLS[1], Sector(1), void_ratio=3.0, tolerance=ROUGH)


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


# Wide gradings and soft balls


def test_soft_packings_are_taken_by_their_test_and_stiff_ones_as_deep_refused():
    """kn/(s3 r) of 170 to 500 was packed, and then refused by its own test for an overlap of six hundredths, though a
    contact bears 4.2 s3 r^2 in the mean, which is 2.5 hundredths there, and the strongest a few times that."""
    lattice = fcc_octagon(layers=5, half_width=5)
    deep = 1 - 0.12 / 2  # neighbours overlap by 0.12 radii
    pressed = replace(
        lattice, positions=deep * lattice.positions, bottom=deep * lattice.bottom, top=deep * lattice.top,
        zone_rule="exposure",
    )  # fmt: skip
    soft = Params(normal_stiffness=5e4 * 20 / 0.006, shear_stiffness=5e4 * 20 / 0.006)
    assert TriaxialTest(pressed, Sector(4), params=soft).prepared.time_step > 0
    with pytest.raises(ValueError, match=r"overlap by 0\.12 radii: at most 0\.05 .* stiffness and the confining"):
        TriaxialTest(pressed, Sector(4)).prepared  # noqa: B018


@pytest.mark.parametrize(("ratio", "stiffness"), [(6.0, 1.5e9), (1.5, 5e7)], ids=["size ratio 6", "s3 r/kn = 0.02"])
def test_wide_gradings_and_soft_balls_settle(ratio, stiffness):
    """Stress from every pair's overlap, by brute force over the full cylinder, against the platens' pushes; the
    tangential forces that it leaves out are within the compaction friction of 0.05."""
    params = Params(normal_stiffness=stiffness, shear_stiffness=stiffness)
    grading = linear(24 / ratio, 24.0)
    cylinder, report = random_cylinder(60, Sector(2), grading, params=params, seed=1, tolerance=0.02)
    assert report.radii.max() / report.radii.min() == pytest.approx(ratio, rel=0.1)
    i, j = np.triu_indices(len(cylinder), 1)
    apart = cylinder.positions[:, i] - cylinder.positions[:, j]
    distance = np.linalg.norm(apart, axis=0)
    overlap = np.maximum(cylinder.radius[i] + cylinder.radius[j] - distance, 0.0)
    above = cylinder.positions[2] - cylinder.bottom, cylinder.top - cylinder.positions[2]
    pushes = [stiffness * np.maximum(cylinder.radius - gap, 0.0) for gap in above]
    inside = (stiffness * overlap * apart[2] ** 2 / distance).sum()
    inside += sum((push * gap).sum() for push, gap in zip(pushes, above, strict=True))
    forces = [push.sum() for push in pushes]
    assert forces[0] == pytest.approx(forces[1], rel=0.05)
    assert inside == pytest.approx(np.mean(forces) * report.height, rel=0.05)
    # Rm is that of the outer balls found anew at the end, and not quite the one that the load was for.
    assert np.mean(forces) == pytest.approx(params.confining_stress * np.pi * report.membrane_radius**2, rel=0.1)
    # What came out bears its load with true masses too: a test finds it balanced, and takes soft balls' overlaps.
    test = TriaxialTest(cylinder, Sector(2), params=replace(params, friction=0.3), confining_friction=0.05,
                        tolerance=0.02, confine_steps=2000)  # fmt: skip
    state, balance = test.confine()
    assert float(balance.worst) <= 0.02
    assert float(state.platens[1] - state.platens[0]) == pytest.approx(report.height, rel=0.02)


def test_no_ball_is_made_heavier_in_the_default_grading_and_small_ones_are_in_a_wide_one():
    """Steps are for twelve contacts of the lightest; a ball of x times the smallest radius has room for 3 (1 + x)^2."""
    default = linear(16.0, 24.0).sample(1000)
    assert random_packing._inertia(default) == (None, default.min())
    wide = linear(10.0, 60.0).sample(1000)
    inertia, least = random_packing._inertia(wide)
    mass = np.asarray(inertia) * wide**3
    assert least > 2 * wide.min() and (np.asarray(inertia) >= 1).all()
    assert (mass / (3 * (1 + wide / wide.min()) ** 2) >= (1 - 1e-12) * least**3 / 12).all()


def test_a_ball_that_flies_does_not_outrun_the_contact_list():
    """Steps end before two balls can have met unseen, wherever the speed of one of them doubles with every step."""
    cut = cut_to_sector(made(4)[1], Sector(4))
    network = build_contact_list(cut, Sector(4))
    state = initial_state(Scene(), Params(), network, [cut.bottom, cut.top])
    for speed in (0.01, 0.3, 0.7):  # skins a step
        outward = np.zeros((3, len(cut)))
        outward[2, 7] = speed * float(network.skin)
        start = state._replace(velocity=from_rows(outward))

        def faster(s):
            return s._replace(displacement=s.displacement + s.velocity, velocity=s.velocity * 1.5)

        after, steps = until_balls_moved(faster, network, 1.0, 50, start)
        moved = float(jnp.abs(after.displacement.z).max())
        assert moved <= float(network.skin) and 1 <= int(steps) < 10
        assert moved == pytest.approx(outward[2, 7] * (1.5 ** int(steps) - 1) / 0.5)


def nothing_runs(*_):
    raise AssertionError("refused only after it began")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"grading": linear(10.0, 70.0)}, r"size ratio is 6\.9\d .* up to 6"),
        ({"params": Params(normal_stiffness=2.5e7)}, r"s3 r/kn = 0\.04: .* size ratio 1\.5 are supported up to 0\.022"),
        ({"params": Params(normal_stiffness=1e8), "grading": linear(10.0, 40.0)}, r"s3 r/kn = 0\.0125: .*0\.006"),
        ({"grading": two_sizes(10.0, 40.0, 0.999)}, r"none is of diameter 40 to 80, though 0\.1 % .*: take \d+ balls"),
    ],
)
def test_what_is_not_supported_is_refused_at_once(monkeypatch, options, words):
    monkeypatch.setattr(random_packing, "_grown", nothing_runs)
    with pytest.raises(ValueError, match=words):
        random_cylinder(800, Sector(1), **options)


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


GAP = "opening,passing\n1,0\n1.25,30\n4,30\n5,100\n"  # size ratio 5, no ball between


def sieved(folder, text=GAP):
    path = folder / "sand.csv"
    path.write_text(text)
    return sieve_curve(path)


def test_so_many_balls_of_each_fraction_that_no_other_choice_is_nearer(tmp_path):
    """Against every way to part 24 balls among three fractions."""
    grading = sieved(tmp_path, "opening,passing\n20,0\n30,25\n40,60\n50,100\n")
    wanted = np.array([0.25, 0.35, 0.4])

    def part(count, low, high):
        """The middles of so many parts, equal by number, of diameters with the mass spread over log d."""
        share = (np.arange(count) + 0.5) / max(count, 1)
        return ((1 - share) * low**-3.0 + share * high**-3.0) ** (-1 / 3)

    def missed(counts):
        cubes = [(part(n, *ends) ** 3).sum() for n, ends in zip(counts, ((20, 30), (30, 40), (40, 50)), strict=True)]
        return np.abs(np.array(cubes) / sum(cubes) - wanted).max()

    least = min(missed((a, b, 24 - a - b)) for a in range(25) for b in range(25 - a))
    fractions = grading.fractions(grading.sample(24))
    np.testing.assert_allclose([each.wanted for each in fractions], wanted, atol=1e-4)
    assert max(abs(each.got - each.wanted) for each in fractions) == pytest.approx(least, abs=1e-3)


def test_a_grading_that_is_not_met_is_told_with_the_balls_that_would_do(tmp_path, monkeypatch):
    """30 % of fines asked for beside one coarse ball among 15: the number that is told does, and no smaller one."""
    grading = sieved(tmp_path)
    radii = grading.sample(15)
    fines = passing_by_mass(radii, 1.0)
    assert 0 < (radii > 1).sum() < 15 and abs(fines - 30) > 5
    monkeypatch.setattr(random_packing, "_grown", nothing_runs)
    with (
        pytest.warns(UserWarning, match=rf"diameter .* have {fines:.3g} % .* 30 % is asked for; \d+ balls") as told,
        pytest.raises(AssertionError),
    ):
        random_cylinder(30, Sector(2), grading)
    enough = int(re.search(r"; (\d+) balls", str(told[0].message)).group(1))
    assert enough % 2 == 0
    assert abs(passing_by_mass(grading.sample(enough // 2), 1.0) - 30) <= 5
    assert all(abs(passing_by_mass(grading.sample(n), 1.0) - 30) > 5 for n in range(15, enough // 2))


def test_a_fraction_without_a_ball_is_refused_with_the_balls_that_would_do(tmp_path):
    grading = sieved(tmp_path, "opening,passing\n10,0\n12,90\n40,90.1\n60,100\n")
    with pytest.raises(ValueError, match=r"of 20 balls in a sector none is .*: take (\d+) balls") as told:
        random_cylinder(40, Sector(2), grading)
    enough = int(re.search(r"take (\d+) balls", str(told.value)).group(1)) // 2
    assert np.histogram(grading.sample(enough), grading.sieves)[0].min() > 0


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
