"""The guide: its tutorials run and find what they say, its links lead somewhere, its site's parts are there."""

import contextlib
import io
import re
import runpy
import sys
from functools import partial
from pathlib import Path

import matplotlib
import pytest

import axijax
import calibrate

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "examples" / "guide"
sys.path.insert(0, str(GUIDE))
from run_pages import PAGES  # noqa: E402

TUTORIALS = sorted(path.stem for path in GUIDE.glob("*.py") if path.read_text().startswith("# %%"))


# ---- Tutorials: all in this process, so that what one compiled serves the next ----


# What a tutorial makes larger than its test needs, with what is put in its place here.
SMALLER = {"batch": ("fcc_octagon", partial(axijax.fcc_octagon, layers=7, half_width=5))}


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """Name of a tutorial -> what it printed, in a folder of its own."""

    def run(name: str) -> str:
        out = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
            patch.chdir(tmp_path_factory.mktemp(name))
            if name in SMALLER:
                patch.setattr(axijax, *SMALLER[name])
            runpy.run_path(str(GUIDE / f"{name}.py"), run_name="__main__")
        return out.getvalue()

    matplotlib.use("Agg")
    return run


def numbers(pattern: str, text: str) -> list[float]:
    found = re.search(pattern, text)
    assert found, f"{pattern} is not in\n{text}"
    return [float(each) for each in found.groups()]


NUMBER = r"(-?[0-9.]+(?:e[-+]?[0-9]+)?)"


def first_test(text):
    core, theory = numbers(rf"peak of the core {NUMBER}, Thornton {NUMBER}", text)
    assert abs(core / theory - 1) < 0.02
    assert "1672 balls in the cylinder, 427 of them simulated" in text


def reading_a_curve(text):
    by_hand, said = numbers(rf"friction angle of {NUMBER} degrees; the curve says {NUMBER}", text)
    assert abs(by_hand - said) < 0.02
    found, rowe = numbers(rf"K behind the peak {NUMBER}; of f = 0.12278 {NUMBER}", text)
    assert abs(found / rowe - 1) < 0.02
    assert "secant modulus E50" in text


def units(text):
    pattern = rf"peak stress ratio {NUMBER} and {NUMBER}; the curves are apart by {NUMBER}"
    si, millimetres, apart = numbers(pattern, text)
    assert si == millimetres and apart < 1e-6 and si > 2


def own_packing(text):
    assert "not the same after a turn by 2*pi/3" in text
    voids, ratio = numbers(rf"void ratio {NUMBER}, peak stress ratio {NUMBER}", text)
    assert 0.3 < voids < 1.2 and 2 < ratio < 5


def random_specimen(text):
    assert "120 balls, 60 in a sector of order 2" in text
    start, end = numbers(rf"void ratio {NUMBER} at the start, {NUMBER} at the end", text)
    assert end > start, "a dense packing dilates"


def stress_paths(text):
    found = {
        name: numbers(rf"{name} +q +{NUMBER}, p +{NUMBER}, s3 +{NUMBER}, volume +{NUMBER}", text)
        for name in ("drained", "undrained")
    }
    assert found["drained"][2] == 50000
    assert abs(found["undrained"][3]) < 0.01 < abs(found["drained"][3])
    ratio = float(re.findall(rf"with R = {NUMBER}", text)[1])
    assert ratio == pytest.approx(1.0, abs=0.02), "unloaded until q is zero"


def batch(text):
    assert "3 tests, failed: none" in text and "computed again: 0" in text
    peaks = [float(peak) for peak in re.findall(r"peak ([0-9.]+)", text)]
    assert peaks[0] < peaks[1] < peaks[2]


def gradient_health(text):
    assert text.count("health: ") == 2
    healthy, sick = re.findall(r"health: (.+?) \(", text)
    assert healthy == "use" and sick != "use"


LOOKS = {
    each.__name__: each
    for each in (
        first_test, reading_a_curve, units, own_packing, random_specimen, stress_paths, batch, gradient_health,
    )
}  # fmt: skip


def test_every_tutorial_is_looked_at():
    """But the sand's fit, whose many packings take half a minute; test_calibrate_random.py has one."""
    assert set(LOOKS) == set(TUTORIALS) - {"calibrate_a_sand"}


@pytest.mark.parametrize("name", sorted(LOOKS))
def test_tutorial(told, name):
    LOOKS[name](told(name))


# ---- Pages and links ----


def anchors(text: str) -> set[str]:
    """Of a page's headings, as GitHub and mkdocs make them."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in heads}


def links(text: str) -> list[str]:
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    text = re.sub(r"`[^`\n]*`", "", text)
    return re.findall(r"\]\(([^()\s]+)\)", text) + re.findall(r'src="([^"]+)"', text)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path):
    for link in links(path.read_text()):
        if link.startswith("https://"):
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), f"{path.name}: {link}"
        assert target.is_relative_to(ROOT)
        assert not anchor or anchor in anchors(target.read_text()), f"{path.name}: {link}"


def test_every_page_and_tutorial_is_in_the_index():
    linked = {(ROOT / "examples" / link).resolve() for link in links((ROOT / "examples" / "README.md").read_text())}
    missing = {path for path in (*GUIDE.glob("*.md"), *(GUIDE / f"{name}.py" for name in TUTORIALS))} - linked
    assert not missing
    studies = {path for path in (ROOT / "examples").glob("*.py")} - linked
    assert not studies, "a study without a line in the index"


def test_pages_are_in_the_sites_navigation():
    config = (GUIDE / "mkdocs.yml").read_text()
    for path in GUIDE.glob("*.md"):
        assert f"guide/{path.name}" in config, path.name
    for name in TUTORIALS:
        assert f"guide/{name}_tutorial.md" in config, name


def test_public_names_have_docstrings_for_the_sites_pages():
    for package in (axijax, calibrate):
        for name in package.__all__:
            found = getattr(package, name)
            assert not callable(found) or found.__doc__, name
