"""Results as labelled data: a run's folder read by one call, curves as NetCDF through xarray, tables as CSV.

    result = open_result("results")     # the folder of a run, or a bare curve.nc
    result.curve.stress_ratio           # xarray over axial_strain, units in the attributes: .plot() is right
    result.case, result.test, result.progress   # made when they are first asked for

Every file is written whole or not at all.
"""

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from axijax.core.files import printable, write_whole
from axijax.core.shown import Card, line_picture, per_cent, shown
from axijax.triaxial.peak import peak_of
from axijax.triaxial.records import QUANTITIES, Curve, quantities_of
from axijax.triaxial.test import TriaxialTest, curve_of

if TYPE_CHECKING:
    import xarray

    from axijax.app.case import Case
    from axijax.triaxial.test import Progress

# How confinement ended: one value a run.
CONFINEMENT = {
    "confinement_unbalanced_force": "mean unbalanced over mean contact force at the end of confinement",
    "confinement_stress_error": "|s1 - s3| / s3 at the end of confinement",
    "confinement_steps": "steps taken by confinement",
}

MEMBERS = "members"  # the folder of a batch's files
STRAIN = "axial_strain"

# How a run can stand; `run.json` says which.
SNAPSHOTS = ("snapshots", "snapshots-full")  # folders: of the sector, and of the whole cylinder
STATUSES = ("running", "interrupted", "failed", "finished")


def curves_dataset(curves: Mapping[str, Curve], labels: Mapping[str, Sequence], attributes: Mapping[str, str]):
    """Several curves as one xarray.Dataset with dimensions (run, record), padded with NaN; axial_strain, as long, is a
    coordinate, so that `dataset.stress_ratio.plot.line(x="axial_strain", hue="run")` draws them.

    curves: by name of the run. labels: further coordinates along run (friction, boundary..). attributes: of the file.
    """
    import xarray

    longest = max(np.size(curve.axial_strain) for curve in curves.values())
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for name in dict.fromkeys(each for curve in curves.values() for each in quantities_of(curve)):
        table = np.full((len(curves), longest), np.nan)
        for row, curve in zip(table, curves.values(), strict=True):
            values = getattr(curve, name)
            if values is not None:  # one of several curves may have what the others have not
                row[: np.size(values)] = values
        about = {"long_name": QUANTITIES[name].long_name, "units": QUANTITIES[name].unit}
        data[name] = (("run", "record"), table, about)
    for name, long_name in CONFINEMENT.items():
        ends = [getattr(curve.confinement, name.removeprefix("confinement_")) for curve in curves.values()]
        data[name] = (("run",), np.asarray(ends), {"long_name": long_name, "units": "1"})
    coordinates = {"run": list(curves), **{name: ("run", list(values)) for name, values in labels.items()}}
    return xarray.Dataset(data, coordinates, dict(attributes)).set_coords(STRAIN)


def save_dataset(dataset: "xarray.Dataset", path: Path) -> None:
    """Write a dataset as NetCDF, whole or not at all. Raises OSError where the folder cannot be written."""
    write_whole(path, lambda target: dataset.to_netcdf(target, engine="scipy"))


def save_run(folder: Path, name: str, case: str, curve: Curve) -> list[Path]:
    """Write one run's curve as NetCDF and CSV; the case (JSON) and the versions go into the NetCDF."""
    import jax

    attributes = {"title": name, "case": case, "axijax": version("axijax"), "jax": jax.__version__}
    paths = [folder / f"curve.{kind}" for kind in ("nc", "csv")]
    save_dataset(curves_dataset({name: curve}, {}, attributes), paths[0])
    columns = quantities_of(curve)
    heads = [f"{column} [{about.unit.replace('1', '-')}]" for column, about in columns.items()]
    rows = zip(*(np.asarray(getattr(curve, column)).tolist() for column in columns), strict=True)
    comment = f"axijax {attributes['axijax']}, {name}: compression positive; curve.nc holds the same with the case"
    save_table(paths[1], heads, [dict(zip(heads, row, strict=True)) for row in rows], comment)
    return paths


def save_table(
    path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, object]], comment: str | None = None
) -> None:
    """Write rows as CSV, whole or not at all; None becomes an empty field. comment: a first line after a #."""

    def write(target: Path) -> None:
        with open(target, "w", newline="") as file:
            if comment is not None:
                file.write(f"# {' '.join(comment.split())}\n")
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows({name: "" if row[name] is None else row[name] for name in columns} for row in rows)

    write_whole(path, write)


