"""Rowe's friction from Rowe's peak: fit f so that the paper's specimen peaks at 2.4, about 12 s from a cold start.

    python examples/rowe_friction.py [--output PICTURE]

The specimen is the quarter of Cui & O'Sullivan (2005), table 1. The settings trade nothing that shows in the peak for
speed: twice the paper's platen speed, dashpots of 0.1, confinement to 1e-5, stop at 0.45 % strain (the top is at
0.3 to 0.4 %). Printed: the fitted friction with the interval that the single number 2.4 carries, beside Thornton's
inverse for rigid balls that cannot rotate and the friction that Rowe measured.
"""

import argparse
import time

import numpy as np

CLOCK = time.perf_counter()

import axijax  # noqa: E402

axijax.fast_cpu_kernels()  # forward mode only, four times as fast; before anything is computed

from axijax import Params  # noqa: E402
from axijax.specimen.specimen import fcc_octagon  # noqa: E402
from axijax.theory import fcc_friction, fcc_stress_ratio  # noqa: E402
from axijax.triaxial.test import TriaxialTest  # noqa: E402
from calibrate import ROWE, fit_friction_to_peak  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", default="rowe_friction.png", help="picture to write")
    output = parser.parse_args().output

    params = Params(platen_speed=0.02, damping_ratio=0.1)
    test = TriaxialTest(fcc_octagon(), params=params, axial_strain=0.0045, tolerance=1e-5)
    found = fit_friction_to_peak(test)

    friction, (low, high) = found.estimate["friction"], found.interval["friction"]
    peak, spread = ROWE.stress_ratio, ROWE.stress_ratio_uncertainty
    thornton = [float(fcc_friction(peak + side * spread)) for side in (-1, 0, 1)]
    print(f"peak s1/s3 = {peak:g} +- {spread:g} ({ROWE.source})\n")
    print(f"{'friction from':42s}{'f':>9s}   {'interval':s}")
    print(f"{'this specimen, simulated':42s}{friction:9.4f}   {low:.4f} .. {high:.4f}")
    print(f"{'Thornton 1979, inverse formula':42s}{thornton[1]:9.4f}   {thornton[0]:.4f} .. {thornton[2]:.4f}")
    low, high = ROWE.friction - ROWE.friction_uncertainty, ROWE.friction + ROWE.friction_uncertainty
    print(f"{'measured by Rowe, 7 degrees (+- 0.5)':42s}{ROWE.friction:9.5f}  {low:.4f} .. {high:.4f}\n")
    print(found)
    draw(found, output, float(fcc_stress_ratio(ROWE.friction)))
    print(f"\n{time.perf_counter() - CLOCK:.1f} s, imports and compilation included; picture: {output}")


def draw(found, path: str, theory: float) -> None:
    """The fitted point with its interval on Thornton's line and on the specimen's tangent."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    f = np.linspace(0.06, 0.15, 100)
    axes.plot(f, 2 * (1 + f) / (1 - f), "0.5", label="Thornton 1979, R = 2(1 + f)/(1 - f)")
    friction, (low, high) = found.estimate["friction"], found.interval["friction"]
    slope = float(found.jacobian[0, 0]) / (friction * (1 - friction))
    near = np.linspace(low, high, 20)
    axes.plot(
        near, found.prediction[0] + slope * (near - friction), "C0", lw=2, label="specimen, secant of the last runs"
    )
    error = [[friction - low], [high - friction]]
    axes.errorbar(
        friction,
        ROWE.stress_ratio,
        ROWE.stress_ratio_uncertainty,
        error,
        "C0o",
        capsize=4,
        label="fitted to Rowe's peak",
    )
    axes.plot(ROWE.friction, theory, "kx", label=f"Thornton at Rowe's friction, R = {theory:.3f}")
    axes.axhline(ROWE.stress_ratio, color="k", lw=0.6, ls=":")
    axes.axvline(ROWE.friction, color="k", lw=0.6, ls=":")
    axes.set(xlabel="friction f [-]", ylabel="peak stress ratio s1/s3 [-]")
    axes.legend(frameon=False, fontsize="small")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
