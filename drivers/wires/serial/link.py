"""`serial://`: the ASCII frames of docs/internals/protocol.md over a serial line.

The path is the port: `serial:///dev/ttyUSB0?baud=115200`.

An answer is the current one when its frame is whole, comes from the controller, answers the kind that was asked and
carries the number that was asked under. Everything else on the line (late or doubled answers, answers to another
client, an echo of one's own frame, noise) is passed over until the time is up. Questions count through from a random
number, so that an answer left over from another run of the program fits none.
"""

import secrets
from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar
from urllib.parse import unquote

from drivers.client import ControllerClient
from drivers.clock import Clock, RealTimeClock
from drivers.commands import Answer, Command, Move, Result
from drivers.contract import Capabilities, RobotState
from drivers.errors import AnswerTimeoutError, DriverUrlError, LinkLostError, ProtocolError
from drivers.registry import Context
from drivers.reopening import Line, ReopeningLink
from drivers.url import DriverUrl
from drivers.wire import Patience, pieces
from drivers.wires.serial.frames import FROM_CONTROLLER, Frame, decode, encode, split
from drivers.wires.serial.messages import (
    COUNTS_PER_FRAME,
    Beat,
    Give,
    Hello,
    Request,
    Take,
    answer_of,
    hello_of,
    request_frame,
    status_of,
    trouble_of,
)
from drivers.wires.serial.port import SerialPort

T = TypeVar("T")

BITS_PER_BYTE = 10
_ANSWER_BYTES = 500  # more than any answer but a hello needs


class Port(Line, Protocol):
    """Bytes in and out (`drivers.wires.serial.port.SerialPort`); it raises LinkLostError."""

    def write(self, data: bytes) -> None:
        """Send, and forget what came in before."""

    def read(self, seconds: float) -> bytes:
        """What comes within some seconds, at once when something comes."""


class SerialLink(ReopeningLink):
    """The wire to one controller.

    Args:
        port: where the bytes go.
        clock: the client's.
        patience: how long to wait.
        seconds_per_byte: time of a byte on the wire.
        first_question: number of the first question; None: random.
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        patience: Patience,
        *,
        seconds_per_byte: float = 0.0,
        first_question: int | None = None,
    ) -> None:
        super().__init__(port, clock, patience)
        self._port = port
        self._seconds_per_byte = seconds_per_byte
        self._question = secrets.randbelow(65536) if first_question is None else first_question

    def send(self, sequence: int, command: Command) -> Answer:
        """Send a command once; what a move stages first may be sent again."""
        self._require_open()
        request: Request
        if isinstance(command, Move):
            stages, request = pieces(command, COUNTS_PER_FRAME // command.set_points.shape[1])
            for stage in stages:
                taken = self._again(partial(self._ask, sequence, stage, partial(answer_of, kind="POINTS")))
                if taken.result != Result.OK:
                    require_taken(taken)
                    return taken
        else:
            request = command
        kind = request_frame(sequence, self.session, request).kind
        answer = self._ask(sequence, request, partial(answer_of, kind=kind))
        require_taken(answer)
        return answer

    def _ask_for(self) -> int:
        take = Take(self._patience.watchdog_ms)
        return int(self._ask(self._next_question(), take, partial(answer_of, kind="TAKE")).result)

    def _give_back(self) -> None:
        self._ask(self._next_question(), Give(), partial(answer_of, kind="GIVE"))

    def state(self) -> RobotState:
        """Ask for the state, several times if need be, opening a lost port again."""
        return self._taken(self._again(lambda: self._ask(self._next_question(), Beat(), status_of)))

    def _greet(self) -> Capabilities:
        return self._ask(self._next_question(), Hello(), hello_of)

    def _next_question(self) -> int:
        self._question = (self._question + 1) % 65536
        return self._question

    def _ask(self, number: int, request: Request, read: Callable[[Frame], T | None]) -> T:
        """Send one frame and wait for what answers it."""
        frame = request_frame(number, self.session, request)
        data, kind = encode(frame), frame.kind
        time_on_wire = (len(data) + _ANSWER_BYTES) * self._seconds_per_byte
        try:
            self._port.write(data)
            deadline = self._clock.now() + self._patience.answer + time_on_wire
            rest, n_bytes, n_frames, unread = b"", 0, 0, False
            while (left := deadline - self._clock.now()) > 0.0:
                received = self._port.read(left)
                n_bytes += len(received)
                candidates, rest = split(rest + received)
                for frame in filter(None, map(decode, candidates)):
                    n_frames += 1
                    if frame.number != number:
                        continue
                    if (trouble := trouble_of(frame)) is not None:
                        raise ProtocolError(f"the controller could not answer {kind}: {trouble}")
                    if (answer := read(frame)) is not None:
                        return answer
                    unread = unread or (frame.start == FROM_CONTROLLER and frame.kind == kind)
        except LinkLostError:
            self._drop()
            raise
        waited = f"within {1000.0 * (self._patience.answer + time_on_wire):.0f} ms"
        if n_bytes and not n_frames:
            raise ProtocolError(
                f"{self._port.name} brought {n_bytes} bytes but no whole frame {waited}; check the baud rate, the "
                "cable, and what is at the other end"
            )
        if unread:
            raise ProtocolError(
                f"{self._port.name} brought an answer to {kind} whose arguments cannot be; "
                "see docs/internals/protocol.md"
            )
        others = f"; {n_frames} other frames came" * (n_frames > 0)
        raise AnswerTimeoutError(f"{self._port.name} brought no answer to {kind} {waited}{others}")


def require_taken(answer: Answer) -> None:
    """What was not understood as it was meant has executed nothing; the client looks into the state."""
    if answer.result == Result.INCOMPLETE:
        raise ProtocolError(Result.INCOMPLETE.sentence)


class SerialDriver(ControllerClient):
    """A controller behind a serial line."""

    @classmethod
    def from_url(cls, url: DriverUrl, context: Context) -> "SerialDriver":
        """Make the driver that a `serial://` URL describes.

        Raises:
            DriverUrlError: if there is no port in it, or an option cannot be.
        """
        baud = url.whole("baud", 115200, at_least=50)
        patience = Patience.from_url(url)
        url.finish()
        path = port_path(url)
        clock = context.clock or RealTimeClock()
        link = SerialLink(SerialPort(path, baud), clock, patience, seconds_per_byte=BITS_PER_BYTE / baud)
        link.say = context.say
        return cls(link, clock, context.limits, say=context.say)


def port_path(url: DriverUrl) -> str:
    """The device that a URL names.

    Raises:
        DriverUrlError: if it names none, or a host.
    """
    if url.host or url.path in ("", "/"):
        raise DriverUrlError(
            f"'{url.text}' names no port; write three slashes: {url.scheme}:///dev/ttyUSB0?baud=115200"
        )
    return unquote(url.path)
