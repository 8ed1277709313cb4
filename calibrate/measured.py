"""Measured data: curves from CSV files with every check that a silent wrong fit would need, and Rowe's FCC test.

Compression is positive for stress and strain, strains are fractions inside; volumetric strain is the loss of volume.
"""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from calibrate.targets import Datum, HardPeak, _at

UNITS = {"fraction": 1.0, "percent": 0.01}
_UNIT_MARKS = {"%": "percent", "percent": "percent", "-": "fraction", "1": "fraction", "fraction": "fraction"}


class DataError(ValueError):
    """Measured data that cannot be used; says which number, why and what to do."""


@dataclass(frozen=True)
class MeasuredCurve:
    """A measured test, compared with a simulated one at its own strains.

    axial_strain: (M,) increasing, compression positive [-].
    stress_ratio: (M,) s1/s3 [-].
    volumetric_strain: (M,) loss of volume, compression positive [-], or None.
    ratio_sigma, volume_sigma: standard uncertainty of each kind of value [-], a number or (M,). They are the weights.
    sigma_known: whether these are real uncertainties; otherwise only their proportion counts and the size of the
        scatter is estimated from the residuals.
    source: where it comes from.

    Raises DataError for fewer than two points, unsorted or repeated strains, values that are not finite,
    tension-positive signs, percent taken for fractions, and shapes or uncertainties that make no sense.
    """

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    volumetric_strain: np.ndarray | None = None
    ratio_sigma: float | np.ndarray = 0.02
    volume_sigma: float | np.ndarray = 1e-4
    sigma_known: bool = False
    source: str = ""

    def __post_init__(self):
        strain = np.atleast_1d(np.asarray(self.axial_strain, float))
        if strain.ndim != 1 or strain.size < 2:
            raise DataError(
                f"axial_strain holds {strain.size} value(s): a curve needs at least two points; for a single number "
                "use Datum, or the peak entry fit_friction_to_peak."
            )
        object.__setattr__(self, "axial_strain", strain)
        for name in ("stress_ratio", "volumetric_strain"):
            values = getattr(self, name)
            if values is None and name == "volumetric_strain":
                continue
            values = np.asarray(values, float)
            if values.shape != strain.shape:
                raise DataError(f"{name} has shape {values.shape}: must match axial_strain, {strain.shape}.")
            object.__setattr__(self, name, values)
        for name in ("axial_strain", "stress_ratio", "volumetric_strain"):
            values = getattr(self, name)
            if values is not None and not np.isfinite(values).all():
                row = int(np.flatnonzero(~np.isfinite(values))[0])
                raise DataError(
                    f"{name} = {values[row]} in data row {row + 1}: must be a finite number; remove the row or fill it."
                )
        self._check_signs_and_order()
        for name in ("ratio_sigma", "volume_sigma"):
            spread = np.asarray(getattr(self, name), float)
            if spread.shape not in ((), strain.shape) or not (np.isfinite(spread).all() and (spread > 0).all()):
                raise DataError(f"{name} = {getattr(self, name)!r}: must be positive, one number or one a point.")

    def _check_signs_and_order(self):
        strain, ratio = self.axial_strain, self.stress_ratio
        if strain.max() <= 0 < -strain.min() or (ratio < 0).all():
            raise DataError(
                f"axial_strain runs from {strain[0]:g} to {strain[-1]:g} and stress_ratio from {ratio[0]:g} to "
                f"{ratio[-1]:g}: the file looks tension-positive; compression must be positive. Change the sign, or "
                "read it with sign=-1."
            )
        steps = np.diff(strain)
        if (steps <= 0).any():
            row = int(np.flatnonzero(steps <= 0)[0])
            how = "repeats" if steps[row] == 0 else "falls back to"
            raise DataError(
                f"axial_strain {how} {strain[row + 1]:g} after {strain[row]:g} in data row {row + 2}: must increase "
                "from row to row; sort the file, and drop unloading branches."
            )
        if strain[0] < 0:
            raise DataError(
                f"axial_strain starts at {strain[0]:g}: must start at or above zero, the end of confinement."
            )
        if strain[-1] >= 0.5:
            raise DataError(
                f"axial_strain reaches {strain[-1]:g}: must stay below 0.5; is the file in percent (unit='percent')?"
            )
        if (ratio <= 0).any():
            row = int(np.flatnonzero(ratio <= 0)[0])
            raise DataError(
                f"stress_ratio = {ratio[row]:g} in data row {row + 1}: s1/s3 must be positive (1 when isotropic)."
            )

    def __len__(self) -> int:
        return self.axial_strain.size

    @property
    def label(self) -> str:
        return "curve R" if self.volumetric_strain is None else "curves R and volumetric strain"

    @property
    def last_strain(self) -> float:
        """Axial strain that a run must reach [-]."""
        return float(self.axial_strain[-1])

    @property
    def observed(self) -> np.ndarray:
        """(M,) stress ratios, or (2M,) with the volumetric strains behind them."""
        return (
            self.stress_ratio
            if self.volumetric_strain is None
            else np.concatenate([self.stress_ratio, self.volumetric_strain])
        )

    @property
    def sigma(self) -> np.ndarray:
        """Standard uncertainty of each number of `observed`."""
        parts = [np.broadcast_to(np.asarray(self.ratio_sigma, float), len(self))]
        if self.volumetric_strain is not None:
            parts.append(np.broadcast_to(np.asarray(self.volume_sigma, float), len(self)))
        return np.concatenate(parts)

    def predict(self, curve):
        """What a simulated curve gives at the measured strains; shaped like `observed`, NaN beyond the run's end."""
        ratio = _at(curve, self.axial_strain, "stress_ratio")
        if self.volumetric_strain is None:
            return ratio
        return jnp.concatenate([ratio, _at(curve, self.axial_strain, "volumetric_strain")])

    def peak(self) -> tuple[float, float]:
        """(largest stress ratio, its axial strain) [-]. Raises DataError where it is the last point: then the test
        was stopped before its peak and the number is a lower bound only."""
        top = int(self.stress_ratio.argmax())
        if top == len(self) - 1:
            raise DataError(
                f"the peak, R = {self.stress_ratio[top]:g}, is at the last point (strain {self.axial_strain[top]:g}): "
                "the curve still rises, so its peak is not known; fit the curve instead, or give a longer one."
            )
        return float(self.stress_ratio[top]), float(self.axial_strain[top])

    @classmethod
    def from_csv(
        cls,
        path,
        *,
        axial_strain: str = "axial_strain",
        stress_ratio: str = "stress_ratio",
        volumetric_strain: str | None = None,
        unit: str | None = None,
        sign: int = 1,
        **uncertainties,
    ) -> "MeasuredCurve":
        """Read a file with one header row; lines that start with # are comments; comma, semicolon or tab between.

        axial_strain, stress_ratio, volumetric_strain: column names, capitals and a unit in brackets apart
            ("Axial_Strain [%]" is axial_strain in percent). Without the stress ratio's column, the columns
            axial_stress and confining_stress are divided. The volumetric strain is read where it is named, or where
            a column volumetric_strain is there.
        unit: "fraction" or "percent" of the strains; None takes the header's brackets, else fractions.
        sign: -1 for a tension-positive file: strains and stresses change sign, their ratio does not.
        uncertainties: ratio_sigma, volume_sigma, sigma_known of MeasuredCurve.

        Raises DataError, naming file, column, row and value, for what cannot be read, and as MeasuredCurve does.
        """
        path = Path(path)
        if unit is not None and unit not in UNITS:
            raise DataError(f"unit = {unit!r}: must be 'fraction' or 'percent'.")
        if sign not in (1, -1):
            raise DataError(f"sign = {sign!r}: must be 1 (compression positive) or -1 (tension positive).")
        columns, units = _read_columns(path)

        def column(name, *, strain=False, optional=False):
            key = name.strip().lower()
            if key not in columns:
                if optional:
                    return None
                raise DataError(f"{path.name}: no column '{name}'; it has {', '.join(columns)}. Name the right one.")
            if not strain:
                return columns[key]
            said = units[key]
            if unit is not None and said is not None and said != unit:
                raise DataError(
                    f"{path.name}: column '{name}' is marked in {said}, but unit = {unit!r}; drop one of them."
                )
            return sign * columns[key] * UNITS[unit or said or "fraction"]

        strain = column(axial_strain, strain=True)
        ratio = column(stress_ratio, optional=True)
        if ratio is None:
            axial, confining = column("axial_stress", optional=True), column("confining_stress", optional=True)
            if axial is None or confining is None:
                column(stress_ratio)
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = axial / confining
            if (np.sign(axial) != sign).all():
                raise DataError(
                    f"{path.name}: axial_stress runs from {axial[0]:g} to {axial[-1]:g}: the file looks "
                    f"{'tension' if sign == 1 else 'compression'}-positive; read it with sign={-sign}."
                )
        volume = column(volumetric_strain or "volumetric_strain", strain=True, optional=volumetric_strain is None)
        try:
            return cls(strain, ratio, volume, source=str(path), **uncertainties)
        except DataError as error:
            raise DataError(f"{path.name}: {error}") from None


