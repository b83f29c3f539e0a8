"""Whole turns of an endless rotary table: the arm is driven at the controller's angle, the plan keeps its own.

A controller counts the turns of an endless axis, and a plan stays within one of them. Whole turns are added to all
set-points that go to the controller and subtracted from all angles that it reports: the table does not turn back, and
the rest of the program uses the plan's angles only.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.runs.schema import ResolvedScene
from cell.session import ProgressReporter
from drivers.contract import Capabilities, Driver, RobotState
from drivers.setpoints import PER_DEGREE, SetPoints, frozen
from planner.ports import ARM_AXES, JointLimits

_TURN = 360 * PER_DEGREE
_INT32 = np.iinfo(np.int32)
_TOLERANCE = 100  # counts by which the table may be outside the plan's range: 0.01 deg


class TurnOffsetDriver(Driver):
    """A connected driver of seven axes whose table angles are those of the plan.

    Args:
        driver: the driver.
        turns: whole turns by which the controller's angle exceeds the plan's.
    """

    def __init__(self, driver: Driver, turns: int) -> None:
        self._driver, self.turns = driver, turns

    def __enter__(self) -> "TurnOffsetDriver":
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self) -> None:
        """Connect; this and all other methods are those of the driver."""
        self._driver.connect()

    def close(self) -> None:
        """Release the connection."""
        self._driver.close()

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities of the controller in the plan's angles."""
        able = self._driver.capabilities
        lower, upper = (
            frozen(np.clip(_turned(end, -self.turns), _INT32.min, _INT32.max), np.int32)
            for end in (able.lower, able.upper)
        )
        return replace(able, lower=lower, upper=upper)

    def state(self) -> RobotState:
        """Return the current state."""
        return self._as_planned(self._driver.state())

    def take(self) -> None:
        """Become the only client."""
        self._driver.take()

    def require_ready(self) -> RobotState:
        """Return the state of an arm at rest without a fault."""
        return self._as_planned(self._driver.require_ready())

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points."""
        return self._as_planned(self._driver.move(_with_turns(set_points, self.turns), speed))

    def stop(self) -> RobotState:
        """Brake on the path."""
        return self._as_planned(self._driver.stop())

    def reset(self) -> RobotState:
        """Clear a latched fault."""
        return self._as_planned(self._driver.reset())

    def _as_planned(self, state: RobotState) -> RobotState:
        return replace(state, axes=_with_turns(state.axes, -self.turns))


def remove_whole_turns(
    driver: Driver, state: RobotState, scene: ResolvedScene, limits: JointLimits, reporter: ProgressReporter
) -> tuple[Driver, RobotState]:
    """Return a connected driver and its state in the angles of the plan; note whole turns of an endless table."""
    turns = whole_turns(state, driver.capabilities, limits) if scene.table_is_endless else 0
    if not turns:
        return driver, state
    reporter.note(
        f"the rotary table is at {state.axes[ARM_AXES] / PER_DEGREE:.4f} deg, {turns:+d} whole turns from the plan's "
        f"angles, and is driven from there: {360 * turns:+d} deg are added to every angle of E1"
    )
    offset = TurnOffsetDriver(driver, turns)
    return offset, offset.state()


def whole_turns(state: RobotState, able: Capabilities, limits: JointLimits) -> int:
    """Return the smallest number of whole turns whose subtraction brings a table within the plan's limits.

    0 if it is within them, no whole turn brings it there, or the controller does not accept the plan's angles with
    these turns added (it does not know that the axis is endless).
    """
    lower, upper = (round(float(np.degrees(end[ARM_AXES])) * PER_DEGREE) for end in (limits.lower, limits.upper))
    angle = int(state.axes[ARM_AXES])
    if lower - _TOLERANCE <= angle <= upper + _TOLERANCE:
        return 0
    turns = -((upper - angle) // _TURN) if angle > upper else (angle - lower) // _TURN
    offset = turns * _TURN
    is_inside = lower <= angle - offset <= upper
    is_accepted = able.lower[ARM_AXES] <= lower + offset and upper + offset <= able.upper[ARM_AXES]
    return turns if is_inside and is_accepted else 0


def _turned(axes: SetPoints, turns: int) -> NDArray[np.int64]:
    """Add whole turns of the table to (..., 7) counts."""
    wide = axes.astype(np.int64)
    wide[..., ARM_AXES] += turns * _TURN
    return wide


def _with_turns(axes: SetPoints, turns: int) -> SetPoints:
    """Add whole turns to set-points; `whole_turns` excludes results beyond 32 bits."""
    wide = _turned(axes, turns)
    if wide.max() > _INT32.max or wide.min() < _INT32.min:
        raise OverflowError(f"{turns:+d} turns take the table beyond the range of a set-point")
    return frozen(wide, np.int32)
