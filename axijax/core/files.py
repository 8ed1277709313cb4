"""The folder that results go to: files that are whole or not there, one run at a time, one sentence where it fails.

A file is written under a hidden name and renamed when it is whole. What a killed process had begun stays behind under
its hidden name; whoever takes the folder next removes it, and knows by a lock what a living process is still writing.
"""

import contextlib
import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system: no locks, and what killed processes leave stays
    fcntl = None  # type: ignore[assignment]

BEGUN = ".axijax-"  # how the name of a file begins while it is written


class FolderError(OSError):
    """A folder cannot be written; says which, why, and what to do."""


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it, so that no partial file can look whole."""
    handle, temporary = _begin(path)
    try:
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
        if handle is not None:
            os.close(handle)


def _begin(path: Path) -> tuple[int | None, Path]:
    """A temporary file beside `path`, locked for as long as the handle is open."""
    while True:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f"{BEGUN}{path.stem}-", suffix=path.suffix)
        if fcntl is None:  # where an open file cannot be renamed either
            os.close(handle)
            return None, Path(name)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return handle, Path(name)
        os.close(handle)  # taken for a leftover between being made and being locked


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes had begun to write into a folder; what a living one is writing stays."""
    if fcntl is None:
        return
    for path in folder.glob(f"{BEGUN}*"):
        with contextlib.suppress(OSError):
            handle = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
            finally:
                os.close(handle)


def writable_folder(path: Path) -> Path:
    """Make a folder for results, and make sure that it can be written before anything is computed.

    Raises ValueError, with the reason, where it cannot.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path, prefix=BEGUN):
            pass
    except OSError as error:
        raise ValueError(
            f"output folder '{path}' cannot be written ({error.strerror}): choose another with --output."
        ) from None
    remove_leftovers(path)
    return path


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; a lock that the system lets go of when the process ends, however it ends.

    Raises ValueError where another process holds it.
    """
    if fcntl is None:
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
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(handle)


@contextmanager
def writing_to(folder: Path, way_on: Callable[[], str]) -> Iterator[None]:
    """Let what goes wrong with writing into a folder be a FolderError: what is the matter, what helps, and the way on.

    way_on: asked when it is needed, such as "run the case again".
    """
    try:
        yield
    except (FolderError, BrokenPipeError):  # told already; or of what is printed, not of the folder
        raise
    except OSError as error:
        reason = error.strerror or str(error)
        if not folder.is_dir():
            told = f"is gone ({reason}), removed or moved since the start: "
        elif error.errno in (errno.ENOSPC, errno.EDQUOT):
            told = f"is full ({reason}): make room there, then "
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            told = f"cannot be written ({reason}): see to its permissions, then "
        else:
            told = f"cannot be written ({reason}): see to the disk, then "
        raise FolderError(f"output folder '{folder}' {told}{way_on()}.") from None


def draw_afterwards(name: str, draw: Callable[[], object]) -> str | None:
    """Draw a picture of what has been written already: None, or a sentence that says why it is missing.

    Whatever goes wrong in a picture, the numbers that it shows are not to be lost for it.
    """
    try:
        draw()
    except Exception as error:
        return f"{name} could not be drawn ({str(error).rstrip('.') or type(error).__name__})"
    return None


def printable(name: str) -> str:
    """A file's name as text that every file and terminal takes: bytes that are no UTF-8 become question marks."""
    return name.encode("utf-8", "replace").decode("utf-8")
