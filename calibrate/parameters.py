"""Which numbers are fitted, and the coordinates in which they stay physical: log for scales, logit for friction, whose
coordinate is a log too where its bounds pass 1.

What is not named is held. `normal_stiffness` named without `shear_stiffness` holds the ratio ks/kn, as PHYSICS 3.3
does; named together each moves alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from axijax.core.quantity import Quantity, present

# Numbers that are no field of their own: kn and ks follow from them.
RATIO, SCALE = "stiffness_ratio", "ball_radius_scale"
DERIVED = {
    RATIO: Quantity("tangential over normal stiffness of a contact", "-", above=0.0, symbols=("ks/kn",)),
    SCALE: Quantity("radius of the balls over the test's: larger balls are softer", "-", above=0.0, symbols=("scale",)),
}
# Default range of what is not bounded by nature, as factors of the reference value.
RANGE = {RATIO: (1e-2, 10.0), SCALE: (1e-2, 1e2)}
FACTOR = (1e-3, 1e3)


def fittable(params) -> dict[str, tuple[Quantity, Any]]:
    """Declaration and value of every parameter of `axijax` Params that a fit can name; what is not there would do
    nothing, so no data can tell it."""
    found = present(params)
    if {"normal_stiffness", "shear_stiffness"} <= set(found):
        kn, ks = (found[name][1] for name in ("normal_stiffness", "shear_stiffness"))
        found |= {RATIO: (DERIVED[RATIO], ks / kn), SCALE: (DERIVED[SCALE], 1.0)}
    return found


def aliases(known: Mapping[str, tuple[Quantity, Any]]) -> dict[str, str]:
    """Full names by symbol."""
    return {symbol: name for name, (about, _) in known.items() for symbol in about.symbols}


def default_limits(name: str, about: Quantity, reference: float) -> tuple[float, float]:
    """The range of a parameter in a fit that gives none, in physical values."""
    if about.coordinate == "logit":
        if reference >= about.top:  # of balls that are stronger than the usual range
            return 1e-3 * about.top, 3 * reference
        return 1e-3 * about.top, 0.999 * about.top
    low, high = (factor * reference for factor in RANGE.get(name, FACTOR))
    return low, min(high, 0.998 * about.below)


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter before the data: a normal distribution of its coordinate.

    value: most likely physical value. spread: standard deviation of the coordinate [-]; for a log coordinate 0.1
    means about 10 %. Raises ValueError unless value is finite and spread positive.
    """

    value: float
    spread: float

    def __post_init__(self):
        if not (np.isfinite(self.value) and self.value > 0):
            raise ValueError(f"prior value = {self.value!r}: must be positive and finite.")
        if not (np.isfinite(self.spread) and self.spread > 0):
            raise ValueError(
                f"prior spread = {self.spread!r}: must be positive, in units of the log (or logit) of the value."
            )


