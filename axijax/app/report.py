"""A report: one HTML page that stands alone, with inputs, curves, checks, pictures and how to make it again.

Everything is inside the page (pictures as data URIs, one script of our own that turns the specimen) and nothing is
fetched, so that it can be mailed, archived, opened offline and printed.
"""

import base64
import io
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from axijax.app import figures as pictures
from axijax.app.case import SECTIONS
from axijax.app.case_stages import StageCase
from axijax.app.case_writing import to_toml
from axijax.app.checks import result_checks
from axijax.app.labels import Measured, case_of, labels, thornton_ratio
from axijax.app.plot import CURVES, curve_figure
from axijax.app.results import Result
from axijax.app.snapshot import snapshot
from axijax.app.turning_view import TURNING, script, turning_view
from axijax.core.files import draw_afterwards, write_whole
from axijax.triaxial.laboratory import laboratory
from axijax.triaxial.peak import at_peak
from axijax.triaxial.records import quantities_of

DPI = 110

CAPTIONS = {
    "specimen": "The specimen: the balls that are simulated, and their images.",
    "section": "Vertical section and plan, coloured by the mean stress of each ball.",
    "force-network": "Contact forces in the vertical section; lines are as wide as the normal force.",
    "fabric-rose": "Directions of the contact normals; 1 where all directions are alike. Axisymmetric, so one quadrant "
    "is shown four times.",
    "membrane-cells": "The membrane's cells on the unfolded cylinder: each outer ball carries the confining stress on "
    "its cell.",
}

BROADLY = ' class="broad"'
# As wide as the page; on a telephone they are moved sideways, so that their letters can be read.
BROAD = ("section", "fabric-rose", "membrane-cells")

SOIL = {
    "friction-dilatancy": "Mobilised friction angle, sin(phi) = (R - 1)/(R + 1), and dilatancy rate.",
    "stress-dilatancy": "Stress ratio against dilatancy, and Rowe's line R = K D with K = tan²(45° + phi/2).",
    "q-p": "Deviatoric against mean stress.",
    "mohr": "Mohr's circles at the largest stress ratio, and their envelope.",
}

VERDICTS = {
    True: '<span class="passed">passed</span>',
    False: '<span class="failed">NOT passed</span>',
    None: '<span class="note">no limit</span>',
}

