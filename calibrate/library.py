"""The library: every run of a random scene, kept so that each later fit of that scene begins with all of them.

A folder for each scene, named by the hash of what the scene is (`calibrate.scene`), holds `scene.json` with these parts
and one file for each run. Files are whole or not there, and each run has a name of its own, so processes share a
library without a lock and a kill costs the runs in progress alone. Runs that failed are kept with their sentence, and
not tried again.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from axijax.core.files import remove_leftovers, write_whole
from axijax.core.npz import read_npz
from calibrate.scene import RandomScene

VARIABLE = "AXIJAX_LIBRARY"
FIELDS = ("axial_strain", "stress_ratio", "volumetric_strain", "void_ratio")
VERSION = 1


@dataclass(frozen=True)
class StoredRun:
    """One run of a scene.

    point: its parameters, forces over the confining stress. seed: of its packing. reach: axial strain asked for.
    curve: T records of `FIELDS`; None where it failed. failed: why, or None. seconds: what it took.
    """

    point: Mapping[str, float]
    seed: int
    reach: float
    curve: Mapping[str, np.ndarray] | None
    failed: str | None
    seconds: float

    @property
    def void_ratio(self) -> float:
        """Void ratio at the beginning of the shear, the mean of three counts; NaN where none was counted [-]."""
        return float("nan") if self.curve is None else float(np.mean(self.curve["void_ratio"][:3]))


def library_folder() -> Path:
    """Where libraries are kept unless another place is named: AXIJAX_LIBRARY, or `axijax/runs` in the user's data."""
    given = os.environ.get(VARIABLE, "")
    if given:
        return Path(given).expanduser()
    home = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    try:
        return Path(home).expanduser() / "axijax" / "runs"
    except RuntimeError:
        raise ValueError(
            f"no library of runs: this user has no home folder; name a folder by --library or {VARIABLE}."
        ) from None


class Library:
    """The runs of one scene in a folder of libraries.

    Raises ValueError where the folder cannot be written.
    """

    def __init__(self, scene: RandomScene, folder: Path | str | None = None):
        self.parts = scene.parts
        key = hashlib.sha256(json.dumps(self.parts, sort_keys=True).encode()).hexdigest()[:16]
        self.folder = (library_folder() if folder is None else Path(folder)) / key
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            remove_leftovers(self.folder)
            about = json.dumps({"version": VERSION, "parts": self.parts}, indent=1)
            if not (self.folder / "scene.json").exists():
                write_whole(self.folder / "scene.json", lambda target: target.write_text(about))
        except OSError as error:
            raise ValueError(
                f"library of runs '{self.folder}' cannot be written ({error.strerror}): name another folder by "
                f"--library or {VARIABLE}."
            ) from None

    def runs(self) -> list[StoredRun]:
        """All runs, failed ones among them, in the order of their seeds; files that are damaged are passed over."""
        found = [read_run(path) for path in sorted(self.folder.glob("run-*.npz"))]
        return sorted((run for run in found if run is not None), key=lambda run: (run.seed, run.reach))

    def find(self, point: Mapping[str, float], seed: int, reach: float) -> StoredRun | None:
        """This run, if it is there and goes as far."""
        run = read_run(self.folder / _name(point, seed))
        return run if run is not None and run.reach >= reach * (1 - 1e-9) else None

    def keep(self, run: StoredRun) -> None:
        """Add a run; of two of one packing and point the one that goes farther stays."""
        path = self.folder / _name(run.point, run.seed)
        before = read_run(path)
        if before is not None and before.curve is not None and (run.curve is None or before.reach >= run.reach):
            return
        about = {
            "version": VERSION,
            "point": {name: float(value) for name, value in run.point.items()},
            "seed": int(run.seed),
            "reach": float(run.reach),
            "failed": run.failed,
            "seconds": round(float(run.seconds), 3),
        }
        curve = run.curve
        arrays: dict[str, Any] = {} if curve is None else {name: np.asarray(curve[name], float) for name in FIELDS}
        arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)

        def write(target: Path) -> None:
            with open(target, "wb") as file:
                np.savez(file, **arrays)

        write_whole(path, write)


def read_run(path: Path) -> StoredRun | None:
    """A run from its file; None where there is none or it is damaged."""
    try:
        held = read_npz(path)
        about = json.loads(held["about"].tobytes())
        if about["version"] != VERSION:
            return None
        curve = None if about["failed"] is not None else {name: held[name] for name in FIELDS}
        return StoredRun(
            {str(name): float(value) for name, value in about["point"].items()},
            int(about["seed"]),
            float(about["reach"]),
            curve,
            about["failed"],
            float(about["seconds"]),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _name(point: Mapping[str, float], seed: int) -> str:
    """A name that a point has whatever the order of its arithmetic."""
    text = json.dumps([sorted((name, f"{value:.10g}") for name, value in point.items()), int(seed)])
    return f"run-{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"


@dataclass(frozen=True)
class Listed:
    """One scene's library: its folder, what it is, and how many runs it holds."""

    folder: Path
    parts: Mapping[str, str]
    runs: int
    failed: int
    bytes: int
    seconds: float


def listed(folder: Path | str | None = None) -> Iterator[Listed]:
    """The libraries in a folder."""
    home = library_folder() if folder is None else Path(folder)
    for path in sorted(home.glob("*/scene.json")):
        try:
            parts = json.loads(path.read_text())["parts"]
        except (OSError, ValueError, KeyError, TypeError):
            parts = {}
        files = sorted(path.parent.glob("run-*.npz"))
        runs = [run for run in map(read_run, files) if run is not None]
        failed = sum(run.curve is None for run in runs)
        size = sum(file.stat().st_size for file in files)
        yield Listed(path.parent, parts, len(runs) - failed, failed, size, sum(run.seconds for run in runs))


def clean(folder: Path | str | None = None, scene: str | None = None, failed_only: bool = False) -> int:
    """Remove the runs of the scene whose name begins so, or of all; returns how many runs went.

    Only what a library wrote is removed. Raises ValueError where no scene has that name.
    """
    home = library_folder() if folder is None else Path(folder)
    chosen = [one.folder for one in listed(home) if scene is None or one.folder.name.startswith(scene)]
    if scene is not None and not chosen:
        raise ValueError(f"'{scene}': no library in '{home}' has a name that begins so; see `axijax library list`.")
    gone = 0
    for each in chosen:
        for path in each.glob("run-*.npz"):
            if failed_only:
                run = read_run(path)
                if run is not None and run.curve is not None:
                    continue
            path.unlink(missing_ok=True)
            gone += 1
        if not failed_only:
            (each / "scene.json").unlink(missing_ok=True)
            remove_leftovers(each)
            if not any(each.iterdir()):
                shutil.rmtree(each, ignore_errors=True)
    return gone
