"""Heuristics: greedy selection, local search and Meta-RaPS.

**Greedy selection** (Chvatal 1979, doi:10.1287/moor.4.3.233) always takes the column with the largest uncovered area
for its cost. With a number of columns it covers at least 1 - 1/e of the maximum (Nemhauser, Wolsey, Fisher 1978,
doi:10.1007/BF01588971). A row is uncovered until its demand is satisfied. Ties go to the first column in canonical
order, so the result does not depend on the numbering of the candidates.

**Local search** is RWLS for a full cover (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038). Whenever the target is
met, the selection is recorded and the column with the smallest loss is removed. Otherwise one column leaves (smallest
weighted loss, not the one that came last). Then one of a randomly drawn uncovered row enters (largest weighted gain,
not the one that has just left). Ties go to the column that moved longest ago. Each row that is still uncovered gains
weight. Of large rows and selections a sample is examined (Cai 2015, "best from multiple selections"). With costs,
losses and gains count per cost, and columns enter while the selection stays cheaper than the best one; the first column
of a group also pays for the group. A row with a larger demand counts by its deficit.

Gains are added up for the examined columns only, in place of keeping them for all: steps are two to ten times cheaper.
Configuration checking needs the kept scores; without it, test instances reached their best at least as soon.

If rows may stay uncovered, the weight of a row is its area, columns may not move back for some steps (tabu search;
Glover 1989, doi:10.1287/ijoc.1.3.190), and all columns of the drawn row are examined. The same search maximises the
area of a number of columns. Components of the overlap graph beyond one count as one more deficit, whose weight grows
while they last.

The compiled loops run in chunks, between which Ctrl-C and the budget are checked. A search without
improvement for long restarts with initial weights.

**Meta-RaPS** (Lan, DePuy, Whitehouse 2007, doi:10.1016/j.ejor.2005.09.028) is kept for comparison. Each iteration
builds a cover by the randomised greedy rule: with probability `PRIORITY` a best column is taken, otherwise a random one
among those within `RESTRICTION` of the best. Redundant columns are removed. A cover that is at most `IMPROVEMENT`
dearer than the cheapest one is improved: a share `MAGNITUDE` of its columns is removed at random and it is completed in
the same way, and kept if it does not cost more, `IMPROVEMENT_ITERATIONS` times. The parameters are those of an open
implementation for set cover; they were not checked against the paper's table. In place of the paper's core problem all
solvers here get the reduced problem. The several priority rules (equal for unit costs) and the penalty on columns that
often come out worst are omitted.
"""

import heapq
from typing import Any, NamedTuple

import numpy as np

from planner.compiled import compiled
from planner.cover.budget import Budget
from planner.cover.problem import CoverInstance, connect, gather_slices, is_connected, pack_bits, reduce_slices
from planner.values import Floats, Ints


class Residual:
    """Uncovered rows of a selection, and the gain of each further column.

    Attributes:
        selected: the columns, in the order of selection.
        deficit: (S,) missing load of each row.
        gains: (V,) uncovered units that each column satisfies (with different loads: shares of the demand); -inf for
            selected columns.
        missing_units: units that must still be covered; zero or less if the target is met.
        effort: touched entries.
    """

    def __init__(self, instance: CoverInstance, columns: Ints) -> None:
        self.instance, self.selected = instance, [int(j) for j in columns]
        self.deficit = np.maximum(instance.demand - instance.loads(columns), 0)
        rows = np.flatnonzero(self.deficit)
        if instance.has_unit_loads:
            waiting = np.where(self.deficit > 0, instance.units, 0)
            gains = reduce_slices(np.add, instance.column_start, instance.column_rows, waiting.__getitem__)
            self.gains: Floats = gains.astype(np.float64)
        else:
            self.gains = np.zeros(instance.n_columns)
            self._update_gains(rows, np.zeros(len(rows), dtype=np.int64), self.deficit[rows])
        self.gains[columns] = -np.inf
        self.missing_units = int(instance.units[rows].sum()) - (0 if instance.maximises_area else instance.slack)
        self.effort = 3 * instance.n_entries

    def _update_gains(self, rows: Ints, before: Ints, after: Ints) -> None:
        """Update the gains for changed deficits of rows."""
        instance = self.instance
        columns, lengths = instance.columns_of(rows)
        if instance.has_unit_loads:
            change = np.repeat(((after > 0).astype(np.int64) - (before > 0)) * instance.units[rows], lengths)
        else:
            load = gather_slices(instance.row_start, instance.row_load, rows)[0]
            change = np.minimum(load, np.repeat(after, lengths)) - np.minimum(load, np.repeat(before, lengths))
            change = change * np.repeat(instance.units[rows] / instance.demand[rows], lengths)
        # bincount of nothing is of integers
        self.gains += np.bincount(columns, change, instance.n_columns).astype(np.float64, copy=False)

    def select(self, column: int) -> None:
        """Select a column."""
        instance, rows = self.instance, self.instance.rows_of(column)
        before = self.deficit[rows]
        after = np.maximum(before - instance.load_of(column), 0)
        self.deficit[rows] = after
        changed = (before > 0) & ((after == 0) | (not instance.has_unit_loads))
        self._update_gains(rows[changed], before[changed], after[changed])
        self.missing_units -= int(instance.units[rows[(before > 0) & (after == 0)]].sum())
        self.gains[column] = -np.inf
        self.selected.append(column)
        mean_row = instance.n_entries // max(instance.n_rows, 1)
        self.effort += int(changed.sum()) * mean_row * 5 + 2 * instance.n_columns + 25_000


