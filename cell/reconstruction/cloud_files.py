"""The merged cloud and the mesh as binary PLY: object frame, millimetres.

What colours them has a name that begins with `scalar_`: CloudCompare takes such properties for scalar fields.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cell.reconstruction.cloud import PointCloud
from planner.surface.mesh import TriangleMesh
from planner.values import Floats


def cloud_ply(cloud: PointCloud, stop: NDArray[np.int32], sigma: Floats, source: str) -> Iterator[bytes]:
    """Points with normals, the view that gave them and their expected standard deviation.

    Args:
        cloud: merged scans.
        stop: (N,) number of the view of each point, from 1 in visiting order: that of its file in scans/.
        sigma: (N,) along the ray [m]; NaN where it is not known.
        source: where the points come from.

    Yields:
        the file, piece by piece.
    """
    scalars = ("scalar_view", "scalar_sigma_mm")
    kinds = [*((axis, "<f8") for axis in "xyz"), *((f"n{axis}", "<f4") for axis in "xyz"), ("view", "<i4")]
    rows = np.empty(len(cloud), dtype=[*kinds, *((name, "<f4") for name in scalars)])
    for column, axis in enumerate("xyz"):
        rows[axis] = cloud.points[:, column] * 1000.0
        rows[f"n{axis}"] = cloud.normals[:, column]
    rows["view"] = rows["scalar_view"] = stop
    rows["scalar_sigma_mm"] = sigma * 1000.0
    yield (
        "ply\nformat binary_little_endian 1.0\ncomment object frame, millimetres; view: from 1 in visiting order\n"
        f"comment points: {_line(source)}\n"
        f"element vertex {len(rows)}\nproperty double x\nproperty double y\nproperty double z\n"
        "property float nx\nproperty float ny\nproperty float nz\nproperty int view\n"
        f"{''.join(f'property float {name}' + chr(10) for name in scalars)}end_header\n"
    ).encode()
    yield rows.tobytes()


def mesh_ply(mesh: TriangleMesh, closed: NDArray[np.bool_], deviation: Floats, source: str) -> Iterator[bytes]:
    """The reconstructed surface; `closed` is 1 for faces that close a hole: invented, not measured.

    Args:
        mesh: the surface, object frame [m].
        closed: (F,) bool.
        deviation: (V,) signed distance of each vertex from the reference [m], positive outside.
        source: where the points come from that it was made of.

    Yields:
        the file, piece by piece.
    """
    vertices = np.empty(len(mesh.vertices), dtype=[("place", "<f8", 3), ("deviation", "<f4")])
    vertices["place"], vertices["deviation"] = mesh.vertices * 1000.0, deviation * 1000.0
    faces = np.empty(len(mesh.faces), dtype=[("n", "u1"), ("v", "<i4", 3), ("closed", "u1")])
    faces["n"], faces["v"], faces["closed"] = 3, mesh.faces, closed
    yield (
        "ply\nformat binary_little_endian 1.0\ncomment object frame, millimetres; closed 1: not measured\n"
        f"comment points: {_line(source)}\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        "property float scalar_deviation_mm\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nproperty uchar closed\nend_header\n"
    ).encode()
    yield vertices.tobytes()
    yield faces.tobytes()


def _line(text: str) -> str:
    """A text as one line of a header, which is ASCII."""
    return " ".join(text.split()).encode("ascii", "backslashreplace").decode("ascii")
