"""Soil mechanics of a curve: closed forms, the records of a small run, a laboratory's summary, and the pictures."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgba

from axijax import Params, theory
from axijax.app import plot
from axijax.app.labels import COLOURS
from axijax.app.report import report_page
from axijax.app.results import curves_dataset
from axijax.app.soil_figures import KINDS
from axijax.triaxial.laboratory import laboratory
from axijax.triaxial.progress import Run, curve_of
from axijax.triaxial.records import DERIVED, QUANTITIES, RECORDS, Confinement, Curve, quantities_of

pytest_plugins = ["small_result"]


# Closed forms.


def test_angles_have_the_values_of_textbooks():
    """R = 3 is 30 degrees (Rankine); the angle of the FCC array's R = 2(1 + f)/(1 - f) is asin((1 + 3f)/(3 + f)); its
    dilatancy D = 2 is an angle of asin(1/3)."""
    assert theory.friction_angle(3.0) == pytest.approx(np.pi / 6) and theory.friction_angle(1.0) == 0
    for friction in (0.0, 0.12278, 0.3, 0.9):
        angle = theory.friction_angle(theory.fcc_stress_ratio(friction))
        assert jnp.sin(angle) == pytest.approx((1 + 3 * friction) / (3 + friction), rel=1e-14)
        assert theory.stress_ratio_of(angle) == pytest.approx(theory.fcc_stress_ratio(friction), rel=1e-13)
    assert theory.friction_angle(0.5) == pytest.approx(-float(theory.friction_angle(2.0)))
    rate = theory.dilatancy(theory.TAN_ANGLE_FCC) - 1
    assert rate == 1 and jnp.sin(theory.dilatancy_angle(rate)) == pytest.approx(1 / 3)
    assert theory.dilatancy_angle(0.0) == 0 and theory.dilatancy_angle(-0.5) < 0


def test_dilatancy_angle_is_that_of_the_strain_rates():
    """At a planar tip of s1 and s3 alone, -(de_1 + 2 de_3)/(de_1 - 2 de_3): where both radial directions give way as
    one, psi is that of plane strain with their sum (Vermeer & de Borst 1984)."""
    for rate in (-0.4, 0.0, 0.6, 1.0):
        radial = (-rate - 1) / 2  # of de_1 = 1: de_v = -rate
        assert jnp.sin(theory.dilatancy_angle(rate)) == pytest.approx(-(1 + 2 * radial) / (1 - 2 * radial))


def test_rowes_line_holds_for_the_array_of_its_own_angle():
    """Contacts at beta = 45 degrees - phi/2 above the horizontal have R = K D with K = tan^2(45 degrees + phi/2)."""
    for friction in (0.1, 0.3, 0.6):
        angle = float(np.arctan(friction))
        tangent = float(np.tan(np.pi / 4 + angle / 2))
        ratio = theory.inclined_contact_stress_ratio(tangent, friction)
        assert ratio == pytest.approx(float(theory.rowe_stress_ratio(angle, theory.dilatancy(tangent) - 1)), rel=1e-12)


@pytest.mark.parametrize("call", [
    lambda: theory.friction_angle(-0.1), lambda: theory.stress_ratio_of(1.6), lambda: theory.dilatancy_angle(-1.0),
    lambda: theory.mohr_envelope([1.0, 1.0], [1.0, 2.0]),
])  # fmt: skip
def test_arguments_out_of_range_are_refused(call):
    with pytest.raises(ValueError, match=r"needs|envelope"):
        call()


def test_envelope_touches_its_circles():
    """Circles made from a line: the distance of each middle from it is the circle's radius."""
    angle, cohesion = np.deg2rad(35), 12.0
    middle = np.array([80.0, 150.0, 420.0])
    radius = middle * np.sin(angle) + cohesion * np.cos(angle)
    found = theory.mohr_envelope(middle + radius, middle - radius)
    assert found == pytest.approx((angle, cohesion))
    distance = np.abs(np.tan(found.angle) * middle + found.cohesion) * np.cos(found.angle)
    np.testing.assert_allclose(distance, radius, rtol=1e-12)
    alone = theory.mohr_envelope(300.0, 100.0)
    assert alone.cohesion == 0 and alone.angle == pytest.approx(float(theory.friction_angle(3.0)))
    alike = theory.mohr_envelope([300.0, 320.0], [100.0, 100.0])
    assert alike.cohesion == 0 and theory.friction_angle(3.0) < alike.angle < theory.friction_angle(3.2)


