"""Interpolator of the controller: the reference position of the axes during a move, at rest at every via point.

A segment from via point a to b is `q(s) = a + s (b - a)`: all axes start and stop together on the straight joint
segment, and each limit of an axis divided by its `|b - a|` limits s. The fastest profile of s is the S-curve of seven
phases (Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, section 3.4), or the
trapezoid of speed without a jerk limit. With V, A, J the largest `|b - a|` over speed, acceleration and jerk limit,
`ease` is the duration of a phase of changing acceleration, `ramp` that from the beginning of one such phase to the
beginning of the next, and `cruise` the inverse of the peak speed. Every segment ends at rest, exactly on its via point.

Braking stays on the segment's straight line and keeps the limits of acceleration and jerk, those of full override: the
deceleration rises as fast as the jerk allows, holds, and falls as fast to end at rest. This stop is the fastest one:
while the deceleration rises and holds, no stop decelerates more; at a speed u in the last phase no stop may decelerate
more than `sqrt(2 jerk u)` and still come to rest without reversing. The segment's own profile comes to rest at the end
of the segment, so a braking arm comes to rest before it.

A plant follows a `Reference`; a dynamic plant uses its speeds and accelerations for feed-forward.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.setpoints import Floats

_MARGIN = 1e-9
"""Relative distance kept from the limits, so that rounding does not lift a speed above one."""

TICK = 1e-9
"""A reference with no more than this time [s] left has ended: sums of times have rounding errors."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Axis angles, speeds and accelerations over the time since a move began, in pieces of constant jerk of s.

    Attributes:
        via: (N, n) via points [rad], the first one at the start of the move.
        segment: (K,) path segment of each piece; segment k goes from via[k] to via[k + 1].
        begin: (K,) start of each piece [s], not decreasing, the first one 0.
        s: (K, 4) path parameter of the segment at the start of the piece, in [0, 1], its speed [1/s], acceleration
            [1/s^2] and jerk [1/s^3].
        acceleration: (n,) largest axis accelerations [rad/s^2], for braking.
        jerk: (n,) largest axis jerks [rad/s^3], for braking; inf: not limited.
        duration: time until the reference stays at rest [s].
        end: (n,) axes from then on [rad].
    """

    via: Floats
    segment: NDArray[np.int64]
    begin: Floats
    s: Floats
    acceleration: Floats
    jerk: Floats
    duration: float
    end: Floats

    def __post_init__(self) -> None:
        for name in ("via", "segment", "begin", "s", "acceleration", "jerk", "end"):
            array: NDArray[Any] = getattr(self, name)
            array.flags.writeable = False  # only this module makes them: no copy is needed

    def sample(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Evaluate the reference at times t (M,) since the start [s]; before 0 it is at its start.

        Returns:
            (M, n) joint angles [rad], (M, n) speeds [rad/s], (M, n) accelerations [rad/s^2].
        """
        t = np.asarray(t, dtype=np.float64)
        q = np.tile(self.end, (len(t), 1))
        qd, qdd = np.zeros_like(q), np.zeros_like(q)
        moving = t < self.duration
        if moving.any():
            segment, s, sd, sdd = self._path(np.maximum(t[moving], 0.0))
            a, b = self.via[segment], self.via[segment + 1]
            # A rounding error must not move the arm past a via point, which may lie on an axis limit.
            q[moving] = np.clip(a + s[:, None] * (b - a), np.minimum(a, b), np.maximum(a, b))
            qd[moving] = sd[:, None] * (b - a)
            qdd[moving] = sdd[:, None] * (b - a)
        return q, qd, qdd

    def progress(self, t: float) -> float:
        """Return the passed fraction of all segments at time `t`, in [0, 1], each by its path parameter."""
        if t >= self.duration:
            return 1.0
        segment, s, _, _ = self._path(np.array([max(t, 0.0)]))
        return float(segment[0] + s[0]) / (len(self.via) - 1)

    def braking_from(self, t: float) -> "Reference":
        """Return the reference that brakes from time `t` [s] since the start; its own time begins there at 0."""
        if t >= self.duration:
            return resting(self.end)
        segment, *at = self._path(np.array([max(t, 0.0)]))
        s, sd, sdd = (float(values[0]) for values in at)
        if sd <= 0.0:
            return resting(self.sample(np.array([t]))[0][0])
        a, b = self.via[int(segment[0])], self.via[int(segment[0]) + 1]
        distance = np.abs(b - a) * (1.0 + _MARGIN)
        most = 1.0 / float((distance / self.acceleration).max())
        inverse_jerk = float((distance / self.jerk).max())  # 0 without a jerk limit
        # Speed lost while the deceleration rises from -sdd to its peak and falls to 0: (peak^2 - sdd^2 / 2) / jerk.
        gained = 0.5 * sdd * sdd * inverse_jerk
        peak = min(most, math.sqrt((sd + gained) / inverse_jerk)) if inverse_jerk > 0.0 else most
        rise, fall = max(peak + sdd, 0.0) * inverse_jerk, peak * inverse_jerk
        jerk = 1.0 / inverse_jerk if inverse_jerk > 0.0 else 0.0
        hold = max((sd + gained - peak * fall) / peak, 0.0)
        begin, phases = np.zeros(3), np.zeros((3, 4))
        for k, (duration, at_begin, slope) in enumerate(((rise, sdd, -jerk), (hold, -peak, 0.0), (fall, -peak, jerk))):
            phases[k] = s, sd, at_begin, slope
            begin[k + 1 :] += duration
            s += duration * (sd + duration * (at_begin / 2 + duration * slope / 6))
            sd += duration * (at_begin + duration * slope / 2)
        return Reference(
            via=np.stack([a, b]),
            segment=np.zeros(3, dtype=np.int64),
            begin=begin,
            s=phases,
            acceleration=self.acceleration,
            jerk=self.jerk,
            duration=rise + hold + fall,
            end=np.clip(a + min(s, 1.0) * (b - a), np.minimum(a, b), np.maximum(a, b)),
        )

    def _path(self, t: Floats) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
        """Return segment, path parameter, its speed and acceleration at times t (M,), all in [0, duration)."""
        piece = np.searchsorted(self.begin, t, side="right") - 1
        tau = t - self.begin[piece]
        s, sd, sdd, sddd = self.s[piece].T
        s = s + tau * (sd + tau * (sdd / 2 + tau * sddd / 6))
        sd = np.maximum(sd + tau * (sdd + tau * sddd / 2), 0.0)
        return self.segment[piece], np.clip(s, 0.0, 1.0), sd, sdd + tau * sddd


