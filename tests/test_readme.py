"""Every command and every Python block of README and guide runs, one after another as a reader would paste them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from cli_in_process import axijax

from axijax.app import case
from axijax.app.case import Case, SpecimenCase, default_case

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
GUIDE = ROOT / "examples" / "guide"
LONGEST = 1500  # words of the README

# Commands that run elsewhere: the first two blocks in .ci/run, the table's rows in test_cli.py; a sand's fit, with the
# same options, in test_calibrate_random.py; the shell's own state; and the site, which needs what tests do not install.
SAND_FIT = "axijax calibrate results/sketch"
ELSEWHERE = ("python3 -m venv", ".venv/bin/", "source .venv", "axijax table1", "pip install", SAND_FIT)

# Pages whose commands go on from one another in one folder, in this order.
COMMANDS = ("first_case.md", "calibration.md", "results.md")
# What may end with exit code 1 here: the check of a specimen so small says what is wrong with it.
MAY_DOUBT = ("axijax check results/first",)


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def page(name: str) -> str:
    return (GUIDE / name).read_text()


def small_case(kind: str) -> Case:
    """In the place of the paper's quarter and of four hundred balls at random."""
    if kind != "random":
        return Case(specimen={"layers": 9, "half_width": 5}, test={"axial_strain": 0.006, "record_every": 25})
    return default_case(kind).model_copy(update={"specimen": SpecimenCase(kind="random", balls=60)})


@pytest.fixture(scope="module")
def first_case(tmp_path_factory):
    """The folder after all `sh` blocks, for a small specimen instead of the paper's; what each command printed."""
    folder = tmp_path_factory.mktemp("readme")
    lines = "".join(blocks("sh") + [block for name in COMMANDS for block in blocks("sh", page(name))]).splitlines()
    printed = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(case, "default_case", small_case)
        patch.setenv("AXIJAX_LIBRARY", str(folder / "runs"))
        patch.chdir(folder)
        for line in dict.fromkeys(lines):  # what a page says again is done already
            if line.startswith(ELSEWHERE):
                continue
            if line.startswith("axijax "):
                called = axijax(*shlex.split(line, comments=True)[1:])
                printed[line] = called.out
                assert called.code == 0 or line.startswith(MAY_DOUBT), f"{line}: {called.err}"
                assert "Traceback" not in called.err
            else:
                subprocess.run(line, shell=True, check=True)
    return folder, printed


def test_the_readme_is_short():
    assert len(README.split()) <= LONGEST


def test_commands_of_the_first_case(first_case):
    folder, printed = first_case
    assert {"axijax new first.toml", "axijax check first.toml", "axijax run first.toml"} <= set(printed)
    peaks = [
        float(re.search(r"peak stress ratio ([0-9.]+)", printed[f"axijax run {name}.toml"])[1])
        for name in ("first", "strong")
    ]
    assert peaks[1] > 1.3 * peaks[0], "the number was changed"
    assert "to 2 %" in printed["axijax resume results/first --axial-strain 0.02"]
    for name in ("results/first/curve.nc", "results/strong/curve.csv", "both.png", "results/first/report.html"):
        assert (folder / name).stat().st_size > 1000
    fit = printed["axijax calibrate results/strong/curve.csv --fit friction --case first.toml"]
    assert float(re.search(r"friction = ([0-9.]+)", fit)[1]) == pytest.approx(0.3, rel=1e-2)


def test_commands_of_the_sand(first_case):
    folder, printed = first_case
    assert "axijax run sketch.toml" in printed
    assert "\nplaten_speed = 0.03\n" in (folder / "sketch.toml").read_text()
    assert (folder / "results" / "sketch" / "curve.csv").stat().st_size > 1000, "what the fit is given"
    (line,) = (line for block in blocks("sh") for line in block.splitlines() if line.startswith(SAND_FIT))
    options = {"--case", "--fit", "--bounds", "--output"}
    assert {word for word in line.split() if word.startswith("--")} == options


