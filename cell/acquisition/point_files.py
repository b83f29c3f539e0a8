"""Point clouds from files: PLY (text or binary), XYZ and other text, PCD (text or binary). Numbers as they stand.

Points that are not finite, which organised clouds keep for rays without an echo, are dropped.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from planner.values import Floats

SUFFIXES = (".ply", ".xyz", ".txt", ".pcd")

_PLY = {
    **{name: "i1" for name in ("char", "int8")}, **{name: "u1" for name in ("uchar", "uint8")},
    **{name: "i2" for name in ("short", "int16")}, **{name: "u2" for name in ("ushort", "uint16")},
    **{name: "i4" for name in ("int", "int32")}, **{name: "u4" for name in ("uint", "uint32")},
    **{name: "f4" for name in ("float", "float32")}, **{name: "f8" for name in ("double", "float64")},
}  # fmt: skip


def read(path: Path) -> Floats:
    """(P, 3) points of a file, in its own unit and frame.

    Raises:
        FileError: if it cannot be read, in one sentence.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
    readers: dict[str, Callable[[bytes], Floats]] = {".ply": _ply, ".pcd": _pcd, ".xyz": _text, ".txt": _text}
    if path.suffix.lower() not in readers:
        raise FileError(f"{path} is '{path.suffix}'; points are read from {', '.join(SUFFIXES)}")
    try:
        points = readers[path.suffix.lower()](content)
    except KeyError as error:
        raise FileError(
            f"{path} holds no points that can be read: its header lacks or does not know {error}"
        ) from error
    except (ValueError, IndexError, TypeError) as error:
        raise FileError(f"{path} holds no points that can be read: {error}") from error
    finite: Floats = points[np.isfinite(points).all(axis=1)]
    return finite


def _text(content: bytes) -> Floats:
    """The first three numbers of each line; spaces, tabs, commas or semicolons between them."""
    rows = []
    for line in content.decode("utf-8-sig").replace(",", " ").replace(";", " ").splitlines():
        words = line.split()
        if words and not words[0].startswith(("#", "/")):
            rows.append([float(word) for word in words[:3]])
    return _three(np.array(rows, dtype=np.float64).reshape(len(rows), -1))


def _ply(content: bytes) -> Floats:
    header, found, body = content.partition(b"end_header")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    if not found or lines[0] != ["ply"]:
        raise ValueError("it is no whole PLY")
    kind = {line[0]: line[1] for line in lines if len(line) > 1}["format"]
    elements = [number for number, line in enumerate(lines) if line[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ValueError("its first element is not 'vertex'")
    count = int(lines[elements[0]][2])
    own = lines[elements[0] + 1 : elements[1] if len(elements) > 1 else None]
    fields = [(line[-1], line[1]) for line in own if line[:1] == ["property"]]
    body = body.partition(b"\n")[2]
    if kind == "ascii":
        rows = body.decode("ascii").splitlines()[:count]
        return _columns(_table(rows), [name for name, _ in fields], count)
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    row = np.dtype([(name, order + _PLY[form]) for name, form in fields])
    return _named(body, row, count)


def _pcd(content: bytes) -> Floats:
    header, found, rest = content.partition(b"DATA ")
    if not found:
        raise ValueError("it is no whole PCD")
    keys = {line.split()[0]: line.split()[1:] for line in header.decode("ascii").splitlines() if line[:1] not in "# "}
    kind, _, body = rest.partition(b"\n")
    count = int(keys["POINTS"][0]) if "POINTS" in keys else int(keys["WIDTH"][0]) * int(keys["HEIGHT"][0])
    names, sizes = keys["FIELDS"], keys["SIZE"]
    times = [int(each) for each in keys.get("COUNT", ["1"] * len(names))]
    if kind.strip() == b"ascii":
        wide = [name if k == 0 else f"{name} {k}" for name, n in zip(names, times, strict=True) for k in range(n)]
        return _columns(_table(body.decode("ascii").splitlines()[:count]), wide, count)
    if kind.strip() != b"binary":
        raise ValueError(f"its data are '{kind.strip().decode('ascii')}'; write them as ascii or binary")
    forms = [kind.lower() + size for kind, size in zip(keys["TYPE"], sizes, strict=True)]
    row = np.dtype([(name, f"<{form}", (n,)) for name, form, n in zip(names, forms, times, strict=True)])
    return _named(body, row, count)


def _table(rows: list[str]) -> Floats:
    return np.array([[float(word) for word in row.split()] for row in rows], dtype=np.float64)


def _columns(table: Floats, names: list[str], count: int) -> Floats:
    if len(table) != count:
        raise ValueError(f"it has {len(table)} of {count} points")
    if not count:
        return np.empty((0, 3))
    return _three(table[:, [names.index(axis) for axis in "xyz"]])


def _named(body: bytes, row: "np.dtype[np.void]", count: int) -> Floats:
    if len(body) < count * row.itemsize:
        raise ValueError(f"it ends before its {count} points")
    table: NDArray[np.void] = np.frombuffer(body, dtype=row, count=count)
    if any(axis not in (row.names or ()) for axis in "xyz"):
        raise ValueError("its points have no x, y and z")
    return _three(np.stack([table[axis].reshape(count).astype(np.float64) for axis in "xyz"], axis=1))


def _three(points: Floats) -> Floats:
    if points.size == 0:
        return np.empty((0, 3))
    if points.shape[1] != 3:
        raise ValueError("its lines have fewer than three numbers")
    return points
