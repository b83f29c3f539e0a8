"""Everything that the wires share: staged moves, speeds as integers, timeouts, heartbeats, reopening of a lost line.

A frame is short and a move may have 200,000 via points. A move is therefore *staged*: its via points go into a buffer
of the controller, piece by piece, under the sequence number of the move. Staging moves nothing, and writing a piece
twice has no further effect. The move command itself, the *commit*, carries the speed, the number of points, the CRC-32
of all points, and the last of them (all points if they fit: then nothing is staged). The controller accepts the commit
only if its buffer matches count and CRC.

A move thus stays one command with one number: it is checked as one before the arm moves, it is executed once or not at
all, and if the wire fails during the transfer the arm is at rest. Several queued moves would need no buffer, but a
fault between them would leave a partial execution, and a refusal of point 70,000 would follow the motion through
69,999.

The CRC-32 is the one of zlib, Ethernet and PKZIP (polynomial 0x04C11DB7 reflected, start and final XOR 0xFFFFFFFF),
over the points as big-endian int32, point by point, from A1 on.

Reopening a line is safe because it only reads: `drivers.client` finds out from the numbers in the state whether the
controller is still the same and whether the last command was executed.
"""

import os
import re
import socket
import zlib
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol, TypeVar
from urllib.parse import unquote

import numpy as np

from drivers.client import Link
from drivers.clock import Clock
from drivers.contract import (
    FULL,
    Answer,
    Capabilities,
    Command,
    Fault,
    Flag,
    Mode,
    Move,
    Reset,
    Result,
    RobotState,
    Stop,
)
from drivers.errors import (
    AnswerTimeoutError,
    DriverUrlError,
    LinkError,
    LinkLostError,
    NotConnectedError,
    ProtocolError,
)
from drivers.registry import DriverUrl
from drivers.setpoints import AXES, SetPoints, frozen
from drivers.status import NOTIFY_AFTER

REAL_TIME = 1000
"""Time scale 1 on the wire: time scales are integers in units of 1e-3."""

DEFAULT_WATCHDOG_MS = 1000
"""Default silence of the client [ms] after which a moving arm is stopped."""

WATCHDOG_RANGE_MS = (100, 5000)
"""Shortest and longest watchdog [ms] of a client; others are refused."""

MAX_BAUD = 12_000_000
"""Largest speed of a serial line [bits/s]: that of the fastest USB adapters."""

MAX_POINTS = 200_000
"""Via points that the controller's buffer holds for one move (4.8 MB)."""

MAX_AXES = 12
"""Largest number of axes in frames and register blocks."""

STATUS_FIELDS = (
    *("heartbeat", "boot", "flags", "mode", "owner", "ack_sequence", "ack_result", "done_sequence", "done_result"),
    *("queue_depth", "fault_code", "override", "path"),
)
"""Integer fields of a `RobotState` on every wire, in the order of the serial frame."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Request to write via points of the next move into the buffer.

    Attributes:
        offset: index of the first point in the move.
        points: (k, n) int32 counts of 1e-4 deg, k at least 1.
    """

    offset: int
    points: SetPoints


@dataclass(frozen=True, slots=True, eq=False)
class Commit:
    """Request to execute a move whose first points are staged.

    Attributes:
        speed: speed fraction in 1e-4.
        count: number of via points of the move.
        crc: CRC-32 of all of them.
        tail: (k, n) the last of them, int32 counts; all of them if count is k.
    """

    speed: int
    count: int
    crc: int
    tail: SetPoints


@dataclass(frozen=True, slots=True)
class Take:
    """Request to take or keep the arm.

    Attributes:
        watchdog_ms: silence [ms] after which a moving arm shall stop.
    """

    watchdog_ms: int


@dataclass(frozen=True, slots=True)
class Give:
    """Request to give the arm back."""


Request = Stage | Commit | Take | Give | Stop | Reset


def split_move(move: Move, size: int) -> tuple[list[Stage], Commit]:
    """Split a move into stages and a commit of at most `size` points each."""
    points = move.set_points
    n = len(points)
    n_tail = min(n, size)
    stages = [Stage(k, points[k : min(k + size, n - n_tail)]) for k in range(0, n - n_tail, size)]
    return stages, Commit(speed_to_wire(move.speed), n, points_crc(points), points[n - n_tail :])


def points_crc(points: SetPoints) -> int:
    """Return the CRC-32 of set-points."""
    return zlib.crc32(np.ascontiguousarray(points, dtype=">i4").tobytes())


