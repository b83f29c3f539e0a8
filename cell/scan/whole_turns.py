"""An endless table that stands whole turns from the plan's angles: it is the same place, and is driven from there.

A controller counts the turns of an endless axis, a plan stays within one of them. What goes to the controller has the
whole turns added, what it says has them taken away: nothing turns back, and everything else knows the plan's angles
only.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cell.runs.schema import ResolvedScene
from cell.scan.legs import AT_START
from cell.session import ProgressReporter
from drivers.contract import Capabilities, Driver, RobotState
from drivers.setpoints import PER_DEGREE, SetPoints, frozen
from planner.ports import ARM_AXES, JointLimits

_TURN = 360 * PER_DEGREE
_INT32 = np.iinfo(np.int32)


class WholeTurnsOff(Driver):
    """A connected driver, its table's angles as the plan has them.

    Args:
        driver: of seven axes.
        turns: by which the controller's angle is above the plan's.
    """

    def __init__(self, driver: Driver, turns: int) -> None:
        self._driver, self.turns = driver, turns

    def __enter__(self) -> "WholeTurnsOff":
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self) -> None:
        """As the driver's own; so is all that follows."""
        self._driver.connect()

    def close(self) -> None:
        """Give the wire back."""
        self._driver.close()

    @property
    def capabilities(self) -> Capabilities:
        """What the controller accepts."""
        able = self._driver.capabilities
        lower, upper = (frozen(np.clip(_turned(end, -self.turns), _INT32.min, _INT32.max), np.int32)
                        for end in (able.lower, able.upper))  # fmt: skip
        return replace(able, lower=lower, upper=upper)

    def state(self) -> RobotState:
        """The state now."""
        return self._as_planned(self._driver.state())

    def take(self) -> None:
        """Become the one client."""
        self._driver.take()

    def require_ready(self) -> RobotState:
        """The state of an arm that stands without a fault."""
        return self._as_planned(self._driver.require_ready())

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points."""
        return self._as_planned(self._driver.move(_added(set_points, self.turns), speed))

    def stop(self) -> RobotState:
        """Brake on the path."""
        return self._as_planned(self._driver.stop())

    def reset(self) -> RobotState:
        """Clear a latched fault."""
        return self._as_planned(self._driver.reset())

    def _as_planned(self, state: RobotState) -> RobotState:
        return replace(state, axes=_added(state.axes, -self.turns))


def as_planned(
    driver: Driver, state: RobotState, scene: ResolvedScene, limits: JointLimits, reporter: ProgressReporter
) -> tuple[Driver, RobotState]:
    """A driver and its state, whole turns of an endless table taken away and told.

    Args:
        driver: connected.
        state: of the controller, which stands.
        scene: of the plan.
        limits: of the plan.
        reporter: is told of turns.
    """
    turns = turns_off(state, driver.capabilities, limits) if scene.table_is_endless else 0
    if not turns:
        return driver, state
    reporter.note(
        f"the rotary table stands at {state.axes[ARM_AXES] / PER_DEGREE:.4f} deg, {turns:+d} whole turns from the "
        f"plan's angles, and is driven from there: {360 * turns:+d} deg on every angle of E1"
    )
    off = WholeTurnsOff(driver, turns)
    return off, off.state()


def turns_off(state: RobotState, able: Capabilities, limits: JointLimits) -> int:
    """Fewest whole turns that bring an endless table within the plan's limits when taken away.

    Args:
        state: of the controller, which stands.
        able: what it accepts.
        limits: of the plan.

    Returns:
        The turns; 0 where it is within them, no whole turn brings it there, or the controller does not take the plan's
        angles with these turns added (it does not know that the axis is endless).
    """
    lower, upper = (round(float(np.degrees(end[ARM_AXES])) * PER_DEGREE) for end in (limits.lower, limits.upper))
    angle = int(state.axes[ARM_AXES])
    if lower - AT_START <= angle <= upper + AT_START:
        return 0
    turns = -((upper - angle) // _TURN) if angle > upper else (angle - lower) // _TURN
    added = turns * _TURN
    inside = lower <= angle - added <= upper
    taken = able.lower[ARM_AXES] <= lower + added and upper + added <= able.upper[ARM_AXES]
    return turns if inside and taken else 0


def _turned(axes: SetPoints, turns: int) -> NDArray[np.int64]:
    """(..., 7) counts with whole turns of the table added."""
    wide = axes.astype(np.int64)
    wide[..., ARM_AXES] += turns * _TURN
    return wide


def _added(axes: SetPoints, turns: int) -> SetPoints:
    """The same as set-points; beyond 32 bits, which `turns_off` keeps from, there are none."""
    wide = _turned(axes, turns)
    if wide.max() > _INT32.max or wide.min() < _INT32.min:
        raise OverflowError(f"{turns:+d} turns take the table beyond what a set-point can hold")
    return frozen(wide, np.int32)
