"""Pictures of the boundary study: strength against the order of the sector, and profiles inside.

    python examples/boundary_pictures.py        # strength, again from the table in examples/pictures
"""

import csv
from pathlib import Path

import numpy as np
from boundary_statistics import ORDERS

from axijax.core.palette import COLOURS, STYLES

COLOUR = dict(zip(ORDERS, (*COLOURS[-1:], *COLOURS[:-1]), strict=True))  # of an order
MARKERS = "osD^"
FRICTION = 0.5  # at which profiles are shown
TABLE = Path(__file__).parent / "pictures" / "boundary_sensitivity.csv"


def draw(samples, table: Path) -> None:
    """Both pictures, beside the table of all numbers."""
    samples = {key: sample for key, sample in samples.items() if sample.runs}
    draw_strength(table)
    draw_profiles(samples, table.with_name("boundary_profiles.png"))


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


def draw_strength(table: Path) -> None:
    """How much stronger or weaker sectors are than the full cylinder, from the table alone."""
    lines = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    sizes = sorted({int(row["size"]) for row in rows})
    figure, axes = figure_of(2, 2)
    panels = (
        (axes[0, 0], "early ratio", "order", "R, mean over 1 to 5 % strain"),
        (axes[0, 1], "early ratio", "arc length [diameters]", "the same against the sector's arc, periodic"),
        (axes[1, 0], "critical ratio", "order", "R, mean over 11 to 15 % strain"),
    )
    for panel, name, against, title in panels:
        for size, colour, marker in zip(sizes, COLOURS, MARKERS, strict=False):
            for boundary in ("periodic", "rigid")[: 2 if against == "order" else 1]:
                some = [row for row in rows if (row["size"], row["friction"]) == (str(size), "all")]
                label = f"{size} balls" + ", rigid planes" * (boundary == "rigid")
                points(panel, some, boundary, name, against, colour, marker, label)
        panel.set_title(title)
        panel.set(xscale="log", xlabel="sectors n in the full cylinder [-]")
        panel.set_xticks(ORDERS[1:], [str(order) for order in ORDERS[1:]])
    axes[0, 1].set_xlabel("arc of the sector at Rm [mean ball diameters]")
    axes[0, 1].set_xticks([2, 3, 5, 10, 20], ["2", "3", "5", "10", "20"])
    for size, colour in zip(sizes, COLOURS, strict=False):
        full = [row for row in rows if (row["size"], row["order"]) == (str(size), "1") and row["early ratio"]]
        relative = [float(row["scatter of a run's early ratio"]) / float(row["early ratio"]) for row in full]
        for side in (-100, 100):
            axes[0, 1].axhline(side * np.sqrt(np.mean(np.square(relative))), color=colour, lw=0.7, linestyle="--")
    axes[0, 1].text(0.97, 0.04, "dashed: scatter of single\nfull cylinders", transform=axes[0, 1].transAxes, ha="right")

    by_friction = axes[1, 1]
    shown = [row for row in rows if int(row["size"]) == sizes[-1] and row["friction"] != "all"]
    for boundary, order in (("periodic", 4), ("periodic", 8), ("periodic", 12), ("rigid", 4), ("rigid", 12)):
        some = [row for row in shown if int(row["order"]) == order]
        label = f"n = {order}" + ", rigid" * (boundary == "rigid")
        points(by_friction, some, boundary, "early ratio", "friction", COLOUR[order], "o", label)
    by_friction.set(title=f"R, mean over 1 to 5 %, {sizes[-1]} balls", xlabel="friction f [-]")
    by_friction.legend(fontsize=8, ncols=2, loc="lower right", bbox_to_anchor=(1, 0.3))
    for panel in axes.ravel():
        panel.axhline(0, color="0.5", linewidth=0.8)
        panel.minorticks_off()
        panel.set_ylabel("change from the full cylinder [%]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(table.with_suffix(".png"), dpi=110)


def points(panel, rows, boundary, name, against, colour, marker, label) -> None:
    """A number's changes from the full cylinder, with error bars, against a column of the table."""
    changed = f"{name}, change from n = 1 [%]"
    mine = [row for row in rows if row["boundary"] == boundary and row[changed]]
    if not mine:
        return
    at, change, error = np.array([[float(row[key]) for key in (against, changed, f"{changed} +-")] for row in mine]).T
    sort, rigid = np.argsort(at), boundary == "rigid"
    panel.errorbar(
        at[sort], change[sort], error[sort], fmt=marker, linestyle=STYLES[3] if rigid else "-", color=colour,
        markersize=5, capsize=2, linewidth=1, label=label, markerfacecolor="white" if rigid else colour,
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
                axis.plot(at, values, line, color=COLOUR[order], linewidth=1.2, label=label)
            wall = "axis" if place == "axis" else "nearest sector plane"
            axis.set(title=title, xlabel=f"from the {wall} [mean diameters]")
            if name == "solid_fraction":
                axis.set_ylim(0, 0.8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8)
    figure.suptitle(f"Inside: {size} balls, f = {friction:g}, mean over the seeds")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw_strength(TABLE)
