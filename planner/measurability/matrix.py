"""The measurability matrix M: which surface feature is measured from which viewpoint (Section 3.5.1).

M is binary; its rows are features (samples of the part's surface, or the paper's planning faces), its columns are
candidate viewpoints. It is filled in one of two ways:

    aimed    one leg to each feature: the feature is measured where the scanner's conditions hold and both legs are free
    rays     the paper's: the scanner's ray grid is cast from the viewpoint; the rows of the faces it measures are set

`aimed` answers for the features themselves and does not depend on a ray grid; `rays` answers for what one scan at the
planning resolution would hit. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.measurability.raygrid import scanned_rows
from planner.ports import Progress, RayCaster, Scanner
from planner.surface.mesh import TriangleMesh
from planner.surface.sample import SurfaceSamples
from planner.values import Bools, Floats, Ints, Ints32, Value, freeze, readonly
from planner.viewpoints.lines_of_sight import BUNDLE, Pairs, Targets, flat_poses, free_pairs, in_view, legs_free
from planner.viewpoints.viewpoints import Viewpoints

if TYPE_CHECKING:
    from scipy.sparse import csr_array

METHODS = ("aimed", "rays")

# Pairs between two looks at which samples are still open: few wasted legs, calls still at full speed.
_OPEN_BUNDLE = 40_000


@dataclass(frozen=True, slots=True, eq=False)
class Measurability(Value):
    """A binary matrix in compressed sparse rows: features x viewpoints.

    Attributes:
        indptr: (S + 1,) int64 where each feature's viewpoints start in `indices`.
        indices: (nnz,) int32 viewpoints that measure the feature, ascending within a row.
        features: the S rows.
        n_viewpoints: number of columns V.
        sigma: (nnz,) float32 expected standard deviation of the point that each entry gives [m], from
            `planner.measurability.quality.sigma_layer`; None where it was not asked for.
    """

    indptr: Annotated[Ints, "S+1"]
    indices: Annotated[Ints32, "nnz"]
    features: Annotated[SurfaceSamples, "S"]
    n_viewpoints: int
    sigma: Annotated[NDArray[np.float32], "nnz"] | None = None

    def __post_init__(self) -> None:
        freeze(self)
        if self.sigma is not None and not (self.sigma >= 0).all():
            raise PlannerError("sigma must be 0 or more at every entry")
        if self.indptr[0] != 0 or self.indptr[-1] != len(self.indices) or (np.diff(self.indptr) < 0).any():
            raise PlannerError("indptr does not fit indices; it must rise from 0 to their number")
        if len(self.indices) and not (self.indices.min() >= 0 and self.indices.max() < self.n_viewpoints):
            raise PlannerError(f"indices must be viewpoints, 0 to {self.n_viewpoints - 1}")
        rising = np.diff(self.indices) > 0
        starts = self.indptr[1:-1]
        rising[starts[(starts > 0) & (starts < len(self.indices))] - 1] = True  # a new row may start anywhere
        if not rising.all():
            raise PlannerError("indices must rise within each row, without repetition")

    @property
    def shape(self) -> tuple[int, int]:
        """(features, viewpoints)."""
        return len(self.features), self.n_viewpoints

    def matrix(self) -> "csr_array":
        """(S, V) scipy matrix of bool; it shares the read-only arrays."""
        from scipy.sparse import csr_array

        indptr = self.indptr if len(self.indices) > np.iinfo(np.int32).max else self.indptr.astype(np.int32)
        matrix = csr_array((np.ones(len(self.indices), np.bool_), self.indices, indptr), shape=self.shape, copy=False)
        matrix.has_canonical_format = True
        return matrix


def fill(
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
    poses = flat_poses(viewpoints.T_object_scanner)
    if method == "aimed":
        targets = Targets.of(features.points, features.normals, features.region)
        pairs = free_pairs(poses, targets, scanner, (ray_caster,), lambda i: in_view(targets, poses[i], scanner))
    elif method == "rays":
        if part is None:
            raise PlannerError("method 'rays' needs `part`, the mesh that the ray caster holds")
        rows = _rows(row_of_face, len(part.faces), len(features))
        pairs = scanned_rows(poses, part, rows, scanner, ray_caster)
    else:
        raise PlannerError(f"method '{method}' is unknown; valid are: {', '.join(METHODS)}")
    return _compress(pairs, viewpoints, features, progress)


def occlude(
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
    features = measurability.features
    if len(viewpoints) != measurability.n_viewpoints:
        raise PlannerError(
            f"M has {measurability.n_viewpoints} viewpoints and {len(viewpoints)} were given; they must be the same"
        )
    K = viewpoints.T_object_scanner.shape[1]
    if K > 1 and ray_caster is None:
        raise PlannerError(f"viewpoints of {K} poses need `ray_caster`: M does not say which pose measured a feature")
    poses = flat_poses(viewpoints.T_object_scanner)
    targets = Targets.of(features.points, features.normals, features.region)
    columns = measurability.matrix().tocsc()
    casters = (occluder_caster,) if ray_caster is None or K == 1 else (ray_caster, occluder_caster)

    limits = None if features.region is None else getattr(scanner, "reject_in", None)

    def rows_of(pose: int) -> Ints:
        entries = columns.indices[columns.indptr[pose // K] : columns.indptr[pose // K + 1]].astype(np.int64)
        return entries if K == 1 and limits is None else in_view(targets, poses[pose], scanner, entries)

    pairs = free_pairs(poses, targets, scanner, casters, rows_of)
    return _compress(pairs, viewpoints, features, progress)


def measured(
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
    poses = flat_poses(T_object_scanner)
    targets = Targets.of(features.points, features.normals, features.region)
    K = np.shape(T_object_scanner)[1]
    result = np.zeros((len(features), len(T_object_scanner) if each else 1), dtype=np.bool_)
    asked = np.arange(len(features)) if among is None else np.flatnonzero(among)

    def rows_of(pose: int) -> Ints:
        return in_view(targets, poses[pose], scanner, None if each else asked)

    for done, pose, row in free_pairs(poses, targets, scanner, casters, rows_of, BUNDLE if each else _OPEN_BUNDLE):
        free = _own_free(poses, targets, scanner, own, pose, row, K)
        result[row[free], pose[free] // K if each else 0] = True
        if not each:
            asked = asked[~result[asked, 0]]
        if progress:
            progress(done, len(poses))
    return result if each else result[:, 0]


def _own_free(
    poses: Floats,
    targets: Targets,
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
                free[here] = legs_free(targets, poses, pose[here], row[here], scanner, (caster,))
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
