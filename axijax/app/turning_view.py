"""The specimen in space as a part of a report that its reader turns: by pointer, by touch, by arrow keys.

The page holds the balls and some hundred lines of script (`turning_view.js`) that draw them; libraries that could do it
are larger than all the rest of a report (trame and vtk.js for PyVista, plotly, k3d) or are fetched when it is opened.
"""

import base64
import json
from html import escape
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from axijax.app.figures import IMAGE, OWN, SLIDING
from axijax.app.snapshot import Snapshot

TURNING = '<figure class="turning"'
MOST = 80_000  # balls; some 1.5 MB
FARTHEST = 32000  # units of length in the page: within int16
STEPS = 64  # of a scale of colours
SHARE = 0.98  # of the balls whose mean stress a scale spans; the highest are at its end


class Scale(NamedTuple):
    """What balls are coloured by: (B,) whole numbers from 0, a colour for each, and what is told of it.

    title: with the unit. kinds: whether the numbers are kinds, or else steps of a scale.
    """

    title: str
    values: np.ndarray
    colours: list[str]
    told: list[str]
    kinds: bool


def turning_view(seen: Snapshot) -> str:
    """A figure of the balls of a snapshot, to be turned by `script()`; empty where they are too many for a page.

    seen: with the sector's images filled in.
    """
    balls = seen.balls
    if not 0 < balls.number.size <= MOST:
        return ""
    bottom, top = (float(height) for height in seen.platens.heights)
    reach = float((np.hypot(*balls.positions[:2]) + balls.radius).max())
    unit = FARTHEST / max(reach, top - bottom)
    centred = balls.positions - np.array([[0.0], [0.0], [(bottom + top) / 2]])
    scales = _scales(seen)
    sector = seen.sector
    view = sector.angle / 2 - np.deg2rad(20 if sector.order > 1 else 0)
    alone = sector.boundary == "rigid" and sector.order > 1
    told: dict[str, Any] = {
        "place": _packed(unit * centred.T, np.int16),
        "radius": _packed(unit * balls.radius, np.int16),
        "number": balls.number.tolist(),
        "reach": round(unit * reach),
        "height": round(unit * (top - bottom)),
        "span": round(float(sector.angle if alone else 2 * np.pi), 4),
        "turn": round(float(view), 4),
        "rise": 0.384,
        "front": [round(float(np.cos(view)), 4), round(float(np.sin(view)), 4)],
        "fields": [
            {
                "values": _packed(each.values, np.uint8),
                "colours": each.colours,
                "told": each.told,
                "kinds": each.kinds,
            }
            for each in scales
        ],
    }
    options = "".join(f'<option value="{place}">{escape(each.title)}</option>' for place, each in enumerate(scales))
    cut = "" if alone else ' <label><input type="checkbox"> cut open</label>'  # a sector alone is
    return (
        f'{TURNING} hidden data-seen="{escape(json.dumps(told, separators=(",", ":")))}">'
        "<p><label>colour <select>" + options + f"</select></label>{cut}</p>"
        '<canvas tabindex="0" role="img" aria-label="The specimen in space; arrow keys turn it"></canvas>'
        '<p class="scale"></p><figcaption>The specimen, to be turned: drag it, or use the arrow keys; two fingers, or '
        "+ and -, change its size; a ball that is pressed tells its value. <output></output></figcaption></figure>"
    )


def script() -> str:
    """What turns all views of a page."""
    return (files("axijax.app") / "turning_view.js").read_text(encoding="utf-8")


def _scales(seen: Snapshot) -> list[Scale]:
    balls = seen.balls
    stress = np.trace(balls.stress) / 3 / seen.confining_stress
    scales = [
        _even("mean stress / confining stress", stress, 0.0, float(np.quantile(stress, SHARE))),
        _counted("contacts of a ball", balls.coordination),
    ]
    if np.ptp(balls.radius) > 1e-9 * balls.radius.max():
        scales.append(_even("radius [L]", balls.radius, float(balls.radius.min()), float(balls.radius.max())))
    zone = balls.membrane_zone.astype(int)
    if zone.any():
        scales.append(Scale("membrane", zone, [IMAGE, SLIDING], ["inside", "carries the membrane"], True))
    if (balls.image > 0).any():
        image = (balls.image > 0).astype(int)
        scales.append(Scale("simulated and images", image, [OWN, IMAGE], ["simulated", "image"], True))
    return scales


def _even(title: str, values: np.ndarray, low: float, high: float) -> Scale:
    """An even scale; what is beyond its ends is at them."""
    wide = max(high - low, 1e-300)
    place = np.clip(np.rint((STEPS - 1) * (values - low) / wide), 0, STEPS - 1).astype(int)
    told = [f"{low + wide * k / (STEPS - 1):.3g}" for k in range(STEPS)]
    told[-1] = "≥ " * bool(values.max() > high + 1e-6 * wide) + told[-1]
    return Scale(title, place, _colours(STEPS), told, False)


def _counted(title: str, values: np.ndarray) -> Scale:
    most = int(np.clip(values.max(initial=0), 1, 255))
    values = np.minimum(values, most)
    return Scale(title, values.astype(int), _colours(most + 1), [str(k) for k in range(most + 1)], False)


def _colours(count: int) -> list[str]:
    return [to_hex(colour) for colour in colormaps["cividis"](np.linspace(0, 1, count))]


def _packed(values: np.ndarray, kind: type) -> str:
    """Whole numbers, little-endian as all browsers have them, as text."""
    whole = np.rint(values).astype(np.dtype(kind).newbyteorder("<"))
    return base64.b64encode(np.ascontiguousarray(whole).tobytes()).decode("ascii")
