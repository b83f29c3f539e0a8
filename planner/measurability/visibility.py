"""Fill by casting the scanner's ray grid from every viewpoint: the paper's way (Sections 3.5.1 and 3.6, Eq. 1).

Each ray of the grid is traced to its first hit; range and grazing are judged there; the reflected ray is traced from
the sensor. The row that the hit face belongs to is set. Cost: viewpoints x rays, so the grid's resolution decides.

Which samples a set of views measures, asked again and again of sets that differ by a few views.

A view is asked about a sample once: only where no other view of the set is known to measure it, and only while that is
not known of the view itself. The answer is that of `planner.measurability.matrix.measured`.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.ports import Progress, RayCaster, Rejection, Scanner
from planner.values import Bools, Floats, Ints, Ints32, readonly
from planner.viewpoints.lines_of_sight import (
    BUNDLE,
    Pairs,
    RayTargets,
    flatten_poses,
    in_view,
    lift_points,
    lines_of_sight_free,
    visible_pairs,
)
from planner.viewpoints.viewpoints import Viewpoints

METHODS = ("aimed", "rays")

# Pairs between two looks at which samples are still open: few wasted legs, calls still at full speed.
_OPEN_BUNDLE = 40_000


def fill_matrix(
    viewpoints: Viewpoints,
    features: SurfaceSamples,
    scanner: Scanner,
    ray_caster: RayCaster,
    *,
    method: str = "aimed",
    part: TriangleMesh | None = None,
    row_of_face: NDArray[np.integer] | None = None,
    progress: Progress | None = None,
) -> Measurability:
    """Fill M for the part alone; occluders are applied afterwards by `occlude`.

    Args:
        viewpoints: V candidates with K poses each; a column measures what any of its poses measures.
        features: the S rows. For `aimed` they must lie on the triangles that the caster holds (a feature beneath them
            is in shadow from everywhere).
        scanner: the sensor's law; its ray grid counts only for `rays`.
        ray_caster: casts on the part, object frame.
        method: "aimed" or "rays".
        part: only for `rays`: the mesh that the caster holds, for its normals and its extent.
        row_of_face: only for `rays`: (F,) the row that each face of `part` belongs to, -1 for none; None where faces
            are the rows.
        progress: called with (poses done, poses in all) after each bundle.

    Raises:
        PlannerError: if the method is unknown, or `rays` lacks its mesh or has an invalid `row_of_face`.
    """
    poses = flatten_poses(viewpoints.T_object_scanner)
    if method == "aimed":
        targets = RayTargets.of(features.points, features.normals, features.region)
        pairs = visible_pairs(poses, targets, scanner, (ray_caster,), lambda i: in_view(targets, poses[i], scanner))
    elif method == "rays":
        if part is None:
            raise PlannerError("method 'rays' needs `part`, the mesh that the ray caster holds")
        rows = _rows(row_of_face, len(part.faces), len(features))
        pairs = scanned_rows(poses, part, rows, scanner, ray_caster)
    else:
        raise PlannerError(f"method '{method}' is unknown; valid are: {', '.join(METHODS)}")
    return _compress(pairs, viewpoints, features, progress)


def apply_occluders(
    measurability: Measurability,
    viewpoints: Viewpoints,
    scanner: Scanner,
    occluder_caster: RayCaster,
    *,
    ray_caster: RayCaster | None = None,
    progress: Progress | None = None,
) -> Measurability:
    """Remove what occluders (fixtures, post, floor) hide; only the legs that survived the part are cast.

    What a scanner's limits for the region of a feature do not allow goes as well (`quality.Limited.reject_in`). An
    entry filled by `rays` stands for its feature's own point here. A layer of sigma is not kept.

    Args:
        measurability: M of the part alone.
        viewpoints: the candidates that M was filled for.
        scanner: where source and sensor are.
        occluder_caster: casts on the occluders, in the object frame.
        ray_caster: casts on the part; needed only where viewpoints have several poses (K > 1), because M does not say
            which of them measured the feature.
        progress: called with (poses done, poses in all) after each bundle.

    Raises:
        PlannerError: if the viewpoints are not M's, or the part's caster is missing.
    """
    features = measurability.samples
    if len(viewpoints) != measurability.n_viewpoints:
        raise PlannerError(
            f"M has {measurability.n_viewpoints} viewpoints and {len(viewpoints)} were given; they must be the same"
        )
    K = viewpoints.T_object_scanner.shape[1]
    if K > 1 and ray_caster is None:
        raise PlannerError(f"viewpoints of {K} poses need `ray_caster`: M does not say which pose measured a feature")
    poses = flatten_poses(viewpoints.T_object_scanner)
    targets = RayTargets.of(features.points, features.normals, features.region)
    columns = measurability.matrix().tocsc()
    casters = (occluder_caster,) if ray_caster is None or K == 1 else (ray_caster, occluder_caster)

    limits = None if features.region is None else getattr(scanner, "reject_in", None)

    def rows_of(pose: int) -> Ints:
        entries = columns.indices[columns.indptr[pose // K] : columns.indptr[pose // K + 1]].astype(np.int64)
        return entries if K == 1 and limits is None else in_view(targets, poses[pose], scanner, entries)

    pairs = visible_pairs(poses, targets, scanner, casters, rows_of)
    return _compress(pairs, viewpoints, features, progress)


def find_measured(
    T_object_scanner: Floats,
    features: SurfaceSamples,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    *,
    each: bool = False,
    own: Sequence[RayCaster | None] | None = None,
    among: Bools | None = None,
    progress: Progress | None = None,
) -> Bools:
    """Which features a few given views measure: prediction on samples that the plan has not seen.

    Args:
        T_object_scanner: (n, K, 4, 4) views of K poses [m].
        features: S points, object frame, on the part's triangles.
        scanner: the sensor's law.
        casters: the part's caster and those of occluders.
        each: answer for each view; otherwise for all of them together, where a feature is asked about only until a view
            measures it.
        own: for each view what stands in the way of that view alone (the arm as it stands there), or None.
        among: (S,) without `each`: features that are asked about; the others count as not measured. None: all.
        progress: called with (poses done, poses in all) after each bundle.

    Returns:
        (S,) True where any view measures the feature; with `each` (S, n).
    """
    poses = flatten_poses(T_object_scanner)
    targets = RayTargets.of(features.points, features.normals, features.region)
    K = np.shape(T_object_scanner)[1]
    result = np.zeros((len(features), len(T_object_scanner) if each else 1), dtype=np.bool_)
    asked = np.arange(len(features)) if among is None else np.flatnonzero(among)

    def rows_of(pose: int) -> Ints:
        return in_view(targets, poses[pose], scanner, None if each else asked)

    for done, pose, row in visible_pairs(poses, targets, scanner, casters, rows_of, BUNDLE if each else _OPEN_BUNDLE):
        free = _own_free(poses, targets, scanner, own, pose, row, K)
        result[row[free], pose[free] // K if each else 0] = True
        if not each:
            asked = asked[~result[asked, 0]]
        if progress:
            progress(done, len(poses))
    return result if each else result[:, 0]


def _own_free(
    poses: Floats,
    targets: RayTargets,
    scanner: Scanner,
    own: Sequence[RayCaster | None] | None,
    pose: Ints,
    row: Ints,
    K: int,
) -> Bools:
    """(n,) whether what belongs to the view of each pair leaves its legs free."""
    free = np.ones(len(row), dtype=np.bool_)
    if own is not None:
        for view in np.unique(pose // K):
            caster = own[view]
            if caster is not None:
                here = np.flatnonzero(pose // K == view)
                free[here] = lines_of_sight_free(targets, poses, pose[here], row[here], scanner, (caster,))
    return free


def _compress(
    pairs: Pairs, viewpoints: Viewpoints, features: SurfaceSamples, progress: Progress | None
) -> Measurability:
    """Gather pairs column by column and turn them into sparse rows; 4 bytes per entry, twice while turning."""
    from scipy.sparse import csc_array

    V, K = viewpoints.T_object_scanner.shape[:2]
    counts = np.zeros(V, dtype=np.int64)
    rows: list[Ints32] = []
    for done, pose, row in pairs:
        counts += np.bincount(pose // K, minlength=V)
        rows.append(row.astype(np.int32))
        if progress:
            progress(done, V * K)
    indices = np.concatenate(rows) if rows else np.empty(0, dtype=np.int32)
    indptr = np.concatenate([[0], np.cumsum(counts)])
    matrix = csc_array((np.ones(len(indices), np.bool_), indices, indptr), shape=(len(features), V)).tocsr()
    matrix.sum_duplicates()  # several poses of a viewpoint may measure the same feature; sorts as well
    return Measurability(matrix.indptr.astype(np.int64), matrix.indices, features, V)


def _rows(row_of_face: NDArray[np.integer] | None, faces: int, features: int) -> Ints32:
    if row_of_face is None:
        if faces != features:
            raise PlannerError(
                f"`part` has {faces} faces and there are {features} rows; give `row_of_face` to map them"
            )
        return np.arange(faces, dtype=np.int32)
    rows: Ints32 = readonly("row_of_face", row_of_face, (faces,), np.int32)
    if rows.min() < -1 or rows.max() >= features:
        raise PlannerError(f"row_of_face has values {rows.min()} to {rows.max()}; valid are -1 to {features - 1}")
    return rows


def scanned_rows(
    poses: Floats, part: TriangleMesh, row_of_face: Ints32, scanner: Scanner, ray_caster: RayCaster
) -> Iterator[tuple[int, Ints, Ints]]:
    """Rows that a scan from each pose measures.

    Rays that pass the part's bounding sphere are not cast: they cannot hit.

    Args:
        poses: (P, 4, 4) T_object_scanner [m].
        part: the mesh that the caster holds, object frame.
        row_of_face: (F,) row of each face, -1 for none.
        scanner: its ray grid and its conditions.
        ray_caster: casts on the part.

    Yields:
        (poses done, pose of each pair, row of each pair) in bundles; each pair once.
    """
    normals = part.normals
    used = part.vertices[part.faces.ravel()]
    low, high = used.min(axis=0), used.max(axis=0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    radius = float(np.linalg.norm(used - middle, axis=1).max()) * (1 + 1e-6)
    grid = scanner.ray_directions()
    n_rows = int(row_of_face.max(initial=0)) + 1
    waiting: list[Ints] = []
    first, count = 0, 0
    for pose in range(len(poses)):
        T = poses[pose]
        waiting.append(_towards(grid, T[:3, :3].T @ (middle - T[:3, 3]), scanner.source, radius))
        count += len(waiting[-1])
        if count < BUNDLE and pose + 1 < len(poses):
            continue
        which, face = _scan(poses[first : pose + 1], waiting, grid, normals, diagonal, scanner, ray_caster)
        row = row_of_face[face].astype(np.int64)
        keys = np.unique(((which + first) * n_rows + row)[row >= 0])
        yield pose + 1, keys // n_rows, keys % n_rows
        waiting, first, count = [], pose + 1, 0


def _towards(grid: Floats, middle: Floats, source: Floats, radius: float) -> Ints:
    """Rays of the grid that meet a sphere; all in the scanner frame."""
    towards = middle - source
    squared = float(towards @ towards) - radius**2
    if squared <= 0:  # the source is inside
        return np.arange(len(grid))
    return np.flatnonzero(grid @ towards >= np.sqrt(squared))


def _scan(
    poses: Floats,
    rays: list[Ints],
    grid: Floats,
    normals: Floats,
    diagonal: float,
    scanner: Scanner,
    ray_caster: RayCaster,
) -> tuple[Ints, Ints32]:
    """(pose, face) of every ray that is measured; `rays[i]` are those of the grid that pose i casts."""
    ends = np.concatenate([[0], np.cumsum([len(chosen) for chosen in rays])])
    pose = np.repeat(np.arange(len(poses)), np.diff(ends))
    local = grid[np.concatenate(rays)]
    directions = np.empty_like(local)
    for i, (start, stop) in enumerate(pairwise(ends)):
        directions[start:stop] = local[start:stop] @ poses[i, :3, :3].T
    sources = poses[:, :3, :3] @ scanner.source + poses[:, :3, 3]
    sensors = poses[:, :3, :3] @ scanner.sensor + poses[:, :3, 3]
    hits = ray_caster.first_hit(sources[pose], directions)
    hit = np.flatnonzero(hits.face >= 0)
    pose, face, distance = pose[hit], hits.face[hit], hits.distance[hit, None]
    outward = normals[face]
    in_scanner = np.empty_like(outward)
    for i, (start, stop) in enumerate(pairwise(np.searchsorted(pose, np.arange(len(poses) + 1)))):
        in_scanner[start:stop] = outward[start:stop] @ poses[i, :3, :3]
    codes = scanner.reject(scanner.source + local[hit] * distance, in_scanner)
    good = np.flatnonzero(codes == Rejection.MEASURED)
    pose, face = pose[good], face[good]
    points = sources[pose] + directions[hit[good]] * distance[good]
    free = ~ray_caster.blocked(sensors[pose], lift_points(points, outward[good], diagonal))
    return pose[free], face[free]


_VIEWS = 256  # that are remembered, those asked about last: 25 MB at 10^5 samples
_UNKNOWN, _MISSED, _SEEN = 0, 1, 2


class VisibilityMemo:
    """What is known so far of views and samples.

    Args:
        samples: S points, object frame, on the part's triangles.
        scanner: the sensor's law.
        casters: the part's caster and those of occluders.
    """

    def __init__(self, samples: SurfaceSamples, scanner: Scanner, casters: Sequence[RayCaster]) -> None:
        self._targets = RayTargets.of(samples.points, samples.normals, samples.region)
        self._scanner, self._casters = scanner, casters
        self._known: dict[bytes, NDArray[np.uint8]] = {}

    def measured(self, T_object_scanner: Floats) -> Bools:
        """(S,) samples that any of the views (n, K, 4, 4) [m] measures."""
        poses, K = flatten_poses(T_object_scanner), np.shape(T_object_scanner)[1]
        known = [self._of(view) for view in poses.reshape(-1, K, 4, 4)]
        found = np.zeros(len(self._targets), dtype=np.bool_)
        for view in known:
            found |= view == _SEEN

        def rows_of(pose: int) -> Ints:
            view = known[pose // K]
            if pose % K == 0:
                asked[:] = ~found & (view == _UNKNOWN)
                view[asked] = _MISSED
            return in_view(self._targets, poses[pose], self._scanner, np.flatnonzero(asked & (view == _MISSED)))

        asked = np.zeros_like(found)
        for _, pose, row in visible_pairs(poses, self._targets, self._scanner, self._casters, rows_of, _OPEN_BUNDLE):
            found[row] = True
            for number in np.unique(pose // K):
                known[number][row[pose // K == number]] = _SEEN
        return found

    def _of(self, view: Floats) -> NDArray[np.uint8]:
        """(S,) what is known of a view (K, 4, 4)."""
        name = view.tobytes()
        known = self._known.pop(name, None)
        self._known[name] = np.zeros(len(self._targets), dtype=np.uint8) if known is None else known
        if len(self._known) > _VIEWS:
            del self._known[next(iter(self._known))]
        return self._known[name]
