"""The rotary table of a scene as the planner's external axis; where it stands when the scene does not say.

How far a rotary table can turn its part: what it turns beside what stands.

Neither has a joint, so the engine's collision finder leaves these pairs out; those that can come near each other are
looked at one by one, once for each angle. A table cannot turn past what its part would touch, wherever the arm is: the
axis ends there, and what lies behind is out of reach, however free it is. Metres, radians.
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
HALF_A_TURN_DEG = -180.0, 180.0
"""What is used of an endless axis: every angle, and nothing winds up."""


def place_table(scene: Scene, T_base_object: Floats, hull: TriangleMesh) -> RotaryTable | None:
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


def kinematics_on_table(arm: Kinematics, table: RotaryTable | None, home: Floats, angles: int) -> Kinematics:
    """Arm and table as one chain; the arm alone where there is no table."""
    return arm if table is None else ArmOnTable(arm, table, home, angles)


def height_above_face(table: RotaryTable, T_base_object: Floats, hull: TriangleMesh) -> float:
    """How high above the table's face the part's lowest point is, T_base_object being its placement (4, 4) [m]."""
    return float(table.seen(hull.vertices @ T_base_object[:3, :3].T + T_base_object[:3, 3])[:, 2].min())


class TablePoses:
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


_STEP_DEG = 1  # between two looks; a point 600 mm from the axis moves by 10 mm, half of what a thin pillar keeps free


class Distance(Protocol):
    """Distance of two geoms in a state of the model [m], as `cell.world.model.World.distance`."""

    def __call__(self, data: mujoco.MjData, a: int, b: int, reach: float, *, any_nearer: bool = False) -> float:
        """The distance."""


class TableCollision:
    """Says at which angles what a table turns keeps clear of what stands.

    Args:
        model: the cell.
        data: a state with the part at angle 0, kinematics up to date; kept.
        table: turns the part; None: nothing turns.
        pairs: (P, 2) guarded geoms.
        clearance: distance that is kept [m].
        distance: of two geoms.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, table: RotaryTable | None,
        pairs: NDArray[np.int32], clearance: float, distance: Distance,
    ) -> None:  # fmt: skip
        self._model, self._data, self._clearance, self._distance = model, data, clearance, distance
        self._pairs = [] if table is None else _near_each_other(model, data, table, pairs, clearance)
        self._turner = TablePoses(data, table)
        self._known: dict[float, bool] = {}

    def clear(self, q: Floats) -> bool:
        """Whether everything is at least the clearance apart, at (axes,) joint angles."""
        if not self._pairs:
            return True
        angle, least = float(q[ARM_AXES]), self._clearance
        if angle not in self._known:
            import mujoco

            self._turner(self._data, q)
            mujoco.mj_kinematics(self._model, self._data)
            self._known[angle] = all(
                self._distance(self._data, a, b, least, any_nearer=True) >= least for a, b in self._pairs
            )
        return self._known[angle]

    def within(self, table: RotaryTable, home: Floats, *, endless: bool) -> RotaryTable:
        """The table with limits no wider than it can turn from 0.

        An endless axis that is stopped to one side goes round to the other as far as it can, up to a whole turn.

        Args:
            table: as the scene has it.
            home: (axes,) joint angles [rad].
            endless: whether nothing but what stands limits it.
        """
        if not self._pairs or not self.clear(home):
            return table
        q = home.copy()

        def end(sign: int, until_deg: float) -> tuple[float, bool]:
            """The last clear angle to one side [rad], and whether something stands behind it."""
            for step in range(_STEP_DEG, int(until_deg) + 1, _STEP_DEG):
                q[ARM_AXES] = np.radians(sign * step)
                if not self.clear(q):
                    return float(np.radians(sign * (step - _STEP_DEG))), True
            q[ARM_AXES] = np.radians(sign * until_deg)
            return (float(q[ARM_AXES]), False) if self.clear(q) else (float(np.radians(sign * int(until_deg))), True)

        (upper, above), (lower, below) = end(1, np.degrees(table.upper)), end(-1, -np.degrees(table.lower))
        if endless and above != below:
            lower, upper = (end(-1, 360.0)[0], upper) if above else (lower, end(1, 360.0)[0])
        return replace(
            table, lower=lower if below or endless else table.lower, upper=upper if above or endless else table.upper
        )


def _near_each_other(
    model: mujoco.MjModel, data: mujoco.MjData, table: RotaryTable, pairs: NDArray[np.int32], clearance: float
) -> list[tuple[int, int]]:
    """Guarded pairs of what a table turns and what stands that come near each other at some angle."""
    moves = model.body_treeid[model.geom_bodyid] >= 0
    found = []
    for a, b in pairs[~moves[pairs].any(axis=1)]:
        still, turned = (a, b) if model.body_mocapid[model.geom_bodyid[a]] < 0 else (b, a)
        # Its middle goes round a circle about the axis: all angles put it into a ball.
        x, y, z = table.seen(data.geom_xpos[turned])
        middle, axis = table.T_base_table @ [0.0, 0.0, z, 1.0], table.T_base_table[:3, 2]
        circle, own = float(np.hypot(x, y)), model.geom_rbound[turned] + clearance
        off = data.geom_xpos[still] - middle[:3]
        if still == model.geom("floor").id:
            near = -off[2] - circle * np.hypot(*axis[:2]) < own
        else:
            near = np.linalg.norm(off) < circle + own + model.geom_rbound[still]
        if near:
            found.append((int(a), int(b)))
    return found
