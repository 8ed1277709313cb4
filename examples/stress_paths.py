"""Stress paths of random specimens: strength in compression and extension, undrained, K0, strain cycles.

Each specimen is made and confined once and loaded in all ways. What is known of such tests and looked for here:
extension is not weaker than compression by more than some degrees of friction angle; a dense specimen dilates
undrained, its effective stress grows; a loose one contracts, and liquefies or comes near it; K0 is near 1 - sin(phi)
(Jaky 1944); under small strain cycles the specimen becomes denser, and stiffness and contacts change with it
(O'Sullivan & Cui 2009).

    python examples/stress_paths.py --quick                          # two seeds of 120 balls: some minutes
    python examples/stress_paths.py --output paths --processes 6     # run what is missing
    python examples/stress_paths.py --output paths --table           # table and picture of what is there, runs nothing

Every specimen and every run writes one file, so the study may be stopped and started again at any time; with --limit it
ends by itself after so many seconds. table.csv holds means over the seeds with their standard errors.
"""

import argparse
import json
import pickle
import time
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from specimen_pool import Deadline, Late, save_rows, work

FRICTION = 0.5  # between balls, in the shear
DENSITIES = {"dense": 0.05, "loose": 0.4}  # friction in compaction and confinement
ORDER = 2  # sectors in the full cylinder
AMPLITUDE = 1e-3  # of the strain cycles, from one limit to the other
SHOWN = (1, 2, 5, 10, 20, 50, 100)  # cycles in the table
KEPT = (
    "axial_strain", "volumetric_strain", "stress_ratio", "core_ratio", "lateral_stress", "path_length", "servo_error",
    "coordination_number", "void_ratio", "unbalanced_force",
)  # fmt: skip


def stages_of(loading: str, options) -> tuple:
    """The one stage of a loading."""
    from axijax import stage

    strain = options.strain
    return {
        "cycles": lambda: (stage("cycles", first=AMPLITUDE, second=0.0, cycles=options.cycles),),
        "compression": lambda: (stage("compression", axial_strain=strain),),
        "extension": lambda: (stage("extension", axial_strain=-strain),),
        "undrained": lambda: (stage("compression", lateral="constant_volume", axial_strain=strain / 2),),
        "k0": lambda: (stage("compression", lateral="k0", axial_strain=strain / 4),),
    }[loading]()


LOADINGS = ("cycles", "compression", "extension", "undrained", "k0")  # the longest first


# ---- Running ----


def specimen_file(options, density: str, seed: int) -> Path:
    return options.output / f"{density}_{seed}.specimen"


def file_of(options, density: str, seed: int, loading: str) -> Path:
    return options.output / f"{density}_{seed}_{loading}.json"


def test_of(options, specimen, density: str, stages: tuple = ()):
    """A test of a specimen, at the inertial number that is asked for."""
    from axijax import Params, Sector, TriaxialTest, platen_speed

    params = Params(friction=FRICTION)
    params = replace(params, platen_speed=platen_speed(options.inertial_number, specimen, params))
    return TriaxialTest(
        specimen, Sector(ORDER), params=params, stages=stages, tolerance=1e-3, confine_steps=100_000,
        confining_friction=DENSITIES[density],
    )  # fmt: skip


def made(options, density: str, seed: int) -> str:
    """Make and confine a specimen, and keep it."""
    import axijax
    from axijax.core.files import write_whole

    if options.deadline.near():
        return "no time left"
    started = time.process_time()
    specimen, _ = axijax.random_cylinder(
        options.balls, axijax.Sector(ORDER), compaction_friction=DENSITIES[density], seed=seed
    )
    path = specimen_file(options, density, seed)
    test_of(options, specimen, density).confined(checkpoint=path.with_suffix(".npz"))
    write_whole(path, lambda part: part.write_bytes(pickle.dumps(specimen)))
    return f"made in {time.process_time() - started:.1f} s of CPU"


def loaded(options, density: str, seed: int, loading: str) -> str:
    """Load a confined specimen in one way, and keep what was recorded."""
    from axijax.core.files import write_whole
    from axijax.triaxial.checkpoint import load_progress

    started, ended = time.process_time(), ""
    path = specimen_file(options, density, seed)
    try:
        options.deadline.look()
        specimen = pickle.loads(path.read_bytes())
        test = test_of(options, specimen, density, stages_of(loading, options))
        run = test.run(start=load_progress(path.with_suffix(".npz"), test), progress=options.deadline.look)
        curve, ended = run.curve, run.ended
    except Late:
        return "no time left"
    except (ValueError, RuntimeError) as error:
        curve, ended = getattr(error, "curve", None), f"failed: {error}"
    seconds = time.process_time() - started
    kept = {} if curve is None else {name: np.asarray(getattr(curve, name), float) for name in KEPT}
    rounded = {name: [float(f"{value:.6g}") for value in values] for name, values in kept.items()}
    found = {"seconds": seconds, "balls": options.balls, "inertial_number": options.inertial_number, "ended": ended}
    text = json.dumps(found | {"curve": rounded})
    write_whole(file_of(options, density, seed, loading), lambda part: part.write_text(text))
    return f"{seconds:.1f} s of CPU, {len(rounded.get('axial_strain', ()))} records{ended and ', ' + ended}"


