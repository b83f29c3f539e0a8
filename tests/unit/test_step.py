"""STEP files: units, solids, faces with kind and parameters, and the face of each triangle."""

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from cell.errors import FileError, UsageError
from cell.part import cad
from cell.part.cad import DEVIATION_MM, MAX_VOLUME_ERROR, SurfaceKind, cad_face
from cell.part.description import volume
from cell.part.mesh_checks import Kind
from cell.part.workpiece import Workpiece, load
from cell.scene.fields import Units
from cell.scene.file import load_scene
from cell.scene.model import MeshFixture
from cell.world.shapes import fixture_mesh
from tests.step_files import BLOCK_VOLUME, StepFile, bored_block, needs_cascadio


def written(folder: Path, text: str, name: str = "part.stp") -> Path:
    """Write the text to a file and return its path."""
    path = folder / name
    path.write_text(text)
    return path


def check_faces(part: Workpiece) -> None:
    """Require every corner of every triangle to be on the surface of its face, within float32 of the file."""
    for index, face in enumerate(part.cad.faces):
        corners = part.reference.vertices[part.reference.faces[part.cad.of_triangle == index]].reshape(-1, 3)
        assert len(corners)
        if face.kind is not SurfaceKind.OTHER:
            assert face.distance(corners).max() < 1e-6


@needs_cascadio
@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("in", 25.4e-3)])
def test_a_bored_block_has_its_size_volume_and_seven_faces(tmp_path: Path, unit: str, metres: float) -> None:
    """Six planes and a cylinder in metres, in any unit; the volume is exact within the tessellation's deviation."""
    part = load(written(tmp_path, bored_block(unit), f"part.{'STEP' if unit == 'in' else 'stp'}"))
    assert part.bounds == pytest.approx(np.array([[0, 0, 0], [60, 40, 30]]) * metres, abs=1e-7)
    wall = 2 * math.pi * 8 * 30 * metres**2
    assert volume(part) == pytest.approx(BLOCK_VOLUME * metres**3, abs=wall * DEVIATION_MM / 1000)
    doubts = [finding.sentence for finding in part.findings]
    assert doubts == ([] if unit == "mm" else ["the part is 1.52 m long; check the unit in the file"])
    assert part.cad.counts() == {"plane": 6, "cylinder": 1}
    assert [face.number for face in part.cad.faces] == [1, 2, 3, 4, 5, 6, 7]
    bore = next(face for face in part.cad.faces if face.kind is SurfaceKind.CYLINDER)
    assert bore.radius == pytest.approx(8 * metres, rel=1e-9)
    assert np.abs(bore.axis) == pytest.approx([0, 0, 1], abs=1e-9)
    check_faces(part)


@needs_cascadio
def test_triangles_of_a_bore_look_at_its_axis(tmp_path: Path) -> None:
    """The normals of a bore point away from the material, towards its axis."""
    part = load(written(tmp_path, bored_block()))
    index = next(k for k, face in enumerate(part.cad.faces) if face.kind is SurfaceKind.CYLINDER)
    own = part.cad.of_triangle == index
    middle = part.reference.vertices[part.reference.faces[own]].mean(axis=1)
    to_axis = np.array([0.030, 0.020]) - middle[:, :2]
    facing = np.einsum("fj,fj->f", part.reference.normals[own, :2], to_axis)
    assert (facing > 0.99 * np.linalg.norm(to_axis, axis=1)).all()
    assert part.cad.areas(part.reference)[index] == pytest.approx(2 * math.pi * 8 * 30 * 1e-6, rel=2e-3)


@needs_cascadio
def test_a_sheet_outside_the_solids_is_left_out_and_reported(tmp_path: Path) -> None:
    """A sheet outside the solids is left out and reported. The faces of two solids are numbered consecutively."""
    file = StepFile()
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    file.block((80, 0, 0), (100, 20, 20), None)
    file.open_sheet((500, 500, 0), 10)
    part = load(written(tmp_path, file.text()))
    assert part.size == pytest.approx([0.1, 0.04, 0.03], abs=1e-7)
    assert [finding.kind for finding in part.findings] == [Kind.NO_SOLID, Kind.BODIES]
    assert "100 mm²" in part.findings[0].sentence
    assert part.cad.counts() == {"plane": 12, "cylinder": 1}
    assert sorted({face.number for face in part.cad.faces}) == list(range(1, 14))
    check_faces(part)


