"""A shear in progress on disk: written whole or not at all, and read back to the last bit.

    run = test.run(checkpoint=Path("shear.npz"))                            # interrupted, or stopped at a small strain
    longer = dataclasses.replace(test, axial_strain=0.05)
    run = longer.run(start=load_progress(Path("shear.npz"), longer))        # the same curve as without a stop

The file is a NumPy .npz archive of every array under its name in `triaxial.Progress`, with a header in JSON: format and
program versions, and what the test was. A checkpoint fits one test only, up to the axial strain where it stops.
"""

import hashlib
import json
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from axijax.confinement import Confinement
from axijax.curve import no_records
from axijax.dynamics import initial_state
from axijax.membrane import Load
from axijax.results import write_whole
from axijax.triaxial import Progress, TriaxialTest

FORMAT = "axijax shear in progress"
VERSION = 3


def save_progress(path: Path, test: TriaxialTest, progress: Progress) -> None:
    """Write a checkpoint, whole or not at all. Raises OSError where the folder cannot be written."""
    leaves = dict(_named(progress))
    header = {
        "format": FORMAT,
        "version": VERSION,
        "axijax": _version("axijax"),
        "jax": jax.__version__,
        "test": _description(test),
        # Python numbers promote differently from arrays, so they come back as what they were.
        "numbers": [name for name, leaf in leaves.items() if isinstance(leaf, int | float)],
    }
    arrays: dict[str, Any] = {name: np.asarray(leaf) for name, leaf in leaves.items()}

    def write(target: Path) -> None:
        with open(target, "wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)

    write_whole(Path(path), write)


def load_progress(path: Path, test: TriaxialTest) -> Progress:
    """Read a checkpoint for a test; what goes on from it is the same to the last bit.

    Raises ValueError, saying what is the matter, where the file is missing, damaged, something else, of another
    version, or of another test. A file written under another version of jax is accepted: its numbers are right, but the
    last bits of what follows are not those of an uninterrupted run.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}  # the archive checks a checksum of each
        header = json.loads(str(arrays.pop("header")[()]))
        known = header["format"] == FORMAT
    except OSError as error:
        if isinstance(error, FileNotFoundError | PermissionError | IsADirectoryError):
            raise ValueError(f"checkpoint '{path}' cannot be read ({error.strerror}).") from None
        known = False
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError):
        known = False
    if not known:
        raise ValueError(f"checkpoint '{path}' is damaged or no checkpoint of axijax: start again without it.")
    if header.get("version") != VERSION:
        raise ValueError(
            f"checkpoint '{path}' has format version {header.get('version')}, this program reads {VERSION}: start "
            "again without it."
        )
    ours, theirs = _description(test), header.get("test", {})
    other = [name for name in ours if ours[name] != theirs.get(name)]
    if other:
        raise ValueError(
            f"checkpoint '{path}' is of another test: its {' and '.join(other)} differ; use the test that wrote it "
            "(only axial_strain may change)."
        )
    numbers = set(header.get("numbers", ()))
    template = _template(test, fixed="fixed.lateral" in arrays)
    names = [name for name, _ in _named(template)]
    if set(names) != set(arrays):
        wrong = sorted(set(names) ^ set(arrays))[0]
        raise ValueError(f"checkpoint '{path}' is damaged: '{wrong}' is missing or unknown; start again without it.")

    def restored(name):
        array = arrays[name]
        if name in numbers:
            return array.item()
        return array if name.startswith("records.") else jnp.asarray(array)

    return jax.tree.unflatten(jax.tree.structure(template), [restored(name) for name in names])


def _named(tree) -> list[tuple[str, object]]:
    """The leaves of a tree under names like 'network.branch.x', in its order."""
    return [(jax.tree_util.keystr(path).lstrip("."), leaf) for path, leaf in jax.tree.leaves_with_path(tree)]


def _template(test: TriaxialTest, fixed: bool) -> Progress:
    """A tree of the shape that a progress of this test has."""
    zero = jnp.zeros(())
    return Progress(
        params=test.params,
        network=test.network,
        membrane=test.membrane,
        state=initial_state(test.network, test.scene, jnp.zeros(2)),
        fixed=Load(zero, zero) if fixed else None,
        confinement=Confinement(zero, zero, zero),
        height=0.0,
        records=no_records(),
    )


def _description(test: TriaxialTest) -> dict[str, object]:
    """All that decides how a shear goes on, but for where it stops and what the progress itself holds."""
    digest = hashlib.sha256()
    for array in (test.cut.positions, test.cut.radius, test.cut.membrane_zone):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        "specimen": digest.hexdigest(),
        "sector": repr(test.sector),
        "scene": repr(test.scene),
        "time_step": test.time_step,
        "ramp_time": test.ramp_time,
        "record_every": test.record_every,
        "refresh": test.refresh,
        "lateral_load": test.lateral_load is not None,
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
