"""Loading, checking and scaling of a part: every format, and one sentence for every problem."""

import contextlib
import hashlib
import itertools
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from cell.errors import CellError, FileError, UsageError
from cell.part.description import volume as described_volume
from cell.part.workpiece import UNITS, Kind, Severity, Workpiece, from_arrays, from_mesh, load
from cell.scene.model import Scene


def body() -> trimesh.Trimesh:
    """Return a closed, asymmetric shape off the origin, in millimetres."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=50.0)
    mesh.vertices = mesh.vertices * [1.0, 0.6, 0.8] + [100.0, -20.0, 30.0]
    return mesh


def write(folder: Path, mesh: trimesh.Trimesh, name: str = "part.stl") -> Path:
    """Write the mesh to a file of the format of its name."""
    path = folder / name
    content = mesh.export(file_type=path.suffix[1:].lower())
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def volume(part: Workpiece) -> float:
    """Return the signed volume [m^3]."""
    corners = part.reference.vertices[part.reference.faces]
    return float(np.einsum("fj,fj->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def kinds(part: Workpiece) -> list[Kind]:
    """Return the kinds of the findings."""
    return [finding.kind for finding in part.findings]


def checked(mesh: trimesh.Trimesh) -> Workpiece:
    """Return the part of a mesh in millimetres."""
    return from_mesh("part", np.array(mesh.vertices), np.array(mesh.faces), "mm", "")


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off", ".glb", ".STL"])
def test_every_format_gives_the_same_part(tmp_path: Path, suffix: str) -> None:
    """Faces, closedness, volume and bounds are equal in each format, and a valid mesh has no finding."""
    mesh = body()
    part = load(write(tmp_path, mesh, f"part{suffix}"), "mm")
    assert part.findings == ()
    assert len(part.reference.faces) == len(mesh.faces)
    assert len(part.reference.vertices) == len(mesh.vertices)
    assert volume(part) == pytest.approx(mesh.volume * 1e-9, rel=1e-5)
    assert part.bounds == pytest.approx(mesh.bounds * 1e-3, abs=1e-7)
    assert part.name == "part"


def test_ascii_and_binary_stl_are_the_same_part(tmp_path: Path) -> None:
    """The two dialects differ by the rounding of the text only."""
    binary = load(write(tmp_path, body(), "binary.stl"), "mm")
    text = load(_ascii(tmp_path), "mm")
    assert len(text.reference.faces) == len(binary.reference.faces)
    assert text.bounds == pytest.approx(binary.bounds, abs=1e-8)
    assert text.findings == ()


def _ascii(folder: Path) -> Path:
    path = folder / "ascii.stl"
    path.write_text(body().export(file_type="stl_ascii"))
    return path


def test_a_binary_stl_that_starts_with_solid_is_binary(tmp_path: Path) -> None:
    """Many programs write the ASCII keyword into the binary header; the size decides."""
    path = write(tmp_path, body())
    path.write_bytes(b"solid facet vertex".ljust(80) + path.read_bytes()[80:])
    assert len(load(path, "mm").reference.faces) == len(body().faces)


def test_the_object_frame_is_the_files_own(tmp_path: Path) -> None:
    """The part is scaled and not moved; its centre is the middle of its bounding box; the hash is the file's."""
    path = write(tmp_path, body())
    part = load(path, "mm")
    assert part.centre == pytest.approx([0.1, -0.02, 0.03], abs=1e-6)
    assert part.T_object_centre[:3, 3] == pytest.approx(part.centre, abs=0)
    assert (part.T_object_centre[:3, :3] == np.eye(3)).all()
    assert part.size == pytest.approx([0.1, 0.06, 0.08], rel=1e-2)
    assert part.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("units", list(UNITS))
def test_units_scale_exactly(tmp_path: Path, units: str) -> None:
    """Each length is multiplied by the unit in metres."""
    part = load(write(tmp_path, body(), "part.ply"), units)
    assert np.ptp(part.bounds, axis=0) == pytest.approx(np.ptp(body().bounds, axis=0) * UNITS[units], rel=1e-6)


def test_a_glb_scene_is_flattened(tmp_path: Path) -> None:
    """Two nodes of one box, one moved and one mirrored, become one part of two bodies, both outward."""
    scene = trimesh.Scene()
    box = trimesh.creation.box(extents=(10, 20, 30))
    scene.add_geometry(box, node_name="a", geom_name="box")
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[0, 3] = 50
    scene.add_geometry(box, node_name="b", geom_name="box", transform=mirror)
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    part = load(path, "mm")
    assert kinds(part) == [Kind.BODIES]
    assert volume(part) == pytest.approx(2 * 6000e-9, rel=1e-6)
    assert part.size == pytest.approx([0.06, 0.02, 0.03], rel=1e-6)


