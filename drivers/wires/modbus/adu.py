"""Modbus telegrams of the controller's side: bytes to requests, answers to bytes, as pure functions.

The telegrams that our map needs, after the MODBUS Application Protocol Specification V1.1b3 and the guides for TCP/IP
(MBAP header) and for serial lines (RTU, CRC-16 with polynomial 0xA001, low byte first). The client's side is pymodbus:
two implementations that have to agree test each other. It is a server of ours because a test bench has to delay, cut,
double and spoil single telegrams at exact places, which no library's server offers.
"""

import struct
from dataclasses import dataclass
from typing import Final

READ_INPUT, WRITE_HOLDING = 4, 16

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4

MAX_READ, MAX_WRITE = 125, 123

_MBAP: Final = struct.Struct(">HHHB")
_SHORTEST_RTU = 4


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
class Refusal:
    """What cannot be answered otherwise: an exception telegram."""

    function: int
    code: int


@dataclass(frozen=True, slots=True)
class Header:
    """What an answer repeats from its request.

    Attributes:
        unit: device address.
        transaction: of TCP; None: RTU.
    """

    unit: int
    transaction: int | None


def request_of(pdu: bytes) -> Read | Write | Refusal:
    """The request of a protocol data unit (function code and data)."""
    function = pdu[0] if pdu else 0
    if function == READ_INPUT:
        if len(pdu) != 5:
            return Refusal(function, ILLEGAL_VALUE)
        address, count = struct.unpack(">HH", pdu[1:])
        return Read(address, count) if 1 <= count <= MAX_READ else Refusal(function, ILLEGAL_VALUE)
    if function == WRITE_HOLDING:
        if len(pdu) < 6:
            return Refusal(function, ILLEGAL_VALUE)
        address, count, size = struct.unpack(">HHB", pdu[1:6])
        if not 1 <= count <= MAX_WRITE or size != 2 * count or len(pdu) != 6 + size:
            return Refusal(function, ILLEGAL_VALUE)
        return Write(address, struct.unpack(f">{count}H", pdu[6:]))
    return Refusal(function & 0x7F, ILLEGAL_FUNCTION)


def registers_pdu(values: list[int]) -> bytes:
    """The answer to a `Read`."""
    return struct.pack(f">BB{len(values)}H", READ_INPUT, 2 * len(values), *values)


def written_pdu(request: Write) -> bytes:
    """The answer to a `Write`."""
    return struct.pack(">BHH", WRITE_HOLDING, request.address, len(request.values))


def refusal_pdu(refusal: Refusal) -> bytes:
    """The exception telegram."""
    return bytes([refusal.function | 0x80, refusal.code])


def pack(header: Header, pdu: bytes) -> bytes:
    """A telegram around a protocol data unit."""
    if header.transaction is not None:
        return _MBAP.pack(header.transaction, 0, len(pdu) + 1, header.unit) + pdu
    data = bytes([header.unit]) + pdu
    return data + crc16(data).to_bytes(2, "little")


def unpack_tcp(packet: bytes) -> tuple[Header, bytes] | None:
    """Header and protocol data unit of exactly one TCP telegram, or None."""
    if len(packet) <= _MBAP.size:
        return None
    transaction, protocol, length, unit = _MBAP.unpack_from(packet)
    if protocol != 0 or length != len(packet) - 6 or length > 254:
        return None
    return Header(unit, transaction), packet[_MBAP.size :]


def unpack_rtu(packet: bytes) -> tuple[Header, bytes] | None:
    """Header and protocol data unit of exactly one RTU telegram, or None."""
    if not _SHORTEST_RTU <= len(packet) <= 256 or crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
        return None
    return Header(packet[0], None), packet[1:-2]


def split_tcp(received: bytes) -> tuple[list[bytes], bytes] | None:
    """Cut a stream into telegrams and the rest; None where it cannot be Modbus: the connection is to be closed."""
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
    """Cut a stream into requests with a right CRC and the rest that may become one; bytes that fit nowhere are dropped.

    RTU marks the end of a telegram by silence, which an operating system does not show reliably; requests of the
    known functions tell their length themselves. Whoever reads drops the rest after a silence.
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
        if unpack_rtu(received[at : at + size]) is None:
            at += 1
            continue
        packets.append(received[at : at + size])
        at += size
    return packets, received[at:]


def _crc16_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
        table.append(byte)
    return tuple(table)


_CRC16 = _crc16_table()


def crc16(data: bytes) -> int:
    """CRC-16/MODBUS."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC16[(crc ^ byte) & 0xFF]
    return crc
