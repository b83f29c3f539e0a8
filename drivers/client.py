"""The client's half of the contract, the same over every wire: numbering, waiting, refusing, resolving lost answers.

A wire implements `Link`, a few small methods; `ControllerClient` turns it into a `Driver`. It adds:

- **Refusals.** A move outside the capabilities or the arm's own limits is not sent.
- **One owner.** Moves and resets need the session. The client takes it before the first of them and gives it back at
  the end. A client that loses it (another client stopped the arm, or took it over from a silent owner) sends nothing
  more.
- **Checks of the status** (`drivers.status`): before each move and scan and while waiting, a fault, a contradiction or
  a frozen heartbeat ends the work. A reported fault ends it until a reset, even if it is no longer reported. Every
  wait has a limit. An arrival sooner than possible is an error.
- **The path** (`drivers.path_watch`): an arm that leaves its path or an axis that leaves its limits is stopped.
- **Lost answers** to a move are resolved, never guessed: the state holds the last answered number. If it is the move's,
  the move was accepted (or refused; the state says which). If it is the previous one, the client sends the same number
  once more, which executes at most once. If the state is unreadable or says neither, the client raises
  `StateUnknownError`. Until a stop is confirmed and the arm is at rest, only `state()` and `stop()` are allowed.
- **A restarted controller or another client** is detected before the next command by the boot number, the owner or the
  last number; again only `state()` and `stop()` are allowed until a stop is confirmed.
- **A lost session**: if the owner changes during a move, the arm is stopped before the client ends.
- **Ctrl-C**, or any other exception while waiting, sends a stop and waits one second for its answer.
"""

import contextlib
import math
import secrets
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Final, Protocol, Self

from drivers import status
from drivers.clock import Clock
from drivers.contract import (
    Answer,
    Capabilities,
    Command,
    Mode,
    Move,
    Reset,
    Result,
    RobotState,
    Stop,
    describe_result,
    next_sequence,
)
from drivers.errors import (
    ArrivalError,
    ContradictionError,
    DriverError,
    FaultError,
    LinkError,
    LinkLostError,
    NotConnectedError,
    NotOwnerError,
    OverdueError,
    PathError,
    ProtocolError,
    RefusedError,
    StateUnknownError,
)
from drivers.limits import Limits, check_move
from drivers.path_watch import PathWatch
from drivers.setpoints import SetPoints, format_axes

_STOP_TRIES: Final = 4  # attempts to send a stop before its failure is raised
_MIN_PAUSE: Final = 0.001  # s, for a link without a better value: time must pass for a limit to be reached
_TAKE_PAUSE: Final = 0.1  # s between two attempts to take a session
_RESTRICTED: Final = "only state() and stop() are allowed"


class Link(Protocol):
    """One wire to one controller. It raises only `LinkError`s, and never repeats a command by itself.

    Attributes:
        deadline: time of the client's clock after which the link does not retry by itself.
        began: time of the client's clock at which the last move was sent first, after a transfer of its via points.
        notify: receives messages about long waits; the client sets it.
    """

    deadline: float = math.inf
    began: float = -math.inf
    notify: Callable[[str], None] | None = None

    @abstractmethod
    def open(self) -> Capabilities:
        """Open the wire and check that a controller of this protocol answers."""

    @abstractmethod
    def close(self) -> None:
        """Release the wire; allowed twice."""

    @abstractmethod
    def take(self, session: int) -> int:
        """Take or keep the arm; return the result of the answer. After OK all messages belong to this session."""

    @abstractmethod
    def give(self) -> None:
        """Give the session back if there is one."""

    @abstractmethod
    def send(self, sequence: int, command: Command) -> Answer:
        """Send one command once and wait for the answer with its number."""

    @abstractmethod
    def state(self) -> RobotState:
        """Read the state. Reading is harmless, so a link may retry by itself before it gives up."""

    @abstractmethod
    def time_to_wait(self) -> float:
        """Return the time [s] after which another reading of the state is useful."""


