"""Reverse mode through whole tests, with the fast CPU kernels on: against tangents, and these against differences."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from calibrate_standin import StandIn
from few_balls import jit

from axijax import Hertz, Params, Sector, Specimen, TriaxialTest, fcc_octagon
from calibrate.descent import fit_friction_per_ball
from calibrate.parameters import Prior
from calibrate.reverse import friction_map
from calibrate.targets import Datum, HardPeak, WindowMean

SMALL = fcc_octagon(layers=5, half_width=3)
WINDOW = WindowMean(0.0005, 0.0015)


def uneven() -> Specimen:
    """The same with balls of unequal size and a little off their places, and said to be random; still the same after a
    quarter turn, with balls on the axis."""
    rho, z = np.hypot(*SMALL.positions[:2]) / SMALL.radius[0], SMALL.positions[2] / SMALL.radius[0]
    radius = SMALL.radius * (0.999 - 0.001 * np.sin(rho + 3 * z))
    places = SMALL.positions * np.array([[1], [1], [0]]) * (1 + 2e-4 * np.cos(rho + z))
    inside = np.abs(z - z.mean()) < np.ptp(z) / 2 - 0.1
    places[2] = SMALL.positions[2] + SMALL.radius * 4e-4 * np.sin(2 * rho + z) * inside
    return Specimen(places, radius, SMALL.bottom, SMALL.top, SMALL.membrane_zone, zone_rule="exposure")


LINEAR = Params(friction=0.3, damping_ratio=0.2, platen_speed=0.03)
HERTZ = Params(Hertz(friction=0.3), confining_stress=1e5, damping_ratio=0.2, platen_speed=0.06)
CASES = {
    "full, Hertz": (SMALL, Sector(1), HERTZ, {}),
    # Rolling resistance backwards: tests/test_rolling_whole.py.
    "uneven, tight lists that are rebuilt": (uneven(), Sector(4), LINEAR, {"rebuild_every": 4}),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_gradient_of_a_whole_test(case):
    """By the friction of every ball: against the tangent along a direction, and that against the central difference."""
    specimen, sector, params, options = CASES[case]
    test = TriaxialTest(specimen, sector, params=params, axial_strain=0.002, tolerance=1e-4, record_every=40, **options)
    random = specimen.zone_rule == "exposure"
    assert (test.network.tight is not None) == random
    assert sector.on_axis(test.cut.positions, test.cut.radius).any() == (sector.order > 1)

    def number(friction):
        curve = test.simulate(replace(params, friction=friction))
        voids = curve.void_ratio[-1] if random else 0.0
        return WINDOW(curve) + 100 * curve.volumetric_strain[-1] + voids, curve.status

    rng = np.random.default_rng(0)
    friction, way = jnp.asarray(rng.uniform(0.2, 0.4, len(test.cut))), jnp.asarray(rng.normal(size=len(test.cut)))
    gradient = jit(jax.value_and_grad(number, has_aux=True))
    (value, status), slope = gradient(friction)
    assert int(status) == 0
    along = jit(lambda way: jax.jvp(lambda f: number(f)[0], (friction,), (way,)))
    same, tangent = along(way)
    assert float(value) == pytest.approx(float(same), rel=1e-12)
    assert float(slope @ way) == pytest.approx(float(tangent), rel=1e-9)
    h = 1e-6
    ahead, behind = (float(gradient(friction + step * way)[0][0]) for step in (h, -h))
    assert (ahead - behind) / (2 * h) == pytest.approx(float(tangent), rel=1e-5)


def test_what_confinement_depends_on_is_refused():
    test = TriaxialTest(SMALL, params=LINEAR, axial_strain=0.002)
    with pytest.raises(ValueError, match=r"ends at confinement.* for a stiffness, .* take jax\.jvp"):
        jax.eval_shape(jax.grad(lambda params: test.simulate(params).stress_ratio[-1]), test.params)


class Balls(StandIn):
    """A stand-in whose friction is the mean of its balls'."""

    cut = SMALL

    def simulate(self, params):
        return super().simulate(replace(params, friction=jnp.mean(params.friction)))


def test_a_map_adds_up_to_the_tangent(tmp_path):
    test, window = Balls(), WindowMean()
    found = friction_map(test, window)
    number = lambda friction: window(test.simulate(replace(test.params, friction=friction)))  # noqa: E731
    _, total = jax.jvp(number, (test.params.friction,), (1.0,))
    assert found.total == pytest.approx(float(total), rel=1e-9)
    assert found.draw(tmp_path / "map.png").stat().st_size > 5000
    with pytest.raises(ValueError, match="one a ball"):
        friction_map(test, window, np.ones(3))


def test_a_friction_of_every_ball_moves_towards_the_data():
    field = fit_friction_per_ball(Balls(), Datum(HardPeak(), 2.3, 0.02), Prior(0.1, 0.5), steps=6)
    assert field.friction.shape == (len(SMALL),)
    assert field.losses.min() < 0.7 * field.losses[0]
