"""KUKAVARPROXY and C3 Bridge: variables of a KUKA controller over TCP, both ends of the wire.

A request is a number (16 bits), the length of the rest (16 bits), 0 to read or 1 to write (8 bits), the name of the
variable and, to write, its value; each text follows its length (16 bits). An answer has the number of the request, the
length, the same mode, the value, and three bytes of which the last is 1 for success. All numbers are big-endian. A
request concerns one variable.

Values are KRL texts: `TRUE`, `12`, `#P_ACTIVE`, `{E6AXIS: A1 0.0,A2 -90.0}`.
"""

import re
import struct
from typing import Final

READ, WRITE = 0, 1

_HEADER: Final = struct.Struct(">HH")
_LENGTH: Final = struct.Struct(">H")
_SUCCESS: Final = b"\x00\x01\x01"
_FAILURE: Final = b"\x00\x01\x00"
_COMPONENT: Final = re.compile(r"([A-Z_]\w*)\s+(-?\d+(?:\.\d*)?(?:[Ee][-+]?\d+)?)")


def request(number: int, name: str, value: str | None = None) -> bytes:
    """Return the request to read a variable, or to write a value."""
    body = bytes([READ if value is None else WRITE]) + _text(name) + (b"" if value is None else _text(value))
    return _HEADER.pack(number, len(body)) + body


def answer(number: int, mode: int, value: str, *, success: bool) -> bytes:
    """Return the answer to a request."""
    body = bytes([mode]) + _text(value) + (_SUCCESS if success else _FAILURE)
    return _HEADER.pack(number, len(body)) + body


def split(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Return the complete messages of a stream, number and body each, and the rest."""
    messages, at = [], 0
    while len(data) - at >= _HEADER.size:
        number, length = _HEADER.unpack_from(data, at)
        end = at + _HEADER.size + length
        if len(data) < end:
            break
        messages.append((number, data[at + _HEADER.size : end]))
        at = end
    return messages, data[at:]


def parse_request(body: bytes) -> tuple[int, str, str]:
    """Return mode, name and value of a request; the value of a reading is empty.

    Raises:
        ValueError: if it is none.
    """
    name, rest = _cut(body[1:])
    value, _ = _cut(rest) if body[0] == WRITE else ("", b"")
    return body[0], name, value


def parse_answer(body: bytes) -> tuple[str, bool]:
    """Return the value of an answer, and whether the request succeeded.

    Raises:
        ValueError: if it is none.
    """
    value, rest = _cut(body[1:])
    return value, rest[-1:] == b"\x01"


def components(value: str) -> dict[str, float]:
    """Return the numbers of an aggregate by the names of its components."""
    return {name: float(number) for name, number in _COMPONENT.findall(value)}


def _text(text: str) -> bytes:
    return _LENGTH.pack(len(text)) + text.encode("ascii", errors="replace")


def _cut(data: bytes) -> tuple[str, bytes]:
    """Return the text at the beginning, and the rest."""
    if len(data) < _LENGTH.size:
        raise ValueError("a message of the proxy is too short")
    (length,) = _LENGTH.unpack_from(data)
    if len(data) < _LENGTH.size + length:
        raise ValueError("a text is longer than its message")
    return data[_LENGTH.size : _LENGTH.size + length].decode("ascii", errors="replace"), data[_LENGTH.size + length :]
