"""Time of synchronised straight joint moves, rest to rest, and the sampled motion along via points.

A move from `q_from` to `q_to` is `q(s) = q_from + s (q_to - q_from)`, s from 0 to 1: all axes start and stop together
and the path is the straight joint segment that was checked for collision. An axis' limit on speed, acceleration or jerk
divided by its `|dq|` limits s; the smallest over the axes holds, and `planner.s_curve` gives the fastest profile of s
under the three. All limits are taken `MARGIN` smaller than given, so that rounding never lifts a sample, or a finite
difference of samples, above a limit.

Every via point is an exact stop: rounding a corner would leave the path that was checked, and driving it exactly means
to stop there. So the same moves under trapezoids of speed are the time-optimal motion along the path without a limit of
jerk; `jerk_free` gives those limits.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.ports import Floats, JointLimits
from planner.readonly import readonly
from planner.s_curve import Profile, fastest, sample

MARGIN = 1e-8
"""Relative distance kept from the limits; at samples 1 ms apart it is a hundred times the rounding of a second
difference."""

RESOLUTION = 1e-13
"""A joint difference [rad] up to which two angles are equal: their rounding, a millionth of what any controller
resolves."""

SAMPLE_PERIOD = 0.012
"""Interpolation cycle of a KR C2 [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A timed motion through via points, at rest at each of them.

    Samples are spaced evenly inside a move, at most `sample_period` apart, and every via point is a sample. A sample
    at a via point belongs to the move that ends there.

    Attributes:
        via_q: (N, 6) via points [rad], KUKA signs.
        segment: (N,) number of the tour's leg that ends at or passes the via point; not decreasing.
        view: (N,) view taken at the via point, -1 where none is (home, and via points of a detour).
        via_t: (N,) times at which the via points are reached [s].
        t: (M,) sample times [s], increasing from 0.
        q: (M, 6) joint angles [rad].
        qd: (M, 6) joint speeds [rad/s].
        qdd: (M, 6) joint accelerations [rad/s^2] that begin at the sample; 0 at the last one.
        segment_of_sample: (M,) number of the leg to which the sample belongs.
        duration: time from first to last via point [s].
        limits: the limits used, after scaling.
    """

    via_q: Floats
    segment: NDArray[np.int64]
    view: NDArray[np.int64]
    via_t: Floats
    t: Floats
    q: Floats
    qd: Floats
    qdd: Floats
    segment_of_sample: NDArray[np.int64]
    duration: float
    limits: JointLimits

    def __post_init__(self) -> None:
        object.__setattr__(self, "via_q", readonly("via_q", self.via_q, (None, 6)))
        n = len(self.via_q)
        object.__setattr__(self, "segment", readonly("segment", self.segment, (n,), np.int64))
        object.__setattr__(self, "view", readonly("view", self.view, (n,), np.int64))
        object.__setattr__(self, "via_t", readonly("via_t", self.via_t, (n,)))
        object.__setattr__(self, "t", readonly("t", self.t, (None,)))
        m = len(self.t)
        for name in ("q", "qd", "qdd"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (m, 6)))
        segment_of_sample = readonly("segment_of_sample", self.segment_of_sample, (m,), np.int64)
        object.__setattr__(self, "segment_of_sample", segment_of_sample)


def check_limits(limits: JointLimits) -> None:
    """Refuse limits under which no motion can be timed.

    Single limits may be infinite (a speed, an acceleration, a jerk that is not limited), but not acceleration and jerk
    of one axis: its motion would jump in speed.

    Raises:
        PlannerError: if a limit is not above 0, acceleration and jerk of an axis are infinite, or a range is empty.
    """
    positive = (limits.velocity > 0) & (limits.acceleration > 0) & (limits.jerk > 0)
    bounded = np.minimum(limits.acceleration, limits.jerk) < np.inf
    if (positive & bounded & (limits.lower <= limits.upper)).all():
        return
    for axis in range(6):
        name = f"A{axis + 1}"
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


def scaled(limits: JointLimits, speed: float = 1.0, acceleration: float = 1.0) -> JointLimits:
    """Limits with velocity and acceleration reduced to a fraction.

    `speed` is the controller's override: a percentage of the velocity, as KUKA defines $OV_PRO. It leaves accelerations
    as they are, so that an arm at low override stops the sooner. `acceleration` takes the jerk with it: the
    acceleration is reached in the same time.

    Args:
        limits: limits at full speed.
        speed: fraction of every velocity, above 0 up to 1.
        acceleration: fraction of every acceleration and jerk, above 0 up to 1.

    Raises:
        PlannerError: if a fraction is outside (0, 1].
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


def jerk_free(limits: JointLimits) -> JointLimits:
    """The limits without that of the jerk: the bound against which jerk-limited motions are compared."""
    return replace(limits, jerk=np.full(6, np.inf))


def move_time(q_from: ArrayLike, q_to: ArrayLike, limits: JointLimits) -> Floats:
    """Shortest time of the synchronised straight move, rest to rest, over broadcast arrays.

    Args:
        q_from: (..., 6) joint angles [rad].
        q_to: (..., 6) joint angles [rad]; broadcast against `q_from`, so `(n, 1, 6)` and `(m, 6)` give a cost matrix.
        limits: limits of velocity, acceleration and jerk.

    Returns:
        (...) time [s]; 0 where both ends are equal.
    """
    check_limits(limits)
    a, b = np.asarray(q_from, dtype=float), np.asarray(q_to, dtype=float)
    times = np.empty(np.broadcast_shapes(a.shape, b.shape)[:-1])
    for rows, profile in _profiles(a, b, limits):
        times[rows] = profile.duration
    return np.asarray(times[()])


def retime(
    via_q: ArrayLike,
    segment: ArrayLike,
    view: ArrayLike,
    limits: JointLimits,
    sample_period: float = SAMPLE_PERIOD,
    *,
    speed: float = 1.0,
    acceleration: float = 1.0,
) -> Motion:
    """Time a motion that stops exactly at every via point.

    Args:
        via_q: (N, 6) via points [rad], N >= 1, inside the joint range.
        segment: (N,) number of the tour's leg that ends at or passes each via point; not decreasing.
        view: (N,) view taken at each via point, -1 where none is.
        limits: limits of the axes.
        sample_period: largest time between samples [s].
        speed: fraction of the velocity limits to use, above 0 up to 1.
        acceleration: fraction of the acceleration and jerk limits to use, above 0 up to 1.

    Returns:
        The motion; a via point that repeats its predecessor takes no time and adds no sample.

    Raises:
        PlannerError: if a limit cannot be used, a via point lies outside the joint range, or the tags do not fit.
    """
    check_limits(limits)
    limits = scaled(limits, speed, acceleration)
    if not 0 < sample_period < np.inf:
        raise PlannerError(f"the sample period is {sample_period} s; it must be above 0 and finite")
    vias = readonly("via_q", via_q, (None, 6))
    if len(vias) == 0:
        raise PlannerError("via_q is empty; a motion needs at least one via point")
    check_inside("via point", vias, limits)
    segments = readonly("segment", segment, (len(vias),), np.int64)
    if (np.diff(segments) < 0).any():
        raise PlannerError(
            "segment decreases along the via points; the legs of a tour must be numbered in driving order"
        )

    widths = np.zeros((3, len(vias) - 1))
    for rows, profile in _profiles(vias[:-1], vias[1:], limits):
        widths[:, *rows] = profile
    durations = Profile(*widths).duration
    via_t = np.concatenate(([0.0], np.cumsum(durations)))
    t, q, qd, qdd, owner = [np.zeros(1)], [vias[:1]], [np.zeros((1, 6))], [np.zeros((1, 6))], [segments[:1]]
    for k in np.flatnonzero(durations > 0):
        steps = max(2, int(np.ceil(durations[k] / sample_period)))
        tau = np.arange(steps + 1) * (durations[k] / steps)
        s, sd, sdd = sample(Profile(*widths[:, k]), tau)
        delta = vias[k + 1] - vias[k]
        low, high = np.minimum(vias[k], vias[k + 1]), np.maximum(vias[k], vias[k + 1])
        positions = np.clip(vias[k] + s[:, None] * delta, low, high)
        positions[-1] = vias[k + 1]
        qdd[-1][-1] = sdd[0] * delta  # the acceleration that begins at the stop replaces the one that ended there
        times = via_t[k] + tau[1:]
        times[-1] = via_t[k + 1]
        t.append(times)
        q.append(positions[1:])
        qd.append(sd[1:, None] * delta)
        qdd.append(sdd[1:, None] * delta)
        owner.append(np.full(steps, segments[k + 1]))
    qdd[-1][-1] = 0.0
    return Motion(
        via_q=vias,
        segment=segments,
        view=readonly("view", view, (len(vias),), np.int64),
        via_t=via_t,
        t=np.concatenate(t),
        q=np.concatenate(q),
        qd=np.concatenate(qd),
        qdd=np.concatenate(qdd),
        segment_of_sample=np.concatenate(owner),
        duration=float(via_t[-1]),
        limits=limits,
    )


def jerk_free_duration(motion: Motion) -> float:
    """Time of the same moves without a limit of jerk [s]: what any motion along the path needs at least.

    The path has corners at its via points, so driving it exactly means to stop at each; between two stops a trapezoid
    of speed is time-optimal.
    """
    return float(move_time(motion.via_q[:-1], motion.via_q[1:], jerk_free(motion.limits)).sum())


def check_inside(what: str, q: Floats, limits: JointLimits) -> None:
    """Refuse joint angles outside the range; there is no wrap-around of A4 and A6.

    Args:
        what: what the error calls a row of q.
        q: (N, 6) joint angles [rad].
        limits: limits of the axes.

    Raises:
        PlannerError: naming the first row and axis outside.
    """
    outside = ~((q >= limits.lower) & (q <= limits.upper))
    if outside.any():
        row, axis = np.argwhere(outside)[0]
        low, high = np.degrees(limits.lower[axis]), np.degrees(limits.upper[axis])
        raise PlannerError(
            f"{what} {row} has A{axis + 1} at {np.degrees(q[row, axis]):.4f} deg; it must lie in "
            f"{low:.4f} to {high:.4f} deg"
        )


_BLOCK = 8192  # moves that are timed at once: their temporaries stay in the core's cache
_EQUAL_RATIO = 1e-12  # relative differences up to which limits of the axes are in one ratio


def _profiles(q_from: Floats, q_to: Floats, limits: JointLimits) -> Iterator[tuple[tuple[slice, ...], Profile]]:
    """Profiles of all moves, in blocks along the first axis of the broadcast shape.

    Where the limits of all axes are in one ratio (each acceleration reached in the same time, say), the axis that
    limits the speed limits acceleration and jerk as well, and two of the three maxima over the axes are left out.
    """
    shape = np.broadcast_shapes(q_from.shape, q_to.shape)[:-1]
    ends = [np.ascontiguousarray(np.moveaxis(q, -1, 0)) for q in (q_from, q_to)]  # axis by axis
    ends = [q.reshape(6, *[1] * (len(shape) + 1 - q.ndim), *q.shape[1:]) for q in ends]
    slower = 1.0 + MARGIN
    with np.errstate(invalid="ignore"):
        ratios = [limits.velocity / limits.acceleration, limits.velocity / limits.jerk]
    together = [bool(np.isfinite(r).all() and np.ptp(r) <= _EQUAL_RATIO * r.max()) for r in ratios]
    per_row = int(np.prod(shape[1:])) if shape else 1
    step = max(1, _BLOCK // max(per_row, 1))
    for start in range(0, shape[0], step) if shape else (0,):
        rows = (slice(start, start + step),) if shape else ()
        block = (min(step, shape[0] - start), *shape[1:]) if shape else ()
        a, b = ([axis[rows] if axis.ndim and axis.shape[0] > 1 else axis for axis in end] for end in ends)
        at_speed, at_acceleration, at_jerk = np.zeros(block), np.zeros(block), np.zeros(block)
        distance, scratch = np.empty(block), np.empty(block)
        for axis in range(6):
            np.subtract(b[axis], a[axis], out=distance)
            np.abs(distance, out=distance)
            np.multiply(distance, distance > RESOLUTION, out=distance)
            distance *= slower
            np.maximum(at_speed, np.divide(distance, limits.velocity[axis], out=scratch), out=at_speed)
            if not together[0]:
                np.maximum(
                    at_acceleration, np.divide(distance, limits.acceleration[axis], out=scratch), out=at_acceleration
                )
            if not together[1]:
                np.maximum(at_jerk, np.divide(distance, limits.jerk[axis], out=scratch), out=at_jerk)
        if together[0]:
            np.multiply(at_speed, ratios[0].max(), out=at_acceleration)
        if together[1]:
            np.multiply(at_speed, ratios[1].max(), out=at_jerk)
        yield rows, fastest(at_speed, at_acceleration, at_jerk)
