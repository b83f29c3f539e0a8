"""Several area targets, demands and weights: against enumeration of every choice of few columns."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner import cover
from planner.cover import CoverProblem, CoverStatus, Overlap
from planner.errors import PlannerError


def drawn(seed: int, rows: int = 14, columns: int = 8) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """A random matrix, areas, and the generator."""
    rng = np.random.default_rng(seed)
    return rng.random((rows, columns)) < 0.35, rng.uniform(0.5, 2.0, rows), rng


def meets(problem: CoverProblem, views: tuple[int, ...]) -> bool:
    """Whether a choice has, of every part, the share of its coverable worth."""
    matrix, part = np.asarray(problem.matrix, dtype=int), np.asarray(problem.region)
    worth = np.asarray(problem.areas if problem.weights is None else problem.weights)
    available = matrix.sum(axis=1)
    enough = (matrix[:, list(views)].sum(axis=1) >= np.minimum(problem.demand, available)) & (available > 0)
    return all(
        worth[enough & (part == g)].sum() >= share * worth[(available > 0) & (part == g)].sum() - 1e-9
        for g, share in enumerate(problem.region_coverage)
    )


def fewest(problem: CoverProblem) -> int:
    """By enumeration."""
    columns = np.shape(problem.matrix)[1]
    return next(
        n for n in range(columns + 1) if any(meets(problem, some) for some in itertools.combinations(range(columns), n))
    )


@given(st.integers(0, 10**6))
def test_every_target_is_met_and_the_bound_holds(seed: int) -> None:
    """Three parts of different shares, demands by row: no fewer views would do than the bound says."""
    matrix, areas, rng = drawn(seed)
    problem = CoverProblem(
        matrix, areas, demand=rng.integers(1, 3, len(areas)), region=rng.integers(0, 3, len(areas)),
        region_coverage=(0.9, float(rng.choice([0.5, 0.7])), float(rng.choice([0.3, 1.0]))),
    )  # fmt: skip
    found = cover.solve(problem, rng=np.random.default_rng(0))
    assert meets(problem, tuple(found.views.tolist()))
    optimum = fewest(problem)
    assert found.lower_bound <= optimum <= len(found.views) <= optimum + 1
    if found.status is CoverStatus.PROVEN:
        assert len(found.views) == optimum
    assert found.marginal_area.sum() == pytest.approx(found.covered_area)


@given(st.integers(0, 10**6))
def test_one_part_with_slack_beside_full_ones_is_exact(seed: int) -> None:
    """Parts that must be whole are, at the fewest views, proven."""
    matrix, areas, rng = drawn(seed)
    problem = CoverProblem(matrix, areas, region=rng.integers(0, 3, len(areas)), region_coverage=(1.0, 0.6, 1.0))
    found = cover.solve(problem, rng=np.random.default_rng(0))
    assert meets(problem, tuple(found.views.tolist()))
    assert found.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE)
    assert len(found.views) == fewest(problem)


@given(st.integers(0, 10**6))
def test_weights_decide_and_areas_are_told(seed: int) -> None:
    """A share of the weight is met with the fewest views; the answer's areas are the rows' own."""
    matrix, areas, rng = drawn(seed)
    weights = areas * rng.choice([0.1, 1.0, 10.0], len(areas))
    problem = CoverProblem(matrix, areas, coverage=0.8, weights=weights)
    found = cover.solve(problem, rng=np.random.default_rng(0))
    same = CoverProblem(matrix, areas, weights=weights, region=np.zeros(len(areas), int), region_coverage=(0.8,))
    assert meets(same, tuple(found.views.tolist()))
    assert len(found.views) == fewest(same)
    assert found.total_area == pytest.approx(areas.sum())
    assert found.coverable_area == pytest.approx(areas[matrix.any(axis=1)].sum())


def test_demands_of_rows_are_those_of_all_where_they_are_equal() -> None:
    """An array of one number is that number."""
    matrix, areas, _ = drawn(3)
    one = cover.solve(CoverProblem(matrix, areas, demand=2), rng=np.random.default_rng(0))
    other = cover.solve(CoverProblem(matrix, areas, demand=np.full(len(areas), 2)), rng=np.random.default_rng(0))
    assert (one.views == other.views).all()
    assert one.demand == other.demand == 2


@pytest.mark.parametrize(
    ("wishes", "said"),
    [
        ({"demand": np.ones(3, dtype=int)}, "shape"),
        ({"demand": np.zeros(14, dtype=int)}, "at least once"),
        ({"region": np.full(14, 2), "region_coverage": (0.5, 0.5)}, "from 0 to 1"),
        ({"region": np.zeros(14, int), "region_coverage": (1.5,)}, "from 0 to 1"),
        ({"weights": -np.ones(14)}, "finite numbers"),
        ({"region": np.zeros(14, int), "region_coverage": (0.5,), "max_views": 2}, "maximises the area"),
    ],
)
def test_what_contradicts_itself_is_refused(wishes: dict, said: str) -> None:
    """One sentence each."""
    matrix, areas, _ = drawn(0)
    with pytest.raises(PlannerError, match=said):
        cover.solve(CoverProblem(matrix, areas, **wishes), rng=np.random.default_rng(0))


@given(st.integers(0, 10**6))
def test_a_beginning_that_meets_all_targets_is_not_lost(seed: int) -> None:
    """Without work to search, the answer has no more views than a choice that is known, and the bound stays true."""
    matrix, areas, rng = drawn(seed, rows=60, columns=40)
    problem = CoverProblem(matrix & (rng.random(matrix.shape) < 0.4), areas, region=rng.integers(0, 3, 60),
                      region_coverage=(0.9, 0.7, 0.8))  # fmt: skip
    known = cover.solve(problem, rng=np.random.default_rng(0), effort_budget=20_000_000)
    again = cover.solve(problem, rng=np.random.default_rng(0), effort_budget=1, start=known.views)
    assert meets(problem, tuple(again.views.tolist()))
    assert len(again.views) <= len(known.views)
    assert again.lower_bound <= len(known.views)


@pytest.mark.parametrize("wish", [{"overlap": Overlap(share=0.2)}, {"group": np.zeros(8, int), "group_costs": [1.0]}])
@pytest.mark.parametrize(
    "targets", [{"weights": np.ones(14)}, {"region": np.zeros(14, int), "region_coverage": (0.5,)}]
)
def test_what_is_said_of_areas_or_groups_is_not_answered_by_weights(wish: dict, targets: dict) -> None:
    """Weighted rows would be taken for the area that views share."""
    matrix, areas, rng = drawn(0)
    with pytest.raises(PlannerError, match="cannot be combined with overlap or groups"):
        cover.solve(CoverProblem(matrix, areas, **wish, **targets), rng=rng)


def test_a_beginning_that_may_not_be_taken_is_not() -> None:
    """One with a banned view, one with a view that is not allowed, one without a pinned one: each would be cheaper."""
    matrix = np.ones((4, 3), dtype=bool)
    matrix[:2, 1] = matrix[2:, 2] = False
    problem = CoverProblem(matrix, np.ones(4), region=np.array([0, 0, 1, 1]), region_coverage=(0.9, 0.9))
    without = np.array([False, True, True])
    for wish in ({"banned": [0]}, {"allowed": without}, {"pinned": [1]}):
        asked = replace(problem, **wish)  # type: ignore[arg-type]
        found = cover.solve(asked, rng=np.random.default_rng(0), effort_budget=1, start=np.array([0]))
        assert sorted(found.views.tolist()) == ([0, 1] if "pinned" in wish else [1, 2])


def test_the_bound_on_the_cost_is_told_with_weights_too() -> None:
    """As proven of the weights; the areas in which the answer is told have none of their own."""
    matrix, areas, rng = drawn(5)
    costs = rng.uniform(1.0, 5.0, matrix.shape[1])
    found = cover.solve(CoverProblem(matrix, areas, weights=areas**2, costs=costs), rng=np.random.default_rng(0))
    assert found.status is CoverStatus.PROVEN
    assert found.cost_bound == pytest.approx(found.cost, rel=1e-4)  # costs are rounded for the search
    assert found.cost == pytest.approx(costs[found.views].sum())
