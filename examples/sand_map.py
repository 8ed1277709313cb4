"""Which sands spheres with rolling resistance can be: strength and dilatancy over friction and rolling friction.

A dense and a medium specimen are packed with each seed and sheared with every pair of friction and rolling friction.
Every test writes one file, so the study may be stopped and started again; several processes share the packings:

    python examples/sand_map.py --output sand_map --workers 2 --picture sand_map.png     # half an hour

It writes table.csv into the output folder: means over the seeds with their standard errors. Then it
shears with what the map gives for each sand, and tells whether strength and dilatancy are that sand's.
"""

import argparse
import itertools
import json
import pickle
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from platen_friction import means
from specimen_pool import Deadline, Late, save_rows, work

# Compaction frictions: void ratios of about 0.59 and 0.69. Specimens are compacted without rolling resistance, which
# would keep them looser (0.63 and 0.82).
DENSITIES = {"dense": 0.03, "medium": 0.2}
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
PEAK = "peak friction angle [degrees]"


def test_of(options, specimen, friction: float, rolling: float):
    """A test of a specimen, at the inertial number of the study."""
    from axijax import Params, Sector, TriaxialTest, platen_speed

    params = Params(
        friction=friction, normal_stiffness=STIFFNESS, confining_stress=STRESS, rolling_friction=rolling, **HELD
    )
    params = replace(params, platen_speed=platen_speed(INERTIAL_NUMBER, specimen, params))
    return TriaxialTest(
        specimen, Sector(options.order), params=params, axial_strain=options.strain, tolerance=1e-3,
        confine_steps=100_000,
    )  # fmt: skip


def made(options, density: str, seed: int) -> str:
    """Pack a specimen, and keep it with its friction in confinement."""
    import axijax
    from axijax.core.files import write_whole

    if options.deadline.near():
        return "no time left"
    params = axijax.Params(
        friction=FRICTIONS[0], normal_stiffness=STIFFNESS, confining_stress=STRESS, rolling_friction=0.0, **HELD
    )
    packed, report = axijax.random_cylinder(
        options.size, axijax.Sector(options.order), compaction_friction=DENSITIES[density], seed=seed, params=params
    )
    path = specimen_file(options, density, seed)
    write_whole(path, lambda part: part.write_bytes(pickle.dumps((packed, report.compaction_friction))))
    return f"void ratio {report.counted_void_ratio:.3f}"


def sheared(options, density: str, seed: int, pair: tuple[float, float]) -> str:
    """Shear a specimen with a friction and a rolling friction, and keep its numbers."""
    from axijax.core.files import write_whole
    from axijax.triaxial.laboratory import laboratory

    started = time.process_time()
    try:
        options.deadline.look()
        specimen, confining_friction = pickle.loads(specimen_file(options, density, seed).read_bytes())
        test = replace(test_of(options, specimen, *pair), confining_friction=confining_friction)
        curve = test.run(progress=options.deadline.look).curve
        numbers = laboratory(curve)
        found = {
            "peak": numbers.friction_angle.value, "dilatancy": numbers.dilatancy,
            "strain": 100 * numbers.peak.axial_strain, "large": numbers.large_strain_angle.value,
            "void_ratio": float(curve.void_ratio[0]), "volume": 100 * float(curve.volumetric_strain[-1]),
        }  # fmt: skip
    except Late:
        return "no time left"
    except (ValueError, RuntimeError) as error:
        found = {"failed": str(error)}
    text = json.dumps(found)
    write_whole(file_of(options, density, seed, pair), lambda part: part.write_text(text))
    return f"{time.process_time() - started:.1f} s of CPU {found.get('failed', '')}"


def run_missing(options, pairs) -> None:
    """Make and shear what is missing of these pairs of each density, seed after seed."""
    work(
        options.workers,
        [(density, seed) for seed in range(options.seeds) for density in pairs],
        partial(made, options),
        lambda *specimen: specimen_file(options, *specimen).exists(),
        lambda density, seed: [each for each in pairs[density] if not file_of(options, density, seed, each).exists()],
        partial(sheared, options),
    )


PAIRS = tuple(itertools.product(FRICTIONS, ROLLING_FRICTIONS))


def specimen_file(options, density: str, seed: int) -> Path:
    return options.output / f"{density}_s{seed}.specimen"


def file_of(options, density: str, seed: int, pair: tuple[float, float]) -> Path:
    friction, rolling = pair
    return options.output / f"{density}_s{seed}_f{friction:g}_r{rolling:g}.json"


def row_of(options, density: str, pair: tuple[float, float]) -> dict | None:
    """Mean and standard error over the seeds, of a density and pair; None where no test has ended well."""
    files = [file_of(options, density, seed, pair) for seed in range(options.seeds)]
    found = [json.loads(file.read_text()) for file in files if file.exists()]
    sound = [each for each in found if "failed" not in each]
    return {"density": density, "friction": pair[0], "rolling_friction": pair[1]} | means(sound) if sound else None


