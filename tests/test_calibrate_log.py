"""The log of a fit: replayed for the same test and the same data only, whole after every kill, and never misread."""

import json
from dataclasses import replace

import numpy as np
import pytest
from calibrate_standin import StandIn, measured
from hypothesis import given, settings
from hypothesis import strategies as st

from axijax import LocalDamping, Params, Scene
from axijax.core.sector import Sector
from axijax.specimen.specimen import fcc_octagon
from axijax.triaxial.test import TriaxialTest
from calibrate.evaluate import Evaluator
from calibrate.fit import fit_parameters
from calibrate.log import FitLog
from calibrate.measured import MeasuredCurve
from calibrate.model import Model
from calibrate.targets import Datum, HardPeak

TRUTH = {"friction": 0.21, "normal_stiffness": 2.4e9, "shear_stiffness": 2.4e9}
DATA = MeasuredCurve([0.0005, 0.001, 0.0015], [1.5, 2.0, 2.2])


@pytest.fixture(scope="module")
def test():
    return TriaxialTest(fcc_octagon(layers=3, half_width=3), params=Params(platen_speed=0.05), axial_strain=0.002)


def refused(log, *arguments, **options) -> str:
    """The sentence with which a log is refused; nothing is run for it, and nothing of it is lost."""
    before = log.read_bytes()
    with pytest.raises(ValueError) as error:
        Evaluator(Model(*arguments, **options.pop("model", {})), options.pop("data", DATA), log)
    assert log.read_bytes() == before
    said = str(error.value)
    assert str(log) in said and "\n" not in said and "another --output" in said and said.endswith(".")
    return said


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("sector.boundary ('rigid' here, 'periodic' there)", lambda test: {"sector": Sector(4, "rigid")}),
        ("sector.order", lambda test: {"sector": Sector(2)}),
        ("scene.rotation (False here, True there)", lambda test: {"scene": Scene(rotation=False)}),
        (
            "params.material.damping (LocalDamping here, Dashpot there)",
            lambda test: {"params": replace(test.params, damping=LocalDamping(0.7))},
        ),
        ("specimen.positions", lambda test: {"specimen": fcc_octagon(layers=3, half_width=5)}),
        ("specimen.positions", lambda test: {"specimen": moved(test.specimen)}),  # as another seed's
        ("material.friction (0.3 here, 0.12278 there)", lambda test: {"params": replace(test.params, friction=0.3)}),
        ("params.material.damping.damping_ratio", lambda test: {"params": replace(test.params, damping_ratio=0.04)}),
        ("axial_strain", lambda test: {"axial_strain": 0.003}),
        ("time_step", lambda test: {"time_step": 0.01}),
        ("tolerance", lambda test: {"tolerance": 1e-5}),
        ("rebuild_every", lambda test: {"rebuild_every": 4}),
        ("confining_friction", lambda test: {"confining_friction": 0.1}),
    ],
)
def test_another_tests_log_is_refused_by_name(name, changed, test, tmp_path):
    log = tmp_path / "log.jsonl"
    Evaluator(Model(test, "f"), DATA, log)
    assert name in refused(log, replace(test, **changed(test)), "f")
    Evaluator(Model(replace(test), "f"), DATA, log)  # an equal test goes on


