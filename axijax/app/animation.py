"""A film of the deforming specimen, from the snapshots that a run has kept, as GIF.

The specimen cut open at its axis, the sector's images filled in; coloured by how far each ball has moved against the
uniform strain of the whole, in diameters, so that shear bands show. Beside it the curve, with a dot where the film
stands.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from axijax.app.labels import LETTERS, readable
from axijax.app.results import SNAPSHOTS, Result
from axijax.core.files import write_whole
from axijax.core.palette import COLOURS

SECONDS = 4.0  # of a film of few frames, each a fifth to a half of a second
LEAST = 2  # snapshots


def save_animation(result: Result, path: Path) -> None:
    """Write the film. Raises ValueError where the run kept too few snapshots, or the path is no GIF's."""
    from matplotlib.animation import FuncAnimation, PillowWriter

    if path.suffix != ".gif":
        raise ValueError(f"animation: '{path}' must end in .gif.")
    frames = _frames(result)
    figure, draw = _stage(result, frames)
    film = FuncAnimation(figure, draw, frames=len(frames), blit=False)
    rate = int(np.clip(round(len(frames) / SECONDS), 2, 20))
    write_whole(path, lambda target: film.save(target, writer=PillowWriter(fps=rate), dpi=90))


def _frames(result: Result) -> list[tuple[float, np.ndarray]]:
    """Axial strain and (3, N) centres of every snapshot, the sector's own balls alone, in the order of the test's."""
    kept = [(result.path / name, _kept(result.path / name)) for name in SNAPSHOTS]
    folder, entries = max(kept, key=lambda each: len(each[1]))
    if len(entries) < LEAST:
        raise ValueError(
            f"animation: the run kept {len(entries) or 'no'} snapshot{'' if len(entries) == 1 else 's'} of its balls, "
            "and a film needs two or more: run it again with `axijax run --snapshots 40`"
        )
    import meshio

    found = []
    for entry in entries:
        name = entry.get("file", "")
        if not re.fullmatch(r"balls_\d+\.vtu", name):
            raise ValueError(f"animation: '{folder / 'balls.pvd'}' names '{name}', which is no snapshot of balls")
        mesh = meshio.read(folder / name)
        own = np.flatnonzero(mesh.point_data["image"].ravel() == 0)
        order = own[np.argsort(mesh.point_data["number"].ravel()[own])]
        found.append((float(entry.get("timestep", "nan")), np.asarray(mesh.points, float)[order].T))
    return found


def _kept(folder: Path) -> list[ElementTree.Element]:
    """Entries of the index of balls; none without one."""
    try:
        return list(ElementTree.parse(folder / "balls.pvd").getroot().iter("DataSet"))
    except (OSError, ElementTree.ParseError):
        return []


def _stage(result: Result, frames: list[tuple[float, np.ndarray]]):
    """The figure, and what draws frame number k into it."""
    test, curve = result.test, result.curve
    radius, sector = test.cut.radius, test.sector
    moved = [_against_uniform(frames[0][1], place) / (2 * radius.mean()) for _, place in frames]
    scale = Normalize(0, max(float(np.quantile(np.concatenate(moved), 0.99)), 1e-9))
    reach = max(float((np.hypot(*place[:2]) + radius).max()) for _, place in frames)
    low = min(float((place[2] - radius).min()) for _, place in frames)
    high = max(float((place[2] + radius).max()) for _, place in frames)
    figure = Figure(figsize=(8, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    figure.colorbar(
        ScalarMappable(scale, "cividis"), ax=left, extend="max", shrink=0.8,
        label="motion against uniform strain / diameter [-]",
    )  # fmt: skip
    right.plot(100 * curve.axial_strain.values, curve.stress_ratio.values, color=COLOURS[0], lw=1.6)
    right.set(xlabel="axial strain [%]", ylabel="stress ratio s1/s3 [-]")
    right.grid(alpha=0.3)
    (dot,) = right.plot([], [], "o", color=COLOURS[1], ms=8)
    readable(figure)
    turns = sector.images

    def draw(k: int) -> list:
        strain, place = frames[k]
        images = [np.asarray(sector.rotate(place, np.full(radius.size, turn))) for turn in range(turns)]
        x, y, z = np.concatenate(images, axis=1)
        size, value = np.tile(radius, turns), np.tile(moved[k], turns)
        order = np.argsort(-y)
        order = order[y[order] > -0.3 * radius.mean()]
        left.cla()
        balls = EllipseCollection(
            2 * size[order], 2 * size[order], np.zeros(order.size), units="xy", transOffset=left.transData,
            offsets=np.stack([x, z], axis=1)[order], cmap="cividis", norm=scale, edgecolors="white", linewidths=0.3,
        )  # fmt: skip
        balls.set_array(value[order])
        left.add_collection(balls)
        left.set(aspect="equal", xlim=(-reach, reach), ylim=(low, high), xlabel="x [L]", ylabel="z [L]")
        left.set_title(f"axial strain {100 * strain:.2f} %", fontsize=LETTERS)
        left.tick_params(labelsize=LETTERS)
        at = int(np.abs(curve.axial_strain.values - strain).argmin())
        dot.set_data([100 * curve.axial_strain.values[at]], [curve.stress_ratio.values[at]])
        return []

    return figure, draw


def _against_uniform(start: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(N,) distance of each ball from where the best uniform strain, the same all around the axis, and a shift
    along it would have brought it."""
    wide = (start[:2] * place[:2]).sum() / max((start[:2] ** 2).sum(), 1e-300)
    long, shift = np.polyfit(start[2], place[2], 1)
    even = np.stack([wide * start[0], wide * start[1], long * start[2] + shift])
    return np.linalg.norm(place - even, axis=0)
