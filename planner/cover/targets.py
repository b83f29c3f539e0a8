"""Several area targets at once, one for each part of the rows, answered by problems with one target.

Parts may each be left open by so much: open_g <= slack_g for every part g. For any weights u_g >= 0 that sum to 1 the
**surrogate** constraint (Greenberg and Pierskalla, "Surrogate mathematical programming", Operations Research 18 (1970),
doi:10.1287/opre.18.5.924)

    sum_g u_g open_g / slack_g <= 1

follows from all of them, so a bound for it is one for all; and it is one area target with weighted rows, which `solve`
answers. A choice that meets it and happens to meet every target is an answer, proven where the surrogate's was.
Otherwise parts that are left open by too much gain weight, and after a few rounds the right side goes down: at the
smallest u_g it implies every target. A part that must not be left open at all needs no weight of its own: its rows
count more than everything that may stay open. One such problem is then exact where at most one part has slack.

Rows may also count by weights of the caller's in place of their areas; what is told is in areas again.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planner.cover.answer import Cover, CoverStatus
from planner.cover.answer_of_columns import retold
from planner.cover.canonical import canonical
from planner.cover.problem import CoverProblem
from planner.errors import PlannerError
from planner.values import Bools, Floats, Ints

Ask = Callable[[CoverProblem, float], Cover]
"""Answers a problem with one target, with a share of the work that there is."""

_ROUNDS = 5  # in which parts gain weight; few instances change after three
_TIGHTER = (0.75, 0.5, 0.25)  # of the way from 1 to the right side that implies every target
_LOOK, _LAST = 0.1, 0.5  # of the work: for each look, and for the weights that they lead to
_SLACK = 1e-9  # relative, when a target counts as met


def solve_parts(problem: CoverProblem, ask: Ask, start: Ints | None = None) -> Cover:
    """Answer a problem with targets for parts, or with weights.

    Args:
        problem: with `region_coverage` or `weights`.
        ask: answers one with one target.
        start: (n,) columns of a choice that is taken where it meets every target and none that was found costs less.

    Raises:
        PlannerError: if the parts do not fit the rows or their targets, a weight is no finite number above 0, or an
            overlap or groups are asked for.
    """
    if problem.overlap is not None or problem.group is not None:
        raise PlannerError("overlap and groups go without targets for parts and without weights; ask for one of them")
    parts = _Parts(problem)
    if not len(parts.coverage):
        found = ask(replace(problem, areas=parts.worth, weights=None), 1.0)
        return found if problem.max_views is not None else parts.told(found, found.views)
    if problem.max_views is not None:
        raise PlannerError("max_views asks for the most area: it goes without targets for parts")
    loose = parts.slack > 0
    u = loose / max(int(loose.sum()), 1)
    if loose.sum() <= 1:
        found = ask(parts.surrogate(u, 1.0), 1.0)
        return parts.told(found, found.views)
    bounds: list[Cover] = []
    for _ in range(_ROUNDS):
        found = ask(parts.surrogate(u, 1.0), _LOOK)
        bounds.append(found)
        if parts.met(found.views):
            break
        u[loose] *= np.maximum(parts.open(found.views)[loose] / parts.slack[loose], 0.1)
        u /= u.sum()
    bounds.append(ask(parts.surrogate(u, 1.0), _LAST))
    if parts.met(bounds[-1].views):
        found = bounds[-1]
    least = float(u[loose].min())
    for share in (*_TIGHTER, 0.0):
        if parts.met(found.views):
            break
        found = ask(parts.surrogate(u, least + share * (1 - least)), _LOOK)
    if start is not None and parts.answers(start) and parts.cost(start) < parts.cost(found.views):
        found = parts.told(found, start)
    return _with_bounds(parts, found, bounds)


class _Parts:
    """The rows of a problem by their parts."""

    def __init__(self, problem: CoverProblem) -> None:
        areas = np.array(problem.areas, dtype=np.float64)
        self.worth: Floats = np.array(areas if problem.weights is None else problem.weights, dtype=np.float64)
        self.coverage = np.array(problem.region_coverage, dtype=np.float64)
        self.part: Ints = (
            np.zeros(len(areas), np.int64) if problem.region is None else np.array(problem.region, np.int64)
        )
        if self.worth.shape != areas.shape or not (np.isfinite(self.worth) & (self.worth >= 0)).all():
            raise PlannerError(f"weights must be {len(areas)} finite numbers, zero or above, one for each row")
        count = max(len(self.coverage), 1)
        if self.part.shape != areas.shape or not 0 <= self.part.min(initial=0) <= self.part.max(initial=0) < count:
            raise PlannerError(f"part must give each of {len(areas)} rows a part from 0 to {count - 1}")
        if not ((self.coverage >= 0) & (self.coverage <= 1)).all():
            raise PlannerError("each of region_coverage is a share of what is coverable and must be from 0 to 1")
        self.problem = replace(problem, pinned=list(problem.pinned), banned=list(problem.banned))
        self._nominal = canonical(
            replace(self.problem, coverage=0.0, max_views=None, weights=None, region=None, region_coverage=())
        )
        self.slack = (1 - self.coverage) * self._by_part(np.ones(self._nominal.whole.n_rows, dtype=bool))

    def _by_part(self, rows: Bools) -> Floats:
        """(G,) worth of some of the coverable rows in each part."""
        of = self._nominal.rows[rows]
        worth = np.bincount(self.part[of], self.worth[of], max(len(self.coverage), 1)).astype(np.float64)
        return worth[: len(self.coverage)]

    def _left(self, views: Ints) -> Bools:
        """Coverable rows that lack what they demand."""
        return ~self._nominal.whole.covered(np.flatnonzero(np.isin(self._nominal.columns, views)))

    def open(self, views: Ints) -> Floats:
        """(G,) worth that is left open in each part."""
        return self._by_part(self._left(views))

    def met(self, views: Ints) -> bool:
        """Whether every target is met."""
        rows, left = self._nominal.rows, self._left(views)
        strict = (self.slack == 0)[self.part[rows]]
        whole = float(self.worth[rows].sum())
        return bool((self.open(views) <= self.slack + _SLACK * whole).all() and not (left & strict).any())

    def answers(self, views: Ints) -> bool:
        """Whether a choice may be taken and meets every target."""
        usable = np.union1d(self._nominal.columns, self._nominal.pinned)
        return (
            bool(np.isin(views, usable).all()) and set(self.problem.pinned) <= set(views.tolist()) and self.met(views)
        )

    def cost(self, views: Ints) -> float:
        """What a choice costs; its number of views where no costs were given."""
        costs = self.problem.costs
        return len(views) if costs is None else float(np.asarray(costs, dtype=np.float64)[views].sum())

    def surrogate(self, u: Floats, most: float) -> CoverProblem:
        """The problem with one target: sum_g u_g open_g / slack_g <= most, and nothing open where there is no slack."""
        scale = np.divide(u, self.slack, out=np.zeros(len(u)), where=self.slack > 0)
        weight = np.where((self.slack > 0)[self.part], scale[self.part] * self.worth, 2.0)
        whole = float(weight[self._nominal.rows].sum())
        coverage = max(1.0 - most / whole, 0.0) if whole > 0 and (self.slack > 0).any() else 1.0
        return replace(self.problem, areas=weight, coverage=coverage, weights=None, region=None, region_coverage=())

    def told(self, found: Cover, views: Ints) -> Cover:
        """The answer in areas, the view that satisfies the largest area first."""
        return retold(self._nominal, found, views, self.problem)


def _with_bounds(parts: _Parts, found: Cover, bounds: list[Cover]) -> Cover:
    """An answer to all targets without views that none of them needs, with the best of the surrogates' bounds."""
    views = found.views
    for view in reversed(views.tolist()):
        rest = views[views != view]
        if view not in found.pinned and parts.met(rest):
            views = rest
    told = parts.told(found, views)
    least = min(max(each.lower_bound for each in bounds), len(views))
    price = None
    if found.cost_and_bound is not None:
        paid = parts.cost(views)
        price = (paid, min(max(each.cost_bound for each in bounds), paid))
    proven = least == len(views) if price is None else price[1] >= price[0] * (1 - 1e-9)
    ended = [each.status for each in bounds if each.status in (CoverStatus.INTERRUPTED, CoverStatus.TIME_LIMITED)]
    status = CoverStatus.PROVEN if proven else ended[0] if ended else CoverStatus.BOUNDED
    work = sum(each.effort for each in bounds)
    return replace(told, lower_bound=least, cost_and_bound=price, status=status, effort=work)
