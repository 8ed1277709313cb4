# %% [markdown]
# # Stress paths
#
# What follows confinement is a sequence of stages: a command for the platens and one for the membrane, until a
# criterion is met. One specimen, confined once, is sheared drained and undrained.

# %%
import axijax

axijax.fast_cpu_kernels()

import numpy as np  # noqa: E402

specimen, sector = axijax.fcc_octagon(layers=5, half_width=5), axijax.Sector(4)
params = axijax.Params(friction=0.3, platen_speed=0.01)


def test(*stages) -> axijax.TriaxialTest:
    return axijax.TriaxialTest(specimen, sector, params=params, stages=stages, tolerance=1e-5, record_every=10)


ways = {
    "drained": test(axijax.stage("compression", axial_strain=0.002)),
    "undrained": test(axijax.stage("compression", lateral="constant_volume", axial_strain=0.002)),
}
confined = ways["drained"].confined()

# %%
for name, way in ways.items():
    run = way.run(start=confined)
    curve = run.curve
    print(
        f"{name:10} q {float(curve.deviatoric_stress[-1]):8.0f}, p {float(curve.mean_stress[-1]):8.0f}, "
        f"s3 {float(curve.lateral_stress[-1]):8.0f}, volume {100 * float(curve.volumetric_strain[-1]):8.4f} %"
        f"{'  ' + run.ended if run.ended else ''}"
    )

# %% [markdown]
# Stages follow one another: load, unload until q is zero again, reload. A stage ends at a record, so up to
# `record_every` steps late.

# %%
cycle = test(
    axijax.stage("compression", axial_strain=0.0015),
    axijax.stage("extension", deviator_stress=0.0, axial_strain=-0.01),
    axijax.stage("compression", axial_strain=0.002),
)
curve = cycle.run(start=confined).curve
for number in np.unique(curve.stage):
    last = np.flatnonzero(curve.stage == number)[-1]
    strain, ratio = float(curve.axial_strain[last]), float(curve.stress_ratio[last])
    print(f"stage {number:g} ends at axial strain {strain:.5f} with R = {ratio:.3f}")
