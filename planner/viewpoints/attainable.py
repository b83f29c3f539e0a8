"""Estimate the attainable share of the surface, over all poses that the arm takes up.

A pose is searched for each of a few surface points (`pose_sampling`): with a range of the sequence, then with poses
transferred from points that have one, then with a longer range. A point without a pose is not proven unattainable: the
share is a lower estimate, which more draws may raise.

A point without a pose has one of two reasons: no tried pose sees it past part and occluders, or some do and the arm
reaches none of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.values import Bools, Ints, Value
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import (
    NO_POSES,
    AimedPoses,
    draw_poses,
    find_frustum,
    poses_with_free_sight,
    transfer_poses,
)

N_PROBED_SAMPLES = 1000
"""Largest number of points: a second of processor time at worst."""

_RANGES = ((0, 32), (32, 96), (96, 256))  # of the sequence
_TRANSFERRED, _NEIGHBOURS = 8, 4
_TOGETHER = 32_768  # poses that are tried at a time
_SHARED = 32  # found poses that are tested on all open points


@dataclass(frozen=True, slots=True, eq=False)
class Attainable(Value):
    """Result of the search for n points.

    Attributes:
        measured: (n,) whether a pose measures it that the arm takes up.
        visible: (n,) whether a pose sees it past part and occluders, reachable or not.
    """

    measured: Annotated[Bools, "n"]
    visible: Annotated[Bools, "n"]


def probe_attainable(targets: RayTargets, evaluator: ViewEvaluator) -> Attainable:
    """Search a pose for each of n points."""
    scanner = evaluator.scanner
    within = find_frustum(scanner)
    measured, visible = np.zeros(len(targets), dtype=np.bool_), np.zeros(len(targets), dtype=np.bool_)
    known = NO_POSES
    for number, drawn_range in enumerate(_RANGES):
        for transfer in (False, True):
            elements = (number * _TRANSFERRED, (number + 1) * _TRANSFERRED) if transfer else drawn_range
            per_point = (elements[1] - elements[0]) * (_NEIGHBOURS if transfer else 1)
            for rows in _batches(measured, max(1, _TOGETHER // per_point)):
                if not transfer:
                    aimed = draw_poses(targets, rows, elements, within, scanner)
                elif len(known):
                    aimed = transfer_poses(targets, rows, elements, known, _NEIGHBOURS, scanner)
                else:
                    continue
                poses = poses_with_free_sight(aimed, targets, scanner, evaluator.casters)
                visible[poses.row] = True
                poses = _first_reachable(poses, evaluator)
                measured[poses.row] = True
                known = AimedPoses.join([known, poses])
                still_open = np.flatnonzero(~measured)
                few = evaluator.views(poses.pick(np.arange(min(len(poses), _SHARED))))
                measured[still_open] = evaluator.measured(few, targets, still_open).any(axis=1)
    return Attainable(measured, visible | measured)


def _first_reachable(aimed: AimedPoses, evaluator: ViewEvaluator) -> AimedPoses:
    """Return the first reachable pose of each point; later poses of the point are not tested."""
    order = np.argsort(aimed.row, kind="stable")
    rows = []
    while len(order):
        points, first = np.unique(aimed.row[order], return_index=True)
        tested = order[first]
        reachable = evaluator.are_reachable(evaluator.views(aimed.pick(tested))[:, None] @ evaluator.T_view_scanner)
        rows.append(tested[reachable])
        order = np.delete(order, first)
        order = order[~np.isin(aimed.row[order], points[reachable])]
    which = np.concatenate([*rows, np.empty(0, dtype=np.int64)])
    return aimed.pick(which[np.argsort(aimed.row[which])])


def _batches(measured: Bools, size: int) -> Iterator[Ints]:
    """Yield open points, a few at a time, without those that were measured meanwhile."""
    rows = np.flatnonzero(~measured)
    while len(rows):
        yield rows[:size]
        rows = rows[size:]
        rows = rows[~measured[rows]]
