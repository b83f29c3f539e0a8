"""Canonical form of a cover problem, and exact reductions of it.

**Canonical form.** Three decisions make every later step exact and reproducible:

* Areas become integers. Each area is rounded to a multiple of 2^-52 of the total (at least one multiple), so that sums
  are exact in int64 and in float64 and do not depend on the order of summation. A target below 1 is checked in these
  units with a relative tolerance of 1e-12: 0.55 of 100 equal areas must mean 55 of them, although the float 0.55 is
  slightly above 55/100. Coverage 1 ignores areas: it requires every coverable row.
* Costs become integers: whole numbers are divided by their greatest common divisor; others are rounded to multiples of
  2^-40 of the largest.
* Columns are sorted by content: larger covered area first, then a hash of rows and loads, then the lower cost, then the
  index. All later steps use the sorted columns, so that a permutation of the candidates changes only indices.

**Reductions** make a problem smaller, keep its optimum, and can be lifted. They are applied in turn until nothing
changes, for large matrices until little changes (`MIN_GAIN`); Beasley 1987, doi:10.1016/0377-2217(87)90141-X, and
earlier work cited there:

* Rows with the same columns and the same demand become one row with their summed area.
* A column is dropped if as many other columns as the largest demand of its rows cover all its rows, belong to its group
  and cost no more. A cover with the column but without one of them may exchange it, and a cover with all of them does
  not need it. Of identical columns the first in canonical order stays.
* Full cover only: a row is dropped if each cover that satisfies some other row, whose columns are a subset of its own,
  satisfies it too.
* A row that cannot stay uncovered and whose columns bring no more than it demands forces these columns.

Subset tests use bit masks, and compare only sets that share the rarest member. A pass of tests that would cost more
than `PASS_SHARE` of the remaining effort is skipped. With different loads only columns are forced. With an overlap
graph nothing is reduced, because a column that covers nothing new may still connect others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, fsum
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from planner.compiled import compiled
from planner.cover.budget import Budget
from planner.cover.problem import (
    NO_GRAPH,
    CoverInstance,
    CoverProblem,
    compress,
    gather_slices,
    overlap_adjacency,
    pack_bits,
    reduce_slices,
    set_hash,
    slice_blocks,
)
from planner.errors import PlannerError
from planner.values import Bools, Floats, Ints, Ints32, Value, freeze

AREA_UNITS = 2**52
"""Approximate sum of the areas in units: sums stay below 2^53 and are exact in float64 too."""

COST_UNITS = 2**40
"""Units of the largest cost, if costs are not whole numbers: the rounding error is below 1e-12 of it."""

MAX_COST_SUM = 2**62
"""Largest sum of all costs in units: sums are int64. With more than four million columns there are fewer units."""

TARGET_TOLERANCE = Fraction(1, 10**12)
"""Share of a target below full coverage that may be missing (rounding of the areas)."""

PASS_SHARE = 0.2
"""Largest share of the remaining effort for one pass of subset tests."""

PAIR_EFFORT, MEMBER_EFFORT = 3, 6
"""Effort of a subset test, and of packing a member."""

LARGE, MIN_GAIN = 200_000, 0.1
"""A matrix with more entries than the first gets another round only if the last one removed this share of them."""


@dataclass(frozen=True, slots=True, eq=False)
class CanonicalForm(Value):
    """A problem in canonical form, without and with its pinned columns, and the mapping to the caller's numbers.

    Attributes:
        reduced: all usable columns and coverable rows.
        rows: (s,) row of the matrix of each of its rows.
        columns: (v,) column of the matrix of each of its columns.
        areas: (S,) area of each row of the matrix [m^2].
        uncoverable_rows: rows without a usable column.
        unsatisfiable_rows: rows whose columns together have a load below the demand.
        cost_unit: caller's cost of one unit.
        pinned: pinned columns of the matrix, ascending.
        pinned_columns: those of them that cover something, as columns of `reduced`.
        forced_columns: columns of `reduced` in every selection: pinned, or needed by a row that must be covered.
        residual: the problem that remains after the pinned columns; with an overlap graph they are part of it.
        residual_columns: (r,) column of `reduced` of each of its columns.
    """

    reduced: CoverInstance
    rows: Annotated[Ints, "s"]
    columns: Annotated[Ints, "v"]
    areas: Annotated[Floats, "S"]
    uncoverable_rows: Annotated[Ints, "_"]
    unsatisfiable_rows: Annotated[Ints, "_"]
    cost_unit: float
    pinned: Annotated[Ints, "_"]
    pinned_columns: Annotated[Ints, "_"]
    forced_columns: Annotated[Ints, "_"]
    residual: CoverInstance
    residual_columns: Annotated[Ints, "r"]

    def __post_init__(self) -> None:
        freeze(self, s=self.reduced.n_rows, v=self.reduced.n_columns, r=self.residual.n_columns)

    @property
    def idle_pins(self) -> Ints:
        """Pinned columns of the matrix that cover nothing; they stay in every answer."""
        return np.setdiff1d(self.pinned, self.columns)


def canonical_form(problem: CoverProblem) -> CanonicalForm:
    """Check a problem and convert it to canonical form.

    Raises:
        PlannerError: if shapes do not fit, an area is NaN, infinite or negative, the coverage is not in [0, 1], a cost
            is not above zero, or options contradict each other.
    """
    matrix, usable, pinned = _checked(problem)
    n_columns = matrix.shape[1]
    areas = np.array(problem.areas, dtype=np.float64)
    group, group_costs = _groups(problem, n_columns)
    useful = np.flatnonzero(usable & (np.diff(matrix.indptr) > 0))
    M = matrix if len(useful) == n_columns else matrix[:, useful]
    has_unit_loads = M.dtype == np.int8
    weights = None if has_unit_loads else M.data
    available = np.bincount(M.indices, weights, matrix.shape[0]).astype(np.int64)  # exact below 2^53
    rows = np.flatnonzero(available)
    if len(rows) < matrix.shape[0]:
        new_index = np.cumsum(available > 0, dtype=M.indices.dtype) - 1
        M = sp.csc_array((M.data, new_index[M.indices], M.indptr), shape=(len(rows), len(useful)))
    M.sort_indices()
    units = _integer_areas(areas[rows])
    limited = min(problem.demand, 2**30) if isinstance(problem.demand, int) else np.minimum(problem.demand, 2**30)
    demanded = np.broadcast_to(limited, available.shape)
    demand = np.minimum(available, demanded)[rows]
    is_full = problem.coverage == 1.0 and problem.max_views is None
    forced = np.zeros(n_columns, dtype=np.bool_)
    forced[pinned] = True
    if is_full:  # rows that demand all of their columns
        forced[useful] |= M.T @ (available <= demanded)[rows].astype(np.int64) > 0
    is_useful = np.isin(np.arange(n_columns), useful)
    costs, group_units, cost_unit = _integer_costs(problem.costs, is_useful, forced, group_costs)
    start, hashed = M.indptr.astype(np.int64), M.indices
    if not has_unit_loads:
        M.data, hashed = np.minimum(M.data, demand[M.indices]), hashed.astype(np.int64)
    covered = reduce_slices(np.add, start, M.indices, units.__getitem__)
    exact_costs = costs if problem.costs is None else np.asarray(problem.costs, dtype=np.float64)  # with fewer ties
    content = set_hash(start, hashed * (1 + int(M.data.max(initial=1))) + M.data)
    first_row = M.indices[start[:-1]]
    order = np.lexsort((useful, exact_costs[useful], group[useful], content, first_row, -covered))
    columns = useful[order]
    group_units[group[np.setdiff1d(pinned, useful)]] = 0  # pinned columns that cover nothing pay for their groups
    max_columns = None if problem.max_views is None else min(problem.max_views - len(pinned), len(useful))
    required = ceil(Fraction(problem.coverage) * int(units.sum()) * (1 - TARGET_TOLERANCE))
    M = M[:, order]
    graph = NO_GRAPH
    if problem.overlap is not None:
        graph = overlap_adjacency(M > 0, areas[rows], problem.overlap)
    pinned_columns = np.flatnonzero(np.isin(columns, pinned))
    reduced = CoverInstance(
        *compress(M),
        demand=demand,
        units=units,
        required=max(required, 0),
        full=is_full,
        max_columns=max_columns,
        costs=costs[columns],
        group=group[columns],
        group_costs=group_units,
        adjacent=graph,
        fixed=pinned_columns if len(graph) else pinned_columns[:0],
    )
    residual, left = (reduced, np.arange(reduced.n_columns)) if len(graph) else reduced.residual(pinned_columns)
    return CanonicalForm(
        reduced,
        rows,
        columns,
        areas,
        uncoverable_rows=np.flatnonzero(available == 0),
        unsatisfiable_rows=np.flatnonzero((available > 0) & (available < demanded)),
        cost_unit=cost_unit,
        pinned=pinned,
        pinned_columns=pinned_columns,
        forced_columns=np.flatnonzero(forced[columns]),
        residual=residual,
        residual_columns=left,
    )


def _checked(problem: CoverProblem) -> tuple[Any, Bools, Ints]:
    """Return the loads by column, (V,) whether each column is usable, and the pinned columns."""
    original: Any = problem.matrix if sp.issparse(problem.matrix) else np.asarray(problem.matrix)
    matrix: Any = sp.csc_array(original)
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
    usable[_checked_columns("banned", problem.banned, n_columns)] = False
    pinned = _checked_columns("pinned", problem.pinned, n_columns)
    if len(refused := pinned[~usable[pinned]]):
        raise PlannerError(f"pinned names column {refused[0]}, which is banned or not among the allowed columns")
    if problem.max_views is not None:
        if problem.max_views < len(pinned):
            reason = f", and {len(pinned)} views are pinned" if len(pinned) else ""
            raise PlannerError(f"max_views is {problem.max_views}; it must be 0 or more{reason}")
        if problem.costs is not None or problem.group is not None or problem.overlap is not None:
            raise PlannerError("max_views cannot be combined with costs, groups or overlap; give one of them")
    return matrix, usable, pinned


def _checked_columns(name: str, values: Sequence[int], n_columns: int) -> Ints:
    """Return the given columns, checked, ascending and without repetition."""
    indices = np.unique(np.array(values, dtype=np.int64))
    outside = indices[(indices < 0) | (indices >= n_columns)]
    if len(outside):
        raise PlannerError(f"{name} names column {outside[0]}; the matrix has columns 0 to {n_columns - 1}")
    return indices


def _groups(problem: CoverProblem, n_columns: int) -> tuple[Ints, Floats]:
    """Return (V,) group of each column and (G,) cost of each group; one group without cost if there are none."""
    if problem.group is None:
        return np.zeros(n_columns, dtype=np.int64), np.zeros(1)
    group = np.array(problem.group, dtype=np.int64)
    costs = np.array([] if problem.group_costs is None else problem.group_costs, dtype=np.float64)
    if group.shape != (n_columns,) or (n_columns and not 0 <= group.min() <= group.max() < len(costs)):
        raise PlannerError(f"group must give each of {n_columns} columns a group from 0 to {len(costs) - 1}")
    if not (np.isfinite(costs) & (costs >= 0)).all():
        raise PlannerError("group_costs must be finite numbers, zero or above")
    return group, costs


def _integer_areas(areas: Floats) -> Ints:
    """Return areas as integers that sum to about AREA_UNITS; each is at least 1, so that no row is ignored."""
    top = float(areas.max(initial=0.0))
    if top == 0.0:
        return np.ones(len(areas), dtype=np.int64)
    relative = areas / top  # at most 1 each, so that neither the sum nor the product overflows
    return np.maximum(np.rint(relative * (AREA_UNITS / fsum(relative))), 1.0).astype(np.int64)


def _integer_costs(
    costs: ArrayLike | None, useful: Bools, forced: Bools, group_costs: Floats
) -> tuple[Ints, Ints, float]:
    """Return the costs of columns and groups as integers, and the caller's cost of one unit.

    The largest cost of a column that may be selected or not has `COST_UNITS`. A forced one has at most as many, however
    expensive it is.

    Args:
        costs: (V,) as the caller gives them.
        useful: (V,) whether each column is usable and covers something.
        forced: (V,) whether each column is in every selection.
        group_costs: (G,) cost of each group.
    """
    n_columns = len(useful)
    column_costs = np.ones(n_columns) if costs is None else np.array(costs, dtype=np.float64)
    if column_costs.shape != (n_columns,):
        raise PlannerError(
            f"costs has shape {column_costs.shape}; the matrix has {n_columns} columns, so it must be ({n_columns},)"
        )
    bad = np.flatnonzero(~(np.isfinite(column_costs) & (column_costs > 0)))
    if len(bad):
        raise PlannerError(f"costs[{bad[0]}] is {column_costs[bad[0]]}; a cost must be a finite number above zero")
    column_costs[~useful] = column_costs[useful].min(initial=column_costs.max(initial=1.0))
    top = max(float(column_costs[~forced].max(initial=0.0)), float(group_costs.max(initial=0.0)))
    top = top or float(column_costs.max(initial=1.0))
    # Every selection has the forced columns, and is priced with the caller's costs.
    column_costs[forced] = np.minimum(column_costs[forced], top)
    both = np.concatenate((column_costs, group_costs))
    if both.max(initial=0.0) <= COST_UNITS and (both == np.rint(both)).all():
        whole = both.astype(np.int64)
        divisor = max(int(np.gcd.reduce(whole)), 1)
        return whole[:n_columns] // divisor, whole[n_columns:] // divisor, float(divisor)
    highest = min(COST_UNITS, MAX_COST_SUM // max(len(both), 1))
    units = np.maximum(np.rint(column_costs / top * highest), 1.0).astype(np.int64)
    groups = np.rint(group_costs / top * highest).astype(np.int64)
    if (units == units[:1]).all() and not groups.any():
        return np.ones(n_columns, dtype=np.int64), groups, top
    return units, groups, top / highest


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A smaller problem, and the mapping of its covers to covers of the original problem.

    Attributes:
        instance: the reduced problem.
        forced: columns of the original problem that some optimal cover contains.
        columns: (V',) original index of each column of the reduced problem, ascending.
    """

    instance: CoverInstance
    forced: Ints
    columns: Ints

    def lift(self, columns: Ints) -> Ints:
        """Convert a cover of the reduced problem to one of the original."""
        return np.concatenate((self.forced, self.columns[columns]))

    def project(self, columns: Ints) -> Ints:
        """Return the remaining ones of some original columns, as columns of the reduced problem."""
        return np.searchsorted(self.columns, columns[np.isin(columns, self.columns)])


