"""Case files: what is read and written, what the defaults are, and what is refused."""

import re
import tomllib
import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from cli_in_process import axijax

from axijax import Hertz, LocalDamping, Params, Rolling, Scene, Sector, Torsion, TriaxialTest, fcc_octagon
from axijax.app import case
from axijax.app.case import GIVEN, KINDS, SECTIONS, Case, default_case, load_case
from axijax.app.case_parts import DAMPINGS, MATERIALS
from axijax.app.case_writing import to_toml
from axijax.core.quantity import declared, optional_parts, settings, values_of
from axijax.specimen.grading import sieve_curve


def write(tmp_path, text):
    path = tmp_path / "case.toml"
    path.write_text(text)
    return path


def test_an_empty_case_is_the_papers_quarter(tmp_path):
    case = load_case(write(tmp_path, ""))
    assert case == Case()
    paper = Params()
    assert case.build().params == paper
    dumped = case.model_dump()["parameters"]
    assert {name: value for name, value in dumped.items() if value is not None} == values_of(paper)
    test = case.build()
    assert len(test.cut) == 427 and test.sector.order == 4


def test_fields_reach_the_test(tmp_path):
    text = "[specimen]\nlayers = 3\nhalf_width = 3\nradius = 1\n[sector]\norder = 2\n[parameters]\nfriction = 0\n"
    test = load_case(write(tmp_path, text)).build()
    assert test.sector.order == 2 and test.cut.radius[0] == 1.0 and test.params.friction == 0.0


