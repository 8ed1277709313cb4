# %% [markdown]
# # Your own packing
#
# Balls from another program or a scanner: a file with columns x, y, z and radius, in any one unit of length, the
# cylinder's axis at x = y = 0. Outer balls and platens are found. Here the file is written first, with balls that we
# have.

# %%
import csv

import axijax

axijax.fast_cpu_kernels()

made = axijax.fcc_octagon(layers=5, half_width=5)
with open("balls.csv", "w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["x", "y", "z", "radius"])
    table.writerows([*place, size] for place, size in zip(made.positions.T, made.radius, strict=True))

# %%
specimen = axijax.packing("balls.csv")
print(f"{len(specimen)} balls, height {specimen.height:.1f}, {len(specimen.membrane_zone)} of them under the membrane")

# %% [markdown]
# A sector is taken only of a packing that is the same after a turn, as this one is after a quarter's. What is not is
# refused with a sentence, and simulated as the whole cylinder, `Sector(1)`.

# %%
try:
    axijax.TriaxialTest(specimen, axijax.Sector(3)).cut  # noqa: B018
except ValueError as refusal:
    print(refusal)

# %% [markdown]
# A packing of sand is confined with the friction of the test, so that it keeps its density; that is also what a case
# file does by default for `kind = "file"`, `path = "balls.csv"` under `[specimen]`.

# %%
test = axijax.TriaxialTest(
    specimen, axijax.Sector(4), params=axijax.Params(friction=0.3), axial_strain=0.012, tolerance=1e-5,
    confining_friction=0.3,
)  # fmt: skip
curve = test.run().curve
print(f"void ratio {float(curve.void_ratio[0]):.3f}, peak stress ratio {float(curve.stress_ratio.max()):.2f}")
