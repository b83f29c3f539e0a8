"""The measurability matrix M of the part alone, and its cache.

M without occluders does not depend on the placement: it is valid after the part is moved, and with other fixtures or
another robot. Its columns do not depend on each other. So one key over part, samples, scanner and method names the
file, and a hash of each viewpoint's poses is stored with its column. If candidates are added, removed or reordered,
their stored columns are used and only the others are computed. A file is rejected, with the reason, if it is damaged,
of another format version or made for other inputs; M is then computed again. Files hold arrays only, no pickles.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
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
from planner.geometry.sampling import SurfaceSamples, draw_samples, samples_at_face_centres
from planner.measurability import quality
from planner.measurability.matrix import Measurability, join_measurability, pick_measurability
from planner.measurability.visibility import fill_matrix
from planner.ports import Progress, RayCaster, Scanner, SigmaScanner, no_progress
from planner.viewpoints.viewpoints import Viewpoints

FORMAT = 2
"""Version of file and computation: incremented with every change of M for equal inputs."""

CACHE_LIMIT_BYTES = 1_000_000_000
"""Size of the cache above which the oldest matrices are deleted; one of the default plan has about 6 MB."""

MIN_REGION_SAMPLES = 400
"""Smallest number of samples of a region: 0.25 % of its coverage each."""

_MAX_COLUMN_RATIO = 4
"""Largest number of stored columns, in multiples of those of one run; beyond, only those of the run are stored."""

_SAMPLE_FIELDS = ("points", "normals", "areas", "face", "planning_face")
_FIELDS = ("indptr", "indices", "shape", *_SAMPLE_FIELDS, "columns", "key", "format")

Hashes = NDArray[np.bytes_]
"""SHA-256 (hex) of each viewpoint's poses, (V,)."""


@dataclass(frozen=True, slots=True, eq=False)
class CachedMatrix:
    """A matrix read from the cache, or the reason for its rejection.

    Attributes:
        measurability: the stored matrix, or None.
        columns: (V,) hashes of its columns; empty without a matrix.
        reason: a sentence if there is no matrix, else "".
    """

    measurability: Measurability | None
    columns: Hashes
    reason: str

    def columns_of(self, hashes: Hashes) -> NDArray[np.int64]:
        """Return the stored column (n,) of each hash, -1 for a hash that is not stored."""
        if not len(self.columns):
            return np.full(len(hashes), -1, dtype=np.int64)
        order = np.argsort(self.columns, kind="stable")
        column = order[np.minimum(np.searchsorted(self.columns, hashes, sorter=order), len(order) - 1)]
        return np.where(self.columns[column] == hashes, column, -1)


