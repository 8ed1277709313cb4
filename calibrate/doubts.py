"""What looks wrong in a measured curve that can be read: units, signs, offsets. Each doubt is one sentence with the
number that looks wrong; none of it can be known from the numbers alone, so nothing is changed.

What is expected: a drained compression of grains that begins isotropic, at no strain, contracts first, and may dilate.
"""

from dataclasses import dataclass

import numpy as np

SMALLEST_RATIO, LARGEST_RATIO = 0.98, 20.0  # s1/s3: seating noise at the start; sands reach 3 to 8, friction 0.8 18
START_RATIO = 1.2  # at strain zero
OFFSET = 0.1  # of the strain at half rise: more of it before the rise begins is an offset or bedding
BEGUN = 0.02  # of the rise: from there on it has begun
HALF_RISE = (2e-5, 0.03)  # axial strain [-] at which R is halfway to its peak; loose sands come to 0.017
EARLY_DILATION = -0.2  # mean volumetric over mean axial strain up to half rise; what contracts first is positive
CONTRACTION, DILATION, NO_VOLUME = 1.25, 2.0, 0.01  # volumetric over axial strain; above 1 the sides would move in
UNEVEN = 0.05  # of the confining stress, which the simulation holds at one value
PADDING = 5  # last rows that repeat one another exactly
COARSE = 0.005  # smallest step of R, of its rise


@dataclass(frozen=True)
class ConfiningStress:
    """The confining stress that a file gives: its median, in Pa where the file says the unit, else as written."""

    value: float
    in_pascal: bool

    def __str__(self) -> str:
        return f"{self.value:g} Pa" if self.in_pascal else f"{self.value:g} (no known unit)"

    def uneven(self, values: np.ndarray, made_of: str = "") -> tuple[str, ...]:
        """A sentence where the (M,) values of the file are not all near the median. made_of: the columns that it was
        made of, where none holds it."""
        if np.abs(values - self.value).max() <= UNEVEN * self.value:
            return ()
        unit = " Pa" if self.in_pascal else ""
        return (
            f"the confining stress runs from {values.min():g} to {values.max():g}{unit}, while the simulated test "
            "holds it; R is the ratio row by row."
            + (f" It is made of {made_of}: is p there (s1 + 2 s3)/3, and q s1 - s3?" if made_of else ""),
        )

    def unlike(self, simulated: float) -> str | None:
        """A sentence where the simulated confining stress is another one; a simulation has any consistent units, so
        one in Pa, kPa or MPa is taken for the same."""
        units = (1.0, 1e3, 1e6) if self.in_pascal else (1.0,)
        if any(abs(self.value / (unit * simulated) - 1) < UNEVEN for unit in units):
            return None
        unit = "" if self.in_pascal else ", write its unit behind the name of the column, such as [kPa]"
        return (
            f"the confining stress of the data is {self}, of the simulated test {simulated:g}: unless the case counts "
            f"in other units{unit}, a stiffness fitted is wrong by a factor {self.value / simulated:.3g}; set "
            "confining_stress of the case to that of the data."
        )


def doubts(strain, ratio, volume, marked: bool) -> list[str]:
    """Sentences on (M,) axial strain, stress ratio and volumetric strain or None; marked: the file says the unit."""
    half = _half_rise(ratio)
    found = _of_ratio(strain, ratio, half) + _of_strain(strain, ratio, half, marked)
    if volume is not None:
        found += _of_volume(strain, volume, half)
    repeated = _repeated(ratio, volume)
    if repeated >= PADDING:
        found.append(
            f"the last {repeated} rows only repeat R = {ratio[-1]:g} while the strain goes on to "
            f"{_percent(strain[-1])}: if the test ended before, remove them."
        )
    return found


def without_padding(strain, ratio, volume) -> tuple[int, list[str]]:
    """(rows that are left, a sentence on those cut): rows at the end that repeat the last values exactly are no
    measurement where there are PADDING of them, and twice as many as ever repeat elsewhere, and R is not read coarsely
    with no volume beside it (it repeats then); or where the strain stands still as well."""
    repeated = _repeated(ratio, volume)
    still = int(np.argmin(np.r_[np.diff(strain)[::-1] == 0, False]))
    rows = len(strain) - min(still, repeated)
    end = len(ratio) - repeated
    same = np.diff(ratio[:end]) == 0 if volume is None else (np.diff(ratio[:end]) == 0) & (np.diff(volume[:end]) == 0)
    breaks = np.flatnonzero(np.r_[True, ~same, True])
    elsewhere = int(np.diff(breaks).max(initial=1)) - 1
    steps = np.abs(np.diff(ratio))
    coarse = volume is None and steps[steps > 0].min(initial=np.inf) > COARSE * (ratio.max() - 1)
    if repeated >= PADDING and repeated > 2 * elsewhere and end >= 2 and not coarse:
        rows = end
    if rows == len(strain):
        return rows, []
    return rows, [
        f"the last {len(strain) - rows} rows only repeat R = {ratio[-1]:g}, from axial strain {_percent(strain[rows])} "
        f"on: cut, the curve ends at {_percent(strain[rows - 1])}."
    ]


