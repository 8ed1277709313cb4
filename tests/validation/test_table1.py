"""Table 1 of Cui & O'Sullivan (2005) against the paper, Thornton's formula and an independent program."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest

from axijax import Sector, TriaxialTest, contact_stiffness, fcc_octagon, flat_top, raise_for_status
from axijax.app.table1 import PAPER_RUNS, PAPER_STIFFNESS

# friction: peak in the paper, peak found by an independent program with the same membrane
PERIODIC = {0.05: (2.09, 2.099), 0.12278: (2.46, 2.466), 0.2: (2.92, 2.911), 0.3: (3.64, 3.602)}
RIGID = {0.12278: (2.01, 2.03), 0.3: (2.91, 2.92)}


def theory(friction):
    return 2 * (1 + friction) / (1 - friction)


def run(test, friction, **changes):
    curve = test.simulate(replace(test.params, friction=friction, **changes))
    raise_for_status(curve.status)
    return curve


@pytest.fixture(scope="module")
def quarter():
    return TriaxialTest(fcc_octagon(), Sector(4), axial_strain=0.008)


@pytest.fixture(scope="module")
def sheared(quarter):
    """Friction -> curve of the quarter, each run once."""
    return lru_cache(partial(run, quarter))


@pytest.fixture(scope="module")
def rigid():
    return TriaxialTest(fcc_octagon(), Sector(4, "rigid"), axial_strain=0.008)


def test_the_specimen_is_the_papers():
    specimen = fcc_octagon()
    assert len(specimen) == 1672
    assert specimen.membrane_zone.sum() == 12 * 44 + 24
    assert specimen.height == pytest.approx((24 * np.sqrt(2) + 2) * 20)


def test_the_quarter_has_the_right_balls(quarter):
    cut = quarter.cut
    assert len(cut) == 427
    assert cut.membrane_zone.sum() == 138
    assert (np.hypot(*cut.positions[:2]) < 1e-6).sum() == 12


@pytest.mark.parametrize("friction", PERIODIC)
def test_periodic_rows(sheared, friction):
    paper, independent = PERIODIC[friction]
    curve = sheared(friction)
    place = int(np.argmax(curve.stress_ratio))
    assert float(curve.stress_ratio[place]) == pytest.approx(paper, rel=0.015)
    assert float(curve.stress_ratio[place]) == pytest.approx(independent, rel=2e-3)
    assert float(np.max(curve.core_ratio)) == pytest.approx(theory(friction), rel=0.010)
    assert 0.0030 <= float(curve.axial_strain[place]) <= 0.0075


def test_with_the_stiffness_of_two_balls_in_series_the_strains_are_the_papers(quarter):
    """The default of `axijax table1`: its strains lie in the flat tops, where the contact's stiffness, that of the rows
    above, reaches them by half to two thirds."""
    own = contact_stiffness(PAPER_STIFFNESS)
    for paper in PAPER_RUNS[1:4:2]:
        curve = run(quarter, paper.friction, normal_stiffness=own, shear_stiffness=own)
        start, end = flat_top(curve.axial_strain, curve.stress_ratio)
        assert start < paper.paper_strain < end
        assert float(curve.stress_ratio.max()) == pytest.approx(paper.paper, rel=0.025)


@pytest.mark.slow
@pytest.mark.parametrize("friction", RIGID)
def test_rigid_rows(rigid, friction):
    """Rigid frictionless planes lose 15 to 25 % of the theoretical strength."""
    low, high = RIGID[friction]
    peak = float(np.max(run(rigid, friction).stress_ratio))
    assert 0.75 * theory(friction) < peak < 0.85 * theory(friction)
    assert low * 0.995 < peak < high * 1.005


def test_confinement_is_isotropic_and_elastic(sheared):
    """Just after confinement: s1 = s3 by platens and by membrane, no sliding; then the lattice's Young's modulus.

    A close packing with kn = ks has E = sqrt(2) K / r; the octagon's boundary softens it a little.
    """
    curve = sheared(0.3)
    assert float(curve.stress_ratio[0]) == pytest.approx(1.0, abs=1e-6)
    early = np.asarray(curve.axial_strain) < 2e-4
    slope = np.polyfit(np.asarray(curve.axial_strain)[early], np.asarray(curve.stress_ratio)[early], 1)[0]
    assert 0.1 * np.sqrt(2) * 1.5e9 / 20 / 5e4 < slope < np.sqrt(2) * 1.5e9 / 20 / 5e4