# Records.


def test_every_quantity_is_declared_once_and_written(result, folder):
    curve = result.curve
    assert set(QUANTITIES) == set(RECORDS) | set(DERIVED) and not set(RECORDS) & set(DERIVED)
    held = quantities_of(curve)
    assert "path_length" not in held and set(DERIVED) < set(held)
    for name, about in held.items():
        assert curve[name].attrs == {"long_name": about.long_name, "units": about.unit}
    heads = (folder / "curve.csv").read_text().splitlines()[1].split(",")
    assert heads == [f"{name} [{about.unit.replace('1', '-')}]" for name, about in held.items()]
    page = report_page([result])
    assert all(f"<td>{name}</td>" in page for name in held)


def test_stresses_are_those_of_the_forces(result, moment):
    """s1 from the last state's platen forces and membrane radius; s3 from the case; p and q by their definitions."""
    records = result.progress.records
    np.testing.assert_array_equal(records.lateral_stress, 5e4)
    section = np.pi * records.membrane_radius**2
    mean = (records.bottom_force + records.top_force) / 2
    np.testing.assert_allclose(mean / section, records.stress_ratio * 5e4, rtol=1e-3)  # the section is the cells'
    whole = result.test.sector.order
    curve = result.curve
    s1, s3 = curve.axial_stress.values, curve.lateral_stress.values
    np.testing.assert_allclose(s1, curve.stress_ratio.values * 5e4, rtol=1e-14)
    np.testing.assert_allclose(3 * curve.mean_stress.values, s1 + 2 * s3, rtol=1e-14)
    np.testing.assert_allclose(curve.deviatoric_stress.values, s1 - s3, rtol=1e-14, atol=1e-9)
    sine = (s1 - s3) / (s1 + s3)
    np.testing.assert_allclose(np.sin(np.deg2rad(curve.friction_angle.values)), sine, rtol=1e-12, atol=1e-15)
    assert moment.platens.forces.mean() == pytest.approx(mean[-1] * len(set(moment.balls.image)) / whole, rel=0.05)
    rate, angle = curve.dilatancy_rate.values, np.deg2rad(curve.dilatancy_angle.values)
    sound = rate > -1  # contracts faster than it is shortened: no angle
    np.testing.assert_allclose(np.sin(angle[sound]), (rate / (2 + rate))[sound], rtol=1e-12)
    assert np.isnan(angle[~sound]).all() and sound[-20:].all()


def made(strain, ratio, volume, s3=1e5, voids=0.7):
    """A curve of these values."""
    one = np.ones_like(strain)
    others = {name: one for name, about in RECORDS.items() if not about.of}
    given = {"axial_strain": strain, "stress_ratio": ratio, "volumetric_strain": volume, "lateral_stress": s3 * one}
    zero = np.zeros(())
    given["void_ratio"] = voids * one + 0.5 * strain
    return Curve(**others | given, confinement=Confinement(zero, zero, zero), status=zero)