def _read_columns(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str | None]]:
    """Columns by lower-case name without brackets, and each one's unit mark."""
    if not path.is_file():
        raise DataError(f"{path}: no such file; give the path of a CSV file.")
    lines = [
        line
        for line in path.read_text(encoding="utf-8-sig").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(lines) < 2:
        raise DataError(
            f"{path.name}: holds {len(lines)} line(s) beside comments; must have a header and at least one row."
        )
    separator = max(",;\t", key=lines[0].count)
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    header, rows = rows[0], rows[1:]
    if all(_is_number(cell) for cell in header):
        raise DataError(f"{path.name}: the first row holds numbers ({', '.join(header[:3])}); must name the columns.")
    names, units = [], {}
    for cell in header:
        match = re.fullmatch(r"(.*?)\s*[\[(]\s*(.*?)\s*[\])]", cell)
        name, mark = (match.group(1), match.group(2)) if match else (cell, None)
        name = name.strip().lower()
        names.append(name)
        units[name] = _UNIT_MARKS.get(mark.lower()) if mark else None
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise DataError(
                f"{path.name}: data row {number} has {len(row)} cells, the header {len(names)}; they must match."
            )
        for name, cell in zip(names, row, strict=True):
            if not _is_number(cell):
                raise DataError(
                    f"{path.name}: {name} = {cell!r} in data row {number}: must be a number with a decimal point."
                )
    table = np.array(rows, float)
    return {name: table[:, place] for place, name in enumerate(names)}, units


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class RoweTest:
    """Rowe's triaxial test on a face-centred cubic packing of steel balls, as Cui & O'Sullivan (2005) use it.

    stress_ratio: peak s1/s3 [-], and stress_ratio_uncertainty: half of its last digit. The paper is read as 'about
        2.4': one number, no scatter given, so the interval is a rounding interval and not a standard deviation.
    friction: of the balls as Rowe measured it, tan 7 degrees [-]; friction_uncertainty: half a degree, likewise.
    """

    stress_ratio: float = 2.4
    stress_ratio_uncertainty: float = 0.05
    friction: float = float(np.tan(np.radians(7.0)))
    friction_uncertainty: float = float(np.tan(np.radians(7.5)) - np.tan(np.radians(7.0)))
    source: str = (
        "Rowe 1962, Proc. R. Soc. A 269, 500-527 (FCC array of steel balls, phi_mu = 7 degrees, peak s1/s3 about 2.4), "
        "as used by Cui & O'Sullivan 2005, section 4"
    )

    def datum(self, functional=None) -> Datum:
        """The peak as a target, by the functional given or the hard maximum."""
        return Datum(functional or HardPeak(), self.stress_ratio, self.stress_ratio_uncertainty, self.source)


ROWE = RoweTest()
