"""What is known of a parameter beside its value: unit, bounds, symbol, natural coordinate.

Declared once, where the parameter is:

    friction: jax.Array | float | None = quantity(0.12278, "Coulomb coefficient between balls", "-", symbols=("f",))

Case files, checks, fits and their help read it from there, by `declared` and `present`. A tree of dataclasses holds the
parameters of a test; every name occurs once in it, so a name alone finds its place (`with_values`). A parameter or part
that is None is not there: it is not compiled, stored or differentiated.
"""

import dataclasses
import difflib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

Coordinate = Literal["log", "logit", "linear"]


@dataclass(frozen=True)
class Quantity:
    """A parameter's declaration.

    meaning: a few words, without the unit. unit: in [L], [M], [T], [F], or "-".
    least, above: lower bound, itself allowed or not. below, most: upper bound, itself not allowed or allowed.
    positive: the direction that counts as positive, where that is a convention.
    symbols: short names by which a fit may call it.
    coordinate: in which it is a number without bounds: "log" of a scale, "logit" of what lies between 0 and `below`.
    per_ball: it may also be one number a ball. whole: it counts something. infinite: it may be infinite.
    optional: it may be None, that is not there.
    """

    meaning: str
    unit: str
    least: float = 0.0
    above: float = -np.inf
    below: float = np.inf
    most: float = np.inf
    positive: str = ""
    symbols: tuple[str, ...] = ()
    coordinate: Coordinate = "log"
    per_ball: bool = False
    whole: bool = False
    infinite: bool = False
    optional: bool = False

    @property
    def description(self) -> str:
        meaning = f"{self.meaning}, {self.positive} positive" if self.positive else self.meaning
        return f"{meaning} [{self.unit}]" if self.unit else meaning

    @property
    def allowed(self) -> str:
        """The bounds in words."""
        low = f"above {self.above:g}" if self.above >= self.least else f"{self.least:g} or more"
        low = {"above 0": "positive", "0 or more": "zero or positive", "-inf or more": "a number"}.get(low, low)
        low = f"{low}, {self.positive}" if self.positive else low
        low = f"a whole number, {low}" if self.whole else low
        high = f" and below {self.below:g}" if np.isfinite(self.below) else ""
        return low + (f" and at most {self.most:g}" if np.isfinite(self.most) else high)

    @property
    def top(self) -> float:
        """Below which a logit coordinate keeps it."""
        return self.below if np.isfinite(self.below) else 1.0

    def to_coordinate(self, value):
        """The unconstrained coordinate of a physical value."""
        if self.coordinate == "logit":
            share = value / self.top
            return jnp.log(share) - jnp.log1p(-share)
        return jnp.log(value) if self.coordinate == "log" else jnp.asarray(value)

    def from_coordinate(self, coordinate):
        """The physical value of a coordinate."""
        if self.coordinate == "logit":
            return self.top / (1 + jnp.exp(-coordinate))
        return jnp.exp(coordinate) if self.coordinate == "log" else coordinate

    def coordinate_rate(self, value):
        """d value / d coordinate [unit of the value]."""
        if self.coordinate == "logit":
            return value * (1 - value / self.top)
        return value if self.coordinate == "log" else jnp.ones_like(value)

    def trouble(self, name: str, value, balls: int | None = None) -> str | None:
        """The sentence for a concrete value that makes no sense, or None. balls: number of them, for one value each."""
        numbers = np.asarray(value)
        if self.whole and numbers.dtype.kind not in "iu":
            return f"{name} = {value!r}: must be {self.allowed}."
        if numbers.dtype.kind not in "fiu":
            return f"{name} = {value!r}: must be a number."
        finite = np.isfinite(numbers) | (np.isposinf(numbers) & self.infinite)
        if not finite.all():
            return f"{name} = {numbers[~finite].ravel()[0]}: must be a finite number."
        for shown in (numbers.min(), numbers.max()) if numbers.size else ():
            if shown < self.least or shown <= self.above or shown > self.most or self.below <= shown < np.inf:
                return f"{name} = {shown:g}: must be {self.allowed}."
        if numbers.shape != () and not (self.per_ball and numbers.shape == (balls,)):
            each = f", or ({balls},), one per ball" if self.per_ball else ""
            return f"{name} has shape {numbers.shape}: must be one number{each}."
        return None


def quantity(default, meaning: str, unit: str, **about) -> Any:
    """A dataclass field with this default that is a parameter; see `Quantity` for the rest."""
    return dataclasses.field(default=default, metadata={"quantity": Quantity(meaning, unit, **about)})


