"""Packages of the Real-Time Data Exchange (RTDE) of Universal Robots, protocol version 2: both ends of the wire.

A package is its size (16 bits, itself included), a type (8 bits) and a payload, big-endian. A client agrees on the
version, sets up a *recipe* of output variables and one of input variables, and starts the exchange; then the controller
sends a data package with the output variables at the agreed frequency, and the client sends data packages with the
input variables.
"""

import struct
from enum import IntEnum
from typing import Any, Final

VERSION: Final = 2
HEADER: Final = struct.Struct(">HB")


class Package(IntEnum):
    """Types of packages."""

    VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


_FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
    "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip


def encode(kind: Package, payload: bytes = b"") -> bytes:
    """Return a package."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def split(data: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Return the complete packages of a stream, type and payload each, and the rest.

    Raises:
        ValueError: if a size is smaller than a header.
    """
    packages, at = [], 0
    while len(data) - at >= HEADER.size:
        size, kind = HEADER.unpack_from(data, at)
        if size < HEADER.size:
            raise ValueError(f"a package has a size of {size} bytes")
        if len(data) - at < size:
            break
        packages.append((kind, data[at + HEADER.size : at + size]))
        at += size
    return packages, data[at:]


class Recipe:
    """The variables of data packages in one direction.

    Args:
        number: of the recipe; the first byte of its data packages.
        names: of the variables.
        types: of the variables, such as "VECTOR6D".

    Raises:
        ValueError: if a type is unknown, or the counts differ.
    """

    def __init__(self, number: int, names: tuple[str, ...], types: tuple[str, ...]) -> None:
        if len(names) != len(types):
            raise ValueError(f"{len(types)} types for {len(names)} variables")
        unknown = [name for name in types if name not in _FORMATS]
        if unknown:
            raise ValueError(f"type {unknown[0]} is unknown")
        self.number, self.names, self._types = number, names, types
        self._struct = struct.Struct(">B" + "".join(_FORMATS[name] for name in types))

    def pack(self, values: dict[str, Any]) -> bytes:
        """Return the data package of the variables."""
        flat: list[Any] = []
        for name in self.names:
            value = values[name]
            flat.extend(value) if isinstance(value, (tuple, list)) else flat.append(value)
        return encode(Package.DATA, self._struct.pack(self.number, *flat))

    def unpack(self, payload: bytes) -> dict[str, Any]:
        """Return the variables of a data package.

        Raises:
            ValueError: if it has another length or recipe.
        """
        if len(payload) != self._struct.size or payload[0] != self.number:
            raise ValueError("a data package does not fit its recipe")
        flat = list(self._struct.unpack(payload)[1:])
        values: dict[str, Any] = {}
        for name, kind in zip(self.names, self._types, strict=True):
            count = int(_FORMATS[kind][:-1] or 1)
            values[name] = flat[0] if count == 1 else tuple(flat[:count])
            flat = flat[count:]
        return values
