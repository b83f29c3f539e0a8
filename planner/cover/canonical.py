"""The cover problem: which columns (viewpoints) cover which rows (surface samples), and how much must be covered.

Weighted partial multiple set cover: choose the cheapest columns (at unit cost: the fewest) so that the covered rows
weigh at least the target; at coverage 1 every row that some usable column covers must be covered (set cover). A row
counts as covered when as many of the chosen columns cover it as its demand says: once, or `multiplicity` times; of a
row that fewer columns can cover all of them are demanded.

Three decisions make every later step exact and reproducible:

* **Areas become integers.** Each area is rounded to a multiple of 2^-52 of the total (at least one multiple), so that
  sums are exact in int64 and in float64 alike and do not depend on the order of summation. Whether a target below 1 is
  met is decided in these units with a relative slack of 1e-12, because 0.55 of 100 equal areas must mean 55 of them,
  though the float 0.55 is a hair above 55/100. Coverage 1 never looks at areas: it asks for every coverable row.
* **Costs become integers**: whole numbers are divided by their greatest common divisor; any others are rounded to
  multiples of 2^-17 of the largest.
* **Columns are sorted by content**: larger covered area first, then a hash of the set of rows, then the lower cost,
  then the index. Everything after this works on the sorted columns, so permuting the candidates changes nothing but
  indices.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, fsum
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError
from planner.values import Bools, Floats, Ints, Value, freeze

AREA_UNITS = 2**52
"""The areas of a problem sum to about this many units: sums stay below 2^53 and are exact in float64 too."""

COST_UNITS = 2**17
"""Costs that are not whole numbers become multiples of the largest cost over this: an error below 1e-5 of it.

