"""What the terminal shows: lines as wide as it is, broken at words and never in a number; help with its brackets."""

import inspect
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cli_in_process import axijax
from small_result import CASE

from axijax.app import animation, plot
from axijax.app.checks import result_checks
from axijax.app.cli import check, main, run, say
from axijax.app.forecast import Forecast
from axijax.app.results import open_result
from axijax.app.runs import resume, run_case
from axijax.core.palette import COLOURS
from calibrate.sensitivity import Sensitivity

pytest_plugins = ["small_result"]
WIDTHS = (60, 80, 120, 200)
FORECAST = Forecast(
    balls=427, contacts=2085, height=718.8, membrane_radius=167.0, critical_time_step=0.0543, time_step=0.03258,
    inertial_number=2.2e-4, heaviest=None, softness=6.7e-4, shear_steps=11450, records=229, confinement_steps=3000,
    seconds=8.0, ball_steps_per_second=1.8e6, memory=311 * 2**20, ramp_strain=1e-4,
    warnings=["the inertial number 0.0022 is above 1e-3: the test is not quasi-static; lower platen_speed to 0.0045"],
)  # fmt: skip


def words(text: str) -> list[str]:
    return text.split()


def screen(monkeypatch, capsys, width, show) -> str:
    monkeypatch.setenv("COLUMNS", str(width))
    show()
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= width, text
    return text


@pytest.mark.parametrize("width", WIDTHS)
def test_lines_break_at_words_and_keep_numbers_whole(monkeypatch, capsys, result, width):
    shows = (
        lambda: check._print_forecast(FORECAST),
        lambda: check._print_checks(result_checks(result)),
        lambda: run._PlainLines(result.path).finished(axijax_run(result)),
    )
    for show in shows:
        wide, text = (
            re.sub(r"[\d.]+(?= s;)", "1", screen(monkeypatch, capsys, room, show)) for room in (2000, width)
        )
        assert sorted(words(text)) == sorted(words(wide)), "no word is broken or lost"
        assert not re.search(r"\d\s*\n\s*%", text), "a number and its unit stay together"


def axijax_run(result):
    from axijax.triaxial.progress import Run, curve_of

    now = result.progress
    return Run(curve_of(now, CASE["test"]["axial_strain"]), *now.lists, now.state)