def moved(specimen):
    positions = specimen.positions.copy()
    positions[0, 0] = np.nextafter(positions[0, 0], 1e9)
    return replace(specimen, positions=positions)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("data.axial_strain", {"data": MeasuredCurve([0.0005, 0.001, 0.0016], DATA.stress_ratio)}),
        ("data.stress_ratio", {"data": MeasuredCurve(DATA.axial_strain, [1.5, 2.0, 2.3])}),
        ("data.volumetric_strain", {"data": replace(DATA, volumetric_strain=np.zeros(3))}),
        ("data.ratio_sigma (0.05 here, 0.02 there)", {"data": replace(DATA, ratio_sigma=0.05)}),
        ("data", {"data": Datum(HardPeak(), 2.4, 0.05)}),
        ("data", {"data": [DATA, Datum(HardPeak(), 2.4, 0.05)]}),
        ("fit.hold_time_step (False here, True there)", {"model": {"hold_time_step": False}}),
    ],
)
def test_another_fits_log_is_refused_by_name(name, options, tmp_path):
    log = tmp_path / "log.jsonl"
    Evaluator(Model(StandIn(), "rho"), DATA, log)
    assert name in refused(log, StandIn(), "rho", **options)
    assert "fit.names.1 ('friction' here, 'density' there)" in refused(log, StandIn(), "f")
    assert "noise (0.1 here, 0.0 there)" in refused(log, StandIn(noise=0.1), "rho")
    Evaluator(Model(StandIn(), "rho"), replace(DATA, source="another folder/data.csv"), log)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A finished fit and its log."""
    log = tmp_path_factory.mktemp("log") / "evaluations.jsonl"
    found = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", log=log)
    return found, log


def same_evaluations(found, again) -> bool:
    fields = ("coordinates", "prediction", "jacobian", "stretch", "failed", "largest_tangent")
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for one, other in zip(found.evaluations, again.evaluations, strict=True)
        for name in fields
    )


def test_a_log_gives_back_the_fit_to_the_last_bit(written, tmp_path):
    found, log = written
    (tmp_path / "log.jsonl").write_bytes(log.read_bytes())
    again = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", log=tmp_path / "log.jsonl")
    assert again.cost.runs == again.cost.passes == 0
    assert again.estimate == found.estimate and again.standard_error == found.standard_error
    assert same_evaluations(found, again)
    assert (tmp_path / "log.jsonl").read_bytes() == log.read_bytes()


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7, 0.999, "all but the last line's end"])
def test_a_line_cut_by_a_kill_is_dropped_and_run_again(share, written, tmp_path):
    found, log = written
    content, path = log.read_bytes(), tmp_path / "log.jsonl"
    path.write_bytes(content[:-1] if isinstance(share, str) else content[: int(share * len(content))])
    again = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", log=path)
    assert 0 < again.cost.runs + again.cost.passes < found.cost.runs + found.cost.passes
    assert same_evaluations(found, again)
    third = fit_parameters(StandIn(), measured(StandIn(), **TRUTH), "f,kn", log=path)  # what was added is whole
    assert third.cost.runs == third.cost.passes == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda lines: lines[0][:40], "no header that can be read"),  # cut in the header, as none is written
        (lambda lines: lines[0][:40] + b"\n" + b"\n".join(lines[1:]), "no header that can be read"),
        (lambda lines: b"\n".join(lines[1:]), "no header that can be read"),
        (lambda lines: b'{"kind": "header", "names": ["friction"]}\n', "of an earlier version"),
        (lambda lines: b"axial_strain,stress_ratio\n0,1\n", "no log of a fit"),
        (lambda lines: b"[" * 100_000 + b"\n", "no log of a fit"),
        (lambda lines: b"\xff\xfe\x00\n", "no log of a fit"),
        (lambda lines: b"\n".join([lines[0], lines[1][:-50], *lines[2:]]), "damaged in line 2"),
        (lambda lines: b"\n".join([lines[0], lines[1], b"{}", *lines[2:]]), "damaged in line 3"),
        (lambda lines: b"\n".join([lines[0], lines[1].replace(b"1", b"2", 1), *lines[2:]]), "damaged in line 2"),
        (lambda lines: b"\n".join([*lines[:2], lines[2] + lines[3], *lines[4:]]), "damaged in line 3"),
        (lambda lines: b"\n".join([*lines[:2], b"\xff" + lines[2], *lines[3:]]), "damaged in line 3"),
    ],
)
def test_damage_is_one_sentence(content, words, written, tmp_path):
    lines = written[1].read_bytes().split(b"\n")
    (tmp_path / "log.jsonl").write_bytes(content(lines))
    assert words in refused(tmp_path / "log.jsonl", StandIn(), "f,kn", data=measured(StandIn(), **TRUTH))


def test_a_folder_in_the_place_of_a_log(tmp_path):
    with pytest.raises(ValueError, match=r"cannot be read \(Is a directory\): name another file"):
        Evaluator(Model(StandIn(), "f"), DATA, tmp_path)


@settings(max_examples=300, deadline=None, database=None)
@given(
    where=st.floats(0, 1, exclude_max=True),
    length=st.sampled_from([0, 1, 7, 400]),
    inserted=st.one_of(st.binary(max_size=8), st.sampled_from([b"\n", b'"', b"}", b"9", b"NaN", b"\n\n", b"\x00"])),
)
def test_no_damage_is_taken_for_an_evaluation(where, length, inserted, written, tmp_path_factory):
    """Bytes lost, put in or exchanged anywhere: a sentence, or a log that holds only what was written into it."""
    content = written[1].read_bytes()
    identity = json.loads(content.split(b"\n")[0])["identity"]
    whole = FitLog(written[1], identity).known
    at = int(where * len(content))
    path = tmp_path_factory.mktemp("fuzz") / "log.jsonl"
    path.write_bytes(content[:at] + inserted + content[at + length :])
    try:
        known = FitLog(path, identity).known
    except ValueError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return
    assert all(entry == whole[place] for place, entry in known.items())


def test_lines_do_not_grow_with_the_data(tmp_path):
    """A data file of 50,000 rows; the log of 103 MB held every prediction and its derivatives."""
    sizes = []
    for count in (50, 50_000):
        log = tmp_path / f"{count}.jsonl"
        data = measured(StandIn(), np.linspace(2e-4, 0.0095, count), **TRUTH)
        evaluator = Evaluator(Model(StandIn(), "f,kn"), data, log)
        evaluator.value(evaluator.model.parameters.coordinates())
        evaluator.tangents(evaluator.model.parameters.coordinates(), (0, 1))
        sizes.append([len(line) for line in log.read_bytes().splitlines()])
    assert np.abs(np.subtract(*sizes)).max() < 100
    assert max(map(max, sizes)) < 101 * 3 * 3 * 25  # records, fields, curve and two tangents, digits
