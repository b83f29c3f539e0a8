"""The Modbus register map as data. A test compares it with docs/internals/protocol_registers.csv.

Three blocks, the same on TCP and RTU; addresses are 0-based as in a telegram.

- *Command*, holding registers, written completely in one FC16. Its length depends on the number of its via points.
- *Status*, input registers, read completely in one FC04, so that it is consistent.
- *Capabilities*, input registers, read once: first the head with the number of axes n, then all of it.

Registers are 16 bits, most significant byte first. Two registers make a 32-bit value, the most significant register
first ("big words", ABCD). Two checks detect a gateway that swaps words: the status begins with the float32 1234.5, and
every block ends with a CRC-32 over its registers, whose own words would be swapped too. This CRC also detects errors
that Modbus TCP does not: blocks assembled from two writes, and values that a gateway invented.

The CRC-32 is that of `drivers.wire`, over the registers before it as they are sent: each as two bytes, the most
significant first, in the order of addresses.
"""

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from drivers.errors import ProtocolError

MAGIC: Final = 0x4B52  # "KR"
MAP_VERSION: Final = 2
WORD_ORDER: Final = 1234.5

MAX_WRITTEN: Final = 123
"""Largest number of registers in one FC16."""

PER_AXIS: Final = 0
"""Count of a field with one value for each axis."""

NONE, MOVE, STAGE, STOP, TAKE, GIVE, RESET = 0, 1, 2, 4, 5, 6, 9
"""Command codes. NONE is a heartbeat and nothing else."""

COMMANDS: Final = {
    NONE: "no command: heartbeat only; the sequence is not looked at",
    MOVE: "move through `count` via points, the last `points` of which stand in this block",
    STAGE: "write `points` via points into the buffer of move `sequence`, from `offset` on; nothing moves",
    STOP: "brake on the path; obeyed from everybody, whatever the sequence",
    TAKE: "own the arm as `session`, with the watchdog `watchdog_ms`; the sequence is repeated and not used up",
    GIVE: "give the arm back; the sequence is repeated and not used up",
    RESET: "clear a latched fault",
}

_WIDTH = {"u16": 1, "i32": 2, "u32": 2, "f32": 2, "text": 1}
_CODE = {"u16": "H", "i32": "i", "u32": "I", "f32": "f"}

