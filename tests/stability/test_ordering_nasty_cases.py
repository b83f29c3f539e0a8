"""Nasty cases of ordering, by name: turns and cables, tiny and huge moves, costs of 0 and of inf.

Every case is ordered twice: exactly with few views, and by the search with many views or a small budget.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.timing.move_time import move_time
from planner.tour import bounds
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import OrderedViews, OrderStatus, order_views
from planner.tour.visits import TourProblem
from tests.support.joint_space import RANGE
from tests.support.joint_space import SYMMETRIC_LIMITS as LIMITS

HOME = np.zeros(6)


def degrees(*angles: float) -> np.ndarray:
    """Return one configuration [rad]."""
    return np.radians(angles)[None]


def ordered(
    views: Sequence[np.ndarray], prices: Mapping[tuple[int, int], float] | None = None, **arguments: int
) -> OrderedViews:
    """Order views, some moves with given times; all scanner poses are equal, so that task space has no effect."""
    poses = np.tile(np.eye(4), (len(views), 1, 1))
    moves = TourProblem.straight(views, HOME, LIMITS)
    times = moves.times.copy()
    for (a, b), time in (prices or {}).items():
        times[a, b] = times[b, a] = time
    return order_views(replace(moves, times=times), poses, np.random.default_rng(0), **arguments)


def stops(found: OrderedViews) -> np.ndarray:
    """Return (n + 2, 6) joint angles from home to home."""
    return np.concatenate((HOME[None], found.q, HOME[None]))


def exactly_ordered(views: Sequence[np.ndarray]) -> bool:
    """Return whether the default budget orders these views exactly."""
    nodes = 1 + sum(map(len, views))
    cost = np.zeros((nodes, nodes))
    problem = gtsp.make_instance(cost, np.cumsum([0, 1, *map(len, views)]))
    return gtsp.exact_effort(problem) <= gtsp.ALWAYS_EXACT


@pytest.mark.parametrize("n", [2, 18])
def test_views_reachable_only_beyond_half_a_turn(n: int) -> None:
    """Angles of A4 or A6 beyond 180 deg are not wrapped, and the move from home is the long one."""
    views = [degrees(5.0 * k, -20, 30, 200 + k, 10, -300 + 2 * k) for k in range(n)]
    found = ordered(views)
    assert exactly_ordered(views) == (n == 2)
    np.testing.assert_array_equal(np.sort(found.q[:, 3]), np.sort([v[0, 3] for v in views]))
    path = stops(found)
    assert found.duration == pytest.approx(float(move_time(path[:-1], path[1:], LIMITS).sum()), rel=1e-12)
    assert found.duration >= 2 * float(move_time(HOME, degrees(0, 0, 0, 200, 0, 0)[0], LIMITS))


@pytest.mark.parametrize("n", [4, 20])
def test_the_cable_is_not_wound_up_over_the_tour(n: int) -> None:
    """Each view turns the tool by 100 deg from the previous one, at any full turn within the range of A6.

    Followed turn by turn, A6 would reach 100 n deg. Joint angles are absolute: every stop is one of the view's angles
    within the range, and the turns of the tour add up to zero.
    """
    views = []
    for k in range(n):
        angle = 100.0 * (k + 1)
        turns = [angle - 360 * t for t in range(int(angle // 360) + 2) if abs(angle - 360 * t) <= 350]
        views.append(np.concatenate([degrees(2.0 * k, 0, 0, 0, 0, turn) for turn in turns]))
    found = ordered(views)
    path = stops(found)
    assert (np.abs(path) <= RANGE).all()
    assert np.diff(path[:, 5]).sum() == pytest.approx(0.0, abs=1e-12)
    for view, q in zip(found.order, found.q, strict=True):
        assert (views[view] == q).all(axis=1).any()


@pytest.mark.parametrize("n", [3, 18])
def test_moves_of_a_billionth_and_of_seven_hundred_degrees(n: int) -> None:
    """Views that differ by 1e-9 rad follow each other at one end of A6's range; the turn of 700 deg is driven twice."""
    low = [degrees(0, 0, 0, 0, 0, -350) + 1e-9 * k * np.eye(6)[2] for k in range(n)]
    high = [degrees(0, 0, 0, 0, 0, 350) - 1e-9 * k * np.eye(6)[2] for k in range(n)]
    found = ordered([*low, *high])
    ends = np.sign(found.q[:, 5])
    assert (np.diff(ends) != 0).sum() == 1
    crossing = float(move_time(low[0][0], high[0][0], LIMITS))
    path = stops(found)
    assert float(move_time(path[:-1], path[1:], LIMITS).max()) == pytest.approx(crossing, rel=1e-6)


