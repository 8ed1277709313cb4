"""A case as a file, with unit, default and what is allowed beside every field."""

import re
import textwrap
from typing import Literal, get_args, get_origin

from axijax.app.case import KINDS, SECTIONS, Case
from axijax.app.case_stages import HELP


def to_toml(case: Case) -> str:
    """The case as a file: every field that its specimen takes, with unit, default and what is allowed in a comment."""
    lines = [
        "# A triaxial test for `axijax run`. Units: any consistent set of length [L], time [T] and mass [M];",
        "# force [F] = [M L/T^2]. A line left out takes its default.",
    ]
    for name, (model, heading) in SECTIONS.items():
        values = getattr(case, name)
        lines += ["", f"# {heading}", f"[{name}]"]
        for field, about in model.model_fields.items():
            if name == "specimen" and field not in ("kind", *KINDS[case.specimen.kind][0]):
                continue
            if name == "parameters" and field not in case.scene.takes():
                continue
            if name == "test" and field == "axial_strain" and case.stage:
                continue
            default = about.default
            if name == "sector" and field == "order" and KINDS[case.specimen.kind][1]:
                allowed = f"{_allowed(about)}; this specimen takes {_listed(KINDS[case.specimen.kind][1])}"
            else:
                allowed = _allowed(about)
            told = [about.description, allowed, "" if default is None else f"default {_toml(default)}"]
            text = "; ".join(part for part in told if part)
            lines += textwrap.wrap(text, 110, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)
            value = getattr(values, field)
            lines.append(f"# {field} =" if value is None else f"{field} = {_toml(value)}")
    for each in case.stage:
        given = each.model_dump(exclude_unset=True, exclude_none=True)
        lines += ["", "[[stage]]", *(f"{field} = {_toml(value)}" for field, value in given.items())]
    return "\n".join(lines) + "\n" + ("" if case.stage else HELP)


def _allowed(about) -> str:
    """What a field may hold, in words."""
    kind = about.annotation
    if get_origin(kind) is Literal:
        choices = [f'"{choice}"' for choice in get_args(kind)]
        return "" if all(choice in about.description for choice in choices) else "one of " + ", ".join(choices)
    if kind is bool:
        return "true or false"
    signs = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}
    rules = [(sign, getattr(rule, name, None)) for rule in about.metadata for name, sign in signs.items()]
    limits = [f"{sign} {limit:g}" for sign, limit in rules if limit is not None]
    return f"{'whole number ' if kind is int else ''}{' and '.join(limits)}".strip()


def _listed(numbers) -> str:
    *most, last = map(str, numbers)
    return f"{', '.join(most)} or {last}" if most else last


def _toml(value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return re.sub(r"(\.0)?e([-+])0*", lambda m: "e-" if m[2] == "-" else "e", _shortest(value))
    return f'"{value}"' if isinstance(value, str) else str(value)


def _shortest(value: float) -> str:
    """Digits that read back to the same number; large ones with an exponent."""
    short = f"{value:.6g}"
    return short if "e" in short and float(short) == value else repr(value)