STYLE = """
:root { color-scheme: light dark; --text: #1b1f23; --page: #fff; --quiet: #57606a; --line: #d0d7de; --thin: #eaeef2;
  --box: #f6f8fa; --good: #1a7f37; --bad: #b35900; --warn: #fff8f0; --link: #0059a8; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e9ec; --page: #14171a; --quiet: #a3acb5; --line: #3a4149;
  --thin: #2a3036; --box: #1f2429; --good: #56d364; --bad: #ffa657; --warn: #2b2117; --link: #79b8ff; } }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; color: var(--text);
  background: var(--page); max-width: 62rem; margin: 2.5rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; padding-bottom: .25rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin: 1.6rem 0 .3rem; }
a { color: var(--link); }
p.lead, figcaption, .note { color: var(--quiet); }
.note { font-size: .9rem; }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .28rem 1rem .28rem 0; border-bottom: 1px solid var(--thin);
  overflow-wrap: break-word; }
td .passed, td .failed { white-space: nowrap; }
th { overflow-wrap: normal; }
.wide { overflow-x: auto; }
nav { columns: 2 14rem; margin: 1.2rem 0; }
nav a { display: block; padding: .12rem 0; }
summary { cursor: pointer; }
thead th { border-bottom: 1px solid var(--quiet); font-weight: 600; }
td.number { text-align: right; white-space: nowrap; }
th.number { text-align: right; }
table.inputs { width: 100%; }
table.inputs th:nth-child(1) { width: 13rem; } table.inputs th:nth-child(2) { width: 11rem; }
.figures { display: flex; flex-wrap: wrap; gap: 1.2rem 2rem; margin: 1.4rem 0; }
.figures div { min-width: 8rem; }
.figures b { display: block; font-size: 1.5rem; line-height: 1.25; font-weight: 600; }
.figures span { font-size: .88rem; color: var(--quiet); }
figure { margin: 1.4rem 0; break-inside: avoid; }
figure img { max-width: 100%; max-height: 46rem; display: block; background: #fff; border-radius: 4px; }
.beside { display: flex; flex-wrap: wrap; gap: 1rem 2.5rem; align-items: flex-end; }
.beside figure { max-width: 29rem; } .beside img { max-height: 36rem; }
figcaption { font-size: .9rem; margin-top: .4rem; }
.turning canvas { display: block; width: 100%; height: 34rem; max-height: 75vh; touch-action: none; cursor: grab; }
.turning p { margin: .3rem 0; font-size: .9rem; } .turning label { margin-right: 1.2rem; white-space: nowrap; }
.turning select { font: inherit; color: inherit; background: var(--box); border: 1px solid var(--line); }
.turning .scale { display: flex; gap: .2rem .7rem; align-items: center; justify-content: center; }
.turning .scale > i { flex: 0 1 16rem; height: .7rem; } .turning .scale span { white-space: nowrap; }
.turning .scale span i { display: inline-block; width: .8rem; height: .8rem; border-radius: 50%; margin-right: .35rem; }
.turning output { display: block; min-height: 1.5em; color: var(--text); font-weight: 600; }
.passed { color: var(--good); } .failed { color: var(--bad); font-weight: 600; }
.warning { border-left: 4px solid var(--bad); padding: .5rem 1rem; background: var(--warn); }
pre { background: var(--box); padding: .8rem 1rem; overflow-x: auto; font-size: .85rem; line-height: 1.4; }
@media (max-width: 40rem) { body { margin: 1.2rem auto; padding: 0 .8rem; } h1 { font-size: 1.5rem; }
  .figures { display: grid; grid-template-columns: 1fr 1fr; gap: .7rem 1rem; }
  .figures div { min-width: 0; } .figures b { font-size: 1.15rem; }
  .turning canvas { height: 26rem; max-height: 62vh; }
  figure.broad { overflow-x: auto; } figure.broad img { max-width: none; width: 40rem; }
  .folding tr { display: block; padding: .4rem 0; border-bottom: 1px solid var(--thin); }
  .folding thead { display: none; } .folding td, .folding td.number { display: block; border: 0; text-align: left;
    padding: 0; white-space: normal; } .folding td:first-child { font-weight: 600; } }
@media print { :root { color-scheme: light; --text: #000; --page: #fff; --quiet: #444; --box: #f6f8fa; --link: #000;
    --line: #bbb; --thin: #ddd; --warn: #fff; }
  body { margin: 0; max-width: none; font-size: 10.5pt; } h2 { break-after: avoid; }
  pre { white-space: pre-wrap; } .turning { display: none; } }
"""


def write_report(results: Sequence[Result], output: Path, data: Measured | None = None, energy: bool = False) -> Path:
    """Write the report of one result, or of several side by side, as one HTML file; returns its path.

    output: the file. data: measured curve for the picture of curves. energy: check the energy ledger too.

    Raises ValueError for a result without a case, and OSError where the file cannot be written.
    """
    page = report_page(results, data, energy)
    # A file's name need not be text.
    write_whole(Path(output), lambda target: target.write_text(page, encoding="utf-8", errors="replace"))
    return Path(output)


def report_page(results: Sequence[Result], data: Measured | None = None, energy: bool = False) -> str:
    """The page as text; arguments as in `write_report`."""
    names = labels(results)
    several = len(results) > 1
    title = "Triaxial test " + results[0].name if not several else f"{len(results)} triaxial tests compared"
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">Discrete element simulation of a triaxial test with axijax {escape(version("axijax"))}; '
        f"report of {datetime.now(UTC):%d %B %Y, %H:%M} UTC. Compression is positive; units are any consistent set of "
        "length [L], mass [M] and time [T], force [F] = [M L/T²].</p>",
        *(_warning(result, name) for result, name in zip(results, names, strict=True)),
    ]
    parts: list[tuple[str, str]] = []  # title and content
    if several:
        parts.append(("Comparison", _comparison(results, names)))
    else:
        body.append(_figures(results[0]))
    curves = _figure(lambda: curve_figure(results, data), _curves_caption(results, data), "curves")
    drawn = [_figure(partial(CURVES[kind], results, data), caption, kind) for kind, caption in SOIL.items()]
    parts.append(("Curves", _beside(curves, *drawn)))
    for result, name in zip(results, names, strict=True):
        own = {
            "Pictures": "\n".join(_pictures(result)) if result.has_state else "",
            "Checks": _checks(result, energy),
            "Inputs": _inputs(result),
            "How to make it again": _reproduce(result),
        }
        parts += [
            (f"{name}: {head[0].lower()}{head[1:]}" if several else head, content)
            for head, content in own.items()
            if content
        ]
    parts.append(("What the curves mean", _glossary(result)))
    links = "".join(f'<a href="#part-{place}">{escape(head)}</a>' for place, (head, _) in enumerate(parts, 1))
    body.append(f'<nav aria-label="Contents">{links}</nav>')
    for place, (head, content) in enumerate(parts, 1):
        body += [f'<h2 id="part-{place}">{escape(head)}</h2>', content]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in body if part)
        + (f"\n<script>\n{script()}</script>" if any(TURNING in part for part in body) else "")
        + "\n</body>\n</html>\n"
    )


