"""The controller's end of the protocols: bytes of one telegram in, bytes of its answer out.

`SerialStation` answers frames, `ModbusStation` the Modbus telegrams that the register map needs, after the MODBUS
Application Protocol Specification V1.1b3 and the guides for TCP/IP (MBAP header) and serial lines (RTU, CRC-16 with
polynomial 0xA001, low byte first). The client uses pymodbus: two independent implementations test each other. This end
uses no library because a test bench must delay, cut, double and corrupt single telegrams at exact places.
"""

import logging
import math
import struct
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np

from drivers.contract import Answer, Reset, Result, Stop
from drivers.emulated.endpoint import Endpoint
from drivers.errors import ProtocolError
from drivers.setpoints import SetPoints
from drivers.wire import REAL_TIME, STATUS_FIELDS, Commit, Give, Stage, Take, speed_to_wire
from drivers.wires import modbus_protocol as registers
from drivers.wires.serial_protocol import (
    TO_CONTROLLER,
    VERSION,
    Frame,
    Hello,
    ReadState,
    Request,
    answer_frame,
    decode_frame,
    encode_frame,
    error_frame,
    hello_frame,
    parse_request,
    split_frames,
    status_frame,
)

_log = logging.getLogger(__name__)

RTU_SILENCE = 0.05
"""Silence [s] after which a broken telegram is dropped; the 3.5 characters of the specification are much less."""

READ_INPUT, WRITE_HOLDING = 4, 16

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4

MAX_READ, MAX_WRITE = 125, 123

_MBAP: Final = struct.Struct(">HHHB")
_MIN_RTU = 4


@dataclass(frozen=True, slots=True)
class Read:
    """FC04: read input registers."""

    address: int
    count: int


@dataclass(frozen=True, slots=True)
class Write:
    """FC16: write holding registers."""

    address: int
    values: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Header:
    """Fields that an answer repeats from its request.

    Attributes:
        unit: device address.
        transaction: of TCP; None: RTU.
    """

    unit: int
    transaction: int | None


def parse_pdu(pdu: bytes) -> Read | Write | bytes:
    """Return the request in a protocol data unit (function code and data), or the exception that answers it."""
    function = pdu[0] if pdu else 0
    if function == READ_INPUT:
        if len(pdu) != 5:
            return exception(function, ILLEGAL_VALUE)
        address, count = struct.unpack(">HH", pdu[1:])
        return Read(address, count) if 1 <= count <= MAX_READ else exception(function, ILLEGAL_VALUE)
    if function == WRITE_HOLDING:
        if len(pdu) < 6:
            return exception(function, ILLEGAL_VALUE)
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if not 1 <= count <= MAX_WRITE or size != 2 * count or len(pdu) != 6 + size:
            return exception(function, ILLEGAL_VALUE)
        return Write(address, struct.unpack(f">{count}H", pdu[6:]))
    return exception(function, ILLEGAL_FUNCTION)


def exception(function: int, code: int) -> bytes:
    """Return the protocol data unit of an exception."""
    return bytes([function | 0x80, code])


def pack(header: Header, pdu: bytes) -> bytes:
    """Return the telegram around a protocol data unit."""
    if header.transaction is not None:
        return _MBAP.pack(header.transaction, 0, len(pdu) + 1, header.unit) + pdu
    data = bytes([header.unit]) + pdu
    return data + crc16(data).to_bytes(2, "little")


def parse_tcp(packet: bytes) -> tuple[Header, bytes] | None:
    """Return header and protocol data unit of exactly one TCP telegram, or None."""
    if len(packet) <= _MBAP.size:
        return None
    transaction, protocol, length, unit = _MBAP.unpack_from(packet)
    if protocol != 0 or length != len(packet) - 6 or length > 254:
        return None
    return Header(unit, transaction), packet[_MBAP.size :]


def parse_rtu(packet: bytes) -> tuple[Header, bytes] | None:
    """Return header and protocol data unit of exactly one RTU telegram, or None."""
    if not _MIN_RTU <= len(packet) <= 256 or crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
        return None
    return Header(packet[0], None), packet[1:-2]


def split_tcp(received: bytes) -> tuple[list[bytes], bytes] | None:
    """Cut a stream into telegrams and the rest; None if it cannot be Modbus: close the connection."""
    packets = []
    while len(received) >= 6:
        _, protocol, length = struct.unpack_from(">HHH", received)
        if protocol != 0 or not 2 <= length <= 254:
            return None
        if len(received) < 6 + length:
            break
        packets.append(received[: 6 + length])
        received = received[6 + length :]
    return packets, received


