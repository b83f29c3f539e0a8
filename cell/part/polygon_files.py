"""Polygon meshes from OBJ, OFF and PLY files, with their colours.

Every index, count and keyword is checked against the file: a face that refers to a missing vertex, a count that differs
from the rows, or geometry that is not supported is an error with its line, never another part.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.part.ply_elements import Element, PlyError, read_elements
from cell.part.polygons import PolygonError, PolygonMesh
from cell.text import decode, lines_of, parse_numbers
from planner.values import Floats, Ints

_FREE_FORM = ("surf", "curv", "curv2", "cstype", "bzp", "bsp", "patch")
_OTHER_FILE = ("call", "csh")
_VERTEX, _FACE = ("v ", "v\t", "V ", "V\t"), ("f ", "f\t", "F ", "F\t", "fo")  # fo: a face in old files


def read_obj(content: bytes) -> PolygonMesh:
    """Read the faces of an OBJ file; points, lines, texture coordinates and normals are ignored.

    Negative indices count back from the last vertex before the face. Colours are those of `v x y z r g b`.

    Raises:
        PolygonError: with the line, if a vertex or a face is not valid, or the file has free-form surfaces.
    """
    text = decode(content).rstrip("\0")
    if "\0" in text:
        raise PolygonError("is not an OBJ file: it contains binary data; export the mesh again")
    lines = [line.partition("#")[0].strip() if "#" in line else line.strip() for line in lines_of(text)]
    if "\\" in text:
        lines = _joined(lines)
    for number, line in enumerate(lines):
        if line[:1] in ("s", "c", "b", "p") and (keyword := line.split(None, 1)[0]) in (*_FREE_FORM, *_OTHER_FILE):
            kind = "a free-form surface" if keyword in _FREE_FORM else "a reference to another file"
            raise PolygonError(f"has {kind}, line {number + 1}, which is not supported; export all as polygons")
    of_vertices = [k for k, line in enumerate(lines) if line[:2] in _VERTEX]
    vertices, colours = _obj_vertices([lines[k][2:] for k in of_vertices], of_vertices)
    corners, counts = _obj_corners(lines, np.array(of_vertices, np.int64))
    return _coloured(PolygonMesh(vertices, corners, counts), colours)


def _obj_vertices(texts: Sequence[str], line_of: Sequence[int]) -> tuple[Floats, Floats | None]:
    """Return coordinates (V, 3) and colours (V, 3), 0 to 255, of the vertices of an OBJ file; None without colours.

    Args:
        texts: of the vertices, without `v`.
        line_of: index of the line of each.
    """
    vertices, rows, starts, widths = _vertices(texts, line_of)
    weighted = np.flatnonzero(widths == 4)
    weighted = weighted[rows[starts[weighted] + 3] != 1]
    if len(weighted):
        raise PolygonError(
            f"has a vertex with a fourth number, line {line_of[weighted[0]] + 1}, a weight that is not 1, or a "
            "blank in a number; export three coordinates"
        )
    colours = None
    if len(widths) and (widths >= 6).all():
        colours = rows[starts[:, None] + np.arange(3, 6)]
        colours = colours * 255 if colours.max() <= 1 else colours
    return vertices, colours


def _obj_corners(lines: Sequence[str], of_vertices: Ints) -> tuple[Ints, Ints]:
    """Return vertex indices (C,), from 0, of all faces of an OBJ file, and the number of corners (P,) of each.

    Args:
        lines: of the file.
        of_vertices: (V,) indices of the lines with a vertex.
    """
    of_faces = [k for k, line in enumerate(lines) if line[:2] in _FACE]
    words = [lines[k][2:] for k in of_faces]
    if any("/" in line for line in words):
        words = [re.sub(r"/\S*", "", line) for line in words]
    numbers, counts = _table(words, of_faces)
    corners = _indices(numbers)
    face_of = np.repeat(np.arange(len(counts)), counts)
    line_of = np.array(of_faces, np.int64)[face_of]
    before = np.searchsorted(of_vertices, line_of)
    corners = np.where(corners < 0, corners + before, corners - 1)
    bad = (corners < 0) | (corners >= len(of_vertices))
    if bad.any():
        first = int(np.argmax(bad))
        raise PolygonError(
            f"has a face that refers to vertex {int(numbers[first])}, line {line_of[first] + 1}; indices are 1 to "
            f"{len(of_vertices)}, or -1 and below back from the vertices before the face; export the mesh again"
        )
    return corners, counts


def _joined(lines: list[str]) -> list[str]:
    """Join vertices and faces whose lines end in a backslash with the next one, which becomes empty.

    Names and comments can end in a backslash, too.
    """
    logical_lines: list[str] = []
    begin = 0
    for line in lines:
        if logical_lines and logical_lines[begin].endswith("\\") and logical_lines[begin][:2] in (*_VERTEX, *_FACE):
            logical_lines[begin] = f"{logical_lines[begin][:-1]} {line}"
            logical_lines.append("")
        else:
            begin = len(logical_lines)
            logical_lines.append(line)
    return logical_lines


def read_off(content: bytes) -> PolygonMesh:
    """Read an OFF file with polygons, with or without normals, texture coordinates and colours.

    Raises:
        PolygonError: with the line, if a row is not valid, or the rows are not as many as announced.
    """
    if b"\0" in content and not content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise PolygonError("is a binary OFF file, which is not supported; export it as text, or as PLY or STL")
    lines = [line.partition("#")[0].strip() for line in lines_of(decode(content))]
    filled = [k for k, line in enumerate(lines) if line]
    if not filled:
        raise PolygonError("has no data; export the mesh again")
    head = lines[filled[0]].split()
    if head[0].upper().endswith("OFF"):
        keyword = head.pop(0).upper()
        if "BINARY" in [word.upper() for word in head]:
            raise PolygonError("is a binary OFF file, which is not supported; export it as text, or as PLY or STL")
        if "4" in keyword or (
            keyword.removesuffix("OFF").endswith("N") and keyword not in ("NOFF", "CNOFF", "STCNOFF", "STNOFF")
        ):
            raise PolygonError(f"is a {keyword} file with more than three coordinates, which is not supported")
        if not head:
            filled.pop(0)
            head = lines[filled[0]].split() if filled else []
    counts, _ = _table([" ".join(head)], filled[:1] or [0])
    if len(counts) < 2 or (counts < 0).any() or not _are_integers(counts):
        raise PolygonError("does not announce its numbers of vertices and faces; export the mesh again")
    n_vertices, n_faces = int(counts[0]), int(counts[1])
    rows = filled[1:]
    if len(rows) != n_vertices + n_faces:
        rebuilt = _off_rows(" ".join(lines[k] for k in rows).split(), n_vertices, n_faces)
        if rebuilt is None:
            raise PolygonError(
                f"announces {n_vertices} vertices and {n_faces} faces but has {len(rows)} rows, one is needed for "
                "each; export or copy it again"
            )
        lines, rows = rebuilt, list(range(len(rebuilt)))
    of_vertices, of_faces = rows[:n_vertices], rows[n_vertices:]
    vertices = _vertices([lines[k] for k in of_vertices], of_vertices)[0]
    numbers, widths = _table([lines[k] for k in of_faces], of_faces)
    starts = np.cumsum(widths) - widths
    sizes = _indices(numbers[starts]) if n_faces else np.zeros(0, np.int64)
    short = (sizes < 3) | (sizes > widths - 1)
    if short.any():
        raise PolygonError(
            f"has a face without the corners that it announces, line {of_faces[int(np.argmax(short))] + 1}"
        )
    corners = numbers[np.repeat(starts + 1 - (np.cumsum(sizes) - sizes), sizes) + np.arange(int(sizes.sum()))]
    mesh = PolygonMesh(vertices, _indices(corners), sizes)
    extra = widths - 1 - sizes
    if n_faces and (extra >= 3).all():
        colours = numbers[(starts + 1 + sizes)[:, None] + np.arange(3)]
        is_share = any("." in lines[k] for k in of_faces) and colours.max() <= 1
        return PolygonMesh(vertices, mesh.corners, sizes, colours * 255 if is_share else colours)
    return mesh


def _off_rows(words: list[str], n_vertices: int, n_faces: int) -> list[str] | None:
    """Return the rows of an OFF file with line breaks elsewhere; None if its words are not coordinates and corners."""
    at = 3 * n_vertices
    if at > len(words):
        return None
    rows = [" ".join(words[k : k + 3]) for k in range(0, at, 3)]
    for _ in range(n_faces):
        if at >= len(words) or not (words[at].isdecimal() and len(words[at]) < 10):
            return None
        begin, at = at, at + 1 + int(words[at])
        rows.append(" ".join(words[begin:at]))
    return rows if at == len(words) else None


def read_ply(content: bytes) -> PolygonMesh:
    """Read the faces and triangle strips of a PLY file.

    Raises:
        PolygonError: if the file is broken or has no vertices.
    """
    try:
        elements = read_elements(content)
        vertex = elements.get("vertex", Element(0))
        if not vertex.count:
            return PolygonMesh(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64))
        vertices = vertex.columns("x", "y", "z")
        face = elements.get("face", Element(0))
        counts, corners = np.zeros(0, np.int64), np.zeros(0, np.int64)
        if face.count:
            names = [name for name in ("vertex_indices", "vertex_index") if name in face.lists]
            if not names:
                raise PlyError("has faces without a list of vertex indices; export it again")
            counts, corners = face.lists[names[0]][0], _indices(face.lists[names[0]][1])
        colours = _ply_colours(face) if face.count else None
        strips = elements.get("tristrips", Element(0))
        if strips.count:
            if len(strips.lists) != 1:
                raise PlyError("has triangle strips without one list of vertex indices; export it again")
            more = _strip_triangles(*next(iter(strips.lists.values())))
            corners = np.concatenate([corners, more.ravel()])
            counts, colours = np.concatenate([counts, np.full(len(more), 3)]), None
    except PlyError as error:
        raise PolygonError(str(error)) from error
    mesh = PolygonMesh(vertices, corners, counts, colours)
    return mesh if colours is not None else _coloured(mesh, _ply_colours(vertex))


def _coloured(mesh: PolygonMesh, colours: Floats | None) -> PolygonMesh:
    """Return a mesh with the mean colours (V, 3) of its vertices; itself without colours, or if a face is not valid."""
    corners = mesh.corners
    is_valid = len(corners) and corners.min() >= 0 and corners.max() < len(mesh.vertices) and mesh.counts.min() > 0
    if colours is None or not is_valid:
        return mesh
    return PolygonMesh(mesh.vertices, corners, mesh.counts, mesh.means(colours))


def _ply_colours(element: Element) -> Floats | None:
    """Return red, green and blue of the rows, 0 to 255; None without colours."""
    names = ("red", "green", "blue")
    if not all(name in element.scalars for name in names):
        return None
    colours = element.columns(*names)
    is_share = element.scalars["red"].dtype.kind == "f" and colours.size and colours.max() <= 1
    return colours * 255 if is_share else colours


def _strip_triangles(lengths: Ints, values: NDArray[Any]) -> Ints:
    """Return the triangles (F, 3) of strips; -1 ends a strip, and every second triangle has the opposite winding."""
    triangles: list[Ints] = [np.zeros((0, 3), np.int64)]
    for indices in np.split(_indices(values), np.cumsum(lengths)[:-1]):
        for strip in np.split(indices, np.flatnonzero(indices == -1)):
            strip = strip[strip != -1]
            if len(strip) >= 3:
                three = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
                three[1::2] = three[1::2, [1, 0, 2]]
                triangles.append(three)
    return np.concatenate(triangles)


def _vertices(texts: Sequence[str], line_of: Sequence[int]) -> tuple[Floats, Floats, Ints, Ints]:
    """Return coordinates (V, 3), all numbers of the vertices, and begin and number (V,) of those of each vertex.

    Raises:
        PolygonError: with the line, if a vertex has fewer than three numbers.
    """
    numbers, widths = _table(texts, line_of)
    if len(widths) and widths.min() < 3:
        line = line_of[int(np.argmin(widths))] + 1
        raise PolygonError(f"has a vertex with fewer than three coordinates, line {line}")
    starts = np.cumsum(widths) - widths
    vertices = numbers[starts[:, None] + np.arange(3)] if len(starts) else np.zeros((0, 3))
    return vertices, numbers, starts, widths


def _are_integers(numbers: NDArray[Any]) -> bool:
    """Return whether all numbers are integers that a double represents exactly, none of them NaN or infinity."""
    return bool((np.abs(numbers) < 2**53).all()) and not (numbers % 1).any()


def _indices(numbers: NDArray[Any]) -> Ints:
    """Return numbers of faces as integers.

    Raises:
        PolygonError: if one is not an integer.
    """
    if not _are_integers(numbers):
        raise PolygonError("has a face with a number that is not an integer; export the mesh again")
    return numbers.astype(np.int64)


def _table(rows: Sequence[str], line_of: Sequence[int]) -> tuple[Floats, Ints]:
    """Return the numbers of all rows one after the other, and how many each row has.

    Args:
        rows: texts.
        line_of: index of the line of each row in the file, for messages.
    """
    widths = np.array([len(row.split()) for row in rows], np.int64)
    numbers = parse_numbers("\n".join(rows), int(widths.sum()))
    if numbers is None:
        for row, line in zip(rows, line_of, strict=True):
            for word in row.split():
                try:
                    float(word.replace("_", "?"))
                except ValueError as error:
                    hint = "; decimal commas are not supported, write decimal points" if "," in word else ""
                    raise PolygonError(
                        f"has '{word[:40]}' where a number is expected, line {line + 1}{hint}"
                    ) from error
        numbers = np.array([float(word) for row in rows for word in row.split()])
    return numbers, widths