def resting(at: Floats) -> Reference:
    """Return the reference that rests at (n,) axes [rad]."""
    at = np.array(at, dtype=np.float64)
    return Reference(
        via=at[None],
        segment=np.zeros(0, dtype=np.int64),
        begin=np.zeros(0),
        s=np.zeros((0, 4)),
        acceleration=np.full(len(at), np.inf),
        jerk=np.full(len(at), np.inf),
        duration=0.0,
        end=at,
    )


def interpolate(
    start: Floats, via: Floats, velocity: Floats, acceleration: Floats, jerk: Floats | None = None
) -> Reference:
    """Return the fastest reference from rest at `start` through every via point, at rest at each.

    Args:
        start: (n,) axes at the start of the move [rad].
        via: (N, n) via points [rad].
        velocity: (n,) largest axis speeds [rad/s].
        acceleration: (n,) largest axis accelerations [rad/s^2].
        jerk: (n,) largest axis jerks [rad/s^3]; inf, or None for all axes: not limited.
    """
    jerk = np.full(len(start), np.inf) if jerk is None else jerk
    points = np.concatenate([start[None], via])
    distance = np.abs(np.diff(points, axis=0)) * (1.0 + _MARGIN)
    segments = np.flatnonzero(distance.any(axis=1))  # a segment of length 0 takes no time and has no piece
    if len(segments) == 0:
        return resting(points[-1])
    cruise, ramp, ease = _phase_durations(
        *((distance[segments] / limit).max(axis=1) for limit in (velocity, acceleration, jerk))
    )
    zero, up = np.zeros_like(ramp), ramp + ease
    peak, rate = 1.0 / cruise, 1.0 / (cruise * ramp)  # of speed and of acceleration
    change = np.divide(rate, ease, out=zero.copy(), where=ease > 0.0)
    s = np.stack([zero, rate * ease**2 / 6, rate * (0.5 * ramp * (ramp - ease) + ease**2 / 6), 0.5 * peak * up], axis=1)
    sd = np.stack([zero, 0.5 * rate * ease, peak - 0.5 * rate * ease, peak], axis=1)
    # The second half mirrors the first.
    phases = (
        np.concatenate([s, 1.0 - s[:, :0:-1]], axis=1),
        np.concatenate([sd, sd[:, :0:-1]], axis=1),
        np.stack([zero, rate, rate, zero, zero, -rate, -rate], axis=1),
        np.stack([change, zero, -change, zero, -change, zero, change], axis=1),
    )
    ends = np.cumsum(cruise + up)
    marks = np.stack([zero, ease, ramp, up, cruise, cruise + ease, cruise + ramp], axis=1)
    return Reference(
        via=points,
        segment=np.repeat(segments, 7),
        begin=(np.concatenate([[0.0], ends[:-1]])[:, None] + marks).ravel(),
        s=np.stack(phases, axis=-1).reshape(-1, 4),
        acceleration=np.array(acceleration, dtype=np.float64),
        jerk=np.array(jerk, dtype=np.float64),
        duration=float(ends[-1]),
        end=points[-1].copy(),
    )


def _phase_durations(at_speed: Floats, at_acceleration: Floats, at_jerk: Floats) -> tuple[Floats, Floats, Floats]:
    """Return cruise, ramp and ease (L,) [s] of segments with V [s] above 0, A [s^2] above 0, J [s^3] 0 if unlimited."""
    # If the segment is long enough to reach full speed ...
    ease = np.minimum(at_jerk / at_acceleration, np.sqrt(at_jerk / at_speed))
    ramp = np.maximum(at_acceleration / at_speed, ease)
    reached = ramp + ease <= at_speed
    # ... else the two ramps meet at the peak speed: ramp (ramp + ease) = A, or 2 ease^3 = J.
    meet_ease = np.minimum(at_jerk / at_acceleration, np.cbrt(at_jerk / 2))
    meet_ramp = np.maximum(2 * at_acceleration / (meet_ease + np.sqrt(meet_ease**2 + 4 * at_acceleration)), meet_ease)
    ease, ramp = np.where(reached, ease, meet_ease), np.where(reached, ramp, meet_ramp)
    return np.where(reached, at_speed, ramp + ease), ramp, ease
