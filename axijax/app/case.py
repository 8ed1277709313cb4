"""Case files: a triaxial test as TOML, validated field by field; the same as a Python object.

    [specimen]
    kind = "octagon"          # or "fcc", "bcc", "hcp", "sc"
    radius = 20.0
    [sector]
    order = 4
    [parameters]
    friction = 0.12278
    [test]
    axial_strain = 0.01

    Case(parameters={"friction": 0.3}).build().run()

Everything left out takes the default, which is the paper's (Cui & O'Sullivan 2005). Units are any consistent set.
Names, defaults and descriptions of the fields are those of `Sector`, `TriaxialTest` and the parts of `Params`, so that
they exist once.
"""

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_type_hints

from pydantic import BaseModel, Field, ValidationError, create_model, model_serializer, model_validator

from axijax.app.case_parts import (
    LEFT_OUT,
    SLOW,
    ParametersCase,
    SceneCase,
    Section,
    bounds,
    build_params,
    check_used,
    described,
)
from axijax.app.case_reading import nearest, read_toml, sentence
from axijax.app.case_stages import StageCase
from axijax.core.quantity import settings
from axijax.core.sector import Sector
from axijax.mechanics.hertz import Hertz
from axijax.mechanics.params import Params
from axijax.specimen.specimen import Specimen, fcc_cylinder, fcc_octagon, lattice_cylinder
from axijax.triaxial.test import TriaxialTest

# Sizes of numbers other than zero in whatever units: products of them stay far from the limits of a float.
LEAST, MOST = 1e-30, 1e30

# Balls of the full cylinder that a case may ask for, fifty times as many as were tested. 34 000 in one sector take a
# minute and a half before their first step.
MOST_BALLS = 200_000

# Kinds of specimen whose balls a result keeps, since the case alone does not give them again to the last bit.
GIVEN = ("random", "file")

# The fields that a kind of specimen takes, and the orders of sector that fit it.
KINDS: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {
    "octagon": (("radius", "layers", "half_width"), (1, 2, 4)),
    "fcc": (("radius", "layers", "specimen_radius"), (1, 2, 4)),
    "bcc": (("radius", "layers", "specimen_radius"), (1, 2, 4)),
    "hcp": (("radius", "layers", "specimen_radius"), (1, 3)),
    "sc": (("radius", "layers", "specimen_radius"), (1, 2, 4)),
    "random": (
        (
            "balls", "smallest_radius", "largest_radius", "grading", "aspect_ratio", "compaction_friction",
            "void_ratio", "relative_density", "seed",
        ),
        (),  # made for the sector, whatever its order
    ),
    "file": (("path",), ()),  # what fits depends on the balls
}  # fmt: skip


def _section(name: str, source: type) -> Any:
    """A section with the settings that a dataclass declares: names, types, defaults, meanings and bounds."""
    hints = get_type_hints(source)
    made: dict[str, Any] = {}
    for each, about in settings(source).items():
        kind, default = hints[each], source.__dataclass_fields__[each].default  # type: ignore[attr-defined]
        told: dict[str, Any] = {"description": described(each, about)}
        if {int, float} & {kind, *get_args(kind)}:  # words and switches have no bounds
            told |= bounds(about)
        if each in LEFT_OUT:
            kind, default = kind | None, None
        made[each] = (kind, Field(default, **told))
    return create_model(name, __base__=Section, __doc__=inspect.getdoc(source), **made)


