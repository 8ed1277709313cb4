# %% [markdown]
# # Is my gradient healthy?
#
# A derivative of a long run may be exact and useless. `calibrate.gradient` gives none without its health: the
# agreement with central differences of the same run over a sweep of step widths, and how fast tangents grow.

# %%
import axijax

axijax.fast_cpu_kernels()

import calibrate  # noqa: E402

test = axijax.TriaxialTest(
    axijax.fcc_octagon(layers=5, half_width=5), axijax.Sector(4), axial_strain=0.004, tolerance=1e-5, record_every=25
)
window = calibrate.WindowMean(0.002, 0.004)  # mean of R between these strains
healthy = calibrate.gradient(test, window, "friction", steps=(1e-3,))
print(healthy)

# %% [markdown]
# Cundall's local damping dissipates by switching with the sign of a velocity, which a tangent does not see. The
# values are right, the tangents are not, and the health says so.

# %%
from dataclasses import replace  # noqa: E402

local = replace(test, params=replace(test.params, damping=axijax.LocalDamping()))
sick = calibrate.gradient(local, window, "friction", steps=(1e-3,))
print(sick)

# %% [markdown]
# The rule of the verdict, as the program applies it:

# %%
from calibrate.gradients import RULE  # noqa: E402

print(RULE)
