"""`run`, which rebuilds its lists on the host, and `simulate`, which does so inside jit, are one trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from axijax import Params, Sector, TriaxialTest, platen_speed, raise_for_status, random_cylinder
from axijax.core.fingerprint import fingerprint


@pytest.fixture(scope="module")
def packed():
    """Of a full cylinder and of a half; specimen and report."""
    return {order: random_cylinder(50 * order, Sector(order), seed=seed) for order, seed in ((1, 3), (2, 2))}


@pytest.mark.parametrize("order", [1, 2])
def test_one_record_of_a_random_specimen(order, packed):
    """Every field of every record, lists and membrane zone found again several times, to 1e-9; chaos has not begun."""
    sector = Sector(order)
    specimen, report = packed[order]
    params = Params(friction=0.4)
    params = replace(params, platen_speed=platen_speed(1e-2, specimen, params))
    test = TriaxialTest(
        specimen, sector, params=params, axial_strain=0.01, confining_friction=report.compaction_friction,
        tolerance=1e-3, confine_steps=100_000, rebuild_every=4, record_every=20,
    )  # fmt: skip
    simulated, run = test.simulate(params), test.run().curve
    raise_for_status(simulated.status)
    size = run.axial_strain.size
    assert size > 10 and simulated.axial_strain.size - size <= 1
    for name in ("axial_strain", "stress_ratio", "core_ratio", "volumetric_strain", "void_ratio", "membrane_radius"):
        ours, theirs = (np.asarray(getattr(curve, name))[:size] for curve in (simulated, run))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9, err_msg=name)
    assert int(simulated.confinement.steps) == int(run.confinement.steps)


def test_a_test_is_what_was_asked(packed):
    """Other parameters in `replace` have their own time step; one that was given stays; nothing else is left over."""
    test = TriaxialTest(packed[1][0], Sector(1), axial_strain=0.01)
    stiffer = replace(test.params, normal_stiffness=6e9, shear_stiffness=6e9)
    other = replace(test, params=stiffer)
    assert test.time_step is None and other.time_step is None
    assert other.prepared.time_step == pytest.approx(test.prepared.time_step / 2, rel=1e-6)
    kept = replace(test, time_step=0.9 * other.prepared.time_step)
    assert replace(kept, params=stiffer).prepared.time_step == kept.time_step
    with pytest.raises(ValueError, match=r"must be at most 0\.8 of the critical time step"):
        replace(test, params=stiffer, time_step=test.prepared.time_step).simulate(stiffer)
    assert fingerprint(replace(other, params=test.params)) == fingerprint(test)
