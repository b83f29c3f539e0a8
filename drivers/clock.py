"""Clocks: time is an argument, so that a simulation jumps and a test never sleeps."""

import math
import time
from typing import Protocol

from drivers.errors import DriverError

LONGEST_WAIT = 0.05
"""Longest real time [s] that one wait blocks: a stop from another thread, or Ctrl-C, is seen within it."""


class Clock(Protocol):
    """Monotonic time of a controller, from any zero."""

    @property
    def simulated(self) -> bool:
        """True where waiting takes no real time."""

    def now(self) -> float:
        """Time [s]."""

    def wait(self, seconds: float) -> None:
        """Let up to `seconds` pass. May return early, so the caller looks again and waits for the rest."""


class SimulatedClock:
    """A clock that stands still unless somebody waits: it jumps by exactly what is asked for."""

    simulated = True

    def __init__(self, start: float = 0.0) -> None:
        self._now = float(start)

    def now(self) -> float:
        """Simulated time [s]."""
        return self._now

    def wait(self, seconds: float) -> None:
        """Jump ahead.

        Raises:
            DriverError: if `seconds` is negative or not finite.
        """
        _require_duration(seconds)
        self._now += seconds


class RealTimeClock:
    """The computer's monotonic clock, optionally faster or slower.

    Args:
        speed: seconds of this clock per real second; 1 is real time.
    """

    simulated = False

    def __init__(self, speed: float = 1.0) -> None:
        if not 0 < speed < math.inf:
            raise DriverError(f"the speed of a clock is {speed}; it must be above 0 and finite")
        self._speed, self._zero = float(speed), time.monotonic()

    def now(self) -> float:
        """Time since the clock was made [s]."""
        return (time.monotonic() - self._zero) * self._speed

    def wait(self, seconds: float) -> None:
        """Block, at most `LONGEST_WAIT` of real time.

        Raises:
            DriverError: if `seconds` is negative or not finite.
        """
        _require_duration(seconds)
        time.sleep(min(seconds / self._speed, LONGEST_WAIT))


def _require_duration(seconds: float) -> None:
    if not 0 <= seconds < math.inf:
        raise DriverError(f"a clock was asked to wait {seconds} s; it must be a finite time of at least 0")
