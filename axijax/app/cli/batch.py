"""`axijax batch`: a case file with lists, run as a batch."""

import contextlib
import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from axijax.app.cli.errors import filling
from axijax.app.cli.say import say

if TYPE_CHECKING:
    from axijax.app.batch import Member

TABLE = "sweep"
MOST_MEMBERS = 10_000  # each is prepared before the first one runs, in a tenth of a second or more


def batch(
    sweep: Annotated[Path, typer.Argument(help="Case file (TOML) with a table named sweep, of lists.")],
    output: Annotated[Path, typer.Option(help="Folder for the curves and the table.")] = Path("batch"),
    workers: Annotated[int | None, typer.Option(min=1, help="Tests at a time; left out: one a core.")] = None,
    executor: Annotated[
        str | None,
        typer.Option(
            help="Who runs the tests: 'processes', 'processes:4', or 'dask://HOST:PORT' for a running Dask scheduler.",
            show_default="threads of this process",
        ),
    ] = None,
) -> None:
    """Run all combinations of the lists in a case file's sweep table, such as parameters.friction = [0.1, 0.2].

    Writes one NetCDF file a test into OUTPUT/members as they come, and summary.csv. Run again after an interruption:
    what is there is not computed again. Ends with exit code 1 where a test failed; the others are kept.
    """
    from axijax.app.batch import Outcome, run_batch
    from axijax.app.executors import open_executor
    from axijax.core.bars import Pace, bar
    from axijax.core.files import writable_folder

    if workers is not None and executor is not None:
        raise ValueError("--workers are threads of this process: with --executor write 'processes:4' for four of them.")
    members = load_sweep(sweep)
    folder = writable_folder(output)
    shares: dict[str, float] = {}
    ended, pace = 0, Pace()
    with bar() as show:

        def tell_bar() -> None:
            done = ended + sum(shares.values())
            pace.mark(done / len(members))
            show(f"{sweep.stem}  {ended} of {len(members)} tests", done / len(members), pace.left)

        def advance(name: str, share: float, ratio: float) -> None:
            shares[name] = share
            tell_bar()

        def tell(outcome: Outcome) -> None:
            nonlocal ended
            ended += 1
            shares.pop(outcome.member.name, None)
            tell_bar()
            say(_line(outcome))

        with contextlib.ExitStack() as stack:
            stack.enter_context(filling(folder, "run it again, and what is there is not computed again"))
            pool = None if executor is None else stack.enter_context(open_executor(executor))
            result = run_batch(members, folder, advance, tell, workers=workers, executor=pool)
    say(f"{len(result.curves)} of {len(members)} tests done. Written: {folder / 'summary.csv'}, {folder / 'members'}")
    if result.failures:
        raise typer.Exit(1)


def load_sweep(path: Path) -> "list[Member]":
    """The members of a sweep file: every combination of the lists in its table [sweep], the last running fastest.

    Raises ValueError, naming file and field.
    """
    from axijax.app.batch import Member, point_name
    from axijax.app.case import make_case
    from axijax.app.case_reading import read_toml

    data = read_toml(path)
    lists = _lists(path, data.pop(TABLE, None))
    count = math.prod(map(len, lists.values()))
    if count > MOST_MEMBERS:
        raise ValueError(
            f"sweep file '{path}' asks for {count:,} tests: at most {MOST_MEMBERS:,} are run at once; shorten its "
            "lists."
        )
    members = []
    for values in itertools.product(*lists.values()):
        point = dict(zip(lists, values, strict=True))
        changed: dict[str, Any] = {name: dict(fields) for name, fields in data.items() if isinstance(fields, dict)}
        for (section, field), value in point.items():
            changed.setdefault(section, {})[field] = value
        case = make_case(data | changed, str(path))
        labels = {".".join(where): value for where, value in point.items()}
        # The time step follows the parameters, as it does when such a case is run alone.
        members.append(Member(point_name(labels), case.build(), None, labels))
    return members


def _lists(path: Path, table) -> dict[tuple[str, str], list]:
    example = f"write [{TABLE}] with lists such as parameters.friction = [0.1, 0.2]"
    if not isinstance(table, dict) or not table:
        raise ValueError(f"sweep file '{path}' has no table [{TABLE}]: {example}, or use `axijax run` for one test.")
    lists = {}
    for section, fields in table.items():
        if not isinstance(fields, dict):
            raise ValueError(f"sweep file '{path}': '{section}' is no section: {example}.")
        for field, values in fields.items():
            if not isinstance(values, list) or not values:
                raise ValueError(f"sweep file '{path}': {section}.{field} = {values!r}: must be a list; {example}.")
            lists[section, field] = values
    return lists


def _line(outcome) -> str:
    from axijax.triaxial.peak import peak_of

    name = outcome.member.name
    if outcome.failure is not None:
        return f"{name}: failed, {outcome.failure}"
    peak = peak_of(outcome.curve)
    return f"{name}: {peak.short} " + ("(there already)" if outcome.resumed else f"in {outcome.seconds:.1f} s")
