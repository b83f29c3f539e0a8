r"""Protocol of the serial line: ASCII frames and the messages in them. docs/internals/protocol.md describes each byte.

    > 00042,0004,STOP * 59A379F2 CR LF        (without the blanks)
    | |     |    |      `-- CRC-32 of everything before the asterisk, 8 capital hexadecimal digits
    | |     |    `--------- body: the kind, then its arguments after commas
    | |     `-------------- number of characters of the body, 4 digits
    | `-------------------- number, 5 digits: a command's sequence number, or a query's running number
    `---------------------- > to the controller, < from it

Each frame has exactly one spelling: decoding and encoding gives the same bytes, so a corrupted frame is never another
spelling of a valid one. `>`, `<` and `*` do not occur in a body, so a frame begins at the last start character of its
line, whatever was lost or left over before it. The CRC-32 detects every burst of up to 32 bits and, in frames as short
as these, every three flipped bits; the length detects cuts and joins without the CRC.

Integers are decimal without leading zeros or plus sign, CRCs are 8 capital hexadecimal digits, a text is the rest of
the body. Each value has exactly one spelling too; parsers return None for anything else.
"""

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from drivers import wire
from drivers.contract import FULL, Answer, Capabilities, Flag, Mode, Reset, RobotState, Stop
from drivers.errors import ProtocolError
from drivers.setpoints import AXES, SetPoints
from drivers.wire import (
    MAX_AXES,
    REAL_TIME,
    STATUS_FIELDS,
    Commit,
    Give,
    Stage,
    Take,
    speed_from_wire,
    speed_to_wire,
)

VERSION: Final = 2

TO_CONTROLLER: Final = ">"
FROM_CONTROLLER: Final = "<"

MAX_FRAME: Final = 1024
"""Longest frame in bytes, start character and CR LF included."""

_OVERHEAD: Final = len(">00000,0000,*00000000\r\n")
MAX_BODY: Final = MAX_FRAME - _OVERHEAD

_FRAME = re.compile(rb"([<>])([0-9]{5}),([0-9]{4}),([ -)+-;=?-~]+)\*([0-9A-F]{8})\r\n")
_BODY = re.compile(r"[A-Z]+(,[ -)+-;=?-~]*)?")
_NOT_ALLOWED = re.compile(r"[^ -)+-;=?-~]")


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    Attributes:
        start: `TO_CONTROLLER` or `FROM_CONTROLLER`.
        number: 0 to 65535.
        body: kind and arguments, joined by commas.
    """

    start: str
    number: int
    body: str

    @property
    def kind(self) -> str:
        """The first word of the body."""
        return self.body.partition(",")[0]


def encode_frame(frame: Frame) -> bytes:
    """Return the bytes of a frame; raise ProtocolError if it has none."""
    if (
        frame.start not in (TO_CONTROLLER, FROM_CONTROLLER)
        or not 0 <= frame.number <= 65535
        or len(frame.body) > MAX_BODY
        or not _BODY.fullmatch(frame.body)
    ):
        raise ProtocolError(
            f"a frame cannot carry number {frame.number} and '{frame.body[:40]}'; the number goes from 0 to 65535, the "
            f"body has up to {MAX_BODY} printable ASCII characters without * < > and begins with a kind in capitals"
        )
    head = f"{frame.start}{frame.number:05d},{len(frame.body):04d},{frame.body}".encode("ascii")
    return head + b"*%08X\r\n" % zlib.crc32(head)


def decode_frame(data: bytes) -> Frame | None:
    """Return the frame that consists of exactly these bytes, or None."""
    match = _FRAME.fullmatch(data)
    if match is None or len(data) > MAX_FRAME:
        return None
    start, number, length, body, crc = match.groups()
    if int(length) != len(body) or int(number) > 65535 or int(crc, 16) != zlib.crc32(data[:-11]):
        return None
    text = body.decode("ascii")
    return Frame(start.decode("ascii"), int(number), text) if _BODY.fullmatch(text) else None


def split_frames(received: bytes) -> tuple[list[bytes], bytes]:
    """Cut a stream into candidates for `decode_frame`, each from the last start character of a line to its LF.

    Args:
        received: all bytes that are not yet cut.

    Returns:
        The candidates, and the remaining bytes that may become one.
    """
    *lines, rest = received.split(b"\n")
    candidates = []
    for line in lines:
        begin = max(line.rfind(b">"), line.rfind(b"<"))
        if begin >= 0:
            candidates.append(line[begin:] + b"\n")
    begin = max(rest.rfind(b">"), rest.rfind(b"<"))
    rest = rest[begin:] if begin >= 0 else b""
    return candidates, rest if len(rest) < MAX_FRAME else b""


def to_frame_text(text: str) -> str:
    """Return a text that a body may hold: other characters become question marks."""
    return _NOT_ALLOWED.sub("?", text)


COUNTS_PER_FRAME: Final = 72
"""Largest number of counts in one frame, by their longest spelling: 12 via points of six axes."""

_INTEGER = re.compile(r"0|-?[1-9][0-9]*")
_COUNT = re.compile(r"0|-?[1-9][0-9]{0,9}")
_CRC = re.compile(r"[0-9A-F]{8}")


@dataclass(frozen=True, slots=True)
class Hello:
    """Request for the capabilities (HELLO)."""

    version: int = VERSION


@dataclass(frozen=True, slots=True)
class ReadState:
    """Request for the state (STATE); the owner's heartbeat."""


