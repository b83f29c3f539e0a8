"""The controller's interpolator: where the axes should be at each time of a move, rest to rest through via points.

A leg from via point a to b is `q(s) = a + s (b - a)`: all axes start and stop together on the straight joint segment,
and each limit of an axis divided by its `|b - a|` limits s. The fastest profile of s is the S-curve of seven phases
(Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, section 3.4), or the trapezoid
of speed where jerk is not limited. With V, A, J the largest `|b - a|` over speed, acceleration and jerk limit, a phase
of changing acceleration takes `ease`, the acceleration from one to the next lasts `ramp`, and `cruise` is the inverse
of the peak speed. Every leg ends at rest, exactly on its via point.

Braking stays on the leg's straight line and keeps the limits of acceleration and jerk, those of full override: the
deceleration rises as fast as the jerk allows, holds, and falls as fast to end at rest. No other stop is ever slower on
the way: while the deceleration rises and holds, none decelerates more, and at a speed u in its last phase none may
decelerate more than `sqrt(2 jerk u)` and still come to rest without turning back. The leg's own profile comes to rest
at the leg's end, so a braking arm stands before it.

A plant follows a `Reference`; a dynamic one uses the speeds and accelerations for its feed-forward.
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
"""What is left of a reference when this time [s] or less is left is its end: sums of times have rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Axis angles, speeds and accelerations over the time since a move began, in pieces of constant jerk of s.

    Attributes:
        via: (N, 6) via points [rad], the first one where the move starts.
        leg: (K,) leg of each piece: leg k goes from via[k] to via[k + 1].
        begin: (K,) start of each piece [s], not decreasing, the first one 0.
        s: (K, 4) path parameter of the leg where the piece begins, in [0, 1], its speed [1/s], acceleration [1/s^2]
            and jerk [1/s^3] there.
        acceleration: (6,) largest axis accelerations [rad/s^2], for braking.
        jerk: (6,) largest axis jerks [rad/s^3], for braking; inf: not limited.
        duration: time until the reference is at rest for good [s].
        end: (6,) axes from then on [rad].
    """

    via: Floats
    leg: NDArray[np.int64]
    begin: Floats
    s: Floats
    acceleration: Floats
    jerk: Floats
    duration: float
    end: Floats

    def __post_init__(self) -> None:
        for name in ("via", "leg", "begin", "s", "acceleration", "jerk", "end"):
            array: NDArray[Any] = getattr(self, name)
            array.flags.writeable = False  # made by this module alone, so nothing is copied

    def sample(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Reference motion at any times.

        Args:
            t: (M,) times since the move began [s]; before 0 it is at its start, after `duration` at its end.

        Returns:
            (M, 6) joint angles [rad], (M, 6) speeds [rad/s], (M, 6) accelerations [rad/s^2].
        """
        t = np.asarray(t, dtype=np.float64)
        q, qd, qdd = (
            np.tile(self.end, (len(t), 1)),
            np.zeros((len(t), len(self.end))),
            np.zeros((len(t), len(self.end))),
        )
        moving = t < self.duration
        if moving.any():
            leg, s, sd, sdd = self._path(np.maximum(t[moving], 0.0))
            a, b = self.via[leg], self.via[leg + 1]
            # Rounding must not carry the arm past a via point, which may lie on an axis limit.
            q[moving] = np.clip(a + s[:, None] * (b - a), np.minimum(a, b), np.maximum(a, b))
            qd[moving] = sd[:, None] * (b - a)
            qdd[moving] = sdd[:, None] * (b - a)
        return q, qd, qdd

    def share(self, t: float) -> float:
        """Share of the legs that is passed at time `t`, in [0, 1]: whole legs, and the path parameter of the next."""
        if t >= self.duration:
            return 1.0
        leg, s, _, _ = self._path(np.array([max(t, 0.0)]))
        return float(leg[0] + s[0]) / (len(self.via) - 1)

    def braked(self, t: float) -> "Reference":
        """The reference that brakes from time `t` on; its own time begins at 0 there.

        Args:
            t: time since the move began [s].
        """
        if t >= self.duration:
            return resting(self.end)
        legs, *at = self._path(np.array([max(t, 0.0)]))
        s, sd, sdd = (float(values[0]) for values in at)
        if sd <= 0.0:
            return resting(self.sample(np.array([t]))[0][0])
        a, b = self.via[int(legs[0])], self.via[int(legs[0]) + 1]
        distance = np.abs(b - a) * (1.0 + _MARGIN)
        most = 1.0 / float((distance / self.acceleration).max())
        inverse_jerk = float((distance / self.jerk).max())  # 0 where jerk is not limited
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
            leg=np.zeros(3, dtype=np.int64),
            begin=begin,
            s=phases,
            acceleration=self.acceleration,
            jerk=self.jerk,
            duration=rise + hold + fall,
            end=np.clip(a + min(s, 1.0) * (b - a), np.minimum(a, b), np.maximum(a, b)),
        )

    def _path(self, t: Floats) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
        """Leg, path parameter, its speed and its acceleration at the times t (M,), all in [0, duration)."""
        piece = np.searchsorted(self.begin, t, side="right") - 1
        tau = t - self.begin[piece]
        s, sd, sdd, sddd = self.s[piece].T
        s = s + tau * (sd + tau * (sdd / 2 + tau * sddd / 6))
        sd = np.maximum(sd + tau * (sdd + tau * sddd / 2), 0.0)
        return self.leg[piece], np.clip(s, 0.0, 1.0), sd, sdd + tau * sddd


