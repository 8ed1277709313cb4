"""Every command and every Python block of the README runs, one after another as a reader would paste them."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from cli_in_process import axijax

from axijax.app import case
from axijax.app.case import Case

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()

# Commands that run elsewhere: the first two blocks in .ci/run, the table's rows in test_cli.py.
ELSEWHERE = ("python3 -m venv", ".venv/bin/")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture(scope="module")
def first_case(tmp_path_factory):
    """The folder after all `sh` blocks, for a small specimen instead of the paper's; what each command printed."""
    folder = tmp_path_factory.mktemp("readme")
    small = Case(specimen={"layers": 9, "half_width": 5}, test={"axial_strain": 0.006, "record_every": 25})
    printed = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(case, "default_case", lambda kind: small)
        patch.chdir(folder)
        for line in "".join(blocks("sh")).splitlines():
            if line.startswith(ELSEWHERE):
                continue
            if line.startswith("axijax "):
                called = axijax(*shlex.split(line)[1:])
                printed[line] = called.out
                # The checks of a specimen so small tell that its radius is ill defined; that is not the README's case.
                assert called.code == 0 or line == "axijax check results/first", f"{line}: {called.err}"
                assert "Traceback" not in called.err
            else:
                subprocess.run(line, shell=True, check=True)
    return folder, printed


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


def test_what_check_prints_is_what_the_readme_shows():
    """Names and order of the lines; times and memory are those of one machine."""
    shown = blocks("text")[0].splitlines()
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


def test_code_blocks_run_in_order(first_case):
    folder, _ = first_case
    python = blocks("python")
    assert len(python) >= 3
    result = subprocess.run(
        [sys.executable, "-c", "import matplotlib; matplotlib.use('Agg')\n" + "\n".join(python)],
        capture_output=True, text=True, cwd=folder, timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "peak stress ratio 2.46" in result.stdout
    slope = float(re.search(r"d friction ([0-9.]+)", result.stdout).group(1))
    assert 4.9 < slope < 5.7
    assert (folder / "curve.png").stat().st_size > 5000


def test_ci_runs_the_readmes_test_command():
    command = re.search(r"```sh\n(.*pytest)\n```", README).group(1)
    assert command in (ROOT / ".ci" / "run").read_text()