Far below what a time of motion or scan is known to, and such that one unit is more than the solvers' tolerances.
"""

TARGET_SLACK = Fraction(1, 10**12)
"""A target below full coverage counts as met when at most this share of it is missing (rounding of the areas)."""


@dataclass(frozen=True, slots=True, eq=False)
class CoverProblem(Value):
    """A set-cover problem in canonical column order; every row can be covered as often as it demands.

    Attributes:
        row_start: (S + 1,) where the columns of each row begin in `row_columns`.
        row_columns: (nnz,) columns that cover each row, ascending within a row.
        column_start: (V + 1,) where the rows of each column begin in `column_rows`.
        column_rows: (nnz,) rows that each column covers, ascending within a column.
        units: (S,) weight of each row, whole numbers as float64 (all sums stay below 2^53).
        required: how many units must be covered; ignored where `full`.
        full: whether every row must be covered.
        demand: (S,) how many columns must cover a row for it to count as covered; at least 1.
        costs: (V,) cost of each column in whole units, at least 1.
    """

    row_start: Annotated[Ints, "S+1"]
    row_columns: Annotated[Ints, "nnz"]
    column_start: Annotated[Ints, "V+1"]
    column_rows: Annotated[Ints, "nnz"]
    units: Annotated[Floats, "S"]
    required: int
    full: bool
    demand: Annotated[Ints, "S"]
    costs: Annotated[Ints, "V"]

    @property
    def n_rows(self) -> int:
        """Rows to be covered."""
        return len(self.row_start) - 1

    @property
    def n_columns(self) -> int:
        """Columns to choose from."""
        return len(self.column_start) - 1

    @property
    def n_entries(self) -> int:
        """Ones of the matrix."""
        return len(self.row_columns)

    @property
    def slack(self) -> int:
        """Units that may stay uncovered."""
        return 0 if self.full else int(self.units.sum()) - self.required

    @property
    def trivial(self) -> bool:
        """Whether nothing needs to be covered."""
        return self.n_rows == 0 if self.full else self.required <= 0

    @property
    def unit_cost(self) -> bool:
        """Whether every column costs 1, so that cost is the number of columns."""
        return bool((self.costs == 1).all())

    @property
    def once(self) -> bool:
        """Whether covering a row once is enough for every row."""
        return bool((self.demand == 1).all())

    def cost(self, columns: ArrayLike) -> int:
        """What several columns cost together."""
        return int(self.costs[np.asarray(columns, dtype=np.int64)].sum())

    def rows_of(self, columns: ArrayLike) -> Ints:
        """The rows of several columns, one column after the other (with repetitions)."""
        return gather(self.column_start, self.column_rows, np.asarray(columns, dtype=np.int64))[0]

    def columns_of(self, rows: ArrayLike) -> tuple[Ints, Ints]:
        """The columns of several rows, one row after the other, and how many each row has."""
        return gather(self.row_start, self.row_columns, np.asarray(rows, dtype=np.int64))

    def counts(self, columns: ArrayLike) -> Ints:
        """(S,) how many of the given columns cover each row."""
        return np.bincount(self.rows_of(columns), minlength=self.n_rows)

    def covered(self, columns: ArrayLike) -> Bools:
        """(S,) which rows the given columns cover as often as demanded."""
        satisfied: Bools = self.counts(columns) >= self.demand
        return satisfied

    def met(self, covered: Bools) -> bool:
        """Whether covering these rows meets the target; exact.

        Args:
            covered: (S,) which rows are covered.
        """
        return bool(covered.all()) if self.full else int(self.units[covered].sum()) >= self.required

    def matrix(self) -> Any:
        """The (S, V) matrix as a scipy csr_array of float64."""
        data = np.ones(self.n_entries)
        return sp.csr_array((data, self.row_columns, self.row_start), shape=(self.n_rows, self.n_columns))

    def restricted(
        self,
        rows: Bools,
        columns: Bools,
        units: Floats,
        required: int,
        demand: Ints | None = None,
    ) -> "CoverProblem":
        """The problem on some rows and columns, in the same order.

        Args:
            rows: (S,) which rows stay.
            columns: (V,) which columns stay.
            units: (S,) weights of the rows; those of the rows that stay are taken.
            required: units that the smaller problem must cover.
            demand: (S,) how often rows must be covered, in place of this problem's.
        """
        M = sp.csr_array((np.ones(self.n_entries, np.int8), self.row_columns, self.row_start), self.shape)
        demand = self.demand if demand is None else demand
        return _from_csr(M[rows][:, columns], units[rows], required, self.full, demand[rows], self.costs[columns])

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.n_rows, self.n_columns


@dataclass(frozen=True, slots=True, eq=False)
class Candidates(Value):
    """A cover problem together with what it was made from.

    Attributes:
        problem: the canonical problem.
        rows: (S',) index of each of the problem's rows in the measurability matrix.
        columns: (V',) index of each of the problem's columns in the measurability matrix.
        areas: (S,) area of every row of the matrix [m^2].
        uncoverable_rows: rows that no usable column covers.
        short_rows: rows that some usable columns cover, but fewer than the multiplicity; all of them are demanded.
        cost_unit: what a cost of 1 in the problem stands for in the caller's unit.
    """

    problem: CoverProblem
    rows: Annotated[Ints, "s"]
    columns: Annotated[Ints, "v"]
    areas: Annotated[Floats, "S"]
    uncoverable_rows: Annotated[Ints, "_"]
    short_rows: Annotated[Ints, "_"]
    cost_unit: float

    def __post_init__(self) -> None:
        freeze(self, s=self.problem.n_rows, v=self.problem.n_columns)


def gather(start: Ints, items: Ints, which: Ints) -> tuple[Ints, Ints]:
    """Concatenate several slices of a compressed index array.

    Args:
        start: (N + 1,) where each slice begins.
        items: (nnz,) the slices, one after the other.
        which: (n,) the slices wanted.

    Returns:
        The wanted slices one after the other, and the (n,) length of each.
    """
    begin = start[which]
    lengths = start[which + 1] - begin
    if len(which) <= 12:  # below this a plain concatenation is faster than the index arithmetic
        parts = [items[a : a + n] for a, n in zip(begin.tolist(), lengths.tolist(), strict=True)]
        return (np.concatenate(parts) if parts else items[:0]), lengths
    ends = np.cumsum(lengths)
    index = np.arange(ends[-1]) + np.repeat(begin - (ends - lengths), lengths)
    return items[index], lengths


def set_hash(start: Ints, items: Ints) -> NDArray[np.uint64]:
    """A 64-bit hash of each slice as a set (order does not matter), the same on every machine.

    The sum modulo 2^64 of SplitMix64 (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195) of the members.
    """
    z = (items.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    total = np.concatenate(([np.uint64(0)], np.cumsum(z, dtype=np.uint64)))
    hashes: NDArray[np.uint64] = total[start[1:]] - total[start[:-1]]
    return hashes


def candidates(
    M: Any,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    coverage: float = 1.0,
    banned: Iterable[int] = (),
    multiplicity: int = 1,
    costs: ArrayLike | None = None,
) -> Candidates:
    """Check the input and bring it into canonical form.

    Args:
        M: (S, V) measurability matrix, scipy sparse or dense; an entry is True where it is not zero.
        areas: (S,) area of each row [m^2], finite and not negative.
        allowed: (V,) which columns may be used (the reachable ones); None: all.
        coverage: share of the coverable area that must be covered, 0 to 1.
        banned: columns that the user excludes; they do not count as coverable either.
        multiplicity: how many columns must cover a row for it to count as covered; of a row that fewer can cover, all.
        costs: (V,) cost of each column, finite and above zero (seconds, say); None: 1 each.

    Raises:
        PlannerError: if shapes do not fit, an area is NaN, infinite or negative, the coverage is not in [0, 1], a
            banned column does not exist, the multiplicity is below 1, or a cost is not above zero.
    """
    matrix = sp.csc_array(M, dtype=bool)  # refuses anything that is not two-dimensional
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    n_rows, n_columns = matrix.shape
    weights = np.array(areas, dtype=np.float64)
    if weights.shape != (n_rows,):
        raise PlannerError(f"areas has shape {weights.shape}; the matrix has {n_rows} rows, so it must be ({n_rows},)")
    bad = np.flatnonzero(~(np.isfinite(weights) & (weights >= 0)))
    if len(bad):
        raise PlannerError(f"areas[{bad[0]}] is {weights[bad[0]]}; an area must be a finite number, zero or above")
    if not 0.0 <= coverage <= 1.0:  # also refuses NaN
        raise PlannerError(f"coverage is {coverage!r}; it is a share of the coverable area and must be from 0 to 1")
    usable = np.ones(n_columns, dtype=bool) if allowed is None else np.array(allowed)
    if usable.shape != (n_columns,) or usable.dtype != np.bool_:
        raise PlannerError(
            f"allowed has shape {usable.shape} and type {usable.dtype}; it must be ({n_columns},) of bool"
        )
    usable = usable.copy()
    usable[column_indices("banned", banned, n_columns)] = False
    if multiplicity < 1:
        raise PlannerError(f"multiplicity is {multiplicity}; every row must be covered at least once")
    multiplicity = min(multiplicity, n_columns + 1)  # more than all columns are all columns
    column_costs, cost_unit = _costs(costs, n_columns)

    usable &= np.diff(matrix.indptr) > 0
    chosen = np.flatnonzero(usable)
    part = matrix[:, chosen]
    per_row = np.bincount(part.indices, minlength=n_rows)
    rows = np.flatnonzero(per_row)
    row_units = _units(weights[rows])
    renumber = np.zeros(n_rows, dtype=np.int64)
    renumber[rows] = np.arange(len(rows))
    start, members = part.indptr.astype(np.int64), part.indices.astype(np.int64)
    covered = np.add.reduceat(row_units[renumber[members]], start[:-1]) if len(chosen) else np.zeros(0)
    given = column_costs if costs is None else np.asarray(costs, dtype=np.float64)  # not rounded: they order more ties
    order = np.lexsort((chosen, given[chosen], set_hash(start, members), -covered))
    canonical = sp.csr_array(part[:, order])[rows]
    required = ceil(Fraction(coverage) * int(row_units.sum()) * (1 - TARGET_SLACK))
    problem = _from_csr(
        canonical,
        row_units,
        required,
        coverage == 1.0,
        np.minimum(per_row[rows], multiplicity),
        column_costs[chosen[order]],
    )
    return Candidates(
        problem,
        rows,
        chosen[order],
        weights,
        uncoverable_rows=np.flatnonzero(per_row == 0),
        short_rows=np.flatnonzero((per_row > 0) & (per_row < multiplicity)),
        cost_unit=cost_unit,
    )


def column_indices(name: str, values: Iterable[int], n_columns: int) -> Ints:
    """Column indices that a user named, checked, ascending and without repetition.

    Raises:
        PlannerError: if one is not a column of the matrix.
    """
    indices = np.unique(np.array(list(values), dtype=np.int64))
    outside = indices[(indices < 0) | (indices >= n_columns)]
    if len(outside):
        raise PlannerError(f"{name} names column {outside[0]}; the matrix has columns 0 to {n_columns - 1}")
    return indices


def _units(areas: Floats) -> Floats:
    """Areas as whole numbers that sum to about AREA_UNITS; no row weighs nothing, so that none is ever ignored."""
    if not len(areas):
        return areas
    top = float(areas.max())
    if top == 0.0:
        return np.ones(len(areas))
    relative = areas / top  # at most 1 each, so that neither the sum nor the product overflows
    units: Floats = np.maximum(np.rint(relative * (AREA_UNITS / fsum(relative))), 1.0)
    return units


def _costs(costs: ArrayLike | None, n_columns: int) -> tuple[Ints, float]:
    """Costs as whole numbers, and what a unit of them stands for."""
    if costs is None:
        return np.ones(n_columns, dtype=np.int64), 1.0
    given = np.array(costs, dtype=np.float64)
    if given.shape != (n_columns,):
        raise PlannerError(
            f"costs has shape {given.shape}; the matrix has {n_columns} columns, so it must be ({n_columns},)"
        )
    bad = np.flatnonzero(~(np.isfinite(given) & (given > 0)))
    if len(bad):
        raise PlannerError(f"costs[{bad[0]}] is {given[bad[0]]}; a cost must be a finite number above zero")
    if not n_columns:
        return np.zeros(0, dtype=np.int64), 1.0
    top = float(given.max())
    if top <= COST_UNITS and (given == np.rint(given)).all():
        whole = given.astype(np.int64)
        divisor = int(np.gcd.reduce(whole))
        return whole // divisor, float(divisor)
    units = np.maximum(np.rint(given / top * COST_UNITS), 1.0).astype(np.int64)
    if (units == units[0]).all():
        return np.ones(n_columns, dtype=np.int64), top
    return units, top / COST_UNITS


def _from_csr(M: Any, units: Floats, required: int, full: bool, demand: Ints, costs: Ints) -> CoverProblem:
    by_row = sp.csr_array(M)
    by_row.sort_indices()
    by_column = sp.csc_array(by_row)
    by_column.sort_indices()
    sets = [array.astype(np.int64) for M in (by_row, by_column) for array in (M.indptr, M.indices)]
    return CoverProblem(sets[0], sets[1], sets[2], sets[3], units, max(required, 0), full, demand, costs)