def table(options) -> list[dict]:
    """The rows of the whole map."""
    rows = [row_of(options, density, pair) for density, pair in itertools.product(DENSITIES, PAIRS)]
    return [row for row in rows if row]


def draw(rows: list[dict], path: Path) -> None:
    """Per density: strength over the map, and strength against dilatancy with the sands' own points."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(9, 7.2), constrained_layout=True)
    for (density, sands), line in zip(SANDS.items(), panels, strict=True):
        mine = {(row["friction"], row["rolling_friction"]): row for row in rows if row["density"] == density}
        voids = np.mean([row["void_ratio"] for row in mine.values()])
        axes, reach = line
        values = np.array([[mine[f, r]["peak"] if (f, r) in mine else np.nan for f in FRICTIONS]
                           for r in ROLLING_FRICTIONS])  # fmt: skip
        levels = axes.contourf(FRICTIONS, ROLLING_FRICTIONS, values, np.arange(10, 65, 5), cmap="cividis")
        figure.colorbar(levels, ax=axes, label=PEAK)
        axes.plot(*np.meshgrid(FRICTIONS, ROLLING_FRICTIONS), "k.", ms=3, clip_on=False)
        axes.set(xlabel="friction f [-]", ylabel="rolling friction eta_r [-]")
        axes.set_title(f"{density}, void ratio {voids:.2f}", loc="left")
        draw_reach(reach, mine, sands)
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
    axes.set(xlabel=PEAK, ylabel="dilatancy rate at the peak [-]")
    axes.legend(fontsize=8, loc="upper left", frameon=False)


def away(peak, dilatancy, sand) -> np.ndarray:
    """How far a strength and a dilatancy are from a sand's, in units of 1 degree and 0.1."""
    return np.maximum(abs(peak - sand[0]), abs(dilatancy - sand[1]) / 0.1)


def where(rows: list[dict], sand: tuple) -> tuple[float, float]:
    """The friction and rolling friction at which the map, linear between its points, is nearest to a sand."""
    from scipy.interpolate import RegularGridInterpolator

    mine = {(row["friction"], row["rolling_friction"]): row for row in rows}
    values = np.array([[[mine[f, r][name] for name in ("peak", "dilatancy")] for r in ROLLING_FRICTIONS]
                       for f in FRICTIONS])  # fmt: skip
    fine = np.array(list(itertools.product(np.arange(0.1, 0.801, 0.01), np.arange(0, 0.801, 0.01)))).round(2)
    peak, dilatancy = RegularGridInterpolator((FRICTIONS, ROLLING_FRICTIONS), values)(fine).T
    return tuple(fine[np.argmin(away(peak, dilatancy, sand))].tolist())


def sands(options, rows: list[dict]) -> None:
    """Shear the specimens with what the map gives for each sand, and tell what comes of it."""
    chosen = {}
    for density, mine in SANDS.items():
        ours = [row for row in rows if row["density"] == density]
        if len(ours) == len(PAIRS):
            chosen |= {(density, name): where(ours, sand) for name, sand in mine.items()}
    run_missing(options, {density: [pair for key, pair in chosen.items() if key[0] == density] for density in SANDS})
    for (density, name), pair in chosen.items():
        angle, dilatancy, strain = sand = SANDS[density][name]
        row = row_of(options, density, pair)
        if row is None:
            continue
        print(
            f"{name} ({angle} degrees, {dilatancy}, at {strain} %): f {pair[0]:g}, eta_r {pair[1]:g} give "
            f"{row['peak']:.1f} +- {row['peak +-']:.1f} degrees, {row['dilatancy']:.2f} +- {row['dilatancy +-']:.2f}, "
            f"at {row['strain']:.1f} %, {'within' if away(row['peak'], row['dilatancy'], sand) <= 1 else 'not within'} "
            "1 degree and 0.1"
        )


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--output", type=Path, default=Path("sand_map"))
    asked.add_argument("--size", type=int, default=2000, help="balls in the full cylinder")
    asked.add_argument("--order", type=int, default=4, help="sectors in the full cylinder")
    asked.add_argument("--seeds", type=int, default=3)
    asked.add_argument("--strain", type=float, default=0.12)
    asked.add_argument("--workers", type=int, default=1, help="processes")
    asked.add_argument("--limit", type=float, default=1e9, help="seconds after which it ends, with what there is")
    asked.add_argument("--picture", type=Path, help="write a picture of the map here")
    options = asked.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    options.deadline = Deadline(options.limit)
    run_missing(options, {density: PAIRS for density in DENSITIES})
    rows = table(options)
    save_rows(options.output / "table.csv", rows)
    sands(options, rows)
    if options.picture:
        draw(rows, options.picture)


if __name__ == "__main__":
    main()
