"""Error against seconds for every knob of the test, with LAMMPS and YADE on the same axes; and the same for gradients.

    python examples/speed_accuracy.py --output speed_accuracy [--parts references,ours,peers,gradients] [--draw]

Peaks: the error is that of the peak stress ratio against the converged peak of the same code (small steps, slow
platens, tight confinement); for the lattice-consistent specimen, against Thornton's closed form. Seconds are those of a
compiled program, on one core unless said: confinement and shear for ours, which is the quarter unless the knob says
otherwise, and the shear of the full cylinder alone for LAMMPS and YADE, which start from our confined specimen.
Gradients: dR/df of the window mean and of the hard maximum by forward mode, reverse mode and central differences,
against differences of the converged run extrapolated to h = 0; seconds of the shear, the confined state being the same.

Points are kept in points.json in the output folder, and those that are there are not computed again; --draw makes
speed_accuracy.png, gradients.png and fastest.md of them without computing any.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent / "peers"))

from benchmark import first_cores, machine
from peers import LAMMPS, YADE, Ours, missing, run_peer

PARTS = ("references", "ours", "peers", "gradients")
STRAIN = 0.0045  # the peak lies at 0.3 to 0.4 %
SPEED = 0.01  # the paper's platen speed
FRICTION = 0.12278
DEFAULTS = "defaults"
CONVERGED = {"share": 0.15, "speed": 1 / 8, "tolerance": 1e-8}
# Knobs of ours: a line each, through the defaults. speed in the paper's, share of the critical time step.
SETTINGS: dict[str, list[dict]] = {
    "platen speed": [{"speed": v} for v in (0.5, 2, 3, 4, 6, 8)],
    "time step": [{"share": s} for s in (0.3, 0.45, 0.7, 0.8)],
    "float32, platen speed": [{"dtype": "float32", "tolerance": 1e-3, "speed": v} for v in (1, 2, 4, 8)],
    "sector n": [{"order": 2}, {"order": 1}],
    "layers": [{"layers": n} for n in (21, 17, 13, 9)],
    "steps between records": [{"record": n} for n in (10, 20, 200, 1000)],
    "cells never refreshed": [{"refresh": False}],
    "confinement tolerance": [{"tolerance": t} for t in (1e-5, 1e-3, 1e-2, 1e-1)],
    "stop strain": [{"strain": e} for e in (0.004, 0.007, 0.01)],
    "dashpots' beta": [{"beta": b} for b in (0.01, 0.02, 0.1, 0.2)],
    "local damping": [{"damping": "local", "share": 0.7, "speed": v} for v in (1, 2, 4)],
    "lattice load, closed form": [{"lattice": True, "strain": 0.001, "speed": v} for v in (0.1, 0.2, 0.4, 0.8)],
}
FAST = {"share": 0.8, "beta": 0.02, "tolerance": 3e-2, "strain": 0.004}
SETTINGS["all together"] = [FAST | {"speed": v} for v in (0.7, 1, 1.5, 2, 3, 3.5, 4, 6)]
SETTINGS["all together, float32"] = [FAST | {"dtype": "float32", "speed": v} for v in (0.7, 1, 1.5, 2, 3, 3.5, 4, 6)]
PEER_SPEEDS = (0.7, 1, 1.5, 2, 3, 4, 6)
PEER_SHARES = {"dashpot": (0.8, 0.6, 0.3), "local": (0.75, 0.5, 0.25)}  # of the critical step of that damping
DIFFERENCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5)
FUNCTIONALS = {"window": "mean from 0.25 to 0.5 % strain", "peak": "hard maximum"}
SLOPE_STRAIN = 0.0055  # covers the window


def options_of(setting: dict, layers: int) -> dict:
    """Options of an `axijax_shear` process for a setting."""
    setting = dict(setting)
    test = {"axial_strain": setting.pop("strain", STRAIN), "tolerance": setting.pop("tolerance", 1e-7)}
    test |= {"record_every": setting.pop("record", 50), "refresh": setting.pop("refresh", True)}
    params = {"platen_speed": SPEED * setting.pop("speed", 1)}
    if setting.get("damping") != "local":
        params["damping_ratio"] = setting.pop("beta", 0.05)
    options = {
        "what": "whole",
        "specimen": {"layers": setting.pop("layers", layers)},
        "order": setting.pop("order", 4),
        "params": params,
        "share": setting.pop("share", 0.6),
        "test": test,
    }
    return options | setting


def label(setting: dict) -> str:
    return ", ".join(f"{name} {f'{value:g}' if isinstance(value, float) else value}" for name, value in setting.items())


class Study:
    """Points by name, kept in a file as they come."""

    def __init__(self, folder: Path, layers: int, repeats: int):
        self.folder, self.layers, self.repeats = folder, layers, repeats
        folder.mkdir(parents=True, exist_ok=True)
        self.file = folder / "points.json"
        self.points: dict[str, dict] = json.loads(self.file.read_text())["points"] if self.file.exists() else {}

    def point(self, name: str, measure) -> dict:
        """The point of this name: found, or measured and kept. A failure is kept as its sentence."""
        if name not in self.points:
            try:
                self.points[name] = measure()
            except RuntimeError as error:
                self.points[name] = {"failed": str(error)[-300:]}
            self.file.write_text(json.dumps({"machine": machine(), "points": self.points}, indent=1))
            shown = {k: v for k, v in self.points[name].items() if k in ("seconds", "cold", "peak", "steps", "failed")}
            print(f"{name}: {shown}", flush=True)
        return self.points[name]

    def ours(self, setting: dict, repeats: int | None = None) -> dict:
        """A setting's peak and seconds; `cold` from the start of the process."""
        began = time.perf_counter()
        with Ours(first_cores(1), **options_of(setting, self.layers)) as one:
            first = one.run()
            cold = time.perf_counter() - began
            runs = [first, *(one.run() for _ in range((repeats or self.repeats) - 1))]
        return first | {"setting": setting, "seconds": float(np.median([r["seconds"] for r in runs])), "cold": cold}

    def scene(self, path: Path) -> dict:
        """Write the full cylinder, confined, for the peers; what they need to know of its time steps."""
        options = options_of({"order": 1, "tolerance": 1e-7, "refresh": False}, self.layers)
        options |= {"what": "shear", "blocks": 2, "scene": str(path)}
        with Ours(first_cores(1), **options) as one:
            numbers = np.load(path)
            mass = float(numbers["density"]) * 4 / 3 * np.pi * float(numbers["radius"].mean()) ** 3
            undamped = 0.3162 * np.sqrt(mass / float(numbers["normal_stiffness"]))  # of FCC with kn = ks
            return {
                "critical": {"dashpot": one.ready["time_step"] / 0.6, "local": float(undamped)},
                "height": float(np.ptp(numbers["platens"])), "ramp": float(numbers["ramp_time"]),
            }  # fmt: skip

    def peer(
        self, code: str, scene: Path, facts: dict, damping: str, share: float, speed: float, cores: int, repeats: int
    ) -> dict:  # fmt: skip
        """A peer's peak and seconds, sheared as far as ours."""
        step = share * facts["critical"][damping]
        duration = STRAIN * facts["height"] / (2 * SPEED * speed) + facts["ramp"] / 2
        steps = int(np.ceil(duration / step / 50)) * 50
        runs, cold = [], None
        for _ in range(repeats):
            began = time.perf_counter()
            done = run_peer(
                code, scene, steps, first_cores(cores), damping=damping, time_step=step, speed=SPEED * speed
            )
            cold = cold or time.perf_counter() - began
            runs.append(done)
        top = runs[0].stress_ratio.argmax()
        return {
            "setting": {"damping": damping, "share": share, "speed": speed, "cores": cores},
            "peak": float(runs[0].stress_ratio[top]), "strain_at_peak": float(runs[0].axial_strain[top]),
            "steps": steps, "seconds": float(np.median([run.seconds for run in runs])), "cold": cold,
        }  # fmt: skip

    def references(self) -> None:
        self.point("reference ours", lambda: self.ours(CONVERGED, 1))
        self.point("reference slopes", self.reference_slopes)
        with tempfile.TemporaryDirectory() as folder:
            scene, facts = Path(folder) / "scene.npz", None
            # Half the default step and a quarter of the paper's speed: ours is converged to 0.01 % there.
            for code, damping in ((LAMMPS, "dashpot"), (LAMMPS, "local"), (YADE, "local")):
                name = f"reference {code} {damping}"
                if code not in missing() and name not in self.points:
                    facts = facts or self.scene(scene)
                    arguments = (code, scene, facts, damping, 0.3, 0.25, 1, 1)
                    self.point(name, lambda a=arguments: self.peer(*a))

    def all_ours(self) -> None:
        self.point(f"ours: {DEFAULTS}", lambda: self.ours({}))
        for knob, settings in SETTINGS.items():
            for setting in settings:
                self.point(f"ours: {knob}: {label(setting)}", lambda s=setting: self.ours(s))
        fastest = self.fastest_ours(1.0)
        if fastest:  # how its time is divided
            self.point("ours: shear of the fastest", lambda: self.shear_alone(fastest["setting"]))

    def shear_alone(self, setting: dict) -> dict:
        """The shear of a setting without its confinement, as the peers are timed."""
        with Ours(first_cores(1), **(options_of(setting, self.layers) | {"what": "slopes"})) as one:
            return {"seconds": float(np.median([one.run()["seconds"] for _ in range(max(3, self.repeats))]))}

    def all_peers(self) -> None:
        for code, why in missing().items():
            print(f"{code} {why}")
        with tempfile.TemporaryDirectory() as folder:
            scene, facts = Path(folder) / "scene.npz", None
            for code in (code for code in (LAMMPS, YADE) if code not in missing()):
                # Threads only slow YADE down.
                cores = (1, 2) if code == LAMMPS and len(first_cores(2)) == 2 else (1,)
                for damping in ("dashpot", "local") if code == LAMMPS else ("local",):
                    largest, *smaller = PEER_SHARES[damping]
                    for count in cores:
                        wanted = [(largest, speed) for speed in PEER_SPEEDS]
                        wanted += [(share, 1) for share in smaller] if count == 1 else []
                        for share, speed in wanted:
                            name = f"{code}: {damping}, {count} core(s): step {share:g}, speed {speed:g}"
                            if name not in self.points:
                                facts = facts or self.scene(scene)
                                arguments = (code, scene, facts, damping, share, speed, count, self.repeats)
                                self.point(name, lambda a=arguments: self.peer(*a))

    def slopes(self, setting: dict, **options) -> Ours:
        settings = options_of({"strain": SLOPE_STRAIN} | setting, self.layers)
        return Ours(first_cores(1), **(settings | {"what": "slopes"} | options))

    def reference_slopes(self) -> dict:
        """dR/df of the converged run: central differences at h and h/2, extrapolated to h = 0; of several h, the one
        where two extrapolations differ least."""
        steps = 8e-3 / 2.0 ** np.arange(4)
        with self.slopes({"share": 0.3, "speed": 0.25, "tolerance": 1e-8}) as one:
            pairs = [[one.run(friction=FRICTION + sign * h) for sign in (1, -1)] for h in steps]
        result = {}
        for name in FUNCTIONALS:
            central = np.array([(up[name] - down[name]) / (2 * h) for (up, down), h in zip(pairs, steps, strict=True)])
            extrapolated = (4 * central[1:] - central[:-1]) / 3
            best = int(np.abs(np.diff(extrapolated)).argmin())
            result[name] = float(extrapolated[best])
            result[f"{name} uncertainty"] = float(abs(np.diff(extrapolated)[best]))
        return result

    def gradients(self) -> None:
        for speed in (1, 2, 4):
            self.point(f"slope: forward: speed {speed}", lambda v=speed: self.derivative({"speed": v}, tangents=1))
        for speed in (1, 4):
            self.point(f"slope: reverse: speed {speed}", lambda v=speed: self.derivative({"speed": v}, reverse=True))
        self.point("slope: forward, float32: speed 1", lambda: self.derivative(
            {"speed": 1, "dtype": "float32", "tolerance": 1e-3}, tangents=1))  # fmt: skip
        for speed in (1, 4):
            if f"slope: differences, speed {speed}: h {DIFFERENCES[-1]:g}" not in self.points:
                self.differences({"speed": speed})

    def derivative(self, setting: dict, **options) -> dict:
        with self.slopes(setting, **options) as one:
            runs = [one.run() for _ in range(self.repeats)]
            slopes = {name: runs[0].get(f"{name}_slope") for name in FUNCTIONALS}
            compile_seconds = one.ready["compile_seconds"]
        seconds = float(np.median([run["seconds"] for run in runs]))
        return {"setting": setting, "seconds": seconds, "compile_seconds": compile_seconds, **slopes}

    def differences(self, setting: dict) -> None:
        with self.slopes(setting) as one:
            for h in DIFFERENCES:

                def central(h=h, one=one):
                    up, down = one.run(friction=FRICTION + h), one.run(friction=FRICTION - h)
                    slopes = {name: (up[name] - down[name]) / (2 * h) for name in FUNCTIONALS}
                    return {"setting": setting, "h": h, "seconds": up["seconds"] + down["seconds"], **slopes}

                self.point(f"slope: differences, speed {setting['speed']}: h {h:g}", central)

    # What the points say.

    def error(self, name: str) -> float:
        """Error of a point's peak [%], of either sign."""
        point = self.points[name]
        if point.get("setting", {}).get("lattice"):
            from axijax import theory

            return 100 * (point["peak"] / theory.fcc_stress_ratio(FRICTION) - 1)
        code = name.split(":")[0]
        damping = "" if code == "ours" else f" {point['setting']['damping']}"
        reference = self.points[f"reference {code}{damping}"]["peak"]
        return 100 * (point["peak"] / reference - 1)

    def lines(self, code: str) -> dict[str, list[tuple[float, float, str]]]:
        """Lines of a code, by what changes along them: (seconds, |error| [%], name) of their points."""
        found: dict[str, list] = {}
        for name, point in self.points.items():
            parts = name.split(": ")
            if parts[0] != code or "peak" not in point or point.get("status"):
                continue
            found.setdefault(parts[1], []).append((point["seconds"], abs(self.error(name)), name))
        return found

    def front(self, code: str, cores: int = 1) -> list[tuple[float, float, str]]:
        """Points of a code that no other beats in both seconds and error, from the fastest. A point counts with the
        largest error of the slower ones on its line too, so that an error that happens to cross zero is no merit."""
        candidates = []
        for line, points in self.lines(code).items():
            if "closed form" in line:
                continue
            worst = 0.0
            for seconds, error, name in sorted(points, reverse=True):
                worst = max(worst, error)
                if self.points[name]["setting"].get("cores", 1) <= cores:
                    candidates.append((seconds, worst, name))
        best, front = np.inf, []
        for point in sorted(candidates):
            if point[1] < best:
                best = point[1]
                front.append(point)
        return front

    def fastest(self, code: str, tolerance: float, cores: int = 1):
        """The fastest point of a code with an error of at most tolerance [%]; None where there is none."""
        return next((point for point in self.front(code, cores) if point[1] <= tolerance), None)

    def fastest_ours(self, tolerance: float):
        found = self.fastest("ours", tolerance) if "reference ours" in self.points else None
        return found and self.points[found[2]]

    def table(self) -> str:
        """Seconds to a peak within 1 % and 0.1 %, each code at its own best."""
        lines = [
            "Seconds to a peak within 1 % and within 0.1 % of the code's own converged peak. Ours: confinement and "
            "shear of the quarter; the others: the shear of the full cylinder alone, from our confined state.",
            "",
            "| within | code | cores | settings | error | warm s | cold s | times ours |",
            "|---|---|---|---|---|---|---|---|",
        ]
        for tolerance in (1.0, 0.1):
            ours = self.fastest("ours", tolerance)
            for code, cores in (("ours", 1), (LAMMPS, 1), (LAMMPS, 2), (YADE, 1)):
                found = self.fastest(code, tolerance, cores)
                if not found:
                    continue
                seconds, _, name = found
                cold, times = self.points[name]["cold"], f"{seconds / ours[0]:.1f}" if ours else "-"
                lines.append(
                    f"| {tolerance:g} % | {code} | {cores} | {name.split(': ', 1)[1]} | {self.error(name):+.3f} % "
                    f"| {seconds:.3f} | {cold:.1f} | {times} |"
                )
        if "ours: shear of the fastest" in self.points:
            alone = self.points["ours: shear of the fastest"]["seconds"]
            lines += ["", f"Of ours within 1 %, the shear alone takes {alone:.3f} s."]
        lines += ["", "Converged peaks: " + ", ".join(
            f"{name.removeprefix('reference ')} {point['peak']:.4f}"
            for name, point in self.points.items() if name.startswith("reference") and "steps" in point
        ) + "."]  # fmt: skip
        lines += ["", "| point | error | warm s | cold s | steps |", "|---|---|---|---|---|"]
        for name, point in self.points.items():
            if "peak" in point and "steps" in point and not name.startswith("reference"):
                broken = " (status)" if point.get("status") else ""
                lines.append(
                    f"| {name} | {self.error(name):+.4f} %{broken} | {point['seconds']:.3f} | {point['cold']:.1f} "
                    f"| {point['steps']:.0f} |"
                )
        return "\n".join(lines) + "\n"