def test_a_built_in_part_needs_no_units(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A built-in part is loaded by its name, and units are refused."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    part = load("mug")
    assert part.name == "mug"
    assert part.size == pytest.approx([0.06, 0.05, 0.047], abs=1e-9)
    assert part.findings == ()
    assert len(part.sha256) == 64
    with pytest.raises(UsageError, match="omit --units"):
        load("mug", "mm")


def test_missing_units_are_refused(tmp_path: Path) -> None:
    """Units are not guessed; the message names the option and the valid units."""
    with pytest.raises(UsageError, match="give --units with one of m, cm, mm, um, in"):
        load(write(tmp_path, body()))


@pytest.mark.parametrize(("units", "hint"), [("MM", "did you mean 'mm'"), ("furlong", "unknown; Valid are m, cm")])
def test_unknown_units_are_refused_with_the_known(tmp_path: Path, units: str, hint: str) -> None:
    """The message lists the valid units and suggests the nearest."""
    with pytest.raises(UsageError, match=hint):
        load(write(tmp_path, body()), units)


def _broken_files(folder: Path) -> dict[str, tuple[str, bytes, str]]:
    """Return name, content and expected error of files that cannot be loaded."""
    content = write(folder, body()).read_bytes()
    text = _ascii(folder).read_text()
    return {
        "empty": ("x.stl", b"", "is empty"),
        "text named stl": ("x.stl", b"Dear Sir, enclosed find the drawing.\n" * 40, "is a text file, not an STL"),
        "short text named stl": ("x.stl", b"hello", "is a text file, not an STL mesh"),
        "truncated binary": ("x.stl", content[:5000], r"announces 1280 faces .64084 bytes. but has 5000"),
        "truncated ascii": ("x.stl", text[: len(text) // 2 - 7].encode(), "its last facet is not complete"),
        "header only": ("x.stl", content[:84], "is cut short"),
        "no faces stl": ("x.stl", b"\0" * 84, "holds no faces"),
        "nan stl": ("x.stl", content[:96] + struct.pack("<f", float("nan")) + content[100:], "1 vertices whose"),
        "inf ply": ("x.ply", b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                    b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
                    b"0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n", "NaN or infinity[)], first at vertex 2"),
        "points only": ("x.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
                        b"property float z\nend_header\n0 0 0\n", "holds no faces"),
        "truncated ply": ("x.ply", write(folder, body(), "y.ply").read_bytes()[:3000], "is cut short"),
        "text named ply": ("x.ply", b"hello\n" * 30, "is not a PLY file"),
        "text named obj": ("x.obj", b"hello\n" * 30, "holds no faces"),
        "bad index": ("x.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "OBJ|refers to vertex"),
        "two coordinates": ("x.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "fewer than three coordinates"),
        "text named off": ("x.off", b"hello\n" * 30, "where a number is expected, line 1|does not announce"),
        "truncated off": ("x.off", write(folder, body(), "y.off").read_bytes()[:900], "announces .* rows"),
        "text named glb": ("x.glb", b"hello\n" * 30, "is not a binary glTF file"),
        "truncated glb": ("x.glb", write(folder, body(), "y.glb").read_bytes()[:2000], "is cut short"),
        "iges": ("x.igs", b"S      1", "'.igs', which is not supported; supported are .stl, .obj"),
        "no suffix": ("x.", b"hello", "not supported"),
        "zero area": ("x.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n", "every face of x has zero area"),
    }  # fmt: skip


def test_a_broken_file_is_refused_in_one_sentence(tmp_path: Path) -> None:
    """Each broken file raises FileError (exit code 6) with one line that names the file and the remedy."""
    for case, (name, content, sentence) in _broken_files(tmp_path).items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=sentence) as caught:
            load(tmp_path / name, "mm")
        message = str(caught.value)
        assert ("\n" in message, "x" in message, len(message) < 400) == (False, True, True), case
        assert caught.value.exit_code == 6


def test_missing_files_are_reported(tmp_path: Path) -> None:
    """A missing file, a folder and a misspelt built-in name have one message each."""
    with pytest.raises(FileError, match="does not exist"):
        load(tmp_path / "none.stl", "mm")
    with pytest.raises(FileError, match="is a folder"):
        load(tmp_path, "mm")
    with pytest.raises(FileError, match="did you mean 'mseke'"):
        load("msekke")
    with pytest.raises(FileError, match="Built in are mseke, mug"):
        load("teapot", "mm")


def test_a_refusal_of_the_system_becomes_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Permission and disk errors during reading are reported in one sentence, for any user of the test."""
    path = write(tmp_path, body())

    def refuse(error: OSError) -> None:
        def read(_: Path) -> bytes:
            raise error

        monkeypatch.setattr(Path, "read_bytes", read)

    refuse(PermissionError(13, "Permission denied"))
    with pytest.raises(FileError, match="permission denied"):
        load(path, "mm")
    refuse(OSError(5, "Input/output error"))
    with pytest.raises(FileError, match="Input/output error"):
        load(path, "mm")


def test_every_error_is_the_users(tmp_path: Path) -> None:
    """A randomly damaged file of each format is loaded or raises a CellError."""
    rng = np.random.default_rng(11)
    small = trimesh.creation.icosphere(subdivisions=1, radius=30.0)
    for suffix, _ in itertools.product((".stl", ".obj", ".ply", ".off", ".glb"), range(25)):
        content = bytearray(write(tmp_path, small, f"good{suffix}").read_bytes())
        for position in rng.integers(0, len(content), rng.integers(1, 20)):
            content[position] = rng.integers(0, 256)
        path = tmp_path / f"bad{suffix}"
        path.write_bytes(bytes(content[: rng.integers(1, len(content) + 1)] if rng.random() < 0.4 else content))
        with contextlib.suppress(CellError):
            assert np.isfinite(load(path, "mm").bounds).all()


def test_an_inverted_body_is_turned_round() -> None:
    """A body with negative volume is flipped, and the change is reported."""
    mesh = body()
    mesh.invert()
    part = checked(mesh)
    assert volume(part) == pytest.approx(body().volume * 1e-9, rel=1e-9)
    assert kinds(part) == [Kind.INVERTED]
    assert "inside out" in part.findings[0].sentence


def test_mixed_winding_is_made_consistent() -> None:
    """With a third of the faces flipped, the message has their number and the volume is restored."""
    mesh = body()
    faces = np.array(mesh.faces)
    turned = np.random.default_rng(0).random(len(faces)) < 0.33
    faces[turned] = faces[turned][:, ::-1]
    part = from_mesh("part", np.array(mesh.vertices), faces, "mm", "")
    assert kinds(part) == [Kind.MIXED_WINDING]
    assert part.findings[0].sentence.startswith(f"{turned.sum()} faces were of opposite winding")
    assert volume(part) == pytest.approx(body().volume * 1e-9, rel=1e-9)


def test_mixed_winding_with_most_faces_inward_ends_outward() -> None:
    """With two thirds flipped, the winding follows the majority, and then the body is flipped."""
    faces = np.array(body().faces)
    turned = np.random.default_rng(0).random(len(faces)) < 0.67
    faces[turned] = faces[turned][:, ::-1]
    part = from_mesh("part", np.array(body().vertices), faces, "mm", "")
    assert kinds(part) == [Kind.MIXED_WINDING, Kind.INVERTED]
    assert volume(part) == pytest.approx(body().volume * 1e-9, rel=1e-9)


def test_an_open_surface_keeps_its_winding_and_is_reported() -> None:
    """Half a sphere gives a warning with the number of border edges, and no face is flipped."""
    mesh = body()
    is_upper = mesh.triangles_center[:, 2] > 30.0
    faces = np.array(mesh.faces)[is_upper]
    part = from_mesh("part", np.array(mesh.vertices), faces, "mm", "")
    assert kinds(part) == [Kind.OPEN]
    assert part.findings[0].severity is Severity.WARNING
    border = len(trimesh.Trimesh(mesh.vertices, faces).outline().entities[0].points) - 1
    assert f"({border} border edges)" in part.findings[0].sentence
    assert len(part.reference.faces) == is_upper.sum()


def test_an_open_surface_that_is_inside_out_is_doubted_not_changed() -> None:
    """An inverted sphere with one missing face is not changed, and a warning is reported."""
    faces = np.array(body().faces)[1:, ::-1]
    part = from_mesh("part", np.array(body().vertices), faces, "mm", "")
    assert kinds(part) == [Kind.OPEN, Kind.INVERTED]
    assert volume(part) < 0
    assert "seems to be inside out" in part.findings[1].sentence


def test_zero_area_and_duplicate_faces_are_dropped_and_counted() -> None:
    """Dropped faces are counted, and the area is unchanged."""
    mesh = body()
    faces = np.array(mesh.faces)
    dirty = np.vstack([faces, [[0, 0, 1], [5, 5, 5]], faces[:3, [1, 2, 0]], faces[7:8, ::-1]])
    part = from_mesh("part", np.array(mesh.vertices), dirty, "mm", "")
    assert [finding.sentence for finding in part.findings] == [
        "2 faces have no area and were dropped",
        "4 faces were duplicated; the copies were dropped",
    ]
    assert part.reference.areas.sum() == pytest.approx(mesh.area * 1e-6, rel=1e-9)


def test_a_sliver_that_joins_its_neighbours_does_not_open_the_surface() -> None:
    """A face of three corners on a line has no area, but the surface around it is closed."""
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 0, 0]], float) * 10
    faces = np.array([[0, 2, 1], [0, 4, 3], [4, 1, 3], [1, 2, 3], [0, 3, 2], [0, 1, 4]])
    part = from_mesh("part", vertices, faces, "mm", "")
    assert kinds(part) == [Kind.ZERO_AREA]
    assert len(part.reference.faces) == 5


def test_a_void_inside_a_body_stays_a_void() -> None:
    """The inner shell of a hollow ball keeps its negative volume; an inverted hollow ball is flipped completely."""
    outer, inner = trimesh.creation.icosphere(subdivisions=2, radius=50.0), trimesh.creation.icosphere(radius=20.0)
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    part = checked(hollow)
    assert kinds(part) == [Kind.BODIES]
    assert volume(part) == pytest.approx(hollow.volume * 1e-9, rel=1e-9)
    hollow.invert()
    turned = checked(hollow)
    assert kinds(turned) == [Kind.INVERTED, Kind.BODIES]
    assert volume(turned) == pytest.approx(volume(part), rel=1e-9)


def test_several_bodies_are_counted_and_each_is_turned_outward() -> None:
    """One of three balls is inverted; it is flipped and the bodies are counted."""
    balls = [trimesh.creation.icosphere(subdivisions=2, radius=20.0) for _ in range(3)]
    for i, ball in enumerate(balls):
        ball.apply_translation([60.0 * i, 0, 0])
    balls[1].invert()
    part = checked(trimesh.util.concatenate(balls))
    assert [finding.sentence for finding in part.findings] == [
        "1 body was inside out (negative volume) and flipped",
        "the mesh consists of 3 separate bodies; all of them are scanned as one part",
    ]
    assert volume(part) == pytest.approx(3 * balls[0].volume * 1e-9, rel=1e-9)


def test_a_one_sided_surface_is_reported() -> None:
    """A Moebius strip is reported as one-sided and is still usable."""
    n = 40
    angle = np.arange(n) * 2 * np.pi / n
    rim = []
    for side in (-1, 1):
        radius = 50 + side * 10 * np.cos(angle / 2)
        rim.append(np.stack([radius * np.cos(angle), radius * np.sin(angle), side * 10 * np.sin(angle / 2)], axis=1))
    vertices = np.vstack(rim)
    i = np.arange(n)
    after = (i + 1) % n
    low, high, low_after, high_after = i, i + n, np.where(after == 0, n, after), np.where(after == 0, 0, after + n)
    faces = np.vstack([np.stack([low, low_after, high], 1), np.stack([high, low_after, high_after], 1)])
    part = from_mesh("strip", vertices, faces, "mm", "")
    assert Kind.ONE_SIDED in kinds(part)


def test_edges_of_more_than_two_faces_are_reported() -> None:
    """Two tetrahedra with a common edge are reported as non-manifold."""
    vertices = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 30], [0, -30, 0], [0, 0, -30]], float)
    one = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    two = [[0, 4, 1], [0, 1, 5], [1, 4, 5], [0, 5, 4]]
    part = from_mesh("part", vertices, np.array(one + two), "mm", "")
    assert Kind.NON_MANIFOLD in kinds(part)


@pytest.mark.parametrize(
    ("size_mm", "units", "sentence"),
    [
        (200, "um", "the part is 0.2 mm long; check the units (um). It would be 200 mm in mm."),
        (200, "m", "the part is 200 m long; check the units (m). It would be 200 mm in mm."),
        (0.2, "mm", "the part is 0.2 mm long; check the units (mm). It would be 200 mm in m."),
    ],
)
def test_implausible_units_are_doubted(size_mm: float, units: str, sentence: str) -> None:
    """The warning names the length and a plausible unit, and the part keeps the given unit."""
    ball = trimesh.creation.box(extents=(size_mm,) * 3)
    part = from_mesh("part", np.array(ball.vertices), np.array(ball.faces), units, "")
    assert [(finding.kind, finding.severity) for finding in part.findings] == [(Kind.UNITS, Severity.WARNING)]
    assert part.findings[0].sentence.startswith(sentence.split(" It would")[0])
    assert sentence.split("It would be ")[1].rstrip(".") in part.findings[0].sentence


@pytest.mark.parametrize("size_mm", [20, 60, 223, 1500])
def test_plausible_sizes_are_not_doubted(size_mm: float) -> None:
    """Parts of usual sizes give no warning."""
    assert checked(trimesh.creation.box(extents=(size_mm,) * 3)).findings == ()


def test_a_flat_part_is_reported() -> None:
    """A sheet without thickness is reported as open and flat."""
    vertices = np.array([[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]], float)
    part = from_mesh("sheet", vertices, np.array([[0, 1, 2], [0, 2, 3]]), "mm", "")
    assert kinds(part) == [Kind.OPEN, Kind.FLAT]


def test_values_are_read_only(tmp_path: Path) -> None:
    """The arrays of a loaded part are read-only."""
    part = load(write(tmp_path, body()), "mm")
    for array in (part.reference.vertices, part.reference.faces, part.bounds, part.centre, part.T_object_centre):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_glb_without_units_is_in_metres(tmp_path: Path) -> None:
    """A GLB without units is in metres, as glTF defines, as a part and as a fixture. Given units take precedence."""
    path = tmp_path / "cube.glb"
    trimesh.creation.box((0.1, 0.1, 0.1)).export(path)
    assert load(path).size == pytest.approx(0.1)
    assert load(path, "cm").size == pytest.approx(0.001)
    vice = {"name": "vice", "shape": "mesh", "path": str(path)}
    scene = Scene.model_validate(
        {"part": {"path": str(path)}, "fixtures": [vice, {**vice, "name": "two", "units": "in"}]}
    )
    assert [scene.part.units, *(fixture.units for fixture in scene.fixtures)] == ["m", "m", "in"]


@pytest.mark.parametrize(
    ("faces", "sentence"),
    [
        ([[0, 1, 2], [0, -1, 2]], r"refers to vertex -1 \(counted from 0\), but there are 4"),
        ([[0, 1, 2], [0, 1, 4]], "refers to vertex 4 "),
        ([[0, 1, 2, 3], [3, 2, 1, 0], [0, 2, 1, 3]], "faces do not have three corners"),
        ([], "holds no faces"),
    ],
)
def test_arrays_that_are_no_triangles_are_refused(faces: list[list[int]], sentence: str) -> None:
    """A mesh in memory has the checks of a file; the message has the wrong index."""
    vertices = 100 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    with pytest.raises(FileError, match=sentence):
        from_arrays("mesh", vertices, np.array(faces), "mm")


def test_a_fixture_of_a_file_with_a_unit_has_no_other(tmp_path: Path) -> None:
    """Units of a 3MF are refused by the scene, as those of a part."""
    path = tmp_path / "vice.3mf"
    path.write_bytes(b"PK")
    vice = {"name": "vice", "shape": "mesh", "path": str(path)}
    assert [each.units for each in Scene.model_validate({"fixtures": [vice]}).fixtures] == ["m"]
    with pytest.raises(ValidationError, match="states its own unit; omit the units"):
        Scene.model_validate({"fixtures": [{**vice, "units": "mm"}]})


def test_the_volume_of_a_part_far_from_its_origin_keeps_its_digits(tmp_path: Path) -> None:
    """A part 10 km from the origin of its file has the volume of the same part at the origin."""
    far = body()
    far.vertices += [1e7, -1e7, 1e7]
    part = from_mesh("far", np.array(far.vertices), np.array(far.faces), "mm", "")
    assert described_volume(part) == pytest.approx(body().volume * 1e-9, rel=1e-6)


def test_an_edge_of_three_faces_is_counted_once() -> None:
    """The finding counts edges, not their occurrences in faces."""
    vertices = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [0, -100, 0], [0, 0, 100]], dtype=np.float64)
    part = from_mesh("fan", vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]), "mm", "")
    assert any(finding.sentence.startswith("1 edge belongs to more than two faces") for finding in part.findings)
