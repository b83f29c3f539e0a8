"""`solve`: check a cover problem, convert it to canonical form, and answer it; targets for several regions.

**Several targets**, one for each region of the rows, are answered by problems with one target. Each region g may leave
an area uncovered: uncovered_g <= slack_g. For any weights u_g >= 0 with sum 1, the **surrogate** constraint (Greenberg
and Pierskalla, "Surrogate mathematical programming", Operations Research 18 (1970), doi:10.1287/opre.18.5.924)

    sum_g u_g uncovered_g / slack_g <= 1

follows from all of them, so a bound for it is a bound for all; and it is one area target with weighted rows. A
selection that meets it and also meets every target is an answer, with the proof of the surrogate problem. Otherwise
regions with too much uncovered area gain weight, and after some rounds the right side is reduced: at the smallest u_g
it implies every target. A region without slack needs no weight: its rows count more than everything that may stay
uncovered. One such problem is then exact if at most one region has slack.

Rows may also be weighted by the caller's weights in place of their areas; the answer is in areas again.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.cover.answer import Cover, CoverStatus, make_cover, reweighted
from planner.cover.budget import DEFAULT_EFFORT, LARGE, LARGE_PACE, Budget, scaled_effort
from planner.cover.overlap import connected_cover
from planner.cover.problem import CoverProblem
from planner.cover.reductions import canonical_form
from planner.cover.solvers import SOLVERS, solve_instance
from planner.errors import PlannerError
from planner.values import Bools, Floats, Ints

CANONICAL_EFFORT = 25
"""Charge of checking and sorting, for each entry of the matrix."""

_ROUNDS = 5  # in which regions gain weight; few instances change after three
_TIGHTER = (0.75, 0.5, 0.25)  # positions from the right side that implies every target (0) to 1
_PROBE_SHARE, _FINAL_SHARE = 0.1, 0.5  # of the effort: for each round, and for the resulting weights
_TARGET_TOLERANCE = 1e-9  # relative, when a target counts as met


def solve(
    problem: CoverProblem,
    *,
    rng: np.random.Generator,
    solver: str = "auto",
    start: Ints | None = None,
    effort_budget: int | None = None,
) -> Cover:
    """Select the fewest or cheapest columns for a coverage, or the largest area with a number of them.

    A first cover and a lower bound are always computed, whatever the budget. Ctrl-C ends the search: the best selection
    so far is returned, and its status says so.

    Args:
        problem: the problem.
        rng: random draws of the search.
        solver: a name in `SOLVERS`.
        start: (n,) columns of a selection to start from, which may miss the target; unusable columns are ignored. None,
            and with an overlap: the greedy selection.
        effort_budget: units of effort for everything together (500 million are about a second of one core); None:
            `DEFAULT_EFFORT`, scaled with the matrix unless there are regions or weights.

    Raises:
        PlannerError: for a contradictory problem, or an unknown solver.
    """
    if solver not in SOLVERS:
        raise PlannerError(f"there is no solver {solver!r}; choose one of {', '.join(SOLVERS)}")
    if problem.region_coverage or problem.weights is not None:

        def solve_single(single: CoverProblem, share: float) -> Cover:
            effort = int(share * (DEFAULT_EFFORT if effort_budget is None else effort_budget))
            return solve(single, rng=rng, solver=solver, start=start, effort_budget=effort)

        return _solve_regions(problem, solve_single, start)
    budget = Budget(DEFAULT_EFFORT if effort_budget is None else effort_budget)
    form = canonical_form(problem)
    reduced, residual = form.reduced, form.residual
    if effort_budget is None:
        budget.limit = scaled_effort(budget.limit, reduced.n_entries)
    budget.pace = LARGE_PACE if reduced.n_entries > LARGE else 1.0
    budget.spend(CANONICAL_EFFORT * reduced.n_entries)
    if len(residual.adjacent):
        return connected_cover(problem, form, rng, budget, solver)
    first = None if start is None else np.flatnonzero(np.isin(form.columns[form.residual_columns], start))
    inner, bound, min_columns = solve_instance(residual, solver, rng, budget, first)
    columns = np.concatenate((form.pinned_columns, form.residual_columns[inner]))
    if problem.max_views is None:
        bound += reduced.cost(columns) - residual.cost(inner)
    min_views = min_columns + len(form.pinned)
    return make_cover(problem, form, columns, bound, solver=solver, budget=budget, min_views=min_views)


def _solve_regions(
    problem: CoverProblem, solve_single: Callable[[CoverProblem, float], Cover], start: Ints | None
) -> Cover:
    """Answer a problem with targets for regions, or with weights.

    Args:
        problem: with `region_coverage` or `weights`.
        solve_single: answers a problem with one target, with a share of the effort.
        start: (n,) columns of a selection that is used if it meets every target and costs less than any other found.

    Raises:
        PlannerError: if the regions do not fit the rows or their targets, a weight is not finite or below 0, or an
            overlap or groups are required.
    """
    if problem.overlap is not None or problem.group is not None:
        raise PlannerError("region_coverage and weights cannot be combined with overlap or groups; remove one of them")
    regions = _Regions(problem)
    if not len(regions.coverage):
        answer = solve_single(replace(problem, areas=regions.weights, weights=None), 1.0)
        return answer if problem.max_views is not None else regions.in_areas(answer, answer.views)
    if problem.max_views is not None:
        raise PlannerError("max_views maximises the area: it cannot be combined with region_coverage")
    has_slack = regions.slack > 0
    u = has_slack / max(int(has_slack.sum()), 1)
    if has_slack.sum() <= 1:
        answer = solve_single(regions.surrogate(u, 1.0), 1.0)
        return regions.in_areas(answer, answer.views)
    is_interrupted = False

    def solve_surrogate(limit: float, share: float) -> Cover:
        """Solve the surrogate problem with the current weights; without search once Ctrl-C ended another one."""
        nonlocal is_interrupted
        cover = solve_single(regions.surrogate(u, limit), 0.0 if is_interrupted else share)
        is_interrupted |= cover.status is CoverStatus.INTERRUPTED
        return cover

    bounds: list[Cover] = []
    for _ in range(_ROUNDS):
        answer = solve_surrogate(1.0, _PROBE_SHARE)
        bounds.append(answer)
        if regions.meets_targets(answer.views):
            break
        u[has_slack] *= np.maximum(regions.uncovered(answer.views)[has_slack] / regions.slack[has_slack], 0.1)
        u /= u.sum()
    bounds.append(solve_surrogate(1.0, _FINAL_SHARE))
    if regions.meets_targets(bounds[-1].views):
        answer = bounds[-1]
    least = float(u[has_slack].min())
    for position in (*_TIGHTER, 0.0):
        if regions.meets_targets(answer.views):
            break
        answer = solve_surrogate(least + position * (1 - least), _PROBE_SHARE)
    if start is not None and regions.accepts(start) and regions.cost(start) < regions.cost(answer.views):
        answer = regions.in_areas(answer, start)
    return _with_bounds(regions, answer, bounds, is_interrupted=is_interrupted)


class _Regions:
    """Rows of a problem by region: weights, targets, and the slack of each."""

    def __init__(self, problem: CoverProblem) -> None:
        areas = np.array(problem.areas, dtype=np.float64)
        self.weights: Floats = np.array(areas if problem.weights is None else problem.weights, dtype=np.float64)
        self.coverage = np.array(problem.region_coverage, dtype=np.float64)
        self.region: Ints = (
            np.zeros(len(areas), np.int64) if problem.region is None else np.array(problem.region, np.int64)
        )
        if self.weights.shape != areas.shape or not (np.isfinite(self.weights) & (self.weights >= 0)).all():
            raise PlannerError(f"weights must be {len(areas)} finite numbers, zero or above, one for each row")
        count = max(len(self.coverage), 1)
        region = self.region
        if region.shape != areas.shape or not 0 <= region.min(initial=0) <= region.max(initial=0) < count:
            raise PlannerError(f"region must give each of {len(areas)} rows a region from 0 to {count - 1}")
        if not ((self.coverage >= 0) & (self.coverage <= 1)).all():
            raise PlannerError("each of region_coverage is a share of the coverable area and must be from 0 to 1")
        self.problem = problem
        self._form = canonical_form(
            replace(problem, coverage=0.0, max_views=None, weights=None, region=None, region_coverage=())
        )
        self.slack = (1 - self.coverage) * self._by_region(np.ones(self._form.reduced.n_rows, dtype=bool))

    def _by_region(self, rows: Bools) -> Floats:
        """Return the (G,) weight of some of the coverable rows in each region."""
        which = self._form.rows[rows]
        count = len(self.coverage)
        return np.bincount(self.region[which], self.weights[which], max(count, 1)).astype(np.float64)[:count]

    def _uncovered_rows(self, views: Ints) -> Bools:
        """Return whether the demand of each coverable row is unsatisfied."""
        return ~self._form.reduced.satisfied(np.flatnonzero(np.isin(self._form.columns, views)))

    def uncovered(self, views: Ints) -> Floats:
        """Return the (G,) uncovered weight of each region."""
        return self._by_region(self._uncovered_rows(views))

    def meets_targets(self, views: Ints) -> bool:
        """Return whether every target is met."""
        rows, uncovered = self._form.rows, self._uncovered_rows(views)
        is_strict = (self.slack == 0)[self.region[rows]]
        tolerance = _TARGET_TOLERANCE * float(self.weights[rows].sum())
        return bool((self.uncovered(views) <= self.slack + tolerance).all() and not (uncovered & is_strict).any())

    def accepts(self, views: Ints) -> bool:
        """Return whether a selection is usable, contains the pinned views and meets every target."""
        usable = np.union1d(self._form.columns, self._form.pinned)
        is_usable = bool(np.isin(views, usable).all())
        return is_usable and set(self.problem.pinned) <= set(views.tolist()) and self.meets_targets(views)

    def cost(self, views: Ints) -> float:
        """Return the cost of a selection; its number of views without costs."""
        costs = self.problem.costs
        return len(views) if costs is None else float(np.asarray(costs, dtype=np.float64)[views].sum())

    def surrogate(self, u: Floats, limit: float) -> CoverProblem:
        """Return the problem with sum_g u_g uncovered_g / slack_g <= limit; regions without slack must be covered."""
        scale = np.divide(u, self.slack, out=np.zeros(len(u)), where=self.slack > 0)
        weight = np.where((self.slack > 0)[self.region], scale[self.region] * self.weights, 2.0)
        total = float(weight[self._form.rows].sum())
        coverage = max(1.0 - limit / total, 0.0) if total > 0 and (self.slack > 0).any() else 1.0
        return replace(self.problem, areas=weight, coverage=coverage, weights=None, region=None, region_coverage=())

    def in_areas(self, answer: Cover, views: Ints) -> Cover:
        """Return the answer in areas."""
        return reweighted(self.problem, self._form, answer, views)


def _with_bounds(regions: _Regions, single: Cover, bounds: list[Cover], *, is_interrupted: bool) -> Cover:
    """Return the answer to all targets without redundant views, with the best bound of the surrogate problems."""
    views = single.views
    for view in reversed(views.tolist()):
        others = views[views != view]
        if view not in single.pinned and regions.meets_targets(others):
            views = others
    answer = regions.in_areas(single, views)
    lower_bound = min(max(each.lower_bound for each in bounds), len(views))
    cost_and_bound = None
    is_proven = lower_bound == len(views)
    if single.cost_and_bound is not None:
        cost = regions.cost(views)
        cost_bound = min(max(each.cost_bound for each in bounds), cost)
        cost_and_bound = (cost, cost_bound)
        is_proven = cost_bound >= cost * (1 - 1e-9)
    ended = CoverStatus.INTERRUPTED if is_interrupted else CoverStatus.BOUNDED
    status = CoverStatus.PROVEN if is_proven else ended
    effort = sum(each.effort for each in bounds)
    return replace(answer, lower_bound=lower_bound, cost_and_bound=cost_and_bound, status=status, effort=effort)
