"""Where the method stops being right: each limit of examples/guide/limits.md, measured. The paper's quarter throughout.

Runs are compared with each other, with closed forms and with PHYSICS.md's independent program, never with a stored run.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from axijax import BackgroundDamping, Params, theory
from axijax.core.sector import Sector
from axijax.core.vector import from_rows
from axijax.mechanics.membrane import build_membrane, membrane_radius
from axijax.mechanics.outer_balls import zone_found_again
from axijax.specimen.specimen import cut_to_sector, fcc_octagon
from axijax.triaxial.test import TriaxialTest

FRICTION = 0.12278
FAST = 0.05  # radii/T a platen, at which the peak is 1 % too high


@lru_cache
def sheared(axial_strain=0.0045, layers=25, dtype=np.float64, **params):
    """Curve and final state; confined to 1e-3 in float32, which rounding allows, and to 1e-6 in float64."""
    test = TriaxialTest(
        fcc_octagon(layers=layers),
        params=Params(**params),
        axial_strain=axial_strain,
        tolerance=1e-3 if dtype == np.float32 else 1e-6,
        dtype=dtype,
    )
    return test, test.run()


def far(**options):
    """Through the peak and lists that are made anew."""
    return sheared(axial_strain=0.05, **options)[1]


def peak(**options):
    return float(sheared(**options)[1].curve.stress_ratio.max())


def inertial_number(test):
    """Strain rate times ball diameter times sqrt(density/s3) [-]."""
    params = test.params
    rate = 2 * params.platen_speed / test.cut.height
    return rate * 2 * test.cut.radius[0] * (params.density / params.confining_stress) ** 0.5


@pytest.mark.slow
def test_loading_rate():
    """Within 0.5 % of the paper's speed at an inertial number of 4e-4, off by one percent at a thousandth (interpolated
    between speeds), and 3 % or more too strong at 2e-3."""
    speeds = np.array([0.02, 0.03, FAST, 0.1])
    paper = peak(friction=FRICTION)
    excess = np.array([peak(friction=FRICTION, platen_speed=speed) / paper - 1 for speed in speeds])
    numbers = inertial_number(sheared(friction=FRICTION)[0]) * speeds / 0.01
    assert numbers[0] == pytest.approx(4.45e-4, rel=1e-2) and numbers[-1] == pytest.approx(2.2e-3, rel=2e-2)
    assert np.all(np.diff(excess) > 0) and abs(excess[0]) < 5e-3 and excess[-1] > 0.03
    assert 6e-4 < np.interp(0.01, excess, numbers) < 1.2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "axial_strain"), [(FRICTION, 0.02), (0.3, 0.0045)])
def test_float32_has_the_same_peak(friction, axial_strain):
    """To 0.1 %: displacements from where the list was built in float32, the platens' heights in float64. It needs the
    Coulomb cap to be one value: chosen twice by the same condition, a contact in millions got a spring of 4e5 radii.
    After the peak, through lists made anew, to 2 %."""
    options = {"friction": friction, "platen_speed": FAST}
    single = sheared(axial_strain=axial_strain, dtype=np.float32, **options)[1]
    double = far(**options) if axial_strain > 0.01 else sheared(axial_strain=axial_strain, **options)[1]
    assert single.state.displacement.x.dtype == single.state.spring.z.dtype == single.network.dtype == np.float32
    for name in ("stress_ratio", "core_ratio"):
        peaks = [float(getattr(run.curve, name).max()) for run in (single, double)]
        assert peaks[0] == pytest.approx(peaks[1], rel=1e-3)
    strain = np.linspace(5e-4, 0.9 * axial_strain, 50)
    curves = [np.interp(strain, r.curve.axial_strain, r.curve.stress_ratio) for r in (single, double)]
    np.testing.assert_allclose(*curves, rtol=0.02)


def test_without_friction():
    """f = 0: the frictionless array, R = 2; the core reaches it, the whole specimen stays 5 % below as at other f."""
    curve = sheared(axial_strain=0.012, friction=0.0, platen_speed=0.04)[1].curve
    assert float(curve.core_ratio.max()) == pytest.approx(float(theory.fcc_stress_ratio(0.0)), rel=0.02)
    assert 1.85 < float(curve.stress_ratio.max()) < 2.0
    assert np.asarray(curve.chatter).max() <= 1e-3


@pytest.mark.slow
def test_high_friction():
    """f = 0.9 runs, unstable steps excluded, but is far from Thornton's 38: balls roll, and the specimen buckles."""
    run = sheared(axial_strain=0.02, friction=0.9, platen_speed=FAST)[1]
    assert np.asarray(run.curve.chatter).max() <= 1e-3
    top = float(run.curve.stress_ratio.max())
    assert peak(friction=0.3, platen_speed=FAST) < top < 0.6 * float(theory.fcc_stress_ratio(0.9))
    assert top < float(run.curve.core_ratio.max()) < float(theory.fcc_stress_ratio(0.9))


