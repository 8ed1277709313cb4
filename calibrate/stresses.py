"""The stress ratio s1/s3 of a table that holds it, or q/p, or two of s1, s3, q = s1 - s3 and p = (s1 + 2 s3)/3.

Everything that the table says of the stresses is held against everything else it says.
"""

import re
from dataclasses import dataclass

import numpy as np

from calibrate.names import AXIAL, CONFINING, DEVIATOR, MEAN, OBLIQUITY, PASCAL, PORE_PRESSURE, RATIO, Head, taken_apart
from calibrate.table import DataError, Table, short

AGREE = 0.01  # of stress ratios made in two ways from one file; of the largest stress of one kind likewise
STEADY = 0.05  # of a confining stress that is given, within which that of a column must be
# Each stress as so much of s1 and so much of s3.
SHARES = {AXIAL: (1.0, 0.0), CONFINING: (0.0, 1.0), DEVIATOR: (1.0, -1.0), MEAN: (1 / 3, 2 / 3)}
# Two that give the others, those first that lose the least to rounding.
PAIRS = (
    (AXIAL, CONFINING), (DEVIATOR, CONFINING), (AXIAL, DEVIATOR), (DEVIATOR, MEAN), (AXIAL, MEAN), (MEAN, CONFINING),
)  # fmt: skip


@dataclass(frozen=True)
class Stresses:
    """ratio: (M,) s1/s3. confining: (M,) s3 or None, in Pa where `in_pascal`, else as written. made_of: how s3 was had,
    empty where a column holds it."""

    ratio: np.ndarray
    confining: np.ndarray | None
    in_pascal: bool
    made_of: str = ""


def known_from(quantities, confining: float | None) -> bool:
    """Whether these columns, with a confining stress that may be given, make a stress ratio."""
    there = set(quantities) | ({CONFINING} if confining is not None else set())
    return RATIO in there or OBLIQUITY in there or any(set(pair) <= there for pair in PAIRS)


