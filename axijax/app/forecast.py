"""What a case will take, and what to beware of, before anything long runs."""

import dataclasses
import time
import warnings
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np

from axijax.app.case import Case
from axijax.core.vector import from_rows
from axijax.mechanics.damping import BackgroundDamping, LocalDamping
from axijax.mechanics.dynamics import initial_state
from axijax.mechanics.mass_scaling import inertial_numbers
from axijax.mechanics.membrane import membrane_radius
from axijax.mechanics.time_step import SAFE_STEP, critical_time_step
from axijax.theory import inertial_number
from axijax.triaxial.progress import Progress, go_on
from axijax.triaxial.records import Confinement, SimulationError, no_records
from axijax.triaxial.test import TriaxialTest

if TYPE_CHECKING:
    from axijax.triaxial.packing_report import PackingReport

# Steps that lattices need to be confined (1450 to 3200 of them, whatever their stiffness and stress).
CONFINEMENT_STEPS = 3000


class Forecast(NamedTuple):
    """A case before it runs.

    balls: in the sector. contacts: pairs in its list, touching or near.
    height, membrane_radius: of the specimen as made [L].
    critical_time_step, time_step: the limit of the actual network, and the step that is taken [T].
    inertial_number: 2 v / H 2 r sqrt(density / s3) of the mean ball, or the largest of all where masses are scaled [-].
    heaviest: largest factor by which a mass is scaled, None where none is [-].
    softness: s3 r / kn, kn of a contact under the confining stress [-].
    ramp_strain: axial strain at which the platens have reached their speed [-].
    shear_steps, records: to the axial strain. confinement_steps: assumed.
    ball_steps_per_second: measured on this machine over some 1000 steps of this case; None where it was not.
    seconds: for the whole run, compiling included. memory: most that this process has used so far [bytes], or None.
    warnings: sentences.
    """

    balls: int
    contacts: int
    height: float
    membrane_radius: float
    critical_time_step: float
    time_step: float
    inertial_number: float
    heaviest: float | None
    softness: float
    ramp_strain: float
    shear_steps: int
    records: int
    confinement_steps: int
    ball_steps_per_second: float | None
    seconds: float | None
    memory: int | None
    warnings: list[str]


def forecast(case: Case, measure: bool = True) -> Forecast:
    """What the case will take. Raises ValueError where it makes no sense.

    measure: compile and run some 1000 steps, to know how long the whole will take.
    """
    with warnings.catch_warnings(record=True) as noted:  # they go into the list instead
        warnings.simplefilter("always")
        case, specimen, packing = case.made()
        test = case.build(specimen)
        prepared = test.prepared
    params, radius = test.params, float(test.cut.radius.mean())
    stiffness = float(params.material.confined_stiffness(test.network, params.confining_stress)[0])
    rate = 2 * float(params.platen_speed) / test.cut.height
    steps = prepared.numerics.most_steps
    compiling, per_step = _timed(test) if measure else (None, None)
    found = Forecast(
        balls=len(test.cut),
        contacts=int(np.count_nonzero(np.asarray(test.network.share))),
        height=test.cut.height,
        membrane_radius=float(membrane_radius(test.membrane, from_rows(test.cut.positions))),
        critical_time_step=critical_time_step(test.scene, params, test.network),
        time_step=float(prepared.time_step),
        inertial_number=_inertial_number(test, rate),
        heaviest=None if test.network.mass_factor is None else float(test.network.mass_factor.max()),
        softness=float(params.confining_stress * radius / stiffness),
        ramp_strain=rate * float(prepared.ramp_time) / 2,
        shear_steps=steps,
        records=steps // test.record_every,
        confinement_steps=CONFINEMENT_STEPS,
        ball_steps_per_second=len(test.cut) / per_step if per_step else None,
        seconds=2 * compiling + (steps + CONFINEMENT_STEPS) * per_step if compiling is not None and per_step else None,
        memory=_memory(),
        warnings=[],
    )
    released = measure and per_step is None
    told = packing.warnings if packing else []
    told = told + [str(each.message).rstrip(".") for each in noted] + _warnings(case, test, found, released, packing)
    return found._replace(warnings=list(dict.fromkeys(told)))


def _inertial_number(test: TriaxialTest, rate: float) -> float:
    params, network = test.params, test.network
    if network.mass_factor is not None:
        return float(inertial_numbers(params, network, rate).max())
    return float(inertial_number(rate, float(test.cut.radius.mean()), params.density, params.confining_stress))


def _timed(test: TriaxialTest) -> tuple[float | None, float | None]:
    """Seconds to compile the shear, and for one step of it; None where the balls do not stay for so long."""
    zero = jnp.zeros(())
    test = dataclasses.replace(test, stages=())  # what a stage commands costs next to nothing
    height = test.cut.height
    state = initial_state(test.scene, test.params, test.network, [test.cut.bottom, test.cut.top])
    loose = Progress(
        test.params, test.network, test.membrane, state, test.lateral_load, Confinement(zero, zero, zero), height,
        no_records(test.params),
    )  # fmt: skip
    seconds = []
    for _ in range(2):
        started = time.perf_counter()
        try:
            steps = go_on(test, loose).taken
        except SimulationError:
            return None, None
        seconds.append(time.perf_counter() - started)
    return max(seconds[0] - seconds[1], 0.0), seconds[1] / steps


