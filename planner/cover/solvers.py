"""The solvers by name, and what is done before and around each: reductions, greedy, bound."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planner.cover.bound import Relaxation
from planner.cover.budget import EFFORT_PER_SECOND, Budget
from planner.cover.greedy import complete, greedy, prune
from planner.cover.meta_raps import meta_raps
from planner.cover.reductions import Reduction, reduce
from planner.cover.search import Search
from planner.cover.sets import Sets
from planner.values import Ints

BOUND_SHARE = 0.35
"""Most of the budget that the linear programme may take."""

SEARCH_SHARES = (0.2, 0.4)
"""`auto`: share of what is left for the search before branch and bound is tried, and before it is tried again."""

PROOF_SHARE, AREA_PROOF_SHARE, FAR_PROOF_SHARE = 0.8, 0.6, 0.3
"""`auto`: share of what is left for branch and bound; for the most area, which with many views only the search
improves; and where more than `FEW` views are left, or for a share of the area more than one: the search may find it."""

EARLY_SHARE, EARLY_CHUNKS = 0.15, 4
"""`auto` begins with a search on the problem as it is: with at most this share, and until it finds nothing better in so
many chunks of work."""

SCARCE, SCARCE_PER_ENTRY, SCARCE_SHARE = EFFORT_PER_SECOND // 2, 100, 0.6
"""With no more work left than this, or than this for each entry (which reductions take), hardly anything can be proven:
the share of the first search then, which goes to its end."""

FEW, HOPEFUL_EXCESS = 2.0, 0.1
"""`auto` tries branch and bound on a choice that exceeds the bound by at most so few columns or this share."""

SMALL = 30
"""With no more columns than this branch and bound comes before the search, and whatever the gap."""

CORE = 0.7
"""The search is confined to the columns that reduced costs leave where these are no more than this share."""


@dataclass(slots=True)
class Job:
    """A reduced problem being solved; the best choice and bound are kept in the budget.

    Attributes:
        sets: the problem.
        rng: random choices.
        budget: work, clock, best so far.
        relaxation: the bound and its multipliers.
    """

    sets: Sets
    rng: np.random.Generator
    budget: Budget
    relaxation: Relaxation

    @property
    def best(self) -> Ints:
        """The best choice so far; there is one from the beginning."""
        assert self.budget.best is not None, "the greedy choice comes first"
        return self.budget.best

    @property
    def hopeful(self) -> bool:
        """Whether branch and bound may close the gap."""
        if self.sets.n_columns <= SMALL or self.sets.most >= 0:
            return True
        return self.excess <= max(FEW, HOPEFUL_EXCESS * len(self.best))

    @property
    def excess(self) -> float:
        """By how many columns of the mean cost the best choice exceeds the bound."""
        return (self.budget.objective - self.budget.lower_bound) / float(self.sets.costs.mean())

    @property
    def proof_share(self) -> float:
        """Share of what is left for branch and bound; above `FAR_PROOF_SHARE` it comes after a short search."""
        if self.sets.most >= 0:
            return AREA_PROOF_SHARE
        one_left = self.budget.objective - self.budget.lower_bound <= 1
        return PROOF_SHARE if one_left or (self.sets.full and self.excess <= FEW) else FAR_PROOF_SHARE

    def core_search(self) -> Search:
        """A search on the columns that a better choice may contain (reduced-cost fixing), where these are fewer."""
        sets = self.sets
        useful = self.relaxation.useful(self.budget.objective - 1)
        core = np.flatnonzero(useful)
        if len(core) > CORE * sets.n_columns or (sets.most < 0 and not sets.met(core)):
            return Search(sets, self.best, self.rng)
        inside = sets.restricted(columns=useful)
        keep = np.searchsorted(core, self.best[useful[self.best]])
        start = prune(inside, complete(inside, keep))
        self.budget.offer(core[start], inside.objective(start))  # it may be the better one already
        return Search(inside, start, self.rng, core)

    def prove(self) -> None:
        """Branch and bound, as far as the budget goes; it knows no graph."""
        from planner.cover.exact import close_gap  # importing highspy costs start-up

        if not len(self.sets.adjacent):
            close_gap(self.relaxation, self.budget)


Solver = Callable[[Job], None]
"""Improves what the job's budget holds."""