class StressReader:
    """Makes the stress ratio of the columns found.

    found: {quantity: heads}; numbers: {place: (M,)}; confining: in Pa, given beside the table, or None.
    """

    def __init__(self, table: Table, found: dict[str, list[Head]], numbers, same, size_of_one, confining: float | None):
        self.file, self.header, self.first = table.file, table.header, table.rows[0]
        self.found, self.numbers, self.confining = found, numbers, confining
        self.same, self.size_of_one = same, size_of_one

    def title(self, quantity: str) -> str:
        if quantity not in self.found:
            return "the confining stress given"
        return f"'{short(self.header[self.found[quantity][0].place], quoted=False)}'"

    def read(self) -> Stresses:
        """The stress ratio, after every check. Raises DataError."""
        ways: dict[str, np.ndarray] = {}
        if RATIO in self.found:
            ways[self.title(RATIO)] = self._pure(RATIO)
        if OBLIQUITY in self.found:
            share = self._pure(OBLIQUITY)
            if share.max() >= 3:
                row = int(share.argmax())
                raise DataError(
                    f"{self.file}: {self.title(OBLIQUITY)} = {share[row]:g} in data row {row + 1}: q/p must be below "
                    "3, where s3 vanishes; if the column holds s1/s3, name it stress_ratio."
                )
            ways[self.title(OBLIQUITY)] = (3 + 2 * share) / (3 - share)
        confining, in_pascal, made_of = None, False, ""
        value, in_pascal = self._sized(needed=not ways)
        pair = next((pair for pair in PAIRS if set(pair) <= set(value)), None)
        if pair is not None:
            axial, confining = self._solved(pair, value)
            made_of = "" if CONFINING in value else " and ".join(self.title(each) for each in pair)
            self._check_pressed(confining, pair, value)
            self._check_others(pair, value, axial, confining)
            ways[self._way(pair)] = axial / confining
        elif CONFINING in value:
            confining = value[CONFINING]
            self._check_pressed(confining, (CONFINING,), value)
        return Stresses(self._agreeing(ways), confining, in_pascal, made_of)

    def _pure(self, quantity: str) -> np.ndarray:
        columns = [self.numbers[head.place] * (self.size_of_one(head) or 1.0) for head in self.found[quantity]]
        return self.same(quantity, columns)

    def _sized(self, needed: bool) -> tuple[dict[str, np.ndarray], bool]:
        """({quantity: (M,)} in one unit, whether that is Pa). needed: the ratio is to be made of them, so that a unit
        that cannot be known is refused, and not left aside."""
        heads = [head for quantity in SHARES for head in self.found.get(quantity, [])]
        if not heads:
            return {}, self.confining is not None
        alone = self.confining is not None and CONFINING not in self.found
        used = sum(quantity in self.found for quantity in SHARES) + alone > 1
        try:
            sizes, in_pascal = self._units(heads, alone)
        except DataError:
            if needed or used:
                raise
            return {}, False
        value = {
            quantity: self.same(
                quantity, [head.turned * self.numbers[head.place] * sizes[head.place] for head in self.found[quantity]]
            )
            for quantity in SHARES
            if quantity in self.found
        }
        if self.confining is not None and CONFINING in value and in_pascal:
            start = float(value[CONFINING][0])
            if abs(start - self.confining) > STEADY * self.confining:
                raise DataError(
                    f"{self.file}: confining stress = {self.confining:g} Pa is given, but {self.title(CONFINING)} "
                    f"begins at {start:g} Pa; leave out what is given, or mend the file."
                )
        if alone:
            value[CONFINING] = np.full(len(self.numbers[heads[0].place]), self.confining)
        return value, in_pascal

    def _units(self, heads: list[Head], with_pascal: bool) -> tuple[dict[int, float], bool]:
        """({place: size in Pa}, True), or sizes of 1 where all columns share one unknown unit or none."""
        marks = [head.mark for head in heads]
        if all(mark in PASCAL for mark in marks):
            return {head.place: PASCAL[head.mark] for head in heads if head.mark is not None}, True
        if len(set(marks)) == 1 and not with_pascal:
            return {head.place: 1.0 for head in heads}, False
        odd = next(head for head in heads if head.mark not in PASCAL)
        mark = (
            "without a unit" if odd.mark is None else f"marked {short(odd.mark)}, which is no unit of stress known here"
        )
        shown = [repr(short(self.header[head.place], quoted=False)) for head in heads if head is not odd]
        shown += ["a confining stress that is given"] if with_pascal else []
        raise DataError(
            f"{self.file}: column '{short(self.header[odd.place], quoted=False)}' is {mark}, beside "
            f"{', '.join(shown)}: the stress ratio cannot be known; write [Pa], [kPa], [MPa], [bar] or [psi] behind "
            "every stress."
        )

    @staticmethod
    def _solved(pair, value) -> tuple[np.ndarray, np.ndarray]:
        """(s1, s3) of two stresses."""
        inverse = np.linalg.inv(np.array([SHARES[each] for each in pair]))
        first, second = (value[each] for each in pair)
        return inverse[0, 0] * first + inverse[0, 1] * second, inverse[1, 0] * first + inverse[1, 1] * second

    def _way(self, pair) -> str:
        if pair == (DEVIATOR, CONFINING):
            return f"1 + {self.title(DEVIATOR)} over {self.title(CONFINING)}"
        if pair == (AXIAL, CONFINING):
            return f"{self.title(AXIAL)} over {self.title(CONFINING)}"
        return " and ".join(self.title(each) for each in pair)

    def _check_others(self, pair, value, axial, confining) -> None:
        """Stresses that were not needed must be what the two that were make of them."""
        for other in set(value) - set(pair):
            made = SHARES[other][0] * axial + SHARES[other][1] * confining
            apart = np.abs(made - value[other]) > AGREE * np.abs(made).max()
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                hint = "; here p is (s1 + 2 s3)/3 and q is s1 - s3" if other in (MEAN, DEVIATOR) else ""
                raise DataError(
                    f"{self.file}: {self.title(other)} is {value[other][row]:g} in data row {row + 1}, but "
                    f"{self._way(pair)} make it {made[row]:g}, in one unit; remove or rename the wrong column{hint}."
                )

    def _agreeing(self, ways: dict[str, np.ndarray]) -> np.ndarray:
        (first, ratio), *others = ways.items()
        for other, again in others:
            apart = np.abs(again - ratio) > AGREE * np.abs(ratio)
            if apart.any():
                row = int(np.flatnonzero(apart)[0])
                raise DataError(
                    f"{self.file}: the stress ratio s1/s3 in data row {row + 1} is {ratio[row]:g} by {first}, but "
                    f"{again[row]:g} by {other}; remove or rename the wrong column."
                )
        return ratio

    def _check_pressed(self, confining: np.ndarray, pair, value) -> None:
        """The confining stress, compression positive, must be so."""
        title = self.title(CONFINING) if CONFINING in value else f"s3, made of {self._way(pair)},"
        row = int(np.argmin(confining))
        if (confining < 0).all():
            others = [self.title(each) for each in pair if each != CONFINING]
            also = f" and {others[0]}" if others and CONFINING in pair else ""
            raise DataError(
                f"{self.file}: {title}{also} look tension-positive ({title} is {confining[0]:g} in data row 1); "
                "compression must be positive: write (tension positive) behind the names of strains and stresses, or "
                "turn the signs in the file."
            )
        if not confining[row] > 0:
            raise DataError(
                f"{self.file}: {title} = {confining[row]:g} in data row {row + 1}: must be positive to divide by; "
                "correct or remove the row."
            )

    def total_stresses(self) -> tuple[str, ...]:
        """A sentence where a column of pore pressure, not zero, stands beside stresses not said to be effective."""
        shown = [
            short(self.header[head.place], quoted=False)
            for kind in (CONFINING, AXIAL, MEAN)
            for head in self.found.get(kind, [])
        ]
        effective = re.compile("effective|['\u2019\u2032]", re.IGNORECASE)
        if RATIO in self.found or all(effective.search(one) for one in shown):
            return ()
        return tuple(
            f"'{short(cell, quoted=False)}' ({short(first, quoted=False)} in data row 1) stands beside "
            f"{' and '.join(map(repr, shown))}: s1/s3 is made of them as they are; if they are total stresses, "
            "subtract the pore pressure in the file."
            for cell, first in zip(self.header, self.first, strict=True)
            if taken_apart(0, cell).name in PORE_PRESSURE and first.strip("+-0.,")
        )
