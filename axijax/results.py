"""Results as labelled data: curves to and from NetCDF through xarray, tables to CSV, written whole or not at all."""

import csv
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from axijax.triaxial import RECORDS, Curve

if TYPE_CHECKING:
    import xarray

LONG_NAMES = {
    "axial_strain": "axial strain, compression positive",
    "stress_ratio": "stress ratio s1/s3, platen force over the area of the sector of radius Rm",
    "virial_ratio": "stress ratio s1/s3 from platen force and membrane forces, free of any area",
    "core_ratio": "vertical over horizontal Love-Weber stress of the inner core",
    "volumetric_strain": "volumetric strain of the cylinder of radius Rm, compression positive",
    "coordination_number": "mean number of contacts of a ball",
    "unbalanced_force": "mean resultant over mean contact force",
    "sliding_fraction": "share of the contacts at the Coulomb limit",
    "chatter": "motion of the contacts to and fro from step to step, against what their springs hold",
    "membrane_radius": "radius Rm through the middle of the membrane zone",
}


def curves_dataset(curves: Mapping[str, Curve], labels: Mapping[str, Sequence], attributes: Mapping[str, str]):
    """Several curves as one xarray.Dataset with dimensions (run, record), padded with NaN.

    curves: by name of the run. labels: further coordinates along run (friction, boundary..). attributes: of the file.
    """
    import xarray

    longest = max(np.size(curve.axial_strain) for curve in curves.values())
    data = {}
    for name in RECORDS:
        table = np.full((len(curves), longest), np.nan)
        for row, curve in zip(table, curves.values(), strict=True):
            values = np.asarray(getattr(curve, name))
            row[: values.size] = values
        units = "L" if name == "membrane_radius" else "1"
        data[name] = (("run", "record"), table, {"long_name": LONG_NAMES[name], "units": units})
    coordinates = {"run": list(curves), **{name: ("run", list(values)) for name, values in labels.items()}}
    return xarray.Dataset(data, coordinates, dict(attributes))


def save_dataset(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF, whole or not at all. Raises OSError where the folder cannot be written."""
    write_whole(path, lambda target: dataset.to_netcdf(target, engine="scipy"))


def save_run(folder: Path, name: str, case: str, curve: Curve) -> list[Path]:
    """Write one run's curve as NetCDF and CSV, with a picture; the case (JSON) and the versions go into the NetCDF."""
    import jax

    from axijax import plot

    attributes = {"title": name, "case": case, "axijax": version("axijax"), "jax": jax.__version__}
    rows = zip(*(np.asarray(getattr(curve, column)).tolist() for column in RECORDS), strict=True)
    paths = [folder / f"curve.{kind}" for kind in ("nc", "csv", "png")]
    save_dataset(curves_dataset({name: curve}, {}, attributes), paths[0])
    save_table(paths[1], RECORDS, [dict(zip(RECORDS, row, strict=True)) for row in rows])
    plot.save_figure(plot.curve_figure({name: curve}), paths[2])
    return paths


def save_table(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows as CSV, whole or not at all; None becomes an empty field."""

    def write(target: Path) -> None:
        with open(target, "w", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows({name: "" if row[name] is None else row[name] for name in columns} for row in rows)

    write_whole(path, write)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it, so that no partial file can look whole."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def writable_folder(path: Path) -> Path:
    """Make a folder for results, and make sure that it can be written before anything is computed.

    Raises ValueError, with the reason, where it cannot.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise ValueError(
            f"output folder '{path}' cannot be written ({error.strerror}): choose another with --output."
        ) from None
    return path