def reduce(instance: CoverInstance, budget: Budget, *, only_forced: bool = False) -> Reduction:
    """Apply all reductions until nothing changes or the effort is spent.

    Args:
        instance: the problem.
        budget: charged.
        only_forced: remove only the forced columns, which takes hardly any effort.
    """
    reduction = Reduction(instance, np.zeros(0, dtype=np.int64), np.arange(instance.n_columns))
    with budget.stopped_by_interrupt():
        again = not len(instance.adjacent)
        while again and not reduction.instance.needs_no_column and (only_forced or budget.remaining):
            reduction, again = _reduce_once(reduction, budget, only_forced)
    return reduction


def _reduce_once(reduction: Reduction, budget: Budget, only_forced: bool) -> tuple[Reduction, bool]:
    """Apply every reduction once; also return whether another round is worth its effort."""
    instance, forced, columns = reduction.instance, reduction.forced, reduction.columns
    shape, entries = instance.shape, instance.n_entries
    budget.spend((2 if only_forced else 15) * entries)
    new = _forced_columns(instance)
    if len(new):
        residual, left = instance.residual(new)
        return Reduction(residual, np.concatenate((forced, columns[new])), columns[left]), True
    if only_forced or not instance.has_unit_loads:
        return reduction, False
    instance = _merge_rows(instance)
    remaining_columns = ~_dominated_columns(instance, budget)
    remaining_rows = ~_dominated_rows(instance, budget) if instance.full else np.ones(instance.n_rows, dtype=bool)
    if not (remaining_columns.all() and remaining_rows.all()):
        instance, columns = instance.restricted(remaining_rows, remaining_columns), columns[remaining_columns]
    min_removed = MIN_GAIN * entries if entries > LARGE else 0.0
    again = instance.shape != shape and entries - instance.n_entries >= min_removed
    return Reduction(instance, forced, columns), again


