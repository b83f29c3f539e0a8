"""Local search: keep a choice that costs too little, swap until the target is met, repeat.

Full cover is RWLS (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038): whenever the target is met the choice is kept
and the column with the smallest loss is removed; otherwise one column leaves (smallest weighted loss, not the one that
came last), one of a randomly drawn open row enters (largest weighted gain, not the one that has just left), ties to the
one that moved longest ago, and every row that is still open gains weight. Of large rows and choices a sample is looked
at (Cai 2015, "best from multiple selections"). With costs, losses and gains count per cost, and columns enter while the
choice stays cheaper than the best one; groups make their first column dearer. A row that demands more counts by its
deficit.

Gains are added up for the columns that are looked at instead of being kept for all: steps are two to ten times cheaper.
Configuration checking goes with the kept scores; without it files came to their best at least as soon.

Where rows may stay open for good, the area itself is the weight, what moved may not move back for some steps (tabu
search; Glover 1989, doi:10.1287/ijoc.1.3.190), and all columns of the row that was drawn are looked at. The same search
finds the most area with a number of columns. Parts of a graph too many count as one more deficit, whose weight grows
while they last.

The loops are in `search_kernels`; they run in chunks, between which the clock, Ctrl-C and the budget are heard. A
search that has found nothing for long goes on with fresh weights.
"""

from typing import TYPE_CHECKING

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import prune
from planner.cover.sets import Sets, packed
from planner.values import Ints

if TYPE_CHECKING:
    from planner.cover.search_kernels import State

FAR_COLUMNS, FAR_ENTRIES, FARTHEST = 60_000, 5_000_000, 1.0
"""With so many columns or entries, which no near cache holds, work costs twice what it costs with few; and the most on
top."""

FAR_BITS, FAR_BITS_CHARGE = 10_000_000, 1.0
"""From so many bytes of bits on (`WIDE`) each look into them misses the caches as well: charged on top of that."""

CHUNK_WORK = 5_000_000
"""Work between two looks at the clock: about 10 ms."""

FRESH_WORK, FAR_BYTE_WORK = 5, 3
"""Charge of each entry when a search begins, and of each byte of so many bits."""

WIDE = 16
"""Where columns have more rows than this on average, a bit for each row says whether they have it."""

AREA_WEIGHTS = 2**40
"""Where rows may stay open their weights sum to this: with loads of 2^16 scores stay below 2^62."""

TENURES = 12
"""Where rows may stay open: longest time that a moved column may not move back, in moves."""

PATIENCE = 60
"""The search starts again after this many chunks without a better choice, and after twice as many the next time."""


