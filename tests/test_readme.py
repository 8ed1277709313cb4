"""Every command and every Python block of README and guide runs, one after another as a reader would paste them, for
small specimens; examples/guide/run_pages.py, which reads the pages for this too, runs them as they are printed."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from cli_in_process import axijax

import axijax as package
from axijax.app import case
from axijax.app.case import Case, SpecimenCase, default_case

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "examples" / "guide"
sys.path.insert(0, str(GUIDE))
import run_pages  # noqa: E402

README = run_pages.README
LONGEST = 1500  # words of the README

# Commands that run elsewhere: the first block in .ci/run, the table's rows in test_cli.py; a sand's fit, with the same
# options, in test_calibrate_random.py; and the shell's own state.
SAND_FIT = "axijax calibrate results/sketch"
ELSEWHERE = ("python3 -m venv", "source .venv", SAND_FIT)

# Pages whose commands go on from one another in one folder, after the README's.
COMMANDS = ("first_case.md", "calibration.md", "results.md")
# What may end with exit code 1 here: the check of a specimen so small says what is wrong with it.
MAY_DOUBT = ("axijax check results/first",)


def blocks(language: str, page: Path = README) -> list[str]:
    """Of what is run on a page; "text" for what it says is printed."""
    return [block.text for block in run_pages.blocks(page, language) if not block.skipped]


SMALL = {"layers": 9, "half_width": 5}
BALLS = 60  # of a random specimen; one size and seed for commands and Python, so that it is compiled once


def small_case(kind: str) -> Case:
    """In the place of the paper's quarter and of four hundred balls at random."""
    if kind != "random":
        return Case(specimen=SMALL, test={"axial_strain": 0.006, "record_every": 25})
    return default_case(kind).model_copy(update={"specimen": SpecimenCase(kind="random", balls=BALLS)})


@pytest.fixture(scope="module")
def first_case(tmp_path_factory):
    """The folder after all `sh` blocks, for a small specimen instead of the paper's; what each command printed."""
    folder = tmp_path_factory.mktemp("readme")
    pages = [README, *(GUIDE / name for name in COMMANDS)]
    lines = "".join(block for page in pages for block in blocks("sh", page)).splitlines()
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
    assert len(README.read_text().split()) <= LONGEST


def test_pages_that_share_a_shell():
    assert run_pages.together([GUIDE / "results.md", README, GUIDE / "calibration.md"]) == [
        [GUIDE / "first_case.md", GUIDE / "results.md", GUIDE / "calibration.md"], [README],
    ]  # fmt: skip


def test_the_script_that_runs_pages(tmp_path, capfd, monkeypatch):
    """Of a repository with pages of our own: what is shared, what is skipped and named, what has failed."""
    first, second = tmp_path / "first.md", tmp_path / "second.md"
    first.write_text(
        "```sh\nnumber=3; echo from $number > made.txt\n```\n```python\nreport = 4\n```\n"
        "```python\nprint(report + 1)\n```\n"
        "```sh\n# needs a GPU\nexit 1\n```\n```text\nno command\n```\n"
    )
    second.write_text("These lines go on\nfrom [the first](first.md).\n```sh\ncat made.txt $number\n```\n")
    for command in ("init -q", "add .", "-c user.name=a -c user.email=a@b commit -q -m pages"):
        subprocess.run(["git", *command.split()], cwd=tmp_path, check=True)
    monkeypatch.setattr(run_pages, "ROOT", tmp_path)
    (group,) = run_pages.together([second])
    folder = tmp_path / "runs"
    folder.mkdir()
    done = run_pages.run(group, None, folder)
    assert [(each.block.name, each.failed) for each in done] == [
        ("first.md:2", False), ("first.md:5", False), ("first.md:8", False), ("second.md:4", True),
    ]  # fmt: skip
    assert all(each.seconds is not None for each in done)
    printed = capfd.readouterr().out
    assert "from 3\n" in printed and "\n5\n" in printed and "first.md:11 skipped: needs a GPU" in printed


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
    shown = blocks("text", GUIDE / "first_case.md")[0].splitlines()
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


