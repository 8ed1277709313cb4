"""Pictures of the balls at one moment: force network, fabric rose, membrane cells, section, the specimen in space.

All take a snapshot with the sector's images filled in; a sector between rigid planes has none and is shown alone.
"""

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure

from axijax.app.labels import LETTERS, readable
from axijax.app.snapshot import Snapshot

STUCK, SLIDING, OWN, IMAGE = "#0072B2", "#D55E00", "#0072B2", "#B8B8B8"
ROSE_BINS = 9  # from horizontal to vertical
DISCS = 15_000  # that shade all balls in space together, 6 to 24 each


def force_network(seen: Snapshot) -> Figure:
    """Touching contacts in a section a ball thick beside the axis, coloured by sliding, wide by normal force."""
    unit = float(seen.balls.radius.mean())
    contacts = seen.contacts
    start, end = _to_section(seen, contacts.start), _to_section(seen, contacts.end)
    shown = _in_section((start[1] + end[1]) / 2, unit)
    mean = float(np.average(contacts.normal_force, weights=contacts.share)) if contacts.first.size else 1.0
    figure, axes = _figure(seen, (5.6, 6.6), "contact forces in a vertical section")
    _circles(axes, seen, unit)
    for sliding, colour in ((False, STUCK), (True, SLIDING)):
        part = np.flatnonzero(shown & (contacts.sliding == sliding))
        lines = [*np.stack([start[::2, part].T, end[::2, part].T], axis=1)]
        widths = 2.5 * contacts.normal_force[part] / mean
        axes.add_collection(LineCollection(lines, linewidths=widths, colors=colour, capstyle="round"))
    for label, colour in (("not sliding", STUCK), ("sliding", SLIDING)):
        axes.plot([], [], color=colour, lw=2.5, label=label)
    for size in (0.5, 1, 2):
        axes.plot([], [], color="0.4", lw=2.5 * size, label=f"{size:g} x mean ({size * mean:.2g} [F])")
    _frame(axes, seen, unit)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, title="width: normal force", fontsize=LETTERS)
    return readable(figure)


def fabric_rose(seen: Snapshot) -> Figure:
    """Contact normals by inclination, counted and weighted by normal force: density over the sphere, 1 where all
    directions are alike. Axisymmetric, so one quadrant is shown four times."""
    contacts = seen.contacts
    inclination = np.arctan2(np.abs(contacts.normal[2]), np.hypot(*contacts.normal[:2]))
    edges = np.linspace(0, np.pi / 2, ROSE_BINS + 1)
    share = np.diff(np.sin(edges))  # of the half sphere between two inclinations
    figure = Figure(figsize=(7.5, 5.4), layout="constrained")
    figure.suptitle(f"fabric: contact normals by their angle above the horizontal\n{_moment(seen)}", fontsize=LETTERS)
    weights = (("number", contacts.share), ("normal force", contacts.share * contacts.normal_force))
    for place, (name, weight) in enumerate(weights):
        axes = figure.add_subplot(1, 2, place + 1, projection="polar", rlabel_position=292.5)
        held = np.histogram(inclination, edges, weights=weight)[0]
        density = held / max(held.sum(), 1e-300) / share
        middle = (edges[1:] + edges[:-1]) / 2
        for sign, turn in ((1, 0), (-1, np.pi), (1, np.pi), (-1, 2 * np.pi)):
            axes.bar(
                turn + sign * middle, density, width=np.diff(edges), color=OWN, alpha=0.75, edgecolor="white", lw=0.8
            )
        ring = np.linspace(0, 2 * np.pi, 181)
        axes.plot(ring, np.ones_like(ring), "--", color=SLIDING, lw=1.4, label="isotropic = 1")
        axes.set_xlabel(f"weighted by {name}", labelpad=10)
        axes.set_xticks(np.deg2rad([0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330]))
        axes.set_xticklabels(["0°", "30°", "60°", "90°\n(vertical)", *[""] * 8])
    axes.legend(loc="lower right", bbox_to_anchor=(1.12, -0.24), frameon=False, fontsize=LETTERS)
    return readable(figure)


def membrane_cells(seen: Snapshot) -> Figure:
    """The membrane's Voronoi cells on the unfolded cylinder of radius Rm, coloured by their areas."""
    membrane = seen.membrane
    if not membrane.polygons:
        raise ValueError("membrane-cells: this test is loaded without a membrane, so there are no cells to draw.")
    figure, axes = _figure(seen, (8, 4.6), "membrane cells on the unfolded cylinder (dots: balls)")
    width = membrane.radius * seen.sector.angle
    turns = seen.sector.images
    # Cells across the ends of the unfolded cylinder are shown at both.
    around = (-1, 0, 1) if seen.sector.boundary == "periodic" else (0,)
    shown = [polygon + np.array([k * turns * width, 0.0]) for k in around for polygon in membrane.polygons]
    cells = PolyCollection(shown, edgecolors="white", linewidths=0.5, cmap="cividis")
    cells.set_array(np.tile(membrane.area, len(around)))
    axes.add_collection(cells)
    figure.colorbar(cells, ax=axes, label="area of a cell [L²]", shrink=0.8, pad=0.015)
    axes.plot(*membrane.places, ".", color="black", ms=2.5)
    for k in range(turns + 1):
        axes.axvline(k * width, color="black", lw=0.9, ls="--")
    bottom, top = seen.platens.heights
    for height in (bottom, top):
        axes.axhline(height, color="0.2", lw=2)
    margin = 0.03 * (top - bottom)
    axes.set(
        aspect="equal", xlim=(0, turns * width), ylim=(bottom - margin, top + margin),
        xlabel="x' = angle times Rm [L]", ylabel="z [L]",
    )  # fmt: skip
    degrees = axes.secondary_xaxis(
        "top", functions=(lambda x: np.rad2deg(x / membrane.radius), lambda d: np.deg2rad(d) * membrane.radius)
    )
    degrees.set_xlabel("angle [degrees]")
    return readable(figure)