def resting(at: Floats) -> Reference:
    """The reference that stands still at (6,) axes [rad]."""
    at = np.array(at, dtype=np.float64)
    return Reference(
        via=at[None],
        leg=np.zeros(0, dtype=np.int64),
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
    """The fastest reference from rest at `start` through every via point, stopping at each.

    Args:
        start: (6,) axes where the move begins [rad].
        via: (N, 6) via points [rad].
        velocity: (6,) largest axis speeds [rad/s].
        acceleration: (6,) largest axis accelerations [rad/s^2].
        jerk: (6,) largest axis jerks [rad/s^3]; inf, or None for all axes: not limited.
    """
    jerk = np.full(len(start), np.inf) if jerk is None else jerk
    points = np.concatenate([start[None], via])
    distance = np.abs(np.diff(points, axis=0)) * (1.0 + _MARGIN)
    legs = np.flatnonzero(distance.any(axis=1))  # a leg of length 0 takes no time and has no piece
    if len(legs) == 0:
        return resting(points[-1])
    cruise, ramp, ease = _widths(*((distance[legs] / limit).max(axis=1) for limit in (velocity, acceleration, jerk)))
    zero, up = np.zeros_like(ramp), ramp + ease
    peak, rate = 1.0 / cruise, 1.0 / (cruise * ramp)  # of speed and of acceleration
    change = np.divide(rate, ease, out=zero.copy(), where=ease > 0.0)
    s = np.stack([zero, rate * ease**2 / 6, rate * (0.5 * ramp * (ramp - ease) + ease**2 / 6), 0.5 * peak * up], axis=1)
    sd = np.stack([zero, 0.5 * rate * ease, peak - 0.5 * rate * ease, peak], axis=1)
    # The second half is the first one backwards.
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
        leg=np.repeat(legs, 7),
        begin=(np.concatenate([[0.0], ends[:-1]])[:, None] + marks).ravel(),
        s=np.stack(phases, axis=-1).reshape(-1, 4),
        acceleration=np.array(acceleration, dtype=np.float64),
        jerk=np.array(jerk, dtype=np.float64),
        duration=float(ends[-1]),
        end=points[-1].copy(),
    )


def _widths(at_speed: Floats, at_acceleration: Floats, at_jerk: Floats) -> tuple[Floats, Floats, Floats]:
    """Cruise, ramp and ease (L,) [s] of legs whose V [s] is above 0, A [s^2] above 0, and J [s^3] 0 without limit."""
    # As if there were room to reach full speed ...
    ease = np.minimum(at_jerk / at_acceleration, np.sqrt(at_jerk / at_speed))
    ramp = np.maximum(at_acceleration / at_speed, ease)
    reached = ramp + ease <= at_speed
    # ... else the speed that is reached has ramps that meet: ramp (ramp + ease) = A, or 2 ease^3 = J.
    meet_ease = np.minimum(at_jerk / at_acceleration, np.cbrt(at_jerk / 2))
    meet_ramp = np.maximum(2 * at_acceleration / (meet_ease + np.sqrt(meet_ease**2 + 4 * at_acceleration)), meet_ease)
    ease, ramp = np.where(reached, ease, meet_ease), np.where(reached, ramp, meet_ramp)
    return np.where(reached, at_speed, ramp + ease), ramp, ease
