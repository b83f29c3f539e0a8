"""Contract of the ordering in joint space."""

from dataclasses import replace

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import OrderStatus, order_views
from planner.tour.visits import TourProblem

LIMITS = JointLimits(
    lower=np.full(6, -3.0), upper=np.full(6, 3.0), velocity=np.arange(1.0, 7.0), acceleration=np.arange(2.0, 8.0)
)
HOME = np.full(6, 0.25)


def make(seed: int, sizes: list[int]) -> tuple[list[np.ndarray], np.ndarray]:
    """Return random configurations, a given number per view, and scanner poses."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (len(sizes), 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (len(sizes), 3))
    return [rng.uniform(-3, 3, (size, 6)) for size in sizes], poses


def forbidding(configurations: list[np.ndarray], *pairs: tuple[int, int]) -> TourProblem:
    """Return a problem with moves that cannot be driven, in either direction."""
    problem = TourProblem.straight(configurations, HOME, LIMITS)
    times = problem.times.copy()
    for a, b in pairs:
        times[a, b] = times[b, a] = np.inf
    return replace(problem, times=times)


@pytest.mark.parametrize("sizes", [[], [1], [4], [2, 3], [1, 1, 1], [3] * 7, [2] * 13, [1, 6, 2, 5, 3] * 3])
def test_an_order_is_a_permutation_with_its_own_times(sizes: list[int]) -> None:
    """Each view is visited once with one of its configurations."""
    configurations, poses = make(len(sizes), sizes)
    found = order_views(TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(0), budget=500)
    assert sorted(found.order) == list(range(len(sizes)))
    for k, choice, q in zip(found.order, found.choice, found.q, strict=True):
        np.testing.assert_array_equal(q, configurations[k][choice])
    stops = np.concatenate([HOME[None], found.q, HOME[None]])
    assert found.duration == pytest.approx(float(move_time(stops[:-1], stops[1:], LIMITS).sum()), rel=1e-12)
    assert found.lower_bound <= found.duration <= found.baseline_duration
    assert found.status is not OrderStatus.NO_TOUR


def test_equal_seeds_give_equal_orders() -> None:
    """Equal inputs and seeds give equal bytes."""
    configurations, poses = make(5, [4] * 14)
    problem = TourProblem.straight(configurations, HOME, LIMITS)
    one, two = (order_views(problem, poses, np.random.default_rng(3), budget=800) for _ in range(2))
    assert one.q.tobytes() == two.q.tobytes()
    assert one.order.tobytes() == two.order.tobytes()


def test_a_forbidden_edge_is_avoided() -> None:
    """All moves home except one per view are forbidden in both directions, and the allowed moves are used."""
    configurations, poses = make(6, [3, 3])
    problem = forbidding(configurations, (0, 1), (2, 0), (0, 4), (0, 5))
    found = order_views(problem, poses, np.random.default_rng(0))
    assert sorted(zip(found.order.tolist(), found.choice.tolist(), strict=True)) == [(0, 2), (1, 2)]


def test_a_missing_tour_is_reported() -> None:
    """If every move to a view is forbidden, the status reports it and the duration is infinite."""
    configurations, poses = make(6, [1, 1])
    found = order_views(forbidding(configurations, (0, 1), (1, 2)), poses, np.random.default_rng(0))
    assert found.status is OrderStatus.NO_TOUR
    assert found.duration == np.inf
    assert "cannot be driven" in found.status.sentence


def test_two_views_with_one_pose_follow_each_other_at_no_cost() -> None:
    """A duplicate of a view adds a visit and no time."""
    configurations, poses = make(8, [2] * 5)
    rng, home = np.random.default_rng(0), np.eye(4)
    once = order_views(TourProblem.straight(configurations, HOME, LIMITS), poses, rng, T_base_home=home)
    doubled = TourProblem.straight([*configurations, configurations[2]], HOME, LIMITS)
    twice = order_views(doubled, np.concatenate([poses, poses[2:3]]), rng, T_base_home=home)
    places = [twice.order.tolist().index(k) for k in (2, 5)]
    assert abs(places[0] - places[1]) == 1
    assert twice.duration == pytest.approx(once.duration, rel=1e-12)


def test_a_view_without_configuration_is_refused_by_number() -> None:
    """The message names the view and the required change."""
    with pytest.raises(PlannerError, match="view 1 has no configuration; drop it"):
        TourProblem.straight(make(9, [2, 0, 1])[0], HOME, LIMITS)


@pytest.mark.parametrize("leave", [[0, 1, 2, 1], [0, 1, 2, 4], [0, 1, 2, -1], [1, 1, 2, 3]])
def test_leaving_from_another_view_is_refused(leave: list[int]) -> None:
    """The arm must leave each view and home at which it arrives. Unknown numbers of nodes are refused."""
    with pytest.raises(PlannerError, match="leave must name a node of the same view"):
        replace(TourProblem.straight(make(9, [2, 1])[0], HOME, LIMITS), leave=leave)


@pytest.mark.parametrize("size", [9, 40])
def test_a_warm_tour_is_never_longer_than_its_start(size: int) -> None:
    """The tour over some of the views is no longer than the earlier order with its best configurations."""
    configurations, poses = make(size, [3] * size)
    before = order_views(
        TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(1), budget=400
    )
    kept = [k for k in range(size) if k % 5]
    place = {view: i for i, view in enumerate(kept)}
    start = np.array([place[view] for view in before.order if view in place])
    problem = TourProblem.straight([configurations[k] for k in kept], HOME, LIMITS)
    fewer = order_views(problem, poses[kept], np.random.default_rng(2), budget=50, bound_effort=None, start=start)
    assert fewer.duration <= gtsp.best_nodes(problem.instance(), start + 1)[0] * (1 + 1e-12)

    problem = TourProblem.straight(configurations, HOME, LIMITS)
    start = np.array(kept)[fewer.order]
    more = order_views(problem, poses, np.random.default_rng(3), budget=50, bound_effort=None, start=start)
    assert sorted(more.order) == list(range(size))
    detours = sum(2 * move_time(HOME, configurations[k], LIMITS).min() for k in range(size) if not k % 5)
    assert more.duration <= (fewer.duration + detours) * (1 + 1e-12)


def test_a_warm_tour_of_many_views_is_as_good_as_one_from_scratch() -> None:
    """Forty views of which four are new: within 2 % of a search from scratch, with a fraction of its steps."""
    configurations, poses = make(7, [3] * 40)
    problem = TourProblem.straight(configurations, HOME, LIMITS)
    scratch = order_views(problem, poses, np.random.default_rng(0), bound_effort=None)
    start = np.array([view for view in scratch.order if view % 10])
    warm = order_views(problem, poses, np.random.default_rng(1), budget=500, bound_effort=None, start=start)
    assert warm.duration <= scratch.duration * 1.02


@pytest.mark.parametrize("start", [[0, 0, 1], [0, 4], [-1, 2]])
def test_a_start_that_is_no_order_is_refused(start: list[int]) -> None:
    """A repeated or unknown view in the start is refused."""
    configurations, poses = make(1, [2] * 4)
    with pytest.raises(PlannerError, match="each at most once"):
        order_views(
            TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(0), start=np.array(start)
        )
