"""Study files: several tests of one sand as TOML, for `axijax calibrate study.toml`.

    case = "sand.toml"                    # a case with a random specimen, beside this file
    fit = ["friction", "kn", "eta_r"]
    [bounds]
    friction = [0.2, 0.9]
    [[test]]
    name = "100 kPa"
    data = "sand_100kPa.csv"
    confining_stress = 1.0e5              # in the case's units
    void_ratio = 0.58
    packings = "laboratory"
    [[test]]
    name = "200 kPa"
    data = "sand_200kPa.csv"
    confining_stress = 2.0e5
    void_ratio = 0.58
    packings = "laboratory"
    held_out = true                       # predicted, never fitted
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from axijax.app.case import Case, load_case
from axijax.app.case_parts import Section
from axijax.app.case_reading import read_toml, sentence
from axijax.app.random_scene import random_scene
from calibrate.measured import DataError, MeasuredCurve, read_measured
from calibrate.parameters import Prior
from calibrate.study import LABORATORY, StudyTest

Packings = float | int | Literal["laboratory"]


class TestEntry(Section):
    """One test of a study file."""

    __test__ = False  # no test of pytest's

    data: str = Field(description="file of the measured curve, beside the study file")
    name: str | None = Field(None, description="left out: the file's name")
    confining_stress: float | None = Field(None, gt=0, description="of the test, in the case's units")
    void_ratio: float | None = Field(
        None, gt=0, description="at the beginning of the shear; left out: not known, or what the file says [-]"
    )
    packings: Packings = Field(
        1, description='packings that the curve is the mean of: 1 for one simulated specimen, or "laboratory"'
    )
    held_out: bool = Field(False, description="predicted, never fitted")
    weight: float = Field(1.0, gt=0, description="on the logarithm of its likelihood [-]")
    first_strain: float = Field(0.0, ge=0, lt=0.5, description="where the data begin to count: bedding is no sand [-]")
    last_strain: float | None = Field(None, gt=0, lt=0.5, description="where the data are cut off [-]")
    specimen: dict[str, Any] = Field({}, description="fields of the case's [specimen] that are others for this test")
    columns: dict[str, str] = Field({}, description="what the header does not say: quantity = 'name [unit]'")
    which: str | None = Field(None, description="the test's name, where the file holds several")
    height: str | None = Field(None, description="of the specimen, for strains in mm: '100 mm'")
    uncertainty: dict[Literal["stress_ratio", "volumetric_strain"], float] = Field(
        {}, description="standard uncertainty of the points; left out: their own scatter"
    )

    @model_validator(mode="after")
    def _sensible(self) -> "TestEntry":
        if not isinstance(self.packings, str) and self.packings < 1:
            raise ValueError(f'packings = {self.packings:g}: must be 1 or more, or "laboratory"')
        return self


class StudyFile(Section):
    """A study file."""

    case: str = Field(description="case file with a random specimen, beside the study file")
    fit: list[str] = Field(description="parameters to fit")
    own: list[str] = Field([], description="those of them that each test has for itself")
    runs: int = Field(40, ge=0, description="most runs of one packing for the first fit of the scene")
    further: int = Field(10, ge=0, description="most runs where the library holds a first fit's already")
    precision: float | None = Field(None, gt=0, description="standard deviation of the log of each that is enough")
    seed: int = Field(0, ge=0, description="of design and samples")
    bounds: dict[str, tuple[float, float]] = Field({}, description="between which each is sought")
    priors: dict[str, tuple[float, float]] = Field({}, description="value and spread of its log, known beforehand")
    test: list[TestEntry]

    @model_validator(mode="before")
    @classmethod
    def _pairs(cls, given: Any) -> Any:
        """TOML has lists where pairs are wanted."""
        if not isinstance(given, dict):
            return given
        for table in ("bounds", "priors"):
            held = given.get(table)
            if isinstance(held, dict):
                pairs = {n: tuple(map(_number, v)) if isinstance(v, list) else v for n, v in held.items()}
                given = given | {table: pairs}
        return given


def _number(value: Any) -> Any:
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


@dataclass(frozen=True)
class Study:
    """What a study file asks: the arguments of `calibrate.fit_study`."""

    tests: list[StudyTest]
    names: list[str]
    options: dict[str, Any]


def load_study(path: Path | str) -> Study:
    """Read a study file, its case and its data. Raises ValueError, naming file, field, value and what is allowed, and
    DataError for data that cannot be used; nothing is packed before."""
    home = Path(path).absolute().parent
    try:
        asked = StudyFile.model_validate(read_toml(path))
    except ValidationError as error:
        known = {"test": TestEntry}
        told = "; ".join(_told(problem, known) for problem in error.errors())
        raise ValueError(f"study file '{path}': {told}.") from None
    case = load_case(home / asked.case)
    tests = [_test(entry, case, home) for entry in asked.test]
    priors = {name: Prior(*pair) for name, pair in asked.priors.items()}
    options = {name: getattr(asked, name) for name in ("own", "runs", "further", "precision", "seed", "bounds")}
    return Study(tests, asked.fit, options | {"priors": priors})


def _told(problem, known) -> str:
    where = ".".join(str(part + 1 if isinstance(part, int) else part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        fields = TestEntry.model_fields if problem["loc"][0] == "test" and len(problem["loc"]) > 1 else (
            StudyFile.model_fields
        )  # fmt: skip
        return f"'{where}' is no field of a study; there are {', '.join(fields)}"
    if problem["type"] == "missing":
        return f"'{where}' is missing"
    return sentence(problem, known)


def _test(entry: TestEntry, case: Case, home: Path) -> StudyTest:
    sizes: dict[str, Any] = {
        {"stress_ratio": "ratio_sigma", "volumetric_strain": "volume_sigma"}[name]: value
        for name, value in entry.uncertainty.items()
    }
    if sizes:
        sizes["sigma_known"] = True
    curve = read_measured(home / entry.data, entry.columns, test=entry.which, height=entry.height, **sizes)
    name = entry.name or Path(entry.data).stem
    curve = cut(curve, entry.first_strain, entry.last_strain or curve.last_strain, name)
    if entry.specimen:
        sections = case.model_dump()
        held = sections["specimen"]
        if entry.specimen.get("grading") is not None:
            entry.specimen["grading"] = str(home / str(entry.specimen["grading"]))
        try:
            case = Case.model_validate(sections | {"specimen": held | entry.specimen})
        except ValidationError as error:
            told = "; ".join(sentence(problem, {"specimen": type(case.specimen)}) for problem in error.errors())
            raise ValueError(f"specimen of test '{name}': {told}.") from None
    void_ratio = entry.void_ratio if entry.void_ratio is not None else curve.facts.void_ratio
    packings = LABORATORY if entry.packings == "laboratory" else float(entry.packings)
    return StudyTest(
        name, curve, random_scene(case), entry.confining_stress, packings, void_ratio, entry.held_out, entry.weight
    )


def cut(curve: MeasuredCurve, first_strain: float, last_strain: float, name: str) -> MeasuredCurve:
    """The data between two strains. Raises DataError where too few are left."""
    kept = (curve.axial_strain >= first_strain) & (curve.axial_strain <= last_strain)
    if kept.all():
        return curve
    if kept.sum() < 5:
        raise DataError(
            f"first_strain = {first_strain:g}, last_strain = {last_strain:g} of test '{name}': leave {kept.sum()} "
            "points of 5 needed."
        )
    changes: dict[str, Any] = {"axial_strain": curve.axial_strain[kept], "stress_ratio": curve.stress_ratio[kept]}
    if curve.volumetric_strain is not None:
        changes["volumetric_strain"] = curve.volumetric_strain[kept]
    for field in ("ratio_sigma", "volume_sigma"):
        if np.ndim(getattr(curve, field)):
            changes[field] = np.asarray(getattr(curve, field))[kept]
    return replace(curve, **changes)