def _forced_columns(instance: CoverInstance) -> Ints:
    """Return the columns without which a row that must be covered cannot have what it demands."""
    if instance.maximises_area:
        return np.zeros(0, dtype=np.int64)
    rows = np.flatnonzero(instance.units > instance.slack)
    columns, lengths = instance.columns_of(rows)
    if instance.has_unit_loads:
        return np.unique(columns[np.repeat(lengths <= instance.demand[rows], lengths)]).astype(np.int64)
    loads, _ = gather_slices(instance.row_start, instance.row_load, rows)
    slack = np.add.reduceat(np.append(loads, 0), np.cumsum(lengths) - lengths) - instance.demand[rows]
    return np.unique(columns[loads > np.repeat(slack, lengths)]).astype(np.int64)


def _merge_rows(instance: CoverInstance) -> CoverInstance:
    """Keep the first of the rows with the same columns and demand, with their summed units."""
    start, members = instance.row_start, instance.row_columns
    hashes, lengths = set_hash(start, members), np.diff(start)
    order = np.lexsort((np.arange(instance.n_rows), hashes, instance.demand, lengths))
    previous, current = order[:-1], order[1:]
    equal = (hashes[previous] == hashes[current]) & (lengths[previous] == lengths[current])
    equal &= instance.demand[previous] == instance.demand[current]
    pairs = np.flatnonzero(equal)
    if not len(pairs):
        return instance
    # Equal hashes do not prove equal sets: compare the members.
    ends = np.cumsum(lengths[previous[pairs]])
    for block in slice_blocks(ends - lengths[previous[pairs]]):
        chunk = pairs[block]
        first, count = gather_slices(start, members, previous[chunk])
        second, _ = gather_slices(start, members, current[chunk])
        equal[chunk] = np.logical_and.reduceat(first == second, np.cumsum(count) - count)
    group = np.concatenate(([0], np.cumsum(~equal)))
    leader = order[np.concatenate(([True], ~equal))]
    summed = np.zeros(instance.n_rows, dtype=np.int64)
    np.add.at(summed, leader[group], instance.units[order])
    is_leader = np.zeros(instance.n_rows, dtype=bool)
    is_leader[leader] = True
    return instance.restricted(rows=is_leader, units=summed)


