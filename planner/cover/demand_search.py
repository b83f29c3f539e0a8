"""Fewest columns that satisfy demands, in a graph that holds together where one is given: greedy, then local search.

Row weighting as in `planner.cover.local_search` (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038), with deficits in
place of uncovered rows; a graph in several parts counts as one more deficit, whose weight grows while it lasts. So
columns are exchanged for the sake of both, not only added.
"""

import numpy as np
from numpy.typing import NDArray

from planner.cover.budget import Budget
from planner.cover.demands import DemandProblem
from planner.cover.interrupts import ends_search
from planner.values import Ints

AREA_WEIGHT = 1000
"""Where part of the rows may stay open: initial weight of a row of mean area."""

FORGET_ABOVE = 3
"""There, when the weights sum to this multiple of their start, their growth is scaled by 0.3: rows best left out would
come to dominate (as in `planner.cover.local_search`)."""

LARGEST_WEIGHT = 2**40
"""Weights times demands stay below 2^62 with this; they are drawn back towards their start when they come near."""

Graph = NDArray[np.uint8]
"""(V, V) 1 where two columns are joined; (0, 0) where nothing has to hold together."""

NO_GRAPH: Graph = np.zeros((0, 0), dtype=np.uint8)

_BLOCK, _CHUNK = 512, 20_000_000  # steps, and entries touched, between two looks at the clock


def parts_of(adjacent: Graph, columns: Ints) -> Ints:
    """(n,) number of the part of the graph that each column belongs to; parts are numbered by their first column."""
    from scipy.sparse.csgraph import connected_components

    if not len(columns):
        return np.zeros(0, dtype=np.int64)
    _, labels = connected_components(adjacent[np.ix_(columns, columns)], directed=False)
    return np.asarray(labels, dtype=np.int64)


def connected(adjacent: Graph, columns: Ints) -> bool:
    """Whether the graph of columns holds together; that of none and of one does."""
    return len(adjacent) == 0 or len(columns) < 2 or int(parts_of(adjacent, columns).max()) == 0


def greedy(problem: DemandProblem, start: Ints) -> Ints:
    """Add the column that takes away the largest deficit (in shares of demands, by area) until the target is met.

    Raises:
        AssertionError: if all columns together do not meet it; the caller looks first.
    """
    chosen = [int(j) for j in start]
    shares, units = problem.matrix().tocsc(), problem.units.astype(np.float64)
    load = problem.loads(np.array(chosen, dtype=np.int64))
    rows_of_entry = shares.indices
    while not problem.met(np.array(chosen, dtype=np.int64)):
        deficit = np.maximum(problem.demand - load, 0) / problem.demand
        useful = units[rows_of_entry] * np.minimum(shares.data, deficit[rows_of_entry])
        gains = np.add.reduceat(np.append(useful, 0.0), shares.indptr[:-1])
        gains[np.diff(shares.indptr) == 0] = 0.0
        gains[chosen] = 0.0
        best = int(np.argmax(gains))
        assert gains[best] > 0, "the target is out of reach of all columns together"
        at = slice(problem.column_start[best], problem.column_start[best + 1])
        load[problem.column_rows[at]] += problem.column_load[at]
        chosen.append(best)
    return np.array(chosen, dtype=np.int64)


def join(adjacent: Graph, columns: Ints) -> Ints:
    """Columns and those on shortest ways between their parts, until the graph holds together.

    The largest part grows towards the nearest other one (Takahashi, Matsuyama 1980, for Steiner trees).

    Raises:
        AssertionError: if no way exists; the caller looks first.
    """
    chosen = list(dict.fromkeys(columns.tolist()))
    while not connected(adjacent, np.array(chosen)):
        members = np.array(chosen, dtype=np.int64)
        labels = parts_of(adjacent, members)
        home = members[labels == int(np.bincount(labels).argmax())]
        goal = np.zeros(len(adjacent), dtype=bool)
        goal[np.setdiff1d(members, home)] = True
        before = np.full(len(adjacent), -2, dtype=np.int64)
        before[home] = -1
        front, found = home, -1
        while found < 0:
            assert len(front), "the parts cannot be joined"
            reached = (adjacent[front] == 1) & (before == -2)[None, :]
            fresh = np.flatnonzero(reached.any(axis=0))
            before[fresh] = front[reached[:, fresh].argmax(axis=0)]
            hits = fresh[goal[fresh]]
            found = int(hits[0]) if len(hits) else -1
            front = fresh
        while before[found] >= 0:
            found = int(before[found])
            if found not in chosen:
                chosen.append(found)
    return np.array(chosen, dtype=np.int64)


