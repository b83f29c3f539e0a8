"""Files of points: clouds that are read (PLY, text, PCD, E57, PTX, LAS), merged cloud and mesh that are written (PLY).

Numbers are read as they stand, without unit or frame. Points that are not finite, which organised clouds keep for rays
without an echo, are dropped. Written files are in the object frame, millimetres. Scalar fields have names that begin
with `scalar_`, as CloudCompare expects.
"""

import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell import files
from cell.errors import FileError
from cell.metrology import point_tables, scan_files
from cell.part.ply_elements import PlyError, read_elements
from cell.runs import ply
from cell.text import decode, lines_of
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import PointCloud
from planner.values import Floats

_TEXTS = (".xyz", ".txt", ".csv", ".asc", ".pts")
SUFFIXES = (".ply", ".pcd", *_TEXTS, *scan_files.SUFFIXES)

_PCD_FORMS = ("f2", "f4", "f8", *(f"{kind}{size}" for kind in "iu" for size in (1, 2, 4, 8)))


def read(path: Path) -> Floats:
    """Read the points (P, 3) of a file, in its own unit and frame; those of all its scans, by their poses.

    Raises:
        FileError: if it cannot be read.
    """
    with files.file_errors(f"{path} cannot be read"):
        content = files.read_bytes(path)
    readers: dict[str, Callable[[bytes], Floats]] = {
        ".ply": _ply,
        ".pcd": _pcd,
        **dict.fromkeys(_TEXTS, point_tables.read_points),
    }
    if path.suffix.lower() not in SUFFIXES:
        raise FileError(f"{path} is '{path.suffix}'; points are read from {', '.join(SUFFIXES)}: convert it")
    if not content:
        raise FileError(f"{path} is empty (0 bytes)")
    if path.suffix.lower() in scan_files.SUFFIXES:
        scans = [scan.points_in_file for scan in scan_files.read(path)]
        return _finite(path, np.concatenate(scans) if scans else np.zeros((0, 3)))
    try:
        points = readers[path.suffix.lower()](content)
    except (PlyError, point_tables.TableError, _PcdError) as error:
        raise FileError(f"{path} {error}") from error
    return _finite(path, points)


def _finite(path: Path, points: Floats) -> Floats:
    finite: Floats = points[np.isfinite(points).all(axis=1)]
    if len(points) and not len(finite):
        raise FileError(f"{path} has {len(points)} points, and the coordinates of none are finite; scan again")
    return finite


def file_of_view(folder: Path, stop: int) -> Path | None:
    """Return the point file of a folder whose name ends in the number of a view; None if there is none.

    Raises:
        FileError: if there are several.
    """
    paths = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES
        and (number := re.search(r"(\d+)$", path.stem)) is not None
        and int(number[1]) == stop
    ]
    if len(paths) > 1:
        raise FileError(f"{paths[0]} and {paths[1].name} both belong to view {stop}; remove one of them")
    return paths[0] if paths else None


def missing_file(folder: Path, stop: int) -> str:
    """Return why a folder has no file of a view: a format that is not read, or no file of this number."""
    for path in sorted(folder.iterdir()):
        number = re.search(r"(\d+)$", path.stem)
        if path.is_file() and number is not None and int(number[1]) == stop:
            formats = ", ".join(SUFFIXES)
            return f"{path} of view {stop} is '{path.suffix}'; points are read from {formats}: convert it"
    return f"{folder} has no file of view {stop}; name it by that number, such as {stop:04d}.ply"


def read_rows(path: Path) -> list[point_tables.Row]:
    """Read a text file as rows of words; spaces, tabs, commas or semicolons separate them.

    Raises:
        FileError: if it cannot be read.
    """
    try:
        with files.file_errors(f"{path} cannot be read"):
            return point_tables.read_rows(files.read_bytes(path))[0]
    except point_tables.TableError as error:
        raise FileError(f"{path} {error}") from error


def _ply(content: bytes) -> Floats:
    vertex = read_elements(content).get("vertex")
    if vertex is None:
        raise PlyError("has no element 'vertex'")
    return vertex.columns("x", "y", "z")


class _PcdError(ValueError):
    """A PCD file that cannot be read; the message follows the name of the file."""


