"""The binary PLY files of a run folder: exactly the numbers that were used, and read back with nothing merged."""

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.surface.mesh import TriangleMesh
from planner.values import Floats

_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uchar": "u1"}


def mesh(content: bytes) -> TriangleMesh:
    """A mesh [m] of a file in millimetres.

    A coordinate may differ from the one that was used by the last bit of a double.

    Raises:
        PlannerError: if the content is not a whole PLY.
    """
    read = elements(content)
    faces = read["face"]
    region = faces["region"] if faces.dtype.names and "region" in faces.dtype.names else None
    return TriangleMesh(places(read["vertex"]), faces["vertex_indices"], region)


def written(mesh: TriangleMesh) -> bytes:
    """A mesh [m] as a file in millimetres, with the region of each face where it has such.

    Vertices are doubles, so that the file holds exactly what was used; trimesh's writer would round to float32.
    """
    vertices = np.ascontiguousarray(mesh.vertices * 1000.0, dtype="<f8")
    regions = mesh.region is not None
    faces = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("v", "<i4", 3), *[("region", "<i4")] * regions])
    faces["n"], faces["v"] = 3, mesh.faces
    if mesh.region is not None:
        faces["region"] = mesh.region
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment object frame, millimetres\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
        + "property int region\n" * regions
        + "end_header\n"
    )
    return header.encode() + vertices.tobytes() + faces.tobytes()


def places(vertices: NDArray[np.void]) -> Floats:
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
                kinds[list(kinds)[-1]] += [("corners", "u1"), (name, _TYPES[kind], 3)]
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
