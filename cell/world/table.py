"""The rotary table of a scene: its pose, the poses of what it turns, and its collisions with the surroundings.

The bodies that a table turns have no joint, so MuJoCo's collision detection skips their pairs with stationary bodies.
Pairs that can come near each other are measured one by one, once for each angle. Where the turned bodies would touch
the surroundings the table's axis ends: angles beyond are out of reach, even if they are free. Metres, radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.scene.model import Scene, pose
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import ArmOnTable, RotaryTable
from planner.ports import ARM_AXES, Kinematics
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

SHORTEST_POST_MM = 1.0
ENDLESS_LIMITS_DEG = -180.0, 180.0
"""Limits of an endless axis: every angle once, so that no cable winds up."""

_STEP_DEG = 1  # between checked angles; a point 600 mm off the axis moves 10 mm, half the clearance of a thin pillar


def place_table(scene: Scene, T_base_object: Floats, hull: TriangleMesh) -> RotaryTable | None:
    """Return the table of a scene; None if it has none.

    Without a position the axis goes through the part's centre, and the face is `table.post_mm` below the part.

    Args:
        scene: with its placement by the part's centre.
        T_base_object: (4, 4) the part at angle 0 [m].
        hull: the part's convex hull, object frame [m].

    Raises:
        SceneError: if the part reaches below the table's face, or is wider than the table carries.
    """
    settings = scene.table
    if not settings.enabled:
        return None
    points = hull.vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3]
    T = pose(settings.position_mm or (0.0, 0.0, 0.0), settings.abc_deg) + 0.0  # no -0.0 in files
    if settings.position_mm is None:
        R = T[:3, :3]
        middle = scene.placement.T[:3, 3] @ R
        middle[2] = (points @ R)[:, 2].min() - settings.post_mm / 1000.0
        T[:3, 3] = R @ middle
    lower, upper = settings.limits_deg or ENDLESS_LIMITS_DEG
    rates = settings.velocity_deg_s, settings.acceleration_deg_s2, settings.jerk_deg_s3
    table = RotaryTable(T, *np.deg2rad([lower, upper, *rates]).tolist())
    on_face = table.to_table_frame(points)
    height, needed = 1000 * float(on_face[:, 2].min()), SHORTEST_POST_MM if scene.post.enabled else 0.0
    if height < needed - 1e-6:
        raise SceneError(
            f"the part's lowest point is {height:.1f} mm above the face of the rotary table, and must be "
            f"{needed:g} mm or more above it: raise placement.position_mm or lower table.position_mm along its axis"
            + ("; a part that stands on the face itself needs post.enabled = false" if needed else "")
        )
    swing = 2000 * float(np.linalg.norm(on_face[:, :2], axis=1).max())
    if swing > settings.swing_mm:
        raise SceneError(
            f"the part swings through a circle of {swing:.0f} mm, and the rotary table carries {settings.swing_mm:g} "
            "mm; place it nearer to the axis, or give a larger table.swing_mm"
        )
    return table


def kinematics_on_table(arm: Kinematics, table: RotaryTable | None, home: Floats, angles: int) -> Kinematics:
    """Return arm and table as one chain; the arm alone without a table."""
    return arm if table is None else ArmOnTable(arm, table, home, angles)


def height_above_face(table: RotaryTable, T_base_object: Floats, hull: TriangleMesh) -> float:
    """Return the height of the part's lowest point above the table's face [m], placed at T_base_object (4, 4)."""
    return float(table.to_table_frame(hull.vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3])[:, 2].min())


class TablePoses:
    """Poses of part and post at angles of a rotary table.

    Args:
        data: a state with both at angle 0; a cell has no other mocap bodies.
        table: the table; None: part and post never move.
    """

    def __init__(self, data: mujoco.MjData, table: RotaryTable | None) -> None:
        self._turns = table is not None
        if table is None:
            return
        # An origin moves on a circle. A quaternion at an angle is cos(angle / 2) times the one at 0, plus
        # sin(angle / 2) times that of the axis times the one at 0.
        axis, at, quaternion = table.T_base_table[:3, 2], data.mocap_pos.copy(), data.mocap_quat.copy()
        along = (at - table.T_base_table[:3, 3]) @ axis
        self._middle = table.T_base_table[:3, 3] + along[:, None] * axis
        self._out, self._quaternion = at - self._middle, quaternion
        self._across = np.cross(axis, self._out)
        scalar, vector = quaternion[:, :1], quaternion[:, 1:]
        self._times_axis = np.concatenate([-vector @ axis[:, None], scalar * axis + np.cross(axis, vector)], axis=1)

    def set_configuration(self, data: mujoco.MjData, q: Floats) -> None:
        """Set part and post in a state, at joint angles (axes,) [rad]."""
        self.set_poses(data, self.poses(q[None])[0])

    def poses(self, q: Floats) -> Sequence[tuple[Floats, Floats] | None]:
        """Return positions (2, 3) [m] and quaternions (2, 4) of part and post for joint angles (N, axes) [rad].

        An item is None if nothing turns.
        """
        if not self._turns:
            return [None] * len(q)
        angle = q[:, ARM_AXES, None, None]
        c, s, c2, s2 = np.cos(angle), np.sin(angle), np.cos(angle / 2), np.sin(angle / 2)
        positions = self._middle + c * self._out + s * self._across
        return list(zip(positions, c2 * self._quaternion + s2 * self._times_axis, strict=True))

    @staticmethod
    def set_poses(data: mujoco.MjData, at: tuple[Floats, Floats] | None) -> None:
        """Set part and post in a state, at one of the `poses`."""
        if at is not None:
            data.mocap_pos[:], data.mocap_quat[:] = at


class Distance(Protocol):
    """Distance of two geoms in a state of the model [m], as `cell.world.model.World.distance`."""

    def __call__(self, data: mujoco.MjData, a: int, b: int, reach: float, *, any_nearer: bool = False) -> float:
        """Return the distance."""


class TableCollision:
    """Collision check of the bodies that a table turns with the stationary ones.

    Args:
        model: the cell.
        data: a state with the part at angle 0, kinematics up to date; kept.
        table: the table; None: nothing turns, everything is clear.
        pairs: (P, 2) checked geoms.
        clearance: distance that is kept [m].
        distance: measures two geoms.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        table: RotaryTable | None,
        pairs: NDArray[np.int32],
        clearance: float,
        distance: Distance,
    ) -> None:
        self._model, self._data, self._clearance, self._distance = model, data, clearance, distance
        self._pairs = [] if table is None else _pairs_in_reach(model, data, table, pairs, clearance)
        self._poses = TablePoses(data, table)
        self._known: dict[float, bool] = {}

    def is_clear(self, q: Floats) -> bool:
        """Return whether every pair is at least the clearance apart, at joint angles (axes,)."""
        if not self._pairs:
            return True
        angle, clearance = float(q[ARM_AXES]), self._clearance
        if angle not in self._known:
            import mujoco

            self._poses.set_configuration(self._data, q)
            mujoco.mj_kinematics(self._model, self._data)
            self._known[angle] = all(
                self._distance(self._data, a, b, clearance, any_nearer=True) >= clearance for a, b in self._pairs
            )
        return self._known[angle]

    def within(self, table: RotaryTable, home: Floats, *, endless: bool) -> RotaryTable:
        """Return the table with limits no wider than it can turn from 0.

        An endless axis that is blocked on one side turns on the other side as far as it can, up to a whole turn.

        Args:
            table: as in the scene.
            home: (axes,) joint angles [rad].
            endless: whether the scene gives no limits.
        """
        if not self._pairs or not self.is_clear(home):
            return table
        q = home.copy()

        def end(sign: int, until_deg: float) -> tuple[float, bool]:
            """Return the last clear angle on one side [rad], and whether an obstacle follows."""
            for step in range(_STEP_DEG, int(until_deg) + 1, _STEP_DEG):
                q[ARM_AXES] = np.radians(sign * step)
                if not self.is_clear(q):
                    return float(np.radians(sign * (step - _STEP_DEG))), True
            q[ARM_AXES] = np.radians(sign * until_deg)
            return (float(q[ARM_AXES]), False) if self.is_clear(q) else (float(np.radians(sign * int(until_deg))), True)

        (upper, above), (lower, below) = end(1, np.degrees(table.upper)), end(-1, -np.degrees(table.lower))
        if endless and above != below:
            lower, upper = (end(-1, 360.0)[0], upper) if above else (lower, end(1, 360.0)[0])
        return replace(
            table, lower=lower if below or endless else table.lower, upper=upper if above or endless else table.upper
        )