# Okabe and Ito's colours, told apart by the colour-blind.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK, GREY = (
    "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000", "#888888",
)  # fmt: skip
LEAST = 2e-4  # errors below this are drawn there [%]
KNOB_STYLE = {
    "platen speed": (BLUE, "o"), "time step": (ORANGE, "s"), "float32, platen speed": (SKY, "v"),
    "sector n": (GREEN, "D"), "layers": (RED, "^"), "steps between records": (PURPLE, "P"),
    "cells never refreshed": (PURPLE, "X"), "confinement tolerance": (GREY, "<"), "stop strain": (BLACK, ">"),
    "dashpots' beta": (RED, "p"), "local damping": (GREEN, "h"),
    "lattice load, closed form": (RED, "*"), "all together": (BLACK, "o"),
    "all together, float32": (GREY, "v"),
}  # fmt: skip


def log_axes(axes, x: str, y: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log", xlabel=x, ylabel=y)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0) if axis is axes.xaxis else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.25, which="major")
    axes.spines[["top", "right"]].set_visible(False)


def put_labels(axes, labels: list[tuple[float, float, str, str]]) -> None:
    """Labels beside points (x, y, text, colour), moved up or down where they would overlap (once limits are set)."""
    from matplotlib.patheffects import withStroke

    scale = axes.figure.dpi / 72
    box = axes.get_window_extent()
    taken: list[tuple[float, float, float]] = []

    def free(at, start, end):
        clear = all(abs(at - y) >= 11 * scale or start > right or end < left for y, left, right in taken)
        return clear and box.y0 + 5 * scale < at < box.y1 - 5 * scale

    for x, y, text, colour in sorted(labels, key=lambda label: label[0]):
        px, py = axes.transData.transform((x, y))
        start, end = px + 7 * scale, px + (7 + 4.7 * len(text)) * scale
        shifts = [sign * 3 * scale * n for n in range(150) for sign in (1, -1)]
        shift = next((d for d in shifts if free(py + d, start, end)), 0.0)
        taken.append((py + shift, start, end))
        far = abs(shift) > 8 * scale
        axes.annotate(
            text, (x, y), xytext=(7, shift / scale), textcoords="offset points", color=colour, fontsize=8,
            va="center", arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.5} if far else None,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )  # fmt: skip


