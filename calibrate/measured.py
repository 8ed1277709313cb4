"""Measured data: curves from CSV files with every check that a silent wrong fit would need, and Rowe's FCC test.

Compression is positive for stress and strain, strains are fractions inside; volumetric strain is the loss of volume.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from axijax.core.shown import Card, line_picture, per_cent, shown
from calibrate.branches import TURN, Places, reversals
from calibrate.columns import read_columns
from calibrate.doubts import ConfiningStress, doubts, of_facts, without_padding
from calibrate.facts import Facts, length, stress
from calibrate.mapping import Request
from calibrate.table import DataError
from calibrate.targets import Datum, HardPeak, _at, passed_peak

LOWEST_RATIO, HIGHEST_RATIO = 0.9, 1000.0  # outside no s1/s3 of a compression that begins isotropic can lie
Q_INSTEAD = "the column holds q = s1 - s3, name it q and give confining_stress too, if q/p, name it q/p"


@shown
@dataclass(frozen=True)
class MeasuredCurve:
    """A measured test, compared with a simulated one at its own strains.

    axial_strain: (M,) increasing, or turning back where `unloading` says so, compression positive [-].
    stress_ratio: (M,) s1/s3 [-].
    volumetric_strain: (M,) loss of volume, compression positive [-], or None.
    ratio_sigma, volume_sigma: standard uncertainty of each kind of value [-], a number or (M,). They are the weights.
    sigma_known: whether these are real uncertainties; otherwise only their proportion counts and the size of the
        scatter is estimated from the residuals.
    unloading: whether the strain may turn back; then the curve is compared branch by branch (`calibrate.branches`), for
        tests whose stages turn as it does, see `stages`.
    source: where it comes from. confining: the confining stress that the file gives, or None.
    facts: what the file says of the specimen beside its columns (test, void ratio, grading and so on).
    warnings: what looks wrong in a file that could be read.

    Raises DataError for fewer than two points, unsorted or repeated strains, values that are not finite,
    tension-positive signs, percent taken for fractions, stress ratios that no compression gives, and shapes or
    uncertainties that make no sense.
    """

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    volumetric_strain: np.ndarray | None = None
    ratio_sigma: float | np.ndarray = 0.02
    volume_sigma: float | np.ndarray = 1e-4
    sigma_known: bool = False
    unloading: bool = False
    source: str = ""
    confining: ConfiningStress | None = None
    facts: Facts = field(default_factory=Facts)
    warnings: tuple[str, ...] = ()

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

    def _card(self) -> Card:
        strain, ratio = self.axial_strain, self.stress_ratio
        rows = {
            "source": Path(self.source).name or "none",
            "points": str(len(self)),
            "axial strain": f"{per_cent(strain[0])} to {per_cent(strain.max())}",
            "stress ratio [-]": f"{ratio.min():.4g} to {ratio.max():.4g}",
            "the file says": str(self.facts) or "nothing",
            "warnings": "; ".join(self.warnings) or "none",
        }
        picture = line_picture(100 * strain, ratio, "axial strain [%]", "stress ratio s1/s3 [-]")
        return Card("MeasuredCurve", rows, picture, tuple(rows)[:4])

    def _check_signs_and_order(self):
        strain, ratio = self.axial_strain, self.stress_ratio
        if strain.max() <= 0 < -strain.min() or (ratio < 0).all():
            raise DataError(
                f"axial_strain runs from {strain[0]:g} to {strain[-1]:g} and stress_ratio from {ratio[0]:g} to "
                f"{ratio[-1]:g}: the file looks tension-positive; compression must be positive. Write "
                "(tension positive) behind the names of strains and stresses, or turn the signs in the file."
            )
        steps = np.diff(strain)
        if not self.unloading and (steps <= 0).any():
            row = int(np.flatnonzero(steps <= 0)[0])
            how = "repeats" if steps[row] == 0 else "falls back to"
            raise DataError(
                f"axial_strain {how} {strain[row + 1]:g} after {strain[row]:g} in data row {row + 2}: must increase "
                "from row to row; sort the file, keep one test of several, and drop unloading branches, or read them "
                "too (unloading, --unloading)."
            )
        if strain[0] < 0:
            raise DataError(
                f"axial_strain starts at {strain[0]:g}: must start at or above zero, the end of confinement; drop the "
                "rows before it, or subtract what the gauge showed there."
            )
        if strain.max() >= 0.5:
            raise DataError(
                f"axial_strain reaches {strain.max():g}: must stay below 0.5; is the file in percent? Then write "
                "[%] behind the name of the column, or columns = {'axial_strain': '[%]'} (--column 'axial_strain=[%]')."
            )
        if (ratio <= 0).any():
            row = int(np.flatnonzero(ratio <= 0)[0])
            raise DataError(
                f"stress_ratio = {ratio[row]:g} in data row {row + 1}: s1/s3 must be positive (1 when isotropic). If "
                f"{Q_INSTEAD}."
            )
        if not self.unloading and ratio.min() < LOWEST_RATIO:
            row = int(ratio.argmin())
            raise DataError(
                f"stress_ratio = {ratio[row]:g} in data row {row + 1}: s1/s3 is 1 when isotropic and rises in "
                f"compression, here it must stay above {LOWEST_RATIO:g}. If {Q_INSTEAD}; if the two stresses are "
                "exchanged or in different units, mend that."
            )
        if ratio.max() <= 1:
            row = int(ratio.argmax())
            raise DataError(
                f"stress_ratio is {ratio[row]:g} at most, in data row {row + 1}: s1/s3 of a compression must rise "
                "above 1; are the two stresses exchanged?"
            )
        if ratio.max() > HIGHEST_RATIO:
            row = int(ratio.argmax())
            raise DataError(
                f"stress_ratio = {ratio[row]:g} in data row {row + 1}: s1/s3 must stay below {HIGHEST_RATIO:g}; write "
                "the unit, such as [kPa], behind each stress, where the two have different ones."
            )

    def __len__(self) -> int:
        return self.axial_strain.size

    @property
    def label(self) -> str:
        return "curve R" if self.volumetric_strain is None else "curves R and volumetric strain"

    @property
    def last_strain(self) -> float:
        """Axial strain that a run must reach [-]."""
        return float(self.axial_strain.max())

    @cached_property
    def places(self) -> Places | None:
        """Where its points lie on its branches; None where it never turns back."""
        found = Places.of(self.axial_strain) if self.unloading else None
        return found if found is not None and found.branch.any() else None

    @property
    def advancing(self) -> "MeasuredCurve":
        """Without its points that do not lie beyond all before them: the curve of the first loading."""
        from axijax.core.smoothing import advancing  # takes long to import

        if not self.unloading:
            return self
        kept = advancing(self.axial_strain)
        spread: dict[str, Any] = {
            name: value if np.ndim(value) == 0 else np.asarray(value)[kept]
            for name, value in (("ratio_sigma", self.ratio_sigma), ("volume_sigma", self.volume_sigma))
        }
        volume = None if self.volumetric_strain is None else self.volumetric_strain[kept]
        return replace(
            self, axial_strain=self.axial_strain[kept], stress_ratio=self.stress_ratio[kept], volumetric_strain=volume,
            unloading=False, **spread,
        )  # fmt: skip

    def stages(self) -> tuple:
        """Stages of a test that turns where this curve does, for TriaxialTest(stages=...): strain-controlled, at
        constant lateral stress."""
        from axijax import stage

        turns = [float(self.axial_strain[i]) for i in reversals(self.axial_strain, TURN * np.ptp(self.axial_strain))]
        limits = [*turns, float(self.axial_strain[-1])]
        pairs = zip(limits[::2], limits[1::2], strict=False)
        made = [stage("cycles", first=first, second=second) for first, second in pairs]
        if len(limits) % 2:
            back, end = [0.0, *limits][-2:]
            made.append(stage("compression" if end > back else "extension", axial_strain=end))
        return tuple(made)

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
        if self.places is not None:
            fields = ("stress_ratio",) if self.volumetric_strain is None else ("stress_ratio", "volumetric_strain")
            return jnp.concatenate(self.places.read(curve, *fields))
        ratio = _at(curve, self.axial_strain, "stress_ratio")
        if self.volumetric_strain is None:
            return ratio
        return jnp.concatenate([ratio, _at(curve, self.axial_strain, "volumetric_strain")])

    @property
    def void_ratio(self) -> np.ndarray:
        """(M,) voids over solids, made of the void ratio at the start, which the file or the caller gives, and the
        volumetric strain [-]; NaN where one of them is not known."""
        if self.facts.void_ratio is None or self.volumetric_strain is None:
            return np.full(len(self), np.nan)
        return (1 + self.facts.void_ratio) * (1 - self.volumetric_strain) - 1

    def peak(self) -> tuple[float, float]:
        """(largest stress ratio, its axial strain) [-]. Raises DataError where it is at the end: then the test was
        stopped before its peak and the number is a lower bound only."""
        top = int(self.stress_ratio.argmax())
        if not passed_peak(self, "stress_ratio"):
            where = "at the last point" if top == len(self) - 1 else "in the last 5 % of the strain"
            raise DataError(
                f"the peak, R = {self.stress_ratio[top]:g}, is {where} (strain {self.axial_strain[top]:g}): "
                "the curve still rises, so its peak is not known; fit the curve instead, or give a longer one."
            )
        return float(self.stress_ratio[top]), float(self.axial_strain[top])


def read_measured(
    path,
    columns: Mapping[str, str] | None = None,
    *,
    test: str | None = None,
    height: str | None = None,
    void_ratio: float | None = None,
    confining_stress: str | None = None,
    unloading: bool = False,
    **uncertainties,
) -> MeasuredCurve:
    """Read a measured test from a text file as laboratories keep it.

    The file has a header row, and commas, semicolons, tabs or blanks between its columns, decimal points or commas, #
    before comments. A material file of the Sand Triaxial Test Database is read as it is. Names are known in many
    spellings (calibrate.names), units stand in brackets behind a name or in the row below, "(dilation positive)" or
    "(tension positive)" turns a sign:

    - axial_strain (eps_a), or axial_displacement [mm] with the height;
    - stress_ratio (R, s1/s3), or q/p, or two of axial_stress (s1), confining_stress (s3), deviator_stress (q = s1 - s3)
      and mean_stress (p = (s1 + 2 s3)/3), or one of these and the confining stress as a number;
    - where it is there volumetric_strain (eps_v), or void_ratio (e), which becomes (e0 - e)/(1 + e0).

    columns: what the header does not say, {quantity: text}: the name of a column, its unit, its sign, or part of it:
        {"axial_displacement": "Weg [mm]", "q": "[kPa]", "eps_v": "dV/V (dilation positive)"}.
    test: which test, where the file holds several. height: of the specimen at the start of the shear, with its unit,
        "100 mm". void_ratio: e0, there [-]. confining_stress: with its unit, "200 kPa".
    unloading: whether the strain may turn back, as MeasuredCurve says; otherwise a strain that falls is refused, since
        it may as well be a second test.
    uncertainties: ratio_sigma, volume_sigma, sigma_known of MeasuredCurve.

    A study file hands over the same as a table: read_measured(table.pop("data"), **table).

    Rows at the end that only repeat the last values are cut. Raises DataError, naming file, column, row and value, for
    what cannot be read, what contradicts itself, what cannot be known, and as MeasuredCurve does. Warns of what can be
    read and looks wrong, and of rows that were left out or cut; `warnings` of the curve holds the same.
    """
    path = Path(path)
    if void_ratio is not None and not 0 < void_ratio < 10:
        raise DataError(f"void_ratio = {void_ratio!r}: must be positive, voids over solids, 0.4 to 1.2 of sands.")
    wanted = Request(
        dict(columns or {}), test, length("height", height), void_ratio, stress("confining_stress", confining_stress)
    )
    with np.errstate(all="ignore"):  # what overflows is not finite, which is refused below
        read = read_columns(path, wanted)
    strain, ratio, volume = read.axial_strain, read.stress_ratio, read.volumetric_strain
    rows, cut = without_padding(strain, ratio, volume)
    strain, ratio, volume = strain[:rows], ratio[:rows], None if volume is None else volume[:rows]
    confining = None
    if read.confining_stress is not None:
        confining = ConfiningStress(float(np.median(read.confining_stress)), read.stress_marked)
    elif read.facts.confining_stress is not None:
        confining = ConfiningStress(read.facts.confining_stress, True)
    try:
        curve = MeasuredCurve(
            strain, ratio, volume, source=str(path), confining=confining, facts=read.facts, unloading=unloading,
            **uncertainties,
        )  # fmt: skip
    except DataError as error:
        raise DataError(f"{path.name}: {error}") from None
    first = curve.advancing
    found = cut + doubts(first.axial_strain, first.stress_ratio, first.volumetric_strain, read.strain_marked)
    found += [*read.doubts, *of_facts(read.facts)]
    if confining is not None and read.confining_stress is not None:
        found += confining.uneven(read.confining_stress, read.made_of)
    curve = replace(curve, warnings=tuple(f"{path.name}: {text}" for text in found))
    for text in curve.warnings:
        warnings.warn(text, stacklevel=2)
    return curve


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
