"""The folder of a fit: nothing in it is replaced that no fit, or another fit, wrote."""

import json
from collections.abc import Mapping
from pathlib import Path

from axijax.core.fingerprint import differences

FILE = "fit.json"


def claim(folder: Path, identity: Mapping[str, str] | None = None) -> bool:
    """Make sure that a fit may write its files into a folder; whether it has been there before.

    identity: of the fit; None where its log says whose the folder is. Raises ValueError where `fit.json` there is no
    fit's, or another's, with what differs.
    """
    path = folder / FILE
    try:
        held = json.loads(path.read_text())
    except FileNotFoundError:
        return False
    except (OSError, ValueError):
        held = None
    if not isinstance(held, dict) or not {"status", "estimate"} <= set(held):
        raise ValueError(f"'{path}' is no file of a fit and would be replaced: choose another --output, or move it.")
    before = held.get("identity")
    if (identity is None) != (before is None):
        raise ValueError(f"'{path}' is of another kind of fit: choose another --output, or delete it.")
    if identity is not None:
        other = differences(identity, before)
        if other:
            raise ValueError(
                f"'{path}' is of another fit, which differs in {other}: choose another --output, or delete it."
            )
    return True
