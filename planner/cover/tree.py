"""Branch and bound: a better selection than the incumbent, or the proof that there is none.

**Numbers of columns.** Without costs, and if one column satisfies each row, the question is always the same: can k
columns leave at most the allowed units uncovered? A full cover allows none, an area target allows its slack, and
maximum coverage asks for less than the incumbent leaves. k columns leave uncovered at least

    sum_i u_i - the k largest of sum_i a_ij u_i       for u_i >= 0, and u_i <= units_i if row i may stay uncovered

(`planner.cover.bounds`). At each node a few subgradient steps move u from its value at the parent node (Polyak's length
towards the allowed units; Held, Wolfe, Crowder 1974, doi:10.1007/BF01580223): a step costs one pass over the entries of
the node, a linear programme costs a thousand. Columns with which the bound would exceed the allowed units are removed.
Then the column with the largest sum, of the row that must be covered and has the fewest columns (else of all), is fixed
in, and out.

The tree contains only the rows that matter, those with a multiplier. This is a relaxation, so a negative answer is a
proof; a selection that fails on other rows adds the rows that it leaves uncovered. On few rows most columns are
dominated by others, so the problem is reduced before.

**Costs, loads and larger demands.** A node fixes columns in and out. The linear programme of `planner.cover.bounds`
continues from the parent node by the dual simplex, row by row; its multipliers bound the node (evaluated in our own
arithmetic). Columns that by reduced cost are in no selection as good as required are fixed out below the node. Then the
column nearest to one half is fixed in, and out (Land, Doig 1960). Depth first, since few columns change from node to
node. If incumbent and bound are far apart, the required objective is half-way: its tree is much smaller, and either
result helps.

No proof rests on the tolerance of a solver, and each call of HiGHS ends after a number of iterations that the budget
pays for.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.cover.bounds import MIN_ROWS, MORE_ROWS, LinearModel, Relaxation
from planner.cover.budget import Budget
from planner.cover.problem import CoverInstance
from planner.cover.reductions import reduce
from planner.cover.search import complete, prune
from planner.values import Bools, Ints

INTEGRAL = 1e-6
"""Distance from 0 or 1 below which a column is not branched on while there are others."""

NEAR = 0.1
"""Gap of incumbent and bound, as a share of the cost, from which the tree asks for the smallest improvement."""

CHUNK_EFFORT = 5_000_000
"""Effort between two checks of Ctrl-C and the budget: about 10 ms."""

TOUCH_EFFORT = 0.4
"""Charge of a unit counted by a tree: a sum in the near CPU cache."""


def close_gap(relaxation: Relaxation, budget: Budget) -> None:
    """Search for better selections, or prove that there are none, as far as the budget allows.

    Args:
        relaxation: bound whose penalties exclude columns, and whose multipliers name the rows that matter.
        budget: charged; holds the incumbent, receives better selections and bounds.
    """
    instance = relaxation.instance
    while budget.spend(0):
        target = _target_objective(relaxation, budget)
        useful = relaxation.useful_columns(target)
        core = np.flatnonzero(useful)
        if target < 0 or not len(core) or not (instance.maximises_area or instance.is_feasible(core)):
            budget.raise_lower_bound(target + 1)
            continue
        if counts_columns(instance):
            rows = (relaxation.multipliers > 0) | instance.maximises_area
            selection, is_complete = search_by_number(instance, rows, useful, target, budget)
        else:
            budget.spend(12 * instance.n_entries)
            inside = Relaxation(instance.restricted(columns=useful))
            model = LinearModel(inside, _decisive_rows(relaxation))
            selection, is_complete = _search_by_programme(inside, model, target, budget)
            selection = None if selection is None else core[selection]
        if selection is not None:
            budget.offer(selection, instance.objective(selection))
        elif is_complete:
            # Columns outside the core are no better; the tree may have found better areas than it began with.
            budget.raise_lower_bound(_target_objective(relaxation, budget) + 1)
        else:
            break


def _target_objective(relaxation: Relaxation, budget: Budget) -> int:
    """Return the required objective: the lower bound on columns, the next better area, or a cost half-way."""
    best = budget.objective - budget.tolerance
    if relaxation.instance.maximises_area:
        return best - 1
    if counts_columns(relaxation.instance):
        return budget.lower_bound
    gap = best - budget.lower_bound
    is_near = gap <= NEAR * budget.objective and not relaxation.instance.has_unit_costs
    return best - (1 if is_near else (gap + 2) // 2)


def counts_columns(instance: CoverInstance) -> bool:
    """Return whether the cost is the number of columns, and one column satisfies each row."""
    return instance.has_unit_costs and instance.has_unit_loads and instance.has_unit_demand


def _decisive_rows(relaxation: Relaxation) -> Ints:
    """Return the rows with a multiplier, and some rows of fewest columns."""
    rows = relaxation.row_of[relaxation.multipliers > 1e-9 * relaxation.multipliers.max()]
    shortest = np.argsort(np.diff(relaxation.instance.row_start), kind="stable")[:MIN_ROWS]
    return np.union1d(rows, shortest)


def _search_by_programme(
    relaxation: Relaxation, model: LinearModel, target: int, budget: Budget
) -> tuple[Ints | None, bool]:
    """Return a selection whose objective is at most the target, or None; and whether certainly none exists."""
    instance = relaxation.instance
    waiting = [relaxation.fixing]
    while waiting:
        fixing = waiting.pop()
        if not relaxation.may_be_feasible(fixing):
            continue
        relaxation.fix(fixing)
        model.fix(fixing)
        x = _solve_node(relaxation, model, target, budget)
        if relaxation.excludes(target):
            continue
        if x is None:
            return None, False
        free = fixing == 0
        fractionality = np.where(free, np.abs(x - np.rint(x)), -1.0)
        if fractionality.max() <= INTEGRAL:
            rounded = prune(instance, complete(instance, np.flatnonzero(x > 0.5)))
            if instance.objective(rounded) <= target:
                return rounded, False
            if not free.any():
                continue
            fractionality = np.where(free, x, -1.0)  # rows may be partly uncovered though columns are integral
        fixing = np.where(free & ~relaxation.useful_columns(target), np.int8(-1), fixing)
        column = int(fractionality.argmax())
        for value in (-1, 1):
            child = fixing.copy()
            child[column] = value
            waiting.append(child)
    return None, True


def _solve_node(relaxation: Relaxation, model: LinearModel, target: int, budget: Budget) -> NDArray[np.float64] | None:
    """Return the solution with all rows; None if the bound excludes the target before, or the programme fails."""
    while not relaxation.excludes(target) and budget.spend(0):
        model.run(budget)
        relaxation.evaluate(model.multipliers())
        if model.is_optimal:
            x, uncovered = model.solution()
            if not model.add_violated(x, uncovered):
                return x
        elif not model.reached_iteration_limit:
            break
    return None


def search_by_number(
    instance: CoverInstance, rows: Bools, columns: Bools, target: int, budget: Budget
) -> tuple[Ints | None, bool]:
    """Return a selection whose objective is at most the target, or None; and whether certainly none exists.

    For maximum coverage better selections go to the budget, and the tree continues for still better ones.

    Args:
        instance: the problem.
        rows: (S,) rows to begin with.
        columns: (V,) columns that the selection may contain.
        target: required objective.
        budget: charged.
    """
    size, allowed = (target, instance.slack) if instance.max_columns is None else (instance.max_columns, target)
    rows, names = rows.copy(), np.flatnonzero(columns)
    while budget.spend(12 * instance.n_entries):
        question = _Question(instance, rows, columns, size, allowed, budget)
        while (answer := question.answer(budget)) is not None:
            selection = names[answer]
            better = prune(instance, complete(instance, selection))
            if instance.objective(better) > target:
                break
            if not instance.maximises_area or not budget.offer(better, instance.objective(better)):
                return better, False
            target = allowed = budget.objective - budget.tolerance - 1
            question.set_allowed(allowed)
        if answer is None:
            return None, question.is_complete
        new = np.flatnonzero(~instance.satisfied(selection) & ~rows)
        priority = np.diff(instance.row_start)[new] if instance.full else -instance.units[new]
        count = max(MIN_ROWS, int(MORE_ROWS * rows.sum()))
        rows[new[np.argsort(priority, kind="stable")[:count]]] = True
    return None, False


class _Question:
    """Whether a number of columns leaves at most the allowed units of some rows uncovered; a tree answers it.

    Attributes:
        is_complete: whether there is no selection, or no other one.
    """

    def __init__(
        self, instance: CoverInstance, rows: Bools, columns: Bools, size: int, allowed: int, budget: Budget
    ) -> None:
        units = np.ones_like(instance.units) if instance.full else instance.units  # a full cover ignores areas
        reached = instance.satisfied(np.flatnonzero(columns))
        self._unreachable = int(units[rows & ~reached].sum())  # uncovered by any selection
        rows = rows & reached
        required = int(units[rows].sum()) + self._unreachable - allowed
        inside = instance.restricted(rows, columns, units=units, required=required)
        self._reduction = reduce(inside, budget)
        left = size - len(self._reduction.forced)
        self.is_complete = left < 0 or allowed < self._unreachable
        self._tree = _root(self._reduction.instance, max(left, 0))
        self.set_allowed(allowed)

    def set_allowed(self, allowed: int) -> None:
        """Set the units that may stay uncovered from now on; not more than before."""
        self._tree.numbers[ALLOWED] = allowed - self._unreachable

    def answer(self, budget: Budget) -> Ints | None:
        """Return the next selection that is good enough; None if there is none, or no effort remains."""
        while not self.is_complete and budget.spend(0):
            tree = self._tree
            result = grow(tree, int(min(CHUNK_EFFORT, budget.remaining) / TOUCH_EFFORT))
            budget.spend(int(tree.numbers[EFFORT] * TOUCH_EFFORT))
            if result == FOUND:
                level, n_top = tree.numbers[[LEVEL, N_SELECTED]]
                largest = tree.columns[ID, tree.levels[FIRST_COLUMN, level] + tree.top[:n_top]]
                return self._reduction.lift(np.concatenate((tree.levels[FIXED_COLUMN, :level], largest)))
            if result == FULL:
                rows, columns, entries = (
                    np.concatenate((a, np.zeros_like(a)), axis=-1) for a in (tree.rows, tree.columns, tree.entries)
                )
                self._tree = tree._replace(rows=rows, columns=columns, entries=entries)
            self.is_complete = result == NONE
        return None


# Compiled loops of the tree over numbers of columns.
#
# A node holds the rows that its fixed columns leave uncovered, the free columns with their rows, and the number of
# columns that may still be added. Its child is written behind it into the same arrays, so that the cost of a node falls
# with its content. One pass over its entries is a step: the columns' sums of multipliers, the largest of them, the
# bound, the columns that it excludes, the rows that the largest leave uncovered, and a move of the multipliers.

MARGIN = 1e-9
"""Share of the sums by which a bound must exceed the allowed units: far above the float error of the sums."""

ROOT_STEPS, FIRST_STEPS, STEPS = 200, 30, 8
"""Steps of the multipliers at the root, in a new node, and after a column was fixed out of it."""

DEFLECTION, SHRINK, MIN_LENGTH, PROGRESS, OVERSHOOT = 0.5, 0.7, 0.1, 1e-4, 0.01
"""Share of the previous direction in the next (with 0.3 trees are twice as large, with 0.8 ten times). Factor of the
step length if the bound did not grow by the share `PROGRESS` of the gap; steps end below the third. Distance beyond the
allowed units at which a step aims, as a share of the mean sum of a selected column."""

COLUMN_EFFORT, ROW_EFFORT, STEP_EFFORT = 8, 6, 50
"""Charge of each column and row in a step, and of the step; an entry is 1."""

GOES_ON, NONE, FOUND, FULL = range(4)
"""Results of `grow`: effort is spent; no selection leaves at most the allowed units; one does; arrays are full."""

LEVEL, EFFORT, ALLOWED, N_SELECTED = range(4)
"""Numbers of a tree: level of the node (-1 at the end); effort; units that may stay uncovered; number of columns of
`Tree.top` in the selection that was found, in addition to the fixed ones."""

ROWS, COLUMNS, LEFT, FIRST_ROW, FIRST_COLUMN, FIRST_ENTRY, VISITS, FIXED_COLUMN = range(8)
"""Fields of a level: numbers of rows and columns of its node; columns that may still be added; begin of rows, columns
and entries in their arrays; number of visits; column that its child fixes in."""

UNITS, MULTIPLIER = range(2)
"""Fields of a row: units; u."""

ID, BEGIN, END = range(3)
"""Fields of a column: number at the root; begin and end of its entries."""

FIRST: Any = np.int64(0)  # typed, since numba would compile a kernel anew for a literal


class Tree(NamedTuple):
    """Arrays of a tree, kept from one call to the next."""

    numbers: Any  # (4,)
    levels: Any  # (fields, levels)
    rows: Any  # (2, R) float64
    columns: Any  # (3, C)
    entries: Any  # (E,) row of the node, from 0
    value: Any  # (columns of the root,) float64: sum of the multipliers
    direction: Any  # (rows of the root,) float64
    count: Any  # (rows of the root,)
    top: Any  # (columns that may be added,) columns of the node with the largest sums, largest first


def _root(instance: CoverInstance, left: int) -> Tree:
    """Return the root: all rows are uncovered; a row's multiplier is its units, which is optimal for one column."""
    levels = np.zeros((FIXED_COLUMN + 1, left + 2), dtype=np.int64)
    levels[[ROWS, COLUMNS, LEFT], 0] = instance.n_rows, instance.n_columns, left
    levels[[FIRST_ROW, FIRST_COLUMN, FIRST_ENTRY], 1] = instance.n_rows, instance.n_columns, instance.n_entries
    begin, end = instance.column_start[:-1], instance.column_start[1:]
    return Tree(
        numbers=np.zeros(4, dtype=np.int64),
        levels=levels,
        rows=np.stack((instance.units, instance.units)).astype(np.float64),
        columns=np.stack((np.arange(instance.n_columns), begin, end)).astype(np.int64),
        entries=instance.column_rows.astype(np.uint32),
        value=np.zeros(instance.n_columns),
        direction=np.zeros(instance.n_rows),
        count=np.zeros(instance.n_rows, dtype=np.int64),
        top=np.zeros(left + 1, dtype=np.int64),
    )


