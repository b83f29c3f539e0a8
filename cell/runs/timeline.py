"""Compute the timeline that replay and pages play: joint angles over time, with a rest at each view.

It is the plan's motion, or the motion of an execution with the *reported* joint angles. Between two views of an
execution it uses the motion that the execution recorded, else the planned motion between the same views, shifted by the
differences at both views, else a straight joint move, which `notes` states. Angles in radians, KUKA signs; times in
seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cell.runs.run import ExecutedScan, RecordedExecution
from planner.timing.motion import Motion
from planner.values import Floats, Value

REST = 0.6
"""Rest at each view [s]."""

_STRAIGHT_SPEED = 0.8  # speed of the fastest axis in an unrecorded move [rad/s]: slow enough to follow


@dataclass(frozen=True, slots=True)
class Stop:
    """A rest at a view.

    Attributes:
        number: number of the view, from 1 in visiting order of the plan.
        candidate: row of viewpoints.npz.
        begin: start of the rest [s].
        end: end of the rest [s].
        moved: time in motion before it, rests excluded [s].
    """

    number: int
    candidate: int
    begin: float
    end: float
    moved: float


@dataclass(frozen=True, slots=True, eq=False)
class Timeline(Value):
    """Joint angles over time.

    Attributes:
        t: (M,) increasing from 0 [s].
        q: (M, axes) [rad]; linear between samples.
        stops: rests in visiting order.
        notes: sentences about motions that were not recorded.
        n_views: largest number that a view can have, if known.
    """

    t: Annotated[Floats, "M"]
    q: Annotated[Floats, "M axes"]
    stops: tuple[Stop, ...]
    notes: tuple[str, ...] = ()
    n_views: int = 0

    @property
    def duration(self) -> float:
        """Duration with rests [s]."""
        return float(self.t[-1])

    def at(self, t: float) -> Floats:
        """Return the (axes,) joint angles at a time [rad]; the first and last values hold outside."""
        return np.array([np.interp(t, self.t, self.q[:, axis]) for axis in range(self.q.shape[1])])

    def stop_at(self, t: float) -> Stop | None:
        """Return the rest at a time, if there is one."""
        return next((stop for stop in self.stops if stop.begin <= t <= stop.end), None)

    def reached(self, t: float) -> int:
        """Return the number of views reached by a time."""
        return sum(stop.begin <= t for stop in self.stops)

    def moved(self, t: float) -> float:
        """Return the time in motion until a time, rests excluded [s]."""
        rested = sum(min(max(t - stop.begin, 0.0), stop.end - stop.begin) for stop in self.stops)
        return min(max(t, 0.0), self.duration) - rested


def plan_timeline(motion: Motion, rest: float = REST) -> Timeline:
    """Return the timeline of a planned motion with `rest` seconds at each view."""
    film = _Film(motion.q[0], rest)
    begin = motion.t[0]
    for via in motion.stops:
        selected = (motion.t > begin) & (motion.t <= motion.via_t[via])
        film.move(motion.t[selected] - begin, motion.q[selected])
        film.stop(int(motion.view[via]))
        begin = motion.via_t[via]
    remaining = motion.t > begin
    film.move(motion.t[remaining] - begin, motion.q[remaining])
    return film.timeline()


def execution_timeline(
    execution: RecordedExecution, planned: Motion | None, home: Floats, rest: float = REST
) -> Timeline:
    """Return the timeline of an execution.

    Args:
        execution: its scans, in execution order.
        planned: the plan's motion, if there is one.
        home: (axes,) first joint angles if there is no motion [rad].
        rest: rest at each view [s].
    """
    source = execution.motion if execution.motion is not None else planned
    film = _Film(source.q[0] if source is not None else home, rest)
    straight: list[str] = []
    before: ExecutedScan | None = None
    for scan in execution.scans:
        off_before = np.zeros_like(scan.q_reported) if before is None else before.q_reported - before.q_commanded
        off_here = scan.q_reported - scan.q_commanded
        segment = None if source is None else _segment(source, -1 if before is None else before.view, scan.view)
        if segment is None:
            film.go_straight(scan.q_reported)
            straight.append(str(scan.stop))
        else:
            t, q = segment
            share = (t / t[-1])[:, None]
            film.move(t, q + (1 - share) * off_before + share * off_here)
            film.go_straight(scan.q_reported)  # difference between the set-point and the end of the segment
        film.stop(scan.view, scan.stop)
        before = scan
    if before is not None and source is not None:
        segment = _segment(source, before.view, -1)
        if segment is not None:
            t, q = segment
            film.move(t, q + (1 - t / t[-1])[:, None] * (before.q_reported - before.q_commanded))
    notes = list(execution.unreadable)
    if straight:
        notes.append(
            f"the motion to {'view' if len(straight) == 1 else 'views'} {', '.join(straight)} is neither recorded nor "
            "planned in this order; straight joint moves are shown instead, without a collision check"
        )
    return film.timeline(notes, 0 if planned is None else len(planned.stops))


def home_timeline(home: Floats) -> Timeline:
    """Return the timeline of an arm at home, for a run that failed before its motion."""
    return Timeline(np.zeros(1), np.asarray(home)[None], ())


def _segment(motion: Motion, view_from: int, view_to: int) -> tuple[Floats, Floats] | None:
    """Return times from 0 (m,) and angles (m, axes) from one view to the next (-1: home); None if not consecutive."""
    stops = np.concatenate([[0], motion.stops, [len(motion.view) - 1]])
    names = np.concatenate([[-1], motion.view[motion.stops], [-1]])
    for k in range(len(stops) - 1):
        if names[k] == view_from and names[k + 1] == view_to:
            begin, end = motion.via_t[stops[k]], motion.via_t[stops[k + 1]]
            selected = (motion.t > begin) & (motion.t <= end)
            return (motion.t[selected] - begin, motion.q[selected]) if selected.any() else None
    return None


class _Film:
    """A timeline under construction."""

    def __init__(self, q: Floats, rest: float) -> None:
        self._t: list[Floats] = [np.zeros(1)]
        self._q: list[Floats] = [np.asarray(q, dtype=np.float64)[None]]
        self._rest = rest
        self._stops: list[Stop] = []

    def move(self, t: Floats, q: Floats) -> None:
        """Append samples at times relative to now."""
        if len(t):
            self._t.append(self._now + t)
            self._q.append(q)

    def go_straight(self, q: Floats) -> None:
        """Append a straight joint move at slow speed, unless the arm is already there."""
        turn = float(np.abs(q - self._q[-1][-1]).max())
        if turn > 1e-9:
            self.move(np.array([turn / _STRAIGHT_SPEED]), np.asarray(q)[None])

    def stop(self, candidate: int, number: int | None = None) -> None:
        """Append a rest; without a number it gets the next one."""
        begin = self._now
        moved = begin - self._rest * len(self._stops)
        number = len(self._stops) + 1 if number is None else number
        self._stops.append(Stop(number, candidate, begin, begin + self._rest, moved))
        self.move(np.array([self._rest]), self._q[-1][-1:])

    def timeline(self, notes: Sequence[str] = (), n_views: int = 0) -> Timeline:
        """Return the finished timeline."""
        n_views = max([n_views, *(stop.number for stop in self._stops)])
        return Timeline(np.concatenate(self._t), np.concatenate(self._q), tuple(self._stops), tuple(notes), n_views)

    @property
    def _now(self) -> float:
        return float(self._t[-1][-1])
