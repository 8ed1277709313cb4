"""Closed forms of PHYSICS 8 on a finite lattice: its core has them, its ends and its skin do not; statics, no dynamics.

`test_stages` holds paths of the program against the same statics, so that what a specimen's record misses of a closed
form is what is missing here.
"""

import numpy as np
import pytest
from finite_lattice import elastic, infinite

from axijax import Sector, fcc_cylinder, fcc_octagon, theory
from axijax.core.vector import from_rows
from axijax.mechanics.membrane import build_membrane, membrane_load

KN, RADIUS = 1.5e9, 20.0
MODULI = ("drained_modulus", "bulk_modulus", "undrained_modulus", "constant_p_modulus")


def areas(specimen):
    membrane = build_membrane(specimen, Sector(1))
    return np.asarray(membrane_load(membrane, from_rows(specimen.positions), specimen.bottom, specimen.top).lateral)


def closed_form(ratio):
    c11, c12, _ = theory.elastic_constants("fcc", KN, ratio * KN, RADIUS)
    return infinite(float(c11), float(c12))


@pytest.fixture(scope="module")
def octagon():
    specimen = fcc_octagon()
    return specimen, areas(specimen)


def test_what_follows_from_the_constants():
    """The formulas as PHYSICS 8 has them."""
    for ratio in (1.0, 0.5, 0.25):
        answer, lam = closed_form(ratio), ratio
        assert answer.k0 == pytest.approx((1 - lam) / (2 * (1 + lam)), abs=1e-12)
        assert answer.drained_modulus == pytest.approx(float(theory.fcc_youngs_modulus(KN, lam * KN, RADIUS)))
        slope = 3 * KN * (1 + 3 * lam) / (4 * 2**0.5 * RADIUS)
        assert answer.undrained_modulus == pytest.approx(slope) == answer.constant_p_modulus
        assert answer.undrained_dp_dq == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("ratio", [1.0, 0.5, 0.25])
def test_the_core_has_the_closed_forms(octagon, ratio):
    """To 0.7 %, where the whole specimen is 3 to 17 % softer."""
    known = closed_form(ratio)
    boundary, core = elastic(*octagon, KN, ratio * KN)
    for name in MODULI:
        assert getattr(core, name) == pytest.approx(getattr(known, name), rel=7e-3), name
        assert 0.8 < getattr(boundary, name) / getattr(known, name) < 0.98, name
    assert core.k0 == pytest.approx(known.k0, abs=2e-3)
    assert core.undrained_dp_dq == pytest.approx(0, abs=5e-3)


@pytest.mark.slow
def test_large_specimens_come_to_the_closed_forms():
    """Cylinders of growing size, by a straight line in one over the radius: moduli to 3 %, which is how far the line
    moves with the sizes that it goes through. Soft in shear, where they are farthest from it."""
    ratio, sizes = 0.25, [13, 16, 17, 20, 24]
    known = closed_form(ratio)
    found = []
    for size in sizes:
        specimen = fcc_cylinder(layers=2 * round(size / 2**0.5) + 1, specimen_radius=size * RADIUS)
        found.append(elastic(specimen, areas(specimen), KN, ratio * KN)[0])
    for name in MODULI:
        softness = [getattr(known, name) / getattr(each, name) for each in found]
        assert np.polyfit(1 / np.array(sizes), softness, 1)[1] == pytest.approx(1, abs=0.03), name
        assert max(softness) > 1.02 or name == "undrained_modulus"
    for name in ("k0", "undrained_dp_dq"):
        line = np.polyfit(1 / np.array(sizes), [getattr(each, name) for each in found], 1)[1]
        assert line == pytest.approx(getattr(known, name), abs=0.02), name
