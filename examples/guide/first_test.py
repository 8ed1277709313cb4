# %% [markdown]
# # A first test
#
# Balls in a face-centred cubic packing, a cylinder of them under a membrane at the confining stress s3, pressed
# between two platens. A quarter is simulated; the rest are its images. This is the specimen of Cui & O'Sullivan
# (2005), with the friction that Rowe (1962) measured.

# %%
import axijax

axijax.fast_cpu_kernels()  # before the first JAX computation: four to five times faster on a CPU

specimen = axijax.fcc_octagon()
test = axijax.TriaxialTest(
    specimen,
    axijax.Sector(4),  # a quarter, between periodic planes
    params=axijax.Params(friction=0.12278),
    axial_strain=0.01,
)
print(f"{len(specimen)} balls in the cylinder, {len(test.cut)} of them simulated")
print(f"time step {float(test.prepared.time_step):.3g}, 0.6 of the critical one")

# %% [markdown]
# `run` confines the specimen without friction until it is in balance, switches friction on and shears it. What it
# leaves is a curve, arrays of one value a record, and the last state.

# %%
run = test.run()
curve = run.curve
for name in ("axial_strain", "stress_ratio", "volumetric_strain", "coordination_number", "sliding_fraction"):
    print(f"{name:20} first {float(getattr(curve, name)[0]):8.4f}   last {float(getattr(curve, name)[-1]):8.4f}")

# %% [markdown]
# The peak, and Thornton's closed form for rigid balls that cannot rotate. Platens measure less, as the balls are soft
# and the specimen's ends and sides differ; the stress inside the core is near it.

# %%
print(axijax.find_peak(curve.axial_strain, curve.stress_ratio))
print(f"peak of the core {float(curve.core_ratio.max()):.3f}, Thornton {axijax.theory.fcc_stress_ratio(0.12278):.3f}")

# %% [markdown]
# A picture: stress ratio and volumetric strain against axial strain. Compression is positive, so that a volume that
# grows goes down.

# %%
import matplotlib.pyplot as plt  # noqa: E402

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6, 6), layout="constrained")
above.plot(100 * curve.axial_strain, curve.stress_ratio, label="platens")
above.plot(100 * curve.axial_strain, curve.core_ratio, label="core")
above.axhline(axijax.theory.fcc_stress_ratio(0.12278), color="grey", ls="--", label="Thornton")
above.set_ylabel("stress ratio s1/s3 [-]")
above.legend()
below.plot(100 * curve.axial_strain, 100 * curve.volumetric_strain)
below.set_xlabel("axial strain [%]")
below.set_ylabel("volumetric strain [%]")
figure.savefig("first_test.png")