def section(seen: Snapshot) -> Figure:
    """The specimen in a vertical section beside the axis and in plan at mid-height, coloured by the balls' mean
    stress; the membrane's balls are ringed."""
    balls = seen.balls
    unit = float(balls.radius.mean())
    bottom, top = seen.platens.heights
    stress = np.trace(balls.stress) / 3 / seen.confining_stress
    place = _to_section(seen, balls.positions)
    x, y, z = balls.positions
    middle = (bottom + top) / 2
    cut, level = _in_section(place[1], unit), np.abs(z - middle) < 1.01 * unit
    scale = Normalize(0, float(np.quantile(stress[cut | level], 0.98)) if (cut | level).any() else 1.0)
    figure = Figure(figsize=(8.5, 5.4), layout="constrained")
    figure.suptitle(f"specimen in section, {_moment(seen)}")
    upright, plan = figure.subplots(1, 2)
    for axes, across, up, depth, shown in ((upright, place[0], z, -place[1], cut), (plan, x, y, z, level)):
        order = np.flatnonzero(shown)
        order = order[np.argsort(depth[order])]
        circles = _discs(axes, across[order], up[order], balls.radius[order])
        circles.set(
            cmap="cividis", norm=scale, edgecolors=np.where(balls.membrane_zone[order], SLIDING, "white"),
            linewidths=np.where(balls.membrane_zone[order], 1.6, 0.4),
        )  # fmt: skip
        circles.set_array(stress[order])
    _frame(upright, seen, unit)
    upright.set(title="vertical section")
    ring, reach = np.linspace(0, 2 * np.pi, 181), _reach(seen)
    if seen.membrane.radius > 0:
        alone = np.linspace(0, seen.sector.angle, 91) if seen.sector.boundary == "rigid" else ring
        Rm = seen.membrane.radius
        plan.plot(Rm * np.cos(alone), Rm * np.sin(alone), color="#009E73", lw=1.4, label="membrane radius Rm")
    if seen.sector.order > 1:
        for k in range(seen.sector.images if seen.sector.images > 1 else 2):
            angle = k * seen.sector.angle
            label = "sector planes" if k == 0 else None
            plan.plot([0, reach * np.cos(angle)], [0, reach * np.sin(angle)], "--", color="black", lw=1, label=label)
    plan.plot([], [], "o", mfc="white", mec=SLIDING, mew=1.6, label="carries the membrane")
    edge, least = 0.6 * unit, 0.0 if seen.sector.boundary == "rigid" and seen.sector.order >= 4 else -reach
    plan.set(
        aspect="equal", title="plan at mid-height", xlabel="x [L]", ylabel="y [L]",
        xlim=(least - edge, reach + edge), ylim=(least - edge, reach + edge),
    )  # fmt: skip
    plan.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False, fontsize=LETTERS)
    figure.colorbar(
        matplotlib.cm.ScalarMappable(scale, "cividis"), ax=[upright, plan], shrink=0.75, pad=0.015, extend="max",
        label="mean stress of a ball / confining stress [-]",
    )  # fmt: skip
    return readable(figure)