def auto(job: Job) -> None:
    """Branch and bound first where little is left; else search and branch and bound, until neither helps.

    The search is short where branch and bound may close the gap: its trees find what is missing, or show that nothing
    is.
    """
    if job.sets.n_columns <= SMALL:
        job.prove()
    search, asked = None, -1
    for share in SEARCH_SHARES:
        if job.budget.spend(0):
            search = search or job.core_search()
            with job.budget.portion(share):
                search.run(job.budget, EARLY_CHUNKS if job.proof_share > FAR_PROOF_SHARE else None)
        if job.hopeful and job.budget.objective != asked and job.budget.spend(0):
            asked = job.budget.objective
            with job.budget.portion(job.proof_share):
                job.prove()
    if search and job.budget.spend(0):
        search.run(job.budget)


def local_search(job: Job) -> None:
    """Local search with the whole budget."""
    if job.budget.spend(0):
        Search(job.sets, job.best, job.rng).run(job.budget)


SOLVERS: dict[str, Solver] = {
    "auto": auto,
    "greedy": lambda job: None,
    "meta-raps": lambda job: meta_raps(job.sets, job.rng, job.budget),
    "local-search": local_search,
    "exact": Job.prove,
}
"""`greedy` has nothing to add: its choice and the bound come first for every solver."""


def answer(
    sets: Sets, solver: str, rng: np.random.Generator, work: Budget, start: Ints | None = None
) -> tuple[Ints, int, int]:
    """A first choice, a reduced problem for a solver, and what it found lifted.

    Args:
        sets: the problem; a graph is not looked at.
        solver: a name in `SOLVERS`.
        rng: random choices.
        work: budget; at its end it still has what is best of the reduced problem.
        start: a choice to begin with; it is completed where it does not do.

    Returns:
        The best choice, a bound on the objective, and, with a number of columns allowed, how many fewer ones need at
        least to leave as little open.
    """
    forced = reduce(sets, work, only_forced=True)
    if start is not None and not forced.sets.trivial:
        start = forced.left_of(start)
        start = prune(forced.sets, complete(forced.sets, start if sets.most < 0 else start[: forced.sets.most]))
    first = _first(forced.sets, start, solver, rng, work)
    reduction = reduce(forced.sets, work)
    inner, relaxation = _run(reduction, first, solver, rng, work)
    chosen, first = forced.lift(reduction.lift(inner)), forced.lift(first)
    paid = sets.objective(chosen) - reduction.sets.objective(inner)  # what the forced columns cost
    if sets.objective(first) < sets.objective(chosen):
        chosen = first
    found = sets.objective(chosen) - paid
    fewest = 0
    if relaxation and sets.most >= 0:
        fewest = next(k for k in range(sets.most + 1) if k == sets.most or relaxation.certified_units(k) <= found)
    return chosen, paid + min(work.lower_bound, found), fewest


def _first(sets: Sets, start: Ints | None, solver: str, rng: np.random.Generator, work: Budget) -> Ints:
    """The better of start and greedy choice, and for `auto` what a short search makes of it."""
    work.begin(sets.tolerance)
    chosen, spent = greedy(sets)
    if sets.trivial:
        return chosen[:0]
    if start is not None and sets.objective(start) <= sets.objective(chosen):
        chosen = start
    work.offer(chosen, sets.objective(chosen))
    scarce = work.left <= max(SCARCE, SCARCE_PER_ENTRY * sets.n_entries)
    share, chunks = (SCARCE_SHARE, None) if scarce else (EARLY_SHARE, EARLY_CHUNKS)
    with work.ended_by_ctrl_c(), work.portion(share):
        if work.spend(spent) and solver == "auto" and sets.n_columns > SMALL:
            Search(sets, chosen, rng).run(work, chunks)
    assert work.best is not None, "the greedy choice is there"
    return work.best


def _run(
    reduction: Reduction, first: Ints, solver: str, rng: np.random.Generator, work: Budget
) -> tuple[Ints, Relaxation | None]:
    """Bound and the chosen solver; the best so far when Ctrl-C ends it."""
    sets = reduction.sets
    work.begin(sets.tolerance)
    if sets.trivial:
        nothing = np.zeros(0, dtype=np.int64)
        work.prove(sets.objective(nothing))
        return nothing, None
    if sets.most < 0:
        work.prove(int(sets.costs.min()))  # one column at least, should Ctrl-C come before the bound
    kept = prune(sets, complete(sets, reduction.left_of(first)))
    work.offer(kept, sets.objective(kept))
    relaxation = None
    with work.ended_by_ctrl_c():
        relaxation = Relaxation(sets)
        work.prove(relaxation.value)
        if work.spend(12 * sets.n_entries):
            from planner.cover.row_generation import raise_bound  # importing highspy costs start-up

            with work.portion(BOUND_SHARE):
                raise_bound(relaxation, work.objective, work)
        SOLVERS[solver](Job(sets, rng, work, relaxation))
    assert work.best is not None, "the first choice is there"
    return work.best, relaxation
