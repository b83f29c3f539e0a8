"""Build the built-in parts, and write their files, which `cell.part.builtin` reads.

`python -m benchmarks.part_models.build` writes `models/parts` again.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.part_models import mesher, shapes
from cell.part.builtin import fit_bounds
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints32

_SEED = 7  # seed of the ripples
_DATE = (1980, 1, 1, 0, 0, 0)  # in the files, so that equal parts give equal bytes


@dataclass(frozen=True, slots=True)
class PartModel:
    """The paper's data of a model (Fig. 6), and the grid of its stand-in.

    Attributes:
        size_mm: bounding box along x, y, z in the printed order [mm].
        faces: number of faces.
        genus: number of handles, from the printed V and F.
        area_mm2: printed area [mm^2]; the stand-ins approximate it.
        cell_mm: grid cell of the marching cubes [mm].
        low_mm: corner of the grid [mm], in the shape's own frame.
        high_mm: the opposite corner [mm].
    """

    size_mm: tuple[float, float, float]
    faces: int
    genus: int
    area_mm2: float
    cell_mm: float
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    @property
    def vertices(self) -> int:
        """Number of vertices, by Euler: V = F / 2 + 2 - 2 genus."""
        return self.faces // 2 + 2 - 2 * self.genus


PART_MODELS = {
    "mseke": PartModel((188, 223, 183), 186334, 0, 120737, 1.2, (-98, -116, -96), (98, 120, 100)),
    "mug": PartModel((60, 50, 47), 149988, 1, 16268, 0.46, (-28, -28, -3), (38, 28, 50)),
    "robinet": PartModel((228, 120, 108), 162916, 5, 64345, 0.95, (-118, -64, -60), (118, 64, 58)),
    "petanque": PartModel((207, 179, 74), 339900, 0, 62757, 0.58, (-106, -96, -42), (114, 96, 44)),
    "humerus": PartModel((60, 11, 9), 277928, 0, 978, 0.09, (-32, -7, -6), (32, 7, 6)),
    "st-jean": PartModel((73, 158, 46), 749994, 2, 29462, 0.27, (-44, -3, -26), (42, 162, 26)),
}
"""The built-in parts by name."""


@dataclass(frozen=True, slots=True)
class _Decimated:
    """A part before its last operations: vertices in shares of the diagonal."""

    vertices: Floats
    faces: Ints32
    diagonal_mm: float


def build(name: str) -> TriangleMesh:
    """Build a part [m]: implicit shape, marching cubes, decimation, bounds."""
    mesh = _decimated(name)
    size = np.array(PART_MODELS[name].size_mm, np.float64)
    return TriangleMesh(fit_bounds(mesh.vertices * mesh.diagonal_mm, size), mesh.faces)


def packed(name: str) -> bytes:
    """Build a part and return its file."""
    model, mesh = PART_MODELS[name], _decimated(name)
    low = np.array(model.low_mm, np.float64)
    grid = ((mesh.vertices * mesh.diagonal_mm - low) / model.cell_mm).astype(np.float32)
    exact = (grid.astype(np.float64) * model.cell_mm + low) / mesh.diagonal_mm == mesh.vertices
    on_grid = exact.all(axis=1)
    corners = mesh.faces.astype(np.int64).ravel()
    unused = np.maximum.accumulate(np.concatenate(([0], corners + 1)))[:-1]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for key, array, method in (
            ("n_vertices", np.array(len(on_grid)), zipfile.ZIP_STORED),
            ("low_mm", low, zipfile.ZIP_STORED),
            ("cell_mm", np.array(model.cell_mm), zipfile.ZIP_STORED),
            ("diagonal_mm", np.array(mesh.diagonal_mm), zipfile.ZIP_STORED),
            ("size_mm", np.array(model.size_mm, np.float64), zipfile.ZIP_STORED),
            ("on_grid", np.packbits(on_grid), zipfile.ZIP_LZMA),
            ("grid", grid[on_grid].T, zipfile.ZIP_LZMA),
            ("off_grid", _byte_planes(mesh.vertices[~on_grid]), zipfile.ZIP_DEFLATED),
            ("behind", (unused - corners).astype(np.int32), zipfile.ZIP_LZMA),
        ):
            entry = zipfile.ZipInfo(f"{key}.npy", _DATE)
            entry.compress_type = method
            stream = io.BytesIO()
            np.save(stream, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(entry, stream.getvalue(), method, 9)
    return content.getvalue()


def _byte_planes(values: Floats) -> NDArray[np.uint8]:
    """Return the bytes (8, 3, N) of values (N, 3); the planes of the high bytes compress well."""
    return np.ascontiguousarray(values, "<f8").view(np.uint8).reshape(*values.shape, 8).T


def _decimated(name: str) -> _Decimated:
    model = PART_MODELS[name]
    shape = getattr(shapes, name.replace("-", "_"))(np.random.default_rng(_SEED))
    fine = mesher.mesh_of(shape, model.low_mm, model.high_mm, model.cell_mm)
    vertices, faces = mesher.collapsed_to(fine, model.faces)
    return _Decimated(vertices, faces, fine.diagonal)


def write(name: str, folder: Path) -> Path:
    """Build a part, write its file NAME.npz to a folder, and return the path."""
    path = folder / f"{name}.npz"
    path.write_bytes(packed(name))
    return path


if __name__ == "__main__":
    for part in PART_MODELS:
        write(part, Path(__file__).parents[2] / "models" / "parts")
