"""Candidates grown where something is open: few poses that together measure what any pose measures that is reached.

A generator that looks along normals leaves open what the arm cannot take up, what lies in niches, and what only another
distance or turn sees. `grow` is given points of the surface (scouts: neither the rows of the matrix nor the points on
which coverage is judged) and which of them the candidates there are measure. It then goes through `SCHEDULE`: each
stage asks for poses of open points, drawn from the lattice of `pose_sampling` or carried over from
neighbours that have some, keeps those that see their point and are taken up, and of these the few that measure the
largest area of what is open, each point up to `DEPTH` times where it can be, so that the selection has a choice.

The work is bounded: a stage asks about a spread of the open points whose poses are at most its budget. What stays open
then is a search that failed, not a proof. Object frame, metres.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planner.ports import Progress, RayCaster, Scanner
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets, in_view_matrix, lines_of_sight_free
from planner.viewpoints.pose_sampling import (
    AimedPoses,
    Frustum,
    draw_poses,
    find_frustum,
    poses_with_free_sight,
    transfer_poses,
)

N_SCOUTS = 20_000
"""Points of the surface that candidates are grown for; docs/internals/candidates.md charts coverable area over them."""

MULTIPLICITY = 3
"""Grown candidates that measure a point which none did before, where there are so many."""

_LOOKS = 4  # poses of a point that are compared by what else they measure
_TOGETHER = 8192  # poses that are asked for at a time: what one finds, the next need not look for
_PAIRS = 100_000  # of a pose and a point that are looked at in one go
_NEIGHBOURS = 4
_GAIN = 2e-4  # of the surface, below which a stage of carried poses is not repeated


@dataclass(frozen=True, slots=True)
class SearchStage:
    """One round over the open points.

    Attributes:
        stretch: of the lattice, for each point (and neighbour).
        carry: whether poses are carried over from neighbours; otherwise they are drawn.
        budget: poses that are asked for at most.
    """

    stretch: tuple[int, int]
    carry: bool
    budget: int


SCHEDULE = (
    SearchStage((0, 32), carry=False, budget=200_000),
    *(SearchStage((8 * k, 8 * k + 8), carry=True, budget=100_000) for k in range(3)),
    SearchStage((32, 128), carry=False, budget=100_000),
    *(SearchStage((8 * k, 8 * k + 8), carry=True, budget=100_000) for k in range(3, 6)),
    SearchStage((128, 512), carry=False, budget=100_000),
    *(SearchStage((8 * k, 8 * k + 8), carry=True, budget=100_000) for k in range(6, 9)),
)


@dataclass(frozen=True, slots=True, eq=False)
class ViewEvaluator:
    """Who measures, past what, and where the arm gets to.

    Attributes:
        scanner: the sensor's law.
        casters: the part's and those of occluders.
        takes_up: (n, K, 4, 4) T_object_scanner [m] -> (n,) whether the arm takes up all K poses without collision.
        T_view_scanner: (K, 4, 4) poses of a view about its viewpoint [m]; one, the identity, for a scanner at rest.
    """

    scanner: Scanner
    casters: Sequence[RayCaster]
    are_reachable: Callable[[Floats], Bools]
    T_view_scanner: Floats

    def views(self, aimed: AimedPoses) -> Floats:
        """(n, 4, 4) viewpoints whose middle pose is the aimed one [m]."""
        return np.asarray(aimed.T_object_scanner @ np.linalg.inv(self.T_view_scanner[len(self.T_view_scanner) // 2]))

    def measuring(self, aimed: AimedPoses, targets: RayTargets) -> AimedPoses:
        """Those of the poses that measure their point and whose view the arm takes up."""
        aimed = poses_with_free_sight(aimed, targets, self.scanner, self.casters)
        return aimed.pick(self.are_reachable(self.views(aimed)[:, None] @ self.T_view_scanner))

    def measured(
        self, views: Floats, targets: RayTargets, rows: Ints, worth: tuple[Floats, float] | None = None
    ) -> Bools:
        """Which of the rows each viewpoint measures.

        Args:
            views: (n, 4, 4) [m].
            targets: S surface points.
            rows: (m,) of them that are asked about.
            worth: of each of the rows (m,), and what a view has to measure more than to be of interest: where what it
                has in view comes to no more, no legs are cast and nothing counts as measured.

        Returns:
            (m, n) bool.
        """
        K = len(self.T_view_scanner)
        poses = (views[:, None] @ self.T_view_scanner).reshape(-1, 4, 4)
        found = np.zeros((len(rows), len(views)), dtype=np.bool_)
        together = max(1, _PAIRS // max(len(rows), 1)) * K
        for first in range(0, len(poses), together):
            some = poses[first : first + together]
            sighted = in_view_matrix(targets, some, self.scanner, rows)
            if worth is not None:
                bound = (sighted @ worth[0]).reshape(-1, K).sum(axis=1)
                sighted[np.repeat(bound <= worth[1], K)] = False
            pose, row = np.nonzero(sighted)
            free = lines_of_sight_free(targets, some, pose, rows[row], self.scanner, self.casters)
            found[row[free], (first + pose[free]) // K] = True
        return found


def grow(
    targets: RayTargets,
    seen: Bools,
    arm: ViewEvaluator,
    *,
    schedule: Sequence[SearchStage] = SCHEDULE,
    depth: int = MULTIPLICITY,
    progress: Progress | None = None,
) -> AimedPoses:
    """Viewpoints for what is open.

    Args:
        targets: S scouts, of equal area.
        seen: (S,) which of them some candidate measures already.
        arm: the scanner and what it can take up.
        schedule: of the search.
        depth: grown candidates that a point gets where it can.
        progress: called with (stages done, stages).

    Returns:
        The viewpoints, each with the scout that it is aimed at.
    """
    garden = _Garden(targets, arm, find_frustum(arm.scanner), np.where(seen, depth, 0), depth)
    last = 1.0
    for number, stage in enumerate(schedule):
        if not stage.carry:
            last = 1.0
        if last >= _GAIN and garden.can(stage):
            last = garden.round(stage)
        if progress:
            progress(number + 1, len(schedule))
    return AimedPoses(arm.views(garden.known), garden.known.row)


class _Garden:
    """What has been grown so far, and how often each scout is measured."""

    def __init__(self, targets: RayTargets, arm: ViewEvaluator, within: Frustum, count: Ints, depth: int) -> None:
        self.targets, self.arm, self.within, self.count, self.depth = targets, arm, within, count, depth
        self.known = AimedPoses(np.empty((0, 4, 4)), np.empty(0, dtype=np.int64))

    def can(self, stage: SearchStage) -> bool:
        """Whether there is anything to carry over."""
        return len(self.known) > 0 or not stage.carry

    def round(self, stage: SearchStage) -> float:
        """Go over the open scouts once; returns the share of all scouts that was gained."""
        before = np.count_nonzero(self.count)
        known = self.known
        for rows in self._batches(stage):
            if stage.carry:
                aimed = transfer_poses(self.targets, rows, stage.stretch, known, _NEIGHBOURS, self.arm.scanner)
            else:
                aimed = draw_poses(self.targets, rows, stage.stretch, self.within, self.arm.scanner)
            self._add(self.arm.measuring(aimed, self.targets))
        return (np.count_nonzero(self.count) - before) / len(self.count)

    def _batches(self, stage: SearchStage) -> Iterator[Ints]:
        """Open scouts, spread over the surface, a few at a time; those that were measured meanwhile are left out."""
        each = (stage.stretch[1] - stage.stretch[0]) * (_NEIGHBOURS if stage.carry else 1)
        rows = np.flatnonzero(self.count == 0)
        rows = _spread(rows)[: max(1, stage.budget // each)]
        size = max(1, _TOGETHER // each)
        while len(rows):
            yield rows[:size]
            rows = rows[size:]
            rows = rows[self.count[rows] == 0]

    def _add(self, aimed: AimedPoses) -> None:
        """Keep the few of the poses that measure the most of what wants views."""
        order = np.argsort(aimed.row, kind="stable")
        own = aimed.row[order]
        aimed = aimed.pick(np.sort(order[np.arange(len(own)) - np.searchsorted(own, own) < _LOOKS]))
        if not len(aimed):
            return
        rows = np.flatnonzero(self.count < self.depth)
        measured = self.arm.measured(self.arm.views(aimed), self.targets, rows)
        taken = _most_useful(measured, self.depth - self.count[rows])
        self.count[rows] += np.minimum(measured[:, taken].sum(axis=1), self.depth - self.count[rows])
        chosen = aimed.pick(taken)
        self.known = AimedPoses(
            np.concatenate([self.known.T_object_scanner, chosen.T_object_scanner]),
            np.concatenate([self.known.row, chosen.row]),
        )


def _most_useful(measured: Bools, wants: Ints) -> Ints:
    """Few views that give each row as many as it wants, where so many measure it; the most useful first, ascending.

    Greedy: the view that measures the most rows that still want one; ties go to the smaller index.

    Args:
        measured: (n, V) what each view measures.
        wants: (n,) views that each row wants.
    """
    wants = np.minimum(wants, measured.sum(axis=1))
    useful = measured.astype(np.float32)  # sums of ones, exact below 2^24, by a fast product
    taken: list[int] = []
    while (wants > 0).any():
        best = int(((wants > 0).astype(np.float32) @ useful).argmax())
        taken.append(best)
        wants = wants - measured[:, best]
        useful[:, best] = 0.0
    return np.array(sorted(taken), dtype=np.int64)


def _spread(rows: Ints) -> Ints:
    """The rows in an order whose every beginning is spread over them: by the golden section of their places."""
    places = np.arange(len(rows)) * 0.6180339887498949 % 1.0
    return rows[np.argsort(places, kind="stable")]
