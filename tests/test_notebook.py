"""How objects show themselves at a prompt and in a notebook, progress bars, and data sets as xarray draws them."""

import io
import json
import sys
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import jax
import matplotlib
import numpy as np
import pytest
from rich.console import Console
from small_result import CASE

import axijax
from axijax.app.batch import BatchResult, Member, Outcome
from axijax.app.batch_files import natural, open_batch, write_summary
from axijax.app.results import open_result, open_results
from axijax.core.bars import Pace, bar, counting, duration, telling
from axijax.core.shown import WIDE, line_picture
from axijax.triaxial.progress import Run
from axijax.triaxial.watch import strain_of, watched
from calibrate import MeasuredCurve

pytest_plugins = ["small_result"]


@pytest.fixture(scope="module")
def run(result):
    now = result.progress
    return Run(axijax.triaxial.progress.curve_of(now, CASE["test"]["axial_strain"]), *now.lists, now.state)


def svg(html: str) -> ElementTree.Element:
    return ElementTree.fromstring(html[html.index("<svg") : html.index("</svg>") + 6])


def test_reprs_are_one_line(result, run):
    progress = result.progress
    measured = MeasuredCurve(np.array([0.001, 0.002]), np.array([2.0, 3.0]), source="lab.csv")
    batch = BatchResult((Outcome(Member("one", result.test), run.curve, None, 1.0),))
    shown = [
        run, run.curve, run.network, run.membrane, run.state, result.test, result.test.specimen, result.test.prepared,
        progress, progress.records, measured, batch, result,
    ]  # fmt: skip
    for each in shown:
        text = repr(each)
        assert len(text) <= WIDE and "\n" not in text and "Array(" not in text and "array(" not in text, text
        html = each._repr_html_()
        assert len(html) < 40_000
        ElementTree.fromstring(html)  # closed tags


def test_html_holds_the_numbers(result, run):
    curve = result.curve
    for shown in (run, run.curve, result):
        html = shown._repr_html_()
        assert f"{float(curve.stress_ratio.max()):.4f}" in html
        line = next(each for each in svg(html).iter() if each.tag.endswith("polyline"))
        points = np.array([pair.split(",") for pair in line.get("points").split()], float)
        # The picture is the curve: places on both axes are linear in strain and stress ratio.
        strain, ratio = curve.axial_strain.values, curve.stress_ratio.values
        across = (points[:, 0] - points[0, 0]) / np.ptp(points[:, 0])
        np.testing.assert_allclose(across, (strain - strain[0]) / np.ptp(strain), atol=1e-3)
        up = np.ptp(points[:, 1]) * (ratio - ratio[0]) / np.ptp(ratio)
        np.testing.assert_allclose(up, points[0, 1] - points[:, 1], atol=0.1)
    specimen = result.test.specimen
    circles = [each for each in svg(specimen._repr_html_()).iter() if each.tag.endswith("circle")]
    assert len(circles) == (np.abs(specimen.positions[1]) <= specimen.radius * (1 + 1e-9)).sum()
    assert f"<td style=\"text-align:left\">{len(specimen)}</td>" in specimen._repr_html_()


def test_what_is_traced_batched_or_empty_shows_itself_too(run):
    texts = []
    jax.jit(lambda curve: texts.append(repr(curve) + repr(curve.confinement)))(run.curve)
    batched = jax.tree.map(lambda values: np.stack([values, values]), run.curve)
    for text in (*texts, repr(batched), repr(jax.tree.map(lambda _: None, run.curve))):
        assert text.startswith("Curve(records of a batch")
    assert line_picture([0.0], [1.0], "x", "y") == "" and line_picture([0, 1], [1, 1], "x", "y") == ""


def test_strain_is_the_coordinate_of_every_data_set(result, folder):
    curve = result.curve
    assert curve.stress_ratio.dims == ("axial_strain",)
    matplotlib.use("Agg")
    (line,) = curve.stress_ratio.plot()
    np.testing.assert_array_equal(line.get_xdata(), curve.axial_strain.values)
    assert "axial strain" in line.axes.get_xlabel()
    matplotlib.pyplot.close("all")
    at = float(curve.axial_strain[3])
    assert float(curve.stress_ratio.sel(axial_strain=at)) == float(curve.stress_ratio[3])
    stopped = folder.with_name("stopped")  # the same from a checkpoint, without a curve
    stopped.mkdir()
    for name in ("case.toml", "checkpoint.npz"):
        (stopped / name).write_bytes((folder / name).read_bytes())
    assert open_result(stopped).curve.stress_ratio.equals(curve.stress_ratio)
    assert [one.curve.stress_ratio.dims for one in open_results(folder / "curve.nc")] == [("axial_strain",)]


