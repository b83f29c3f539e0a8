"""The merged cloud and the mesh as binary PLY: object frame, millimetres.

What colours them has a name that begins with `scalar_`: CloudCompare takes such properties for scalar fields.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cell.reconstruction.cloud import PointCloud
from cell.runs import ply
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats


def cloud_ply(cloud: PointCloud, stop: NDArray[np.int32], sigma: Floats, source: str) -> Iterator[bytes]:
    """Points with normals, the view that gave them and their expected standard deviation.

    Args:
        cloud: merged scans.
        stop: (N,) number of the view of each point, from 1 in visiting order: that of its file in scans/.
        sigma: (N,) along the ray [m]; NaN where it is not known.
        source: where the points come from.

    Returns:
        The file, piece by piece.
    """
    normals = {f"n{axis}": cloud.normals[:, i].astype("<f4") for i, axis in enumerate("xyz")}
    views = {"view": stop.astype("<i4"), "scalar_view": stop.astype("<f4")}
    more = normals | views | {"scalar_sigma_mm": (sigma * 1000.0).astype("<f4")}
    comments = ["object frame, millimetres; view: from 1 in visiting order", f"points: {_line(source)}"]
    return ply.file_pieces(comments, {"vertex": ply.point_rows(cloud.points, more)})


def mesh_ply(mesh: TriangleMesh, closed: NDArray[np.bool_], deviation: Floats, source: str) -> Iterator[bytes]:
    """The reconstructed surface; `closed` is 1 for faces that close a hole: invented, not measured.

    Args:
        mesh: the surface, object frame [m].
        closed: (F,) bool.
        deviation: (V,) signed distance of each vertex from the reference [m], positive outside.
        source: where the points come from that it was made of.

    Returns:
        The file, piece by piece.
    """
    vertices = ply.point_rows(mesh.vertices, {"scalar_deviation_mm": (deviation * 1000.0).astype("<f4")})
    faces = ply.triangle_rows(mesh.faces, {"closed": closed.astype(np.uint8)})
    comments = ["object frame, millimetres; closed 1: not measured", f"points: {_line(source)}"]
    return ply.file_pieces(comments, {"vertex": vertices, "face": faces})


def _line(text: str) -> str:
    """A text as one line of a header, which is ASCII."""
    return " ".join(text.split()).encode("ascii", "backslashreplace").decode("ascii")
