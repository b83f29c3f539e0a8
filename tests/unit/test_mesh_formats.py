"""Mesh files as programs write them: the surface of the file, or a sentence with the cause and its line."""

import base64
import io
import itertools
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks import generated_files
from cell.errors import FileError
from cell.part.mesh_checks import Kind
from cell.part.mesh_files import parse, read_coloured
from cell.part.workpiece import from_arrays, load
from planner.values import Floats

PROFILE = [(0, 0), (100, 0), (100, 30), (30, 30), (30, 80), (0, 80)]
HEIGHT = 40
AREA, VOLUME = 23_400.0, 180_000.0


def prism(shift: float = 0.0) -> tuple[list[tuple[float, float, float]], list[list[int]]]:
    """Return vertices and polygons of an L-shaped prism: two concave caps and six quads."""
    vertices = [(x + shift, y, z) for z in (0, HEIGHT) for x, y in PROFILE]
    sides = [[k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    return vertices, [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *sides]


def measures(path: Path, content: bytes | str) -> tuple[float, float, Floats]:
    """Return area, volume and size of the mesh of a file with this content."""
    content = content.encode() if isinstance(content, str) else content
    path.write_bytes(content)
    vertices, faces = parse(path, content)
    corners = vertices[faces] - vertices.mean(axis=0)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("fj,fj->", corners[:, 0], cross) / 6
    return float(np.linalg.norm(cross, axis=1).sum() / 2), float(volume), np.ptp(vertices, axis=0)


def obj(vertices: list[tuple[float, float, float]], faces: list[list[int]], gap: str = " ") -> str:
    """Return an OBJ text with the separator `gap`."""
    rows = [gap.join(["v", *map(str, vertex)]) for vertex in vertices]
    return "\n".join(rows + [gap.join(["f", *(str(corner + 1) for corner in face)]) for face in faces]) + "\n"


def off(faces: list[list[int]], head: str = "OFF") -> str:
    """Return the prism as OFF."""
    vertices, _ = prism()
    rows = [" ".join(map(str, vertex)) for vertex in vertices] + [" ".join(map(str, [len(f), *f])) for f in faces]
    return "\n".join([head, f"{len(vertices)} {len(faces)} 0", *rows]) + "\n"


def ply(faces: list[list[int]], form: str, comment: bytes = b"comment none", before: str = "") -> bytes:
    """Return the prism as PLY in one of the three forms, optionally with an element before the vertices."""
    vertices, _ = prism()
    header = [b"ply", f"format {form} 1.0".encode(), comment]
    header += [b"element camera 1", b"property float f", b"property list uchar int k"] if before else []
    header += [
        f"element vertex {len(vertices)}".encode(),
        b"property float x",
        b"property double y",
        b"property float z",
    ]
    header += [f"element face {len(faces)}".encode(), b"property list uchar int vertex_indices", b"property uchar q"]
    head = b"\n".join([*header, b"end_header"]) + b"\n"
    if form == "ascii":
        rows = ["2.5 2 7 8"] if before else []
        rows += [" ".join(map(str, vertex)) for vertex in vertices]
        return head + "\n".join(rows + [" ".join(map(str, [len(f), *f, 9])) for f in faces]).encode() + b"\n"
    order = "<" if form == "binary_little_endian" else ">"
    body = struct.pack(f"{order}fB2i", 2.5, 2, 7, 8) if before else b""
    body += b"".join(struct.pack(f"{order}fdf", *vertex) for vertex in vertices)
    return head + body + b"".join(struct.pack(f"{order}B{len(f)}iB", len(f), *f, 9) for f in faces)


@pytest.mark.parametrize("first", range(6))
@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_a_concave_polygon_covers_its_own_surface_only(tmp_path: Path, suffix: str, first: int) -> None:
    """Area and volume are right whatever the first corner of the caps is."""
    vertices, faces = prism()
    faces = [face[first:] + face[:first] if len(face) == 6 else face for face in faces]
    content = {".obj": obj(vertices, faces), ".off": off(faces), ".ply": ply(faces, "ascii")}[suffix]
    area, volume, size = measures(tmp_path / f"l{suffix}", content)
    assert (area, volume) == pytest.approx((AREA, VOLUME), rel=1e-9)
    assert size == pytest.approx([100, 80, HEIGHT])


def test_random_star_shaped_polygons_have_their_area(tmp_path: Path) -> None:
    """The area of 100 concave polygons in random planes is that of the shoelace formula."""
    random = np.random.default_rng(1)
    for number in range(100):
        count = int(random.integers(4, 20))
        angle = (np.arange(count) + random.uniform(0, 0.9, count)) * 2 * np.pi / count
        radius = random.uniform(0.2, 1, count)
        flat = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        x, y = flat.T
        expected = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
        axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        vertices = [tuple(row) for row in (flat @ axes[:2] + random.normal(size=3)).tolist()]
        area, _, _ = measures(tmp_path / f"{number}.obj", obj(vertices, [list(range(count))]))
        assert area == pytest.approx(expected, rel=1e-9)


def test_a_polygon_that_crosses_itself_is_refused(tmp_path: Path) -> None:
    """Its area is ambiguous; the sentence names the face."""
    bow = [(0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]
    with pytest.raises(FileError, match=r"crosses itself \(face 1\)"):
        measures(tmp_path / "bow.obj", obj(bow, [[0, 1, 2, 3]]))


DIALECTS = {
    "tabs": lambda text: text.replace(" ", "\t"),
    "indented": lambda text: "".join(f"  {line}  \n" for line in text.splitlines()),
    "CR LF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "UTF-8 mark": lambda text: "\ufeff" + text,
    "comments": lambda text: "# Prüfstück\n" + text.replace("\n", " # f 1 2 3\n", 3),
    "no last line end": lambda text: text.rstrip("\n"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
@pytest.mark.parametrize("suffix", [".obj", ".off"])
def test_white_space_marks_and_encodings_do_not_change_the_part(
    tmp_path: Path, suffix: str, encoding: str, dialect: str
) -> None:
    """Tabs, indents, line ends, byte order marks and comments in any encoding are read."""
    if dialect == "UTF-8 mark" and encoding != "utf-8":
        pytest.skip("the mark belongs to UTF-8")
    vertices, faces = prism()
    text = DIALECTS[dialect](obj(vertices, faces) if suffix == ".obj" else off(faces))
    area, volume, _ = measures(tmp_path / f"l{suffix}", text.encode(encoding))
    assert (area, volume) == pytest.approx((AREA, VOLUME))


def test_relative_indices_count_back_from_their_face(tmp_path: Path) -> None:
    """Two blocks with indices -12 to -1 are two bodies."""
    blocks = []
    for shift in (0, 200):
        vertices, faces = prism(shift)
        rows = [f"v {x} {y} {z}" for x, y, z in vertices]
        blocks += rows + ["f " + " ".join(f"{corner - 12}//{corner - 12}" for corner in face) for face in faces]
    area, volume, size = measures(tmp_path / "two.obj", "\n".join(blocks))
    assert (area, volume) == pytest.approx((2 * AREA, 2 * VOLUME))
    assert size[0] == pytest.approx(300)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("f 0 1 2", "vertex 0, line 14"),
        ("f 1 2 13", "vertex 13, line 14"),
        ("f -13 1 2", "vertex -13, line 14"),
        ("f 1 2", "2 corners"),
        ("f 1 2 x", "'x' where a number is expected, line 14"),
        ("f 1.5 2 3", "not an integer"),
        ("v 1,5 2,5 3,5", "line 14; decimal commas"),
        ("v 1 2", "fewer than three coordinates, line 14"),
        ("surf 0 1 0 1 1 2 3 4", "free-form surface, line 14"),
    ],
)
def test_a_line_that_is_not_a_surface_is_named(tmp_path: Path, line: str, sentence: str) -> None:
    """The message names the line and the cause."""
    vertices, faces = prism()
    text = obj(vertices, faces[2:3])
    with pytest.raises(FileError, match=sentence):
        measures(tmp_path / "bad.obj", text + line + "\n")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("before", ["", "camera"])
@pytest.mark.parametrize("comment", ["comment Exporté", "comment end_header", "obj_info ü"])
def test_ply_in_every_form(tmp_path: Path, form: str, before: str, comment: str) -> None:
    """Mixed polygons, elements before the vertices, and comments in Latin-1 are read."""
    _, faces = prism()
    content = ply(faces, form, comment.encode("latin-1"), before)
    assert measures(tmp_path / "l.ply", content)[:2] == pytest.approx((AREA, VOLUME))
    assert measures(tmp_path / "l.ply", b"\xef\xbb\xbf" + content)[:2] == pytest.approx((AREA, VOLUME))
    with pytest.raises(FileError, match="cut short"):
        measures(tmp_path / "l.ply", content[:-4])


@pytest.mark.parametrize("faces", ["f 1 2 3\nf /1", "f /1\nf 1 2 3"])
def test_a_face_without_corners_is_named_in_a_coloured_mesh(tmp_path: Path, faces: str) -> None:
    """Colours of vertices have no mean over no corners."""
    rows = [f"v {x} {y} 0 1 0 0" for x, y in ((0, 0), (9, 0), (0, 9))]
    with pytest.raises(FileError, match=r"has a face with 0 corners \(face \d\)"):
        measures(tmp_path / "l.obj", "\n".join([*rows, faces]))


def test_ply_triangle_strips(tmp_path: Path) -> None:
    """A strip of a box side and a restart mark give the triangles with consistent winding."""
    rows = ["0 0 0", "1 0 0", "0 1 0", "1 1 0", "0 2 0", "1 2 0"]
    head = ["ply", "format ascii 1.0", "element vertex 6", *(f"property float {axis}" for axis in "xyz")]
    head += ["element tristrips 1", "property list int int vertex_indices", "end_header"]
    strips = ["1 0", "9 0 1 2 3 -1 2 3 4 5", "0"]
    content = "\n".join([*head, *rows, *strips, ""]).replace("tristrips 1", "tristrips 3")
    (tmp_path / "s.ply").write_text(content)
    vertices, faces = parse(tmp_path / "s.ply", content.encode())
    cross = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    assert len(faces) == 4
    assert cross[:, 2] == pytest.approx(np.ones(4))


@pytest.mark.parametrize("head", ["OFF", "COFF", "off", "OFF # comment"])
def test_off_counts_are_checked(tmp_path: Path, head: str) -> None:
    """Faces with colours are read; a row more or less than announced is refused."""
    _, faces = prism()
    coloured = [[*face] for face in faces]
    text = off(coloured, head)
    assert measures(tmp_path / "l.off", text)[:2] == pytest.approx((AREA, VOLUME))
    with pytest.raises(FileError, match="announces 12 vertices and 8 faces but has 19 rows"):
        measures(tmp_path / "l.off", "\n".join(text.splitlines()[:-1]))
    with pytest.raises(FileError, match="binary OFF"):
        measures(tmp_path / "b.off", b"OFF BINARY\n\0\0\0\x0c")


def test_off_with_line_breaks_elsewhere(tmp_path: Path) -> None:
    """Words count in an OFF file without colours, wherever its lines end; a missing word is refused."""
    head, counts, *rows = off(prism()[1]).splitlines()
    words = " ".join(rows).split()
    for body in ("\n".join(words), " ".join(words), "\n".join(rows).replace("6 7 8 9", "6 7\n\n8 9")):
        assert measures(tmp_path / "l.off", f"{head}\n{counts}\n{body}\n")[:2] == pytest.approx((AREA, VOLUME))
    for wrong in (words[:-1], [*words, "1"], words[:30]):
        with pytest.raises(FileError, match="announces 12 vertices and 8 faces but has"):
            measures(tmp_path / "l.off", "\n".join([head, counts, *wrong]))


@pytest.mark.parametrize("name", ["L", "零件1", "assembly - vertex facet_1", "end loop"])
@pytest.mark.parametrize("encoding", ["utf-8", "gbk", "utf-8-sig", "utf-16"])
def test_ascii_stl_names_and_encodings(tmp_path: Path, name: str, encoding: str) -> None:
    """A name can be any text; byte order marks are no part of it."""
    text = stl(name)
    assert measures(tmp_path / "l.stl", text.encode(encoding))[:2] == pytest.approx((AREA, VOLUME))


def stl(name: str) -> str:
    """Return the prism as ASCII STL, with its caps cut into triangles."""
    vertices, _ = prism()
    rows = [f"solid {name}"]
    for triangle in stl_triangles():
        rows += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x:g} {y:g} {z:g}" for x, y, z in (vertices[k] for k in triangle)),
        ]
        rows += ["endloop", "endfacet"]
    return "\n".join([*rows, f"endsolid {name}", ""])


@pytest.mark.parametrize("vertex", ["vertex 0,000 0,000 0,000", "vertex 0.0, 0.0, 0.0"])
def test_commas_in_an_stl_are_named_with_their_line(tmp_path: Path, vertex: str) -> None:
    """Commas are refused, not guessed."""
    with pytest.raises(FileError, match=r"line 4: .*no commas"):
        measures(tmp_path / "l.stl", stl("L").replace(stl("L").splitlines()[3], vertex, 1))


def gltf(
    node: dict[str, object] | None = None, primitive: dict[str, object] | None = None, **more: object
) -> tuple[dict[str, object], bytes]:
    """Return description and buffer of a triangle (0,0,0) (1,0,0) (0,1,0) with a target and three translations."""
    numbers = [[0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 0, 1] * 3, [0, 0, 0, 2, 0, 0, 4, 0, 0]]
    data = b"".join(struct.pack("<9f", *row) for row in numbers)
    described: dict[str, object] = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [{"buffer": 0, "byteOffset": 36 * k, "byteLength": 36} for k in range(3)],
        "accessors": [{"bufferView": k, "componentType": 5126, "count": 3, "type": "VEC3"} for k in range(3)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, **(primitive or {})}]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "scenes": [{"nodes": [0]}],
        **more,
    }
    return described, data