@shown
@dataclass(frozen=True)
class Result:
    """What a run has left; made by `open_result`.

    path: the folder, or the curve's file.
    name: of the run.
    curve: one value a record along axial_strain, in memory; units and long names in the attributes, confinement_* as
        scalars.
    status: "running", "interrupted", "failed" or "finished".
    info: what run.json says; empty without one.
    """

    path: Path
    name: str
    curve: "xarray.Dataset"
    status: str
    info: Mapping[str, Any]

    def _card(self) -> Card:
        peak, strain = peak_of(self.curve), self.curve[STRAIN].values
        rows = {
            "status": self.status,
            "axial strain": f"to {per_cent(strain[-1])}",
            "records": str(strain.size),
            "peak stress ratio [-]" if peak.reached else "largest stress ratio so far [-]": peak.value,
            "at axial strain": per_cent(peak.axial_strain),
            "path": str(self.path),
        }
        ratio = self.curve.stress_ratio.values
        picture = line_picture(100 * strain, ratio, "axial strain [%]", "stress ratio s1/s3 [-]")
        return Card(f"Result {self.name}", rows, picture)

    @cached_property
    def case(self) -> "Case":
        """The case, every value filled in. Raises ValueError where none was kept, or it is damaged."""
        from axijax.app.case import Case, load_case

        if (self.path / "case.toml").is_file():
            return load_case(self.path / "case.toml")
        kept = self.curve.attrs.get("case")
        if kept is None:
            raise ValueError(f"result '{self.path}' keeps no case, only curves: use the folder that `axijax run` made.")
        try:
            return Case.model_validate_json(kept)
        except ValueError:
            raise ValueError(
                f"result '{self.path}': the case in its curve.nc is of another version of axijax; run the test again."
            ) from None

    @cached_property
    def test(self) -> TriaxialTest:
        """The test, built again from the case, with the very balls that were tested where they are random or from a
        file. Raises ValueError as `case` does, or where that specimen is lost.
        """
        from axijax.app.case import GIVEN
        from axijax.app.specimen_file import NAME, load_specimen

        given = self.case.specimen.kind in GIVEN
        return self.case.build(load_specimen(self.path / NAME, self.case) if given else None)

    @property
    def has_state(self) -> bool:
        """Whether the last state was kept, so that `progress` can be read."""
        return (self.path / "checkpoint.npz").is_file()

    @cached_property
    def progress(self) -> "Progress":
        """The last state with its contact list, membrane and records. Raises ValueError where there is none."""
        from axijax.triaxial.checkpoint import load_progress

        path = self.path / "checkpoint.npz"
        if not self.has_state:
            raise ValueError(
                f"result '{self.path}' holds no last state (checkpoint.npz): only its curves can be shown; run the "
                "case again to see the balls."
            )
        return load_progress(path, self.test)


def open_result(path: str | Path) -> Result:
    """Read the folder of a run, or one run's curve.nc.

    A run that has not finished has the curve up to its last checkpoint, or to where it went wrong.

    Raises ValueError, saying what is the matter, where there is no such result, it is damaged, or it has no curve yet.
    """
    results = open_results(path)
    if len(results) > 1:
        names = ", ".join(result.name for result in results)
        raise ValueError(f"result '{path}' holds {len(results)} runs ({names}): read it with open_results.")
    return results[0]


def open_results(path: str | Path) -> list[Result]:
    """Read the folder of a run or a batch, or a file of curves, which may hold several runs (table1's curves.nc does).

    Of a batch the members that have finished, what distinguishes them as scalar coordinates of their curves.

    Raises ValueError as `open_result` does.
    """
    path = Path(path)
    if path.is_file():
        return [Result(path, name, curve, "finished", {}) for name, curve in _read_curves(path)]
    if not path.is_dir():
        raise ValueError(f"result '{path}' does not exist: give the folder that `axijax run` made, or its curve.nc.")
    if (path / MEMBERS).is_dir():
        return _read_members(path)
    info = read_info(path)
    # A run that went wrong keeps its curve, faulty end and all, under another name.
    kept = [path / name for name in ("curve.nc", "partial_curve.nc") if (path / name).is_file()]
    if kept:
        status = info.get("status", "finished" if kept[0].name == "curve.nc" else "failed")
        return [Result(path, _name(path), curve, status, info) for _, curve in _read_curves(kept[0])]
    if not info and not (path / "checkpoint.npz").is_file():
        raise ValueError(
            f"'{path}' is no result: it holds none of curve.nc, run.json and checkpoint.npz; give the folder that "
            "`axijax run` made."
        )
    status = info.get("status", "interrupted")
    if not (path / "checkpoint.npz").is_file():
        raise ValueError(
            f"result '{path}' is {status} and has neither a curve nor a checkpoint: run the case again"
            + (f" ({info['message']})." if info.get("message") else ".")
        )
    import xarray

    result = Result(path, _name(path), xarray.Dataset(), status, info)
    progress = result.progress
    if progress.records.height.size == 0:
        way_on = f"go on with `axijax resume {path}`" if info else "its run.json is lost too, so run the case again"
        raise ValueError(
            f"result '{path}' is {status} and was confined but not sheared, so it has no curve yet: {way_on}."
        )
    curve = curve_of(progress, result.test.axial_strain)
    dataset = _along_strain(curves_dataset({result.name: curve}, {}, {}).isel(run=0, drop=True))
    complete = Result(path, result.name, dataset, status, info)
    complete.__dict__.update(case=result.case, test=result.test, progress=progress)
    return [complete]