def test_members_are_sorted_by_number(result, run, tmp_path):
    from axijax.app.batch_files import Stored, open_folder, write_member

    numbers = [10, 9, 100, 1]
    folder = open_folder(tmp_path)
    for number in numbers:
        labels = {"specimen.seed": number}
        name = f"specimen.seed={number}"
        write_member(folder, Stored(name, result.test, result.test.params, labels, run.curve))
    data = open_batch(folder)
    assert list(data["specimen.seed"].values) == [1, 9, 10, 100]
    assert "axial_strain" in data.coords and data.axial_strain.dims == ("member", "record")
    lines = data.stress_ratio.plot.line(x="axial_strain", hue="member")
    assert len(lines) == 4
    matplotlib.pyplot.close("all")
    write_summary(folder)
    rows = (folder / "summary.csv").read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == [f"specimen.seed={n}" for n in (1, 9, 10, 100)]
    wanted = ["f=0.10", "f=0.9", "kn=2e8 a", "kn=1e9 b"]
    assert sorted(reversed(wanted), key=natural) == wanted


# Progress bars.


def terminal(width=80):
    return Console(file=io.StringIO(), force_terminal=True, width=width, legacy_windows=False)


@pytest.mark.parametrize("width", [60, 80, 200])
def test_a_bar_is_one_line_and_gone_at_the_end(width):
    console = terminal(width)
    with bar(console) as show:
        show("confining")
        show("shearing  0.331 of 1 %  s1/s3 2.410", 0.331, 12.0)
        console.file.truncate(0)
        console.file.seek(0)
        show("shearing  0.500 of 1 %  s1/s3 2.500", 0.5, 75.0)
        import time

        time.sleep(0.3)
    text = console.file.getvalue()
    assert "0.500 of 1 %" in text and "50 %" in text and "1:15 left" in text
    assert text.endswith("\x1b[2K") or "\x1b[2K" in text, "wiped out"


def test_a_bar_is_silent_in_a_pipe():
    console = Console(file=io.StringIO(), force_terminal=False, width=80)
    with bar(console) as show:
        show("shearing", 0.5, 1.0)
    assert console.file.getvalue() == ""


def test_time_left_is_what_is_left_at_the_pace_so_far(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("axijax.core.bars.time", SimpleNamespace(perf_counter=lambda: now[0]))
    pace = Pace()
    for when, share, steps in ((0.0, 0.0, 0), (50.0, 0.1, 1000), (51.0, 0.2, 2000), (52.0, 0.3, 3000)):
        now[0] = when
        pace.mark(share, steps)
    assert pace.left == pytest.approx(7.0) and pace.rate == pytest.approx(1000), "the first stretch compiles"
    assert (duration(7), duration(3599.6), duration(7325)) == ("0:07", "1:00:00", "2:02:05")


def test_progress_may_be_a_function_true_or_nothing(result):
    seen = []
    for given in (seen.append, True, False, None):
        with watched(result.test, given) as tell:
            tell(result.progress)
    assert seen == [result.progress]
    counts, words = [], []
    for given in (lambda *all: counts.append(all), True, False):
        with counting(given) as tell:
            tell(3, 60, "run")
    for given in (words.append, True, False):
        with telling(given) as tell:
            tell("packing")
    assert counts == [(3, 60, "run")] and words == ["packing"]


def test_strain_so_far_is_said_of_the_strain_asked_and_never_more(result):
    assert strain_of(result.test, result.progress) == "0.200 of 0.2 %"
    longer = replace(result.test, axial_strain=0.004)
    assert strain_of(longer, result.progress) == f"{100 * result.progress.strain:.3f} of 0.4 %"


def test_a_run_ends_with_the_first_record_at_its_strain(result, folder):
    """A record is so many steps, of which each brings both platens nearer by speed times step."""
    test, now = result.test, result.progress
    record = 2 * float(test.params.platen_speed) * test.prepared.time_step * test.record_every / now.height
    assert test.axial_strain <= now.strain < test.axial_strain + record * (1 + 1e-9)
    assert json.loads((folder / "run.json").read_text())["axial_strain"] == now.strain


def test_stops_are_kept_and_change_nothing(result):
    test, strains = result.test, []
    stops = (0.0005, 0.001, 0.0015)
    run = test.run(progress=lambda now: strains.append(now.strain), stops=stops)
    for stop in stops:
        assert min(strain - stop for strain in strains if strain >= stop) < 2e-4, "at the first record there"
    np.testing.assert_array_equal(run.curve.stress_ratio, result.curve.stress_ratio)
    assert sys.getsizeof(repr(run)) < 500
