"""What a finished or unfinished result is checked for: numbers with limits, and what they mean."""

import dataclasses
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from axijax.app.results import Result
from axijax.app.snapshot import Snapshot, snapshot
from axijax.core.vector import from_rows
from axijax.mechanics.observe import in_core
from axijax.specimen.grading import WELL_MET
from axijax.triaxial.engine import STALE
from axijax.triaxial.peak import Peak, at_peak, peak_of
from axijax.triaxial.records import CHATTER
from axijax.triaxial.test import TriaxialTest
from axijax.triaxial.uniformity import ISOTROPIC, SCATTERS

# Axial strain over which the energy ledger is kept, where it is asked for.
LEDGER_STRAIN = 5e-4

# Diameters of height below which the platens bear on the whole specimen, and the balls in a random specimen's core
# below which their mean stress says little: they scatter by the root of their number.
SLENDER, FEW = 1.25, 100

# Mean resultant on a ball over the mean contact force above which a test is not quasi-static.
UNBALANCED = 0.01


class Check(NamedTuple):
    """One check of a result.

    name: what is checked, for people. value: what was found, a number or a word. limit: what is allowed, a bound from
    above for a number, or why there is none. passed: whether it is kept; None where a sound run has no limit.
    meaning: one sentence on what it tells.
    """

    name: str
    value: float | str
    limit: float | str
    passed: bool | None
    meaning: str


def result_checks(result: Result, energy: bool = False) -> list[Check]:
    """All checks that the parts of a result allow: a bare curve's only, or the last state's too.

    energy: also shear the test anew over the first 0.05 % of axial strain with the energy ledger.
    """
    checks = [
        Check(
            "status", result.status, "finished", result.status == "finished",
            "the run has reached its axial strain without a fault",
        ),
        *_curve_checks(result),
        *_packing_checks(result),
    ]  # fmt: skip
    if result.has_state:
        checks += _state_checks(result.test, snapshot(result.test, result.progress))
    if energy:
        checks.append(_energy_check(result.test))
    return checks


def _at_most(name: str, value, limit: float, meaning: str) -> Check:
    value = float(value)
    return Check(name, value, limit, bool(value <= limit), meaning)


def _curve_checks(result: Result) -> list[Check]:
    curve = result.curve
    peak = peak_of(curve)
    there = curve.isel(axial_strain=peak.record)
    place = "the peak" if peak.reached else "the largest stress ratio"
    checks = [_peak_check(peak)]
    try:
        test: TriaxialTest | None = result.test
    except ValueError:  # only curves were kept
        test = None
    tolerance = 1e-7 if test is None else test.tolerance
    if "confinement_unbalanced_force" in curve:
        checks += [
            _at_most(
                "unbalanced force after confinement", curve.confinement_unbalanced_force, tolerance,
                "mean resultant on a ball over the mean contact force: the specimen was in equilibrium",
            ),
            _at_most(
                "stress error after confinement", curve.confinement_stress_error, tolerance,
                "|s1 - s3| / s3: the stress was isotropic before shear",
            ),
        ]  # fmt: skip
    platen, virial, core = (at_peak(curve, peak, name) for name in ("stress_ratio", "virial_ratio", "core_ratio"))
    checks += [
        _at_most(
            f"unbalanced force around {place}",
            np.median(curve.unbalanced_force.values[max(0, peak.record - 10) : peak.record + 11]), UNBALANCED,
            "mean resultant on a ball over the mean contact force, median of 21 records (single ones jump where balls "
            "rearrange): above a hundredth the test is not quasi-static",
        ),
        _at_most(
            f"platen against virial stress ratio at {place}", abs(platen / virial - 1),
            _radius_limit(test, float(there.membrane_radius)),
            f"{platen:.4g} from platen force and radius Rm, {virial:.4g} from forces alone: a wide gap means that Rm "
            "is not the radius at which the membrane acts",
        ),
        _at_most(
            f"chatter at {place}", max(0.0, float(there.chatter)), CHATTER,
            "contacts moving to and fro from step to step: above the limit the step is too long, the peak wrong",
        ),
        _at_most(
            "chatter of the whole curve", max(0.0, float(curve.chatter.max())), CHATTER,
            "the same over all records: above the limit the curve is inexact there",
        ),
    ]  # fmt: skip
    if np.isfinite(core):
        checks.append(_core_check(test, platen, core, float(there.membrane_radius), place))
    return checks


