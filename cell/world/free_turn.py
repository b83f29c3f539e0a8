"""How far a rotary table can turn its part: what it turns beside what stands.

Neither has a joint, so the engine's collision finder leaves these pairs out; those that can come near each other are
looked at one by one, once for each angle. A table cannot turn past what its part would touch, wherever the arm is: the
axis ends there, and what lies behind is out of reach, however free it is. Metres, radians.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from cell.world.rotary_table import Turner
from planner.kinematics.rotary_table import RotaryTable
from planner.ports import ARM_AXES
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_STEP_DEG = 1  # between two looks; a point 600 mm from the axis moves by 10 mm, half of what a thin pillar keeps free


class Distance(Protocol):
    """Distance of two geoms in a state of the model [m], as `cell.world.model.World.distance`."""

    def __call__(self, data: mujoco.MjData, a: int, b: int, reach: float, *, any_nearer: bool = False) -> float:
        """The distance."""


class FreeTurn:
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
        self._turner = Turner(data, table)
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
