# %% [markdown]
# # A sand calibrated
#
# The curve of one random packing is one draw, so that a sand is fitted with many packings: runs over the box of the
# parameters, each on a packing of its own, a surface through them whose covariance holds the scatter, and the
# interval of the parameters that the data leave. Here the data are simulated, with another packing and a hidden
# friction, and everything is small and fast; a real sand takes 400 balls or more, slower platens, and 24 to 40 runs.

# %%
from dataclasses import replace

import axijax

axijax.fast_cpu_kernels()
axijax.use_compilation_cache()

import calibrate  # noqa: E402

SECTOR = axijax.Sector(2)


def sand(seed: int, params: axijax.Params) -> axijax.TriaxialTest:
    """A test of a packing of its own, with these parameters."""
    specimen, report = axijax.random_cylinder(60, SECTOR, compaction_friction=0.05, seed=seed, params=params)
    params = replace(params, platen_speed=axijax.platen_speed(2e-3, specimen, params))
    return axijax.TriaxialTest(
        specimen, SECTOR, params=params, axial_strain=0.02, tolerance=1e-3,
        confining_friction=report.compaction_friction, confine_steps=100_000,
    )  # fmt: skip


# %%
hidden = sand(seed=77, params=axijax.Params(friction=0.45)).run().curve
every = slice(4, None, 4)
data = calibrate.MeasuredCurve(hidden.axial_strain[every], hidden.stress_ratio[every], hidden.volumetric_strain[every])

# %%
scene = calibrate.RandomScene(sand, axijax.Params(friction=0.4))
fit = calibrate.fit_study(
    [calibrate.StudyTest("hidden", data, scene)],
    "friction",
    bounds={"friction": (0.1, 0.9)},
    runs=14,
    library="library",
    workers=1,  # in this process; more start processes, for which a script needs `if __name__ == "__main__":`
)
print(fit)

# %% [markdown]
# It prints that the fit has not converged, since the scatter is too large: friction 0.32, with 95 % between 0.11 and
# 0.89, known to +-61 % only; the mean of 9 packings would give +-31 %. The hidden 0.45 is in the interval, and the
# verdict says what would help: data of sixty balls scatter much. `packings=9` says that the data are the mean of so
# many, `packings=calibrate.LABORATORY` that they scatter no more than a laboratory's. The runs are kept in `library`:
# the next data set of this sand begins with them.