Request = Hello | ReadState | wire.Request


def request_frame(number: int, session: int, request: Request) -> Frame:
    """Return the frame of a request; HELLO has no session."""
    match request:
        case Hello(version):
            body = f"HELLO,{version}"
        case ReadState():
            body = _joined("STATE", session)
        case Take(watchdog_ms):
            body = _joined("TAKE", session, watchdog_ms)
        case Give():
            body = _joined("GIVE", session)
        case Stage(offset, points):
            body = _joined("POINTS", session, offset, len(points), *points.ravel().tolist())
        case Commit(speed, count, crc, tail):
            body = _joined("MOVE", session, speed, count, f"{crc:08X}", len(tail), *tail.ravel().tolist())
        case Stop():
            body = _joined("STOP", session)
        case Reset():
            body = _joined("RESET", session)
    return Frame(TO_CONTROLLER, number, body)


def parse_request(frame: Frame, axes: int = AXES) -> tuple[int, Request] | None:
    """Return session and request of a frame to a controller with this number of axes, or None."""
    if frame.start != TO_CONTROLLER:
        return None
    kind, *rest = frame.body.split(",")
    words = iter(rest)
    request: Request | None = None
    try:
        session = 0 if kind == "HELLO" else _integer(words, 0, 65535)
        match kind:
            case "HELLO":
                request = Hello(_integer(words))
            case "STATE":
                request = ReadState()
            case "TAKE":
                request = Take(_integer(words, 0, 65535))
            case "GIVE":
                request = Give()
            case "POINTS":
                request = Stage(_integer(words, 0), _points(words, axes))
            case "MOVE":
                request = Commit(_integer(words, 0, 65535), _integer(words, 1), _crc(words), _points(words, axes))
            case "STOP":
                request = Stop()
            case "RESET":
                request = Reset()
        return None if request is None or any(True for _ in words) else (session, request)
    except (ValueError, StopIteration):
        return None


def answer_frame(number: int, kind: str, answer: Answer) -> Frame:
    """Return the frame of an answer to any request except HELLO and STATE."""
    return Frame(FROM_CONTROLLER, number, _with_text(f"{kind},{int(answer.result)}", answer.detail))


def parse_answer(frame: Frame, kind: str) -> Answer | None:
    """Return the answer in a frame to a request of this kind, or None."""
    answered, words = _kind_and_arguments(frame)
    if answered != kind:
        return None
    try:
        return Answer(frame.number, _integer(words, 0, 65535), _text(words))
    except (ValueError, StopIteration):
        return None


def status_frame(number: int, state: RobotState) -> Frame:
    """Return the frame of the answer to STATE."""
    values = [int(getattr(state, name) or 0) for name in STATUS_FIELDS]
    body = _joined("STATE", *values, len(state.axes), *state.axes.tolist())
    return Frame(FROM_CONTROLLER, number, _with_text(body, state.fault_message))