def _pairs_in_reach(
    model: mujoco.MjModel, data: mujoco.MjData, table: RotaryTable, pairs: NDArray[np.int32], clearance: float
) -> list[tuple[int, int]]:
    """Return checked pairs of a turned and a stationary geom that come near each other at some angle."""
    moves = model.body_treeid[model.geom_bodyid] >= 0
    near_pairs = []
    for a, b in pairs[~moves[pairs].any(axis=1)]:
        stationary, turned = (a, b) if model.body_mocapid[model.geom_bodyid[a]] < 0 else (b, a)
        # The middle moves on a circle about the axis: over all angles the geom stays within a ball about its centre.
        x, y, z = table.to_table_frame(data.geom_xpos[turned])
        middle, axis = table.T_base_table @ [0.0, 0.0, z, 1.0], table.T_base_table[:3, 2]
        circle, pair_reach = float(np.hypot(x, y)), model.geom_rbound[turned] + clearance
        offset = data.geom_xpos[stationary] - middle[:3]
        if stationary == model.geom("floor").id:
            near = -offset[2] - circle * np.hypot(*axis[:2]) < pair_reach
        else:
            near = np.linalg.norm(offset) < circle + pair_reach + model.geom_rbound[stationary]
        if near:
            near_pairs.append((int(a), int(b)))
    return near_pairs