def _warning(result: Result, name: str) -> str:
    told = [f"{name}: {text}" for text in result.info.get("warnings", ())]
    if result.status != "finished":
        message = result.info.get("message") or "the curves end where it was last saved"
        told.insert(0, f"{name} has not finished (status: {result.status}): {message}")
    return "\n".join(f'<p class="warning">{escape(text)}</p>' for text in told)


def _summary(result: Result) -> dict[str, str]:
    """What a reader looks for first, by name."""
    found, case = laboratory(result.curve), case_of(result)
    asked = case.test.axial_strain if case is not None and not case.stage and result.status == "finished" else None
    summary = found.rows(asked)
    if case is not None and thornton_ratio(case) is not None:
        summary["Thornton (1979), rigid balls that do not rotate [-]"] = f"{thornton_ratio(case):.4g}"
    where = "at the peak" if found.peak.reached else "there"
    core = f"stress ratio of the inner core {where} [-]"
    return summary | {core: f"{at_peak(result.curve, found.peak, 'core_ratio'):.4g}"}


def _figures(result: Result) -> str:
    cells = "".join(f"<div><b>{value}</b><span>{escape(name)}</span></div>" for name, value in _summary(result).items())
    return f'<div class="figures">{cells}</div>'


def _comparison(results: Sequence[Result], names: Sequence[str]) -> str:
    summaries = [_summary(result) for result in results]
    columns = list(dict.fromkeys(name for summary in summaries for name in summary))
    rows = [
        [name, *(summary.get(column, "") for column in columns)] for name, summary in zip(names, summaries, strict=True)
    ]
    return _table(["run", *columns], rows, numbers=range(1, len(columns) + 1))


def _curves_caption(results: Sequence[Result], data: Measured | None) -> str:
    text = "Stress ratio and volumetric strain against axial strain."
    if any((case := case_of(result)) is not None and thornton_ratio(case) is not None for result in results):
        text += " Dashed: Thornton's stress ratio of the ideal FCC array, 2 (1 + f) / (1 - f)."
    if data is not None:
        text += f" Circles: measured, {data.source}."
    return text


def _checks(result: Result, energy: bool) -> str:
    rows = [
        [
            escape(check.name),
            escape(check.value) if isinstance(check.value, str) else f"{check.value + 0.0:.2g}",
            check.limit if isinstance(check.limit, str) else f"≤ {check.limit:.2g}",
            VERDICTS[check.passed],
            f'<span class="note">{escape(check.meaning)}</span>',
        ]
        for check in result_checks(result, energy)
    ]
    heads = ["check", "found", "allowed", "", "what it tells"]
    return _table(heads, rows, numbers=(1, 2), escaped=True, style="folding")


def _inputs(result: Result) -> str:
    parts = []
    for section, given in result.case.sections().items():
        model, about = SECTIONS.get(section, (StageCase, StageCase.__doc__ or ""))
        rows = [[field, _shown(value), model.model_fields[field].description or ""] for field, value in given.items()]
        parts.append(f"<h3>{escape(section)}</h3><p class='note'>{escape(about)}</p>")
        parts.append(_table(["field", "value", "meaning and unit"], rows, style="inputs folding"))
    if result.has_state:
        test = result.test
        rows = [
            ["time step", f"{test.prepared.time_step:.5g}", "taken, [T]"],
            ["steps", str(test.prepared.numerics.most_steps), "of the shear"],
            ["balls", str(len(test.cut)), "in the sector"],
            ["membrane balls", str(int(test.cut.membrane_zone.sum())), "of these, at the start"],
            ["height", f"{test.cut.height:.5g}", "of the specimen as made [L]"],
        ]
        heads = ["", "value", "meaning and unit"]
        parts += ["<h3>what follows from these</h3>", _table(heads, rows, style="inputs folding")]
    return "\n".join(parts)