def complete(instance: CoverInstance, columns: Ints) -> Ints:
    """Add columns greedily until the target is met or `max_columns` is reached; connect them in an overlap graph."""
    return _completed(instance, columns)[0]


def _completed(instance: CoverInstance, columns: Ints) -> tuple[Ints, int]:
    """Return the completed selection and the effort."""
    residual = Residual(instance, columns)
    has_unit_costs = instance.has_unit_costs
    cost = instance.costs.astype(np.float64)
    group_cost = instance.group_costs.astype(np.float64)
    group_cost[instance.group[residual.selected]] = 0.0
    while residual.missing_units > 0 and instance.allows_more(len(residual.selected)):
        rates = residual.gains if has_unit_costs else residual.gains / (cost + group_cost[instance.group])
        best = int(np.argmax(rates))
        if residual.gains[best] <= 0:
            break
        residual.select(best)
        group_cost[instance.group[best]] = 0.0
    selected = np.array(residual.selected, dtype=np.int64)
    return (connect(instance.adjacent, selected) if len(instance.adjacent) else selected), residual.effort


def greedy(instance: CoverInstance) -> tuple[Ints, int]:
    """Return the greedy cover without redundant columns, and the effort."""
    selected, effort = _completed(instance, instance.fixed)
    return prune(instance, selected), effort


def prune(instance: CoverInstance, columns: Ints) -> Ints:
    """Remove columns that neither target nor graph needs: the most expensive first, of equal cost the last first."""
    columns = np.asarray(columns, dtype=np.int64)
    loads = instance.loads(columns)
    uncovered = int(instance.units[loads < instance.demand].sum())
    slack = 0 if instance.maximises_area else instance.slack - uncovered
    remaining = columns[np.lexsort((np.arange(len(columns)), instance.costs[columns]))].tolist()
    again = True
    while again:
        again = False
        for column in remaining[::-1]:
            rows = instance.rows_of(column)
            less = loads[rows] - instance.load_of(column)
            is_lost = (loads[rows] >= instance.demand[rows]) & (less < instance.demand[rows])
            loss = int(instance.units[rows[is_lost]].sum())
            if loss > slack or column in instance.fixed:
                continue
            if len(instance.adjacent):
                others = np.array([j for j in remaining if j != column], dtype=np.int64)
                if not is_connected(instance.adjacent, others):
                    continue
                again = True  # in a graph, a removal may make another column redundant
            remaining.remove(column)
            loads[rows] = less
            slack -= loss
    is_selected = np.zeros(instance.n_columns, dtype=bool)
    is_selected[remaining] = True
    return columns[is_selected[columns]]


def order_by_marginal_area(instance: CoverInstance, columns: Ints) -> tuple[Ints, list[Ints]]:
    """Order columns by their marginal coverage, largest first.

    Returns:
        The columns in that order, and for each the rows whose demand it is the first to satisfy.
    """
    deficit = instance.demand.copy()
    rows = {j: instance.rows_of(j) for j in columns.tolist()}

    def gain(column: int) -> int:
        column_rows = rows[column]
        return int(instance.units[column_rows[deficit[column_rows] > 0]].sum())

    # Gains only fall, so an up-to-date gain at the top of the heap is the largest; canonical order decides ties.
    heap = [(-gain(column), column) for column in rows]
    heapq.heapify(heap)
    order: list[int] = []
    added: list[Ints] = []
    while heap:
        known, best = heap[0]
        if (now := -gain(best)) != known:
            heapq.heapreplace(heap, (now, best))
            continue
        heapq.heappop(heap)
        column_rows = rows[best]
        was_open = deficit[column_rows] > 0
        deficit[column_rows] -= instance.load_of(best)
        order.append(best)
        added.append(column_rows[was_open & (deficit[column_rows] <= 0)])
    return np.array(order, dtype=np.int64), added


FAR_COLUMNS, FAR_ENTRIES, MAX_FAR = 60_000, 5_000_000, 1.0
"""Numbers of columns and entries, too many for the near CPU cache, at which the charge of effort doubles; and the
largest surcharge."""