def glb(described: dict[str, object], data: bytes) -> bytes:
    """Return a binary glTF file."""
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


INSTANCES = {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}}


def test_instances_of_a_glb_are_bodies(tmp_path: Path) -> None:
    """The mesh appears at each translation, whether the extension is required or only used."""
    for more in ({}, {"extensionsRequired": ["EXT_mesh_gpu_instancing"]}):
        area, _, size = measures(tmp_path / "i.glb", glb(*gltf(INSTANCES, **more)))
        assert area == pytest.approx(1.5)
        assert size == pytest.approx([5, 1, 0])


def test_morph_weights_of_a_glb_are_applied(tmp_path: Path) -> None:
    """A weight of 0.5 raises the triangle by half of its target."""
    content = glb(*gltf({"weights": [0.5]}, {"targets": [{"POSITION": 1}]}))
    (tmp_path / "m.glb").write_bytes(content)
    assert parse(tmp_path / "m.glb", content)[0][:, 2] == pytest.approx([0.5] * 3)


def test_a_rotation_of_a_glb_keeps_lengths(tmp_path: Path) -> None:
    """A rounded quaternion turns the triangle without distortion; one of another length is refused."""
    rounded = glb(*gltf({"rotation": [0, 0, 0.707, 0.707]}))  # 90 deg about z
    vertices = parse(tmp_path / "q.glb", rounded)[0]
    assert vertices == pytest.approx(np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0]]), abs=1e-9)
    with pytest.raises(FileError, match="no unit quaternion"):
        parse(tmp_path / "q.glb", glb(*gltf({"rotation": [0, 0, 1, 1]})))


