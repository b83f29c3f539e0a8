"""What the links over real wires share: a line that is lost is opened again, and greeted again, when it is next used.

Opening again is safe because it only reads: whether the controller is still the one that was left, and what became of
the last command, `drivers.client` finds out from the numbers in the state.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from drivers.clock import Clock
from drivers.commands import Result
from drivers.contract import Capabilities, RobotState
from drivers.errors import AnswerTimeoutError, LinkError, LinkLostError, NotConnectedError, ProtocolError
from drivers.status import SAID_AFTER
from drivers.wire import Patience, Pulse

T = TypeVar("T")


class Line(Protocol):
    """What can be opened and closed."""

    name: str

    def open(self) -> None:
        """Take it."""

    def close(self) -> None:
        """Give it back; may be called twice."""


class ReopeningLink(ABC):
    """Opening, closing, asking again, and the client's watchdog.

    Args:
        line: the port.
        clock: the client's.
        patience: how long to wait.
    """

    def __init__(self, line: Line, clock: Clock, patience: Patience) -> None:
        self._line, self._clock, self._patience = line, clock, patience
        self._pulse = Pulse(clock, patience.watchdog)
        self._capabilities: Capabilities | None = None
        self._is_open = False
        self._busy = False
        self.session = 0  # the one that was taken; 0: this client only reads
        self.deadline = math.inf
        self.say: Callable[[str], None] | None = None  # told what is waited for

    @abstractmethod
    def _ask_for(self) -> int:
        """Take the session, once; the answer's result."""

    @abstractmethod
    def _give_back(self) -> None:
        """Give the session back, once."""

    @abstractmethod
    def _greet(self) -> Capabilities:
        """Make sure that a controller of ours answers on the open line, and read what it accepts."""

    def open(self) -> Capabilities:
        """Open the line and greet the controller."""
        return self._reopen(self._patience.tries)

    def close(self) -> None:
        """Give the line back."""
        self._capabilities, self.session = None, 0
        self._drop()

    def take(self, session: int) -> int:
        """Take a session; asking twice is asking once, so a lost answer is asked for again."""
        before, self.session, result = self.session, session, -1
        try:
            result = self._again(self._ask_for)
        finally:
            if result != Result.OK:
                self.session = before
        return result

    def give(self) -> None:
        """Give the session back; where that is lost, silence ends it."""
        if self.session:
            self._require_open()
            self._give_back()
            self.session = 0

    def time_to_wait(self) -> float:
        """The poll's period."""
        return self._patience.poll if self._busy else 0.0

    def _taken(self, state: RobotState) -> RobotState:
        """A state as read, once its heartbeat has been looked at."""
        try:
            self._pulse.see(state.heartbeat or 0)
        except LinkLostError:
            self._drop()
            raise
        self._busy = state.busy
        return state

    def _again(self, ask: Callable[[], T]) -> T:
        """Ask what is harmless to ask several times, on a line that is opened again if need be.

        It gives up after `tries`, but not before the watchdog's time: earlier, a moving arm has not been stopped by
        the controller's own watchdog, and what became of its move may still be learned.
        """
        began, asked, said = self._clock.now(), 0, self.say is None
        while True:
            try:
                self._require_open()
                return ask()
            except LinkError as error:
                asked += 1
                now = self._clock.now()
                if now >= self.deadline or (asked >= self._patience.tries and now - began >= self._patience.watchdog):
                    raise
                if self.say and not said and now - began > SAID_AFTER:
                    said = True
                    self.say(f"waiting for an answer of the controller ({error})")
                if not isinstance(error, AnswerTimeoutError):  # that one has waited already
                    self._clock.wait(self._patience.poll)

    def _require_open(self) -> None:
        if self._is_open:
            return
        if self._capabilities is None:
            raise NotConnectedError(f"{self._line.name} is not open; connect() first")
        before = self._capabilities
        if not alike(before, self._reopen(1)):
            self._drop()
            self._capabilities = before
            raise ProtocolError(
                f"the controller at {self._line.name} has other limits or another clock than before the line was lost"
            )

    def _reopen(self, tries: int) -> Capabilities:
        self._drop()
        failure = LinkError("nothing was asked")
        for _ in range(tries):
            try:
                self._line.open()
                self._capabilities = self._greet()
            except LinkError as error:
                self._line.close()
                failure = error
                continue
            self._is_open = True
            self._pulse.forget()
            return self._capabilities
        raise failure

    def _drop(self) -> None:
        self._is_open = False
        self._line.close()


def alike(a: Capabilities, b: Capabilities) -> bool:
    """Whether two controllers take the same moves."""
    return (a.max_speed, a.max_via, a.time_scale) == (b.max_speed, b.max_via, b.time_scale) and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("lower", "upper", "max_step")
    )
