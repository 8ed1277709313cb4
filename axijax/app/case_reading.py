"""How a case file is read, and what is said of one that makes no sense."""

import difflib
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel

LONGEST = 60  # characters of a name or a value that a sentence shows
MOST_BYTES = 10**6  # of a case file; 10^4 is a long one


def read_toml(path: Path | str) -> dict:
    """What a TOML file holds. Raises ValueError where it cannot be read."""
    try:
        with open(path, "rb") as file:
            text = file.read(MOST_BYTES + 1)
        if len(text) > MOST_BYTES:
            raise ValueError(f"case file '{path}' is larger than {MOST_BYTES:,} bytes: it is no case file.")
        data = tomllib.loads(text.decode())
    except OSError as error:
        raise ValueError(f"case file '{path}' cannot be read: {error.strerror}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"case file '{path}' is not valid TOML: {error}.") from None
    except RecursionError:
        raise ValueError(f"case file '{path}' is nested too deeply: it is no case file.") from None
    except ValueError as error:
        if "integer string conversion" not in str(error):
            raise
        raise ValueError(f"case file '{path}' holds a number of thousands of digits: it is no case file.") from None
    return data


def sentence(problem, sections: Mapping[str, type[BaseModel]]) -> str:
    """What pydantic found, for people. sections: the models of a case file's sections."""
    given, (first, *rest) = problem["input"], problem["loc"] or ("",)
    if first == "stage" and rest and isinstance(rest[0], int):
        told = sentence({**problem, "loc": ("stage", *rest[1:])}, sections)
        return f"[[stage]] {rest[0] + 1}: {told.replace('stage.', '', 1)}"
    if problem["type"] == "tuple_type" and first == "stage":
        return "stage: must be tables, each headed [[stage]]"
    if problem["type"] == "missing":
        return f"{rest[-1] if rest else first} is missing: it has no default"
    where = ".".join(str(part)[:LONGEST] for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        *section, name = problem["loc"]
        known = list(sections[str(section[0])].model_fields if section else sections)
        elsewhere = [f"[{other}]" for other, model in sections.items() if name in model.model_fields]
        near = nearest(str(name), known)
        hint = f"it belongs to {' or '.join(elsewhere)}" if elsewhere else near or f"known are {', '.join(known)}"
        return f"'{where}' is not a {'field' if section else 'section'}; {hint}"
    if problem["type"] == "value_error":
        return f"{where}{'.' if where else ''}{problem['ctx']['error']}"
    if problem["type"] == "model_type":
        return f"{where} = {_repr(given)}: must be a section, [{where}], with its fields below"
    told = problem["msg"].replace("Input should be", "must be")
    for theirs, ours in (("boolean", "true or false"), ("integer", "a whole number"), ("number", "a number")):
        told = told.replace(f"a valid {theirs}", ours)
    if problem["type"] == "literal_error":
        near = nearest(str(given), re.findall(r"'([^']*)'", problem["ctx"]["expected"]))
        told += f"; {near}" if near else ""
    return f"{where} = {str(given).lower() if isinstance(given, bool) else _repr(given)}: {told}"


def _repr(given) -> str:
    """A value as it is shown in a sentence, however long it is."""
    try:
        shown = repr(given)
    except (ValueError, RecursionError):  # an integer of thousands of digits, in hexadecimal
        return "a value that is too long to be shown"
    return shown if len(shown) <= LONGEST + 20 else f"{shown[:LONGEST]}.. ({len(shown)} characters)"


def nearest(name: str, known) -> str:
    near = difflib.get_close_matches(name[:LONGEST], known, n=1)
    return f"did you mean '{near[0]}'?" if near else ""
