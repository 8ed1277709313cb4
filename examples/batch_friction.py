"""Peak strength against friction, one test for each friction, as a batch; a quarter of a minute on two cores.

    python examples/batch_friction.py [--output batch_friction]

The quarter of Cui & O'Sullivan (2005) is sheared past its peak with eleven frictions. The picture shows the curves, and
their peaks against Thornton's line: the inner core, free of the boundaries, follows it to 1 %, the platens measure
3 to 6 % less. The folder holds one file a test; run again, the script computes only what is missing.
"""

import argparse
from pathlib import Path

import axijax

axijax.fast_cpu_kernels()
axijax.use_compilation_cache()

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from axijax.app.batch import Outcome, open_batch, parameter_grid, run_batch  # noqa: E402
from axijax.app.plot import save_figure  # noqa: E402
from axijax.theory import fcc_stress_ratio  # noqa: E402

FRICTION = np.arange(0.03, 0.331, 0.03).round(2)


def tell(outcome: Outcome) -> None:
    how = "was there" if outcome.resumed else f"{outcome.seconds:.1f} s"
    what = outcome.failure if outcome.curve is None else f"peak {outcome.curve.stress_ratio.max():.3f}"
    print(f"{outcome.member.name:16}", what, how, flush=True)


def picture(data) -> Figure:
    """Curves on the left, peaks against friction on the right."""
    data = data.sortby("friction")
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    curves, peaks = figure.subplots(1, 2)
    colours = matplotlib.colormaps["viridis"]
    top = float(data.friction.max()) * 1.1
    for friction, strain, ratio in zip(data.friction, data.axial_strain, data.stress_ratio, strict=True):
        curves.plot(100 * strain, ratio, color=colours(float(friction) / top), lw=1.4)
        curves.annotate(
            f"{float(friction):.2f}", (100 * float(strain.max()), float(ratio.dropna("record")[-1])),
            xytext=(4, 0), textcoords="offset points", va="center", size=8, color=colours(float(friction) / top),
        )  # fmt: skip
    curves.set(
        xlabel="axial strain [%]", ylabel="stress ratio s1/s3 [-]", title="Curves, marked with their friction",
        xlim=(0, 108 * float(data.axial_strain.max())),
    )  # fmt: skip
    line = np.linspace(0, top, 100)
    peaks.plot(line, fcc_stress_ratio(line), color="black", lw=1, label="Thornton 1979, rigid balls")
    peaks.plot(data.friction, data.core_ratio.max("record"), "s", color="#2a9d8f", mfc="none", label="inner core")
    peaks.plot(data.friction, data.peak_ratio, "o", color="#1d3557", label="platens")
    peaks.set(
        xlabel="coefficient of friction [-]", ylabel="peak stress ratio s1/s3 [-]", title="Peaks",
        xlim=(0, top), ylim=(1.9, None),
    )  # fmt: skip
    peaks.legend(frameon=False, loc="upper left")
    for axes in (curves, peaks):
        axes.grid(alpha=0.3)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("batch_friction"))
    folder = parser.parse_args().output
    test = axijax.TriaxialTest(axijax.fcc_octagon(), axial_strain=0.006)
    run_batch(parameter_grid(test, friction=FRICTION), folder, finished=tell)
    data = open_batch(folder).sortby("friction")
    save_figure(picture(data), folder / "batch_friction.png")
    theory, core = fcc_stress_ratio(data.friction.values), data.core_ratio.max("record").values
    for row in zip(data.friction.values, theory, data.peak_ratio.values, core, strict=True):
        print("friction {:.2f}: Thornton {:.3f}, platens {:.3f}, core {:.3f}".format(*row))


if __name__ == "__main__":
    main()
