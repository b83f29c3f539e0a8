"""The built-in parts: closed meshes in place of the paper's models (its Fig. 6), shipped in `models/parts`.

Each has the name, bounding box, number of faces and genus of the paper's model. `benchmarks/part_models` makes the
files. A file holds the state before the last operations of the builder, because that state compresses well. Most
vertices lie on an edge of the grid of the marching cubes and have float32 grid coordinates. The decimation moved the
others; their float64 coordinates are stored as planes of bytes. A corner of a face is stored as its distance below the
next unused vertex. The reader repeats the last operations of the builder, so that the arrays agree bit by bit.
"""

import lzma
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError, UsageError
from cell.files import model_file
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

NAMES = ("mseke", "mug", "robinet", "petanque", "humerus", "st-jean")
"""Names of the built-in parts; the first is the default."""

_BROKEN_ARCHIVE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError)


def load(name: str) -> TriangleMesh:
    """Return a built-in part [m]; it stands on z = 0 with x and y about the origin.

    Raises:
        UsageError: if there is no such part.
        FileError: if its file is missing or damaged.
    """
    if name not in NAMES:
        raise UsageError(f"the built-in part '{name}' does not exist; choose one of {', '.join(NAMES)}")
    path = model_file(f"parts/{name}.npz")
    try:
        # np.load leaves a file open that is no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return _unpack(stored)
    except (OSError, ValueError, LookupError, EOFError, PlannerError, *_BROKEN_ARCHIVE) as error:
        raise FileError(f"{path} is damaged ({error}); install scan-cell again") from error


def fit_bounds(vertices: Floats, size_mm: Floats) -> Floats:
    """Scale vertices (V, 3) per axis to a bounding box [mm] on z = 0 with x and y about the origin; return metres."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = size_mm / 1000
    corner = np.array([-size[0] / 2, -size[1] / 2, 0.0])
    fitted: Floats = (vertices - low) / (high - low) * size + corner
    return fitted


def _unpack(stored: Mapping[str, NDArray[Any]]) -> TriangleMesh:
    on_grid = np.unpackbits(stored["on_grid"], count=int(stored["n_vertices"])).astype(np.bool_)
    vertices = np.empty((len(on_grid), 3))
    grid = stored["grid"].T.astype(np.float64)
    vertices[on_grid] = (grid * stored["cell_mm"] + stored["low_mm"]) / stored["diagonal_mm"]
    vertices[~on_grid] = np.ascontiguousarray(stored["off_grid"].T).view("<f8")[..., 0]
    behind = stored["behind"]
    used = np.where(behind <= 0, 1 - behind, 0)
    faces = np.cumsum(used) - used - behind
    vertices = fit_bounds(vertices * stored["diagonal_mm"], stored["size_mm"])
    return TriangleMesh(vertices, faces.astype(np.int32).reshape(-1, 3))