def specimen(seen: Snapshot) -> Figure:
    """The specimen in space from aside and above, the farthest balls first: the simulated sector's in colour, their
    images in grey."""
    balls, sector = seen.balls, seen.sector
    unit = float(balls.radius.mean())
    view, rise = sector.angle / 2 - np.deg2rad(20 if sector.order > 1 else 0), np.deg2rad(22)
    right = np.array([-np.sin(view), np.cos(view), 0.0])
    towards = np.array([np.cos(rise) * np.cos(view), np.cos(rise) * np.sin(view), np.sin(rise)])
    up = np.cross(towards, right)
    figure, axes = _figure(seen, (5.6, 6.2), "specimen")
    bottom, top = seen.platens.heights
    reach = _reach(seen)

    def outline(height, angles, closed=False):
        ring = np.stack([reach * np.cos(angles), reach * np.sin(angles), np.full(angles.size, height)])
        if closed:
            ring = np.concatenate([ring, np.array([[0.0], [0.0], [height]])], axis=1)
        return right @ ring, up @ ring

    alone = sector.boundary == "rigid"
    ring = np.linspace(0, sector.angle if alone else 2 * np.pi, 181)
    axes.fill(*outline(bottom, ring, alone), fc="0.88", ec="0.4", lw=1, zorder=0)
    order = np.argsort(towards @ balls.positions)
    across, height, radius = (values[order] for values in (right @ balls.positions, up @ balls.positions, balls.radius))
    base = np.where((balls.image[order] == 0)[:, None], to_rgb(OWN), to_rgb(IMAGE))
    # Discs that shrink towards the light and grow paler, one ball after another.
    step = np.linspace(0, 1, int(np.clip(DISCS / radius.size, 6, 24)))[None, :]
    pale = 0.55 + 0.45 * np.minimum(step * 1.6, 1)
    white = 0.55 * np.clip(step - 0.4, 0, None) ** 1.5
    colours = base[:, None, :] * pale[..., None] * (1 - white[..., None]) + white[..., None]
    shrink = radius[:, None] * (1 - 0.8 * step)
    offset = 0.35 * radius[:, None] * step
    discs = _discs(axes, (across[:, None] - offset).ravel(), (height[:, None] + offset).ravel(), shrink.ravel())
    discs.set(facecolors=colours.reshape(-1, 3), edgecolors="none", zorder=1)
    axes.fill(*outline(top, ring, alone), fc=(0.88, 0.88, 0.88, 0.25), ec="0.4", lw=1, zorder=2)
    if sector.order > 1:
        for k in range(2 if alone else sector.order):
            line = outline(top, np.array([k * sector.angle]), closed=True)
            axes.plot(*line, "--", color="black", lw=1, zorder=3)
    own, images = int((balls.image == 0).sum()), int((balls.image > 0).sum())
    axes.plot([], [], "o", color=OWN, ms=9, label=f"simulated: {own} balls")
    if images:
        axes.plot([], [], "o", color=IMAGE, ms=9, label=f"images: {images}")
    axes.legend(loc="upper left", bbox_to_anchor=(0, 0.02), ncols=2, frameon=False, fontsize=LETTERS)
    axes.set_aspect("equal")
    axes.margins(0.02 + 0.1 * unit / reach)
    axes.autoscale_view()
    axes.set_axis_off()
    return readable(figure)


# What `axijax plot --kind` draws of a last state.
KINDS: dict[str, Callable[[Snapshot], Figure]] = {
    "force-network": force_network,
    "fabric-rose": fabric_rose,
    "membrane-cells": membrane_cells,
    "section": section,
    "specimen": specimen,
}


def _moment(seen: Snapshot) -> str:
    return f"axial strain {100 * seen.axial_strain:.3g} %, stress ratio {seen.stress_ratio:.3f}"


def _figure(seen: Snapshot, size: tuple[float, float], title: str):
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(f"{title}\n{_moment(seen)}", fontsize=LETTERS)
    return figure, axes


def _to_section(seen: Snapshot, places: np.ndarray) -> np.ndarray:
    """Places with the section's plane turned to y = 0: the plane y = 0 itself, or midway between two rigid planes."""
    if seen.sector.boundary == "periodic":
        return places
    turn = -seen.sector.angle / 2
    cos, sin = np.cos(turn), np.sin(turn)
    return np.stack([cos * places[0] - sin * places[1], sin * places[0] + cos * places[1], places[2]])


def _in_section(y: np.ndarray, unit: float) -> np.ndarray:
    # One layer of a cubic array, wherever its layers are; about one ball of a random one.
    return (y > -0.3 * unit) & (y < 1.3 * unit)


def _reach(seen: Snapshot) -> float:
    """Outermost surface of any ball from the axis [L]."""
    return float((np.hypot(*seen.balls.positions[:2]) + seen.balls.radius).max())


def _discs(axes, across: np.ndarray, up: np.ndarray, radius: np.ndarray) -> EllipseCollection:
    discs = EllipseCollection(
        2 * radius, 2 * radius, np.zeros(radius.size), units="xy", transOffset=axes.transData,
        offsets=np.stack([across, up], axis=1),
    )  # fmt: skip
    axes.add_collection(discs)
    axes.update_datalim(np.stack([across, up], axis=1))
    return discs


def _circles(axes, seen: Snapshot, unit: float) -> None:
    """Outlines of the section's balls."""
    x, y, z = _to_section(seen, seen.balls.positions)
    order = np.flatnonzero(_in_section(y, unit))
    order = order[np.argsort(-y[order])]
    _discs(axes, x[order], z[order], seen.balls.radius[order]).set(facecolors="0.96", edgecolors="0.75", linewidths=0.6)


def _frame(axes, seen: Snapshot, unit: float) -> None:
    """Platens and limits of a vertical section."""
    bottom, top = seen.platens.heights
    for height in (bottom, top):
        axes.axhline(height, color="0.2", lw=3)
    reach = _reach(seen)
    least = 0.0 if seen.sector.boundary == "rigid" else -reach
    axes.set(
        aspect="equal", xlim=(least - unit, reach + unit), ylim=(bottom - unit, top + unit), ylabel="z [L]",
        xlabel="distance from the axis [L]" if seen.sector.boundary == "rigid" else "x [L]",
    )  # fmt: skip