def prune(problem: DemandProblem, columns: Ints, adjacent: Graph, fixed: Ints) -> Ints:
    """Remove columns that neither demands nor the graph need, last first, until none can go."""
    kept = list(dict.fromkeys(columns.tolist()))
    again = True
    while again:
        again = False
        for column in reversed(kept.copy()):
            rest = np.array([j for j in kept if j != column], dtype=np.int64)
            if column not in fixed and problem.met(rest) and connected(adjacent, rest):
                kept.remove(column)
                again = len(adjacent) > 0  # in a graph a column may be free to go once another has gone
    return np.array(kept, dtype=np.int64)


def improve(
    problem: DemandProblem,
    start: Ints,
    rng: np.random.Generator,
    budget: Budget,
    *,
    adjacent: Graph = NO_GRAPH,
    fixed: Ints | None = None,
    enough: int = 0,
) -> Ints:
    """Look for fewer columns than the start has, while work is left.

    Args:
        problem: what is demanded.
        start: columns that meet it and hold together.
        rng: draws.
        budget: work and clock; its own incumbent is not used.
        adjacent: the graph that must hold together.
        fixed: columns that must stay.
        enough: the search ends at this number of columns (a lower bound).
    """
    from planner.cover import demand_kernels  # importing numba costs 0.3 s

    pinned = np.zeros(problem.n_columns, dtype=np.uint8)
    pinned[np.zeros(0, dtype=np.int64) if fixed is None else fixed] = 1
    best = prune(problem, start, adjacent, np.flatnonzero(pinned))
    sets = (problem.row_start, problem.row_columns, problem.row_load,
            problem.column_start, problem.column_rows, problem.column_load)  # fmt: skip
    growth = np.ones(problem.n_rows, dtype=np.int64)
    if not problem.full and problem.n_rows:
        growth = np.maximum(np.rint(problem.units * (AREA_WEIGHT / problem.units.mean())), 1).astype(np.int64)
    most = int(problem.demand.max(initial=1))
    with ends_search(budget):
        while len(best) > max(enough, int(pinned.sum()), 1) and budget.spend(0):
            weights, load = growth.copy(), problem.loads(best)
            gains = _gains(problem, weights, load)
            chosen = np.zeros(problem.n_columns + 1, dtype=np.int64)
            chosen[: len(best)] = best
            # One too few: the column with the least loss goes first.
            free = [p for p, j in enumerate(best.tolist()) if not pinned[j]]
            losses = [demand_kernels.loss_of(*sets[3:], problem.demand, weights, load, int(best[p])) for p in free]
            out = free[int(np.argmin(losses))]
            demand_kernels.move(*sets, problem.demand, weights, load, gains, int(best[out]), -1)
            size = len(best) - 1
            chosen[out] = chosen[size]
            stamps = np.zeros(problem.n_columns, dtype=np.int64)
            better = np.zeros(problem.n_columns + 1, dtype=np.int64)
            largest = int(gains.max(initial=1))
            state = np.array([0, max(largest // 4, most), -1], dtype=np.int64)
            found, work = -1, 0
            while found < 0 and budget.spend(work):
                size, found, work = demand_kernels.search(
                    *sets, problem.demand, problem.units, growth, weights, problem.slack, problem.full, adjacent,
                    pinned, chosen, size, load, gains, stamps, better, rng.random(_BLOCK), state,
                    min(max(budget.left, 1), _CHUNK),
                )  # fmt: skip
                tired = not problem.full and int(weights.sum()) > FORGET_ABOVE * int(growth.sum())
                if tired or int(weights.max(initial=0)) > LARGEST_WEIGHT // most or int(state[1]) > 2**50:
                    weights[:] = growth + (weights - growth) * 3 // 10
                    gains[:] = _gains(problem, weights, load)
                    state[1] = min(int(state[1]), max(largest // 4, most))
                if work == 0:
                    return best
            if found >= 0:
                best = prune(problem, better[:found].copy(), adjacent, np.flatnonzero(pinned))
    return best


def _gains(problem: DemandProblem, weights: Ints, load: Ints) -> Ints:
    """(V,) weighted deficit that each column would take away."""
    deficit = np.maximum(problem.demand - load, 0)
    gains = np.zeros(problem.n_columns, dtype=np.int64)
    row = np.repeat(np.arange(problem.n_rows), np.diff(problem.row_start))
    np.add.at(gains, problem.row_columns, weights[row] * np.minimum(problem.row_load, deficit[row]))
    return gains