@pytest.mark.parametrize("name", ["KHR_mesh_quantization", "KHR_draco_mesh_compression", "EXT_unknown"])
def test_a_required_extension_that_is_not_supported_is_named(tmp_path: Path, name: str) -> None:
    """The file is refused; extensions of materials are harmless."""
    with pytest.raises(FileError, match=name):
        measures(tmp_path / "r.glb", glb(*gltf(extensionsRequired=[name])))
    assert measures(tmp_path / "k.glb", glb(*gltf(extensionsRequired=["KHR_materials_unlit"])))[0] == pytest.approx(0.5)


def test_the_version_of_a_gltf_is_named(tmp_path: Path) -> None:
    """Version 1 has objects for lists."""
    with pytest.raises(FileError, match=r"is glTF of version 1\.0; supported is version 2"):
        measures(tmp_path / "v.gltf", json.dumps({"asset": {"version": "1.0"}, "buffers": {"b": {}}}))


def test_a_skin_is_refused(tmp_path: Path) -> None:
    """A skeleton would deform the mesh."""
    with pytest.raises(FileError, match="skin"):
        measures(tmp_path / "s.glb", glb(*gltf({"skin": 0})))


def test_gltf_with_its_buffer_beside_it_or_inside(tmp_path: Path) -> None:
    """Both forms give the triangle; a missing buffer and one outside the folder are named."""
    described, data = gltf()
    (tmp_path / "a b.bin").write_bytes(data)
    inside = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    for uri in ("a%20b.bin", inside):
        described["buffers"] = [{"byteLength": len(data), "uri": uri}]
        assert measures(tmp_path / "a.gltf", json.dumps(described))[0] == pytest.approx(0.5)
    for uri, sentence in (
        ("c.bin", "needs c.bin beside it"),
        ("../a.bin", "outside its folder"),
        ("http://x/a", "outside"),
    ):
        described["buffers"] = [{"byteLength": len(data), "uri": uri}]
        with pytest.raises(FileError, match=sentence):
            measures(tmp_path / "a.gltf", json.dumps(described))