def test_a_laboratorys_summary_of_a_curve_that_is_known():
    """R rises along a quadratic to 4 at 5 % and falls along it to the end; the volume along another."""
    strain = np.linspace(0, 0.12, 401)
    ratio = 4 - 3 * ((strain - 0.05) / 0.05) ** 2 * np.where(strain > 0.05, 0.15, 1)
    found = laboratory(made(strain, ratio, 0.1 * strain - 4 * strain**2, voids=np.nan))
    assert found.peak.reached and found.peak.stress_ratio == pytest.approx(4, abs=1e-3)
    assert found.peak.axial_strain == pytest.approx(0.05, abs=2e-4)
    assert found.friction_angle.value == pytest.approx(np.rad2deg(np.arcsin(0.6)), abs=0.01)
    assert found.dilatancy == pytest.approx(-0.1 + 8 * found.peak.axial_strain, rel=1e-6)
    assert found.volumetric_strain == pytest.approx(0.012 - 4 * 0.0144)
    assert found.large_strain == pytest.approx(0.108)
    assert found.large_strain_angle.value == pytest.approx(
        float(np.rad2deg(theory.friction_angle(4 - 0.45 * (0.058 / 0.05) ** 2))), abs=0.02
    )
    # q = 1.5e5 is half of 3e5: (1 - eps/0.05)^2 = 1/2.
    assert found.secant_modulus == pytest.approx(1.5e5 / (0.05 * (1 - 0.5**0.5)), rel=1e-3)
    assert np.isnan(found.void_ratio) and found.values()["void_ratio"] is None
    random = laboratory(made(strain, ratio, 0.1 * strain - 4 * strain**2))
    assert (random.void_ratio_start, random.void_ratio) == pytest.approx((0.7, 0.76))
    assert json.loads(json.dumps(random.values()))["peak_reached"] is True
    rows = random.rows(asked=0.1234)
    assert rows["void ratio, start and end [-]"] == "0.7000, 0.7600"
    assert rows["axial strain reached [%]"] == "12, the last record before 12.34"
    assert "peak stress ratio s1/s3 [-]" in rows and "+-" in rows["peak stress ratio s1/s3 [-]"]


def test_a_summary_says_what_the_test_does_not_show():
    strain = np.linspace(0, 0.01, 101)
    rising = laboratory(made(strain, 1 + 100 * strain, 0.1 * strain))
    rows = rising.rows()
    assert not rising.peak.reached and np.isnan(rising.large_strain)
    assert any("largest stress ratio" in name and "no peak" in name for name in rows)
    assert not any("at the peak" in name or "large-strain" in name for name in rows)
    assert rows["axial strain reached [%]"] == "1"


# Pictures.


@pytest.fixture(scope="module")
def several(result):
    """Three results that differ by their confining stress alone, and one of another friction, of known curves."""
    strain = np.linspace(0, 0.1, 201)
    results = []
    for number, (s3, top, friction) in enumerate([(1e5, 3.0, 0.3), (2e5, 3.0, 0.3), (4e5, 3.0, 0.3), (1e5, 4.0, 0.5)]):
        curve = made(strain, top - (top - 1) * ((strain - 0.05) / 0.05) ** 2, 0.1 * strain - 4 * strain**2, s3)
        parameters = result.case.parameters.model_copy(update={"friction": friction, "confining_stress": s3})
        one = replace(result, name=f"test {number}", curve=curves_dataset({"a": curve}, {}, {}).isel(run=0, drop=True))
        one.__dict__["case"] = result.case.model_copy(update={"parameters": parameters})
        results.append(one)
    return results


def lines_of(figure, number=0):
    return {line.get_label(): line.get_xydata() for line in figure.axes[number].lines}


def test_mohrs_circles_have_one_envelope_for_one_material(several):
    lines = lines_of(KINDS["mohr"](several))
    envelopes = {name: points for name, points in lines.items() if name.startswith("envelope")}
    first, second = envelopes
    assert first.startswith("envelope, phi = 30.0°") and second == "envelope, phi = 36.9°"
    (_, low), (far, high) = envelopes[second]
    assert low == 0 and np.rad2deg(np.arctan(high / far)) == pytest.approx(36.87, abs=0.01)
    circles = [points for name, points in lines.items() if "friction" in name]
    assert len(circles) == 4
    for points, (s3, ratio) in zip(circles, [(1e5, 3), (2e5, 3), (4e5, 3), (1e5, 4)], strict=True):
        s1 = points[:, 0].max()
        assert s1 == pytest.approx(ratio * s3, rel=1e-3) and points[:, 0].min() == pytest.approx(s3)
        distance = np.hypot(points[:, 0] - (s1 + s3) / 2, points[:, 1])
        np.testing.assert_allclose(distance, (s1 - s3) / 2, rtol=1e-9)