@compiled
def sum_columns(t: Tree, level: int) -> int:
    """Compute the columns' sums of multipliers and the list of the largest; return its length."""
    levels, columns, entries, value, top = t.levels, t.columns, t.entries, t.value, t.top
    r0, c0 = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level]
    u = t.rows[MULTIPLIER, r0 : r0 + levels[ROWS, level]]
    n, n_top, touched = levels[COLUMNS, level], 0, 0
    most = min(levels[LEFT, level], n)
    for c in range(n):
        begin, end, total = columns[BEGIN, c0 + c], columns[END, c0 + c], 0.0
        for row in entries[begin:end]:
            total += u[row]
        touched += end - begin
        value[c] = total
        if n_top == most and total <= value[top[n_top - 1]]:
            continue
        at = n_top if n_top < most else n_top - 1
        n_top = at + 1
        touched += at
        while at > 0 and value[top[at - 1]] < total:
            top[at] = top[at - 1]
            at -= 1
        top[at] = c
        touched -= at
    t.numbers[EFFORT] += touched + COLUMN_EFFORT * n + ROW_EFFORT * levels[ROWS, level] + STEP_EFFORT
    return n_top


@compiled
def fix_out(t: Tree, level: int, c: int) -> None:
    """Remove a column from a node: the last one takes its place."""
    a, columns = t.levels[FIRST_COLUMN, level], t.columns
    t.levels[COLUMNS, level] -= 1
    last = t.levels[COLUMNS, level]
    for field in range(3):
        columns[field, a + c], columns[field, a + last] = columns[field, a + last], columns[field, a + c]
    t.value[c] = t.value[last]


