"""The controller's interpolator: where the axes should be at each time of a move, rest to rest through via points.

A leg from via point a to b is `q(s) = a + s (b - a)`: all axes start and stop together on the straight joint segment.
In s the axis limits are `ds/dt <= 1/V`, `V = max_j |b_j - a_j| / v_j`, and `d2s/dt2 <= 1/A`, `A = max_j |b_j - a_j| /
a_j`. The shortest profile from rest to rest is a trapezoid of speed with ramps of `A/V` and a cruise of `V - A/V`
where `A <= V^2`, else two ramps of `sqrt(A)`; see Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines
and Robots, 2008, section 3.2. Every leg ends at rest, exactly on its via point. Braking stays on the leg's straight
line: it only lowers the speed along it, at the same deceleration that the ramps use, so the arm stands before the
leg's end.

A plant follows a `Reference`; a dynamic one uses the speeds and accelerations for its feed-forward.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.setpoints import AXES, Floats

_MARGIN = 1e-9
"""Relative distance kept from the limits, so that rounding does not lift a speed above one."""

TICK = 1e-9
"""What is left of a reference when this time [s] or less is left is its end: sums of times have rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Axis angles, speeds and accelerations over the time since a move began, in pieces of constant acceleration of s.

    Attributes:
        via: (N, 6) via points [rad], the first one where the move starts.
        leg: (K,) leg of each piece: leg k goes from via[k] to via[k + 1].
        begin: (K,) start of each piece [s], not decreasing, the first one 0.
        s: (K,) path parameter of the leg where the piece begins, in [0, 1].
        sd: (K,) its speed there [1/s].
        sdd: (K,) its acceleration [1/s^2].
        duration: time until the reference is at rest for good [s].
        end: (6,) axes from then on [rad].
    """

    via: Floats
    leg: NDArray[np.int64]
    begin: Floats
    s: Floats
    sd: Floats
    sdd: Floats
    duration: float
    end: Floats

    def __post_init__(self) -> None:
        for name in ("via", "leg", "begin", "s", "sd", "sdd", "end"):
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
        q, qd, qdd = np.tile(self.end, (len(t), 1)), np.zeros((len(t), AXES)), np.zeros((len(t), AXES))
        moving = t < self.duration
        if moving.any():
            leg, s, sd, sdd = self._path(np.maximum(t[moving], 0.0))
            a, b = self.via[leg], self.via[leg + 1]
            # Rounding must not carry the arm past a via point, which may lie on an axis limit.
            q[moving] = np.clip(a + s[:, None] * (b - a), np.minimum(a, b), np.maximum(a, b))
            qd[moving] = sd[:, None] * (b - a)
            qdd[moving] = sdd[:, None] * (b - a)
        return q, qd, qdd

    def braked(self, t: float) -> "Reference":
        """The reference that brakes from time `t` on; its own time begins at 0 there.

        Args:
            t: time since the move began [s].
        """
        if t >= self.duration:
            return resting(self.end)
        legs, at, speeds, _ = self._path(np.array([max(t, 0.0)]))
        leg, s, sd = int(legs[0]), float(at[0]), float(speeds[0])
        here = self.sample(np.array([t]))[0][0]
        deceleration = float(np.abs(self.sdd[self.leg == leg]).max())
        if sd <= 0.0:
            return resting(here)
        duration = sd / deceleration
        end_s = min(s + 0.5 * sd * duration, 1.0)
        a, b = self.via[leg], self.via[leg + 1]
        return Reference(
            via=np.stack([a, b]),
            leg=np.zeros(1, dtype=np.int64),
            begin=np.zeros(1),
            s=np.array([s]),
            sd=np.array([sd]),
            sdd=np.array([-deceleration]),
            duration=duration,
            end=np.clip(a + end_s * (b - a), np.minimum(a, b), np.maximum(a, b)),
        )

    def _path(self, t: Floats) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
        """Leg, path parameter, its speed and its acceleration at the times t (M,), all in [0, duration)."""
        piece = np.searchsorted(self.begin, t, side="right") - 1
        tau = t - self.begin[piece]
        s = self.s[piece] + tau * (self.sd[piece] + 0.5 * tau * self.sdd[piece])
        sd = np.maximum(self.sd[piece] + tau * self.sdd[piece], 0.0)
        return self.leg[piece], np.clip(s, 0.0, 1.0), sd, self.sdd[piece]


def resting(at: Floats) -> Reference:
    """The reference that stands still at (6,) axes [rad]."""
    nothing = np.zeros(0)
    return Reference(
        via=np.array(at, dtype=np.float64)[None],
        leg=np.zeros(0, dtype=np.int64),
        begin=nothing,
        s=nothing.copy(),
        sd=nothing.copy(),
        sdd=nothing.copy(),
        duration=0.0,
        end=np.array(at, dtype=np.float64),
    )


def interpolate(start: Floats, via: Floats, velocity: Floats, acceleration: Floats) -> Reference:
    """The shortest reference from rest at `start` through every via point, stopping at each.

    Args:
        start: (6,) axes where the move begins [rad].
        via: (N, 6) via points [rad].
        velocity: (6,) largest axis speeds [rad/s].
        acceleration: (6,) largest axis accelerations [rad/s^2].
    """
    points = np.concatenate([start[None], via])
    distance = np.abs(np.diff(points, axis=0)) * (1.0 + _MARGIN)
    legs = np.flatnonzero(distance.any(axis=1))  # a leg of length 0 takes no time and has no piece
    if len(legs) == 0:
        return resting(points[-1])
    at_speed = (distance[legs] / velocity).max(axis=1)
    ramp_squared = (distance[legs] / acceleration).max(axis=1)
    trapezoid = ramp_squared <= at_speed**2
    ramp = np.where(trapezoid, ramp_squared / at_speed, np.sqrt(ramp_squared))
    cruise = np.where(trapezoid, at_speed - ramp, 0.0)
    peak = 1.0 / (ramp + cruise)
    zero = np.zeros_like(ramp)
    ends = np.cumsum(2.0 * ramp + cruise)
    begins = np.concatenate([[0.0], ends[:-1]])
    return Reference(
        via=points,
        leg=np.repeat(legs, 3),
        begin=np.stack([begins, begins + ramp, begins + ramp + cruise], axis=1).ravel(),
        s=np.stack([zero, 0.5 * peak * ramp, 1.0 - 0.5 * peak * ramp], axis=1).ravel(),
        sd=np.stack([zero, peak, peak], axis=1).ravel(),
        sdd=np.stack([peak / ramp, zero, -peak / ramp], axis=1).ravel(),
        duration=float(ends[-1]),
        end=points[-1].copy(),
    )
