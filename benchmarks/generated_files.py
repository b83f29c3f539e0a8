"""Mesh files of every format, in the forms that programs write, compared with the surface that they were made from.

Each file is a set of prisms whose area, volume and number of bodies are known in closed form: concave profiles,
profiles with straight corners, and caps with a hole that a bridge joins to the border. Format, encoding, line ends,
numbers, names, index style, property types, elements and transforms are random. About one file in six is damaged in a
known way and must be refused by a sentence that names the fault. trimesh reads the same files as a second judge; it
does not read many of these forms, so a file that it reads otherwise is no fault of either.

`GENERATED_FILES` in the environment changes the 2,000 files.
"""

import base64
import io
import json
import os
import re
import struct
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import CellError
from cell.part import workpiece
from cell.part.description import volume
from cell.part.mesh_checks import Kind, adjacent_faces, label_bodies
from planner.values import Floats

Polygons = list[list[int]]

FORMATS = ("obj", "ply", "off", "stl", "binary stl", "glb", "gltf", "3mf")
TOLERANCE = 2e-5
"""Relative difference of area and volume: single precision of binary formats, nine digits of texts."""

_NAMES = (
    "part",
    "f 1 2 3",
    "vertex end_header",
    "endsolid facet",
    "v 0 0 0",
    "OFF 3 1 0",
    "Prüfstück",
    "a#b",
    "C:\\x\\",
)
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A closed surface.

    Attributes:
        vertices: (V, 3) corners of the polygons, without the middles.
        polygons: corners with outward winding.
        middles: (P, 3) a point of each polygon that sees all its corners; empty if a polygon has none.
        area: of the surface.
        volume: of the solid.
    """

    vertices: Floats
    polygons: Polygons
    middles: Floats
    area: float
    volume: float

    def placed(self, M: Floats, shift: Floats) -> "Body":
        """Return the body transformed by a scaled rotation (3, 3) and a translation (3,)."""
        scale = float(np.cbrt(np.linalg.det(M)))
        vertices, middles = (points @ M.T + shift for points in (self.vertices, self.middles))
        return Body(vertices, self.polygons, middles, self.area * scale**2, self.volume * scale**3)

    def triangles(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return vertices and triangles (F, 3), a fan about the middle of each polygon."""
        rows = [
            (a, b, len(self.vertices) + k)
            for k, polygon in enumerate(self.polygons)
            for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True)
        ]
        return np.concatenate([self.vertices, self.middles]), np.array(rows)


def _profile(rng: np.random.Generator) -> tuple[Floats, Floats | None, Floats | None]:
    """Return a profile (N, 2) of positive winding, a point that sees all of it or None, and a hole (M, 2) or None."""
    kind = rng.choice(["star", "l", "convex", "comb", "frame"])
    if kind == "frame":
        outer = np.array([[0, 0], [90, 0], [90, 70], [0, 70.0]])
        return outer, None, np.array([[20, 20], [20, 50], [60, 50], [60, 20.0]])
    if kind == "comb":
        teeth = int(rng.integers(2, 5))
        top = [(x, y) for k in reversed(range(teeth)) for x, y in ((30 * k + 15, 60), (30 * k, 60), (30 * k, 20))]
        return np.array([(0, 0), (30 * teeth - 15, 0), *top[:-1]], float), None, None
    if kind == "l":
        return np.array([(0, 0), (100, 0), (100, 30), (30, 30), (30, 80), (0, 80.0)]), np.array([15.0, 14.0]), None
    count = int(rng.integers(3, 14))
    angle = (np.arange(count) + rng.uniform(0, 0.4, count)) * 2 * np.pi / count
    radius = rng.uniform(20, 60, count) if kind == "star" else np.full(count, 40.0)
    if count == 3:
        radius = np.full(count, 40.0)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), np.zeros(2), None


def _shoelace(ring: Floats) -> float:
    x, y = ring.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def _perimeter(ring: Floats) -> float:
    return float(np.linalg.norm(np.roll(ring, -1, axis=0) - ring, axis=1).sum())