@compiled
def bound_node(t: Tree, level: int, steps: int) -> int:
    """Move the multipliers of a node until it is excluded (`NONE`), a selection is found, or the steps are done."""
    levels, columns, entries, count, direction = t.levels, t.columns, t.entries, t.count, t.direction
    units, u, allowed = t.rows[UNITS], t.rows[MULTIPLIER], float(t.numbers[ALLOWED])
    r0, c0 = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level]
    n_rows, left = levels[ROWS, level], levels[LEFT, level]
    best, length = -np.inf, 1.0
    for i in range(n_rows):
        direction[i] = 0.0
        if left == 1:  # then exact
            u[r0 + i] = units[r0 + i]
    for _ in range(steps):
        n_top = sum_columns(t, level)
        total, n = 0.0, levels[COLUMNS, level]
        for i in range(n_rows):
            total += u[r0 + i]
            count[i] = 0
        bound = total
        for k in range(n_top):
            c = t.top[k]
            bound -= t.value[c]
            for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
                count[entries[e]] += 1
        margin = MARGIN * (total + allowed)
        if bound > allowed + margin:
            return NONE
        uncovered = 0.0
        for i in range(n_rows):
            if count[i] == 0:
                uncovered += units[r0 + i]
        if uncovered <= allowed:
            t.numbers[N_SELECTED] = n_top
            return FOUND
        if left == 1 or n <= left:
            return NONE
        least = bound + t.value[t.top[n_top - 1]] - allowed - margin
        c = FIRST
        while c < levels[COLUMNS, level]:
            if t.value[c] < least:
                fix_out(t, level, c)
            else:
                c += 1
        if bound > best + PROGRESS * abs(allowed - bound):
            best = bound
        else:
            length *= SHRINK
            if length < MIN_LENGTH:
                break
        norm = 0.0
        for i in range(n_rows):
            d = (1.0 - DEFLECTION) * (1.0 - count[i]) + DEFLECTION * direction[i]
            direction[i] = d
            at, unit = u[r0 + i], units[r0 + i]
            if not ((at <= 0.0 and d < 0.0) or (at >= unit and unit <= allowed and d > 0.0)):
                norm += d * d * unit * unit
        if norm == 0.0:
            break
        step = length * (allowed + OVERSHOOT * total / left - bound) / norm
        for i in range(n_rows):
            unit = units[r0 + i]
            to = max(u[r0 + i] + step * direction[i] * unit * unit, 0.0)
            u[r0 + i] = min(to, unit) if unit <= allowed else to
    return GOES_ON


