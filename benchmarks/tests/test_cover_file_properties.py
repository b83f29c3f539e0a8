"""Set-cover files: files written in each format are read with the same content."""

import gzip
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.covers.files import read
from cell.errors import CellError


def rows(M, costs):
    """Return the text of the row format."""
    lines = [f"{len(M)} {M.shape[1]}", " ".join(map(str, costs))]
    for row in M:
        lines += [str(row.sum()), " ".join(str(j + 1) for j in np.flatnonzero(row))]
    return "\n".join(lines)


def rail(M, costs):
    """Return the text of the rail format."""
    lines = [f"{len(M)} {M.shape[1]}"]
    for column, cost in zip(M.T, costs, strict=True):
        lines.append(" ".join(map(str, [cost, column.sum(), *(np.flatnonzero(column) + 1)])))
    return "\n".join(lines)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.booleans(), st.sampled_from([rows, rail]))
def test_what_is_written_is_read(seed, n_rows, n_columns, packed, form):
    """A written file, plain or packed, is read with the same matrix and costs."""
    rng = np.random.default_rng(seed)
    M, costs = rng.random((n_rows, n_columns)) < 0.4, rng.integers(1, 100, n_columns)
    text = form(M, costs).encode()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        path.write_bytes(gzip.compress(text) if packed else text)
        found = read(path, form.__name__)
    np.testing.assert_array_equal(found.matrix.toarray(), M)
    np.testing.assert_array_equal(found.costs, costs)


@given(st.integers(0, 2**32 - 1), st.data())
def test_a_damaged_file_is_refused_or_is_another_file(seed, data):
    """A file that lacks a number is refused or gives another problem."""
    rng = np.random.default_rng(seed)
    M, costs = rng.random((6, 5)) < 0.5, rng.integers(1, 9, 5)
    numbers = rows(M, costs).split()
    del numbers[data.draw(st.integers(0, len(numbers) - 1))]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file"
        path.write_text(" ".join(numbers))
        with suppress(CellError):
            found = read(path)
            assert found.matrix.shape != M.shape or (found.matrix.toarray() != M).any() or (found.costs != costs).any()


def test_truncated_gzip_is_a_file_error(tmp_path):
    """A truncated gzip file is refused with a message that names the cause."""
    packed = gzip.compress(rows(np.ones((50, 50), bool), np.arange(1, 51)).encode())
    (tmp_path / "half.gz").write_bytes(packed[: len(packed) // 2])
    with pytest.raises(CellError, match="cannot be read"):
        read(tmp_path / "half.gz")
