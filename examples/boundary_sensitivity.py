"""How sensitive are randomly packed balls to the circumferential boundary? The question Cui & O'Sullivan left open.

Random dense specimens are made with the symmetry of a sector of order n, confined and sheared; n = 1 is the full
cylinder. Every run writes one file, so the study may be stopped and started again at any time, and run by several
processes at once:

    python examples/boundary_sensitivity.py --output study            # run what is missing
    python examples/boundary_sensitivity.py --output study --draw     # table and pictures of what is there

`boundary_statistics` computes what is compared, `boundary_tables` and `boundary_pictures` show it.
"""

import argparse
import fcntl
import itertools
import json
import multiprocessing
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from boundary_statistics import ORDERS

RIGID = (3, 4, 6, 8, 12)
INERTIAL_NUMBER = 2e-3
COMPACTION_FRICTION = 0.05  # dense; without any friction a packing takes five times as long to settle
SIZES = (504, 1008, 2016, 4032)  # multiples of 24, so that every order divides them
FRICTIONS = (0.1, 0.2, 0.3, 0.4, 0.5)


def packings(options):
    """All specimens asked for: (size, order, boundary, seed). Each is sheared with every friction.

    Small specimens first; all seeds of an order follow each other, as those share what is compiled.
    """
    for size in options.sizes:
        boundaries = [(order, "periodic") for order in options.orders]
        boundaries += [(order, "rigid") for order in options.orders if order in RIGID]
        for (order, boundary), seed in itertools.product(boundaries, range(options.seeds)):
            yield size, order, boundary, seed


def sheared(specimen, report, sector, friction, strain) -> dict:
    """Shear one specimen and return what the study keeps of it."""
    import axijax
    from axijax.mechanics.rebuild import specimen_now
    from axijax.specimen.fabric import contact_statistics, profiles
    from axijax.triaxial.random_specimen import platen_speed
    from axijax.triaxial.records import records_of

    params = axijax.Params(friction=friction)
    params = replace(params, platen_speed=platen_speed(INERTIAL_NUMBER, specimen, params))
    test = axijax.TriaxialTest(
        specimen,
        sector,
        params=params,
        axial_strain=strain,
        confining_friction=COMPACTION_FRICTION,
        tolerance=1e-3,
        confine_steps=100_000,
    )
    run = test.run()
    end = specimen_now(test.cut, run.network, run.membrane, run.state)
    rows = {field: np.asarray(getattr(run.curve, field), float) for field in records_of(run.curve)}
    shown = {}
    for stage, cut, radius in (
        ("start", test.cut, report.membrane_radius),
        ("end", end, float(rows["membrane_radius"][-1])),
    ):
        for place, profile in zip(("axis", "plane"), profiles(cut, sector, radius), strict=True):
            shown[f"{stage} {place}"] = {key: np.round(row, 6).tolist() for key, row in profile._asdict().items()}
    return {
        "report": {
            key: value for key, value in vars(report).items() if isinstance(value, int | float | str)
        },
        "end": contact_statistics(end, sector)._asdict(),
        "mean_radius": float(specimen.radius.mean()),
        "curve": {field: [float(f"{value:.6g}") for value in row] for field, row in rows.items()},
        "profiles": shown,
    }  # fmt: skip


def work(options) -> None:
    """Make and shear all that is missing and that no other process is at."""
    import axijax
    from axijax.core.files import write_whole
    from axijax.triaxial.random_specimen import random_cylinder

    axijax.fast_cpu_kernels()
    for size, order, boundary, seed in packings(options):
        packing = f"{size}_{boundary}_{order}_s{seed}"
        lock = options.output / f"{packing}.lock"
        paths = {friction: options.output / f"{packing}_f{friction:g}.json" for friction in options.frictions}
        with open(lock, "w") as held:
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue  # another process is at it; its lock goes with it
            missing = [friction for friction, path in paths.items() if not path.exists()]
            started = time.perf_counter()
            sector, specimen = axijax.Sector(order, boundary), None
            for friction in missing:
                try:
                    if specimen is None:
                        specimen, report = random_cylinder(
                            size, sector, compaction_friction=COMPACTION_FRICTION, seed=seed
                        )
                    found = sheared(specimen, report, sector, friction, options.strain)
                except (ValueError, RuntimeError) as error:
                    found = {"failed": str(error)}
                    print(f"{paths[friction].stem}: {error}", flush=True)
                found["case"] = {
                    "size": size, "order": order, "boundary": boundary, "friction": friction, "seed": seed,
                    "strain": options.strain,
                }  # fmt: skip
                text = json.dumps(found)
                write_whole(paths[friction], lambda part, text=text: part.write_text(text))
            lock.unlink(missing_ok=True)
        if missing:
            print(f"{packing}: {len(missing)} tests in {time.perf_counter() - started:.0f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("boundary_sensitivity"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="balls in the full cylinder")
    parser.add_argument("--orders", type=int, nargs="+", default=ORDERS, help="sectors in the full cylinder")
    parser.add_argument("--frictions", type=float, nargs="+", default=FRICTIONS)
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument("--strain", type=float, default=0.15, help="axial strain at the end")
    parser.add_argument("--draw", action="store_true", help="draw what is there, run nothing")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    if options.draw:
        from boundary_pictures import draw
        from boundary_statistics import statistics_of
        from boundary_tables import print_tables, write_csv

        samples = statistics_of(options.output)
        table = options.output / "boundary_sensitivity.csv"
        write_csv(samples, table)
        print_tables(samples)
        draw(samples, table)
        return
    if options.workers == 1:
        work(options)
        return
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=work, args=(options,)) for _ in range(options.workers)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()


if __name__ == "__main__":
    main()
