"""What a run may replace in its folder: what a run has written there, and nothing else.

A run writes run.json before anything else, and only begins where no file has the name of one of its own. So beside a
run.json of axijax these names are a run's, and without one they are somebody else's, who may not have a copy.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from axijax.app.paraview import is_snapshot_file
from axijax.app.results import SNAPSHOTS, STATUSES
from axijax.app.specimen_file import NAME
from axijax.core.files import remove_leftovers, write_whole

CURVES = ("curve.nc", "curve.csv", "curve.png", "partial_curve.nc")
# In the order in which they are removed: what is left at any moment tells no more than is true.
FILES = (*CURVES, "checkpoint.npz", "case.toml", NAME)
PICTURES, REPORT = "pictures", "report.html"  # where `axijax plot` and `axijax report` write by default
SHOWN = 20  # names in a sentence


def refuse_to_lose(folder: Path, overwrite: bool) -> None:
    """Raise ValueError where a run that begins in a folder would replace something that it may not, saying what."""
    own, others = _contents(folder)
    info = _run_info(folder)
    if info is None:
        own += [name for name in ("run.json",) if (folder / name).exists()]
        if own:
            raise ValueError(
                f"output folder '{folder}' holds {_listed(own)} but no sound run.json, by which axijax knows what it "
                "wrote: these are not replaced, --overwrite or not; move them away, or choose another --output."
            )
        return
    status = info["status"]
    hardly_begun = status in ("running", "interrupted") and not set(own) & {"case.toml", "checkpoint.npz", *CURVES}
    if overwrite or hardly_begun:
        return
    way = f"choose another --output, or --overwrite{f', which leaves {_listed(others)} as they are' if others else ''}"
    held = {"finished": "a finished result", "failed": "a failed run"}.get(status)
    if held:
        raise ValueError(f"output folder '{folder}' already holds {held}: {way}.")
    raise ValueError(
        f"output folder '{folder}' already holds an unfinished run: `axijax resume {folder}` goes on with it; or {way}."
    )


def clear(folder: Path) -> None:
    """Remove what another run has written into a folder, but for its run.json, which says meanwhile that it goes."""
    info = _run_info(folder)
    if info is None:
        return
    about = {**info, "status": "interrupted", "message": "another run was about to take its place"}
    write_whole(folder / "run.json", lambda target: target.write_text(json.dumps(about, indent=2) + "\n"))
    own, _ = _contents(folder)
    for name in own:
        (folder / name).unlink(missing_ok=True)
    for name in SNAPSHOTS:
        if (folder / name).is_dir():
            remove_leftovers(folder / name)
            if not any((folder / name).iterdir()):
                (folder / name).rmdir()


def remove_stale(folder: Path) -> list[str]:
    """Remove what `axijax plot` and `axijax report` make of a result by default, which a run that goes on would leave
    behind; the names."""
    names = [REPORT]
    if (folder / PICTURES).is_dir():
        from axijax.app.plot import KNOWN  # Matplotlib only where it has drawn

        names += [f"{PICTURES}/{kind}.{end}" for kind, end in KNOWN.items()]
    stale = [name for name in names if (folder / name).is_file()]
    for name in stale:
        (folder / name).unlink()
    return stale


def _contents(folder: Path) -> tuple[list[str], list[str]]:
    """Names in a folder that a run gives, but for run.json, and all the others."""
    own = [name for name in FILES if (folder / name).exists()]
    others = [path.name for path in folder.iterdir() if path.name not in (*FILES, "run.json", *SNAPSHOTS)]
    for part in SNAPSHOTS:
        if (folder / part).is_dir():
            for path in sorted((folder / part).iterdir()):
                (own if is_snapshot_file(path.name) else others).append(f"{part}/{path.name}")
        elif (folder / part).exists():
            others.append(part)
    return own, sorted(others)


def _run_info(folder: Path) -> dict[str, Any] | None:
    """What run.json says, where it is one of axijax."""
    try:
        info = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    known = isinstance(info, dict) and info.get("status") in STATUSES and {"axijax", "command"} <= set(info)
    return info if known else None


def _listed(names: Sequence[str]) -> str:
    shown, more = names[:SHOWN], len(names) - SHOWN
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
