# %% [markdown]
# # Your own packing
#
# Balls from another program or a scanner: a file with columns x, y, z and radius, in any one unit of length, the cylinder's
# axis at x = y = 0. Outer balls and platens are found. Here the file is written first, with a packing of this program's.

# %%
import csv

import axijax

axijax.fast_cpu_kernels()

made, _ = axijax.random_cylinder(60, axijax.Sector(1), compaction_friction=0.1, seed=2)
with open("balls.csv", "w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["x", "y", "z", "radius"])
    table.writerows([*place, size] for place, size in zip(made.positions.T, made.radius, strict=True))

# %%
specimen = axijax.packing("balls.csv")
print(f"{len(specimen)} balls, height {specimen.height:.1f}, {len(specimen.membrane_zone)} of them under the membrane")

# %% [markdown]
# No symmetry is known of such a packing, so the whole cylinder is simulated, n = 1. A sector is taken only of one that is the
# same after a turn; what is not is refused with a sentence.

# %%
try:
    axijax.TriaxialTest(specimen, axijax.Sector(4)).cut  # noqa: B018
except ValueError as refusal:
    print(refusal)

# %% [markdown]
# Confined with the friction of the test the packing keeps its density. (A case file says the same as
# `kind = "file"`, `path = "balls.csv"` under `[specimen]`.)

# %%
params = axijax.Params(friction=0.4)
test = axijax.TriaxialTest(
    specimen, axijax.Sector(1), params=params, axial_strain=0.01, tolerance=1e-3, confine_steps=100_000,
    confining_friction=0.4,
)  # fmt: skip
curve = test.run().curve
print(f"void ratio {float(curve.void_ratio[0]):.3f}, stress ratio at 1 % {float(curve.stress_ratio[-1]):.2f}")
