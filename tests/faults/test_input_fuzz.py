"""Mangled and crafted input files in a reduced form; `python -m benchmarks fuzz_inputs` is the full form."""

import io
import json
import re
import resource
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pytest

from benchmarks import fuzz_inputs
from cell.errors import CellError, FileError, SceneError
from cell.part import workpiece
from cell.runs.run import npz_arrays
from cell.scene.file import load_scene
from tests.support.fixture_types import RunCommand


def _clean(rows: list[dict[str, Any]]) -> None:
    """Require no foreign exception, at most 10 s per file, and more than a third of the mangled files refused."""
    for row in rows:
        assert row["foreign"] == 0, row
        assert row["slowest_s"] < 10, row
        assert row["refused"] > row["mangled"] // 3, row


def test_mangled_files_are_read_or_refused_in_our_words(executed: Path) -> None:
    """Mangled meshes, scenes, JSON and npz are read or refused by an error of the program, within 10 s."""
    scan = executed / "executions/0001/scans/0001.npz"
    _clean(fuzz_inputs.fuzzed(executed, scan, 400, seed=3))


@pytest.mark.slow
def test_ten_thousand_mangled_files(executed: Path) -> None:
    """The same holds for 10,000 mangled files."""
    _clean(fuzz_inputs.fuzzed(executed, executed / "executions/0001/scans/0001.npz", 10_000, seed=4))


def _glb(described: bytes | dict[str, Any], data: bytes = b"") -> bytes:
    text = described if isinstance(described, bytes) else json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(data), 0x004E4942) + data if data else b""
    return (
        b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(chunk)) + struct.pack("<II", len(text), 0x4E4F534A)
        + text + chunk
    )  # fmt: skip