def three_mf(path: Path, unit: str, items: str, required: str = "") -> bytes:
    """Return a 3MF file with the triangles of the prism as object 1, and a mirrored copy at x 300 as object 2."""
    vertices, _ = prism()
    triangles = stl_triangles()
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in vertices)
    corners = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles)
    objects = (
        f'<object id="1"><mesh><vertices>{points}</vertices><triangles>{corners}</triangles></mesh></object>'
        '<object id="2"><components><component objectid="1" '
        'transform="-1 0 0 0 1 0 0 0 1 300 0 0"/></components></object>'
    )
    return packed(path, objects, items, f'unit="{unit}" {required}')


def packed(path: Path, objects: str, items: str, attributes: str = "") -> bytes:
    """Write a 3MF file of objects and build items; return its bytes."""
    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    model = (
        f'<?xml version="1.0"?><model xmlns="{core}" {attributes}><resources>{objects}</resources>'
        f"<build>{items}</build></model>"
    )
    relation = 'Target="/3D/m.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"'
    space = 'xmlns="http://schemas.openxmlformats.org/package/2006/relationships"'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", f"<Relationships {space}><Relationship {relation}/></Relationships>")
        archive.writestr("3D/m.model", model)
    return path.read_bytes()


def stl_triangles() -> list[list[int]]:
    """Return the triangles of the prism."""
    _, faces = prism()
    caps = [[5, 4, 3], [5, 3, 0], [0, 3, 2], [0, 2, 1], [6, 8, 9], [6, 7, 8], [6, 9, 11], [9, 10, 11]]
    return caps + [[f[0], f[k], f[k + 1]] for f in faces if len(f) == 4 for k in (1, 2)]


