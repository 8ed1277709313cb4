"""A shear in progress on disk: written whole or not at all, and read back to the last bit.

    run = test.run(checkpoint=Path("shear.npz"))                            # interrupted, or stopped at a small strain
    longer = dataclasses.replace(test, axial_strain=0.05)
    run = longer.run(start=load_progress(Path("shear.npz"), longer))        # the same curve as without a stop

A checkpoint in which nothing is sheared yet is a confined specimen, for all tests that differ in their stages alone:

    confined = test.confined(checkpoint=Path("confined.npz"))
    drained = test.run(start=confined)
    undrained = replace(test, stages=(stage("compression", lateral="constant_volume", axial_strain=0.05),))
    undrained.run(start=load_progress(Path("confined.npz"), undrained))

The file is a NumPy .npz archive of every array under its name in `triaxial.Progress`, with a header in JSON: format and
program versions, and what the test was. A checkpoint fits one test only, up to the axial strain where it stops, or the
stages that it has not begun.
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
from axijax.triaxial.progress import Progress, fit_for_stages
from axijax.triaxial.records import Confinement, no_records
from axijax.triaxial.stages import start_loading, start_stage

if TYPE_CHECKING:
    from axijax.triaxial.test import TriaxialTest

FORMAT = "axijax shear in progress"
VERSION = 6


def save_progress(path: Path, test: "TriaxialTest", progress: Progress) -> None:
    """Write a checkpoint, whole or not at all. Raises OSError where the folder cannot be written."""
    leaves = dict(_named(progress))
    header = {
        "format": FORMAT,
        "version": VERSION,
        **versions(),
        "test": _description(test, _reached(progress.stage, progress.begun, progress.taken)),
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
    reached, wrong_stage = _reached_in(arrays, len(test.stages))
    other = differences(_description(test, reached), header.get("test"))
    if other:
        raise ValueError(
            f"checkpoint '{path}' is of another test: it differs in {other}; use the test that wrote it (only "
            "axial_strain may change, and stages that have not begun)."
        )
    if wrong_stage:
        raise ValueError(f"checkpoint '{path}' is damaged: {wrong_stage}; start again without it.")
    numbers = header.get("numbers")
    staged = "state.loading.stage" in arrays
    template = _template(test, "fixed.lateral" in arrays, staged, reached)
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
    return fit_for_stages(test, progress)


def _reached(stage: int, begun: bool, taken: int) -> int:
    """How many of a test's stages have begun; -1 where nothing has been sheared at all."""
    return int(stage) + bool(begun) if taken or begun or stage else -1


def _reached_in(arrays, stages: int) -> tuple[int, str]:
    """The same of a file's arrays, and what is wrong with them."""
    found = [arrays.get(name) for name in ("stage", "begun", "taken", "steps", "first")]
    if any(each is None or each.shape != () or each.dtype.kind not in "ib" for each in found):
        return -1, "its counts of stages are missing or no numbers"
    stage, begun, taken, steps, first = (int(each) for each in found)
    if not (stage >= 0 and stage + begun <= stages and min(taken, steps, first) >= 0):
        return -1, "its counts are those of no stage" if stage or begun else ""
    return _reached(stage, bool(begun), taken), ""


def _named(tree) -> list[tuple[str, object]]:
    """The leaves of a tree under names like 'network.branch.x', in its order."""
    return [(jax.tree_util.keystr(path).lstrip("."), leaf) for path, leaf in jax.tree.leaves_with_path(tree)]


def _template(test: "TriaxialTest", fixed: bool, staged: bool, reached: int) -> Progress:
    """A tree of the shape that a progress of this test has, of which so many stages have begun."""
    zero = jnp.zeros(())
    state = initial_state(test.scene, test.params, test.network, jnp.zeros(2))
    if staged:
        state = start_loading(test.params, state)
    if staged and reached > 0:
        prepared = test.prepared
        path = prepared.stages[reached - 1]

        def begun(state, params):
            return start_stage(test.scene, path, prepared.lists, prepared.time_step, params, state, None)

        shapes = jax.eval_shape(begun, state, test.params)
        state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    slope = None if test.membrane.surface is None else zero
    return Progress(
        params=test.params,
        network=test.network,
        membrane=test.membrane,
        state=state,
        fixed=Load(zero, zero, axial=slope, ends=slope) if fixed else None,
        confinement=Confinement(zero, zero, zero),
        height=0.0,
        records=no_records(test.params, staged),
    )


def _description(test: "TriaxialTest", reached: int) -> dict[str, str]:
    """All that decides how a shear goes on, but for where it stops and the parameters, which the progress holds; of the
    stages those that have begun."""

    def decides(name: str) -> bool:
        first, *rest = name.split(".")
        if first == "stages":
            return bool(rest) and int(rest[0]) <= reached
        return first not in ("axial_strain", "params")

    held = {name: part for name, part in fingerprint(test).items() if decides(name)}
    if reached >= 0:
        held["stages"] = "some" if test.stages else "none"
    return held | {"params": ", ".join(type(part).__name__ for part in parts_of(test.params))}