def _scene(**changes: Any) -> dict[str, Any]:
    """Return the description of a GLB with one triangle of 36 bytes."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
        **changes,
    }


def _three_mf(transform: str) -> bytes:
    """Return a 3MF of one triangle with a transform."""
    corners = "".join(f'<vertex x="{x}" y="{y}" z="0"/>' for x, y in ((0, 0), (9, 0), (0, 9)))
    model = (
        '<model unit="meter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1"><mesh><vertices>{corners}</vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles>'
        f'</mesh></object></resources><build><item objectid="1" transform="{transform}"/></build></model>'
    )
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    with zipfile.ZipFile(content := io.BytesIO(), "w") as archive:
        archive.writestr(
            "_rels/.rels", f'<Relationships><Relationship Target="/3d.model" Type="{kind}"/></Relationships>'
        )
        archive.writestr("3d.model", model)
    return content.getvalue()


_TRIANGLE = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0]], "<f4").tobytes()
_ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}

MESHES: dict[str, tuple[str, bytes, str]] = {
    "an accessor without data": (
        "x.glb",
        _glb(_scene(accessors=[{"componentType": 5126, "count": 360_000_000, "type": "VEC3"}])),
        "sparse accessor",
    ),
    "more announced than there is": (
        "x.glb",
        _glb(_scene(accessors=[{**_ACCESSOR, "count": 360_000_000}]), _TRIANGLE),
        "announces more data than it has",
    ),
    "a mesh under many nodes": (
        "x.glb",
        _glb(_scene(nodes=[{"mesh": 0}] * 5000, scenes=[{"nodes": list(range(5000))}],
                    meshes=[{"primitives": [{"attributes": {"POSITION": 0}}] * 5000}]), _TRIANGLE),
        "expands to more",
    ),
    "nodes in a circle": (
        "x.glb", _glb(_scene(nodes=[{"children": [1]}, {"children": [0]}]), _TRIANGLE), "a node under two parents"
    ),
    "a morph target of one vertex": (
        "x.glb",
        _glb(_scene(
            meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 1}]}], "weights": [1]}],
            accessors=[_ACCESSOR, {**_ACCESSOR, "count": 1}],
        ), _TRIANGLE),
        "a morph target with another number of vertices",
    ),
    "a polygon with a corner at 1e308": (
        "x.off",
        b"OFF\n5 2 0\n0 0 0\n9 0 0\n9 9 0\n0 9 1e308\n4 4 5\n4 3 2 1 0\n3 0 1 4\n",
        "has a coordinate of 1e+308",
    ),
    "a deep description": ("x.glb", _glb(b"[" * 100_000), "cannot be read"),
    "a description of another kind": ("x.glb", _glb(b"[1, 2]"), "not an object"),
    "nodes of another kind": ("x.glb", _glb(_scene(nodes={"a": 1}), _TRIANGLE), "that is not a list"),
    "a number in place of a mesh": ("x.glb", _glb(_scene(meshes=[7]), _TRIANGLE), "that is not a list"),
    "a count that is a text": (
        "x.glb", _glb(_scene(accessors=[{**_ACCESSOR, "count": "3"}]), _TRIANGLE), "not an integer"
    ),
    "an STL with corners that are words": (
        "x.stl", b"solid\nfacet normal a b c\nvertex a b c\nvertex 1 0 0\nvertex 0 1 0\nendfacet\n",
        "a vertex that cannot be read, line 3: a b c; it needs three numbers",
    ),
    "an OBJ with an infinite index": (
        "x.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 inf\n", "a number that is not an integer"
    ),
    "an OFF with a size that is not a number": (
        "x.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\nnan 0 1 2\n", "a number that is not an integer"
    ),
    "a PLY with an infinite length": (
        "x.ply", b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1e999 0 1 2\n",
        "is cut short",
    ),
    **{
        f"a GLB with {what}": ("x.glb", _glb(_scene(nodes=[{"mesh": 0, **node}]), _TRIANGLE), words)
        for what, node, words in (
            ("a scale of 1e300", {"scale": [1e300] * 3}, "has a coordinate of 9e+300, and the limit is 1e+09"),
            ("a translation of 1e300", {"translation": [1e300, 0, 0]}, "has a coordinate of 1e+300"),
            ("a matrix of 1e300", {"matrix": [1e300] * 16}, "check scales and places"),
            ("a rotation of 1e200", {"rotation": [1e200, 0, 0, 1]}, "has a rotation that is no unit quaternion"),
        )
    },
    **{
        f"{name} with coordinates of 1e300": (name, content, "has a coordinate of 1e+300")
        for name, content in (
            ("x.stl", b"solid\nfacet normal 0 0 0\nvertex 0 0 0\nvertex 1e300 0 0\nvertex 0 1e300 0\nendfacet\n"
             b"endsolid\n"),
            ("x.obj", b"v 0 0 0\nv 1e300 0 0\nv 0 1e300 0\nf 1 2 3\n"),
            ("x.off", b"OFF\n3 1 0\n0 0 0\n1e300 0 0\n0 1e300 0\n3 0 1 2\n"),
            ("x.ply", b"ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
             b"property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"
             b"1e300 0 0\n0 1e300 0\n3 0 1 2\n"),
        )
    },
    "a 3MF with a transform of 1e300": ("x.3mf", _three_mf("1e300 0 0 0 1e300 0 0 0 1e300 0 0 0"), "a coordinate of"),
    "a 3MF with a transform of NaN": ("x.3mf", _three_mf("nan 0 0 0 1 0 0 0 1 0 0 0"), "coordinates are not numbers"),
}  # fmt: skip


@pytest.mark.parametrize("case", MESHES)
def test_a_crafted_mesh_is_refused_in_one_sentence(case: str, tmp_path: Path) -> None:
    """A crafted mesh is refused within 2 s and without allocating its announced size."""
    name, content, words = MESHES[case]
    (tmp_path / name).write_bytes(content)
    began, before = process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileError, match=re.escape(words)) as refusal:
        workpiece.load(tmp_path / name, None if name.endswith(".3mf") else "mm")
    assert "\n" not in str(refusal.value)
    assert process_time() - began < 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KB


def test_pictures_and_normals_are_not_looked_at(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """An invalid picture in a GLB and invalid normals in an ASCII STL are ignored."""
    described = _scene(
        images=[{"bufferView": 1, "mimeType": "image/png"}], textures=[{"source": 0}],
        bufferViews=[{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 400_000}],
    )  # fmt: skip
    (tmp_path / "x.glb").write_bytes(_glb(described, _TRIANGLE + bytes(400_000)))
    assert len(workpiece.load(tmp_path / "x.glb", "mm").reference.faces) == 1
    facet = "facet normal {0}\nouter loop\nvertex 0 0 0\nvertex 9 0 0\nvertex 0 9 0\nendloop\nendfacet\n"
    (tmp_path / "x.stl").write_text("solid x\n" + facet.format("nan nan") + facet.format("a b c d") + "endsolid x\n")
    assert len(workpiece.load(tmp_path / "x.stl", "mm").reference.faces) == 1  # the second is a duplicate
    assert capfd.readouterr() == ("", "")


SCENES = {
    "brackets": "a = " + "[" * 100_000,
    "a long number": "clearance_mm = " + "9" * 200_000,
    "tables in tables": "[" + ".".join("a" * 3000) + "]\nb = 1",
    "lists in lists": "[plan]\nrolls_deg = " + "[" * 40 + "]" * 40,
    "a clearance of 1e300": "clearance_mm = 1e300",
    "a distant part": "[placement]\nposition_mm = [1e300, 0, 0]",
    "a distant fixture": '[[fixtures]]\nname = "a"\nshape = "box"\nsize_mm = [1, 1, 1]\nposition_mm = [-1e7, 0, 0]',
    "an angle of 1e300": "[placement]\nabc_deg = [1e300, 0, 0]",
    "a size of NaN": '[[fixtures]]\nname = "a"\nshape = "box"\nsize_mm = [nan, 1, 1]',
}


@pytest.mark.parametrize("case", SCENES)
def test_a_crafted_scene_is_refused_in_one_sentence(case: str, tmp_path: Path) -> None:
    """Thousands of brackets or digits, and numbers without measure, are reported as an error of the scene."""
    (tmp_path / "x.toml").write_text(SCENES[case])
    with pytest.raises(SceneError, match=r"x\.toml") as refusal:
        load_scene(tmp_path / "x.toml")
    assert len(str(refusal.value)) < 500


@pytest.mark.parametrize("arguments", [
    ("plan", "{long}.stl", "--units", "mm"),
    ("plan", "--scene", "{long}.toml"),
    ("plan", "--out", "{long}", "--faces", "20"),
    ("scan", "{long}"),
    ("export", "{long}"),
    ("replay", "{long}"),
    ("check", "--scene", "{long}.toml"),
])  # fmt: skip
def test_a_name_that_no_file_can_have_is_no_bug(
    arguments: tuple[str, ...], tmp_path: Path, run_cell: RunCommand
) -> None:
    """A name of more than 255 bytes ends with the exit code of files or of the scene."""
    process = run_cell(*(word.format(long="n" * 300) for word in arguments), cwd=tmp_path)
    assert process.returncode in (2, 6), process.stderr
    assert "bug" not in process.stderr


def test_names_and_paths_in_a_scene_are_looked_at(tmp_path: Path) -> None:
    """Names of fixtures that are too long, invalid paths, and the home folder of an unknown user are refused."""
    painted = '[[region]]\nname = "a"\ncolour = "#ff0000"\npainted_units = "mm"\npainted ='
    for content, words in (
        (f'[[fixtures]]\nname = "{"n" * 101}"\nshape = "box"\nsize_mm = [1, 1, 1]', "it must have at most 100"),
        (f'[[fixtures]]\nname = "a"\nshape = "mesh"\nunits = "mm"\npath = "{"n" * 300}.stl"', "no valid file name"),
        (f'{painted} "{"n" * 300}.ply"', "no valid file name"),
        (f'{painted} "~no-such-user/a.ply"', "no valid file name"),
        ('[robot.packages]\narm = "~no-such-user/arm"', "robot.packages names '~no-such-user/arm', below the home"),
    ):
        (tmp_path / "x.toml").write_text(content)
        with pytest.raises(SceneError, match=words):
            load_scene(tmp_path / "x.toml")


@pytest.mark.parametrize("name", ["plan.json", "scene.resolved.json", "manifest.json"])
def test_a_deep_file_of_a_run_is_damaged(name: str, planned: Path, tmp_path: Path, run_cell: RunCommand) -> None:
    """A file nested 100,000 times is refused by every command that reads it."""
    import shutil

    shutil.copytree(planned, tmp_path / "run")
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    if name != "manifest.json":
        del manifest["artefacts"][name]
        (tmp_path / "run/manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "run" / name).write_text('{"views": ' + "[" * 100_000)
    for command in (("export", "run"), ("scan", "run"), ("replay", "run", "--picture", "x.png")):
        process = run_cell(*command, cwd=tmp_path, code=6)
        assert process.stderr.count("\n") == 1


def _bomb(unfolded: int) -> bytes:
    """Return an npz of one array of zeros, compressed about a thousand times."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (unfolded // 8,)})
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("q.npy", "w", force_zip64=True) as file,
    ):
        file.write(header.getvalue())
        for _ in range(unfolded >> 20):
            file.write(bytes(1 << 20))
    return buffer.getvalue()


def _liar() -> bytes:
    """Return an npz whose array announces a size of one terabyte."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 37,)})
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("q.npy", header.getvalue() + bytes(80))
    return buffer.getvalue()


@pytest.mark.parametrize("make_content", [lambda: _bomb(1 << 28), _liar], ids=["bomb", "liar"])
def test_allocation_is_bounded_by_the_size_of_the_file(make_content: Callable[[], bytes]) -> None:
    """An npz that expands a thousand times or announces a terabyte is refused without allocating that size."""
    content = make_content()
    began, before = process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CellError, match="is damaged or cut short"):
        npz_arrays(Path("q.npz"), content)
    assert process_time() - began < 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KB