@compiled
def branching_column(t: Tree, level: int) -> int:
    """Return the column of largest sum, of the row that must be covered and has the fewest columns.

    If all rows may stay uncovered, it is the one of largest sum; -1 if such a row has no column. The sums are computed
    again: with those before the last move, trees on measurability matrices are twice as large.
    """
    levels, columns, entries, count, value = t.levels, t.columns, t.entries, t.count, t.value
    r0, c0, n = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level], levels[COLUMNS, level]
    units, u = t.rows[UNITS], t.rows[MULTIPLIER]
    row = -1
    for i in range(levels[ROWS, level]):
        count[i] = 0
    for c in range(n):
        for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
            count[entries[e]] += 1
    for i in range(levels[ROWS, level]):
        if units[r0 + i] > t.numbers[ALLOWED] and (
            row < 0 or count[i] < count[row] or (count[i] == count[row] and u[r0 + i] > u[r0 + row])
        ):
            row = i
    if row >= 0 and count[row] == 0:
        return -1
    sum_columns(t, level)
    best = -1
    for c in range(n):
        if best >= 0 and value[c] <= value[best]:
            continue
        inside = row < 0
        for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
            inside = inside or entries[e] == row
        if inside:
            best = c
    return best


@compiled
def descend(t: Tree, level: int, c: int) -> bool:
    """Write the child in which a column is fixed in, and fix it out of its parent; return False without space."""
    levels, columns, entries, place = t.levels, t.columns, t.entries, t.count
    r0, c0, n_rows = levels[FIRST_ROW, level], levels[FIRST_COLUMN, level], levels[ROWS, level]
    r1, c1, e1 = levels[FIRST_ROW, level + 1], levels[FIRST_COLUMN, level + 1], levels[FIRST_ENTRY, level + 1]
    size = 0
    for q in range(levels[COLUMNS, level]):
        size += columns[END, c0 + q] - columns[BEGIN, c0 + q]
    room = min(t.rows.shape[1] - r1 - n_rows, columns.shape[1] - c1 - levels[COLUMNS, level], len(entries) - e1 - size)
    if room < 0:
        return False
    levels[FIXED_COLUMN, level] = columns[ID, c0 + c]
    for i in range(n_rows):
        place[i] = 0
    for e in range(columns[BEGIN, c0 + c], columns[END, c0 + c]):
        place[entries[e]] = -1
    n_new = 0
    for i in range(n_rows):
        if place[i] == 0:
            place[i] = n_new
            for field in range(2):
                t.rows[field, r1 + n_new] = t.rows[field, r0 + i]
            n_new += 1
    fix_out(t, level, c)
    n, at = 0, e1
    for q in range(c0, c0 + levels[COLUMNS, level]):
        begin = at
        for e in range(columns[BEGIN, q], columns[END, q]):
            row = place[entries[e]]
            if row >= 0:
                entries[at] = row
                at += 1
        if at > begin:
            columns[ID, c1 + n], columns[BEGIN, c1 + n], columns[END, c1 + n] = columns[ID, q], begin, at
            n += 1
    t.numbers[EFFORT] += 2 * size
    levels[ROWS, level + 1], levels[COLUMNS, level + 1] = n_new, n
    levels[LEFT, level + 1], levels[VISITS, level + 1] = levels[LEFT, level] - 1, 0
    below = level + 2
    levels[FIRST_ROW, below], levels[FIRST_COLUMN, below], levels[FIRST_ENTRY, below] = r1 + n_new, c1 + n, at
    return True


