"""Pictures of results and of the paper's figures, with matplotlib (imported on first use of this module)."""

import difflib
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from axijax.app import figures, soil_figures
from axijax.app.animation import save_animation
from axijax.app.labels import LETTERS, Lines, Measured, case_of, plain, readable, thornton_ratio
from axijax.app.results import Result, open_result
from axijax.app.snapshot import snapshot
from axijax.core.files import draw_afterwards, writable_folder, write_whole
from axijax.core.palette import COLOURS
from axijax.triaxial.progress import Run
from axijax.triaxial.test import TriaxialTest

# Colour is friction, style the boundary.
FRICTION_COLOURS = dict(zip((0.12278, 0.3, 0.05, 0.2), COLOURS, strict=False))
MARKERS = "s^DvPX*"


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    write_whole(path, lambda target: figure.savefig(target, dpi=150, bbox_inches="tight"))


def stress_ratio_figure(rows) -> Figure:
    """Stress ratio against axial strain of Table 1's runs, like figure 4(a) of the paper, with Thornton's lines; a
    band along each curve where it is within 0.3 % of its peak."""
    figure = Figure(figsize=(10, 5.5), layout="constrained")
    axes = figure.add_subplot()
    styles = {"periodic": "-", "rigid": "--", "full": ":"}
    for row in rows:
        run, curve = row.paper_run, row.run.curve
        colour = FRICTION_COLOURS.get(run.friction, "black")
        label = {
            "periodic": f"quarter, periodic planes, f = {run.friction:g}",
            "rigid": f"quarter, rigid planes, f = {run.friction:g}",
            "full": f"full cylinder, forces fixed, f = {run.friction:g}",
        }[run.boundary]
        axes.plot(
            100 * np.asarray(curve.axial_strain), curve.stress_ratio, styles[run.boundary], color=colour, lw=1.6,
            label=label, zorder=2,
        )  # fmt: skip
        strain, ratio = np.asarray(curve.axial_strain), np.asarray(curve.stress_ratio)
        start, end = row.flat
        flat = ~(strain < start) & ~(strain > end) & (strain <= 0.01)  # an open side goes to the end
        axes.plot(
            100 * strain[flat], ratio[flat], color=colour, lw=8, alpha=0.25, solid_capstyle="butt", zorder=1,
        )  # fmt: skip
        axes.plot(
            100 * run.paper_strain, run.paper, "o" if run.boundary == "periodic" else "s",
            color=colour, mfc="white" if run.boundary != "periodic" else colour, ms=6, zorder=4,
        )  # fmt: skip
        if run.boundary == "periodic":
            axes.axhline(run.theory, color=colour, lw=0.8, alpha=0.6)
            name = f"Thornton, f = {run.friction:g}"
            axes.text(0.985, run.theory + 0.02, name, color=colour, size=9, ha="right")
    axes.plot([], [], color="grey", lw=8, alpha=0.25, label="within 0.3 % of the peak")
    axes.plot([], [], "o", color="grey", label="paper's peaks, periodic planes")
    axes.plot([], [], "s", color="grey", mfc="white", label="paper's peaks, rigid planes and full system")
    axes.set(
        xlim=(0, 1), ylim=(1, 4), xlabel="axial strain [%]", ylabel="stress ratio s1/s3 [-]",
        title="FCC specimen, triaxial compression (Cui & O'Sullivan 2005, figure 4a)\n"
        + (f"stiffness 1.5e9 read as the {rows[0].stiffness}'s" if rows else ""),
    )  # fmt: skip
    axes.legend(fontsize=9, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    axes.grid(alpha=0.3)
    return figure


def curve_figure(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Stress ratio and volumetric strain against axial strain, one line a run; Thornton's stress ratio where the
    specimen is an FCC array; measured data as points."""
    figure = Figure(figsize=(5.6, 6.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    lines = Lines(results)
    ideal: dict[str, tuple[float, str]] = {}
    for number, (result, name, style) in enumerate(lines.each):
        curve, case = result.curve, case_of(result)
        strain = 100 * curve.axial_strain.values
        line = {**style, "lw": 1.6}
        # Marks, each line's at its own places, so that runs that coincide still show.
        if len(results) > 1 and lines.scale is None:
            every = max(strain.size // 8, 1)
            shift = number * every // len(results)
            line |= {"marker": MARKERS[number % len(MARKERS)], "ms": 4.5, "markevery": (shift, every)}
        upper.plot(strain, curve.stress_ratio.values, label=name, **line)
        lower.plot(strain, 100 * curve.volumetric_strain.values, **line)
        ratio = None if case is None else thornton_ratio(case)
        if case is not None and ratio is not None:
            friction = case.parameters.friction if case.scene.friction else 0.0
            ideal.setdefault(f"Thornton (1979), f = {friction:g}", (ratio, line["color"]))
    end = max(100 * float(result.curve.axial_strain.max()) for result in results)
    for label, (ratio, colour) in ideal.items() if lines.scale is None or len(ideal) == 1 else ():
        upper.plot([0, end], [ratio, ratio], color=colour, lw=1, ls=(0, (6, 3)), label=label)
    if data is not None:
        points = {"color": "black", "ls": "none", "marker": "o", "mfc": "none", "ms": 5}
        label = plain(f"measured, {Path(data.source).name}")
        upper.plot(100 * data.axial_strain, data.stress_ratio, label=label, **points)
        if data.volumetric_strain is not None:
            lower.plot(100 * data.axial_strain, 100 * data.volumetric_strain, **points)
    upper.set(ylabel="stress ratio s1/s3 [-]")
    handles, names = upper.get_legend_handles_labels()
    columns = 2 if len(names) > 2 and max(map(len, names)) < 34 else 1
    if names:
        figure.legend(handles, names, loc="outside lower center", ncols=columns, frameon=False, fontsize=LETTERS)
    lower.set(xlabel="axial strain [%]", ylabel="volumetric strain [%]\n(compression positive)")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    lines.bar(figure)
    return readable(figure)


# What `axijax plot --kind` draws of curves, all results in one picture.
CURVES = {"curve": curve_figure, **soil_figures.KINDS}


# Every picture, and how its file's name ends.
ANIMATION = "animation"
KNOWN = {**dict.fromkeys((*CURVES, *figures.KINDS), "png"), ANIMATION: "gif"}


def plot_result(
    results: Sequence[Result], kinds: Sequence[str], output: Path, data: Measured | None = None
) -> list[Path]:
    """Draw results as PNG files and return their paths.

    kinds: of `CURVES`, all results in one picture ("curve", "q-eps", ..), and of `figures.KINDS`, one picture a
        result: "force-network", "fabric-rose", "membrane-cells", "section", "specimen"; and "animation", a GIF.
    output: a file where one picture is made; otherwise a folder, made where it is missing.
    data: measured curve for the pictures against strain, and for "stress-dilatancy".

    A picture that cannot be drawn costs a warning, the others are drawn all the same.

    Raises ValueError for an unknown kind, for several pictures in one file, for a result without a last state, and
    where no picture could be drawn.
    """
    kinds = list(dict.fromkeys(kinds))
    for kind in kinds:
        if kind not in KNOWN:
            near = difflib.get_close_matches(kind, KNOWN, n=1, cutoff=0.4)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(KNOWN)}."
            raise ValueError(f"kind = '{kind}' is no picture; {hint}")
    count = sum(1 if kind in CURVES else len(results) for kind in kinds)
    if output.suffix and count > 1:
        raise ValueError(f"output '{output}': {count} pictures do not fit one file; give a folder.")
    writable_folder(output.parent if output.suffix else output)
    paths: list[Path] = []
    missing: list[str] = []

    def save(make: Callable[[], Figure], name: str) -> None:
        note(name, "png", lambda path: save_figure(make(), path))

    def note(name: str, end: str, write: Callable[[Path], object]) -> None:
        path = output if output.suffix else output / f"{name}.{end}"
        problem = draw_afterwards(path.name, lambda: write(path))
        if problem is None:
            paths.append(path)
        else:
            missing.append(problem)

    for kind in kinds:
        if kind in CURVES:
            save(partial(CURVES[kind], results, data), kind)
    drawn = [kind for kind in kinds if kind in figures.KINDS]
    names = [result.name for result in results]
    for number, result in enumerate(results):
        unique = names[number] if names.count(names[number]) == 1 else f"{names[number]}-{number + 1}"
        before = "" if len(results) == 1 else f"{unique}-"
        if ANIMATION in kinds:
            note(f"{before}{ANIMATION}", "gif", partial(save_animation, result))
        if not drawn:
            continue
        seen = snapshot(result.test, result.progress, full=True)
        for kind in drawn:
            save(partial(figures.KINDS[kind], seen), f"{before}{kind}")
    if not paths:
        raise ValueError("; ".join(missing) + ".")
    for problem in missing:
        warnings.warn(problem, stacklevel=2)
    return paths


def local_shear(test: TriaxialTest, displacement: np.ndarray) -> np.ndarray:
    """How far each ball has moved against its first neighbours, at most, in diameters; (N,)."""
    network = test.network
    listed = np.asarray(network.image) >= 0
    first, second, image = (np.asarray(a)[listed] for a in (network.first, network.second, network.image))
    relative = displacement[:, first] - test.sector.rotate(displacement[:, second], image)
    size = np.linalg.norm(relative, axis=0)
    largest = np.zeros(len(test.cut))
    np.maximum.at(largest, first, size)
    np.maximum.at(largest, second, size)
    return largest / (2 * test.cut.radius)


def deformed_figure(test: TriaxialTest, run: Run) -> Figure:
    """The deformed specimen, like figure 4(b) of the paper: from outside, in section through the axis, and in plan.

    The sector's images are filled in. Colour: displacement relative to the first neighbours, which draws the shear
    planes; ringed balls carry the membrane; dashed lines are the sector planes.
    """
    sector = test.sector
    displacement = run.positions - test.cut.positions
    shear = local_shear(test, displacement)
    turns = np.repeat(np.arange(sector.images), len(test.cut))
    balls = np.tile(np.arange(len(test.cut)), sector.images)
    once = (turns == 0) | ~sector.on_axis(test.cut.positions, test.cut.radius)[balls]
    balls, turns = balls[once], turns[once]
    x, y, z = sector.rotate(run.positions[:, balls], turns)
    moved = sector.rotate(displacement[:, balls], turns)
    value, radius, zone = shear[balls], test.cut.radius[balls], test.cut.membrane_zone[balls]
    bottom, top = (float(height) for height in run.state.platens)
    unit = float(test.cut.radius.mean())
    colours = matplotlib.colors.Normalize(0.0, max(float(np.quantile(shear, 0.98)), 1e-12))
    curve = run.curve

    figure = Figure(figsize=(13.5, 6.2), layout="constrained")
    outside, section, plan = figure.subplots(1, 3, width_ratios=(1, 1, 1.05))
    cut_open = (y > -0.3 * unit) & (y < 1.3 * unit)
    views = (
        (outside, np.ones(x.size, bool), x, z, y, "from outside"),
        (section, cut_open, x, z, y, "section beside the axis"),
        (plan, np.abs(z - (bottom + top) / 2) < 1.8 * unit, x, y, z, "plan at mid-height"),
    )
    for axes, shown, across, up, depth, title in views:
        order = np.flatnonzero(shown)
        order = order[np.argsort(-depth[order] if axes is not plan else depth[order])]
        size = 2 * radius[order] / unit
        circles = EllipseCollection(
            size, size, np.zeros(order.size), units="xy", transOffset=axes.transData,
            offsets=np.stack([across[order], up[order]], axis=1) / unit,
            edgecolors=np.where(zone[order], "black", "0.6"), linewidths=np.where(zone[order], 1.1, 0.3),
            cmap="YlOrRd", norm=colours,
        )  # fmt: skip
        circles.set_array(value[order])
        axes.add_collection(circles)
        axes.set(aspect="equal", title=title, xlabel="x / r")
    for axes in (outside, section):
        for height in (bottom, top):
            axes.axhline(height / unit, color="0.2", lw=3)
        axes.set(xlim=(-12.5, 12.5), ylim=(bottom / unit - 1, top / unit + 1), ylabel="z / r")
    lines = np.flatnonzero(cut_open)
    section.quiver(
        x[lines] / unit, z[lines] / unit, moved[0][lines] / unit, moved[2][lines] / unit,
        angles="xy", scale_units="xy", scale=1, width=0.003, color=COLOURS[0],
    )  # fmt: skip
    reach = 12.0
    for k in range(sector.order):
        angle = k * sector.angle
        plan.plot([0, reach * np.cos(angle)], [0, reach * np.sin(angle)], "--", color="black", lw=1)
    ring = np.linspace(0, 2 * np.pi, 181)
    membrane = float(curve.membrane_radius[-1]) / unit
    plan.plot(membrane * np.cos(ring), membrane * np.sin(ring), color=COLOURS[2], lw=1, label="membrane radius Rm")
    plan.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), frameon=False, fontsize=LETTERS)
    plan.set(xlim=(-12.5, 12.5), ylim=(-12.5, 12.5), ylabel="y / r")
    figure.colorbar(
        matplotlib.cm.ScalarMappable(colours, "YlOrRd"), ax=[outside, section, plan], shrink=0.7, pad=0.01,
        label="displacement relative to first neighbours / diameter",
    )  # fmt: skip
    friction = test.params.friction
    told = "without friction" if friction is None else f"f = {float(np.mean(np.asarray(friction))):g}"
    figure.suptitle(
        f"Deformed specimen, {told}, axial strain {100 * float(curve.axial_strain[-1]):.4g} % "
        "(arrows: displacement; ringed: membrane zone; dashed: sector planes)"
    )
    return figure


def draw_curve(folder: Path) -> str | None:
    """Draw curve.png of the curve.nc in a folder: None, or a sentence that says why it is missing."""

    def draw() -> None:
        save_figure(curve_figure([open_result(folder / "curve.nc")]), folder / "curve.png")

    return draw_afterwards("curve.png", draw)
