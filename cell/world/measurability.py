"""A measurability matrix on disk, with the hash of everything it depends on, so that it is calculated once.

The part-only M does not depend on where the part stands: moving the part, changing fixtures or the robot reuses it.
Its columns do not depend on each other either, so the hash is split: one key over part, features, scanner and method
names the file, and one hash over each viewpoint's poses stands beside its column. Where candidates are added, taken
away or sorted anew, the columns that the file holds are taken from it and only the others are calculated. A file is
refused, with the reason in one sentence, when it is damaged, of another format version or made for other
inputs; the caller then calculates M anew and says so. Arrays only, nothing is pickled.

Step 5 with its cache: the part-only measurability matrix, calculated once per part, candidates and scanner.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cell import files, scanners
from cell.errors import FileError, SceneError
from cell.files import atomic_write
from cell.scene.model import Scene
from cell.scene.settle import Settings
from cell.session import ProgressReporter
from planner.geometry.closest import closest_facing_faces
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples, join_samples, samples_at_face_centres
from planner.measurability import quality
from planner.measurability.matrix import Measurability, join_measurability, pick_measurability
from planner.measurability.visibility import fill_matrix
from planner.ports import Progress, RayCaster, Scanner, SigmaScanner
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

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
class CachedMatrix:
    """What a look into the cache gave: the matrix, or why it was refused.

    Attributes:
        measurability: the matrix as it is stored, or None.
        columns: (V,) hashes of its columns; empty where the matrix is None.
        reason: one sentence where the matrix is None, else "".
    """

    measurability: Measurability | None
    columns: Hashes
    reason: str

    def columns_of(self, wanted: Hashes) -> NDArray[np.int64]:
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
    features = measurability.samples
    try:
        with atomic_write(path) as temporary, temporary.open("wb") as stream:
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


def load(path: Path, key: str) -> CachedMatrix:
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
        return CachedMatrix(M, arrays["columns"], "")
    except Exception as error:  # a damaged zip fails in a dozen ways: BadZipFile, zlib.error, NotImplementedError, ...
        return _refused(f"{path} cannot be read ({type(error).__name__}: {error})")


def _refused(reason: str) -> CachedMatrix:
    return CachedMatrix(None, np.empty(0, dtype="S64"), reason)


CACHE_LIMIT_BYTES = 1_000_000_000
"""Above this the oldest matrices are removed; one of the default plan has some 6 MB."""


MIN_REGION_SAMPLES = 400
"""Rows of the matrix that a region has at least: 0.25 points of its coverage each."""

_MAX_COLUMN_RATIO = 4
"""A file holds at most this many times the columns that one run asks for; beyond, it is begun anew with these."""


def cache_folder() -> Path:
    """Where matrices are kept."""
    return files.cache_folder("measurability")


@dataclass(frozen=True, slots=True, eq=False)
class PartSurface:
    """The part as its matrix knows it, object frame.

    Attributes:
        reference: the part [m].
        planning: its decimated copy [m].
        features: the rows of the matrix, from `surface_features`.
        caster: casts on the reference.
    """

    reference: TriangleMesh
    planning: TriangleMesh
    samples: SurfaceSamples
    caster: RayCaster


def surface_samples(
    scene: Scene, reference: TriangleMesh, planning: TriangleMesh, rng: np.random.Generator
) -> SurfaceSamples:
    """The rows of the matrix: samples of the reference (`aimed`), or one per planning face (`rays`).

    Regions have them as dense as a part without regions, and at least `REGION_ROWS`, each for less area then.
    """
    if scene.plan.fill == "rays":
        return samples_at_face_centres(reference, planning)
    count = scene.plan.samples_per_face * len(planning.faces)
    if (region := reference.region) is None:
        return draw_samples(reference, planning, count, rng)
    areas = np.bincount(region[region >= 0], weights=reference.areas[region >= 0])
    each = np.maximum(np.rint(count * areas / reference.areas.sum()), MIN_REGION_SAMPLES).astype(np.int64)
    return join_samples(
        [
            draw_samples(replace(reference, region=np.where(region == k, region, -1)), planning, int(each[k]), rng)
            for k in np.flatnonzero(areas > 0)
        ]
    )


def part_matrix(
    scene: Scene,
    settings: Settings,
    surface: PartSurface,
    candidates: Viewpoints,
    *,
    reporter: ProgressReporter | None = None,
    use_cache: bool = True,
    progress: Progress | None = None,
) -> Measurability:
    """Fill M for the part alone, or take from the cache what it holds of it; only the other columns are calculated.

    Args:
        scene: for the scanner's type and the method.
        settings: for the scanner's numbers.
        surface: the part and the rows.
        candidates: the columns.
        reporter: is told when a cached matrix is refused or cannot be kept.
        use_cache: whether to look into the cache and to leave the result there.
        progress: called with (poses done, poses in all).
    """
    method, reference, planning, features = scene.plan.fill, surface.reference, surface.planning, surface.samples
    if features.region is not None:  # what is asked of a region is applied afterwards; the cache knows of none
        whole = replace(surface, samples=replace(features, region=None))
        M = part_matrix(scene, settings, whole, candidates, reporter=reporter, use_cache=use_cache, progress=progress)
        return replace(M, samples=features)
    scanner = scanners.make(scene.scanner.type, settings.planning_scanner if method == "rays" else settings.scanner)
    parameters = scanners.identity(scene.scanner.type, scanner)
    parameters.pop("sigma_angle_mdeg", None)  # M is of the conditions alone; a limit on sigma is applied to it
    row_of_face = None
    if method == "rays":
        row_of_face = closest_facing_faces(reference.centres, reference.normals, planning)
    elif "max_spacing_mm" not in parameters:
        parameters.pop("resolution_deg", None)  # an aimed leg belongs to no grid
    key = row_key(reference, features, parameters, method, row_of_face)
    path = cache_folder() / f"{key[:32]}.npz"
    hashes = column_hashes(candidates)

    def calculated(views: Viewpoints) -> Measurability:
        return fill_matrix(
            views,
            features,
            scanner,
            surface.caster,
            method=method,
            part=reference,
            row_of_face=row_of_face,
            progress=progress,
        )

    if not use_cache:
        return calculated(candidates)
    cached = load(path, key) if path.exists() else None
    if cached is None or cached.measurability is None:
        if cached is not None and reporter is not None:
            reporter.note(f"a cached matrix is not used: {cached.reason}; it is calculated anew")
        M = calculated(candidates)
        _keep(path, M, key, hashes, reporter)
        return M
    place = cached.columns_of(hashes)
    missing = np.flatnonzero(place < 0)
    if not len(missing):
        return _columns(cached.measurability, place)
    M = join_measurability([cached.measurability, calculated(pick_viewpoints(candidates, missing))])
    place[missing] = cached.measurability.n_viewpoints + np.arange(len(missing))
    wanted = _columns(M, place)
    if M.n_viewpoints > _MAX_COLUMN_RATIO * len(candidates):
        _keep(path, wanted, key, hashes, reporter)
    else:
        _keep(path, M, key, np.concatenate([cached.columns, hashes[missing]]), reporter)
    return wanted


def _columns(M: Measurability, place: NDArray[np.int64]) -> Measurability:
    """The columns in the order that is wanted; M itself where it is in that order already."""
    return M if np.array_equal(place, np.arange(M.n_viewpoints)) else pick_measurability(M, place)


def _keep(path: Path, M: Measurability, key: str, columns: Hashes, reporter: ProgressReporter | None) -> None:
    try:
        save(path, M, key, columns)
        delete_oldest(path.parent, CACHE_LIMIT_BYTES)
    except FileError as error:
        if reporter is not None:
            reporter.note(f"the matrix is not kept for the next run: {error}")


def delete_oldest(folder: Path, limit: int) -> None:
    """Keep a folder of matrices below a number of bytes: those written longest ago go first, the newest stays.

    Args:
        folder: where the `.npz` files are.
        limit: bytes that they may take in all.
    """
    files = sorted(((entry.stat(), entry) for entry in folder.glob("*.npz")), key=lambda pair: pair[0].st_mtime)
    size = sum(stat.st_size for stat, _ in files)
    for stat, entry in files[:-1]:
        if size <= limit:
            return
        entry.unlink(missing_ok=True)  # another run may have been faster
        size -= stat.st_size


def limit_sigma(
    M: Measurability,
    candidates: Viewpoints,
    scanner: Scanner,
    max_sigma_mm: float,
    casters: Sequence[RayCaster],
    *,
    may_be_empty: bool = False,
) -> Measurability:
    """Only what is measured precisely enough: the matrix with its layer of sigma.

    Args:
        M: the matrix with occluders applied.
        candidates: its columns.
        scanner: the sensor's law.
        max_sigma_mm: largest expected standard deviation of a point [mm], inclusive.
        casters: the part's and the occluders'.
        may_be_empty: whether there are others where these measure nothing so precisely.

    Raises:
        SceneError: if the scanner does not know its sigma, or no candidate measures anything so precisely.
    """
    if not callable(getattr(scanner, "sigma", None)):
        raise SceneError(
            f"plan.max_sigma_mm is {max_sigma_mm:g}, but the scanner {type(scanner).__name__} does not know how "
            "precise its points are; leave the limit out, or choose another scanner.type"
        )
    precise = cast(SigmaScanner, scanner)
    layered = quality.sigma_layer(M, candidates, precise, casters=casters)
    kept = quality.within_sigma(layered, max_sigma_mm / 1000)
    if len(M.indices) and not len(kept.indices) and not may_be_empty:
        best = 1000 * float(layered.sigma.min()) if layered.sigma is not None else float("nan")
        raise SceneError(
            f"plan.max_sigma_mm is {max_sigma_mm:g} and no candidate measures anything so precisely: the best point "
            f"has an expected standard deviation of {best:.3g} mm; a longer baseline, a smaller standoff or a smaller "
            "scanner.sigma_angle_mdeg makes it less"
        )
    return kept
