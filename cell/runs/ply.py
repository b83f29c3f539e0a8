"""Read and write the binary PLY files of a run folder: exact coordinates, vertices and faces in their order."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import trimesh

_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "ushort": "<u2", "uchar": "|u1"}
_NAMES = {kind: name for name, kind in _TYPES.items()}
_CORNERS = "corners"  # number of vertices of a face, stored before their indices


def mesh(content: bytes) -> TriangleMesh:
    """Return the mesh [m] of a file in millimetres.

    A coordinate may differ from the written one by the last bit of a double.
    """
    read = elements(content)
    faces = read["face"]
    region = faces["region"] if faces.dtype.names and "region" in faces.dtype.names else None
    return TriangleMesh(positions(read["vertex"]), faces["vertex_indices"], region)


def to_trimesh(mesh: TriangleMesh) -> "trimesh.Trimesh":
    """Return a copy of a mesh [m] for the user; `units` is "m", and vertices and faces keep their numbers."""
    import trimesh

    copy = trimesh.Trimesh(mesh.vertices.copy(), mesh.faces.copy(), process=False)
    copy.units = "m"
    return copy


def mesh_bytes(mesh: TriangleMesh) -> bytes:
    """Return a mesh [m] as the bytes of a file in millimetres, with the region of each face if it has regions.

    Vertices are doubles; trimesh's writer would round them to float32.
    """
    regions = {} if mesh.region is None else {"region": mesh.region.astype("<i4")}
    face = triangle_rows(mesh.faces, regions)
    return b"".join(file_pieces(["object frame, millimetres"], {"vertex": point_rows(mesh.vertices, {}), "face": face}))


def point_rows(positions: Floats, more: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return positions (N, 3) [m] as an element in millimetres, with further columns (N,)."""
    return _element({axis: positions[:, i] * 1000.0 for i, axis in enumerate("xyz")} | dict(more))


def triangle_rows(faces: NDArray[np.int32], more: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return faces (F, 3) as an element, with further columns (F,)."""
    corners = {_CORNERS: np.full(len(faces), 3, dtype=np.uint8), "vertex_indices": faces.astype("<i4")}
    return _element(corners | dict(more))


def _element(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.void]:
    """Return columns as one structured array."""
    kinds = [(name, column.dtype, column.shape[1:]) for name, column in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), dtype=kinds)
    for name, column in columns.items():
        rows[name] = column
    return rows


def file_pieces(comments: Sequence[str], elements: Mapping[str, NDArray[np.void]]) -> Iterator[bytes]:
    """Yield the bytes of a file of named elements; comments are ASCII, one line each."""
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)]
    for element, rows in elements.items():
        header.append(f"element {element} {len(rows)}")
        for name, (kind, *_) in (rows.dtype.fields or {}).items():
            if name != _CORNERS:
                prefix = "list uchar " if kind.shape else ""
                header.append(f"property {prefix}{_NAMES[kind.base.str]} {name}")
    yield ("\n".join([*header, "end_header"]) + "\n").encode("ascii")
    for rows in elements.values():
        yield rows.tobytes()


def positions(vertices: NDArray[np.void]) -> Floats:
    """Return x, y and z (N, 3) [m] of an element in millimetres."""
    return np.stack([vertices[axis] for axis in "xyz"], axis=1) / 1000.0


def elements(content: bytes) -> dict[str, NDArray[np.void]]:
    """Return the elements of a little-endian binary PLY with triangular faces, as structured arrays by name.

    The vertices of a face are in `vertex_indices`. Raises PlannerError if header and length differ, ValueError if the
    content is not such a file.
    """
    header, separator, body = content.partition(b"end_header\n")
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
    if not separator or at != len(body):
        raise PlannerError("its header and its length differ")
    return arrays
