"""The [[stage]] tables of a case file: what follows confinement, one table a stage.

Names, units and bounds of the fields are those that the commands of a stage declare (`axijax.triaxial.commands`).
"""

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, create_model, model_validator

from axijax.app.case_parts import Section, bounds
from axijax.core.quantity import Quantity, declared
from axijax.triaxial.commands import Cycling, Fluid, Line, Moved, Moving, Pressed
from axijax.triaxial.stage import Stage, Until
from axijax.triaxial.stage_types import LATERAL, TYPES, stage

PARTS = (Moving, Cycling, Pressed, Moved, Line, Fluid, Until)
# The quantities of all commands, by name; K is of a type, not of a command.
NUMBERS: dict[str, Quantity] = {
    **{name: about for part in PARTS for name, about in declared(part).items()},
    "k": Quantity("K = s3/s1 at the end of an anisotropic stage", "-", above=0.0),
}


class StageBase(Section):
    """One stage: what the platens do, what the membrane does, and where it ends."""

    @model_validator(mode="after")
    def _makes_sense(self) -> "StageBase":
        try:
            self.build()
        except ValueError as error:
            raise ValueError(str(error).rstrip(".")) from None
        return self

    def build(self) -> Stage:
        """Raises ValueError where its fields do not fit one another."""
        given = self.model_dump(exclude_none=True, exclude_unset=True)
        return stage(given.pop("type"), given.pop("lateral", "constant"), **given)


def _fields() -> dict[str, Any]:
    made: dict[str, Any] = {
        "type": (Literal[tuple(TYPES)], Field(description="what the platens do")),
        "lateral": (Literal[tuple(LATERAL)], Field("constant", description="what the membrane does")),
        "of": (
            Literal["axial_strain", "deviator_stress"],
            Field("axial_strain", description="what the limits of cycles are limits of"),
        ),
    }
    for name, about in NUMBERS.items():
        kind = int | None if about.whole else float | None
        told: dict[str, Any] = {"description": about.description, **bounds(about)}
        made[name] = (kind, Field(None, **told))
    return made


if TYPE_CHECKING:  # mypy cannot see the fields of classes made while running

    class StageCase(StageBase):
        def __getattr__(self, name: str) -> Any: ...
else:
    StageCase = create_model("StageCase", __base__=StageBase, __doc__=StageBase.__doc__, **_fields())


HELP = """
# Stages, in place of [test] axial_strain: what follows confinement, one table each, in this order; none: compression.
# type: compression, extension, hold, cycles (first, second, cycles, of), axial_stress, lateral_stress, isotropic
#   (lateral_stress), anisotropic (lateral_stress, k). lateral, what the membrane does meanwhile: constant, constant_p,
#   line (dq_dp), constant_volume, fluid (fluid_modulus, porosity), k0. A stage ends at the first of axial_strain,
#   stress_ratio, deviator_stress, mean_stress, volumetric_strain, time, or where it leads to.
# [[stage]]
# type = "isotropic"
# lateral_stress = 1e5
# [[stage]]
# type = "compression"
# lateral = "constant_volume"
# axial_strain = 0.01
"""
