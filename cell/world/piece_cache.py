"""Convex pieces of a part on disk, by the hash of mesh and settings, so that they are found once.

A file that is damaged, of another format or of another mesh is left unread and written again. Arrays only, nothing is
pickled. The same mesh gives the same pieces, so a lost cache costs seconds and nothing else.
"""

import contextlib
import hashlib
import json
import os
from pathlib import Path

import numpy as np

from cell import caches
from planner.surface.mesh import TriangleMesh

FORMAT = 1
"""Version of the file and of the algorithm: raised with every change of what is found for the same mesh."""

LIMIT_BYTES = 100_000_000
"""Above this the files written longest ago are removed; one part has some 0.3 MB."""


def cache_folder() -> Path:
    """Where pieces are kept."""
    return caches.folder("pieces")


def key_of(mesh: TriangleMesh, *settings: float) -> str:
    """sha256 (hex) of a mesh and the settings of its decomposition."""
    digest = hashlib.sha256(json.dumps([FORMAT, *settings]).encode())
    digest.update(np.ascontiguousarray(mesh.vertices).data)
    digest.update(np.ascontiguousarray(mesh.faces).data)
    return digest.hexdigest()


def load(key: str) -> tuple[TriangleMesh, ...] | None:
    """The pieces of a key; None where they are not there or cannot be read."""
    try:
        with (cache_folder() / f"{key[:32]}.npz").open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            if stored["key"].tobytes() != key.encode():
                return None
            vertices, faces = stored["vertices"], stored["faces"]
            v, f = np.cumsum(stored["vertex_counts"])[:-1], np.cumsum(stored["face_counts"])[:-1]
        return tuple(TriangleMesh(*pair) for pair in zip(np.split(vertices, v), np.split(faces, f), strict=True))
    except Exception:  # a damaged zip fails in a dozen ways; the pieces are then found again
        return None


def save(key: str, pieces: tuple[TriangleMesh, ...]) -> None:
    """Keep pieces; a folder that cannot be written only costs the time of the next run."""
    folder = cache_folder()
    path = folder / f"{key[:32]}.npz"
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    with contextlib.suppress(OSError):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as stream:
                np.savez(
                    stream,
                    vertices=np.concatenate([piece.vertices for piece in pieces]),
                    faces=np.concatenate([piece.faces for piece in pieces]),
                    vertex_counts=np.array([len(piece.vertices) for piece in pieces], dtype=np.int64),
                    face_counts=np.array([len(piece.faces) for piece in pieces], dtype=np.int64),
                    key=np.frombuffer(key.encode(), dtype=np.uint8),
                )
                stream.flush()
                os.fsync(stream.fileno())
            temporary.replace(path)
            _forget_oldest(folder)
        finally:
            temporary.unlink(missing_ok=True)


def _forget_oldest(folder: Path) -> None:
    files = sorted(((entry.stat(), entry) for entry in folder.glob("*.npz")), key=lambda pair: pair[0].st_mtime)
    size = sum(stat.st_size for stat, _ in files)
    for stat, entry in files[:-1]:
        if size <= LIMIT_BYTES:
            return
        entry.unlink(missing_ok=True)
        size -= stat.st_size
