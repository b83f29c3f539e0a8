"""Compute which samples views measure: fill the matrix M, apply occluders, test given views.

M is filled by one of two methods (Section 3.5.1):

    aimed    two lines of sight per sample: it is measured if the scanner's conditions hold and both are free
    rays     the method of the paper (Section 3.6, Eq. 1): the ray grid of the scanner is cast from the viewpoint

With `rays` each ray is traced to its first hit. Range and grazing angle are tested there, and the reflected ray is
traced from the sensor; the row of the hit face is then set. The cost is viewpoints x rays, so the resolution of the
grid decides. `aimed` evaluates the samples themselves and does not depend on a ray grid; `rays` evaluates the hits of
one scan at the planning resolution. Object frame, metres.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.ports import Progress, RayCaster, Rejection, Scanner, no_progress
from planner.values import Bools, Floats, Ints, Ints32, readonly
from planner.viewpoints.lines_of_sight import (
    BUNDLE,
    Pairs,
    RayTargets,
    bundle_items,
    flatten_poses,
    in_view,
    lift_points,
    lines_of_sight_free,
    visible_pairs,
)
from planner.viewpoints.viewpoints import Viewpoints

METHODS = ("aimed", "rays")

_OPEN_BUNDLE = 40_000  # pairs between two updates of the open samples: few wasted rays, calls still at full speed
_REMEMBERED = 256  # views of a `VisibilityMemo`, the last ones used: 25 MB at 10^5 samples
_UNKNOWN, _MISSED, _SEEN = 0, 1, 2


def fill_matrix(
    viewpoints: Viewpoints,
    samples: SurfaceSamples,
    scanner: Scanner,
    ray_caster: RayCaster,
    *,
    method: str = "aimed",
    part: TriangleMesh | None = None,
    row_of_face: NDArray[np.integer] | None = None,
    progress: Progress = no_progress,
) -> Measurability:
    """Fill M for the part alone; `apply_occluders` takes occluders into account afterwards.

    Args:
        viewpoints: V candidates with K poses each; a column measures the union of its poses.
        samples: the S rows. For `aimed` they must lie on the triangles of the caster: a sample beneath them is occluded
            from everywhere.
        scanner: sensor model; its ray grid is used only for `rays`.
        ray_caster: of the part.
        method: "aimed" or "rays".
        part: only for `rays`: the mesh of the caster, for its normals and its extent.
        row_of_face: only for `rays`: (F,) row of each face of `part`, -1 for none; None if faces are the rows.
        progress: called with (poses done, poses in all) after each bundle.
    """
    poses = flatten_poses(viewpoints.T_object_scanner)
    if method == "aimed":
        targets = RayTargets.of(samples.points, samples.normals, samples.region)
        pairs = visible_pairs(poses, targets, scanner, (ray_caster,), lambda i: in_view(targets, poses[i], scanner))
    elif method == "rays":
        if part is None:
            raise PlannerError("method 'rays' needs `part`, the mesh that the ray caster holds")
        rows = _check_rows(row_of_face, len(part.faces), len(samples))
        pairs = scanned_rows(poses, part, rows, scanner, ray_caster)
    else:
        raise PlannerError(f"method '{method}' is unknown; valid are: {', '.join(METHODS)}")
    return _compress(pairs, viewpoints, samples, progress)


def apply_occluders(
    measurability: Measurability,
    viewpoints: Viewpoints,
    scanner: Scanner,
    occluder_caster: RayCaster,
    *,
    ray_caster: RayCaster | None = None,
    progress: Progress = no_progress,
) -> Measurability:
    """Remove the entries that occluders (fixtures, post, floor) hide; only lines of sight of entries are cast.

    Args:
        measurability: M of the part alone.
        viewpoints: candidates of M.
        scanner: sensor model.
        occluder_caster: of everything but the part.
        ray_caster: of the part; needed only if viewpoints have several poses (K > 1), because M does not say which of
            them measured the sample.
        progress: called with (poses done, poses in all) after each bundle.
    """
    pairs = _unoccluded_pairs(measurability, viewpoints, scanner, occluder_caster, ray_caster)
    return _compress(pairs, viewpoints, measurability.samples, progress)


def any_unoccluded(
    measurability: Measurability,
    viewpoints: Viewpoints,
    usable: Bools,
    scanner: Scanner,
    occluder_caster: RayCaster,
    *,
    ray_caster: RayCaster | None = None,
) -> Bools:
    """Return (S,) whether a usable candidate measures each sample past occluders: an entry of `apply_occluders` stays.

    A sample is tested only until a candidate measures it.

    Args:
        measurability: M of the part alone.
        viewpoints: candidates of M.
        usable: (V,) candidates that count.
        scanner: sensor model.
        occluder_caster: of everything but the part.
        ray_caster: of the part, as for `apply_occluders`.
    """
    is_open = np.ones(len(measurability.samples), dtype=np.bool_)
    for _, _, row in _unoccluded_pairs(
        measurability, viewpoints, scanner, occluder_caster, ray_caster, usable=usable, is_open=is_open
    ):
        is_open[row] = False
    return ~is_open


def _unoccluded_pairs(
    measurability: Measurability,
    viewpoints: Viewpoints,
    scanner: Scanner,
    occluder_caster: RayCaster,
    ray_caster: RayCaster | None,
    *,
    usable: Bools | None = None,
    is_open: Bools | None = None,
) -> Pairs:
    """Yield the pairs of entries of M that occluders do not hide, as `visible_pairs`.

    With `is_open` (S,), which the caller updates, a pose is tested on the samples that are open by then; with `usable`
    (V,) only usable viewpoints are tested.
    """
    samples = measurability.samples
    require_candidates(viewpoints, measurability)
    K = viewpoints.T_object_scanner.shape[1]
    if K > 1 and ray_caster is None:
        raise PlannerError(f"viewpoints of {K} poses need `ray_caster`: M does not say which pose measured a sample")
    poses = flatten_poses(viewpoints.T_object_scanner)
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    columns = measurability.matrix().tocsc()
    casters = (occluder_caster,) if ray_caster is None or K == 1 else (ray_caster, occluder_caster)
    has_region_limits = samples.region is not None and getattr(scanner, "reject_in", None) is not None

    def rows_of(pose: int) -> Ints:
        if usable is not None and not usable[pose // K]:
            return np.empty(0, dtype=np.int64)
        entries = columns.indices[columns.indptr[pose // K] : columns.indptr[pose // K + 1]].astype(np.int64)
        if is_open is not None:
            entries = entries[is_open[entries]]
        return in_view(targets, poses[pose], scanner, entries) if K > 1 or has_region_limits else entries

    return visible_pairs(poses, targets, scanner, casters, rows_of, BUNDLE if is_open is None else len(samples))


def require_candidates(viewpoints: Viewpoints, measurability: Measurability) -> None:
    """Refuse other candidates than those of M."""
    if len(viewpoints) != measurability.n_viewpoints:
        raise PlannerError(
            f"M has {measurability.n_viewpoints} viewpoints and {len(viewpoints)} were given; they must be the same"
        )


def find_measured(
    T_object_scanner: Floats,
    samples: SurfaceSamples,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    *,
    each: bool = False,
    own_occluders: Sequence[RayCaster | None] | None = None,
    among: Bools | None = None,
    progress: Progress = no_progress,
) -> Bools:
    """Return the samples that given views measure: a prediction on samples that the plan did not use.

    Args:
        T_object_scanner: (n, K, 4, 4) views of K poses [m].
        samples: S points on the part's triangles.
        scanner: sensor model.
        casters: of the part and of occluders.
        each: evaluate each view; otherwise all views together, and a sample only until a view measures it.
        own_occluders: for each view the caster of an occluder of this view alone (the arm in its configuration); or
            None.
        among: (S,) without `each`: samples to test; the others count as not measured. None: all.
        progress: called with (poses done, poses in all) after each bundle.

    Returns:
        (S,) whether any view measures the sample; with `each` (S, n).
    """
    poses = flatten_poses(T_object_scanner)
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    K = np.shape(T_object_scanner)[1]
    result = np.zeros((len(samples), len(T_object_scanner) if each else 1), dtype=np.bool_)
    still_open = np.arange(len(samples)) if among is None else np.flatnonzero(among)

    def rows_of(pose: int) -> Ints:
        return in_view(targets, poses[pose], scanner, None if each else still_open)

    for n_done, pose, row in visible_pairs(poses, targets, scanner, casters, rows_of, BUNDLE if each else _OPEN_BUNDLE):
        free = np.ones(len(row), dtype=np.bool_)
        for view in np.unique(pose // K) if own_occluders is not None else ():
            if own_occluders is not None and (caster := own_occluders[view]) is not None:
                here = np.flatnonzero(pose // K == view)
                free[here] = lines_of_sight_free(targets, poses, pose[here], row[here], scanner, (caster,))
        result[row[free], pose[free] // K if each else 0] = True
        if not each:
            still_open = still_open[~result[still_open, 0]]
        progress(n_done, len(poses))
    return result if each else result[:, 0]


class VisibilityMemo:
    """Evaluates sets of views that differ by a few views and remembers the results, as `find_measured` computes them.

    A pair of view and sample is evaluated at most once, and only if no other view of the set is known to measure the
    sample.

    Args:
        samples: S points on the part's triangles.
        scanner: sensor model.
        casters: of the part and of occluders.
    """

    def __init__(self, samples: SurfaceSamples, scanner: Scanner, casters: Sequence[RayCaster]) -> None:
        self._targets = RayTargets.of(samples.points, samples.normals, samples.region)
        self._scanner, self._casters = scanner, casters
        self._known: dict[bytes, NDArray[np.uint8]] = {}

    def measured(self, T_object_scanner: Floats) -> Bools:
        """Return (S,) the samples that any of the views (n, K, 4, 4) [m] measures."""
        poses, K = flatten_poses(T_object_scanner), np.shape(T_object_scanner)[1]
        known = [self._results_of(view) for view in poses.reshape(-1, K, 4, 4)]
        is_measured = np.zeros(len(self._targets), dtype=np.bool_)
        for results in known:
            is_measured |= results == _SEEN

        def rows_of(pose: int) -> Ints:
            results = known[pose // K]
            if pose % K == 0:
                tested[:] = ~is_measured & (results == _UNKNOWN)
                results[tested] = _MISSED
            return in_view(self._targets, poses[pose], self._scanner, np.flatnonzero(tested & (results == _MISSED)))

        tested = np.zeros_like(is_measured)
        for _, pose, row in visible_pairs(poses, self._targets, self._scanner, self._casters, rows_of, _OPEN_BUNDLE):
            is_measured[row] = True
            for number in np.unique(pose // K):
                known[number][row[pose // K == number]] = _SEEN
        return is_measured

    def _results_of(self, view: Floats) -> NDArray[np.uint8]:
        """Return (S,) the known results of a view (K, 4, 4), moved to the end of the memory."""
        key = view.tobytes()
        known = self._known.pop(key, None)
        self._known[key] = np.zeros(len(self._targets), dtype=np.uint8) if known is None else known
        if len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
        return self._known[key]


def _compress(pairs: Pairs, viewpoints: Viewpoints, samples: SurfaceSamples, progress: Progress) -> Measurability:
    """Collect pairs column by column and convert them to sparse rows; 4 bytes per entry, twice while converting."""
    from scipy.sparse import csc_array

    V, K = viewpoints.T_object_scanner.shape[:2]
    counts = np.zeros(V, dtype=np.int64)
    rows: list[Ints32] = []
    for n_done, pose, row in pairs:
        counts += np.bincount(pose // K, minlength=V)
        rows.append(row.astype(np.int32))
        progress(n_done, V * K)
    indices = np.concatenate(rows) if rows else np.empty(0, dtype=np.int32)
    indptr = np.concatenate([[0], np.cumsum(counts)])
    matrix = csc_array((np.ones(len(indices), np.bool_), indices, indptr), shape=(len(samples), V)).tocsr()
    matrix.sum_duplicates()  # several poses of a viewpoint may measure the same sample; also sorts
    return Measurability(matrix.indptr.astype(np.int64), matrix.indices, samples, V)


def _check_rows(row_of_face: NDArray[np.integer] | None, faces: int, samples: int) -> Ints32:
    if row_of_face is None:
        if faces != samples:
            raise PlannerError(f"`part` has {faces} faces and there are {samples} rows; give `row_of_face` to map them")
        return np.arange(faces, dtype=np.int32)
    rows: Ints32 = readonly("row_of_face", row_of_face, (faces,), np.int32)
    if rows.min() < -1 or rows.max() >= samples:
        raise PlannerError(f"row_of_face has values {rows.min()} to {rows.max()}; valid are -1 to {samples - 1}")
    return rows


def scanned_rows(
    poses: Floats, part: TriangleMesh, row_of_face: Ints32, scanner: Scanner, ray_caster: RayCaster
) -> Iterator[tuple[int, Ints, Ints]]:
    """Yield the rows that a scan from each pose measures; rays that miss the part's bounding sphere are not cast.

    Args:
        poses: (P, 4, 4) T_object_scanner [m].
        part: the mesh of the caster.
        row_of_face: (F,) row of each face, -1 for none.
        scanner: its ray grid and its conditions.
        ray_caster: of the part.

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

    def rays_of(pose: int) -> Ints:
        T = poses[pose]
        return _rays_to_sphere(grid, T[:3, :3].T @ (middle - T[:3, 3]), scanner.source, radius)

    for first, rays in bundle_items(len(poses), rays_of, BUNDLE):
        n_done = first + len(rays)
        which, face = _scan(poses[first:n_done], rays, grid, normals, diagonal, scanner, ray_caster)
        row = row_of_face[face].astype(np.int64)
        keys = np.unique(((which + first) * n_rows + row)[row >= 0])
        yield n_done, keys // n_rows, keys % n_rows


def _rays_to_sphere(grid: Floats, middle: Floats, source: Floats, radius: float) -> Ints:
    """Return the rays of the grid that meet a sphere; all in the scanner frame."""
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
    """Return (pose, face) of every ray that is measured; pose i casts the rays `rays[i]` of the grid."""
    ends = np.concatenate([[0], np.cumsum([len(indices) for indices in rays])])
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