@needs_cascadio
@pytest.mark.parametrize(
    ("edge", "is_first"),
    [
        pytest.param(edge, is_first, marks=() if is_first == (k != 1) else pytest.mark.slow)
        for k, edge in enumerate([[(0, 40, 30)], [(0, -20, 30)], [(5, 3, 30), (0, 0, 30)]])
        for is_first in (False, True)
    ],
)
def test_a_sheet_that_touches_the_solid_does_not_open_it(
    tmp_path: Path, edge: list[tuple[float, float, float]], is_first: bool
) -> None:
    """A copy of the top face, a flap at its edge, and a triangle on it are left out: the solid is closed."""
    file = StepFile()
    y = edge[0][1]
    corners = [(0.0, 0.0, 30.0), (60.0, 0.0, 30.0), (60.0, y, 30.0), (0.0, y, 30.0)] if len(edge) == 1 else edge
    corners = [*corners, (60.0, 40.0, 30.0)] if len(edge) == 2 else corners
    if is_first:
        file.solids.append(file.sheet_on(*corners))
        file.block((0, 0, 0), (60, 40, 30), None)
    else:
        file.block((0, 0, 0), (60, 40, 30), None)
        file.solids.append(file.sheet_on(*corners))
    part = load(written(tmp_path, file.text()))
    assert [finding.kind for finding in part.findings] == [Kind.NO_SOLID]
    assert part.cad.counts() == {"plane": 6}
    assert part.reference.areas.sum() == pytest.approx(10_800e-6)
    assert volume(part) == pytest.approx(72_000e-9)


@needs_cascadio
def test_the_tessellated_copy_of_a_solid_is_no_second_body(tmp_path: Path) -> None:
    """A file can have both forms of a part; triangles alone are read, too."""
    file = StepFile()
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    file.others.append(
        ("TESSELLATED_SHAPE_REPRESENTATION", file.tessellated_block((60, 40, 30), file.solids[0]), "copy")
    )
    part = load(written(tmp_path, file.text()))
    assert (part.findings, part.cad.counts()) == ((), {"plane": 6, "cylinder": 1})
    file = StepFile()
    file.solids.append(file.tessellated_block((60, 40, 30)))
    part = load(written(tmp_path, file.text()))
    assert (part.findings, volume(part)) == ((), pytest.approx(72_000e-9))


def faces_of(file: StepFile) -> list[str]:
    """Return the references of the faces so far, in the order of the file."""
    return [f"#{k + 1}" for k, line in enumerate(file.lines) if line.startswith("ADVANCED_FACE")]


@needs_cascadio
@pytest.mark.parametrize("coloured", [[0], [2, 6], range(7)])
def test_colours_of_faces_change_neither_numbers_nor_kinds(tmp_path: Path, coloured: list[int]) -> None:
    """A solid with coloured faces is one solid with all its faces."""
    plain, part = [None, None]
    for number, faces in enumerate(([], coloured)):
        file = StepFile()
        file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
        file.block((80, 0, 0), (100, 20, 20), None)
        grey = [(file.solids[0], (0.9, 0.9, 0.9))] if faces else []
        file.colours += [*grey, *((faces_of(file)[k], (1.0 - 0.1 * k, 0.0, 0.0)) for k in faces)]
        plain, part = part, load(written(tmp_path, file.text(), f"{number}.stp"))
    assert (part.cad.counts(), part.findings) == ({"plane": 12, "cylinder": 1}, plain.findings)
    assert part.cad.areas(part.reference) == pytest.approx(plain.cad.areas(plain.reference))
    check_faces(part)


@needs_cascadio
def test_a_face_to_which_an_annotation_refers_is_no_second_surface(tmp_path: Path) -> None:
    """Faces of a solid can be items of another representation, too."""
    file = StepFile()
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    file.others.append(("SHAPE_REPRESENTATION", faces_of(file)[-1], "callout"))
    part = load(written(tmp_path, file.text()))
    assert (part.cad.counts(), part.findings) == ({"plane": 6, "cylinder": 1}, ())


@needs_cascadio
def test_a_solid_with_a_missing_face_is_read_beside_a_closed_one(tmp_path: Path) -> None:
    """Both solids are the part, and the gap is reported."""
    file = StepFile()
    file.block((0, 0, 0), (60, 40, 30), None)
    file.block((80, 0, 0), (100, 20, 20), None)
    text = file.text().replace(f"{faces_of(file)[-1]}))", "))").replace(",))", "))")
    part = load(written(tmp_path, text))
    assert part.size == pytest.approx([0.1, 0.04, 0.03], abs=1e-7)
    assert part.cad.counts() == {"plane": 11}
    assert part.reference.areas.sum() == pytest.approx(10_800e-6 + 5 * 400e-6)
    assert part.findings[0].kind == Kind.GAPS
    assert "surface of 2000 mm²" in part.findings[0].sentence