def _dominated_columns(instance: CoverInstance, budget: Budget) -> Bools:
    """Return (V,) whether a column is empty, or enough others cover all its rows and cost no more."""
    sizes = np.diff(instance.column_start)
    largest_demand = reduce_slices(np.maximum, instance.column_start, instance.column_rows, instance.demand.__getitem__)
    group = np.where(instance.group_costs[instance.group] == 0, -1, instance.group)
    dominated: Bools = (sizes == 0) | _dominated(
        instance.column_start, instance.column_rows, instance.row_start, instance.row_columns,
        instance.costs, group, largest_demand, budget,
    )  # fmt: skip
    return dominated


def _dominated_rows(instance: CoverInstance, budget: Budget) -> Bools:
    """Return (S,) whether a row of a full cover is satisfied whenever another row is."""
    return _dominated(
        instance.row_start, instance.row_columns, instance.column_start, instance.column_rows,
        instance.demand, np.full(instance.n_rows, -1), None, budget,
    )  # fmt: skip


def _dominated(
    start: Ints, members: Ints32, of_start: Ints, of_member: Ints32, price: Ints, group: Ints, need: Ints | None,
    budget: Budget,
) -> Bools:  # fmt: skip
    """Return (N,) whether a set, as `members` from `start` on, is dominated; all False if the tests cost too much.

    `of_start` and `of_member` list the sets of each member; for the others see `_find_dominated`. Without `need` the
    containing set is dominated.
    """
    frequency, sizes, n_sets = np.diff(of_start), np.diff(start), len(start) - 1
    key = frequency.astype(np.int64) * len(frequency) + np.arange(len(frequency))
    rarest = reduce_slices(np.minimum, start, members, key.__getitem__) % max(len(frequency), 1)
    effort = PAIR_EFFORT * int(frequency[rarest[sizes > 0]].sum()) + MEMBER_EFFORT * len(members)
    if not len(members) or effort > PASS_SHARE * budget.remaining:
        return np.zeros(n_sets, dtype=bool)
    budget.spend(effort)
    bits = pack_bits(start, members, len(frequency))
    min_containing = np.zeros(n_sets, dtype=np.int64) if need is None else need.astype(np.int64)
    sizes, of_start = sizes.astype(np.int64), of_start.astype(np.int64)
    dominated: Bools = _find_dominated(
        bits, sizes, rarest, of_start, of_member, price, group, min_containing, need is None
    )
    return dominated


