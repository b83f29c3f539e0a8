"""A rotary table under the part, and arm and table as one kinematic chain of seven axes.

In the frame of the part, a table that turns by an angle is a robot that moves about the table's axis by minus that
angle. So everything that belongs to the part (candidates, samples, measurability) is computed once, with the table at
0. `ArmOnTable` maps joint angles (..., 7) to T_base_flange with the table turned back. Metres, radians; E1 turns
right-handed about the table's z.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.kinematics.setpoints import from_steps, to_steps
from planner.ports import ARM_AXES, JointLimits, Kinematics
from planner.values import Floats, Value


@dataclass(frozen=True, slots=True, eq=False)
class RotaryTable(Value):
    """An external axis that turns the part.

    Attributes:
        T_base_table: (4, 4) [m]; the axis is z, the face lies in the plane z = 0.
        lower: smallest angle [rad].
        upper: largest angle [rad].
        velocity: largest speed [rad/s].
        acceleration: largest acceleration [rad/s^2].
        jerk: largest jerk [rad/s^3].
    """

    T_base_table: Annotated[Floats, "4 4"]
    lower: float
    upper: float
    velocity: float
    acceleration: float
    jerk: float

    def turn(self, angle: ArrayLike) -> Floats:
        """Return (..., 4, 4) the motion [m] from angle 0 to angles (...) [rad] of a body on the table, base frame."""
        angle = np.asarray(angle, dtype=np.float64)
        T = np.zeros((*angle.shape, 4, 4))
        T[..., 0, 0] = T[..., 1, 1] = np.cos(angle)
        T[..., 1, 0] = np.sin(angle)
        T[..., 0, 1] = -T[..., 1, 0]
        T[..., 2, 2] = T[..., 3, 3] = 1.0
        turned: Floats = self.T_base_table @ T @ np.linalg.inv(self.T_base_table)
        return turned

    def to_table_frame(self, points: Floats) -> Floats:
        """Transform points (..., 3) [m] from base to the frame of the table at rest: z is the height above its face."""
        return np.asarray((points - self.T_base_table[:3, 3]) @ self.T_base_table[:3, :3])

    @property
    def upright(self) -> bool:
        """Whether the axis is vertical, so that the floor is the same at every angle."""
        return bool(self.T_base_table[2, 2] > 1.0 - 1e-12)

    def limits(self, arm: JointLimits) -> JointLimits:
        """Return the limits of the arm's axes followed by those of the table."""
        names = ("lower", "upper", "velocity", "acceleration", "jerk")
        return replace(arm, **{name: np.append(getattr(arm, name), getattr(self, name)) for name in names})

    def angles(self, count: int) -> Floats:
        """Return the angles within the limits out of `count`, evenly spaced over a turn, as multiples of 1e-4 deg."""
        turn = from_steps(to_steps((np.arange(count) - count // 2) * (2 * np.pi / count)))
        # An axis that goes farther than half a turn to one side reaches the other side's angles there.
        turn = np.where(turn < self.lower, turn + 2 * np.pi, np.where(turn > self.upper, turn - 2 * np.pi, turn))
        # Limits that leave room for less than one step still have an angle: the middle of the range.
        inside = from_steps(to_steps(turn[(turn >= self.lower - 1e-9) & (turn <= self.upper + 1e-9)]))
        return inside if len(inside) else from_steps(to_steps([(self.lower + self.upper) / 2]))


class ArmOnTable:
    """A `planner.ports.Kinematics` of an arm and a rotary table; q has seven angles, the table's last.

    Args:
        arm: the arm alone.
        table: turns the part.
        home: (7,) configuration at which motions begin and end [rad].
        angles: number of table angles per turn at which configurations are searched.
    """

    def __init__(self, arm: Kinematics, table: RotaryTable, home: Floats, angles: int) -> None:
        self._arm, self._table, self._home = arm, table, np.asarray(home)
        self._angles = table.angles(angles)

    @cached_property
    def limits(self) -> JointLimits:
        """Limits of the seven axes."""
        return self._table.limits(self._arm.limits)

    def forward(self, q: Floats) -> Floats:
        """Return (N, 4, 4) T_base_flange [m] with the table turned back, at q (N, 7) [rad]."""
        q = np.asarray(q, dtype=np.float64)
        T: Floats = self._table.turn(-q[:, ARM_AXES]) @ self._arm.forward(q[:, :ARM_AXES])
        return T

    def inverse_at(self, T_base_flange: Floats, angles: Floats) -> Floats:
        """Return (n, branches, 7) branches of one pose (4, 4) [m], table turned back, at (n,) table angles [rad]."""
        arm = self._arm.inverse(self._table.turn(angles) @ T_base_flange)
        return np.concatenate([arm, np.where(np.isnan(arm[..., :1]), np.nan, angles[:, None, None])], axis=-1)

    def inverse(self, T_base_flange: Floats) -> Floats:
        """Return every branch at every table angle, ordered by the time from home of the slowest axis at full speed.

        Args:
            T_base_flange: (N, 4, 4) [m], table turned back.

        Returns:
            (N, branches * angles, 7) joint angles [rad], NaN for a branch without a real solution.
        """
        turned = self._table.turn(self._angles)[:, None] @ T_base_flange
        arm = self._arm.inverse(turned.reshape(-1, 4, 4))
        count, branches = len(T_base_flange), arm.shape[1]
        q = np.empty((count, len(self._angles), branches, ARM_AXES + 1))
        q[..., :ARM_AXES] = np.moveaxis(arm.reshape(len(self._angles), count, branches, ARM_AXES), 0, 1)
        q[..., ARM_AXES] = np.where(np.isnan(q[..., 0]), np.nan, self._angles[:, None])
        flat = q.reshape(count, -1, ARM_AXES + 1)
        seconds = (np.abs(flat - self._home) / self.limits.velocity).max(axis=-1)
        first = np.argsort(seconds, axis=1, kind="stable")  # NaN comes last
        return np.take_along_axis(flat, first[..., None], axis=1)
