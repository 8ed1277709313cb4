"""What a test is differentiated against: the material of the balls, the loading, and what else acts on them."""

from dataclasses import dataclass
from typing import Any

import jax

from axijax.core.quantity import check_values, optional_parts, parts_of, present, quantity, with_values
from axijax.core.tree import pytree
from axijax.mechanics.damping import Damping
from axijax.mechanics.linear import Linear
from axijax.mechanics.material import Material
from axijax.mechanics.term import Term


@pytree
@dataclass(frozen=True, init=False)
class Params:
    """A tree of numbers in consistent units, each may be a traced JAX value.

    Defaults are those of Cui & O'Sullivan (2005), section 4.2, with friction as measured by Rowe (1962). Every number
    has a name of its own, by which it is given, read and replaced, wherever in the tree it is:

        Params(friction=0.3), Params(Hertz(shear_modulus=5e9), friction=0.3)
        params.friction, dataclasses.replace(params, friction=0.4, damping=None)

    material: of the balls, `Linear` or `Hertz` or one of your own.
    confining_stress: s3, compression positive [F/L^2].
    platen_speed: speed of each platen during shear, inward positive [L/T].
    terms: further forces on the balls, such as `axijax.mechanics.gravity.Gravity`; see `axijax.mechanics.term`.

    Raises ValueError for a name that no part has: it would do nothing.
    """

    material: Material
    confining_stress: jax.Array | float = quantity(
        5.0e4, "confining stress s3", "F/L^2", above=0.0, positive="compression", symbols=("s3",)
    )
    platen_speed: jax.Array | float = quantity(
        0.01, "speed of each platen during shear", "L/T", above=0.0, positive="inward"
    )
    terms: tuple[Term, ...] = ()

    def __init__(
        self,
        material: Material | None = None,
        confining_stress: jax.Array | float = 5.0e4,
        platen_speed: jax.Array | float = 0.01,
        terms: tuple[Term, ...] = (),
        **named: Any,
    ):
        material = Linear() if material is None else material
        if named:
            material, terms = with_values((material, terms), named)
        for name, value in zip(
            ("material", "confining_stress", "platen_speed", "terms"),
            (material, confining_stress, platen_speed, terms),
            strict=True,
        ):
            object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or "terms" not in vars(self):  # as pickle and copy ask of an object without fields
            raise AttributeError(name)
        for part in parts_of((self.material, self.terms)):
            if name in part.__dataclass_fields__:
                return getattr(part, name)
        raise AttributeError(f"these parameters have no '{name}'; they have {', '.join(present(self))}")


def check_params(params: Params, balls: int) -> None:
    """Raise ValueError, naming field, value and what is allowed, for concrete parameters that make no sense.

    balls: number of balls in the sector, for a friction per ball.
    """
    if not isinstance(params, Params):
        raise ValueError(f"params = {params!r}: must be an axijax.Params.")
    if not isinstance(params.material, Material):
        raise ValueError(f"material = {params.material!r}: must be a material, such as axijax.Linear().")
    for name, kind in (("damping", Damping), *optional_parts(params.material).items()):
        part = getattr(params.material, name)
        if part is not None and not isinstance(part, kind):
            such = "Dashpot" if kind is Damping else kind.__name__
            raise ValueError(f"{name} = {part!r}: must be None or a {kind.__name__}, such as {such}().")
    for term in params.terms:
        if not isinstance(term, Term):
            raise ValueError(f"terms hold {term!r}: each must be an axijax.mechanics.term.Term.")
    check_values(params, balls)
