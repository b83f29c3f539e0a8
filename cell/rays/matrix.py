"""Step 5 with its cache: the part-only measurability matrix, calculated once per part, candidates and scanner."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cell import caches, scanners
from cell.errors import FileError, SceneError
from cell.narrator import Narrator
from cell.rays import matrix_cache as measurability_cache
from cell.rays.matrix_cache import Hashes
from cell.scene.resolve import Settings
from cell.scene.scene import Scene
from planner.geometry.closest import closest_face
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, face_features, join_samples, sample
from planner.measurability import quality
from planner.measurability.matrix import Measurability, join_measurability, pick_measurability
from planner.measurability.visibility import fill
from planner.ports import Progress, RayCaster, Scanner, SigmaScanner
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

CACHE_LIMIT_BYTES = 1_000_000_000
"""Above this the oldest matrices are removed; one of the default plan has some 6 MB."""


REGION_ROWS = 400
"""Rows of the matrix that a region has at least: 0.25 points of its coverage each."""

_KEPT = 4
"""A file holds at most this many times the columns that one run asks for; beyond, it is begun anew with these."""


def cache_folder() -> Path:
    """Where matrices are kept."""
    return caches.folder("measurability")


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
    features: SurfaceSamples
    caster: RayCaster


def surface_features(
    scene: Scene, reference: TriangleMesh, planning: TriangleMesh, rng: np.random.Generator
) -> SurfaceSamples:
    """The rows of the matrix: samples of the reference (`aimed`), or one per planning face (`rays`).

    Regions have them as dense as a part without regions, and at least `REGION_ROWS`, each for less area then.
    """
    if scene.plan.fill == "rays":
        return face_features(reference, planning)
    count = scene.plan.samples_per_face * len(planning.faces)
    if (region := reference.region) is None:
        return sample(reference, planning, count, rng)
    areas = np.bincount(region[region >= 0], weights=reference.areas[region >= 0])
    each = np.maximum(np.rint(count * areas / reference.areas.sum()), REGION_ROWS).astype(np.int64)
    return join_samples(
        [
            sample(replace(reference, region=np.where(region == k, region, -1)), planning, int(each[k]), rng)
            for k in np.flatnonzero(areas > 0)
        ]
    )


def part_matrix(
    scene: Scene,
    settings: Settings,
    surface: PartSurface,
    candidates: Viewpoints,
    *,
    narrator: Narrator | None = None,
    use_cache: bool = True,
    progress: Progress | None = None,
) -> Measurability:
    """Fill M for the part alone, or take from the cache what it holds of it; only the other columns are calculated.

    Args:
        scene: for the scanner's type and the method.
        settings: for the scanner's numbers.
        surface: the part and the rows.
        candidates: the columns.
        narrator: is told when a cached matrix is refused or cannot be kept.
        use_cache: whether to look into the cache and to leave the result there.
        progress: called with (poses done, poses in all).
    """
    method, reference, planning, features = scene.plan.fill, surface.reference, surface.planning, surface.features
    if features.region is not None:  # what is asked of a region is applied afterwards; the cache knows of none
        whole = replace(surface, features=replace(features, region=None))
        M = part_matrix(scene, settings, whole, candidates, narrator=narrator, use_cache=use_cache, progress=progress)
        return replace(M, features=features)
    scanner = scanners.make(scene.scanner.type, settings.planning_scanner if method == "rays" else settings.scanner)
    parameters = scanners.identity(scene.scanner.type, scanner)
    parameters.pop("sigma_angle_mdeg", None)  # M is of the conditions alone; a limit on sigma is applied to it
    row_of_face = None
    if method == "rays":
        row_of_face = closest_face(reference.centres, reference.normals, planning)
    elif "max_spacing_mm" not in parameters:
        parameters.pop("resolution_deg", None)  # an aimed leg belongs to no grid
    key = measurability_cache.row_key(reference, features, parameters, method, row_of_face)
    path = cache_folder() / f"{key[:32]}.npz"
    hashes = measurability_cache.column_hashes(candidates)

    def calculated(views: Viewpoints) -> Measurability:
        return fill(
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
    cached = measurability_cache.load(path, key) if path.exists() else None
    if cached is None or cached.measurability is None:
        if cached is not None and narrator is not None:
            narrator.note(f"a cached matrix is not used: {cached.reason}; it is calculated anew")
        M = calculated(candidates)
        _keep(path, M, key, hashes, narrator)
        return M
    place = cached.place_of(hashes)
    missing = np.flatnonzero(place < 0)
    if not len(missing):
        return _columns(cached.measurability, place)
    M = join_measurability([cached.measurability, calculated(pick_viewpoints(candidates, missing))])
    place[missing] = cached.measurability.n_viewpoints + np.arange(len(missing))
    wanted = _columns(M, place)
    if M.n_viewpoints > _KEPT * len(candidates):
        _keep(path, wanted, key, hashes, narrator)
    else:
        _keep(path, M, key, np.concatenate([cached.columns, hashes[missing]]), narrator)
    return wanted


def _columns(M: Measurability, place: NDArray[np.int64]) -> Measurability:
    """The columns in the order that is wanted; M itself where it is in that order already."""
    return M if np.array_equal(place, np.arange(M.n_viewpoints)) else pick_measurability(M, place)


def _keep(path: Path, M: Measurability, key: str, columns: Hashes, narrator: Narrator | None) -> None:
    try:
        measurability_cache.save(path, M, key, columns)
        forget_oldest(path.parent, CACHE_LIMIT_BYTES)
    except FileError as error:
        if narrator is not None:
            narrator.note(f"the matrix is not kept for the next run: {error}")


def forget_oldest(folder: Path, limit: int) -> None:
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
    kept = quality.within(layered, max_sigma_mm / 1000)
    if len(M.indices) and not len(kept.indices) and not may_be_empty:
        best = 1000 * float(layered.sigma.min()) if layered.sigma is not None else float("nan")
        raise SceneError(
            f"plan.max_sigma_mm is {max_sigma_mm:g} and no candidate measures anything so precisely: the best point "
            f"has an expected standard deviation of {best:.3g} mm; a longer baseline, a smaller standoff or a smaller "
            "scanner.sigma_angle_mdeg makes it less"
        )
    return kept
