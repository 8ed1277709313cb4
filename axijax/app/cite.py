"""What to cite: this version, the method's papers, and those of what a test used, as BibTeX."""

from importlib.metadata import version

from axijax.mechanics.hertz import Hertz
from axijax.triaxial.test import TriaxialTest

# By key: kind of entry and its fields.
PAPERS = {
    "cui2005": (
        "inproceedings",
        {
            "author": "Cui, L. and O'Sullivan, C.",
            "title": "Development of a mixed boundary environment for axi-symmetric {DEM} analyses",
            "booktitle": "Powders and Grains 2005",
            "year": "2005",
            "note": "periodic sector, membrane of Voronoi areas",
        },
    ),
    "cundall1979": (
        "article",
        {
            "author": "Cundall, P. A. and Strack, O. D. L.",
            "title": "A discrete numerical model for granular assemblies",
            "journal": "Géotechnique",
            "volume": "29",
            "number": "1",
            "pages": "47--65",
            "year": "1979",
            "note": "the method; local damping",
        },
    ),
    "thornton1979": (
        "article",
        {
            "author": "Thornton, C.",
            "title": "The conditions for failure of a face-centered cubic array of uniform rigid spheres",
            "journal": "Géotechnique",
            "volume": "29",
            "number": "4",
            "pages": "441--459",
            "year": "1979",
            "note": "closed form of the FCC lattice",
        },
    ),
    "luding2008": (
        "article",
        {
            "author": "Luding, S.",
            "title": "Cohesive, frictional powders: contact models for tension",
            "journal": "Granular Matter",
            "volume": "10",
            "pages": "235--246",
            "year": "2008",
            "note": "tangential spring that is cut back at the Coulomb limit",
        },
    ),
    "jax2018": (
        "software",
        {
            "author": "Bradbury, J. and Frostig, R. and Hawkins, P. and others",
            "title": "{JAX}: composable transformations of {Python+NumPy} programs",
            "url": "http://github.com/jax-ml/jax",
            "year": "2018",
        },
    ),
    "mindlin1953": (
        "article",
        {
            "author": "Mindlin, R. D. and Deresiewicz, H.",
            "title": "Elastic spheres in contact under varying oblique forces",
            "journal": "Journal of Applied Mechanics",
            "volume": "20",
            "pages": "327--344",
            "year": "1953",
            "note": "Hertzian contacts",
        },
    ),
    "iwashita1998": (
        "article",
        {
            "author": "Iwashita, K. and Oda, M.",
            "title": "Rolling resistance at contacts in simulation of shear band development by {DEM}",
            "journal": "Journal of Engineering Mechanics",
            "volume": "124",
            "number": "3",
            "pages": "285--292",
            "year": "1998",
            "note": "rolling and torsional resistance",
        },
    ),
}


def used_by(test: TriaxialTest | None) -> list[str]:
    """Keys of the papers behind a test, or, without one, behind every test."""
    keys = ["cui2005", "cundall1979", "luding2008", "jax2018"]
    if test is None:
        return keys
    material = test.params.material
    if "fcc" in test.specimen.name.lower():
        keys.append("thornton1979")
    if isinstance(material, Hertz):
        keys.append("mindlin1953")
    if material.rolling is not None or material.torsion is not None:
        keys.append("iwashita1998")
    return keys


def bibtex(test: TriaxialTest | None = None) -> str:
    """This version of axijax and the papers behind `test`, or behind every test, as BibTeX entries."""
    own = {
        "author": "{The axijax developers}",
        "title": "axijax: differentiable discrete element triaxial tests on an axisymmetric sector",
        "version": version("axijax"),
        "year": "2026",
        "license": "MIT",
    }
    entries = [_entry("software", "axijax", own), *(_entry(PAPERS[k][0], k, PAPERS[k][1]) for k in used_by(test))]
    return "\n\n".join(entries) + "\n"


def _entry(kind: str, key: str, fields: dict[str, str]) -> str:
    lines = ",\n".join(f"  {name} = {{{value}}}" for name, value in fields.items())
    return f"@{kind}{{{key},\n{lines}\n}}"
