"""Where a time step gives the wrong strength, and what the program says about it: a map, some minutes on two cores.

    python examples/stability_map.py [--output stability_map.png] [--quick]

The quarter of Cui & O'Sullivan (2005) is sheared past its peak with time steps from 0.4 of the critical one to beyond
it, with local damping 0.7 and with dashpots of beta = 0.05, 0.1 and 0.3, at frictions from 0.05 to 0.3. Every peak is
compared with that of the same specimen at a small step (beta = 0.05, 0.1 sqrt(m/K)). Past the limit nothing blows up:
the Coulomb cap bounds the motion, contacts chatter, and the peak falls to a plausible number. Hatched: refused by
default (above 0.8 of the computed limit). Crosses: the guard's error, contacts chatter at the peak. Rings: its
warning, they chattered before it only. Written beside the picture: the table, as CSV.
"""

import argparse
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

CLOCK = time.perf_counter()

import axijax  # noqa: E402

axijax.fast_cpu_kernels()

from axijax.app.results import save_table  # noqa: E402
from axijax.core.status import UNSTABLE  # noqa: E402
from axijax.mechanics.damping import Damping  # noqa: E402
from axijax.mechanics.time_step import SAFE_STEP, critical_time_step  # noqa: E402
from axijax.triaxial.records import CHATTER  # noqa: E402

DAMPING = {
    "local damping 0.7": axijax.LocalDamping(0.7),
    "dashpots 0.05": axijax.Dashpot(0.05),
    "dashpots 0.1": axijax.Dashpot(0.1),
    "dashpots 0.3": axijax.Dashpot(0.3),
}
FRICTION = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
SHARE = (0.4, 0.6, 0.72, 0.78, 0.84, 0.88, 0.92, 0.96, 1.0, 1.05, 1.1, 1.2, 1.4)  # of the computed limit
COLUMNS = (
    "damping", "friction", "share_of_limit", "step_over_sqrt_m_k", "peak", "relative_error", "refused", "guard",
    "largest_chatter", "chatter_at_peak",
)  # fmt: skip


def make_test(damping: Damping, friction: float, **options) -> axijax.TriaxialTest:
    """The quarter, sheared just past its peak."""
    return axijax.TriaxialTest(
        axijax.fcc_octagon(),
        params=axijax.Params(friction=friction, damping=damping),
        axial_strain=0.005,
        tolerance=1e-5,
        allow_unsafe_step=True,
        **options,
    )


