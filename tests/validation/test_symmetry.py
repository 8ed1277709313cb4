"""Quarter, half and full cylinder are one trajectory, by symmetry, until an instability breaks it."""

import jax
import numpy as np
import pytest

from axijax import Sector, TriaxialTest, fcc_octagon, raise_for_status
from axijax.mechanics.dynamics import initial_state, make_step, positions
from axijax.mechanics.membrane import membrane_load
from axijax.specimen.specimen import cut_to_sector

ORDERS = (1, 2, 4)
SPECIMEN = fcc_octagon(layers=13, half_width=5)


@pytest.fixture(scope="module")
def tests():
    """A small specimen of the paper's kind with one time step for all orders, so that records fall on the same
    strains."""
    step = TriaxialTest(SPECIMEN, Sector(1)).prepared.time_step
    return {n: TriaxialTest(SPECIMEN, Sector(n), axial_strain=0.006, time_step=step) for n in ORDERS}


@pytest.mark.slow
def test_peaks_and_curves_agree_each_from_its_own_confinement(tests):
    """Of the quarter and the full cylinder; positions below are those of the half too."""
    full, quarter = (tests[n].simulate(tests[n].params) for n in (1, 4))
    for curve in (full, quarter):
        raise_for_status(curve.status)
    assert float(abs(np.max(quarter.stress_ratio) - np.max(full.stress_ratio))) < 5e-5
    other = np.interp(full.axial_strain, quarter.axial_strain, quarter.stress_ratio)
    assert np.abs(other - full.stress_ratio).max() < 2e-4


@pytest.mark.slow
def test_positions_agree_from_one_symmetric_state(tests):
    """200 steps from the same state: the confined quarter, turned into the half and the full cylinder."""
    quarter = tests[4]
    confined, _ = quarter.confine()
    moved = {}
    for n, test in tests.items():
        full = cut_to_sector(SPECIMEN, Sector(n))
        image, ball = _which(quarter, full.positions)
        displacement = Sector(4).rotate(np.asarray(confined.displacement)[:, ball], image)
        state = initial_state(test.scene, test.params, test.network, confined.platens)
        state = state._replace(displacement=type(state.displacement)(*displacement))
        step = make_step(test.scene, test.prepared.shear.platen_speeds)
        load = membrane_load(test.membrane, positions(test.network, state), *state.platens)

        def advance(s, step=step, test=test, load=load):
            body = lambda s, _: (step(test.params, test.network, load, test.prepared.time_step, s), None)  # noqa: E731
            return jax.lax.scan(body, s, None, length=200)[0]

        moved[n] = np.asarray(positions(test.network, jax.jit(advance)(state))), image, ball
    reference = moved[4][0]
    for n in (1, 2):
        place, image, ball = moved[n]
        expected = Sector(4).rotate(reference[:, ball], image)
        assert np.abs(place - expected).max() < 1e-9 * 20


def _which(quarter, places):
    """For each place, the ball of the quarter and the image of it that is there."""
    from scipy.spatial import cKDTree

    count = len(quarter.cut)
    copies = [quarter.sector.rotate(quarter.cut.positions, k) for k in range(4)]
    distance, column = cKDTree(np.concatenate(copies, axis=1).T).query(places.T)
    assert distance.max() < 1e-9
    return column // count, column % count
