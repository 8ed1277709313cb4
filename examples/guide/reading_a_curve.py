# %% [markdown]
# # Reading a curve as a soil mechanician
#
# What a laboratory writes of a triaxial test: friction angle, dilatancy, stiffness, void ratio. Compression is
# positive, the rate of dilatancy d = -d(volumetric strain)/d(axial strain) counts expansion positive.

# %%
import axijax

axijax.fast_cpu_kernels()

from axijax.triaxial.laboratory import laboratory  # noqa: E402

test = axijax.TriaxialTest(axijax.fcc_octagon(), axijax.Sector(4), axial_strain=0.01)  # friction 0.12278
curve = test.run().curve

# %% [markdown]
# Everything at once, as `axijax run` and the report print it.

# %%
read = laboratory(curve)
for name, value in read.rows().items():
    print(f"{name:55} {value}")

# %% [markdown]
# The same by hand. The mobilised friction angle follows from R = s1/s3 alone: sin(phi) = (R - 1)/(R + 1).

# %%
import numpy as np  # noqa: E402

ratio = float(curve.stress_ratio.max())
angle = np.degrees(np.arcsin((ratio - 1) / (ratio + 1)))
print(f"R = {ratio:.3f} is a friction angle of {angle:.2f} degrees; the curve says {curve.friction_angle.max():.2f}")

# %% [markdown]
# Rowe's stress-dilatancy: R = K (1 + d) with K = tan(45 + phi_f/2)^2, phi_f being the angle of friction between the
# balls, atan(0.12278) = 7 degrees. It is for contacts that slide; the volume begins to grow at the peak, so K is read
# behind it.

# %%
late = curve.axial_strain > 0.006
constant = (curve.stress_ratio[late] / (1 + curve.dilatancy_rate[late])).mean()
print(f"K behind the peak {float(constant):.3f}; of f = 0.12278 {np.tan(np.pi / 4 + np.arctan(0.12278) / 2) ** 2:.3f}")

# %% [markdown]
# Stress invariants are on the curve too, here at the last record, and so is the dilatancy angle.

# %%
print(f"p = {float(curve.mean_stress[-1]):.4g}, q = {float(curve.deviatoric_stress[-1]):.4g} [F/L^2]")
print(f"dilatancy angle {float(curve.dilatancy_angle[-1]):.1f} degrees")