def test_commands_of_the_results_page(first_case):
    folder, _ = first_case
    pictures = {path.stem for path in (folder / "results" / "first" / "pictures").glob("*.png")}
    assert {"curve", "q-eps", "mohr", "specimen", "force-network"} <= pictures
    for name in ("snapshots", "snapshots-full"):
        for part in ("balls", "contacts", "membrane", "platens"):
            assert (folder / "results" / "first" / name / f"{part}.pvd").exists()


def test_what_check_prints_is_what_the_guide_shows():
    """Names and order of the lines; times and memory are those of one machine."""
    shown = blocks("text", page("first_case.md"))[0].splitlines()
    import contextlib
    import io

    from axijax.app.cli.check import _print_forecast
    from axijax.app.forecast import forecast

    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        _print_forecast(forecast(Case(), measure=False))
    ours = out.getvalue().splitlines()
    measured = ("time  ", "memory")
    assert [line for line in shown if not line.startswith(measured)] == [
        line for line in ours if not line.startswith(measured)
    ]


# Run one page after another in one process, so that what one compiled serves the next; each page with names of its own.
PAGES = """
import matplotlib, re, sys
matplotlib.use("Agg")
for path in sys.argv[1:]:
    print("page", path)
    with open(path) as file:
        source = "\\n".join(re.findall(r"```python\\n(.*?)```", file.read(), re.DOTALL))
    exec(compile(source, path, "exec"), {"__name__": "__main__"})
"""


@pytest.fixture(scope="module")
def python_blocks(first_case):
    folder, _ = first_case
    # PHYSICS shows formulas; where_to_add.md is run by test_outside.py. What a page says again has been run already.
    found = [ROOT / "README.md", *sorted(each for each in GUIDE.glob("*.md") if blocks("python", each.read_text()))]
    pages: dict[tuple[str, ...], Path] = {}
    for each in found:
        pages.setdefault(tuple(blocks("python", each.read_text())), each)
    cache = {  # of compiled programs, of which other tests need some; scripts have none unless they ask for it
        "JAX_COMPILATION_CACHE_DIR": jax.config.values["jax_compilation_cache_dir"],
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.05",
    }
    result = subprocess.run(
        [sys.executable, "-c", PAGES, *map(str, pages.values())],
        capture_output=True, text=True, cwd=folder, timeout=400, env={**os.environ, **cache, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr
    printed = dict(re.findall(r"^page (\S+)\n(.*?)(?=^page |\Z)", result.stdout, re.DOTALL | re.MULTILINE))
    return folder, {Path(name).name: text for name, text in printed.items()}


def test_the_page_on_python_begins_with_the_readmes_blocks():
    assert blocks("python", page("python.md"))[:2] == blocks("python")


def test_the_ten_lines_and_the_derivative(python_blocks):
    folder, printed = python_blocks
    assert "peak stress ratio 2.46" in printed["README.md"]
    slope = float(re.search(r"d friction ([0-9.]+)", printed["README.md"]).group(1))
    assert 4.9 < slope < 5.7
    assert (folder / "curve.png").stat().st_size > 5000


def test_python_blocks_of_the_pages(python_blocks):
    _, printed = python_blocks
    assert {"calibration.md", "stress_paths.md", "random_specimens.md", "batches.md"} <= set(printed)
    assert "converged" in printed["calibration.md"] and "friction = " in printed["calibration.md"]
    assert 1.5 < float(re.search(r"at 1 % strain ([0-9.]+)", printed["random_specimens.md"])[1]) < 4
    assert "followed to its end" in printed["stress_paths.md"]
    peaks = [float(each) for each in re.search(r"\[([0-9.]+) +([0-9.]+)\]", printed["batches.md"]).groups()]
    assert 2 < peaks[0] < peaks[1] < 3


def test_ci_runs_the_readmes_test_command():
    command = re.search(r"```sh\n(.*pytest)\n```", README).group(1)
    assert command in (ROOT / ".ci" / "run").read_text()
