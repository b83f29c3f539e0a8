"""The cover over several set-ups against all choices of views."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.sparse import csc_array

from planner.cover import CoverProblem, Overlap, grouped
from planner.cover.grouped import GroupedCover, GroupLoads, fewest_groups, fewest_views, solve_grouped
from planner.values import Bools

ROWS = 14


def _wish(rng: np.random.Generator, setups: int, columns: int) -> CoverProblem:
    """Columns of all set-ups, each of which measures other rows; nine of ten are usable."""
    dense = np.column_stack(
        [(rng.random((ROWS, columns)) < 0.3) & (rng.random(ROWS) < 0.6)[:, None] for _ in range(setups)]
    )
    areas = rng.integers(1, 4, ROWS).astype(float)
    group = np.repeat(np.arange(setups), columns)
    return CoverProblem(csc_array(dense), areas, allowed=rng.random(setups * columns) < 0.9, group=group)


def _best(wish: CoverProblem, size: Callable[[list[int], Bools], tuple[float, ...] | None]) -> tuple[float, ...]:
    """The smallest size of all choices of usable columns; None is none. Told (S,) rows that have what they need."""
    dense, usable = wish.matrix.toarray(), np.flatnonzero(wish.allowed)
    need = np.minimum(dense[:, usable].sum(axis=1), wish.demand)
    found = []
    for count in range(1, len(usable) + 1):
        for some in combinations(usable.tolist(), count):
            if set(wish.pinned) <= set(some):
                told = size(list(some), (need > 0) & (dense[:, list(some)].sum(axis=1) >= need))
                found += [] if told is None else [told]
    return min(found)


def _wanted(wish: CoverProblem, target: float) -> float:
    dense = wish.matrix.toarray()[:, wish.allowed]
    return target * float(np.asarray(wish.areas)[dense.any(axis=1)].sum())


def _checked(wish: CoverProblem, found: GroupedCover) -> None:
    """The views are usable, contain the pinned ones, and cover what is said."""
    group, dense = np.asarray(wish.group), wish.matrix.toarray()
    columns = np.concatenate([np.flatnonzero(group == setup)[views] for setup, views in found.views.items()])
    assert np.asarray(wish.allowed)[columns].all()
    assert set(wish.pinned) <= set(columns.tolist())
    need = np.minimum(dense[:, wish.allowed].sum(axis=1), wish.demand)
    has = (need > 0) & (dense[:, columns].sum(axis=1) >= need)
    assert np.asarray(wish.areas)[has].sum() >= found.covered_area - 1e-9
    assert found.is_met_by(dense[:, columns].sum(axis=1))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("wished", ["plain", "pinned", "twice"])
def test_fewest_setups_and_then_fewest_views(seed: int, wished: str) -> None:
    """Both numbers are the best there is; pinned views are taken, and rows may need two views of any set-ups."""
    wish = _wish(np.random.default_rng(seed), 3, 4)
    if wished == "pinned":
        wish = replace(wish, pinned=np.flatnonzero(wish.allowed)[[1, -1]].tolist())
    if wished == "twice":
        wish = replace(wish, demand=2)
    target, group = (1.0, 0.8)[seed % 2], np.asarray(wish.group)
    found = solve_grouped(wish, np.array([target]), np.random.default_rng(0))

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        enough = np.asarray(wish.areas)[has].sum() >= _wanted(wish, target) - 1e-9
        return (len(set(group[some])), len(some)) if enough else None

    setups, views = _best(wish, size)
    assert (len(found.views), found.group_bound) == (setups, setups)
    assert (found.n_views, found.view_bound) == (views, views)
    assert found.is_feasible
    _checked(wish, found)
    first = fewest_views(wish, np.array([target]), np.random.default_rng(0))
    assert first is not None
    least = _best(wish, lambda some, has: (told := size(some, has)) and told[::-1])
    assert first == least[::-1]


@pytest.mark.parametrize("seed", range(8))
def test_seconds_come_after_set_ups_or_with_them(seed: int) -> None:
    """The cheapest views in the fewest set-ups; where a set-up has a price, the cheapest sum, and no bound above it."""
    rng = np.random.default_rng(50 + seed)
    wish = _wish(rng, 3, 4)
    wish = replace(wish, costs=rng.integers(1, 9, 12).astype(float))
    costs, group = np.asarray(wish.costs), np.asarray(wish.group)
    for each in (None, 6.0):
        found = solve_grouped(wish, np.array([0.8]), np.random.default_rng(0), group_cost=each)

        def size(some: list[int], has: Bools, each: float | None = each) -> tuple[float, ...] | None:
            if np.asarray(wish.areas)[has].sum() < _wanted(wish, 0.8) - 1e-9:
                return None
            setups = len(set(group[some]))
            paid = float(costs[some].sum())
            return (setups, paid) if each is None else (paid + each * setups,)

        assert found.price is not None
        assert found.price[0] == pytest.approx(_best(wish, size)[-1])
        assert found.price[1] <= found.price[0] + 1e-9
        assert found.price[1] >= found.price[0] * (1 - 1e-3)
        _checked(wish, found)


@pytest.mark.parametrize("seed", range(8))
def test_what_bounds_seconds_is_no_more_than_the_optimum(seed: int) -> None:
    """By itself, not held to what was found."""
    rng = np.random.default_rng(50 + seed)
    wish = replace(_wish(rng, 3, 4), costs=rng.integers(1, 9, 12).astype(float))
    costs, group = np.asarray(wish.costs), np.asarray(wish.group)

    def paid(some: list[int], has: Bools) -> tuple[float, ...] | None:
        if np.asarray(wish.areas)[has].sum() < _wanted(wish, 0.8) - 1e-9:
            return None
        setups = len(set(group[some]))
        return setups, float(costs[some].sum()), float(costs[some].sum()) + 6.0 * setups

    rows = GroupLoads(wish, np.array([0.8]))
    fewest, members, every = fewest_groups(rows, (), None)
    asked = grouped._GroupCovers(wish, rows, rng, "auto")
    found, bound = asked.best_of(members, np.empty(0, np.int64), is_complete=every, fast=False)
    assert bound.cost <= _best(wish, paid)[1] + 1e-9
    priced = asked.with_group_costs(found, 6.0, fewest, 1.0)[1]
    assert priced.cost <= _best(wish, lambda some, has: (told := paid(some, has)) and told[2:])[0] + 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_the_most_area_with_so_many_views(seed: int) -> None:
    """In as few set-ups as could measure what is asked for with all their views; the bound is no less."""
    wish = replace(_wish(np.random.default_rng(80 + seed), 4, 3), max_views=3)
    found = solve_grouped(wish, np.array([0.8]), np.random.default_rng(0))
    rows, group = GroupLoads(wish, np.array([0.8])), np.asarray(wish.group)
    count, members, _ = fewest_groups(rows, (), None)

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        inside = any(set(group[some]) <= set(each) for each in members)
        return (-float(np.asarray(wish.areas)[has].sum()),) if len(some) <= 3 and inside else None

    assert found.covered_area == pytest.approx(-_best(wish, size)[0])
    assert found.upper_area == pytest.approx(found.covered_area)
    assert len(found.views) <= count
    assert found.n_views <= 3


@pytest.mark.parametrize("seed", range(8))
def test_parts_of_the_rows_have_targets_of_their_own(seed: int) -> None:
    """All of one part and half of the other, in the fewest set-ups; the bound on views is one."""
    rng = np.random.default_rng(120 + seed)
    wish = replace(_wish(rng, 3, 4), region=np.arange(ROWS) % 2)
    targets, areas, group = np.array([1.0, 0.5]), np.asarray(wish.areas), np.asarray(wish.group)
    can = wish.matrix.toarray()[:, wish.allowed].any(axis=1)
    wanted = [float(share * areas[can & (np.arange(ROWS) % 2 == part)].sum()) for part, share in enumerate(targets)]

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        reached = [float(areas[has & (np.arange(ROWS) % 2 == part)].sum()) for part in range(2)]
        return (len(set(group[some])), len(some)) if np.all(np.array(reached) >= np.array(wanted) - 1e-9) else None

    found = solve_grouped(wish, targets, np.random.default_rng(0))
    setups, views = _best(wish, size)
    assert len(found.views) == found.group_bound == setups
    assert found.view_bound <= views <= found.n_views
    _checked(wish, found)


@pytest.mark.parametrize("seed", range(6))
def test_views_of_all_set_ups_hang_together(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One chain of views that share a row, whichever set-up each is of; no bound is above the best."""
    monkeypatch.setattr(grouped, "DEFAULT_EFFORT", grouped.DEFAULT_EFFORT // 10)  # for twelve columns
    monkeypatch.setattr(grouped, "N_THOROUGH", 1)  # so that they are bounded together
    wish = replace(_wish(np.random.default_rng(160 + seed), 3, 4), overlap=Overlap(area=0.5))
    dense, group = wish.matrix.toarray(), np.asarray(wish.group)

    def hang(some: list[int]) -> bool:
        joined, left = {some[0]}, set(some[1:])
        while near := {one for one in left if any((dense[:, one] & dense[:, other]).any() for other in joined)}:
            joined, left = joined | near, left - near
        return not left

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        enough = np.asarray(wish.areas)[has].sum() >= _wanted(wish, 0.7) - 1e-9
        return (len(set(group[some])), len(some)) if enough and hang(some) else None

    found = solve_grouped(wish, np.array([0.7]), np.random.default_rng(0))
    columns = np.concatenate([np.flatnonzero(group == setup)[views] for setup, views in found.views.items()])
    if hang(columns.tolist()):  # else no choice of so few set-ups does
        setups, views = _best(wish, size)
        assert (found.group_bound, found.view_bound) <= (setups, views)
        assert len(found.views) == setups
        assert views <= found.n_views <= views + 1


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("looked_at", [1, 100])
def test_many_choices_are_bounded_together(seed: int, looked_at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one choice is covered by itself, the number of set-ups stays exact and the bound on views a bound.

    Where all are looked at, so many views are the fewest.
    """
    monkeypatch.setattr(grouped, "N_COVERED", 1)
    monkeypatch.setattr(grouped, "N_COVERED_MORE", looked_at)
    wish = _wish(np.random.default_rng(100 + seed), 4, 3)
    group = np.asarray(wish.group)
    found = solve_grouped(wish, np.array([0.75]), np.random.default_rng(0))

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        enough = np.asarray(wish.areas)[has].sum() >= _wanted(wish, 0.75) - 1e-9
        return (len(set(group[some])), len(some)) if enough else None

    setups, views = _best(wish, size)
    assert (len(found.views), found.group_bound) == (setups, setups)
    assert found.view_bound <= views <= found.n_views
    assert looked_at == 1 or found.n_views == views
    _checked(wish, found)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("most", [None, 2])
def test_more_choices_than_can_be_looked_at(seed: int, most: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """No more set-ups than are allowed are used then, and neither bound is above what all choices would show."""
    monkeypatch.setattr(grouped, "MAX_ENUMERATED", 0)
    wish = _wish(np.random.default_rng(200 + seed), 5, 2)
    group, dense = np.asarray(wish.group), wish.matrix.toarray()
    found = solve_grouped(wish, np.array([0.9]), np.random.default_rng(0), max_groups=most)
    wanted = float(found.loads.wanted[0])

    def size(some: list[int], has: Bools) -> tuple[float, ...] | None:
        enough = np.asarray(wish.areas)[has].sum() >= wanted - 1e-9
        return (len(set(group[some])), len(some)) if enough else None

    setups, _ = _best(wish, size)
    views, _ = _best(wish, lambda some, has: None if size(some, has) is None else (len(some), 0))
    assert found.group_bound <= setups <= len(found.views) <= (most or len(dense))
    assert found.view_bound <= views
    _checked(wish, found)


@pytest.mark.parametrize("seed", range(4))
def test_the_share_that_is_kept_is_of_what_rows_weigh(seed: int) -> None:
    """Where rows weigh more than their area, that is what they count in the share too."""
    wish = _wish(np.random.default_rng(seed), 3, 4)
    weights = np.asarray(wish.areas) * np.where(np.arange(ROWS) % 2, 5.0, 1.0)
    found = solve_grouped(replace(wish, weights=weights), np.array([0.8]), np.random.default_rng(0))
    group, dense = np.asarray(wish.group), wish.matrix.toarray()
    columns = np.concatenate([np.flatnonzero(group == setup)[views] for setup, views in found.views.items()])
    has, can = (dense[:, some].any(axis=1) for some in (columns, np.asarray(wish.allowed)))
    assert found.share == pytest.approx(weights[has].sum() / weights[can].sum())
    assert found.share >= 0.8 - 1e-9


def test_one_set_up_alone_does_what_it_can() -> None:
    """Where more set-ups would be needed than are allowed, the one that can measure most is covered."""
    wish = _wish(np.random.default_rng(1), 3, 4)
    found = solve_grouped(wish, np.array([1.0]), np.random.default_rng(0), max_groups=1)
    dense = wish.matrix.toarray() & wish.allowed
    can = [np.asarray(wish.areas)[dense[:, np.asarray(wish.group) == row].any(axis=1)].sum() for row in range(3)]
    assert list(found.views) == [int(np.argmax(can))]
    assert not found.is_feasible
    assert found.covered_area == pytest.approx(max(can))


def test_choices_of_set_ups_are_all_that_reach_the_area() -> None:
    """Against all subsets of the fewest; those that must be used are in each."""
    rng = np.random.default_rng(5)
    can, areas = rng.random((7, 60)) < 0.45, rng.random(60)
    wish = CoverProblem(csc_array(can.T), areas, allowed=np.ones(7, dtype=bool), group=np.arange(7))
    wanted = 0.9 * float(areas[can.any(axis=0)].sum())
    for must in ((), (3,)):
        count, members, every = fewest_groups(GroupLoads(wish, np.array([0.9])), must, None)
        assert every
        enough = {
            size: {
                some
                for some in combinations(range(7), size)
                if set(must) <= set(some) and areas[can[list(some)].any(axis=0)].sum() >= wanted
            }
            for size in range(1, count + 1)
        }
        assert set(members) == enough[count]
        assert not any(enough[size] for size in range(1, count))
