"""Stress paths of random specimens: strength in compression and extension, undrained, K0, strain cycles.

    python examples/stress_paths.py --balls 200 --seeds 5 --output paths.csv

Each specimen is confined once and loaded in all ways. What is known of such tests and looked for here: extension is not
weaker than compression by more than some degrees of friction angle; a dense specimen dilates undrained, its effective
stress grows; a loose one contracts, and liquefies or comes near it; K0 is near 1 - sin(phi) (Jaky 1944); under small
strain cycles stiffness grows and the specimen becomes denser (O'Sullivan & Cui 2009). Means with their standard errors.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

import axijax
from axijax import Params, Sector, TriaxialTest, platen_speed, random_cylinder, stage

FRICTION = 0.5  # of the shear
DENSITIES = {"dense": 0.05, "loose": 0.4}  # friction of compaction


def friction_angle(ratio: float) -> float:
    """Mobilised friction angle [degrees] at a ratio of the larger to the smaller principal stress."""
    return float(np.degrees(np.arcsin((ratio - 1) / (ratio + 1))))


def loadings(strain: float, cycles: int) -> dict[str, tuple]:
    return {
        "compression": (stage("compression", axial_strain=strain),),
        "extension": (stage("extension", axial_strain=-strain),),
        "undrained": (stage("compression", lateral="constant_volume", axial_strain=strain),),
        "k0": (stage("compression", lateral="k0", axial_strain=strain / 3),),
        "cycles": (stage("cycles", first=1e-3, second=0.0, cycles=cycles),),
    }


def study(balls: int, compaction: float, seed: int, strain: float, cycles: int) -> dict[str, float]:
    """The numbers of one specimen."""
    sector = Sector(2)
    specimen, report = random_cylinder(balls, sector, compaction_friction=compaction, seed=seed)
    params = Params(friction=FRICTION)
    params = replace(params, platen_speed=platen_speed(2e-3, specimen, params))
    plain = TriaxialTest(
        specimen, sector, params=params, tolerance=1e-3, confine_steps=100_000, confining_friction=compaction
    )
    found = {"void ratio": float(report.void_ratio)}
    confined = None
    for name, stages in loadings(strain, cycles).items():
        test = replace(plain, stages=stages)
        confined = test.confined() if confined is None else confined
        run = test.run(start=confined)
        ratio, s3 = np.asarray(run.curve.stress_ratio), np.asarray(run.curve.lateral_stress)
        if name == "compression":
            found["phi compression"] = friction_angle(ratio.max())
        elif name == "extension":
            found["phi extension"] = friction_angle(1 / ratio.min())
        elif name == "undrained":
            found |= {"s3 least / s3": s3.min() / s3[0], "s3 last / s3": s3[-1] / s3[0], "liquefied": bool(run.ended)}
        elif name == "k0":
            found["K0"] = 1 / ratio[-1]
            found["1 - sin phi"] = 1 - np.sin(np.radians(found["phi compression"]))
        else:
            found |= cyclic(run.curve, cycles)
    return found


def cyclic(curve, cycles: int) -> dict[str, float]:
    """Secant stiffness s1/strain of the first and the last loading, over the confining stress; what is lost of volume,
    and contacts of a ball before and after."""
    travelled, strain = np.asarray(curve.path_length), np.asarray(curve.axial_strain)
    s1 = np.asarray(curve.stress_ratio)
    number = np.minimum((travelled / (2 * np.ptp(strain))).astype(int), cycles - 1)

    def stiffness(which):
        inside = number == which
        return np.ptp(s1[inside]) / np.ptp(strain[inside])

    return {
        "E first / s3": stiffness(0),
        "E last / s3": stiffness(cycles - 1),
        "volume lost [%]": 100 * float(curve.volumetric_strain[-1]),
        "contacts before": float(curve.coordination_number[0]),
        "contacts after": float(curve.coordination_number[-1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--balls", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--strain", type=float, default=0.03)
    parser.add_argument("--cycles", type=int, default=100)
    parser.add_argument("--output", type=Path, default=Path("stress_paths.csv"))
    options = parser.parse_args()
    axijax.fast_cpu_kernels()
    axijax.use_compilation_cache()
    rows = []
    for density, compaction in DENSITIES.items():
        found = []
        for seed in range(options.seeds):
            one = study(options.balls, compaction, seed, options.strain, options.cycles)
            found.append(one)
            rows.append({"density": density, "seed": seed, **one})
            print(density, seed, ", ".join(f"{name} {float(value):.4g}" for name, value in one.items()), flush=True)
            with open(options.output, "w", newline="") as file:
                table = csv.DictWriter(file, list(rows[0]))
                table.writeheader()
                table.writerows(rows)
        for name in found[0]:
            values = np.array([float(one[name]) for one in found])
            error = values.std(ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
            print(f"{density}: {name} {values.mean():.4g} +- {error:.2g}", flush=True)


if __name__ == "__main__":
    main()