def speed_to_wire(speed: float) -> int:
    """Return a speed fraction in 1e-4, never rounded up; 0, which every controller refuses, if it is outside (0, 1]."""
    return int(speed * FULL + 1e-6) if 0.0 < speed <= 1.0 else 0


def speed_from_wire(speed: int) -> float:
    """Return the speed fraction of a value in 1e-4."""
    return speed / FULL


class StagingBuffer:
    """The controller's buffer of via points.

    It belongs to one sequence number at a time; a piece under another number empties it first.

    Args:
        axes: number of axes.
    """

    def __init__(self, axes: int = AXES) -> None:
        self.sequence, self._axes = 0, axes
        self._bytes = bytearray()

    def __len__(self) -> int:
        """Number of points in the buffer."""
        return len(self._bytes) // (4 * self._axes)

    def write(self, sequence: int, piece: Stage) -> bool:
        """Write a piece; return False if it would leave a gap or does not fit."""
        if sequence != self.sequence:
            self.sequence, self._bytes = sequence, bytearray()
        if piece.offset > len(self) or piece.offset + len(piece.points) > MAX_POINTS:
            return False
        begin = piece.offset * 4 * self._axes
        data = np.ascontiguousarray(piece.points, dtype=">i4").tobytes()
        self._bytes[begin : begin + len(data)] = data
        return True

    def assemble(self, sequence: int, commit: Commit) -> SetPoints | None:
        """Return all points of a move, or None if the buffer does not match the commit's count and CRC.

        The buffer is unchanged, so that a repeated commit gives the same points.
        """
        n_staged = commit.count - len(commit.tail)
        if not (n_staged >= 0 and len(commit.tail) and commit.count <= MAX_POINTS):
            return None
        if n_staged and (sequence != self.sequence or n_staged > len(self)):
            return None
        staged = bytes(self._bytes[: n_staged * 4 * self._axes]) if n_staged else b""
        points = frozen(
            np.concatenate([np.frombuffer(staged, dtype=">i4").reshape(-1, self._axes), commit.tail]), np.int32
        )
        return points if points_crc(points) == commit.crc else None


@dataclass(frozen=True)
class Timeouts:
    """Waiting times of a client.

    Attributes:
        answer: longest time from a request to its answer [s], without the transfer time of the bytes.
        tries: smallest number of attempts before the state counts as unreadable.
        watchdog: silence [s] after which either end considers the other gone.
        poll: time [s] between two readings of the state of a moving arm.
    """

    answer: float = 0.25
    tries: int = 3
    watchdog: float = DEFAULT_WATCHDOG_MS / 1000.0
    poll: float = 0.02

    @property
    def watchdog_ms(self) -> int:
        """The watchdog [ms]."""
        return round(self.watchdog * 1000.0)

    @classmethod
    def from_url(cls, url: DriverUrl) -> "Timeouts":
        """Take the options timeout_ms, watchdog_ms and poll_ms.

        Raises:
            DriverUrlError: if one is invalid, or the watchdog would expire while the client still retries.
        """
        shortest, longest = WATCHDOG_RANGE_MS
        answer = url.number("timeout_ms", 1000.0 * cls.answer, above=0.0, at_most=60_000.0)
        watchdog = url.integer("watchdog_ms", DEFAULT_WATCHDOG_MS, at_least=shortest, at_most=longest)
        poll = url.number("poll_ms", 1000.0 * cls.poll, above=0.0, at_most=longest)
        if cls.tries * answer > watchdog or poll > watchdog / 2.0:
            raise DriverUrlError(
                f"'{url.text}' has timeout_ms={answer:g}, poll_ms={poll:g} and watchdog_ms={watchdog}; the watchdog "
                f"must be at least {cls.tries} times the timeout and twice the poll, or one lost answer stops the arm"
            )
        return cls(answer / 1000.0, cls.tries, watchdog / 1000.0, poll / 1000.0)


class Heartbeat:
    """Watchdog of the client: a controller with a frozen heartbeat is gone, even if something answers for it.

    Args:
        clock: the client's.
        limit: longest time [s] without a change of the heartbeat.
    """

    def __init__(self, clock: Clock, limit: float) -> None:
        self._clock, self._limit = clock, limit
        self._last: int | None = None
        self._frozen_since: float | None = None

    def update(self, heartbeat: int) -> None:
        """Process the heartbeat of an answer; raise LinkLostError if it is frozen, seen at least three times."""
        now = self._clock.now()
        if heartbeat != self._last:
            self._last, self._frozen_since = heartbeat, None
        elif self._frozen_since is None:
            self._frozen_since = now  # count from here: an earlier pause of the client is no frozen heartbeat
        elif now - self._frozen_since > self._limit:
            raise LinkLostError(
                f"the controller's heartbeat has not changed for {now - self._frozen_since:.2f} s; another device "
                "answers for the controller, or it has crashed"
            )

    def restart(self) -> None:
        """Forget the last heartbeat: the line was opened again."""
        self._last = None


