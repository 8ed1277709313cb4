"""A formula in the place of the simulator, for tests where the physics is not the point."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

from axijax import Params


@dataclass
class StandIn:
    """R rises to 0.97 of Thornton's peak as tanh of eps kn g(ks/kn) / s3, then softens a little; exact strain stretch
    but for the softening. noise: relative scatter from run to run, a wild function of the parameters. broken: runs with
    a friction above it fail."""

    noise: float = 0.0
    broken: float = 1.0
    axial_strain: float = 0.01
    params: Params = field(default_factory=Params)

    def simulate(self, params):
        strain = jnp.linspace(0.0, self.axial_strain, 101)
        peak = 0.97 * 2 * (1 + params.friction) / (1 - params.friction)
        ratio = params.shear_stiffness / params.normal_stiffness
        x = 0.02 * strain * params.normal_stiffness * (1 + 3 * ratio) / (3 + ratio) / params.confining_stress
        stress_ratio = 1 + (peak - 1) * jnp.tanh(x) * (1 - 3 * strain)
        wild = jnp.sin(1e7 * (params.friction + params.normal_stiffness / 1.5e9)) + jnp.cos(3e6 * ratio)
        stress_ratio = stress_ratio * (1 + self.noise * wild * jnp.sin(300 * strain))
        volume = 0.3 * strain - 0.5 * strain * jnp.tanh(x)
        return SimpleNamespace(
            axial_strain=strain,
            stress_ratio=stress_ratio,
            volumetric_strain=volume,
            status=jnp.where(params.friction > self.broken, 1, 0),
        )


def measured(simulator, strains=None, noise=0.0, seed=0, **values):
    """A MeasuredCurve of the stand-in at other parameters."""
    from dataclasses import replace

    from calibrate.measured import MeasuredCurve

    strains = np.linspace(2e-4, 0.0095, 50) if strains is None else strains
    curve = simulator.simulate(replace(simulator.params, **values))
    ratio = np.interp(strains, curve.axial_strain, curve.stress_ratio)
    return MeasuredCurve(strains, ratio * (1 + noise * np.random.default_rng(seed).standard_normal(strains.size)))
