"""A shear in progress on disk: written whole or not at all, and read back to the last bit.

    run = test.run(checkpoint=Path("shear.npz"))                            # interrupted, or stopped at a small strain
    longer = dataclasses.replace(test, axial_strain=0.05)
    run = longer.run(start=load_progress(Path("shear.npz"), longer))        # the same curve as without a stop

The file is a NumPy .npz archive of every array under its name in `triaxial.Progress`, with a header in JSON: format and
program versions, and what the test was. A checkpoint fits one test only, up to the axial strain where it stops.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.core.files import write_whole
from axijax.core.fingerprint import differences, fingerprint, versions
from axijax.core.npz import read_npz
from axijax.core.quantity import parts_of
from axijax.mechanics.dynamics import initial_state
from axijax.mechanics.membrane import Load
from axijax.mechanics.params import check_params
from axijax.triaxial.checkpoint_arrays import what_is_wrong
from axijax.triaxial.progress import Progress
from axijax.triaxial.records import Confinement, no_records

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest

FORMAT = "axijax shear in progress"
VERSION = 4


def save_progress(path: Path, test: "TriaxialTest", progress: Progress) -> None:
    """Write a checkpoint, whole or not at all. Raises OSError where the folder cannot be written."""
    leaves = dict(_named(progress))
    header = {
        "format": FORMAT,
        "version": VERSION,
        **versions(),
        "test": _description(test),
        # Python numbers promote differently from arrays, so they come back as what they were.
        "numbers": [name for name, leaf in leaves.items() if isinstance(leaf, int | float)],
    }
    arrays: dict[str, Any] = {name: np.asarray(leaf) for name, leaf in leaves.items()}

    def write(target: Path) -> None:
        with open(target, "wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)

    write_whole(Path(path), write)


def load_progress(path: Path, test: "TriaxialTest") -> Progress:
    """Read a checkpoint for a test; what goes on from it is the same to the last bit.

    Raises ValueError, saying what is the matter, where the file is missing, damaged, something else, of another
    version, or of another test. A file written under another version of jax is accepted: its numbers are right, but the
    last bits of what follows are not those of an uninterrupted run.
    """
    path = Path(path)
    try:
        arrays = read_npz(path)
        header = json.loads(str(arrays.pop("header")[()]))
        known = header["format"] == FORMAT
    except OSError as error:
        raise ValueError(f"checkpoint '{path}' cannot be read ({error.strerror}).") from None
    except (ValueError, KeyError, TypeError, IndexError, RecursionError):
        known = False
    if not known:
        raise ValueError(f"checkpoint '{path}' is damaged or no checkpoint of axijax: start again without it.")
    if header.get("version") != VERSION:
        raise ValueError(
            f"checkpoint '{path}' has format version {str(header.get('version'))[:20]}, this program reads {VERSION}: "
            "start again without it."
        )
    other = differences(_description(test), header.get("test"))
    if other:
        raise ValueError(
            f"checkpoint '{path}' is of another test: it differs in {other}; use the test that wrote it (only "
            "axial_strain may change)."
        )
    numbers = header.get("numbers")
    template = _template(test, fixed="fixed.lateral" in arrays)
    own = dict(_named(template))
    wrong = "".join(f"'{name[:60]}' is missing or unknown" for name in sorted(set(own) ^ set(arrays))[:1])
    wrong = wrong or what_is_wrong(arrays, own, numbers, len(test.cut), test.record_every)
    if wrong:
        raise ValueError(f"checkpoint '{path}' is damaged: {wrong}; start again without it.")

    def restored(name):
        array = arrays[name]
        if name in numbers:
            return array.item()
        return array if name.startswith("records.") else jnp.asarray(array)

    progress = jax.tree.unflatten(jax.tree.structure(template), [restored(name) for name in own])
    try:
        check_params(progress.params, len(test.cut))
    except ValueError as error:
        raise ValueError(f"checkpoint '{path}' is damaged: {str(error).rstrip('.')}; start again without it.") from None
    return progress


def _named(tree) -> list[tuple[str, object]]:
    """The leaves of a tree under names like 'network.branch.x', in its order."""
    return [(jax.tree_util.keystr(path).lstrip("."), leaf) for path, leaf in jax.tree.leaves_with_path(tree)]


def _template(test: "TriaxialTest", fixed: bool) -> Progress:
    """A tree of the shape that a progress of this test has."""
    zero = jnp.zeros(())
    return Progress(
        params=test.params,
        network=test.network,
        membrane=test.membrane,
        state=initial_state(test.scene, test.params, test.network, jnp.zeros(2)),
        fixed=Load(zero, zero) if fixed else None,
        confinement=Confinement(zero, zero, zero),
        height=0.0,
        records=no_records(),
    )


def _description(test: "TriaxialTest") -> dict[str, str]:
    """All that decides how a shear goes on, but for where it stops and the parameters, which the progress holds."""
    parts = fingerprint(test)
    held = {name: part for name, part in parts.items() if name.split(".")[0] not in ("axial_strain", "params")}
    return held | {"params": ", ".join(type(part).__name__ for part in parts_of(test.params))}