def test_3mf_with_units_components_and_transforms(tmp_path: Path) -> None:
    """The unit of the file scales to metres; a mirrored component keeps its volume."""
    items = '<item objectid="1"/><item objectid="2"/>'
    for unit, metres in (("millimeter", 1e-3), ("inch", 0.0254)):
        area, volume, size = measures(tmp_path / "l.3mf", three_mf(tmp_path / "l.3mf", unit, items))
        assert area == pytest.approx(2 * AREA * metres**2)
        assert volume == pytest.approx(2 * VOLUME * metres**3)
        assert size == pytest.approx(np.array([300, 80, HEIGHT]) * metres)


def test_a_3mf_of_nested_copies_is_refused_before_it_is_expanded(tmp_path: Path) -> None:
    """Ten copies in ten copies, nine deep, are a billion triangles in two kilobytes; seven copies are read."""
    ten = ("".join(10 * [f'<component objectid="{k}"/>']) for k in range(1, 10))
    copies = "".join(f'<object id="{k}"><components>{each}</components></object>' for k, each in enumerate(ten, 2))
    triangle = "<mesh><vertices>{}</vertices><triangles><triangle v1='0' v2='1' v3='2'/></triangles></mesh>".format(
        "".join(f"<vertex x='{x}' y='{y}' z='0'/>" for x, y in ((0, 0), (9, 0), (0, 9)))
    )
    for items, is_refused in (('<item objectid="10"/>', True), (7 * '<item objectid="1"/>', False)):
        content = packed(tmp_path / "l.3mf", f'<object id="1">{triangle}</object>{copies}', items)
        if is_refused:
            with pytest.raises(FileError, match="expands to more triangles than it has bytes"):
                parse(tmp_path / "l.3mf", content)
        else:
            assert len(parse(tmp_path / "l.3mf", content)[1]) == 7


