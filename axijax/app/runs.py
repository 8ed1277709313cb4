"""A case run into a folder of its own, so that what is there always tells how far it got.

    case.toml         the case as it was run, every value filled in
    run.json          versions, machine, times, and the status: running, interrupted, failed or finished
    specimen.npz      the balls of a random specimen, as they were generated
    checkpoint.npz    the last state and all records; kept, for pictures, checks and going on to a larger strain
    curve.nc .csv .png    once the run has finished
    partial_curve.nc      in their place where it went wrong
    snapshots/            for ParaView, where they were asked for; snapshots-full/ of the whole cylinder

run.json comes first and is changed in one piece, so at whatever moment a run is killed it says no more than is true. A
result is finished before anything is drawn.

`run_case` starts a run and `resume` goes on with one, to the last bit as if it had never stopped.
"""

import contextlib
import json
import os
import platform
import socket
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from axijax.app import results
from axijax.app.case import GIVEN, Case, load_case
from axijax.app.case_writing import to_toml
from axijax.app.overwrite import CURVES, clear, refuse_to_lose, remove_stale
from axijax.app.results import curves_dataset, save_dataset, save_run
from axijax.app.specimen_file import NAME, load_specimen, save_specimen
from axijax.core.files import locked, printable, writable_folder, write_whole, writing_to
from axijax.core.quantity import values_of
from axijax.core.signals import signals_wait
from axijax.triaxial.checkpoint import load_progress, save_progress
from axijax.triaxial.progress import Progress, Run
from axijax.triaxial.records import SimulationError
from axijax.triaxial.test import TriaxialTest

if TYPE_CHECKING:
    from axijax.specimen.specimen import Specimen
    from axijax.triaxial.packing_report import PackingReport

# Called with the test and with where it stands: None before confinement, then once before the first step of the shear
# and about every 1000 steps of it.
Tell = Callable[[TriaxialTest, Progress | None], None]


class Interrupted(Exception):  # noqa: N818 (not an error)
    """A run was stopped from outside; says how to go on."""


def run_case(
    case: Case,
    folder: Path,
    name: str,
    tell: Tell = lambda test, now: None,
    *,
    overwrite: bool = False,
    snapshots: int = 0,
    full: bool = False,
    command: Sequence[str] = (),
    packing: Callable[[str], None] = lambda told: None,
    packed: "Callable[[PackingReport], None]" = lambda report: None,
    confined: Path | None = None,
    keep_confined: Path | None = None,
) -> Run:
    """Run a case into a folder, which is made where there is none.

    name: of the run, for titles. overwrite: replace what another run left there. snapshots: how many to write for
    ParaView, evenly over the shear, each at the first record there; full: of the whole cylinder. command: the command
    line, to be kept.
    packing: called with what the packing of a random specimen is at, packed: with what it has become. confined: begin
    with the specimen that another case has kept there, which may differ in its stages alone. keep_confined: file for
    the confined specimen.

    Raises ValueError where the case makes no sense, the folder cannot be written or holds a result, or files that no
    run wrote and this one would replace; SimulationError for a run that went wrong, whose curve so far is kept;
    Interrupted (Ctrl-C, SIGTERM, SIGHUP, output that nobody reads) with the way to go on.
    """
    folder = Path(folder)
    made = not folder.exists()
    with locked(writable_folder(folder)):
        try:
            refuse_to_lose(folder, overwrite)
            case, specimen, report = case.made(packing)
            test = case.build(specimen)
            start = None if confined is None else _start_from(Path(confined), test)
            if report is not None:
                packed(report)
        except BaseException as error:
            if made:
                with contextlib.suppress(OSError):
                    folder.rmdir()
            if isinstance(error, KeyboardInterrupt):
                raise Interrupted("interrupted before anything was written: run the case again.") from None
            raise
        info: dict[str, Any] = {"name": printable(name), "command": [printable(word) for word in command]}
        info |= {"started": _now(), "seconds": 0.0, "resumed": 0, "axial_strain": 0.0, "snapshots": snapshots}
        info |= {"full": True} if full else {}
        if report is not None:
            info["packing"] = packing_values(report)
        made_here = specimen if case.specimen.kind in GIVEN else None
        return _run(folder, case, test, start, info, tell, made_here, keep_confined)


