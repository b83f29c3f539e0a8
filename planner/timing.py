"""Time of synchronised straight joint moves, rest to rest, and the sampled motion along via points.

A move from `q_from` to `q_to` is `q(s) = q_from + s (q_to - q_from)`, s from 0 to 1: all axes start and stop together
and the path is the straight joint segment that was checked for collision. In the path parameter the axis limits become

    ds/dt   <= 1 / max_j |dq_j| / v_j  = 1 / T_v         d2s/dt2 <= 1 / max_j |dq_j| / a_j = 1 / A

and the shortest rest-to-rest profile is a trapezoid of speed (duration `T_v + A / T_v`) where `A <= T_v^2`, else a
triangle (duration `2 sqrt(A)`); see Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots,
2008, section 3.2. Both limits are taken `MARGIN` smaller than given, so that rounding never lifts a sample, or a finite
difference of samples, above a limit.

Every via point is an exact stop: rounding a corner would leave the path that was checked.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.ports import Floats, JointLimits
from planner.readonly import readonly

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

    An infinite velocity is valid (the axis is limited by its acceleration alone), an infinite acceleration is not: its
    motion would jump in speed.

    Raises:
        PlannerError: if a velocity is not positive, an acceleration not positive and finite, or a range is empty.
    """
    for axis in range(6):
        name = f"A{axis + 1}"
        if not limits.velocity[axis] > 0:
            raise PlannerError(f"the velocity limit of {name} is {limits.velocity[axis]} rad/s; it must be above 0")
        if not 0 < limits.acceleration[axis] < np.inf:
            raise PlannerError(
                f"the acceleration limit of {name} is {limits.acceleration[axis]} rad/s^2; it must be above 0 and "
                "finite"
            )
        if not limits.lower[axis] <= limits.upper[axis]:
            raise PlannerError(
                f"the range of {name} is empty: its lower limit {limits.lower[axis]} rad is above its upper limit "
                f"{limits.upper[axis]} rad"
            )


def scaled(limits: JointLimits, speed: float = 1.0, acceleration: float = 1.0) -> JointLimits:
    """Limits with velocity and acceleration reduced to a fraction (the override of a controller).

    Args:
        limits: limits at full speed.
        speed: fraction of every velocity, above 0 up to 1.
        acceleration: fraction of every acceleration, above 0 up to 1.

    Raises:
        PlannerError: if a fraction is outside (0, 1].
    """
    for name, fraction in (("speed", speed), ("acceleration", acceleration)):
        if not 0 < fraction <= 1:
            raise PlannerError(f"the {name} fraction is {fraction}; it must be above 0 and at most 1")
    return JointLimits(limits.lower, limits.upper, limits.velocity * speed, limits.acceleration * acceleration)


def move_time(q_from: ArrayLike, q_to: ArrayLike, limits: JointLimits) -> Floats:
    """Shortest time of the synchronised straight move, rest to rest, over broadcast arrays.

    Args:
        q_from: (..., 6) joint angles [rad].
        q_to: (..., 6) joint angles [rad]; broadcast against `q_from`, so `(n, 1, 6)` and `(m, 6)` give a cost matrix.
        limits: velocity and acceleration limits.

    Returns:
        (...) time [s]; 0 where both ends are equal.
    """
    check_limits(limits)
    ramp, cruise = _profile(np.asarray(q_from, dtype=float), np.asarray(q_to, dtype=float), limits)
    return 2.0 * ramp + cruise


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
        acceleration: fraction of the acceleration limits to use, above 0 up to 1.

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

    ramps, cruises = _profile(vias[:-1], vias[1:], limits)
    durations = 2.0 * ramps + cruises
    via_t = np.concatenate(([0.0], np.cumsum(durations)))
    t, q, qd, qdd, owner = [np.zeros(1)], [vias[:1]], [np.zeros((1, 6))], [np.zeros((1, 6))], [segments[:1]]
    for k in np.flatnonzero(durations > 0):
        steps = max(2, int(np.ceil(durations[k] / sample_period)))
        tau = np.arange(steps + 1) * (durations[k] / steps)
        s, sd, sdd = _sample(float(ramps[k]), float(cruises[k]), tau)
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


def _profile(q_from: Floats, q_to: Floats, limits: JointLimits) -> tuple[Floats, Floats]:
    """Times of one ramp and of the cruise between the ramps (...) [s]; both 0 for a move of length 0."""
    shape = np.broadcast_shapes(q_from.shape, q_to.shape)[:-1]
    at_speed, squared_ramp = np.zeros(shape), np.zeros(shape)
    for axis in range(6):  # axis by axis: no (..., 6) temporary of a whole cost matrix
        distance = np.abs(q_to[..., axis] - q_from[..., axis])
        distance = np.where(distance > RESOLUTION, distance * (1.0 + MARGIN), 0.0)
        np.maximum(at_speed, distance / limits.velocity[axis], out=at_speed)
        np.maximum(squared_ramp, distance / limits.acceleration[axis], out=squared_ramp)
    trapezoid = (squared_ramp <= at_speed**2) & (at_speed > 0)
    ramp = np.asarray(np.sqrt(squared_ramp))
    np.divide(squared_ramp, at_speed, out=ramp, where=trapezoid)
    return ramp, np.where(trapezoid, at_speed - ramp, 0.0)


def _sample(ramp: float, cruise: float, tau: Floats) -> tuple[Floats, Floats, Floats]:
    """Path parameter, its speed and its acceleration at the times tau (K,) after the start of a move."""
    peak = 1.0 / (ramp + cruise)
    slope = peak / ramp
    rest = np.maximum(2.0 * ramp + cruise - tau, 0.0)
    rising, level = tau < ramp, tau < ramp + cruise
    s = np.select(
        [rising, level], [0.5 * slope * tau**2, 0.5 * peak * ramp + peak * (tau - ramp)], 1.0 - 0.5 * slope * rest**2
    )
    sd = np.select([rising, level], [slope * tau, np.full_like(tau, peak)], slope * rest)
    return s, np.minimum(sd, peak), np.select([rising, level], [slope, 0.0], -slope)
