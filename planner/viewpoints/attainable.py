"""What any pose of all measures that the arm takes up, asked of a few surface points: the bound on every plan.

Each point is searched for by itself (`pose_sampling`): a stretch of the lattice, then poses carried over
from points that have one, then a longer stretch. A point that is not found is not proven out of reach: the share that
is found is a lower estimate, and rises by 0.1 to 1 point with four times the draws (docs/internals/candidates.md).

What is not found has one of two reasons: no pose that was tried sees the point past part and occluders, or poses do and
the arm takes up none of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.values import Bools, Ints, Value
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import AimedPoses, draw_poses, find_frustum, poses_with_free_sight, transfer_poses

N_PROBED_SAMPLES = 1000
"""Points that are asked about at most: a second of processor time at worst."""

_STRETCHES = ((0, 32), (32, 96), (96, 256))
_CARRIED, _NEIGHBOURS = 8, 4
_TOGETHER = 32_768  # poses that are tried at a time
_SHARED = 32  # found poses that are asked about the other points


@dataclass(frozen=True, slots=True, eq=False)
class Attainable(Value):
    """What became of each point.

    Attributes:
        measured: (n,) a pose measures it that the arm takes up.
        sighted: (n,) a pose sees it past part and occluders, whether or not the arm takes it up.
    """

    measured: Annotated[Bools, "n"]
    visible: Annotated[Bools, "n"]


def probe_attainable(targets: RayTargets, arm: ViewEvaluator) -> Attainable:
    """Search a pose for each point.

    Args:
        targets: n points.
        arm: the scanner and what it can take up.
    """
    within = find_frustum(arm.scanner)
    measured, sighted = np.zeros(len(targets), dtype=np.bool_), np.zeros(len(targets), dtype=np.bool_)
    known = AimedPoses(np.empty((0, 4, 4)), np.empty(0, dtype=np.int64))
    for number, stretch in enumerate(_STRETCHES):
        for carry in (False, True):
            part = (number * _CARRIED, (number + 1) * _CARRIED) if carry else stretch
            each = (part[1] - part[0]) * (_NEIGHBOURS if carry else 1)
            for rows in _batches(measured, max(1, _TOGETHER // each)):
                if not carry:
                    aimed = draw_poses(targets, rows, part, within, arm.scanner)
                elif len(known):
                    aimed = transfer_poses(targets, rows, part, known, _NEIGHBOURS, arm.scanner)
                else:
                    continue
                found = poses_with_free_sight(aimed, targets, arm.scanner, arm.casters)
                sighted[found.row] = True
                found = _first_taken_up(found, arm)
                measured[found.row] = True
                known = AimedPoses(
                    np.concatenate([known.T_object_scanner, found.T_object_scanner]),
                    np.concatenate([known.row, found.row]),
                )
                still = np.flatnonzero(~measured)
                few = arm.views(found.pick(np.arange(min(len(found), _SHARED))))
                measured[still] = arm.measured(few, targets, still).any(axis=1)
    return Attainable(measured, sighted | measured)


def _first_taken_up(aimed: AimedPoses, arm: ViewEvaluator) -> AimedPoses:
    """The first pose of each point that the arm takes up; poses behind it are not asked about."""
    order = np.argsort(aimed.row, kind="stable")
    kept = []
    while len(order):
        own, first = np.unique(aimed.row[order], return_index=True)
        asked = order[first]
        taken = arm.are_reachable(arm.views(aimed.pick(asked))[:, None] @ arm.T_view_scanner)
        kept.append(asked[taken])
        order = np.delete(order, first)
        order = order[~np.isin(aimed.row[order], own[taken])]
    which = np.concatenate([*kept, np.empty(0, dtype=np.int64)])
    return aimed.pick(which[np.argsort(aimed.row[which])])


def _batches(measured: Bools, size: int) -> Iterator[Ints]:
    """Points that are open, a few at a time; those that were measured meanwhile are left out."""
    rows = np.flatnonzero(~measured)
    while len(rows):
        yield rows[:size]
        rows = rows[size:]
        rows = rows[~measured[rows]]
