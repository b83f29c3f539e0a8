"""What a controller moves: the protocol of a plant, and the ideal one.

The controller owns the reference (`drivers.profile`), a plant follows it.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import DriverError
from drivers.profile import TICK, Reference, resting
from drivers.setpoints import AXES, Floats


class Plant(Protocol):
    """An arm with its servos. It holds no clock: time passes only when the controller says so."""

    @property
    def reported_axes(self) -> Floats:
        """(6,) axes as the encoders see them [rad]."""

    @property
    def settled(self) -> bool:
        """True where the arm is at rest at the end of its reference, within what the plant calls at rest."""

    @property
    def failure(self) -> str:
        """Why the arm no longer follows (the simulation diverged, a drive tripped), in words; empty while it does."""

    def follow(self, reference: Reference) -> None:
        """Take a new reference, whose time 0 is now. It begins where the old one is, with the same speed."""

    def advance(self, seconds: float) -> None:
        """Let time pass, at least 0 s. After its end a reference stands still."""


PlantFactory = Callable[[Floats], Plant]
"""Makes a plant that stands at (6,) axes [rad]."""


class IdealPlant:
    """An arm that is exactly where its reference says, whatever the step.

    Args:
        start: (6,) axes at which the arm stands [rad].
    """

    def __init__(self, start: ArrayLike) -> None:
        at = np.array(start, dtype=np.float64)
        if at.ndim != 1 or len(at) < AXES or not np.isfinite(at).all():
            raise DriverError(f"a plant was started at {at}; it must be {AXES} or more finite joint angles in radians")
        self._reference, self._elapsed = resting(at), 0.0

    @property
    def reported_axes(self) -> Floats:
        """(6,) axes [rad]: the reference."""
        if self.settled:
            return self._reference.end
        return np.asarray(self._reference.sample(np.array([self._elapsed]))[0][0])

    @property
    def settled(self) -> bool:
        """True where the reference has ended."""
        return self._elapsed >= self._reference.duration

    @property
    def failure(self) -> str:
        """Never any."""
        return ""

    def follow(self, reference: Reference) -> None:
        """Take a new reference."""
        self._reference, self._elapsed = reference, 0.0

    def advance(self, seconds: float) -> None:
        """Go along the reference."""
        if not seconds >= 0:
            raise DriverError(f"a plant was advanced by {seconds} s; time only passes forwards")
        self._elapsed += seconds
        if self._reference.duration - self._elapsed <= TICK:
            self._elapsed = self._reference.duration
