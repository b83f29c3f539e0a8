"""Covers with groups of columns against all selections."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array

from planner.cover import Cover, CoverProblem, CoverStatus, Overlap, grouped, solve
from planner.cover.grouped import GroupedCover, GroupLoads, fewest_groups, fewest_views, solve_grouped
from planner.values import Ints
from tests.support.cover_oracle import Selections

ROWS = 14
SEEDS = st.integers(0, 10**6)


def draw(seed: int, n_groups: int, n_columns: int) -> CoverProblem:
    """Return columns of groups that each measure different rows; nine of ten are usable."""
    rng = np.random.default_rng(seed)
    dense = [(rng.random((ROWS, n_columns)) < 0.3) & (rng.random(ROWS) < 0.6)[:, None] for _ in range(n_groups)]
    return CoverProblem(
        csc_array(np.column_stack(dense)),
        rng.integers(1, 4, ROWS).astype(float),
        allowed=rng.random(n_groups * n_columns) < 0.9,
        group=np.repeat(np.arange(n_groups), n_columns),
    )


def columns_of(problem: CoverProblem, cover: GroupedCover) -> Ints:
    """Return the selected columns of all groups."""
    group = np.asarray(problem.group)
    selected = [np.flatnonzero(group == number)[views] for number, views in cover.views.items()]
    return np.concatenate([np.zeros(0, np.int64), *selected])


def solved(
    problem: CoverProblem, targets: list[float], seed: int, **options: float | int | None
) -> tuple[GroupedCover, Selections]:
    """Return the cover, checked against its own columns, and all selections with these targets."""
    cover = solve_grouped(problem, np.array(targets), np.random.default_rng(seed), **options)  # type: ignore[arg-type]
    stated = replace(problem, group_costs=None)
    if problem.max_views is None:
        coverage = tuple(targets) if problem.region is not None else ()
        stated = replace(stated, coverage=targets[0], region_coverage=coverage)
    columns = columns_of(problem, cover).tolist()
    own = Selections(stated, [columns])
    assert set(problem.pinned) <= set(columns)
    assert own.n_groups[0] == len(cover.views)
    assert own.size[0] == cover.n_views
    assert own.weight[0] == pytest.approx(cover.covered_area)
    assert own.meets_target[0] or not cover.is_feasible
    assert cover.is_met_by(problem.matrix.toarray()[:, columns].sum(axis=1))
    return cover, Selections(stated)


def best(selections: Selections, *values: np.ndarray) -> tuple[float, ...]:
    """Return the lexicographically smallest values of a feasible selection."""
    return min(tuple(float(value[k]) for value in values) for k in np.flatnonzero(selections.is_feasible))


@settings(max_examples=30)
@given(SEEDS, st.sampled_from([1.0, 0.8]), st.sampled_from([1, 1, 2]), st.integers(0, 2))
def test_the_fewest_groups_and_then_the_fewest_views_are_proven(
    seed: int, target: float, demand: int, n_pinned: int
) -> None:
    """The optimum is proven with pinned views and with a demand of two views.

    The fewest views in any groups are found too.
    """
    problem = replace(draw(seed, 3, 4), demand=demand)
    problem = replace(problem, pinned=np.flatnonzero(problem.allowed)[[1, -1][:n_pinned]].tolist())
    cover, selections = solved(problem, [target], 0)
    assert cover.is_feasible
    n_groups, n_views = best(selections, selections.n_groups, selections.size)
    assert (len(cover.views), cover.group_bound) == (n_groups, n_groups)
    assert (cover.n_views, cover.view_bound) == (n_views, n_views)
    views_first = fewest_views(problem, np.array([target]), np.random.default_rng(0))
    assert views_first is not None
    assert views_first[::-1] == best(selections, selections.size, selections.n_groups)


@settings(max_examples=12)
@given(SEEDS)
def test_costs_follow_groups_or_are_summed_with_theirs(seed: int) -> None:
    """The views are the cheapest in the fewest groups, or have the cheapest sum with a cost of groups. Bounds hold."""
    rng = np.random.default_rng(seed)
    problem = replace(draw(seed, 3, 4), costs=rng.integers(1, 9, 12).astype(float))
    for group_cost in (None, 6.0):
        cover, selections = solved(problem, [0.8], 0, group_cost=group_cost)
        total = selections.cost + (group_cost or 0.0) * selections.n_groups
        keys = (total,) if group_cost else (selections.n_groups, total)
        assert cover.cost_and_bound is not None
        cost, bound = cover.cost_and_bound
        assert cost == pytest.approx(best(selections, *keys)[-1])
        assert cost * (1 - 1e-3) <= bound <= cost + 1e-9
    loads = GroupLoads(problem, np.array([0.8]))
    fewest, choices, is_complete = fewest_groups(loads, (), None)
    covers = grouped._GroupCovers(problem, loads, rng, "auto", None)
    found, alone = covers.best_of(choices, np.empty(0, np.int64), is_complete=is_complete, fast=False)
    assert (
        alone.cost <= best(selections, selections.n_groups, selections.cost)[1] + 1e-9
    )  # not limited by the found cost
    assert covers.with_group_costs(found, 6.0, fewest, 1.0)[1].cost <= best(selections, total)[0] + 1e-9


@settings(max_examples=12)
@given(SEEDS)
def test_the_most_area_of_a_number_of_views(seed: int) -> None:
    """The area is the largest in as few groups as could meet the target, and the bound equals it."""
    problem = replace(draw(seed, 4, 3), max_views=3)
    cover, selections = solved(problem, [0.8], 0)
    count, choices, _ = fewest_groups(GroupLoads(problem, np.array([0.8])), (), None)
    group = np.asarray(problem.group)[selections.usable]
    inside = [~selections.selected[:, ~np.isin(group, choice)].any(axis=1) for choice in choices]
    most = selections.area[selections.is_feasible & np.any(inside, axis=0)].max()
    assert cover.covered_area == pytest.approx(most)
    assert cover.upper_area == pytest.approx(most)
    assert len(cover.views) <= count


@settings(max_examples=12)
@given(SEEDS)
def test_regions_have_targets_of_their_own(seed: int) -> None:
    """All of one region and half of the other are covered in the fewest groups."""
    problem = replace(draw(seed, 3, 4), region=np.arange(ROWS) % 2)
    cover, selections = solved(problem, [1.0, 0.5], 0)
    n_groups, n_views = best(selections, selections.n_groups, selections.size)
    assert len(cover.views) == cover.group_bound == n_groups
    assert cover.view_bound <= n_views <= cover.n_views


@pytest.mark.parametrize("seed", range(3))
def test_views_of_all_groups_are_connected(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The overlap graph may connect views of different groups, and no bound is above the optimum."""
    monkeypatch.setattr(grouped, "DEFAULT_EFFORT", grouped.DEFAULT_EFFORT // 10)  # for twelve columns
    monkeypatch.setattr(grouped, "N_THOROUGH", 1)  # so that all choices are bounded together
    problem = replace(draw(160 + seed, 3, 4), overlap=Overlap(area=0.5))
    cover, selections = solved(problem, [0.7], 0)
    if Selections(problem, [columns_of(problem, cover).tolist()]).is_connected[0]:  # otherwise no choice of groups is
        n_groups, n_views = best(selections, selections.n_groups, selections.size)
        assert (cover.group_bound, cover.view_bound) <= (n_groups, n_views)
        assert len(cover.views) == n_groups
        assert n_views <= cover.n_views <= n_views + 1


@pytest.mark.parametrize(("seed", "n_covered"), [(0, 1), (1, 1), (2, 100), (3, 100)])
def test_many_choices_are_bounded_together(seed: int, n_covered: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of groups is exact and the bound on views is valid.

    With all choices covered, the views are the fewest.
    """
    monkeypatch.setattr(grouped, "N_COVERED", 1)
    monkeypatch.setattr(grouped, "N_COVERED_MORE", n_covered)
    cover, selections = solved(draw(100 + seed, 4, 3), [0.75], 0)
    n_groups, n_views = best(selections, selections.n_groups, selections.size)
    assert (len(cover.views), cover.group_bound) == (n_groups, n_groups)
    assert cover.view_bound <= n_views <= cover.n_views
    assert n_covered == 1 or cover.n_views == n_views


@pytest.mark.parametrize(("seed", "max_groups"), [(0, None), (1, None), (2, 2), (3, 2)])
def test_more_choices_than_can_be_enumerated(
    seed: int, max_groups: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit on groups holds, and no bound is above that of all choices."""
    monkeypatch.setattr(grouped, "MAX_ENUMERATED", 0)
    problem = draw(200 + seed, 5, 2)
    cover, selections = solved(problem, [0.9], 0, max_groups=max_groups)
    enough = selections.weight >= float(cover.loads.target_weight[0]) - 1e-9
    assert cover.group_bound <= selections.n_groups[enough].min() <= len(cover.views) <= (max_groups or 5)
    assert cover.view_bound <= selections.size[enough].min()


def test_ctrl_c_ends_the_search_for_all_choices(monkeypatch: pytest.MonkeyPatch) -> None:
    """The covers after the interrupted one get no effort; the result is a cover with valid bounds."""
    efforts: list[int] = []

    def interrupted(*arguments: Any, effort_budget: int, **options: Any) -> Cover:
        efforts.append(effort_budget)
        answer = solve(*arguments, effort_budget=effort_budget, **options)
        return replace(answer, status=CoverStatus.INTERRUPTED) if len(efforts) == 2 else answer

    monkeypatch.setattr(grouped, "solve", interrupted)
    cover, selections = solved(draw(101, 4, 3), [0.75], 0)
    assert len(efforts) > 2
    assert min(efforts[:2]) > 0 == max(efforts[2:])
    n_groups, n_views = best(selections, selections.n_groups, selections.size)
    assert (len(cover.views), cover.group_bound) == (n_groups, n_groups)
    assert cover.view_bound <= n_views <= cover.n_views


@pytest.mark.parametrize("seed", range(2))
def test_the_share_counts_weights(seed: int) -> None:
    """The share is that of the weights if rows have weights in place of their areas.

    If the target needs more groups than allowed, the group with the largest weight is covered.
    """
    problem = draw(seed, 3, 4)
    weights = np.asarray(problem.areas) * np.where(np.arange(ROWS) % 2, 5.0, 1.0)
    cover, selections = solved(replace(problem, weights=weights), [0.8], 0)
    assert cover.share == pytest.approx(cover.covered_area / selections.weight.max())
    assert cover.share >= 0.8 - 1e-9
    one, selections = solved(replace(problem, weights=weights), [1.0], 0, max_groups=1)
    assert len(one.views) == 1
    assert not one.is_feasible
    assert one.covered_area == pytest.approx(selections.weight[selections.n_groups == 1].max())


@pytest.mark.parametrize("required", [(), (3,)])
def test_the_choices_of_groups_are_complete(required: tuple[int, ...]) -> None:
    """The choices are exactly the smallest subsets that reach the area and contain the required groups."""
    rng = np.random.default_rng(5)
    measurable, areas = rng.random((7, 60)) < 0.45, rng.random(60)
    problem = CoverProblem(csc_array(measurable.T), areas, allowed=np.ones(7, dtype=bool), group=np.arange(7))
    target = 0.9 * float(areas[measurable.any(axis=0)].sum())
    count, choices, is_complete = fewest_groups(GroupLoads(problem, np.array([0.9])), required, None)
    assert is_complete
    subsets = [set(some) for size in range(1, count + 1) for some in combinations(range(7), size)]
    enough = [some for some in subsets if areas[measurable[list(some)].any(axis=0)].sum() >= target]
    assert {frozenset(choice) for choice in choices} == {frozenset(some) for some in enough if set(required) <= some}
