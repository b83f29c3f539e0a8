"""Planning mesh of a part, kept in the user's cache: decimation takes 0.5 s for 200,000 faces, reading a few ms.

It depends on the triangles of the part and the number of faces only, so that other placements and scanners share it.
"""

import hashlib
from contextlib import suppress
from importlib.metadata import version
from inspect import getsource
from pathlib import Path

import numpy as np

from cell import files
from planner.geometry import decimation, mesh
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh

CACHE_LIMIT_BYTES = 50_000_000
"""Size of the cache above which the oldest meshes are deleted; one of the default plan has 50 kB."""


def planning_mesh(reference: TriangleMesh, face_count: int, *, use_cache: bool = True) -> TriangleMesh:
    """Return the planning mesh of a part.

    Args:
        reference: the part [m].
        face_count: wanted number of faces.
        use_cache: whether the cache is read and written. A file that is damaged or cannot be written is ignored.
    """
    if not use_cache:
        return decimate(reference, face_count)
    path = files.cache_folder("planning") / f"{_key(reference, face_count)}.npz"
    if (stored := _read(path)) is not None:
        return stored
    planning = decimate(reference, face_count)
    with suppress(OSError):
        with files.atomic_write(path) as temporary, temporary.open("wb") as stream:
            np.savez(stream, vertices=planning.vertices, faces=planning.faces, hash=_hash(planning))
        files.delete_oldest(path.parent, CACHE_LIMIT_BYTES)
    return planning


def _read(path: Path) -> TriangleMesh | None:
    """Read a stored mesh; None if there is none, or it is damaged."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            planning = TriangleMesh(stored["vertices"], stored["faces"])
            return planning if str(stored["hash"]) == _hash(planning) else None
    except Exception:  # a damaged zip fails in many ways
        return None


def _key(reference: TriangleMesh, face_count: int) -> str:
    """Return a hash of everything that the planning mesh depends on: mesh, number, libraries, code."""
    libraries = [version(name) for name in ("fast-simplification", "numpy", "scipy")]
    code = [getsource(module) for module in (decimation, mesh)]
    inputs = [_hash(reference), str(face_count), *libraries, *code]
    return hashlib.sha256("\n".join(inputs).encode()).hexdigest()[:32]


def _hash(triangles: TriangleMesh) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(triangles.vertices).data)
    digest.update(np.ascontiguousarray(triangles.faces).data)
    return digest.hexdigest()
