"""The sections [scene] and [parameters] of a case file: which parts of `Params` there are, and their numbers.

Names, bounds, units and defaults are those that the parts themselves declare (`axijax.core.quantity`). A parameter that
would do nothing in its scene is refused; where it only repeats its default, as files of older versions do, it is left
out with a warning.
"""

import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, create_model

from axijax.core.quantity import Quantity, declared, optional_parts
from axijax.mechanics.damping import BackgroundDamping, Damping, Dashpot, LocalDamping
from axijax.mechanics.dynamics import MembraneKind, Scene
from axijax.mechanics.hertz import Hertz
from axijax.mechanics.linear import Linear
from axijax.mechanics.material import Material
from axijax.mechanics.params import Params

# Inertial number at which random specimens are sheared where nothing else is said. With 200 to 500 balls in a sector
# the unbalanced force is then 0.003 in the mean and below 0.01 in 98 % of the records (with rolling friction 0.0005);
# at twice the speed in 84 to 96 %, at five times the speed in 18 to 67 %.
SLOW = 1e-4

# Fields that a file may leave to the specimen, and what they are then.
LEFT_OUT = {
    "confining_friction": "left out: none, but for a random specimen that of its compaction, and for a packing from a "
    "file that of the test",
    "platen_speed": "left out: 0.01, but for a random specimen that of an inertial number of 1e-4",
}

MATERIALS: dict[str, type[Material]] = {"linear": Linear, "hertz": Hertz}
DAMPINGS: dict[str, type[Damping] | None] = {
    "dashpot": Dashpot, "local": LocalDamping, "background": BackgroundDamping, "none": None,
}  # fmt: skip


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, ser_json_inf_nan="constants")


class SceneCase(Section):
    """What is modelled at all; what is not is neither compiled nor stored."""

    rotation: bool = Field(True, description="balls may spin")
    friction: bool = Field(
        True, description="contacts carry tangential springs; without it no spring is stored and nothing spins"
    )
    damping: Literal["dashpot", "local", "background", "none"] = Field(
        "dashpot",
        description='"dashpot" (in the contacts), "local" (Cundall\'s; its tangents are meaningless), "background" '
        '(mass-proportional; adds strength that is not there) or "none"',
    )
    contact_law: Literal["linear", "hertz"] = Field(
        "linear", description='"linear" springs, or "hertz" for elastic spheres of one material (Hertz-Mindlin)'
    )
    membrane: MembraneKind = Field(
        "radial",
        description='force of the membrane: "radial", towards the axis, "normal" to its surface rho(z), so that it '
        'pushes a barrelling specimen along z as well, or "tied", normal with its ends tied to the platens',
    )

    def parts(self) -> tuple[type, ...]:
        """The classes whose parameters this scene has."""
        damping = DAMPINGS[self.damping]
        return (MATERIALS[self.contact_law], *(() if damping is None else (damping,)), Params)

    def takes(self) -> dict[str, Quantity]:
        """The parameters that do something in this scene, by name."""
        found = {name: about for part in self.parts() for name, about in declared(part).items()}
        if not self.friction:
            found.pop("friction")
        # What resists relative rotation.
        return found | (_optional(MATERIALS[self.contact_law]) if self.friction and self.rotation else {})

    def build(self) -> Scene:
        return Scene(rotation=self.rotation, membrane=self.membrane)


def described(name: str, about: Quantity) -> str:
    """The meaning of a field, and what it is where it is left out."""
    return about.description + (f"; {LEFT_OUT[name]}" if name in LEFT_OUT else "")


def bounds(about: Quantity) -> dict[str, float]:
    """What pydantic is to allow."""
    least = about.least if about.least > about.above else -np.inf
    rules = {"ge": least, "gt": about.above, "lt": about.below, "le": about.most}
    return {rule: bound for rule, bound in rules.items() if np.isfinite(bound)}


def _optional(material: type) -> dict[str, Quantity]:
    """The parameters of parts that are there only where one of their parameters is given."""
    return {name: about for part in optional_parts(material).values() for name, about in declared(part).items()}


def _parameters() -> dict[str, Any]:
    made: dict[str, Any] = {}
    for part in (Linear, Hertz, *(kind for kind in DAMPINGS.values() if kind is not None), Params):
        for name, about in declared(part).items():
            default = part.__dataclass_fields__[name].default  # type: ignore[attr-defined]
            if name in LEFT_OUT:
                default = None
            kind = float if default is not None else float | None
            told: Any = {"description": described(name, about), "allow_inf_nan": about.infinite, **bounds(about)}
            made[name] = kind, Field(default, **told)
    for name, about in _optional(Linear).items():
        told = {"description": f"{about.description}; left out with its like: no such resistance", **bounds(about)}
        made[name] = float | None, Field(None, **told)
    return made


if TYPE_CHECKING:  # mypy cannot see the fields of classes made while running

    class ParametersCase(Section):
        def __getattr__(self, name: str) -> Any: ...
else:
    ParametersCase = create_model("ParametersCase", __base__=Section, __doc__="Material and loading.", **_parameters())


def build_params(scene: SceneCase, parameters: ParametersCase) -> Params:
    """The parameters of a scene."""
    damping = DAMPINGS[scene.damping]
    material = MATERIALS[scene.contact_law](damping=None if damping is None else damping())
    values = {name: getattr(parameters, name) for name in scene.takes()}
    if not scene.friction:
        values["friction"] = None
    given = {name: value for name, value in values.items() if value is not None or name == "friction"}
    return Params(material, **given)


def check_used(scene: SceneCase, parameters: ParametersCase) -> None:
    """Warn of parameters that do nothing in this scene and only repeat their default; raise ValueError for others."""
    idle = [name for name in parameters.model_fields_set if name not in scene.takes()]
    for name in idle:
        value, default = getattr(parameters, name), ParametersCase.model_fields[name].default
        if value != default:
            raise ValueError(
                f"parameters.{name} = {value:g} would do nothing with {_scene_of(scene)}: leave it out, or change "
                "[scene]"
            )
    if idle:
        them, do, are = ("them", "do", "are") if len(idle) > 1 else ("it", "does", "is")
        warnings.warn(
            f"[parameters] {', '.join(sorted(idle))} {do} nothing with {_scene_of(scene)} and {are} left out: older "
            f"versions wrote what the scene has not; delete {them}.",
            stacklevel=2,
        )


def _scene_of(scene: SceneCase) -> str:
    off = "".join(f", {name} = false" for name in ("friction", "rotation") if not getattr(scene, name))
    return f"contact_law = '{scene.contact_law}', damping = '{scene.damping}'{off}"
