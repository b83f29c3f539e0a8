"""The solvers by name, and the steps before and around each: reductions, greedy selection, bound."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import EFFORT_PER_SECOND, Budget
from planner.cover.problem import CoverInstance
from planner.cover.reductions import Reduction, reduce
from planner.cover.search import LocalSearch, complete, greedy, meta_raps, prune
from planner.cover.tree import close_gap
from planner.values import Ints

BOUND_SHARE = 0.35
"""Largest share of the budget for the linear programme."""

SEARCH_SHARES = (0.2, 0.4)
"""`auto`: share of the remaining effort for the search before branch and bound is tried, and before the second try."""

PROOF_SHARE, AREA_PROOF_SHARE, FAR_PROOF_SHARE = 0.8, 0.6, 0.3
"""`auto`: share of the remaining effort for branch and bound; for maximum coverage, which with many views only the
search improves; and if the incumbent exceeds the bound by more than `FEW` views (for a share of the area by more than
one), which the search may find."""

EARLY_SHARE, EARLY_CHUNKS = 0.15, 4
"""`auto` begins with a search on the problem before its reduction: largest share of the effort, and number of chunks
without improvement after which it ends."""

SCARCE, SCARCE_PER_ENTRY, SCARCE_SHARE = EFFORT_PER_SECOND // 2, 100, 0.6
"""With no more effort than the first, or than the second for each entry (which reductions take), hardly anything can be
proven: the first search then gets this share, and uses it."""

FEW, HOPEFUL_EXCESS = 2.0, 0.1
"""`auto` tries branch and bound if the incumbent exceeds the bound by at most this number of columns or this share."""

SMALL = 30
"""Number of columns up to which branch and bound precedes the search, and is tried whatever the gap."""

CORE = 0.7
"""The search is confined to the columns that reduced costs leave if they are no more than this share."""


@dataclass(slots=True)
class SolverTask:
    """A reduced problem that is being solved; the budget keeps the incumbent and the bound.

    Attributes:
        instance: the problem.
        rng: random draws.
        budget: effort, incumbent, lower bound.
        relaxation: the bound and its multipliers.
    """

    instance: CoverInstance
    rng: np.random.Generator
    budget: Budget
    relaxation: Relaxation

    @property
    def incumbent(self) -> Ints:
        """The best selection so far."""
        assert self.budget.incumbent is not None, "the greedy selection precedes all solvers"
        return self.budget.incumbent

    @property
    def may_be_proven(self) -> bool:
        """Whether branch and bound may close the gap."""
        if self.instance.n_columns <= SMALL or self.instance.maximises_area:
            return True
        return self.excess <= max(FEW, HOPEFUL_EXCESS * len(self.incumbent))

    @property
    def excess(self) -> float:
        """Number of columns of the mean cost by which the incumbent exceeds the bound."""
        return (self.budget.objective - self.budget.lower_bound) / float(self.instance.costs.mean())

    @property
    def proof_share(self) -> float:
        """Share of the remaining effort for branch and bound; above `FAR_PROOF_SHARE` it follows a short search."""
        if self.instance.maximises_area:
            return AREA_PROOF_SHARE
        one_left = self.budget.objective - self.budget.lower_bound <= 1
        return PROOF_SHARE if one_left or (self.instance.full and self.excess <= FEW) else FAR_PROOF_SHARE

    def core_search(self) -> LocalSearch:
        """Return a search on the columns that a better selection may contain (reduced-cost fixing), if few enough."""
        instance = self.instance
        useful = self.relaxation.useful_columns(self.budget.objective - 1)
        core = np.flatnonzero(useful)
        is_feasible = instance.maximises_area or instance.is_feasible(core)
        if len(core) > CORE * instance.n_columns or not is_feasible:
            return LocalSearch(instance, self.incumbent, self.rng)
        inside = instance.restricted(columns=useful)
        inner_start = np.searchsorted(core, self.incumbent[useful[self.incumbent]])
        start = prune(inside, complete(inside, inner_start))
        self.budget.offer(core[start], inside.objective(start))  # it may already be better
        return LocalSearch(inside, start, self.rng, core)

    def prove(self) -> None:
        """Run branch and bound as far as the budget allows; it supports no overlap graph."""
        if not len(self.instance.adjacent):
            close_gap(self.relaxation, self.budget)


Solver = Callable[[SolverTask], None]
"""Improves the incumbent and the bound in the task's budget."""


def auto(task: SolverTask) -> None:
    """Run branch and bound first on small problems; then search and branch and bound in turn until neither helps.

    The search is short if branch and bound may close the gap: its trees find a better selection, or prove that none
    exists.
    """
    if task.instance.n_columns <= SMALL:
        task.prove()
    search, last_objective = None, -1
    for share in SEARCH_SHARES:
        if task.budget.spend(0):
            search = search or task.core_search()
            with task.budget.portion(share):
                search.run(task.budget, EARLY_CHUNKS if task.proof_share > FAR_PROOF_SHARE else None)
        if task.may_be_proven and task.budget.objective != last_objective and task.budget.spend(0):
            last_objective = task.budget.objective
            with task.budget.portion(task.proof_share):
                task.prove()
    if search and task.budget.spend(0):
        search.run(task.budget)


