"""The client's half of the contract, the same over every wire: numbering, waiting, refusing, knowing the unknown.

A wire implements `Link`, four small methods; `ControllerClient` makes a `Driver` of it. What it adds:

- **Both sides refuse.** What the capabilities exclude is not even sent.
- **A lost answer** to a move is looked into, never guessed: the state says which number the controller answered last.
  If it is the move's, the move was accepted (or refused: the state says that too). If it is the old one, the same
  number is sent once more, which executes at most once. If the state cannot be read, or says neither, a
  `StateUnknownError` says so, and until a stop has been confirmed and the arm seen standing only `state()` and
  `stop()` are possible.
- **A restarted controller, or another client**, is noticed before the next command by its last number or its boot
  number; then too only `state()` and `stop()` are possible until a stop was confirmed.
- **Ctrl-C**, or any other exception while waiting, is a controlled stop before it goes on.
"""

import contextlib
import threading
from types import TracebackType
from typing import Protocol, Self

from drivers.clock import Clock
from drivers.commands import Answer, Command, Move, Reset, Result, Stop, next_sequence, sentence_of
from drivers.contract import Capabilities, Mode, RobotState
from drivers.errors import (
    DriverError,
    EmergencyStopError,
    FaultError,
    LinkError,
    LinkLostError,
    NotConnectedError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
    StoppedError,
)
from drivers.limits import refuse
from drivers.setpoints import SetPoints, text

_STOP_TRIES = 4
"""How often a stop is sent before its failure is raised."""


class Link(Protocol):
    """One wire to one controller. It raises only `LinkError`s, and never repeats a command by itself."""

    def open(self) -> Capabilities:
        """Open the wire and make sure that a controller of ours answers."""

    def close(self) -> None:
        """Give the wire back; may be called twice."""

    def send(self, sequence: int, command: Command) -> Answer:
        """Send one command once and wait for the answer that carries its number."""

    def state(self) -> RobotState:
        """Read the state. Reading is harmless, so a link may ask again by itself before it gives up."""

    def time_to_wait(self) -> float:
        """Time [s] after which asking for the state again makes sense."""


