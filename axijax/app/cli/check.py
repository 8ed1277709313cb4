"""The command check: a case before it runs, a result after it did."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from axijax.app.cli.run import Json
from axijax.app.cli.say import say, say_rows

if TYPE_CHECKING:
    from axijax.app.checks import Check
    from axijax.app.forecast import Forecast


def check(
    what: Annotated[Path, typer.Argument(help="Case file, or the folder of a result.")],
    as_json: Json = False,
) -> None:
    """Check a case before it runs, or a result after it did; exit code 1 where something is not sound.

    A case: time step and its limit, inertial number, steps, time (from 1000 steps that are run and measured) and
    memory, and warnings. A result: equilibrium after confinement, platen against internal stress, the membrane's
    cells, chatter, and the energy ledger over the first 0.05 % of strain, which is run again for it.
    """
    if what.is_dir():
        from axijax.app.checks import result_checks
        from axijax.app.results import open_result
        from axijax.core.bars import bar

        with bar() as show:
            show("shearing the first 0.05 % of strain again, for the energy ledger")
            checks = result_checks(open_result(what), energy=True)
        sound = all(one.passed is not False for one in checks)
        if as_json:
            print(json.dumps({"sound": sound, "checks": [one._asdict() for one in checks]}))
        else:
            _print_checks(checks)
        if not sound:
            raise typer.Exit(1)
    else:
        from axijax.app.case import load_case
        from axijax.app.forecast import forecast
        from axijax.core.bars import bar

        loaded = load_case(what)
        with bar() as show:
            show("preparing, then running 1000 steps to measure the speed")
            found = forecast(loaded)
        print(json.dumps(found._asdict())) if as_json else _print_forecast(found)


def _print_forecast(found: "Forecast") -> None:
    share = found.time_step / found.critical_time_step
    lines = {
        "specimen": f"{found.balls} balls in the sector, {found.contacts} pairs in the list; height "
        f"{found.height:.4g}, radius {found.membrane_radius:.4g} [L]",
        "critical time step": f"{found.critical_time_step:.4g} [T]",
        "time step": f"{found.time_step:.4g} [T], {share:.2f} of the critical one",
        "inertial number": f"{found.inertial_number:.2g}  (2 v/H 2 r sqrt(density/s3); quasi-static below 1e-3)",
        "softness": f"{found.softness:.2g}  (s3 r/kn)",
        "steps": f"{found.shear_steps} of shear with {found.records} records, after about {found.confinement_steps} of "
        "confinement",
    }
    if found.heaviest is not None:
        lines["masses"] = f"up to {found.heaviest:.3g} times the true ones; the inertial number is the largest"
    if found.seconds is not None and found.ball_steps_per_second is not None:
        lines["time"] = (
            f"about {_duration(found.seconds)}, compiling included, at {found.ball_steps_per_second / 1e6:.2g} million "
            "ball-steps/s  (measured now, over some 1000 steps)"
        )
    if found.memory is not None:
        lines["memory"] = f"{found.memory / 2**20:.0f} MiB  (this process, now)"
    say_rows(lines.items())
    for text in found.warnings:
        say(f"warning: {text}.")
    count = len(found.warnings)
    say(f"{count or 'no'} warning{'' if count == 1 else 's'}")


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _print_checks(checks: "list[Check]") -> None:
    for one in checks:
        value = one.value if isinstance(one.value, str) else f"{one.value:.2g}"
        limit = one.limit if isinstance(one.limit, str) else f"at most {one.limit:.2g}"
        mark = {True: "ok  ", False: "FAIL", None: "note"}[one.passed]
        say(f"{mark}  {one.name}: {value}  ({limit})")
        if not one.passed:
            say(f"      {one.meaning}.")
    counts = {mark: sum(one.passed is mark for one in checks) for mark in (True, False, None)}
    told = f"{counts[True]} of {counts[True] + counts[False]} checks passed"
    say(told + (f", {counts[None]} without a limit" if counts[None] else ""))
