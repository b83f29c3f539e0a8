"""Files of points: clouds that are read (PLY, XYZ and other text, PCD), merged cloud and mesh that are written (PLY).

Numbers are read as they stand, without unit or frame. Points that are not finite, which organised clouds keep for rays
without an echo, are dropped. Written files are in the object frame, millimetres. Scalar fields have names that begin
with `scalar_`, as CloudCompare expects.
"""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.runs import ply
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud
from planner.values import Floats

SUFFIXES = (".ply", ".xyz", ".txt", ".pcd")

_PLY_TYPE_NAMES = (
    "char=i1 uchar=u1 short=i2 ushort=u2 int=i4 uint=u4 float=f4 double=f8 "
    "int8=i1 uint8=u1 int16=i2 uint16=u2 int32=i4 uint32=u4 float32=f4 float64=f8"
)
_PLY_TYPES = dict(pair.split("=") for pair in _PLY_TYPE_NAMES.split())


class UnreadableError(ValueError):
    """The content of a file is no list of points; the message names the cause."""


def read(path: Path) -> Floats:
    """Read the points (P, 3) of a file, in its own unit and frame.

    Raises:
        FileError: if it cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    readers: dict[str, Callable[[bytes], Floats]] = {".ply": _ply, ".pcd": _pcd, ".xyz": _text, ".txt": _text}
    if path.suffix.lower() not in readers:
        raise FileError(f"{path} is '{path.suffix}'; points are read from {', '.join(SUFFIXES)}")
    try:
        points = readers[path.suffix.lower()](content)
    except KeyError as error:
        raise FileError(f"{path} has no readable points: its header lacks {error}, or {error} is unknown") from error
    except UnreadableError as error:
        raise FileError(f"{path} has no readable points: {error}") from error
    except (ValueError, IndexError, TypeError) as error:
        raise FileError(
            f"{path} has no readable points: a value is not a number, or its lines differ in length, or its content is "
            "not that of its header; write it again"
        ) from error
    finite: Floats = points[np.isfinite(points).all(axis=1)]
    if len(points) and not len(finite):
        raise FileError(f"{path} has {len(points)} points, and the coordinates of none are finite; scan again")
    return finite


def file_of_view(folder: Path, stop: int) -> Path | None:
    """Return the point file of a folder whose name ends in the number of a view; None if there is none.

    Raises:
        FileError: if there are several.
    """
    found = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES
        and (number := re.search(r"(\d+)$", path.stem)) is not None
        and int(number[1]) == stop
    ]
    if len(found) > 1:
        raise FileError(f"{found[0]} and {found[1].name} both belong to view {stop}; remove one of them")
    return found[0] if found else None


def words_of_lines(path: Path) -> list[list[str]]:
    """Read a text file as words; spaces, tabs, commas or semicolons separate them.

    Raises:
        FileError: if it cannot be read.
    """
    try:
        return _words(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error


def _words(text: str) -> list[list[str]]:
    return [line.split() for line in text.replace(",", " ").replace(";", " ").splitlines()]


def _text(content: bytes) -> Floats:
    """Read the first three numbers of each line."""
    lines = _words(content.decode("utf-8-sig"))
    rows = [[float(word) for word in words[:3]] for words in lines if words and not words[0].startswith(("#", "/"))]
    if not rows:
        raise UnreadableError("it has no lines of numbers")
    return _three(np.array(rows, dtype=np.float64).reshape(len(rows), -1))


def _ply(content: bytes) -> Floats:
    header, found, body = content.partition(b"end_header")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    if not found or lines[0] != ["ply"]:
        raise UnreadableError("it is no complete PLY")
    kind = {line[0]: line[1] for line in lines if len(line) > 1}["format"]
    elements = [number for number, line in enumerate(lines) if line[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise UnreadableError("its first element is not 'vertex'")
    count = int(lines[elements[0]][2])
    own = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    fields = [(line[-1], line[1]) for line in own if line[:1] == ["property"]]
    body = body.partition(b"\n")[2]
    if kind == "ascii":
        return _from_text(body, [name for name, _ in fields], count)
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    return _from_binary(body, np.dtype([(name, order + _PLY_TYPES[form]) for name, form in fields]), count)


def _pcd(content: bytes) -> Floats:
    header, found, rest = content.partition(b"DATA ")
    if not found:
        raise UnreadableError("it is no complete PCD")
    keys = {line.split()[0]: line.split()[1:] for line in header.decode("ascii").splitlines() if line[:1] not in "# "}
    kind, _, body = rest.partition(b"\n")
    count = int(keys["POINTS"][0]) if "POINTS" in keys else int(keys["WIDTH"][0]) * int(keys["HEIGHT"][0])
    names, sizes = keys["FIELDS"], keys["SIZE"]
    counts = [int(each) for each in keys.get("COUNT", ["1"] * len(names))]
    if kind.strip() == b"ascii":
        wide = [name if k == 0 else f"{name} {k}" for name, n in zip(names, counts, strict=True) for k in range(n)]
        return _from_text(body, wide, count)
    if kind.strip() != b"binary":
        raise UnreadableError(f"its data are '{kind.strip().decode('ascii')}'; write them as ascii or binary")
    forms = [kind.lower() + size for kind, size in zip(keys["TYPE"], sizes, strict=True)]
    row = np.dtype([(name, f"<{form}", (n,)) for name, form, n in zip(names, forms, counts, strict=True)])
    return _from_binary(body, row, count)


def _from_text(body: bytes, names: list[str], count: int) -> Floats:
    rows = [[float(word) for word in row.split()] for row in body.decode("ascii").splitlines()[:count]]
    if len(rows) != count:
        raise UnreadableError(f"it has {len(rows)} of {count} points")
    if not count:
        return np.empty((0, 3))
    return _three(np.array(rows, dtype=np.float64)[:, [names.index(axis) for axis in "xyz"]])


def _from_binary(body: bytes, row: "np.dtype[np.void]", count: int) -> Floats:
    if len(body) < count * row.itemsize:
        raise UnreadableError(f"it ends before its {count} points")
    table: NDArray[np.void] = np.frombuffer(body, dtype=row, count=count)
    if any(axis not in (row.names or ()) for axis in "xyz"):
        raise UnreadableError("its points have no x, y and z")
    return _three(np.stack([table[axis].reshape(count).astype(np.float64) for axis in "xyz"], axis=1))


def _three(points: Floats) -> Floats:
    if points.size == 0:
        return np.empty((0, 3))
    if points.shape[1] != 3:
        raise UnreadableError("its lines have fewer than three numbers")
    return points


def cloud_ply(cloud: PointCloud, stop: NDArray[np.int32], sigma: Floats, source: str) -> Iterator[bytes]:
    """Write a merged cloud as PLY, piece by piece: points with normals, view and expected standard deviation.

    Args:
        cloud: merged scans.
        stop: (N,) number of each point's view, from 1 in visiting order, as in the name of its file in scans/.
        sigma: (N,) along the ray [m]; NaN if not known.
        source: source of the points.
    """
    normals = {f"n{axis}": cloud.normals[:, i].astype("<f4") for i, axis in enumerate("xyz")}
    views = {"view": stop.astype("<i4"), "scalar_view": stop.astype("<f4")}
    more = normals | views | {"scalar_sigma_mm": (sigma * 1000.0).astype("<f4")}
    comments = ["object frame, millimetres; view: from 1 in visiting order", f"points: {_ascii_line(source)}"]
    return ply.file_pieces(comments, {"vertex": ply.point_rows(cloud.points, more)})


def mesh_ply(mesh: TriangleMesh, closed: NDArray[np.bool_], deviation: Floats, source: str) -> Iterator[bytes]:
    """Write the reconstructed surface as PLY, piece by piece.

    Args:
        mesh: the surface, object frame [m].
        closed: (F,) True for faces that close a hole, which were not measured.
        deviation: (V,) signed distance of each vertex from the reference [m], positive outside.
        source: source of the points.
    """
    vertices = ply.point_rows(mesh.vertices, {"scalar_deviation_mm": (deviation * 1000.0).astype("<f4")})
    faces = ply.triangle_rows(mesh.faces, {"closed": closed.astype(np.uint8)})
    comments = ["object frame, millimetres; closed 1: not measured", f"points: {_ascii_line(source)}"]
    return ply.file_pieces(comments, {"vertex": vertices, "face": faces})


def _ascii_line(text: str) -> str:
    """Convert a text to one line of a PLY header."""
    return " ".join(text.split()).encode("ascii", "backslashreplace").decode("ascii")
