"""Reverse mode on a small specimen; run by the tests in a process of its own, without the fast CPU kernels.

Prints the sensitivities' sum beside the tangent's and raises where anything is off.
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from axijax import Params
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.test import TriaxialTest
from calibrate.descent import fit_friction_per_ball
from calibrate.parameters import Prior
from calibrate.reverse import friction_map
from calibrate.targets import Datum, HardPeak, WindowMean


def main(folder: Path) -> None:
    settings = Params(damping_ratio=0.2, platen_speed=0.03)
    test = TriaxialTest(fcc_octagon(layers=5, half_width=3), params=settings, axial_strain=0.004, tolerance=1e-5)
    window = WindowMean(0.002, 0.0035)
    found = friction_map(test, window)
    number = jax.jit(lambda f: window(test.simulate(replace(test.params, friction=f))))

    def along(direction):
        start = jnp.full(len(test.cut), test.params.friction)
        return float(jax.jvp(number, (start,), (jnp.asarray(direction),))[1])

    total, ball = along(np.ones(len(test.cut))), int(np.abs(found.sensitivity).argmax())
    print(f"sum of sensitivities {found.total!r}, tangent {total!r}")
    assert found.total == pytest.approx(total, rel=1e-9)
    assert found.sensitivity[ball] == pytest.approx(along(np.eye(len(test.cut))[ball]), rel=1e-9)
    assert found.draw(folder / "map.png").stat().st_size > 5000
    with pytest.raises(ValueError, match="one a ball"):
        friction_map(test, window, np.ones(3))

    field = fit_friction_per_ball(test, Datum(HardPeak(), 2.3, 0.02), Prior(0.1, 0.5), steps=6)
    print(f"losses {field.losses}")
    assert field.friction.shape == (len(test.cut),)
    assert field.losses.min() < 0.7 * field.losses[0]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
