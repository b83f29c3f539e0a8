"""A textbook row-weighting local search for set cover, without other parts: a rival of the planner.

One column leaves, others enter random uncovered rows while the cover stays cheaper than the best, and rows that stay
uncovered gain weight (RWLS: Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.04.026; scores are divided by costs as in
Gao, Zhang, Fan, Wang 2014). It has no reduction, bound, sampling or restart. Flags of configuration checking are set
when a row becomes covered or uncovered, at no further cost.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_STEPS = 500  # steps between checks of the clock
_OPEN, _INSIDE, _COST, _TIME, _TABU = range(
    5
)  # indices of `numbers`: uncovered rows, selected columns, their cost, flips, last in

_Ints = NDArray[np.int64]


def row_weighting_search(
    M: Any, costs: _Ints, seed: int, seconds: float, clock: Callable[[], float]
) -> Iterator[tuple[float, int, _Ints]]:
    """Yield ever better covers until the time is spent.

    Args:
        M: (m, n) csr_array of bool, each row covered by some column.
        costs: (n,) cost of each column, above zero.
        seed: seed of the draws.
        seconds: time limit.
        clock: processor seconds, for example.

    Yields:
        Seconds since the start, the cost, and the columns of each cover that is the cheapest so far.
    """
    begin, (m, n) = clock(), M.shape
    by_column = M.tocsc()
    by_column.sort_indices()
    matrix = tuple(a.astype(np.int64) for a in (M.indptr, M.indices, by_column.indptr, by_column.indices))
    score = np.diff(matrix[2])
    rows = np.zeros(m, np.int64), np.ones(m, np.int64), np.arange(m), np.arange(m)
    columns = np.zeros(n, bool), np.ones(n, bool), score, np.zeros(n, np.int64), np.arange(n), np.arange(n)
    numbers = np.array([m, 0, 0, 0, -1])
    rng = np.random.default_rng(seed)
    _greedy(*matrix, costs, rows, columns, numbers)
    best = int(costs.sum()) + 1
    while True:
        if _improve(*matrix, costs, rows, columns, numbers, best, _STEPS, rng):
            best = int(numbers[_COST])
            yield clock() - begin, best, np.flatnonzero(columns[0])
        if clock() - begin >= seconds:
            return


@njit(cache=True)
def _greedy(r_start: Any, r_cols: Any, c_start: Any, c_rows: Any, costs: Any, rows: Any, columns: Any, n: Any) -> None:
    """Always select the column with the largest gain for its cost."""
    everything = np.arange(len(costs))
    while n[_OPEN] > 0:
        j = _pick(everything, False, -1, costs.sum() + 1, costs, columns)
        _flip(j, r_start, r_cols, c_start, c_rows, costs, rows, columns, n)


@njit(cache=True)
def _improve(
    r_start: Any, r_cols: Any, c_start: Any, c_rows: Any, costs: Any, rows: Any, columns: Any, n: Any, best: int,
    steps: int, rng: Any,
) -> bool:  # fmt: skip
    """Run steps until a cover is cheaper than the best, or their number is reached; return whether one is."""
    _, weight, open_rows, _ = rows
    score, inside = columns[2], columns[4]
    for _ in range(steps):
        if n[_OPEN] == 0 and n[_COST] < best:
            return True
        while n[_OPEN] == 0:
            j = _pick(inside[: n[_INSIDE]], True, -1, best, costs, columns)
            _flip(j, r_start, r_cols, c_start, c_rows, costs, rows, columns, n)
        j = _pick(inside[: n[_INSIDE]], True, n[_TABU], best, costs, columns)
        if j >= 0:
            _flip(j, r_start, r_cols, c_start, c_rows, costs, rows, columns, n)
        while n[_OPEN] > 0:
            row = open_rows[rng.integers(0, n[_OPEN])]
            if r_start[row + 1] == r_start[row] + 1:
                columns[1][r_cols[r_start[row]]] = True  # its only column must come back
            j = _pick(r_cols[r_start[row] : r_start[row + 1]], False, -1, best - n[_COST], costs, columns)
            if j < 0:
                break
            _flip(j, r_start, r_cols, c_start, c_rows, costs, rows, columns, n)
            n[_TABU] = j
            for i in open_rows[: n[_OPEN]]:
                weight[i] += 1
                for q in range(r_start[i], r_start[i + 1]):
                    score[r_cols[q]] += 1
    return False


@njit(cache=True)
def _pick(among: Any, is_selected: bool, tabu: int, below: int, costs: Any, columns: Any) -> int:
    """Return the allowed column, in or out, below a cost, with the largest score for its cost; or -1."""
    is_chosen, allowed, score, age, _, _ = columns
    best = -1
    for j in among:
        if is_chosen[j] != is_selected or j == tabu or not (is_selected or (allowed[j] and costs[j] < below)):
            continue
        more = 1 if best < 0 else score[j] * costs[best] - score[best] * costs[j]
        if more > 0 or (more == 0 and age[j] < age[best]):
            best = j
    return best


@njit(cache=True)
def _flip(
    j: int, r_start: Any, r_cols: Any, c_start: Any, c_rows: Any, costs: Any, rows: Any, columns: Any, n: Any
) -> None:
    """Select or remove a column and update the scores."""
    covered, weight, open_rows, open_place = rows
    is_chosen, allowed, score, age, inside, inside_place = columns
    sign = -1 if is_chosen[j] else 1
    is_chosen[j], allowed[j], score[j] = sign > 0, False, -score[j]
    n[_COST], n[_TIME] = n[_COST] + sign * costs[j], n[_TIME] + 1
    age[j], n[_INSIDE] = n[_TIME], _move(inside, inside_place, j, n[_INSIDE], sign)
    for i in c_rows[c_start[j] : c_start[j + 1]]:
        covered[i] += sign
        if covered[i] == (sign > 0):  # between uncovered and covered: the gain of every other column changes
            n[_OPEN] = _move(open_rows, open_place, i, n[_OPEN], -sign)
            for q in range(r_start[i], r_start[i + 1]):
                if r_cols[q] != j:
                    score[r_cols[q]] -= sign * weight[i]
                    allowed[r_cols[q]] = True
        elif covered[i] == 1 + (sign > 0):  # one other column covers it alone, until now or from now on
            for q in range(r_start[i], r_start[i + 1]):
                if is_chosen[r_cols[q]] and r_cols[q] != j:
                    score[r_cols[q]] += sign * weight[i]
                    break


@njit(cache=True)
def _move(items: Any, place: Any, item: int, count: int, sign: int) -> int:
    """Add or remove an item of the set of the first `count` items by a swap; return the new count."""
    at = count if sign > 0 else count - 1
    other = items[at]
    items[place[item]], place[other] = other, place[item]
    items[at], place[item] = item, at
    return count + sign
