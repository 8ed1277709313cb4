"""How objects show themselves at a prompt and in a notebook: one line of text, or a small table with a small picture.

An object says what it holds by `_card`; `Card.line` is its repr, `Card.html` its notebook view. Pictures are inline
SVG, a few kilobytes, in the colour of the page's text, so that they are read in a light and in a dark notebook.
"""

import dataclasses
from collections.abc import Mapping
from html import escape
from typing import Any, NamedTuple, TypeVar

import numpy as np

from axijax.core.palette import COLOURS

Kind = TypeVar("Kind", bound=type)

WIDE = 300  # characters of a repr, at most
POINTS, CIRCLES = 160, 500  # of a picture, at most
LINE = COLOURS[0]  # read on white and on black


class Card(NamedTuple):
    """title: what it is. rows: name with unit, and value, as text. picture: SVG, or nothing. brief: names of the rows
    that the one line has; all where there are none."""

    title: str
    rows: Mapping[str, str]
    picture: str = ""
    brief: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        shown = self.brief or tuple(self.rows)
        told = "; ".join(f"{name} {self.rows[name]}" for name in shown if name in self.rows)
        text = f"{self.title}({told})"
        return text if len(text) <= WIDE else f"{text[: WIDE - 4]} ..)"

    @property
    def html(self) -> str:
        rows = "".join(
            f'<tr><td style="text-align:left">{escape(name)}</td><td style="text-align:left">{escape(value)}</td></tr>'
            for name, value in self.rows.items()
        )
        table = f"<table><tbody>{rows}</tbody></table>"
        inside = f"<div>{table}</div><div>{self.picture}</div>" if self.picture else table
        return (
            f"<div><b>{escape(self.title)}</b>"
            f'<div style="display:flex;flex-wrap:wrap;gap:1.5em;align-items:center">{inside}</div></div>'
        )


def shown(kind: Kind) -> Kind:
    """Makes a class show itself by its method `_card`, or by what its fields hold where it has none. The outermost
    decorator, since a dataclass writes a repr of its own."""

    def card(self) -> Card:
        return self._card() if hasattr(self, "_card") else _fields(self)

    setattr(kind, "__repr__", lambda self: card(self).line)  # noqa: B010 (mypy knows no class's repr by assignment)
    setattr(kind, "_repr_html_", lambda self: card(self).html)  # noqa: B010
    return kind


def _fields(self) -> Card:
    """The fields of a dataclass or named tuple: numbers as they are, of arrays the shape, of the rest the kind."""
    names = getattr(self, "_fields", None) or [each.name for each in dataclasses.fields(self)]
    return Card(type(self).__name__, {name: _told(getattr(self, name)) for name in names})


def _told(value: Any) -> str:
    shape = getattr(value, "shape", None)
    if isinstance(value, str | int | float | type(None)):
        return f"{value:.6g}" if isinstance(value, float) else repr(value)
    if shape is None:
        return f"{len(value)} values" if isinstance(value, tuple) else type(value).__name__
    try:
        return f"{np.asarray(value)[()]:.6g}" if shape == () else f"shape {tuple(shape)}"
    except Exception:  # traced by JAX
        return "traced"


def per_cent(strain: float) -> str:
    """A strain as people write it."""
    return f"{100 * strain:.4g} %"


def numbers(values) -> np.ndarray | None:
    """Values as (T,) floats; None where they are not there, traced by JAX, of a batch, or no numbers."""
    try:
        found = np.asarray(values, float)
    except Exception:  # a traced value raises an error of JAX's, a placeholder of a tree TypeError
        return None
    return found if found.ndim == 1 and found.size else None


def line_picture(x, y, across: str, up: str) -> str:
    """A curve with the ends of both axes as numbers; nothing where there is no curve to draw. across, up: their names
    with units."""
    x, y = numbers(x), numbers(y)
    if x is None or y is None or x.shape != y.shape:
        return ""
    x, y = x[np.isfinite(x) & np.isfinite(y)], y[np.isfinite(x) & np.isfinite(y)]
    if x.size < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return ""
    every = max(1, -(-x.size // POINTS))
    place = np.unique(np.append(np.arange(0, x.size, every), [x.size - 1, int(y.argmax())]))
    left, right, top, bottom = 46.0, 286.0, 22.0, 132.0
    u = left + (right - left) * (x[place] - x.min()) / np.ptp(x)
    v = bottom - (bottom - top) * (y[place] - y.min()) / np.ptp(y)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(u, v, strict=True))
    texts = [
        (left - 4, top + 4, "end", f"{y.max():.4g}"), (left - 4, bottom, "end", f"{y.min():.4g}"),
        (left, bottom + 14, "start", f"{x.min():.3g}"), (right, bottom + 14, "end", f"{x.max():.3g}"),
        ((left + right) / 2, bottom + 14, "middle", across), (left, top - 9, "start", up),
    ]  # fmt: skip
    written = "".join(
        f'<text x="{a:g}" y="{b:g}" text-anchor="{anchor}">{escape(text)}</text>' for a, b, anchor, text in texts
    )
    axes = f'<path d="M{left} {top}V{bottom}H{right}" fill="none" stroke="currentColor" stroke-width="0.8"/>'
    curve = f'<polyline points="{points}" fill="none" stroke="{LINE}" stroke-width="1.8"/>'
    return _svg(300, 150, axes + curve + written)


def ball_picture(positions: np.ndarray, radius: np.ndarray, bottom: float, top: float) -> str:
    """The balls of a vertical layer about the axis, between the platens; nothing where these are too many to be cheap.
    positions: (3, N), radius: (N,)."""
    shown = np.flatnonzero(np.abs(positions[1]) < radius * 1.01)
    if not 0 < shown.size <= CIRCLES:
        return ""
    reach = float((np.abs(positions[0, shown]) + radius[shown]).max())
    scale = 150 / max(top - bottom, 1e-300)
    wide = 2 * reach * scale + 8
    circles = "".join(
        f'<circle cx="{(x + reach) * scale + 4:.1f}" cy="{(top - z) * scale + 5:.1f}" r="{r * scale:.1f}"/>'
        for x, z, r in zip(positions[0, shown], positions[2, shown], radius[shown], strict=True)
    )
    plates = f'<path d="M0 4H{wide:.1f}M0 156H{wide:.1f}" stroke="currentColor" stroke-width="2.5"/>'
    return _svg(wide, 160, f'<g fill="{LINE}" fill-opacity="0.3" stroke="{LINE}">{circles}</g>{plates}')


def _svg(width: float, height: float, inside: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.1f} {height:g}" font-family="sans-serif" font-size="11" fill="currentColor">'
        f"{inside}</svg>"
    )
