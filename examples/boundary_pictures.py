"""Pictures of the boundary study: strength against the order of the sector, and profiles inside."""

from pathlib import Path

import numpy as np
from boundary_statistics import ORDERS, STRAINS, changes, curves_of, full_scatter, of_size

COLOURS = dict(zip(ORDERS, ("black", "C0", "C9", "C2", "C8", "C1", "C3"), strict=True))
FRICTION = 0.5  # at which curves and profiles are shown


def draw(samples, folder: Path) -> None:
    """Both pictures, into a folder."""
    samples = {key: sample for key, sample in samples.items() if sample.runs}
    draw_strength(samples, folder / "boundary_sensitivity.png")
    draw_profiles(samples, folder / "boundary_profiles.png")


def largest(samples):
    """Samples of the largest size that has most orders, at one friction, by (boundary, order); size, friction."""
    shown = {key: sample for key, sample in samples.items() if key[1] == FRICTION} or samples
    orders = {size: sum(key[0] == size for key in shown) for size in {key[0] for key in shown}}
    size = max(orders, key=lambda size: (orders[size], size))
    friction = next(key[1] for key in shown if key[0] == size)
    return {key[2:]: sample for key, sample in shown.items() if key[:2] == (size, friction)}, size, friction


def figure_of(rows: int, columns: int):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.1 * columns, 3.6 * rows + 0.8), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def draw_strength(samples, path: Path) -> None:
    figure, axes = figure_of(2, 4)
    shown, size, friction = largest(samples)
    for (boundary, order), sample in sorted(shown.items()):
        if boundary == "rigid" and order not in (4, 12):
            continue
        curves = curves_of(list(sample.runs.values()))
        style = {"color": COLOURS[order], "linestyle": "-" if boundary == "periodic" else ":", "linewidth": 1.3}
        label = f"{order}" + ", rigid" * (boundary == "rigid")
        axes[0, 0].plot(100 * STRAINS, curves["stress_ratio"].mean(axis=0), label=label, **style)
        axes[1, 0].plot(100 * STRAINS, 100 * curves["volumetric_strain"].mean(axis=0), **style)
    specimens = f"{size} balls, f = {friction:g}"
    axes[0, 0].set(title=f"stress ratio R, mean curves,\n{specimens}", xlabel="axial strain [%]", ylim=(0.7, None))
    axes[0, 0].legend(title="n", ncols=5, fontsize=7, loc="lower right", columnspacing=1)
    axes[1, 0].set(title="volumetric strain [%] (compression positive),\nthe same", xlabel="axial strain [%]")

    scatter = full_scatter(samples)
    sizes = {size: f"C{place}" for place, size in enumerate(sorted(scatter))}
    panels = (
        (axes[0, 1], "early ratio", False, "R, mean over 1 to 5 % strain, change from\nn = 1 [%], mean over f"),
        (axes[0, 2], "early ratio", True, "the same against the sector's arc,\nperiodic only"),
        (axes[0, 3], "early ratio x (1 + void ratio)", False, "R (1 + e), the same mean: as if the core\nwere filled"),
        (axes[1, 1], "peak ratio", False, "peak of the mean curve, change [%]"),
        (axes[1, 2], "critical ratio", False, "R, mean over 11 to 15 % strain, change [%]"),
    )
    for panel, name, against_arc, title in panels:
        found = changes(samples, name)
        for size, colour in sizes.items():
            for boundary in ("periodic", "rigid")[: 1 if against_arc else 2]:
                some = {order: value for (which, order), value in of_size(found, size).items() if which == boundary}
                label = f"{size} balls" + ", rigid planes" * (boundary == "rigid")
                points(panel, some, colour, boundary, label, against_arc)
        panel.set_title(title)
    for panel in (axes[0, 1], axes[0, 2]):
        for size, colour in sizes.items():
            for side in (-1, 1):
                panel.axhline(side * scatter[size], color=colour, linewidth=0.7, linestyle="--")
    axes[0, 1].text(0.03, 0.04, "dashed: scatter of single\nfull cylinders", transform=axes[0, 1].transAxes, fontsize=8)

    by_friction = axes[1, 3]
    frictions = sorted({sample.friction for sample in samples.values()})
    found = {f: of_size(changes(samples, "early ratio", (f,)), largest(samples)[1]) for f in frictions}
    for boundary, order in (("periodic", 4), ("periodic", 8), ("periodic", 12), ("rigid", 4), ("rigid", 12)):
        some = {f: found[f][boundary, order] for f in frictions if (boundary, order) in found[f]}
        if some:
            label = f"n = {order}" + ", rigid" * (boundary == "rigid")
            points(by_friction, some, COLOURS[order], boundary, label, False)
    by_friction.set(title=f"R, mean over 1 to 5 %, change [%],\n{largest(samples)[1]} balls", xlabel="friction f")
    low, high = by_friction.get_ylim()
    by_friction.set_ylim(low, high + 0.3 * (high - low))
    by_friction.legend(fontsize=7, ncols=2, loc="upper center")
    for panel in axes.ravel():
        if panel not in (axes[0, 0], axes[1, 0]):
            panel.axhline(0, color="0.5", linewidth=0.8)
    for panel in (axes[0, 1], axes[0, 3], axes[1, 1], axes[1, 2]):
        panel.set(xscale="log", xlabel="sectors n in the full cylinder")
        panel.set_xticks(ORDERS[1:], [str(order) for order in ORDERS[1:]])
        panel.minorticks_off()
    axes[0, 2].set(xscale="log", xlabel="arc of the sector at Rm [mean ball diameters]")
    axes[0, 2].set_xticks([2, 3, 5, 10, 20], ["2", "3", "5", "10", "20"])
    axes[0, 2].minorticks_off()
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    seeds = max(len(sample.runs) for sample in samples.values())
    figure.suptitle(f"Random dense specimens against the order of the sector: means of {seeds} seeds, standard errors")
    figure.savefig(path, dpi=110)


