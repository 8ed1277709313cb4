"""Case files: a triaxial test as TOML, validated field by field.

    [specimen]
    kind = "fcc octagon"      # or "fcc cylinder"
    radius = 20.0
    [sector]
    order = 4
    [parameters]
    friction = 0.12278
    [test]
    axial_strain = 0.01

Everything left out takes the default, which is the paper's (Cui & O'Sullivan 2005). Units are any consistent set.
"""

import difflib
import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from axijax.dynamics import Params, Scene
from axijax.packing import Specimen, fcc_cylinder, fcc_octagon
from axijax.sector import Sector
from axijax.triaxial import TriaxialTest


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class SpecimenCase(_Section):
    """The specimen, a full cylinder from which the sector is cut."""

    kind: Literal["fcc octagon", "fcc cylinder"] = Field("fcc octagon", description="how the balls are packed")
    radius: float = Field(20.0, gt=0, description="ball radius [L]")
    layers: int = Field(25, ge=1, description="number of [001] layers")
    half_width: int = Field(9, ge=3, description="octagon: half width in ball radii, odd")
    specimen_radius: float = Field(200.0, gt=0, description="cylinder: radius of the specimen [L]")

    def build(self) -> Specimen:
        if self.kind == "fcc octagon":
            return fcc_octagon(self.radius, self.layers, self.half_width)
        return fcc_cylinder(self.radius, self.layers, self.specimen_radius)


class SectorCase(_Section):
    """The sector that is simulated."""

    order: int = Field(4, ge=1, description="number n of sectors in the cylinder, 1 for the full one")
    boundary: Literal["periodic", "rigid"] = Field("periodic", description="sector planes")


class SceneCase(_Section):
    """What is modelled at all."""

    rotation: bool = Field(True, description="balls may spin")
    friction: bool = Field(True, description="contacts have friction")
    damping: Literal["dashpot", "local", "background", "none"] = Field("dashpot", description="damping during shear")


class ParametersCase(_Section):
    """Material and loading."""

    friction: float = Field(0.12278, ge=0, description="Coulomb coefficient between balls [-]")
    normal_stiffness: float = Field(1.5e9, gt=0, description="of a contact [F/L]")
    shear_stiffness: float = Field(1.5e9, gt=0, description="of a contact [F/L]")
    confining_stress: float = Field(5.0e4, gt=0, description="s3, compression positive [F/L^2]")
    platen_speed: float = Field(0.01, gt=0, description="speed of each platen, inward positive [L/T]")
    density: float = Field(2000.0, gt=0, description="of the balls [M/L^3]")
    damping_ratio: float = Field(0.05, ge=0, description="of the contact dashpots [-]")
    local_damping: float = Field(0.7, ge=0, lt=1, description="Cundall's coefficient, with damping = 'local' [-]")
    background_damping: float = Field(0.5, ge=0, description="rate, with damping = 'background' [1/T]")


class TestCase(_Section):
    """The test and its numerics."""

    __test__ = False  # pytest: not a test
    axial_strain: float = Field(0.01, gt=0, lt=0.5, description="where the test stops [-]")
    time_step: float | None = Field(None, gt=0, description="[T]; left out: 0.6 of the critical one")
    record_every: int = Field(50, ge=1, description="steps between records")
    refresh: bool = Field(True, description="find the membrane's cells again with every record")
    tolerance: float = Field(1e-7, gt=0, description="unbalanced force and stress error that end confinement [-]")


class Case(_Section):
    """A whole case. `build` makes the test; raises ValueError where the fields do not fit one another."""

    specimen: SpecimenCase = SpecimenCase()
    sector: SectorCase = SectorCase()
    scene: SceneCase = SceneCase()
    parameters: ParametersCase = ParametersCase()
    test: TestCase = TestCase()

    def build(self) -> TriaxialTest:
        return TriaxialTest(
            self.specimen.build(),
            Sector(**self.sector.model_dump()),
            scene=Scene(**self.scene.model_dump()),
            params=Params(**self.parameters.model_dump()),
            **self.test.model_dump(),
        )


# The fields of every section, by name.
SECTIONS = {
    "specimen": SpecimenCase.model_fields,
    "sector": SectorCase.model_fields,
    "scene": SceneCase.model_fields,
    "parameters": ParametersCase.model_fields,
    "test": TestCase.model_fields,
}


def load_case(path: Path | str) -> Case:
    """Read a case file. Raises ValueError, naming file, field, value and what is allowed."""
    return make_case(read_toml(path), str(path))


def read_toml(path: Path | str) -> dict:
    """What a TOML file holds. Raises ValueError where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ValueError(f"case file '{path}' cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"case file '{path}' is not valid TOML: {error}.") from None


def make_case(data: dict, source: str) -> Case:
    """A case from what a file called `source` holds. Raises ValueError like `load_case`."""
    try:
        return Case.model_validate(_whole_numbers_as_floats(data))
    except ValidationError as error:
        raise ValueError(f"case file '{source}': {_sentence(error)}") from None


def _whole_numbers_as_floats(data: dict) -> dict:
    """Let 20 stand for 20.0 where a field is a float; everything else stays as strict as it is."""
    for section, fields in SECTIONS.items():
        values = data.get(section)
        if not isinstance(values, dict):
            continue
        for name, value in values.items():
            wants_float = name in fields and fields[name].annotation in (float, float | None)
            if wants_float and isinstance(value, int) and not isinstance(value, bool):
                values[name] = float(value)
    return data


def _sentence(error: ValidationError) -> str:
    problem = error.errors()[0]
    where = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        *section, name = problem["loc"]
        known = list(SECTIONS[str(section[0])] if section else SECTIONS)
        near = difflib.get_close_matches(str(name), known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}."
        return f"'{where}' is not a field; {hint}"
    return f"{where} = {problem['input']!r}: {problem['msg'][0].lower()}{problem['msg'][1:]}."