def _repeated(ratio, volume) -> int:
    """Rows at the end that repeat the values of the row before them exactly."""
    same = (np.diff(ratio) == 0) & (True if volume is None else np.diff(volume) == 0)
    return int(np.argmin(same[::-1])) if not same.all() else len(same)


def of_facts(facts) -> list[str]:
    """Sentences on what a file says of its test that the simulated one is not."""
    state = facts.consolidation or {}
    return [
        f"{facts.test or 'the test'} was consolidated with {name} = {value:g}; the simulated test is confined by equal "
        "stresses and sheared from there."
        for name, value in state.items()
    ]


def _percent(strain: float) -> str:
    return f"{strain:.4g} ({100 * strain:.3g} %)"


def _half_rise(ratio) -> int:
    """Row at which R has risen half of the way to its peak."""
    return int(np.argmax(ratio >= 1 + 0.5 * (ratio.max() - 1)))


def _of_ratio(strain, ratio, half: int) -> list[str]:
    found = []
    if ratio.min() < SMALLEST_RATIO:
        row = int(ratio.argmin())
        found.append(
            f"stress_ratio = {ratio[row]:.4g} in data row {row + 1} is below 1, where an isotropic test begins: are "
            "the stresses corrected for their zero, and is it s1/s3?"
        )
    if ratio.max() > LARGEST_RATIO:
        row = int(ratio.argmax())
        found.append(
            f"stress_ratio = {ratio[row]:.4g} in data row {row + 1}; sands reach 3 to 8: have both stresses one unit?"
        )
    if ratio[0] > START_RATIO and strain[0] <= 0.02 * strain[half]:
        found.append(
            f"stress_ratio begins at {ratio[0]:.4g} at axial strain {_percent(strain[0])}, where an isotropic test "
            "has 1: have both stresses one unit, and is the strain zero where the shear begins?"
        )
    return found


def _of_strain(strain, ratio, half: int, marked: bool) -> list[str]:
    found = []
    low, high = HALF_RISE
    if half > 0 and not low <= strain[half] <= high:
        unit = "is the unit right?" if marked else (
            "the column has no unit and is taken for fractions; write [%] behind its name if it is in percent."
        )  # fmt: skip
        found.append(
            f"R comes halfway to its peak at an axial strain of {_percent(strain[half])}, where sands and balls take "
            f"{100 * low:g} to {100 * high:g} %: {unit}"
        )
    if half > 0:
        # The chord is no steeper than the beginning of a curve that bends down, so this errs to the small side.
        offset = strain[0] - (ratio[0] - 1) * (strain[half] - strain[0]) / (ratio[half] - ratio[0])
        if offset > OFFSET * (strain[half] - strain[0]):
            found.append(
                f"axial_strain begins at {_percent(strain[0])} where R = {ratio[0]:.4g}: an isotropic start has no "
                f"strain, so some {_percent(offset)} look like an offset; subtract it in the file if it is one."
            )
        flat = int(np.flatnonzero(ratio[:half] < 1 + BEGUN * (ratio.max() - 1)).max(initial=0))
        if flat > 0 and strain[flat] - strain[0] > OFFSET * strain[half]:
            found.append(
                f"R is still {ratio[flat]:.4g} at axial strain {_percent(strain[flat])} in data row {flat + 1}: "
                "bedding of the platens, or an offset? Remove the rows before, and subtract that strain from the rest "
                "if it is one."
            )
    return found


def _of_volume(strain, volume, half: int) -> list[str]:
    found = []
    largest = np.abs(volume - volume[0]).max()
    if abs(volume[0]) > CONTRACTION * strain[0] + 0.02 * largest:
        found.append(
            f"volumetric_strain begins at {_percent(volume[0])} where the axial strain is {_percent(strain[0])}: an "
            "offset? Subtract it in the file if it is one."
        )
    shortened, lost = strain - strain[0], volume - volume[0]
    early = np.flatnonzero(shortened > 0)
    early = early[early <= max(half, early[0])]
    if lost[early].mean() < EARLY_DILATION * shortened[early].mean():
        row = int(early[-1])
        found.append(
            f"volumetric_strain = {_percent(volume[row])} at axial strain {_percent(strain[row])}: the volume grows "
            "from the start, while specimens contract first; if the file counts dilation positive, write "
            "(dilation positive) behind the name of the column."
        )
    there = shortened >= 0.1 * shortened[-1]
    rate = lost[there] / shortened[there]
    for row, wrong in (
        (int(rate.argmax()), rate.max() > CONTRACTION),
        (int(rate.argmin()), rate.min() < -DILATION),
        (int(np.abs(rate).argmax()), largest < NO_VOLUME * shortened[-1]),
    ):
        if wrong:
            row = int(np.flatnonzero(there)[row])
            found.append(
                f"volumetric_strain = {_percent(volume[row])} at axial strain {_percent(strain[row])}, "
                f"{lost[row] / shortened[row]:.3g} of it, is out of proportion: is its unit right, and the "
                "test drained?"
            )
    return found