def split_rtu(received: bytes) -> tuple[list[bytes], bytes]:
    """Cut a stream into requests with a correct CRC and a rest that may become one; drop all other bytes.

    RTU marks the end of a telegram by silence, which an operating system does not show reliably; requests of the
    known functions contain their length. The caller drops the rest after a silence.
    """
    packets, at = [], 0
    while at + 1 < len(received):
        function = received[at + 1]
        if function in (15, WRITE_HOLDING):
            if at + 6 >= len(received):
                break
            size = 9 + received[at + 6]
        elif function in (1, 2, 3, READ_INPUT, 5, 6):
            size = 8
        else:
            at += 1
            continue
        if at + size > len(received):
            break
        if parse_rtu(received[at : at + size]) is None:
            at += 1
            continue
        packets.append(received[at : at + size])
        at += size
    return packets, received[at:]


def crc16(data: bytes) -> int:
    """Return the CRC-16/MODBUS."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_OF_BYTE[(crc ^ byte) & 0xFF]
    return crc


def _shifted_out(crc: int) -> int:
    for _ in range(8):
        crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


_CRC_OF_BYTE = [_shifted_out(byte) for byte in range(256)]


class Rest(Protocol):
    """A state that says whether the arm is at rest."""

    @property
    def at_rest(self) -> bool:
        """Whether the arm is at rest."""


class EmulatedController(Protocol):
    """A controller as the server of its line sees it.

    Attributes:
        moves: number of accepted moves.
    """

    moves: int

    def tick(self) -> Rest:
        """Let time pass."""

    def time_to_wait(self) -> float:
        """Return the rest of the current motion [s]."""

    def emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop."""

    def brake_for_restart(self) -> None:
        """Brake on the path as in a power failure."""

    def restart(self) -> None:
        """Restart the controller over the same arm."""


class Station(Protocol):
    """The controller's end of one protocol."""

    @property
    def endpoint(self) -> EmulatedController:
        """The controller."""

    silence: float
    """Time [s] after which an incomplete telegram is dropped."""

    def split(self, received: bytes) -> tuple[list[bytes], bytes] | None:
        """Cut a stream into telegrams and the rest; None if it violates the protocol: close the connection."""

    def answer(self, packet: bytes) -> bytes:
        """Return the answer to a telegram; empty if there is none."""

    def refuse(self, packet: bytes) -> bytes:
        """Return a refusal of a telegram that is not executed."""

    def restart(self) -> None:
        """Reset the protocol state after a restart of the controller."""


class SerialStation:
    """The controller's end of the serial protocol."""

    silence = math.inf  # a frame ends with its LF, however long it takes

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._last = b""

    def split(self, received: bytes) -> tuple[list[bytes], bytes]:
        """Cut a stream into frames and the rest."""
        return split_frames(received)

    def restart(self) -> None:
        """Reset the protocol state after a restart of the controller."""
        self._last = b""

    def answer(self, packet: bytes) -> bytes:
        """Return the answer; empty for bytes that are no frame, or a frame of another controller."""
        frame = decode_frame(packet)
        if frame is None or frame.start != TO_CONTROLLER:
            _log.debug("not a frame to a controller: %r", packet[:80])
            return b""
        message = parse_request(frame, len(self.endpoint.limits.lower))
        if message is None:
            return encode_frame(error_frame(frame.number, f"cannot understand {frame.kind} or its arguments"))
        session, request = message
        answer = self._answer(frame, session, request)
        if session and session == self.endpoint.owner and packet != self._last:  # a copy is no heartbeat
            self._last = packet
            self.endpoint.note_activity(session)
        return encode_frame(answer)

    def refuse(self, packet: bytes) -> bytes:
        """Return a refusal of a telegram that is not executed."""
        frame = decode_frame(packet)
        return encode_frame(error_frame(frame.number, "the controller is occupied")) if frame else b""

    def _answer(self, frame: Frame, session: int, request: Request) -> Frame:
        number = frame.number
        match request:
            case Hello(version):
                if version != VERSION:
                    return error_frame(
                        number, f"this controller speaks version {VERSION} of the protocol, not {version}"
                    )
                return hello_frame(number, self.endpoint.capabilities)
            case ReadState():
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


