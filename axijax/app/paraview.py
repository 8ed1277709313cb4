"""Snapshots for ParaView: VTK XML files of balls, contacts, membrane cells and platens, with axial strain as time (of a
test in stages the strain travelled, to and fro).

    write = SnapshotWriter(Path("results/snapshots"), test, full=True)
    write(progress)        # at any stage of a run

Open the indexes balls.pvd, contacts.pvd, membrane.pvd and platens.pvd in ParaView: balls are points (filter Glyph,
sphere, scaled by `radius` with factor 2), contacts are lines (filter Tube, radius by `normal_force`), membrane cells
and platens are faces. An index names only files that are whole, at whatever moment a run is stopped.
"""

import contextlib
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from axijax.app.snapshot import Snapshot, confined_positions, snapshot
from axijax.core.files import remove_leftovers, write_whole
from axijax.mechanics.dynamics import positions
from axijax.triaxial.test import Progress, TriaxialTest

if TYPE_CHECKING:
    import meshio

PARTS = ("balls", "contacts", "membrane", "platens")
CONFINED = "confined.npy"  # centres at the end of confinement, kept beside the snapshots
DISC_CORNERS = 96  # of a platen's full circle


class SnapshotWriter:
    """Writes snapshots of a run into a folder, one after another, and keeps the index of all of them.

    folder: made where it is missing. In a folder that holds snapshots already it goes on, as a resumed run does: those
        of a later or the same strain are replaced.
    test: the test that is run.
    full: fill in the sector's images to the whole cylinder.
    """

    def __init__(self, folder: Path, test: TriaxialTest, full: bool = False):
        self.folder, self.test, self.full = Path(folder), test, full
        self.strains = _indexed_strains(self.folder)

    def __call__(self, progress: Progress) -> list[Path]:
        """Write the state of a shear in progress; the files written, indexes last. Raises OSError where it cannot."""
        self.folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(self.folder)
        moment = snapshot(self.test, progress, self.full, self._confined(progress))
        # Strains are compared as the index writes them.
        now = _number(progress.path_length)
        self.strains = [strain for strain in self.strains if float(strain) < float(now)]
        place = len(self.strains)
        self.strains.append(now)
        parts = meshes(moment)
        files = {part: self.folder / f"{part}_{place:04d}.vtu" for part in PARTS}
        for part, path in files.items():
            write_whole(path, partial(parts[part].write, file_format="vtu"))
        indexes = {part: self.folder / f"{part}.pvd" for part in PARTS}
        for part, path in indexes.items():
            text = _index(part, self.strains)
            write_whole(path, partial(Path.write_text, data=text))
        return [*files.values(), *indexes.values()]

    def _confined(self, progress: Progress) -> np.ndarray:
        """Centres at the end of confinement: kept in the folder, or from confining once more."""
        kept = self.folder / CONFINED
        if progress.records.height.size == 0:
            confined = np.asarray(positions(progress.network, progress.state), float)
        else:
            with contextlib.suppress(OSError, ValueError, EOFError):
                found = np.load(kept, allow_pickle=False)
                if found.shape == (3, len(self.test.cut)):
                    return found
            confined = confined_positions(self.test, progress)

        def save(target: Path) -> None:
            with open(target, "wb") as file:
                np.save(file, confined)

        write_whole(kept, save)
        return confined


def is_snapshot_file(name: str) -> bool:
    """Whether a file's name is one that a SnapshotWriter gives."""
    return name == CONFINED or re.fullmatch(rf"({'|'.join(PARTS)})(_\d{{4,}}\.vtu|\.pvd)", name) is not None