def local_search(task: SolverTask) -> None:
    """Run the local search with the whole budget."""
    if task.budget.spend(0):
        LocalSearch(task.instance, task.incumbent, task.rng).run(task.budget)


SOLVERS: dict[str, Solver] = {
    "auto": auto,
    "greedy": lambda task: None,
    "meta-raps": lambda task: meta_raps(task.instance, task.rng, task.budget),
    "local-search": local_search,
    "exact": SolverTask.prove,
}
"""`greedy` has nothing to add: greedy selection and bound precede every solver."""


def solve_instance(
    instance: CoverInstance, solver: str, rng: np.random.Generator, budget: Budget, start: Ints | None = None
) -> tuple[Ints, int, int]:
    """Solve an instance: first selection, reductions, bound, solver.

    Args:
        instance: the problem; an overlap graph is ignored.
        solver: a name in `SOLVERS`.
        rng: random draws.
        budget: charged; at the end it still holds the incumbent of the reduced problem.
        start: a selection to start from; it is completed if it misses the target.

    Returns:
        The best selection, a lower bound on the objective, and, for maximum coverage, the smallest number of columns
        that may leave as little uncovered.
    """
    forced = reduce(instance, budget, only_forced=True)
    if start is not None and not forced.instance.needs_no_column:
        start = forced.project(start)[: forced.instance.max_columns]
        start = prune(forced.instance, complete(forced.instance, start))
    first = _first_selection(forced.instance, start, solver, rng, budget)
    reduction = reduce(forced.instance, budget)
    inner, relaxation = _solve_reduced(reduction, first, solver, rng, budget)
    selected, first = forced.lift(reduction.lift(inner)), forced.lift(first)
    forced_cost = instance.objective(selected) - reduction.instance.objective(inner)
    if instance.objective(first) < instance.objective(selected):
        selected = first
    objective = instance.objective(selected) - forced_cost
    min_columns = 0
    if relaxation and (limit := instance.max_columns) is not None:
        sizes = range(limit + 1)
        min_columns = next(k for k in sizes if k == limit or relaxation.certified_uncovered(k) <= objective)
    return selected, forced_cost + min(budget.lower_bound, objective), min_columns


def _first_selection(
    instance: CoverInstance, start: Ints | None, solver: str, rng: np.random.Generator, budget: Budget
) -> Ints:
    """Return the better of start and greedy selection, for `auto` improved by a short search."""
    budget.begin(instance.tolerance)
    selected, effort = greedy(instance)
    if instance.needs_no_column:
        return selected[:0]
    if start is not None and instance.objective(start) <= instance.objective(selected):
        selected = start
    budget.offer(selected, instance.objective(selected))
    is_scarce = budget.remaining <= max(SCARCE, SCARCE_PER_ENTRY * instance.n_entries)
    share, chunks = (SCARCE_SHARE, None) if is_scarce else (EARLY_SHARE, EARLY_CHUNKS)
    with budget.stopped_by_interrupt(), budget.portion(share):
        if budget.spend(effort) and solver == "auto" and instance.n_columns > SMALL:
            LocalSearch(instance, selected, rng).run(budget, chunks)
    assert budget.incumbent is not None, "the greedy selection was offered"
    return budget.incumbent


def _solve_reduced(
    reduction: Reduction, first: Ints, solver: str, rng: np.random.Generator, budget: Budget
) -> tuple[Ints, Relaxation | None]:
    """Compute the bound and run the solver; after Ctrl-C return the incumbent."""
    instance = reduction.instance
    budget.begin(instance.tolerance)
    if instance.needs_no_column:
        nothing = np.zeros(0, dtype=np.int64)
        budget.raise_lower_bound(instance.objective(nothing))
        return nothing, None
    if not instance.maximises_area:
        budget.raise_lower_bound(int(instance.costs.min()))  # one column at least, if Ctrl-C precedes the bound
    selection = prune(instance, complete(instance, reduction.project(first)))
    budget.offer(selection, instance.objective(selection))
    relaxation = None
    with budget.stopped_by_interrupt():
        relaxation = Relaxation(instance)
        budget.raise_lower_bound(relaxation.bound)
        if budget.spend(12 * instance.n_entries):
            with budget.portion(BOUND_SHARE):
                raise_bound(relaxation, budget.objective, budget)
        SOLVERS[solver](SolverTask(instance, rng, budget, relaxation))
    assert budget.incumbent is not None, "the first selection was offered"
    return budget.incumbent, relaxation
