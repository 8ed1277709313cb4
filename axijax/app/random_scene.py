"""A case with a random specimen as a scene that `calibrate` fits: any number of packings, each run as `run` runs it."""

from dataclasses import dataclass

from axijax.app.case import Case
from axijax.core.fingerprint import fingerprint
from axijax.core.quantity import values_of
from axijax.mechanics.params import Params
from axijax.triaxial.test import TriaxialTest
from calibrate.scene import RandomScene


@dataclass(frozen=True)
class CaseMaker:
    """Makes the test of a case, given as JSON, with another packing and other parameters."""

    case: str

    def __call__(self, seed: int, params: Params) -> TriaxialTest:
        case = Case.model_validate_json(self.case)
        values = {name: float(value) for name, value in values_of(params).items()}
        if case.parameters.platen_speed is None:  # that of each specimen, as `run` takes it
            values.pop("platen_speed", None)
        parameters = case.parameters.model_validate(values)
        specimen = case.specimen.model_copy(update={"seed": seed})
        return case.model_copy(update={"specimen": specimen, "parameters": parameters}).build()


def random_scene(case: Case) -> RandomScene:
    """The scene of a case with a random specimen; the same scene whatever its seed, parameters and axial strain.

    Raises ValueError for a case with another specimen.
    """
    if case.specimen.kind != "random":
        raise ValueError(
            f"specimen.kind = '{case.specimen.kind}': fits on many packings are for random specimens; a lattice is "
            "fitted by derivatives, with its case file behind --case."
        )
    sections = case.model_dump()
    if case.parameters.platen_speed is None:  # one number for all is another scene
        sections["rate"] = "of each specimen"
    del sections["parameters"], sections["specimen"]["seed"], sections["test"]["axial_strain"]
    if case.specimen.grading is not None:  # the numbers, not the place of the file
        from axijax.specimen.grading import sieve_curve

        sections["specimen"]["grading"] = fingerprint(sieve_curve(case.specimen.grading))
    identity = fingerprint(sections, "case")
    case = case.model_copy(update={"specimen": case.specimen.model_copy(update={"seed": 0})})
    return RandomScene(CaseMaker(case.model_dump_json()), _params(case), identity, _least(case))


def _params(case: Case) -> Params:
    from axijax.app.case_parts import build_params

    return build_params(case.scene, case.parameters)


def _least(case: Case) -> dict[str, float]:
    """Friction below that of compaction would let the specimen slip as soon as it is sheared."""
    confining = case.test.confining_friction
    if confining is None:
        confining = case.specimen.compaction_friction if case.specimen.void_ratio is None else 0.0
    return {"friction": confining} if case.scene.friction else {}
