"""Functionals of a laboratory's report: closed forms of made curves, tangents of a lattice against differences of the
same runs, one sentence for a curve that does not reach a number, and friction from stress-dilatancy."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from calibrate_standin import StandIn

from axijax import Params
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.test import TriaxialTest
from calibrate.facts import Facts
from calibrate.fit import fit_parameters
from calibrate.functionals import (
    E50,
    FrictionAngle,
    MaxDilatancy,
    StressDilatancy,
    VoidRatioAt,
    VolumeAt,
    rowe_constant,
)  # fmt: skip
from calibrate.measured import MeasuredCurve
from calibrate.model import Model
from calibrate.targets import Datum, HardPeak, RatioAt, SmoothPeak, WindowMean, trouble

STRAIN = jnp.linspace(0.0, 0.15, 1501)


def made(K=2.5, top=4.0, at=0.08, most=0.6, e0=0.7):
    """R is a parabola with its top at `at`; dilatancy -d eps_v/d eps one that is `most` there; R = K D besides in
    `along`, whose volume follows from R."""
    R = top - 400 * (STRAIN - at) ** 2
    x = STRAIN - at
    rate = most - 50 * x**2
    volume = -(most * x - 50 / 3 * x**3) + (-(most * -at - 50 / 3 * (-at) ** 3)) * -1
    along = -((top / K - 1) * x - 400 / K / 3 * x**3)
    return SimpleNamespace(
        axial_strain=STRAIN, stress_ratio=R, volumetric_strain=volume, along=along, rate=rate,
        void_ratio=(1 + e0) * (1 - volume) - 1,
    )  # fmt: skip


def of_rowe(K):
    curve = made(K)
    return SimpleNamespace(
        axial_strain=STRAIN, stress_ratio=curve.stress_ratio, volumetric_strain=curve.along - curve.along[0]
    )


def test_values_of_made_curves():
    curve = made()
    # A slope of least squares over a width w of 50/3 x^3 about zero is 50/3 w^2 3/20.
    assert float(MaxDilatancy(0.15)(curve)) == pytest.approx(0.6 - 2.5 * 0.01**2, rel=1e-4)
    assert float(MaxDilatancy(0.15, width=0.04)(curve)) == pytest.approx(0.6 - 2.5 * 0.04**2, rel=1e-3)
    assert float(StressDilatancy(0.03, 0.15)(of_rowe(2.5))) == pytest.approx(2.5, rel=1e-3)
    assert float(VolumeAt(0.1)(curve)) == pytest.approx(-(0.6 * 0.1 - 50 / 3 * (0.02**3 + 0.08**3)), rel=1e-6)
    assert float(VoidRatioAt(0.1)(curve)) == pytest.approx(1.7 * (1 - float(VolumeAt(0.1)(curve))) - 1)
    assert float(FrictionAngle()(curve)) == pytest.approx(np.degrees(np.arcsin(3 / 5)))
    late = 4 - 400 * np.mean((np.linspace(0.1, 0.15, 2001) - 0.08) ** 2)
    found = float(FrictionAngle(WindowMean(0.1, 0.15))(curve))
    assert found == pytest.approx(np.degrees(np.arcsin((late - 1) / (late + 1))), rel=1e-4)
    # R rises from 1.44 to 4: halfway from 1 to the peak at 2.5, where 400 x^2 = 1.5.
    assert float(E50()(curve)) == pytest.approx(1.5 / (0.08 - np.sqrt(1.5 / 400)), rel=1e-5)


def test_rowes_constant_of_measured_pairs():
    D = np.linspace(0.8, 2.0, 30)
    noise = 0.05 * np.random.default_rng(0).standard_normal((2000, 30))
    found = np.array([rowe_constant(3.0 * D + each, D) for each in noise])
    assert found[:, 0].mean() == pytest.approx(3.0, abs=1e-3)
    assert found[:, 1].mean() == pytest.approx(found[:, 0].std(), rel=0.05)
    for bad in ((D, -D), (D, D[:3]), (D[:1], D[:1]), (np.full(30, np.nan), D)):
        with pytest.raises(ValueError, match="must be"):
            rowe_constant(*bad)


NUMBERS = {
    "dilatancy": MaxDilatancy(0.0048, 0.001, width=0.0005),
    "K": StressDilatancy(0.001, 0.0045, width=0.0005),
    "volume": VolumeAt(0.003),
    "peak angle": FrictionAngle(),
    "smooth peak angle": FrictionAngle(SmoothPeak()),
    "late angle": FrictionAngle(WindowMean(0.003, 0.004)),
    "E50": E50(),
}


@pytest.fixture(scope="module")
def lattice():
    """A small lattice with its tangent along friction at f = 0.2, and runs at two steps to either side."""
    test = TriaxialTest(
        fcc_octagon(layers=5, half_width=5), params=Params(damping_ratio=0.2, platen_speed=0.02), axial_strain=0.0075,
        tolerance=1e-6, record_every=20,
    )  # fmt: skip
    model = Model(test, "f")
    z = model.parameters.coordinates({"f": 0.2})
    return model, *model.run_with_tangents(z), {h: [model.run(z + sign * h) for sign in (1, -1)] for h in (1e-3, 1e-4)}


@pytest.mark.parametrize("kind", NUMBERS)
def test_tangents_of_a_lattice_agree_with_differences(lattice, kind):
    functional = NUMBERS[kind]
    _, curve, tangents, runs = lattice
    assert trouble(functional, curve) is None
    fields = ("axial_strain", "stress_ratio", "volumetric_strain")
    primal = {name: jnp.asarray(getattr(curve, name)) for name in fields}
    push = {name: jnp.asarray(getattr(tangents, name)[0]) for name in fields}
    _, slope = jax.jvp(lambda held: functional(SimpleNamespace(**held)), (primal,), (push,))
    differences = [(float(functional(up)) - float(functional(down))) / (2 * h) for h, (up, down) in runs.items()]
    assert min(abs(float(slope) - one) for one in differences) < 1e-3 * abs(float(slope)), (slope, differences)


def test_friction_from_stress_dilatancy_of_a_lattice(lattice):
    """R against D of a run with a hidden f = 0.2 gives f = 0.2 again."""
    model, curve, _, _ = lattice
    rows = slice(1, None)
    measured = MeasuredCurve(curve.axial_strain[rows], curve.stress_ratio[rows], curve.volumetric_strain[rows])
    datum = Datum.measured(NUMBERS["K"], measured, 0.001)
    found = fit_parameters(model, datum, "friction", start={"friction": 0.1})
    assert found.converged and found.estimate["friction"] == pytest.approx(0.2, abs=5e-5)
    assert found.cost.forward_equivalents <= 8


def data(curve, rows=slice(None), **facts):
    return MeasuredCurve(
        np.asarray(curve.axial_strain)[rows], np.asarray(curve.stress_ratio)[rows],
        np.asarray(curve.volumetric_strain)[rows], facts=Facts(**facts), source="lab.csv",
    )  # fmt: skip


RISING, LATE = slice(0, 700), slice(100, None)
MISSED = {
    "a peak of data that rise": (HardPeak(), RISING, "still rises, and that is no peak"),
    "a smooth peak": (SmoothPeak(), RISING, "still rises"),
    "its angle": (FrictionAngle(), RISING, "largest stress ratio, 3.9"),
    "E50": (E50(), RISING, "still rises"),
    "E50 of what begins late": (E50(), slice(600, None), "above half of its rise"),
    "the angle at large strain": (FrictionAngle(WindowMean(0.05, 0.15)), RISING, "ends at strain 0.0699, before 0.15"),
    "a ratio": (RatioAt(0.15), RISING, "ends at strain 0.0699, before 0.15"),
    "dilatancy that grows": (MaxDilatancy(0.06), RISING, "still grows at strain 0.06"),
    "dilatancy beyond": (MaxDilatancy(0.15), RISING, "before 0.15"),
    "a volume beyond": (VolumeAt(0.15), RISING, "before 0.15"),
    "a volume before": (VolumeAt(0.001), LATE, "it begins at strain 0.01, after 0.001"),
    "K beyond": (StressDilatancy(0.05, 0.15), RISING, "before 0.15"),
    "K of the start": (StressDilatancy(0.0, 0.05), RISING, "R = K D holds of what shears"),
    "a void ratio without e0": (VoidRatioAt(0.05), RISING, "has no void ratio"),
}  # fmt: skip


@pytest.mark.parametrize("kind", MISSED)
def test_a_number_that_a_curve_does_not_reach_is_refused(kind):
    functional, rows, words = MISSED[kind]
    curve = made()
    if kind == "K of the start":
        curve.volumetric_strain = 1.5 * STRAIN
    with pytest.raises(ValueError, match=r"lab\.csv does not reach") as error:
        Datum.measured(functional, data(curve, rows), 0.1)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_numbers_of_measured_data_are_those_of_their_curve():
    curve = made()
    whole = data(curve, void_ratio=0.7)
    for functional in (HardPeak(), E50(), FrictionAngle(), MaxDilatancy(0.15), VolumeAt(0.1), VoidRatioAt(0.1)):
        datum = Datum.measured(functional, whole, 0.1)
        assert datum.value == pytest.approx(float(functional(curve)), rel=1e-9)
        assert datum.source == "lab.csv" and datum.label == functional.name
        assert datum.last_strain <= 0.15
    without = MeasuredCurve(whole.axial_strain, whole.stress_ratio)
    assert trouble(VolumeAt(0.1), without) == "it has no volumetric strain"


def test_a_fit_to_a_run_that_does_not_reach_it_is_not_converged():
    found = fit_parameters(StandIn(axial_strain=0.002), Datum(FrictionAngle(), 24.0, 0.5), "f", start="test")
    assert not found.converged and "does not reach 'friction angle of hard maximum of R'" in found.status


@pytest.mark.parametrize(
    "make, words",
    [
        (lambda: MaxDilatancy(0.05, width=0.06), "width = 0.06: must be positive and at most"),
        (lambda: StressDilatancy(0.05, 0.02), "at most stop - start"),
        (lambda: VolumeAt(5.0), "strain = 5.0"),
        (lambda: VoidRatioAt(-0.1), "strain = -0.1"),
        (lambda: E50("R"), "ratio = 'R'"),
        (lambda: StressDilatancy(0.0, 0.1, ratio="q"), "ratio = 'q'"),
    ],
)
def test_functionals_refuse(make, words):
    with pytest.raises(ValueError, match=words):
        make()
