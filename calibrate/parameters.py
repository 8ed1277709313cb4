"""Which numbers are fitted, and the coordinates in which they stay physical: log for scales, logit for friction.

What is not named is held. `normal_stiffness` named without `shear_stiffness` holds the ratio ks/kn, as PHYSICS 3.3
does; named together each moves alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

ALIASES = {
    "f": "friction",
    "mu": "friction",
    "kn": "normal_stiffness",
    "ks": "shear_stiffness",
    "ks/kn": "stiffness_ratio",
    "G": "shear_modulus",
    "nu": "poisson_ratio",
    "s3": "confining_stress",
    "beta": "damping_ratio",
    "rho": "density",
    "scale": "ball_radius_scale",
}

# Default allowed range of each parameter, as factors of the reference value for all but friction and the ratio.
_FACTOR = (1e-3, 1e3)
LIMITS = {
    "friction": (1e-3, 0.999),
    "stiffness_ratio": (1e-2, 10.0),
    "normal_stiffness": _FACTOR,
    "shear_stiffness": _FACTOR,
    "shear_modulus": _FACTOR,
    "poisson_ratio": (1e-3, 0.499),
    "confining_stress": _FACTOR,
    "density": _FACTOR,
    "damping_ratio": (1e-2, 1e2),
    "ball_radius_scale": (1e-2, 1e2),
}
_ABSOLUTE = ("friction", "stiffness_ratio", "poisson_ratio", "ball_radius_scale")
_BELOW = {"friction": 1.0, "poisson_ratio": 0.5}

# What the other contact law knows nothing of.
_UNUSED = {
    "linear": ("shear_modulus", "poisson_ratio"),
    "hertz": ("normal_stiffness", "shear_stiffness", "stiffness_ratio", "ball_radius_scale"),
}


def reference_values(params) -> dict[str, float]:
    """The value of every parameter that can be named, at some `axijax` Params."""
    values = {name: float(np.mean(getattr(params, name))) for name in LIMITS if hasattr(params, name)}
    values["stiffness_ratio"] = values["shear_stiffness"] / values["normal_stiffness"]
    values["ball_radius_scale"] = 1.0
    return values


def check_used(names: Sequence[str], contact_law: str) -> None:
    """Raise ValueError for a parameter that a scene with this contact law does not use."""
    unused = [name for name in names if name in _UNUSED[contact_law]]
    if unused:
        raise ValueError(
            f"parameter '{unused[0]}': contact_law = '{contact_law}' does not use it, so no data can tell it; fit "
            "another parameter, or take the other contact law."
        )


def _hertz_stiffness(shear_modulus, poisson_ratio):
    """What the normal and the tangential stiffness under a given force are proportional to (Hertz-Mindlin)."""
    modulus = shear_modulus / (1 - poisson_ratio)
    return modulus ** (2 / 3), shear_modulus / (2 - poisson_ratio) * modulus ** (-1 / 3)


def to_coordinate(name: str, value):
    """Unconstrained coordinate of a physical value: logit for friction, log for all others."""
    return jnp.log(value) - jnp.log1p(-value) if name == "friction" else jnp.log(value)


def from_coordinate(name: str, coordinate):
    """Physical value of a coordinate."""
    return 1 / (1 + jnp.exp(-coordinate)) if name == "friction" else jnp.exp(coordinate)


def coordinate_rate(name: str, value):
    """d value / d coordinate [unit of the value]."""
    return value * (1 - value) if name == "friction" else value


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

    names: P full names. reference: values that anything not named keeps. lower, upper: (P,) physical limits.
    """

    names: tuple[str, ...]
    reference: Mapping[str, float]
    lower: np.ndarray
    upper: np.ndarray

    @classmethod
    def of(
        cls, params, names: Sequence[str] | str, bounds: Mapping[str, tuple[float, float]] | None = None
    ) -> "ParameterSet":
        """From reference Params, names or aliases (f, kn, ks, ks/kn, s3, beta, rho), and bounds by name.

        Raises ValueError for unknown, repeated or contradictory names and for bounds that make no sense.
        """
        names = names.split(",") if isinstance(names, str) else list(names)
        full = []
        for name in (str(name).strip() for name in names):
            known = ALIASES.get(name, name)
            if known not in LIMITS:
                raise ValueError(f"parameter '{name}': must be one of {', '.join(LIMITS)} (or {', '.join(ALIASES)}).")
            if known in full:
                raise ValueError(f"parameter '{known}' is named twice; name each once.")
            full.append(known)
        if not full:
            raise ValueError("no parameter is named; name at least one, for instance 'friction'.")
        if "stiffness_ratio" in full and "shear_stiffness" in full:
            raise ValueError(
                "'stiffness_ratio' and 'shear_stiffness' are both named; one gives the other, so name one."
            )
        if "ball_radius_scale" in full and {"normal_stiffness", "confining_stress"} & set(full):
            raise ValueError(
                "'ball_radius_scale' is named with a stiffness or the confining stress: only kn / (s3 r) acts, so they "
                "cannot be told apart; name one of them."
            )
        if np.ndim(params.friction) and "friction" in full:
            raise ValueError(
                "friction is given per ball; fit one number, or take friction_map for a sensitivity per ball."
            )
        reference = reference_values(params)
        given = {ALIASES.get(name, name): limits for name, limits in (bounds or {}).items()}
        for name in given:
            if name not in full:
                raise ValueError(f"bounds are given for '{name}', which is not fitted; fitted are {', '.join(full)}.")
        low, high = [], []
        for name in full:
            factor = 1.0 if name in _ABSOLUTE else reference[name]
            lower, upper = given.get(name, tuple(factor * limit for limit in LIMITS[name]))
            if not (np.isfinite([lower, upper]).all() and 0 < lower < upper and upper < _BELOW.get(name, np.inf)):
                raise ValueError(
                    f"bounds of {name} = ({lower!r}, {upper!r}): must be two numbers, 0 < lower < upper"
                    + (f" < {_BELOW[name]:g}." if name in _BELOW else ".")
                )
            low.append(lower)
            high.append(upper)
        return cls(tuple(full), reference, np.array(low, float), np.array(high, float))

    def __len__(self) -> int:
        return len(self.names)

    def coordinates(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """(P,) coordinates of physical values by name or alias; what is missing takes the reference.

        Raises ValueError, naming field, value and what is allowed, for values outside the limits.
        """
        given = {ALIASES.get(name, name): value for name, value in (values or {}).items()}
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
        return np.array([float(to_coordinate(n, v)) for n, v in zip(self.names, physical, strict=True)])

    def values(self, coordinates) -> dict[str, float]:
        """Physical values of (P,) coordinates."""
        return {name: float(from_coordinate(name, z)) for name, z in zip(self.names, coordinates, strict=True)}

    def params(self, base, coordinates, hold_time_step: bool = True):
        """`base` Params with these coordinates put in; pure, for traced coordinates.

        hold_time_step: multiply the density by the larger of normal and tangential stiffness over their reference.
            Every frequency over the reference time step then stays at or below the reference's, so that a test built
            once serves a wide range of stiffness; the loading is faster against the waves by the root of that factor.
        """
        value = {name: from_coordinate(name, z) for name, z in zip(self.names, coordinates, strict=True)}
        reference = self.reference
        kn = value.get("normal_stiffness", reference["normal_stiffness"])
        if "shear_stiffness" in value:
            ks = value["shear_stiffness"]
        else:
            ks = kn * value.get("stiffness_ratio", reference["stiffness_ratio"])
        if "ball_radius_scale" in value:  # only kn / (s3 r) acts: larger balls are softer ones (dimensional analysis)
            kn, ks = kn / value["ball_radius_scale"], ks / value["ball_radius_scale"]
        density = value.get("density", reference["density"])
        if hold_time_step and set(value) & {"normal_stiffness", "shear_stiffness", "stiffness_ratio"}:
            density = density * jnp.maximum(kn / reference["normal_stiffness"], ks / reference["shear_stiffness"])
        if hold_time_step and set(value) & {"shear_modulus", "poisson_ratio"}:
            material = ("shear_modulus", "poisson_ratio")
            now = _hertz_stiffness(*(value.get(name, reference[name]) for name in material))
            once = _hertz_stiffness(*(reference[name] for name in material))
            density = density * jnp.maximum(now[0] / once[0], now[1] / once[1])
        same = ("friction", "confining_stress", "damping_ratio", "shear_modulus", "poisson_ratio")
        changed = {name: value[name] for name in same if name in value}
        return replace(base, normal_stiffness=kn, shear_stiffness=ks, density=density, **changed)
