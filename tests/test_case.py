"""Case files: what is read and written, what the defaults are, and what is refused."""

import inspect
import re
import tomllib
from dataclasses import fields

import numpy as np
import pytest
from cli_in_process import axijax

from axijax import Params, Scene, Sector, TriaxialTest
from axijax.app import case
from axijax.app.case import KINDS, SECTIONS, Case, default_case, load_case, to_toml
from axijax.specimen.grading import sieve_curve


def write(tmp_path, text):
    path = tmp_path / "case.toml"
    path.write_text(text)
    return path


def test_an_empty_case_is_the_papers_quarter(tmp_path):
    case = load_case(write(tmp_path, ""))
    assert case.parameters.model_dump() == vars(Params())
    assert case == Case()
    test = case.build()
    assert len(test.cut) == 427 and test.sector.order == 4


def test_fields_reach_the_test(tmp_path):
    text = "[specimen]\nlayers = 3\nhalf_width = 3\nradius = 1\n[sector]\norder = 2\n[parameters]\nfriction = 0\n"
    test = load_case(write(tmp_path, text)).build()
    assert test.sector.order == 2 and test.cut.radius[0] == 1.0 and test.params.friction == 0.0


def test_no_field_is_left_out_of_a_case():
    """A field added to a class that a case makes appears in case files by itself."""
    for name, source in {"sector": Sector, "scene": Scene, "parameters": Params}.items():
        assert list(SECTIONS[name][0].model_fields) == [each.name for each in fields(source)]
    ours = set(SECTIONS["test"][0].model_fields)
    theirs = {each.name for each in fields(TriaxialTest) if each.init}
    sections = {"specimen", "sector", "scene", "params"}
    assert theirs - ours - sections == {"lateral_load", "dtype", "allow_unsafe_step"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_case_holds_every_field_with_its_unit_default_and_range(kind, tmp_path):
    path = tmp_path / "new.toml"
    assert axijax("new", "--kind", kind, path).code == 0
    text = path.read_text()
    case = load_case(path)
    assert case == default_case(kind)
    if kind != "random":  # which takes a minute to make
        assert case.build().sector.order == max(KINDS[kind][1])
    data = tomllib.loads(text)
    assert list(data) == list(SECTIONS)
    parts = re.split(r"^\[\w+\]\n", text, flags=re.M)[1:]
    for (name, (model, _)), part in zip(SECTIONS.items(), parts, strict=True):
        names = set(model.model_fields)
        if name == "specimen":
            names = {"kind", *KINDS[kind][0]}
        told = {each for each in names if re.search(rf"^(# )?{each} =", part, re.M)}
        assert told == names
        assert set(data[name]) == {each for each in names if model.model_fields[each].default is not None}
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
        parameters={"friction": 0.1 + 0.2, "normal_stiffness": 1.5e9 / 7, "density": 1e-300},
        sector={"order": 1},
        test={"time_step": 0.1 / 3, "tolerance": 3e-7, "refresh": False},
        scene={"damping": "local"},
    )
    assert Case.model_validate_json(case.model_dump_json()) == case
    assert Case.model_validate(tomllib.loads(to_toml(case))) == case
    assert "time_step = 0.03333" in to_toml(case)


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


def test_descriptions_come_from_the_docstrings():
    assert SECTIONS["parameters"][0].model_fields["platen_speed"].description in " ".join(
        inspect.getdoc(Params).split()
    )


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
    from axijax.triaxial.test import random_specimen as random_packing

    for told in ("compaction stopped after 10 steps: raise most_steps.", "confinement: too fast: take a denser start."):

        def stops(*_, told=told, **__):
            raise RuntimeError(told)

        case._packed.cache_clear()
        monkeypatch.setattr(random_packing, "random_cylinder", stops)
        with pytest.raises(RuntimeError) as raised:
            default_case("random").made()
        why = told.rsplit(":", 1)[0]
        assert str(raised.value) == f"{why}: take another specimen.seed, more balls, or a higher compaction_friction."
