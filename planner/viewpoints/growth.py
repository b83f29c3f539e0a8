"""Grow candidates for the open surface: few poses that together measure nearly all that reachable poses can measure.

A generator that looks along normals does not cover niches, surface for which these poses are out of reach, and surface
that needs another distance or roll. `grow` is given points of the surface (scouts: neither the rows of the matrix nor
the points on which coverage is judged) and which of them the existing candidates measure. It executes `SCHEDULE`: each
stage generates poses for open points, from the sequence of `pose_sampling` or transferred from neighbours, and keeps
the reachable ones that measure their point. Of these it adds the few that measure the largest open area, until each
point is measured `MULTIPLICITY` times if possible, so that the selection has a choice.

The effort is bounded: a stage considers open points, spread over the surface, up to its budget of poses. A point that
stays open is a failed search, not a proof. Object frame, metres.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner.ports import Progress, RayCaster, Scanner, no_progress
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets, in_view_matrix, lines_of_sight_free
from planner.viewpoints.pose_sampling import (
    NO_POSES,
    AimedPoses,
    Frustum,
    draw_poses,
    find_frustum,
    poses_with_free_sight,
    transfer_poses,
)

N_SCOUTS = 20_000
"""Points of the surface for which candidates grow."""

MULTIPLICITY = 3
"""Grown candidates per point that no other candidate measures, if there are as many."""

_COMPARED = 4  # poses of a point that are compared by the area that they measure
_TOGETHER = 8192  # poses that are generated at a time: the next batch skips the points that it measures
_PAIRS = 100_000  # of a pose and a point that are evaluated at a time
_NEIGHBOURS = 4
_MIN_GAIN = 2e-4  # share of the surface; a stage of transferred poses is not repeated below


@dataclass(frozen=True, slots=True)
class SearchStage:
    """One pass over the open points.

    Attributes:
        elements: range of the sequence, for each point (and neighbour).
        transfer: whether poses are transferred from neighbours; otherwise they are drawn.
        budget: largest number of generated poses.
    """

    elements: tuple[int, int]
    transfer: bool
    budget: int


SCHEDULE = (
    SearchStage((0, 32), transfer=False, budget=200_000),
    *(SearchStage((8 * k, 8 * k + 8), transfer=True, budget=100_000) for k in range(3)),
    SearchStage((32, 128), transfer=False, budget=100_000),
    *(SearchStage((8 * k, 8 * k + 8), transfer=True, budget=100_000) for k in range(3, 6)),
    SearchStage((128, 512), transfer=False, budget=100_000),
    *(SearchStage((8 * k, 8 * k + 8), transfer=True, budget=100_000) for k in range(6, 9)),
)


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvaluator:
    """Scanner, occluders and reachability: decides which points a pose measures and whether the arm takes it up.

    Attributes:
        scanner: sensor model.
        casters: of the part and of occluders.
        are_reachable: (n, K, 4, 4) T_object_scanner [m] -> (n,) whether the arm takes up all K poses without collision.
        T_view_scanner: (K, 4, 4) poses of a view relative to its viewpoint [m]; one identity for a scanner at rest.
    """

    scanner: Scanner
    casters: Sequence[RayCaster]
    are_reachable: Callable[[Floats], Bools]
    T_view_scanner: Floats

    def views(self, aimed: AimedPoses) -> Floats:
        """Return (n, 4, 4) viewpoints [m] whose middle pose is the aimed one."""
        return np.asarray(aimed.T_object_scanner @ np.linalg.inv(self.T_view_scanner[len(self.T_view_scanner) // 2]))

    def measuring(self, aimed: AimedPoses, targets: RayTargets) -> AimedPoses:
        """Return the poses that measure their point and whose view is reachable."""
        aimed = poses_with_free_sight(aimed, targets, self.scanner, self.casters)
        return aimed.pick(self.are_reachable(self.views(aimed)[:, None] @ self.T_view_scanner))

    def measured(
        self, views: Floats, targets: RayTargets, rows: Ints, threshold: tuple[Floats, float] | None = None
    ) -> Bools:
        """Return (m, n) whether each viewpoint measures each row.

        Args:
            views: (n, 4, 4) viewpoints [m].
            targets: S surface points.
            rows: (m,) of them.
            threshold: weights (m,) of the rows and a smallest sum: a viewpoint with at most this sum in view is not
                evaluated further, and measures nothing.
        """
        K = len(self.T_view_scanner)
        poses = (views[:, None] @ self.T_view_scanner).reshape(-1, 4, 4)
        is_measured = np.zeros((len(rows), len(views)), dtype=np.bool_)
        together = max(1, _PAIRS // max(len(rows), 1)) * K
        for first in range(0, len(poses), together):
            block = poses[first : first + together]
            visible = in_view_matrix(targets, block, self.scanner, rows)
            if threshold is not None:
                bound = (visible @ threshold[0]).reshape(-1, K).sum(axis=1)
                visible[np.repeat(bound <= threshold[1], K)] = False
            pose, row = np.nonzero(visible)
            free = lines_of_sight_free(targets, block, pose, rows[row], self.scanner, self.casters)
            is_measured[row[free], (first + pose[free]) // K] = True
        return is_measured


def grow(
    targets: RayTargets,
    seen: Bools,
    evaluator: ViewEvaluator,
    *,
    schedule: Sequence[SearchStage] = SCHEDULE,
    multiplicity: int = MULTIPLICITY,
    progress: Progress = no_progress,
) -> AimedPoses:
    """Grow viewpoints for the open points.

    Args:
        targets: S scouts with equal areas.
        seen: (S,) whether an existing candidate measures each.
        evaluator: scanner, occluders and reachability.
        schedule: stages of the search.
        multiplicity: grown candidates that measure a point, if possible.
        progress: called with (stages done, stages).

    Returns:
        The viewpoints, each with the scout at which it is aimed.
    """
    search = _Growth(targets, evaluator, find_frustum(evaluator.scanner), np.where(seen, multiplicity, 0), multiplicity)
    gain = 1.0
    for number, stage in enumerate(schedule):
        if not stage.transfer:
            gain = 1.0
        if gain >= _MIN_GAIN and (len(search.known) or not stage.transfer):
            gain = search.execute(stage)
        progress(number + 1, len(schedule))
    return AimedPoses(evaluator.views(search.known), search.known.row)


class _Growth:
    """Grown poses, and the number of views that measure each scout."""

    def __init__(
        self, targets: RayTargets, evaluator: ViewEvaluator, within: Frustum, count: Ints, multiplicity: int
    ) -> None:
        self.targets, self.evaluator, self.within = targets, evaluator, within
        self.count, self.multiplicity = count, multiplicity
        self.known = NO_POSES

    def execute(self, stage: SearchStage) -> float:
        """Go over the open scouts once; return the share of all scouts that was gained."""
        before = np.count_nonzero(self.count)
        known, scanner = self.known, self.evaluator.scanner
        for rows in self._batches(stage):
            if stage.transfer:
                aimed = transfer_poses(self.targets, rows, stage.elements, known, _NEIGHBOURS, scanner)
            else:
                aimed = draw_poses(self.targets, rows, stage.elements, self.within, scanner)
            self._add(self.evaluator.measuring(aimed, self.targets))
        return (np.count_nonzero(self.count) - before) / len(self.count)

    def _batches(self, stage: SearchStage) -> Iterator[Ints]:
        """Yield open scouts, spread over the surface, a few at a time, without those that were measured meanwhile."""
        per_point = (stage.elements[1] - stage.elements[0]) * (_NEIGHBOURS if stage.transfer else 1)
        rows = np.flatnonzero(self.count == 0)
        rows = _spread(rows)[: max(1, stage.budget // per_point)]
        size = max(1, _TOGETHER // per_point)
        while len(rows):
            yield rows[:size]
            rows = rows[size:]
            rows = rows[self.count[rows] == 0]

    def _add(self, aimed: AimedPoses) -> None:
        """Add the few poses that measure the largest part of the scouts with too few views."""
        order = np.argsort(aimed.row, kind="stable")
        rows_in_order = aimed.row[order]
        aimed = aimed.pick(
            np.sort(order[np.arange(len(rows_in_order)) - np.searchsorted(rows_in_order, rows_in_order) < _COMPARED])
        )
        if not len(aimed):
            return
        rows = np.flatnonzero(self.count < self.multiplicity)
        measured = self.evaluator.measured(self.evaluator.views(aimed), self.targets, rows)
        selection = _select_greedily(measured, self.multiplicity - self.count[rows])
        self.count[rows] += np.minimum(measured[:, selection].sum(axis=1), self.multiplicity - self.count[rows])
        self.known = AimedPoses.join([self.known, aimed.pick(selection)])


def _select_greedily(measured: Bools, demand: Ints) -> Ints:
    """Return views, ascending, that meet the demand (n,) of the rows where `measured` (n, V) allows it.

    The next view is the one that measures the most rows with unmet demand; ties go to the smaller index.
    """
    demand = np.minimum(demand, measured.sum(axis=1))
    useful = measured.astype(np.float32)  # sums of ones, exact below 2^24, by a fast product
    selection: list[int] = []
    while (demand > 0).any():
        best = int(((demand > 0).astype(np.float32) @ useful).argmax())
        selection.append(best)
        demand = demand - measured[:, best]
        useful[:, best] = 0.0
    return np.array(sorted(selection), dtype=np.int64)


def _spread(rows: Ints) -> Ints:
    """Return the rows in an order whose every beginning is spread over them: by the golden section of their places."""
    places = np.arange(len(rows)) * 0.6180339887498949 % 1.0
    return rows[np.argsort(places, kind="stable")]
