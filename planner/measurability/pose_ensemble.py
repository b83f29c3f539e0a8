"""Probability that a view measures a sample under errors of the scanner's pose (Scott 2009).

The error of an executed pose is normal, with one standard deviation of position along each axis of the scanner and one
of orientation about each. An ensemble of drawn errors gives for each entry of the matrix the number of its members that
measure the sample. All views use the same errors (common random numbers, so that views are compared under equal
conditions). Scott, "Model-based view planning", Machine Vision and Applications 20 (2009),
doi:10.1007/s00138-007-0110-2.

An entry counts only if the view also measures the sample without error. Samples that an error brings into view by
chance are left out, so coverage at a confidence is a lower estimate, and only the entries of the matrix are evaluated
again. Object frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.geometry.rigid import rotation_matrices
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import find_measured
from planner.ports import Progress, RayCaster, Scanner, no_progress
from planner.values import Bools, Floats, Ints, Ints32, Value, freeze
from planner.viewpoints.lines_of_sight import RayTargets, flatten_poses, in_view, visible_pairs
from planner.viewpoints.viewpoints import Viewpoints

MEMBERS = 32
"""Default size of the ensemble. The probability of one view is then at most 98.5 %, see `credited_probability`."""


@dataclass(frozen=True, slots=True)
class PoseError:
    """Standard deviations of the errors of an executed pose.

    Attributes:
        position: of the scanner's origin, along each of its axes [m].
        orientation: of the scanner, about each of its axes [rad].
    """

    position: float
    orientation: float

    def __post_init__(self) -> None:
        for name in ("position", "orientation"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise PlannerError(
                    f"the standard deviation of {name} is {value}; it must be a finite number, 0 or more"
                )

    @property
    def is_exact(self) -> bool:
        """Whether poses are exact."""
        return self.position == 0 and self.orientation == 0

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw (count, 4, 4) errors: the actual pose of the scanner in the frame of the planned one [m]."""
        samples = rng.standard_normal((count, 6))
        T = np.zeros((count, 4, 4))
        T[:, :3, :3] = rotation_matrices(self.orientation * samples[:, 3:])
        T[:, :3, 3] = self.position * samples[:, :3]
        T[:, 3, 3] = 1.0
        return T


@dataclass(frozen=True, slots=True, eq=False)
class ProbabilityLayer(Value):
    """Number of members of the ensemble that measure the sample, for each entry of a measurability matrix.

    Attributes:
        indptr: (S + 1,) as in the matrix.
        indices: (nnz,) as in the matrix.
        hits: (nnz,) members that measure the sample, 0 to `members`.
        members: size of the ensemble; 0 for exact poses, with which every entry is certain.
    """

    indptr: Annotated[Ints, "S+1"]
    indices: Annotated[Ints32, "nnz"]
    hits: Annotated[Ints32, "nnz"]
    members: int

    def __post_init__(self) -> None:
        freeze(self)
        if len(self.hits) and not (self.hits.min() >= 0 and self.hits.max() <= self.members):
            raise PlannerError(f"hits must be from 0 to the ensemble's {self.members} members")

    @property
    def probability(self) -> Floats:
        """(nnz,) credited probability of each entry."""
        return credited_probability(self.hits, self.members)

    def restricted_to(self, M: Measurability) -> "ProbabilityLayer":
        """Return the layer on the entries of a matrix that contains a part of this layer's entries."""
        width = M.n_viewpoints
        entries, requested_entries = (
            np.repeat(np.arange(len(start) - 1), np.diff(start)) * width + columns
            for start, columns in ((self.indptr, self.indices), (M.indptr, M.indices))
        )
        at = np.searchsorted(entries, requested_entries)
        if len(requested_entries) and (
            not len(entries) or (entries[np.minimum(at, len(entries) - 1)] != requested_entries).any()
        ):
            raise PlannerError("the matrix has entries that the layer lacks; make the layer anew")
        return ProbabilityLayer(M.indptr, M.indices, self.hits[at], self.members)