class ControllerClient:
    """A `Driver` over any link; its methods are documented by `drivers.contract.Driver`.

    Args:
        link: the wire.
        clock: with which it waits.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link, self._clock = link, clock
        self._lock = threading.RLock()  # around each exchange, never while waiting: a stop gets through
        self._capabilities: Capabilities | None = None
        self._sequence = 0  # the last number used
        self._acknowledged = 0  # the last number whose answer is known
        self._boot = 0  # which run of the controller that was
        self._unknown = ""

    def connect(self) -> None:
        """Open the wire and continue the controller's numbering."""
        with self._lock:
            if self._capabilities is not None:
                return
            capabilities = self._link.open()
            try:
                state = self._link.state()
            except BaseException:
                self._link.close()
                raise
            self._agree(state)
            self._capabilities = capabilities

    def close(self) -> None:
        """Stop an arm that moves, and give the wire back."""
        if self._capabilities is None:
            return
        try:
            if self._unknown or self.state().busy:
                self.stop()
        except LinkError:
            pass  # the wire is gone; the controller's own watchdog stops the arm
        finally:
            self._capabilities = None
            self._link.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def capabilities(self) -> Capabilities:
        """What the controller accepts."""
        if self._capabilities is None:
            raise NotConnectedError("the driver is not connected; use it inside 'with', or call connect() first")
        return self._capabilities

    def state(self) -> RobotState:
        """The controller's state now."""
        with self._lock:
            _ = self.capabilities
            return self._link.state()

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points and return when the arm stands at the last one."""
        command = Move(set_points, speed)
        with self._lock:
            state = self._require_known()
            result, detail = refuse(command, state.axes, self.capabilities)
            if result is not Result.OK:
                raise RefusedError(detail, result)
            try:
                sequence = self._send_surely(command)
            except DriverError:
                raise
            except BaseException:  # Ctrl-C while the answer was on its way: the arm may move
                with contextlib.suppress(DriverError):
                    self.stop()
                raise
        return self._wait_for_end(sequence)

    def stop(self) -> RobotState:
        """Brake on the path and return when the arm stands."""
        with self._lock:
            _ = self.capabilities
            self._sequence = next_sequence(self._sequence)
            for left in reversed(range(_STOP_TRIES)):
                try:
                    self._link.send(self._sequence, Stop())
                    break
                except LinkError:  # stopping twice is stopping
                    if not left:
                        raise
        while not (state := self.state()).standing:
            self._pause()
        with self._lock:
            self._agree(state)
        return state

    def reset(self) -> RobotState:
        """Clear a latched fault."""
        with self._lock:
            _ = self._require_known()
            self._send_surely(Reset())
            return self._link.state()

    def _agree(self, state: RobotState) -> None:
        """Go on from where the controller is."""
        self._unknown = ""
        self._sequence = self._acknowledged = state.ack_sequence
        self._boot = state.boot

    def _require_known(self) -> RobotState:
        """The state now, if it is the one that this client left.

        Raises:
            StateUnknownError: if not.
        """
        _ = self.capabilities
        if not self._unknown:
            state = self._link.state()
            if not (foreign := self._foreign(state)):
                return state
            self._unknown = foreign
        raise StateUnknownError(f"{self._unknown}; only reading and stopping are possible, so stop() first")

    def _foreign(self, state: RobotState) -> str:
        """Why this is not the controller that this client left; empty if it is."""
        if state.boot != self._boot:
            return "the controller was restarted"
        if state.ack_sequence not in (self._acknowledged, self._sequence):
            return (
                f"the controller last answered command {state.ack_sequence}, neither {self._acknowledged} nor "
                f"{self._sequence}: it was restarted, or another client talks to it"
            )
        return ""

    def _send_surely(self, command: Command) -> int:
        """Send a command under a new number, find out what became of it if no answer comes, and return the number.

        Raises:
            RefusedError: if it was refused.
            StateUnknownError: if it cannot be found out.
        """
        self._sequence = next_sequence(self._sequence)
        answer = self._answer_to(self._sequence, command)
        self._acknowledged = self._sequence
        if answer.result != Result.OK:
            raise RefusedError(answer.sentence, answer.result)
        return self._sequence

    def _answer_to(self, sequence: int, command: Command) -> Answer:
        failure: LinkError
        for _ in range(2):
            try:
                return self._link.send(sequence, command)
            except LinkLostError as error:
                failure = error
                break
            except LinkError as error:  # no answer, or none that could be read
                failure = error
            try:
                state = self._link.state()
            except LinkError as error:
                failure = error
                break
            if foreign := self._foreign(state):
                failure = ProtocolError(foreign)
                break
            if state.ack_sequence == sequence:
                return Answer(sequence, state.ack_result)
        raise self._state_unknown(f"whether command {sequence} was executed is not known", failure) from failure

    def _wait_for_end(self, sequence: int) -> RobotState:
        """Wait until a move ended and the arm stands."""
        try:
            while (state := self.state()).busy:
                self._pause()
        except LinkError as error:
            raise self._state_unknown(f"how far move {sequence} went is not known", error) from error
        except DriverError:
            raise
        except BaseException:  # Ctrl-C above all
            with contextlib.suppress(DriverError):
                self.stop()
            raise
        if state.done_sequence != sequence:
            lost = ProtocolError(
                f"the controller says that move {state.done_sequence} ended last: it was restarted, or another client "
                "moved it"
            )
            raise self._state_unknown(f"how move {sequence} ended is not known", lost) from lost
        if state.done_result == Result.OK:
            return state
        if state.done_result == Result.STOPPED:
            raise StoppedError(f"the move was stopped; the arm stands at {text(state.axes)}")
        kind = EmergencyStopError if state.mode is Mode.EMERGENCY_STOP else FaultError
        reason = state.fault_sentence or sentence_of(state.done_result)
        raise kind(f"{reason}; the arm stands at {text(state.axes)}", state.fault_code)

    def _state_unknown(self, what: str, failure: LinkError) -> StateUnknownError:
        self._unknown = f"{what} ({failure})"
        return StateUnknownError(f"{self._unknown}; only reading and stopping are possible")

    def _pause(self) -> None:
        with self._lock:
            seconds = self._link.time_to_wait()
        self._clock.wait(seconds)
