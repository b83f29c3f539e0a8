"""Orders and configurations compared with the enumeration of all of them."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour import bounds
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import (
    OrderStatus,
    fixed_order,
    grow_order,
    is_connected_order,
    order_views,
    overlapping_order,
)
from planner.tour.visits import TourProblem
from planner.values import Floats
from tests.support.joint_space import KR16_LIMITS as LIMITS

HOME = np.radians([0, -90, 90, 0, 90, 0])
UNIT_LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.ones(6), np.full(6, 2.0))
ORIGIN = np.zeros(6)


def views(seed: int, n: int, most: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Return random configurations, one to `most` per view, and scanner poses."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (n, 3))
    return [rng.uniform(LIMITS.lower, LIMITS.upper, (int(rng.integers(1, most + 1)), 6)) for _ in range(n)], poses


def cheapest(cost: Floats, first: np.ndarray) -> float:
    """Return the cost of the cheapest closed tour from node 0 over all orders and nodes."""
    best = np.inf
    for order in itertools.permutations(range(1, len(first) - 1)):
        for nodes in itertools.product(*(range(first[k], first[k + 1]) for k in order)):
            tour = [0, *nodes, 0]
            best = min(best, sum(cost[a, b] for a, b in itertools.pairwise(tour)))
    return best


@pytest.mark.parametrize("seed", range(9))
def test_small_orders_are_the_true_optimum(seed: int) -> None:
    """For up to six views no order and no choice is faster, also with changed prices."""
    n = seed % 6 + 1
    configurations, poses = views(seed, n, 3)
    rng = np.random.default_rng(seed)
    n_nodes = 1 + sum(map(len, configurations))
    prices = {
        (int(a), int(b)): float(time)
        for a, b, time in zip(
            rng.integers(0, n_nodes, 6), rng.integers(0, n_nodes, 6), rng.choice([0.1, 5.0, np.inf], 6), strict=True
        )
        if a < b
    }
    moves = TourProblem.straight(configurations, HOME, LIMITS)
    times = moves.times.copy()
    for (a, b), time in prices.items():
        times[a, b] = times[b, a] = time
    found = order_views(replace(moves, times=times), poses, np.random.default_rng(0))
    first = np.cumsum([0, 1, *map(len, configurations)])
    truth = cheapest(times, first)
    assert found.duration == pytest.approx(truth, rel=1e-12)
    assert found.status is (OrderStatus.OPTIMAL if np.isfinite(truth) else OrderStatus.NO_TOUR)


def random_problem(seed: int, n: int, solutions: int) -> gtsp.Instance:
    """Return the problem of home and n views with random configurations."""
    configurations, _ = views(seed, n, solutions)
    nodes = np.concatenate([HOME[None], *configurations])
    return gtsp.make_instance(move_time(nodes[:, None], nodes, LIMITS), np.cumsum([0, 1, *map(len, configurations)]))


def test_the_search_meets_the_exact_optimum() -> None:
    """On five instances of eight views, the search finds the exact cost of each.

    Precondition: the initial order is worse by more than 5 % on average, so that the search has something to improve.
    """
    start_gaps = []
    for seed in range(5):
        problem = random_problem(100 + seed, 8, 7)
        exact = gtsp.solve_exactly(problem)
        start_cost, start = gtsp.best_nodes(problem, np.arange(1, 9))
        cost, tour = gtsp.search(problem, start, seed, 3000)
        assert cost == pytest.approx(exact.cost, rel=1e-12)
        assert cost == pytest.approx(gtsp.best_nodes(problem, problem.clusters_of(tour)[1:])[0], rel=1e-12)
        assert exact.cost == pytest.approx(problem.length(exact.tour), rel=1e-12)
        start_gaps.append(start_cost / exact.cost - 1)
    assert np.mean(start_gaps) > 0.05


@pytest.mark.parametrize("effort", [0, 10_000, 1_000_000, 100_000_000])
def test_bounds_are_bounds(effort: int) -> None:
    """No bound is above the optimum by more than rounding, for any effort and any known tour."""
    for seed in range(4):
        problem = random_problem(200 + seed, seed % 5 + 3, 6)
        optimum = gtsp.solve_exactly(problem).cost
        assert bounds.one_tree_bound(problem.cost, problem.first) <= optimum * (1 + 1e-12)
        for known in (optimum, 1.3 * optimum):
            bound = bounds.walk_bound(problem.cost, problem.first, known, effort)
            assert bound.value <= optimum * (1 + 1e-9)
            if bound.tour is not None:
                assert problem.length(bound.tour) == pytest.approx(optimum, rel=1e-9)


def test_without_effort_for_an_ascent_there_is_no_walk_bound() -> None:
    """With effort for a few evaluations, as for hundreds of clusters, it is 0; with more there is a bound."""
    problem = random_problem(200, 8, 6)
    price = bounds._Ascent(problem.cost, problem.first, 1.0, 0).price
    best = gtsp.solve_exactly(problem).cost
    assert bounds.walk_bound(problem.cost, problem.first, best, 9 * price).value == 0.0
    assert bounds.walk_bound(problem.cost, problem.first, best, 90 * price).value > 0.0


def test_the_walks_prove_the_optimum() -> None:
    """With enough effort the bound of each of six instances is the optimum, which the quick bound is not."""
    for seed in range(6):
        problem = random_problem(300 + seed, 8, 6)
        optimum = gtsp.solve_exactly(problem).cost
        assert bounds.walk_bound(problem.cost, problem.first, optimum, 10**9).value == pytest.approx(optimum)
        assert bounds.one_tree_bound(problem.cost, problem.first) < 0.99 * optimum


def test_large_instances_are_searched_and_bounded() -> None:
    """Fifteen views: found by search, within 2 % of the walk bound; without effort, start and quick bound."""
    problem = random_problem(400, 15, 6)
    proven = gtsp.solve(problem, np.arange(1, 16), np.random.default_rng(0), 5000, 10**9)
    assert gtsp.exact_effort(problem) > 5000 * 45_000
    assert proven.cost <= 1.02 * proven.lower_bound
    idle = gtsp.solve(problem, np.arange(1, 16), np.random.default_rng(0), 0, 0)
    assert idle.cost == gtsp.best_nodes(problem, np.arange(1, 16))[0]
    assert idle.lower_bound < proven.lower_bound <= proven.cost < idle.cost


@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_whole_numbers_are_whole_and_never_above_the_optimum(seed: int) -> None:
    """For integer distances on a grid, the bound is an integer and at most the exact cost."""
    rng = np.random.default_rng(seed)
    places = rng.integers(0, 50, (28, 2)).astype(float)
    first = np.arange(0, 29, 4)
    problem = gtsp.make_instance(np.rint(np.linalg.norm(places[:, None] - places, axis=2)), first)
    cost, tour = gtsp.best_nodes(problem, np.arange(1, 7))
    found = gtsp._solution(problem, tour, cost, bounds.one_tree_bound(problem.cost, first))
    assert found.lower_bound == np.floor(found.lower_bound)
    assert found.lower_bound <= gtsp.solve_exactly(problem).cost


def test_the_steps_grow_with_the_square_of_the_clusters() -> None:
    """Up to 22 clusters the steps are the given ones; with 88 there are sixteen times as many."""
    few, many = (gtsp.make_instance(np.ones((m, m)), np.arange(m + 1)) for m in (22, 88))
    assert gtsp.scale_steps(few, 1000) == 1000
    assert gtsp.scale_steps(many, 1000) == 16_000


def directed_problem(seed: int, clusters: int) -> tuple[Floats, np.ndarray]:
    """Return random directed costs and the first node of each cluster."""
    rng = np.random.default_rng(seed)
    first = np.concatenate([[0, 1], 1 + np.cumsum(rng.integers(1, 4, clusters))])
    return rng.uniform(0, 1, (first[-1], first[-1])), first


@pytest.mark.parametrize("seed", range(6))
def test_exact_search_and_bound_on_directed_costs(seed: int) -> None:
    """The exact search is exact, the search finds the optimum of small instances, no bound is above it."""
    cost, first = directed_problem(seed, 5)
    problem = gtsp.make_instance(cost, first)
    assert not problem.symmetric
    best = cheapest(cost, first)
    exact = gtsp.solve_exactly(problem)
    assert exact.cost == pytest.approx(best, abs=1e-12)
    assert problem.length(exact.tour) == pytest.approx(best, abs=1e-12)
    start = gtsp.best_nodes(problem, np.arange(1, 6))[1]
    length, tour = gtsp.search(problem, start, seed, 3000)
    assert length == pytest.approx(problem.length(tour), abs=1e-12)
    assert sorted(problem.clusters_of(tour).tolist()) == list(range(6))
    assert length == pytest.approx(best, abs=1e-9)
    assert bounds.one_tree_bound(problem.either, problem.first) <= best + 1e-9
    assert bounds.walk_bound(problem.either, problem.first, best, 10**7).value <= best + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_sweeps_are_entered_at_one_end_and_left_at_the_other(seed: int) -> None:
    """Sweeps driven in either direction: the time is the smallest over orders and directions, with the stays."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-1, 1, (4, 2, 6))
    stays = rng.uniform(0.1, 0.5, 4)
    home = np.zeros(6)
    moves = TourProblem.straight(list(ends), home, UNIT_LIMITS)
    moves = replace(moves, leave=[0, 2, 1, 4, 3, 6, 5, 8, 7], stays=np.concatenate([[0.0], np.repeat(stays, 2)]))
    found = order_views(moves, np.tile(np.eye(4), (4, 1, 1)), rng)
    best = np.inf
    for order in itertools.permutations(range(4)):
        for direction in itertools.product((0, 1), repeat=4):
            at, time = home, float(stays.sum())
            for view, begin in zip(order, direction, strict=True):
                time += float(move_time(at, ends[view, begin], UNIT_LIMITS))
                at = ends[view, 1 - begin]
            best = min(best, time + float(move_time(at, home, UNIT_LIMITS)))
    assert found.duration == pytest.approx(best, abs=1e-9)