def draw_peaks(study: Study, path: Path) -> None:
    """Left: every knob of ours through the defaults. Right: the codes, with the front of each."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(15, 7), sharey=True, layout="constrained")
    ours = study.lines("ours")
    default = ours.pop(DEFAULTS, [None])[0]
    labels: tuple[list, list] = ([], [])

    def line(axes, points, colour, marker, text, size=6, **style):
        x, y = np.array([(seconds, max(error, LEAST)) for seconds, error, _ in sorted(points)]).T
        axes.plot(x, y, color=colour, marker=marker, ms=size, lw=size / 5, **style)
        if text:
            away = np.log(x / default[0]) ** 2 + np.log(y / default[1]) ** 2 if default else x / y
            end = int(np.argmax(away))
            labels[axes is right].append((x[end], y[end], text, colour))

    for knob, points in ours.items():
        colour, marker = KNOB_STYLE.get(knob, (GREY, "o"))
        apart = any(part in knob for part in ("all together", "closed form", "float32", "local"))
        through = [] if default is None or apart else [default]
        line(left, points + through, colour, marker, knob, ls="--" if "all together" in knob else "-")
    for code, colour in (("ours", BLUE), (LAMMPS, RED), (YADE, GREEN)):
        for name, points in study.lines(code).items() if code != "ours" else ():
            damping, cores = name.split(", ")
            style = {"mfc": "white"} if cores.startswith("2") else {}
            style |= {"ls": ":" if damping == "local" else "-", "alpha": 0.8}
            largest = PEER_SHARES[damping][0]
            by_speed = [point for point in points if study.points[point[2]]["setting"]["share"] == largest]
            by_step = [point for point in points if study.points[point[2]]["setting"]["speed"] == 1]
            text = f"{code}, {damping}" + (", 2 cores" if cores.startswith("2") else "")
            line(right, by_speed, colour, "s" if code == LAMMPS else "^", "", label=text, **style)
            if len(by_step) > 1:
                line(right, by_step, colour, "x", "", 4, **(style | {"mfc": None}))
        if code == "ours" and (front := study.front(code)):
            for _, points in ours.items():
                right.plot(*np.array([(s, max(e, LEAST)) for s, e, _ in points]).T, ".", color=BLUE, alpha=0.25)
            x, y = np.array([(s, max(e, LEAST)) for s, e, _ in front]).T
            for axes in (left, right):
                axes.step(x, y, where="post", color=BLUE, lw=3, alpha=0.3)
            labels[1].append((x[0], y[0], "ours, quarter: Pareto front", BLUE))
    for axes, which in ((left, 0), (right, 1)):
        if default is not None:
            axes.plot(default[0], max(default[1], LEAST), "o", ms=15, mfc="none", mec=BLACK, mew=2)
            labels[which].append((default[0], max(default[1], LEAST), "   our defaults", BLACK))
        log_axes(axes, "seconds, one core unless said, compiled", "")
        axes.axhline(1.0, color=GREY, lw=0.7), axes.axhline(0.1, color=GREY, lw=0.7)
        low, high = axes.get_xlim()
        axes.set_xlim(low / 1.1, high * (2.2 if axes is left else 3.0))
    if right.get_legend_handles_labels()[0]:
        right.legend(frameon=False, loc="upper right")
    left.set_ylabel("error of the peak stress ratio [%]")
    left.set_title("Every knob of the simulator, one at a time from the defaults", loc="left", fontsize=11)
    right.set_title(
        "Full cylinder in LAMMPS and YADE (shear alone), our quarter (whole test)\n"
        "lines: platen speed at the largest step; crosses: time step at the paper's speed",
        loc="left", fontsize=11,
    )  # fmt: skip
    figure.canvas.draw()
    for axes, wanted in ((left, labels[0]), (right, labels[1])):
        if wanted:
            put_labels(axes, wanted)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_gradients(study: Study, path: Path) -> None:
    """Error of dR/df against seconds, a panel for each functional."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(13, 5.5), sharey=True, layout="constrained")
    reference = study.points["reference slopes"]
    styles = {"forward": (BLUE, "o"), "forward, float32": (SKY, "v"), "reverse": (ORANGE, "D")}
    for axes, (functional, title) in zip(panels, FUNCTIONALS.items(), strict=True):
        labels, lines = [], {}
        for name, point in study.points.items():
            if name.startswith("slope: ") and point.get(functional) is not None:
                error = max(100 * abs(point[functional] / reference[functional] - 1), 1e-4)
                lines.setdefault(name.split(": ")[1], []).append((point["seconds"], error, name.split(": ")[2]))
        for line, points in lines.items():
            colour, marker = styles.get(line, (GREEN if line.endswith("1") else RED, "s"))
            if line not in styles:  # of the differences' steps h, which cost the same, the best and the worst
                points = [best(points, key=lambda point: point[1]) for best in (min, max)]
                points = [
                    (*point[:2], f"{point[2]} ({which})")
                    for point, which in zip(points, ("best", "worst"), strict=True)
                ]
            x, y = np.array([point[:2] for point in points]).T
            axes.plot(x, y, color=colour, marker=marker, ls="-", lw=1.2, ms=7)
            labels += [(s, e, f"{line}, {text}", colour) for s, e, text in points]
        log_axes(axes, "seconds of the shear, one core, compiled", "")
        low, high = axes.get_xlim()
        axes.set_xlim(low / 1.2, high * 3)
        floor = 100 * reference[f"{functional} uncertainty"] / abs(reference[functional])
        axes.axhspan(0, max(floor, 1e-4), color=GREY, alpha=0.2, lw=0)
        axes.set_title(f"dR/df of the {title}: {reference[functional]:.3f}", loc="left", fontsize=11)
        figure.canvas.draw()
        if labels:
            put_labels(axes, labels)
    panels[0].set_ylabel("error of dR/df [%]; grey: the reference's own uncertainty")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw(study: Study) -> None:
    if "reference ours" in study.points:
        draw_peaks(study, study.folder / "speed_accuracy.png")
        (study.folder / "fastest.md").write_text(study.table())
        print(study.table())
    if "reference slopes" in study.points:
        draw_gradients(study, study.folder / "gradients.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("speed_accuracy"), help="folder")
    parser.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--layers", type=int, default=25, help="of the specimen; the closed form and peaks are for 25")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--draw", action="store_true", help="draw what is there and compute nothing")
    options = parser.parse_args()
    parts = options.parts.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"--parts {', '.join(sorted(unknown))}: known are {', '.join(PARTS)}")
    study = Study(options.output, options.layers, options.repeats)
    work = dict(zip(PARTS, (study.references, study.all_ours, study.all_peers, study.gradients), strict=True))
    for part in () if options.draw else parts:
        work[part]()
    draw(study)


if __name__ == "__main__":
    main()