@dataclass(frozen=True)
class ParameterSet:
    """Named parameters of one simulator, in order; P of them.

    names: P full names. about: their declarations. reference: values that anything not named keeps.
    lower, upper: (P,) physical limits. symbols: short names of all parameters there are.
    """

    names: tuple[str, ...]
    about: tuple[Quantity, ...]
    reference: Mapping[str, float]
    lower: np.ndarray
    upper: np.ndarray
    symbols: Mapping[str, str]

    @classmethod
    def of(
        cls, params, names: Sequence[str] | str, bounds: Mapping[str, tuple[float, float]] | None = None
    ) -> "ParameterSet":
        """From reference Params, names or symbols (f, kn, ks, ks/kn, s3, beta, rho, G, nu), and bounds by name.

        Raises ValueError for unknown, repeated or contradictory names and for bounds that make no sense.
        """
        known = fittable(params)
        symbols = aliases(known)
        names = names.split(",") if isinstance(names, str) else list(names)
        full = []
        for name in (str(name).strip() for name in names):
            found = symbols.get(name, name)
            if found not in known:
                raise ValueError(
                    f"parameter '{name}': this test has no such number, so no data can tell it; it has "
                    f"{', '.join(known)} (or {', '.join(symbols)})."
                )
            if found in full:
                raise ValueError(f"parameter '{found}' is named twice; name each once.")
            full.append(found)
        if not full:
            raise ValueError("no parameter is named; name at least one, for instance 'friction'.")
        if RATIO in full and "shear_stiffness" in full:
            raise ValueError(
                "'stiffness_ratio' and 'shear_stiffness' are both named; one gives the other, so name one."
            )
        if SCALE in full and {"normal_stiffness", "confining_stress"} & set(full):
            raise ValueError(
                "'ball_radius_scale' is named with a stiffness or the confining stress: only kn / (s3 r) acts, so they "
                "cannot be told apart; name one of them."
            )
        if "friction" in full and np.ndim(known["friction"][1]):
            raise ValueError(
                "friction is given per ball; fit one number, or take friction_map for a sensitivity per ball."
            )
        reference = {name: float(np.mean(value)) for name, (_, value) in known.items()}
        given = {symbols.get(name, name): limits for name, limits in (bounds or {}).items()}
        for name in given:
            if name not in full:
                raise ValueError(f"bounds are given for '{name}', which is not fitted; fitted are {', '.join(full)}.")
        about, low, high = [], [], []
        for name in full:
            each = known[name][0]
            ranged = each.coordinate == "logit" or (each.coordinate == "log" and 0 < reference[name] < np.inf)
            if name not in given and not ranged:
                raise ValueError(
                    f"{name} = {reference[name]:g} in this test, from which no range to fit in follows: give bounds."
                )
            lower, upper = given.get(name, default_limits(name, each, reference[name]))
            if each.coordinate == "logit" and np.isinf(each.below) and upper >= each.top:
                each = replace(each, coordinate="log")  # a friction above 1: no bound of nature is left
            top = each.top if each.coordinate == "logit" else each.below
            least = -np.inf if each.coordinate == "linear" else 0.0
            if not (np.isfinite([lower, upper]).all() and least < lower < upper < top):
                raise ValueError(
                    f"bounds of {name} = ({lower!r}, {upper!r}): must be two numbers, "
                    + ("" if np.isinf(least) else "0 < ")
                    + "lower < upper"
                    + (f" < {top:g}." if np.isfinite(top) else ".")
                )
            about.append(each)
            low.append(lower)
            high.append(upper)
        return cls(tuple(full), tuple(about), reference, np.array(low, float), np.array(high, float), symbols)

    def full_name(self, name: str) -> str:
        """The full name of a symbol, or the name itself."""
        return self.symbols.get(name, name)

    def about_of(self, name: str) -> Quantity:
        """The declaration of one of the names."""
        return self.about[self.names.index(name)]

    def __len__(self) -> int:
        return len(self.names)

    def coordinates(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """(P,) coordinates of physical values by name or alias; what is missing takes the reference.

        Raises ValueError, naming field, value and what is allowed, for values outside the limits.
        """
        given = {self.full_name(name): value for name, value in (values or {}).items()}
        for name in given:
            if name not in self.names:
                raise ValueError(f"a value is given for '{name}', which is not among {', '.join(self.names)}.")
        physical = np.array([float(given.get(name, self.reference[name])) for name in self.names])
        for name, value, low, high in zip(self.names, physical, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                raise ValueError(f"{name} = {value:g}: must lie in its limits {low:g} to {high:g}.")
        return self._coordinates(physical)

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """(P,) lower and upper limits of the coordinates."""
        return self._coordinates(self.lower), self._coordinates(self.upper)

    def _coordinates(self, physical) -> np.ndarray:
        return np.array([float(each.to_coordinate(v)) for each, v in zip(self.about, physical, strict=True)])

    def values(self, coordinates) -> dict[str, float]:
        """Physical values of (P,) coordinates."""
        return {name: float(value) for name, value in self._physical(coordinates).items()}

    def _physical(self, coordinates) -> dict[str, Any]:
        pairs = zip(self.names, self.about, coordinates, strict=True)
        return {name: about.from_coordinate(z) for name, about, z in pairs}

    def params(self, base, coordinates, hold_time_step: bool = True):
        """`base` Params with these coordinates put in; pure, for traced coordinates.

        hold_time_step: multiply the density by the larger of normal and tangential stiffness over their reference,
            and by what the resistances to rotation have grown beside it. Every frequency over the reference time step
            then stays at or below the reference's, so that a test built once serves a wide range of stiffness; the
            loading is faster against the waves by the root of that factor.
        """
        value = self._physical(coordinates)
        changes = {name: number for name, number in value.items() if name not in DERIVED}
        if set(value) & {RATIO, SCALE, "normal_stiffness"}:
            kn = value.get("normal_stiffness", self.reference.get("normal_stiffness"))
            ks = value.get("shear_stiffness", kn * value.get(RATIO, self.reference[RATIO]))
            # Only kn / (s3 r) acts: larger balls are softer ones (dimensional analysis).
            softer = value.get(SCALE, 1.0)
            changes |= {"normal_stiffness": kn / softer, "shear_stiffness": ks / softer}
        made = replace(base, **changes)
        stiffness = {"normal_stiffness", "shear_stiffness", RATIO, "shear_modulus", "poisson_ratio"}
        if hold_time_step and set(value) & stiffness:
            made = replace(made, density=made.density * made.material.stiffness_over(base.material))
        if hold_time_step and set(value) & {"rolling_stiffness", "torsional_stiffness"}:
            made = replace(made, density=made.density * made.material.turning_over(base.material))
        return made