def _peak_check(peak: Peak) -> Check:
    """Whether the curve has a peak at all. A test may stop before it on purpose, so that this is no fault."""
    if peak.reached:
        meaning = f"{peak}, and the curve goes on lower"
        return Check("peak stress ratio", peak.stress_ratio, "reached within the test", True, meaning)
    meaning = f"{peak}; go on to a larger axial strain before the value is read as a strength"
    return Check("peak stress ratio", "none within the test", "no fault of a short test", None, meaning)


def _packing_checks(result: Result) -> list[Check]:
    """Whether a random specimen's balls have the masses that the sieves of its grading ask for, and whether it was
    isotropic and uniform when the shear began."""
    packing = result.info.get("packing")
    if not isinstance(packing, dict):
        return []
    checks = []
    if packing.get("deviation") is not None:
        checks.append(
            _at_most(
                "grading met", packing["deviation"], WELL_MET,
                "by how much of the whole mass the worst fraction between two sieves misses what was asked for: more "
                "balls meet it better",
            )
        )  # fmt: skip
    error, core = packing.get("core_stress_error"), float(result.curve.core_ratio[0])
    if error is not None and np.isfinite(error) and np.isfinite(core):
        checks.append(
            _at_most(
                "core isotropic when shear begins", abs(core - 1), ISOTROPIC + SCATTERS * error,
                f"vertical over horizontal stress of the inner core is {core:.3f}; of {packing['core_contacts']} "
                f"contacts 1 +- {error:.2g} is expected: allowed are {ISOTROPIC:g} and {SCATTERS:g} times that",
            )
        )  # fmt: skip
    return checks


def _radius_limit(test: TriaxialTest | None, radius: float) -> float:
    """How far platen and virial stress ratio may be apart.

    Rm is a mean over a zone about a ball wide, and the membrane's work goes with the square of the distance, so that
    the gap of a sound run goes with (r/Rm)^2: 1.0 of it in the paper's quarter, 1.9 in an octagon of half its width.
    """
    return 0.05 if test is None else max(0.05, 3 * float((test.cut.radius.mean() / radius) ** 2))


def _core_check(test: TriaxialTest | None, platen: float, core: float, radius: float, place: str = "the peak") -> Check:
    """Platen against core stress ratio, with the limit that the boundaries and the number of balls allow."""
    name, gap = f"platen against core stress ratio at {place}", abs(platen / core - 1)
    meaning = (
        f"{platen:.4g} from the platens, {core:.4g} in the inner core: a wide gap means that boundaries (platens of a "
        "short specimen, rigid sector planes) bear on the result"
    )
    if test is None:
        return _at_most(name, gap, 0.1, meaning)
    slenderness = test.cut.height / (2 * radius)
    if test.sector.boundary == "rigid":
        return Check(name, gap, "differs by design: rigid planes", None, meaning)
    if slenderness < SLENDER:
        return Check(name, gap, f"differs by design: only {slenderness:.2g} diameters high", None, meaning)
    if test.cut.zone_rule == "given":
        return _at_most(name, gap, 0.1, meaning)
    count = int(in_core(from_rows(test.cut.positions), radius, np.array([test.cut.bottom, test.cut.top])).sum())
    if count < FEW:
        return Check(name, gap, f"scatters: {count} balls in the core", None, meaning)
    return _at_most(name, gap, max(0.1, 2 * count**-0.5), meaning)


