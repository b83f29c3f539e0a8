"""A cover problem in canonical form: checked, in whole numbers, its columns sorted by what they hold.

Three decisions make every later step exact and reproducible:

* **Areas become integers.** Each area is rounded to a multiple of 2^-52 of the total (at least one multiple), so that
  sums are exact in int64 and in float64 alike and do not depend on the order of summation. Whether a target below 1 is
  met is decided in these units with a relative slack of 1e-12, because 0.55 of 100 equal areas must mean 55 of them,
  though the float 0.55 is a hair above 55/100. Coverage 1 never looks at areas: it asks for every coverable row.
* **Costs become integers**: whole numbers are divided by their greatest common divisor; any others are rounded to
  multiples of 2^-17 of the largest.
* **Columns are sorted by content**: larger covered area first, then a hash of the rows and loads, then the lower cost,
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
from numpy.typing import ArrayLike

from planner.cover.graph import NO_GRAPH, joined_columns
from planner.cover.problem import CoverProblem
from planner.cover.sets import Sets, both_ways, of_slices, set_hash
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
class Canonical(Value):
    """A problem in canonical form, with the pinned columns taken out, and the way back to the caller's numbers.

    Attributes:
        whole: every usable column and coverable row.
        rows: (s,) row of the matrix of each of its rows.
        columns: (v,) column of the matrix of each of its columns.
        areas: (S,) area of every row of the matrix [m^2].
        uncoverable_rows: rows that no usable column covers.
        unsatisfiable_rows: rows whose columns together bring less than was demanded.
        cost_unit: what a cost of 1 stands for in the caller's unit.
        pinned: pinned columns of the matrix, ascending.
        fixed: those of them that cover something, as columns of `whole`.
        rest: what they leave to be searched; where a graph has to hold together they are part of it.
        rest_columns: (r,) column of `whole` of each of its columns.
    """

    whole: Sets
    rows: Annotated[Ints, "s"]
    columns: Annotated[Ints, "v"]
    areas: Annotated[Floats, "S"]
    uncoverable_rows: Annotated[Ints, "_"]
    unsatisfiable_rows: Annotated[Ints, "_"]
    cost_unit: float
    pinned: Annotated[Ints, "_"]
    fixed: Annotated[Ints, "_"]
    rest: Sets
    rest_columns: Annotated[Ints, "r"]

    def __post_init__(self) -> None:
        freeze(self, s=self.whole.n_rows, v=self.whole.n_columns, r=self.rest.n_columns)

    @property
    def idle(self) -> Ints:
        """Pinned columns of the matrix that cover nothing; they stay in every answer."""
        return np.setdiff1d(self.pinned, self.columns)


def canonical(problem: CoverProblem) -> Canonical:
    """Check a problem and bring it into canonical form.

    Raises:
        PlannerError: if shapes do not fit, an area is NaN, infinite or negative, the coverage is not in [0, 1], a cost
            is not above zero, or wishes contradict each other.
    """
    matrix, usable, pinned = _checked(problem)
    n_columns = matrix.shape[1]
    areas = np.array(problem.areas, dtype=np.float64)
    group, group_costs = _groups(problem, n_columns)
    costs, group_units, cost_unit = _costs(problem.costs, n_columns, group_costs)

    chosen = np.flatnonzero(usable & (np.diff(matrix.indptr) > 0))
    part = matrix if len(chosen) == n_columns else matrix[:, chosen]
    plain = part.dtype == np.int8
    weights = None if plain else part.data
    available = np.bincount(part.indices, weights, matrix.shape[0]).astype(np.int64)  # exact below 2^53
    rows = np.flatnonzero(available)
    if len(rows) < matrix.shape[0]:
        place = np.cumsum(available > 0, dtype=part.indices.dtype) - 1
        part = sp.csc_array((part.data, place[part.indices], part.indptr), shape=(len(rows), len(chosen)))
    part.sort_indices()
    units = _units(areas[rows])
    most = min(problem.demand, 2**30) if isinstance(problem.demand, int) else np.minimum(problem.demand, 2**30)
    asked = np.broadcast_to(most, available.shape)
    demand = np.minimum(available, asked)[rows]
    start, of_entry = part.indptr.astype(np.int64), part.indices
    if not plain:
        part.data, of_entry = np.minimum(part.data, demand[part.indices]), of_entry.astype(np.int64)
    covered = of_slices(np.add, start, part.indices, units.__getitem__)
    given = costs if problem.costs is None else np.asarray(problem.costs, dtype=np.float64)  # unrounded: fewer ties
    held = set_hash(start, of_entry * (1 + int(part.data.max(initial=1))) + part.data)
    first = part.indices[start[:-1]]
    order = np.lexsort((chosen, given[chosen], group[chosen], held, first, -covered))
    columns = chosen[order]
    group_units[group[np.setdiff1d(pinned, chosen)]] = 0  # pinned columns that cover nothing open theirs in any case
    most = -1 if problem.max_views is None else min(problem.max_views - len(pinned), len(chosen))
    full = problem.coverage == 1.0 and most < 0
    required = ceil(Fraction(problem.coverage) * int(units.sum()) * (1 - TARGET_SLACK))
    in_order = part[:, order]
    graph = NO_GRAPH
    if problem.overlap is not None:
        graph = joined_columns(in_order > 0, areas[rows], problem.overlap)
    fixed = np.flatnonzero(np.isin(columns, pinned))
    whole = Sets(
        *both_ways(in_order), demand, units, required=max(required, 0), full=full, most=most, costs=costs[columns],
        group=group[columns], group_costs=group_units, adjacent=graph,
        fixed=fixed if len(graph) else fixed[:0],
    )  # fmt: skip
    rest, left = (whole, np.arange(whole.n_columns)) if len(graph) else whole.without(fixed)
    return Canonical(
        whole, rows, columns, areas,
        uncoverable_rows=np.flatnonzero(available == 0),
        unsatisfiable_rows=np.flatnonzero((available > 0) & (available < asked)),
        cost_unit=cost_unit, pinned=pinned, fixed=fixed, rest=rest, rest_columns=left,
    )  # fmt: skip


def _checked(problem: CoverProblem) -> tuple[Any, Bools, Ints]:
    """The loads by column, which columns may be used, and the pinned ones."""
    given: Any = problem.matrix if sp.issparse(problem.matrix) else np.asarray(problem.matrix)
    matrix: Any = sp.csc_array(given)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    if matrix.dtype == np.int64:
        if len(matrix.data) and matrix.data.min() < 0:
            raise PlannerError(f"a load of the matrix is {matrix.data.min()}; loads must be zero or above")
    else:
        matrix = sp.csc_array((np.ones(matrix.nnz, np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)
    n_rows, n_columns = matrix.shape
    areas = np.array(problem.areas, dtype=np.float64)
    if areas.shape != (n_rows,):
        raise PlannerError(f"areas has shape {areas.shape}; the matrix has {n_rows} rows, so it must be ({n_rows},)")
    bad = np.flatnonzero(~(np.isfinite(areas) & (areas >= 0)))
    if len(bad):
        raise PlannerError(f"areas[{bad[0]}] is {areas[bad[0]]}; an area must be a finite number, zero or above")
    if not 0.0 <= problem.coverage <= 1.0:  # also refuses NaN
        raise PlannerError(
            f"coverage is {problem.coverage!r}; it is a share of the coverable area and must be from 0 to 1"
        )
    if np.shape(problem.demand) not in ((), (n_rows,)):
        raise PlannerError(f"demand has shape {np.shape(problem.demand)}; it must be one number, or ({n_rows},)")
    if np.min(problem.demand, initial=1) < 1:
        raise PlannerError(f"demand is {np.min(problem.demand)}; every row must be covered at least once")
    usable = np.ones(n_columns, dtype=bool) if problem.allowed is None else np.array(problem.allowed)
    if usable.shape != (n_columns,) or usable.dtype != np.bool_:
        raise PlannerError(
            f"allowed has shape {usable.shape} and type {usable.dtype}; it must be ({n_columns},) of bool"
        )
    usable = usable.copy()
    usable[_named("banned", problem.banned, n_columns)] = False
    pinned = _named("pinned", problem.pinned, n_columns)
    if len(refused := pinned[~usable[pinned]]):
        raise PlannerError(f"pinned names column {refused[0]}, which is banned or not among the allowed columns")
    if problem.max_views is not None:
        _check_most(problem, len(pinned))
    return matrix, usable, pinned


def _check_most(problem: CoverProblem, pins: int) -> None:
    if problem.max_views is not None and problem.max_views < pins:
        raise PlannerError(
            f"max_views is {problem.max_views}; it must be 0 or more"
            + (f", and {pins} views are pinned" if pins else "")
        )
    if problem.costs is not None or problem.group is not None or problem.overlap is not None:
        raise PlannerError("max_views counts views: it goes with neither costs nor groups nor overlap")


def _named(name: str, values: Iterable[int], n_columns: int) -> Ints:
    """Columns that a user named, checked, ascending and without repetition."""
    indices = np.unique(np.array(list(values), dtype=np.int64))
    outside = indices[(indices < 0) | (indices >= n_columns)]
    if len(outside):
        raise PlannerError(f"{name} names column {outside[0]}; the matrix has columns 0 to {n_columns - 1}")
    return indices


def _groups(problem: CoverProblem, n_columns: int) -> tuple[Ints, Floats]:
    """(V,) group of each column and (G,) fixed cost of each group; one group without a cost where none are given."""
    if problem.group is None:
        return np.zeros(n_columns, dtype=np.int64), np.zeros(1)
    group = np.array(problem.group, dtype=np.int64)
    costs = np.array([] if problem.group_costs is None else problem.group_costs, dtype=np.float64)
    if group.shape != (n_columns,) or (n_columns and not 0 <= group.min() <= group.max() < len(costs)):
        raise PlannerError(f"group must give each of {n_columns} columns a group from 0 to {len(costs) - 1}")
    if not (np.isfinite(costs) & (costs >= 0)).all():
        raise PlannerError("group_costs must be finite numbers, zero or above")
    return group, costs


def _units(areas: Floats) -> Ints:
    """Areas as whole numbers that sum to about AREA_UNITS; no row weighs nothing, so that none is ever ignored."""
    top = float(areas.max(initial=0.0))
    if top == 0.0:
        return np.ones(len(areas), dtype=np.int64)
    relative = areas / top  # at most 1 each, so that neither the sum nor the product overflows
    return np.maximum(np.rint(relative * (AREA_UNITS / fsum(relative))), 1.0).astype(np.int64)


def _costs(costs: ArrayLike | None, n_columns: int, group_costs: Floats) -> tuple[Ints, Ints, float]:
    """Costs of columns and groups as whole numbers, and what a unit of them stands for."""
    given = np.ones(n_columns) if costs is None else np.array(costs, dtype=np.float64)
    if given.shape != (n_columns,):
        raise PlannerError(
            f"costs has shape {given.shape}; the matrix has {n_columns} columns, so it must be ({n_columns},)"
        )
    bad = np.flatnonzero(~(np.isfinite(given) & (given > 0)))
    if len(bad):
        raise PlannerError(f"costs[{bad[0]}] is {given[bad[0]]}; a cost must be a finite number above zero")
    both = np.concatenate((given, group_costs))
    top = float(both.max(initial=0.0))
    if top <= COST_UNITS and (both == np.rint(both)).all():
        whole = both.astype(np.int64)
        divisor = max(int(np.gcd.reduce(whole)), 1)
        return whole[:n_columns] // divisor, whole[n_columns:] // divisor, float(divisor)
    units = np.maximum(np.rint(given / top * COST_UNITS), 1.0).astype(np.int64)
    groups = np.rint(group_costs / top * COST_UNITS).astype(np.int64)
    if (units == units[0]).all() and not groups.any():
        return np.ones(n_columns, dtype=np.int64), groups, top
    return units, groups, top / COST_UNITS