class SpecimenCase(Section):
    """The specimen, a full cylinder from which the sector is cut."""

    kind: Literal["octagon", "fcc", "bcc", "hcp", "sc", "random", "file"] = Field(
        "octagon",
        description="packing: FCC of octagonal section (the paper's), a circular cylinder of a lattice, random, or "
        "your own from a file",
    )
    radius: float = Field(20.0, gt=0, description="ball radius [L]")
    layers: int = Field(25, ge=1, le=10_000, description="number of horizontal layers [-]")
    half_width: int = Field(9, ge=3, le=1_001, description="half width of the octagon in ball radii, odd [-]")
    specimen_radius: float = Field(200.0, gt=0, description="radius of the cylinder that holds the balls [L]")

    balls: int = Field(
        400, ge=10, le=MOST_BALLS, description="balls in the full cylinder, a multiple of the sector's order [-]"
    )
    smallest_radius: float = Field(16.0, gt=0, description="smallest ball radius; radii are spread evenly [L]")
    largest_radius: float = Field(24.0, gt=0, description="largest ball radius [L]")
    grading: str | None = Field(
        None,
        description="CSV file of a sieve curve in place of these two radii: under a header line, sieve opening (ball "
        "diameter) [L] and per cent passing by mass, from 0 to 100",
    )
    aspect_ratio: float = Field(2.0, gt=0, description="height over diameter, met to some 10 % [-]")
    compaction_friction: float = Field(
        0.05,
        ge=0,
        le=1,
        description="friction while it is compacted: 0.05 dense, 0.5 loose [-]",
    )
    void_ratio: float | None = Field(
        None,
        gt=0,
        description="void ratio sought in place of compaction_friction, to 0.005, in up to twelve compactions; the one "
        "that a test's records begin with, counted below the skin [-]",
    )
    relative_density: float | None = Field(
        None,
        ge=0,
        le=1,
        description="sought in place of compaction_friction, between the loosest (0) and the densest (1) packing of "
        "this grading and size at this confining stress, which are found once and kept [-]",
    )
    seed: int = Field(0, ge=0, lt=2**63, description="of the random numbers [-]")
    path: str = Field(
        "balls.csv",
        description="file of balls, with columns x, y, z and radius (CSV, or NetCDF with such variables) [L]; the "
        "cylinder's axis is x = y = 0",
    )

    @model_validator(mode="after")
    def _takes(self) -> "SpecimenCase":
        taken = KINDS[self.kind][0]
        for name in self.model_fields_set - {"kind", *taken}:
            raise ValueError(f"{name} does not belong to kind = '{self.kind}', which takes {', '.join(taken)}")
        if self.void_ratio is not None and self.relative_density is not None:
            raise ValueError(
                f"void_ratio = {self.void_ratio:g}, relative_density = {self.relative_density:g}: give one of them only"
            )
        return self

    @model_validator(mode="after")
    def _of_so_many_balls(self) -> "SpecimenCase":
        if self.kind == "octagon":
            across, fields = 0.83 * self.half_width**2, "half_width"
        else:
            ratio = self.specimen_radius / self.radius  # a power would raise OverflowError where a product is infinite
            across, fields = 0.91 * ratio * ratio, "specimen_radius, or a larger radius"
        if self.kind not in GIVEN and across * self.layers > MOST_BALLS:
            raise ValueError(
                f"kind = '{self.kind}' of {self.layers} layers would hold some {across * self.layers:.2g} balls: at "
                f"most {MOST_BALLS:,} are allowed; take fewer layers or a smaller {fields}"
            )
        return self

    @model_serializer(mode="wrap")
    def _taken(self, dump) -> dict[str, Any]:
        return {name: value for name, value in dump(self).items() if name in ("kind", *KINDS[self.kind][0])}

    def build(self) -> Specimen:
        """A lattice's specimen, or that of a file."""
        options = {name: getattr(self, name) for name in KINDS[self.kind][0]}
        if self.kind == "octagon":
            return fcc_octagon(**options)
        if self.kind == "fcc":
            return fcc_cylinder(**options)
        if self.kind == "file":
            from axijax.triaxial.own_packing import packing

            return packing(self.path)
        return lattice_cylinder(self.kind, **options)


if TYPE_CHECKING:
    from axijax.triaxial.packing_report import PackingReport

if TYPE_CHECKING:  # mypy cannot see the fields of classes made while running

    class _Made(Section):
        def __getattr__(self, name: str) -> Any: ...

    class SectorCase(_Made): ...

    class TestSection(_Made): ...
else:
    SectorCase = _section("SectorCase", Sector)
    TestSection = _section("TestSection", TriaxialTest)