def _state_checks(test: TriaxialTest, seen: Snapshot) -> list[Check]:
    """Checks of the last state; seen: of the sector alone."""
    single = np.dtype(test.dtype) == np.float32
    bottom, top = seen.platens.heights
    mean = max(seen.platens.forces.mean(), 1e-300)
    volume = 4 / 3 * np.pi * seen.balls.radius**3 * seen.balls.weight
    internal = float((seen.balls.stress[2, 2] * volume).sum())
    uneven = abs(np.diff(seen.platens.forces)[0] - seen.membrane.upward.sum())
    heights = seen.membrane.places[1] - (bottom + top) / 2
    outer = mean * (top - bottom) - float((seen.membrane.upward * heights).sum())
    checks = [
        _at_most(
            "bottom against top platen force", uneven / mean, _platen_limit(seen),
            "both platens bear the same force, but for the membrane's along the axis, where the test is quasi-static",
        ),
        _at_most(
            "platen against internal stress", abs(internal / outer - 1), 0.01,
            "the balls' vertical Love-Weber stress, summed over their volumes, is platen force times height, and the "
            "membrane's along the axis, in equilibrium: nothing is counted twice or left out",
        ),
    ]  # fmt: skip
    if seen.membrane.number.size:
        balls = seen.balls
        inward = seen.confining_stress * balls.membrane_area * (np.hypot(*balls.positions[:2]) + balls.radius)
        sideways = float(((balls.stress[0, 0] + balls.stress[1, 1]) * volume).sum())
        checks.append(
            _at_most(
                "membrane against internal stress",
                abs(sideways / (inward.sum() + seen.platens.restraint) - 1),
                0.01,
                "the balls' horizontal Love-Weber stress, summed over their volumes, is membrane force times its "
                "distance from the axis, and the walls' friction likewise, in equilibrium",
            )
        )
    if seen.membrane.number.size and test.refresh:  # cells that keep their first areas do not follow the strip
        strip = seen.sector.angle * seen.membrane.radius * (top - bottom)
        checks += [
            _at_most(
                "membrane cells tile the strip", abs(seen.membrane.area.sum() / strip - 1), 1e-4 if single else 1e-9,
                "the cells' areas add up to the sector's part of the cylinder of radius Rm",
            ),
            _at_most(
                "membrane cells up to date", seen.membrane.stale, STALE,
                "share of the strip counted to a wrong cell since the membrane was triangulated",
            ),
        ]  # fmt: skip
    return checks


def _platen_limit(seen: Snapshot) -> float:
    """How far the platens' forces may be apart: their difference is the sum of the balls' vertical resultants, which of
    N independent ones of a hundredth of the mean contact force each is within three times sqrt(N/3) of that."""
    scatter = UNBALANCED * seen.contacts.normal_force.mean() * (seen.balls.number.size / 3) ** 0.5
    return max(0.01, float(3 * scatter / seen.platens.forces.mean()))


def _energy_check(test: TriaxialTest) -> Check:
    """Work done against energy stored and lost, over the first part of the shear."""
    # Of a test in stages: a compression of its confined specimen.
    error = _ledger_error(dataclasses.replace(test, stages=(), axial_strain=min(LEDGER_STRAIN, test.axial_strain)))
    return _at_most(
        "energy ledger closes", error, 1e-5,
        f"work of platens and membrane, less what is stored, lost to friction and to damping, over the platens' work; "
        f"first {100 * LEDGER_STRAIN:g} % of strain",
    )  # fmt: skip


def _ledger_error(test: TriaxialTest) -> float:
    """Largest share of the platens' work that is unaccounted for at the end of a shear."""
    from axijax.mechanics.energy import energy_balance, make_ledger_step, open_ledger
    from axijax.triaxial.engine import current_load, fixed_load
    from axijax.triaxial.stages import start_shear

    confined, _ = test.confine()
    network, membrane, params, dt = test.network, test.membrane, test.params, test.prepared.time_step
    start = start_shear(test.scene, params, test.prepared.lists, confined)
    fixed = fixed_load(test.refresh, test.prepared.lateral_load, test.prepared.lists, start)
    step = make_ledger_step(test.scene, test.prepared.shear.platen_speeds)
    seen = partial(energy_balance, test.scene)

    @jax.jit
    def shear(state):
        both = state, open_ledger(network.dtype)
        first = seen(params, network, current_load(membrane, network, state, fixed), dt, *both)

        def block(both, _):
            load = current_load(membrane, network, both[0], fixed)
            return jax.lax.fori_loop(0, test.record_every, lambda _, b: step(params, network, load, dt, b), both), None

        both, _ = jax.lax.scan(block, both, None, length=test.prepared.numerics.records)
        last = seen(params, network, current_load(membrane, network, both[0], fixed), dt, *both)
        return (last.unaccounted - first.unaccounted) / last.platen_work

    return abs(float(shear(start)))