def _memory() -> int | None:
    try:
        import resource
    except ImportError:  # not a POSIX system
        return None
    import sys

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _warnings(
    case: Case, test: TriaxialTest, found: Forecast, collapsed: bool, packing: "PackingReport | None"
) -> list[str]:
    """What the guide's limits say of this case."""
    params, sector, strain = test.params, test.sector, test.axial_strain
    if case.stage:
        strain = max(abs(each.axial_strain or each.first or 0.0) for each in case.stage)
    friction = float(np.max(np.asarray(params.friction))) if params.material.frictional else 0.0
    share = found.time_step / found.critical_time_step
    damping = params.material.damping
    local = isinstance(damping, LocalDamping)
    local_limit = 1 / (1 + float(damping.local_damping)) ** 0.5 if isinstance(damping, LocalDamping) else 1.0
    lattice_sector = sector.order > 1 and sector.boundary == "periodic" and case.specimen.kind in ("octagon", "fcc")
    compaction = packing.compaction_friction if packing else 0.0
    slenderness = found.height / (2 * found.membrane_radius)
    told = [
        (
            collapsed,
            "the balls do not stay where they are once released: confinement will probably fail",
        ),
        (
            case.specimen.kind == "bcc",
            "a BCC array does not stand without friction: its confinement, which has none, reaches no equilibrium (an "
            "unbalanced force of 0.03 after 20 000 steps)",
        ),
        (
            found.inertial_number > 1e-3,
            f"inertial number {found.inertial_number:.2e} is above 1e-3: the peak will be too high (1 % at 9e-4, 5 to "
            "7 % at 2e-3); lower parameters.platen_speed",
        ),
        (
            found.softness > 3e-3,
            f"softness s3 r/kn = {found.softness:.1e} is above 3e-3: the peak falls, by 7 % at 3e-3 and 12 % at 1e-2, "
            "against rigid balls; raise the stiffness or lower parameters.confining_stress",
        ),
        (
            found.softness < 1e-5,
            f"softness s3 r/kn = {found.softness:.1e} is below 1e-5, where nothing has been tested; the steps become "
            "many and the peak changes by less than 1.5 %",
        ),
        (
            friction == 0 and strain > 0.04,
            "without friction the specimen collapses past 4 % strain",
        ),
        (
            test.confining_friction <= friction < compaction,
            f"friction {friction:g} is below the friction {compaction:.4g} of the compaction: the specimen gives way "
            "when it is confined, and does not keep its void ratio; lower specimen.compaction_friction",
        ),
        (
            friction > 0.5,
            f"friction {friction:g} is high: balls roll instead of sliding, and the closed form, which knows no "
            "rotation, does not hold (0.9: peak 17.6 where it says 38)",
        ),
        (
            sector.order == 1 and strain > 0.017,
            "the full cylinder breaks its symmetry at 1.7 % strain and collapses past 2.3 %; the case goes to "
            f"{100 * strain:g} %",
        ),
        (
            lattice_sector and strain >= 0.03,
            "at 3 % strain balls on the axis of an FCC sector meet, and carry far more than their share",
        ),
        (
            sector.boundary == "rigid",
            "rigid sector planes are there for comparison: between them the paper's quarter is 18 % weaker",
        ),
        (
            slenderness < 0.75,
            f"the specimen is only {slenderness:.2f} diameters high: short ones are too strong (5 layers: 3.19, 25 "
            "layers 2.465); look at core_ratio instead",
        ),
        (
            local,
            "local damping gives right values and meaningless derivatives",
        ),
        (
            local and share > local_limit,
            f"local damping: the true limit of the time step is {local_limit:.2f} of the critical one, and it is "
            f"{share:.2f} of it; the rise may chatter; lower test.time_step",
        ),
        (
            isinstance(damping, BackgroundDamping),
            "mass-proportional damping adds strength: 0.2 % at a rate of 0.05/T, 2 % at 0.5/T, 8 % at 2/T",
        ),
        (
            damping is None,
            "nothing damps the shear: the waves that the platens send off stay",
        ),
        (
            found.ramp_strain > 0.5 * strain > 0,
            f"the platens reach their speed only at {100 * found.ramp_strain:.2g} % strain, in the second half of the "
            "test; raise test.axial_strain or lower parameters.platen_speed",
        ),
        (
            found.records < 30,
            f"only {found.records} records: the peak may fall between two; lower test.record_every",
        ),
        (
            share > 0.7,
            f"the time step is {share:.2f} of the critical one; 0.6 is the default, more than {SAFE_STEP:g} is refused",
        ),
        (
            test.tolerance > 1e-3,
            f"tolerance {test.tolerance:g}: confinement may end far from equilibrium",
        ),
    ]
    return [sentence for true, sentence in told if true]