@compiled
def grow(t: Tree, effort_limit: int) -> int:
    """Continue a tree, depth first, until the effort is spent or it ends."""
    numbers, levels = t.numbers, t.levels
    numbers[EFFORT] = 0
    while numbers[LEVEL] >= 0:
        if numbers[EFFORT] > effort_limit:
            return GOES_ON
        level = numbers[LEVEL]
        uncovered, r0 = 0.0, levels[FIRST_ROW, level]
        for i in range(levels[ROWS, level]):
            uncovered += t.rows[UNITS, r0 + i]
        if uncovered <= float(numbers[ALLOWED]):
            numbers[N_SELECTED] = 0
            return FOUND
        result, c = NONE, -1
        if levels[LEFT, level] > 0 and levels[COLUMNS, level] > 0:
            visits = levels[VISITS, level]
            result = bound_node(t, level, STEPS if visits else FIRST_STEPS if level else ROOT_STEPS)
        if result == FOUND:
            return FOUND
        if result == GOES_ON and levels[COLUMNS, level] > 0:
            c = branching_column(t, level)
        if c < 0:
            numbers[LEVEL] -= 1
            continue
        if not descend(t, level, c):
            return FULL
        levels[VISITS, level] = 1
        numbers[LEVEL] += 1
    return NONE
