"""The cover over all set-ups: fewest set-ups, then fewest views, each with a bound.

The columns of all set-ups stand side by side over one set of samples. How few set-ups do is looked up: all unions of
so many set-ups are asked whether they reach the area, so that number is exact. The choices of so many that do are
covered one by one, those that can measure most first; where they are too many, all of them are one more problem, in
which a set-up is a group of columns with a cost above that of all its views together.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import hstack

from planner import cover
from planner.cover import Problem
from planner.measurability.matrix import Measurability
from planner.values import Bools, Floats, Ints

_ABOVE_ALL_VIEWS = 1000.0
"""Cost of a set-up where a view costs 1."""

_EACH = 24
"""Choices of set-ups that are covered one by one; of a brief answer a third."""

_LOOKED_AT = 200_000
"""Unions of set-ups that are looked at for the fewest; beyond, the bound is what was shown until then."""


@dataclass(frozen=True, slots=True, eq=False)
class JointCover:
    """Views of several set-ups.

    Attributes:
        views: for each set-up that is used its columns, in the order that they were chosen in.
        setups_bound: no fewer set-ups reach the target.
        views_bound: no cover by so many set-ups has fewer views.
        covered_area: of the rows that they measure [m^2].
        wanted_area: that was asked for [m^2].
        target: share of what all set-ups can measure of the rows that was asked for.
        enough: whether so many set-ups as are allowed can measure it.
    """

    views: dict[int, Ints]
    setups_bound: int
    views_bound: int
    covered_area: float
    wanted_area: float
    target: float
    enough: bool

    @property
    def n_views(self) -> int:
        """Views of all set-ups."""
        return sum(map(len, self.views.values()))


def joint_cover(
    matrices: Sequence[Measurability],
    usable: Sequence[Bools],
    target: float,
    rng: np.random.Generator,
    *,
    most: int | None = None,
    brief: bool = False,
    start: Mapping[int, Ints] | None = None,
) -> JointCover:
    """Fewest set-ups, then fewest views.

    Args:
        matrices: of each set-up, over the same rows.
        usable: for each set-up (V,) columns that may be chosen.
        target: share of what all usable columns together measure of the rows' area.
        rng: randomness of the search.
        most: set-ups that may be used; where the target takes more, those that can measure most do what they can.
        brief: whether a short search is enough, and a weaker bound.
        start: views by set-up from which the search begins where it comes to these set-ups.
    """
    areas = matrices[0].features.areas
    can = np.stack([M.matrix() @ use.astype(np.int32) > 0 for M, use in zip(matrices, usable, strict=True)])
    wanted = target * float(areas[can.any(axis=0)].sum())
    fewest, members = fewest_setups(can, areas, wanted, most)
    joined = hstack([M.matrix() for M in matrices], format="csr")
    group = np.repeat(np.arange(len(matrices)), [M.n_viewpoints for M in matrices])
    first = np.concatenate([[0], np.cumsum([M.n_viewpoints for M in matrices])])
    allowed = np.concatenate(list(usable)) & np.isin(group, sorted({each for some in members for each in some}))
    asked, wanted = wanted, min(wanted, max(float(areas[can[list(some)].any(axis=0)].sum()) for some in members))

    known = np.concatenate([first[row] + views for row, views in start.items()]) if start else np.empty(0, np.int64)

    def solved(columns: Bools, work: int, *, grouped: bool = False) -> cover.Cover:
        reach = float(areas[joined @ columns.astype(np.int32) > 0].sum())
        problem = Problem(
            joined, areas, columns, coverage=min(1.0, wanted / reach), group=group if grouped else None,
            group_costs=np.full(len(matrices), _ABOVE_ALL_VIEWS) if grouped else None,
        )  # fmt: skip
        begin = known if len(known) and columns[known].all() else None
        return cover.solve(problem, rng=rng, budget=work, start=begin)

    work, count = (cover.DEFAULT_WORK // 5, _EACH // 3) if brief else (cover.DEFAULT_WORK, _EACH)
    largest = sorted(members, key=lambda some: -float(areas[can[list(some)].any(axis=0)].sum()))
    each = [solved(allowed & np.isin(group, some), work) for some in largest[:count]]
    bound = min(one.lower_bound for one in each)
    if len(members) > count:
        each.append(solved(allowed, work, grouped=True))
        of_all = math.ceil(each[-1].cost_bound - 1e-6) - int(_ABOVE_ALL_VIEWS) * fewest
        free = solved(allowed, work).lower_bound  # as if set-ups cost nothing
        bound = min(bound, max(of_all, free))
    found = min(each, key=lambda one: (len(np.unique(group[one.views])), len(one.views)))
    used = np.unique(group[found.views])
    views = {int(setup): found.views[group[found.views] == setup] - first[setup] for setup in used}
    return JointCover(
        views=views,
        setups_bound=min(fewest, len(used)),
        views_bound=min(bound, len(found.views)),
        covered_area=found.covered_area,
        wanted_area=wanted,
        target=target,
        enough=wanted >= asked,
    )


def fewest_setups(can: Bools, areas: Floats, wanted: float, most: int | None) -> tuple[int, list[tuple[int, ...]]]:
    """How many set-ups it takes at least, and all choices of so many that do.

    Args:
        can: (G, S) which samples each set-up can measure.
        areas: (S,) of them [m^2].
        wanted: area that is asked for [m^2].
        most: set-ups that may be used; None: any number.

    Returns:
        The number and the choices; where no choice of `most` does, the one that measures most alone. Where the fewest
        is more than can be looked at, a number that none has less than, with the set-ups of a greedy choice.
    """
    reach = wanted * (1 - 1e-12)
    looked, greedy = 0, _greedy(can, areas, reach)
    for count in range(1, min(len(can), len(greedy), most or len(can)) + 1):
        unions = {
            some: float(areas[can[list(some)].any(axis=0)].sum()) for some in combinations(range(len(can)), count)
        }
        enough = [some for some, area in unions.items() if area >= reach]
        if enough:
            return count, enough
        if count == most:
            return count, [max(unions, key=lambda some: unions[some])]
        looked += len(unions)
        if looked > _LOOKED_AT:
            return count + 1, [greedy]
    return len(greedy), [greedy]


def _greedy(can: Bools, areas: Floats, wanted: float) -> tuple[int, ...]:
    """Set-ups, each adding most, until the area is reached."""
    chosen: list[int] = []
    left = np.ones(can.shape[1], dtype=np.bool_)
    while float(areas[~left].sum()) < wanted:
        chosen.append(int(np.argmax((can & left) @ areas)))
        left &= ~can[chosen[-1]]
    return tuple(chosen)
