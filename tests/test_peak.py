"""Whether the largest stress ratio of a curve is a peak, against curves whose peak is known by construction."""

import csv
import json

import numpy as np
import pytest
from cli_in_process import SMALL, axijax, write

from axijax.app.batch_files import open_batch
from axijax.triaxial.peak import find_peak, flat_top

STRAIN = np.linspace(0, 0.01, 201)
RISING = 1 + 2 * np.tanh(STRAIN / 0.004)


def humped(at, width=0.004):
    """A parabola on top of 2.5 with its peak at a strain."""
    return 2.5 - ((STRAIN - at) / width) ** 2


def test_a_hump_is_a_peak_with_its_place_and_height():
    peak = find_peak(STRAIN, humped(0.004))
    assert peak.reached and peak.record == 80 and peak.axial_strain == pytest.approx(0.004)
    assert peak.stress_ratio == pytest.approx(2.5) and str(peak) == "peak stress ratio 2.5000 at 0.400 % axial strain"


def test_the_end_of_a_rise_is_none():
    peak = find_peak(STRAIN, RISING)
    assert not peak.reached and peak.record == 200
    assert str(peak) == (
        f"largest stress ratio so far {RISING[-1]:.4f} at 1.000 % axial strain, at the last record: the curve still "
        "rises, no peak"
    )


def test_a_noisy_rise_has_no_peak_wherever_its_maximum_falls():
    """R rises by 0.02 over its last tenth, and single records scatter by 0.01."""
    smooth = 1 + 1.5 * STRAIN / 0.01 * (1 - 0.43 * STRAIN / 0.01)
    found = [find_peak(STRAIN, smooth + 0.01 * np.random.default_rng(seed).normal(size=201)) for seed in range(200)]
    assert {peak.reached for peak in found} == {False} and len({peak.record for peak in found}) > 5


@pytest.mark.parametrize("share", [0.2, 0.5, 0.85])
def test_a_noisy_hump_has_its_peak(share):
    ratio = humped(share * 0.01) + 0.01 * np.random.default_rng(1).normal(size=201)
    peak = find_peak(STRAIN, ratio)
    assert peak.reached and peak.axial_strain == pytest.approx(share * 0.01, abs=1.5e-3)


def test_a_steep_fall_close_to_the_end_is_a_peak_and_a_ripple_is_none():
    assert find_peak(STRAIN, humped(0.0095, width=0.002)).reached
    assert not find_peak(STRAIN, RISING + 0.003 * np.sin(STRAIN / 0.01 * 60 * np.pi)).reached


def test_a_curve_that_falls_from_its_start_has_none():
    peak = find_peak(STRAIN, 2 - RISING / 10)
    assert peak.record == 0 and "first record" in peak.doubt


def test_records_that_are_no_numbers_are_left_out():
    ratio = humped(0.004)
    ratio[190:] = np.nan
    assert find_peak(STRAIN, ratio)[:1] == (80,)
    rising = RISING.copy()
    rising[190:] = np.nan
    assert find_peak(STRAIN, rising).record == 189 and not find_peak(STRAIN, rising).reached
    assert not find_peak(STRAIN, np.full(201, np.nan)).reached


def test_a_flat_top_is_where_a_parabola_is_within_a_third_of_a_percent_of_its_peak():
    """2.5 - (e - 0.004)^2 / w^2 has fallen by 0.3 % at w sqrt(0.0075); between records of 5e-5 a chord is straight."""
    half = 0.004 * np.sqrt(0.003 * 2.5)
    assert flat_top(STRAIN, humped(0.004)) == pytest.approx((0.004 - half, 0.004 + half), abs=1e-6)
    ratio = humped(0.004)
    ratio[100] = 2.5 * 0.996  # a dip behind the top ends it, whatever comes after
    ratio[101:] = 2.499
    start, end = flat_top(STRAIN, ratio)
    assert start == pytest.approx(0.004 - half, abs=1e-6) and end < STRAIN[100]


def test_a_top_that_is_cut_off_has_an_open_side():
    start, end = flat_top(STRAIN, humped(0.0099))
    assert start == pytest.approx(0.0099 - 0.004 * np.sqrt(0.003 * 2.5), abs=1e-6) and np.isnan(end)
    assert np.isnan(flat_top(STRAIN, np.full(201, 2.0))).all() and np.isnan(flat_top([], [])).all()


def test_units_of_strain_do_not_matter():
    for ratio in (RISING, humped(0.004), humped(0.0095)):
        assert find_peak(STRAIN, ratio).doubt == find_peak(100 * STRAIN, ratio).doubt


def test_every_command_says_that_a_rising_curve_has_no_peak(tmp_path):
    """The small case stopped halfway up, and past its peak."""
    case = write(tmp_path / "short.toml", SMALL.replace("axial_strain = 0.012", "axial_strain = 0.003"))
    told = axijax("run", case, "--output", tmp_path / "out")
    assert told.code == 0 and "largest stress ratio so far" in told.out and "still rises, no peak" in told.out
    assert axijax("report", tmp_path / "out").code == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "so far [-], at the last record: the curve still rises, no peak" in page
    assert "peak stress ratio s1/s3" not in page and "at the peak" not in page

    sweep = write(tmp_path / "sweep.toml", SMALL + "[sweep]\ntest.axial_strain = [0.003, 0.012]\n")
    told = axijax("batch", sweep, "--output", tmp_path / "batch", "--workers", 1)
    short, whole = sorted(line for line in told.out.splitlines() if line.startswith("test.axial"))
    assert "largest so far" in short and "at the last record: the curve" in short
    assert ": peak 2.87" in whole and "no peak" not in whole
    with open(tmp_path / "batch" / "summary.csv") as file:
        assert [row["peak_reached"] for row in csv.DictReader(file)] == ["False", "True"]
    assert list(open_batch(tmp_path / "batch").peak_reached.values) == [False, True]


def test_json_lines_say_so_too(tmp_path):
    case = write(tmp_path / "short.toml", SMALL.replace("axial_strain = 0.012", "axial_strain = 0.003"))
    last = json.loads(axijax("run", case, "--output", tmp_path / "out", "--json").out.splitlines()[-1])
    assert last["peak_reached"] is False and "no peak" in last["warning"]