class Case(Section):
    """A whole case. `build` makes the test; raises ValueError where the fields do not fit one another."""

    specimen: SpecimenCase = SpecimenCase()
    sector: SectorCase = SectorCase()
    scene: SceneCase = SceneCase()
    parameters: ParametersCase = ParametersCase()
    test: TestSection = TestSection()
    stage: tuple[StageCase, ...] = Field((), strict=False)

    @model_validator(mode="after")
    def _used(self) -> "Case":
        check_used(self.scene, self.parameters)
        if self.specimen.kind != "random" and self.parameters.platen_speed is None:
            self.parameters = self.parameters.model_copy(update={"platen_speed": float(Params().platen_speed)})
        if self.stage and "axial_strain" in self.test.model_fields_set:
            raise ValueError(
                "test.axial_strain would do nothing beside [[stage]]: leave it out, and give the stages where they end"
            )
        return self

    @model_serializer(mode="wrap")
    def _of_its_scene(self, dump) -> dict[str, Any]:
        sections = dump(self)
        taken = self.scene.takes()
        sections["parameters"] = {name: value for name, value in sections["parameters"].items() if name in taken}
        stages = [each.model_dump(exclude_unset=True, exclude_none=True) for each in self.stage]
        if stages:
            sections["stage"] = stages
            sections["test"].pop("axial_strain")
        else:
            sections.pop("stage")
        return sections

    def sections(self) -> dict[str, dict[str, Any]]:
        """The fields of all sections, "stage 1" and so on among them, by name."""
        sections = self.model_dump()
        stages = {f"stage {number}": given for number, given in enumerate(sections.pop("stage", ()), 1)}
        return sections | stages

    def build(self, specimen: Specimen | None = None) -> TriaxialTest:
        """The test. specimen: one that was made before, by `made`, and the case that `made` returned with it."""
        if specimen is None:
            case, specimen, _ = self.made()
            return case.build(specimen)
        if self.parameters.platen_speed is None:
            return self._slow(specimen).build(specimen)
        options = self.test.model_dump()
        options["confining_friction"] = options["confining_friction"] or 0.0
        return TriaxialTest(
            specimen,
            Sector(**self.sector.model_dump()),
            scene=self.scene.build(),
            params=build_params(self.scene, self.parameters),
            stages=tuple(each.build() for each in self.stage),
            **options,
        )

    def made(self, packing: Callable[[str], None] | bool = False) -> "tuple[Case, Specimen, PackingReport | None]":
        """The case with what it leaves to its specimen filled in, the specimen, and what a random one has become.

        packing: of `random_cylinder`, as its progress.

        Raises ValueError where the fields do not fit one another; RuntimeError where a random one does not settle.
        """
        for section, values in self:
            for name, value in () if section == "stage" else values:
                if isinstance(value, float) and value != 0 and math.isfinite(value) and not LEAST <= abs(value) <= MOST:
                    raise ValueError(f"{section}.{name} = {value:g}: must lie between {LEAST:g} and {MOST:g} in size.")
        friction = self.test.confining_friction
        if self.specimen.kind != "random":
            if self.specimen.kind == "file" and friction is None:
                own = self.parameters.friction if self.scene.friction else 0.0
                return self.with_test(confining_friction=own), self.specimen.build(), None
            return self, self.specimen.build(), None
        stiffness = {"normal_stiffness", "shear_stiffness", "shear_modulus", "poisson_ratio"}
        wanted = {*stiffness, "confining_stress", "density", "damping_ratio"}
        material = self.parameters.model_dump(include=wanted & set(self.scene.takes()))
        made_of = self.specimen.model_dump_json(), self.sector.model_dump_json(), tuple(material.items())
        specimen, report = _packed(*made_of, packing)
        case = self.with_test(confining_friction=report.compaction_friction if friction is None else friction)
        return case._slow(specimen), specimen, report

    def _slow(self, specimen: Specimen) -> "Case":
        """The same case with the speed that it leaves to a random specimen."""
        if self.parameters.platen_speed is not None:
            return self
        from axijax.triaxial.random_specimen import platen_speed

        speed = platen_speed(SLOW, specimen, build_params(self.scene, self.parameters))
        changed = {"platen_speed": float(f"{speed:.4g}")}
        return self.model_copy(update={"parameters": self.parameters.model_copy(update=changed)})

    def with_test(self, **changes) -> "Case":
        """The same case with other fields in its section [test]."""
        return self.model_copy(update={"test": self.test.model_copy(update=changes)})


# A sweep's members share a specimen.
_PACKED: "dict[tuple, tuple[Specimen, PackingReport]]" = {}
MOST_PACKED = 8