def _pcd(content: bytes) -> Floats:
    content = content.removeprefix(b"\xef\xbb\xbf")
    end = re.search(rb"(?:^|[\r\n])DATA[ \t]+(\w+)[ \t]*(?:\r\n|\n|\r)", content)
    if end is None:
        raise _PcdError("is not a PCD file, or its header has no DATA line; export it again")
    header = {words[0]: words[1:] for line in lines_of(decode(content[: end.start()])) if (words := line.split())}
    try:
        columns, count = _pcd_columns(header)
        grid = [int(header[key][0]) for key in ("WIDTH", "HEIGHT") if key in header]
    except (KeyError, ValueError, IndexError) as error:
        raise _PcdError(
            "has a header without valid FIELDS, SIZE and TYPE of equal length, or POINTS; export it again"
        ) from error
    if len(grid) == 2 and grid[0] * grid[1] != count:
        raise _PcdError(f"announces {count} points but WIDTH {grid[0]} and HEIGHT {grid[1]}; export it again")
    if any(axis not in [name for name, _, length in columns if length == 1] for axis in "xyz"):
        fields = ", ".join(f"{name} ({length})" if length != 1 else name for name, _, length in columns)
        raise _PcdError(f"has no x, y and z; its fields are {fields}")
    body, kind = content[end.end() :], end[1].lower()
    if kind == b"ascii":
        return _pcd_text(body.decode("latin-1"), columns, count)  # numbers are ASCII
    if kind not in (b"binary", b"binary_compressed"):
        raise _PcdError(f"has the data '{kind.decode()}', which is not supported; write ascii or binary")
    width = sum(length * int(form[1:]) for _, form, length in columns)
    if kind == b"binary_compressed":
        body = _unpack_lzf(body, width * count)
    if len(body) < width * count:
        raise _PcdError(f"ends before its {count} points; it is cut short, export or copy it again")
    if kind == b"binary" and len(body) - width * count >= max(width, 1):
        raise _PcdError(f"has {len(body) - width * count} bytes behind its {count} points; correct its header")
    if not count:
        return np.empty((0, 3))
    # Packed data are stored column by column, plain data row by row.
    found, at = {}, 0
    for name, form, length in columns:
        size = length * int(form[1:])
        if name in ("x", "y", "z") and length == 1:
            stride = size if kind == b"binary_compressed" else width
            found[name] = np.ndarray((count,), f"<{form}", body, at, (stride,)).astype(np.float64)
        at += size * count if kind == b"binary_compressed" else size
    return np.stack([found[axis] for axis in "xyz"], axis=1)


def _pcd_columns(header: dict[str, list[str]]) -> tuple[list[tuple[str, str, int]], int]:
    """Return name, type and length of each field, and the number of points."""
    names = [name.lower() for name in header["FIELDS"]]
    lengths = [int(length) for length in header.get("COUNT", ["1"] * len(names))]
    forms = [kind.lower() + str(int(size)) for kind, size in zip(header["TYPE"], header["SIZE"], strict=True)]
    if any(form not in _PCD_FORMS for form in forms) or min(lengths) < 0:
        raise ValueError
    count = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
    if count < 0:
        raise ValueError
    return list(zip(names, forms, lengths, strict=True)), count


def _pcd_text(text: str, columns: list[tuple[str, str, int]], count: int) -> Floats:
    starts: dict[str, int] = {}
    at = 0
    for name, _, length in columns:
        starts.setdefault(name, at)
        at += length
    rows = [line for line in lines_of(text) if line.strip("\0\x1a \t")]
    if len(rows) > count:
        raise _PcdError(f"has {len(rows)} points but announces {count}; correct its header, or export it again")
    if len(rows) < count:
        raise _PcdError(f"has {len(rows)} of {count} points; it is cut short, export or copy it again")
    points = np.empty((count, 3))
    for k, row in enumerate(rows):
        words = row.split()
        numbers = [point_tables.number_of(words[starts[axis]]) for axis in "xyz"] if len(words) >= at else [None]
        if None in numbers:
            raise _PcdError(f"has a point without {at} numbers, point {k + 1}: {row.strip()[:60]}")
        points[k] = numbers
    return points


def _unpack_lzf(packed: bytes, expected: int) -> bytes:
    """Unpack the LZF compression of PCL: sizes, then literals and references back."""
    if len(packed) < 8:
        raise _PcdError("ends before its packed points; it is cut short, export or copy it again")
    size, full = struct.unpack_from("<II", packed)
    if full != expected or 8 + size > len(packed):
        raise _PcdError(f"announces {full} unpacked bytes where its header needs {expected}, or is cut short")
    out, at, end = bytearray(), 8, 8 + size
    try:
        while at < end:
            control = packed[at]
            at += 1
            if control < 32:
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += packed[at]
                at += 1
            begin = len(out) - ((control & 31) << 8) - packed[at] - 1
            at += 1
            if begin < 0 or len(out) > full:
                raise IndexError
            piece = out[begin : begin + length + 2]
            repeats = -(-(length + 2) // max(len(piece), 1))
            out += (piece * repeats)[: length + 2]
    except IndexError as error:
        raise _PcdError("has packed points that cannot be unpacked; export it again") from error
    if len(out) != full:
        raise _PcdError("has packed points that cannot be unpacked; export it again")
    return bytes(out)


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