def resume(folder: Path, tell: Tell = lambda test, now: None, axial_strain: float | None = None) -> Run:
    """Go on with an interrupted run, or with a finished one to a larger axial strain.

    Raises ValueError where there is nothing to go on with, saying why; otherwise as `run_case` does.
    """
    folder = Path(folder)
    read_info(folder)  # no folder is made where there is no result
    with locked(writable_folder(folder)):
        info = read_info(folder)
        case = load_case(folder / "case.toml")
        if case.stage:
            _check_stages_wanted(folder, info, axial_strain)
        else:
            case = case.with_test(axial_strain=_strain_wanted(folder, info, case.test.axial_strain, axial_strain))
        test = case.build(load_specimen(folder / NAME, case) if case.specimen.kind in GIVEN else None)
        checkpoint = folder / "checkpoint.npz"
        start = load_progress(checkpoint, test) if checkpoint.exists() else None
        if start is None and info["status"] == "finished":
            raise ValueError(f"result '{folder}' has lost its checkpoint.npz, so it cannot go on: run the case again.")
        if start is not None:
            _check_same_parameters(folder, test, start)
        stale = remove_stale(folder)
        if stale:
            told = ", ".join(stale)
            warnings.warn(f"{told}: removed, since they are of a smaller strain; draw them again", stacklevel=2)
        return _run(folder, case, test, start, {**info, "resumed": info["resumed"] + 1}, tell)


def read_info(folder: Path) -> dict[str, Any]:
    """What run.json says. Raises ValueError where there is none, or it is damaged."""
    if not (Path(folder) / "run.json").is_file():
        raise ValueError(f"'{folder}' is no result of axijax: it holds no run.json.")
    return results.read_info(folder, needed=results.NEEDED)


def _strain_wanted(folder: Path, info: dict[str, Any], reached: float, wanted: float | None) -> float:
    """Where to go on to, if there is anything to go on with."""
    again = f"`axijax resume {folder} --axial-strain"
    if info["status"] == "finished" and (wanted is None or wanted <= reached):
        raise ValueError(
            f"result '{folder}' is finished at axial_strain = {reached:g}: to go on, {again} E` with a larger E."
        )
    if info["status"] == "failed" and (wanted is None or wanted > info["axial_strain"]):
        sound = f", or {again} E` with E up to {info['axial_strain']:.4g}, where it was sound"
        raise ValueError(
            f"result '{folder}' failed ({info['message']}) and would again: change its case"
            f"{sound if info['axial_strain'] > 0 else ''}."
        )
    return reached if wanted is None else wanted


def _check_stages_wanted(folder: Path, info: dict[str, Any], wanted: float | None) -> None:
    """Raise ValueError where a test in stages has nothing left to go on with."""
    if wanted is not None:
        raise ValueError(
            f"--axial-strain = {wanted:g}: result '{folder}' is a test in stages, which end where its case.toml says."
        )
    if info["status"] in ("finished", "failed"):
        why = f" ({info['message']}) and would again" if info["status"] == "failed" else ": its stages are done"
        raise ValueError(f"result '{folder}' is {info['status']}{why}; run a changed case into another folder.")


def _run(
    folder: Path,
    case: Case,
    test: TriaxialTest,
    start: Progress | None,
    info: dict[str, Any],
    tell: Tell,
    specimen: "Specimen | None" = None,
    keep_confined: Path | None = None,
) -> Run:
    """specimen: a random one that is not in the folder yet."""
    began = time.perf_counter()
    before = info["seconds"]
    unheard: list[OSError] = []

    def note(status: str, message: str = "") -> None:
        info.update(status=status, message=message, ended=None if status == "running" else _now())
        info.update(seconds=round(before + time.perf_counter() - began, 3))
        write_whole(folder / "run.json", lambda target: target.write_text(json.dumps(info, indent=2) + "\n"))

    def warn(sentence: str | None) -> None:
        if sentence is not None:
            info["warnings"].append(sentence)
            warnings.warn(sentence, stacklevel=2)

    def say(now: Progress | None) -> None:
        try:
            tell(test, now)
        except OSError as error:  # a closed pipe or terminal, not the folder's disk
            unheard.append(error)
            raise KeyboardInterrupt from error

    def advance(now: Progress) -> None:
        info["axial_strain"] = now.strain
        if keep_confined is not None and now.taken == 0:
            save_progress(Path(keep_confined), test, now)
        done = now.share(test) if test.stages else now.strain
        if due and done >= due[0]:
            reached.append(now.strain)
            try:
                write_snapshot(now)
            except OSError:  # the disk, of which the rest of the run would suffer too
                raise
            except Exception as error:
                warn(f"the snapshot at {now.strain:.3g} axial strain could not be made ({error})")
            due[:] = [each for each in due if each > done]
        check()
        say(now)
        check()

    def way_on() -> str:
        if (folder / "run.json").is_file() and (folder / "case.toml").is_file():
            return f"`axijax resume {folder}` goes on from the last checkpoint"
        return "run the case again"

    # The time step is written down, so that another version or machine goes on with the same one.
    case = case.with_test(time_step=test.prepared.time_step)
    info.update(_versions(), balls=len(test.cut), warnings=[])
    with writing_to(folder, way_on), signals_wait() as check:
        if info["resumed"] == 0:
            clear(folder)
        note("running")
        if specimen is not None:
            save_specimen(folder / NAME, specimen, case)
        write_whole(folder / "case.toml", lambda target: target.write_text(to_toml(case)))
        for name in CURVES:  # of a smaller strain; the checkpoint holds the records until there are new ones
            (folder / name).unlink(missing_ok=True)
        begun = 0.0 if start is None else start.share(test) if test.stages else start.strain
        due = _snapshot_strains(info["snapshots"], 1.0 if test.stages else test.axial_strain, begun)
        wanted, reached = len(due), list[float]()
        if due:
            from axijax.app.paraview import SnapshotWriter

            full = info.get("full", False)
            write_snapshot = SnapshotWriter(folder / results.snapshots_folder(full), test, full)
        try:
            say(None)
            run = test.run(start=start, progress=advance, checkpoint=folder / "checkpoint.npz", stops=tuple(due))
            save_run(folder, info["name"], case.model_dump_json(), run.curve)
        except KeyboardInterrupt:
            confined = (folder / "checkpoint.npz").exists()
            where = f"at {100 * info['axial_strain']:.3g} % axial strain" if confined else "before it was confined"
            why = f", since nothing reads what it prints ({unheard[0].strerror})" if unheard else ""
            note("interrupted", f"stopped from outside {where}{why}")
            how = "goes on" if confined else "starts it again"
            raise Interrupted(f"interrupted {where}{why}: `axijax resume {folder}` {how}.") from None
        except SimulationError as error:
            if error.curve is not None:
                dataset = curves_dataset({info["name"]: error.curve}, {}, {"title": info["name"], "status": "failed"})
                save_dataset(dataset, folder / "partial_curve.nc")
            note("failed", str(error).rstrip("."))
            raise
        except Exception as error:  # such as memory, or a disk that has no room for run.json either
            with contextlib.suppress(OSError):
                note("interrupted", f"stopped by {str(error).rstrip('.') or type(error).__name__}")
            raise
        note("finished", run.ended)
        warn(run.ended or None)
        if len(reached) < wanted:
            reason = "a stage ends with a stretch of 1000 steps" if test.stages else "they are made at records"
            warn(f"{len(reached)} of {wanted} snapshots were made, since {reason}, and there were not enough of these")
        from axijax.app.plot import draw_curve  # Matplotlib only where something is drawn

        warn(draw_curve(folder))
        if info["warnings"]:
            note("finished", run.ended)
    return run