def _packed(
    specimen: str, sector: str, material: tuple[tuple[str, Any], ...], packing: Callable[[str], None] | bool = False
) -> "tuple[Specimen, PackingReport]":
    """A random specimen, from sections in JSON, made once. packing: is told what goes on."""
    made_of = specimen, sector, material
    if made_of not in _PACKED:
        made = _pack(specimen, sector, material, packing)
        while len(_PACKED) >= MOST_PACKED:
            _PACKED.pop(next(iter(_PACKED)))
        _PACKED[made_of] = made
    return _PACKED[made_of]


def _pack(
    specimen: str, sector: str, material: tuple[tuple[str, Any], ...], packing: Callable[[str], None] | bool
) -> "tuple[Specimen, PackingReport]":
    """A random specimen, from sections in JSON."""
    from axijax.specimen.grading import linear, sieve_curve
    from axijax.triaxial.random_specimen import random_cylinder

    options = SpecimenCase.model_validate_json(specimen).model_dump(exclude={"kind"})
    smallest, largest, path = (options.pop(name) for name in ("smallest_radius", "largest_radius", "grading"))
    if path is None and smallest > largest:
        raise ValueError(
            f"specimen.smallest_radius = {smallest:g}, largest_radius = {largest:g}: the smallest must "
            "not be above the largest."
        )
    grading = linear(smallest, largest) if path is None else sieve_curve(path)
    ours = Sector(**SectorCase.model_validate_json(sector).model_dump())
    params = Params(Hertz() if "shear_modulus" in dict(material) else None, **dict(material))
    try:
        return random_cylinder(sector=ours, grading=grading, params=params, progress=packing, **options)
    except RuntimeError as error:
        told = str(error).rpartition(": ")[0]  # its own remedy is for callers of the function
        raise RuntimeError(
            f"{told}: take another specimen.seed, more balls, or a higher compaction_friction."
        ) from None


# The sections of a case: class and heading.
SECTIONS: dict[str, tuple[type[BaseModel], str]] = {
    "specimen": (SpecimenCase, "The specimen: a full cylinder, from which the sector is cut."),
    "sector": (SectorCase, "The sector that is simulated."),
    "scene": (SceneCase, "What is modelled at all."),
    "parameters": (ParametersCase, "Material and loading; compression is positive."),
    "test": (TestSection, "The test and its numerics."),
}


def default_case(kind: str = "octagon") -> Case:
    """The case in which everything but the kind of specimen is left out, with the largest order of sector that fits.

    Raises ValueError for an unknown kind.
    """
    if kind not in KINDS:
        near = nearest(kind, KINDS)
        raise ValueError(f"kind = '{kind}': must be one of {', '.join(KINDS)}{f'; {near}' if near else '.'}")
    sections: dict[str, Any] = {"specimen": {"kind": kind}}
    if kind in GIVEN:
        # So few balls find no room in the tip of a quarter; a soil's friction; a balance that such a packing can reach.
        sections["sector"], sections["parameters"] = {"order": 2 if kind == "random" else 1}, {"friction": 0.4}
        sections["test"] = {"tolerance": 1e-3, "confine_steps": 100_000, "axial_strain": 0.05}
    elif 4 not in KINDS[kind][1]:
        sections["sector"] = {"order": max(KINDS[kind][1])}
    return Case(**sections)


def load_case(path: Path | str) -> Case:
    """Read a case file. Raises ValueError, naming file, field, value and what is allowed."""
    return make_case(read_toml(path), str(path))


def make_case(data: dict, source: str) -> Case:
    """A case from what a file called `source` holds. Raises ValueError like `load_case`."""
    for name in ("grading", "path"):  # files that lie beside the case file
        specimen = data.get("specimen")
        if isinstance(specimen, dict) and isinstance(specimen.get(name), str):
            data = data | {"specimen": specimen | {name: str(Path(source).absolute().parent / specimen[name])}}
            if "\0" in specimen[name]:
                raise ValueError(f"case file '{source}': specimen.{name} holds a zero byte: it must name a file.")
    known = {name: model for name, (model, _) in SECTIONS.items()} | {"stage": StageCase}
    try:
        return Case.model_validate(data)
    except ValidationError as error:
        told = "; ".join(sentence(problem, known) for problem in error.errors())
        raise ValueError(f"case file '{source}': {told}{'' if told.endswith('?') else '.'}") from None