def _name(folder: Path) -> str:
    return printable(folder.resolve().name)


def read_info(folder: Path, needed: Sequence[str] = ("status",)) -> dict[str, Any]:
    """What run.json says, empty where there is none. Raises ValueError where it is damaged, or lacks what is needed."""
    path = Path(folder) / "run.json"
    if not path.is_file():
        return {}
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError("too long")
        info = json.loads(path.read_text(encoding="utf-8"))
        wrong = "it is no object" if not isinstance(info, dict) else _mistyped(info, needed)
    except (OSError, ValueError, RecursionError):
        wrong = "it is no JSON"
    if wrong:
        raise ValueError(f"result '{folder}': its run.json is damaged ({wrong}); run the case again, with --overwrite.")
    return info


MOST_BYTES = 10**7  # of a run.json; a long one has a few thousand

# What run.json holds, and how each must be.
INFO: dict[str, tuple[Callable[[Any], bool], str]] = {
    "status": (lambda v: isinstance(v, str) and v in STATUSES, f"one of {', '.join(STATUSES)}"),
    "name": (lambda v: isinstance(v, str), "a text"),
    "message": (lambda v: isinstance(v, str), "a text"),
    "seconds": (lambda v: _is_number(v) and 0 <= v < 1e12, "a number of seconds"),
    "axial_strain": (lambda v: _is_number(v) and -1 < v < 1, "a strain"),
    "resumed": (lambda v: isinstance(v, int) and _is_number(v) and 0 <= v < 10**9, "a whole number"),
    "full": (lambda v: isinstance(v, bool), "true or false"),
    "snapshots": (lambda v: isinstance(v, int) and _is_number(v) and 0 <= v <= MOST_SNAPSHOTS, "a whole number"),
}
MOST_SNAPSHOTS = 100_000
# What a run needs to be resumed; the rest is only there where it was asked for.
NEEDED = tuple(name for name in INFO if name != "full")


def _is_number(value) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _mistyped(info: Mapping[str, Any], needed: Sequence[str]) -> str:
    """What of run.json is not there, or not what it must be; empty where all is well."""
    for name, (fits, allowed) in INFO.items():
        if name not in info and name in needed:
            return f"'{name}' is missing"
        if name in info and not fits(info[name]):
            return f"'{name}' must be {allowed}"
    return ""


def _along_strain(curve: "xarray.Dataset") -> "xarray.Dataset":
    """One run with the axial strain for its dimension, by which xarray draws and selects."""
    return curve.set_coords(STRAIN).swap_dims(record=STRAIN)


def snapshots_folder(full: bool) -> str:
    """Where a run's snapshots go: those of the whole cylinder to a folder of their own."""
    return SNAPSHOTS[full]


def member_files(folder: Path) -> list[Path]:
    """Finished members of a batch; a name that begins with a dot is being written, or was when its process died."""
    return sorted((folder / MEMBERS).glob("[!.]*.nc"))


def _read_members(path: Path) -> list[Result]:
    """The members of a batch that have finished, by number."""
    files = member_files(path)
    if not files:
        raise ValueError(f"result '{path}' is a batch of which no member has finished yet.")
    results = [Result(path, name, curve, "finished", {}) for file in files for name, curve in _read_curves(file)]
    return sorted(results, key=lambda result: list(numbers_beside(result.curve).values()))


def numbers_beside(curve: "xarray.Dataset") -> dict[str, float]:
    """The numbers by which a file of several curves, such as a batch's, tells this one from the others."""
    return {
        str(name): each.item() for name, each in curve.coords.items() if not each.ndim and each.dtype.kind in "fi"
    }


def _read_curves(path: Path) -> list[tuple[str, "xarray.Dataset"]]:
    import xarray

    runs: list[tuple[str, xarray.Dataset]] = []
    lacking = ""
    try:
        with xarray.open_dataset(path, engine="scipy") as file:
            curves = file.load()
        if "member" in curves.dims:
            curves = curves.rename(member="run")
        labels = json.loads(curves.attrs.get("labels", "[]"))
        names = [str(name) for name in curves["run"].values]
        held = quantities_of(curves)
        missing = next((name for name in held if name not in curves), None)
        lacking = f", or of another version (it lacks {missing})" if missing else ""
        known = all(curves[name].dims == ("run", "record") for name in held)
        numbers = [*held, *(name for name in CONFINEMENT if name in curves)]
        known = known and all(curves[name].dtype.kind in "fi" for name in numbers)
        for number, name in enumerate(names if known else ()):
            run = curves.isel(run=number)
            run = run.drop_vars([each for each in run.coords if not run[each].ndim and each not in labels])
            runs.append((name, _along_strain(run.isel(record=np.isfinite(run[STRAIN].values)))))
    except Exception:  # the readers of SciPy and xarray raise whatever a damaged file leads them to
        known = False
    if not known or not runs or not all(run.sizes[STRAIN] for _, run in runs):
        raise ValueError(
            f"result '{path}' is damaged or no file of curves of axijax (NetCDF){lacking}: run the case again."
        )
    return runs
