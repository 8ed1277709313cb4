"""Reverse mode through stages; run by the tests in a process of its own, without the fast CPU kernels.

A mean of the stresses over a test that is compressed at constant volume and unloaded again, derived by the friction of
each ball: along a direction it must be the tangent.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from axijax import Params, Sector, TriaxialTest, fcc_octagon
from axijax.triaxial.stage_types import stage

TEST = TriaxialTest(
    fcc_octagon(layers=3, half_width=3),
    Sector(4),
    params=Params(friction=0.2, platen_speed=0.05),
    stages=(
        stage("compression", lateral="constant_volume", axial_strain=4e-4),
        stage("extension", deviator_stress=0.0, axial_strain=-1e-3),
    ),
    tolerance=1e-4,
    record_every=20,
)


def mean_stress(friction):
    curve = TEST.simulate(replace(TEST.params, friction=friction))
    s3 = curve.lateral_stress / TEST.params.confining_stress
    return (s3 * (curve.stress_ratio + 2)).mean() + 1e3 * curve.axial_strain.mean()


def main() -> None:
    count = len(TEST.cut)
    friction = 0.2 + 0.02 * jnp.sin(jnp.arange(count))
    way = jnp.asarray(np.random.default_rng(0).normal(size=count))
    jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})  # large programs that run briefly
    back = np.asarray(jit(jax.grad(mean_stress))(friction))
    ahead = float(jit(lambda f: jax.jvp(mean_stress, (f,), (way,))[1])(friction))
    assert np.isfinite(back).all() and abs(ahead) > 1e-3
    np.testing.assert_allclose(back @ np.asarray(way), ahead, rtol=1e-8)


if __name__ == "__main__":
    main()