class Search:
    """A choice that moves; it keeps its weights between calls."""

    def __init__(self, sets: Sets, columns: Ints, rng: np.random.Generator, names: Ints | None = None) -> None:
        """Begin with a choice that meets what is asked for.

        Args:
            sets: the problem.
            columns: the choice.
            rng: seeds the draws.
            names: (V,) what the budget calls each column; None: as it is.
        """
        from planner.cover import search_kernels  # importing numba costs 0.3 s

        self._kernels, self.sets = search_kernels, sets
        self._names = np.arange(sets.n_columns) if names is None else names
        self._state = self._fresh(rng)
        self._begin(columns)
        numbers, k = self._state.numbers, search_kernels
        numbers[k.BEST] = sets.objective(columns)
        # The kernel begins with a step; the choice has to be cheaper, or to cover more, than the best one by then.
        numbers[k.LIMIT] = sets.most if sets.most >= 0 else sets.cost(columns) - 1
        numbers[k.ALLOWED] = numbers[k.BEST] - 1 if sets.most >= 0 else sets.slack
        self._tenures = 0 if sets.full else min(TENURES, max(sets.n_columns - len(columns), 1))
        self._patience = PATIENCE
        self._far_bits = self._state.bits.nbytes >= FAR_BITS
        self._fresh_work = FRESH_WORK * sets.n_entries + FAR_BYTE_WORK * self._state.bits.nbytes * self._far_bits
        self._waited = 0

    def run(self, budget: Budget, chunks: int | None = None) -> None:
        """Search while work is left; better choices go to the budget.

        Args:
            budget: charged.
            chunks: the search ends when so many have found nothing better; None: it does not.
        """
        kernels, sets, state = self._kernels, self.sets, self._state
        numbers = state.numbers
        # Rows open for good: nothing is better than the bound; elsewhere the budget knows.
        target = budget.lower_bound + sets.tolerance
        far = 1.0 + min(sets.n_columns / FAR_COLUMNS + sets.n_entries / FAR_ENTRIES, FARTHEST)
        far += FAR_BITS_CHARGE * self._far_bits
        best, work, self._fresh_work = int(numbers[kernels.BEST]), self._fresh_work, 0
        while budget.spend(work):
            limit = min(CHUNK_WORK, max(int(budget.left / far), 1))
            done = kernels.steps(state, sets.full, sets.most >= 0, target, self._tenures, limit)
            if done < 0:
                break
            work = int(done * far)
            self._waited += 1
            if numbers[kernels.BEST] < best:
                best, self._waited = int(numbers[kernels.BEST]), 0
                found = prune(sets, state.columns[kernels.BEST_MEMBER, : numbers[kernels.BEST_MEMBERS]])
                budget.offer(self._names[found], sets.objective(found))
            elif self._waited == chunks:
                break
            elif self._waited > self._patience:
                self._waited, self._patience = 0, 2 * self._patience
                self._begin(state.columns[kernels.MEMBER, : numbers[kernels.MEMBERS]].copy())

    def _begin(self, chosen: Ints) -> None:
        """Fresh weights; the next steps go on from this choice."""
        k, sets, (rows, columns, groups), numbers = self._kernels, self.sets, self._state[6:9], self._state.numbers
        rows[k.LOAD] = rows[k.OWNERS] = 0
        rows[k.WEIGHT] = rows[k.OPEN_WEIGHT] = rows[k.FIRST_WEIGHT]
        rows[k.OPEN_ROW] = rows[k.OPEN_PLACE] = np.arange(sets.n_rows)
        columns[k.PLACE], columns[k.STAMP], columns[k.LOSS], groups[k.INSIDE] = -1, 0, 0, 0
        columns[k.STACK, : len(chosen)], numbers[k.FIRST_MEMBERS] = chosen, len(chosen)
        numbers[k.OPEN], numbers[k.MISSING], numbers[k.TABU] = sets.n_rows, sets.total, -1
        numbers[k.MEMBERS] = numbers[k.SPENT] = 0
        brought = rows[k.WEIGHT][sets.column_rows] * (1 if sets.plain else sets.column_load)
        worth = np.add.reduceat(np.append(brought, 0), sets.column_start[:-1])
        numbers[k.PARTS] = max(int(worth.max(initial=1)) // 4, 1)

    def _fresh(self, rng: np.random.Generator) -> "State":
        """The arrays of a search."""
        k, sets = self._kernels, self.sets
        numbers = np.zeros(k.NUMBERS, dtype=np.int64)
        numbers[k.PRICED], numbers[k.ONCE] = not sets.unit_cost, sets.once
        numbers[k.CHEAPEST] = sets.costs.min() if sets.n_columns else 1
        rows = np.zeros((k.OPEN_PLACE + 1, sets.n_rows), dtype=np.int64)
        rows[k.DEMAND], rows[k.UNITS], rows[k.FIRST_WEIGHT] = sets.demand, sets.units, 1
        if not sets.full:
            shares = sets.units / float(max(sets.total, 1))
            rows[k.FIRST_WEIGHT] = np.maximum(np.rint(shares * AREA_WEIGHTS), 1.0).astype(np.int64)
        columns = np.zeros((k.STACK + 1, sets.n_columns), dtype=np.int64)
        columns[k.COST], columns[k.GROUP] = sets.costs, sets.group
        columns[k.FIXED, sets.fixed] = 1
        groups = np.stack((sets.group_costs, np.zeros_like(sets.group_costs)))
        wide = sets.plain and sets.n_entries > WIDE * sets.n_columns
        bits = packed(sets.column_start, sets.column_rows, sets.n_rows) if wide else np.zeros((0, 0), dtype=np.uint64)
        state: State = k.State(
            sets.row_start, sets.row_columns, sets.column_start, sets.column_rows, sets.column_load, bits,
            rows, columns, groups, sets.adjacent, numbers, rng.integers(0, 2**64, 1, dtype=np.uint64),
        )  # fmt: skip
        return state
