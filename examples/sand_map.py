"""Which sands spheres with rolling resistance can be: strength and dilatancy over friction and rolling friction.

A dense and a medium specimen are packed with each seed and sheared with every pair of friction and rolling friction.
Every test writes one file, so the study may be stopped and started again; several processes share the packings:

    python examples/sand_map.py --output sand_map --workers 2 --picture sand_map.png     # two hours of one core

It writes table.csv into the output folder: means over the seeds with their standard errors.
"""

import argparse
import csv
import itertools
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from platen_friction import means

# Compaction frictions: void ratios of about 0.58 and 0.68, the larger of these further apart from seed to seed.
DENSITIES = {"dense": 0.05, "medium": 0.3}
FRICTIONS = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8)
ROLLING_FRICTIONS = (0.0, 0.1, 0.2, 0.4, 0.8)
INERTIAL_NUMBER = 1e-3
STRESS, STIFFNESS = 2e5, 1e10  # kn/(s3 r) = 2500, as Karlsruhe sand's curves ask for at 200 kPa
HELD = {"rolling_stiffness": 0.5, "shear_stiffness": 0.3 * STIFFNESS}
# Measured (examples/guide/PHYSICS.md, section 7): peak friction angle, dilatancy rate there, its strain [%].
SANDS = {
    "dense": {"Karlsruhe TMD18": (39.9, 0.63, 7.1), "Karlsruhe TMD17": (40.4, 0.72, 6.6)},
    "medium": {"Toyoura 0.2 MPa": (39.8, 0.65, 5.4), "Karlsruhe TMD13": (36.9, 0.35, 10.4)},
}
NUMBERS = {
    "peak": "peak friction angle [degrees]",
    "dilatancy": "dilatancy rate at the peak [-]",
    "strain": "axial strain at the peak [%]",
}


def sheared(test, friction: float, rolling: float) -> dict[str, float]:
    """What the study keeps of one test."""
    from axijax.triaxial.laboratory import laboratory

    params = replace(test.params, friction=friction, rolling_friction=rolling)
    curve = replace(test, params=params).run().curve
    found = laboratory(curve)
    return {
        "peak": found.friction_angle.value, "dilatancy": found.dilatancy, "strain": 100 * found.peak.axial_strain,
        "large": found.large_strain_angle.value, "void_ratio": float(curve.void_ratio[0]),
        "volume": 100 * float(curve.volumetric_strain[-1]),
    }  # fmt: skip


def work(options, specimen: tuple[str, int]) -> None:
    """Pack one specimen and run what is missing of its tests."""
    import axijax
    from axijax.core.files import write_whole

    axijax.fast_cpu_kernels()
    axijax.use_compilation_cache()
    density, seed = specimen
    missing = [pair for pair in pairs() if not file_of(options, density, seed, *pair).exists()]
    if not missing:
        return
    params = axijax.Params(
        friction=FRICTIONS[0], rolling_friction=0.1, normal_stiffness=STIFFNESS, confining_stress=STRESS, **HELD
    )
    sector = axijax.Sector(options.order)
    packed, report = axijax.random_cylinder(
        options.size, sector, compaction_friction=DENSITIES[density], seed=seed, params=params
    )
    test = axijax.TriaxialTest(
        packed, sector, params=replace(params, platen_speed=axijax.platen_speed(INERTIAL_NUMBER, packed, params)),
        axial_strain=options.strain, confining_friction=report.compaction_friction, tolerance=1e-3,
        confine_steps=100_000,
    )  # fmt: skip
    for friction, rolling in missing:
        started = time.perf_counter()
        try:
            found = sheared(test, friction, rolling)
        except (ValueError, RuntimeError) as error:
            found = {"failed": str(error)}
        path = file_of(options, density, seed, friction, rolling)
        write_whole(path, partial(write_text, json.dumps(found)))
        print(f"{path.stem}: {time.perf_counter() - started:.0f} s {found.get('failed', '')}", flush=True)


def write_text(text: str, path: Path) -> None:
    path.write_text(text)


def pairs():
    return itertools.product(FRICTIONS, ROLLING_FRICTIONS)


def file_of(options, density: str, seed: int, friction: float, rolling: float) -> Path:
    return options.output / f"{density}_s{seed}_f{friction:g}_r{rolling:g}.json"


