"""Fastest jerk-limited profile from rest to rest in closed form: the seven-phase S-curve of a path parameter.

A path parameter s runs from 0 to 1 under `ds/dt <= 1/v`, `|d2s/dt2| <= 1/a`, `|d3s/dt3| <= 1/j`; here v [s], a [s^2]
and j [s^3] are inverse limits, so that 0 means "no limit". The profile is a step smoothed by three moving averages of
widths `cruise >= ramp >= ease`, which gives its seven phases. Its peaks are

    speed 1 / cruise,   acceleration 1 / (cruise ramp),   jerk 1 / (cruise ramp ease),   duration cruise + ramp + ease

and each of the three limits is reached unless the move is too short for it. Four cases, each the limit of the next:

    all limits reached            cruise = v, ramp = a / v, ease = j / a            where ramp >= ease, cruise >= both
    acceleration not reached      cruise = v, ramp = ease = sqrt(j / v)             where cruise >= 2 ease
    speed not reached             ease = j / a, cruise = ramp + ease, cruise ramp = a
    neither reached               ramp = ease = cruise / 2 = (j / 2)^(1/3)

Without a jerk limit (j = 0) ease is 0 and the profile is a trapezoid or triangle of speed. The duration is subadditive
in (v, a, j): the sums of the widths of two profiles are ordered and keep the sums of their inverse limits, and the
fastest profile is not slower. The phases are those of Biagiotti and Melchiorri, Trajectory Planning for Automatic
Machines and Robots, 2008, section 3.4; the chain of averages is theirs in Control Engineering Practice 20 (2012), pages
1385 to 1399. Seconds throughout.
"""

from typing import NamedTuple

import numpy as np

from planner.values import Floats


class Profile(NamedTuple):
    """Widths (...) [s] of the three averages, `cruise >= ramp + ease`, `ramp >= ease`; all 0 for a move of length 0.

    A ramp of speed takes `ramp + ease`; the acceleration changes in its first and its last `ease`. The time between the
    ramps is `cruise - ramp - ease`.
    """

    cruise: Floats
    ramp: Floats
    ease: Floats

    @property
    def duration(self) -> Floats:
        """(...) time from rest to rest [s]."""
        return self.cruise + self.ramp + self.ease


def fastest_profile(inverse_speed: Floats, inverse_acceleration: Floats, inverse_jerk: Floats) -> Profile:
    """Return the fastest profile under the three limits.

    Args:
        inverse_speed: (...) v [s], 0 without a limit.
        inverse_acceleration: (...) a [s^2], 0 without a limit.
        inverse_jerk: (...) j [s^3], 0 without a limit; if a is 0 as well, the move has no length.
    """
    v, a, j = inverse_speed, inverse_acceleration, inverse_jerk
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ease = np.where(j > 0.0, j / a, 0.0)  # infinite without an acceleration limit
        ramp = np.where(a > 0.0, a / v, 0.0)
        short = ~(ramp >= ease)
        if short.any():  # full speed is reached before the acceleration limit
            ramp = np.where(short, np.sqrt(j / v), ramp)
            ease_at_speed = np.where(short, ramp, ease)
        else:
            ease_at_speed = ease
        slow = ~(ramp + ease_at_speed <= v)
        if not slow.any():
            return Profile(v, ramp, ease_at_speed)
        # Full speed is not reached; this form of the quadratic root has no cancellation.
        top = 2.0 * a / (ease + np.sqrt(ease * ease + 4.0 * a))
        neither = ~(top >= ease)
        least = np.cbrt(0.5 * j)
        top = np.where(neither, least, top)
        ease = np.where(neither, least, ease)
    cruise = np.where(slow, top + ease, v)
    return Profile(cruise, np.where(slow, top, ramp), np.where(slow, ease, ease_at_speed))


def sample_profile(profile: Profile, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Sample the path parameter, its speed and its acceleration.

    Args:
        profile: one profile (scalars) with a duration above 0.
        t: (K,) times after the start [s], in [0, duration].

    Returns:
        (K,) s, (K,) ds/dt [1/s], (K,) d2s/dt2 [1/s^2]. The acceleration is the one that begins at t, which matters
        without a jerk limit, where it jumps.
    """
    cruise, ramp, ease = (float(width) for width in profile)
    rest = np.maximum(cruise + ramp + ease - t, 0.0)
    early = t < rest  # the second half is the first one backwards; it begins at the middle of a triangle of speed
    tau = np.where(early, t, rest)
    speed = 1.0 / cruise
    acceleration = speed / ramp
    jerk = acceleration / ease if ease > 0.0 else 0.0
    up = ramp + ease
    left = np.maximum(up - tau, 0.0)
    rising = tau < ease
    # Backwards, the acceleration that begins at a time is the one that ends there forwards.
    steady = (tau < ramp) | (~early & (tau <= ramp))
    ending = tau < up
    s = np.select(
        [rising, steady],
        [jerk * tau**3 / 6.0, acceleration * (0.5 * tau * (tau - ease) + ease * ease / 6.0)],
        speed * (tau - 0.5 * up) + jerk * left**3 / 6.0,
    )
    sd = np.select(
        [rising, steady], [0.5 * jerk * tau**2, acceleration * (tau - 0.5 * ease)], speed - 0.5 * jerk * left**2
    )
    sdd = np.select([rising, steady, ending], [jerk * tau, np.full_like(tau, acceleration), jerk * left], 0.0)
    s, sdd = np.where(early, s, 1.0 - s), np.where(early, sdd, -sdd)
    return np.clip(s, 0.0, 1.0), np.clip(sd, 0.0, speed), np.clip(sdd, -acceleration, acceleration)
