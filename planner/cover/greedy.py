"""Greedy cover: always the column that covers most uncovered area for its cost; and the removal of redundant ones.

Chvatal 1979 (doi:10.1287/moor.4.3.233); with a number of columns allowed it covers at least 1 - 1/e of the most that is
possible (Nemhauser, Wolsey, Fisher 1978, doi:10.1007/BF01588971). A row counts as open until it has what it demands.
Ties go to the first column in canonical order, so the result does not depend on how the candidates were numbered.
"""

import heapq

import numpy as np

from planner.cover.graph import connected, join
from planner.cover.sets import Sets, gather, of_slices
from planner.values import Floats, Ints


class Open:
    """What some columns leave open, and what each other column would still bring.

    Attributes:
        chosen: the columns, in the order in which they came.
        deficit: (S,) load that each row lacks.
        gains: (V,) units of open rows that each column helps (where loads differ, in shares of their demand); -inf for
            the chosen ones.
        missing: units that must still be covered; zero or less means that the target is met.
        work: entries touched.
    """

    def __init__(self, sets: Sets, columns: Ints) -> None:
        self.sets, self.chosen = sets, [int(j) for j in columns]
        self.deficit = np.maximum(sets.demand - sets.loads(columns), 0)
        rows = np.flatnonzero(self.deficit)
        if sets.plain:
            waiting = np.where(self.deficit > 0, sets.units, 0)
            brought = of_slices(np.add, sets.column_start, sets.column_rows, waiting.__getitem__)
            self.gains: Floats = brought.astype(np.float64)
        else:
            self.gains = np.zeros(sets.n_columns)
            self._change(rows, np.zeros(len(rows), dtype=np.int64), self.deficit[rows])
        self.gains[columns] = -np.inf
        self.missing = int(sets.units[rows].sum()) - (0 if sets.most >= 0 else sets.slack)
        self.work = 3 * sets.n_entries

    def _change(self, rows: Ints, before: Ints, after: Ints) -> None:
        """Gains follow deficits that changed."""
        sets = self.sets
        columns, lengths = sets.columns_of(rows)
        if sets.plain:
            change = np.repeat(((after > 0).astype(np.int64) - (before > 0)) * sets.units[rows], lengths)
        else:
            load = gather(sets.row_start, sets.row_load, rows)[0]
            change = np.minimum(load, np.repeat(after, lengths)) - np.minimum(load, np.repeat(before, lengths))
            change = change * np.repeat(sets.units[rows] / sets.demand[rows], lengths)
        # bincount of nothing is of integers
        self.gains += np.bincount(columns, change, sets.n_columns).astype(np.float64, copy=False)

    def take(self, column: int) -> None:
        """Choose a column."""
        sets, rows = self.sets, self.sets.rows_of(column)
        before = self.deficit[rows]
        after = np.maximum(before - sets.load_of(column), 0)
        self.deficit[rows] = after
        moved = (before > 0) & ((after == 0) | (not sets.plain))
        self._change(rows[moved], before[moved], after[moved])
        self.missing -= int(sets.units[rows[(before > 0) & (after == 0)]].sum())
        self.gains[column] = -np.inf
        self.chosen.append(column)
        self.work += int(moved.sum()) * (sets.n_entries // max(sets.n_rows, 1)) * 5 + 2 * sets.n_columns + 25_000


def complete(sets: Sets, columns: Ints) -> Ints:
    """Add columns greedily until the target is met, or as many are chosen as are allowed; in a graph, join them."""
    return _completed(sets, columns)[0]


def _completed(sets: Sets, columns: Ints) -> tuple[Ints, int]:
    still = Open(sets, columns)
    unit_cost = sets.unit_cost
    price = sets.costs.astype(np.float64)
    opening = sets.group_costs.astype(np.float64)
    opening[sets.group[still.chosen]] = 0.0
    while still.missing > 0 and (sets.most < 0 or len(still.chosen) < sets.most):
        best = int(np.argmax(still.gains if unit_cost else still.gains / (price + opening[sets.group])))
        if still.gains[best] <= 0:
            break
        still.take(best)
        opening[sets.group[best]] = 0.0
    chosen = np.array(still.chosen, dtype=np.int64)
    return (join(sets.adjacent, chosen) if len(sets.adjacent) else chosen), still.work


def greedy(sets: Sets) -> tuple[Ints, int]:
    """The greedy cover without redundant columns, and the work that it took."""
    chosen, work = _completed(sets, sets.fixed)
    return prune(sets, chosen), work


def prune(sets: Sets, columns: Ints) -> Ints:
    """Remove columns that neither target nor graph needs, the dearest first, of equal cost the last first."""
    columns = np.asarray(columns, dtype=np.int64)
    loads = sets.loads(columns)
    allowed = 0 if sets.most >= 0 else sets.slack - int(sets.units[loads < sets.demand].sum())
    kept = columns[np.lexsort((np.arange(len(columns)), sets.costs[columns]))].tolist()
    again = True
    while again:
        again = False
        for column in kept[::-1]:
            rows = sets.rows_of(column)
            less = loads[rows] - sets.load_of(column)
            lost = int(sets.units[rows[(loads[rows] >= sets.demand[rows]) & (less < sets.demand[rows])]].sum())
            if lost > allowed or column in sets.fixed:
                continue
            if len(sets.adjacent):
                rest = np.array([j for j in kept if j != column], dtype=np.int64)
                if not connected(sets.adjacent, rest):
                    continue
                again = True  # in a graph a column may be free to go once another has gone
            kept.remove(column)
            loads[rows] = less
            allowed -= lost
    stays = np.zeros(sets.n_columns, dtype=bool)
    stays[kept] = True
    return columns[stays[columns]]


def by_marginal_area(sets: Sets, columns: Ints) -> tuple[Ints, list[Ints]]:
    """Order columns by what each adds, largest first, and list the rows whose demand each is the first to satisfy.

    Returns:
        The columns in that order, and for each the rows it completes.
    """
    deficit = sets.demand.copy()
    rows = {j: sets.rows_of(j) for j in columns.tolist()}

    def gain(column: int) -> int:
        own = rows[column]
        return int(sets.units[own[deficit[own] > 0]].sum())

    # Gains only fall, so a gain that is on top and still true is the largest; canonical order decides ties.
    waiting = [(-gain(column), column) for column in rows]
    heapq.heapify(waiting)
    order: list[int] = []
    added: list[Ints] = []
    while waiting:
        known, best = waiting[0]
        if (now := -gain(best)) != known:
            heapq.heapreplace(waiting, (now, best))
            continue
        heapq.heappop(waiting)
        own = rows[best]
        waited = deficit[own] > 0
        deficit[own] -= sets.load_of(best)
        order.append(best)
        added.append(own[waited & (deficit[own] <= 0)])
    return np.array(order, dtype=np.int64), added
