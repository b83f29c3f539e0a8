"""What a controller moves: the protocol of a plant, and the ideal one.

The controller owns the reference (`drivers.profile`), a plant follows it. Two sets of axes are told apart: the
*reported* ones, which the controller's encoders see, and the *true* ones, which only a simulation knows and from which
a simulated scanner looks. A controller tells only the first; a simulation asks its plant for the second.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import DriverError
from drivers.profile import TICK, Reference, resting
from drivers.setpoints import AXES, Floats, frozen

ExecutedOffset = Callable[[Floats], Floats]
"""Axis error of a stop: (6,) commanded axes [rad] -> (6,) true minus commanded axes [rad], from a seeded generator."""


class Plant(Protocol):
    """An arm with its servos. It holds no clock: time passes only when the controller says so."""

    @property
    def reported_axes(self) -> Floats:
        """(6,) axes as the encoders see them [rad]."""
        ...

    @property
    def true_axes(self) -> Floats:
        """(6,) axes where the arm really is [rad]."""
        ...

    @property
    def settled(self) -> bool:
        """True where the arm is at rest at the end of its reference, within what the plant calls at rest."""
        ...

    @property
    def failure(self) -> str:
        """Why the arm no longer follows (the simulation diverged, a drive tripped), in words; empty while it does."""
        ...

    def follow(self, reference: Reference) -> None:
        """Take a new reference, whose time 0 is now. It begins where the old one is, with the same speed."""
        ...

    def advance(self, seconds: float) -> None:
        """Let time pass, at least 0 s. After its end a reference stands still."""
        ...


PlantFactory = Callable[[Floats], Plant]
"""Makes a plant that stands at (6,) axes [rad]."""


class IdealPlant:
    """An arm that is exactly where its reference says, whatever the step.

    With `offset`, the true axes carry an error that the reported ones do not: a new one is drawn for each move, grows
    evenly over the move's time in place of the old one, and stays while the arm stands. A move of no length draws none,
    a stop keeps what has grown.

    Args:
        start: (6,) axes at which the arm stands [rad].
        offset: error of the executed pose at the end of a move; None: none.
    """

    def __init__(self, start: ArrayLike, *, offset: ExecutedOffset | None = None) -> None:
        at = np.array(start, dtype=np.float64)
        if at.shape != (AXES,) or not np.isfinite(at).all():
            raise DriverError(f"a plant was started at {at}; it must be {AXES} finite joint angles in radians")
        self._reference, self._elapsed = resting(at), 0.0
        self._offset = offset
        self._error_from, self._error_to, self._error_duration = np.zeros(AXES), np.zeros(AXES), 0.0

    @property
    def reported_axes(self) -> Floats:
        """(6,) axes [rad]: the reference."""
        return np.asarray(self._reference.sample(np.array([self._elapsed]))[0][0])

    @property
    def true_axes(self) -> Floats:
        """(6,) axes [rad]: the reference with the offset."""
        return self.reported_axes + self._error()

    @property
    def settled(self) -> bool:
        """True where the reference has ended."""
        return self._elapsed >= self._reference.duration

    @property
    def failure(self) -> str:
        """Never any."""
        return ""

    def follow(self, reference: Reference) -> None:
        """Take a new reference; draw the error of its end."""
        error = self._error()
        if reference.duration == 0.0 or self._offset is None or not self.settled:
            # No motion, no error asked for, or a braked reference: what has grown stays.
            drawn = error
        else:
            drawn = np.array(self._offset(frozen(reference.end, np.float64)), dtype=np.float64)
            if drawn.shape != (AXES,) or not np.isfinite(drawn).all():
                raise DriverError(f"the executed offset is {drawn}; it must be {AXES} finite angles in radians")
        self._error_from, self._error_to, self._error_duration = error, drawn, reference.duration
        self._reference, self._elapsed = reference, 0.0

    def advance(self, seconds: float) -> None:
        """Go along the reference."""
        if not seconds >= 0:
            raise DriverError(f"a plant was advanced by {seconds} s; time only passes forwards")
        self._elapsed += seconds
        if self._reference.duration - self._elapsed <= TICK:
            self._elapsed = self._reference.duration

    def _error(self) -> Floats:
        share = self._elapsed / self._error_duration if self._error_duration > 0 else 1.0
        return self._error_from + share * (self._error_to - self._error_from)
