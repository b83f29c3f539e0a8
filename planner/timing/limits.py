"""Joint limits as a motion uses them: check, scale, compare with joint angles."""

from dataclasses import replace

import numpy as np

from planner.errors import PlannerError
from planner.ports import JointLimits, axis_name
from planner.values import Floats


def require_usable(limits: JointLimits) -> None:
    """Refuse limits under which no motion can be timed: not above 0, an empty range, or a speed that could jump.

    A single limit may be infinite, but not acceleration and jerk of one axis together: its speed would jump.
    """
    for axis in range(len(limits.lower)):
        name = axis_name(axis)
        for what, unit in (("velocity", "rad/s"), ("acceleration", "rad/s^2"), ("jerk", "rad/s^3")):
            value = getattr(limits, what)[axis]
            if not value > 0:
                raise PlannerError(f"the {what} limit of {name} is {value} {unit}; it must be above 0")
        if limits.acceleration[axis] == np.inf and limits.jerk[axis] == np.inf:
            raise PlannerError(
                f"the acceleration limit of {name} is inf rad/s^2 and its jerk limit inf rad/s^3; "
                "one of them must be finite, or its speed would jump"
            )
        if not limits.lower[axis] <= limits.upper[axis]:
            raise PlannerError(
                f"the range of {name} is empty: its lower limit {limits.lower[axis]} rad is above its upper limit "
                f"{limits.upper[axis]} rad"
            )


def scale_limits(limits: JointLimits, speed: float = 1.0, acceleration: float = 1.0) -> JointLimits:
    """Reduce velocity and acceleration to a fraction.

    `speed` is the override of the controller: a share of the velocity, as KUKA defines $OV_PRO. It does not change
    accelerations, so an arm at low override stops sooner. `acceleration` also scales the jerk, so that the acceleration
    is reached in the same time.

    Args:
        limits: limits at full speed.
        speed: fraction of every velocity, in (0, 1].
        acceleration: fraction of every acceleration and jerk, in (0, 1].
    """
    for name, fraction in (("speed", speed), ("acceleration", acceleration)):
        if not 0 < fraction <= 1:
            raise PlannerError(f"the {name} fraction is {fraction}; it must be above 0 and at most 1")
    return replace(
        limits,
        velocity=limits.velocity * speed,
        acceleration=limits.acceleration * acceleration,
        jerk=limits.jerk * acceleration,
    )


def without_jerk_limit(limits: JointLimits) -> JointLimits:
    """Remove the jerk limits: the reference for the duration of jerk-limited motions."""
    return replace(limits, jerk=np.full_like(limits.jerk, np.inf))


def require_inside(what: str, q: Floats, limits: JointLimits) -> None:
    """Refuse joint angles (N, axes) [rad] outside the range; A4 and A6 do not wrap around.

    The error names the first row and axis outside; `what` is the name of a row.
    """
    outside = ~((q >= limits.lower) & (q <= limits.upper))
    if outside.any():
        row, axis = np.argwhere(outside)[0]
        low, high = np.degrees(limits.lower[axis]), np.degrees(limits.upper[axis])
        raise PlannerError(
            f"{what} {row} has {axis_name(int(axis))} at {np.degrees(q[row, axis]):.4f} deg; it must lie in "
            f"{low:.4f} to {high:.4f} deg"
        )
