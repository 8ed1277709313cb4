"""Whether the arrays of a checkpoint can be those of a test: lengths, types, numbers that are finite, indices that
point somewhere, strains that a shear can have reached."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

# The lengths of the arrays, as the docstrings of ContactList, Membrane, State and Progress state them: N balls, C
# contacts, K slots, Z balls of the membrane's zone, T triangles, R records. Arrays that are not named here are held to
# the number of dimensions of the test's own.
LENGTHS: dict[str, tuple[tuple[str | int, ...], ...]] = {
    r"network\.(first|second|image|cos|sin|branch\..|distance|overlap|share)": (("C",),),
    r"network\.pair_cube": ((), ("C",)),
    r"network\.(slot|side|slot_cos|slot_sin)": (("K", "N"),),
    r"network\.(positions\..|radius|weight|free\..|mass_factor)": (("N",),),
    r"membrane\.(zone|angle|share|counted)": (("Z",),),
    r"membrane\.direction": ((2, "Z"),),
    r"membrane\.(corner|turn_sign|turn_shift|flip_sign|flip_bottom|flip_top|owned|edge)": ((3, "T"),),
    r"membrane\.edge_inside": (("3T",),),
    r"membrane\.surface\.made": (("N",),),
    r"state\.(displacement|velocity|spin)\..": (("N",),),
    r"state\.memory\[\d+\]\.contact\..*": (("C",),),
    r"state\.memory\[\d+\]\.ball.*": (("N",),),
    r"state\.platen(s|_speeds)": ((2,),),
    r"records\..*": (("R",),),
    r"fixed\.lateral": (("N",), (2, "N")),
    r"fixed\.axial": (("N",),),
    r"fixed\.ends": ((2,),),
    r"params\.material\.friction": ((), ("N",)),
}

# Where arrays of indices point, and from where on.
INDICES = {
    r"network\.(first|second)": (0, "N"),
    r"network\.slot": (0, "C"),
    r"membrane\.zone": (0, "N"),
    r"membrane\.corner": (0, "Z"),
    r"membrane\.edge": (0, "3T"),
}

# Records that a specimen with an empty core does not have.
MAY_BE_NAN = ("records.core_ratio", "records.void_ratio")


def what_is_wrong(
    arrays: Mapping[str, np.ndarray], template: Mapping[str, Any], numbers: Any, balls: int, record_every: int
) -> str:
    """What shows that these arrays are no progress of the test, for the middle of a sentence; empty where nothing does.

    arrays, template: by the same names, as read, and as the test makes them. numbers: names of those that were Python's
    numbers, whatever stands there.
    """
    if not isinstance(numbers, list) or not all(isinstance(name, str) and name in arrays for name in numbers):
        return "its header names numbers that it does not hold"
    lengths: dict[str | int, int] = {"N": balls}
    for name, array in arrays.items():
        wrong = _wrong_array(name, array, template[name], name in numbers, lengths)
        if wrong:
            return f"'{name}' {wrong}"
    for name, array in arrays.items():
        for pattern, (least, what) in INDICES.items():
            if re.fullmatch(pattern, name) and array.size and not (least <= array.min() <= array.max() < lengths[what]):
                return f"'{name}' points to what does not exist"
    return _wrong_values(arrays, record_every)


def _wrong_array(name: str, array: np.ndarray, own: Any, is_number: bool, lengths: dict[str | int, int]) -> str:
    was_number = isinstance(own, int | float)
    group = name.split(".")[0]
    as_many: tuple[Any, ...] = (None,) * np.ndim(own)
    allowed = next((shapes for pattern, shapes in LENGTHS.items() if re.fullmatch(pattern, name)), (as_many,))
    if (is_number and array.shape != ()) or (was_number and not is_number and group not in ("params", "fixed")):
        return "is no number"
    if not any(_fits(array.shape, shape, lengths) for shape in allowed):
        return f"has shape {array.shape}, which does not fit the others"
    kind = np.asarray(own).dtype
    if group in ("params", "records", "fixed", "confinement"):
        if array.dtype.kind not in ("fi" if group != "records" else "f"):
            return f"holds {array.dtype}, no numbers"
    elif array.dtype.kind != kind.kind or (not was_number and array.dtype != kind):
        return f"holds {array.dtype} where the test has {kind}"
    if name not in MAY_BE_NAN and array.dtype.kind == "f" and not np.isfinite(array).all():
        return "holds numbers that are not finite"
    return ""


def _fits(found: tuple[int, ...], shape: tuple, lengths: dict[str | int, int]) -> bool:
    """Whether a shape is as long as its letters say; a letter that is met for the first time takes its length."""
    if len(found) != len(shape):
        return False
    for size, letter in zip(found, shape, strict=True):
        if letter == "T":
            lengths.setdefault("3T", 3 * size)
        if letter is not None and size != (letter if isinstance(letter, int) else lengths.setdefault(letter, size)):
            return False
    return True


def _wrong_values(arrays: Mapping[str, np.ndarray], record_every: int) -> str:
    """Heights and counts that no shear can have."""
    bottom, top = (float(height) for height in arrays["state.platens"])
    height, heights = float(arrays["height"]), arrays["records.height"]
    most = 2 if "state.loading.stage" in arrays else 1.001  # stages may lengthen a specimen
    if not (height > 0 and 0 < top - bottom <= most * height):
        return "its platens are where no shear moves them"
    if heights.size and not (abs(heights[0] / height - 1) < 1e-3 and heights.min() > 0):
        return "its records do not begin at its height"
    if not 0 <= int(arrays["due"]) <= record_every or int(arrays["taken"]) < 0:
        return "its counts are those of no shear"
    return ""