def test_a_pipe_has_a_fixed_width(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert say.width() == say.PIPE
    say.say("word " * 100)
    assert max(map(len, capsys.readouterr().out.splitlines())) <= say.PIPE


def test_what_belongs_together_is_not_parted():
    text = "reached 0.9957 % of 1 % at R = 2.637 +- 0.004, in a/path/that/is/long/and/stays/whole.csv and 41.2 s more"
    for room in range(45, 120):
        lines = say.wrapped(text, room, "  ")
        assert words(" ".join(lines)) == words(text)
        assert not any(re.match(r"\s*(%|\+-|s more)", line) for line in lines[1:])
        assert not any(line.endswith("+-") for line in lines)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("command", [each.__name__ for each in main.COMMANDS])
def test_help_flows_and_shows_its_brackets(monkeypatch, command, width):
    monkeypatch.setenv("COLUMNS", str(width))
    function = next(each for each in main.COMMANDS if each.__name__ == command)
    found = axijax(command, "--help")
    lines = found.out.splitlines()
    assert found.code == 0 and max(map(len, lines)) <= width
    assert f"Usage: axijax {command}" in found.out
    assert "\u2026" not in found.out, "nothing is cut off"
    flat = " ".join(re.sub(r"[\u2500-\u257f]", " ", found.out).split())
    for paragraph in inspect.cleandoc(function.__doc__).split("\n\n"):
        assert " ".join(paragraph.split()) in flat, "with all its brackets"
    # No line ends before a word that would have fitted.
    text = found.out.split("\u256d")[0].split("\n")
    for line, after in pairwise(text):
        if line.strip() and after.strip():
            assert len(line.rstrip()) + 1 + len(after.split()[0]) > width - 2, line
    for example in main.COMMANDS[function]:
        assert " ".join(example.split()) in flat


def test_brackets_of_units_are_in_the_help(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    text = axijax("calibrate", "--help").out
    for part in ("[mm]", "[kPa]", "[-]", "[bar]"):
        assert part in text, part


@pytest.mark.parametrize("width", WIDTHS)
def test_the_line_of_a_run_fits_beside_a_bar(result, width):
    line = run._line(result.test, result.progress, 1.8e6, width)
    assert len(line) + len("  ") + 10 + len(" 100 %  12:34:56 left") <= width, "ten characters of bar"
    assert "0.200 of 0.2 %" in line and "shearing" in line


@pytest.mark.parametrize("width", WIDTHS)
def test_sensitivities_are_tables_of_whole_numbers(width):
    strain = np.linspace(0.001, 0.02, 20)
    slopes = np.random.default_rng(0).normal(size=(2, 2, 20))
    found = Sensitivity(
        ("friction", "normal_stiffness"), strain, slopes[0], slopes, 0.1 * np.abs(slopes), None, np.full(2, 0.05), 4,
        (0.02, 1e-4),
    )  # fmt: skip
    lines = "\n".join(say.wrapped(found.table(width), width)).split("directions")[0].splitlines()
    assert max(map(len, lines)) <= width
    rows = [line.split()[1:] for line in lines if line.startswith("friction")]
    told = [float(word) for line in rows for word in line if word != "+-"]
    assert len(told) == 2 * 2 * 10
    np.testing.assert_allclose(told[::2][:10], slopes[0, 0, 1::2], rtol=0.06)


def test_six_snapshots_are_six_and_make_a_film(tmp_path):
    from PIL import Image

    folder = tmp_path / "six"
    run_case_in(folder, snapshots=6)
    result = open_result(folder)
    frames = animation._frames(result)
    strains = np.array([strain for strain, _ in frames])
    np.testing.assert_allclose(strains, np.linspace(0, 0.002, 6), atol=2e-4)
    assert all(place.shape == (3, len(result.test.cut)) for _, place in frames)
    # A uniform strain and a shift are no motion against the uniform strain.
    start = frames[0][1]
    even = start * np.array([[1.01], [1.01], [0.97]]) + np.array([[0.0], [0.0], [3.0]])
    assert animation._against_uniform(start, even).max() < 1e-9 * np.abs(start).max()
    (path,) = plot.plot_result([result], ["animation"], tmp_path / "film.gif")
    with Image.open(path) as film:
        assert film.format == "GIF" and film.n_frames == 6
    few = open_result(folder)
    (folder / "snapshots" / "balls.pvd").unlink()
    with pytest.raises(ValueError, match=r"kept no snapshots of its balls, and a film needs two.*--snapshots 40"):
        plot.plot_result([few], ["animation"], tmp_path / "none")
    # What was drawn of the smaller strain goes where the run goes on.
    plot.plot_result([result], ["curve"], folder / "pictures")
    (folder / "pictures" / "own.png").write_bytes(b"mine")
    with pytest.warns(UserWarning, match="pictures/curve.png: removed, since they are of a smaller strain"):
        resume(folder, axial_strain=0.0025)
    assert [path.name for path in (folder / "pictures").iterdir()] == ["own.png"]


def run_case_in(folder, **options):
    from axijax.app.case import Case

    return run_case(Case.model_validate(CASE), folder, "six", **options)


def test_one_colour_has_one_meaning_and_all_are_told_apart(result):
    """Deuteranopia as Machado, Oliveira & Fernandes (2009) simulate it, in linear RGB; distances in CIE L*a*b*."""
    from matplotlib.colors import to_rgb

    simulate = np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
    )
    xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]]
    )

    def lab(colour):
        light = np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)])
        ratio = xyz @ np.clip(simulate @ light, 0, 1) / np.array([0.95047, 1.0, 1.08883])
        f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
        return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])

    seen = [lab(colour) for colour in COLOURS]
    gaps = [np.linalg.norm(a - b) for k, a in enumerate(seen) for b in seen[:k]]
    assert min(gaps) > 10, "five times what an eye just tells"
    assert np.linalg.norm(lab(COLOURS[0]) - lab(COLOURS[1])) > 60, "the two most used"
    several = plot.curve_figure([replace(result, name=name) for name in "abc"])
    lines = [line for line in several.axes[0].lines if line.get_label() in "abc"]
    assert len({line.get_linewidth() for line in lines}) == 1, "no width reads as emphasis"
    assert len({line.get_color() for line in lines}) == len({line.get_marker() for line in lines}) == 3
