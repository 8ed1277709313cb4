"""A formula with scatter in the place of random packings, so that fits of them can be tested in seconds.

R rises as tanh of strain kn/s3 to a peak that friction sets and softens; the volume contracts and dilates. Each packing
adds three smooth random curves and has a void ratio, with which its strength falls.
"""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from axijax import Params
from calibrate.scene import RandomScene

SCATTER = 0.03


def mean_curve(params, strain, void_ratio=0.6):
    kappa = float(params.normal_stiffness) / (float(params.confining_stress) * 20)
    ratio = float(params.shear_stiffness) / float(params.normal_stiffness)
    peak = np.log(2.0 + 1.5 * float(params.friction)) - 2.0 * (void_ratio - 0.6)
    rise = np.tanh(0.15 * strain * kappa * (1 + 0.3 * np.log(ratio)))
    log_ratio = peak * rise * (1 - 2 * strain)
    volume = 0.2 * strain * np.exp(-strain * 60) - float(params.friction) * 0.6 * strain * rise * (1 - 2 * strain)
    return log_ratio, volume


@dataclass(frozen=True)
class StandInTest:
    params: Params
    seed: int
    scatter: float = SCATTER
    axial_strain: float = 0.1

    def run(self):
        rng = np.random.default_rng(self.seed)
        strain = np.linspace(0, self.axial_strain, 201)
        void_ratio = 0.6 + 0.01 * rng.standard_normal()
        log_ratio, volume = mean_curve(self.params, strain, void_ratio)
        waves = [np.sin((2 * k + 1) * np.pi * strain / 0.2) for k in range(3)]
        log_ratio = log_ratio + self.scatter * sum(rng.standard_normal() * w for w in waves) * (strain / 0.1) ** 0.3
        volume = volume + 0.1 * self.scatter * sum(rng.standard_normal() * w for w in waves) * strain / 0.1
        if float(self.params.friction) > 1.2:
            raise RuntimeError("the test went wrong: a ball has left the membrane; lower time_step.")
        return SimpleNamespace(
            curve=SimpleNamespace(
                axial_strain=strain, stress_ratio=np.exp(log_ratio), volumetric_strain=volume,
                void_ratio=np.full(strain.size, void_ratio),
            )
        )  # fmt: skip


def stand_in(seed, params):
    return StandInTest(params, seed)


def scene(**values):
    return RandomScene(stand_in, Params(**{"friction": 0.4} | values))
