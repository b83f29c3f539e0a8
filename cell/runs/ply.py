"""The binary PLY files of a run folder: exactly the numbers that were used, and read back with nothing merged."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "ushort": "<u2", "uchar": "|u1"}
_NAMES = {kind: name for name, kind in _TYPES.items()}
_CORNERS = "corners"  # how many a face has, before their numbers


def mesh(content: bytes) -> TriangleMesh:
    """A mesh [m] of a file in millimetres.

    A coordinate may differ from the one that was used by the last bit of a double.

    Raises:
        PlannerError: if the content is not a whole PLY.
    """
    read = elements(content)
    faces = read["face"]
    region = faces["region"] if faces.dtype.names and "region" in faces.dtype.names else None
    return TriangleMesh(positions(read["vertex"]), faces["vertex_indices"], region)


def mesh_bytes(mesh: TriangleMesh) -> bytes:
    """A mesh [m] as a file in millimetres, with the region of each face where it has such.

    Vertices are doubles, so that the file holds exactly what was used; trimesh's writer would round to float32.
    """
    regions = {} if mesh.region is None else {"region": mesh.region.astype("<i4")}
    face = triangle_rows(mesh.faces, regions)
    return b"".join(file_pieces(["object frame, millimetres"], {"vertex": point_rows(mesh.vertices, {}), "face": face}))


def point_rows(places: Floats, more: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Places (N, 3) [m] as an element in millimetres, and further columns (N,) of the types that the file gets."""
    return _element({axis: places[:, i] * 1000.0 for i, axis in enumerate("xyz")} | dict(more))


def triangle_rows(faces: NDArray[np.int32], more: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Faces (F, 3) as an element, and further columns (F,)."""
    corners = {_CORNERS: np.full(len(faces), 3, dtype=np.uint8), "vertex_indices": faces.astype("<i4")}
    return _element(corners | dict(more))


def _element(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Columns as rows, one behind the other."""
    kinds = [(name, column.dtype, column.shape[1:]) for name, column in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), dtype=kinds)
    for name, column in columns.items():
        rows[name] = column
    return rows


def file_pieces(comments: Sequence[str], elements: Mapping[str, NDArray[np.void]]) -> Iterator[bytes]:
    """A file of elements by name, piece by piece; comments are of ASCII, one line each."""
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    for element, rows in elements.items():
        header.append(f"element {element} {len(rows)}")
        for name, (kind, *_) in (rows.dtype.fields or {}).items():
            if name != _CORNERS:
                listed = "list uchar " if kind.shape else ""
                header.append(f"property {listed}{_NAMES[kind.base.str]} {name}")
    yield ("\n".join([*header, "end_header"]) + "\n").encode("ascii")
    for rows in elements.values():
        yield rows.tobytes()


def positions(vertices: NDArray[np.void]) -> Floats:
    """(N, 3) x, y and z of an element in millimetres [m]."""
    return np.stack([vertices[axis] for axis in "xyz"], axis=1) / 1000.0


def elements(content: bytes) -> dict[str, NDArray[np.void]]:
    """Its elements as structured arrays, by name; triangles are `vertex_indices` of a face.

    Args:
        content: of a little-endian binary PLY whose faces are triangles.

    Raises:
        PlannerError: if header and length differ.
        ValueError: if it is none.
    """
    header, found, body = content.partition(b"end_header\n")
    kinds: dict[str, list[tuple[str, str] | tuple[str, str, int]]] = {}
    counts: dict[str, int] = {}
    for line in header.decode("ascii").splitlines():
        match line.split():
            case ["element", name, count]:
                kinds[name], counts[name] = [], int(count)
            case ["property", "list", _, kind, name]:
                kinds[list(kinds)[-1]] += [(_CORNERS, "u1"), (name, _TYPES[kind], 3)]
            case ["property", kind, name]:
                kinds[list(kinds)[-1]].append((name, _TYPES[kind]))
    arrays, at = {}, 0
    for name, fields in kinds.items():
        row = np.dtype(fields)
        arrays[name] = np.frombuffer(body[at : at + counts[name] * row.itemsize], dtype=row)
        at += counts[name] * row.itemsize
    if not found or at != len(body):
        raise PlannerError("its header and its length differ")
    return arrays
