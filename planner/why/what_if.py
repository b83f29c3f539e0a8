"""Changes of a plan that would measure an uncovered point; the effect of each is computed.

A `PlanChange` holds the candidates that the arm reaches under it, and the scanner's law and the ray casters under it.
Its measured points are subject to the same conditions as the plan's coverage. `select_changes` selects the smallest
change that gains nearly as much as any other. `with_standoff`, `with_roll` and `tilted_viewpoints` generate the
candidates of changes that move the scanner. Object frame, metres, radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated

import numpy as np

from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats, Ints, Value
from planner.viewpoints.lines_of_sight import BUNDLE, RayTargets, flatten_poses, in_view, visible_pairs
from planner.viewpoints.viewpoints import Viewpoints, aim_viewpoints

SUFFICIENT_SHARE = 0.9
"""Share of the largest gain from which a change counts as equal: then the smaller change is preferred."""

MAX_VIEWS = 10
"""Largest number of views that are named together."""

MIN_GAIN = 0.01
"""Share of the points from which a change counts as useful."""


class ChangeKind(IntEnum):
    """Kinds of change, the cheapest first: plan, set-up, limits of the scanner, scanner."""

    VIEW = 0
    ROLL = 1
    STANDOFF = 2
    AIMED = 3
    TURN = 4
    FIXTURE = 5
    GRAZING = 6
    RANGE = 7
    SPACING = 8
    SIGMA = 9
    RESOLUTION = 10
    FOV = 11
    BASELINE = 12


@dataclass(frozen=True, slots=True, eq=False)
class PlanChange(Value):
    """One change to a plan.

    Attributes:
        kind: its kind.
        change: its size; comparable within one kind.
        sentence: description ("standoff 260 mm instead of 300").
        setting: option of the plan that applies it ("--standoff 300,260"), or a command with RUN for the run folder; ""
            if there is none.
        T_object_scanner: (n, K, 4, 4) candidates that the arm reaches under the change [m].
        scanner: the sensor's law under the change.
        casters: casters of part and occluders under the change, object frame.
    """

    kind: ChangeKind
    change: float
    sentence: str
    setting: str
    T_object_scanner: Annotated[Floats, "n K 4 4"]
    scanner: Scanner
    casters: tuple[RayCaster, ...]

    def measures(self, targets: RayTargets, rows: Ints) -> Bools:
        """Return (n,) whether at least one candidate measures each row under the change."""
        measured = np.zeros(len(targets), dtype=np.bool_)
        remaining = rows
        poses = flatten_poses(self.T_object_scanner)

        def rows_of(pose: int) -> Ints:
            return in_view(targets, poses[pose], self.scanner, remaining)

        for _, _, row in visible_pairs(poses, targets, self.scanner, self.casters, rows_of, BUNDLE // 8):
            measured[row] = True
            remaining = remaining[~measured[remaining]]
        return measured[rows]


def measured_pairs(
    targets: RayTargets, rows: Ints, T_object_scanner: Floats, scanner: Scanner, casters: Sequence[RayCaster]
) -> Ints:
    """Return (p, 2) pairs of an index into `rows` and a view of the (m, K, 4, 4) that measures this row, each once."""
    poses = flatten_poses(T_object_scanner)
    index = np.zeros(len(targets), dtype=np.int64)
    index[rows] = np.arange(len(rows))

    def rows_of(pose: int) -> Ints:
        return in_view(targets, poses[pose], scanner, rows)

    pairs = [
        np.stack([index[row], pose // T_object_scanner.shape[1]], axis=1)
        for _, pose, row in visible_pairs(poses, targets, scanner, casters, rows_of, BUNDLE)
    ]
    return np.unique(np.concatenate([*pairs, np.empty((0, 2), np.int64)]), axis=0)


def select_changes(gains: Floats, kinds: Sequence[ChangeKind], changes: Sequence[float], *, most: int = 3) -> list[int]:
    """Select the smallest change that gains nearly as much as any other, then others of other kinds.

    Args:
        gains: (W,) share of the points that each change measures, 0 to 1.
        kinds: of the changes.
        changes: their sizes.
        most: largest number of selected changes, each of another kind.

    Returns:
        Indices of changes; none if no gain reaches `MIN_GAIN`.
    """
    selected: list[int] = []
    left = [i for i in range(len(gains)) if gains[i] >= MIN_GAIN]
    while left and len(selected) < most:
        sufficient = SUFFICIENT_SHARE * max(gains[i] for i in left)
        best = min((i for i in left if gains[i] >= sufficient), key=lambda i: (kinds[i], changes[i], -gains[i], i))
        selected.append(best)
        left = [i for i in left if kinds[i] is not kinds[best]]
    return selected


def select_views(pairs: Ints, rows: int) -> list[int]:
    """Select greedily at most `MAX_VIEWS` views that together measure nearly all measurable rows.

    Args:
        pairs: (p, 2) row and view that measures it.
        rows: number of rows.
    """
    selected: list[int] = []
    left = pairs
    uncovered = total = len(np.unique(pairs[:, 0]))
    while len(left) and len(selected) < MAX_VIEWS and uncovered > (1 - SUFFICIENT_SHARE) * min(total, rows):
        counts = np.bincount(left[:, 1])
        view = int(counts.argmax())
        selected.append(view)
        covered = left[left[:, 1] == view, 0]
        left = left[~np.isin(left[:, 0], covered)]
        uncovered -= len(covered)
    return selected


def with_standoff(viewpoints: Viewpoints, standoff: float) -> Viewpoints:
    """Return the views at another standoff [m], moved along the viewing direction of their middle poses."""
    T = np.array(viewpoints.T_object_scanner)
    back = viewpoints.standoff - standoff
    T[..., :3, 3] += (back[:, None] * middle_poses(T)[:, :3, 2])[:, None]
    return Viewpoints(T, viewpoints.face, np.full(len(T), standoff), viewpoints.roll)


def with_roll(viewpoints: Viewpoints, roll: float) -> Viewpoints:
    """Return the views at another roll [rad], rotated about the viewing axis of their middle poses."""
    T = viewpoints.T_object_scanner
    between = middle_poses(T)
    by = roll - viewpoints.roll
    turn = np.zeros((len(T), 4, 4))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(by)
    turn[:, 1, 0] = np.sin(by)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0
    move = between @ turn @ np.linalg.inv(between)
    return Viewpoints(move[:, None] @ T, viewpoints.face, viewpoints.standoff, np.full(len(T), roll))


def middle_poses(T_object_scanner: Floats) -> Floats:
    """Return the (V, 4, 4) pose halfway between first and last of each view's K poses, the centre of a sweep."""
    first, last = T_object_scanner[:, 0], T_object_scanner[:, -1]
    between = (first + last) / 2
    if T_object_scanner.shape[1] > 1:  # the rotation nearest to the mean of two is halfway between them
        u, _, v = np.linalg.svd(between[:, :3, :3])
        between[:, :3, :3] = u @ v
    return between


