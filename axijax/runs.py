"""A case run into a folder of its own, so that what is there always tells how far it got.

    case.toml         the case as it was run, every value filled in
    run.json          versions, machine, times, and the status: running, interrupted, failed or finished
    specimen.npz      the balls of a random specimen, as they were generated
    checkpoint.npz    the last state and all records; kept, for pictures, checks and going on to a larger strain
    curve.nc .csv .png    once the run has finished
    partial_curve.nc      in their place where it went wrong
    snapshots/            for ParaView, where they were asked for

`run_case` starts a run and `resume` goes on with one, to the last bit as if it had never stopped.
"""

import json
import os
import platform
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from axijax.case import Case, load_case, to_toml
from axijax.checkpoint import load_progress
from axijax.curve import SimulationError
from axijax.progress import Progress, Run
from axijax.quantity import values_of
from axijax.results import curves_dataset, save_dataset, save_run, writable_folder, write_whole
from axijax.specimen_file import NAME, load_specimen, save_specimen
from axijax.triaxial import TriaxialTest

if TYPE_CHECKING:
    from axijax.random_packing import PackingReport

CURVES = ("curve.nc", "curve.csv", "curve.png")
FILES = ("case.toml", "run.json", "checkpoint.npz", "partial_curve.nc", NAME, *CURVES)

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
    command: Sequence[str] = (),
    packed: "Callable[[PackingReport], None]" = lambda report: None,
) -> Run:
    """Run a case into a folder, which is made where there is none.

    name: of the run, for titles. overwrite: replace what another run left there. snapshots: how many to write for
    ParaView, evenly over the shear, one every 1000 steps at most. command: the command line, to be kept.
    packed: called with what a random specimen has become.

    Raises ValueError where the case makes no sense, the folder cannot be written or holds a result; SimulationError
    for a run that went wrong, whose curve so far is kept; Interrupted (Ctrl-C, SIGTERM) with the way to go on.
    """
    folder = Path(folder)
    if not overwrite:
        _refuse_to_overwrite(folder)
    case, specimen, report = case.made()
    test = case.build(specimen)
    if report is not None:
        packed(report)
    with _locked(writable_folder(folder)):
        if overwrite:
            _clear(folder, FILES)
            shutil.rmtree(folder / "snapshots", ignore_errors=True)
        info = {"name": name, "command": list(command), "started": _now(), "seconds": 0.0, "resumed": 0}
        info.update(axial_strain=0.0, snapshots=snapshots)
        if report is not None:
            info["packing"] = packing_values(report)
            with _one_sentence_for_a_full_disk(folder, "then run the case again"):
                save_specimen(folder / NAME, specimen, case)
        return _run(folder, case, test, None, info, tell)


def resume(folder: Path, tell: Tell = lambda test, now: None, axial_strain: float | None = None) -> Run:
    """Go on with an interrupted run, or with a finished one to a larger axial strain.

    Raises ValueError where there is nothing to go on with, saying why; otherwise as `run_case` does.
    """
    folder = Path(folder)
    info = read_info(folder)
    case = load_case(folder / "case.toml")
    strain = _strain_wanted(folder, info, case.test.axial_strain, axial_strain)
    case = case.with_test(axial_strain=strain)
    test = case.build(load_specimen(folder / NAME, case) if case.specimen.kind == "random" else None)
    checkpoint = folder / "checkpoint.npz"
    start = load_progress(checkpoint, test) if checkpoint.exists() else None
    if start is None and info["status"] == "finished":
        raise ValueError(f"result '{folder}' has lost its checkpoint.npz, so it cannot go on: run the case again.")
    if start is not None:
        _check_same_parameters(folder, test, start)
    with _locked(writable_folder(folder)):
        _clear(folder, ("partial_curve.nc", *CURVES))
        return _run(folder, case, test, start, {**info, "resumed": info["resumed"] + 1}, tell)


def read_info(folder: Path) -> dict[str, Any]:
    """What run.json says. Raises ValueError where there is none, or it is damaged."""
    path = Path(folder) / "run.json"
    try:
        info = json.loads(path.read_text())
        known = {"status", "name", "message", "seconds", "resumed", "axial_strain"} <= set(info)
    except OSError as error:
        raise ValueError(
            f"'{folder}' is no result of axijax: its run.json cannot be read ({error.strerror})."
        ) from None
    except (ValueError, TypeError):
        known = False
    if not known:
        raise ValueError(f"result '{folder}': its run.json is damaged; run the case again, with --overwrite.")
    return info


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