class Line(Protocol):
    """A port that is opened and closed."""

    name: str

    def open(self) -> None:
        """Open the port."""

    def close(self) -> None:
        """Release the port; allowed twice."""


class ReopeningLink(Link):
    """A link that opens a lost line again at its next use: opening, closing, retrying, and the client's watchdog.

    Args:
        line: the port.
        clock: the client's.
        timeouts: waiting times.
    """

    def __init__(self, line: Line, clock: Clock, timeouts: Timeouts) -> None:
        self._line, self._clock, self._timeouts = line, clock, timeouts
        self._heartbeat_monitor = Heartbeat(clock, timeouts.watchdog)
        self._capabilities: Capabilities | None = None
        self._is_open = False
        self._is_busy = False
        self._committed = 0  # number of the last move that was sent
        self.session = 0  # the taken session; 0: this client only reads

    @abstractmethod
    def _handshake(self) -> Capabilities:
        """Check that a controller of this protocol answers on the open line, and read its capabilities."""

    @abstractmethod
    def _exchange(self, sequence: int | None, request: Request) -> Answer:
        """Send a request once and wait for its answer; taking and giving have no sequence number."""

    @abstractmethod
    def _read_state(self) -> RobotState:
        """Read the state, once."""

    @abstractmethod
    def _max_points(self, axes: int) -> int:
        """Return the largest number of via points in one message."""

    def open(self) -> Capabilities:
        """Open the line and read the controller's capabilities."""
        return self._reopen(self._timeouts.tries)

    def close(self) -> None:
        """Release the line."""
        self._capabilities, self.session = None, 0
        self._drop()

    def take(self, session: int) -> int:
        """Take a session. Repeating the request has no further effect, so it is retried after a lost answer."""
        before, self.session, result = self.session, session, -1
        try:
            take = Take(self._timeouts.watchdog_ms)
            result = int(self._retry(lambda: self._exchange(None, take)).result)
        finally:
            if result != Result.OK:
                self.session = before
        return result

    def give(self) -> None:
        """Give the session back; if the request is lost, the client's silence ends the session."""
        if self.session:
            self._require_open()
            self._exchange(None, Give())
            self.session = 0

    def send(self, sequence: int, command: Command) -> Answer:
        """Send a command once; its stages may be sent again."""
        self._require_open()
        if not isinstance(command, Move):
            return self._exchange(sequence, command)
        stages, commit = split_move(command, self._max_points(command.set_points.shape[1]))
        for stage in stages:
            answer = self._retry(partial(self._exchange, sequence, stage))
            if answer.result != Result.OK:
                break
        else:
            if sequence != self._committed:  # a repeated commit may have been executed before
                self._committed, self.began = sequence, self._clock.now()
            answer = self._exchange(sequence, commit)
        if answer.result == Result.INCOMPLETE:  # nothing was executed: the client checks the state and sends it again
            raise ProtocolError(Result.INCOMPLETE.message)
        return answer

    def state(self) -> RobotState:
        """Read the state; retry, and open a lost line again if necessary."""
        state = self._retry(self._read_state)
        try:
            self._heartbeat_monitor.update(state.heartbeat or 0)
        except LinkLostError:
            self._drop()
            raise
        self._is_busy = state.is_busy
        return state

    def time_to_wait(self) -> float:
        """Return the polling period."""
        return self._timeouts.poll if self._is_busy else 0.0

    def _retry(self, request: Callable[[], T]) -> T:
        """Repeat a harmless request until it is answered; open the line again if necessary.

        It gives up after `tries`, but not before the watchdog's time: until then the controller's own watchdog has not
        stopped a moving arm, and the result of its move may still become known.
        """
        began, tries, has_notified = self._clock.now(), 0, self.notify is None
        while True:
            try:
                self._require_open()
                return request()
            except LinkError as error:
                tries += 1
                now = self._clock.now()
                if now >= self.deadline or (tries >= self._timeouts.tries and now - began >= self._timeouts.watchdog):
                    raise
                if self.notify and not has_notified and now - began > NOTIFY_AFTER:
                    has_notified = True
                    self.notify(f"waiting for an answer of the controller ({error})")
                if not isinstance(error, AnswerTimeoutError):  # a timeout has already waited
                    self._clock.wait(self._timeouts.poll)

    def _require_open(self) -> None:
        if self._is_open:
            return
        if self._capabilities is None:
            raise NotConnectedError(f"{self._line.name} is not open; call connect() first")
        before = self._capabilities
        if not same_capabilities(before, self._reopen(1)):
            self._drop()
            self._capabilities = before
            raise ProtocolError(
                f"the controller at {self._line.name} has other limits or another clock than before the line was lost"
            )

    def _reopen(self, tries: int) -> Capabilities:
        self._drop()
        failure = LinkError("no attempt was made")
        for _ in range(tries):
            try:
                self._line.open()
                self._capabilities = self._handshake()
            except LinkError as error:
                self._line.close()
                failure = error
                continue
            self._is_open = True
            self._heartbeat_monitor.restart()
            return self._capabilities
        raise failure

    def _drop(self) -> None:
        self._is_open = False
        self._line.close()


