"""Orders in which each view overlaps an earlier one, against trying all of them."""

from itertools import permutations

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import grow_order, is_connected_order, order_views, overlapping_order
from planner.tour.visits import TourProblem

LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.full(6, 1.0), np.full(6, 2.0))
HOME = np.zeros(6)


def instance(seed, n=6):
    """Joint solutions of n views and a connected graph of overlaps, a random tree with some more edges."""
    rng = np.random.default_rng(seed)
    configurations = [rng.uniform(-2, 2, (int(rng.integers(1, 4)), 6)) for _ in range(n)]
    joined = np.zeros((n, n), dtype=bool)
    for k in range(1, n):
        joined[k, rng.integers(k)] = True
    return configurations, joined | joined.T


def solved(configurations, joined, seed=0):
    """The ordering's answer."""
    poses = np.broadcast_to(np.eye(4), (len(configurations), 4, 4))
    return overlapping_order(joined)(
        TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(seed)
    )


def test_every_order_keeps_the_wish_and_few_take_longer_than_the_best() -> None:
    """On 25 instances: kept always; never faster than the best of all orders that keep it, mostly as fast."""
    optimal = bound = 0
    for seed in range(25):
        configurations, joined = instance(seed)
        found = solved(configurations, joined)
        assert is_connected_order(joined, found.order)
        assert sorted(found.order.tolist()) == list(range(len(configurations)))
        problem = TourProblem.straight(configurations, HOME, LIMITS).instance()
        best = min(
            gtsp.best_nodes(problem, np.array(order) + 1)[0]
            for order in permutations(range(len(configurations)))
            if is_connected_order(joined, np.array(order))
        )
        assert found.duration >= best - 1e-9
        np.testing.assert_allclose(
            found.q, [configurations[k][i] for k, i in zip(found.order, found.choice, strict=True)]
        )
        optimal += found.duration <= best * (1 + 1e-9)
        bound += found.duration > found.lower_bound * (1 + 1e-6)
    assert optimal >= 15
    assert bound > 5  # the wish costs something on some of them


def test_an_order_that_keeps_the_wish_by_itself_is_not_touched() -> None:
    """Where all views overlap, the answer is that of the free ordering."""
    configurations, _ = instance(3)
    everything = ~np.eye(len(configurations), dtype=bool)
    poses = np.broadcast_to(np.eye(4), (len(configurations), 4, 4))
    free = order_views(TourProblem.straight(configurations, HOME, LIMITS), poses, np.random.default_rng(0))
    np.testing.assert_array_equal(solved(configurations, everything).order, free.order)


def test_views_that_do_not_hang_together_are_ordered_freely() -> None:
    """No order can keep the wish: the free one comes back, nothing is raised."""
    configurations, joined = instance(1)
    found = solved(configurations, np.zeros_like(joined))
    assert sorted(found.order.tolist()) == list(range(len(configurations)))
    assert grow_order(np.zeros_like(joined), found.order, 0) is None


@pytest.mark.parametrize("first", range(4))
def test_growing_follows_the_wanted_order_where_it_may(first: int) -> None:
    """A chain 0 - 1 - 2 - 3: from each end along it, from the middle outwards."""
    chain = np.eye(4, k=1, dtype=bool) | np.eye(4, k=-1, dtype=bool)
    order = grow_order(chain, np.array([0, 2, 1, 3]), first)
    assert order is not None
    assert order[0] == first
    assert is_connected_order(chain, order)
