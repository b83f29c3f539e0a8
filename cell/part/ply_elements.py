"""Elements of any PLY file: ASCII or binary, properties in any order, lists of different lengths.

`cell.runs.ply` writes and reads the files of a run folder; this module reads what other programs write.
"""

import re
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.text import decode, lines_of, parse_numbers
from planner.values import Floats, Ints

_TYPE_NAMES = (
    "char=i1 uchar=u1 short=i2 ushort=u2 int=i4 uint=u4 float=f4 double=f8 "
    "int8=i1 uint8=u1 int16=i2 uint16=u2 int32=i4 uint32=u4 int64=i8 uint64=u8 float32=f4 float64=f8"
)
_TYPES = dict(pair.split("=") for pair in _TYPE_NAMES.split())
_STRUCT_CODES = dict(zip(("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"), "bBhHiIqQfd", strict=True))
_MARK = b"\xef\xbb\xbf"  # UTF-8
_WINDOWS_NAN = re.compile(r"[-+]?(?:1\.#\w+|nan\(\w*\))", re.IGNORECASE)


_MORE = "its counts or properties are wrong, or it was copied as text; export or copy it again"


class PlyError(ValueError):
    """A broken PLY file; the message follows the name of the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """The rows of an element.

    Attributes:
        count: number of rows.
        scalars: (count,) of each property that is a number.
        lists: lengths (count,) of each property that is a list, and all its numbers one row after the other.
    """

    count: int
    scalars: dict[str, NDArray[Any]] = field(default_factory=dict)
    lists: dict[str, tuple[Ints, NDArray[Any]]] = field(default_factory=dict)

    def columns(self, *names: str) -> Floats:
        """Return properties as columns (count, K).

        Raises:
            PlyError: if one is missing.
        """
        for name in names:
            if name not in self.scalars:
                raise PlyError(f"has no property {name}; it has {', '.join([*self.scalars, *self.lists]) or 'none'}")
        return np.stack([self.scalars[name].astype(np.float64) for name in names], axis=1)


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    count_kind: str = ""


@dataclass(frozen=True, slots=True)
class _Table:
    name: str
    count: int
    properties: list[_Property]


def read_elements(content: bytes) -> dict[str, Element]:
    """Return the elements of a PLY file by name.

    Raises:
        PlyError: if it is broken, or ends before the rows that it announces.
    """
    content = content.removeprefix(_MARK)
    end = re.search(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)", content)
    if not content.startswith(b"ply") or end is None:
        raise PlyError("is not a PLY file, or its header has no end; export it again")
    form, tables = _header(decode(content[: end.start()]))
    if form == "ascii":
        body = content[end.end() :].removeprefix(_MARK)
        numbers = _ascii_numbers(body, len(lines_of(decode(content[: end.end()]))) - 1)
        return _from_numbers(tables, numbers)
    # In a binary file with CR as line end, a line feed after the header belongs to the data.
    begin = end.start(1) + 1 if b"\n" not in content[: end.start()] else end.end()
    return _from_bytes(tables, content[begin:], {"binary_little_endian": "<", "binary_big_endian": ">"}[form])


def _header(text: str) -> tuple[str, list[_Table]]:
    form, tables = "", list[_Table]()
    for number, line in enumerate(lines_of(text), start=1):
        try:
            match line.split():
                case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as form, *_]:
                    pass
                case ["element", name, count]:
                    tables.append(_Table(name, int(count), []))
                case ["property", "list", count_kind, kind, name] if not count_kind.startswith(("float", "double")):
                    tables[-1].properties.append(_Property(name.lower(), _TYPES[kind], _TYPES[count_kind]))
                case ["property", kind, name]:
                    tables[-1].properties.append(_Property(name.lower(), _TYPES[kind]))
                case ["comment" | "obj_info" | "ply", *_] | []:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError) as error:
            raise PlyError(f"has a header line that is not PLY, line {number}: {line.strip()[:60]}") from error
    if not form:
        raise PlyError("has no format line in its header; export it again")
    if any(table.count < 0 for table in tables):
        raise PlyError("announces a negative number of rows; export it again")
    return form, tables


def _ascii_numbers(body: bytes, header_lines: int) -> Floats:
    text = decode(body)
    numbers = parse_numbers(text, len(text.split()))
    if numbers is not None:
        return numbers
    for number, line in enumerate(lines_of(_WINDOWS_NAN.sub("nan", text)), start=header_lines + 1):
        for word in line.split():
            try:
                float(word)
            except ValueError as error:
                hint = "; write decimal points" if "," in word else ""
                raise PlyError(f"has '{word[:40]}' where a number is expected, line {number}{hint}") from error
    return np.array(_WINDOWS_NAN.sub("nan", text).split(), dtype=np.float64)


def _from_numbers(tables: list[_Table], numbers: Floats) -> dict[str, Element]:
    elements, at = {}, 0
    for table in tables:
        if not any(each.count_kind for each in table.properties):
            width = len(table.properties)
            rows = numbers[at : at + table.count * width]
            if len(rows) < table.count * width:
                raise _cut_short(table)
            rows = rows.reshape(table.count, width)
            at += rows.size
            scalars = {each.name: rows[:, k] for k, each in enumerate(table.properties)}
            elements[table.name] = Element(table.count, scalars)
        else:
            elements[table.name], at = _ascii_rows(table, numbers, at)
    if at < len(numbers):
        raise PlyError(f"has {len(numbers) - at} numbers more than its header announces; {_MORE}")
    return elements


def _ascii_rows(table: _Table, numbers: Floats, at: int) -> tuple[Element, int]:
    """Read the rows of an element with lists, from a position; return the next position too."""
    starts: dict[str, list[int]] = {each.name: [] for each in table.properties}
    counts: dict[str, list[int]] = {each.name: [] for each in table.properties if each.count_kind}
    for _ in range(table.count):
        for each in table.properties:
            if at >= len(numbers):
                raise _cut_short(table)
            length = 1
            if each.count_kind:
                if not 0 <= numbers[at] <= len(numbers) - at - 1 or numbers[at] % 1:
                    raise _cut_short(table)
                length = int(numbers[at])
                counts[each.name].append(length)
                at += 1
            starts[each.name].append(at)
            at += length
    if at > len(numbers):
        raise _cut_short(table)
    element = Element(table.count)
    for each in table.properties:
        begin = np.array(starts[each.name], np.int64)
        if each.count_kind:
            lengths = np.array(counts[each.name], np.int64)
            element.lists[each.name] = lengths, numbers[_ranges(begin, lengths)]
        else:
            element.scalars[each.name] = numbers[begin]
    return element, at


def _ranges(begin: Ints, lengths: Ints) -> Ints:
    """Return the indices begin, ..., begin + length - 1 of all rows, one row after the other."""
    ends = np.cumsum(lengths)
    total = int(ends[-1]) if len(ends) else 0
    indices: Ints = np.arange(total) + np.repeat(begin - (ends - lengths), lengths)
    return indices


def _from_bytes(tables: list[_Table], body: bytes, order: str) -> dict[str, Element]:
    elements, at = {}, 0
    for table in tables:
        element = _rows_of_equal_length(table, body, at, order)
        if element is None:
            elements[table.name], at = _rows_one_by_one(table, body, at, order)
        else:
            elements[table.name], at = element
    if more := len(body[at:].strip()):
        raise PlyError(f"has {more} bytes more than its header announces; {_MORE}")
    return elements


def _rows_of_equal_length(table: _Table, body: bytes, at: int, order: str) -> tuple[Element, int] | None:
    """Read an element whose lists have the same length in every row; None if they have not."""
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    first = at
    for k, each in enumerate(table.properties):
        if each.count_kind:
            if not table.count:
                return Element(0, {p.name: np.zeros(0) for p in table.properties}), at
            size = int(each.count_kind[1])
            if first + size > len(body):
                raise _cut_short(table)
            length = int(np.frombuffer(body, order + each.count_kind, 1, first)[0])
            if not 0 <= length <= len(body):
                raise _cut_short(table)
            fields += [(f"{k} count", order + each.count_kind), (f"{k}", order + each.kind, length)]
            first += size + length * int(each.kind[1])
        else:
            fields.append((f"{k}", order + each.kind))
            first += int(each.kind[1])
    row = np.dtype(fields)
    if at + table.count * row.itemsize > len(body):
        if any(each.count_kind for each in table.properties):
            return None
        raise _cut_short(table)
    rows = np.frombuffer(body, row, table.count, at)
    element = Element(table.count)
    for k, each in enumerate(table.properties):
        if each.count_kind:
            lengths = rows[f"{k} count"].astype(np.int64)
            if (lengths != lengths[:1]).any():
                return None
            element.lists[each.name] = lengths, rows[f"{k}"].ravel()
        else:
            element.scalars[each.name] = rows[f"{k}"]
    return element, at + table.count * row.itemsize


def _rows_one_by_one(table: _Table, body: bytes, at: int, order: str) -> tuple[Element, int]:
    kinds = [
        (each.name, each.count_kind and struct.Struct(order + _STRUCT_CODES[each.count_kind]), _STRUCT_CODES[each.kind])
        for each in table.properties
    ]
    scalars: dict[str, list[float]] = {each.name: [] for each in table.properties if not each.count_kind}
    lengths: dict[str, list[int]] = {each.name: [] for each in table.properties if each.count_kind}
    values: dict[str, list[float]] = {name: [] for name in lengths}
    try:
        for _ in range(table.count):
            for name, counter, code in kinds:
                if isinstance(counter, struct.Struct):
                    (length,) = counter.unpack_from(body, at)
                    at += counter.size
                    if not 0 <= length <= len(body):
                        raise _cut_short(table)
                    lengths[name].append(length)
                    values[name] += struct.unpack_from(f"{order}{length}{code}", body, at)
                    at += length * struct.calcsize(f"{order}{code}")
                else:
                    scalars[name] += struct.unpack_from(order + code, body, at)
                    at += struct.calcsize(order + code)
    except (struct.error, TypeError) as error:
        raise _cut_short(table) from error
    lists = {name: (np.array(lengths[name], np.int64), np.array(values[name])) for name in lengths}
    return Element(table.count, {name: np.array(rows) for name, rows in scalars.items()}, lists), at


def _cut_short(table: _Table) -> PlyError:
    return PlyError(f"ends before its {table.count} rows of '{table.name}'; it is cut short, export or copy it again")