def parse_status(frame: Frame) -> RobotState | None:
    """Return the state in a frame, or None."""
    kind, words = _kind_and_arguments(frame)
    if kind != "STATE":
        return None
    try:
        values = {name: _integer(words, 0, 65535) for name in STATUS_FIELDS}
        mode, axes = Mode(values.pop("mode")), _axes(words, _integer(words, AXES, MAX_AXES))
        return RobotState(mode, axes, bool(values["flags"] & Flag.AT_REST), fault_message=_text(words), **values)
    except (ValueError, StopIteration, RuntimeError):
        return None


def hello_frame(number: int, capabilities: Capabilities) -> Frame:
    """Return the frame of the answer to HELLO."""
    limits = (capabilities.lower, capabilities.upper, capabilities.max_step)
    body = _joined(
        "HELLO",
        VERSION,
        len(capabilities.lower),
        round(capabilities.time_scale * REAL_TIME),
        speed_to_wire(capabilities.max_speed),
        capabilities.max_via or 0,
        *(count for counts in limits for count in counts.tolist()),
    )
    return Frame(FROM_CONTROLLER, number, _with_text(body, capabilities.controller))


def parse_hello(frame: Frame) -> Capabilities | None:
    """Return the capabilities in a frame, or None.

    Raises:
        ProtocolError: if the controller speaks another version of the protocol.
    """
    kind, words = _kind_and_arguments(frame)
    if kind != "HELLO":
        return None
    try:
        version = _integer(words, 0)
        if version != VERSION:
            raise ProtocolError(
                f"the controller speaks version {version} of the protocol and this driver {VERSION}, see "
                "docs/internals/protocol.md; bring both to one version"
            )
        axes, scale = _integer(words, AXES, MAX_AXES), _integer(words, 0, 2**32 - 1)
        speed, max_via = _integer(words, 0, FULL), _integer(words, 0)
        lower, upper, step = (_axes(words, axes) for _ in range(3))
        return Capabilities(
            controller=_text(words),
            lower=lower,
            upper=upper,
            max_step=step,
            max_speed=speed_from_wire(speed),
            max_via=max_via or None,
            hardware=True,
            simulated_time=False,
            time_scale=scale / REAL_TIME,
        )
    except (ValueError, StopIteration, RuntimeError):
        return None


def error_frame(number: int, text: str) -> Frame:
    """Return the ERROR frame, the answer to a request that could not be served."""
    return Frame(FROM_CONTROLLER, number, _with_text("ERROR", text))


def parse_error(frame: Frame) -> str | None:
    """Return the text of an ERROR frame, or None."""
    kind, words = _kind_and_arguments(frame)
    try:
        return _text(words) if kind == "ERROR" else None
    except StopIteration:
        return None


def _kind_and_arguments(frame: Frame) -> tuple[str, Iterator[str]]:
    if frame.start != FROM_CONTROLLER:
        return "", iter(())
    kind, *words = frame.body.split(",")
    return kind, iter(words)


def _joined(*words: object) -> str:
    return ",".join(map(str, words))


def _with_text(body: str, text: str) -> str:
    return f"{body},{to_frame_text(text)}"[:MAX_BODY]


def _integer(words: Iterator[str], lowest: int = -(2**63), highest: int = 2**63 - 1) -> int:
    word = next(words)
    if not _INTEGER.fullmatch(word) or not len(word) <= 20 or not lowest <= int(word) <= highest:
        raise ValueError(word)
    return int(word)


def _axes(words: Iterator[str], axes: int) -> SetPoints:
    return np.array([_integer(words, -(2**31), 2**31 - 1) for _ in range(axes)], dtype=np.int32)


def _crc(words: Iterator[str]) -> int:
    word = next(words)
    if not _CRC.fullmatch(word):
        raise ValueError(word)
    return int(word, 16)


def _points(words: Iterator[str], axes: int) -> SetPoints:
    n = _integer(words, 1, COUNTS_PER_FRAME // axes)
    texts = list(islice(words, n * axes))
    if len(texts) != n * axes or not all(map(_COUNT.fullmatch, texts)):
        raise ValueError("points")
    counts = np.array(texts, dtype=np.int64).reshape(n, axes)
    points = counts.astype(np.int32)
    if (points != counts).any():
        raise ValueError("points")
    return points


def _text(words: Iterator[str]) -> str:
    """Return the remaining words as text; its comma is present even if the text is empty."""
    first = next(words)
    return ",".join([first, *words])
