"""What a user installs: the wheel, in a place of its own, away from this folder."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel, and a folder that it was installed into; what it needs is this environment's."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "axijax", "calibrate"):  # a build writes beside its sources
        (source / name).symlink_to(ROOT / name)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", str(folder), str(source)], check=True, capture_output=True)
    (wheel,) = folder.glob("axijax-*.whl")
    place = folder / "place"
    subprocess.run([*pip, "install", "--no-deps", "--target", str(place), str(wheel)], check=True, capture_output=True)
    return wheel, place


def test_every_module_is_in_the_wheel(installed):
    wheel, _ = installed
    held = set(zipfile.ZipFile(wheel).namelist())
    for package in ("axijax", "calibrate"):
        for path in (ROOT / package).rglob("*.py"):
            assert str(path.relative_to(ROOT)) in held
        assert f"{package}/py.typed" in held
    assert not [name for name in held if name.startswith(("tests", "examples"))]


def test_the_installed_program_runs_without_the_sources(installed, tmp_path):
    """Its modules are those of the wheel, and its command writes a case file."""
    _, place = installed
    elsewhere = {**os.environ, "PYTHONPATH": str(place), "PYTHONSAFEPATH": "1"}

    def python(*arguments):
        told = subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path, env=elsewhere, capture_output=True, text=True, check=True
        )
        return told.stdout.strip()

    where = "import axijax, calibrate; print(axijax.__file__, calibrate.__file__)"
    assert all(str(place) in path for path in python("-c", where).split())
    python("-m", "axijax", "new", "first.toml")
    assert (tmp_path / "first.toml").exists()
