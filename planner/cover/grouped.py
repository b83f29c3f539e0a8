"""Set cover with groups of columns: fewest groups, then fewest views, each with a bound.

A group holds the columns of one set-up of the part. `solve_grouped` first finds the smallest number of groups whose
columns together meet the targets, by enumeration, so that this number is exact. Each choice of that many groups is then
covered by itself. The covers of all choices, and one bound on the columns of all choices together, give the bound on
the number of views.

Columns may have costs in place of 1, and their number may be limited. With a cost for each group the number of groups
no longer comes first, and one problem holds all groups.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Self

import numpy as np

from planner.cover.answer import Cover, CoverStatus
from planner.cover.budget import DEFAULT_EFFORT
from planner.cover.problem import CoverProblem
from planner.cover.solve import solve
from planner.values import Bools, Floats, Ints

MAX_ENUMERATED = 200_000
"""Choices of groups enumerated for the smallest number; beyond it the bound is the number reached so far."""

N_COVERED = 24
"""Choices covered one by one; a fast answer covers a third of them."""

N_COVERED_MORE, N_THOROUGH = 48, 3
"""Choices covered if the common bound leaves room for a better one; choices covered with the whole budget."""

FAST_SHARE, COMMON_SHARE = 0.2, 4.0
"""Budget of a fast cover, and of the bound on all choices together, in budgets of one cover."""

_VIEWS_FIRST_GROUP_COST = 0.01
"""Cost of a group, in the cost of one view, if the number of views comes first and groups decide between equals."""

_AREA_TOLERANCE, _COST_TOLERANCE = 1e-12, 1e-9  # relative


class GroupLoads:
    """Number of measurements that all columns of each group give to each row, and the targets of the rows.

    Attributes:
        loads: (G, S) allowed columns of each group that measure each row.
        demand: (S,) columns that must measure each row, at most as many as all groups offer.
        weights: (S,) area or weight of each row.
        region: (S,) region of each row.
        target_weight: (P,) weight that must be satisfied in each region.
    """

    def __init__(self, problem: CoverProblem, targets: Floats) -> None:
        """Sum the columns of `problem`; `targets` (P,) are shares of the weight that all groups can satisfy."""
        group = np.asarray(problem.group)
        member = np.asarray(problem.allowed)[:, None] & (group[:, None] == np.arange(int(group.max(initial=-1)) + 1))
        self.loads: Ints = np.asarray(problem.matrix @ member.astype(np.int64)).T
        self.demand: Ints = np.minimum(self.loads.sum(axis=0), problem.demand)
        self.weights = np.asarray(problem.areas if problem.weights is None else problem.weights, dtype=np.float64)
        self.region: Ints = (
            np.zeros(len(self.weights), np.int64) if problem.region is None else np.asarray(problem.region, np.int64)
        )
        self.target_weight: Floats = targets * self.weight_of(self.demand > 0)

    @property
    def n_groups(self) -> int:
        """Number of groups."""
        return len(self.loads)

    def weight_of(self, rows: Bools) -> Floats:
        """Return the (P,) weight of selected (S,) rows in each region."""
        n_regions = int(self.region.max(initial=0)) + 1
        return np.bincount(self.region[rows], self.weights[rows], minlength=n_regions).astype(np.float64)

    def satisfied(self, loads: Ints) -> Bools:
        """Return (S,) whether the load of each row meets its demand."""
        return (self.demand > 0) & (loads >= self.demand)

    def reached(self, groups: Collection[int]) -> Floats:
        """Return the (P,) weight that all columns of some groups satisfy."""
        return self.weight_of(self.satisfied(self.loads[list(groups)].sum(axis=0)))

    def deficit(self, reached: Floats) -> float:
        """Return the weight that is missing; 0 if (P,) reached weights meet all targets."""
        return float(np.maximum(self.target_weight * (1 - _AREA_TOLERANCE) - reached, 0.0).sum())


@dataclass(frozen=True, slots=True, eq=False)
class GroupedCover:
    """Columns of several groups with bounds.

    Attributes:
        views: columns of each used group, numbered within the group, in the order of their choice.
        group_bound: no smaller number of groups meets the targets.
        view_bound: no cover by as many groups has fewer views.
        covered_area: area, or weight, of the satisfied rows.
        loads: loads and targets of the rows.
        targets: (P,) requested share of the weight that all groups can satisfy.
        is_feasible: whether the allowed number of groups can meet the targets.
        cost_and_bound: cost of views and groups, and its lower bound; None without costs.
        has_group_costs: whether the cost contains groups.
        upper_area: upper bound on the covered area for a limited number of views; None without a limit.
    """

    views: dict[int, Ints]
    group_bound: int
    view_bound: int
    covered_area: float
    loads: GroupLoads
    targets: Floats
    is_feasible: bool
    cost_and_bound: tuple[float, float] | None = None
    has_group_costs: bool = False
    upper_area: float | None = None

    @property
    def n_views(self) -> int:
        """Number of views in all groups."""
        return sum(map(len, self.views.values()))

    @property
    def objective(self) -> tuple[float, ...]:
        """Values to minimise in order: uncovered area if views are limited, groups if they are free, cost or views."""
        paid = float(self.n_views) if self.cost_and_bound is None else self.cost_and_bound[0]
        area = 0.0 if self.upper_area is None else -self.covered_area
        return (area, paid) if self.has_group_costs else (area, float(len(self.views)), paid)

    @property
    def share(self) -> float:
        """Share of the coverable weight whose demand is satisfied."""
        coverable = float(self.loads.weight_of(self.loads.demand > 0).sum())
        return self.covered_area / coverable if coverable > 0 else 1.0

    def with_view(self, group: int, column: int, cost: float) -> "GroupedCover":
        """Return the cover with one more view of a used group."""
        views = {**self.views, group: np.append(self.views[group], column)}
        price = None if self.cost_and_bound is None else (self.cost_and_bound[0] + cost, self.cost_and_bound[1])
        return replace(self, views=views, cost_and_bound=price)

    def with_bounds_of(self, other: "GroupedCover") -> "GroupedCover":
        """Return the cover with the bounds of a cover of the same problem, or of one with more candidates."""
        price = self.cost_and_bound
        if price is not None and other.cost_and_bound is not None:
            price = price[0], min(other.cost_and_bound[1], price[0])
        return replace(
            self,
            group_bound=min(other.group_bound, len(self.views)),
            view_bound=min(other.view_bound, self.n_views),
            cost_and_bound=price,
            upper_area=None if other.upper_area is None else max(other.upper_area, self.covered_area),
        )

    def is_met_by(self, loads: Ints) -> bool:
        """Return whether (S,) loads still meet the targets; for limited views, the covered area."""
        reached = self.loads.weight_of(self.loads.satisfied(loads))
        least = self.loads.target_weight if self.upper_area is None else np.array([self.covered_area])
        return bool((reached >= least * (1 - 1e-9)).all())


def solve_grouped(
    problem: CoverProblem,
    targets: Floats,
    rng: np.random.Generator,
    *,
    max_groups: int | None = None,
    group_cost: float | None = None,
    solver: str = "auto",
    fast: bool = False,
    start: Mapping[int, Ints] | None = None,
    effort_budget: int | None = None,
) -> GroupedCover:
    """Find the fewest groups, then the fewest or cheapest views; or the most area for a limited number of views.

    Args:
        problem: columns of all groups side by side; its coverage is ignored. Pinned columns require their groups.
        targets: (P,) requested share of what all allowed columns together can measure of each region of the rows.
        rng: randomness of the search.
        max_groups: limit; if the targets take more groups, those with the largest coverage are selected.
        group_cost: cost of each group in the unit of the costs of the columns; the sum of all costs is minimised.
        solver: a name in `planner.cover.SOLVERS`.
        fast: whether a short search is enough; its bound holds for the choices of groups that it covered.
        start: columns of each group from which the search begins if a choice has all these groups.
        effort_budget: effort of each search, `DEFAULT_EFFORT` if None.
    """
    loads, group = GroupLoads(problem, targets), np.asarray(problem.group)
    first = np.searchsorted(group, np.arange(loads.n_groups))
    required = tuple(np.unique(group[list(problem.pinned)]).tolist())
    fewest, choices, is_complete = fewest_groups(loads, required, max_groups)
    reached = [loads.reached(choice) for choice in choices]
    is_feasible = any(loads.deficit(area) == 0 for area in reached)
    if not is_feasible:
        loads.target_weight = np.minimum(loads.target_weight, min(reached, key=loads.deficit))
    known = np.concatenate([first[row] + views for row, views in start.items()]) if start else np.empty(0, np.int64)
    covers = _GroupCovers(problem, loads, rng, solver, effort_budget)
    largest = sorted(zip(choices, reached, strict=True), key=lambda each: -float(each[1].sum()))
    best, bound = covers.best_of([choice for choice, _ in largest], known, is_complete=is_complete, fast=fast)
    if group_cost is not None:
        best, bound = covers.with_group_costs(best, group_cost, fewest, FAST_SHARE if fast else 1.0)
    used = np.unique(group[best.views])
    covered = best.covered_area
    if problem.weights is not None and problem.max_views is None:  # the cover reports areas, and rows have weights
        sums = np.asarray(problem.matrix[:, best.views].sum(axis=1, dtype=np.int64)).ravel()
        covered = float(loads.weight_of(loads.satisfied(sums)).sum())
    paid = covers.price(best, group_cost)
    return GroupedCover(
        views={int(row): best.views[group[best.views] == row] - first[row] for row in used},
        group_bound=min(fewest, len(used)),
        view_bound=min(bound.views, len(best.views)),
        covered_area=covered,
        loads=loads,
        targets=targets,
        is_feasible=is_feasible,
        cost_and_bound=None if paid is None else (paid, min(bound.cost, paid)),
        has_group_costs=group_cost is not None,
        upper_area=None if problem.max_views is None else max(bound.area, covered),
    )


def fewest_views(
    problem: CoverProblem, targets: Floats, rng: np.random.Generator, effort_budget: int | None = None
) -> tuple[int, int] | None:
    """Return numbers of groups and views by a short search for the fewest views.

    None if views have costs or a limit, must overlap, or rows have weights or regions.
    """
    covers = _GroupCovers(problem, GroupLoads(problem, targets), rng, "auto", effort_budget)
    if problem.costs is not None or not covers.allow_group_costs:
        return None
    cover = covers.solve(np.asarray(problem.allowed), FAST_SHARE, group_cost=_VIEWS_FIRST_GROUP_COST)
    return len(np.unique(np.asarray(problem.group)[cover.views])), len(cover.views)


def fewest_groups(
    loads: GroupLoads, required: tuple[int, ...], max_groups: int | None
) -> tuple[int, list[tuple[int, ...]], bool]:
    """Find the smallest number of groups whose columns meet the targets, and all choices of that many groups.

    Args:
        loads: contributions of each group, and the targets.
        required: groups that are used in any case.
        max_groups: limit, no smaller than the number of required groups; None: no limit.

    Returns:
        A lower bound on the number, choices of groups, and whether no other choice of as many groups meets the
        targets. If no choice of `max_groups` does: the choice that measures most. If there are too many choices to
        enumerate: the groups of a greedy choice.
    """
    others = [row for row in range(loads.n_groups) if row not in required]
    n_enumerated, greedy = 0, _greedy_groups(loads, required, max_groups or loads.n_groups)
    for count in range(max(len(required), 1), min(loads.n_groups, len(greedy), max_groups or loads.n_groups) + 1):
        deficits = {
            (choice := tuple(sorted((*required, *more)))): loads.deficit(loads.reached(choice))
            for more in combinations(others, count - len(required))
        }
        if enough := [choice for choice, deficit in deficits.items() if deficit == 0]:
            return count, enough, True
        if count == max_groups:
            return count, [min(deficits, key=lambda choice: deficits[choice])], True
        n_enumerated += len(deficits)
        if n_enumerated > MAX_ENUMERATED:
            return count + 1, [greedy], False
    return len(greedy), [greedy], False


def _greedy_groups(loads: GroupLoads, required: tuple[int, ...], limit: int) -> tuple[int, ...]:
    """Add the group that leaves the smallest deficit until none is left or the limit is reached."""
    selection = required
    while not selection or (loads.deficit(loads.reached(selection)) > 0 and len(selection) < limit):
        others = (row for row in range(loads.n_groups) if row not in selection)
        selection += (min(others, key=lambda row: loads.deficit(loads.reached((*selection, row)))),)
    return tuple(sorted(selection))


@dataclass(frozen=True, slots=True)
class _Bound:
    """Lower bounds on views and cost, upper bound on area."""

    views: int
    cost: float
    area: float

    @classmethod
    def of_any(cls, covers: Collection[Cover]) -> Self:
        """Return the bound on the best of several problems."""
        return cls(
            min(cover.lower_bound for cover in covers),
            min(cover.cost_bound for cover in covers),
            max(cover.upper_area for cover in covers),
        )

    @classmethod
    def tightest(cls, bounds: Collection["_Bound"]) -> Self:
        """Combine bounds that hold for the same problem."""
        return cls(
            max(bound.views for bound in bounds),
            max(bound.cost for bound in bounds),
            min(bound.area for bound in bounds),
        )


class _GroupCovers:
    """Covers of a problem by the columns of selected groups."""

    def __init__(
        self, problem: CoverProblem, loads: GroupLoads, rng: np.random.Generator, solver: str, effort_budget: int | None
    ) -> None:
        self._problem, self._loads, self._rng, self._solver = problem, loads, rng, solver
        is_hard = problem.overlap is not None or problem.max_views is not None
        self._bound_budget = DEFAULT_EFFORT if effort_budget is None else effort_budget
        self._budget = self._bound_budget * (3 if is_hard else 1)  # as for one plan
        self._group, self._allowed = np.asarray(problem.group), np.asarray(problem.allowed)
        costs = problem.costs
        self._costs = np.ones(len(self._group)) if costs is None else np.asarray(costs, dtype=np.float64)
        self._is_interrupted = False

    def best_of(
        self, choices: Sequence[tuple[int, ...]], known: Ints, *, is_complete: bool, fast: bool
    ) -> tuple[Cover, _Bound]:
        """Return the best cover by one choice of groups, and the bound on all choices; on the first few if `fast`.

        Choices are covered one by one: fast, then the best with the whole budget, then those of the smallest bound as
        long as this raises the bound on all. If there are many, the columns of all choices together give a bound as
        well: most columns are dominated then, and what remains is hardly larger than the problem of two groups.

        Args:
            choices: of equally many groups, the most promising first.
            known: columns to begin with if a choice has all of them.
            is_complete: whether no other choice meets the targets; if not, the bound is on all groups together.
            fast: whether fast covers of the first few are enough.
        """
        first = choices[: N_COVERED // 3 if fast else N_COVERED]
        each = {choice: self._solve_choice(choice, FAST_SHARE, known) for choice in first}
        if fast:
            return self._best(each), _Bound.of_any(each.values())
        common = None
        if not is_complete or len(choices) > len(each) or (len(choices) > N_THOROUGH and len(choices[0]) > 1):
            columns = self._columns_of({row for choice in choices for row in choice}) if is_complete else self._allowed
            common = self.solve(columns, COMMON_SHARE, start=self._best(each).views, bound_only=True)
            for choice in choices[N_COVERED:N_COVERED_MORE]:
                if self._leaves_room(common, each):
                    each[choice] = self._solve_choice(choice, FAST_SHARE, known)
        left = sorted(each, key=lambda choice: self._objective(each[choice]))
        for choice in left[:N_THOROUGH]:
            if self._leaves_room(each[choice], each) and (common is None or self._leaves_room(common, each)):
                each[choice] = self._solve_choice(choice, 1.0, each[choice].views)
        left = left[N_THOROUGH:]
        bounds = [] if common is None else [_Bound.of_any([common])]
        if is_complete and len(each) == len(choices):
            least = -np.inf if common is None else self._bound(common)
            while left:  # the bound on all choices is the smallest of their bounds
                weakest = min(left, key=lambda choice: self._bound(each[choice]))
                others = [self._bound(cover) for choice, cover in each.items() if choice not in left]
                if max(self._bound(each[weakest]), least) >= min(others):
                    break
                each[weakest] = self._solve_choice(weakest, 1.0, each[weakest].views)
                left.remove(weakest)
            bounds.append(_Bound.of_any(each.values()))
        return self._best(each), _Bound.tightest(bounds)

    def with_group_costs(self, known: Cover, group_cost: float, fewest: int, share: float) -> tuple[Cover, _Bound]:
        """Return the cheapest cover if each group has a cost; at most as expensive as the known cover."""
        free = self.solve(self._allowed, share, start=known.views)
        answer = self.solve(self._allowed, share, start=known.views, group_cost=group_cost)
        bound = _Bound.of_any([answer])
        bound = replace(bound, cost=max(bound.cost, free.cost_bound + fewest * group_cost))
        return min(answer, known, key=lambda cover: self.price(cover, group_cost) or 0.0), bound

    def price(self, cover: Cover, group_cost: float | None) -> float | None:
        """Return the cost of views and groups; None if views have no costs."""
        if self._problem.costs is None:
            return None
        return float(self._costs[cover.views].sum()) + (group_cost or 0.0) * len(np.unique(self._group[cover.views]))

    @property
    def allow_group_costs(self) -> bool:
        """Whether one problem can hold costs of groups (`planner.cover.solve`, `planner.cover.reductions`)."""
        problem = self._problem
        return problem.region is None and problem.weights is None and problem.max_views is None and not problem.overlap

    def solve(
        self, columns: Bools, share: float, *, start: Ints | None = None, group_cost: float | None = None,
        bound_only: bool = False,
    ) -> Cover:  # fmt: skip
        """Cover the rows that (V,) selected columns can satisfy, up to the targets.

        Once Ctrl-C ended a search, later covers get no search.

        Args:
            columns: that may be chosen.
            share: of the budget of one cover.
            start: columns to begin with if all of them are selected.
            group_cost: of each group; None: groups are free.
            bound_only: whether only the bound is of use: by branch and bound, and without overlap.
        """
        problem, loads, numbers = self._problem, self._loads, np.flatnonzero(columns)
        matrix = problem.matrix[:, numbers]
        is_satisfied = loads.satisfied(np.asarray(matrix.sum(axis=1, dtype=np.int64)).ravel())
        reach = loads.weight_of(is_satisfied)
        shares = np.minimum(np.divide(loads.target_weight, reach, out=np.ones_like(reach), where=reach > 0), 1.0)
        part = replace(
            problem, matrix=matrix[is_satisfied], areas=np.asarray(problem.areas)[is_satisfied], allowed=None,
            demand=loads.demand[is_satisfied], coverage=float(shares[0]),
            costs=None if problem.costs is None else self._costs[numbers],
            pinned=np.searchsorted(numbers, list(problem.pinned)).tolist(),
            weights=None if problem.weights is None else loads.weights[is_satisfied],
            region=None if problem.region is None else loads.region[is_satisfied],
            region_coverage=() if problem.region is None else tuple(shares.tolist()),
            overlap=None if bound_only else problem.overlap,
            group=None if group_cost is None else self._group[numbers],
            group_costs=None if group_cost is None else np.full(loads.n_groups, group_cost),
        )  # fmt: skip
        begin = np.searchsorted(numbers, start) if start is not None and len(start) and columns[start].all() else None
        solver, budget = ("exact", self._bound_budget) if bound_only else (self._solver, self._budget)
        effort = 0 if self._is_interrupted else int(share * budget)
        cover = solve(part, rng=self._rng, solver=solver, effort_budget=effort, start=begin)
        self._is_interrupted |= cover.status is CoverStatus.INTERRUPTED
        return replace(cover, views=numbers[cover.views])

    def _solve_choice(self, groups: tuple[int, ...], share: float, start: Ints) -> Cover:
        return self.solve(self._columns_of(groups), share, start=start)

    def _columns_of(self, groups: Collection[int]) -> Bools:
        return self._allowed & np.isin(self._group, sorted(groups))

    def _best(self, each: Mapping[tuple[int, ...], Cover]) -> Cover:
        return min(each.values(), key=self._objective)

    def _bound(self, cover: Cover) -> float:
        """Return the lower bound on the quantity that is minimised."""
        return cover.cost_bound if self._problem.max_views is None else -cover.upper_area

    def _leaves_room(self, cover: Cover, each: Mapping[tuple[int, ...], Cover]) -> bool:
        """Return whether the bound of a cover allows a better one than the best of several."""
        best = self._best(each)
        size = best.cost if self._problem.max_views is None else -best.covered_area
        return self._bound(cover) < size - _COST_TOLERANCE * abs(size)

    def _objective(self, cover: Cover) -> tuple[float, ...]:
        groups, paid = len(np.unique(self._group[cover.views])), self.price(cover, None)
        uncovered = -cover.covered_area if self._problem.max_views is not None else 0.0
        return uncovered, groups, len(cover.views) if paid is None else paid
