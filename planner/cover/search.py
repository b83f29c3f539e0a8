"""Local search: keep a choice that costs too little, swap until the target is met, repeat.

Full cover is RWLS (Gao, Weise, Li 2015, doi:10.1016/j.ejor.2015.05.038): whenever the target is met the choice is kept
and the column with the smallest loss is removed; otherwise one column leaves (smallest weighted loss, not the one that
came last), one of a randomly drawn open row enters (largest weighted gain, and only when a row of it has been opened or
closed since it left: configuration checking), ties to the one that moved longest ago, and every row that is still open
gains weight. Of large rows a sample is looked at (Cai 2015, "best from multiple selections"). With costs, losses and
gains count per cost, and columns enter while the choice stays cheaper than the best one; groups make their first column
dearer. A row that demands more counts by its deficit.

Where rows may stay open for good, the area itself is the weight: the column that loses least leaves, the one that gains
most enters, and what moved may not move back for some steps (tabu search; Glover 1989, doi:10.1287/ijoc.1.3.190). The
same search finds the most area with a number of columns. Parts of a graph too many count as one more deficit, whose
weight grows while they last.

The loops are in `search_kernels`; they run in chunks, between which the clock, Ctrl-C and the budget are heard. A
search that has found nothing for long goes on with fresh weights.
"""

from typing import TYPE_CHECKING

import numpy as np

from planner.cover.budget import Budget
from planner.cover.greedy import prune
from planner.cover.sets import Sets
from planner.values import Ints

if TYPE_CHECKING:
    from planner.cover.search_kernels import State

CHUNK_WORK = 20_000_000
"""Work between two looks at the clock: about 40 ms."""

AREA_WEIGHTS = 2**40
"""Where rows may stay open their weights sum to this: with loads of 2^16 scores stay below 2^62."""

TENURES = 12
"""Where rows may stay open: longest time that a moved column may not move back, in moves."""

PATIENCE = 15
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

        self._kernels, self.sets, self._rng = search_kernels, sets, rng
        self._names = np.arange(sets.n_columns) if names is None else names
        self._growth = np.ones(sets.n_rows, dtype=np.int64)
        if not sets.full:
            shares = sets.units / float(max(sets.total, 1))
            self._growth = np.maximum(np.rint(shares * AREA_WEIGHTS), 1.0).astype(np.int64)
        self._state = self._fresh()
        self._place(columns)
        self._tenures = 0 if sets.full else min(TENURES, max(sets.n_columns - len(columns), 1))
        self._patience = PATIENCE
        self._waited = 0

    def run(self, budget: Budget) -> None:
        """Search while work is left; better choices go to the budget."""
        kernels, sets, state = self._kernels, self.sets, self._state
        numbers = state.numbers
        # Rows open for good: nothing is better than the bound; elsewhere the budget knows.
        target = budget.lower_bound + sets.tolerance
        best, work = int(numbers[kernels.BEST]), sets.n_entries
        while budget.spend(work):
            limit = min(CHUNK_WORK, max(budget.left, 1))
            work = kernels.steps(state, sets.full, sets.most >= 0, target, self._tenures, limit)
            if work < 0:
                break
            self._waited += 1
            if numbers[kernels.BEST] < best:
                best, self._waited = int(numbers[kernels.BEST]), 0
                found = prune(sets, state.best[: numbers[kernels.BEST_MEMBERS]])
                budget.offer(self._names[found], sets.objective(found))
            elif self._waited > self._patience:
                self._waited, self._patience = 0, 2 * self._patience
                self._start_again()

    def _start_again(self) -> None:
        """Weights are forgotten; the choice stays where it is."""
        self._state.weights[:] = self._growth
        self._kernels.rescore(self._state)

    def _place(self, columns: Ints) -> None:
        """Put the first choice in place, unstamped."""
        kernels, state = self._kernels, self._state
        kernels.rescore(state)
        state.numbers[kernels.PARTS] = max(int(state.score.max(initial=1)) // 4, 1)
        for column in columns.tolist():
            kernels.move(state, column, 1)
        state.stamp[:] = 0
        numbers, sets = state.numbers, self.sets
        numbers[kernels.BEST] = sets.objective(columns)
        numbers[kernels.LIMIT] = sets.most if sets.most >= 0 else sets.cost(columns) - 1
        numbers[kernels.ALLOWED] = numbers[kernels.MISSING] - 1 if sets.most >= 0 else sets.slack
        if sets.most < 0:  # the kernel begins with a step; the choice has to be cheaper than the best one by then
            numbers[kernels.LIMIT] = sets.cost(columns) - 1

    def _fresh(self) -> "State":
        """The arrays of a search that has no column yet."""
        kernels, sets = self._kernels, self.sets
        n_rows, n_columns = sets.shape
        numbers = np.zeros(kernels.NUMBERS, dtype=np.int64)
        numbers[kernels.PRICED] = not sets.unit_cost
        numbers[kernels.OPEN], numbers[kernels.MISSING], numbers[kernels.TABU] = n_rows, sets.total, -1
        fixed = np.zeros(n_columns, dtype=np.bool_)
        fixed[sets.fixed] = True

        def zeros(count: int) -> Ints:
            return np.zeros(count, dtype=np.int64)

        state: State = kernels.State(
            row_start=sets.row_start, row_columns=sets.row_columns, row_load=sets.row_load,
            column_start=sets.column_start, column_rows=sets.column_rows, column_load=sets.column_load,
            demand=sets.demand, units=sets.units, costs=sets.costs, group=sets.group, group_costs=sets.group_costs,
            group_members=zeros(len(sets.group_costs)), adjacent=sets.adjacent, fixed=fixed, growth=self._growth,
            weights=self._growth.copy(), load=zeros(n_rows), owner=zeros(n_rows), score=zeros(n_columns),
            chosen=np.zeros(n_columns, dtype=np.bool_), free=np.ones(n_columns, dtype=np.bool_),
            members=zeros(n_columns), place=zeros(n_columns),
            open_rows=np.arange(n_rows), open_place=np.arange(n_rows), stamp=zeros(n_columns), best=zeros(n_columns),
            labels=np.zeros((2, n_columns + 1), dtype=np.int64), numbers=numbers,
            random=self._rng.integers(0, 2**64, 1, dtype=np.uint64),
        )  # fmt: skip
        return state