def test_3mf_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    """Required extensions, missing objects and broken archives have a sentence each."""
    path = tmp_path / "l.3mf"
    with pytest.raises(FileError, match="extension 'p'"):
        measures(path, three_mf(path, "inch", '<item objectid="1"/>', 'requiredextensions="p" xmlns:p="x"'))
    with pytest.raises(FileError, match="missing object 7"):
        measures(path, three_mf(path, "inch", '<item objectid="7"/>'))
    with pytest.raises(FileError, match="archive or model is broken"):
        measures(path, b"PK\x03\x04 nothing")


@pytest.mark.parametrize("suffix", [".ply", ".off", ".obj"])
def test_colours_of_concave_polygons(tmp_path: Path, suffix: str) -> None:
    """A painted cap has its own area, not that of a fan."""
    vertices, faces = prism()
    path = tmp_path / f"painted{suffix}"
    red = [[255, 0, 0] if len(face) == 6 else [0, 0, 255] for face in faces]
    if suffix == ".off":
        rows = [" ".join(map(str, vertex)) for vertex in vertices]
        rows += [" ".join(map(str, [len(f), *f, *c])) for f, c in zip(faces, red, strict=True)]
        path.write_text("\n".join(["OFF", "12 8 0", *rows]))
    elif suffix == ".ply":
        head = ["ply", "format ascii 1.0", "element vertex 12", *(f"property float {axis}" for axis in "xyz")]
        head += ["element face 8", "property list uchar int vertex_index"]
        head += [*(f"property uchar {name}" for name in ("red", "green", "blue")), "end_header"]
        rows = [" ".join(map(str, vertex)) for vertex in vertices]
        rows += [" ".join(map(str, [len(f), *f, *c])) for f, c in zip(faces, red, strict=True)]
        path.write_text("\n".join([*head, *rows, ""]))
    else:
        rows, corners = [], itertools.count(1)
        for face, colour in zip(faces, red, strict=True):
            rows += ["v " + " ".join(map(str, [*vertices[k], *colour])) for k in face]
            rows.append("f " + " ".join(str(next(corners)) for _ in face))
        path.write_text("\n".join(rows))
    mesh, colours = read_coloured(path, "mm")
    is_red = (colours == [255, 0, 0]).all(axis=1)
    assert mesh.areas[is_red].sum() * 1e6 == pytest.approx(2 * (100 * 30 + 30 * 50))


def test_generated_files_are_equal_to_their_closed_forms_or_refused_by_name() -> None:
    """Area, volume, bodies and closedness of 160 random files of eight formats; damaged ones name their fault."""
    rows = generated_files.compared(160, seed=7)
    assert [row["first failure"] for row in rows] == [""] * len(rows)
    assert all(row["equal"] > 10 for row in rows)
    assert sum(row["refused"] for row in rows) > 10