def row_key(
    part: TriangleMesh,
    samples: SurfaceSamples,
    scanner_parameters: Mapping[str, object],
    method: str,
    row_of_face: NDArray[np.integer] | None = None,
) -> str:
    """Hash everything that the columns of M depend on, except their viewpoints (SHA-256, hex).

    Args:
        part: mesh of the ray casts.
        samples: the rows of M.
        scanner_parameters: `parameters()` of the scanner.
        method: "aimed" or "rays".
        row_of_face: row of each face, for `rays`.
    """
    digest = hashlib.sha256()
    text = json.dumps([FORMAT, method, dict(scanner_parameters)], sort_keys=True, allow_nan=False)
    digest.update(text.encode())
    arrays: dict[str, NDArray[Any]] = {
        **{"vertices": part.vertices, "faces": part.faces},
        **{name: getattr(samples, name) for name in _SAMPLE_FIELDS},
    }
    if row_of_face is not None:
        arrays["row_of_face"] = np.asarray(row_of_face, dtype=np.int32)
    for name, array in arrays.items():
        digest.update(f"{name}{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def column_hashes(viewpoints: Viewpoints) -> Hashes:
    """Hash the poses of each viewpoint (V,): with the row key everything that its column depends on."""
    poses = np.ascontiguousarray(viewpoints.T_object_scanner)
    return np.array([hashlib.sha256(pose.data).hexdigest() for pose in poses], dtype="S64")


def save(path: Path, measurability: Measurability, key: str, columns: Hashes) -> None:
    """Write a matrix atomically. Equal matrices give equal bytes.

    Args:
        path: the .npz file; its folder is created if necessary.
        measurability: the matrix.
        key: from `row_key`.
        columns: from `column_hashes`, of the matrix's viewpoints.

    Raises:
        FileError: if the file cannot be written.
    """
    cure = "choose a folder with space that you may write to"
    with (
        files.file_errors(f"the measurability matrix cannot be written to {path}", cure),
        atomic_write(path) as temporary,
        temporary.open("wb") as stream,
    ):
        np.savez(
            stream,
            indptr=measurability.indptr,
            indices=measurability.indices,
            shape=np.array(measurability.shape, dtype=np.int64),
            **{name: getattr(measurability.samples, name) for name in _SAMPLE_FIELDS},
            columns=columns,
            key=np.frombuffer(key.encode("ascii"), dtype=np.uint8),
            format=np.array(FORMAT, dtype=np.int64),
        )
        stream.flush()
        os.fsync(stream.fileno())  # after a crash a renamed file could be empty without it


def load(path: Path, key: str) -> CachedMatrix:
    """Read a matrix with all stored columns.

    Args:
        path: the .npz file.
        key: from `row_key`, of the present inputs.

    Returns:
        The matrix, or the reason why it has to be computed.
    """
    try:
        if not path.exists():
            return _rejected(f"{path} does not exist yet")
        # zip checks a CRC of every array that is read in full, so a flipped bit is found here.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            missing = [name for name in _FIELDS if name not in stored]
            if missing:
                return _rejected(f"{path} is no measurability matrix: it has no {', '.join(missing)}")
            if int(stored["format"]) != FORMAT:
                return _rejected(f"{path} has format {int(stored['format'])}; this version reads {FORMAT}")
            if stored["key"].tobytes() != key.encode("ascii"):
                return _rejected(f"{path} was computed for another part, scanner, other samples or another method")
            arrays = {name: stored[name] for name in _FIELDS}
        samples = SurfaceSamples(*(arrays[name] for name in _SAMPLE_FIELDS))
        rows, columns = (int(length) for length in arrays["shape"])
        if rows != len(samples):
            return _rejected(f"{path} is damaged: {rows} rows for {len(samples)} samples")
        if arrays["columns"].shape != (columns,) or arrays["columns"].dtype != np.dtype("S64"):
            return _rejected(f"{path} is damaged: its {columns} columns do not have one hash each")
        M = Measurability(arrays["indptr"], arrays["indices"], samples, columns)
        return CachedMatrix(M, arrays["columns"], "")
    except Exception as error:  # a damaged zip fails in many ways: BadZipFile, zlib.error, NotImplementedError, ...
        return _rejected(f"{path} cannot be read ({type(error).__name__}: {error})")


def _rejected(reason: str) -> CachedMatrix:
    return CachedMatrix(None, np.empty(0, dtype="S64"), reason)


def cache_folder() -> Path:
    """Return the folder of the cache."""
    return files.cache_folder("measurability")


@dataclass(frozen=True, slots=True, eq=False)
class PartSurface:
    """The part with the samples of its matrix, object frame.

    Attributes:
        reference: the part [m].
        planning: its decimated copy [m].
        samples: the rows of the matrix, from `surface_samples`.
        caster: casts rays on the reference.
    """

    reference: TriangleMesh
    planning: TriangleMesh
    samples: SurfaceSamples
    caster: RayCaster


def surface_samples(
    scene: Scene, reference: TriangleMesh, planning: TriangleMesh, rng: np.random.Generator
) -> SurfaceSamples:
    """Draw the rows of the matrix: samples of the reference (`aimed`), or one per planning face (`rays`).

    Regions are sampled as densely as a part without regions, and with at least `MIN_REGION_SAMPLES`.
    """
    if scene.plan.fill == "rays":
        return samples_at_face_centres(reference, planning)
    count = scene.plan.samples_per_face * len(planning.faces)
    if (region := reference.region) is None:
        return draw_samples(reference, planning, count, rng)
    areas = np.bincount(region[region >= 0], weights=reference.areas[region >= 0])
    each = np.maximum(np.rint(count * areas / reference.areas.sum()), MIN_REGION_SAMPLES).astype(np.int64)
    return SurfaceSamples.join(
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
    progress: Progress = no_progress,
) -> Measurability:
    """Compute M for the part alone, or read it from the cache; only missing columns are computed.

    Args:
        scene: for the scanner's type and the method.
        settings: for the scanner's parameters.
        surface: the part and the rows.
        candidates: the columns.
        reporter: is notified of a rejected file, or one that cannot be written.
        use_cache: whether the cache is read and written.
        progress: called with (finished poses, all poses).
    """
    method, reference, planning, samples = scene.plan.fill, surface.reference, surface.planning, surface.samples
    if samples.region is not None:  # targets of regions are applied later; the cache is independent of regions
        plain = replace(surface, samples=replace(samples, region=None))
        M = part_matrix(scene, settings, plain, candidates, reporter=reporter, use_cache=use_cache, progress=progress)
        return replace(M, samples=samples)
    scanner = scanners.make(scene.scanner.type, settings.planning_scanner if method == "rays" else settings.scanner)
    row_of_face = None
    if method == "rays":
        row_of_face = closest_facing_faces(reference.centres, reference.normals, planning)

    def compute(views: Viewpoints) -> Measurability:
        return fill_matrix(
            views, samples, scanner, surface.caster,
            method=method, part=reference, row_of_face=row_of_face, progress=progress,
        )  # fmt: skip

    if not use_cache:
        return compute(candidates)
    parameters = scanners.identity(scene.scanner.type, scanner)
    parameters.pop("sigma_angle_mdeg", None)  # M has no limit on sigma; it is applied later
    if method != "rays" and "max_spacing_mm" not in parameters:
        parameters.pop("resolution_deg", None)  # an aimed ray belongs to no grid
    key = row_key(reference, samples, parameters, method, row_of_face)
    path, hashes = cache_folder() / f"{key[:32]}.npz", column_hashes(candidates)
    cached = load(path, key) if path.exists() else None
    if cached is None or cached.measurability is None:
        if cached is not None and reporter is not None:
            reporter.note(f"a cached matrix is not used: {cached.reason}; it is computed again")
        M = compute(candidates)
        _store(path, M, key, hashes, reporter)
        return M
    columns = cached.columns_of(hashes)
    missing = np.flatnonzero(columns < 0)
    if not len(missing):
        return _pick_columns(cached.measurability, columns)
    M = join_measurability([cached.measurability, compute(candidates.pick(missing))])
    columns[missing] = cached.measurability.n_viewpoints + np.arange(len(missing))
    picked = _pick_columns(M, columns)
    if M.n_viewpoints > _MAX_COLUMN_RATIO * len(candidates):
        _store(path, picked, key, hashes, reporter)
    else:
        _store(path, M, key, np.concatenate([cached.columns, hashes[missing]]), reporter)
    return picked


def _pick_columns(M: Measurability, columns: NDArray[np.int64]) -> Measurability:
    """Return the columns in this order; M itself if it is in this order already."""
    return M if np.array_equal(columns, np.arange(M.n_viewpoints)) else pick_measurability(M, columns)


def _store(path: Path, M: Measurability, key: str, columns: Hashes, reporter: ProgressReporter | None) -> None:
    """Write a matrix to the cache and keep its size; a failure costs time in the next run only."""
    try:
        save(path, M, key, columns)
    except FileError as error:
        if reporter is not None:
            reporter.note(f"the matrix is not cached for the next run: {error}")
    with suppress(OSError):  # another run deletes files at the same time, or they belong to another user
        files.delete_oldest(path.parent, CACHE_LIMIT_BYTES)


def limit_sigma(
    M: Measurability,
    candidates: Viewpoints,
    scanner: Scanner,
    max_sigma_mm: float,
    casters: Sequence[RayCaster],
    *,
    may_be_empty: bool = False,
) -> Measurability:
    """Remove entries of M with a larger standard deviation than allowed; add the layer of sigma.

    Args:
        M: the matrix with occluders applied.
        candidates: its columns.
        scanner: sensor model.
        max_sigma_mm: largest expected standard deviation of a point [mm], inclusive.
        casters: of the part and of the occluders.
        may_be_empty: whether an empty result is valid, because there are other candidates.

    Raises:
        SceneError: if the scanner has no model of sigma, or the result is empty.
    """
    if not callable(getattr(scanner, "sigma", None)):
        raise SceneError(
            f"plan.max_sigma_mm is {max_sigma_mm:g}, but the scanner {type(scanner).__name__} has no model of "
            "the precision of its points; omit the limit, or choose another scanner.type"
        )
    precise = cast(SigmaScanner, scanner)
    layered = quality.sigma_layer(M, candidates, precise, casters=casters)
    remaining = quality.within_sigma(layered, max_sigma_mm / 1000)
    if len(M.indices) and not len(remaining.indices) and not may_be_empty:
        best = 1000 * float(layered.sigma.min()) if layered.sigma is not None else float("nan")
        raise SceneError(
            f"plan.max_sigma_mm is {max_sigma_mm:g} and no candidate measures a sample that precisely: the best point "
            f"has an expected standard deviation of {best:.3g} mm; a longer baseline, a smaller standoff or a smaller "
            "scanner.sigma_angle_mdeg makes it less"
        )
    return remaining
