"""The package's structure: nothing points up, its public names are those it shows, no file is too long to be read."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import axijax

ROOT = Path(__file__).parents[1]
LONGEST = 420  # lines


def lint_imports(folder):
    """import-linter's own command, of this environment, on the packages of a folder with a pyproject.toml."""
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    return subprocess.run(
        [*command, "--config", "pyproject.toml", "--no-cache"], cwd=folder, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": str(folder)},
    )  # fmt: skip


def test_contracts_between_wings_are_kept():
    told = lint_imports(ROOT)
    assert told.returncode == 0, told.stdout + told.stderr
    assert "3 kept, 0 broken" in told.stdout


def test_an_import_that_points_up_is_found(tmp_path):
    """Without which the contracts could hold of nothing: the same packages and contracts, and one import too many."""
    for name in ("axijax", "calibrate", "pyproject.toml"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "axijax").unlink()
    (tmp_path / "axijax").mkdir()
    for each in (ROOT / "axijax").iterdir():
        if each.name not in ("core", "__pycache__"):
            (tmp_path / "axijax" / each.name).symlink_to(each)
    (tmp_path / "axijax" / "core").mkdir()
    for each in (ROOT / "axijax" / "core").glob("*.py"):
        (tmp_path / "axijax" / "core" / each.name).write_bytes(each.read_bytes())
    with open(tmp_path / "axijax" / "core" / "vector.py", "a") as file:
        file.write("\nfrom axijax.app import case\n")
    told = lint_imports(tmp_path)
    assert told.returncode == 1 and "axijax.core.vector -> axijax.app.case" in told.stdout, told.stdout


def test_the_package_shows_its_public_names_and_nothing_else():
    """In a process of its own: modules that others import become attributes, and are not shown all the same."""
    code = "import axijax.app.runs, axijax; print(*dir(axijax))"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ).stdout.split()  # fmt: skip
    modules = {path.stem for path in (ROOT / "axijax").glob("*.py")} - {"__init__", "__main__"}
    assert set(shown) == set(axijax.__all__) | modules
    assert len(shown) == len(set(shown)) and not [name for name in shown if name.startswith("_")]


@pytest.mark.parametrize("name", sorted(dir(axijax)))
def test_every_public_name_is_there(name):
    found = getattr(axijax, name)
    if name not in axijax.__all__ or name == "theory":
        assert found is import_module(f"axijax.{name}")
    else:
        assert found.__name__ == name and found.__module__.startswith("axijax.") and found.__doc__


def test_a_name_that_is_not_there_is_told():
    with pytest.raises(AttributeError, match="has no attribute 'Sand'; it has BackgroundDamping, "):
        axijax.Sand  # noqa: B018


@pytest.mark.parametrize("package", ["axijax", "calibrate"])
def test_no_file_is_too_long(package):
    lines = {path: len(path.read_text().splitlines()) for path in (ROOT / package).rglob("*.py")}
    assert len(lines) > 10
    assert {str(path): count for path, count in lines.items() if count > LONGEST} == {}