class SequenceLedger:
    """The client's record of its controller: session, boot number and the last sequence numbers.

    Nothing is guessed: an unresolved question is an *uncertainty* in words. While there is one, only reading and
    stopping are allowed.

    Args:
        link: the wire.
        session: session number of the client.
        read: reads the state.

    Attributes:
        session: session number of the client.
        owns: whether the session owns the arm, to the client's knowledge.
        boot: boot number of the controller at the last reconciliation.
        uncertainty: the unresolved question in words; empty if there is none.
    """

    def __init__(self, link: Link, session: int, read: Callable[[], RobotState]) -> None:
        self._link, self._read = link, read
        self.session, self.owns, self.boot, self.uncertainty = session, False, 0, ""
        self._sequence = 0  # the last used number
        self._acknowledged = 0  # the last number with a known answer

    def reconcile(self, state: RobotState) -> None:
        """Adopt the controller's state; every uncertainty ends."""
        self.uncertainty, self.owns, self.boot = "", state.owner == self.session, state.boot
        self._sequence = self._acknowledged = state.ack_sequence

    def next_number(self) -> int:
        """Return a new sequence number."""
        self._sequence = next_sequence(self._sequence)
        return self._sequence

    def require_certain(self) -> None:
        """Raise StateUnknownError while there is an uncertainty."""
        if self.uncertainty:
            raise StateUnknownError(f"{self.uncertainty}; {_RESTRICTED}, so call stop() first")

    def take(self, clock: Clock, notify: Callable[[str], None] | None) -> None:
        """Become the owner of the arm; wait for a silent owner as long as its watchdog may last.

        Raises:
            NotOwnerError: if another client owns the arm and is active, or the status does not show the session.
            RefusedError: if the controller refuses for another reason.
            StateUnknownError: in an uncertainty, and if the controller was restarted since it was connected.
        """
        self.require_certain()
        if self.owns:
            return
        began, has_notified = clock.now(), False
        while (result := self._link.take(self.session)) != Result.OK:
            waited, owner = clock.now() - began, self._link.state().owner
            if result != Result.NOT_OWNER:
                raise RefusedError(f"the controller refuses ownership of the arm: {describe_result(result)}", result)
            if waited > status.TAKE_LIMIT:
                raise NotOwnerError(f"session {owner} owns the arm and its client is active; end that client first")
            if notify and waited > status.NOTIFY_AFTER and not has_notified:
                has_notified = True
                notify(f"waiting for the client of session {owner}, which owns the arm, to end")
            clock.wait(_TAKE_PAUSE)
        granted = clock.now()
        while (state := self._read()).owner != self.session:
            if clock.now() - granted > status.OWNER_LIMIT:
                raise NotOwnerError(
                    f"the controller gave the arm to session {self.session} and still reports {state.owner} as its "
                    f"owner after {status.OWNER_LIMIT:g} s; nothing was moved: end the other client, or correct the "
                    "controller's program"
                )
            clock.wait(_TAKE_PAUSE)
        if state.boot != self.boot:
            self.uncertainty = "the controller was restarted"
            self.require_certain()
        self.reconcile(state)

    def describe_intervention(self, state: RobotState) -> str:
        """Return why this is not the controller as this client left it; empty if it is."""
        if state.boot != self.boot:
            return "the controller was restarted"
        if self.owns and state.owner != self.session:
            cause = f"session {state.owner} owns the arm now" if state.owner else "another client has stopped the arm"
            return f"{cause}; session {self.session} of this client has ended"
        if state.ack_sequence not in (self._acknowledged, self._sequence):
            return (
                f"the controller last answered command {state.ack_sequence}, neither {self._acknowledged} nor "
                f"{self._sequence}: it was restarted, or another client sends commands"
            )
        return ""

    def send(self, command: Command) -> int:
        """Send a command under a new number, resolve a lost answer, and return the number.

        Raises:
            RefusedError: if it was refused.
            NotOwnerError: if the session has ended.
            StateUnknownError: if the answer cannot be resolved.
        """
        sequence = self.next_number()
        answer = self._answer_to(sequence, command)
        if answer.result == Result.NOT_OWNER:
            self.uncertainty = f"session {self.session} of this client has ended"
            raise NotOwnerError(f"{answer.message}: {self.uncertainty}, and nothing is sent before a stop")
        self._acknowledged = sequence
        if answer.result != Result.OK:
            raise RefusedError(f"the controller refused command {sequence}: {answer.message}", answer.result)
        return sequence

    def _answer_to(self, sequence: int, command: Command) -> Answer:
        failure: LinkError
        for is_again in (False, True):
            try:
                answer = self._link.send(sequence, command)
                if not is_again or answer.result != Result.STALE:
                    return answer
                failure = ProtocolError(answer.message)  # the first one has arrived meanwhile: the state has its answer
            except LinkLostError as error:
                failure = error
                break
            except LinkError as error:  # no answer, or an unreadable one
                failure = error
            try:
                state = self._read()
            except LinkError as error:
                failure = error
                break
            if intervention := self.describe_intervention(state):
                failure = ProtocolError(intervention)
                break
            if state.ack_sequence == sequence:
                return Answer(sequence, state.ack_result)
        raise self.mark_unknown(f"the execution of command {sequence} is unknown", failure) from failure

    def mark_unknown(self, uncertainty: str, failure: LinkError) -> StateUnknownError:
        """Record an uncertainty and return the error that reports it."""
        self.uncertainty = f"{uncertainty} ({failure})"
        return StateUnknownError(f"{self.uncertainty}; {_RESTRICTED}")