def _run(folder: Path, case: Case, test: TriaxialTest, start: Progress | None, info: dict[str, Any], tell: Tell) -> Run:
    began = time.perf_counter()
    before = info["seconds"]

    def note(status: str, message: str = "") -> None:
        info.update(status=status, message=message, ended=None if status == "running" else _now())
        info.update(seconds=round(before + time.perf_counter() - began, 3))
        write_whole(folder / "run.json", lambda target: target.write_text(json.dumps(info, indent=2) + "\n"))

    def advance(now: Progress) -> None:
        info["axial_strain"] = now.strain
        tell(test, now)
        if due and now.strain >= due[0]:
            write_snapshot(now)
            due[:] = [strain for strain in due if strain > now.strain]
        check()

    # The time step is written down, so that another version or machine goes on with the same one.
    case = case.with_test(time_step=test.prepared.time_step)
    info.update(_versions(), balls=len(test.cut))
    with _one_sentence_for_a_full_disk(folder), _signals_wait() as check:
        write_whole(folder / "case.toml", lambda target: target.write_text(to_toml(case)))
        note("running")
        due = _snapshot_strains(info["snapshots"], test.axial_strain, 0.0 if start is None else start.strain)
        if due:
            from axijax.paraview import SnapshotWriter

            write_snapshot = SnapshotWriter(folder / "snapshots", test)
        try:
            tell(test, None)
            run = test.run(start=start, progress=advance, checkpoint=folder / "checkpoint.npz")
            save_run(folder, info["name"], case.model_dump_json(), run.curve)
        except KeyboardInterrupt:
            confined = (folder / "checkpoint.npz").exists()
            where = f"at {100 * info['axial_strain']:.3g} % axial strain" if confined else "before it was confined"
            note("interrupted", f"stopped from outside {where}")
            how = "goes on" if confined else "starts it again"
            raise Interrupted(f"interrupted {where}: `axijax resume {folder}` {how}.") from None
        except SimulationError as error:
            if error.curve is not None:
                dataset = curves_dataset({info["name"]: error.curve}, {}, {"title": info["name"], "status": "failed"})
                save_dataset(dataset, folder / "partial_curve.nc")
            note("failed", str(error).rstrip("."))
            raise
        note("finished")
    return run


def packing_values(report: "PackingReport") -> dict[str, Any]:
    """A packing's report as JSON holds it; the radii are in specimen.npz."""
    told = {each.name: getattr(report, each.name) for each in fields(report) if each.name not in ("radii", "sieves")}
    columns = ("radius", "per cent passing wanted", "per cent passing reached")
    sieves = dict(zip(columns, np.round(report.sieves, 4).T.tolist(), strict=True))
    return {name: None if value == np.inf else value for name, value in told.items()} | {"sieves": sieves}


def _snapshot_strains(number: int, axial_strain: float, start: float) -> list[float]:
    """Where snapshots are due: evenly from the start of the shear to its end, those before `start` done."""
    strains = [axial_strain * k / (number - 1) for k in range(number)] if number > 1 else [axial_strain] * number
    return [strain for strain in strains if strain > start or start == 0]


def _refuse_to_overwrite(folder: Path) -> None:
    there = [name for name in FILES if (folder / name).exists()]
    if not there:
        return
    way = "choose another --output, or --overwrite"
    if "run.json" not in there:
        raise ValueError(f"output folder '{folder}' already holds {' and '.join(there)}: {way}.")
    status = read_info(folder)["status"]
    if status == "finished":
        raise ValueError(f"output folder '{folder}' already holds a finished result: {way}.")
    if status == "failed":
        raise ValueError(f"output folder '{folder}' already holds a failed run: {way}.")
    with _locked(folder):
        raise ValueError(
            f"output folder '{folder}' already holds an unfinished run: `axijax resume {folder}` goes on with it; "
            f"or {way}."
        )


def _check_same_parameters(folder: Path, test: TriaxialTest, start: Progress) -> None:
    """A checkpoint goes on with its own parameters; a changed case file would say otherwise."""
    for name, value in values_of(test.params).items():
        if value != getattr(start.params, name):
            raise ValueError(
                f"result '{folder}': its case.toml says parameters.{name} = {value:g}, but it was run with "
                f"{getattr(start.params, name):g}; put that back, or run the changed case into another folder."
            )


def _clear(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        (folder / name).unlink(missing_ok=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder for this process; a lock that the system lets go of when the process ends, however it ends."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"output folder '{folder}' is in use by a run that is going on: wait for it, or choose another "
                "--output."
            ) from None
        yield
    finally:
        os.close(handle)


@contextmanager
def _signals_wait() -> Iterator[Callable[[], None]]:
    """Let Ctrl-C and SIGTERM wait for a moment between two stretches of the run, when what is yielded is called: it
    raises KeyboardInterrupt if there was one. A second Ctrl-C does not wait.

    An exception thrown into the middle of a compilation can end the process in a crash.
    """
    asked: list[int] = []

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    def stop(number: int, _) -> None:
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked.append(number)
        print("axijax: stopping at the next checkpoint (Ctrl-C once more: at once)", file=sys.stderr, flush=True)

    if threading.current_thread() is not threading.main_thread():  # only the main thread may handle signals
        yield check
        return
    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield check
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _one_sentence_for_a_full_disk(folder: Path, remedy: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OSError(
            f"output folder '{folder}' cannot be written ({error.strerror or error}): make room there, "
            + (remedy or f"then `axijax resume {folder}` goes on from the last checkpoint")
            + "."
        ) from None


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