def state_of_program(
    *, is_slow: bool, is_paused: bool, has_move: bool, is_emergency: bool, passed: int, n_via: int, **fields: Any
) -> RobotState:
    """Return the state of a controller that reports a program and no mode.

    Args:
        is_slow: whether no axis moves.
        is_paused: whether the program is held.
        has_move: whether a move has begun and not ended.
        is_emergency: whether its fault is an emergency stop.
        passed: passed via points of the move.
        n_via: its via points.
        **fields: the other fields of the state.
    """
    fault, ack, done = fields["fault_code"], fields["ack_sequence"], fields["done_sequence"]
    is_held = has_move and is_paused and is_slow and not fault
    at_rest = is_slow and (is_held or bool(fault) or not has_move)
    mode = Mode.IDLE
    if fault:
        mode = Mode.EMERGENCY_STOP if is_emergency else Mode.FAULT
    elif not at_rest:
        mode = Mode.MOVING
    elif done and done == ack and fields["done_result"] == Result.OK and not has_move:
        mode = Mode.IN_POSITION
    path = FULL if mode is Mode.IN_POSITION else max(min(passed * FULL // n_via, FULL - 1), 0)
    state = RobotState(mode=mode, at_rest=at_rest, queue_depth=int(has_move), path=path, **fields)
    return replace(state, flags=state.flags | Flag.HELD) if is_held else state


def fault_message(code: int) -> str:
    """Return the message of a fault code of the contract, or name the code."""
    return Fault(code).message if code in tuple(Fault) else f"fault {code} of this controller"


def same_capabilities(a: Capabilities, b: Capabilities) -> bool:
    """Return whether two controllers accept the same moves."""
    return (a.max_speed, a.max_via, a.time_scale) == (b.max_speed, b.max_via, b.time_scale) and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("lower", "upper", "max_step")
    )


def port_path(url: DriverUrl) -> str:
    """Return the serial device that a URL names.

    Raises:
        DriverUrlError: if it names none, or a host.
    """
    path = unquote(url.path)
    if windows := re.fullmatch(r"/*(?:[\\/]{2}\.[\\/])?(COM[0-9]+)/?", (url.host or "") + path, re.IGNORECASE):
        return "\\\\.\\" + windows[1].upper()  # the form that also has ports above COM9
    if url.host or path in ("", "/"):
        raise DriverUrlError(
            f"'{url.text}' names no port; write three slashes: {url.scheme}:///dev/ttyUSB0?baud=115200, or on "
            f"Windows {url.scheme}:///COM3?baud=115200"
        )
    return path


def connect_tcp(address: tuple[str, int], seconds: float, check: str) -> socket.socket:
    """Return a connection to a controller.

    Args:
        address: host and port.
        seconds: longest time for an answer.
        check: what a user should check besides address and network.

    Raises:
        LinkLostError: if nothing answers.
    """
    connection = None
    try:
        connection = socket.create_connection(address, seconds + 1.0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    except OSError as error:
        if connection is not None:
            connection.close()
        raise LinkLostError(
            f"{address[0]}:{address[1]} cannot be opened: {describe_failure(error)}; check address and network, and "
            f"that {check}"
        ) from error
    return connection


def describe_failure(error: Exception) -> str:
    """Return the cause of a failed port in the words of the system, not of the library that met it."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and (cause.strerror or cause.errno):
            return (os.strerror(cause.errno) if cause.errno else str(cause.strerror)).lower()
        cause = cause.__cause__ or cause.__context__
    return "the port is missing, closed or in use; check address, plug and rights"
