"""Coloured meshes: which colour each triangle has. STEP by its faces; PLY, OBJ, OFF and GLB as trimesh reads them."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import FileError
from cell.part import step
from cell.part.formats import STEP
from cell.part.mesh_files import read_bytes
from planner.geometry.mesh import TriangleMesh
from planner.values import Bools, Floats

TOLERANCE = 32
"""Steps of 255 by which each of red, green and blue may be off: paint is blended at its borders, and rounded."""


def read(path: Path, metres: float) -> tuple[TriangleMesh, Floats]:
    """A coloured mesh.

    Args:
        path: of the file.
        metres: in one of its units.

    Returns:
        The mesh [m], and (F, 3) red, green and blue of its triangles, 0 to 255: of colours at its vertices the mean of
        three; NaN where a CAD face has none.

    Raises:
        FileError: if it cannot be read, or has no colours.
    """
    content, suffix = read_bytes(path), path.suffix.lower()
    if suffix in STEP:
        vertices, faces, of_face = step.coloured(str(path), content)
        if np.isnan(of_face).all():
            raise FileError(f"{path} has no colours; colour its faces, or select them by their numbers")
        return TriangleMesh(vertices * metres, faces.astype(np.int32)), of_face
    import trimesh  # half a second of start-up that only a painted mesh needs

    try:
        with warnings.catch_warnings(action="ignore"):
            loaded: Any = trimesh.load(io.BytesIO(content), file_type=suffix[1:], process=False)
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_mesh()
            visual = loaded.visual
            visual = visual.to_color() if visual.kind == "texture" else visual
            known = visual.kind in ("vertex", "face")
            colours = np.array(visual.face_colors, np.float64)[:, :3] if known else None
        mesh = TriangleMesh(np.array(loaded.vertices) * metres, np.array(loaded.faces, np.int32))
    except Exception as error:  # a parser meets broken bytes with any exception there is; each is the same to the user
        raise FileError(f"{path} cannot be read as a coloured mesh; export it again") from error
    if colours is None:
        raise FileError(f"{path} has no colours; paint it, and export it as PLY with colours")
    return mesh, colours


def close(colours: Floats, colour: str) -> Bools:
    """(F,) which of (F, 3) colours are `#rrggbb`, to `TOLERANCE`."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return np.asarray((np.abs(colours - wanted) <= TOLERANCE).all(axis=1))
