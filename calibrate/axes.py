"""The parameters of a fit on random packings: in which coordinate each is even, and between which values it is sought.

The box is what the fit believes before it has seen data: every coordinate equally likely within it. So its bounds are
stated with every result, and what the data leave as wide as the box is not identified.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from axijax.core.quantity import Coordinate, Quantity
from calibrate.parameters import RATIO, SCALE, Prior, aliases, fittable
from calibrate.scene import RandomScene, is_force

# Where a parameter is sought that no bounds are given for: between these values, or these factors of the reference.
BETWEEN = {
    "friction": (0.15, 0.8),
    RATIO: (0.1, 1.5),
    "poisson_ratio": (0.05, 0.45),
    "rolling_friction": (0.0, 0.6),
    "torsional_friction": (0.0, 0.6),
    "rolling_stiffness": (0.1, 2.0),
    "torsional_stiffness": (0.1, 2.0),
}
FACTORS = (1 / 6, 6.0)
STRAIGHT = ("rolling_friction", "torsional_friction", "poisson_ratio")  # may be zero and act along a line there


@dataclass(frozen=True)
class Axis:
    """One parameter: name, declaration, bounds as physical values; `coordinate` says in what it is even. label: what it
    is called where several tests have one each."""

    name: str
    about: Quantity
    low: float
    high: float
    label: str = ""

    @property
    def unit(self) -> str:
        return "" if self.about.unit == "-" else self.about.unit

    def coordinate(self, value):
        return np.asarray(self.about.to_coordinate(value), float)

    def to_unit(self, value):
        """0 at the lower bound, 1 at the upper."""
        low, high = self.coordinate(self.low), self.coordinate(self.high)
        return (self.coordinate(value) - low) / (high - low)

    def from_unit(self, share):
        low, high = self.coordinate(self.low), self.coordinate(self.high)
        return np.asarray(self.about.from_coordinate(low + np.asarray(share) * (high - low)), float)

    def stretched(self, low: float, high: float) -> "Axis":
        """The same with its bounds multiplied."""
        return replace(self, low=self.low * low, high=self.high * high)


def axes_of(
    scene: RandomScene, names: Sequence[str] | str, bounds: Mapping[str, tuple[float, float]] | None = None
) -> tuple[Axis, ...]:
    """Axes for names or symbols (friction, kn, ks/kn, eta_r..) and bounds by name.

    Raises ValueError for names that the scene has not and for bounds that make no sense.
    """
    known = fittable(scene.params)
    symbols = aliases(known)
    names = names.split(",") if isinstance(names, str) else list(names)
    full = [symbols.get(str(name).strip(), str(name).strip()) for name in names]
    given = {symbols.get(name, name): limits for name, limits in (bounds or {}).items()}
    allowed = [name for name in known if name not in (SCALE, "confining_stress", "platen_speed", "density")]
    for name in full:
        if name not in allowed:
            raise ValueError(
                f"parameter '{name}' cannot be fitted on this specimen; there are {', '.join(allowed)} "
                f"(or {', '.join(s for s, n in symbols.items() if n in allowed)})."
            )
    if not full or len(set(full)) < len(full):
        raise ValueError(f"fit = {', '.join(full) or 'nothing'}: name at least one parameter, and each once.")
    if {RATIO, "shear_stiffness"} <= set(full):
        raise ValueError("'stiffness_ratio' and 'shear_stiffness' are both named; one gives the other, so name one.")
    for name in given:
        if name not in full:
            raise ValueError(f"bounds are given for '{name}', which is not fitted; fitted are {', '.join(full)}.")
    return tuple(_axis(scene, name, *known[name], given.get(name)) for name in full)


def _axis(scene: RandomScene, name: str, about: Quantity, reference, limits) -> Axis:
    least = max(scene.least.get(name, -np.inf), about.least if about.least > about.above else about.above)
    if limits is None:
        low, high = BETWEEN.get(name, tuple(factor * float(reference) for factor in FACTORS))
        low, high = max(low, least), min(high, about.most, 0.998 * about.below)
        if name == "friction":
            high = max(high, min(4 * low, 1.5))
    else:
        low, high = map(float, limits)
    straight = name in STRAIGHT or about.coordinate == "linear"
    if not (np.isfinite([low, high]).all() and least <= low < high <= about.most and high < about.below):
        raise ValueError(f"bounds of {name} = ({low:g}, {high:g}): must be {_allowed(least, about)}, lower < upper.")
    if not straight and low <= 0:
        raise ValueError(f"lower bound of {name} = {low:g}: must be positive.")
    if straight:
        return Axis(name, replace(about, coordinate="linear"), low, high)
    even: Coordinate = "logit" if about.coordinate == "logit" and high < about.top else "log"
    return Axis(name, replace(about, coordinate=even), low, high)


def _allowed(least: float, about: Quantity) -> str:
    high = min(about.most, about.below)
    low = f"{least:g} or more" if np.isfinite(least) else "numbers"
    return low + (f" and up to {high:g}" if np.isfinite(high) else "")


def physical(scene: RandomScene, axes: Sequence[Axis], values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """The scene's parameters that these values of the axes change; kn without ks keeps their ratio."""
    chosen = dict(zip((axis.name for axis in axes), map(float, values), strict=True))
    found = {name: value for name, value in chosen.items() if name != RATIO}
    reference = scene.values()
    if RATIO in chosen or ("normal_stiffness" in chosen and "shear_stiffness" not in chosen):
        kn = chosen.get("normal_stiffness", reference["normal_stiffness"])
        held = reference["shear_stiffness"] / reference["normal_stiffness"] if "shear_stiffness" in reference else None
        ratio = chosen.get(RATIO, held)
        if ratio is not None and "shear_stiffness" in reference:
            found["shear_stiffness"] = kn * ratio
    return found


def of_point(scene: RandomScene, axes: Sequence[Axis], point: Mapping[str, float]) -> np.ndarray:
    """(P,) values of the axes at a run's point, at the scene's own confining stress."""
    found = []
    for axis in axes:
        if axis.name == RATIO:
            found.append(point["shear_stiffness"] / point["normal_stiffness"])
        else:
            found.append(point[axis.name] * (scene.stress if is_force(scene, axis.name) else 1.0))
    return np.array(found)


def prior_density(axes: Sequence[Axis], priors: Mapping[str, Prior], points: np.ndarray) -> np.ndarray:
    """(n,) log of what is believed beyond the box, up to a constant, at (n, P) shares of it."""
    total = np.zeros(len(points))
    for k, axis in enumerate(axes):
        prior = priors.get(axis.name)
        if prior is not None:
            apart = axis.coordinate(axis.from_unit(points[:, k])) - axis.coordinate(prior.value)
            total -= 0.5 * (apart / prior.spread) ** 2
    return total
