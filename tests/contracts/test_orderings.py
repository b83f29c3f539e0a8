"""Contract of the ordering in joint space."""

from dataclasses import replace

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.timing.move_time import move_time
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import OrderStatus, order_views
from planner.tour.visits import TourProblem
from tests.support.joint_space import SYMMETRIC_LIMITS as LIMITS

HOME = np.full(6, 0.25)


def make(seed: int, sizes: list[int]) -> tuple[list[np.ndarray], np.ndarray]:
    """Return random configurations, a given number per view, and scanner poses."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (len(sizes), 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (len(sizes), 3))
    return [rng.uniform(-2.2, 2.2, (size, 6)) for size in sizes], poses


@pytest.mark.parametrize("sizes", [[], [1], [2, 3], [1, 1, 1], [3] * 7, [1, 6, 2, 5, 3] * 2])
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
    configurations, poses = make(5, [4] * 10)
    problem = TourProblem.straight(configurations, HOME, LIMITS)
    one, two = (order_views(problem, poses, np.random.default_rng(3), budget=400) for _ in range(2))
    assert one.q.tobytes() == two.q.tobytes()
    assert one.order.tobytes() == two.order.tobytes()


def test_a_view_without_configuration_is_refused_by_number() -> None:
    """The message names the view and the required change."""
    with pytest.raises(PlannerError, match="view 1 has no configuration; drop it"):
        TourProblem.straight(make(9, [2, 0, 1])[0], HOME, LIMITS)


@pytest.mark.parametrize("leave", [[0, 1, 2, 1], [0, 1, 2, 4], [0, 1, 2, -1], [1, 1, 2, 3]])
def test_leaving_from_another_view_is_refused(leave: list[int]) -> None:
    """The arm must leave each view and home at which it arrives. Unknown numbers of nodes are refused."""
    with pytest.raises(PlannerError, match="leave must name a node of the same view"):
        replace(TourProblem.straight(make(9, [2, 1])[0], HOME, LIMITS), leave=leave)


@pytest.mark.parametrize("size", [9, 24])
def test_a_warm_tour_is_never_longer_than_its_start(size: int) -> None:
    """The tour over some of the views is no longer than the earlier order with its best configurations."""
    configurations, poses = make(size, [3] * size)
    before = order_views(
        TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(1), budget=400
    )
    remaining = [k for k in range(size) if k % 5]
    place = {view: i for i, view in enumerate(remaining)}
    start = np.array([place[view] for view in before.order if view in place])
    problem = TourProblem.straight([configurations[k] for k in remaining], HOME, LIMITS)
    fewer = order_views(problem, poses[remaining], np.random.default_rng(2), budget=50, bound_effort=None, start=start)
    assert fewer.duration <= gtsp.best_nodes(problem.instance(), start + 1)[0] * (1 + 1e-12)

    problem = TourProblem.straight(configurations, HOME, LIMITS)
    start = np.array(remaining)[fewer.order]
    more = order_views(problem, poses, np.random.default_rng(3), budget=50, bound_effort=None, start=start)
    assert sorted(more.order) == list(range(size))
    detours = sum(2 * move_time(HOME, configurations[k], LIMITS).min() for k in range(size) if not k % 5)
    assert more.duration <= (fewer.duration + detours) * (1 + 1e-12)


def test_a_warm_tour_of_many_views_is_as_good_as_one_from_scratch() -> None:
    """Thirty views of which three are new: within 2 % of a search from scratch, with a fraction of its steps."""
    configurations, poses = make(7, [3] * 30)
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