def packing_values(report: "PackingReport") -> dict[str, Any]:
    """A packing's report as JSON holds it; the radii are in specimen.npz."""
    listed = ("radii", "sieves", "fractions")
    told = {each.name: getattr(report, each.name) for each in fields(report) if each.name not in listed}
    columns = ("radius", "per cent passing wanted", "per cent passing reached")
    sieves = dict(zip(columns, np.round(report.sieves, 4).T.tolist(), strict=True))
    fractions = [each._asdict() for each in report.fractions]
    told = {name: _finite(value) for name, value in told.items()}
    return (
        told
        | {"sieves": sieves, "fractions": fractions, "deviation": report.deviation}
        | {"relative_density": report.relative_density}
    )


def _finite(value):
    """JSON knows neither infinity nor NaN, as of the core of a narrow sector that holds no ball."""
    if isinstance(value, tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _snapshot_strains(number: int, axial_strain: float, start: float) -> list[float]:
    """Where snapshots are due: evenly from the start of the shear to its end, those before `start` done; of a test in
    stages in shares of it."""
    strains = [axial_strain * k / (number - 1) for k in range(number)] if number > 1 else [axial_strain] * number
    return [strain for strain in strains if strain > start or start == 0]


def _start_from(path: Path, test: TriaxialTest) -> Progress:
    """A confined specimen that another case has kept. Raises ValueError where it is not one of this test."""
    start = load_progress(path, test)
    if start.taken:
        raise ValueError(f"checkpoint '{path}' has been sheared already: give one that --keep-confined has written.")
    for name, value in values_of(test.params).items():
        kept = np.asarray(getattr(start.params, name))
        if kept.shape != () or value != kept:
            shown = f"{kept:g}" if kept.shape == () else f"{kept.size} values"
            raise ValueError(f"checkpoint '{path}' was confined with {name} = {shown}, the case says {value:g}.")
    return start


def _check_same_parameters(folder: Path, test: TriaxialTest, start: Progress) -> None:
    """A checkpoint goes on with its own parameters; a changed case file would say otherwise."""
    for name, value in values_of(test.params).items():
        run_with = np.asarray(getattr(start.params, name))
        if run_with.shape != () or value != run_with:
            shown = f"{run_with:g}" if run_with.shape == () else f"{run_with.size} values"
            raise ValueError(
                f"result '{folder}': its case.toml says parameters.{name} = {value:g}, but it was run with "
                f"{shown}; put that back, or run the changed case into another folder."
            )


def _versions() -> dict[str, Any]:
    import jax
    import numpy

    return {
        "axijax": version("axijax"),
        "jax": jax.__version__,
        "numpy": numpy.__version__,
        "python": platform.python_version(),
        "machine": {
            "host": socket.gethostname(),
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "device": jax.devices()[0].device_kind,
        },
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
