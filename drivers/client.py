"""The client's half of the contract, the same over every wire: numbering, waiting, refusing, knowing the unknown.

A wire implements `Link`, a few small methods; `ControllerClient` makes a `Driver` of it. What it adds:

- **Both sides refuse.** What the capabilities or the arm's own limits exclude is not even sent.
- **One owner.** Moves and resets need the session, which is taken before the first and given back at the end. Who loses
  it (another client stopped the arm, or took it over from a client that was silent) sends nothing more.
- **A status is doubted** (`drivers.status`): before each move and scan and while waiting, faults, contradictions and a
  heartbeat that stands still end the work; every wait has its limit; who arrives sooner than it can has not arrived.
- **A lost answer** to a move is looked into, never guessed: the state says which number the controller answered last.
  If it is the move's, the move was accepted (or refused: the state says that too). If it is the old one, the same
  number is sent once more, which executes at most once. If the state cannot be read, or says neither, a
  `StateUnknownError` says so, and until a stop has been confirmed and the arm seen standing only `state()` and
  `stop()` are possible.
- **A restarted controller, or another client**, is noticed before the next command by the boot number, the owner or the
  last number; then too only `state()` and `stop()` are possible until a stop was confirmed.
- **Ctrl-C**, or any other exception while waiting, is a stop with one second for its answer before it goes on.
"""

import contextlib
import math
import secrets
import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Self

from drivers import arrival, status
from drivers.account import Account
from drivers.clock import Clock
from drivers.commands import Move, Reset, Result, Stop
from drivers.contract import Capabilities, RobotState
from drivers.errors import (
    ArrivalError,
    ContradictionError,
    DriverError,
    LinkError,
    NotConnectedError,
    OverdueError,
    ProtocolError,
    RefusedError,
)
from drivers.limits import Limits, refuse
from drivers.link import Link
from drivers.setpoints import SetPoints

_STOP_TRIES = 4
"""How often a stop is sent before its failure is raised."""

_SHORTEST_PAUSE = 0.001  # s, where a link knows no better: time has to pass for a limit to be reached