def tilted_viewpoints(
    points: Floats,
    normals: Floats,
    tilt: float,
    azimuths: int,
    standoff: float,
    rolls: Sequence[float],
    sweep: Floats | None = None,
) -> Viewpoints:
    """Return new views aimed at points, with directions tilted from the normal by one angle to several sides.

    Args:
        points: (n, 3) [m], object frame.
        normals: (n, 3) outward unit normals.
        tilt: angle between the direction to the scanner and the normal [rad].
        azimuths: number of sides; one if the tilt is 0.
        standoff: [m].
        rolls: [rad].
        sweep: (K, 4, 4) poses of a sweep in the frame of its middle pose; None for K = 1.
    """
    sides = 1 if tilt == 0 else azimuths
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    turn = np.arange(sides) * (2 * np.pi / sides)
    aside = np.cos(turn)[None, :, None] * first[:, None] + np.sin(turn)[None, :, None] * second[:, None]
    outward = (np.cos(tilt) * normals[:, None] + np.sin(tilt) * aside).reshape(-1, 3)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    viewpoints = aim_viewpoints(np.repeat(points, sides, axis=0), outward, np.full(len(outward), -1), [standoff], rolls)
    if sweep is None or len(sweep) == 1:
        return viewpoints
    return Viewpoints(viewpoints.T_object_scanner @ sweep, viewpoints.face, viewpoints.standoff, viewpoints.roll)
