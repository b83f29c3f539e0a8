"""What every ordering keeps to."""

from collections.abc import Callable

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.order.orderings import ORDERINGS, OrderStatus, Sequence
from planner.ports import JointLimits
from planner.timing.motion import move_time

LIMITS = JointLimits(
    lower=np.full(6, -3.0), upper=np.full(6, 3.0), velocity=np.arange(1.0, 7.0), acceleration=np.arange(2.0, 8.0)
)
HOME = np.full(6, 0.25)


def make(seed: int, sizes: list[int]) -> tuple[list[np.ndarray], np.ndarray]:
    """Random joint solutions, as many per view as asked, and scanner poses."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (len(sizes), 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (len(sizes), 3))
    return [rng.uniform(-3, 3, (size, 6)) for size in sizes], poses


@pytest.fixture(params=sorted(ORDERINGS))
def ordering(request: pytest.FixtureRequest) -> Callable[..., Sequence]:
    """Each ordering in turn."""
    return ORDERINGS[request.param]


@pytest.mark.parametrize("sizes", [[], [1], [4], [2, 3], [1, 1, 1], [3] * 7, [2] * 13, [1, 6, 2, 5, 3] * 3])
def test_a_sequence_is_a_permutation_with_its_own_times(ordering: Callable[..., Sequence], sizes: list[int]) -> None:
    """Each view once, each q one of its solutions, the duration the sum of its moves, between bound and baseline."""
    configurations, poses = make(len(sizes), sizes)
    found = ordering(configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(0), budget=500)
    assert sorted(found.order) == list(range(len(sizes)))
    for k, choice, q in zip(found.order, found.choice, found.q, strict=True):
        np.testing.assert_array_equal(q, configurations[k][choice])
    stops = np.concatenate([HOME[None], found.q, HOME[None]])
    assert found.duration == pytest.approx(float(move_time(stops[:-1], stops[1:], LIMITS).sum()), rel=1e-12)
    assert found.lower_bound <= found.duration <= found.baseline_duration
    assert found.status is not OrderStatus.NO_TOUR


def test_equal_seeds_give_equal_sequences(ordering: Callable[..., Sequence]) -> None:
    """Same input and seed, same bytes."""
    configurations, poses = make(5, [4] * 14)
    one, two = (
        ordering(configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(3), budget=800)
        for _ in range(2)
    )
    assert one.q.tobytes() == two.q.tobytes()
    assert one.order.tobytes() == two.order.tobytes()


def test_a_forbidden_edge_is_avoided(ordering: Callable[..., Sequence]) -> None:
    """With all ways home but one per view forbidden, in either direction of the pair, those are taken."""
    configurations, poses = make(6, [3, 3])
    forbidden = {(0, 1): np.inf, (2, 0): np.inf, (0, 4): np.inf, (0, 5): np.inf}
    found = ordering(
        configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(0), edge_time=forbidden
    )
    assert sorted(zip(found.order.tolist(), found.choice.tolist(), strict=True)) == [(0, 2), (1, 2)]


def test_no_drivable_tour_is_said(ordering: Callable[..., Sequence]) -> None:
    """Where every way to a view is forbidden the status says so and the duration is infinite."""
    configurations, poses = make(6, [1, 1])
    forbidden = {(0, 1): np.inf, (1, 2): np.inf}
    found = ordering(
        configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(0), edge_time=forbidden
    )
    assert found.status is OrderStatus.NO_TOUR
    assert found.duration == np.inf
    assert "cannot be driven" in found.status.sentence


def test_two_views_with_one_pose_follow_each_other_at_no_cost(ordering: Callable[..., Sequence]) -> None:
    """A duplicate of a view adds a visit and no time."""
    configurations, poses = make(8, [2] * 5)
    arguments = {"rng": np.random.default_rng(0), "T_base_home": np.eye(4)}
    once = ordering(configurations, HOME, LIMITS, T_base_scanner=poses, **arguments)
    doubled = [*configurations, configurations[2]]
    twice = ordering(doubled, HOME, LIMITS, T_base_scanner=np.concatenate([poses, poses[2:3]]), **arguments)
    places = [twice.order.tolist().index(k) for k in (2, 5)]
    assert abs(places[0] - places[1]) == 1
    assert twice.duration == pytest.approx(once.duration, rel=1e-12) or ordering is ORDERINGS["christofides"]


def test_a_view_without_solution_is_refused_by_number(ordering: Callable[..., Sequence]) -> None:
    """The message names the view and what to do."""
    configurations, poses = make(9, [2, 0, 1])
    with pytest.raises(PlannerError, match="view 1 has no joint solution; drop it"):
        ordering(configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(0))


def test_an_edge_price_for_a_node_that_is_not_there_is_refused(ordering: Callable[..., Sequence]) -> None:
    """A wrong node number is a bug of the caller and named."""
    configurations, poses = make(9, [2, 1])
    with pytest.raises(PlannerError, match=r"edge_time\[\(1, 9\)\]"):
        ordering(
            configurations, HOME, LIMITS, T_base_scanner=poses, rng=np.random.default_rng(0), edge_time={(1, 9): 1.0}
        )