def stiffness(softness, **options):
    """Peak at s3 r/K = softness; the strain to the peak goes with it, and so may the platen speed."""
    K = 5e4 * 20 / softness
    soft = softness / (5e4 * 20 / 1.5e9)
    return peak(
        axial_strain=float(np.clip(0.0045 * soft, 2e-4, 0.035)),
        friction=FRICTION, normal_stiffness=K, shear_stiffness=K, platen_speed=0.02 * min(soft**0.5, 3.0), **options,
    )  # fmt: skip


@pytest.mark.slow
def test_stiffness():
    """The peak falls slowly with softness: the geometry changes more on the way. K/2 by the independent program: 2.432;
    the stiffest is 1.5 % below Thornton's rigid balls, the paper's K 3.5 % and s3 r/K = 0.01 12 %."""
    rigid = float(theory.fcc_stress_ratio(FRICTION))
    softness = np.array([1e-5, 1e-3 * 2 / 3, 1e-3 * 4 / 3, 1e-2])
    peaks = np.array([stiffness(value) for value in softness])
    assert np.all(np.diff(peaks) < 0)
    assert peaks[2] == pytest.approx(2.432, rel=5e-3)
    shortfall = 1 - peaks / rigid
    assert shortfall[0] < 0.02 and 0.03 < shortfall[1] < 0.045 and 0.1 < shortfall[-1] < 0.14


@pytest.mark.slow
def test_mass_proportional_damping_adds_strength():
    """PHYSICS 1.4: 2/T adds 8 % (independent program)."""
    found = peak(damping=BackgroundDamping(2.0), friction=FRICTION)
    assert found / peak(friction=FRICTION) - 1 == pytest.approx(0.08, abs=0.005)


@pytest.mark.slow
def test_a_specimen_of_three_layers():
    """It runs, and tells nothing of the material: between smooth platens three layers stand 60 % stronger, while the
    core's ratio stays that of the lattice."""
    run = sheared(layers=3, axial_strain=0.01, friction=FRICTION)[1]
    assert float(run.curve.stress_ratio.max()) > 1.3 * float(theory.fcc_stress_ratio(FRICTION))
    assert float(run.curve.core_ratio.max()) == pytest.approx(float(theory.fcc_stress_ratio(FRICTION)), rel=0.03)


@pytest.mark.slow
def test_five_percent_strain():
    """The lists are made anew; sound to the end, and softening after the peak."""
    run = far(friction=FRICTION, platen_speed=FAST)
    ratio = np.asarray(run.curve.stress_ratio)
    assert int(run.curve.status) == 0 and np.isfinite(ratio).all()
    assert float(run.curve.axial_strain[-1]) > 0.0495
    assert ratio[-1] < 0.85 * ratio.max()
    assert np.asarray(run.curve.chatter).max() <= 1e-3


