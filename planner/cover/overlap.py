"""Views that can be registered to each other: selections with a connected overlap graph (`Overlap`).

The fewest views of the cover without this constraint bound their number from below; the difference is the price of the
constraint. The search starts from them, connects their components along shortest paths in the graph of all candidates,
and exchanges views.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import scipy.sparse as sp

from planner.cover.answer import Cover, make_cover
from planner.cover.budget import Budget
from planner.cover.problem import NO_GRAPH, CoverInstance, CoverProblem, graph_components, overlap_adjacency
from planner.cover.reductions import CanonicalForm
from planner.cover.search import LocalSearch, complete, prune
from planner.cover.solvers import solve_instance
from planner.values import Bools, Floats, Ints, Value

UNCONSTRAINED_SHARE = 0.4
"""Share of the budget for the cover without the constraint: it is the start and the bound."""


@dataclass(frozen=True, slots=True, eq=False)
class OverlapGraph(Value):
    """Overlap graph of the views of a cover.

    Attributes:
        component: (n,) connected component of each view; 0 is the one that measures most.
        component_area: (p,) area that each component measures [m^2].
        adjacent: (n, n) whether two views overlap enough, in the order of `Cover.views`.
        coverable_area: area of the rows that some usable column covers [m^2].
    """

    component: Annotated[Ints, "n"]
    component_area: Annotated[Floats, "p"]
    adjacent: Annotated[Bools, "n n"]
    coverable_area: float

    @property
    def is_connected(self) -> bool:
        """Whether all scans can be registered to each other."""
        return len(self.component_area) < 2

    @property
    def sentence(self) -> str:
        """The result in words with its numbers."""
        if self.is_connected:
            return "the overlap graph is connected: all scans can be registered to each other"
        share = 100 * self.component_area[0] / self.coverable_area if self.coverable_area else 0.0
        return (
            "no selection of these candidates both meets the target and has a connected overlap graph: it falls into "
            f"{len(self.component_area)} components; the largest has {int((self.component == 0).sum())} of "
            f"{len(self.component)} views and measures {share:.2f} % of the coverable surface"
        )


def overlap_graph(problem: CoverProblem, cover: Cover) -> OverlapGraph:
    """Return the overlap graph of a cover's views; the problem must have an overlap."""
    assert problem.overlap is not None, "without an overlap there is no graph"
    measured = np.asarray(sp.csc_array(problem.matrix, dtype=bool)[:, cover.views].toarray())
    areas = np.asarray(problem.areas, dtype=np.float64)
    adjacent = overlap_adjacency(measured, areas, problem.overlap)
    labels = graph_components(adjacent, np.arange(len(cover.views)))
    count = int(labels.max(initial=-1)) + 1
    by_component = [float(areas[measured[:, labels == k].any(axis=1)].sum()) for k in range(count)]
    order = np.array(sorted(range(count), key=lambda k: -by_component[k]), dtype=np.int64)
    rank = np.argsort(order)
    component_area = np.array(by_component)[order]
    return OverlapGraph(rank[labels], component_area, adjacent.astype(bool), cover.coverable_area)


def connected_cover(
    problem: CoverProblem, form: CanonicalForm, rng: np.random.Generator, budget: Budget, solver: str
) -> Cover:
    """Select few columns that cover the required share and are connected.

    If no selection does both, the components of the candidates' graph are covered one after the other, beginning with
    the one that measures most, each by connected columns.

    Args:
        problem: as the caller states it.
        form: the same in canonical form.
        rng: random draws of the search.
        budget: charged.
        solver: for the cover without the constraint.
    """
    constrained = form.reduced
    free = replace(constrained, adjacent=NO_GRAPH, fixed=constrained.fixed[:0])
    residual, left = free.residual(form.pinned_columns)
    with budget.portion(UNCONSTRAINED_SHARE):
        inner, bound, _ = solve_instance(residual, solver, rng, budget)
    start = np.concatenate((form.pinned_columns, left[inner]))
    bound += free.cost(start) - residual.cost(inner)
    is_empty = constrained.needs_no_column and not len(start)
    selected = start if is_empty else _select_connected(constrained, start, rng, budget, bound)
    n_views = len(start) + len(form.idle_pins)
    return make_cover(problem, form, selected, bound, solver=solver, budget=budget, n_views_without_overlap=n_views)


def _select_connected(
    instance: CoverInstance, start: Ints, rng: np.random.Generator, budget: Budget, lower_bound: int
) -> Ints:
    """Return columns that meet the target and are connected; if none are, cover component after component."""
    label = graph_components(instance.adjacent, np.arange(instance.n_columns))
    components = [np.flatnonzero(label == k) for k in range(int(label.max(initial=-1)) + 1)]
    components.sort(key=lambda columns: -int(instance.units[instance.satisfied(columns)].sum()))
    for columns in components:
        if np.isin(instance.fixed, columns).all() and instance.is_feasible(columns):
            inside = instance.restricted(columns=np.isin(np.arange(instance.n_columns), columns))
            inner_start = np.searchsorted(columns, start[np.isin(start, columns)])
            return columns[_improve_connected(inside, inner_start, rng, budget, lower_bound)]
    # no component is sufficient: each covers as many of the uncovered rows as it can
    selected = instance.fixed[:0]
    for columns in components:
        fixed = instance.fixed[np.isin(instance.fixed, columns)]
        if instance.is_feasible(selected) and not len(fixed):
            continue
        rows = ~instance.satisfied(selected) & instance.satisfied(np.union1d(selected, columns))
        inside = instance.restricted(rows, np.isin(np.arange(instance.n_columns), columns))
        inside = replace(inside, full=True)
        with budget.portion(0.5):
            improved = _improve_connected(inside, np.searchsorted(columns, fixed), rng, budget, 0)
        selected = np.union1d(selected, columns[improved])
    return selected


def _improve_connected(
    instance: CoverInstance, start: Ints, rng: np.random.Generator, budget: Budget, lower_bound: int
) -> Ints:
    """Complete a selection, connect it and improve it; the instance has one component and can meet its target."""
    first = prune(instance, complete(instance, np.union1d(start, instance.fixed)))
    budget.begin(lower_bound=lower_bound)
    budget.offer(first, instance.objective(first))
    with budget.stopped_by_interrupt():
        if len(first) > 1 and budget.spend(0):
            LocalSearch(instance, first, rng).run(budget)
    assert budget.incumbent is not None, "the first selection was offered"
    return budget.incumbent