def _pictures(result: Result) -> Iterable[str]:
    seen = snapshot(result.test, result.progress, full=True)
    own = int((seen.balls.image == 0).sum())
    yield (
        f'<p class="note">The last state, at {100 * seen.axial_strain:.3g} % axial strain (the first record at the '
        f"strain asked for; the curves end with the one before): {own} balls simulated, "
        f"{seen.balls.number.size} with the images "
        f"of the sector, {seen.contacts.first.size} touching contacts among these.</p>"
    )
    figures = {
        kind: _figure(partial(pictures.KINDS[kind], seen), caption, kind, broad=kind in BROAD)
        for kind, caption in CAPTIONS.items()
        if kind != "membrane-cells" or seen.membrane.polygons
    }
    yield _beside(figures.pop("specimen"), figures.pop("force-network"))
    yield turning_view(seen) or (
        f'<p class="note">{seen.balls.number.size} balls are too many for a view in this page that can be turned; '
        "ParaView shows them: <code>axijax snapshot --full</code>.</p>"
    )
    yield from figures.values()


def _reproduce(result: Result) -> str:
    """Commands, versions, machine and the case file."""
    known = {**result.curve.attrs, **result.info}
    versions = {name: known[name] for name in ("axijax", "jax", "numpy", "python") if name in known}
    told = ", ".join(f"{name} {number}" for name, number in versions.items()) or "the same versions"
    commands = f"axijax run case.toml --output {result.name}\naxijax check {result.name}\naxijax report {result.name}\n"
    parts = [
        f"<p>With {escape(told)}, and the case file below saved as case.toml:</p>",
        f"<pre>{escape(commands)}</pre>",
        "<p>On the same machine these versions give the same numbers to the last bit.</p>",
    ]
    rows = [[name, value] for name, value in _flat(result.info) if name not in ("status", "message", "warnings")]
    if rows:
        parts += ["<h3>Run</h3>", _table(["", ""], rows)]
    text = escape(to_toml(result.case))
    parts.append(f"<details><summary>The inputs above as a case file, to copy</summary><pre>{text}</pre></details>")
    return "\n".join(parts)


def _flat(values: Mapping[str, Any], above: str = "") -> Iterable[tuple[str, str]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}, ")
        elif value not in (None, ""):
            yield f"{above}{name}".replace("_", " "), _shown(value)


def _glossary(result: Result) -> str:
    held = quantities_of(result.curve)
    rows = [[name, f"[{each.unit.replace('1', '-')}]", each.long_name] for name, each in held.items()]
    return _table(["in curve.nc and curve.csv", "unit", "meaning"], rows, style="folding")


def _shown(value) -> str:
    if value is None:
        return "left out"
    if isinstance(value, list | tuple):  # a command line
        return shlex.join(map(str, value))
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _beside(*figures: str) -> str:
    return f'<div class="beside">{"".join(figures)}</div>'


def _figure(make: Callable[[], Figure], caption: str, alt: str, broad: bool = False) -> str:
    """A picture, or why there is none: the rest of the page is worth having without it."""
    target = io.BytesIO()
    problem = draw_afterwards(
        f"the picture '{alt}'", lambda: make().savefig(target, dpi=DPI, bbox_inches="tight", format="png")
    )
    if problem is not None:
        return f'<p class="warning">{escape(problem)}</p>'
    image = base64.b64encode(target.getvalue()).decode("ascii")
    return (
        f'<figure{BROADLY if broad else ""}><img alt="{escape(alt)}" src="data:image/png;base64,{image}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Iterable[int] = (),
    escaped: bool = False,
    style: str = "",
) -> str:
    numbers = set(numbers)
    kind = [' class="number"' if place in numbers else "" for place in range(len(heads))]

    def line(tag, cells):
        return "".join(
            f"<{tag}{mark}>{cell if escaped else escape(str(cell))}</{tag}>"
            for mark, cell in zip(kind, cells, strict=True)
        )

    top = f"<thead><tr>{line('th', heads)}</tr></thead>" if any(heads) else ""
    return (
        f'<div class="wide"><table class="{style}">{top}<tbody>'
        + "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
        + "</tbody></table></div>"
    )
