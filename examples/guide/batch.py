# %% [markdown]
# # Many tests at once
#
# Strength against friction: a grid of parameters, a test on each core. Every finished test is a file; run again, only
# what is missing is computed.

# %%
import axijax

axijax.fast_cpu_kernels()

from axijax.batch import open_batch, parameter_grid, run_batch  # noqa: E402

test = axijax.TriaxialTest(axijax.fcc_octagon(), axijax.Sector(4), axial_strain=0.006)
members = parameter_grid(test, friction=[0.1, 0.2, 0.3])
result = run_batch(members, "batch")
print(f"{len(result.outcomes)} tests, failed: {dict(result.failures) or 'none'}")

# %% [markdown]
# The folder as one dataset, with the parameters as coordinates.

# %%
curves = open_batch("batch")
for friction, peak in zip(curves.friction.values, curves.stress_ratio.max("record").values, strict=True):
    print(f"f = {friction:.2f}: peak {peak:.3f}, Thornton {axijax.theory.fcc_stress_ratio(friction):.3f}")

# %% [markdown]
# Again: nothing is left to do.

# %%
again = run_batch(members, "batch")
print(f"computed again: {sum(not outcome.resumed for outcome in again.outcomes)}")
