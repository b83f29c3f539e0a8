"""Upper bound on the displacement of any point of arm and scanner along a straight joint segment.

On the segment q(t) = q_0 + t d, t in [0, 1], a point p of link k moves with a speed of at most

    sum over joints i <= k of |d_i| rho_i(p, t),        rho_i = distance of p from axis i,

because each joint turns p about its own axis. With R_ik >= rho_i(p, t) for all p of link k and all t, no point of
link k is displaced by more than sum_i |d_i| R_ik between any two configurations of the segment. Two bounds give R_ik:

1. *Segment.* Seen from the body that carries axis i, joint i leaves rho_i as it is and only the joints i < j <= k move
   p, so |rho_i(p, t) - rho_i(p, 0)| <= t D_ik and |rho_i(p, t) - rho_i(p, 1)| <= (1 - t) D_ik with
   D_ik = sum_{i<j<=k} |d_j| R_jk. The smaller of the two upper bounds is at most their mean:
   rho_i(p, t) <= (rho_i(p, 0) + rho_i(p, 1) + D_ik) / 2. The maximum over p of each term keeps it a bound. R_kk is
   constant; the others follow from i = k - 1 down to 1.
2. *Chain.* From axis i to the anchor of joint i + 1 (a constant distance), from anchor to anchor (constant lengths),
   and from anchor k to the farthest point of link k. It holds for all joint angles and caps the first on long segments.

The points of a link are the corners of its boxes and of the boxes about its meshes, and the end centres of its
cylinders with their radius added: the distance from an axis is convex, so it is largest there. The scanner belongs to
link 6.

A mimic joint is carried by a link and turns by `ratio` times the angle of its axis. Its body stays within a ball about
the joint's anchor, which the link carries: the ball's points move as bounded above, and the rotation adds at most
|ratio d_axis| times the ball's radius. Metres and radians.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cell.robot.model import AXES, MimicJoints
from cell.world.shapes import enclosing_points
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_N = len(AXES)
_ROUNDING = 1e-7  # m; the squared distances below cancel digits, which a root turns into at most 5e-8 m
_CHUNK = 512  # configurations a pass, so that its arrays stay in the processor's cache


class TravelBound:
    """The bound of one compiled cell: a function of (N, axes) and (N, axes) joint angles [rad] to (N,) lengths [m].

    Args:
        model: the cell.
        table_radius: radius about a rotary table's axis that contains everything it turns [m]; its travel is added.
    """

    def __init__(self, model: mujoco.MjModel, table_radius: float = 0.0) -> None:
        import mujoco

        self._table_radius = table_radius
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0  # a state of cell.xml begins at home
        mujoco.mj_kinematics(model, data)
        joints = [model.joint(axis).id for axis in AXES]
        self._anchors, self._axes = data.xanchor[joints].copy(), data.xaxis[joints].copy()
        bodies = [int(model.jnt_bodyid[joint]) for joint in joints]
        links: list[list[tuple[Floats, float]]] = [[] for _ in range(_N)]
        mimic_joints = MimicJoints.from_model(model)
        # For each body of a mimic joint: the link that carries it (None: the base), its axes, and ratio times radius.
        self._turning: list[tuple[int | None, list[tuple[int, float]]]] = []
        for geom in range(model.ngeom):
            body = int(model.geom_bodyid[geom])
            link = _link_of(model, body, bodies)
            if link is None and model.body_jntadr[model.body_weldid[body]] < 0:
                continue
            points, radius = enclosing_points(model, data, geom)
            turns: list[tuple[int, float]] = []
            while body not in bodies and body > 0:  # a body of a mimic joint, or fixed to one
                joint = int(model.body_jntadr[body])
                if joint >= _N:
                    anchor = data.xanchor[joint]
                    radius += float(np.linalg.norm(points - anchor, axis=1).max())
                    points = anchor[None].copy()
                    number = joint - _N
                    turns.append((int(mimic_joints.axis[number]), abs(float(mimic_joints.ratio[number])) * radius))
                body = int(model.body_parentid[body])
            if link is not None:
                links[link].append((points, radius))
            if turns:
                self._turning.append((link, turns))
        sizes = [sum(len(corners) for corners, _ in link) for link in links]
        self._starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        self._link_of = np.repeat(np.arange(_N), sizes)
        self._points = np.concatenate([corners for link in links for corners, _ in link])
        self._radii = np.concatenate([np.full(len(corners), radius) for link in links for corners, radius in link])
        # Product of exponentials: cross-product matrices of the axes at A1..A6 = 0.
        x, y, z = self._axes.T
        zero = np.zeros(_N)
        self._cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(_N, 3, 3)
        self._caps = self._chain_caps()

    def __call__(self, q_from: Floats, q_to: Floats) -> Floats:
        """Return the upper bound (N,) on the displacement of any point [m] between configurations (N, axes) [rad]."""
        external = self._table_radius * np.abs(q_to[:, _N:] - q_from[:, _N:]).sum(axis=1)
        q_from, q_to = q_from[:, :_N], q_to[:, :_N]
        pieces = [
            self._bound(q_from[start : start + _CHUNK], q_to[start : start + _CHUNK])
            for start in range(0, len(q_from), _CHUNK)
        ]
        return np.concatenate(pieces) + external if pieces else np.zeros(0)

    def displacement(self, q_from: Floats, q_to: Floats) -> Floats:
        """Return the largest displacement (N,) of a point of arm, tool or table [m] between (N, axes) angles [rad]."""
        placed = [
            np.einsum("npij,pj->npi", rotations[:, self._link_of], self._points) + shifts[:, self._link_of]
            for rotations, shifts in (self._link_transforms(q[:, :_N]) for q in (q_from, q_to))
        ]
        turned = self._table_radius * np.abs(q_to[:, _N:] - q_from[:, _N:]).sum(axis=1)
        moved: Floats = np.maximum(np.linalg.norm(placed[1] - placed[0], axis=2).max(axis=1), turned)
        return moved

    def reach(self, axes: int) -> Floats:
        """Return the largest distances (axes,) of any point of arm or tool from each axis, over all angles [m].

        The displacement of any point between two configurations is at most the sum of reach times angle. Behind A6
        they are the radius of a rotary table.
        """
        reach = self._caps.max(axis=1)
        for link, turns in self._turning:
            for axis, radius in turns:
                carried = 0.0 if link is None else self._caps[axis, link]
                reach[axis] = max(reach[axis], carried + sum(each for other, each in turns if other == axis), radius)
        return np.concatenate([reach, np.full(axes - _N, self._table_radius)])

    def _bound(self, q_from: Floats, q_to: Floats) -> Floats:
        count = len(q_from)
        steps = np.abs(q_to - q_from)
        radii = self._radii_about_axes(np.concatenate([q_from, q_to]))
        mean = (radii[:count] + radii[count:]) / 2
        moved = np.zeros((count, _N))  # of each link k, by the joints i + 1 .. k
        for i in range(_N - 1, -1, -1):
            bound = np.minimum(mean[:, i, i:] + moved[:, i:] / 2, self._caps[i, i:])
            moved[:, i:] += steps[:, i, None] * bound
        longest: Floats = moved.max(axis=1)
        for link, turns in self._turning:
            joint_travel = sum(radius * steps[:, axis] for axis, radius in turns)
            longest = np.maximum(longest, joint_travel if link is None else moved[:, link] + joint_travel)
        return longest

    def _radii_about_axes(self, q: Floats) -> Floats:
        """Return the largest distances (N, 6, 6) of a point of link k from axis i [m]; valid for i <= k."""
        rotations, shifts = self._link_transforms(q)
        placed = np.einsum("npij,pj->npi", rotations[:, self._link_of], self._points) + shifts[:, self._link_of]
        # The axis is carried by its own link, whose rotation leaves it in place.
        axes = np.einsum("nkij,kj->nki", rotations, self._axes)
        anchors = np.einsum("nkij,kj->nki", rotations, self._anchors) + shifts
        across = np.einsum("npj,npj->np", placed, placed)[:, None] - 2 * anchors @ np.swapaxes(placed, 1, 2)
        across += np.einsum("nij,nij->ni", anchors, anchors)[:, :, None]
        along = axes @ np.swapaxes(placed, 1, 2) - np.einsum("nij,nij->ni", axes, anchors)[:, :, None]
        distance = np.sqrt(np.maximum(across - along * along, 0.0)) + (self._radii + _ROUNDING)
        radii: Floats = np.maximum.reduceat(distance, self._starts, axis=2)
        return radii

    def _link_transforms(self, q: Floats) -> tuple[Floats, Floats]:
        """Return rotation (N, 6, 3, 3) and translation (N, 6, 3) [m] of each link relative to A1..A6 = 0."""
        sin, cos = np.sin(q)[..., None, None], np.cos(q)[..., None, None]
        turns = np.eye(3) + sin * self._cross + (1 - cos) * (self._cross @ self._cross)  # Rodrigues
        offsets = self._anchors - np.einsum("nkij,kj->nki", turns, self._anchors)
        rotations, shifts = turns.copy(), offsets.copy()
        for i in range(1, _N):
            rotations[:, i] = rotations[:, i - 1] @ turns[:, i]
            shifts[:, i] = shifts[:, i - 1] + (rotations[:, i - 1] @ offsets[:, i, :, None])[..., 0]
        return rotations, shifts

    def _chain_caps(self) -> Floats:
        """Return bound 2 (6, 6): largest distance of a point of link k from axis i over all joint angles [m].

        It is 0 for a link without shape, so that bound 1, which then has a point of the next link, does not matter.
        """
        caps = np.zeros((_N, _N))
        for k in range(_N):
            piece = self._link_of == k
            if piece.any():  # a link of an arm from a file may have no shape
                balls = self._points[piece], self._radii[piece]
                caps[: k + 1, k] = farthest(self._anchors[: k + 1], self._axes[: k + 1], balls)
        return caps


def farthest(anchors: Floats, lines: Floats, points: tuple[Floats, Floats]) -> Floats:
    """Return the largest distance (n,) from each axis of points behind the last axis, at any angles [m].

    Args:
        anchors: (n, 3) of the joints [m].
        lines: (n, 3) directions of their axes.
        points: centres (P, 3) and radii (P,) of balls [m].
    """
    offset, radius = points[0] - anchors[-1], points[1]
    reach = float((np.linalg.norm(offset, axis=1) + radius).max())
    distances = np.empty(len(anchors))
    distances[-1] = (np.linalg.norm(np.cross(offset, lines[-1]), axis=1) + radius).max()
    for i in range(len(anchors) - 2, -1, -1):
        step = anchors[i + 1] - anchors[i]
        distances[i] = np.linalg.norm(np.cross(step, lines[i])) + reach
        reach += float(np.linalg.norm(step))
    return distances


def table_radius(model: mujoco.MjModel, data: mujoco.MjData, table: RotaryTable | None) -> float:
    """Return the radius about the table's axis that contains everything it turns [m]; 0 without a table.

    Args:
        model: the cell.
        data: with part and post at angle 0, kinematics up to date.
        table: the table.
    """
    if table is None:
        return 0.0
    turned, farthest = {model.body("object").id, model.body("post").id}, 0.0
    for geom in np.flatnonzero([int(body) in turned for body in model.geom_bodyid]):
        points, radius = enclosing_points(model, data, int(geom))
        farthest = max(farthest, float(np.linalg.norm(table.to_table_frame(points)[:, :2], axis=1).max()) + radius)
    return farthest


def _link_of(model: mujoco.MjModel, body: int, bodies: list[int]) -> int | None:
    """Return the index of the link that is a body or carries it; None for no link."""
    while body > 0:
        if body in bodies:
            return bodies.index(body)
        body = int(model.body_parentid[body])
    return None
