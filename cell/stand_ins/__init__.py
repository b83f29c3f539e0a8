"""The six built-in parts: stand-ins made by code for the paper's models (its Fig. 6).

Each has the paper's name, bounding box, number of faces and genus, so the number of vertices too (F = 2 V - 2 chi for a
closed surface); the shape is our own. Building is seeded and takes one to six seconds, so that a built mesh is kept in
the user's cache folder under the hash of everything that made it; a cache that cannot be read or written is ignored.
"""

import hashlib
import importlib
import logging
import zipfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np

from cell import caches
from cell.errors import UsageError
from planner.geometry.mesh import TriangleMesh

_log = logging.getLogger(__name__)

_SEED = 7  # of the ripples; part of what is frozen


@dataclass(frozen=True, slots=True)
class StandIn:
    """What the paper says about a model (Fig. 6), and how its stand-in is cut.

    Attributes:
        size_mm: bounding box along x, y, z in the order printed [mm].
        faces: number of faces.
        genus: number of handles, from the printed V and F.
        area_mm2: printed area [mm^2]; the stand-ins come near it.
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


STAND_INS = {
    "mseke": StandIn((188, 223, 183), 186334, 0, 120737, 1.2, (-98, -116, -96), (98, 120, 100)),
    "mug": StandIn((60, 50, 47), 149988, 1, 16268, 0.46, (-28, -28, -3), (38, 28, 50)),
    "robinet": StandIn((228, 120, 108), 162916, 5, 64345, 0.95, (-118, -64, -60), (118, 64, 58)),
    "petanque": StandIn((207, 179, 74), 339900, 0, 62757, 0.58, (-106, -96, -42), (114, 96, 44)),
    "humerus": StandIn((60, 11, 9), 277928, 0, 978, 0.09, (-32, -7, -6), (32, 7, 6)),
    "st-jean": StandIn((73, 158, 46), 749994, 2, 29462, 0.27, (-44, -3, -26), (42, 162, 26)),
}
"""The parts by name; the first is the default."""

NAMES = tuple(STAND_INS)


def build(name: str) -> TriangleMesh:
    """A built-in part, metres; it stands on z = 0 with x and y about the origin.

    Raises:
        UsageError: if there is no such part.
    """
    if name not in STAND_INS:
        raise UsageError(f"there is no built-in part '{name}'; there are {', '.join(NAMES)}")
    path = _cache_path(name)
    mesh = None if path is None else _read(path, STAND_INS[name])
    if mesh is None:
        mesh = _make(name)
        if path is not None:
            _write(path, mesh)
    return mesh


def _make(name: str) -> TriangleMesh:
    from cell.stand_ins import mesher

    part = STAND_INS[name]
    field = importlib.import_module(f"cell.stand_ins.{name.replace('-', '_')}").field(np.random.default_rng(_SEED))
    fine = mesher.mesh_of(field, part.low_mm, part.high_mm, part.cell_mm)
    return mesher.to_bounds(mesher.to_count(fine, part.faces), part.size_mm)


def _cache_path(name: str) -> Path | None:
    """Where the mesh is kept; the name holds a hash of the code and the libraries that make it."""
    here = Path(__file__).parent
    versions = [metadata.version(library) for library in ("numpy", "scikit-image", "fast-simplification")]
    digest = hashlib.sha256(" ".join(versions).encode())
    try:
        for source in ("__init__", "fields", "mesher", name.replace("-", "_")):
            digest.update((here / f"{source}.py").read_bytes())
        folder = caches.folder("stand_ins")
    except (OSError, RuntimeError):  # sources inside an archive, or a user without a home
        return None
    return folder / f"{name}-{digest.hexdigest()[:16]}.npz"


def _read(path: Path, part: StandIn) -> TriangleMesh | None:
    """The mesh in the cache, or none where there is no usable one."""
    try:
        # Opened here, because np.load leaves the file open when it is no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            mesh = TriangleMesh(stored["vertices"], stored["faces"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        _log.debug("built-in part is not taken from %s: %s", path, error)
        return None
    return mesh if (len(mesh.faces), len(mesh.vertices)) == (part.faces, part.vertices) else None


def _write(path: Path, mesh: TriangleMesh) -> None:
    """Write beside the place and rename, so that no reader meets half a file; a full or closed disk is no failure."""
    try:
        with caches.whole(path) as part, part.open("wb") as file:
            np.savez(file, vertices=mesh.vertices, faces=mesh.faces)
    except OSError as error:
        _log.debug("built-in part is not kept in %s: %s", path, error)
