"""What the serial line's frames say: bodies to values and back. docs/internals/protocol.md has the table of kinds.

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
from drivers.contract import Capabilities, Flag, Mode, RobotState
from drivers.errors import ProtocolError
from drivers.setpoints import AXES, SetPoints
from drivers.wire import MOST_AXES, SCALES, SPEEDS, Commit, Stage, speed_from_wire, speed_to_wire
from drivers.wires.serial.frames import FROM_CONTROLLER, MAX_BODY, TO_CONTROLLER, Frame, plain

VERSION: Final = 2

COUNTS_PER_FRAME: Final = 72
"""Set-points of one frame: so many of the longest fit beside the other arguments; 12 via points of six axes."""

_INTEGER = re.compile(r"0|-?[1-9][0-9]*")
_COUNT = re.compile(r"0|-?[1-9][0-9]{0,9}")
_CRC = re.compile(r"[0-9A-F]{8}")


@dataclass(frozen=True, slots=True)
class Hello:
    """Who are you? Asks for the capabilities."""

    version: int = VERSION


@dataclass(frozen=True, slots=True)
class Beat:
    """How are you? Asks for the state; of the owner it is the heartbeat."""


@dataclass(frozen=True, slots=True)
class Take:
    """Asks for the arm, or keeps it.

    Attributes:
        watchdog_ms: silence [ms] after which a moving arm shall stop.
    """

    watchdog_ms: int


@dataclass(frozen=True, slots=True)
class Give:
    """Gives the arm back."""


Request = Hello | Beat | Take | Give | Stage | Commit | Stop | Reset


def request_frame(number: int, session: int, request: Request) -> Frame:
    """The frame of a request; a hello is of no session."""
    match request:
        case Hello(version):
            body = f"HELLO,{version}"
        case Beat():
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


def request_of(frame: Frame, axes: int = AXES) -> tuple[int, Request] | None:
    """Session and request of a frame to a controller of so many axes, or None where it is none of ours."""
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
                request = Beat()
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
    """The frame that answers all but HELLO and STATE."""
    return Frame(FROM_CONTROLLER, number, _with_text(f"{kind},{int(answer.result)}", answer.detail))


def answer_of(frame: Frame, kind: str) -> Answer | None:
    """The answer of a frame to a command of a kind, or None."""
    name, words = _start(frame)
    if name != kind:
        return None
    try:
        return Answer(frame.number, _integer(words, 0, 65535), _text(words))
    except (ValueError, StopIteration):
        return None


def status_frame(number: int, s: RobotState) -> Frame:
    """The frame that answers STATE."""
    body = _joined(
        "STATE", s.heartbeat or 0, s.boot, s.flags, int(s.mode), s.owner, s.ack_sequence, int(s.ack_result),
        s.done_sequence, int(s.done_result), s.queue_depth, int(s.fault_code), s.override, s.path,
        len(s.axes), *s.axes.tolist(),
    )  # fmt: skip
    return Frame(FROM_CONTROLLER, number, _with_text(body, s.fault_sentence))


def status_of(frame: Frame) -> RobotState | None:
    """The state of a frame, or None."""
    name, words = _start(frame)
    if name != "STATE":
        return None
    try:
        beat, boot, flags, mode, owner, ack, ack_result, done, done_result, queue, fault, override, path = (
            _integer(words, 0, 65535) for _ in range(13)
        )
        axes = _axes(words, _integer(words, AXES, MOST_AXES))
        return RobotState(
            Mode(mode), axes, bool(flags & Flag.STANDS), ack, ack_result, done, done_result, queue, fault, _text(words),
            boot, owner, beat, override, path, flags,
        )  # fmt: skip
    except (ValueError, StopIteration, RuntimeError):
        return None


def hello_frame(number: int, able: Capabilities) -> Frame:
    """The frame that answers HELLO."""
    limits = [*able.lower.tolist(), *able.upper.tolist(), *able.max_step.tolist()]
    body = _joined(
        "HELLO", VERSION, len(able.lower), round(able.time_scale * SCALES), speed_to_wire(able.max_speed),
        able.max_via or 0, *limits,
    )  # fmt: skip
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
            raise ProtocolError(
                f"the controller speaks version {version} of the protocol and this driver {VERSION}, see "
                "docs/internals/protocol.md; bring both to one version"
            )
        axes, scale = _integer(words, AXES, MOST_AXES), _integer(words, 0, 2**32 - 1)
        speed, max_via = _integer(words, 0, SPEEDS), _integer(words, 0)
        lower, upper, step = (_axes(words, axes) for _ in range(3))
        return Capabilities(
            controller=_text(words), lower=lower, upper=upper, max_step=step, max_speed=speed_from_wire(speed),
            max_via=max_via or None, hardware=True, simulated_time=False, time_scale=scale / SCALES,
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


def _axes(words: Iterator[str], axes: int) -> SetPoints:
    return np.array([_integer(words, -(2**31), 2**31 - 1) for _ in range(axes)], dtype=np.int32)


def _crc(words: Iterator[str]) -> int:
    word = next(words)
    if not _CRC.fullmatch(word):
        raise ValueError(word)
    return int(word, 16)


def _points(words: Iterator[str], axes: int) -> SetPoints:
    n = _integer(words, 1, COUNTS_PER_FRAME // axes)
    taken = list(islice(words, n * axes))
    if len(taken) != n * axes or not all(map(_COUNT.fullmatch, taken)):
        raise ValueError("points")
    counts = np.array(taken, dtype=np.int64).reshape(n, axes)
    points = counts.astype(np.int32)
    if (points != counts).any():
        raise ValueError("points")
    return points


def _text(words: Iterator[str]) -> str:
    """All that is left; the text's comma stands even where the text is empty."""
    first = next(words)
    return ",".join([first, *words])
