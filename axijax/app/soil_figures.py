"""Pictures of curves as soil mechanics draws them, several results in one: stresses, volume, angles, stress-dilatancy,
Mohr's circles.

A random specimen's records are drawn thin, and its smooth curve (`axijax.core.smoothing`) thick. Legends stand beside
the axes, so that they cover nothing. Sizes are for a picture shown 14 cm wide: letters of 10.5 points.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

from axijax import theory
from axijax.app.labels import LETTERS, Lines, Measured, case_of, plain, readable
from axijax.app.results import Result
from axijax.core.smoothing import Smooth, advancing
from axijax.triaxial.laboratory import laboratory
from axijax.triaxial.peak import is_random
from axijax.triaxial.records import dilatancy_rates

STRAIN, VOLUME = "axial strain [%]", "volumetric strain [%]\n(compression positive)"
STRESS = "[F/L²]"
ANGLE = "mobilised friction angle [degrees]"
RATE = "dilatancy rate d [-]\n(expansion positive)"
POINTS = {"color": "black", "ls": "none", "marker": "o", "mfc": "none", "ms": 4.5}
# Fields of a case by which tests of one material differ, so that their circles have one envelope.
LOADING = {"parameters": {"confining_stress", "platen_speed"}, "specimen": {"seed"}, "test": None}


def q_strain(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Deviatoric stress against axial strain; a circle at the peak."""
    figure, axes = _figure()
    lines = Lines(results)
    for result, name, line in lines.each:
        curve = result.curve
        found = laboratory(curve)
        _draw(axes, curve, curve.deviatoric_stress, name, line)
        if found.peak.reached:
            s3 = float(curve.lateral_stress[found.peak.record])
            q, error = (found.peak.stress_ratio - 1) * s3, (found.peak.error or 0.0) * s3
            axes.errorbar(100 * found.peak.axial_strain, q, error or None, fmt="o", color=line["color"], capsize=3)
    axes.plot([], [], "o", color="0.3", label="peak, with its error where it is smoothed")
    axes.set(xlabel=STRAIN, ylabel=f"deviatoric stress q = s1 - s3 {STRESS}")
    return _finished(figure, lines)


def volume_strain(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Volumetric against axial strain."""
    figure, axes = _figure()
    lines = Lines(results)
    for result, name, line in lines.each:
        axes.plot(100 * result.curve.axial_strain, 100 * result.curve.volumetric_strain, label=name, **line)
    if data is not None and data.volumetric_strain is not None:
        axes.plot(100 * data.axial_strain, 100 * data.volumetric_strain, label=_measured(data), **POINTS)
    axes.set(xlabel=STRAIN, ylabel=VOLUME)
    return _finished(figure, lines)


def void_ratio_pressure(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Void ratio against the logarithm of mean stress; a dot where a test begins."""
    figure, axes = _figure()
    lines = Lines(results)
    shown = [each for each in lines.each if is_random(each[0].curve)]
    if not shown:
        raise ValueError("e-log-p: a regular array's voids are not counted, so there is no void ratio to draw.")
    for result, name, line in shown:
        p = result.curve.mean_stress
        axes.plot(p, result.curve.void_ratio, label=name, **line)
        axes.plot(p[0], result.curve.void_ratio[0], "o", color=line["color"])
    axes.plot([], [], "o", color="0.3", label="start")
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel=f"mean stress p = (s1 + 2 s3)/3 {STRESS}", ylabel="void ratio e [-]")
    return _finished(figure, lines)


