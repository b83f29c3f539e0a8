"""What would measure a point that stays open: single changes to a plan, each tried by computing it.

A `WhatIf` is one change: candidates that the arm reaches under it, the scanner's law and the casters under it. What
it measures is asked of the same conditions as the plan's coverage. `choose` takes the smallest change that gains nearly
as much as any; the candidates of changes that move the scanner are made by `backed_off`, `rolled` and `tilted_at`.
Object frame, metres, radians.
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

NEARLY = 0.9
"""Share of the largest gain from which on a change counts as gaining as much: then the smaller change is preferred."""

MANY = 10
"""Views that are named together at most."""

WORTH = 0.01
"""Share of the points below which a change does not count as helping them."""


class Kind(IntEnum):
    """Kinds of change, the cheapest first: of the plan, of the set-up, of the scanner's limits, of the scanner."""

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
class WhatIf(Value):
    """One change to a plan.

    Attributes:
        kind: of the change.
        change: its size; comparable within one kind.
        sentence: what would be different ("standoff 260 mm instead of 300").
        setting: how to ask for it ("--standoff 300,260"); "" where no setting does.
        T_object_scanner: (n, K, 4, 4) candidates that the arm reaches under the change [m].
        scanner: the sensor's law under the change.
        casters: the part's and those of occluders under the change, object frame.
    """

    kind: Kind
    change: float
    sentence: str
    setting: str
    T_object_scanner: Annotated[Floats, "n K 4 4"]
    scanner: Scanner
    casters: tuple[RayCaster, ...]

    def measures(self, targets: RayTargets, rows: Ints) -> Bools:
        """(n,) which of the rows at least one candidate measures under the change."""
        found = np.zeros(len(targets), dtype=np.bool_)
        still = rows
        poses = flatten_poses(self.T_object_scanner)

        def rows_of(pose: int) -> Ints:
            return in_view(targets, poses[pose], self.scanner, still)

        for _, _, row in visible_pairs(poses, targets, self.scanner, self.casters, rows_of, BUNDLE // 8):
            found[row] = True
            still = still[~found[still]]
        return found[rows]


def measured_pairs(
    targets: RayTargets, rows: Ints, T_object_scanner: Floats, scanner: Scanner, casters: Sequence[RayCaster]
) -> Ints:
    """(p, 2) row (index into the `rows` asked about) and view of the (m, K, 4, 4) that measures it, each pair once."""
    poses = flatten_poses(T_object_scanner)
    place = np.zeros(len(targets), dtype=np.int64)
    place[rows] = np.arange(len(rows))

    def rows_of(pose: int) -> Ints:
        return in_view(targets, poses[pose], scanner, rows)

    found = [
        np.stack([place[row], pose // T_object_scanner.shape[1]], axis=1)
        for _, pose, row in visible_pairs(poses, targets, scanner, casters, rows_of, BUNDLE)
    ]
    return np.unique(np.concatenate([*found, np.empty((0, 2), np.int64)]), axis=0)


def choose(gains: Floats, kinds: Sequence[Kind], changes: Sequence[float], *, most: int = 3) -> list[int]:
    """The changes to name, the smallest that gains nearly as much as any first, then others of other kinds.

    Args:
        gains: (W,) share of the points that each change measures, 0 to 1.
        kinds: of the changes.
        changes: their sizes.
        most: how many to name, each of another kind.

    Returns:
        Ints of changes; none where no change is `WORTH` naming.
    """
    named: list[int] = []
    left = [i for i in range(len(gains)) if gains[i] >= WORTH]
    while left and len(named) < most:
        enough = NEARLY * max(gains[i] for i in left)
        best = min((i for i in left if gains[i] >= enough), key=lambda i: (kinds[i], changes[i], -gains[i], i))
        named.append(best)
        left = [i for i in left if kinds[i] is not kinds[best]]
    return named


def few_views(pairs: Ints, rows: int) -> list[int]:
    """At most `MANY` views that together measure nearly all of the rows that can be, greedily, the most useful first.

    Args:
        pairs: (p, 2) row and view that measures it.
        rows: how many rows there are.
    """
    chosen: list[int] = []
    left = pairs
    open_rows = total = len(np.unique(pairs[:, 0]))
    while len(left) and len(chosen) < MANY and open_rows > (1 - NEARLY) * min(total, rows):
        counts = np.bincount(left[:, 1])
        view = int(counts.argmax())
        chosen.append(view)
        done = left[left[:, 1] == view, 0]
        left = left[~np.isin(left[:, 0], done)]
        open_rows -= len(done)
    return chosen


def backed_off(viewpoints: Viewpoints, standoff: float) -> Viewpoints:
    """The same views at another standoff [m]: each is moved along the viewing direction of its middle."""
    T = np.array(viewpoints.T_object_scanner)
    back = viewpoints.standoff - standoff
    T[..., :3, 3] += (back[:, None] * middle(T)[:, :3, 2])[:, None]
    return Viewpoints(T, viewpoints.face, np.full(len(T), standoff), viewpoints.roll)


def rolled(viewpoints: Viewpoints, roll: float) -> Viewpoints:
    """The same views at another roll [rad]: each is turned about the viewing axis of its middle."""
    T = viewpoints.T_object_scanner
    between = middle(T)
    by = roll - viewpoints.roll
    turn = np.zeros((len(T), 4, 4))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(by)
    turn[:, 1, 0] = np.sin(by)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = turn[:, 3, 3] = 1.0
    move = between @ turn @ np.linalg.inv(between)
    return Viewpoints(move[:, None] @ T, viewpoints.face, viewpoints.standoff, np.full(len(T), roll))


def middle(T_object_scanner: Floats) -> Floats:
    """(V, 4, 4) the pose halfway between the first and the last of each view's K poses, about which a sweep is made."""
    first, last = T_object_scanner[:, 0], T_object_scanner[:, -1]
    between = (first + last) / 2
    if T_object_scanner.shape[1] > 1:  # the rotation nearest to the mean of two is the one halfway between them
        u, _, v = np.linalg.svd(between[:, :3, :3])
        between[:, :3, :3] = u @ v
    return between


def tilted_at(
    points: Floats, normals: Floats, tilt: float, azimuths: int, standoff: float, rolls: Sequence[float],
    sweep: Floats | None = None,
) -> Viewpoints:  # fmt: skip
    """New views aimed at points, their viewing direction tilted from the normal by one angle to several sides.

    Args:
        points: (n, 3) [m], object frame.
        normals: (n, 3) outward unit normals.
        tilt: angle between the direction to the scanner and the normal [rad].
        azimuths: number of sides; one where the tilt is 0.
        standoff: [m].
        rolls: [rad].
        sweep: (K, 4, 4) poses of a sweep in the frame of its middle; None for K = 1.
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
    made = aim_viewpoints(np.repeat(points, sides, axis=0), outward, np.full(len(outward), -1), [standoff], rolls)
    if sweep is None or len(sweep) == 1:
        return made
    return Viewpoints(made.T_object_scanner @ sweep, made.face, made.standoff, made.roll)
