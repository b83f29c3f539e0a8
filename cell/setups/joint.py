"""The cover over all set-ups: fewest set-ups, then fewest views, each with a bound.

The columns of all set-ups stand side by side over one set of samples, as the groups of one
`planner.cover.CoverProblem`. How few set-ups do is looked up: all choices of so many are asked whether all their
columns bring what is asked for, so that number is exact. How the choices of so many that do are covered:
`cell.setups.choices`.

Views may have costs (seconds) in place of 1, and be so many at most; where a set-up has a cost in the same unit, its
number no longer comes first, and all together are one problem.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cell.setups.choices import SHORT, Choices
from cell.setups.fewest import Rows, fewest_setups
from planner.cover import CoverProblem
from planner.values import Floats, Ints

_BELOW_ALL_VIEWS = 0.01
"""Cost of a set-up in that of its dearest view where fewest views come first, and set-ups decide between equals."""


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
    wish: CoverProblem,
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
    asked = Choices(wish, rows, rng, solver)
    largest = sorted(zip(members, reached, strict=True), key=lambda each: -float(each[1].sum()))
    found, bound = asked.of_choices([some for some, _ in largest], known, every=every, brief=brief)
    if setup_cost is not None:
        found, bound = asked.weighted(found, setup_cost, fewest, SHORT if brief else 1.0)
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


def views_first(wish: CoverProblem, targets: Floats, rng: np.random.Generator) -> tuple[int, int] | None:
    """Set-ups and views by a short search for fewest views, in as few set-ups as these take: what few set-ups cost.

    None where views have costs or are so many at most, must hang together, or rows weigh or have parts.

    Args:
        wish: as of `joint_cover`.
        targets: as there.
        rng: randomness of the search.
    """
    asked = Choices(wish, Rows(wish, targets), rng, "auto")
    if wish.costs is not None or not asked.groups_go:
        return None
    found = asked.of(np.asarray(wish.allowed), SHORT, setup_cost=_BELOW_ALL_VIEWS)
    return len(np.unique(np.asarray(wish.group)[found.views])), len(found.views)
