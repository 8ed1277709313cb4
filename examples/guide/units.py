# %% [markdown]
# # Units: glass beads in SI, and in mm, N, s
#
# The program knows no units; any consistent set will do. The same test of 2 mm glass beads at 100 kPa, once in m, kg,
# s and once in mm, tonne, s (forces in N, stresses in MPa): R against strain is the same to the last digits.

# %%
from dataclasses import replace

import numpy as np

import axijax

axijax.fast_cpu_kernels()


def beads(length: float, mass: float) -> axijax.TriaxialTest:
    """length: of a metre, mass: of a kilogram in the units wanted; seconds stay."""
    stress = mass / length  # of a pascal, kg/(m s^2)
    radius, density, shear_modulus = 1e-3 * length, 2500 * mass / length**3, 2.6e10 * stress
    params = axijax.Params(
        axijax.Hertz(friction=0.2, density=density, shear_modulus=shear_modulus / 100, poisson_ratio=0.22),
        confining_stress=1e5 * stress,
    )
    specimen = axijax.fcc_octagon(radius=radius, layers=7, half_width=5)
    params = replace(params, platen_speed=axijax.platen_speed(2e-3, specimen, params))
    return axijax.TriaxialTest(specimen, axijax.Sector(4), params=params, axial_strain=0.01, tolerance=1e-5)


# %% [markdown]
# The balls are a hundred times softer than glass, as is common: steps are ten times longer, and the peak falls by
# little (see Limits, softness). The platens go at an inertial number of 2e-3, which is fast, for a short tutorial.

# %%
si, millimetres = beads(1.0, 1.0), beads(1e3, 1e-3)
for name, test in (("SI", si), ("mm, tonne, s", millimetres)):
    print(
        f"{name:13} height {test.specimen.height:.4g}, density {float(test.params.density):.4g}, "
        f"s3 {float(test.params.confining_stress):.4g}, platen speed {float(test.params.platen_speed):.4g}, "
        f"time step {float(test.prepared.time_step):.4g}"
    )

# %%
curves = [test.run().curve for test in (si, millimetres)]
peaks = [float(curve.stress_ratio.max()) for curve in curves]
apart = np.abs(np.asarray(curves[0].stress_ratio) / np.asarray(curves[1].stress_ratio) - 1).max()
print(f"peak stress ratio {peaks[0]:.6f} and {peaks[1]:.6f}; the curves are apart by {apart:.1e}")
print(f"platen force {float(curves[0].top_force.max()):.4f} N and {float(curves[1].top_force.max()):.4f} N")
assert apart < 1e-6
