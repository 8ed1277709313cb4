"""A packing from a file: the same specimen as the one written, refusals, and a run that can be checked and resumed."""

import numpy as np
import pytest
import xarray
from cli_in_process import axijax as command

from axijax import Sector, fcc_octagon, packing, packing_of, random_cylinder
from axijax.mechanics.outer_balls import outer_balls
from axijax.specimen.specimen import cut_to_sector

OCTAGON = fcc_octagon(layers=7)


@pytest.fixture(scope="module")
def packed():
    """Balls at random; not made while tests are collected, which every worker does."""
    return random_cylinder(60, sector=Sector(1), seed=2)[0]


def written(path, specimen, header="x [mm],y [mm],z [mm],Radius [mm],material"):
    rows = np.vstack([specimen.positions, specimen.radius]).T.tolist()
    path.write_text("\n".join([header, *(",".join([*map(repr, row), "glass"]) for row in rows)]) + "\n")
    return path


def test_a_file_gives_back_the_balls_to_the_last_bit(packed, tmp_path):
    for path in (tmp_path / "balls.csv", tmp_path / "balls.nc"):
        if path.suffix == ".csv":
            written(path, packed)
        else:
            columns = dict(zip("xyz", packed.positions, strict=True), radius=packed.radius)
            xarray.Dataset({name: ("ball", values) for name, values in columns.items()}).to_netcdf(path, engine="scipy")
        read = packing(path)
        np.testing.assert_array_equal(read.positions, packed.positions)
        np.testing.assert_array_equal(read.radius, packed.radius)
        assert read.bottom == (packed.positions[2] - packed.radius).min()
        assert read.top == (packed.positions[2] + packed.radius).max()
        found = outer_balls(packed.positions, packed.radius, read.bottom, read.top, Sector(1))
        np.testing.assert_array_equal(read.membrane_zone, found)


def test_a_lattice_from_outside_is_the_lattice(packed):
    """Its outer balls are those of the paper's rule, its platens those of the lattice, and its sectors can be cut."""
    outside = packing_of(OCTAGON.positions, OCTAGON.radius)
    np.testing.assert_array_equal(outside.membrane_zone, OCTAGON.membrane_zone)
    assert (outside.bottom, outside.top) == pytest.approx((OCTAGON.bottom, OCTAGON.top), abs=1e-10)
    cuts = [cut_to_sector(specimen, Sector(4)) for specimen in (outside, OCTAGON)]
    np.testing.assert_array_equal(cuts[0].positions, cuts[1].positions)
    with pytest.raises(ValueError, match="same after a turn"):
        cut_to_sector(packing_of(packed.positions, packed.radius), Sector(2))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda p, r: (p[:2], r), "(3, N)"),
        (lambda p, r: (p[:, :3], r[:3]), "at least four"),
        (lambda p, r: (p, r[:5]), "must be one number"),
        (lambda p, r: (p, -r), "positive"),
        (lambda p, r: (np.where(p > 100, np.nan, p), r), "not finite"),
        (lambda p, r: (p + np.array([[100.0], [0], [0]]), r), "move the balls"),
    ],
)
def test_what_is_no_packing_is_refused(change, told):
    with pytest.raises(ValueError, match="packing") as caught:
        packing_of(*change(OCTAGON.positions, OCTAGON.radius))
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "0 columns 'x'"),
        ("x,y,z\n1,2,3\n", "0 columns 'radius'"),
        ("x,y,z,radius,x\n1,2,3,4,5\n", "2 columns 'x'"),
        ("x,y,z,radius\n1,2,3,4\n1,2,three,4\n", "line 3: z is 'three'"),
        ("x,y,z,radius\n1,2,3\n", "line 2: radius is nothing"),
        ("x,y,z,radius\n1,2,3,4\n", "at least four balls"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused_by_a_sentence(tmp_path, text, told):
    path = tmp_path / "balls.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"balls\.csv") as caught:
        packing(path)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_a_case_with_a_packing_runs_and_its_result_needs_the_file_no_more(packed, tmp_path):
    """The path is that of the case file's folder; the result keeps the balls, for check, resume and report."""
    balls = written(tmp_path / "balls.csv", packed)
    case = tmp_path / "own.toml"
    case.write_text(
        '[specimen]\nkind = "file"\npath = "balls.csv"\n[sector]\norder = 1\n[parameters]\nfriction = 0.4\n'
        "platen_speed = 0.1\n[test]\naxial_strain = 0.004\nrecord_every = 20\ntolerance = 1e-2\n"
        "confine_steps = 100000\n"
    )
    ran = command("run", case, "--output", tmp_path / "out")
    assert ran.code == 0, ran.err
    balls.unlink()
    again = command("resume", tmp_path / "out", "--axial-strain", "0.006")
    assert again.code == 0, again.err
    assert command("report", tmp_path / "out").code == 0
    lost = command("run", case, "--output", tmp_path / "new")
    assert lost.code == 1 and "balls.csv' cannot be read" in lost.err and not (tmp_path / "new").exists()
