"""The rotary table of a scene as the planner's external axis; where it stands when the scene does not say."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cell.errors import SceneError
from cell.scene.posed import pose
from cell.scene.scene import Scene
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import ArmOnTable, RotaryTable
from planner.ports import ARM_AXES, Kinematics
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

SHORTEST_POST_MM = 1.0
HALF_A_TURN_DEG = -180.0, 180.0
"""What is used of an endless axis: every angle, and nothing winds up."""


def rotary_table(scene: Scene, T_base_object: Floats, hull: TriangleMesh) -> RotaryTable | None:
    """The table of a scene; None where it has none.

    Args:
        scene: its placement is by the part's centre.
        T_base_object: (4, 4) the part at angle 0 [m].
        hull: the part's convex hull, object frame [m].

    Raises:
        SceneError: if the part reaches below the table's face, or is wider than the table carries.
    """
    asked = scene.table
    if not asked.enabled:
        return None
    points = hull.vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3]
    T = pose(asked.position_mm or (0.0, 0.0, 0.0), asked.abc_deg) + 0.0  # no -0.0 in files
    if asked.position_mm is None:
        R = T[:3, :3]
        middle = scene.placement.T[:3, 3] @ R
        middle[2] = (points @ R)[:, 2].min() - asked.post_mm / 1000.0
        T[:3, 3] = R @ middle
    lower, upper = asked.limits_deg or HALF_A_TURN_DEG
    rates = asked.velocity_deg_s, asked.acceleration_deg_s2, asked.jerk_deg_s3
    table = RotaryTable(T, *np.deg2rad([lower, upper, *rates]).tolist())
    on_face = table.seen(points)
    height, needed = 1000 * float(on_face[:, 2].min()), SHORTEST_POST_MM if scene.post.enabled else 0.0
    if height < needed - 1e-6:
        raise SceneError(
            f"the part's lowest point is {height:.1f} mm above the face of the rotary table, and must be "
            f"{needed:g} mm or more above it: raise placement.position_mm or lower table.position_mm along its axis"
            + ("; a part that stands on the face itself needs post.enabled = false" if needed else "")
        )
    swing = 2000 * float(np.linalg.norm(on_face[:, :2], axis=1).max())
    if swing > asked.swing_mm:
        raise SceneError(
            f"the part swings through a circle of {swing:.0f} mm, and the rotary table carries {asked.swing_mm:g} mm; "
            "place it nearer to the axis, or give a larger table.swing_mm"
        )
    return table


def on_table(arm: Kinematics, table: RotaryTable | None, home: Floats, angles: int) -> Kinematics:
    """Arm and table as one chain; the arm alone where there is no table."""
    return arm if table is None else ArmOnTable(arm, table, home, angles)


def height_above(table: RotaryTable, T_base_object: Floats, hull: TriangleMesh) -> float:
    """How high above the table's face the part's lowest point is, T_base_object being its placement (4, 4) [m]."""
    return float(table.seen(hull.vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3])[:, 2].min())


class Turner:
    """Puts part and post of states of a model where a table has turned them.

    Args:
        data: a state with both at angle 0; a cell has no other mocap bodies.
        table: turns them; None: they stand.
    """

    def __init__(self, data: mujoco.MjData, table: RotaryTable | None) -> None:
        self._turns = table is not None
        if table is None:
            return
        # An origin goes round a circle; a quaternion is cos of half the angle of the one at 0, and sin of it of that
        # times the axis' own.
        axis, at, quaternion = table.T_base_table[:3, 2], data.mocap_pos.copy(), data.mocap_quat.copy()
        along = (at - table.T_base_table[:3, 3]) @ axis
        self._middle = table.T_base_table[:3, 3] + along[:, None] * axis
        self._out, self._quaternion = at - self._middle, quaternion
        self._across = np.cross(axis, self._out)
        scalar, vector = quaternion[:, :1], quaternion[:, 1:]
        self._times_axis = np.concatenate([-vector @ axis[:, None], scalar * axis + np.cross(axis, vector)], axis=1)

    def __call__(self, data: mujoco.MjData, q: Floats) -> None:
        """Set both in a state, at (axes,) joint angles [rad]; nothing is done where they stand."""
        self.put(data, self.poses(q[None])[0])

    def poses(self, q: Floats) -> Sequence[tuple[Floats, Floats] | None]:
        """N positions (2, 3) [m] and quaternions (2, 4) of part and post at (N, axes) joint angles [rad]; or None."""
        if not self._turns:
            return [None] * len(q)
        angle = q[:, ARM_AXES, None, None]
        c, s, c2, s2 = np.cos(angle), np.sin(angle), np.cos(angle / 2), np.sin(angle / 2)
        positions = self._middle + c * self._out + s * self._across
        return list(zip(positions, c2 * self._quaternion + s2 * self._times_axis, strict=True))

    @staticmethod
    def put(data: mujoco.MjData, at: tuple[Floats, Floats] | None) -> None:
        """Set both in a state, at one of the `poses`."""
        if at is not None:
            data.mocap_pos[:], data.mocap_quat[:] = at
