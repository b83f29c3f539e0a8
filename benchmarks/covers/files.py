"""Reader of set-cover files: whole numbers separated by white space, as plain text or gzip.

Beasley's OR-Library (doi:10.1057/jors.1990.166) and Fulkerson, Nemhauser and Trotter's Steiner triples
(doi:10.1007/BFb0120689) know three formats; in all of them indices start at 1:

    rows      m n, the n costs of the columns, then for each of the m rows how many columns cover it and which
    rail      m n, then for each of the n columns its cost, how many rows it covers and which
    steiner   n m, then for each of the m rows the three columns that cover it (all cost 1)

A file does not name its format. The reader takes the one format in which it can read the file to its last number.
"""

import gzip
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from cell.errors import FileError, UsageError
from planner.values import Ints

LARGEST = 100_000_000
"""Most rows or columns of a file; a larger number means another kind of file, and would fill the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class CoverFile:
    """A set-cover problem from a file.

    Attributes:
        format: name of the format.
        matrix: (m, n) csr_array of bool, True where the column covers the row.
        costs: (n,) cost of each column.
    """

    format: str
    matrix: Any
    costs: Ints


class _MismatchError(Exception):
    """The numbers do not follow the format; the message says where."""


def read(path: Path, form: str | None = None) -> CoverFile:
    """Read a set-cover file.

    Args:
        path: the file; gzip is recognised by its content.
        form: name of its format; None: the format that fits.

    Raises:
        FileError: if the file cannot be read, holds anything but whole numbers, or fits none of the formats.
        UsageError: if there is no such format, or if the file fits more than one.
    """
    if form is not None and form not in FORMATS:
        raise UsageError(f"the format {form!r} is unknown; choose one of {', '.join(FORMATS)}")
    numbers = _numbers(path)
    found: list[CoverFile] = []
    reasons: list[str] = []
    for name in FORMATS if form is None else (form,):
        try:
            found.append(_parse(name, numbers))
        except _MismatchError as mismatch:
            reasons.append(f"as {name}: {mismatch}")
    if not found:
        raise FileError(f"{path} is not a set-cover file ({'; '.join(reasons)})")
    if len(found) > 1:
        names = " and ".join(one.format for one in found)
        raise UsageError(f"{path} can be read as {names}; choose the format with --format")
    return found[0]


def _numbers(path: Path) -> Ints:
    """Read all numbers of a file."""
    try:
        content = path.read_bytes()
        if content.startswith(b"\x1f\x8b"):
            content = gzip.decompress(content)
    except (OSError, EOFError, zlib.error) as error:
        raise FileError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy only warns where it stops reading
            return np.fromstring(content, dtype=np.int64, sep=" ")
    except (ValueError, DeprecationWarning) as error:
        raise FileError(f"{path} is not a set-cover file: it must hold whole numbers only") from error


def _parse(name: str, numbers: Ints) -> CoverFile:
    """Read the numbers in one format."""
    if len(numbers) < 2:
        raise _MismatchError("it ends before the two sizes")
    sizes = int(numbers[0]), int(numbers[1])
    if min(sizes) < 0:
        raise _MismatchError("a size is negative")
    n_rows, n_columns = (sizes[1], sizes[0]) if name == "steiner" else sizes
    if max(sizes) > LARGEST:
        raise _MismatchError(f"{max(sizes)} rows or columns are more than {LARGEST}")
    if name == "rows" and len(numbers) < 2 + n_columns:
        raise _MismatchError(f"it ends before the {n_columns} costs")
    if name == "rail" and len(numbers) < 2 + 2 * n_columns:
        raise _MismatchError(f"{n_columns} columns are {2 * n_columns} numbers at least, but {len(numbers) - 2} follow")
    if name == "rows":
        costs = numbers[2 : 2 + n_columns]
        start, members = _lists(numbers, 2 + n_columns, n_rows, "row", n_columns)
        matrix = sp.csr_array((np.ones(len(members), bool), members, start), shape=(n_rows, n_columns))
    elif name == "rail":
        heads = np.zeros(n_columns, dtype=np.int64)
        start, members = _lists(numbers, 2, n_columns, "column", n_rows, heads)
        costs = heads
        matrix = sp.csc_array((np.ones(len(members), bool), members, start), shape=(n_rows, n_columns)).tocsr()
    else:
        if len(numbers) != 2 + 3 * n_rows:
            raise _MismatchError(f"{n_rows} triples are {3 * n_rows} numbers, but {len(numbers) - 2} follow the sizes")
        members = _indices(numbers[2:], n_columns)
        start = np.arange(0, len(members) + 1, 3)
        costs = np.ones(n_columns, dtype=np.int64)
        matrix = sp.csr_array((np.ones(len(members), bool), members, start), shape=(n_rows, n_columns))
    if (costs <= 0).any():
        at = int(np.flatnonzero(costs <= 0)[0])
        raise _MismatchError(f"column {at + 1} costs {costs[at]}; a cost must be above zero")
    matrix.sum_duplicates()
    return CoverFile(name, matrix, costs)


def _lists(numbers: Ints, at: int, count: int, what: str, highest: int, heads: Ints | None = None) -> tuple[Ints, Ints]:
    """Read `count` lists, each after its length; with `heads`, a number before the length is written there.

    Returns:
        The start of each list, and the members of all lists, counted from 0.
    """
    lengths = np.zeros(count, dtype=np.int64)
    use = np.ones(len(numbers), dtype=bool)
    use[:at] = False
    for position in range(count):
        if heads is not None and at < len(numbers):
            heads[position], use[at] = numbers[at], False
            at += 1
        if at >= len(numbers):
            raise _MismatchError(f"it ends before {what} {position + 1}")
        length = int(numbers[at])
        use[at] = False
        if not 0 <= length <= len(numbers) - at - 1:
            raise _MismatchError(
                f"{what} {position + 1} has {length} members, but {len(numbers) - at - 1} numbers are left"
            )
        lengths[position] = length
        at += 1 + length
    if at != len(numbers):
        raise _MismatchError(f"{len(numbers) - at} numbers follow the last {what}")
    return np.concatenate(([0], np.cumsum(lengths))), _indices(numbers[use], highest)


def _indices(numbers: Ints, highest: int) -> Ints:
    """Check indices from 1 to the highest and count them from 0."""
    wrong = np.flatnonzero((numbers < 1) | (numbers > highest))
    if len(wrong):
        raise _MismatchError(f"an index is {numbers[wrong[0]]}; indices must be from 1 to {highest}")
    indices: Ints = numbers - 1
    return indices


FORMATS = ("rows", "rail", "steiner")
"""The formats, as `--format` names them."""
