"""`serial://`: the ASCII frames of docs/internals/protocol.md over a serial line. Only this module imports pyserial.

The path of the URL is the port: `serial:///dev/ttyUSB0?baud=115200`.

An answer is current if its frame is complete, comes from the controller, answers the requested kind and has the
request's number. Everything else on the line (late or doubled answers, answers to another client, an echo of the
client's own frame, noise) is ignored until the time is over. Query numbers count on from a random number, so that an
answer left over from another run of the program matches none.
"""

import secrets
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol, TypeVar

import serial

from drivers import wire
from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock
from drivers.contract import Answer, Capabilities, RobotState
from drivers.errors import AnswerTimeoutError, LinkLostError, ProtocolError
from drivers.registry import Context, DriverUrl
from drivers.wire import MAX_BAUD, Line, ReopeningLink, Timeouts, describe_failure, port_path
from drivers.wires.serial_protocol import (
    COUNTS_PER_FRAME,
    FROM_CONTROLLER,
    Frame,
    Hello,
    ReadState,
    Request,
    decode_frame,
    encode_frame,
    parse_answer,
    parse_error,
    parse_hello,
    parse_status,
    request_frame,
    split_frames,
)

T = TypeVar("T")

BITS_PER_BYTE = 10
_ANSWER_BYTES = 500  # upper bound for any answer except that to HELLO

_PORT_ERRORS = (OSError, TypeError, ValueError, AttributeError)
"""Exceptions of pyserial if a port vanishes: SerialException is an OSError, the rest are its bugs on a closed port."""

try:
    import termios

    _FAILURES: tuple[type[Exception], ...] = (*_PORT_ERRORS, termios.error)
except ImportError:  # Windows
    _FAILURES = _PORT_ERRORS


class Port(Line, Protocol):
    """Bytes in and out (`SerialPort`); it raises LinkLostError."""

    def write(self, data: bytes) -> None:
        """Discard received bytes, then send."""

    def read(self, seconds: float) -> bytes:
        """Return bytes as soon as some arrive within `seconds`; empty if none do."""


