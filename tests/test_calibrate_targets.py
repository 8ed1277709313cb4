"""Targets against curves whose peak, slope and strain are known, and every sentence for data that cannot be used."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.measured import ROWE, DataError, MeasuredCurve, read_measured
from calibrate.targets import Datum, HardPeak, InitialSlope, RatioAt, SmoothPeak, StrainAtPeak, WindowMean

STRAIN = jnp.linspace(0.0, 0.01, 401)


def parabola(peak=2.5, at=0.004, curvature=2e5, strain=STRAIN):
    return SimpleNamespace(axial_strain=strain, stress_ratio=peak - curvature * (strain - at) ** 2)


def test_values_on_a_parabola():
    curve = parabola()
    assert HardPeak()(curve) == pytest.approx(2.5)
    assert WindowMean(0.003, 0.005)(curve) == pytest.approx(2.5 - 2e5 * 0.001**2 / 3, rel=1e-4)
    assert RatioAt(0.002)(curve) == pytest.approx(2.5 - 0.8)
    assert InitialSlope(0.001, 0.002)(curve) == pytest.approx(2 * 2e5 * 0.0025, rel=1e-3)
    # A Gaussian weight of variance t/(2c): mean strain at the top, mean R half a temperature below it.
    assert StrainAtPeak(0.01)(curve) == pytest.approx(0.004, rel=1e-6)
    assert SmoothPeak(0.01)(curve) == pytest.approx(2.495, rel=1e-5)
    assert SmoothPeak(1e-4)(curve) == pytest.approx(2.5, abs=1e-4)


@pytest.mark.parametrize(
    "functional, slope",
    [
        (HardPeak(), (1.0, 0.0)),
        (WindowMean(0.003, 0.005), (1.0, 0.0)),
        (SmoothPeak(), (1.0, 0.0)),
        (RatioAt(0.002), (1.0, -800.0)),
        (StrainAtPeak(), (0.0, 1.0)),
        (InitialSlope(0.001, 0.002), (0.0, 4e5)),
    ],
)
def test_derivatives_to_peak_and_to_its_strain(functional, slope):
    exact = jax.grad(lambda p, e: functional(parabola(p, e)), argnums=(0, 1))(2.5, 0.004)
    for found, wanted in zip(exact, slope, strict=True):
        assert float(found) == pytest.approx(wanted, rel=1e-3, abs=2e-3 * max(1.0, abs(slope[1])))


def test_window_beyond_the_run_is_nan_not_a_guess():
    assert np.isnan(WindowMean(0.008, 0.012)(parabola()))
    assert np.isnan(RatioAt(0.02)(parabola()))


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: HardPeak("stress"), "ratio = 'stress'"),
        (lambda: WindowMean(0.25, 0.5), "0.4 % is 0.004"),
        (lambda: WindowMean(0.005, 0.003), "start must be below stop"),
        (lambda: SmoothPeak(0.0), "temperature = 0.0"),
        (lambda: RatioAt(-0.1), "strain = -0.1"),
        (lambda: Datum(HardPeak(), 2.4, 0.0), "uncertainty = 0.0"),
        (lambda: Datum(HardPeak(), float("nan"), 0.1), "value = nan"),
    ],
)
def test_functionals_refuse(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_rowe():
    assert pytest.approx(0.12278, abs=1e-5) == ROWE.friction
    assert "Rowe 1962" in ROWE.source
    assert ROWE.datum().value == 2.4
    assert ROWE.datum().uncertainty == 0.05


def write(tmp_path, text):
    path = tmp_path / "data.csv"
    path.write_text(text)
    return path


def test_csv_reads_comments_units_names_and_separators(tmp_path):
    text = "# a test\nAxial_Strain [%];stress_ratio;Volume (%)\n0.0;1.0;0\n# pause\n0.1;1.5;0.01\n0.2;2.0;-0.02\n"
    curve = read_measured(write(tmp_path, text), {"volumetric_strain": "volume"})
    assert curve.axial_strain == pytest.approx([0, 0.001, 0.002])
    assert curve.volumetric_strain == pytest.approx([0, 1e-4, -2e-4])
    assert len(curve.observed) == len(curve.sigma) == 6
    named = {"axial_strain": "strain [%]", "stress_ratio": "r"}
    percent = read_measured(write(tmp_path, "strain,r\n0,1\n0.1,2\n"), named)
    assert percent.axial_strain[1] == pytest.approx(0.001)


def test_csv_makes_the_ratio_from_stresses_and_turns_signs(tmp_path):
    path = write(tmp_path, "axial_strain,axial_stress,confining_stress\n-0.001,-100,-50\n-0.002,-150,-50\n")
    turned = {name: "(tension positive)" for name in ("axial_strain", "axial_stress", "confining_stress")}
    curve = read_measured(path, turned)
    assert curve.stress_ratio == pytest.approx([2, 3])
    assert curve.axial_strain == pytest.approx([0.001, 0.002])
    with pytest.raises(DataError, match="tension-positive"):
        read_measured(path)


@pytest.mark.parametrize(
    "text, words",
    [
        ("axial_strain,stress_ratio\n0,1\n0.002,2\n0.001,1.5\n", "falls back to 0.001 after 0.002 in data row 3"),
        ("axial_strain,stress_ratio\n0,1\n0.001,2\n0.001,1.5\n", "repeats 0.001"),
        ("axial_strain,q\n0,1\n0.002,2\n", "no column 'stress_ratio'; it has axial_strain, q"),
        ("axial_strain,stress_ratio\n-0.001,1.2\n-0.002,2\n", "tension-positive"),
        ("axial_strain,stress_ratio\n0,1\n0.001,nan\n", "stress_ratio = nan in data row 2"),
        ("axial_strain,stress_ratio\n0,1\n0.001,\n", "stress_ratio = '' in data row 2"),
        ("axial_strain,stress_ratio\n0,1\n0.001\n", "data row 2 has 1 cells"),
        ("axial_strain,stress_ratio\n0,1\n", "at least two points"),
        ("axial_strain,stress_ratio\n", "must have a header and at least one row"),
        ("0,1\n0.001,2\n", "must name the columns"),
        ("axial_strain,stress_ratio\n0,1\n0.9,2\n", "percent"),
        ("axial_strain,stress_ratio\n0,1\n0.001,-2\n", "stress_ratio = -2 in data row 2"),
        ("axial_strain [%],stress_ratio\n0,1\n0.1,2\n", "is marked '%', but columns say '-'"),
    ],
)
def test_bad_files_get_a_sentence(tmp_path, text, words):
    columns = {"axial_strain": "[-]"} if "[%]" in text else {}
    with pytest.raises(DataError, match=words.replace("[", r"\[")):
        read_measured(write(tmp_path, text), columns)


def test_missing_file_and_a_peak_at_the_last_point(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_measured(tmp_path / "none.csv")
    with pytest.raises(DataError, match="at the last point"):
        MeasuredCurve([0, 0.001, 0.002], [1, 1.5, 2]).peak()
    assert MeasuredCurve([0, 0.001, 0.002], [1, 2, 1.8]).peak() == (2.0, 0.001)


def test_prediction_is_interpolated_and_nan_beyond_the_run():
    curve = MeasuredCurve([0.001, 0.0025, 0.02], [1.0, 1.5, 1.4])
    found = np.asarray(curve.predict(parabola()))
    assert found[:2] == pytest.approx([2.5 - 2e5 * 0.003**2, 2.5 - 2e5 * 0.0015**2], rel=1e-9)
    assert np.isnan(found[2])
