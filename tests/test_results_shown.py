"""What a run leaves: drawn, reported, exported; every number against the state it came from."""

import json
import re
import shutil
import struct
import zlib
from base64 import b64decode
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import jax
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from small_result import CASE
from typer.testing import CliRunner

from axijax.app import figures as pictures
from axijax.app import labels, paraview, plot, soil_figures
from axijax.app.case import Case
from axijax.app.checks import result_checks
from axijax.app.report import report_page
from axijax.app.results import open_result
from axijax.app.snapshot import snapshot
from axijax.theory import fcc_stress_ratio
from axijax.triaxial.progress import begin
from calibrate import MeasuredCurve

pytest_plugins = ["small_result"]


# ParaView.


def read_vtu(path):
    """Points, offsets and the named arrays of a VTK XML unstructured grid, by the format's description alone."""
    root = ElementTree.parse(path).getroot()
    kinds = {"Float64": "<f8", "Int64": "<i8", "Int32": "<i4"}

    def array(element):
        raw = b64decode(element.text.strip()[: 4 * -(-4 * 3 // 3)])  # number of blocks, block size, last block size
        blocks = struct.unpack("<3I", raw[:12])[0]
        head = 4 * (3 + blocks)
        encoded = 4 * -(-head // 3)
        sizes = struct.unpack(f"<{3 + blocks}I", b64decode(element.text.strip()[:encoded])[:head])[3:]
        packed, data = b64decode(element.text.strip()[encoded:]), b""
        for size in sizes:
            data += zlib.decompress(packed[:size])
            packed = packed[size:]
        values = np.frombuffer(data, kinds[element.get("type")])
        width = int(element.get("NumberOfComponents", 1))
        return values.reshape(-1, width) if width > 1 else values

    named = {
        kind: {e.get("Name"): array(e) for e in root.iter("DataArray") if e in list(root.find(f".//{kind}"))}
        for kind in ("Points", "Cells", "PointData", "CellData")
        if root.find(f".//{kind}") is not None
    }
    return named.pop("Points")["Points"], named["Cells"], named.get("PointData", {}), named.get("CellData", {})


@pytest.fixture(scope="module")
def exported(result, tmp_path_factory):
    """Snapshots of the start and of the last state."""
    folder = tmp_path_factory.mktemp("snapshots") / "made"
    write = paraview.SnapshotWriter(folder, result.test, full=True)
    write(begin(result.test, result.test.params))
    return folder, write(result.progress)


def test_files_hold_the_state(exported, moment, result):
    folder, paths = exported
    assert [path.name for path in paths[:4]] == [f"{part}_0001.vtu" for part in paraview.PARTS]
    points, _, data, _ = read_vtu(folder / "balls_0001.vtu")
    balls, contacts = moment.balls, moment.contacts
    np.testing.assert_array_equal(points, balls.positions.T)
    for name in ("radius", "velocity", "spin", "membrane_area", "weight", "number", "image"):
        np.testing.assert_array_equal(data[name], getattr(balls, name).T, err_msg=name)
    np.testing.assert_array_equal(data["coordination_number"], balls.coordination)
    np.testing.assert_array_equal(data["stress"].reshape(-1, 3, 3), np.moveaxis(balls.stress, -1, 0))
    ends, _, at_points, data = read_vtu(folder / "contacts_0001.vtu")
    np.testing.assert_allclose(ends[::2] - ends[1::2], (contacts.start - contacts.end).T, atol=1e-12 * ends.max())
    np.testing.assert_array_equal(data["force"], contacts.force.T)
    np.testing.assert_allclose(
        np.hypot(data["normal_force"], data["tangential_force"]), np.linalg.norm(contacts.force, axis=0), rtol=1e-12
    )
    np.testing.assert_array_equal(data["sliding"], contacts.sliding)
    np.testing.assert_array_equal(at_points["normal_force"][1::2], data["normal_force"])
    corners, cells, _, data = read_vtu(folder / "membrane_0001.vtu")
    np.testing.assert_allclose(np.hypot(*corners.T[:2]), moment.membrane.radius)
    assert np.diff(cells["offsets"], prepend=0).sum() == len(corners) and (cells["types"] == 7).all()
    assert data["area"].sum() == pytest.approx(moment.membrane.area.sum(), rel=1e-12)
    assert data["force"].sum() == pytest.approx(moment.membrane.force.sum(), rel=1e-12)
    # The polygon of a cell is about the ball whose number it bears, of the image it bears.
    first = np.concatenate([[0], cells["offsets"][:-1]])
    for cell in (0, 17, len(first) - 1):
        x, y, z = corners[cells["connectivity"][first[cell] : cells["offsets"][cell]]].mean(0)
        ball = np.flatnonzero((balls.number == data["number"][cell]) & (balls.image == data["image"][cell]))[0]
        place = balls.positions[:, ball]
        turn = np.angle((x + 1j * y) / (place[0] + 1j * place[1]))
        assert np.hypot(turn * moment.membrane.radius, z - place[2]) < balls.radius[ball]
    rim, _, _, data = read_vtu(folder / "platens_0001.vtu")
    np.testing.assert_array_equal(np.unique(rim[:, 2]), moment.platens.heights)
    np.testing.assert_array_equal(data["force"], moment.platens.forces)


def test_displacement_counts_from_the_end_of_confinement(exported, result):
    folder, _ = exported
    before, _, data, _ = read_vtu(folder / "balls_0000.vtu")
    assert not data["displacement"].any() and not data["velocity"].any()
    after, _, data, _ = read_vtu(folder / "balls_0001.vtu")
    np.testing.assert_allclose(data["displacement"], after - before, atol=1e-12)
    shortening = result.progress.strain * result.progress.height
    assert np.ptp(data["displacement"][:, 2]) == pytest.approx(shortening, rel=0.2)


def times(folder):
    root = ElementTree.parse(folder / "balls.pvd").getroot()
    return {entry.get("file"): float(entry.get("timestep")) for entry in root.iter("DataSet")}


def test_index_has_strain_for_time_and_survives_stops(exported, result, tmp_path, monkeypatch):
    folder, _ = exported
    strain = pytest.approx(result.progress.strain, rel=1e-8)
    assert times(folder) == {"balls_0000.vtu": 0.0, "balls_0001.vtu": strain}
    again = Path(shutil.copytree(folder, tmp_path / "again"))
    resumed = paraview.SnapshotWriter(again, result.test)
    resumed(result.progress)  # goes on in the folder, in place of the same strain
    assert times(again) == times(folder)
    points = read_vtu(again / "balls_0001.vtu")[0]
    assert len(points) == len(result.test.cut), "the sector alone"

    def full(path, write):
        raise OSError("disk full")

    monkeypatch.setattr(paraview, "write_whole", full)
    with pytest.raises(OSError, match="disk full"):
        paraview.SnapshotWriter(again, result.test)(result.progress)
    assert times(again) == times(folder) and not list(again.glob(".*"))


def test_a_test_without_membrane_or_contacts_is_written_too(moment, tmp_path):
    none = moment.contacts._replace(**{name: a[..., :0] for name, a in moment.contacts._asdict().items()})
    bare = moment.membrane._replace(polygons=[], number=np.zeros(0, int), image=np.zeros(0, int), area=np.zeros(0))
    bare = bare._replace(force=np.zeros(0))
    for part, mesh in paraview.meshes(moment._replace(contacts=none, membrane=bare)).items():
        mesh.write(tmp_path / f"{part}.vtu", file_format="vtu")
    for part, count in (("balls", moment.balls.number.size), ("contacts", 0), ("membrane", 0), ("platens", 2)):
        assert read_vtu(tmp_path / f"{part}.vtu")[1]["offsets"].size == count
    assert pictures.force_network(moment._replace(contacts=none)).axes
    with pytest.raises(ValueError, match="without a membrane"):
        pictures.membrane_cells(moment._replace(membrane=bare))


def test_vtk_reads_the_files(exported):
    """The format's own library, where it is installed."""
    vtk = pytest.importorskip("vtk")
    for path in exported[1][:4]:
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(path))
        reader.Update()
        assert reader.GetOutput().GetNumberOfCells() > 0


# Pictures.


def drawn(figure, kind):
    return [each for axes in figure.axes for each in axes.collections if isinstance(each, kind)]


def test_curves_theory_and_data_are_drawn_as_they_are(result, folder):
    data = MeasuredCurve(np.array([0.001, 0.002]), np.array([2.0, 3.0]), np.array([1e-4, 2e-4]), source="lab.csv")
    other = open_result(folder)
    friction = result.case.parameters.model_copy(update={"friction": 0.3})
    other.__dict__["case"] = result.case.model_copy(update={"parameters": friction})
    figure = plot.curve_figure([result, other], data)
    upper, lower = figure.axes
    lines = {line.get_label(): line for line in upper.lines}
    assert set(lines) == {
        "friction 0.12278", "friction 0.3", "Thornton (1979), f = 0.12278", "Thornton (1979), f = 0.3",
        "measured, lab.csv",
    }  # fmt: skip
    strain, ratio = lines["friction 0.3"].get_data()
    np.testing.assert_allclose(strain, 100 * result.curve.axial_strain)
    np.testing.assert_array_equal(ratio, result.curve.stress_ratio)
    assert set(lines["Thornton (1979), f = 0.3"].get_ydata()) == {float(fcc_stress_ratio(0.3))}
    np.testing.assert_allclose(lines["measured, lab.csv"].get_xydata(), [[0.1, 2], [0.2, 3]])
    np.testing.assert_allclose(lower.lines[0].get_ydata(), 100 * result.curve.volumetric_strain)
    assert "[%]" in lower.get_xlabel() and "[-]" in upper.get_ylabel()


def test_many_runs_that_differ_in_one_number_are_told_apart_by_a_scale(result, folder):
    """Six stiffnesses over two decades, out of order, on a logarithmic scale; a second difference makes six names."""
    from matplotlib import colormaps

    def varied(**fields):
        other = open_result(folder)
        parameters = result.case.parameters.model_copy(update=fields)
        other.__dict__["case"] = result.case.model_copy(update={"parameters": parameters})
        return other

    values = [1e9, 1e10, 3e8, 3e9, 1e8, 3e10]
    for draw in (plot.curve_figure, soil_figures.q_strain):
        figure = draw([varied(normal_stiffness=value) for value in values])
        *curves, scale = figure.axes
        assert scale.get_ylabel() == "normal stiffness" and scale.get_yscale() == "log"
        records = [line for line in curves[0].lines if len(line.get_xdata()) == result.curve.sizes["axial_strain"]]
        assert len(records) == len(values) and not any(line.get_label().strip("_child0123456789") for line in records)
        colours = [line.get_color() for line in records]
        shares = [np.log(value / 1e8) / np.log(300) for value in values]
        np.testing.assert_allclose(colours, [colormaps["viridis"](share) for share in shares], atol=0.01)
    mixed = [varied(normal_stiffness=value, friction=0.1 + k / 10) for k, value in enumerate(values)]
    names = [line.get_label() for line in plot.curve_figure(mixed).axes[0].lines]
    assert "friction 0.1, normal stiffness 1e+09" in names


def test_runs_are_named_by_what_was_chosen_not_by_what_follows(result):
    """Another contact law has other parameters, which its name says already."""
    other = replace(result)
    other.__dict__["case"] = Case(**CASE | {"scene": {"contact_law": "hertz"}})
    assert labels.labels([result, other]) == ["contact law linear", "contact law hertz"]


def test_force_network_is_as_wide_as_the_forces(moment):
    lines = drawn(pictures.force_network(moment), LineCollection)
    contacts = moment.contacts
    middle = (contacts.start[1] + contacts.end[1]) / 2 / moment.balls.radius[0]
    shown = (middle > -0.3) & (middle < 1.3)
    widths = np.concatenate([each.get_linewidths() for each in lines])
    assert widths.size == shown.sum() > 0
    ratio = np.sort(widths) / np.sort(contacts.normal_force[shown])
    np.testing.assert_allclose(ratio, ratio[0])


def test_rose_is_a_circle_where_all_directions_are_alike(moment):
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(3, 200_000))
    normal /= np.linalg.norm(normal, axis=0)
    one = np.ones(normal.shape[1])
    alike = moment.contacts._replace(normal=normal, share=one, normal_force=one)

    def bars(contacts):
        number, force = pictures.fabric_rose(moment._replace(contacts=contacts)).axes
        return [np.array([bar.get_height() for bar in axes.patches]).reshape(4, -1) for axes in (number, force)]

    for density in bars(alike):
        np.testing.assert_allclose(density, 1.0, atol=0.06)
    for density in bars(moment.contacts):
        assert density[0].argmax() == 4, "an FCC array bears at 45 degrees"
    share = 1 / (np.sin(np.deg2rad(50)) - np.sin(np.deg2rad(40)))
    inclined = np.abs(moment.contacts.normal[2]) > 0.5
    assert bars(moment.contacts)[0][0, 4] == pytest.approx(share * inclined.mean(), rel=1e-9)


def test_cells_section_and_specimen_show_every_ball_once(moment):
    figure = pictures.membrane_cells(moment)
    (cells,) = drawn(figure, PolyCollection)
    np.testing.assert_array_equal(np.asarray(cells.get_array()), np.tile(moment.membrane.area, 3))
    assert figure.axes[0].get_xlim()[1] == pytest.approx(2 * np.pi * moment.membrane.radius)
    upright, plan = drawn(pictures.section(moment), EllipseCollection)
    y = moment.balls.positions[1] / moment.balls.radius[0]
    assert len(upright.get_offsets()) == ((y > -0.3) & (y < 1.3)).sum()
    assert len(plan.get_offsets()) > 0
    (discs,) = drawn(pictures.specimen(moment), EllipseCollection)
    colours = discs.get_facecolors()
    colours = colours[:: len(colours) // moment.balls.number.size]
    blue = colours[:, 2] > colours[:, 0] + 0.1
    assert blue.size == moment.balls.number.size and blue.sum() == len(np.unique(moment.balls.number))


def test_pictures_are_files(result, tmp_path):
    kinds = ["curve", *pictures.KINDS]
    paths = plot.plot_result([result], kinds, tmp_path / "all")
    assert [path.name for path in paths] == [f"{kind}.png" for kind in kinds]
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 10_000
    with pytest.raises(ValueError, match="did you mean 'fabric-rose'"):
        plot.plot_result([result], ["fabric_rose"], tmp_path)
    with pytest.raises(ValueError, match="2 pictures do not fit one file"):
        plot.plot_result([result], ["curve", "section"], tmp_path / "one.png")
    assert plot.plot_result([result], ["curve"], tmp_path / "one.png") == [tmp_path / "one.png"]


# The report.


class Page(HTMLParser):
    """Text, tags that were not closed in order, and everything that a page would fetch."""

    def __init__(self, text):
        super().__init__()
        self.words, self.open, self.wrong, self.fetched, self.images = [], [], [], [], 0
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br", "input"):
            self.open.append(tag)
        for name, value in attributes:
            if name in ("src", "href") and not value.startswith(("data:image/png;base64,", "#")):
                self.fetched.append(value)
        self.images += tag == "img"

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data):
        self.words.append(data)


def test_report_stands_alone_and_tells_all(result):
    text = report_page([result])
    page = Page(text)
    assert not page.wrong and not page.open and not page.fetched
    assert "http" not in text and "@import" not in text and "url(" not in text
    assert page.images == 10
    for values in result.case.model_dump().values():
        for name, value in values.items():
            words = {"None": "left out", "True": "true", "False": "false"}
            shown = {words.get(str(value), str(value)), f"{value:g}" if isinstance(value, float) else ""} - {""}
            assert any(f"{name} {each} " in page.text for each in shown), name
    peak = float(result.curve.stress_ratio.max())
    assert f"{peak:.4g} largest stress ratio s1/s3 so far [-], at the last record: the curve still rises" in page.text
    assert "peak stress ratio s1/s3" not in page.text and f"jax {jax.__version__}" in page.text
    for check in result_checks(result):
        assert check.name in page.text
    assert "axijax run case.toml --output small" in page.text and "half_width = 5" in text


def test_report_has_the_specimen_to_be_turned(result):
    """The balls that its script draws are those of the last state, whole cylinder, by size, place and colour."""
    text = report_page([result])
    assert text.count("<script>") == 1 and len(text) < 4e6
    (told,) = re.findall(r'<figure class="turning" hidden data-seen="([^"]*)"', text)
    told = json.loads(unescape(told))
    seen = snapshot(result.test, result.progress, full=True)

    def numbers(packed, kind):
        return np.frombuffer(b64decode(packed), kind)

    place, radius = numbers(told["place"], "<i2").reshape(-1, 3).T, numbers(told["radius"], "<i2")
    bottom, top = seen.platens.heights
    unit = (top - bottom) / told["height"]
    np.testing.assert_allclose(unit * radius, seen.balls.radius, atol=0.6 * unit)
    middle = np.array([0, 0, (bottom + top) / 2])[:, None]
    np.testing.assert_allclose(unit * place + middle, seen.balls.positions, atol=(top - bottom) / 3e4)
    assert told["number"] == seen.balls.number.tolist()
    options = re.findall(r"<option[^>]*>([^<]*)", text)
    fields = dict(zip(options, told["fields"], strict=True))
    contacts = fields["contacts of a ball"]
    values = [int(contacts["told"][k]) for k in numbers(contacts["values"], "u1")]
    assert values == seen.balls.coordination.tolist()
    image = fields["simulated and images"]
    assert [image["told"][k] for k in numbers(image["values"], "u1")].count("simulated") == len(result.test.cut)
    stress = fields["mean stress / confining stress"]
    values = np.array([float(stress["told"][k].removeprefix("≥ ")) for k in numbers(stress["values"], "u1")])
    exact = np.trace(seen.balls.stress) / 3 / seen.confining_stress
    within = exact < values.max()
    np.testing.assert_allclose(values[within], exact[within], atol=values.max() / 100)
    for each in told["fields"]:
        assert len(each["colours"]) == len(each["told"]) > numbers(each["values"], "u1").max()


def test_report_escapes_what_it_did_not_write(result):
    spoilt = replace(result, status="failed", info={"message": "<script>alert(1)</script>", "machine": {"cpu": "<b>"}})
    text = report_page([replace(spoilt, path=result.path / "curve.nc")])
    assert "<script" not in text and "&lt;script&gt;" in text and "&lt;b&gt;" in text


# The commands.


def test_commands_write_what_they_say(folder, tmp_path, monkeypatch):
    from axijax.app.cli.main import app

    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder, "small")

    def call(*arguments):
        outcome = CliRunner().invoke(app, arguments)
        assert outcome.exit_code == 0, outcome.output
        return outcome.output

    assert "small/pictures/curve.png" in call("plot", "small", "--data", "small/curve.csv")
    assert "report.html" in call("report", "small/curve.nc", "small/curve.nc", "--output", "new/report.html")
    page = Page(Path("new/report.html").read_text())
    assert "Comparison" in page.text and not page.wrong and not page.fetched
    # The run has written the start and the end, of which the end is written again.
    made = times(Path("small/snapshots"))
    assert list(made) == ["balls_0000.vtu", "balls_0001.vtu"]
    assert "balls_0001.vtu" in call("snapshot", "small") and times(Path("small/snapshots")) == made
    assert "snapshots-full/balls_0000.vtu" in call("snapshot", "small", "--full")
    for bad in (["plot", "none"], ["snapshot", "small/curve.nc"], ["plot", "small", "--data", "none.csv"]):
        outcome = CliRunner().invoke(app, bad)
        assert isinstance(outcome.exception, ValueError)
        assert re.search("'none' does not exist|no last state|none.csv: no such file", str(outcome.exception))
