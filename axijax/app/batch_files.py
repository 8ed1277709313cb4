"""The folder of a batch: one NetCDF file a member, written whole, and a table of them all.

A file carries the fingerprint of the test, the parameters and the versions that it came from, by which a batch that is
run again knows what is done. Nothing else is kept about a batch, so any number of processes may fill one folder.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from axijax.app.results import MEMBERS, curves_dataset, member_files, save_dataset, save_table
from axijax.core.files import remove_leftovers, writable_folder, write_whole
from axijax.core.fingerprint import differences, fingerprint, versions
from axijax.core.quantity import values_of
from axijax.mechanics.params import Params
from axijax.triaxial.peak import at_peak, peak_of
from axijax.triaxial.records import Confinement, Curve, records_of
from axijax.triaxial.test import TriaxialTest

if TYPE_CHECKING:
    import xarray

FAILED = ".failed.json"
SUMMARY = "summary.csv"
READ_ERRORS = (OSError, TypeError, ValueError, KeyError, IndexError, AttributeError, EOFError, MemoryError)
PEAK = (
    "peak_ratio", "peak_error", "core_ratio_at_peak", "virial_ratio_at_peak", "axial_strain_at_peak", "peak_reached",
)  # fmt: skip


@dataclass(frozen=True)
class Stored:
    """A member as its file holds it."""

    name: str
    test: TriaxialTest
    params: Params
    labels: dict[str, Any]
    curve: Curve | None = None
    seconds: float = 0.0
    ended: str = ""

    def one(self) -> "xarray.Dataset":
        """Its curve with dimension record, and everything else as scalar coordinates and attributes."""
        assert self.curve is not None
        curve = self.curve
        peak = peak_of(curve)
        there: list[float | bool] = [
            peak.stress_ratio, np.nan if peak.error is None else peak.error, at_peak(curve, peak, "core_ratio"),
            at_peak(curve, peak, "virial_ratio"), peak.axial_strain, peak.reached,
        ]  # fmt: skip
        scalars = {name: float(value) for name, value in values_of(self.params).items() if np.ndim(value) == 0}
        # A label says what was asked for; a parameter of the same name is the same number.
        about = scalars | self.labels | dict(zip(PEAK, there, strict=True)) | {"seconds": self.seconds}
        attributes = {
            "identity": json.dumps(identity(self.test, self.params)),
            "labels": json.dumps(list(self.labels)),
            "confinement": json.dumps([float(value) for value in curve.confinement]),
            **({"ended": self.ended} if self.ended else {}),
            **versions(),
        }
        data = curves_dataset({self.name: curve}, {name: [value] for name, value in about.items()}, attributes)
        return data.rename(run="member")

    @staticmethod
    def dataset(members: Sequence["Stored"]) -> "xarray.Dataset":
        return joined([member.one() for member in members])


def joined(datasets: Sequence["xarray.Dataset"]) -> "xarray.Dataset":
    """Members' datasets as one with dimensions (member, record), padded with NaN; attributes that all share."""
    import xarray

    if not datasets:
        return xarray.Dataset(coords={"member": np.array([], str)})
    longest = max(data.sizes["record"] for data in datasets)
    # A label that only some members have is NaN, or an empty text, for the others.
    absent = {
        name: "" if label.dtype.kind in "OSU" else np.nan for data in datasets for name, label in data.coords.items()
    }
    padded = []
    for data in datasets:
        lacking = {name: ("member", [empty]) for name, empty in absent.items() if name not in data.coords}
        padded.append(data.pad(record=(0, longest - data.sizes["record"])).assign_coords(lacking))
    return xarray.concat(padded, dim="member", join="outer", combine_attrs="drop_conflicts")


def open_folder(folder: Path) -> Path:
    """Make a batch's folder where there is none. Raises ValueError where it cannot be written, or where it holds a
    summary.csv that no batch wrote.
    """
    remove_leftovers(writable_folder(folder) / MEMBERS)
    summary = folder / SUMMARY
    if summary.exists():
        with open(summary, errors="replace") as file:
            ours = file.readline().startswith("member,")
        if not ours:
            raise ValueError(f"output folder '{folder}' holds a {SUMMARY} that no batch wrote: choose another folder.")
    return folder


def open_batch(folder: Path | str) -> "xarray.Dataset":
    """All finished members of a batch's folder, sorted by their labels, numbers as numbers: curves over (member,
    record), axial_strain among the coordinates, labels, parameters and peaks over (member,).

        open_batch("sweep").stress_ratio.plot.line(x="axial_strain", hue="member")

    Raises ValueError where there are none.
    """
    files = member_files(Path(folder))
    if not files:
        raise ValueError(f"folder '{folder}' holds no finished member of a batch.")
    return joined(sorted(map(_load, files), key=_place))


