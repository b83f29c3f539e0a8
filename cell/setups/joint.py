"""The cover over all set-ups: fewest set-ups, then fewest views, each with a bound.

The columns of all set-ups stand side by side over one set of samples, as the groups of one `planner.cover.Problem`. How
few set-ups do is looked up: all choices of so many are asked whether all their columns bring what is asked for, so that
number is exact. The choices of so many that do are covered one by one, those that can measure most first; where they
are too many, all of them are one more problem, in which a set-up costs more than all its views.

Views may have costs (seconds) in place of 1, and be so many at most; where a set-up has a cost in the same unit, its
number no longer comes first, and all together are one problem.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from cell.setups.fewest import Rows, fewest_setups
from planner import cover
from planner.cover import Cover, Problem
from planner.values import Bools, Floats, Ints

_ABOVE_ALL_VIEWS = 1000.0
"""Cost of a set-up in that of its dearest view."""

_BELOW_ALL_VIEWS = 0.01
"""The same where fewest views come first, and set-ups decide between equals."""

_EACH = 24
"""Choices of set-ups that are covered one by one; a brief answer looks at a third of them, and at no more."""


@dataclass(frozen=True, slots=True, eq=False)
class JointCover:
    """Views of several set-ups.

    Attributes:
        views: for each set-up that is used its columns, in the order that they were chosen in.
        setups_bound: no fewer set-ups reach the target.
        views_bound: no cover by so many set-ups has fewer views.
        covered_area: of the rows that have what they demand [m^2], or what they weigh.
        rows: what they need, and how much of it was asked for.
        targets: (P,) share of what all set-ups can measure of each part of the rows that was asked for.
        enough: whether so many set-ups as are allowed can measure it.
        price: cost of the views, and of the set-ups where they have one, and what no cover undercuts; None without.
        priced_setups: whether set-ups have a cost in it.
        upper_area: with so many views at most, what no other choice in so many set-ups exceeds; None without.
    """

    views: dict[int, Ints]
    setups_bound: int
    views_bound: int
    covered_area: float
    rows: Rows
    targets: Floats
    enough: bool
    price: tuple[float, float] | None = None
    priced_setups: bool = False
    upper_area: float | None = None

    @property
    def n_views(self) -> int:
        """Views of all set-ups."""
        return sum(map(len, self.views.values()))

    @property
    def size(self) -> tuple[float, ...]:
        """What is to be small: set-ups, then what views cost, or their number; what set-ups are priced with first."""
        paid = float(self.n_views) if self.price is None else self.price[0]
        area = 0.0 if self.upper_area is None else -self.covered_area
        return (area, paid) if self.priced_setups else (area, float(len(self.views)), paid)

    @property
    def share(self) -> float:
        """Of what can be measured (or promised) of the rows: has what was asked for, so many views, say."""
        can = float(self.rows.worth_of(self.rows.need > 0).sum())
        return self.covered_area / can if can > 0 else 1.0

    def with_view(self, setup: int, column: int, cost: float) -> "JointCover":
        """With one more view of a set-up that is used."""
        views = {**self.views, setup: np.append(self.views[setup], column)}
        paid = None if self.price is None else (self.price[0] + cost, self.price[1])
        return replace(self, views=views, price=paid)

    def bounded(self, by: "JointCover") -> "JointCover":
        """With what another cover proves of the same problem, or of one with more candidates."""
        return replace(
            self,
            setups_bound=min(by.setups_bound, len(self.views)),
            views_bound=min(by.views_bound, self.n_views),
            price=None if self.price is None or by.price is None else (self.price[0], min(by.price[1], self.price[0])),
            upper_area=None if by.upper_area is None else max(by.upper_area, self.covered_area),
        )

    def kept_by(self, loads: Ints) -> bool:
        """Whether views that bring (S,) loads keep what was asked for; with so many at most, what the cover has."""
        reached = self.rows.worth_of(self.rows.have(loads))
        least = self.rows.wanted if self.upper_area is None else np.array([self.covered_area])
        return bool((reached >= least * (1 - 1e-9)).all())


def joint_cover(
    wish: Problem,
    targets: Floats,
    rng: np.random.Generator,
    *,
    most: int | None = None,
    setup_cost: float | None = None,
    solver: str = "auto",
    brief: bool = False,
    start: Mapping[int, Ints] | None = None,
) -> JointCover:
    """Fewest set-ups, then fewest or cheapest views; or the most area with so many views in so few set-ups.

    Args:
        wish: the columns of all set-ups side by side, those of each a group; its coverage is not read. Pinned columns
            bring their set-ups along.
        targets: (P,) share of what all allowed columns together measure of each part of the rows.
        rng: randomness of the search.
        most: set-ups that may be used; where the target takes more, those that can measure most do what they can.
        setup_cost: of each set-up in the unit of the views' costs; the sum of all is what is to be small then.
        solver: a name in `planner.cover.SOLVERS`.
        brief: whether a short search is enough; its bound is on the choices of set-ups that it looked at.
        start: views by set-up from which the search begins where it comes to these set-ups.
    """
    rows, group = Rows(wish, targets), np.asarray(wish.group)
    first = np.searchsorted(group, np.arange(len(rows.brought)))
    fewest, members, every = fewest_setups(rows, tuple(np.unique(group[list(wish.pinned)]).tolist()), most)
    reached = [rows.reached(some) for some in members]
    enough = any(rows.short(area) == 0 for area in reached)
    if not enough:
        rows.wanted = np.minimum(rows.wanted, min(reached, key=rows.short))
    known = np.concatenate([first[row] + views for row, views in start.items()]) if start else np.empty(0, np.int64)
    asked = _Asked(wish, rows, rng, solver, cover.DEFAULT_WORK // (5 if brief else 1), known)
    largest = sorted(zip(members, reached, strict=True), key=lambda each: -float(each[1].sum()))
    found, bound = asked.of_choices([some for some, _ in largest], fewest, every=every, brief=brief)
    if setup_cost is not None:
        found, bound = asked.weighted(found, setup_cost, fewest)
    used = np.unique(group[found.views])
    covered = found.covered_area
    if wish.weights is not None and wish.max_views is None:  # the cover tells areas, and rows weigh
        loads = np.asarray(wish.matrix[:, found.views].sum(axis=1, dtype=np.int64)).ravel()
        covered = float(rows.worth_of(rows.have(loads)).sum())
    paid = asked.paid(found, setup_cost)
    return JointCover(
        views={int(setup): found.views[group[found.views] == setup] - first[setup] for setup in used},
        setups_bound=min(fewest, len(used)),
        views_bound=min(bound.views, len(found.views)),
        covered_area=covered,
        rows=rows,
        targets=targets,
        enough=enough,
        price=None if paid is None else (paid, min(bound.cost, paid)),
        priced_setups=setup_cost is not None,
        upper_area=None if wish.max_views is None else max(bound.area, covered),
    )


def views_first(wish: Problem, targets: Floats, rng: np.random.Generator) -> tuple[int, int] | None:
    """Set-ups and views by a short search for fewest views, in as few set-ups as these take: what few set-ups cost.

    None where views have costs or are so many at most, must hang together, or rows weigh or have parts.

    Args:
        wish: as of `joint_cover`.
        targets: as there.
        rng: randomness of the search.
    """
    asked = _Asked(wish, Rows(wish, targets), rng, "auto", cover.DEFAULT_WORK // 5, np.empty(0, np.int64))
    if wish.costs is not None or not asked.groups_go:
        return None
    found = asked.of(np.asarray(wish.allowed), _BELOW_ALL_VIEWS)
    return len(np.unique(np.asarray(wish.group)[found.views])), len(found.views)


@dataclass(frozen=True, slots=True)
class _Bound:
    """What no cover undercuts, and none exceeds."""

    views: int
    cost: float
    area: float

    @classmethod
    def of(cls, some: Sequence[Cover]) -> Self:
        """Of all that one of some covers answers."""
        return cls(
            min(one.lower_bound for one in some),
            min(one.cost_bound for one in some),
            max(one.upper_area for one in some),
        )


class _Asked:
    """What is asked, of some of the columns, answered by `planner.cover`."""

    def __init__(
        self, wish: Problem, rows: Rows, rng: np.random.Generator, solver: str, work: int, known: Ints
    ) -> None:
        self._wish, self._rows, self._rng, self._solver, self._known = wish, rows, rng, solver, known
        hard = wish.overlap is not None or wish.max_views is not None
        self._work = 3 * work if hard else work  # as for one plan
        self._group, self._allowed = np.asarray(wish.group), np.asarray(wish.allowed)
        self._costs = np.ones(len(self._group)) if wish.costs is None else np.asarray(wish.costs, dtype=np.float64)

    def of_choices(
        self, choices: Sequence[tuple[int, ...]], fewest: int, *, every: bool, brief: bool
    ) -> tuple[Cover, _Bound]:
        """The best cover by one of some choices of set-ups, and the bound on all; on the first few where brief.

        Args:
            choices: of so many set-ups.
            fewest: set-ups of each of them.
            every: whether no other choice does; without, the bound is on all set-ups together.
            brief: whether the first few are enough.
        """
        count = _EACH // 3 if brief else _EACH
        each = [self.of(self._allowed & np.isin(self._group, some)) for some in choices[:count]]
        bound = _Bound.of(each)
        if not every and not brief:
            bound = _Bound.of([*each, self.of(self._allowed)])
        elif len(choices) > count and not brief:
            columns = self._allowed & np.isin(self._group, sorted({setup for some in choices for setup in some}))
            free = _Bound.of([self.of(columns)])  # as if set-ups cost nothing
            if self.groups_go:
                above = _ABOVE_ALL_VIEWS * float(self._costs.max())
                each.append(self.of(columns, above))
                left = each[-1].cost_bound - above * fewest
                views = math.ceil(left - 1e-6) if self._wish.costs is None else 0
                free = replace(free, views=max(views, free.views), cost=max(left, free.cost))
            bound = _Bound(min(bound.views, free.views), min(bound.cost, free.cost), max(bound.area, free.area))
        return min(each, key=self._size), bound

    def weighted(self, known: Cover, setup_cost: float, fewest: int) -> tuple[Cover, _Bound]:
        """The cover by any set-ups, each at a cost; no dearer than one that is known."""
        self._known = known.views
        free, found = self.of(self._allowed), self.of(self._allowed, setup_cost)
        bound = _Bound.of([found])
        bound = replace(bound, cost=max(bound.cost, free.cost_bound + fewest * setup_cost))
        return min(found, known, key=lambda one: self.paid(one, setup_cost) or 0.0), bound

    def paid(self, one: Cover, setup_cost: float | None) -> float | None:
        """What views cost, and their set-ups where these have a cost; None where views are counted."""
        if self._wish.costs is None:
            return None
        return float(self._costs[one.views].sum()) + (setup_cost or 0.0) * len(np.unique(self._group[one.views]))

    @property
    def groups_go(self) -> bool:
        """Whether set-ups may have a cost in one problem (`planner.cover.targets`, `planner.cover.canonical`)."""
        wish = self._wish
        return wish.part is None and wish.weights is None and wish.max_views is None and wish.overlap is None

    def _size(self, one: Cover) -> tuple[float, ...]:
        """What is to be small."""
        setups, paid = len(np.unique(self._group[one.views])), self.paid(one, None)
        most_first = -one.covered_area if self._wish.max_views is not None else 0.0
        return most_first, setups, len(one.views) if paid is None else paid

    def of(self, columns: Bools, setup_cost: float | None = None) -> Cover:
        """Of columns (V,), as far as they bring what all would; with a cost for each set-up or none."""
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
            part=None if wish.part is None else rows.part[kept],
            part_coverage=() if wish.part is None else tuple(shares.tolist()),
            group=None if setup_cost is None else self._group[some],
            group_costs=None if setup_cost is None else np.full(len(rows.brought), setup_cost),
        )  # fmt: skip
        begin = np.searchsorted(some, self._known) if len(self._known) and columns[self._known].all() else None
        found = cover.solve(problem, rng=self._rng, solver=self._solver, budget=self._work, start=begin)
        return replace(found, views=some[found.views])