@needs_cascadio
def test_parts_in_other_files_are_named(tmp_path: Path) -> None:
    """An assembly without its parts is refused; what is missing beside a solid is a warning."""
    file = StepFile()
    file.add("DOCUMENT_FILE('bolt.stp','','',$,'',$)")
    file.add("DOCUMENT_FILE('drawing.pdf','','',$,'',$)")
    with pytest.raises(FileError, match=r"its parts are in other files \(bolt.stp\)"):
        load(written(tmp_path, file.text()))
    file.block((0, 0, 0), (60, 40, 30), None)
    part = load(written(tmp_path, file.text()))
    assert [finding.kind for finding in part.findings] == [Kind.OTHER_FILES]
    assert part.findings[0].sentence.startswith("parts in other files are missing (bolt.stp)")


@needs_cascadio
@pytest.mark.parametrize("radius", [1.0, 8.0, 50.0])
def test_round_parts_have_their_volume_within_a_thousandth(tmp_path: Path, radius: float) -> None:
    """A cylinder of any size is triangulated finer until its volume is right."""
    file = StepFile()
    file.cylinder(radius, 30)
    part = load(written(tmp_path, file.text()))
    assert volume(part) == pytest.approx(math.pi * radius**2 * 30e-9, rel=MAX_VOLUME_ERROR)
    assert part.findings == ()
    check_faces(part)


@needs_cascadio
def test_a_volume_that_is_not_reached_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With an unreachable limit, the difference is stated in percent."""
    monkeypatch.setattr(cad, "MAX_VOLUME_ERROR", 1e-9)
    file = StepFile()
    file.cylinder(50, 3)
    part = load(written(tmp_path, file.text()))
    assert [finding.kind for finding in part.findings] == [Kind.COARSE]
    assert re.search(r"by 0\.00\d+ % of the volume", part.findings[0].sentence)


@needs_cascadio
def test_surfaces_alone_are_used_and_reported_as_open(tmp_path: Path) -> None:
    """A file without solids gives its surfaces, which are reported as open."""
    file = StepFile()
    file.open_sheet((0, 0, 0), 50)
    part = load(written(tmp_path, file.text()))
    assert part.cad.counts() == {"plane": 1}
    assert Kind.OPEN in [finding.kind for finding in part.findings]


@needs_cascadio
@pytest.mark.parametrize(
    ("content", "output"),
    [
        ("solid x\n", "is not a STEP file"),
        ("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n", "no surface"),
        (bored_block()[:3000], "is cut short"),
    ],
    ids=["another format", "empty", "cut short"],
)
def test_broken_files_are_one_sentence(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: str, output: str
) -> None:
    """An unreadable file gives one sentence with a cure; the output of Open CASCADE is discarded."""
    with pytest.raises(FileError, match=output):
        load(written(tmp_path, content))
    assert capfd.readouterr() == ("", "")


def test_without_cascadio_the_message_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The optional dependency is named with its extra."""
    monkeypatch.setitem(sys.modules, "cascadio", None)
    with pytest.raises(FileError, match=r"pip install 'scan-cell\[step\]'"):
        load(written(tmp_path, bored_block()))


def test_units_are_the_files(tmp_path: Path) -> None:
    """Units for a STEP file that states its unit are refused. The scene sets metres by itself."""
    path = written(tmp_path, bored_block())
    with pytest.raises(UsageError, match="states its own unit"):
        load(path, "mm")
    assert load_scene(None, {"part": {"path": str(path)}}).part.units == "m"


@needs_cascadio
def test_a_file_without_a_unit_asks_for_it(tmp_path: Path) -> None:
    """Its numbers are read in the given unit, faces included."""
    text = re.sub(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\([^)]*\)\)", "", bored_block())
    path = written(tmp_path, text)
    with pytest.raises(UsageError, match="does not state its unit; give the units"):
        load(path)
    part = load(path, "in")
    assert part.size == pytest.approx(np.array([60, 40, 30]) * 0.0254, rel=1e-6)
    bore = next(face for face in part.cad.faces if face.kind is SurfaceKind.CYLINDER)
    assert bore.radius == pytest.approx(8 * 0.0254, rel=1e-9)
    check_faces(part)


@needs_cascadio
def test_a_fixture_has_the_unit_of_its_file_or_else_the_given_one(tmp_path: Path) -> None:
    """A second unit is refused: a fixture in millimetres would be a thousandth of its size."""
    text, size = bored_block(), np.array([60, 40, 30]) / 1000
    stated = written(tmp_path, text)
    silent = written(tmp_path, re.sub(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\([^)]*\)\)", "", text), "silent.stp")

    def fixture(path: Path, units: Units) -> np.ndarray:
        vice = MeshFixture(name="vice", shape="mesh", path=str(path), units=units)
        return np.ptp(fixture_mesh(vice).vertices, axis=0)

    assert fixture(stated, "m") == pytest.approx(size, rel=1e-6)
    assert fixture(silent, "mm") == pytest.approx(size, rel=1e-6)
    assert fixture(silent, "in") == pytest.approx(25.4 * size, rel=1e-6)
    with pytest.raises(UsageError, match="states its own unit"):
        fixture(stated, "mm")
    with pytest.raises(UsageError, match="does not state its unit"):
        fixture(silent, "m")


