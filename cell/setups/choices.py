"""Covers by choices of set-ups: each by itself, and what all of them together allow at best.

Choices are covered one by one, those that can measure most first: shortly, the best with all work, then those of the
least bound as long as that raises the bound on all. Where they are many, all their columns together give a bound as
well, as if set-ups cost nothing: most columns are held by others then, and what is left of a matrix of all set-ups is
hardly larger than that of two.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from cell.setups.fewest import Rows
from planner import cover
from planner.cover import Cover, CoverProblem
from planner.values import Bools, Ints

_EACH = 24
"""Choices of set-ups that are covered one by one, of many too; a brief answer looks at a third of them."""

_MORE, _BEST = 48, 3
"""Of many choices so many are looked at where the bound leaves a better cover; so many are covered with all work.

Choices of several set-ups are many beyond the latter: what all allow together is hardly less than what most do alone.
"""

SHORT, _TOGETHER = 0.2, 4.0
"""Of the work for one plan: for a short cover, and for the bound on all choices together."""

_SLACK = 1e-9  # relative, of costs and areas


@dataclass(frozen=True, slots=True)
class Bound:
    """What no cover undercuts, and none exceeds."""

    views: int
    cost: float
    area: float

    @classmethod
    def of(cls, some: Collection[Cover]) -> Self:
        """Of all that one of some covers answers."""
        return cls(
            min(one.lower_bound for one in some),
            min(one.cost_bound for one in some),
            max(one.upper_area for one in some),
        )

    @classmethod
    def tightest(cls, some: Collection["Bound"]) -> Self:
        """Of some that hold for the same."""
        return cls(max(one.views for one in some), max(one.cost for one in some), min(one.area for one in some))


class Choices:
    """What is asked, of some of the columns, answered by `planner.cover`."""

    def __init__(self, wish: CoverProblem, rows: Rows, rng: np.random.Generator, solver: str) -> None:
        self._wish, self._rows, self._rng, self._solver = wish, rows, rng, solver
        hard = wish.overlap is not None or wish.max_views is not None
        self._work = cover.DEFAULT_EFFORT * (3 if hard else 1)  # as for one plan
        self._group, self._allowed = np.asarray(wish.group), np.asarray(wish.allowed)
        self._costs = np.ones(len(self._group)) if wish.costs is None else np.asarray(wish.costs, dtype=np.float64)

    def of_choices(
        self, choices: Sequence[tuple[int, ...]], known: Ints, *, every: bool, brief: bool
    ) -> tuple[Cover, Bound]:
        """The best cover by one of some choices of set-ups, and the bound on all; on the first few where brief.

        Args:
            choices: of so many set-ups, the most promising first.
            known: columns to begin with where a choice has them all.
            every: whether no other choice does; without, the bound is on all set-ups together.
            brief: whether short covers of the first few are enough.
        """
        each = {some: self._by(some, SHORT, known) for some in choices[: _EACH // 3 if brief else _EACH]}
        if brief:
            return self._best(each), Bound.of(each.values())
        free = None
        if not every or len(choices) > len(each) or (len(choices) > _BEST and len(choices[0]) > 1):
            columns = self._of_setups({setup for some in choices for setup in some}) if every else self._allowed
            free = self.of(columns, _TOGETHER, start=self._best(each).views, together=True)
            for some in choices[_EACH:_MORE]:
                if self._leaves_better(free, each):
                    each[some] = self._by(some, SHORT, known)
        left = sorted(each, key=lambda some: self._size(each[some]))
        for some in left[:_BEST]:
            if self._leaves_better(each[some], each) and (free is None or self._leaves_better(free, each)):
                each[some] = self._by(some, 1.0, each[some].views)
        left = left[_BEST:]
        bounds = [] if free is None else [Bound.of([free])]
        if every and len(each) == len(choices):
            least = -np.inf if free is None else self._least(free)
            while left:  # the bound on all is the least of theirs
                weakest = min(left, key=lambda some: self._least(each[some]))
                others = [self._least(one) for some, one in each.items() if some not in left]
                if max(self._least(each[weakest]), least) >= min(others):
                    break
                each[weakest] = self._by(weakest, 1.0, each[weakest].views)
                left.remove(weakest)
            bounds.append(Bound.of(each.values()))
        return self._best(each), Bound.tightest(bounds)

    def weighted(self, known: Cover, setup_cost: float, fewest: int, work: float) -> tuple[Cover, Bound]:
        """The cover by any set-ups, each at a cost; no dearer than one that is known."""
        free = self.of(self._allowed, work, start=known.views)
        found = self.of(self._allowed, work, start=known.views, setup_cost=setup_cost)
        bound = Bound.of([found])
        bound = replace(bound, cost=max(bound.cost, free.cost_bound + fewest * setup_cost))
        return min(found, known, key=lambda one: self.paid(one, setup_cost) or 0.0), bound

    def paid(self, one: Cover, setup_cost: float | None) -> float | None:
        """What views cost, and their set-ups where these have a cost; None where views are counted."""
        if self._wish.costs is None:
            return None
        return float(self._costs[one.views].sum()) + (setup_cost or 0.0) * len(np.unique(self._group[one.views]))

    @property
    def groups_go(self) -> bool:
        """Whether set-ups may have a cost in one problem (`planner.cover.selection`, `planner.cover.reductions`)."""
        wish = self._wish
        return wish.region is None and wish.weights is None and wish.max_views is None and wish.overlap is None

    def _by(self, setups: tuple[int, ...], work: float, start: Ints) -> Cover:
        return self.of(self._of_setups(setups), work, start=start)

    def _of_setups(self, setups: Collection[int]) -> Bools:
        return self._allowed & np.isin(self._group, sorted(setups))

    def _best(self, each: Mapping[tuple[int, ...], Cover]) -> Cover:
        return min(each.values(), key=self._size)

    def _least(self, one: Cover) -> float:
        """What no cover of the same undercuts of what is to be small."""
        return one.cost_bound if self._wish.max_views is None else -one.upper_area

    def _leaves_better(self, one: Cover, each: Mapping[tuple[int, ...], Cover]) -> bool:
        """Whether what one cover proves leaves a better one than the best of some."""
        best = self._best(each)
        size = best.cost if self._wish.max_views is None else -best.covered_area
        return self._least(one) < size - _SLACK * abs(size)

    def _size(self, one: Cover) -> tuple[float, ...]:
        """What is to be small."""
        setups, paid = len(np.unique(self._group[one.views])), self.paid(one, None)
        most_first = -one.covered_area if self._wish.max_views is not None else 0.0
        return most_first, setups, len(one.views) if paid is None else paid

    def of(
        self, columns: Bools, work: float, *, start: Ints | None = None, setup_cost: float | None = None,
        together: bool = False,
    ) -> Cover:  # fmt: skip
        """Of columns (V,), as far as they bring what all would.

        Args:
            columns: that may be chosen.
            work: in that of one plan.
            start: columns to begin with where they all may be.
            setup_cost: of each set-up; None: set-ups cost nothing.
            together: whether only the bound is of use: by branch and bound, and views need not hang together.
        """
        wish, rows, some = self._wish, self._rows, np.flatnonzero(columns)
        matrix = wish.matrix[:, some]
        kept = rows.have(np.asarray(matrix.sum(axis=1, dtype=np.int64)).ravel())
        reach = rows.worth_of(kept)
        shares = np.minimum(np.divide(rows.wanted, reach, out=np.ones_like(reach), where=reach > 0), 1.0)
        problem = replace(
            wish, matrix=matrix[kept], areas=np.asarray(wish.areas)[kept], allowed=None, demand=rows.need[kept],
            coverage=float(shares[0]),
            costs=None if wish.costs is None else self._costs[some],
            pinned=np.searchsorted(some, list(wish.pinned)).tolist(),
            weights=None if wish.weights is None else rows.worth[kept],
            region=None if wish.region is None else rows.part[kept],
            region_coverage=() if wish.region is None else tuple(shares.tolist()),
            overlap=None if together else wish.overlap,
            group=None if setup_cost is None else self._group[some],
            group_costs=None if setup_cost is None else np.full(len(rows.brought), setup_cost),
        )  # fmt: skip
        begin = np.searchsorted(some, start) if start is not None and len(start) and columns[start].all() else None
        solver, whole = ("exact", cover.DEFAULT_EFFORT) if together else (self._solver, self._work)
        found = cover.solve(problem, rng=self._rng, solver=solver, effort_budget=int(work * whole), start=begin)
        return replace(found, views=some[found.views])