def run_missing(options) -> None:
    """Make and load what is missing, seed after seed."""
    work(
        options.processes,
        [(density, seed) for seed in range(options.seeds) for density in DENSITIES],
        partial(made, options),
        lambda *specimen: specimen_file(options, *specimen).exists(),
        lambda *specimen: [each for each in LOADINGS if not file_of(options, *specimen, each).exists()],
        partial(loaded, options),
    )


# ---- What is read off ----


def friction_angle(ratio: float) -> float:
    """Mobilised friction angle [degrees] at a ratio of the larger to the smaller principal stress."""
    return float(np.degrees(np.arcsin((ratio - 1) / (ratio + 1))))


def strength(strain: np.ndarray, ratio: np.ndarray) -> tuple[float, float, float]:
    """Largest friction angle and that of the last fifth of the strain [degrees], and the strain at the largest. Of the
    smoothed curve; strain and ratio of the larger to the smaller stress grow from 0 and 1."""
    from axijax.core.smoothing import Smooth, advancing

    ahead = advancing(strain)
    strain, ratio = strain[ahead], ratio[ahead]
    top = Smooth(strain).maximum(ratio)
    late = ratio[strain > 0.8 * strain[-1]].mean()
    return friction_angle(top.value), friction_angle(late), top.place


def cyclic(curve: dict[str, np.ndarray]) -> dict[str, float]:
    """Of strain cycles: secant modulus of the loading, (change of s1 - s3)/(strain x s3), volumetric strain, void ratio
    and contacts of a ball at the end of each of SHOWN."""
    deviator = (curve["stress_ratio"] - 1) * curve["lateral_stress"]
    number, place = np.divmod(curve["path_length"] / AMPLITUDE + 1e-9, 2)
    found = {}
    for cycle in SHOWN:
        inside = number == cycle - 1
        if not (number >= cycle).any() and curve["path_length"][-1] < (2 * cycle - 0.05) * AMPLITUDE:
            break
        up = inside & (place <= 1.02)
        modulus = np.ptp(deviator[up]) / np.ptp(curve["axial_strain"][up]) / curve["lateral_stress"][0]
        last = np.flatnonzero(inside)[-1]
        found |= {
            f"modulus/s3 in cycle {cycle}": modulus,
            f"volumetric strain after {cycle} [%]": 100 * curve["volumetric_strain"][last],
            f"void ratio after {cycle}": curve["void_ratio"][last],
            f"contacts after {cycle}": curve["coordination_number"][last],
        }
    return found


def numbers_of(runs: dict[str, dict]) -> dict[str, float]:
    """The numbers of one specimen, of those of its loadings that are there."""
    sound = {
        name: {key: np.array(values) for key, values in run["curve"].items()}
        for name, run in runs.items()
        if not run["ended"].startswith("failed") and len(run["curve"].get("axial_strain", ())) > 10
    }
    found: dict[str, float] = {}
    if any(sound):
        curve = next(iter(sound.values()))
        found |= {"void ratio": curve["void_ratio"][0], "contacts at the start": curve["coordination_number"][0]}
    for name, sign in (("compression", 1), ("extension", -1)):
        if name in sound:
            peak, late, at = strength(sign * sound[name]["axial_strain"], sound[name]["stress_ratio"] ** sign)
            found |= {f"phi in {name}": peak, f"phi in {name}, late": late, f"strain at peak, {name} [%]": 100 * at}
    if {"compression", "extension"} <= set(sound):
        for late in ("", ", late"):
            found[f"phi, extension - compression{late}"] = (
                found[f"phi in extension{late}"] - found[f"phi in compression{late}"]
            )
    if "undrained" in sound:
        curve = sound["undrained"]
        stress = curve["lateral_stress"] / curve["lateral_stress"][0]
        found |= {
            "undrained, s3' least/s3": stress.min(),
            "undrained, s3' last/s3": stress[-1],
            "undrained, liquefied": float("liquefied" in runs["undrained"]["ended"]),
            "undrained, strain at least s3' [%]": 100 * curve["axial_strain"][stress.argmin()],
        }
        if not runs["undrained"]["ended"]:
            last = curve["stress_ratio"][curve["axial_strain"] > 0.9 * curve["axial_strain"][-1]]
            found["undrained, phi of the last tenth"] = friction_angle(last.mean())
    if "k0" in sound:
        found["K0"] = 1 / sound["k0"]["stress_ratio"][-1]
        for late in ("", ", late"):
            if f"phi in compression{late}" in found:
                jaky = 1 - np.sin(np.radians(found[f"phi in compression{late}"]))
                found |= {f"1 - sin phi{late}": jaky, f"K0 - (1 - sin phi{late})": found["K0"] - jaky}
    return found | (cyclic(sound["cycles"]) if "cycles" in sound else {})