class ModbusStation:
    """The controller's end of the Modbus map, TCP and RTU.

    Args:
        endpoint: the controller.
        unit: device address; telegrams to other addresses are ignored.
        rtu: RTU instead of TCP.
    """

    def __init__(self, endpoint: Endpoint, *, unit: int = 1, rtu: bool = False) -> None:
        self.endpoint = endpoint
        self._unit, self._rtu = unit, rtu
        self._axes = len(endpoint.limits.lower)
        self._blocks = {block.name: block.for_axes(self._axes) for block in registers.BLOCKS}
        self.silence = RTU_SILENCE if rtu else math.inf
        self.restart()

    def restart(self) -> None:
        """Reset the protocol state after a restart of the controller."""
        self._heartbeat = self._owner_heartbeat = -1
        self._answer = Answer(0, Result.OK)

    def split(self, received: bytes) -> tuple[list[bytes], bytes] | None:
        """Cut a stream into telegrams and the rest; None if it cannot be Modbus."""
        return split_rtu(received) if self._rtu else split_tcp(received)

    def answer(self, packet: bytes) -> bytes:
        """Return the answer; empty for bytes that are no telegram, or a telegram to another device."""
        parsed = self._parse(packet)
        if parsed is None or parsed[0].unit != self._unit:
            return b""
        header, pdu = parsed
        match parse_pdu(pdu):
            case Read() as request:
                return pack(header, self._read(request))
            case Write() as request:
                return pack(header, self._write(request))
            case refusal:
                return pack(header, refusal)

    def refuse(self, packet: bytes) -> bytes:
        """Return a refusal of a telegram that is not executed: device failure."""
        parsed = self._parse(packet)
        if parsed is None:
            return b""
        header, pdu = parsed
        return pack(header, exception(pdu[0], DEVICE_FAILURE))

    def _parse(self, packet: bytes) -> tuple[Header, bytes] | None:
        return parse_rtu(packet) if self._rtu else parse_tcp(packet)

    def _read(self, request: Read) -> bytes:
        for name, values in ((registers.STATUS.name, self._status), (registers.CAPABILITIES.name, self._capabilities)):
            block = self._blocks[name]
            first = request.address - block.address
            if first >= 0 and first + request.count <= block.registers:
                read = block.encode(values())[first : first + request.count]
                return struct.pack(f">BB{len(read)}H", READ_INPUT, 2 * len(read), *read)
        return exception(READ_INPUT, ILLEGAL_ADDRESS)

    def _write(self, request: Write) -> bytes:
        if request.address != registers.COMMAND.address:
            return exception(WRITE_HOLDING, ILLEGAL_ADDRESS)
        try:
            values, counts = self._blocks[registers.COMMAND.name].decode(request.values)
        except ProtocolError:
            return exception(WRITE_HOLDING, ILLEGAL_VALUE)
        points = np.array(counts, dtype=np.int32).reshape(-1, self._axes)
        fields = {name: value for name, value in values.items() if isinstance(value, int)}
        if fields["points"] != len(points):
            return exception(WRITE_HOLDING, ILLEGAL_VALUE)
        self._heartbeat, session = fields["heartbeat"], fields["session"]
        if fields["command"] != registers.NONE:
            self._answer = self._command(fields, points)
        if session and session == self.endpoint.owner and self._heartbeat != self._owner_heartbeat:
            self._owner_heartbeat = self._heartbeat  # a block repeated by a gateway is no heartbeat
            self.endpoint.note_activity(session)
        return struct.pack(">BHH", WRITE_HOLDING, request.address, len(request.values))

    def _command(self, fields: dict[str, int], points: SetPoints) -> Answer:
        sequence, session = fields["sequence"], fields["session"]
        match fields["command"]:
            case registers.MOVE if len(points):
                commit = Commit(fields["speed"], fields["count"], fields["points_crc"], points)
                return self.endpoint.commit(session, sequence, commit)
            case registers.STAGE if len(points):
                return self.endpoint.stage(session, sequence, Stage(fields["offset"], points))
            case registers.STOP:
                return self.endpoint.command(session, sequence, Stop())
            case registers.RESET:
                return self.endpoint.command(session, sequence, Reset())
            case registers.TAKE:
                return replace(self.endpoint.take(session, fields["watchdog_ms"]), sequence=sequence)
            case registers.GIVE:
                return replace(self.endpoint.give(session), sequence=sequence)
        return Answer(sequence, Result.UNKNOWN_COMMAND)

    def _status(self) -> dict[str, registers.Value]:
        state = self.endpoint.report()
        return {
            **_IDENTITY,
            **{name: int(getattr(state, name) or 0) for name in STATUS_FIELDS},
            "echo": max(self._heartbeat, 0),
            "answer_sequence": self._answer.sequence,
            "answer_result": int(self._answer.result),
            "n_axes": self._axes,
            "axes": tuple(state.axes.tolist()),
        }

    def _capabilities(self) -> dict[str, registers.Value]:
        capabilities = self.endpoint.capabilities
        return {
            **_IDENTITY,
            "n_axes": self._axes,
            "time_scale": round(capabilities.time_scale * REAL_TIME),
            "max_speed": speed_to_wire(capabilities.max_speed),
            "max_via": capabilities.max_via or 0,
            "lower": tuple(capabilities.lower.tolist()),
            "upper": tuple(capabilities.upper.tolist()),
            "max_step": tuple(capabilities.max_step.tolist()),
            "name": capabilities.controller,
        }


_IDENTITY: dict[str, registers.Value] = {
    "magic": registers.MAGIC,
    "version": registers.MAP_VERSION,
    "word_order": registers.WORD_ORDER,
}
