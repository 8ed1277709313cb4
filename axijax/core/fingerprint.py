"""What a test is, as named parts, so that what was computed from it is not taken for another test's.

    parts = fingerprint(test)                   # {"sector.order": "4.0", "specimen.positions": "float64(3, 427) 1c.."}
    differences(fingerprint(other), parts)      # "sector.boundary ('rigid' here, 'periodic' there)"

A checkpoint, a member of a batch and the log of a fit keep these parts and are refused where one differs. Nothing is
named here: every field from which an object is made counts, at any depth, and the numbers that it derives from them by
a rule of this program, which it names in `derived`: a change of the rule, such as that of the time step, makes another
test, and a number that is given makes the same test as the rule that would have given it.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from types import CodeType
from typing import Any

import jax
import numpy as np

SHOWN = 3  # parts that a sentence names; the rest are counted


def fingerprint(value: Any, name: str = "") -> dict[str, str]:
    """The parts of a test, or of anything that is made of dataclasses, numbers, arrays and functions; by dotted names.

    name: what the names of the parts begin with. Single numbers and words stand as they are, arrays and functions as a
    hash. 1, 1.0 and a 0-dimensional array of 1 are one number.

    Raises ValueError where there is something in it that cannot be recognised again.
    """
    parts: dict[str, str] = {}
    try:
        _add(parts, name, value)
    except RecursionError:
        raise ValueError(
            f"a {type(value).__name__} that holds itself cannot be recognised again, so nothing that is computed from "
            "it can be kept: leave out the file or folder."
        ) from None
    return parts


def versions() -> dict[str, str]:
    """The versions of axijax and jax, as parts."""
    return {package: _version(package) for package in ("axijax", "jax")}


def differences(here: Mapping[str, str], there: Any) -> str:
    """What differs between two fingerprints, for the middle of a sentence; empty where nothing does.

    there: what a file holds in the place of one, whatever that is.
    """
    there = there if isinstance(there, Mapping) else {}
    other = [name for name in dict.fromkeys([*here, *there]) if here.get(name) != there.get(name)]
    told = [_told(str(name), here.get(name), there.get(name)) for name in other[:SHOWN]]
    more = [f"{len(other) - SHOWN} more"] if len(other) > SHOWN else []
    return " and ".join(filter(None, [", ".join(told), *more]))


def _told(name: str, here, there) -> str:
    """One part; with both its values where they can be read."""
    readable = all(isinstance(v, str) and len(v) < 40 and v.isprintable() and " " not in v for v in (here, there))
    name = name if name.isprintable() and len(name) < 80 else "a name that makes no sense"
    return f"{name} ({here} here, {there} there)" if readable else name


def _add(parts: dict[str, str], name: str, value: Any) -> None:
    """Add a value's parts."""

    def within(inner: str) -> str:
        return f"{name}.{inner}" if name else inner

    if value is None or isinstance(value, bool | np.bool_ | str):
        parts[name] = repr(value.item() if isinstance(value, np.bool_) else value)
    elif isinstance(value, int | float | np.number):
        parts[name] = _number(value)
    elif isinstance(value, np.ndarray | jax.Array):
        array = np.asarray(value)
        parts[name] = _number(array[()]) if array.ndim == 0 else f"{array.dtype}{array.shape} {_hash(array)}"
    elif isinstance(value, type):
        parts[name] = f"{value.__module__}.{value.__qualname__}"
    elif is_dataclass(value):
        parts[name or "kind"] = type(value).__qualname__
        made_of = {each.name: getattr(value, each.name, None) for each in fields(value)}
        for inner, held in (made_of | getattr(value, "derived", {})).items():
            _add(parts, within(inner), held)
    elif isinstance(value, Mapping):
        parts[name or "kind"] = f"{type(value).__qualname__} of {len(value)}"
        for key, inner in value.items():
            _add(parts, within(str(key)), inner)
    elif isinstance(value, list | tuple):
        parts[name or "kind"] = f"{type(value).__qualname__} of {len(value)}"
        names = getattr(value, "_fields", range(1, len(value) + 1))
        for key, inner in zip(names, value, strict=True):
            _add(parts, within(str(key)), inner)
    elif isinstance(value, partial):
        _add(parts, name, (value.func, value.args, value.keywords))
    elif hasattr(value, "__wrapped__"):  # a function that was compiled
        _add(parts, name, value.__wrapped__)
    elif isinstance(getattr(value, "__code__", None), CodeType):
        parts[name] = _function(value)
    elif hasattr(value, "__dict__") and not callable(value):
        _add(parts, name, {"kind": type(value), **vars(value)})
    else:
        raise ValueError(
            f"'{name or type(value).__name__}' is a {type(value).__name__}, which cannot be recognised again, so "
            "nothing that is computed from it can be kept: leave out the file or folder."
        )


def _number(value) -> str:
    return repr(bool(value)) if isinstance(value, np.bool_) else repr(float(value))


def _hash(array: np.ndarray) -> str:
    if array.dtype.hasobject:
        raise ValueError(
            "an array of Python objects cannot be recognised again, so nothing that is computed from it can be kept: "
            "leave out the file or folder, or make it an array of numbers."
        )
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:32]


def _function(function) -> str:
    """A hash of what a function does: its instructions, what they name, and what it carries along."""
    carried = [cell.cell_contents for cell in function.__closure__ or ()]
    if getattr(function, "__self__", None) is not None:
        carried.append(function.__self__)
    parts = fingerprint([carried, function.__defaults__, function.__kwdefaults__])
    text = json.dumps([parts, _code(function.__code__)]).encode()
    return f"{function.__qualname__} {hashlib.sha256(text).hexdigest()[:32]}"


def _code(code: CodeType) -> list:
    constants = [_code(each) if isinstance(each, CodeType) else repr(each) for each in code.co_consts]
    return [code.co_code.hex(), list(code.co_names), constants]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
