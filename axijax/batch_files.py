"""The folder of a batch: one NetCDF file a member, written whole, and a table of them all.

A file carries a hash of the test, the parameters and the versions that it came from, by which a batch that is run again
knows what is done. Nothing else is kept about a batch, so any number of processes may fill one folder.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from axijax.curve import RECORDS, Confinement, Curve
from axijax.params import Params
from axijax.quantity import values_of
from axijax.results import curves_dataset, save_dataset, save_table, write_whole
from axijax.triaxial import TriaxialTest

if TYPE_CHECKING:
    import xarray

MEMBERS = "members"  # the folder of the members' files
FAILED = ".failed.json"
PEAK = ("peak_ratio", "core_ratio_at_peak", "virial_ratio_at_peak", "axial_strain_at_peak")


@dataclass(frozen=True)
class Stored:
    """A member as its file holds it."""

    name: str
    test: TriaxialTest
    params: Params
    labels: dict[str, Any]
    curve: Curve | None = None
    seconds: float = 0.0

    def one(self) -> "xarray.Dataset":
        """Its curve with dimension record, and everything else as scalar coordinates and attributes."""
        assert self.curve is not None
        curve = self.curve
        peak = int(np.argmax(np.asarray(curve.stress_ratio)))
        at_peak = [
            float(getattr(curve, n)[peak]) for n in ("stress_ratio", "core_ratio", "virial_ratio", "axial_strain")
        ]
        scalars = {name: float(value) for name, value in values_of(self.params).items() if np.ndim(value) == 0}
        # A label says what was asked for; a parameter of the same name is the same number.
        about = scalars | self.labels | dict(zip(PEAK, at_peak, strict=True)) | {"seconds": self.seconds}
        attributes = {
            "key": key(self.test, self.params),
            "labels": json.dumps(list(self.labels)),
            "confinement": json.dumps([float(value) for value in curve.confinement]),
            "axijax": version("axijax"),
            "jax": jax.__version__,
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


def open_batch(folder: Path | str) -> "xarray.Dataset":
    """All finished members of a batch's folder, sorted by name: curves over (member, record), labels, parameters and
    peaks over (member,). Raises ValueError where there are none.
    """
    files = _files(Path(folder))
    if not files:
        raise ValueError(f"folder '{folder}' holds no finished member of a batch.")
    return joined([_load(file) for file in files])


def read_member(folder: Path, wanted: Stored) -> Stored | None:
    """A member that is done, or None. Raises ValueError where the file of that name is of something else."""
    file = _file(folder, wanted.name)
    if not file.exists():
        return None
    data = _load(file)
    if data.attrs.get("key") != key(wanted.test, wanted.params):
        raise ValueError(
            f"member '{wanted.name}': '{file}' is of another test, other parameters or another version (axijax "
            f"{data.attrs.get('axijax')}, jax {data.attrs.get('jax')}): choose another folder, or delete it."
        )
    unbalanced, stress_error, steps = json.loads(data.attrs["confinement"])
    records: dict[str, Any] = {name: data[name].values[0] for name in RECORDS} | {"status": np.int32(0)}
    confinement = Confinement._make(map(np.asarray, (unbalanced, stress_error, int(steps))))
    curve = Curve(**records, confinement=confinement)
    return replace(wanted, curve=curve, seconds=float(data.seconds.values[0]))


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
    """Write summary.csv: a row a member, with labels, peak and time, or why it failed.

    Of several processes each writes it at its end and looks whether another has added something meanwhile, so that
    the last one's is complete.
    """
    while True:
        files, failed = _files(folder), sorted((folder / MEMBERS).glob(f"[!.]*{FAILED}"))
        rows: list[dict[str, Any]] = []
        names: dict[str, None] = {}
        for data in map(_load, files):
            labels = json.loads(data.attrs["labels"])
            names |= dict.fromkeys(labels)
            values = {name: data[name].values[0].item() for name in (*labels, *PEAK, "seconds")}
            rows.append({"member": str(data.member.values[0]), **values})
        rows += [json.loads(file.read_text()) for file in failed]
        columns = ("member", *names, *PEAK, "seconds", "failure")
        save_table(folder / "summary.csv", columns, [dict.fromkeys(columns) | row for row in rows])
        if (files, failed) == (_files(folder), sorted((folder / MEMBERS).glob(f"[!.]*{FAILED}"))):
            return


def slug(name: str) -> str:
    """A member's name as a file's: letters, digits and + - . = _ stay."""
    return re.sub(r"[^\w+.=-]+", "_", name).strip("._") or "member"


def key(test: TriaxialTest, params: Params) -> str:
    """A hash of all that decides a curve: the test, the parameters, the versions of axijax and jax."""
    digest = hashlib.sha256(f"{version('axijax')} {jax.__version__}".encode())
    _feed(digest, (test, params))
    return digest.hexdigest()


def _feed(digest, value) -> None:
    """Add a value and its type's name to a hash; of a dataclass the fields that it is made from."""
    if is_dataclass(value) and not isinstance(value, type):
        _feed(digest, [type(value).__name__, {f.name: getattr(value, f.name) for f in fields(value) if f.init}])
    elif isinstance(value, str | bool | type | None):
        digest.update(f"{value!r};".encode())
    elif isinstance(value, int | float | np.ndarray | np.generic | jax.Array):
        array = np.asarray(value)
        # 1, 1.0 and jnp.float64(1) are one number.
        array = array.astype(float) if array.ndim == 0 else array
        digest.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    elif isinstance(value, Mapping):
        _feed(digest, [part for item in value.items() for part in item])
    elif isinstance(value, list | tuple):
        digest.update(f"{type(value).__name__}[{len(value)}".encode())
        for part in value:
            _feed(digest, part)
    else:
        raise TypeError(f"a test with a {type(value).__name__} in it cannot be recognised again: leave out the folder.")


def _file(folder: Path, name: str) -> Path:
    return folder / MEMBERS / f"{slug(name)}.nc"


def _files(folder: Path) -> list[Path]:
    """Finished members; a name that begins with a dot is being written, or was when its process was killed."""
    return sorted((folder / MEMBERS).glob("[!.]*.nc"))


def _load(file: Path) -> "xarray.Dataset":
    import xarray

    try:
        return xarray.load_dataset(file, engine="scipy")
    except (OSError, TypeError, ValueError, KeyError) as error:
        raise ValueError(f"'{file}' is damaged or no member of a batch ({error}): delete it.") from None
