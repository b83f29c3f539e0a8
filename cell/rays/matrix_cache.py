"""A measurability matrix on disk, with the hash of everything it depends on, so that it is calculated once.

The part-only M does not depend on where the part stands: moving the part, changing fixtures or the robot reuses it.
Its columns do not depend on each other either, so the hash is split: one key over part, features, scanner and method
names the file, and one hash over each viewpoint's poses stands beside its column. Where candidates are added, taken
away or sorted anew, the columns that the file holds are taken from it and only the others are calculated. A file is
refused, with the reason in one sentence, when it is damaged, of another format version or made for other
inputs; the caller then calculates M anew and says so. Arrays only, nothing is pickled.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell import caches
from cell.errors import FileError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.viewpoints.viewpoints import Viewpoints

FORMAT = 2
"""Version of the file and of the calculation: raised with every change of what M holds for the same inputs."""

_FIELDS = (
    "indptr",
    "indices",
    "shape",
    "points",
    "normals",
    "areas",
    "face",
    "planning_face",
    "columns",
    "key",
    "format",
)


Hashes = NDArray[np.bytes_]
"""(V,) sha256 of each viewpoint's poses as hex text."""


@dataclass(frozen=True, slots=True, eq=False)
class Cached:
    """What a look into the cache gave: the matrix, or why it was refused.

    Attributes:
        measurability: the matrix as it is stored, or None.
        columns: (V,) hashes of its columns; empty where the matrix is None.
        reason: one sentence where the matrix is None, else "".
    """

    measurability: Measurability | None
    columns: Hashes
    reason: str

    def place_of(self, wanted: Hashes) -> NDArray[np.int64]:
        """(n,) stored column of each wanted hash, -1 where the file does not hold it."""
        if not len(self.columns):
            return np.full(len(wanted), -1, dtype=np.int64)
        order = np.argsort(self.columns, kind="stable")
        place = order[np.minimum(np.searchsorted(self.columns, wanted, sorter=order), len(order) - 1)]
        return np.where(self.columns[place] == wanted, place, -1)


def row_key(
    part: TriangleMesh,
    features: SurfaceSamples,
    scanner_parameters: Mapping[str, object],
    method: str,
    row_of_face: NDArray[np.integer] | None = None,
) -> str:
    """sha256 (hex) over everything that each column of M depends on, but for its viewpoint.

    Args:
        part: the mesh that rays were cast on.
        features: the rows.
        scanner_parameters: the scanner's `parameters()`; anything that JSON can hold.
        method: "aimed" or "rays".
        row_of_face: the map that `rays` used.
    """
    digest = hashlib.sha256()
    text = json.dumps([FORMAT, method, dict(scanner_parameters)], sort_keys=True, allow_nan=False)
    digest.update(text.encode())
    arrays: dict[str, NDArray[Any]] = {
        "vertices": part.vertices,
        "faces": part.faces,
        "points": features.points,
        "normals": features.normals,
        "areas": features.areas,
        "face": features.face,
        "planning_face": features.planning_face,
    }
    if row_of_face is not None:
        arrays["row_of_face"] = np.asarray(row_of_face, dtype=np.int32)
    for name, array in arrays.items():
        digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def column_hashes(viewpoints: Viewpoints) -> Hashes:
    """(V,) sha256 of each viewpoint's poses: what its column depends on beside the row key."""
    poses = np.ascontiguousarray(viewpoints.T_object_scanner)
    return np.array([hashlib.sha256(pose.data).hexdigest() for pose in poses], dtype="S64")


def save(path: Path, measurability: Measurability, key: str, columns: Hashes) -> None:
    """Write the matrix; the file appears complete or not at all. Equal matrices give equal bytes.

    Args:
        path: the .npz file; its folder is made if it is missing.
        measurability: what to write.
        key: from `row_key`.
        columns: from `column_hashes`, of the matrix's viewpoints.

    Raises:
        FileError: if the file cannot be written.
    """
    features = measurability.features
    try:
        with caches.whole(path) as temporary, temporary.open("wb") as stream:
            np.savez(
                stream,
                indptr=measurability.indptr,
                indices=measurability.indices,
                shape=np.array(measurability.shape, dtype=np.int64),
                points=features.points,
                normals=features.normals,
                areas=features.areas,
                face=features.face,
                planning_face=features.planning_face,
                columns=columns,
                key=np.frombuffer(key.encode("ascii"), dtype=np.uint8),
                format=np.array(FORMAT, dtype=np.int64),
            )
            stream.flush()
            os.fsync(stream.fileno())  # otherwise a crash may leave a renamed file without its contents
    except OSError as error:
        raise FileError(
            f"the measurability matrix cannot be written to {path}: {error.strerror or error}; choose a folder "
            "with space that you may write to"
        ) from error


def load(path: Path, key: str) -> Cached:
    """Read a matrix back, if the file holds the one that is asked for.

    Args:
        path: the .npz file.
        key: from `row_key`, of the inputs at hand.

    Returns:
        The matrix with all columns that the file holds, or the reason why it has to be calculated.
    """
    try:
        if not path.exists():
            return _refused(f"{path} does not exist yet")
        # zip checks a CRC of every array that is read in full, so a flipped bit is found here.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            missing = [name for name in _FIELDS if name not in stored]
            if missing:
                return _refused(f"{path} is no measurability matrix: it lacks {', '.join(missing)}")
            if int(stored["format"]) != FORMAT:
                return _refused(f"{path} has format {int(stored['format'])}; this version reads {FORMAT}")
            if stored["key"].tobytes() != key.encode("ascii"):
                return _refused(f"{path} was calculated for another part, scanner, features or method")
            arrays = {name: stored[name] for name in _FIELDS}
        features = SurfaceSamples(
            arrays["points"], arrays["normals"], arrays["areas"], arrays["face"], arrays["planning_face"]
        )
        rows, columns = (int(length) for length in arrays["shape"])
        if rows != len(features):
            return _refused(f"{path} is damaged: {rows} rows for {len(features)} features")
        if arrays["columns"].shape != (columns,) or arrays["columns"].dtype != np.dtype("S64"):
            return _refused(f"{path} is damaged: its {columns} columns do not have one hash each")
        M = Measurability(arrays["indptr"], arrays["indices"], features, columns)
        return Cached(M, arrays["columns"], "")
    except Exception as error:  # a damaged zip fails in a dozen ways: BadZipFile, zlib.error, NotImplementedError, ...
        return _refused(f"{path} cannot be read ({type(error).__name__}: {error})")


def _refused(reason: str) -> Cached:
    return Cached(None, np.empty(0, dtype="S64"), reason)