def overlapping_views(seed, n=6):
    """Return configurations of n views and a connected overlap graph, a random tree."""
    rng = np.random.default_rng(seed)
    configurations = [rng.uniform(-2, 2, (int(rng.integers(1, 4)), 6)) for _ in range(n)]
    overlap = np.zeros((n, n), dtype=bool)
    for k in range(1, n):
        overlap[k, rng.integers(k)] = True
    return configurations, overlap | overlap.T


def order_with_overlap(configurations, overlap, seed=0):
    """Order views under the condition of overlap."""
    poses = np.broadcast_to(np.eye(4), (len(configurations), 4, 4))
    return overlapping_order(overlap)(
        TourProblem.straight(configurations, ORIGIN, UNIT_LIMITS), poses, np.random.default_rng(seed)
    )


def test_overlapping_orders_are_valid_and_mostly_optimal() -> None:
    """On ten instances the order is valid, never faster than the best valid one, and mostly as fast."""
    optimal = bound = 0
    for seed in range(10):
        configurations, overlap = overlapping_views(seed)
        found = order_with_overlap(configurations, overlap)
        assert is_connected_order(overlap, found.order)
        assert sorted(found.order.tolist()) == list(range(len(configurations)))
        problem = TourProblem.straight(configurations, ORIGIN, UNIT_LIMITS).instance()
        best = min(
            gtsp.best_nodes(problem, np.array(order) + 1)[0]
            for order in itertools.permutations(range(len(configurations)))
            if is_connected_order(overlap, np.array(order))
        )
        assert found.duration >= best - 1e-9
        np.testing.assert_allclose(
            found.q, [configurations[k][i] for k, i in zip(found.order, found.choice, strict=True)]
        )
        optimal += found.duration <= best * (1 + 1e-9)
        bound += found.duration > found.lower_bound * (1 + 1e-6)
    assert optimal >= 6
    assert bound > 2  # the condition costs time in some instances