def table(options) -> list[dict]:
    """Mean and standard error over the seeds, of every density and pair."""
    rows = []
    for density, (friction, rolling) in itertools.product(DENSITIES, pairs()):
        files = [file_of(options, density, seed, friction, rolling) for seed in range(options.seeds)]
        found = [json.loads(file.read_text()) for file in files if file.exists()]
        sound = [each for each in found if "failed" not in each]
        if not sound:
            continue
        rows.append({"density": density, "friction": friction, "rolling_friction": rolling} | means(sound))
    return rows


def draw(rows: list[dict], path: Path) -> None:
    """Per density: the numbers over the map, and strength against dilatancy with the sands' own points."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 4, figsize=(17, 7.2), constrained_layout=True)
    for (density, sands), line in zip(SANDS.items(), panels, strict=True):
        mine = {(row["friction"], row["rolling_friction"]): row for row in rows if row["density"] == density}
        voids = np.mean([row["void_ratio"] for row in mine.values()])
        for axes, name in zip(line, ("peak", "dilatancy", "strain"), strict=False):
            values = np.array([[mine[f, r][name] if (f, r) in mine else np.nan for f in FRICTIONS]
                               for r in ROLLING_FRICTIONS])  # fmt: skip
            levels = axes.contourf(FRICTIONS, ROLLING_FRICTIONS, values, 10, cmap="cividis")
            figure.colorbar(levels, ax=axes, label=NUMBERS[name])
            axes.plot(*np.meshgrid(FRICTIONS, ROLLING_FRICTIONS), "k.", ms=2)
            axes.set(xlabel="friction f [-]", ylabel="rolling friction eta_r [-]")
        line[0].set_title(f"{density}, void ratio {voids:.2f}", loc="left")
        draw_reach(line[3], mine, sands)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_reach(axes, mine: dict, sands: dict) -> None:
    """Dilatancy against strength: a line for each rolling friction, its points the frictions; the sands as crosses."""
    import matplotlib.pyplot as plt

    colours = plt.get_cmap("viridis")(np.linspace(0, 0.9, len(ROLLING_FRICTIONS)))
    for rolling, colour in zip(ROLLING_FRICTIONS, colours, strict=True):
        line = [mine[f, rolling] for f in FRICTIONS if (f, rolling) in mine]
        axes.errorbar(
            [row["peak"] for row in line], [row["dilatancy"] for row in line], [row["dilatancy +-"] for row in line],
            [row["peak +-"] for row in line], fmt=".-", color=colour, label=f"eta_r = {rolling:g}", lw=1,
        )  # fmt: skip
    for (name, (angle, dilatancy, _)), marker in zip(sands.items(), "PX", strict=False):
        axes.plot(angle, dilatancy, marker, color="crimson", ms=9, mec="white", label=name)
    axes.set(xlabel=NUMBERS["peak"], ylabel=NUMBERS["dilatancy"])
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def nearest(rows: list[dict]) -> None:
    """Tell the point of the map that is nearest to each sand, in units of 1 degree and 0.1."""
    for density, sands in SANDS.items():
        mine = [row for row in rows if row["density"] == density]
        for name, (angle, dilatancy, strain) in sands.items():
            away = [max(abs(row["peak"] - angle), abs(row["dilatancy"] - dilatancy) / 0.1) for row in mine]
            row = mine[int(np.argmin(away))]
            print(
                f"{name} ({angle} degrees, {dilatancy}, at {strain} %): nearest f {row['friction']:g}, eta_r "
                f"{row['rolling_friction']:g}: {row['peak']:.1f} +- {row['peak +-']:.1f} degrees, "
                f"{row['dilatancy']:.2f} +- {row['dilatancy +-']:.2f}, at {row['strain']:.1f} %"
            )


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--output", type=Path, default=Path("sand_map"))
    asked.add_argument("--size", type=int, default=2000, help="balls in the full cylinder")
    asked.add_argument("--order", type=int, default=4, help="sectors in the full cylinder")
    asked.add_argument("--seeds", type=int, default=3)
    asked.add_argument("--strain", type=float, default=0.12)
    asked.add_argument("--workers", type=int, default=1, help="processes")
    asked.add_argument("--picture", type=Path, help="write a picture of the map here")
    options = asked.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    specimens = [(density, seed) for seed in range(options.seeds) for density in DENSITIES]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        list(pool.map(partial(work, options), specimens))
    rows = table(options)
    with open(options.output / "table.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    nearest(rows)
    if options.picture:
        draw(rows, options.picture)


if __name__ == "__main__":
    main()
