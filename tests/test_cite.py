"""What to cite: entries that BibTeX reads, and those of what a test used."""

import re
from dataclasses import replace
from importlib.metadata import version

from cli_in_process import axijax as command

from axijax import Hertz, Rolling, Sector, TriaxialTest, fcc_octagon
from axijax.app.cite import bibtex


def keys(text):
    """Of entries whose braces match and whose fields are given."""
    assert text.count("{") == text.count("}")
    return re.findall(r"^@\w+\{(\w+),$", text, re.MULTILINE)


def test_a_test_cites_what_it_used_and_nothing_else():
    test = TriaxialTest(fcc_octagon(layers=3, half_width=3), Sector(4))
    assert keys(bibtex(test)) == ["axijax", "cui2005", "cundall1979", "luding2008", "jax2018", "thornton1979"]
    rolling = replace(test.params, rolling=Rolling(0.5, 0.1))
    assert "iwashita1998" in keys(bibtex(replace(test, params=rolling)))
    hertz = replace(test, params=replace(test.params, material=Hertz(shear_modulus=1e9, poisson_ratio=0.2)))
    assert "mindlin1953" in keys(bibtex(hertz)) and "iwashita1998" not in keys(bibtex(hertz))


def test_the_command_names_this_version(tmp_path):
    called = command("cite")
    assert called.code == 0 and f"version = {{{version('axijax')}}}" in called.out
    assert keys(called.out) == ["axijax", "cui2005", "cundall1979", "luding2008", "jax2018"]
    missing = command("cite", tmp_path / "nothing")
    assert missing.code == 1 and "does not exist" in missing.err