def test_rowes_line_and_the_curve_are_where_they_belong(several):
    figure = KINDS["stress-dilatancy"](several[:1])
    lines = lines_of(figure)
    (rowe,) = (points for name, points in lines.items() if name == "Rowe, FCC array, f = 0.3")
    assert rowe[1, 1] / rowe[1, 0] == pytest.approx(1.3 / 0.7)  # R = 2 (1 + f)/(1 - f) at D = 2
    curve = lines["test 0"]
    np.testing.assert_allclose(curve[:, 0], 1 - 0.1 + 8 * several[0].curve.axial_strain, atol=1e-6)


@pytest.mark.parametrize("kind", ["q-eps", "stress-dilatancy", "mohr"])
def test_many_results_of_one_differing_number_share_a_scale(several, kind):
    """Seven frictions: a colour of the scale for each test and for what is drawn with it, none with a name."""
    results, frictions = [], [0.1 + 0.05 * k for k in range(7)]
    for friction in frictions:
        one = replace(several[0])
        parameters = several[0].case.parameters.model_copy(update={"friction": friction})
        one.__dict__["case"] = several[0].case.model_copy(update={"parameters": parameters})
        results.append(one)
    figure = KINDS[kind](results, None)
    axes, bar = figure.axes
    assert bar.get_ylabel() == "friction"
    wanted = [tuple(colormaps["viridis"](k / 6)) for k in range(7)]
    drawn = [to_rgba(line.get_color()) for line in axes.lines if len(line.get_xdata())]
    for colour in wanted:
        assert any(np.allclose(colour, each, atol=0.01) for each in drawn)
    told = [text.get_text() for text in figure.legends[0].get_texts()] if figure.legends else []
    assert len(told) < 3 and not any("friction" in name and "0." in name for name in told)


def test_pictures_are_readable(several, result, tmp_path):
    """Letters of 9 points and more, units at every axis, colours of the palette, a legend that covers no axes."""
    for kind, draw in KINDS.items():
        figure = draw(several, None)
        figure.draw_without_rendering()
        for axes in figure.axes:
            texts = [axes.xaxis.label, axes.yaxis.label, *axes.get_xticklabels(), *axes.get_yticklabels()]
            assert all(text.get_fontsize() >= 9 for text in texts), kind
            assert "[" in axes.get_ylabel() and ("[" in axes.get_xlabel() or axes is figure.axes[0])
        (legend,) = figure.legends
        assert all(text.get_fontsize() >= 9 for text in legend.get_texts())
        box = legend.get_window_extent()
        assert not any(box.overlaps(axes.get_window_extent()) for axes in figure.axes), kind
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width, kind
        named = {to_hex(line.get_color()).upper() for line in figure.axes[0].lines if "friction" in line.get_label()}
        assert named <= set(COLOURS)
    two = list(KINDS)[:2]  # the others are drawn above; here they are written
    assert [path.stem for path in plot.plot_result(several, two, tmp_path)] == two
    with pytest.raises(ValueError, match="no void ratio to draw"):
        plot.plot_result([result], ["e-log-p"], tmp_path / "lattice")


def test_a_deformed_specimen_without_friction_is_drawn(result):
    progress = result.progress
    run = Run(curve_of(progress, 1.0), progress.network, progress.membrane, progress.state)
    smooth = replace(result.test, params=Params(friction=None))
    assert "without friction" in plot.deformed_figure(smooth, run).get_suptitle()
    assert "f = 0.12278" in plot.deformed_figure(result.test, run).get_suptitle()
