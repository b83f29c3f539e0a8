"""The controller's side of the serial protocol: bytes of one frame in, bytes of its answer out."""

import logging
import math

from drivers.commands import Reset, Stop
from drivers.emulated.endpoint import Endpoint
from drivers.wire import Commit, Stage
from drivers.wires.serial.frames import Frame, decode, encode, split
from drivers.wires.serial.messages import (
    VERSION,
    Beat,
    Give,
    Hello,
    Request,
    Take,
    answer_frame,
    hello_frame,
    request_of,
    status_frame,
    trouble_frame,
)

_log = logging.getLogger(__name__)


class SerialStation:
    """Answers frames.

    Args:
        endpoint: the controller.
    """

    silence = math.inf  # a frame ends by its LF, however long it takes

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._last = b""

    def split(self, received: bytes) -> tuple[list[bytes], bytes]:
        """Cut a stream into frames and the rest."""
        return split(received)

    def forget(self) -> None:
        """The controller was restarted."""
        self._last = b""

    def answer(self, packet: bytes) -> bytes:
        """The answer; empty where there is none: to what is no frame, or comes from another controller."""
        frame = decode(packet)
        if frame is None or frame.start != ">":
            _log.debug("no frame of ours: %r", packet[:80])
            return b""
        message = request_of(frame, len(self.endpoint.limits.lower))
        if message is None:
            return encode(trouble_frame(frame.number, f"cannot understand {frame.kind} or its arguments"))
        session, request = message
        answer = self._answer(frame, session, request)
        if session and session == self.endpoint.owner and packet != self._last:  # a copy is no sign of life
            self._last = packet
            self.endpoint.hear(session)
        return encode(answer)

    def refuse(self, packet: bytes) -> bytes:
        """An answer that executes nothing: the controller could not."""
        frame = decode(packet)
        return encode(trouble_frame(frame.number, "the controller is occupied")) if frame else b""

    def _answer(self, frame: Frame, session: int, request: Request) -> Frame:
        number = frame.number
        match request:
            case Hello(version):
                if version != VERSION:
                    return trouble_frame(
                        number, f"this controller speaks version {VERSION} of the protocol, not {version}"
                    )
                return hello_frame(number, self.endpoint.capabilities)
            case Beat():
                return status_frame(number, self.endpoint.report())
            case Take(watchdog_ms):
                answer = self.endpoint.take(session, watchdog_ms)
            case Give():
                answer = self.endpoint.give(session)
            case Stage():
                answer = self.endpoint.stage(session, number, request)
            case Commit():
                answer = self.endpoint.commit(session, number, request)
            case Stop() | Reset():
                answer = self.endpoint.command(session, number, request)
        return answer_frame(number, frame.kind, answer)