def points(panel, some, colour, boundary, label, against_arc) -> None:
    """Changes (change, error, arc) by order or friction, with error bars."""
    x = [value[2] if against_arc else at for at, value in some.items()]
    change, error, _ = np.array(list(some.values())).reshape(-1, 3).T
    rigid = boundary == "rigid"
    panel.errorbar(
        x, change, error, fmt="s:" if rigid else "o-", color=colour, markersize=5, capsize=2, linewidth=1,
        label=label, markerfacecolor="white" if rigid else colour,
    )  # fmt: skip


def mean_profile(runs, stage: str, name: str):
    """(middles of the bins [mean diameters], mean over the runs); parts of the fabric weighted with the contacts."""
    some = [run["profiles"][stage] for run in runs]
    edges = np.mean([np.array(p["edges"]) / run["mean_radius"] / 2 for p, run in zip(some, runs, strict=True)], axis=0)
    values, weight = (np.array([p[key] for p in some], float) for key in (name, "contacts"))
    if name == "solid_fraction":
        weight = np.ones_like(values)
    kept = weight * np.isfinite(values)
    total = kept.sum(axis=0)
    mean = (kept * np.nan_to_num(values)).sum(axis=0) / np.where(total > 0, total, np.nan)
    return (edges[1:] + edges[:-1]) / 2, mean


def draw_profiles(samples, path: Path) -> None:
    shown, size, friction = largest(samples)
    figure, axes = figure_of(2, 4)
    panels = (
        ("start", "solid_fraction", "solid fraction before shear"),
        ("end", "solid_fraction", "solid fraction after 15 %"),
        ("end", "circumferential", "circumferential part of the fabric, after 15 %"),
        ("end", "vertical", "vertical part of the fabric, after 15 %"),
    )
    for row, place in zip(axes, ("axis", "plane"), strict=True):
        for axis, (stage, name, title) in zip(row, panels, strict=True):
            for (boundary, order), sample in sorted(shown.items()):
                if boundary == "rigid" and order not in (4, 12):
                    continue
                at, values = mean_profile(list(sample.runs.values()), f"{stage} {place}", name)
                label = f"n = {order}" + ", rigid" * (boundary == "rigid")
                line = "-" if boundary == "periodic" else ":"
                axis.plot(at, values, line, color=COLOURS[order], linewidth=1.2, label=label)
            wall = "axis" if place == "axis" else "nearest sector plane"
            axis.set(title=title, xlabel=f"from the {wall} [mean diameters]")
            if name == "solid_fraction":
                axis.set_ylim(0, 0.8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(f"Inside: {size} balls, f = {friction:g}, mean over the seeds")
    figure.savefig(path, dpi=110)
