"""Cover with demands: every row asks for a sum, and each column brings its own part of it to each of its rows.

    choose the fewest columns C with  sum_{j in C} load_ij >= demand_i  for the rows that are required.

Loads and demands are whole numbers, so that sums are exact. Plain cover is the case of loads and demands of 1; k views
on a row are a demand of k; a probability of being measured becomes a sum of logarithms (`planner.cover.robust`). A
`CoverProblem` says nothing of loads, and its kernels stay as fast as they are because of that.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp

from planner.cover.canonical import CoverProblem
from planner.values import Bools, Floats, Ints, Value


@dataclass(frozen=True, slots=True, eq=False)
class DemandProblem(Value):
    """Rows that demand, columns that bring; every required row can be satisfied by all columns together.

    Attributes:
        row_start: (S + 1,) where the columns of each row begin in `row_columns`.
        row_columns: (nnz,) columns of each row, ascending within a row.
        row_load: (nnz,) what the column brings to the row, 1 to the row's demand.
        column_start: (V + 1,) where the rows of each column begin in `column_rows`.
        column_rows: (nnz,) rows of each column, ascending within a column.
        column_load: (nnz,) what the column brings to the row.
        demand: (S,) of each row, at least 1.
        units: (S,) weight of each row, whole numbers (`planner.cover.canonical`).
        required: units of satisfied rows that are asked for; ignored where `full`.
        full: whether every row must be satisfied.
    """

    row_start: Annotated[Ints, "S+1"]
    row_columns: Annotated[Ints, "nnz"]
    row_load: Annotated[Ints, "nnz"]
    column_start: Annotated[Ints, "V+1"]
    column_rows: Annotated[Ints, "nnz"]
    column_load: Annotated[Ints, "nnz"]
    demand: Annotated[Ints, "S"]
    units: Annotated[Ints, "S"]
    required: int
    full: bool

    @classmethod
    def of(cls, loads: Any, demand: Ints, units: Floats, required: int, *, full: bool) -> "DemandProblem":
        """From a sparse (S, V) matrix of loads; what exceeds a row's demand is cut (no choice needs more).

        Args:
            loads: whole numbers, 0 where a column brings nothing.
            demand: (S,) at least 1.
            units: (S,) whole numbers.
            required: units of satisfied rows that are asked for.
            full: whether every row must be satisfied.
        """
        rows: Any = sp.csr_array(loads).astype(np.int64)
        rows.sum_duplicates()
        rows.data = np.minimum(rows.data, np.repeat(demand, np.diff(rows.indptr)))
        rows.eliminate_zeros()
        columns: Any = sp.csc_array(rows)
        columns.sort_indices()
        return cls(
            rows.indptr, rows.indices, rows.data, columns.indptr, columns.indices, columns.data,
            demand, units.astype(np.int64), max(required, 0), full,
        )  # fmt: skip

    @classmethod
    def of_cover(cls, problem: CoverProblem) -> "DemandProblem":
        """A cover problem as one of demands."""
        ones = np.ones(problem.n_entries, dtype=np.int64)
        return cls(
            problem.row_start, problem.row_columns, ones, problem.column_start, problem.column_rows, ones,
            problem.demand, problem.units.astype(np.int64), problem.required, problem.full,
        )  # fmt: skip

    @property
    def n_rows(self) -> int:
        """Rows that demand."""
        return len(self.row_start) - 1

    @property
    def n_columns(self) -> int:
        """Columns to choose from."""
        return len(self.column_start) - 1

    @property
    def n_entries(self) -> int:
        """Loads above zero."""
        return len(self.row_columns)

    @property
    def slack(self) -> int:
        """Units of rows that may stay unsatisfied."""
        return 0 if self.full else int(self.units.sum()) - self.required

    @property
    def trivial(self) -> bool:
        """Whether nothing is asked for."""
        return self.n_rows == 0 if self.full else self.required <= 0

    def matrix(self) -> Any:
        """(S, V) scipy csr_array of the loads as shares of their row's demand, at most 1."""
        shares = self.row_load / np.repeat(self.demand, np.diff(self.row_start))
        return sp.csr_array((shares, self.row_columns, self.row_start), shape=(self.n_rows, self.n_columns))

    def loads(self, columns: Ints) -> Ints:
        """(S,) what columns bring to each row together."""
        total = np.zeros(self.n_rows, dtype=np.int64)
        for j in np.asarray(columns).tolist():
            at = slice(self.column_start[j], self.column_start[j + 1])
            total[self.column_rows[at]] += self.column_load[at]
        return total

    def satisfied(self, columns: Ints) -> Bools:
        """(S,) which rows have what they demand."""
        enough: Bools = self.loads(columns) >= self.demand
        return enough

    def met(self, columns: Ints) -> bool:
        """Whether columns bring what is asked for; exact."""
        open_units = int(self.units[~self.satisfied(columns)].sum())
        return open_units == 0 and bool(self.satisfied(columns).all()) if self.full else open_units <= self.slack

    def on_columns(self, keep: Ints) -> "DemandProblem":
        """The problem on some columns; rows stay, also those that can no longer be satisfied."""
        M = sp.csr_array((self.row_load, self.row_columns, self.row_start), (self.n_rows, self.n_columns))
        return DemandProblem.of(M[:, keep], self.demand, self.units.astype(np.float64), self.required, full=self.full)