@pytest.mark.slow
def test_two_thousand_generated_files() -> None:
    """The same holds for 2,000 files."""
    assert [row["first failure"] for row in generated_files.compared(2000, seed=8)] == [""] * 8


@pytest.mark.parametrize("line", ["# C:\\parts\\", "g C:\\parts\\", "usemtl a\\"])
def test_a_backslash_at_the_end_of_a_name_continues_no_line(tmp_path: Path, line: str) -> None:
    """The next face is read; a face that is continued over three lines is one face with its line number."""
    vertices, faces = prism()
    rows = obj(vertices, faces).splitlines()
    content = "\n".join([*rows[:12], line, *rows[12:]])
    assert measures(tmp_path / "l.obj", content)[:2] == pytest.approx((AREA, VOLUME))
    continued = content.replace("f 6 5 4 3 2 1", "f 6 5 \\\n4 3 \\\n2 1")
    assert measures(tmp_path / "l.obj", continued)[:2] == pytest.approx((AREA, VOLUME))
    with pytest.raises(FileError, match=f"line {len(rows) + 4}"):
        measures(tmp_path / "l.obj", continued + "\nf 1 2 x")


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_straight_corners_are_joined_to_their_neighbours(tmp_path: Path, suffix: str) -> None:
    """A cap with a corner in the middle of each edge, between quads that end there, is closed without slivers."""
    ring = np.array(PROFILE, float)
    ring = np.stack([ring, (ring + np.roll(ring, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
    n = len(ring)
    vertices = [(x, y, z) for z in (0.0, float(HEIGHT)) for x, y in ring.tolist()]
    faces = [list(range(n))[::-1], list(range(n, 2 * n)), *([k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n))]
    rows = [" ".join(map(str, vertex)) for vertex in vertices]
    if suffix == ".obj":
        content = obj(vertices, faces)
    else:
        corners = [" ".join(map(str, [len(face), *face])) for face in faces]
        head = f"OFF\n{2 * n} {len(faces)} 0" if suffix == ".off" else (
            f"ply\nformat ascii 1.0\nelement vertex {2 * n}\nproperty double x\nproperty double y\nproperty double z\n"
            f"element face {len(faces)}\nproperty list int int vertex_indices\nend_header"
        )  # fmt: skip
        content = "\n".join([head, *rows, *corners, ""])
    (tmp_path / f"l{suffix}").write_text(content)
    part = load(tmp_path / f"l{suffix}", "mm")
    assert part.findings == ()
    assert part.reference.areas.min() > 1e-6
    assert part.reference.areas.sum() == pytest.approx(AREA * 1e-6)


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_rounding_errors_do_not_open_the_surface(tmp_path: Path, shift: float) -> None:
    """Corners that differ by the rounding of coordinates are one vertex; a millionth of the part is a gap."""
    corners = np.array(prism(shift)[0])[np.array(stl_triangles())]
    tags = [Kind.OPEN, Kind.BODIES]
    for error, findings in ((1e-15, []), (1e-4, tags)):
        noise = error * np.random.default_rng(0).standard_normal(corners.shape)
        part = from_arrays("l", (corners + noise).reshape(-1, 3), np.arange(60).reshape(-1, 3), "mm")
        assert [finding.kind for finding in part.findings] == findings
    ball = trimesh.creation.icosphere(subdivisions=4, radius=50.0)
    places = ball.vertices[ball.faces].reshape(-1, 3)
    places = np.nextafter(places, np.random.default_rng(0).choice((-2.0, 2.0), places.shape))  # 1 ulp
    assert from_arrays("ball", places, np.arange(len(places)).reshape(-1, 3), "mm").findings == ()
    numbers = corners.astype("<f4")
    numbers[::3][numbers[::3] == 0] = 1e-17
    rows = np.zeros(20, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"] = numbers
    (tmp_path / "l.stl").write_bytes(bytes(80) + struct.pack("<I", 20) + rows.tobytes())
    assert load(tmp_path / "l.stl", "mm").findings == ()


def test_a_vertex_without_a_face_does_not_change_the_others(tmp_path: Path) -> None:
    """A far vertex of no face does not merge those of the faces; one that is not a number is named."""
    vertices = np.array(prism()[0])
    text = obj((vertices * 1e-6).tolist(), prism()[1]).replace("f ", "v 1e9 0 0\nf ", 1)
    assert measures(tmp_path / "l.obj", text)[:2] == pytest.approx((AREA * 1e-12, VOLUME * 1e-18))
    vertices[3] = np.nan
    with pytest.raises(FileError, match="1 vertices whose coordinates are not numbers"):
        from_arrays("l", vertices, np.array(stl_triangles()), "mm")


def test_bytes_behind_the_announced_faces_are_not_lost(tmp_path: Path) -> None:
    """A binary STL of two bodies one after the other, and a PLY with more rows than announced, are refused."""
    vertices, _ = prism()
    rows = np.zeros(20, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"] = np.array(vertices)[np.array(stl_triangles())]
    body = b"solid facet vertex".ljust(80) + struct.pack("<I", 20) + rows.tobytes()
    assert measures(tmp_path / "l.stl", body + bytes(100))[:2] == pytest.approx((AREA, VOLUME))
    with pytest.raises(FileError, match="announces 20 faces but has 1084 bytes behind them"):
        measures(tmp_path / "l.stl", body + body)
    with pytest.raises(FileError, match="announces 21 faces"):
        measures(tmp_path / "l.stl", body[:80] + struct.pack("<I", 21) + rows.tobytes())
    _, faces = prism()
    with pytest.raises(FileError, match="2 numbers more than its header announces"):
        measures(tmp_path / "l.ply", ply(faces, "ascii") + b"3 4\n")
    with pytest.raises(FileError, match="3 bytes more than its header announces"):
        measures(tmp_path / "l.ply", ply(faces, "binary_big_endian") + b"abc")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda text: text.replace("endsolid L", ""), "does not end with 'endsolid'"),
        (lambda _: "solid nothing\nendsolid nothing\n", "holds no faces"),
        (lambda text: text.replace("vertex 0 0 0", "vertex 0 0 0 0", 1), "line 13: 0 0 0 0; it needs three numbers"),
        (lambda text: text.replace("vertex 0 0 0", "vertex 0 0 0\nvertex 1 0 0", 1), r"with 4 corners \(facet 2\)"),
        (lambda text: text.replace("endfacet\nendsolid", "endsolid"), "last facet is not complete"),
    ],
)
def test_an_stl_that_is_no_list_of_triangles_is_named(tmp_path: Path, change: Callable, sentence: str) -> None:
    """Four corners, four numbers and a missing end are different causes."""
    with pytest.raises(FileError, match=sentence):
        measures(tmp_path / "l.stl", change(stl("L")))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"3D/m.model": 'type="support"'}, "support structure"),
        ({"Metadata/model_settings.config": '<part subtype="negative_part"/>'}, "negative_part"),
        ({"_rels/.rels": ""}, "names no model"),
        ({"3D/m.model": 'encoding="no-such"'}, "cannot be read as 3MF"),
    ],
)
def test_a_3mf_that_is_more_than_solids_is_named(tmp_path: Path, change: dict[str, str], sentence: str) -> None:
    """Support structures, subtracted volumes, a missing model and an unknown encoding are refused."""
    content = three_mf(tmp_path / "l.3mf", "millimeter", '<item objectid="1"/>')
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name).decode() for name in archive.namelist()}
    for name, text in change.items():
        if name == "3D/m.model" and "type" in text:
            members[name] = members[name].replace('<object id="1"', f'<object id="1" {text}')
        elif name == "3D/m.model":
            members[name] = members[name].replace('version="1.0"', f'version="1.0" {text}')
        elif name == "_rels/.rels":
            members[name] = '<Relationships xmlns="x"/>'
        else:
            members[name] = text
    with zipfile.ZipFile(tmp_path / "l.3mf", "w") as archive:
        for name, text in members.items():
            archive.writestr(name, text)
    with pytest.raises(FileError, match=sentence):
        parse(tmp_path / "l.3mf", (tmp_path / "l.3mf").read_bytes())
