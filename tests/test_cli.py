"""The command line: a small table from start to finish, and one sentence for what cannot work."""

import csv
import subprocess
import sys
import threading

import numpy as np
import pytest

from axijax.app import table1


def axijax(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "axijax", *arguments], capture_output=True, text=True, cwd=cwd, timeout=120
    )


def test_help_stands_alone():
    for arguments in (("--help",), ("table1", "--help")):
        result = axijax(*arguments)
        assert result.returncode == 0 and "triaxial" in result.stdout


def test_unwritable_folder_is_one_sentence(tmp_path):
    (tmp_path / "taken").write_text("a file, not a folder")
    result = axijax("table1", "--output", str(tmp_path / "taken"))
    assert result.returncode == 1
    assert "taken" in result.stderr and "--output" in result.stderr
    assert "Traceback" not in result.stderr and len(result.stderr.strip().splitlines()) == 1


def test_unknown_option_is_refused():
    result = axijax("table1", "--outptu", "x")
    assert result.returncode != 0 and "Traceback" not in result.stderr


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Two rows of the table, to a small strain, saved as the command saves them."""
    folder = tmp_path_factory.mktemp("table1")
    runs = (table1.PAPER_RUNS[0], table1.DEFORMED)
    threads = []
    short, table1.DEFORMED_STRAIN, table1.AXIAL_STRAIN = (table1.DEFORMED_STRAIN, table1.AXIAL_STRAIN), 0.002, 0.002
    try:
        rows = table1.run_table(runs, finished=lambda row: threads.append(threading.current_thread()))
    finally:
        table1.DEFORMED_STRAIN, table1.AXIAL_STRAIN = short
    # What is told of each row as it ends is told by one thread, so that lines cannot run together.
    assert threads == 2 * [threading.main_thread()]
    return rows, folder, table1.save(rows, folder)


def test_table_has_the_stated_columns(saved):
    rows, folder, _ = saved
    with open(folder / "table1.csv") as file:
        table = list(csv.DictReader(file))
    assert tuple(table[0]) == (
        "stiffness", "boundary", "sectors", "friction", "theory", "paper", "peak_ratio", "core_ratio", "virial_ratio",
        "paper_strain", "axial_strain_at_peak", "flat_from", "flat_to", "seconds",
    )  # fmt: skip
    assert [row["stiffness"] for row in table] == ["ball", "ball"]
    assert [row["friction"] for row in table] == ["0.05", "0.12278"]
    assert float(table[1]["peak_ratio"]) == pytest.approx(float(np.max(rows[1].run.curve.stress_ratio)), abs=1e-6)


@pytest.mark.parametrize("width", [40, 60, 79, 80, 100, 120, 200])
def test_the_table_is_as_wide_as_the_terminal_and_breaks_no_number(saved, width):
    import io

    from rich.console import Console

    from axijax.app.cli.table1 import _cells, tables

    rows, _, _ = saved
    console = Console(file=io.StringIO(), width=width)
    pieces = tables(rows, width)
    for table in pieces:
        console.print(table)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width and (len(pieces) == 1) == (width >= 120)
    words = [line.split() for line in lines]
    for row in rows:
        told = [word for line in words if line[:3] == list(_cells(row).values())[:3] for word in line[3:]]
        assert told == list(_cells(row).values())[3:]


def test_curves_come_back_labelled(saved):
    import xarray

    rows, folder, _ = saved
    with xarray.open_dataset(folder / "curves.nc", engine="scipy") as curves:
        assert list(curves.friction.values) == [0.05, 0.12278]
        assert curves.stress_ratio.attrs["long_name"] and curves.membrane_radius.attrs["units"] == "L"
        first = curves.stress_ratio.isel(run=0).dropna("record").values
    np.testing.assert_array_equal(first, rows[0].run.curve.stress_ratio)


def test_pictures_are_pictures(saved):
    _, _, paths = saved
    assert [path.name for path in paths] == ["table1.csv", "curves.nc", "figure_4a.png", "figure_4b.png"]
    for path in paths[2:]:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 20_000


def test_a_failed_write_leaves_nothing(tmp_path):
    from axijax.core.files import write_whole

    def breaks(target):
        target.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_whole(tmp_path / "curve.csv", breaks)
    assert list(tmp_path.iterdir()) == []