def test_a_free_order_with_overlap_stays() -> None:
    """If all views overlap, the result is the free order."""
    configurations, _ = overlapping_views(3)
    everything = ~np.eye(len(configurations), dtype=bool)
    poses = np.broadcast_to(np.eye(4), (len(configurations), 4, 4))
    free = order_views(TourProblem.straight(configurations, ORIGIN, UNIT_LIMITS), poses, np.random.default_rng(0))
    np.testing.assert_array_equal(order_with_overlap(configurations, everything).order, free.order)


@pytest.mark.parametrize("first", range(4))
def test_a_grown_order_follows_the_wanted_one(first: int) -> None:
    """A chain 0 - 1 - 2 - 3: along it from each end, outwards from the middle."""
    chain = np.eye(4, k=1, dtype=bool) | np.eye(4, k=-1, dtype=bool)
    order = grow_order(chain, np.array([0, 2, 1, 3]), first)
    assert order is not None
    assert order[0] == first
    assert is_connected_order(chain, order)


@pytest.mark.parametrize("seed", range(4))
def test_fixed_orders_have_the_best_configurations(seed: int) -> None:
    """Configurations as good as the best of all; remaining views are inserted one by one at their cheapest places."""
    rng = np.random.default_rng(seed)
    moves = TourProblem.straight([rng.uniform(-2, 2, (2, 6)) for _ in range(5)], np.zeros(6), UNIT_LIMITS)
    problem = moves.instance()
    for prefix in ([3, 0, 4, 1, 2], [3, 0, 4, 1], [2]):
        found = fixed_order(prefix)(moves, np.tile(np.eye(4), (5, 1, 1)), rng, bound_effort=None)
        assert [view for view in found.order if view in prefix] == prefix
        assert sorted(found.order) == list(range(5))
        choices = np.stack(np.meshgrid(*[[0, 1]] * 5), axis=-1).reshape(-1, 5)
        tours = [[0, *(1 + 2 * found.order + choice)] for choice in choices]
        assert found.duration == pytest.approx(min(problem.length(np.array(tour)) for tour in tours))
        orders = [o for o in itertools.permutations(range(5)) if [v for v in o if v in prefix] == prefix]
        best = min(gtsp.best_nodes(problem, np.array(order) + 1)[0] for order in orders)
        assert found.duration >= best - 1e-9
        if len(prefix) > 3:
            assert found.duration == pytest.approx(best)
