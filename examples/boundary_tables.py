"""Tables of the boundary study: a CSV file of every number, and Markdown of those that answer its question."""

import csv
from pathlib import Path

from boundary_statistics import COMPARED, by_arc, changes, full_scatter, narrowest, of_size

ALL = "all"  # in place of a friction: the mean over the frictions
DEFINITIONS = """\
Axial strain 0 to 15 %, curves averaged over 1 % of strain, no cut. R = s1/s3, platen force over the area of radius Rm.
peak ratio, strain at peak, dilatancy at peak (-d(volumetric strain)/d(axial strain) over +-1 % about it): of the MEAN
curve over the seeds. early ratio: mean over 1 to 5 %. critical ratio: mean over 11 to 15 %. mean of the runs' peaks:
each run's own maximum; noise lifts it, the more the fewer balls a sector has. scatter: standard deviation over the
seeds, of the early ratio or at the strain of the mean curve's peak. early ratio x (1 + void ratio): as if all sections
were as solid; the hole that a narrow sector has along its axis carries no load. Errors (+-): jackknife over the seeds;
a strain at peak is a maximum's place, whose error the jackknife only indicates. void ratio, solid fractions: before
shear; inner half is within Rm/2. coordination: ball-ball contacts only, so that rigid planes lower it. arc length:
2 pi Rm/n. f = all: mean over the frictions of the changes from n = 1; packings are the same at all frictions, so a
seed is left out at all of them together."""


def write_csv(samples, path: Path) -> None:
    rows = []
    for sample in samples.values():
        row = {
            "size": sample.size, "friction": sample.friction, "boundary": sample.boundary, "order": sample.order,
            "runs": len(sample.runs), "failed": len(sample.failed),
        }  # fmt: skip
        for name, value in sample.numbers.items():
            row[name] = value
            if name in next(iter(sample.left_out.values()), {}):
                row[name + " +-"] = sample.error(name)
        if sample.left_out:
            row["scatter of a run's early ratio"] = sample.scatter()
        rows.append(row)
    at = {(row["size"], row["friction"], row["boundary"], row["order"]): row for row in rows}
    frictions = sorted({sample.friction for sample in samples.values()})
    for wanted in (*((f,) for f in frictions), None):
        for name in COMPARED:
            for (size, boundary, order), (value, error, arc) in changes(samples, name, wanted).items():
                key = size, wanted[0] if wanted else ALL, boundary, order
                if key not in at:
                    at[key] = dict(zip(("size", "friction", "boundary", "order"), key, strict=True))
                    at[key]["arc length [diameters]"] = arc
                    rows.append(at[key])
                at[key][f"{name}, change from n = 1 [%]"] = value
                at[key][f"{name}, change from n = 1 [%] +-"] = error
    fields = list(dict.fromkeys(name for row in rows for name in row))
    with open(path, "w", newline="") as file:
        for line in DEFINITIONS.splitlines():
            file.write(f"# {line}\n")
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(
            {name: f"{value:.5g}" if isinstance(value, float) else value for name, value in row.items()} for row in rows
        )


def print_tables(samples) -> None:
    """Markdown: changes from the full cylinder, over all frictions and by friction; then the numbers themselves."""
    print(DEFINITIONS + "\n")
    scatter = full_scatter(samples)
    sizes = sorted(scatter)
    for name in COMPARED:
        print(f"\n{name}, change from n = 1 [%], mean over the frictions (arc length in diameters)")
        found = changes(samples, name)
        print_changes({f"{size} balls": of_size(found, size) for size in sizes})
        print("by arc, all periodic sectors together:")
        rows = [
            [f"{least:g} to {most:g}", f"{number}", f"{mean:+.1f} ± {error:.1f}", f"{spread:.1f}"]
            for least, most, number, mean, error, spread in by_arc(found)
        ]
        table(["arc", "samples", "change [%]", "chi^2 a degree of freedom"], rows)
    print("\nscatter of single full cylinders, early ratio [%]; largest n up to which the change is smaller")
    found = changes(samples, "early ratio")
    rows = [[f"{scatter[size]:.1f}" for size in sizes]]
    rows.append([f"{narrowest(of_size(found, size), scatter[size])}" for size in sizes])
    table([f"{size} balls" for size in sizes], rows)
    frictions = sorted({sample.friction for sample in samples.values()})
    by_friction = {f"f = {f:g}": changes(samples, "early ratio", (f,)) for f in frictions}
    for size in sizes:
        print(f"\nearly ratio, change from n = 1 [%], {size} balls, by friction")
        print_changes({name: of_size(found, size) for name, found in by_friction.items()})
    shown = ("peak ratio", "strain at peak [%]", "dilatancy at peak", "early ratio", "critical ratio",
             "coordination at end", "void ratio at start", "solid fraction, inner half",
             "solid fraction, outer half")  # fmt: skip
    rows = []
    for sample in samples.values():
        row = [f"{sample.size}", f"{sample.friction:g}", sample.boundary, f"{sample.order}", f"{len(sample.runs)}"]
        row[-1] += f", {len(sample.failed)} failed" * bool(sample.failed)
        for name in shown if sample.numbers else ():
            digits = 1 if "%" in name else 3
            row.append(f"{sample.numbers[name]:.{digits}f} ± {sample.error(name):.{digits}f}")
        rows.append(row)
    print()
    table(["balls", "f", "boundary", "n", "runs", *shown], rows)


def print_changes(columns) -> None:
    """A table of changes: under each heading those by (boundary, order)."""
    rows = []
    for boundary, order in sorted({key for some in columns.values() for key in some}):
        row = [f"{order}{', rigid' * (boundary == 'rigid')}"]
        for some in columns.values():
            value = some.get((boundary, order))
            row.append("{:+.1f} ± {:.1f} ({:.1f})".format(*value) if value else "-")
        rows.append(row)
    table(["n", *columns], rows)


def table(heads, rows) -> None:
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
