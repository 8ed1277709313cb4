"""A packing of one's own, from another program or a scanner, as a specimen: balls as arrays, or in a file.

    specimen = packing("balls.csv")               # columns x, y, z and radius, any one unit of length
    specimen = packing_of(positions, radius)      # (3, N) and (N,) or one number

The cylinder's axis is x = y = 0. The outer balls are found, and found again while it is sheared, as those of a random
specimen are.
"""

import csv
from pathlib import Path

import numpy as np

from axijax.core.sector import Sector
from axijax.mechanics.outer_balls import outer_balls
from axijax.specimen.specimen import Specimen

COLUMNS = ("x", "y", "z", "radius")
OFF_AXIS = 0.1  # of the packing's half width: by so much its middle may be off the axis


def packing_of(positions: np.ndarray, radius: np.ndarray | float, name: str = "packing") -> Specimen:
    """A specimen of given balls, a full cylinder about x = y = 0.

    positions: (3, N) ball centres [L]; radius: (N,) or one number [L]. name: what it is, for labels. Balls may be
    pressed into one another as a confined packing's are; the platens lie at the lowest and the highest point of a ball.
    A sector of order n > 1 can be cut from it only where it is the same after a turn by 2*pi/n.

    Raises ValueError where the arrays do not fit, a number is not finite, a radius is not positive, or the packing's
    middle is far from the axis.
    """
    positions = np.array(positions, float)
    if positions.ndim != 2 or positions.shape[0] != 3 or positions.shape[1] < 4:
        raise ValueError(f"packing positions have shape {positions.shape}: must be (3, N) with at least four balls.")
    radius = np.array(radius, float)
    if radius.shape not in ((), positions.shape[1:]):
        raise ValueError(f"packing radius has shape {radius.shape}: must be one number or ({positions.shape[1]},).")
    radius = np.broadcast_to(radius, positions.shape[1:])
    if not (np.isfinite(radius).all() and (radius > 0).all()):
        raise ValueError(f"packing radius holds {radius.min():g}: every radius must be positive and finite [L].")
    if not np.isfinite(positions).all():
        raise ValueError(f"packing positions hold {np.sum(~np.isfinite(positions))} numbers that are not finite.")
    low, high = (positions[:2] - radius).min(axis=1), (positions[:2] + radius).max(axis=1)
    middle, half = (low + high) / 2, (high - low).max() / 2
    if np.hypot(*middle) > OFF_AXIS * half:
        raise ValueError(
            f"packing: its middle lies at x = {middle[0]:.6g}, y = {middle[1]:.6g}, but the cylinder's axis is "
            "x = y = 0; move the balls by that much."
        )
    bottom, top = float((positions[2] - radius).min()), float((positions[2] + radius).max())
    zone = outer_balls(positions, radius, bottom, top, Sector(1))
    return Specimen(positions, radius, bottom, top, zone, name, "exposure")


def packing(path: str | Path) -> Specimen:
    """A specimen of the balls in a file: CSV with columns x, y, z, radius, or NetCDF with variables of these names.

    Lines before the columns' names that begin with # are left out; further columns are not read. All four are in one
    unit of length, that of the test. Raises ValueError, naming the file and the line, where it cannot be read so, and
    as `packing_of` does.
    """
    path = Path(path)
    try:
        table = _netcdf(path) if path.suffix.lower() == ".nc" else _csv(path)
    except OSError as error:
        raise ValueError(f"packing '{path}' cannot be read ({error.strerror or error}).") from None
    try:
        return packing_of(table[:3], table[3], f"packing {path.stem}")
    except ValueError as error:
        raise ValueError(f"packing '{path}': {str(error).removeprefix('packing').lstrip(': ')}") from None


def _csv(path: Path) -> np.ndarray:
    """(4, N) numbers of a CSV file."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            lines = enumerate(csv.reader(file), 1)
            rows = [(number, row) for number, row in lines if row and not row[0].startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"packing '{path}' is no CSV file in UTF-8 ({error}).") from None
    names = [cell.partition("[")[0].strip().lower() for cell in rows[0][1]] if rows else []
    for name in COLUMNS:
        if names.count(name) != 1:
            raise ValueError(
                f"packing '{path}': its first line has {names.count(name)} columns '{name}': name the columns "
                f"{', '.join(COLUMNS)}, each once."
            )
    places = [names.index(name) for name in COLUMNS]
    table = np.empty((4, len(rows) - 1))
    for ball, (number, row) in enumerate(rows[1:]):
        for column, place in enumerate(places):
            try:
                table[column, ball] = float(row[place])
            except (ValueError, IndexError):
                told = f"'{row[place][:40]}'" if place < len(row) else "nothing"
                raise ValueError(
                    f"packing '{path}', line {number}: {COLUMNS[column]} is {told}: must be a number."
                ) from None
    return table


def _netcdf(path: Path) -> np.ndarray:
    """(4, N) numbers of a NetCDF file."""
    import xarray

    try:
        with xarray.open_dataset(path, engine="scipy") as file:
            columns = [np.asarray(file[name].values, float) for name in COLUMNS]
        return np.stack([np.atleast_1d(column) for column in columns])
    except FileNotFoundError:
        raise
    except Exception:  # the readers of SciPy and xarray raise whatever a damaged file leads them to
        raise ValueError(
            f"packing '{path}' is no NetCDF (version 3) file with {', '.join(COLUMNS)} of equal length."
        ) from None
