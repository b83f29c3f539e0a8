"""Clocks. Time is an argument, so that a simulation can skip it and a test never sleeps."""

import math
import time
from typing import Protocol

from drivers.errors import DriverError

MAX_WAIT = 0.05
"""Longest real time [s] of one wait: a stop from another thread or Ctrl-C takes effect within it."""


class Clock(Protocol):
    """Monotonic time of a controller, with an arbitrary zero."""

    @property
    def simulated(self) -> bool:
        """True if waiting takes no real time."""

    def now(self) -> float:
        """Return the time [s]."""

    def wait(self, seconds: float) -> None:
        """Let up to `seconds` pass. May return early: the caller checks the time and waits again.

        Raises:
            DriverError: if `seconds` is negative or not finite.
        """


class SimulatedClock:
    """A clock that advances only in `wait`, by exactly the given time."""

    simulated = True

    def __init__(self, start: float = 0.0) -> None:
        self._now = float(start)

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._now

    def wait(self, seconds: float) -> None:
        """Advance by `seconds`."""
        _require_duration(seconds)
        self._now += seconds


class RealTimeClock:
    """The monotonic clock of the computer, optionally scaled.

    Args:
        speed: seconds of this clock per real second.
    """

    simulated = False

    def __init__(self, speed: float = 1.0) -> None:
        if not 0 < speed < math.inf:
            raise DriverError(f"the speed of a clock is {speed}; it must be above 0 and finite")
        self._speed, self._zero = float(speed), time.monotonic()

    def now(self) -> float:
        """Return the time since the clock was made [s]."""
        return (time.monotonic() - self._zero) * self._speed

    def wait(self, seconds: float) -> None:
        """Block for `seconds`, at most `MAX_WAIT` of real time."""
        _require_duration(seconds)
        time.sleep(min(seconds / self._speed, MAX_WAIT))


def _require_duration(seconds: float) -> None:
    if not 0 <= seconds < math.inf:
        raise DriverError(f"a clock cannot wait {seconds} s; the time must be finite and at least 0")