@pytest.fixture(scope="module")
def python_blocks(first_case):
    """What the pages' blocks print, a page after another, each with names of its own; where the commands have run.

    The paper's quarter (its peak: validation/test_table1.py, its slope: validation/test_gradients.py) is a small one.
    """
    folder, _ = first_case
    # where_to_add.md is run by test_outside.py. What a page says again has been run already.
    pages: dict[tuple[str, ...], Path] = {}
    for each in run_pages.PAGES:
        if each.name != "where_to_add.md" and (found := blocks("python", each)):
            pages.setdefault(tuple(found), each)
    octagon, packed, printed = package.fcc_octagon, package.random_cylinder, {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(package, "fcc_octagon", lambda: octagon(**SMALL))
        patch.setattr(package, "random_cylinder", lambda _, *args, **options: packed(BALLS, *args, **options))
        patch.setattr("axijax.case.Case", partial(Case, specimen=SMALL))
        patch.chdir(folder)
        for found, page in pages.items():
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile("\n".join(found), page, "exec"), {"__name__": "__main__"})
            printed[page.name] = out.getvalue()
    return folder, printed


def test_the_page_on_python_begins_with_the_readmes_blocks():
    assert blocks("python", GUIDE / "python.md")[:2] == blocks("python")


def test_the_ten_lines_and_the_derivative(python_blocks):
    """Below Thornton's endless array; `simulate` has the peak of `run`; the slope is the closed form's to a tenth."""
    folder, printed = python_blocks
    told = printed["README.md"]
    peak, closed = map(float, re.search(r"peak stress ratio ([0-9.]+), Thornton ([0-9.]+)", told).groups())
    assert 0.9 * closed < peak < closed == pytest.approx(2.56, abs=1e-3)
    value, slope = map(float, re.search(r"peak ([0-9.]+), d peak / d friction ([0-9.]+)", told).groups())
    assert value == pytest.approx(peak, abs=2e-3)
    assert slope == pytest.approx(4 / (1 - 0.12278) ** 2, rel=0.1)
    assert (folder / "curve.png").stat().st_size > 5000


def test_names_of_the_package_that_pages_use_are_there_in_a_new_process():
    """The blocks above share a process in which everything has been imported already."""
    text = "\n".join(block for page in run_pages.PAGES for block in blocks("python", page))
    names = sorted(set(re.findall(r"\baxijax\.[a-z]\w*(?:\.[a-z]\w*)*(?=\()", text, re.IGNORECASE)))
    assert {"axijax.TriaxialTest", "axijax.theory.fcc_stress_ratio", "axijax.stage"} <= set(names)
    subprocess.run([sys.executable, "-c", "\n".join(["import axijax", *names])], check=True, cwd=ROOT, timeout=100)


def test_python_blocks_of_the_pages(python_blocks):
    _, printed = python_blocks
    assert {"calibration.md", "stress_paths.md", "random_specimens.md", "batches.md"} <= set(printed)
    assert "converged" in printed["calibration.md"] and "friction = " in printed["calibration.md"]
    assert 1.5 < float(re.search(r"at 1 % strain ([0-9.]+)", printed["random_specimens.md"])[1]) < 4
    assert "followed to its end" in printed["stress_paths.md"]
    peaks = [float(each) for each in re.search(r"\[([0-9.]+) +([0-9.]+)\]", printed["batches.md"]).groups()]
    assert 2 < peaks[0] < peaks[1] < 3


def test_ci_runs_the_readmes_test_command():
    (command,) = (line for block in run_pages.blocks(README) for line in block.text.splitlines() if "pytest" in line)
    assert command in (ROOT / ".ci" / "run").read_text()