def part(kind: type, meaning: str) -> Any:
    """A dataclass field for a part that is not there by default; giving any of its parameters by name puts it there."""
    return dataclasses.field(default=None, metadata={"part": kind, "meaning": meaning})


def optional_parts(tree: type | object) -> dict[str, type]:
    """The optional parts that a part declares, there or not, by field."""
    return {f.name: f.metadata["part"] for f in dataclasses.fields(tree) if "part" in f.metadata}  # type: ignore[arg-type]


def setting(default, meaning: str, unit: str = "", **about) -> Any:
    """A dataclass field with this default that a case file may hold but nothing is differentiated against."""
    return dataclasses.field(default=default, metadata={"setting": Quantity(meaning, unit, **about)})


def settings(part: type | object) -> dict[str, Quantity]:
    """The settings that a part declares, by name."""
    return {f.name: f.metadata["setting"] for f in dataclasses.fields(part) if "setting" in f.metadata}  # type: ignore[arg-type]


def declared(part: type | object) -> dict[str, Quantity]:
    """The parameters that a part itself declares, there or not, by name."""
    return {f.name: f.metadata["quantity"] for f in dataclasses.fields(part) if "quantity" in f.metadata}  # type: ignore[arg-type]


def parts_of(tree) -> list[Any]:
    """The tree's parts, depth first: itself and every dataclass or member of a tuple below it that is there."""
    below = tree if isinstance(tree, tuple) else []
    if dataclasses.is_dataclass(tree):
        below = [getattr(tree, f.name) for f in dataclasses.fields(tree) if "quantity" not in f.metadata]
    found = [tree] if dataclasses.is_dataclass(tree) else []
    for each in below:
        if isinstance(each, tuple) or dataclasses.is_dataclass(each):
            found += parts_of(each)
    return found


def present(tree) -> dict[str, tuple[Quantity, Any]]:
    """Declaration and value of every parameter of a tree that is there, by name."""
    return {
        name: (about, getattr(part, name))
        for part in parts_of(tree)
        for name, about in declared(part).items()
        if getattr(part, name) is not None
    }


def values_of(tree) -> dict[str, Any]:
    """The value of every parameter of a tree that is there, by name."""
    return {name: value for name, (_, value) in present(tree).items()}


def senseless(tree) -> jax.Array:
    """Whether any parameter is outside its bounds, as a traced value; what `check_values` cannot see."""
    wrong = [
        jnp.any((value < about.least) | (value <= about.above) | ((value >= about.below) & np.isfinite(about.below)))
        for about, value in present(tree).values()
    ]
    return jnp.stack(wrong).any()


def with_values(tree, values: dict[str, Any]):
    """The tree with parameters or parts replaced by name, wherever in it they are.

    Raises ValueError for a name that no part of it has, since that parameter would do nothing.
    """
    left = dict(values)
    made = _replaced(tree, left)
    if left:
        raise ValueError(_not_there(next(iter(left)), next(iter(left.values())), made))
    return made


def _replaced(tree, left: dict[str, Any]):
    if isinstance(tree, tuple):
        return tuple(_replaced(each, left) for each in tree)
    if not dataclasses.is_dataclass(tree) or not left:
        return tree
    changes = {}
    for f in dataclasses.fields(tree):
        value = left.pop(f.name) if f.name in left else getattr(tree, f.name)
        kind = f.metadata.get("part")
        if value is None and kind is not None and set(left) & set(declared(kind)):
            value = kind()
        after = _replaced(value, left)
        if after is not getattr(tree, f.name):
            changes[f.name] = after
    return dataclasses.replace(tree, **changes) if changes else tree  # type: ignore[type-var]


def _not_there(name: str, value, tree) -> str:
    known = [each for part in parts_of(tree) for each in declared(part)]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}."
    shown = "" if isinstance(value, jax.core.Tracer) or np.ndim(value) else f" = {value!r}"
    kinds = ", ".join(type(part).__name__ for part in parts_of(tree))
    return f"{name}{shown}: no part of these parameters ({kinds}) has it, so it would do nothing; {hint}"


def check_values(tree, balls: int | None = None, where: Callable[[str], str] = str) -> None:
    """Raise ValueError, naming field, value and what is allowed, for concrete parameters that make no sense.

    balls: number of balls in the sector, for parameters that may be given per ball.
    """
    every = [(name, about, getattr(part, name)) for part in parts_of(tree) for name, about in declared(part).items()]
    for name, about, value in every:
        if (value is None and about.optional) or isinstance(value, jax.core.Tracer):
            continue
        trouble = about.trouble(where(name), value, balls)
        if trouble:
            raise ValueError(trouble)