class ControllerClient:
    """A `Driver` over any link; its methods are documented by `drivers.contract.Driver`.

    Args:
        link: the wire.
        clock: used for all waiting.
        limits: limits of the arm, by which moves are refused and arrivals checked.
        notify: receives a message about a long wait.

    Attributes:
        on_state: receives each state that is read except by `connect` and `close`. An exception that it raises ends a
            move; one that it raises during a stop is raised by `stop` at its end, and elsewhere only notified. None:
            nothing.
    """

    def __init__(
        self, link: Link, clock: Clock, limits: Limits, *, notify: Callable[[str], None] | None = None
    ) -> None:
        self._link, self._clock = link, clock
        self._limits, self._notify = limits, notify
        if notify is not None:
            link.notify = notify
        self.on_state: Callable[[RobotState], None] | None = None
        self._lock = threading.RLock()  # around each exchange, not while the arm moves: a stop gets through
        self._ledger = SequenceLedger(link, secrets.randbelow(65535) + 1, self._read)
        self._capabilities: Capabilities | None = None
        self._heartbeat: int | None = None  # the controller's last one
        self._is_halted = False  # a stop was sent because this client has to end: no second stop is tried
        self._fault: FaultError | None = None  # reported since the last reset
        self._is_in_position = False  # the last move ended, and no stop or reset followed

    def connect(self) -> None:
        """Open the wire and read the state."""
        with self._lock:
            if self._capabilities is not None:
                return
            capabilities = self._link.open()
            try:
                status.require_valid_capabilities(capabilities, len(self._limits.lower))
                state = self._link.state()
                status.require_consistent(state, capabilities)
            except BaseException:
                self._link.close()
                raise
            self._is_halted = self._is_in_position = False
            self._fault = None
            self._ledger.reconcile(state)
            self._capabilities = capabilities

    def close(self) -> None:
        """Stop an arm that moves for this client, and release session and wire."""
        if self._capabilities is None:
            return
        try:
            with self._deadline_in(status.HALT_LIMIT if self._is_halted else math.inf):
                if self._ledger.owns and not self._is_halted:
                    state = self._link.state()
                    if state.owner == self._ledger.session and (self._ledger.uncertainty or state.is_busy):
                        self._stop(self._stop_limit)
                if self._ledger.owns:
                    self._link.give()
        except (LinkError, OverdueError):
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
        """Limits of the controller."""
        if self._capabilities is None:
            raise NotConnectedError("the driver is not connected; use it inside 'with', or call connect() first")
        return self._capabilities

    def state(self) -> RobotState:
        """Return the current state as the controller reports it."""
        with self._lock:
            _ = self.capabilities
            return self._read()

    def take(self) -> None:
        """Become the owner; wait for a silent owner as long as its watchdog may last."""
        with self._lock:
            _ = self.capabilities
            self._ledger.take(self._clock, self._notify)

    def require_ready(self) -> RobotState:
        """Return the state if the arm is at rest without a fault."""
        with self._lock:
            state = self._require_known()
            if fault := status.latched_fault(state):
                raise RefusedError(f"{fault}; reset first", Result.IN_FAULT)
            if self._fault:
                raise RefusedError(
                    f"{self._fault}; it is no longer reported and was not reset: find its cause, then reset",
                    Result.IN_FAULT,
                )
            if state.is_busy:
                raise RefusedError("the arm moves or will move; wait until it is at rest", Result.BUSY)
            if self._is_in_position and state.mode is not Mode.IN_POSITION:
                raise RefusedError(
                    f"the arm was in position after its move, and the controller now reports mode "
                    f"{state.mode.name.lower()}: a stop, a fault or a restart came between; find its cause, then reset",
                    Result.IN_FAULT,
                )
            return state

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points and return when the arm is at rest at the last one."""
        command = Move(set_points, speed)
        with self._lock:
            self.take()
            self._is_halted = False
            state = self.require_ready()
            self._is_in_position = False
            for bounds in (self.capabilities, self._limits):
                result, detail = check_move(command, state.axes, bounds)
                if result is not Result.OK:
                    raise RefusedError(detail, result)
            fastest = status.fastest_duration(command, state, self._limits)
            goal, able = f"the end of a move to {format_axes(command.set_points[-1])}", self.capabilities
            began = self._clock.now()
            try:
                sequence = self._ledger.send(command)
                began = max(began, self._link.began)
                monitor = status.MotionMonitor(self._clock, goal, began, fastest, able.time_scale, self._notify)
                watch = PathWatch(command, state, self._limits, able, began)
            except DriverError:
                raise
            except BaseException:  # Ctrl-C before the answer: the arm may move
                self._halt()
                raise
        return self._wait_for_end(sequence, command, monitor, watch, fastest)

    def stop(self) -> RobotState:
        """Brake on the path and return when the arm is at rest."""
        state, failure = self._brake(self._stop_limit)
        if failure:
            raise failure
        return state

    def reset(self) -> RobotState:
        """Clear a latched fault."""
        with self._lock:
            self.take()
            _ = self._require_known()
            self._ledger.send(Reset())
            self._fault, self._is_in_position = None, False
            return self._read()

    @property
    def _stop_limit(self) -> float:
        return status.STOP_LIMIT / min(self.capabilities.time_scale, 1.0)

    def _read(self) -> RobotState:
        state = self._receive()
        if self.on_state is not None:
            self.on_state(state)
        return state

    def _receive(self) -> RobotState:
        state = self._link.state()
        self._heartbeat = state.heartbeat
        if not self._fault and status.latched_fault(state):
            self._fault = status.fault_error(state)
        return state

    def _read_consistent(self) -> RobotState:
        state = self.state()
        status.require_consistent(state, self.capabilities)
        return state

    def _stop(self, limit: float) -> RobotState:
        """Stop an arm that has a cause to stop; a failure of `on_state` is notified and does not replace the cause."""
        state, failure = self._brake(limit)
        if failure and self._notify:
            self._notify(str(failure))
        return state

    def _brake(self, limit: float) -> tuple[RobotState, Exception | None]:
        """Stop, and return the state at rest and the first failure of `on_state` until then."""
        failure: Exception | None = None
        with self._deadline_in(limit):
            with self._lock:
                _ = self.capabilities
                number = self._ledger.next_number()
                for left in reversed(range(_STOP_TRIES)):
                    try:
                        self._link.send(number, Stop())
                        break
                    except LinkError:  # a repeated stop is harmless
                        if not left or self._clock.now() >= self._link.deadline:
                            raise
            while True:
                with self._lock:
                    state = self._receive()
                try:
                    if self.on_state is not None:
                        self.on_state(state)
                except Exception as error:
                    failure = failure or error
                if status.is_at_rest(state):
                    break
                if self._clock.now() >= self._link.deadline:
                    wrong = status.find_contradiction(state, self.capabilities)
                    raise OverdueError(
                        f"{limit:g} s after a stop the controller does not report the arm at rest"
                        + f" ({wrong})" * bool(wrong)
                        + "; press the emergency stop"
                    )
                self._pause()
        with self._lock:
            self._ledger.reconcile(state)
            self._is_halted = self._is_in_position = False
        return state, failure

    @contextlib.contextmanager
    def _deadline_in(self, seconds: float) -> Iterator[None]:
        """Set the link's deadline after `seconds`, unless it already has an earlier one."""
        before = self._link.deadline
        self._link.deadline = min(before, self._clock.now() + seconds)
        try:
            yield
        finally:
            self._link.deadline = before

    def _halt(self) -> None:
        """Stop within one second; a failure is notified, not raised."""
        try:
            self._stop(status.HALT_LIMIT)
        except DriverError as error:
            if self._notify:
                self._notify(f"the stop was not confirmed ({error}); the controller's watchdog stops the arm")
        self._is_halted = True

    def _require_known(self) -> RobotState:
        """Return the state if this is the controller as this client left it, alive and consistent."""
        capabilities, before = self.capabilities, self._heartbeat
        self._ledger.require_certain()
        state = self._read()
        while state.heartbeat is not None and state.heartbeat == before:  # the link limits this wait
            self._pause()
            state = self._read()
        status.require_consistent(state, capabilities)
        self._ledger.uncertainty = self._ledger.describe_intervention(state)
        self._ledger.require_certain()
        return state

    def _wait_for_end(
        self, sequence: int, move: Move, monitor: status.MotionMonitor, watch: PathWatch, fastest: float
    ) -> RobotState:
        """Wait until a move has ended and the arm is at rest."""
        try:
            while (state := self._read_consistent()).is_busy:
                # The arm brakes, on any client's command.
                has_ended = state.done_sequence == sequence and state.owner in (0, self._ledger.session)
                if not has_ended and (intervention := self._ledger.describe_intervention(state)):
                    self._halt()
                    raise ProtocolError(intervention)
                if self._fault:
                    raise self._stopped_after(self._fault)
                watch.update(state.axes, self._clock.now())
                monitor.update(state)
                self._pause()
            if state.done_sequence != sequence or state.boot != self._ledger.boot:
                raise ProtocolError(
                    f"the controller reports move {state.done_sequence} as the last ended one: it was restarted, or "
                    "another client moved it"
                )
            status.require_completed(state)
            if self._fault:
                raise type(self._fault)(f"{self._fault}; it was reported during the move", self._fault.code)
            status.require_arrived(move, state, monitor.elapsed, fastest)
            watch.update(state.axes, self._clock.now())
            watch.require_end(state.axes)
        except LinkError as error:
            raise self._ledger.mark_unknown(f"the progress of move {sequence} is unknown", error) from error
        except (ContradictionError, OverdueError, ArrivalError, PathError) as error:
            self._halt()
            self._ledger.uncertainty = str(error)
            raise
        except DriverError:
            raise
        except BaseException:  # Ctrl-C above all
            self._halt()
            raise
        self._is_in_position = True
        return state

    def _stopped_after(self, fault: FaultError) -> FaultError:
        """Stop an arm that moves in a fault, and return the error that ends its move.

        A controller brakes by itself; one that does not, or that forgets the fault, must not drive on.
        """
        try:
            end = f"the arm is at rest at {format_axes(self._stop(self._stop_limit).axes)}"
        except DriverError as error:
            end = f"the stop was not confirmed ({error}), so press the emergency stop"
            self._ledger.uncertainty = f"{fault}; {end}"
        return type(fault)(f"{fault}; {end}", fault.code)

    def _pause(self) -> None:
        with self._lock:
            seconds = self._link.time_to_wait()
        self._clock.wait(seconds or _MIN_PAUSE)