FAR_BITS, FAR_BITS_CHARGE = 10_000_000, 1.0
"""Bytes of bit masks (`WIDE`) from which each access misses the caches as well, and the further surcharge."""

CHUNK_EFFORT = 5_000_000
"""Effort between two checks of Ctrl-C and the budget: about 10 ms."""

START_EFFORT, FAR_BYTE_EFFORT = 5, 3
"""Charge of each entry at the start of a search, and of each byte of bit masks beyond `FAR_BITS`."""

WIDE = 16
"""Mean rows of a column from which a bit mask says which rows it has."""

AREA_WEIGHTS = 2**40
"""Sum of the row weights if rows may stay uncovered: with loads of 2^16, scores stay below 2^62."""

MAX_TENURE = 12
"""If rows may stay uncovered: largest number of moves for which a column may not move back."""

PATIENCE = 60
"""Chunks without improvement after which the search restarts; doubled at each restart."""


class LocalSearch:
    """Local search; it keeps its selection and weights between calls of `run`."""

    def __init__(
        self, instance: CoverInstance, columns: Ints, rng: np.random.Generator, names: Ints | None = None
    ) -> None:
        """Start from a feasible selection.

        Args:
            instance: the problem.
            columns: the selection.
            rng: seeds the draws.
            names: (V,) number of each column in the budget's problem; None: the same number.
        """
        self.instance = instance
        self._names = np.arange(instance.n_columns) if names is None else names
        self._state = self._new_state(rng)
        self._restart(columns)
        numbers = self._state.numbers
        numbers[BEST] = instance.objective(columns)
        # The kernel begins with a step; by then the selection must be cheaper, or cover more, than the best one.
        maximum = instance.max_columns
        numbers[LIMIT] = instance.cost(columns) - 1 if maximum is None else maximum
        numbers[ALLOWED] = instance.slack if maximum is None else numbers[BEST] - 1
        self._max_tenure = 0 if instance.full else min(MAX_TENURE, max(instance.n_columns - len(columns), 1))
        self._patience = PATIENCE
        self._has_far_bits = self._state.bits.nbytes >= FAR_BITS
        self._start_effort = START_EFFORT * instance.n_entries
        self._start_effort += FAR_BYTE_EFFORT * self._state.bits.nbytes * self._has_far_bits
        self._waited = 0

    def run(self, budget: Budget, chunks: int | None = None) -> None:
        """Search while effort remains; offer better selections to the budget.

        Args:
            budget: charged.
            chunks: number of chunks without improvement after which the search ends; None: it does not.
        """
        instance, state = self.instance, self._state
        numbers = state.numbers
        target = budget.lower_bound + instance.tolerance
        far = 1.0 + min(instance.n_columns / FAR_COLUMNS + instance.n_entries / FAR_ENTRIES, MAX_FAR)
        far += FAR_BITS_CHARGE * self._has_far_bits
        best, effort, self._start_effort = int(numbers[BEST]), self._start_effort, 0
        while budget.spend(effort):
            limit = min(CHUNK_EFFORT, max(int(budget.remaining / far), 1))
            step_effort = run_steps(state, instance.full, instance.maximises_area, target, self._max_tenure, limit)
            if step_effort < 0:
                break
            effort = int(step_effort * far)
            self._waited += 1
            if numbers[BEST] < best:
                best, self._waited = int(numbers[BEST]), 0
                pruned = prune(instance, state.columns[BEST_MEMBER, : numbers[BEST_MEMBERS]])
                budget.offer(self._names[pruned], instance.objective(pruned))
            elif self._waited == chunks:
                break
            elif self._waited > self._patience:
                self._waited, self._patience = 0, 2 * self._patience
                self._restart(state.columns[MEMBER, : numbers[MEMBERS]].copy())

    def _restart(self, selected: Ints) -> None:
        """Reset the weights; the next steps continue from this selection."""
        instance, state, numbers = self.instance, self._state, self._state.numbers
        rows, columns = state.rows, state.columns
        rows[LOAD] = rows[OWNERS] = 0
        rows[WEIGHT] = rows[OPEN_WEIGHT] = rows[FIRST_WEIGHT]
        rows[OPEN_ROW] = rows[OPEN_PLACE] = np.arange(instance.n_rows)
        columns[PLACE], columns[STAMP], columns[LOSS], state.groups[N_SELECTED] = -1, 0, 0, 0
        columns[STACK, : len(selected)], numbers[FIRST_MEMBERS] = selected, len(selected)
        numbers[OPEN], numbers[MISSING], numbers[TABU] = instance.n_rows, instance.total_units, -1
        numbers[MEMBERS] = numbers[TOTAL_COST] = 0
        loads = 1 if instance.has_unit_loads else instance.column_load
        weighted = rows[WEIGHT][instance.column_rows] * loads
        column_weight = np.add.reduceat(np.append(weighted, 0), instance.column_start[:-1])
        numbers[COMPONENT_WEIGHT] = max(int(column_weight.max(initial=1)) // 4, 1)

    def _new_state(self, rng: np.random.Generator) -> "SearchState":
        """Return the arrays of a search."""
        instance = self.instance
        numbers = np.zeros(N_NUMBERS, dtype=np.int64)
        numbers[HAS_COSTS], numbers[UNIT_DEMAND] = not instance.has_unit_costs, instance.has_unit_demand
        numbers[CHEAPEST] = instance.costs.min() if instance.n_columns else 1
        rows = np.zeros((OPEN_PLACE + 1, instance.n_rows), dtype=np.int64)
        rows[DEMAND], rows[UNITS], rows[FIRST_WEIGHT] = instance.demand, instance.units, 1
        if not instance.full:
            shares = instance.units / float(max(instance.total_units, 1))
            rows[FIRST_WEIGHT] = np.maximum(np.rint(shares * AREA_WEIGHTS), 1.0).astype(np.int64)
        columns = np.zeros((STACK + 1, instance.n_columns), dtype=np.int64)
        columns[COST], columns[GROUP] = instance.costs, instance.group
        columns[FIXED, instance.fixed] = 1
        groups = np.stack((instance.group_costs, np.zeros_like(instance.group_costs)))
        bits = np.zeros((0, 0), dtype=np.uint64)
        if instance.has_unit_loads and instance.n_entries > WIDE * instance.n_columns:
            bits = pack_bits(instance.column_start, instance.column_rows, instance.n_rows)
        return SearchState(
            row_start=instance.row_start,
            row_columns=instance.row_columns,
            column_start=instance.column_start,
            column_rows=instance.column_rows,
            column_load=instance.column_load,
            bits=bits,
            rows=rows,
            columns=columns,
            groups=groups,
            adjacent=instance.adjacent,
            numbers=numbers,
            random=rng.integers(0, 2**64, 1, dtype=np.uint64),
        )


# Compiled loops of the local search.
#
# A move touches only the rows of the moved column. The gain of a column outside the selection is added up when it is
# examined, over its rows or, if they are fewer, over the uncovered rows with the column's bit mask: a step examines a
# few dozen candidates, while the columns that share a row with the moved one may be all of them. The loss of a member
# is kept up to date if each row demands 1: a row that one member alone covers knows this member by the sum of its
# members (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038, keep the scores of all columns).
#
# Scores are integers and their ratios to costs are float64 without contraction, so that a run is the same on every
# machine. Effort is counted in touched entries.
#
# The state has a few arrays of many fields, and Python calls `run_steps` alone: each array of the state, each slice
# assignment and each entry point adds to the time of compilation. Functions that are called for each candidate take
# arrays: passing the whole state to them makes a step six times as expensive.

MOVE_EFFORT, ROW_EFFORT, ENTRY_EFFORT, BIT_EFFORT = 10, 7, 3, 2
MEMBER_EFFORT, NEXT_MEMBER_EFFORT, DRAWN_MEMBER_EFFORT, CANDIDATE_EFFORT, DRAWN_CANDIDATE_EFFORT = 10, 6, 18, 10, 35
"""Charges in quarter units: a move, each of its rows, each added entry and bit; an examined member (after the first
`FEW` less) or candidate in turn, and a drawn one. Fitted to processor time on instances of 200 to 5000 rows (within
15 %)."""

SAMPLE = 50
"""Number of examined members of an uncovered row that has more, and of a selection with more than `MANY` members."""

FEW, MANY = 120, 400
"""Numbers of members from which an examination costs less, and from which a sample is examined."""

# typed, since numba would compile a kernel anew for each literal that it is called with
IN: Any = np.int64(1)
OUT: Any = np.int64(-1)
NONE: Any = np.int64(-1)
NEVER: Any = np.int64(0)
TEN: Any = np.int64(10)

DEMAND, UNITS, FIRST_WEIGHT, WEIGHT, OPEN_WEIGHT, LOAD, OWNERS, OPEN_ROW, OPEN_PLACE = range(9)
"""Fields of a row in `SearchState.rows`: demanded load; units that are missing while it is uncovered; weight at the
start; weight; weight if it is uncovered, else 0; load by the selection; sum of the selected columns of the row (if
there is one, this is it). The last two are the list of uncovered rows, and the place of each row in it."""

COST, GROUP, FIXED, LOSS, STAMP, MEMBER, PLACE, BEST_MEMBER, LABEL, SEEN, STACK = range(11)
"""Fields of a column in `SearchState.columns`: cost; group; whether it may not leave; weight of the rows that it alone
of the selection covers (if rows demand 1); number of its last move, 0 for none. Then lists: the selection, in no order,
and the place of each column in it (-1: outside); the best selection; three of scratch for the graph's components."""

FIRST_COST, N_SELECTED = range(2)
"""Fields of a group in `SearchState.groups`: additional cost of its first column; number of its selected columns."""

(MOVES, MEMBERS, OPEN, TOTAL_COST, BEST, BEST_MEMBERS, TABU, MISSING, LIMIT, ALLOWED, COMPONENT_WEIGHT, STEPS,
 HAS_COSTS, CHEAPEST, UNIT_DEMAND, EFFORT, FIRST_MEMBERS, N_NUMBERS) = range(18)  # fmt: skip
"""Numbers of a search: moves; selected columns; uncovered rows; cost of the selection; objective and size of the best
one; column that came last; missing units; cost up to which columns enter; units that may be missing; weight of a
component of the graph beyond one; steps; whether costs differ; the smallest cost; whether each row demands 1 and each
column brings 1; effort in quarter units; number of columns in `STACK` to select first. Last, the number of fields."""


ALL: Any = np.int64(LABEL)
OTHERS: Any = np.int64(SEEN)


class SearchState(NamedTuple):
    """Arrays of a search, kept from one chunk of steps to the next."""

    row_start: Any  # (S + 1,) the problem's rows
    row_columns: Any  # (nnz,) columns of each row
    column_start: Any  # (V + 1,) the problem's columns
    column_rows: Any  # (nnz,) rows of each column
    column_load: Any  # (nnz,) or (0,) their loads
    bits: Any  # (V, words) bit mask of the rows of each column; (0, 0) if columns are short or loads differ
    rows: Any  # (fields, S) see above
    columns: Any  # (fields, V)
    groups: Any  # (fields, G)
    adjacent: Any  # (V, V) overlap graph; (0, 0) without one
    numbers: Any  # (N_NUMBERS,)
    random: Any  # (1,) state of the random numbers


@compiled
def column_cost(columns: Any, groups: Any, column: int, n_selected: int) -> Any:
    """Return the cost of a column, and of its group if this number of its columns is selected."""
    group = columns[GROUP, column]
    return columns[COST, column] + (groups[FIRST_COST, group] if groups[N_SELECTED, group] == n_selected else 0)


@compiled
def move(s: SearchState, column: int, sign: int) -> None:
    """Add a column to the selection (sign 1) or remove it (-1)."""
    numbers, rows, columns, groups = s.numbers, s.rows, s.columns, s.groups
    column_start, column_rows, column_load = s.column_start, s.column_rows, s.column_load
    numbers[MOVES] += 1
    columns[STAMP, column] = numbers[MOVES]
    numbers[TOTAL_COST] += sign * column_cost(columns, groups, column, NEVER if sign > 0 else IN)
    groups[N_SELECTED, columns[GROUP, column]] += sign
    if sign > 0:
        columns[PLACE, column] = numbers[MEMBERS]
        columns[MEMBER, numbers[MEMBERS]] = column
        numbers[MEMBERS] += 1
    else:
        numbers[MEMBERS] -= 1
        last = columns[MEMBER, numbers[MEMBERS]]
        columns[MEMBER, columns[PLACE, column]] = last
        columns[PLACE, last] = columns[PLACE, column]
        columns[PLACE, column] = -1
    begin, end = column_start[column], column_start[column + 1]
    unit_demand, has_loads, loss = numbers[UNIT_DEMAND], len(column_load) > 0, 0
    for entry in range(begin, end):
        row = column_rows[entry]
        before, demand, weight = rows[LOAD, row], rows[DEMAND, row], rows[WEIGHT, row]
        after = before + (sign * column_load[entry] if has_loads else sign)
        rows[LOAD, row] = after
        rows[OWNERS, row] += sign * column
        if unit_demand and before + after == 3:  # another member covers the row alone, until now or from now on
            columns[LOSS, rows[OWNERS, row] - (column if sign > 0 else 0)] -= sign * weight
        if (before < demand) == (after < demand):
            continue
        numbers[MISSING] -= sign * rows[UNITS, row]
        loss += weight
        if sign > 0:
            numbers[OPEN] -= 1
            last, place = rows[OPEN_ROW, numbers[OPEN]], rows[OPEN_PLACE, row]
            rows[OPEN_ROW, place], rows[OPEN_PLACE, last] = last, place
            rows[OPEN_WEIGHT, row] = 0
        else:
            rows[OPEN_ROW, numbers[OPEN]], rows[OPEN_PLACE, row] = row, numbers[OPEN]
            numbers[OPEN] += 1
            rows[OPEN_WEIGHT, row] = weight
    columns[LOSS, column] = loss
    numbers[EFFORT] += MOVE_EFFORT + ROW_EFFORT * (end - begin)


@compiled
def load_gain(rows: Any, row: int, load: Any) -> Any:
    """Return the weighted deficit of a row that a load removes."""
    return rows[OPEN_WEIGHT, row] * min(load, rows[DEMAND, row] - rows[LOAD, row])


@compiled
def load_loss(rows: Any, row: int, load: Any) -> Any:
    """Return the weighted deficit of a row once a load is removed."""
    slack = rows[LOAD, row] - rows[DEMAND, row]
    return rows[WEIGHT, row] * (load - max(slack, 0)) if slack < load else 0


@compiled
def draw(random: Any, count: int) -> Any:
    """Draw a number from 0 to count - 1 (SplitMix64; Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195)."""
    random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return np.int64(((z >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))


@compiled
def label_components(s: SearchState, without: int, field: int) -> int:
    """Number the components of the selection, without one position (-1: none), in a field; return how many exist."""
    size, components = s.numbers[MEMBERS], 0
    for position in range(size):
        s.columns[field, position] = -1
    for first in range(size):
        if first == without or s.columns[field, first] >= 0:
            continue
        s.columns[field, first] = components
        s.columns[STACK, 0] = first
        depth = 1
        while depth > 0:
            depth -= 1
            at = s.columns[MEMBER, s.columns[STACK, depth]]
            for other in range(size):
                adjacent = s.adjacent[at, s.columns[MEMBER, other]] == 1
                if other != without and s.columns[field, other] < 0 and adjacent:
                    s.columns[field, other] = components
                    s.columns[STACK, depth] = other
                    depth += 1
        components += 1
    return components


@compiled
def select_leaving(s: SearchState, tabu: int, components: int, tenure: int) -> Any:
    """Return the member with the smallest loss for its cost, oldest first; -1 if none may leave.

    Args:
        s: the search.
        tabu: column that came last, or -1; it leaves only if there is no other.
        components: number of components of the graph; 0 without one.
        tenure: number of moves for which a column that came stays; 0: only the tabu one stays.
    """
    rows, columns, column_start, numbers, random = s.rows, s.columns, s.column_start, s.numbers, s.random
    best, least, least_cost, stamp = -1, 0.0, 1.0, 0
    has_costs, unit_demand, has_loads = numbers[HAS_COSTS] > 0, numbers[UNIT_DEMAND] > 0, len(s.column_load) > 0
    size = numbers[MEMBERS]
    examined = size if size <= MANY else SAMPLE
    if examined == size:
        numbers[EFFORT] += MEMBER_EFFORT * min(size, FEW) + NEXT_MEMBER_EFFORT * max(size - FEW, 0)
    else:
        numbers[EFFORT] += DRAWN_MEMBER_EFFORT * examined
    for k in range(examined):
        position = k if examined == size else draw(random, size)
        column = columns[MEMBER, position]
        if (column == tabu and size > 1) or (components > 0 and columns[FIXED, column]):
            continue
        if tenure > 0 and columns[STAMP, column] > 0 and numbers[MOVES] - columns[STAMP, column] < tenure:
            continue
        weighted = columns[LOSS, column]
        if not unit_demand:
            weighted = 0
            for entry in range(column_start[column], column_start[column + 1]):
                load = np.int64(s.column_load[entry]) if has_loads else np.int64(1)
                weighted += load_loss(rows, s.column_rows[entry], load)
            numbers[EFFORT] += ENTRY_EFFORT * (column_start[column + 1] - column_start[column])
        loss, cost = float(weighted), 1.0
        if components > 0:
            loss += float(numbers[COMPONENT_WEIGHT] * (label_components(s, position, OTHERS) - components))
        if has_costs:
            cost = float(column_cost(columns, s.groups, column, IN))
        difference = loss * least_cost - least * cost
        if best < 0 or difference < 0 or (difference == 0 and columns[STAMP, column] < stamp):
            best, least, least_cost, stamp = column, loss, cost, columns[STAMP, column]
    if best < 0 and size > 0 and not columns[FIXED, columns[MEMBER, 0]]:
        best = columns[MEMBER, 0]
    return best


@compiled
def select_entering(s: SearchState, row: int, left: int, components: int, tenure: int, sample: int) -> Any:
    """Return the column outside with the largest gain for its cost, oldest first; -1 if none may enter.

    Args:
        s: the search.
        row: row whose columns are examined; -1: all columns.
        left: column that has just left.
        components: number of components of the graph, whose labels are in place; 0 without one.
        tenure: number of moves for which a column stays out; 0: only the one that has just left.
        sample: number of columns that are drawn if the row has more.
    """
    rows, columns, numbers, random = s.rows, s.columns, s.numbers, s.random
    column_start, column_rows, column_load, bits = s.column_start, s.column_rows, s.column_load, s.bits
    first, last = (s.row_start[row], s.row_start[row + 1]) if row >= 0 else (0, columns.shape[1])
    count, size, n_open = last - first, numbers[MEMBERS], numbers[OPEN]
    sampled = row >= 0 and count > sample and components == 0
    best, most, most_cost, stamp = -1, 0.0, 1.0, 0
    has_costs, has_loads, touched = numbers[HAS_COSTS] > 0, len(column_load) > 0, 0
    for component in range(components):
        columns[SEEN, component] = 0  # last column that was found adjacent to each component
    for k in range(sample if sampled else count):
        at = first + (draw(random, count) if sampled else k)
        column: Any = np.int64(s.row_columns[at]) if row >= 0 else at
        if columns[PLACE, column] >= 0 or column == left:
            continue
        if tenure > 0 and columns[STAMP, column] > 0 and numbers[MOVES] - columns[STAMP, column] < tenure:
            continue
        begin, end, weighted = column_start[column], column_start[column + 1], 0
        if len(bits) > 0 and n_open < end - begin:
            for position in range(n_open):
                other = rows[OPEN_ROW, position]
                if (bits[column, other >> 6] >> np.uint64(other & 63)) & np.uint64(1):
                    weighted += rows[WEIGHT, other]
            touched += BIT_EFFORT * n_open
        else:
            for entry in range(begin, end):
                if has_loads:
                    weighted += load_gain(rows, column_rows[entry], np.int64(column_load[entry]))
                else:
                    weighted += rows[OPEN_WEIGHT, column_rows[entry]]
            touched += ENTRY_EFFORT * (end - begin)
        gain, cost = float(weighted), 1.0
        if components > 1:
            adjacent = 0
            for position in range(size):
                component = columns[LABEL, position]
                if columns[SEEN, component] != column + 1 and s.adjacent[column, columns[MEMBER, position]] == 1:
                    columns[SEEN, component] = column + 1
                    adjacent += 1
            gain += float(numbers[COMPONENT_WEIGHT] * (adjacent - 1))
        if has_costs:
            cost = float(column_cost(columns, s.groups, column, NEVER))
        difference = gain * most_cost - most * cost
        if best < 0 or difference > 0 or (difference == 0 and columns[STAMP, column] < stamp):
            best, most, most_cost, stamp = column, gain, cost, columns[STAMP, column]
    examined = sample if sampled else count
    each = DRAWN_CANDIDATE_EFFORT if sampled else CANDIDATE_EFFORT * (1 + (size if components > 1 else 0))
    numbers[EFFORT] += touched + each * examined
    return best


@compiled
def is_feasible(numbers: Any, full: bool, components: int) -> Any:
    """Return whether the selection reaches the target and is connected."""
    return (numbers[OPEN] == 0 if full else numbers[MISSING] <= numbers[ALLOWED]) and components <= 1


@compiled
def record_best(numbers: Any, columns: Any, maximises_area: bool) -> None:
    """Record the selection as the best one; the next must be better."""
    numbers[BEST], numbers[BEST_MEMBERS] = numbers[MISSING] if maximises_area else numbers[TOTAL_COST], numbers[MEMBERS]
    for position in range(numbers[MEMBERS]):
        columns[BEST_MEMBER, position] = columns[MEMBER, position]
    if maximises_area:
        numbers[ALLOWED] = numbers[MISSING] - 1
    else:
        numbers[LIMIT] = numbers[TOTAL_COST] - 1


@compiled
def run_steps(s: SearchState, full: bool, maximises_area: bool, target: int, max_tenure: int, effort_limit: int) -> Any:
    """Run steps of the search until the effort is spent or the objective is at most the target.

    Args:
        s: the search.
        full: whether every row must be satisfied: uncovered rows gain weight.
        maximises_area: whether the number of columns is given, and uncovered units are minimised.
        target: objective at which the search ends.
        max_tenure: largest number of moves for which a column may not move back; 0: it may at once.
        effort_limit: largest effort.

    Returns:
        Effort; -1 if no column may leave.
    """
    numbers = s.numbers
    has_graph = len(s.adjacent) > 0
    sample: Any = np.int64(SAMPLE if full else s.columns.shape[1])
    numbers[EFFORT] = 0
    for position in range(numbers[FIRST_MEMBERS]):
        move(s, s.columns[STACK, position], IN)
        s.columns[STAMP, s.columns[STACK, position]] = 0
    numbers[FIRST_MEMBERS] = 0
    while numbers[EFFORT] < 4 * effort_limit:
        components = label_components(s, NONE, ALL) if has_graph else 0
        while is_feasible(numbers, full, components):
            record_best(numbers, s.columns, maximises_area)
            if numbers[BEST] <= target:
                return numbers[EFFORT] // 4
            if maximises_area:
                break
            out = select_leaving(s, NONE, components, NEVER)
            if out < 0:
                return numbers[EFFORT] // 4
            move(s, out, OUT)
            components = label_components(s, NONE, ALL) if has_graph else 0
        numbers[STEPS] += 1
        numbers[EFFORT] += 2 * numbers[MEMBERS] ** 2 * (numbers[MEMBERS] + 1) if has_graph else 0
        tenure = draw(s.random, max_tenure) + 2 if max_tenure > 0 else 0
        out = select_leaving(s, numbers[TABU], components, min(tenure // 2, numbers[MEMBERS]))
        if out < 0:
            return -1
        move(s, out, OUT)
        while True:
            components = label_components(s, NONE, ALL) if has_graph else 0
            if is_feasible(numbers, full, components) or numbers[TOTAL_COST] + numbers[CHEAPEST] > numbers[LIMIT]:
                break
            by_row = numbers[OPEN] > 0 and not (has_graph and draw(s.random, TEN) < 3)
            row: Any = s.rows[OPEN_ROW, draw(s.random, numbers[OPEN])] if by_row else np.int64(-1)
            column = select_entering(s, row, out, components, tenure, sample)
            if column < 0 and by_row and not full:
                column = select_entering(s, NONE, out, components, tenure, sample)
            if column < 0:
                break
            if numbers[TOTAL_COST] + column_cost(s.columns, s.groups, column, NEVER) > numbers[LIMIT]:
                break
            move(s, column, IN)
            numbers[TABU] = column
        if full:
            for position in range(numbers[OPEN]):
                s.rows[WEIGHT, s.rows[OPEN_ROW, position]] += 1
                s.rows[OPEN_WEIGHT, s.rows[OPEN_ROW, position]] += 1
            numbers[EFFORT] += ENTRY_EFFORT * numbers[OPEN]
        if has_graph:
            is_split = label_components(s, NONE, ALL) > 1
            weight = numbers[COMPONENT_WEIGHT]
            numbers[COMPONENT_WEIGHT] = weight + weight // 20 + 1 if is_split else max(weight - weight // 50, 1)
    return numbers[EFFORT] // 4


PRIORITY, RESTRICTION, IMPROVEMENT, MAGNITUDE = 0.05, 0.15, 0.15, 0.3
ITERATIONS, IMPROVEMENT_ITERATIONS = 1000, 100
"""Parameters of Meta-RaPS, see the module's docstring."""


def meta_raps(instance: CoverInstance, rng: np.random.Generator, budget: Budget) -> None:
    """Search by Meta-RaPS for `ITERATIONS`, or until the effort is spent.

    Args:
        instance: the problem.
        rng: random draws.
        budget: charged for touched entries; receives better covers.
    """
    total_cost = instance.costs.sum() + instance.group_costs.sum()
    best = int(instance.total_units if instance.maximises_area else total_cost)
    for _ in range(ITERATIONS):
        if not budget.spend(0):
            break
        cover = _construct(instance, np.zeros(0, dtype=np.int64), rng, budget)
        best = min(best, instance.objective(cover))
        if instance.objective(cover) <= (1.0 + IMPROVEMENT) * best:
            cover = _improve(instance, cover, rng, budget)
        budget.offer(cover, instance.objective(cover))


def _improve(instance: CoverInstance, cover: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """Remove a share of a cover and complete it again, up to `IMPROVEMENT_ITERATIONS` times."""
    for _ in range(IMPROVEMENT_ITERATIONS):
        if not len(cover) or not budget.spend(0):
            break
        n_kept = len(cover) - max(1, int(MAGNITUDE * len(cover)))
        rebuilt = _construct(instance, rng.permutation(cover)[:n_kept], rng, budget)
        if instance.objective(rebuilt) <= instance.objective(cover):
            cover = rebuilt
    return cover


def _construct(instance: CoverInstance, partial: Ints, rng: np.random.Generator, budget: Budget) -> Ints:
    """Complete a partial cover by the randomised greedy rule and remove redundant columns."""
    residual = Residual(instance, partial)
    while residual.missing_units > 0 and instance.allows_more(len(residual.selected)):
        rates = np.maximum(residual.gains, 0.0) / instance.costs
        threshold = rates.max()
        if threshold <= 0:
            break
        if rng.random() >= PRIORITY:
            threshold *= 1.0 - RESTRICTION
        candidates = np.flatnonzero((rates >= threshold) & (residual.gains > 0))
        residual.select(int(candidates[int(rng.random() * len(candidates))]))
    budget.spend(residual.effort)
    return prune(instance, np.array(residual.selected, dtype=np.int64))