def meshes(moment: Snapshot) -> "Mapping[str, meshio.Mesh]":
    """The parts of a snapshot as meshes with named data; units as in `axijax.app.snapshot`."""
    import meshio

    balls, contacts, membrane = moment.balls, moment.contacts, moment.membrane
    ball_data = {
        "number": balls.number,
        "image": balls.image,
        "radius": balls.radius,
        "velocity": balls.velocity.T,
        "spin": balls.spin.T,
        "stress": balls.stress.reshape(9, -1).T,
        "mean_stress": np.trace(balls.stress) / 3,
        "coordination_number": balls.coordination,
        "weight": balls.weight,
        "membrane_area": balls.membrane_area,
        "membrane_zone": balls.membrane_zone.astype(np.int64),
    }
    contact_data = {
        "first": contacts.first,
        "second": contacts.second,
        "image": contacts.image,
        "copy": contacts.copy,
        "share": contacts.share,
        "force": contacts.force.T,
        "normal_force": contacts.normal_force,
        "tangential_force": contacts.tangential_force,
        "sliding": contacts.sliding.astype(np.int64),
    }
    if balls.displacement is not None:
        ball_data["displacement"] = balls.displacement.T
    count = contacts.first.size
    # Lines share no points, so that a value of a line can be one of its two points, as the filter Tube wants it.
    ends = np.stack([contacts.start.T, contacts.end.T], axis=1).reshape(-1, 3)
    angles = [polygon[:, 0] / membrane.radius for polygon in membrane.polygons]
    wrapped = [
        np.stack([membrane.radius * np.cos(angle), membrane.radius * np.sin(angle), polygon[:, 1]], axis=1)
        for angle, polygon in zip(angles, membrane.polygons, strict=True)
    ]
    cell_data = {"number": membrane.number, "image": membrane.image, "area": membrane.area, "force": membrane.force}
    return {
        "balls": meshio.Mesh(
            balls.positions.T, [("vertex", np.arange(balls.number.size)[:, None])], point_data=_plain(ball_data)
        ),
        "contacts": meshio.Mesh(
            ends,
            [("line", np.arange(2 * count).reshape(-1, 2))],
            point_data={"normal_force": np.repeat(contacts.normal_force, 2)},
            cell_data={name: [values] for name, values in _plain(contact_data).items()},
        ),
        "membrane": _faces(wrapped, cell_data),
        "platens": _faces(
            _discs(moment), {"height": moment.platens.heights, "force": moment.platens.forces, "top": np.array([0, 1])}
        ),
    }


def _plain(data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(values) for name, values in data.items()}


def _faces(polygons: list[np.ndarray], data: Mapping[str, np.ndarray]) -> "meshio.Mesh":
    """Polygons (P, 3) each, which need not have the same number of corners, with one value a polygon."""
    import meshio

    corners = np.array([len(polygon) for polygon in polygons], int)
    first = np.cumsum(corners) - corners
    blocks: list[tuple[str, np.ndarray]] = []
    values: dict[str, list[np.ndarray]] = {name: [] for name in data}
    for number in np.unique(corners) if polygons else [3]:  # cells of one kind have one number of corners
        which = np.flatnonzero(corners == number)
        blocks.append(("polygon", first[which, None] + np.arange(number)))
        for name, column in data.items():
            values[name].append(np.asarray(column)[which])
    points = np.concatenate(polygons) if polygons else np.zeros((0, 3))
    return meshio.Mesh(points, blocks, cell_data=values)


def _discs(moment: Snapshot) -> list[np.ndarray]:
    """The part of either platen above or below the balls: a disc, or the sector's slice of it."""
    balls, sector = moment.balls, moment.sector
    reach = (np.hypot(*balls.positions[:2]) + balls.radius).max()
    whole = sector.order == 1 or (moment.full and sector.boundary == "periodic")
    span = 2 * np.pi if whole else sector.angle
    angle = np.linspace(0, span, max(int(DISC_CORNERS * span / (2 * np.pi)), 8), endpoint=not whole)
    rim = reach * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline = rim if whole else np.concatenate([np.zeros((1, 2)), rim])
    return [np.column_stack([outline, np.full(len(outline), height)]) for height in moment.platens.heights]


def _number(strain: float) -> str:
    return f"{strain:.9g}"


def _index(part: str, strains: list[str]) -> str:
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    root.append(ElementTree.Comment(" timestep is the axial strain [-] "))
    collection = ElementTree.SubElement(root, "Collection")
    for place, strain in enumerate(strains):
        ElementTree.SubElement(collection, "DataSet", timestep=strain, part="0", file=f"{part}_{place:04d}.vtu")
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _indexed_strains(folder: Path) -> list[str]:
    """Strains of the snapshots that a folder holds already, from the index that is written last."""
    try:
        root = ElementTree.parse(folder / f"{PARTS[-1]}.pvd").getroot()
    except (OSError, ElementTree.ParseError):
        return []
    return [entry.get("timestep", "0") for entry in root.iter("DataSet")]
