"""NumPy's .npz archives from disk, read with mistrust: nothing is allocated that the file does not hold."""

import io
import math
import zipfile
from pathlib import Path

import numpy as np


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an archive that `numpy.savez` wrote, by name; each is checked against its checksum.

    `numpy.load` makes room for as much as an array's header claims before it looks for the numbers, be it 800 GB.

    Raises OSError where the file cannot be opened, and ValueError where it is damaged or no such archive.
    """
    size = Path(path).stat().st_size
    with open(path, "rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                members = archive.infolist()
                if any(each.compress_type != zipfile.ZIP_STORED or each.file_size > size for each in members):
                    raise ValueError("a member that is larger than the file")
                return {each.filename.removesuffix(".npy"): _array(archive.read(each)) for each in members}
        except OSError as error:
            raise ValueError(f"an archive that cannot be read ({error})") from None
        except Exception as error:  # zipfile raises whatever a damaged archive leads it to
            raise ValueError(f"no archive of arrays ({error})") from None


def _array(content: bytes) -> np.ndarray:
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, fortran, kind = np.lib.format.read_array_header_1_0(file)
    else:
        shape, fortran, kind = np.lib.format.read_array_header_2_0(file)
    numbers = content[file.tell() :]
    if kind.hasobject or kind.itemsize == 0 or math.prod(shape) * kind.itemsize != len(numbers):
        raise ValueError("an array that is not as long as its header says")
    return np.frombuffer(numbers, kind).reshape(shape, order="F" if fortran else "C").copy()
