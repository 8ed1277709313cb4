"""Which conventions of Cui & O'Sullivan (2005) fit their Table 1 best; three minutes on two cores.

    python examples/paper_conventions.py [--output paper_conventions.csv]

The paper leaves open what its stiffness 1.5e9 belongs to, whether its membrane forces follow the specimen, over which
area it takes the axial stress, how the platens stand during confinement, how stiff they are, and through which radius
its membrane goes. Each column of the table is all seven rows under one set of them; the last has a stiffness fitted to
all fourteen numbers by `calibrate`. A cell holds the peak stress ratio, the strain there [%] and its flat top. Below
stand how far the paper's numbers are away in the mean, and how many of them agree (`axijax.app.table1.misfit`): a peak
as it is rounded, a strain within the flat top; where the paper's 3.25 contradicts its difference column, either will
do.

Full cylinders are run as quarters, which by symmetry are the same trajectory (`tests/validation/test_symmetry.py`).
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import axijax

axijax.fast_cpu_kernels()  # forward mode only
axijax.use_compilation_cache()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from axijax.app.results import save_table  # noqa: E402
from axijax.app.table1 import AXIAL_STRAIN, PAPER_RUNS, PAPER_STIFFNESS, PaperRun, Row, misfit  # noqa: E402
from axijax.core.parallel import parallel  # noqa: E402
from axijax.core.quantity import quantity  # noqa: E402
from axijax.core.tree import pytree  # noqa: E402
from axijax.triaxial.paths import Balance, Isotropic  # noqa: E402
from calibrate import Datum, HardPeak, Model, ParameterSet, StrainAtPeak, fit_parameters  # noqa: E402

# What a least-squares fit takes for the standard uncertainties of the paper's numbers, as shares of them: peaks move by
# a percent with the conventions, and a strain is anywhere in a flat top.
PEAK_SIGMA, STRAIN_SIGMA = 0.01, 0.1


@pytree
@dataclass(frozen=True)
class OwnPlatens(axijax.Linear):
    """Balls that meet the platens with another stiffness than each other."""

    platen_stiffness: jax.Array | float = quantity(1.5e9, "normal stiffness against platens", "F/L", above=0.0)

    def wall_law(self, network):
        return replace(self, normal_stiffness=self.platen_stiffness).linear_wall_law(network)

    def linear_wall_law(self, network):
        return super().wall_law(network)

    def stiffest(self, network, stress, touching_within):
        normal, shear = float(self.normal_stiffness), float(self.shear_stiffness)
        return normal, shear, lambda *_: (float(self.platen_stiffness), shear)


@pytree
@dataclass(frozen=True)
class Held(Isotropic):
    """Confinement by the membrane alone: the platens stay where they are, so that s1 is whatever comes of it."""

    def platen_speeds(self, params, network, dt, state, push, section):
        return jnp.zeros_like(state.platen_speeds)

    def watch(self, seen, dtype):
        return Balance(seen.unbalanced_force, jnp.zeros((), dtype))


@dataclass(frozen=True)
class Conventions:
    """One reading of the paper; the default is `axijax table1`'s apart from what the columns' names say.

    stiffness: of a contact [F/L]. platens: their stiffness over that. fixed: membrane forces fixed in size from the
        start of the shear in all rows, not the full cylinder's alone. first_area: axial stress over the area at that
        moment. held: platens during confinement. mean_radius: Rm is the mean of the outer balls' radii, not their
        middle.
    """

    stiffness: float = PAPER_STIFFNESS / 2
    platens: float = 1.0
    fixed: bool = False
    first_area: bool = False
    held: bool = False
    mean_radius: bool = False

    def test(self, paper_run: PaperRun) -> axijax.TriaxialTest:
        stiffness = {"normal_stiffness": self.stiffness, "shear_stiffness": self.stiffness}
        material = axijax.Linear() if self.platens == 1 else OwnPlatens(platen_stiffness=self.platens * self.stiffness)
        specimen = axijax.fcc_octagon()
        return axijax.TriaxialTest(
            replace(specimen, zone_rule="exposure") if self.mean_radius else specimen,
            axijax.Sector(4, "rigid" if paper_run.boundary == "rigid" else "periodic"),
            params=axijax.Params(material, friction=paper_run.friction, **stiffness),
            axial_strain=AXIAL_STRAIN,
            refresh=not (self.fixed or paper_run.boundary == "full"),
        )

    def row(self, paper_run: PaperRun) -> Row:
        test = self.test(paper_run)
        prepared = test.prepared
        if self.held:
            servo = prepared.confinement
            held = Held(servo.friction, servo.tolerance, servo.most_steps)
            prepared = replace(prepared, confinement=held)
        curve = axijax.simulate(prepared, test.params)
        axijax.raise_for_status(curve.status)
        if self.first_area:
            grown = (curve.membrane_radius / curve.membrane_radius[0]) ** 2
            curve = replace(curve, stress_ratio=curve.stress_ratio * grown)
        return Row(paper_run, "ball", test, SimpleNamespace(curve=curve), 0.0)


COLUMNS = {
    "contact": Conventions(PAPER_STIFFNESS),
    "contact, forces fixed": Conventions(PAPER_STIFFNESS, fixed=True),
    "ball": Conventions(),
    "ball, forces fixed": Conventions(fixed=True),
    "ball, first area": Conventions(first_area=True),
    "ball, fixed, first area": Conventions(fixed=True, first_area=True),
    "ball, platens held": Conventions(held=True),
    "ball, platens x 2": Conventions(platens=2.0),
    "ball, platens x 10": Conventions(platens=10.0),
    "ball, Rm mean": Conventions(mean_radius=True),
}


class WholeTable:
    """All rows as one simulator for `calibrate`: its curves lie one behind another, of one length."""

    def __init__(self, conventions: Conventions):
        self.tests = [conventions.test(paper_run) for paper_run in PAPER_RUNS]
        self.params = self.tests[0].params
        self.records = [test.prepared.numerics.records for test in self.tests]

    def simulate(self, params):
        curves = [
            axijax.simulate(test.prepared, replace(params, friction=paper_run.friction))
            for test, paper_run in zip(self.tests, PAPER_RUNS, strict=True)
        ]
        names = "axial_strain", "stress_ratio", "virial_ratio", "core_ratio", "volumetric_strain"
        joined = {name: jnp.concatenate([getattr(curve, name) for curve in curves]) for name in names}
        status = jnp.bitwise_or.reduce(jnp.stack([curve.status for curve in curves]))
        return SimpleNamespace(**joined, status=status)

    def data(self) -> list[Datum]:
        """Fourteen numbers of the paper; its peak by its difference column where that contradicts it."""
        ends = np.cumsum(self.records)
        data = []
        for paper_run, start, end in zip(PAPER_RUNS, ends - self.records, ends, strict=True):

            def of_row(functional, start=start, end=end):
                return lambda curve: functional(
                    SimpleNamespace(
                        axial_strain=curve.axial_strain[start:end], stress_ratio=curve.stress_ratio[start:end]
                    )
                )

            peak = paper_run.by_difference or paper_run.paper
            data.append(Datum(of_row(HardPeak()), peak, PEAK_SIGMA * peak))
            strain = paper_run.paper_strain
            data.append(Datum(of_row(StrainAtPeak()), strain, STRAIN_SIGMA * strain))
        return data


def fitted(conventions: Conventions) -> float:
    """The contact stiffness, with kn = ks, that fits all fourteen numbers best by least squares [F/L]."""
    table = WholeTable(conventions)
    bounds = {"kn": (0.2 * PAPER_STIFFNESS, PAPER_STIFFNESS)}
    model = Model(table, ParameterSet.of(table.params, "kn", bounds))
    fit = fit_parameters(model, table.data(), "kn", start="test", jacobian="tangent", max_runs=20)
    print(fit)
    return fit.estimate["normal_stiffness"]


def whole(conventions: Conventions) -> list[Row]:
    """All rows of the table, two at a time."""
    rows = parallel(conventions.row, PAPER_RUNS, 2)
    for row in rows:
        if isinstance(row, Exception):
            raise row
    return [row for row in rows if isinstance(row, Row)]


def cell(row: Row) -> str:
    start, end = row.flat
    return f"{row.peak.stress_ratio:.3f} at {100 * row.peak.axial_strain:.2f} ({100 * start:.2f}..{100 * end:.2f})"


def summary(rows: list[Row]) -> str:
    distance, agreeing = misfit(rows)
    return f"{100 * distance:.1f} % away; {agreeing} of {2 * len(rows)}"


def show(name: str, rows: list[Row]) -> None:
    print(f"{name}: {summary(rows)}")
    for row in rows:
        paper = row.paper_run
        print(f"    {paper.name:24s}{cell(row)}, paper {paper.paper:.2f} at {100 * paper.paper_strain:.2f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("paper_conventions.csv"), help="table to write")
    output = parser.parse_args().output
    began = time.perf_counter()
    columns = {}
    for name, conventions in COLUMNS.items():
        columns[name] = whole(conventions)
        show(name, columns[name])
    kn = fitted(Conventions())
    columns[f"kn = {kn:.3g}, fitted"] = whole(Conventions(kn))
    show(*list(columns.items())[-1])
    table = [
        {"row": paper_run.name, "paper": f"{paper_run.paper:.2f} at {100 * paper_run.paper_strain:.2f}"}
        | {name: cell(rows[place]) for name, rows in columns.items()}
        for place, paper_run in enumerate(PAPER_RUNS)
    ]
    table.append({"row": "misfit", "paper": ""} | {name: summary(rows) for name, rows in columns.items()})
    save_table(output, list(table[0]), table)
    print(f"{time.perf_counter() - began:.0f} s; written: {output}")


if __name__ == "__main__":
    main()
