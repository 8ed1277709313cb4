"""Case files: what is read, what the defaults are, and what is refused."""

import pytest

from axijax import Params
from axijax.case import Case, load_case


def write(tmp_path, text):
    path = tmp_path / "case.toml"
    path.write_text(text)
    return path


def test_an_empty_case_is_the_papers_quarter(tmp_path):
    case = load_case(write(tmp_path, ""))
    assert case.parameters.model_dump() == vars(Params())
    test = case.build()
    assert len(test.cut) == 427 and test.sector.order == 4


def test_fields_reach_the_test(tmp_path):
    text = "[specimen]\nlayers = 3\nhalf_width = 3\nradius = 1\n[sector]\norder = 2\n[parameters]\nfriction = 0\n"
    test = load_case(write(tmp_path, text)).build()
    assert test.sector.order == 2 and test.cut.radius[0] == 1.0 and test.params.friction == 0.0


def test_a_case_survives_a_round_trip():
    case = Case(parameters={"friction": 0.25}, sector={"order": 1})
    assert Case.model_validate_json(case.model_dump_json()) == case


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[parameters]\nfricton = 0.1", ("parameters.fricton", "friction")),
        ("[parameter]\nfriction = 0.1", ("parameter", "parameters")),
        ("[parameters]\nfriction = -0.1", ("parameters.friction", "-0.1", "greater than or equal to 0")),
        ("[parameters]\nnormal_stiffness = 0", ("parameters.normal_stiffness", "greater than 0")),
        ("[parameters]\nfriction = nan", ("parameters.friction", "nan", "finite")),
        ("[parameters]\nfriction = 'much'", ("parameters.friction", "much", "number")),
        ("[sector]\norder = 0", ("sector.order", "0", "greater than or equal to 1")),
        ("[sector]\norder = 2.5", ("sector.order", "2.5", "integer")),
        ("[sector]\nboundary = 'mirror'", ("sector.boundary", "mirror", "periodic")),
        ("[test]\naxial_strain = 0.7", ("test.axial_strain", "0.7", "less than 0.5")),
        ("[specimen]\nkind = 'sand'", ("specimen.kind", "sand", "fcc octagon")),
        ("[sector\n", ("not valid TOML",)),
        ("sector = 4", ("sector", "4")),
    ],
)
def test_bad_cases_get_one_sentence(tmp_path, text, words):
    with pytest.raises(ValueError) as error:
        load_case(write(tmp_path, text))
    message = str(error.value)
    assert "case.toml" in message and "\n" not in message
    for word in words:
        assert word in message


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"nowhere\.toml' cannot be read"):
        load_case(tmp_path / "nowhere.toml")