@compiled
def _find_dominated(
    bits: Any, sizes: Any, rarest: Any, of_start: Any, of_member: Any, price: Any, group: Any, need: Any,
    drop_larger: bool,
) -> Any:  # fmt: skip
    """Find the sets that others make superfluous; of equal sets the later one is dominated.

    Args:
        bits: (N, words) the sets as bit masks.
        sizes: (N,) number of members of each.
        rarest: (N,) member of each that is in the fewest sets: only sets that share it can contain the set.
        of_start: with `of_member`, the sets of each member.
        of_member: see `of_start`.
        price: (N,) the containing set may not have a higher price than the contained one.
        group: (N,) the containing set must be of the same group, unless its own group is -1.
        need: (N,) number of sets that must contain a dominated one; ignored with `drop_larger`.
        drop_larger: whether the containing set is dominated (rows), not the contained one (columns).

    Returns:
        (N,) bool.
    """
    is_dominated = np.zeros(len(sizes), dtype=np.bool_)
    for j in range(len(sizes)):
        if sizes[j] == 0 or (drop_larger and is_dominated[j]):
            continue
        common = 0
        for at in range(of_start[rarest[j]], of_start[rarest[j] + 1]):
            other = of_member[at]
            if other == j or sizes[other] < sizes[j] or price[other] > price[j]:
                continue
            if sizes[other] == sizes[j] and price[other] == price[j] and (other > j) != drop_larger:
                continue
            if (drop_larger and is_dominated[other]) or (group[other] >= 0 and group[other] != group[j]):
                continue
            inside = True
            for word in range(bits.shape[1]):
                if bits[j, word] & ~bits[other, word]:
                    inside = False
                    break
            if not inside:
                continue
            if drop_larger:
                is_dominated[other] = True
                continue
            common += 1
            if common >= need[j]:
                is_dominated[j] = True
                break
    return is_dominated
