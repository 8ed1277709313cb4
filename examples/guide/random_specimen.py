# %% [markdown]
# # A random specimen
#
# Balls of a grading, packed at random with the symmetry of a sector, compacted by membrane and platens. How dense
# they become is a matter of the friction during compaction: 0.05 gives a dense packing, 0.5 nearly the loosest. Small
# here; take 2000 balls or more for a quarter, or its arc is too narrow.

# %%
from dataclasses import replace

import axijax

axijax.fast_cpu_kernels()

sector = axijax.Sector(2)
specimen, report = axijax.random_cylinder(120, sector, compaction_friction=0.05, seed=0)
print(report)

# %% [markdown]
# The shear: friction of the sand, platens at a speed that is slow against the balls (an inertial number; 1e-4 is
# quasi-static, the 2e-3 here is for a short tutorial), confined with the friction of its compaction so that it keeps
# its density.

# %%
params = axijax.Params(friction=0.5)
params = replace(params, platen_speed=axijax.platen_speed(2e-3, specimen, params))
dense = axijax.TriaxialTest(
    specimen, sector, params=params, axial_strain=0.03, confining_friction=report.compaction_friction, tolerance=1e-3
)
curve = dense.run().curve

# %% [markdown]
# A random specimen's curve jumps, and its largest record is what jumped highest. Its peak is that of the smoothed
# curve, with a standard error.

# %%
print(axijax.peak_of(curve))
print(f"void ratio {float(curve.void_ratio[0]):.3f} at the start, {float(curve.void_ratio[-1]):.3f} at the end")
print(f"volumetric strain {100 * float(curve.volumetric_strain[-1]):.2f} % (negative: it dilates)")

# %% [markdown]
# One packing is one draw. For a mean with an error change `seed`, and average.
