"""Views whose data can be registered: the graph of chosen views is connected (`planner.cover.problem.Overlap`).

The fewest views of the cover without this wish bound the number from below; the difference is its price. The search
begins with them, joins their parts along shortest ways in the graph of all candidates, and exchanges views from there.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy.sparse as sp

from planner.cover.answer import Cover
from planner.cover.answer_of_columns import told
from planner.cover.budget import Budget
from planner.cover.canonical import Canonical
from planner.cover.graph import NO_GRAPH, joined_columns, parts_of
from planner.cover.greedy import complete, prune
from planner.cover.problem import CoverProblem
from planner.cover.search import Search
from planner.cover.sets import Sets
from planner.cover.solvers import answer
from planner.values import Bools, Floats, Ints, Value

UNCONNECTED_SHARE = 0.4
"""Of the budget, for the cover without the constraint: it is the start and the bound."""


@dataclass(frozen=True, slots=True, eq=False)
class OverlapGraph(Value):
    """How the views of a cover hang together.

    Attributes:
        component: (n,) number of the connected part that each view belongs to; 0 is the one that measures most.
        component_area: (p,) area that each part measures [m^2].
        adjacent: (n, n) which of the views are joined, in the order of `Cover.views`.
        coverable_area: area of the rows that some usable column covers [m^2].
    """

    component: Annotated[Ints, "n"]
    component_area: Annotated[Floats, "p"]
    adjacent: Annotated[Bools, "n n"]
    coverable_area: float

    @property
    def is_connected(self) -> bool:
        """Whether every view overlaps others so far that all scans hang together."""
        return len(self.component_area) < 2

    @property
    def sentence(self) -> str:
        """In words with its numbers."""
        if self.is_connected:
            return "every view overlaps others so far that all scans hang together"
        share = 100 * self.component_area[0] / self.coverable_area if self.coverable_area else 0.0
        return (
            "no choice of these candidates both covers what is asked for and hangs together: they fall into "
            f"{len(self.component_area)} parts, and the largest, of {int((self.component == 0).sum())} of "
            f"{len(self.component)} views, measures {share:.2f} % of what can be measured"
        )


def overlap_graph(problem: CoverProblem, cover: Cover) -> OverlapGraph:
    """The graph of a cover's views and its parts, the one that measures most first; the problem has an overlap."""
    assert problem.overlap is not None, "without an overlap there is no graph"
    measured = np.asarray(sp.csc_array(problem.matrix, dtype=bool)[:, cover.views].toarray())
    measured[cover.uncoverable_rows] = False
    areas = np.asarray(problem.areas, dtype=np.float64)
    joined = joined_columns(measured, areas, problem.overlap)
    labels = parts_of(joined, np.arange(len(cover.views)))
    by_part = [float(areas[measured[:, labels == k].any(axis=1)].sum()) for k in range(int(labels.max(initial=-1)) + 1)]
    order = sorted(range(len(by_part)), key=lambda k: (-by_part[k], k))
    rank = np.argsort(np.array(order, dtype=np.int64), kind="stable")
    part = rank[labels] if len(labels) else labels
    return OverlapGraph(part, np.array([by_part[k] for k in order]), joined.astype(bool), cover.coverable_area)


def connected_cover(
    problem: CoverProblem, found: Canonical, rng: np.random.Generator, work: Budget, solver: str
) -> Cover:
    """Choose few columns that cover the required share and hang together.

    Where no choice does both, the parts of the candidates' graph are covered one after the other, the one that measures
    most first, each by columns that hang together.

    Args:
        problem: as the caller told it.
        found: the same in canonical form.
        rng: random choices of the search.
        work: budget.
        solver: for the cover that need not hang together.
    """
    whole = found.whole
    free = replace(whole, adjacent=NO_GRAPH, fixed=whole.fixed[:0])
    rest, left = free.without(found.fixed)
    with work.portion(UNCONNECTED_SHARE):
        inner, bound, _ = answer(rest, solver, rng, work)
    start = np.concatenate((found.fixed, left[inner]))
    bound += free.cost(start) - rest.cost(inner)
    chosen = start if whole.trivial and not len(start) else _choice(whole, start, rng, work, bound)
    return told(
        found, chosen, bound, solver=solver, work=work, problem=problem,
        n_views_without_overlap=len(start) + len(found.idle),
    )  # fmt: skip


def _choice(sets: Sets, start: Ints, rng: np.random.Generator, work: Budget, least: int) -> Ints:
    """Columns that meet the target and hang together; part after part of the graph where none do."""
    label = parts_of(sets.adjacent, np.arange(sets.n_columns))
    parts = [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]
    parts.sort(key=lambda columns: -int(sets.units[sets.covered(columns)].sum()))
    for columns in parts:
        if np.isin(sets.fixed, columns).all() and sets.met(columns):
            inside = sets.restricted(columns=np.isin(np.arange(sets.n_columns), columns))
            keep = np.searchsorted(columns, start[np.isin(start, columns)])
            return columns[_improved(inside, keep, rng, work, least)]
    # no part is enough: each covers what it can of what is still open
    chosen = sets.fixed[:0]
    for columns in parts:
        held = sets.fixed[np.isin(sets.fixed, columns)]
        if sets.met(chosen) and not len(held):
            continue
        waiting = ~sets.covered(chosen) & sets.covered(np.union1d(chosen, columns))
        inside = sets.restricted(waiting, np.isin(np.arange(sets.n_columns), columns))
        inside = replace(inside, full=True)
        with work.portion(0.5):
            found = _improved(inside, np.searchsorted(columns, held), rng, work, 0)
        chosen = np.union1d(chosen, columns[found])
    return chosen


def _improved(sets: Sets, start: Ints, rng: np.random.Generator, work: Budget, least: int) -> Ints:
    """A choice that hangs together, from some columns on; `sets` is in one part and can meet its target."""
    first = prune(sets, complete(sets, np.union1d(start, sets.fixed)))
    work.begin(lower_bound=least)
    work.offer(first, sets.objective(first))
    with work.ended_by_ctrl_c():
        if len(first) > 1 and work.spend(0):
            Search(sets, first, rng).run(work)
    assert work.best is not None, "the first choice is there"
    return work.best