def peak_of(test: axijax.TriaxialTest) -> tuple[float, str, float, float]:
    """Peak stress ratio, the guard's verdict, the largest chatter, and that at the peak."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            curve = test.run().curve
    except axijax.SimulationError as error:
        curve = error.curve
    chatter, peak = np.asarray(curve.chatter), int(np.argmax(curve.stress_ratio))
    status = int(curve.status)
    verdict = "error" if status == UNSTABLE else "warning" if (chatter > CHATTER).any() else "quiet"
    return float(curve.stress_ratio[peak]), verdict, float(chatter.max()), float(chatter[peak])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", default="stability_map.png", type=Path, help="picture to write, table beside it")
    parser.add_argument("--quick", action="store_true", help="two frictions and four steps only")
    options = parser.parse_args()
    frictions = FRICTION[::5] if options.quick else FRICTION
    shares = SHARE[1::4] if options.quick else SHARE

    first = make_test(axijax.Dashpot(0.05), 0.3)
    mass = first.params.material.mass_per_cube * first.cut.radius[0] ** 3
    unit = float((mass / first.params.normal_stiffness) ** 0.5)
    limits = {
        name: critical_time_step(first.scene, axijax.Params(damping=damping), first.network)
        for name, damping in DAMPING.items()
    }

    def reference(friction: float) -> float:
        return peak_of(make_test(axijax.Dashpot(0.05), friction, time_step=0.1 * unit))[0]

    def row(name: str, friction: float, share: float) -> dict[str, object]:
        step = share * limits[name]
        peak, verdict, largest, at_peak = peak_of(make_test(DAMPING[name], friction, time_step=step))
        return {
            "damping": name,
            "friction": friction,
            "share_of_limit": share,
            "step_over_sqrt_m_k": round(step / unit, 4),
            "peak": round(peak, 4),
            "relative_error": round(peak / right[friction] - 1, 5),
            "refused": share > SAFE_STEP,
            "guard": verdict,
            "largest_chatter": round(largest, 6),
            "chatter_at_peak": round(at_peak, 6),
        }

    rows = []
    cases = [(name, friction, share) for name in DAMPING for friction in frictions for share in shares]
    with ThreadPoolExecutor(2) as pool:
        right = dict(zip(frictions, pool.map(reference, frictions), strict=True))
        for found in pool.map(lambda case: row(*case), cases):
            rows.append(found)
            print(
                f"{len(rows):3d}/{len(cases)} {found['damping']:17s} f = {found['friction']:g}, "
                f"{found['share_of_limit']:4.2f} of the limit: peak {found['peak']:.3f} "
                f"({100 * found['relative_error']:+.2f} %), {found['guard']}",
                flush=True,
            )
    options.output = options.output.with_suffix(".png")
    table = options.output.with_suffix(".csv")
    save_table(table, COLUMNS, rows)
    draw(rows, limits, unit, options.output)
    silent = [r for r in rows if abs(r["relative_error"]) > 0.01 and not r["refused"] and r["guard"] != "error"]
    alarms = [r for r in rows if r["guard"] == "error" and abs(r["relative_error"]) < 0.001 and not r["refused"]]
    wrong = sum(abs(r["relative_error"]) > 0.01 for r in rows)
    caught = sum(abs(r["relative_error"]) > 0.01 and r["guard"] == "error" for r in rows)
    print(
        f"\n{len(rows)} runs, {wrong} peaks off by more than 1 %: {wrong - len(silent)} of them refused or caught "
        f"({caught} by the guard alone), {len(silent)} neither; {len(alarms)} false alarms.\n"
        f"{time.perf_counter() - CLOCK:.0f} s; picture: {options.output}, table: {table}"
    )


def draw(rows, limits, unit, path: Path) -> None:
    """One panel for each damping: friction against step, coloured by the error of the peak."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = Figure(figsize=(11.5, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    frictions, shares = (sorted({r[name] for r in rows}) for name in ("friction", "share_of_limit"))
    levels = [-60, -30, -10, -3, -1, -0.3, 0.3, 1, 3]
    colours = ListedColormap(["#67001f", "#b2182b", "#e0603f", "#f4a582", "#fde0d2", "#f2f2f2", "#9ecae1", "#4292c6"])
    norm = BoundaryNorm(levels, colours.N)
    panels = figure.subplots(2, 2, sharey=True).ravel()
    for axes, (name, limit) in zip(panels, limits.items(), strict=True):
        mine = {(r["friction"], r["share_of_limit"]): r for r in rows if r["damping"] == name}
        error = np.array([[100 * mine[f, share]["relative_error"] for share in shares] for f in frictions])
        column = np.arange(len(shares))
        axes.pcolormesh(
            np.arange(len(shares) + 1) - 0.5, np.arange(len(frictions) + 1) - 0.5, error, cmap=colours, norm=norm,
            edgecolors="white", linewidth=0.5,
        )  # fmt: skip
        first_refused = np.searchsorted(shares, SAFE_STEP + 1e-9) - 0.5
        axes.axvspan(first_refused, len(shares) - 0.5, fill=False, hatch="//", edgecolor="0.45", lw=0, alpha=0.5)
        axes.axvline(first_refused, color="k", lw=1.5)
        for y, friction in enumerate(frictions):
            for x, share in enumerate(shares):
                verdict = mine[friction, share]["guard"]
                mark = {"error": "x", "warning": "o"}.get(verdict)
                if mark:
                    axes.plot(x, y, mark, color="w" if error[y, x] < -10 else "k", mfc="none", ms=7, mew=1.6)
        axes.set_xticks(column, [f"{share:g}\n{share * limit / unit:.3f}" for share in shares], fontsize=7.5)
        axes.set_yticks(np.arange(len(frictions)), [f"{friction:g}" for friction in frictions])
        axes.set_title(f"{name}: computed limit {limit / unit:.3f} " + r"$\sqrt{m/K}$", fontsize=10)
    for axes in panels[::2]:
        axes.set_ylabel("friction f [-]")
    for axes in panels[2:]:
        axes.set_xlabel(r"time step over the computed limit; below it over $\sqrt{m/K}$")
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=panels, ticks=levels, pad=0.01, spacing="uniform")
    bar.set_label("error of the peak stress ratio [%]")
    figure.legend(
        handles=[
            Patch(fill=False, hatch="//", edgecolor="0.25", label=f"refused (above {SAFE_STEP:g} of the limit)"),
            Line2D([], [], color="k", marker="x", ls="", mew=1.6, label="guard: error, chatter at the peak"),
            Line2D([], [], color="k", marker="o", ls="", mfc="none", mew=1.6, label="guard: warning, chatter before"),
        ],
        loc="outside lower center", ncols=3, frameon=False, fontsize=9,
    )  # fmt: skip
    figure.suptitle("Silent loss of strength at too long a time step: quarter FCC octagon, 427 balls", fontsize=11)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
