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
    Hello,
    Request,
    Status,
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
        request = request_of(frame)
        if request is None:
            return encode(trouble_frame(frame.number, f"cannot understand {frame.kind} or its arguments"))
        if packet != self._last:  # a copy of the last frame is no sign of life
            self._last = packet
            self.endpoint.hear(request.watchdog_ms if isinstance(request, Beat) else None)
        return encode(self._answer(frame, request))

    def refuse(self, packet: bytes) -> bytes:
        """An answer that executes nothing: the controller could not."""
        frame = decode(packet)
        return encode(trouble_frame(frame.number, "the controller is occupied")) if frame else b""

    def _answer(self, frame: Frame, request: Request) -> Frame:
        number = frame.number
        match request:
            case Hello(version):
                if version != VERSION:
                    return trouble_frame(
                        number, f"protocol version {version} is unknown; this controller has {VERSION}"
                    )
                return hello_frame(number, self.endpoint.capabilities)
            case Beat():
                report = self.endpoint.report()
                return status_frame(number, Status(report.heartbeat, report.state))
            case Stage():
                return answer_frame(frame.kind, self.endpoint.stage(number, request))
            case Commit():
                return answer_frame(frame.kind, self.endpoint.commit(number, request))
            case Stop() | Reset():
                return answer_frame(frame.kind, self.endpoint.command(number, request))