def test_a_ball_squeezed_out_is_loaded_but_does_not_carry_the_radius_away():
    """An inner ball pushed out through the membrane by eight radii joins the zone; Rm stays where it was."""
    cut = cut_to_sector(fcc_octagon(), Sector(4))
    rho = np.hypot(*cut.positions[:2])
    inner = ~cut.membrane_zone & (abs(cut.positions[2] - cut.height / 2) < 60)
    ball = int(np.argmax(rho * inner))
    angle = np.deg2rad(41.0)
    positions = np.array(cut.positions)
    positions[:2, ball] = (rho.max() + 160) * np.array([np.cos(angle), np.sin(angle)])
    out = replace(cut, positions=positions)
    assert zone_found_again(cut, Sector(4)).sum() == cut.membrane_zone.sum(), "nobody joins an undeformed zone"
    zone = zone_found_again(out, Sector(4))
    assert zone[ball] and zone.sum() == cut.membrane_zone.sum() + 1
    membrane = build_membrane(replace(out, membrane_zone=zone), Sector(4))
    before = build_membrane(cut, Sector(4))
    expected = float(membrane_radius(before, from_rows(cut.positions)))
    assert float(membrane_radius(membrane, from_rows(positions))) == pytest.approx(expected, rel=1e-12)
    assert bool(membrane.counted[np.flatnonzero(np.asarray(membrane.zone) == ball)[0]]) is False


def test_float32_keeps_the_overlap_only_by_displacements():
    """At these coordinates float32 positions miss an overlap by 2e-3 of it, displacements by a hundredth of that."""
    from axijax.mechanics.contact_list import build_contact_list
    from axijax.mechanics.contacts import geometry

    cut = cut_to_sector(fcc_octagon(), Sector(4))
    rng = np.random.default_rng(5)
    moved = from_rows(0.02 * rng.standard_normal(cut.positions.shape))
    exact = np.asarray(geometry(build_contact_list(cut, Sector(4)), moved).overlap)
    single = build_contact_list(cut, Sector(4), dtype=np.float32)
    by_displacement = np.asarray(geometry(single, moved.map(lambda row: row.astype(np.float32))).overlap)
    listed = np.asarray(single.image) == 0
    ends = [np.asarray(index)[listed] for index in (single.first, single.second)]
    place = (cut.positions + np.asarray(moved)).astype(np.float32)
    branch = place[:, ends[0]] - place[:, ends[1]]
    by_position = np.float32(40.0) - np.sqrt((branch**2).sum(axis=0))
    typical = 0.019  # the specimen's overlap under its confining stress
    missed = np.abs(by_position - exact[listed]).max()
    assert 1e-3 * typical < missed < 1e-2 * typical
    assert np.abs(by_displacement - exact)[listed].max() < 0.01 * missed


def test_a_rattler_changes_nothing():
    """A ball of half the radius, loose in the hole of an on-axis ball: as strong as with the hole empty."""
    whole = fcc_octagon(layers=9, half_width=5)
    place = np.array([[0.0], [0.0], [whole.height / 2 + 20 * np.sqrt(2)]])
    hole = int(np.argmin(np.linalg.norm(whole.positions - place, axis=0)))
    radius = whole.radius.copy()
    radius[hole] *= 0.5
    empty = whole.select(np.arange(len(whole)) != hole)
    curves = []
    for specimen in (empty, replace(whole, radius=radius)):
        test = TriaxialTest(specimen, Sector(4), params=Params(platen_speed=0.05), axial_strain=0.003, tolerance=1e-6)
        curves.append((test, test.run()))
    (_, alone), (test, loose) = curves
    loose_ball = int(np.argmin(test.cut.radius))
    assert np.hypot(*test.cut.positions[:2, loose_ball]) < 1e-9, "the rattler is on the axis"
    assert np.abs(loose.positions[:2, loose_ball]).max() == 0.0
    assert float(loose.curve.stress_ratio.max()) == pytest.approx(float(alone.curve.stress_ratio.max()), rel=1e-3)