def make_body(rng: np.random.Generator, *, triangles: bool) -> Body:
    """Return a prism of a random profile; with `triangles`, one whose polygons have middles."""
    ring, middle, hole = _profile(rng)
    while triangles and middle is None:
        ring, middle, hole = _profile(rng)
    if rng.random() < 0.3:  # straight corners of the caps
        ring = np.stack([ring, (ring + np.roll(ring, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
    first = int(rng.integers(len(ring)))
    ring = np.roll(ring, -first, axis=0)
    height, count = float(rng.uniform(10, 60)), len(ring)
    if hole is not None:  # the bridge to the closest corner crosses nothing
        hole = np.roll(hole, -int(np.argmin(np.linalg.norm(hole - ring[0], axis=1))), axis=0)
    has_belt = rng.random() < 0.3  # straight corners of the sides
    rings = [ring] if hole is None else [ring, hole]
    flat = np.concatenate(rings)
    n_flat = len(flat)
    levels = [0.0, height, height / 2] if has_belt else [0.0, height]
    vertices = np.concatenate([np.column_stack([flat, np.full(n_flat, z)]) for z in levels])
    cap = list(range(count))
    if hole is not None:  # a bridge from the first corner to the hole and back
        cap = [*cap, 0, *range(count, n_flat), count]
    polygons, middles = [cap[::-1], [n_flat + k for k in cap]], []
    begin = 0
    for each in rings:
        for k in range(len(each)):
            a, b = begin + k, begin + (k + 1) % len(each)
            belt = ([b + 2 * n_flat], [a + 2 * n_flat]) if has_belt else ([], [])
            polygons.append([a, b, *belt[0], b + n_flat, a + n_flat, *belt[1]])
        begin += len(each)
    if middle is not None:
        middles = [[*middle, 0.0], [*middle, height], *(vertices[p].mean(axis=0).tolist() for p in polygons[2:])]
    area = 2 * sum(_shoelace(each) for each in rings) + height * sum(_perimeter(each) for each in rings)
    solid = height * sum(_shoelace(each) for each in rings)
    return Body(vertices, polygons, np.array(middles).reshape(-1, 3), area, solid)


def rotation(rng: np.random.Generator) -> Floats:
    """Return a random rotation (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return np.asarray(q)


@dataclass(frozen=True, slots=True, eq=False)
class GeneratedFile:
    """A generated file.

    Attributes:
        name: of the file.
        content: of the file.
        other_files: files of the folder by name.
        units: for the reader; None for formats with their own.
        area: expected [m^2].
        volume: expected [m^3].
        bodies: expected number.
        refusal: regular expression of the sentence of a damaged file; "" if it must be read.
        tags: chosen forms, to describe a failure.
    """

    name: str
    content: bytes
    other_files: dict[str, bytes]
    units: str | None
    area: float
    volume: float
    bodies: int
    refusal: str
    tags: str


class _Text:
    """Random forms of a text file: numbers, separators, line ends, blank lines, encodings, names."""

    def __init__(self, rng: np.random.Generator, *, encodings: Sequence[str]) -> None:
        self.rng = rng
        self.form = str(rng.choice(["r", "9g", "+e", "E", "f"]))
        self.gap = str(rng.choice([" ", "  ", "\t"]))
        self.indent = str(rng.choice(["", "", "  ", "\t"]))
        self.end = str(rng.choice(["\n", "\r\n", "\r"]))
        self.encoding = str(rng.choice(encodings))
        self.name = str(rng.choice(_NAMES))

    def number(self, value: float) -> str:
        """Return a number in the form of this file."""
        forms = {"r": repr(float(value)), "9g": f"{value:.12g}", "+e": f"{value:+.11e}", "E": f"{value:.11E}"}
        return forms.get(self.form, f"{value:.10f}")

    def row(self, words: Sequence[object]) -> str:
        """Return a line of words."""
        return self.indent + self.gap.join(str(word) for word in words)

    def point(self, point: Floats) -> list[str]:
        """Return the words of a point."""
        return [self.number(value) for value in point]

    def joined(self, lines: Sequence[str]) -> bytes:
        """Return the bytes of lines, with blank lines or without a last line end."""
        lines = [line for line in lines for line in ([line, ""] if self.rng.random() < 0.02 else [line])]
        text = self.end.join(lines) + ("" if self.rng.random() < 0.2 else self.end)
        return text.encode(self.encoding, "replace")

    def joined_ply(self, head: Sequence[str], body: Sequence[str]) -> bytes:
        """Return the bytes of a PLY text, whose header has no blank lines."""
        return self.end.join([*head, ""]).encode(self.encoding, "replace") + self.joined(body).removeprefix(
            b"\xef\xbb\xbf"
        )

    def __str__(self) -> str:
        return f"{self.encoding} {self.end!r} gap {self.gap!r} number {self.form} name {self.name!r}"


_TEXT_ENCODINGS = ("utf-8", "utf-8-sig", "latin-1", "utf-16", "gbk")


def _obj(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[bytes, str]:
    text = _Text(rng, encodings=_TEXT_ENCODINGS)
    relative, style = rng.random() < 0.4, int(rng.integers(4))
    blocks, coloured = rng.random() < 0.5, rng.random() < 0.3
    tags = f"{text} {'relative' if relative else 'absolute'} style {style} {'blocks' if blocks else ''}"
    lines = [f"# {text.name}", "mtllib x.mtl", "vt 0.5 0.5", "vn 0 0 1"]

    def vertex_rows(body: Body) -> list[str]:
        more = ["0.5", "0.25", "1"] if coloured else []
        return [text.row(["v", *text.point(point), *more]) for point in body.vertices]

    def face_rows(body: Body, begin: int, total: int) -> list[str]:
        rows = []
        for polygon in body.polygons:
            numbers = [begin + corner - total if relative else begin + corner + 1 for corner in polygon]
            words = [(f"{k}", f"{k}/1", f"{k}//1", f"{k}/1/1")[style] for k in numbers]
            row = text.row(["f", *words])
            if rng.random() < 0.05:  # a continued line
                head, _, tail = row.rpartition(text.gap)
                row = f"{head} \\{text.end}{tail}"
            rows.append(row + (" # f 1 2 3" if rng.random() < 0.02 else ""))
        return rows

    total = sum(len(body.vertices) for body in bodies)
    if blocks:
        begin = 0
        for number, body in enumerate(bodies):
            lines += [f"{'og'[number % 2]} {text.name}", *vertex_rows(body), f"usemtl {text.name}", "s 1"]
            lines += face_rows(body, begin, begin + len(body.vertices))
            begin += len(body.vertices)
    else:
        lines += [row for body in bodies for row in vertex_rows(body)] + [f"g {text.name}"]
        begin = 0
        for body in bodies:
            lines += face_rows(body, begin, total)
            begin += len(body.vertices)
    extra = {
        "index zero": "f 0 1 2",
        "missing vertex": f"f 1 2 {total + 1}",
        "decimal commas": "v 1,5 2,5 3,5",
        "two coordinates": "v 1 2",
        "a word": "f 1 2 three",
        "free form": "curv2 1 2 3",
    }
    return text.joined([*lines, *([extra[fault]] if fault else [])]), tags


def _off(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[bytes, str]:
    text = _Text(rng, encodings=_TEXT_ENCODINGS)
    vertices, polygons = _joined_bodies(bodies)
    counts = f"{len(vertices) + (fault == 'more announced')} {len(polygons) - (fault == 'fewer announced')} 0"
    if rng.random() < 0.1:
        counts = counts.removesuffix(" 0")
    head = [["OFF", counts], [f"OFF {counts}"], [counts], ["COFF", counts]][int(rng.integers(4))]
    colour = ["255", "0", "0", "255"] if head[0] == "COFF" else []
    face_colour = [[], ["255", "0", "0"], ["0.5", "0.5", "0.5", "1.0"]][int(rng.integers(3))]
    rows = [text.row([*text.point(point), *colour]) for point in vertices]
    for polygon in polygons:
        some = face_colour if rng.random() < 0.9 else []
        rows.append(text.row([len(polygon), *polygon, *some]) + (" # face" if rng.random() < 0.02 else ""))
    if fault == "missing vertex":
        rows[-1] = text.row([3, 0, 1, len(vertices)])
    elif fault == "too few corners":
        rows[-1] = text.row([5, 0, 1])
    elif fault == "four coordinates":
        head = ["4OFF", counts]
    elif fault == "decimal commas":
        rows[0] = text.row(["1,5", "2,5", "3,5"])
    return text.joined([head[0], f"# {text.name}", *head[1:], *rows]), f"{text} {head[0]}"


def _joined_bodies(bodies: list[Body]) -> tuple[Floats, Polygons]:
    polygons, begin = [], 0
    for body in bodies:
        polygons += [[begin + corner for corner in polygon] for polygon in body.polygons]
        begin += len(body.vertices)
    return np.concatenate([body.vertices for body in bodies]), polygons


_PLY_TYPES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
}
_PLY_LONG = {"char": "int8", "uchar": "uint8", "short": "int16", "ushort": "uint16", "int": "int32", "uint": "uint32",
             "float": "float32", "double": "float64"}  # fmt: skip


def _ply(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[bytes, str]:
    form = str(rng.choice(["ascii", "binary_little_endian", "binary_big_endian"]))
    text = _Text(rng, encodings=("utf-8", "utf-8-sig", "latin-1") if form == "ascii" else ("utf-8", "latin-1"))
    if form != "ascii":
        text.end = "\n" if text.end == "\r" else text.end
    text.indent = ""
    vertices, polygons = _joined_bodies(bodies)
    real, index = str(rng.choice(["float", "double"])), str(rng.choice(["int", "uint", "short", "ushort"]))
    count, long = str(rng.choice(["uchar", "int", "ushort", "uint"])), rng.random() < 0.3
    strips: list[list[int]] = []
    if rng.random() < 0.3:  # quads become strips in one element
        index = "int"
        quads = [polygon for polygon in polygons if len(polygon) == 4]
        polygons = [polygon for polygon in polygons if len(polygon) != 4]
        strips = [[a, b, d, c] for a, b, c, d in quads]
    elif fault == "missing vertex" or not polygons:
        index = "int"
    columns: list[tuple[str, str]] = [(axis, real) for axis in "xyz"]
    more = [("nx", "float"), ("red", "uchar"), ("quality", "double")]
    columns += [each for each in more if rng.random() < 0.3]
    columns = [columns[k] for k in rng.permutation(len(columns))]
    values = {"x": vertices[:, 0], "y": vertices[:, 1], "z": vertices[:, 2]}
    elements: list[tuple[str, int, list[str], list[list[tuple[str, Any]]]]] = []
    if rng.random() < 0.3:
        elements.append(("camera", 1, ["property float f", "property list uchar short k"],
                         [[("float", 2.5), ("uchar", [("short", 7), ("short", 8)])]]))  # fmt: skip
    rows: list[list[tuple[str, Any]]] = [
        [(kind, float(values[name][k]) if name in values else 1) for name, kind in columns]
        for k in range(len(vertices))
    ]
    if fault == "no z":
        columns = [("w" if name == "z" else name, kind) for name, kind in columns]
    elements.append(("vertex", len(rows), [f"property {kind} {name}" for name, kind in columns], rows))
    if fault == "missing vertex":
        polygons = [*polygons, [0, 1, len(vertices)]]
    name = str(rng.choice(["vertex_indices", "vertex_index"]))
    has_flag, has_texture = rng.random() < 0.3, rng.random() < 0.2
    properties = ["property uchar flags"] * has_flag + [f"property list {count} {index} {name}"]
    properties += ["property list uchar float texcoord"] * has_texture
    faces: list[list[tuple[str, Any]]] = []
    for polygon in polygons:
        row: list[tuple[str, Any]] = [("uchar", 3)] if has_flag else []
        row.append((count, [(index, corner) for corner in polygon]))
        faces.append([*row, ("uchar", [("float", 0.5)] * 2)] if has_texture else row)
    elements.append(("face", len(faces), properties, faces))
    if strips:
        numbers = [corner for strip in strips for corner in [*strip, -1]]
        elements.append(("tristrips", 1, ["property list int int vertex_indices"],
                         [[("int", [("int", number) for number in numbers])]]))  # fmt: skip
    head = ["ply", f"format {form} 1.0", f"comment {text.name}"]
    for element, n_rows, names, _ in elements:
        wrong = {("more announced", "face"): 1, ("fewer announced", elements[-1][0]): -1}.get((fault, element), 0)
        head += [f"element {element} {n_rows + wrong}", f"obj_info {text.name}", *names]
    if long:
        head = [re.sub(r"\b(" + "|".join(_PLY_TYPES) + r")\b", lambda m: _PLY_LONG[m[1]], line)
                if line.startswith("property") else line for line in head]  # fmt: skip
    tags = f"{text} {form} {real} {index} {count} {[e[0] for e in elements]} strips {len(strips)}"
    if form == "ascii":
        body = [text.row(_ply_words(row, text)) for _, _, _, rows in elements for row in rows]
        if fault == "more columns":
            body = [line + text.gap + "0" for line in body]
        return text.joined_ply([*head, "end_header"], body), tags
    order = "<" if form == "binary_little_endian" else ">"
    packed = b"".join(_ply_bytes(row, order) for _, _, _, rows in elements for row in rows)
    if fault == "more columns":
        packed += bytes(24)
    return text.end.join([*head, "end_header", ""]).encode(text.encoding, "replace") + packed, tags


def _ply_words(row: list[tuple[str, Any]], text: _Text) -> list[str]:
    words = []
    for kind, value in row:
        if isinstance(value, list):
            words += [str(len(value)), *_ply_words(value, text)]
        else:
            words.append(text.number(value) if kind in ("float", "double") else str(value))
    return words


def _ply_bytes(row: list[tuple[str, Any]], order: str) -> bytes:
    out = b""
    for kind, value in row:
        if isinstance(value, list):
            out += struct.pack(order + _PLY_TYPES[kind], len(value)) + _ply_bytes(value, order)
        else:
            out += struct.pack(order + _PLY_TYPES[kind], value)
    return out


def _stl(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[bytes, str]:
    text = _Text(rng, encodings=_TEXT_ENCODINGS)
    lines = []
    solid = [bodies] if rng.random() < 0.5 else [[body] for body in bodies]
    case: Callable[[str], str] = str.upper if rng.random() < 0.2 else str
    ends = rng.choice(["endloop endfacet endsolid", "end loop,end facet,end solid"])
    loop, facet, end = ends.split("," if "," in ends else " ")
    for group in solid:
        lines.append(case("solid ") + text.name)
        for body in group:
            vertices, faces = body.triangles()
            for corners in vertices[faces]:
                rows = [text.row([case("vertex"), *text.point(point.astype(np.float32))]) for point in corners]
                lines += [case("facet normal 0 0 1"), case("  outer loop"), *rows, case(loop), case(facet)]
        lines.append(case(end) + f" {text.name}")
    if fault == "cut short":
        lines = lines[: -5 - int(rng.integers(3))]
    elif fault == "decimal commas":
        at = next(k for k, line in enumerate(lines) if "vertex" in line.lower() and "solid" not in line.lower())
        lines[at] = text.row(["vertex", "1,5", "2,5", "3,5"])
    elif fault == "four corners":
        at = next(k for k, line in enumerate(lines) if "vertex" in line.lower() and "solid" not in line.lower())
        lines.insert(at, lines[at])
    return text.joined(lines), f"{text} {ends}"


def _binary_stl(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[bytes, str]:
    header = str(rng.choice(["", "solid part", "solid facet normal vertex", "COLOR=abcd"]))
    rows = np.concatenate([vertices[faces] for vertices, faces in (body.triangles() for body in bodies)])
    table = np.zeros(len(rows), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    table["corners"] = rows
    table["attribute"] = rng.integers(0, 60000, len(rows)) if rng.random() < 0.3 else 0
    count = len(rows) + {"more announced": 1, "fewer announced": -1}.get(fault, 0)
    content = header.encode().ljust(80, b" " if rng.random() < 0.3 else b"\0") + struct.pack("<I", count)
    return content + table.tobytes() + bytes(int(rng.integers(3)) if not fault else 0), header


def _placed(rng: np.random.Generator, *, may_mirror: bool) -> tuple[Floats, dict[str, Any]]:
    """Return a random transform (4, 4), and the same as properties of a glTF node."""
    scale = float(rng.choice([0.5, 1.0, 2.0])) * np.array([1, 1, -1 if may_mirror and rng.random() < 0.3 else 1])
    R, shift = rotation(rng), rng.uniform(-0.2, 0.2, 3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R * scale, shift
    if rng.random() < 0.5:
        return T, {"matrix": T.T.ravel().tolist()}
    w = np.sqrt(max(1 + np.trace(R), 1e-12)) / 2
    x, y, z = (R[2, 1] - R[1, 2]) / (4 * w), (R[0, 2] - R[2, 0]) / (4 * w), (R[1, 0] - R[0, 1]) / (4 * w)
    if w < 0.1:
        return T, {"matrix": T.T.ravel().tolist()}
    return T, {"translation": shift.tolist(), "rotation": [x, y, z, w], "scale": scale.tolist()}


def _moved(points: Floats, T: Floats) -> Floats:
    moved: Floats = points @ T[:3, :3].T + T[:3, 3]
    return moved


def _gltf(rng: np.random.Generator, bodies: list[Body], fault: str) -> tuple[dict[str, Any], bytes, str]:
    described: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [],
                                 "meshes": [], "accessors": [], "bufferViews": [], "buffers": []}  # fmt: skip
    data = b""
    tags = []

    def stored(content: bytes, **accessor: Any) -> int:
        nonlocal data
        data += bytes(-len(data) % 4)
        view = {"buffer": 0, "byteOffset": len(data), "byteLength": len(content)}
        if "stride" in accessor:
            view["byteStride"] = accessor.pop("stride")
        described["bufferViews"].append(view)
        described["accessors"].append({"bufferView": len(described["bufferViews"]) - 1, **accessor})
        data += content
        return len(described["accessors"]) - 1

    def points(vertices: Floats) -> int:
        if rng.random() < 0.3:  # interleaved with a normal
            both = np.concatenate([vertices, np.tile([0, 0, 1], (len(vertices), 1))], axis=1).astype("<f4")
            return stored(both.tobytes(), componentType=5126, count=len(vertices), type="VEC3", stride=24)
        return stored(vertices.astype("<f4").tobytes(), componentType=5126, count=len(vertices), type="VEC3")

    def indices(numbers: Sequence[int]) -> int:
        kinds = [(5123, "<u2"), (5125, "<u4"), *([(5121, "<u1")] if max(numbers) < 255 else [])]
        code, kind = kinds[int(rng.integers(len(kinds)))]
        return stored(np.array(numbers, kind).tobytes(), componentType=code, count=len(numbers), type="SCALAR")

    for body in bodies:
        T, node = _placed(rng, may_mirror=True)
        T_above, above = _placed(rng, may_mirror=False)
        is_mirrored = np.linalg.det(T[:3, :3]) < 0
        vertices, faces = body.triangles()
        faces = faces[:, ::-1] if is_mirrored else faces
        local = _moved(vertices, np.linalg.inv(T_above @ T))
        style = str(rng.choice(["triangles", "no indices", "fans"]))
        tags.append(style)
        if style == "triangles":
            primitives = [{"attributes": {"POSITION": points(local)}, "indices": indices(faces.ravel().tolist())}]
        elif style == "no indices":
            primitives = [{"attributes": {"POSITION": points(local[faces].reshape(-1, 3))}, "mode": 4}]
        else:
            position = points(local)
            primitives = []
            for k, polygon in enumerate(body.polygons):
                ring = [*polygon, polygon[0]]
                ring = ring[::-1] if is_mirrored else ring
                if len(polygon) == 4:  # a strip, without the middle
                    a, b, c, d = ring[:4]
                    strip = {"attributes": {"POSITION": position}, "indices": indices([a, b, d, c]), "mode": 5}
                    primitives.append(strip)
                else:
                    fan = [len(body.vertices) + k, *ring]
                    primitives.append({"attributes": {"POSITION": position}, "indices": indices(fan), "mode": 6})
        described["meshes"].append({"primitives": primitives})
        nodes = described["nodes"]
        nodes += [{**above, "children": [len(nodes) + 1]}, {**node, "mesh": len(described["meshes"]) - 1}]
        described["scenes"][0]["nodes"].append(len(nodes) - 2)
    described["nodes"].append({"mesh": 0, "name": "in no scene"})
    if fault == "extension":
        described["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    elif fault == "skin":
        described["nodes"][1]["skin"] = 0
    elif fault == "sparse":
        described["accessors"][0]["sparse"] = {}
    elif fault == "missing accessor":
        described["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = len(described["accessors"])
    elif fault == "cut short":
        described["bufferViews"][-1]["byteLength"] += 400
        described["accessors"][-1]["count"] += 30
    described["buffers"].append({"byteLength": len(data)})
    return described, data, " ".join(tags)


def _glb(described: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def _three_mf(rng: np.random.Generator, bodies: list[Body], fault: str, unit: str) -> tuple[bytes, str]:
    is_split = rng.random() < 0.3  # the production extension: objects in another model part
    objects, items, tags = [], [], "split" if is_split else ""

    def transform(T: Floats) -> str:
        return " ".join(f"{value:.12g}" for value in [*T[:3, :3].T.ravel(), *T[:3, 3]])

    for number, body in enumerate(bodies):
        T, _ = _placed(rng, may_mirror=True)
        T_above, _ = _placed(rng, may_mirror=False)
        vertices, faces = body.triangles()
        local = _moved(vertices, np.linalg.inv(T_above @ T))
        faces = faces[:, ::-1] if np.linalg.det(T[:3, :3]) < 0 else faces
        rows = "".join(f'<vertex x="{x:.12g}" y="{y:.12g}" z="{z:.12g}"/>' for x, y, z in local)
        corners = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
        if fault == "missing vertex" and not number:
            corners += f'<triangle v1="0" v2="1" v3="{len(vertices)}"/>'
        mesh = f"<mesh><vertices>{rows}</vertices><triangles>{corners}</triangles></mesh>"
        inner, outer = 2 * number + 1, 2 * number + 2
        path = ' p:path="/3D/Objects/bodies.model"' if is_split else ""
        above = f'<components><component objectid="{inner}"{path} transform="{transform(T)}"/></components>'
        objects.append((f'<object id="{inner}" type="model">{mesh}</object>', f'<object id="{outer}">{above}</object>'))
        items.append(f'<item objectid="{outer + 90 * (fault == "missing object")}" transform="{transform(T_above)}"/>')
    required = 'requiredextensions="p"' if is_split else ""
    if fault == "extension":
        required = 'xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02" requiredextensions="b"'
    head = f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="{unit}" xmlns="{_CORE}" xmlns:p="{_PRODUCTION}"'
    inner_text = "".join(one for one, _ in objects)
    outer_text = "".join(other for _, other in objects)
    own = outer_text if is_split else inner_text + outer_text
    model = f"{head} {required}><resources>{own}</resources><build>{''.join(items)}</build></model>"
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    space = "http://schemas.openxmlformats.org/package/2006/relationships"
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        relation = f'<Relationship Target="/3D/m.model" Id="r" Type="{kind}"/>' if fault != "no model" else ""
        archive.writestr("_rels/.rels", f'<Relationships xmlns="{space}">{relation}</Relationships>')
        archive.writestr("3D/m.model", model)
        if is_split:
            split = f"{head}><resources>{inner_text}</resources><build/></model>"
            archive.writestr("3D/Objects/bodies.model", split)
    content = buffer.getvalue()
    return (content[: len(content) // 2] if fault == "cut short" else content), tags


FAULTS: dict[str, dict[str, str]] = {
    "obj": {
        "index zero": r"vertex 0, line \d+",
        "missing vertex": r"refers to vertex \d+, line \d+",
        "decimal commas": r"line \d+; decimal commas",
        "two coordinates": r"fewer than three coordinates, line \d+",
        "a word": r"'three' where a number is expected, line \d+",
        "free form": r"free-form surface, line \d+",
    },
    "ply": {
        "more announced": "cut short|ends before",
        "fewer announced": "more|beyond",
        "no z": "no property z",
        "missing vertex": r"refers to vertex \d+",
        "more columns": r"more .*than|numbers in line \d+|not an integer|ends before",
    },
    "off": {
        "more announced": "announces",
        "fewer announced": "announces",
        "missing vertex": r"refers to vertex \d+",
        "too few corners": r"corners that it announces, line \d+",
        "four coordinates": "4OFF",
        "decimal commas": r"line \d+; decimal commas",
    },
    "stl": {
        "cut short": "cut short",
        "decimal commas": r"line \d+.*no commas",
        "four corners": "with 4 corners",
    },
    "binary stl": {"more announced": "announces", "fewer announced": "announces"},
    "glb": {
        "extension": "KHR_draco_mesh_compression",
        "skin": "skin",
        "sparse": "sparse",
        "missing accessor": "missing accessor",
        "cut short": "announces more",
    },
    "3mf": {
        "extension": "extension 'b'",
        "missing vertex": "missing vertex",
        "missing object": "missing object",
        "no model": "names no model",
        "cut short": "broken|cut short",
    },
}
FAULTS["gltf"] = FAULTS["glb"]


def make_file(rng: np.random.Generator, form: str) -> GeneratedFile:
    """Return a random file of a format, damaged in one of six cases."""
    fault = str(rng.choice(list(FAULTS[form]))) if rng.random() < 1 / 6 else ""
    n_bodies = int(rng.integers(1, 4))
    polygonal = form in ("obj", "ply", "off")
    originals = [make_body(rng, triangles=not polygonal) for _ in range(n_bodies)]
    R, shift, scale = rotation(rng), rng.uniform(-100, 100, 3), float(rng.uniform(0.5, 1.5))
    if rng.random() < 0.3:
        R, shift, scale = np.eye(3), np.zeros(3), 1.0
    metre = 0.001 if form in ("glb", "gltf") else 1.0
    bodies = [
        each.placed(R * scale * metre, (R @ [300.0 * k, 0, 0] * scale + shift) * metre)
        for k, each in enumerate(originals)
    ]
    other_files: dict[str, bytes] = {}
    units, factor = str(rng.choice(["mm", "cm", "in"])), 1.0
    if form in ("glb", "gltf"):
        described, data, tags = _gltf(rng, bodies, fault)
        if form == "glb":
            content = _glb(described, data)
        else:
            uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
            described["buffers"][0]["uri"] = "part%20a.bin" if rng.random() < 0.5 else uri
            other_files = {"part a.bin": data}
            content = json.dumps(described, indent=int(rng.integers(3))).encode(str(rng.choice(["utf-8", "utf-8-sig"])))
    elif form == "3mf":
        unit, factor = [("millimeter", 1e-3), ("inch", 0.0254), ("centimeter", 0.01)][int(rng.integers(3))]
        content, tags = _three_mf(rng, bodies, fault, unit)
    else:
        writers = {"obj": _obj, "ply": _ply, "off": _off, "stl": _stl, "binary stl": _binary_stl}
        content, tags = writers[form](rng, bodies, fault)
        factor = workpiece.UNITS[units]
    states_units = form in ("glb", "gltf", "3mf")
    area, solid = sum(body.area for body in bodies), sum(body.volume for body in bodies)
    return GeneratedFile(
        f"part.{form.removeprefix('binary ')}", content, other_files, None if states_units else units, area * factor**2,
        solid * factor**3, n_bodies, FAULTS[form][fault] if fault else "", f"{fault} {tags}".strip(),
    )  # fmt: skip


def judge(file: GeneratedFile, folder: Path) -> tuple[str, str]:
    """Read a file with the product; return equal, refused, wrong or foreign, and a description of a failure."""
    path = folder / file.name
    path.write_bytes(file.content)
    for name, content in file.other_files.items():
        (folder / name).write_bytes(content)
    try:
        part = workpiece.load(path, file.units)
    except CellError as error:
        if error.exit_code == CellError.exit_code:
            return "foreign", f"{error}"
        if file.refusal and re.search(file.refusal, str(error)):
            return "refused", ""
        return "wrong", f"refused: {error} (expected {file.refusal or 'a part'})"
    except Exception as error:  # any other exception is a bug
        return "foreign", f"{type(error).__name__}: {error}"
    if file.refusal:
        return "wrong", f"read, but must be refused: {file.refusal}"
    mesh = part.reference
    one, two, _, uses = adjacent_faces(mesh.faces.astype(np.int64))
    bodies = label_bodies(len(mesh.faces), one, two)[1]
    area, solid = float(mesh.areas.sum()), volume(part)
    doubts = [finding.sentence for finding in part.findings if finding.kind not in (Kind.BODIES, Kind.UNITS)]
    faults = [
        f"{name} {found:.9g}, expected {expected:.9g}"
        for name, found, expected in (("area", area, file.area), ("volume", solid, file.volume))
        if solid is None or abs(found - expected) > TOLERANCE * expected
    ]
    if bodies != file.bodies:
        faults.append(f"{bodies} bodies, expected {file.bodies}")
    if (uses != 2).any():
        faults.append(f"{int((uses != 2).sum())} edges without two faces")
    faults += doubts
    return ("wrong", "; ".join(faults)) if faults else ("equal", "")


def _second_judge(file: GeneratedFile, folder: Path) -> bool:
    """Return whether trimesh reads the area of the file."""
    import trimesh

    with warnings.catch_warnings(action="ignore"):
        try:
            loaded: Any = trimesh.load(folder / file.name, force="mesh")
            area = float(loaded.area)
        except Exception:  # trimesh raises any exception
            return False
    factor = workpiece.UNITS[file.units] if file.units else 1.0
    return abs(area * factor**2 - file.area) < TOLERANCE * file.area


def results(count: int, seed: int, *, second: bool = False) -> Iterator[tuple[str, GeneratedFile, str, str, bool]]:
    """Yield format, file, result, description of a failure, and whether trimesh agrees."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            form = FORMATS[number % len(FORMATS)]
            file = make_file(np.random.default_rng([seed, number]), form)
            result, failure = judge(file, Path(folder))
            agrees = second and not file.refusal and _second_judge(file, Path(folder))
            yield form, file, result, failure and f"{number}: {failure} [{file.tags}]", agrees


def compared(count: int, seed: int, *, second: bool = False) -> list[dict[str, Any]]:
    """Return a row for each format."""
    rows = {form: {"format": form, "files": 0, "equal": 0, "refused": 0, "wrong": 0, "foreign": 0, "trimesh equal": 0,
                   "first failure": ""} for form in FORMATS}  # fmt: skip
    for form, _, result, failure, agrees in results(count, seed, second=second):
        row: dict[str, Any] = rows[form]
        row["files"] += 1
        row[result] += 1
        row["trimesh equal"] += agrees
        row["first failure"] = row["first failure"] or failure
    return list(rows.values())


def run() -> list[dict[str, Any]]:
    """Return a row for each format, of 2,000 files."""
    return compared(int(os.environ.get("GENERATED_FILES", "2000")), seed=0, second=True)
