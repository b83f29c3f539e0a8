"""Whether two bodies of an arm keep apart at all angles of the axes between them: proven by branch and bound.

Between the two stand the joints J_1 .. J_n, the first carried by body A, the last carrying body B. From the middle of a
box of angles to anywhere in it joint i turns by at most h_i, and every point beyond it moves by at most h_i times its
distance from the axis. Any of the bodies between may be looked at as the one that stands: where it is the one behind
joint s, A's points move by the joints up to s, B's by those after it, so that the distance of the two changes by at
most

    sum over i <= s of h_i R_Ai + sum over i > s of h_i R_Bi,

for every s. R_Ai is the largest distance of a point of A from axis i at any angles: for the joint that A carries that
of its points; for another what is between the anchors and from the last to the farthest point. A box whose middle is
farther apart than this and what is asked for is settled; another is halved, the one that may come nearest first.
Metres, radians.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from cell.robot.model import AXES, Followers
from cell.world.gap import Shapes, mesh_of
from cell.world.travel import enclosing_points
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

LOOKS = 200_000
"""Configurations looked at before a pair is said not to be proven apart."""

MOST_AXES = 3
"""Axes between two bodies above which a proof is not tried: the boxes that it needs grow with their power."""


def keeps_apart(
    model: mujoco.MjModel, shapes: Shapes, one: int, other: int, least: float, most_looks: int = LOOKS
) -> bool:
    """Whether two bodies are proven to be at least so far apart at all angles of the axes between them.

    Args:
        model: the arm, alone or in its cell.
        shapes: who measures.
        one: a body.
        other: another.
        least: distance [m], above 0.
        most_looks: after so many configurations it is not proven.
    """
    import mujoco

    axes, moved = ways(model, one, other)
    if len(axes) > MOST_AXES or not len(axes):
        return False
    low, high = _ranges(model, axes)
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in (one, other)]
    pairs = [(a, b) for a in geoms[0] for b in geoms[1]]
    data, followers, q = mujoco.MjData(model), Followers.of(model), np.zeros(len(AXES))
    boxes = [(0.0, 0, (low + high) / 2, (high - low) / 2)]
    for look in range(most_looks):
        if not boxes:
            return True
        _, _, middle, half = heapq.heappop(boxes)
        moves = moved @ half
        way = int(np.argmin(moves))
        q[axes] = middle
        data.qpos[:] = followers.qpos(q)
        mujoco.mj_kinematics(model, data)
        distance = reach = least + float(moves[way])
        for a, b in pairs:
            distance = min(distance, shapes.distance(data, a, b, distance))
        if distance < least:
            return False
        if distance < reach:
            along = int(np.argmax(moved[way] * half))
            half = np.where(np.arange(len(half)) == along, half / 2, half)
            for sign in (-1, 1):
                centre = middle.copy()
                centre[along] += sign * half[along]
                heapq.heappush(boxes, (distance - reach, 2 * look + (sign > 0), centre, half))
    return not boxes


def _ranges(model: mujoco.MjModel, axes: list[int]) -> tuple[Floats, Floats]:
    """Lowest and highest angles (k,) that have to be looked at [rad]: of a range of more than a turn one turn."""
    low, high = np.array([model.joint(AXES[axis]).range for axis in axes]).T.copy()
    followers = Followers.of(model)
    for k, axis in enumerate(axes):
        if all(float(ratio).is_integer() for ratio in followers.ratio[followers.axis == axis]):
            high[k] = min(high[k], low[k] + 2 * np.pi)
    return low, high


def ways(model: mujoco.MjModel, one: int, other: int) -> tuple[list[int], Floats]:
    """The axes between two bodies, and (n + 1, k) how far one moves against the other for each of them [m/rad].

    A row for each body between the two that may be looked at as the one that stands.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    joints = _joints_between(model, one, other)
    if not joints:
        return [], np.zeros((1, 0))
    anchors, lines = data.xanchor[joints], data.xaxis[joints]
    by_other = _farthest(anchors, lines, _points(model, data, other))
    by_one = _farthest(anchors[::-1], lines[::-1], _points(model, data, one))[::-1]
    followers, count = Followers.of(model), len(joints)
    driven = [
        (j, 1.0) if j < len(AXES) else (int(followers.axis[j - 6]), float(followers.ratio[j - 6])) for j in joints
    ]
    axes = sorted({axis for axis, _ in driven})
    moved = np.zeros((count + 1, len(axes)))
    for number, (axis, ratio) in enumerate(driven):
        stands_behind = np.arange(count + 1) > number
        moved[:, axes.index(axis)] += abs(ratio) * np.where(stands_behind, by_one[number], by_other[number])
    return axes, moved


def _joints_between(model: mujoco.MjModel, one: int, other: int) -> list[int]:
    """Joints from the first body to the second, in order."""
    up, down = (_joints_above(model, body) for body in (one, other))
    while up and down and up[-1] == down[-1]:
        up.pop()
        down.pop()
    return up + down[::-1]


def _joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints between a body and the world, nearest first."""
    found: list[int] = []
    while body > 0:
        at = int(model.body_jntadr[body])
        found += range(at, at + int(model.body_jntnum[body])) if at >= 0 else ()
        body = int(model.body_parentid[body])
    return found


def _farthest(anchors: Floats, lines: Floats, points: tuple[Floats, Floats]) -> Floats:
    """(n,) largest distance from each axis of points behind the last of them, at any angles [m].

    Args:
        anchors: (n, 3) of the joints [m].
        lines: (n, 3) their axes.
        points: (P, 3) and how much is about each (P,) [m].
    """
    offset, radius = points[0] - anchors[-1], points[1]
    beyond = float((np.linalg.norm(offset, axis=1) + radius).max())
    found = np.empty(len(anchors))
    found[-1] = (np.linalg.norm(np.cross(offset, lines[-1]), axis=1) + radius).max()
    for i in range(len(anchors) - 2, -1, -1):
        step = anchors[i + 1] - anchors[i]
        found[i] = np.linalg.norm(np.cross(step, lines[i])) + beyond
        beyond += float(np.linalg.norm(step))
    return found


def _points(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[Floats, Floats]:
    """(P, 3) points of a body where it stands, and how much is about each (P,) [m]."""
    import mujoco

    points, radii = [], []
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        at, radius = enclosing_points(model, data, geom)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            at = data.xpos[body] + mesh_of(model, geom).vertices @ data.xmat[body].reshape(3, 3).T
        points.append(at)
        radii.append(np.full(len(at), radius))
    return np.concatenate(points), np.concatenate(radii)
