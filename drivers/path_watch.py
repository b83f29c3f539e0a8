"""Watch of a moving arm: the reported axes must follow the straight joint segments of the move, in their order.

A point of the path has a deviation from the reported axes, `sum_i |deviation of axis i| / tolerance of axis i`. It may
be one at most. With the tolerance of axis i chosen as a length over the largest distance of any point of the arm from
that axis, no point of the arm is then farther from its place on the path than that length: the displacement by each
axis is at most its angle times that distance.

Progress is monotone. The watch keeps the interval of path points at which the arm can be: its lower end never falls,
and since any earlier reading its upper end rises by at most what an arm with these limits can drive. Each reading
reduces the interval to the points whose deviation is allowed; if none is left, the arm left the path, moved back, or
skipped a via point. The position on the path is measured in seconds at full axis speed.
"""

from typing import Final

import numpy as np

from drivers.contract import Capabilities, Move, RobotState
from drivers.errors import PathError
from drivers.limits import Limits
from drivers.setpoints import PER_DEGREE, Floats, SetPoints, axis_name

LAG_CHANGE: Final = 0.05
"""Largest change of the age [s] of reported axes during a move."""

SPEED_MARGIN: Final = 1.05
"""Factor on the axis speeds for controllers whose clock differs from the client's."""

_ROUNDING = 1e-9  # s


