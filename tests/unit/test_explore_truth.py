"""The fewest views that a simulation says would have done, and what no fewer measure, against brute force."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from cell.explore.truth import _bound, _fewest, _Point
from cell.runs.run import open_finished
from cell.runs.schema import BoundAt, Truth
from planner.values import Bools, Floats


def _columns(planned: Path) -> tuple[Bools, Floats, float]:
    """(S, V) what reachable candidates measure, without those of which another measures as much and more; areas."""
    run = open_finished(planned)
    M = run.measurability
    sees = M.matrix().toarray()[:, run.reach.reachable]
    total = float(M.samples.areas.sum())
    more = np.array([
        [(~one | other).all() and ((one != other).any() or i > j) for j, other in enumerate(sees.T)]
        for i, one in enumerate(sees.T)
    ])  # fmt: skip
    return sees[:, ~more.any(axis=1)], M.samples.areas / total, total


def _most(sees: Bools, areas: Floats, count: int) -> float:
    """Brute force: the largest share that so many columns measure."""
    return max(
        float(areas[sees[:, list(chosen)].any(axis=1)].sum()) for chosen in combinations(range(sees.shape[1]), count)
    )


@pytest.mark.parametrize("count", [1, 2])
def test_the_fewest_views_for_a_coverage_are_those_of_brute_force(count: int, planned: Path) -> None:
    """What so many measure at most takes so many; a little more takes one more, at least."""
    run = open_finished(planned)
    M, (sees, areas, _) = run.measurability, _columns(planned)
    most = _most(sees, areas, count)
    assert _fewest(run, M, most - 1e-9) == (count, count)
    least, found = _fewest(run, M, most + 1e-6)
    assert count < least <= found
    assert _fewest(run, M, _most(sees, areas, count - 1) + 1e-6 if count > 1 else 1e-6) == (
        count,
        count,
    )


def test_more_than_all_that_is_measured_takes_what_all_takes(planned: Path) -> None:
    """Views that stand elsewhere than candidates may measure what none of these does."""
    run = open_finished(planned)
    M, (sees, areas, _) = run.measurability, _columns(planned)
    all_of_it = float(areas[sees.any(axis=1)].sum())
    assert all_of_it < 1
    assert _fewest(run, M, 1.0) == _fewest(run, M, all_of_it)
    assert _fewest(run, M, all_of_it)[0] >= run.plan.lower_bound


def test_fewer_views_than_the_fewest_measure_no_more_than_was_reached() -> None:
    """The bound of the curve holds for as many and more; it is never raised, and never below what was found.

    As many as were found to suffice measure as much.
    """
    curve = [(0, 0.0, 0.0), (1, 0.3, 0.35), (2, 0.6, 0.7), (3, 0.7, 0.85), (4, 0.8, 0.9), (5, 0.82, 0.9)]
    points = [_Point(n_views=n, covered=found, upper_bound=most) for n, found, most in curve]
    reached, fewest = 0.75, 4
    bound = _bound(points, reached, fewest, 4)
    assert [(at.views, at.found) for at in bound] == [(n, found) for n, found, _ in curve]
    assert [at.found for at in _bound(points, reached, 3, 3)] == [0.0, 0.3, 0.6, 0.75, 0.8, 0.82]
    assert [at.at_most for at in bound] == [0.0, 0.35, 0.7, 0.75, 0.9, 0.9]
    assert [at.at_most for at in _bound(points, 0.7 - 1e-12, fewest, 4)] == [0.0, 0.35, 0.7 - 1e-12, 0.7, 0.9, 0.9]
    assert [at.at_most for at in _bound(points, 1.0, 6, 6)] == [most for _, _, most in curve]


@pytest.mark.parametrize(("least", "found", "told"), [(5, 5, "5, proven, for"), (4, 6, "4 at least for")])
def test_the_fewest_views_are_called_proven_where_as_many_do(least: int, found: int, told: str) -> None:
    """Where the best cover that was found has more, the bound is no more than a bound."""
    known = Truth(
        visible=0.9, by_views=(0.9,), known_model_visible=0.9, known_model_views=6, coverable=0.95, fewest=least,
        fewest_found=found, bound=(BoundAt(views=1, found=0.9, at_most=0.9),), nearest_mm=10.0, nearest="arm, floor",
    )  # fmt: skip
    assert known.fewest_words.startswith(told)