def credited_probability(hits: NDArray[np.integer], members: int) -> Floats:
    """Return the probability for hits out of members: (hits + 1/2) / (members + 1), and 0 without a hit.

    It is the mean of the posterior under Jeffreys' prior (Krichevsky, Trofimov 1981, doi:10.1109/TIT.1981.1056331).
    Hits of all members do not prove certainty, and a sum of logarithms needs a cap. Without members (exact poses) a hit
    is certain.
    """
    if members == 0:
        return np.ones(np.shape(hits))
    hits = np.asarray(hits, dtype=np.float64)
    return np.where(hits > 0, (hits + 0.5) / (members + 1.0), 0.0)


def probability_layer(
    M: Measurability,
    viewpoints: Viewpoints,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    errors: Floats,
    *,
    columns: Bools | None = None,
    progress: Progress = no_progress,
) -> ProbabilityLayer:
    """Count for each entry the members of an ensemble that measure the sample.

    The cost is that of filling the entries of the matrix once per member.

    Args:
        M: the matrix, occluders applied.
        viewpoints: its columns; an error applies to all poses of a sweep alike.
        scanner: sensor model.
        casters: of the part and of occluders.
        errors: (m, 4, 4) drawn errors, from `PoseError.draw`; none means exact poses.
        columns: (V,) columns to evaluate (the reachable ones); entries of others get no hit.
        progress: called with (members done, members in all).
    """
    hits = np.zeros(len(M.indices), dtype=np.int32)
    targets = RayTargets.of(M.samples.points, M.samples.normals, M.samples.region)
    numbered = M.matrix().astype(np.int64)
    numbered.data = np.arange(len(hits))  # entries are numbered in row order
    by_column = numbered.tocsc()
    start, rows = by_column.indptr, by_column.indices.astype(np.int64)
    keys = np.repeat(np.arange(M.n_viewpoints), np.diff(start)) * len(targets) + rows
    K = viewpoints.T_object_scanner.shape[1]

    def rows_of(pose: int) -> Ints:
        view_rows = rows[start[pose // K] : start[pose // K + 1]]
        is_evaluated = len(view_rows) and (columns is None or columns[pose // K])
        return in_view(targets, poses[pose], scanner, view_rows) if is_evaluated else view_rows[:0]

    for member, error in enumerate(errors, start=1):
        poses = flatten_poses(viewpoints.T_object_scanner @ error)
        hit = np.zeros(len(hits), dtype=np.bool_)
        for _, pose, row in visible_pairs(poses, targets, scanner, casters, rows_of):
            hit[np.searchsorted(keys, pose // K * len(targets) + row)] = True
        hits[by_column.data[hit]] += 1
        progress(member, len(errors))
    return ProbabilityLayer(M.indptr, M.indices, hits, len(errors))


def simulate_executions(
    T_object_scanner: Floats,
    samples: SurfaceSamples,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    errors: Floats,
    *,
    progress: Progress = no_progress,
) -> tuple[Ints32, Floats]:
    """Simulate executions of a plan with pose errors, and count how often each sample is measured.

    Args:
        T_object_scanner: (n, K, 4, 4) views of the plan [m].
        samples: S points of the surface.
        scanner: sensor model.
        casters: of the part and of occluders.
        errors: (N, n, 4, 4) error of each view in each execution.
        progress: called with (executions done, executions in all).

    Returns:
        (S,) executions in which any view measures the sample, and (N,) share of the samples' area that each measures.
    """
    times = np.zeros(len(samples), dtype=np.int32)
    share = np.zeros(len(errors))
    for number, error in enumerate(errors):
        is_measured = find_measured(T_object_scanner @ error[:, None], samples, scanner, casters)
        times += is_measured
        share[number] = samples.areas[is_measured].sum() / samples.areas.sum()
        progress(number + 1, len(errors))
    return times, share