class ControllerClient:
    """A `Driver` over any link; its methods are documented by `drivers.contract.Driver`.

    Args:
        link: the wire.
        clock: with which it waits.
        limits: what the arm can do at most, by which moves are refused and arrivals judged.
        say: told what is waited for where nothing happens.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        limits: Limits,
        *,
        say: Callable[[str], None] | None = None,
    ) -> None:
        self._link, self._clock = link, clock
        self._limits, self._say = limits, say
        self._lock = threading.RLock()  # around each exchange, never while waiting: a stop gets through
        self._account = Account(link, secrets.randbelow(65535) + 1, self._read)
        self._capabilities: Capabilities | None = None
        self._beat: int | None = None  # its last heartbeat
        self._leaving = False  # told to end: no second stop is tried

    def connect(self) -> None:
        """Open the wire and learn the state."""
        with self._lock:
            if self._capabilities is not None:
                return
            capabilities = self._link.open()
            try:
                status.require_possible(capabilities, len(self._limits.lower))
                state = self._link.state()
                status.believe(state, capabilities)
            except BaseException:
                self._link.close()
                raise
            self._leaving = False
            self._account.agree(state)
            self._capabilities = capabilities

    def close(self) -> None:
        """Stop an arm that moves for this client, and give session and wire back."""
        if self._capabilities is None:
            return
        try:
            with self._within(status.HALT if self._leaving else math.inf):
                if self._account.owns and not self._leaving:
                    state = self._link.state()
                    if state.owner == self._account.session and (self._account.doubt or state.busy):
                        self.stop()
                if self._account.owns:
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
        """What the controller accepts."""
        if self._capabilities is None:
            raise NotConnectedError("the driver is not connected; use it inside 'with', or call connect() first")
        return self._capabilities

    def state(self) -> RobotState:
        """The controller's state now, as it says."""
        with self._lock:
            _ = self.capabilities
            return self._read()

    def take(self) -> None:
        """Become the owner; a silent one is waited for, as long as its watchdog may be."""
        with self._lock:
            _ = self.capabilities
            self._account.take(self._clock, self._say)

    def ready(self) -> RobotState:
        """The state of an arm that stands without a fault."""
        with self._lock:
            state = self._require_known()
            if fault := status.latched(state):
                raise RefusedError(f"{fault}; reset first", Result.IN_FAULT)
            if state.busy:
                raise RefusedError("the arm moves, or is about to; wait until it stands", Result.BUSY)
            return state

    def move(self, set_points: SetPoints, speed: float) -> RobotState:
        """Drive through via points and return when the arm stands at the last one."""
        command = Move(set_points, speed)
        with self._lock:
            self.take()
            self._leaving = False
            state = self.ready()
            for bounds in (self.capabilities, self._limits):
                result, detail = refuse(command, state.axes, bounds)
                if result is not Result.OK:
                    raise RefusedError(detail, result)
            profile = arrival.profile_of(command, state, self._limits)
            watch = arrival.watch_of(command, profile, self._clock, self.capabilities.time_scale, self._say)
            try:
                sequence = self._account.send(command)
            except DriverError:
                raise
            except BaseException:  # Ctrl-C while the answer was on its way: the arm may move
                self._halt()
                raise
        return self._wait_for_end(sequence, command, watch, profile)

    def stop(self) -> RobotState:
        """Brake on the path and return when the arm stands."""
        return self._stop(status.STANDS_AFTER / min(self.capabilities.time_scale, 1.0))

    def reset(self) -> RobotState:
        """Clear a latched fault."""
        with self._lock:
            self.take()
            _ = self._require_known()
            self._account.send(Reset())
            return self._read()

    def _read(self) -> RobotState:
        state = self._link.state()
        self._beat = state.heartbeat
        return state

    def _stop(self, limit: float) -> RobotState:
        with self._within(limit):
            with self._lock:
                _ = self.capabilities
                number = self._account.number()
                for left in reversed(range(_STOP_TRIES)):
                    try:
                        self._link.send(number, Stop())
                        break
                    except LinkError:  # stopping twice is stopping
                        if not left or self._clock.now() >= self._link.deadline:
                            raise
            while not status.stands(state := self.state()):
                if self._clock.now() >= self._link.deadline:
                    wrong = status.contradiction(state, self.capabilities)
                    raise OverdueError(
                        f"{limit:g} s after a stop the controller does not say that the arm stands"
                        + f" ({wrong})" * bool(wrong)
                        + "; press the emergency stop"
                    )
                self._pause()
        with self._lock:
            self._account.agree(state)
            self._leaving = False
        return state

    @contextlib.contextmanager
    def _within(self, seconds: float) -> Iterator[None]:
        """Let the link give up after so long [s]; the nearer of two limits counts."""
        before = self._link.deadline
        self._link.deadline = min(before, self._clock.now() + seconds)
        try:
            yield
        finally:
            self._link.deadline = before

    def _halt(self) -> None:
        """Stop, with one second for it; what keeps it from being confirmed is said and not raised."""
        try:
            self._stop(status.HALT)
        except DriverError as error:
            if self._say:
                self._say(f"the stop was not confirmed ({error}); the controller's watchdog stops the arm")
        self._leaving = True

    def _require_known(self) -> RobotState:
        """The state now, if it is the one that this client left, of a controller that lives.

        Raises:
            StateUnknownError: if not.
            ContradictionError: if it cannot be true.
        """
        able, before = self.capabilities, self._beat
        self._account.require_no_doubt()
        state = self._read()
        while state.heartbeat is not None and state.heartbeat == before:  # the link knows how long that may last
            self._pause()
            state = self._read()
        status.believe(state, able)
        self._account.doubt = self._account.foreign(state)
        self._account.require_no_doubt()
        return state

    def _wait_for_end(self, sequence: int, move: Move, watch: status.Watch, profile: float) -> RobotState:
        """Wait until a move ended and the arm stands."""
        try:
            while (state := self._believed()).busy:
                ended = state.done_sequence == sequence  # it brakes, on whosever word
                if not ended and (foreign := self._account.foreign(state)):
                    raise ProtocolError(foreign)
                watch.see(state)
                self._pause()
            if state.done_sequence != sequence or state.boot != self._account.boot:
                raise ProtocolError(
                    f"the controller says that move {state.done_sequence} ended last: it was restarted, or another "
                    "client moved it"
                )
            arrival.require_ended_well(state)
            arrival.require_arrived(move, state, watch.elapsed, profile)
        except LinkError as error:
            raise self._account.unknown(f"how far move {sequence} went is not known", error) from error
        except (ContradictionError, OverdueError, ArrivalError) as error:
            self._halt()
            self._account.doubt = str(error)
            raise
        except DriverError:
            raise
        except BaseException:  # Ctrl-C above all
            self._halt()
            raise
        return state

    def _believed(self) -> RobotState:
        state = self.state()
        status.believe(state, self.capabilities)
        return state

    def _pause(self) -> None:
        with self._lock:
            seconds = self._link.time_to_wait()
        self._clock.wait(seconds or _SHORTEST_PAUSE)