@needs_cascadio
def test_a_unit_of_length_outside_the_context_is_no_unit(tmp_path: Path) -> None:
    """A context of angles only does not state the unit."""
    text = re.sub(r"(GLOBAL_UNIT_ASSIGNED_CONTEXT\(\()#\d+,", r"\1", bored_block())
    with pytest.raises(UsageError, match="does not state its unit"):
        load(written(tmp_path, text))


@needs_cascadio
def test_a_byte_order_mark_is_no_part_of_the_file(tmp_path: Path) -> None:
    """A mark of UTF-8 before the file changes nothing."""
    assert load(written(tmp_path, "\ufeff" + bored_block())).cad.counts() == {"plane": 6, "cylinder": 1}


@needs_cascadio
@pytest.mark.parametrize("by_layer", [False, True])
def test_hidden_bodies_are_left_out_and_reported(tmp_path: Path, by_layer: bool) -> None:
    """A solid that the CAD program hides, itself or by its layer, is not measured."""
    file = StepFile()
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    file.block((80, 0, 0), (100, 20, 20), None)
    hidden = file.solids[1]
    item = file.add(f"STYLED_ITEM('',(),{hidden})")
    if by_layer:
        item = file.add(f"PRESENTATION_LAYER_ASSIGNMENT('off','',({item}))")
    file.add(f"INVISIBILITY(({item}))")
    part = load(written(tmp_path, file.text()))
    assert part.size == pytest.approx([0.06, 0.04, 0.03], abs=1e-7)
    assert "1 hidden body is left out" in part.findings[0].sentence


@needs_cascadio
@pytest.mark.parametrize("name", ["part (1)", "a;b", "it''s (2", "(1,2);#3", "/* x", "\\X2\\96F64EF6\\X0\\ (1)"])
def test_names_can_be_any_text(tmp_path: Path, name: str) -> None:
    """Brackets and semicolons in names separate nothing: a hidden solid and a sheet are left out."""
    file = StepFile()
    file.add("/* don't; (count) */ DIRECTION('',(0.,0.,1.))")
    file.block((0, 0, 0), (60, 40, 30), (30, 20, 8))
    file.block((80, 0, 0), (100, 20, 20), None)
    hidden = file.solids[1]
    file.solids.append(file.sheet_on((0, 0, 30), (60, 0, 30), (60, 40, 30)))
    item = file.add(f"STYLED_ITEM('',(),{hidden})")
    file.add(f"INVISIBILITY(({item}))")
    text = file.text()
    for entity in ("STYLED_ITEM('", "MANIFOLD_SOLID_BREP('", "SHAPE_REPRESENTATION('", "SHELL('"):
        text = text.replace(entity, entity + name)
    part = load(written(tmp_path, text))
    assert [finding.kind for finding in part.findings] == [Kind.HIDDEN, Kind.NO_SOLID]
    assert part.cad.counts() == {"plane": 6, "cylinder": 1}


@needs_cascadio
def test_a_file_that_crashes_open_cascade_is_refused(tmp_path: Path) -> None:
    """The crash ends a child process only."""
    text = bored_block().replace(
        "ENDSEC;\nEND-ISO", "#99999=POINT(" + "(" * 500_000 + ")" * 500_000 + ");\nENDSEC;\nEND-ISO"
    )
    with pytest.raises(FileError, match=r"makes Open CASCADE fail|no surface"):
        load(written(tmp_path, text))


def test_faces_are_placed_by_their_node() -> None:
    """Points and axes of a face are transformed by its node; a spline has no parameters."""
    T = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    torus = {"type": "torus", "center": [1, 0, 0], "axis": [1, 0, 0], "major_radius": 0.2, "minor_radius": 0.05}
    face = cad_face(7, torus, T)
    assert (face.number, face.kind, face.radius, face.centre_radius) == (7, SurfaceKind.TORUS, 0.05, 0.2)
    assert face.point == pytest.approx([1, 3, 3])
    assert face.axis == pytest.approx([0, 1, 0])
    cone = cad_face(1, {"type": "cone", "apex": [0, 0, 0], "axis": [0, 0, 1], "semi_angle": -0.5}, np.eye(4))
    assert cone.half_angle == 0.5
    assert cad_face(2, {}, T).kind is SurfaceKind.OTHER
