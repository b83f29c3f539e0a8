"""Limits of a controller: position, speed, acceleration, jerk and step size of the axes."""

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from drivers.contract import Capabilities, Move, Result
from drivers.errors import DriverError
from drivers.setpoints import AXES, MAX_COUNT, PER_DEGREE, Floats, SetPoints, axis_name, frozen

ENDLESS_RANGE = 36_000 * PER_DEGREE
"""Range of an axis without limits to either side of 0, counts: a hundred turns."""

PATH_TOLERANCE = 2_000
"""Default path tolerance of every axis, counts: 0.2 deg."""

_ROUNDING = 1e-3  # counts; a limit this near to a count is that count: its radians are rounded


class JointLimits(Protocol):
    """Limits of the axes of an arm, n axes (`planner.ports.JointLimits`)."""

    @property
    def lower(self) -> Floats:
        """(n,) smallest joint angles [rad]."""

    @property
    def upper(self) -> Floats:
        """(n,) largest joint angles [rad]."""

    @property
    def velocity(self) -> Floats:
        """(n,) axis speeds [rad/s]."""

    @property
    def acceleration(self) -> Floats:
        """(n,) axis accelerations [rad/s^2]."""

    @property
    def jerk(self) -> Floats:
        """(n,) axis jerks [rad/s^3]; inf: not limited."""


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of a controller with n axes, n at least 6.

    Attributes:
        lower: (n,) smallest set-points, int32 counts of 1e-4 deg; a set-point on the limit is inside.
        upper: (n,) largest set-points, counts.
        velocity: (n,) axis speeds at speed fraction 1 [rad/s].
        acceleration: (n,) axis accelerations at every speed fraction [rad/s^2].
        max_step: (n,) largest change of an axis between two via points, counts.
        max_speed: largest speed fraction, in (0, 1].
        max_via: largest number of via points of a move; None: no bound.
        jerk: (n,) axis jerks at every speed fraction [rad/s^3]; inf: not limited. A scalar holds for every axis.
        path_tolerance: (n,) largest deviation of an axis from the path of a move while all others are on it, counts;
            `drivers.path_watch` combines them. A scalar holds for every axis.
    """

    lower: SetPoints
    upper: SetPoints
    velocity: Floats
    acceleration: Floats
    max_step: SetPoints
    max_speed: float = 1.0
    max_via: int | None = None
    jerk: Floats = field(default_factory=lambda: np.array(np.inf))
    path_tolerance: SetPoints = field(default_factory=lambda: np.array(PATH_TOLERANCE, dtype=np.int32))

    def __post_init__(self) -> None:
        axes = max(AXES, np.size(self.lower))
        for name in ("jerk", "path_tolerance"):
            if np.ndim(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(axes, getattr(self, name)))
        for name in ("lower", "upper", "velocity", "acceleration", "max_step", "jerk", "path_tolerance"):
            values = np.asarray(getattr(self, name))
            if values.shape != (axes,):
                raise DriverError(f"{name} of a controller's limits has shape {values.shape}; it must be ({axes},)")
            kind = np.float64 if name in ("velocity", "acceleration", "jerk") else np.int32
            object.__setattr__(self, name, frozen(values, kind))
        if not (self.lower <= self.upper).all():
            name = axis_name(int(np.argmax(self.lower > self.upper)))
            raise DriverError(f"the range of {name} is empty; its lower limit must not be above its upper limit")
        for name in ("velocity", "acceleration"):
            values = getattr(self, name)
            if not ((values > 0) & (values < np.inf)).all():
                raise DriverError(f"{name} of a controller's limits is {values}; every axis must be above 0 and finite")
        if not (self.jerk > 0).all():
            raise DriverError(f"jerk of a controller's limits is {self.jerk}; every axis must be above 0")
        for name in ("max_step", "path_tolerance"):
            if not (getattr(self, name) > 0).all():
                raise DriverError(f"{name} of a controller's limits must be at least one count on every axis")
        if self.max_via is not None and self.max_via < 1:
            raise DriverError(f"the largest number of via points is {self.max_via}; it must be at least 1")
        if not 0 < self.max_speed <= 1:
            raise DriverError(f"the largest speed fraction is {self.max_speed}; it must be above 0 and at most 1")

    @classmethod
    def from_rad(cls, arm: JointLimits) -> "Limits":
        """Convert the limits of an arm; a step may be the whole range.

        Positions are rounded inwards to counts. A joint without an end may have limits that do not fit 32 bits: they
        are reduced to these.
        """
        low, high = (np.degrees(np.asarray(limit, dtype=np.float64)) * PER_DEGREE for limit in (arm.lower, arm.upper))
        low, high = np.maximum(np.ceil(low - _ROUNDING), -MAX_COUNT), np.minimum(np.floor(high + _ROUNDING), MAX_COUNT)
        step = np.clip(high - low, 1, MAX_COUNT)
        return cls(low, high, arm.velocity, arm.acceleration, step, jerk=arm.jerk)

    def with_endless_axis(self) -> "Limits":
        """Return these limits with an endless last axis; its largest step stays the same."""
        return replace(
            self, lower=np.append(self.lower[:-1], -ENDLESS_RANGE), upper=np.append(self.upper[:-1], ENDLESS_RANGE)
        )

    def capabilities(self, controller: str, *, hardware: bool, simulated_time: bool) -> Capabilities:
        """Return the capabilities of a controller with these limits."""
        return Capabilities(
            controller, self.lower, self.upper, self.max_step, self.max_speed, self.max_via, hardware, simulated_time
        )


def check_move(move: Move, start: SetPoints, bounds: Limits | Capabilities) -> tuple[Result, str]:
    """Return the first violated limit of a move and a message, or (OK, ""). Both ends of a wire use this function.

    Args:
        move: the move to check.
        start: (n,) position at the beginning of the move, counts.
        bounds: limits of the controller, or capabilities of its driver.
    """
    points = move.set_points
    if points.shape[1] != len(bounds.lower):
        return Result.LIMIT, f"the move has {points.shape[1]} axes; the controller has {len(bounds.lower)}"
    if bounds.max_via is not None and len(points) > bounds.max_via:
        return Result.TOO_MANY_POINTS, (
            f"the move has {len(points)} via points; the controller accepts at most {bounds.max_via}"
        )
    outside = (points < bounds.lower) | (points > bounds.upper)
    if outside.any():
        row, axis = (int(k) for k in np.argwhere(outside)[0])
        return Result.LIMIT, (
            f"via point {row} has {axis_name(axis)} at {points[row, axis] / PER_DEGREE:.4f} deg; it must lie in "
            f"{bounds.lower[axis] / PER_DEGREE:.4f} to {bounds.upper[axis] / PER_DEGREE:.4f} deg"
        )
    if not 0 < move.speed <= bounds.max_speed:  # NaN too
        return (
            Result.SPEED,
            f"the speed fraction is {move.speed:g}; it must be above 0 and at most {bounds.max_speed:g}",
        )
    steps = np.abs(np.diff(points.astype(np.int64), axis=0, prepend=start[None].astype(np.int64)))
    if (steps > bounds.max_step).any():
        row, axis = (int(k) for k in np.argwhere(steps > bounds.max_step)[0])
        return Result.STEP, (
            f"via point {row} is a step of {steps[row, axis] / PER_DEGREE:.4f} deg on {axis_name(axis)}; it must be at "
            f"most {bounds.max_step[axis] / PER_DEGREE:.4f} deg"
        )
    return Result.OK, ""