Value = int | float | str | tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Field:
    """One value of a block.

    Attributes:
        name: its name here and in the documentation.
        type: u16, i32, u32, f32, or text (ASCII, two characters a register, filled up with zero bytes).
        meaning: meaning and unit.
        count: number of consecutive values; of a text, number of registers; `PER_AXIS`: n.
    """

    name: str
    type: str
    meaning: str
    count: int = 1

    @property
    def registers(self) -> int:
        """Number of registers."""
        return _WIDTH[self.type] * self.count


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive fields from an address on.

    Attributes:
        name: for the documentation.
        kind: "holding" or "input".
        address: of its first register, 0-based.
        fields: without the CRC-32 that ends every block.
        optional_points: whether via points may follow between the fields and the CRC.
        axes: number of axes, n; 0 in `BLOCKS`, set by `for_axes`.
    """

    name: str
    kind: str
    address: int
    fields: tuple[Field, ...]
    optional_points: bool = False
    axes: int = 0

    def for_axes(self, axes: int) -> "Block":
        """Return this block for an arm with this number of axes."""
        sized = (replace(field, count=axes) if field.count == PER_AXIS else field for field in self.fields)
        return replace(self, fields=tuple(sized), axes=axes)

    @property
    def max_points(self) -> int:
        """Largest number of via points beside the fields, in a block with optional points."""
        return (MAX_WRITTEN - self.registers) // (2 * self.axes)

    @property
    def registers(self) -> int:
        """Number of registers without via points, CRC included."""
        return sum(field.registers for field in self.fields) + 2

    def encode(self, values: Mapping[str, Value], points: Sequence[int] = ()) -> list[int]:
        """Return the registers of the block.

        Args:
            values: one for each field.
            points: counts of the via points, from A1 on, point by point.

        Raises:
            ProtocolError: if a value does not fit its field.
        """
        try:
            data = b"".join(_pack(field, values[field.name]) for field in self.fields)
            data += struct.pack(f">{len(points)}i", *points)
        except (struct.error, UnicodeEncodeError) as error:
            raise ProtocolError(f"the {self.name} block cannot carry {dict(values)}: {error}") from error
        data += struct.pack(">I", zlib.crc32(data))
        return list(struct.unpack(f">{len(data) // 2}H", data))

    def decode(self, registers: Sequence[int]) -> tuple[dict[str, Value], tuple[int, ...]]:
        """Return values and via points of the block's registers.

        Raises:
            ProtocolError: if the length or the CRC is wrong.
        """
        n_more = len(registers) - self.registers
        if n_more < 0 or (n_more and not self.optional_points) or (n_more and n_more % (2 * self.axes)):
            lengths = f"{self.registers}" + f" and {2 * self.axes} for each via point" * self.optional_points
            raise ProtocolError(f"the {self.name} block has {len(registers)} registers; it must have {lengths}")
        data = struct.pack(f">{len(registers)}H", *registers)
        if zlib.crc32(data[:-4]) != struct.unpack(">I", data[-4:])[0]:
            raise ProtocolError(
                f"the CRC-32 of the {self.name} block is wrong; the block is inconsistent, or its words are swapped"
            )
        return _unpack(self.fields, data), struct.unpack(f">{n_more // 2}i", data[-4 - 2 * n_more : -4])


def _pack(field: Field, value: Value) -> bytes:
    if field.type == "text":
        data = str(value).encode("ascii", "replace")[: 2 * field.count]
        return data.ljust(2 * field.count, b"\0")
    values = value if isinstance(value, tuple) else (value,)
    if len(values) != field.count:
        raise struct.error(f"{field.name} has {len(values)} values; it must have {field.count}")
    return struct.pack(f">{field.count}{_CODE[field.type]}", *values)


def _unpack(fields: Sequence[Field], data: bytes) -> dict[str, Value]:
    """Return the values of the fields at the beginning of the data."""
    unpacked: dict[str, Value] = {}
    for field in fields:
        field_data, data = data[: 2 * field.registers], data[2 * field.registers :]
        if field.type == "text":
            unpacked[field.name] = field_data.rstrip(b"\0").decode("ascii", "replace")
        else:
            values: tuple[int, ...] = struct.unpack(f">{field.count}{_CODE[field.type]}", field_data)
            unpacked[field.name] = values if field.count > 1 else values[0]
    return unpacked


_IDENTITY = (
    Field("magic", "u16", "0x4B52"),
    Field("version", "u16", f"version of this map, {MAP_VERSION}"),
    Field("word_order", "f32", "1234.5; read as anything else, the words are swapped"),
)

COMMAND: Final = Block(
    "command",
    "holding",
    0,
    (
        Field("heartbeat", "u16", "counts on with every write; the owner's feeds the watchdog, unless it is repeated"),
        Field("session", "u16", "1 to 65535: the client's; 0: of none, for a stop"),
        Field("sequence", "u16", "1 to 65535, new for every command"),
        Field("command", "u16", "see the command codes"),
        Field("watchdog_ms", "u16", "taking: silence [ms] after which a moving arm is stopped, 100 to 5000; else 0"),
        Field("speed", "u16", "speed fraction of a move [1e-4]"),
        Field("points", "u16", "via points in this block, k; 0 to 9 of six axes"),
        Field("offset", "u32", "staging: index of this block's first point in the move; else 0"),
        Field("count", "u32", "move: via points of the whole move; else 0"),
        Field("points_crc", "u32", "move: CRC-32 over all its via points; else 0"),
    ),
    optional_points=True,
)

STATUS: Final = Block(
    "status",
    "input",
    0,
    (
        *_IDENTITY,
        Field("heartbeat", "u16", "counts on while the controller lives"),
        Field("boot", "u16", "another number after each start of the controller"),
        Field("echo", "u16", "heartbeat of the last command block that was taken"),
        Field("flags", "u16", "bit 0: stands; bit 1: moves or brakes; bit 2: in position; bit 3: fault; bit 4: e-stop; "
              "bit 5: held; all others 0"),
        Field("mode", "u16", "0 idle, 1 moving, 2 in position, 3 fault, 4 e-stop"),
        Field("owner", "u16", "session that owns the arm; 0: none"),
        Field("ack_sequence", "u16", "last command that was executed or refused; 0: none since the start"),
        Field("ack_result", "u16", "the answer to it"),
        Field("done_sequence", "u16", "last move that ended; 0: none since the start"),
        Field("done_result", "u16", "how it ended"),
        Field("answer_sequence", "u16", "sequence of the last command block with a command"),
        Field("answer_result", "u16", "the answer to that block: also REUSED, STALE, INCOMPLETE"),
        Field("queue_depth", "u16", "moves accepted and not ended, 0 or 1"),
        Field("fault_code", "u16", "0, or the latched fault"),
        Field("override", "u16", "share of the commanded speed that is driven [1e-4]"),
        Field("path", "u16", "share of its way that the last move has passed [1e-4]"),
        Field("n_axes", "u16", "number of axes, n"),
        Field("axes", "i32", "A1 on [1e-4 deg]", PER_AXIS),
    ),
)  # fmt: skip

CAPABILITIES: Final = Block(
    "capabilities",
    "input",
    100,
    (
        *_IDENTITY,
        Field("n_axes", "u16", "number of axes, n, 6 to 12"),
        Field("time_scale", "u32", "seconds of the controller's clock per 1,000 s; 1,000 of all but emulators"),
        Field("max_speed", "u16", "largest speed fraction [1e-4]"),
        Field("max_via", "u32", "most via points of one move; 0: no bound"),
        Field("name", "text", "what the controller is", 16),
        Field("lower", "i32", "smallest set-points, A1 on [1e-4 deg]", PER_AXIS),
        Field("upper", "i32", "largest set-points [1e-4 deg]", PER_AXIS),
        Field("max_step", "i32", "largest change of an axis from one via point to the next [1e-4 deg]", PER_AXIS),
    ),
)

BLOCKS: Final = (COMMAND, STATUS, CAPABILITIES)

HEAD: Final = 5
"""Registers of the capabilities before the CRC is known: identity and number of axes."""


def require_identity(registers: Sequence[int]) -> None:
    """Raise ProtocolError unless a block comes from a controller of this protocol, in its word order.

    Only the first four registers are read, before the CRC is checked: this gives a better message.
    """
    values = _unpack(_IDENTITY, struct.pack(">4H", *registers[:4]))
    if values["magic"] != MAGIC:
        raise ProtocolError(
            f"register 0 reads {values['magic']}; a controller of this protocol has {MAGIC} (0x{MAGIC:04X})"
        )
    word_order = values["word_order"]
    if not (isinstance(word_order, float) and math.isclose(word_order, WORD_ORDER)):
        raise ProtocolError(
            f"the word-order test reads {word_order}, not {WORD_ORDER}; a gateway swaps words: set it to big words"
        )
    if values["version"] != MAP_VERSION:
        raise ProtocolError(
            f"the controller has map version {values['version']} and this driver {MAP_VERSION}, see "
            "docs/internals/protocol.md; bring both to one version"
        )