@pytest.mark.parametrize("n", [5, 40])
@pytest.mark.parametrize("at", [degrees(30, -20, 10, 40, 20, 60), HOME[None]], ids=["one place", "home"])
def test_views_all_in_one_place_cost_nothing_more(n: int, at: np.ndarray) -> None:
    """With all costs between views 0, the tour consists of two moves and is proven."""
    found = ordered([at] * n)
    assert sorted(found.order) == list(range(n))
    assert found.duration == pytest.approx(2 * float(move_time(HOME, at[0], LIMITS)), rel=1e-12)
    assert found.status is OrderStatus.OPTIMAL


@pytest.mark.parametrize("n", [6, 18])
def test_two_views_with_the_same_pose_follow_each_other(n: int) -> None:
    """The second of two equal views adds no time, so both tours have the same duration."""
    rng = np.random.default_rng(n)
    views = [rng.uniform(-1, 1, (2, 6)) for _ in range(n)]
    found = ordered([*views, views[2]])
    places = [found.order.tolist().index(k) for k in (2, n)]
    assert abs(places[0] - places[1]) == 1
    assert found.duration == pytest.approx(ordered(views).duration, rel=1e-9)


def test_one_view_with_very_many_configurations_among_views_with_one() -> None:
    """A view with three hundred configurations is visited at the one between the other views."""
    rng = np.random.default_rng(0)
    many = np.concatenate([rng.uniform(-2, 2, (299, 6)), degrees(50, 0, 0, 0, 0, 0)])
    others = [degrees(float(angle), 0, 0, 0, 0, 0) for angle in np.linspace(10, 150, 15)]
    found = ordered([many, *others])
    assert found.choice[found.order.tolist().index(0)] == 299


@pytest.mark.parametrize("n", [3, 20])
def test_a_view_that_no_move_reaches(n: int) -> None:
    """With infinite times of all moves of one view, the status reports it and the duration is infinite.

    The other views are in a tour with no more forbidden moves than needed.
    """
    rng = np.random.default_rng(n)
    views = [rng.uniform(-1, 1, (2, 6)) for _ in range(n)]
    forbidden = {(a, b): np.inf for a in (1, 2) for b in range(2 * n + 1)}
    found = ordered(views, forbidden)
    assert found.status is OrderStatus.NO_TOUR
    assert (found.duration, found.baseline_duration) == (np.inf, np.inf)
    assert sorted(found.order) == list(range(n))
    path = stops(found)
    others = [k for k in range(n + 1) if found.order[min(k, n - 1)] != 0 and (k == 0 or found.order[k - 1] != 0)]
    assert np.isfinite(move_time(path[:-1], path[1:], LIMITS)[others]).all()


@pytest.mark.parametrize("n", [4, 18])
def test_every_move_but_one_tour_forbidden(n: int) -> None:
    """If only the moves of one tour have a finite time, this tour is found."""
    rng = np.random.default_rng(n)
    cycle = np.concatenate(([0], 1 + rng.permutation(n)))
    price = {(a, b): np.inf for a in range(n + 1) for b in range(a)}
    for a, b in zip(cycle, np.roll(cycle, -1), strict=True):
        price[max(a, b), min(a, b)] = 1.0
    found = ordered([np.full((1, 6), 0.01 * k) for k in range(n)], price)
    assert found.duration == pytest.approx(n + 1.0)
    assert found.status is OrderStatus.OPTIMAL


@pytest.mark.parametrize("clusters", [1, 2, 3])
def test_fewer_clusters_than_a_tour_has_corners(clusters: int) -> None:
    """Exact search, search and bounds agree for one, two and three clusters of two nodes each."""
    rng = np.random.default_rng(clusters)
    places = rng.uniform(0, 1, (2 * clusters, 2))
    problem = gtsp.make_instance(np.linalg.norm(places[:, None] - places, axis=2), np.arange(0, 2 * clusters + 1, 2))
    exact = gtsp.solve_exactly(problem)
    _, start = gtsp.best_nodes(problem, np.arange(1, clusters))
    assert gtsp.search(problem, start, 0, 100)[0] == pytest.approx(exact.cost)
    assert bounds.one_tree_bound(problem.cost, problem.first) <= exact.cost * (1 + 1e-12)


@pytest.mark.parametrize(
    ("cost", "first", "message"),
    [
        (np.zeros((3, 3)), [0, 1, 1, 3], "every cluster needs at least one node"),
        (np.zeros((3, 3)), [1, 2, 3], "the first cluster begins at node 0"),
        (np.array([[0.0, -1], [-1, 0]]), [0, 1, 2], "negative"),
        (np.array([[0.0, np.nan], [np.nan, 0]]), [0, 1, 2], "NaN"),
    ],
)
def test_broken_instances_are_refused(cost: np.ndarray, first: list[int], message: str) -> None:
    """The message names the reason."""
    with pytest.raises(PlannerError, match=message):
        gtsp.make_instance(cost, np.array(first))