class PathWatch:
    """Watch of one move.

    Args:
        move: the move.
        start: state of the arm before it.
        limits: limits of the arm; the axis speeds count, and the path tolerance.
        able: capabilities of the controller.
        now: time of the client's clock at which the move was sent [s].
    """

    def __init__(self, move: Move, start: RobotState, limits: Limits, able: Capabilities, now: float) -> None:
        points = np.concatenate([start.axes[None], move.set_points]).astype(np.float64)
        self._begin, self._along = points[:-1], np.diff(points, axis=0)
        speed = np.degrees(limits.velocity) * PER_DEGREE * move.speed
        self._time = np.concatenate([[0.0], np.cumsum((np.abs(self._along) / speed).max(axis=1))])
        self._tolerance = limits.path_tolerance.astype(np.float64)
        self._low, self._high = np.maximum(limits.lower, able.lower), np.minimum(limits.upper, able.upper)
        self._low, self._high = np.minimum(self._low, start.axes), np.maximum(self._high, start.axes)
        self._rate, self._lag_change = SPEED_MARGIN * able.time_scale, LAG_CHANGE * able.time_scale
        self._earliest = self._latest = 0.0
        # A reading is made between the previous update and its own: the time since an earlier reading is at most that
        # since the update before it. `_bound` is the smallest `latest - rate * time` of all of them.
        self._previous, self._bound = now, -self._rate * now

    def update(self, axes: SetPoints, now: float) -> None:
        """Process the (n,) reported axes at a time of the client's clock [s].

        Raises:
            PathError: if an axis is outside its limits, or the arm is not on its path.
        """
        self._require_inside(axes)
        limit = self._bound + self._rate * now + self._lag_change
        first = int(np.searchsorted(self._time[1:-1], self._earliest - _ROUNDING))
        last = int(np.searchsorted(self._time[:-1], limit, side="right"))
        s, deviation = self._breakpoints(axes, slice(first, last))
        begin, length = self._time[first:last], np.diff(self._time[first : last + 1])
        enter = np.maximum(begin + _first_allowed(s, deviation) * length, self._earliest)
        leave = np.minimum(begin + _first_allowed(s[:, ::-1], deviation[:, ::-1]) * length, limit)
        allowed = (deviation <= 1.0).any(axis=1) & (enter <= leave + _ROUNDING)
        if not allowed.any():
            raise PathError(self._describe(axes, slice(first, last), limit))
        self._earliest, self._latest = float(enter[allowed].min()), float(leave[allowed].max())
        self._bound = min(self._bound, self._latest - self._rate * self._previous)
        self._previous = now

    def require_end(self, axes: SetPoints) -> None:
        """Raise PathError unless the arm can have passed the whole path by the last update."""
        if self._latest < self._time[-1] - _ROUNDING:
            number = int(np.searchsorted(self._time[1:-1], self._latest))
            ahead = np.abs(self._begin[number] + self._along[number] - axes)
            axis = int((ahead / self._tolerance).argmax())
            raise PathError(
                f"the controller reports the end of the move, but the arm did not pass via point {number + 1} of "
                f"{len(self._begin)}: {axis_name(axis)} is {ahead[axis] / PER_DEGREE:.4f} deg away from it, and the "
                f"limit is {self._tolerance[axis] / PER_DEGREE:.4f} deg; {_CURE}"
            )

    def _require_inside(self, axes: SetPoints) -> None:
        outside = np.maximum(self._low - axes.astype(np.float64), axes - self._high.astype(np.float64))
        axis = int((outside / self._tolerance).argmax())
        if outside[axis] > self._tolerance[axis]:
            low, high = self._low[axis] / PER_DEGREE, self._high[axis] / PER_DEGREE
            raise PathError(
                f"{axis_name(axis)} is at {axes[axis] / PER_DEGREE:.4f} deg during a move, "
                f"{outside[axis] / PER_DEGREE:.4f} deg outside its limits {low:.4f} to {high:.4f} deg; {_CURE}"
            )

    def _breakpoints(self, axes: SetPoints, segments: slice) -> tuple[Floats, Floats]:
        """Return the points (m, n + 2) of segments, as shares, between which the deviation is linear; the deviations.

        They are the ends of a segment and the points at which an axis has no deviation.
        """
        along, ahead = self._along[segments], axes - self._begin[segments]
        own = np.divide(ahead, along, out=np.zeros_like(along), where=along != 0.0)
        ends = np.tile([0.0, 1.0], (len(along), 1))
        s = np.sort(np.clip(np.concatenate([own, ends], axis=1), 0.0, 1.0), axis=1)
        return s, self._ratios(axes, segments, s).sum(axis=2)

    def _ratios(self, axes: SetPoints, segments: slice, s: Floats) -> Floats:
        """Return the deviations (m, k, n) of the axes from points (m, k) of segments, over their tolerances."""
        along, ahead = self._along[segments], axes - self._begin[segments]
        return np.asarray(np.abs(ahead[:, None] - s[:, :, None] * along[:, None]) / self._tolerance)

    def _describe(self, axes: SetPoints, segments: slice, limit: float) -> str:
        """Return the deviation from the nearest point of the path that the arm can have reached, in words."""
        begin, length = self._time[:-1][segments], np.diff(self._time)[segments]
        share = np.divide(
            np.array([[self._earliest], [limit]]) - begin, length, out=np.zeros((2, len(begin))), where=length > 0.0
        )
        share = np.clip(share, 0.0, 1.0)
        s = np.clip(self._breakpoints(axes, segments)[0], share[0, :, None], share[1, :, None])
        ratios = self._ratios(axes, segments, s)
        segment, point = np.unravel_index(ratios.sum(axis=2).argmin(), s.shape)
        nearest: Floats = ratios[segment, point]
        axis = int(nearest.argmax())
        tolerance = self._tolerance[axis] / PER_DEGREE
        s, deviation = (each[:, ::-1] for each in self._breakpoints(axes, slice(segments.stop - 1, None)))
        leave = self._time[segments.stop - 1 : -1] + _first_allowed(s, deviation) * np.diff(
            self._time[segments.stop - 1 :]
        )
        is_ahead = bool(((deviation <= 1.0).any(axis=1) & (leave > limit)).any())
        left, beside = tolerance, ""
        if nearest[axis] <= 1.0:
            left = float(max(1.0 - (nearest.sum() - nearest[axis]), 0.0) * tolerance)
            beside = " beside the deviations of the other axes"
        return (
            f"the arm left the path of its move on the way to via point {segments.start + int(segment) + 1} of "
            f"{len(self._begin)}: {axis_name(axis)} is at {axes[axis] / PER_DEGREE:.4f} deg, "
            f"{nearest[axis] * tolerance:.4f} deg off, and the limit is {left:.4f} deg{beside}; "
            + (_AHEAD if is_ahead else _CURE)
        )


_CURE = (
    "the arm was stopped; the controller must drive all axes together on straight lines through every via point, see "
    "docs/internals/protocol.md"
)

_AHEAD = (
    "the arm was stopped: it is farther on its path than it can be, so the controller skipped a part of it, or is "
    "faster than real time and does not report its time scale"
)


def _first_allowed(s: Floats, deviation: Floats) -> Floats:
    """Return the first point (m,) at which a piecewise linear deviation (m, k) at s (m, k) is at most one."""
    rows, first = np.arange(len(s)), (deviation <= 1.0).argmax(axis=1)
    before = np.maximum(first - 1, 0)
    high, low = deviation[rows, before], deviation[rows, first]
    share = np.divide(high - 1.0, high - low, out=np.ones(len(s)), where=(first > 0) & (high > low))
    return np.asarray(s[rows, before] + share * (s[rows, first] - s[rows, before]))
