"""Sampled motion along via points: straight joint moves (`planner.timing.move_time`), rest to rest.

Every via point is an exact stop, because a rounded corner would leave the checked path. So the same moves with
trapezoids of speed are the time-optimal motion along the path without a jerk limit (`without_jerk_limit`). The line of
a sweep is the exception: it has its own timing and passes its via points without a stop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.ports import JointLimits
from planner.timing.limits import require_inside, require_usable, scale_limits, without_jerk_limit
from planner.timing.move_time import move_profiles, move_time
from planner.timing.s_curve import Profile, sample_profile
from planner.values import Floats, Ints, Value, freeze, readonly

SAMPLE_PERIOD = 0.012
"""Interpolation cycle of a KR C2 [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion(Value):
    """A timed motion through N via points, at rest at each except inside the line of a sweep.

    Samples are evenly spaced inside a move, at most `sample_period` apart, and every via point is a sample. A sample
    at a via point belongs to the move that ends there.

    Attributes:
        via_q: (N, axes) via points [rad], KUKA signs.
        segment: (N,) number of the tour's segment that ends at or passes the via point; not decreasing.
        view: (N,) view taken at the via point, -1 for none (home, and via points of a detour).
        via_t: (N,) times at which the via points are reached [s].
        t: (M,) sample times [s], increasing from 0.
        q: (M, axes) joint angles [rad].
        qd: (M, axes) joint speeds [rad/s].
        qdd: (M, axes) joint accelerations [rad/s^2] that begin at the sample; 0 at the last one.
        segment_of_sample: (M,) number of the segment to which the sample belongs.
        duration: time from first to last via point [s].
        limits: the limits in use, after scaling.
        pose: (N,) pose of the view taken at the via point: 0 for a view at rest, -1 for none.
        line: (N,) number, from 0, of the sweep line that reaches the via point; -1 for a joint move.
    """

    via_q: Annotated[Floats, "N axes"]
    segment: Annotated[Ints, "N"]
    view: Annotated[Ints, "N"]
    via_t: Annotated[Floats, "N"]
    t: Annotated[Floats, "M"]
    q: Annotated[Floats, "M axes"]
    qd: Annotated[Floats, "M axes"]
    qdd: Annotated[Floats, "M axes"]
    segment_of_sample: Annotated[Ints, "M"]
    duration: float
    limits: JointLimits
    pose: Annotated[Ints, "N"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    line: Annotated[Ints, "N"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if not len(self.pose):
            object.__setattr__(self, "pose", np.where(np.asarray(self.view) >= 0, 0, -1))
        if not len(self.line):
            object.__setattr__(self, "line", np.full(len(self.via_q), -1))
        freeze(self)

    @property
    def stops(self) -> Ints:
        """(n,) via point of each view in driving order: its stop, or the middle pose of its sweep."""
        rows = np.flatnonzero(self.view >= 0)
        groups = np.split(rows, np.flatnonzero(np.diff(self.view[rows])) + 1) if len(rows) else []
        return np.array([group[self.pose[group] == len(group) // 2][0] for group in groups], dtype=np.int64)


class TimedLine(Protocol):
    """The line of a sweep, from rest to rest, with its own timing."""

    @property
    def times(self) -> Floats:
        """(m,) times of its via points after its start [s], from 0; the last is its duration."""

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (n, axes) angles [rad], speeds [rad/s], accelerations [rad/s^2] at (n,) times from its start [s]."""


def retime(
    via_q: ArrayLike,
    segment: ArrayLike,
    view: ArrayLike,
    limits: JointLimits,
    sample_period: float = SAMPLE_PERIOD,
    *,
    speed: float = 1.0,
    acceleration: float = 1.0,
    pose: ArrayLike | None = None,
    lines: Mapping[int, TimedLine] | None = None,
) -> Motion:
    """Time a motion that stops at every via point except inside the lines of sweeps.

    Args:
        via_q: (N, axes) via points [rad], N >= 1, inside the joint range.
        segment: (N,) number of the tour's segment that ends at or passes each via point; not decreasing.
        view: (N,) view taken at each via point, -1 for none.
        limits: limits of the axes.
        sample_period: largest time between samples [s].
        speed: fraction of the velocity limits, in (0, 1].
        acceleration: fraction of the acceleration and jerk limits, in (0, 1].
        pose: (N,) pose of the view taken at each via point; None: every view is one pose.
        lines: sweep lines by the number of their first via point; the following via points are theirs.

    Returns:
        The motion; a via point that repeats its predecessor takes no time and adds no sample.
    """
    require_usable(limits)
    limits = scale_limits(limits, speed, acceleration)
    if not 0 < sample_period < np.inf:
        raise PlannerError(f"the sample period is {sample_period} s; it must be above 0 and finite")
    vias = readonly("via_q", via_q, (None, len(limits.lower)))
    if len(vias) == 0:
        raise PlannerError("via_q is empty; a motion needs at least one via point")
    require_inside("via point", vias, limits)
    segments = readonly("segment", segment, (len(vias),), np.int64)
    if (np.diff(segments) < 0).any():
        raise PlannerError(
            "segment decreases along the via points; the segments of a tour must be numbered in driving order"
        )

    widths = np.zeros((3, len(vias) - 1))
    for rows, profile in move_profiles(vias[:-1], vias[1:], limits):
        widths[:, *rows] = profile
    durations, lines = Profile(*widths).duration, lines or {}
    on_line = _take_line_times(lines, durations)
    via_t = np.concatenate(([0.0], np.cumsum(durations)))
    samples, owner = [(np.zeros(1), vias[:1], np.zeros_like(vias[:1]), np.zeros_like(vias[:1]))], [segments[:1]]
    for k in np.flatnonzero(durations > 0).tolist():
        if on_line[k + 1] < 0:
            piece = _sample_move(Profile(*widths[:, k]), vias[k : k + 2], via_t[k : k + 2], sample_period)
        elif k in lines:
            line_rows = slice(k, k + len(lines[k].times))
            piece = _sample_line(lines[k], vias[line_rows], via_t[line_rows], sample_period)
        else:
            continue  # sampled with the first piece of the line
        times, q, qd, qdd = piece
        samples[-1][-1][-1] = qdd[0]  # the acceleration that begins at the stop replaces the one that ends there
        samples.append((times[1:], q[1:], qd[1:], qdd[1:]))
        owner.append(np.full(len(times) - 1, segments[k + 1]))
    samples[-1][-1][-1] = 0.0
    t, q, qd, qdd = map(np.concatenate, zip(*samples, strict=True))
    return Motion(
        via_q=vias,
        segment=segments,
        view=readonly("view", view, (len(vias),), np.int64),
        via_t=via_t,
        t=t,
        q=q,
        qd=qd,
        qdd=qdd,
        segment_of_sample=np.concatenate(owner),
        duration=float(via_t[-1]),
        limits=limits,
        pose=np.zeros(0, dtype=np.int64) if pose is None else readonly("pose", pose, (len(vias),), np.int64),
        line=on_line,
    )


def _take_line_times(lines: Mapping[int, TimedLine], durations: Floats) -> Ints:
    """Return (N,) the line that reaches each via point, -1 for none; write the times of the lines into `durations`."""
    on_line = np.full(len(durations) + 1, -1)
    for number, begin in enumerate(sorted(lines)):
        times = lines[begin].times
        if begin + len(times) > len(on_line) or (on_line[begin + 1 : begin + len(times)] >= 0).any():
            raise PlannerError(
                f"the line that begins at via point {begin} has {len(times)} via points, and there is no room for them"
            )
        on_line[begin + 1 : begin + len(times)] = number
        durations[begin : begin + len(times) - 1] = np.diff(times)
    return on_line


_Samples = tuple[Floats, Floats, Floats, Floats]
"""(m,) times [s]; (m, axes) angles, speeds and accelerations [rad], [rad/s], [rad/s^2]; both ends included."""


def _sample_move(profile: Profile, ends: Floats, end_t: Floats, period: float) -> _Samples:
    """Sample a straight move."""
    steps = max(2, int(np.ceil(profile.duration / period)))
    tau = np.arange(steps + 1) * (profile.duration / steps)
    s, sd, sdd = sample_profile(profile, tau)
    delta = ends[1] - ends[0]
    q = np.clip(ends[0] + s[:, None] * delta, np.minimum(*ends), np.maximum(*ends))
    times = end_t[0] + tau
    q[-1], times[-1] = ends[1], end_t[1]
    return times, q, sd[:, None] * delta, sdd[:, None] * delta


def _sample_line(line: TimedLine, vias: Floats, via_t: Floats, period: float) -> _Samples:
    """Sample a line, also at its via points; its ends are exact."""
    pieces = [
        begin + np.arange(steps := max(1, int(np.ceil((end - begin) / period)))) * ((end - begin) / steps)
        for begin, end in pairwise(via_t)
        if end > begin
    ]
    times = np.concatenate([*pieces, via_t[-1:]])
    q, qd, qdd = (np.array(values) for values in line.at(np.minimum(times - via_t[0], line.times[-1])))
    q[0], q[-1] = vias[0], vias[-1]
    return times, q, qd, qdd


def jerk_free_duration(motion: Motion) -> float:
    """Return the time of the same moves without a jerk limit [s]: a lower bound for any motion along the path.

    The path has corners at its via points, so a motion that keeps to it stops at each; between two stops a trapezoid
    of speed is time-optimal. A sweep has its own speed and keeps its time.
    """
    moves = move_time(motion.via_q[:-1], motion.via_q[1:], without_jerk_limit(motion.limits))
    return float(np.where(motion.line[1:] >= 0, np.diff(motion.via_t), moves).sum())