class SerialPort:
    """A serial port, 8 data bits, no parity, 1 stop bit, exclusive to this process.

    Args:
        path: device, such as /dev/ttyUSB0.
        baud: bits per second.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.name, self._baud = path, baud
        self._port: Any = None

    def open(self) -> None:
        """Open the port; raise LinkLostError if this fails."""
        try:
            self._port = serial.Serial(self.name, self._baud, timeout=0.0, write_timeout=1.0, exclusive=True)
        except _FAILURES as error:
            raise LinkLostError(
                f"{self.name} cannot be opened for reading and writing: {describe_failure(error)}; check the name, the "
                "plug, the rights (on Linux the group dialout), and that no other program uses it"
            ) from error

    def close(self) -> None:
        """Release the port; allowed twice."""
        port, self._port = self._port, None
        if port is not None:
            try:
                port.close()
            except _FAILURES:
                return  # it is already gone

    def write(self, data: bytes) -> None:
        """Discard received bytes, then send; raise LinkLostError if the port is gone."""
        try:
            self._port.reset_input_buffer()
            self._port.write(data)
        except _FAILURES as error:
            raise LinkLostError(f"{self.name} cannot be written any more: {describe_failure(error)}") from error

    def read(self, seconds: float) -> bytes:
        """Return bytes as soon as some arrive within `seconds`; raise LinkLostError if the port is gone."""
        try:
            self._port.timeout = max(seconds, 0.0)
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first
        except _FAILURES as error:
            raise LinkLostError(f"{self.name} cannot be read any more: {describe_failure(error)}") from error


class SerialLink(ReopeningLink):
    """The serial wire to one controller.

    Args:
        port: the serial port.
        clock: the client's.
        timeouts: waiting times.
        seconds_per_byte: transfer time of a byte.
        first_query: number of the first query; None: random.
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        timeouts: Timeouts,
        *,
        seconds_per_byte: float = 0.0,
        first_query: int | None = None,
    ) -> None:
        super().__init__(port, clock, timeouts)
        self._port = port
        self._seconds_per_byte = seconds_per_byte
        self._query = secrets.randbelow(65536) if first_query is None else first_query

    def _handshake(self) -> Capabilities:
        return self._ask(self._next_query(), Hello(), parse_hello)

    def _exchange(self, sequence: int | None, request: wire.Request) -> Answer:
        kind = request_frame(0, self.session, request).kind
        number = self._next_query() if sequence is None else sequence
        return self._ask(number, request, partial(parse_answer, kind=kind))

    def _read_state(self) -> RobotState:
        return self._ask(self._next_query(), ReadState(), parse_status)

    def _max_points(self, axes: int) -> int:
        return COUNTS_PER_FRAME // axes

    def _next_query(self) -> int:
        self._query = (self._query + 1) % 65536
        return self._query

    def _ask(self, number: int, request: Request, parse: Callable[[Frame], T | None]) -> T:
        """Send one frame and wait for its answer."""
        frame = request_frame(number, self.session, request)
        data, kind = encode_frame(frame), frame.kind
        transfer_time = (len(data) + _ANSWER_BYTES) * self._seconds_per_byte
        try:
            self._port.write(data)
            deadline = self._clock.now() + self._timeouts.answer + transfer_time
            rest, n_bytes, n_frames, n_echoes, is_malformed = b"", 0, 0, 0, False
            while (left := deadline - self._clock.now()) > 0.0:
                received = self._port.read(left)
                n_bytes += len(received)
                candidates, rest = split_frames(rest + received)
                for frame in filter(None, map(decode_frame, candidates)):
                    n_frames += 1
                    if encode_frame(frame) == data:  # of an RS-485 adapter: the answer follows it
                        n_echoes += 1
                        continue
                    if frame.number != number:
                        continue
                    if (error := parse_error(frame)) is not None:
                        raise ProtocolError(f"the controller could not answer {kind}: {error}")
                    if (answer := parse(frame)) is not None:
                        return answer
                    is_malformed = is_malformed or (frame.start == FROM_CONTROLLER and frame.kind == kind)
        except LinkLostError:
            self._drop()
            raise
        name, waited = self._port.name, f"within {1000.0 * (self._timeouts.answer + transfer_time):.0f} ms"
        if n_bytes and not n_frames:
            raise ProtocolError(
                f"{name} received {n_bytes} bytes but no complete frame {waited}; check the baud rate, the cable, and "
                "the device at the other end"
            )
        if is_malformed:
            raise ProtocolError(
                f"{name} received an answer to {kind} with invalid arguments; see docs/internals/protocol.md"
            )
        if n_echoes == n_frames > 0:
            raise AnswerTimeoutError(
                f"{name} received its own request and no answer to {kind} {waited}: the line or an RS-485 adapter "
                "returns all bytes, and the controller is silent; check the wiring, the baud rate and the controller"
            )
        others = f"; {n_frames} other frames arrived" * (n_frames > 0)
        raise AnswerTimeoutError(f"{name} received no answer to {kind} {waited}{others}")


class SerialDriver(ControllerClient):
    """A controller behind a serial line."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "SerialDriver":
        """Make the driver of a `serial://` URL.

        Raises:
            DriverUrlError: if it names no port, or an option is invalid.
        """
        baud = url.integer("baud", 115200, at_least=50, at_most=MAX_BAUD)
        timeouts = Timeouts.from_url(url)
        url.finish()
        path = port_path(url)
        clock = context.clock or RealTimeClock()
        link = SerialLink(SerialPort(path, baud), clock, timeouts, seconds_per_byte=BITS_PER_BYTE / baud)
        return cls(link, clock, context.limits, notify=context.notify)