def read_member(folder: Path, wanted: Stored) -> Stored | None:
    """A member that is done, or None. Raises ValueError where the file of that name is of something else."""
    file = _file(folder, wanted.name)
    if not file.exists():
        return None
    data = _load(file)
    other = differences(identity(wanted.test, wanted.params), _identity_in(file, data))
    if other:
        raise ValueError(
            f"member '{wanted.name}': '{file}' is of another test or other parameters: it differs in {other}; choose "
            "another folder, or delete it."
        )
    unbalanced, stress_error, steps = json.loads(data.attrs["confinement"])
    records: dict[str, Any] = {name: data[name].values[0] for name in records_of(data)} | {"status": np.int32(0)}
    confinement = Confinement._make(map(np.asarray, (unbalanced, stress_error, int(steps))))
    curve = Curve(**records, confinement=confinement)
    return replace(wanted, curve=curve, seconds=float(data.seconds.values[0]), ended=str(data.attrs.get("ended", "")))


def write_member(folder: Path, member: Stored) -> None:
    """Write a member's file, whole or not at all; an earlier failure of it is forgotten."""
    file = _file(folder, member.name)
    file.parent.mkdir(exist_ok=True)
    save_dataset(member.one(), file)
    file.with_suffix(FAILED).unlink(missing_ok=True)


def write_failure(folder: Path, name: str, failure: str) -> None:
    """Note why a member has no result, so that the summary of all processes can say so."""
    file = _file(folder, name).with_suffix(FAILED)
    file.parent.mkdir(exist_ok=True)
    write_whole(file, lambda target: target.write_text(json.dumps({"member": name, "failure": failure})))


def write_summary(folder: Path) -> None:
    """Write summary.csv: a row a member, with labels, peak and time, or why it failed; and where a stage could not be
    followed to its end, why.

    Of several processes each writes it at its end and looks whether another has added something meanwhile, so that
    the last one's is complete.
    """
    while True:
        files, failed = member_files(folder), sorted((folder / MEMBERS).glob(f"[!.]*{FAILED}"))
        rows: list[dict[str, Any]] = []
        names: dict[str, None] = {}
        for data in sorted(map(_load, files), key=_place):
            labels = json.loads(data.attrs["labels"])
            names |= dict.fromkeys(labels)
            values = {name: data[name].values.tolist()[0] for name in (*labels, *PEAK, "seconds")}
            ended = {"ended": data.attrs["ended"]} if data.attrs.get("ended") else {}
            rows.append({"member": str(data.member.values[0]), **values, **ended})
        rows += [json.loads(file.read_text()) for file in failed]
        some_ended = ["ended"] if any("ended" in row for row in rows) else []
        columns = ("member", *names, *PEAK, "seconds", *some_ended, "failure")
        save_table(folder / SUMMARY, columns, [dict.fromkeys(columns) | row for row in rows])
        if (files, failed) == (member_files(folder), sorted((folder / MEMBERS).glob(f"[!.]*{FAILED}"))):
            return


def slug(name: str) -> str:
    """A member's name as a file's: letters, digits and + - . = _ stay."""
    return re.sub(r"[^\w+.=-]+", "_", name).strip("._") or "member"


def identity(test: TriaxialTest, params: Params) -> dict[str, str]:
    """All that decides a curve: the test, the parameters of this member, the versions of axijax and jax."""
    return {**versions(), **fingerprint(test), **fingerprint(params, "parameters")}


def _place(data: "xarray.Dataset") -> list[list[tuple[int, float, str]]]:
    """By what a member is sorted: its labels in their order, numbers before texts, and then its name."""
    labels = [data[name].values.tolist()[0] for name in json.loads(data.attrs["labels"])]
    parts = [*labels, str(data.member.values[0])]
    return [natural(part) if isinstance(part, str) else [(0, float(part), "")] for part in parts]


def natural(text: str) -> list[tuple[int, float, str]]:
    """A text as a key that sorts the numbers in it as numbers: 'seed=2' before 'seed=10'."""
    parts = re.split(r"(\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)", text)
    return [(0, float(part), "") if place % 2 else (1, 0.0, part) for place, part in enumerate(parts)]


def _identity_in(file: Path, data: "xarray.Dataset") -> Any:
    try:
        return json.loads(data.attrs["identity"])
    except (KeyError, TypeError, ValueError, RecursionError):
        raise ValueError(f"'{file}' is damaged, or a member that another version wrote: delete it.") from None


def _file(folder: Path, name: str) -> Path:
    return folder / MEMBERS / f"{slug(name)}.nc"


def _load(file: Path) -> "xarray.Dataset":
    import xarray

    try:
        data = xarray.load_dataset(file, engine="scipy")
        sound = all(data[name].dims == ("member", "record") for name in records_of(data)) and data.sizes["member"] == 1
        labels, confinement = (json.loads(data.attrs[name]) for name in ("labels", "confinement"))
        sound = sound and all(data[name].dims == ("member",) for name in (*labels, *PEAK, "seconds"))
        sound = sound and len(confinement) == len(Confinement._fields) and np.isfinite(confinement).all()
    except READ_ERRORS:
        sound = False
    if not sound:
        raise ValueError(f"'{file}' is damaged, or no member of a batch of this version of axijax: delete it.")
    return data