def runs_of(options, density: str, seed: int) -> dict[str, dict]:
    files = {loading: file_of(options, density, seed, loading) for loading in LOADINGS}
    return {loading: json.loads(file.read_text()) for loading, file in files.items() if file.exists()}


def table(options) -> list[dict]:
    """A row for each density and number: mean over the seeds, standard error, seeds."""
    rows = []
    for density in DENSITIES:
        found = [numbers_of(runs_of(options, density, seed)) for seed in range(options.seeds)]
        for name in dict.fromkeys(name for numbers in found for name in numbers):
            values = np.array([numbers[name] for numbers in found if name in numbers], float)
            values = values[np.isfinite(values)]
            if values.size:
                error = values.std(ddof=1) / values.size**0.5 if values.size > 1 else float("nan")
                rows.append(
                    {"density": density, "what": name, "mean": values.mean(), "error": error, "seeds": values.size}
                )
    return rows


def write_table(rows: list[dict], path: Path) -> None:
    if not rows:
        return
    save_rows(path, rows)
    for row in rows:
        print(f"{row['density']}: {row['what']}: {row['mean']:.4g} +- {row['error']:.2g} ({row['seeds']} seeds)")


def draw(options, path: Path) -> None:
    """A line for each specimen: drained both ways, undrained stress path, K0, stiffness against cycles."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(10, 7.5))
    for (density, colour), seed in product(zip(DENSITIES, ("#0072B2", "#D55E00"), strict=True), range(options.seeds)):
        runs = runs_of(options, density, seed)
        curves = {name: {k: np.array(v) for k, v in run["curve"].items()} for name, run in runs.items() if run["curve"]}
        style = {"color": colour, "lw": 0.8, "alpha": 0.7, "label": density if seed == 0 else None}
        for name in {"compression", "extension"} & set(curves):
            curve = curves[name]
            panels[0, 0].plot(100 * curve["axial_strain"], curve["stress_ratio"], **style | {"label": None})
        for name, panel in {"undrained": panels[0, 1], "k0": panels[1, 0]}.items():
            if name in curves:
                s3, ratio = curves[name]["lateral_stress"] / 1e3, curves[name]["stress_ratio"]
                panel.plot(s3 * (ratio + 2) / 3, s3 * (ratio - 1), **style)
        if "cycles" in curves:
            found = cyclic(curves["cycles"])
            cycles = [cycle for cycle in SHOWN if f"modulus/s3 in cycle {cycle}" in found]
            panels[1, 1].semilogx(cycles, [found[f"modulus/s3 in cycle {cycle}"] for cycle in cycles], ".-", **style)
    told = (
        ("compression and extension", "axial strain [%]", "s1/s3 [-]"), ("constant volume", "p' [kPa]", "q [kPa]"),
        ("no lateral strain", "p' [kPa]", "q [kPa]"), ("strain cycles of 0.1 %", "cycle", "secant modulus / s3 [-]"),
    )  # fmt: skip
    for panel, (title, x, y) in zip(panels.ravel(), told, strict=True):
        panel.set(title=title, xlabel=x, ylabel=y)
    panels[0, 1].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("stress_paths"))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--limit", type=float, default=1e9, help="seconds after which it ends, with what there is")
    parser.add_argument("--balls", type=int, default=1200, help="in the full cylinder; half are simulated")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--strain", type=float, default=0.12, help="axial strain of compression and extension")
    parser.add_argument("--cycles", type=int, default=100)
    parser.add_argument("--inertial-number", type=float, default=5e-4, help="gives the platen speed")
    parser.add_argument("--quick", action="store_true", help="two seeds of 120 balls, ten cycles, ten times as fast")
    parser.add_argument("--table", action="store_true", help="table and picture of what is there, runs nothing")
    options = parser.parse_args()
    if options.quick:
        quick = {"balls": 120, "seeds": 2, "strain": 0.04, "cycles": 10, "inertial_number": 5e-3}
        options = argparse.Namespace(**vars(options) | quick)
    options.output.mkdir(parents=True, exist_ok=True)
    if not options.table:
        options.deadline = Deadline(options.limit)
        run_missing(options)
    write_table(table(options), options.output / "table.csv")
    draw(options, options.output / "stress_paths.png")


if __name__ == "__main__":
    main()
