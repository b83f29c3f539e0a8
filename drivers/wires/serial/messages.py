"""What the serial line's frames say: bodies to values and back. docs/protocol.md has the table of kinds.

Integers are decimal without leading zeros or plus sign, CRCs 8 capital hexadecimal digits, texts the rest of the body.
As with the frames there is one way to write each value, and what is no such value decodes to None.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np

from drivers.commands import Answer, Reset, Stop
from drivers.contract import Capabilities, Mode, RobotState
from drivers.errors import ProtocolError
from drivers.setpoints import AXES, SetPoints
from drivers.wire import SPEEDS, Commit, Stage, speed_from_wire, speed_to_wire
from drivers.wires.serial.frames import FROM_CONTROLLER, MAX_BODY, TO_CONTROLLER, Frame, plain

VERSION: Final = 1

POINTS_PER_FRAME: Final = 12
"""Via points of one frame: 12 of the longest fit beside the other arguments."""

_INTEGER = re.compile(r"0|-?[1-9][0-9]*")
_COUNT = re.compile(r"0|-?[1-9][0-9]{0,9}")
_CRC = re.compile(r"[0-9A-F]{8}")


@dataclass(frozen=True, slots=True)
class Hello:
    """Who are you? Asks for the capabilities."""

    version: int = VERSION


@dataclass(frozen=True, slots=True)
class Beat:
    """How are you? Asks for the state, and is the client's heartbeat.

    Attributes:
        watchdog_ms: silence [ms] after which a moving arm shall stop.
    """

    watchdog_ms: int


Request = Hello | Beat | Stage | Commit | Stop | Reset


@dataclass(frozen=True, slots=True)
class Status:
    """The answer to a `Beat`.

    Attributes:
        heartbeat: counts on while the controller lives, 0 to 65535.
        state: all else.
    """

    heartbeat: int
    state: RobotState


def request_frame(number: int, request: Request) -> Frame:
    """The frame of a request."""
    match request:
        case Hello(version):
            body = f"HELLO,{version}"
        case Beat(watchdog_ms):
            body = f"STATE,{watchdog_ms}"
        case Stage(offset, points):
            body = _joined("POINTS", offset, len(points), *points.ravel().tolist())
        case Commit(speed, count, crc, tail):
            body = _joined("MOVE", speed, count, f"{crc:08X}", len(tail), *tail.ravel().tolist())
        case Stop():
            body = "STOP"
        case Reset():
            body = "RESET"
    return Frame(TO_CONTROLLER, number, body)


def request_of(frame: Frame) -> Request | None:
    """The request of a frame, or None where it is none of ours."""
    if frame.start != TO_CONTROLLER:
        return None
    words = iter(frame.body.split(","))
    request: Request | None = None
    try:
        match next(words):
            case "HELLO":
                request = Hello(_integer(words))
            case "STATE":
                request = Beat(_integer(words, 0, 65535))
            case "POINTS":
                request = Stage(_integer(words, 0), _points(words))
            case "MOVE":
                request = Commit(_integer(words, 0, 65535), _integer(words, 1), _crc(words), _points(words))
            case "STOP":
                request = Stop()
            case "RESET":
                request = Reset()
        return None if any(True for _ in words) else request
    except (ValueError, StopIteration):
        return None


def answer_frame(kind: str, answer: Answer) -> Frame:
    """The frame that answers POINTS, MOVE, STOP or RESET."""
    return Frame(FROM_CONTROLLER, answer.sequence, _with_text(f"{kind},{int(answer.result)}", answer.detail))


def answer_of(frame: Frame, kind: str) -> Answer | None:
    """The answer of a frame to a command of a kind, or None."""
    name, words = _start(frame)
    if name != kind:
        return None
    try:
        return Answer(frame.number, _integer(words, 0, 65535), _text(words))
    except (ValueError, StopIteration):
        return None


def status_frame(number: int, status: Status) -> Frame:
    """The frame that answers STATE."""
    s = status.state
    body = _joined(
        "STATE", status.heartbeat, s.boot, int(s.mode), int(s.standing), s.ack_sequence, int(s.ack_result),
        s.done_sequence, int(s.done_result), s.queue_depth, int(s.fault_code), *s.axes.tolist(),
    )  # fmt: skip
    return Frame(FROM_CONTROLLER, number, _with_text(body, s.fault_sentence))


def status_of(frame: Frame) -> Status | None:
    """The state of a frame, or None."""
    name, words = _start(frame)
    if name != "STATE":
        return None
    try:
        heartbeat, boot = _integer(words, 0, 65535), _integer(words, 0, 65535)
        mode, standing = Mode(_integer(words, 0, 65535)), _integer(words, 0, 1) == 1
        ack, ack_result, done, done_result, queue, fault = (_integer(words, 0, 65535) for _ in range(6))
        axes = _axes(words)
        state = RobotState(mode, axes, standing, ack, ack_result, done, done_result, queue, fault, _text(words), boot)
    except (ValueError, StopIteration, RuntimeError):
        return None
    return Status(heartbeat, state)


def hello_frame(number: int, able: Capabilities) -> Frame:
    """The frame that answers HELLO."""
    limits = [*able.lower.tolist(), *able.upper.tolist(), *able.max_step.tolist()]
    body = _joined("HELLO", VERSION, speed_to_wire(able.max_speed), able.max_via or 0, *limits)
    return Frame(FROM_CONTROLLER, number, _with_text(body, able.controller))


def hello_of(frame: Frame) -> Capabilities | None:
    """The capabilities of a frame, or None.

    Raises:
        ProtocolError: if the controller speaks another version of the protocol.
    """
    name, words = _start(frame)
    if name != "HELLO":
        return None
    try:
        version = _integer(words, 0)
        if version != VERSION:
            raise ProtocolError(f"the controller speaks version {version} of the protocol; this driver {VERSION}")
        speed, max_via = _integer(words, 1, SPEEDS), _integer(words, 0)
        lower, upper, step = (_axes(words) for _ in range(3))
        return Capabilities(
            controller=_text(words), lower=lower, upper=upper, max_step=step, max_speed=speed_from_wire(speed),
            max_via=max_via or None, hardware=True, simulated_time=False,
        )  # fmt: skip
    except (ValueError, StopIteration, RuntimeError):
        return None


def trouble_frame(number: int, text: str) -> Frame:
    """The frame that answers what cannot be answered otherwise."""
    return Frame(FROM_CONTROLLER, number, _with_text("ERROR", text))


def trouble_of(frame: Frame) -> str | None:
    """The text of such a frame, or None."""
    name, words = _start(frame)
    try:
        return _text(words) if name == "ERROR" else None
    except StopIteration:
        return None


def _start(frame: Frame) -> tuple[str, Iterator[str]]:
    if frame.start != FROM_CONTROLLER:
        return "", iter(())
    kind, *words = frame.body.split(",")
    return kind, iter(words)


def _joined(*words: object) -> str:
    return ",".join(map(str, words))


def _with_text(body: str, text: str) -> str:
    return f"{body},{plain(text)}"[:MAX_BODY]


def _integer(words: Iterator[str], least: int = -(2**63), most: int = 2**63 - 1) -> int:
    word = next(words)
    if not _INTEGER.fullmatch(word) or not len(word) <= 20 or not least <= int(word) <= most:
        raise ValueError(word)
    return int(word)


def _axes(words: Iterator[str]) -> SetPoints:
    return np.array([_integer(words, -(2**31), 2**31 - 1) for _ in range(AXES)], dtype=np.int32)


def _crc(words: Iterator[str]) -> int:
    word = next(words)
    if not _CRC.fullmatch(word):
        raise ValueError(word)
    return int(word, 16)


def _points(words: Iterator[str]) -> SetPoints:
    n = _integer(words, 1, POINTS_PER_FRAME)
    taken = list(islice(words, n * AXES))
    if len(taken) != n * AXES or not all(map(_COUNT.fullmatch, taken)):
        raise ValueError("points")
    counts = np.array(taken, dtype=np.int64).reshape(n, AXES)
    points = counts.astype(np.int32)
    if (points != counts).any():
        raise ValueError("points")
    return points


def _text(words: Iterator[str]) -> str:
    """All that is left; the text's comma stands even where the text is empty."""
    first = next(words)
    return ",".join([first, *words])