def test_no_field_is_left_out_of_a_case():
    """A field added to a class that a case makes appears in case files by itself."""
    assert list(SECTIONS["sector"][0].model_fields) == [each.name for each in fields(Sector)] == list(settings(Sector))
    assert {each.name for each in fields(Scene)} == set(SECTIONS["scene"][0].model_fields) - {
        "friction", "damping", "contact_law"
    }  # fmt: skip
    kinds = {Params, *MATERIALS.values(), *DAMPINGS.values()} - {None}
    kinds |= {part for kind in MATERIALS.values() for part in optional_parts(kind).values()}
    assert set(SECTIONS["parameters"][0].model_fields) == {name for kind in kinds for name in declared(kind)}
    ours = set(SECTIONS["test"][0].model_fields)
    theirs = {each.name for each in fields(TriaxialTest) if each.init}
    sections = {"specimen", "sector", "scene", "params", "stages"}
    assert theirs - ours - sections == {"lateral_load", "dtype", "allow_unsafe_step"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_case_holds_every_field_with_its_unit_default_and_range(kind, tmp_path):
    path = tmp_path / "new.toml"
    assert axijax("new", "--kind", kind, path).code == 0
    text = path.read_text()
    case = load_case(path)
    expected = default_case(kind)
    if kind == "file":  # the balls lie beside the case
        beside = expected.specimen.model_copy(update={"path": str(tmp_path / "balls.csv")})
        expected = expected.model_copy(update={"specimen": beside})
    assert case == expected
    if kind not in GIVEN:  # a random one takes a minute to make, one from a file needs the file
        assert case.build().sector.order == max(KINDS[kind][1])
    data = tomllib.loads(text)
    assert list(data) == list(SECTIONS)
    parts = re.split(r"^\[\w+\]\n", text, flags=re.M)[1:]
    for (name, (model, _)), part in zip(SECTIONS.items(), parts, strict=True):
        names = set(model.model_fields)
        if name == "specimen":
            names = {"kind", *KINDS[kind][0]}
        if name == "parameters":
            names = set(case.scene.takes())
        told = {each for each in names if re.search(rf"^(# )?{each} =", part, re.M)}
        assert told == names
        filled = {"platen_speed"} if name == "parameters" and kind != "random" else set()
        assert set(data[name]) - filled == {each for each in names if model.model_fields[each].default is not None}
        for each in names:
            about = re.search(rf"((?:^#.*\n)+)(# )?{each} =", part, re.M)[1].replace("\n#  ", "")
            field = model.model_fields[each]
            assert field.description and field.description in " ".join(about.split())
            if field.annotation in (int, float, float | None):
                assert field.annotation is int or re.search(r"\[[^\]]+\]", about), f"{each} has no unit"
                assert ">" in about, f"{each} has no range"
                if field.default is not None:
                    assert float(re.search(r"default (\S+)$", about.strip())[1]) == field.default


def test_a_case_survives_both_round_trips():
    """Through JSON and through TOML, floats to the last bit."""
    case = Case(
        parameters={
            "friction": 0.1 + 0.2, "normal_stiffness": 1.5e9 / 7, "density": 1e-300, "platen_friction": float("inf"),
            "local_damping": 0.1 + 0.2, "rolling_friction": 0.2 / 3,
        },
        sector={"order": 1},
        test={"time_step": 0.1 / 3, "tolerance": 3e-7, "refresh": False},
        scene={"damping": "local"},
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert_round_trips(case)
    assert "time_step = 0.03333" in to_toml(case)


def assert_round_trips(case):
    assert Case.model_validate_json(case.model_dump_json()) == case
    assert Case.model_validate(tomllib.loads(to_toml(case))) == case


def test_a_sieve_curve_lies_beside_its_case(tmp_path):
    """Its balls are those of `sieve_curve`, in a run from any folder."""
    (tmp_path / "sieves.csv").write_text("opening,passing\n30,0\n40,60\n50,100\n")
    text = "[specimen]\nkind = 'random'\nballs = 60\ngrading = 'sieves.csv'\ncompaction_friction = 0.3\n"
    text += "[sector]\norder = 2\n"
    case = load_case(write(tmp_path, text))
    assert Case.model_validate(tomllib.loads(to_toml(case))) == case
    filled, specimen, report = case.made()
    expected = sieve_curve(tmp_path / "sieves.csv").sample(30)
    np.testing.assert_allclose(np.sort(specimen.radius), np.sort(np.tile(expected, 2)), rtol=1e-12)
    assert filled.test.confining_friction == report.compaction_friction == 0.3


def test_a_case_is_a_test_in_python():
    case = Case(specimen={"layers": 3, "half_width": 3}, parameters={"friction": 0.3})
    test = case.with_test(axial_strain=0.02).build()
    assert test.params.friction == 0.3 and test.axial_strain == 0.02


def test_descriptions_come_from_the_declarations():
    told = SECTIONS["parameters"][0].model_fields["confining_stress"].description
    assert told == declared(Params)["confining_stress"].description
    assert told == "confining stress s3, compression positive [F/L^2]"


# A whole case file as the version before this one wrote it, without its comments; friction alone is not its default.
OLD = """
[specimen]
kind = "octagon"
radius = 20.0
layers = 3
half_width = 3
[sector]
order = 4
boundary = "periodic"
[scene]
rotation = true
friction = true
damping = "dashpot"
contact_law = "linear"
[parameters]
friction = 0.3
normal_stiffness = 1.5e9
shear_stiffness = 1.5e9
confining_stress = 50000.0
platen_speed = 0.01
density = 2000.0
damping_ratio = 0.05
local_damping = 0.7
background_damping = 0.5
shear_modulus = 2.9e10
poisson_ratio = 0.2
[test]
axial_strain = 0.01
record_every = 50
refresh = true
confine_steps = 20000
tolerance = 1e-7
rebuild_every = 0
"""


def test_an_old_case_file_means_what_it_meant(tmp_path, monkeypatch):
    """With one sentence on what it names without need; written anew it says nothing."""
    with pytest.warns(UserWarning) as caught:
        old = load_case(write(tmp_path, OLD))
    (told,) = [str(each.message) for each in caught]
    for words in ("background_damping, local_damping, poisson_ratio, shear_modulus", "do nothing", "delete them."):
        assert words in told
    assert "\n" not in told
    test = old.build()
    assert test.params == Params(friction=0.3) and test.sector == Sector(4) and test.scene == Scene()
    assert test.specimen.positions.shape == fcc_octagon(layers=3, half_width=3).positions.shape
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load_case(write(tmp_path, to_toml(old))) == old
        assert Case.model_validate_json(old.model_dump_json()) == old
    monkeypatch.setattr("axijax.app.forecast._timed", lambda test: (1.0, 1e-5))  # no step is of interest here
    called = axijax("check", write(tmp_path, OLD))
    assert called.code == 0 and called.err.count("warning") == 1 and "local_damping" in called.err


# Scene and parameter of it that would do nothing there.
IDLE = [
    ({}, "local_damping", 0.5),
    ({}, "shear_modulus", 1e9),
    ({"damping": "none"}, "damping_ratio", 0.1),
    ({"damping": "background"}, "damping_ratio", 0.1),
    ({"contact_law": "hertz"}, "normal_stiffness", 1e9),
    ({"friction": False}, "friction", 0.3),
    ({"friction": False}, "rolling_friction", 0.3),
    ({"rotation": False}, "torsional_stiffness", 0.3),
]


@pytest.mark.parametrize(("scene", "name", "value"), IDLE)
def test_a_parameter_that_would_do_nothing_is_refused_in_a_file_and_a_sweep(scene, name, value, tmp_path):
    lines = [f"{key} = {str(held).lower() if isinstance(held, bool) else repr(held)}" for key, held in scene.items()]
    text = "\n".join(["[specimen]", "layers = 3", "half_width = 3", "[scene]", *lines])
    file = write(tmp_path, f"{text}\n[parameters]\n{name} = {value}\n")
    with pytest.raises(ValueError) as raised:
        load_case(file)
    for words in (f"case file '{file}'", f"parameters.{name} = {value:g} would do nothing", "leave it out", "[scene]"):
        assert words in str(raised.value)
    sweep = write(tmp_path, f"{text}\n[sweep]\nparameters.{name} = [{value}]\n")
    called = axijax("batch", sweep, "--output", tmp_path / "out")
    assert called.code == 1 and f"parameters.{name} = {value:g} would do nothing" in called.err
    assert not (tmp_path / "out").exists()


IDLE_IN_PYTHON = {
    "local_damping = 0.5": lambda: Params(local_damping=0.5),
    "damping_ratio = 0.1": lambda: replace(Params(), damping=None, damping_ratio=0.1),
    "normal_stiffness = 1000000000.0": lambda: Params(Hertz(), normal_stiffness=1e9),
    "gravity_z = -9.81": lambda: replace(Params(), gravity_z=-9.81),
    "rolling = Rolling(": lambda: small(Params(rolling=Rolling()), Scene(rotation=False)).prepared,
    "torsion = Torsion(": lambda: small(Params(friction=None, torsion=Torsion())).prepared,
}


@pytest.mark.parametrize("words", IDLE_IN_PYTHON)
def test_a_parameter_that_would_do_nothing_is_refused_in_python(words):
    with pytest.raises(ValueError, match="would do nothing") as raised:
        IDLE_IN_PYTHON[words]()
    assert words in str(raised.value)


def small(params=None, scene=None, **options):
    specimen = fcc_octagon(layers=3, half_width=3)
    return TriaxialTest(specimen, scene=scene or Scene(), params=params or Params(), **options)


def test_rolling_torsion_and_platen_friction_stand_in_files(tmp_path):
    """A part is there where one of its parameters is given, its others at their defaults."""
    text = "[specimen]\nlayers = 3\nhalf_width = 3\n[scene]\ndamping = 'local'\n[parameters]\n"
    text += "rolling_friction = 0.3\ntorsional_stiffness = 0.7\nplaten_friction = 0.2\nlocal_damping = 0.6\n"
    params = load_case(write(tmp_path, text)).build().params
    assert params == Params(
        rolling=Rolling(rolling_friction=0.3),
        torsion=Torsion(torsional_stiffness=0.7),
        platen_friction=0.2,
        damping=LocalDamping(0.6),
    )
    glued = Case(parameters={"platen_friction": float("inf")})
    assert glued.build().params == Params(platen_friction=float("inf"))
    assert_round_trips(glued)
    hertz = Case(scene={"contact_law": "hertz"}, parameters={"rolling_friction": 0.3}).build().params
    assert hertz == Params(Hertz(), rolling_friction=0.3)


def test_what_is_stiffer_takes_shorter_steps_and_what_is_given_stays():
    """A step goes with sqrt(m/K): four times the stiffness halves the computed one. One that was given is kept."""
    test = small()
    stiff = replace(test.params, normal_stiffness=4 * 1.5e9, shear_stiffness=4 * 1.5e9)
    before = test.prepared.time_step
    after = replace(test, params=stiff).prepared.time_step
    assert after == pytest.approx(before / 2, rel=1e-9)
    given = replace(test, time_step=0.3 * before)
    assert replace(given, params=stiff).prepared.time_step == 0.3 * before
    with pytest.raises(ValueError, match="critical time step"):
        replace(test, time_step=before, params=stiff).prepared  # noqa: B018


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[parameters]\nfricton = 0.1", ("parameters.fricton", "friction")),
        ("[parameter]\nfriction = 0.1", ("parameter", "parameters")),
        ("[parameters]\nfriction = -0.1", ("parameters.friction", "-0.1", "greater than or equal to 0")),
        ("[specimen]\nkind = 'sand'", ("specimen.kind", "sand", "octagon")),
        ("[sector\n", ("not valid TOML",)),
        ("sector = 4", ("sector", "4")),
    ],
)
def test_bad_cases_get_one_sentence(tmp_path, text, words):
    """test_bad_inputs_cli.py holds the long list."""
    with pytest.raises(ValueError) as error:
        load_case(write(tmp_path, text))
    message = str(error.value)
    assert "case.toml" in message and "\n" not in message
    for word in words:
        assert word in message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.toml' cannot be read"):
        load_case(tmp_path / "nowhere.toml")


def test_a_packing_that_does_not_settle_has_one_remedy(monkeypatch):
    """The function's own remedies, in place of which stand those of a case file."""
    from axijax.triaxial import random_specimen as random_packing

    for told in ("compaction stopped after 10 steps: raise most_steps.", "confinement: too fast: take a denser start."):

        def stops(*_, told=told, **__):
            raise RuntimeError(told)

        case._PACKED.clear()
        monkeypatch.setattr(random_packing, "random_cylinder", stops)
        with pytest.raises(RuntimeError) as raised:
            default_case("random").made()
        why = told.rsplit(":", 1)[0]
        assert str(raised.value) == f"{why}: take another specimen.seed, more balls, or a higher compaction_friction."
