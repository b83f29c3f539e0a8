"""The Modbus register map; `modbus_registers.csv` has its fields, also in docs/internals/protocol_registers.csv.

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

import csv
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
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


_TABLE = (resources.files("drivers.wires") / "modbus_registers.csv").read_text(encoding="utf-8")
_ROWS = list(csv.DictReader(_TABLE.splitlines()))

COMMANDS: Final = {int(row["name"]): row["meaning"] for row in _ROWS if row["block"] == "command code"}


def _fields(block: str) -> tuple[Field, ...]:
    rows = (row for row in _ROWS if row["block"] == block)
    return tuple(Field(row["name"], row["type"], row["meaning"], int(row["count"])) for row in rows)


_IDENTITY = _fields("identity")
COMMAND: Final = Block("command", "holding", 0, _fields("command"), optional_points=True)
STATUS: Final = Block("status", "input", 0, (*_IDENTITY, *_fields("status")))
CAPABILITIES: Final = Block("capabilities", "input", 100, (*_IDENTITY, *_fields("capabilities")))

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
