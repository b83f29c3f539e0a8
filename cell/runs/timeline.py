"""What replay shows when: joint angles over the time of the show, and the stops at which the scanner looks.

The show is the plan's motion, or an execution's, with a rest at each stop so that the eye can follow. An execution is
shown with the angles that its controller *reported*; between two stops it takes the motion that it recorded itself,
else the plan's motion between the same two views (shifted by what the two stops were off), else a straight joint move,
which `notes` tells. Angles in radians, KUKA signs; times in seconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cell.runs.run import ExecutedScan, RecordedExecution
from planner.timing.motion import Motion
from planner.values import Floats, Value

REST = 0.6
"""How long the show rests at a stop [s]."""

_STRAIGHT_SPEED = 0.8  # fastest axis of a move that nobody recorded [rad/s]: slow enough to follow


@dataclass(frozen=True, slots=True)
class Stop:
    """A place where the scanner looks.

    Attributes:
        number: from 1, in visiting order of the plan.
        candidate: row of viewpoints.npz.
        begin: when the show arrives [s].
        end: when it leaves [s].
        moved: time that the robot has been moving by then [s], rests left out.
    """

    number: int
    candidate: int
    begin: float
    end: float
    moved: float


@dataclass(frozen=True, slots=True, eq=False)
class Timeline(Value):
    """Joint angles over the time of the show.

    Attributes:
        t: (M,) increasing from 0 [s].
        q: (M, axes) [rad]; straight between samples.
        stops: in visiting order.
        notes: sentences about what is not as recorded.
        n_views: of the plan, as far as it is known: the largest number that a stop can have.
    """

    t: Annotated[Floats, "M"]
    q: Annotated[Floats, "M axes"]
    stops: tuple[Stop, ...]
    notes: tuple[str, ...] = ()
    n_views: int = 0

    @property
    def duration(self) -> float:
        """Length of the show [s]."""
        return float(self.t[-1])

    def at(self, t: float) -> Floats:
        """(axes,) joint angles at a time [rad]; the first and the last hold before and after."""
        return np.array([np.interp(t, self.t, self.q[:, axis]) for axis in range(self.q.shape[1])])

    def stop_at(self, t: float) -> Stop | None:
        """The stop at which the show rests at a time."""
        return next((stop for stop in self.stops if stop.begin <= t <= stop.end), None)

    def reached(self, t: float) -> int:
        """How many stops have been reached by a time."""
        return sum(stop.begin <= t for stop in self.stops)

    def moved(self, t: float) -> float:
        """Time that the robot has been moving [s], rests left out."""
        rested = sum(min(max(t - stop.begin, 0.0), stop.end - stop.begin) for stop in self.stops)
        return min(max(t, 0.0), self.duration) - rested


def of_plan(motion: Motion, rest: float = REST) -> Timeline:
    """The plan's motion.

    Args:
        motion: timed motion with the views at its via points.
        rest: at each stop [s].
    """
    film = _Film(motion.q[0], rest)
    begin = motion.t[0]
    for via in motion.stops:
        piece = (motion.t > begin) & (motion.t <= motion.via_t[via])
        film.move(motion.t[piece] - begin, motion.q[piece])
        film.stop(int(motion.view[via]))
        begin = motion.via_t[via]
    rest_of_it = motion.t > begin
    film.move(motion.t[rest_of_it] - begin, motion.q[rest_of_it])
    return film.timeline()


def of_execution(execution: RecordedExecution, planned: Motion | None, home: Floats, rest: float = REST) -> Timeline:
    """The motion of an execution through its scans.

    Args:
        execution: its scans, in the order in which they were taken.
        planned: the plan's motion; None where the run has none.
        home: (axes,) joint angles at which the show starts where no motion does [rad].
        rest: at each stop [s].
    """
    source = execution.motion if execution.motion is not None else planned
    film = _Film(source.q[0] if source is not None else home, rest)
    straight: list[str] = []
    before: ExecutedScan | None = None
    for scan in execution.scans:
        off_before = np.zeros_like(scan.q_reported) if before is None else before.q_reported - before.q_commanded
        off_here = scan.q_reported - scan.q_commanded
        leg = None if source is None else _leg(source, -1 if before is None else before.view, scan.view)
        if leg is None:
            film.go_straight(scan.q_reported)
            straight.append(str(scan.view))
        else:
            t, q = leg
            share = (t / t[-1])[:, None]
            film.move(t, q + (1 - share) * off_before + share * off_here)
            film.go_straight(scan.q_reported)  # what the commanded set-point differs from the end of the leg
        film.stop(scan.view, scan.stop)
        before = scan
    if before is not None and source is not None:
        leg = _leg(source, before.view, -1)
        if leg is not None:
            t, q = leg
            film.move(t, q + (1 - t / t[-1])[:, None] * (before.q_reported - before.q_commanded))
    notes = list(execution.unreadable)
    if straight:
        notes.append(
            f"the motion to {'view' if len(straight) == 1 else 'views'} {', '.join(straight)} is neither recorded nor "
            "planned in this order; straight joint moves stand for it and were not checked for collisions"
        )
    return film.timeline(notes, 0 if planned is None else len(planned.stops))


def of_home(home: Floats) -> Timeline:
    """A robot that stands at home: all that a run shows that failed before it had a motion."""
    return Timeline(np.zeros(1), np.asarray(home)[None], ())


def _leg(motion: Motion, view_from: int, view_to: int) -> tuple[Floats, Floats] | None:
    """Times from 0 (m,) and angles (m, axes) between two views that follow each other, -1 is home; None if none do."""
    stops = np.concatenate([[0], motion.stops, [len(motion.view) - 1]])
    names = np.concatenate([[-1], motion.view[motion.stops], [-1]])
    for k in range(len(stops) - 1):
        if names[k] == view_from and names[k + 1] == view_to:
            begin, end = motion.via_t[stops[k]], motion.via_t[stops[k + 1]]
            piece = (motion.t > begin) & (motion.t <= end)
            return (motion.t[piece] - begin, motion.q[piece]) if piece.any() else None
    return None


class _Film:
    """Moves and stops put one after the other."""

    def __init__(self, q: Floats, rest: float) -> None:
        self._t: list[Floats] = [np.zeros(1)]
        self._q: list[Floats] = [np.asarray(q, dtype=np.float64)[None]]
        self._rest = rest
        self._stops: list[Stop] = []

    def move(self, t: Floats, q: Floats) -> None:
        """Append samples; t counts from now."""
        if len(t):
            self._t.append(self._now + t)
            self._q.append(q)

    def go_straight(self, q: Floats) -> None:
        """A straight joint move at a speed that the eye can follow; nothing where it stands there already."""
        turn = float(np.abs(q - self._q[-1][-1]).max())
        if turn > 1e-9:
            self.move(np.array([turn / _STRAIGHT_SPEED]), np.asarray(q)[None])

    def stop(self, candidate: int, number: int | None = None) -> None:
        """Rest here; without a number it is the next one."""
        begin = self._now
        moved = begin - self._rest * len(self._stops)
        number = len(self._stops) + 1 if number is None else number
        self._stops.append(Stop(number, candidate, begin, begin + self._rest, moved))
        self.move(np.array([self._rest]), self._q[-1][-1:])

    def timeline(self, notes: Sequence[str] = (), n_views: int = 0) -> Timeline:
        """The film so far."""
        n_views = max([n_views, *(stop.number for stop in self._stops)])
        return Timeline(np.concatenate(self._t), np.concatenate(self._q), tuple(self._stops), tuple(notes), n_views)

    @property
    def _now(self) -> float:
        return float(self._t[-1][-1])
