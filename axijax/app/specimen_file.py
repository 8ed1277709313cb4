"""A generated specimen on disk: written whole or not at all, and read back to the last bit.

A result keeps the random specimen that was tested: to generate it again is slow, and another machine may differ in the
last bit.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from axijax.app.case import Case
from axijax.core.files import write_whole
from axijax.core.npz import read_npz
from axijax.specimen.specimen import Specimen

NAME = "specimen.npz"
ARRAYS = ("positions", "radius", "membrane_zone", "bottom", "top", "name", "zone_rule")


def save_specimen(path: Path, specimen: Specimen, case: Case) -> None:
    """Write a specimen, with what the case says of it. Raises OSError where the folder cannot be written."""
    arrays: dict[str, Any] = {name: np.asarray(getattr(specimen, name)) for name in ARRAYS}

    def write(target: Path) -> None:
        with open(target, "wb") as file:
            np.savez(file, made_from=np.array(_made_from(case)), **arrays)

    write_whole(path, write)


def load_specimen(path: Path, case: Case) -> Specimen:
    """Read the specimen of a case. Raises ValueError where the file is missing, damaged, or of another specimen."""
    remedy = "run the case again"
    try:
        arrays = {name: array for name, array in read_npz(path).items() if name in (*ARRAYS, "made_from")}
        plain: dict[str, Any] = {name: array.item() if array.ndim == 0 else array for name, array in arrays.items()}
        made_from = plain.pop("made_from")
        specimen = Specimen(**plain)
    except FileNotFoundError:
        raise ValueError(
            f"result '{path.parent}' has lost its {path.name}, the balls that were tested: {remedy}."
        ) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"result '{path.parent}': its {path.name} is damaged or no specimen: {remedy}.") from None
    if made_from != _made_from(case):
        raise ValueError(
            f"result '{path.parent}': its case.toml says another [specimen] or [sector] than its {path.name} was made "
            "from; put that back, or run the changed case into another folder."
        )
    return specimen


def _made_from(case: Case) -> str:
    """What a case says of the specimen."""
    specimen = case.specimen.model_dump()
    if specimen.get("relative_density") is None:  # older results know no such field
        specimen.pop("relative_density", None)
    return json.dumps([specimen, case.sector.model_dump()])