def q_pressure(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Deviatoric against mean stress, with the line q = M p through the peak."""
    figure, axes = _figure()
    lines = Lines(results)
    for result, name, line in lines.each:
        curve = result.curve
        peak = laboratory(curve).peak
        slope = 3 * (peak.stress_ratio - 1) / (peak.stress_ratio + 2)
        which = "peak" if peak.reached else "largest so far"
        told = name and f"{name}; M = {slope:.2f} ({which})"
        axes.plot(curve.mean_stress, curve.deviatoric_stress, label=told, **line)
        far = 1.05 * float(curve.mean_stress.max())
        axes.plot([0, far], [0, slope * far], color=line["color"], lw=0.9, ls=(0, (6, 3)))
    axes.plot([], [], color="0.3", lw=0.9, ls=(0, (6, 3)), label="q = M p")
    axes.set(xlabel=f"mean stress p = (s1 + 2 s3)/3 {STRESS}", ylabel=f"deviatoric stress q = s1 - s3 {STRESS}")
    axes.set(xlim=(0, None), ylim=(min(0.0, axes.get_ylim()[0]), None))
    return _finished(figure, lines)


def friction_dilatancy(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Mobilised friction angle, and dilatancy rate, against axial strain."""
    figure = Figure(figsize=(5.6, 6.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    lines = Lines(results)
    for result, name, line in lines.each:
        curve = result.curve
        _draw(upper, curve, curve.friction_angle, name, line)
        lower.plot(100 * curve.axial_strain, curve.dilatancy_rate, **line)
    if data is not None:
        strain, angle = 100 * data.axial_strain, np.rad2deg(theory.friction_angle(np.asarray(data.stress_ratio)))
        upper.plot(strain, angle, label=_measured(data), **POINTS)
        if data.volumetric_strain is not None:
            lower.plot(strain, dilatancy_rates(data.axial_strain, data.volumetric_strain), **POINTS)
    upper.set(ylabel=ANGLE)
    lower.set(xlabel=STRAIN, ylabel=RATE)
    lower.axhline(0, color="0.4", lw=0.8)
    return _finished(figure, lines)


def stress_dilatancy(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Stress ratio against D = 1 - d eps_v/d eps_1, with Rowe's line R = K D: for the large-strain friction angle of
    each test that shows one, and for the friction between the balls."""
    figure, axes = _figure()
    far = top = 1.0
    frictions: dict[float, None] = {}
    lines = Lines(results)
    for result, name, line in lines.each:
        curve, case = result.curve, case_of(result)
        found = laboratory(curve)
        rate, ratio = curve.dilatancy_rate.values, _smooth(curve, curve.stress_ratio)
        shown = np.isfinite(rate) & (rate > -1)
        axes.plot(1 + rate[shown], ratio[shown], label=name, **line)
        far = max(far, 1 + float(rate[shown].max(initial=0.0)))
        top = max(top, float(ratio[shown].max(initial=1.0)))
        friction = case.parameters.friction if case is not None and case.scene.friction else 0.0
        if case is not None and case.specimen.kind in ("octagon", "fcc"):
            if friction >= 1:  # where the ideal array locks
                continue
            factor = float(theory.rowe_stress_dilatancy(np.pi / 4, friction))
            _rowe(axes, factor, name and f"Rowe, FCC array, f = {friction:g}", line["color"], (0, (6, 3)))
            continue
        if np.isfinite(found.large_strain):
            angle = found.large_strain_angle.value
            factor = float(theory.stress_ratio_of(float(np.deg2rad(angle))))
            _rowe(axes, factor, name and f"Rowe, phi = {angle:.1f}° at large strain", line["color"], (0, (6, 3)))
        if friction:
            frictions[friction] = None
    if lines.scale is not None:
        told = "Rowe, R = K D, of the friction or the large-strain angle of each"
        axes.plot([], [], color="0.3", lw=1, ls=(0, (6, 3)), label=told)
    for friction in frictions if len(frictions) == 1 else ():
        factor = float(theory.stress_ratio_of(float(np.arctan(friction))))
        _rowe(axes, factor, f"Rowe, f = {friction:g} between balls", "0.35", ":")
    if data is not None and data.volumetric_strain is not None:
        rate = dilatancy_rates(data.axial_strain, data.volumetric_strain)
        axes.plot(1 + rate, data.stress_ratio, label=_measured(data), **POINTS)
        top = max(top, float(np.max(data.stress_ratio)))
    axes.set(xlim=(0, 1.1 * far), ylim=(0.95, 1.08 * top), xlabel="dilatancy D = 1 - d eps_v/d eps_1 [-]")
    axes.set(ylabel="stress ratio R = s1/s3 [-]")
    return _finished(figure, lines)


def mohr(results: Sequence[Result], data: Measured | None = None) -> Figure:
    """Mohr's circles at the largest stress ratio; tests that differ by their loading alone have one envelope."""
    figure, axes = _figure()
    groups: dict[str, list[tuple[float, float, str]]] = {}
    ring = np.linspace(0, np.pi, 181)
    lines = Lines(results)
    for number, (result, name, line) in enumerate(lines.each):
        peak = laboratory(result.curve).peak
        s3 = float(result.curve.lateral_stress[peak.record])
        s1 = peak.stress_ratio * s3
        which = "" if peak.reached or not name else ", no peak yet"
        middle, radius = (s1 + s3) / 2, (s1 - s3) / 2
        axes.plot(middle + radius * np.cos(ring), radius * np.sin(ring), label=f"{name}{which}", **line)
        groups.setdefault(_material(result, number), []).append((s1, s3, line["color"]))
    far = axes.dataLim.x1
    for circles in groups.values():
        s1s, s3s, colours = zip(*circles, strict=True)
        envelope = theory.mohr_envelope(s1s, s3s)
        many = len(groups) > 1
        told = f"envelope, phi = {np.rad2deg(envelope.angle):.1f}°"
        told += f", c = {envelope.cohesion:.3g} {STRESS}" if envelope.cohesion else ""
        reach = np.array([0.0, far])
        heights = envelope.cohesion + reach * np.tan(envelope.angle)
        style = {"color": colours[0] if many else "0.25", "lw": 1, "ls": (0, (6, 3))}
        axes.plot(reach, heights, label="" if many and lines.scale is not None else told, **style)
    axes.set(xlabel=f"normal stress {STRESS}", ylabel=f"shear stress {STRESS}", xlim=(0, 1.02 * far))
    axes.set(ylim=(0, None), aspect="equal")
    return _finished(figure, lines)


KINDS: Mapping[str, Callable[[Sequence[Result], Measured | None], Figure]] = {
    "q-eps": q_strain,
    "eps_v-eps": volume_strain,
    "e-log-p": void_ratio_pressure,
    "q-p": q_pressure,
    "friction-dilatancy": friction_dilatancy,
    "stress-dilatancy": stress_dilatancy,
    "mohr": mohr,
}


def _figure():
    figure = Figure(figsize=(5.6, 4.8), layout="constrained")
    return figure, figure.add_subplot()


def _finished(figure: Figure, lines: Lines) -> Figure:
    """With a grid, the legend below the axes, and a scale of colours beside them where that tells the lines apart."""
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    handles, names = figure.axes[0].get_legend_handles_labels()
    if names:
        columns = 2 if len(names) > 4 and max(map(len, names)) < 34 else 1
        figure.legend(handles, names, loc="outside lower center", ncols=columns, frameon=False, fontsize=LETTERS)
    lines.bar(figure)
    return readable(figure)


def _measured(data: Measured) -> str:
    return plain(f"measured, {Path(data.source).name}")


def _smooth(curve, values) -> np.ndarray:
    """A record as it is drawn thick: smoothed where the specimen is random; NaN where the strain goes back."""
    values = np.asarray(values, float)
    used = advancing(curve.axial_strain) & np.isfinite(values)
    if not is_random(curve) or used.sum() < 3:
        return values
    smooth = np.full(values.shape, np.nan)
    smooth[used] = Smooth(np.asarray(curve.axial_strain, float)[used]).values(values[used])
    return smooth


def _draw(axes, curve, values, name: str, line) -> None:
    """A record against axial strain."""
    strain = 100 * curve.axial_strain.values
    if is_random(curve):
        axes.plot(strain, values, color=line["color"], lw=0.7, alpha=0.45)
    axes.plot(strain, _smooth(curve, values), label=name, lw=1.8, **line)


def _rowe(axes, factor: float, label: str, colour: str, style) -> None:
    axes.plot([0, 10], [0, 10 * factor], color=colour, lw=1, ls=style, label=label)


def _material(result: Result, number: int) -> str:
    """What a test was of, by all of its case but the loading; by itself where it has kept no case."""
    case = case_of(result)
    if case is None:
        return str(number)
    kept = {
        section: {field: value for field, value in fields.items() if field not in (LOADING.get(section) or ())}
        for section, fields in case.sections().items()
        if LOADING.get(section, ()) is not None
    }
    return repr(kept)
