r"""ASCII frames of the serial line: bytes to values and back. docs/internals/protocol.md describes each byte.

    > 00042,0004,STOP * 59A379F2 CR LF        (without the blanks)
    | |     |    |      `-- CRC-32 of everything before the asterisk, 8 capital hexadecimal digits
    | |     |    `--------- body: the kind, then its arguments after commas
    | |     `-------------- number of characters of the body, 4 digits
    | `-------------------- number, 5 digits: a command's sequence number, or a query's running number
    `---------------------- > to the controller, < from it

There is one way to write a frame: what decodes encodes to the same bytes, so that no mangled frame passes for
another spelling of a good one. `>`, `<` and `*` do not stand in a body, so a frame begins at the last start character
of its line, whatever was lost or left over before it. The CRC-32 finds every burst of up to 32 bits and, in frames as
short as these, every three flipped bits; the length finds what was cut or joined without asking the CRC.
"""

import re
import zlib
from dataclasses import dataclass
from typing import Final

from drivers.errors import ProtocolError

TO_CONTROLLER: Final = ">"
FROM_CONTROLLER: Final = "<"

MAX_FRAME: Final = 1024
"""Longest frame in bytes, start character and CR LF included."""

_OVERHEAD: Final = len(">00000,0000,*00000000\r\n")
MAX_BODY: Final = MAX_FRAME - _OVERHEAD

_FRAME = re.compile(rb"([<>])([0-9]{5}),([0-9]{4}),([ -)+-;=?-~]+)\*([0-9A-F]{8})\r\n")
_BODY = re.compile(r"[A-Z]+(,[ -)+-;=?-~]*)?")
_FOREIGN = re.compile(r"[^ -)+-;=?-~]")


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


def encode(frame: Frame) -> bytes:
    """Bytes of a frame.

    Raises:
        ProtocolError: if it cannot be written.
    """
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


def decode(data: bytes) -> Frame | None:
    """The frame that exactly these bytes are, or None where they are not one."""
    match = _FRAME.fullmatch(data)
    if match is None or len(data) > MAX_FRAME:
        return None
    start, number, length, body, crc = match.groups()
    if int(length) != len(body) or int(number) > 65535 or int(crc, 16) != zlib.crc32(data[:-11]):
        return None
    text = body.decode("ascii")
    return Frame(start.decode("ascii"), int(number), text) if _BODY.fullmatch(text) else None


def split(received: bytes) -> tuple[list[bytes], bytes]:
    """Cut a stream into candidates for `decode`, each from the last start character of a line to its LF.

    Args:
        received: all bytes that were not yet cut.

    Returns:
        The candidates, and the rest that may become one.
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


def plain(text: str) -> str:
    """A text as a body may carry it: foreign characters become question marks."""
    return _FOREIGN.sub("?", text)
