"""Orders and joint solutions against enumeration of every one."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour import bounds
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import OrderStatus, order_views
from planner.tour.visits import TourProblem

LIMITS = JointLimits(
    lower=np.radians([-185, -155, -130, -350, -130, -350]),
    upper=np.radians([185, 35, 154, 350, 130, 350]),
    velocity=np.radians([156, 156, 156, 330, 330, 615]),
    acceleration=np.radians([312, 312, 312, 660, 660, 1230]),
)
HOME = np.radians([0, -90, 90, 0, 90, 0])


def views(seed: int, n: int, most: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Random joint solutions, one to `most` per view, and scanner poses."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (n, 3))
    return [rng.uniform(LIMITS.lower, LIMITS.upper, (int(rng.integers(1, most + 1)), 6)) for _ in range(n)], poses


def cheapest(configurations: list[np.ndarray], edge_time: dict[tuple[int, int], float]) -> float:
    """The best time over all orders and all joint solutions, by enumeration."""
    nodes = np.concatenate([HOME[None], *configurations])
    cost = [[float(move_time(a, b, LIMITS)) for b in nodes] for a in nodes]
    for (a, b), time in edge_time.items():
        cost[a][b] = cost[b][a] = time
    starts = np.cumsum([1, *map(len, configurations)])
    best = np.inf
    for order in itertools.permutations(range(len(configurations))):
        for chosen in itertools.product(*(range(starts[k], starts[k + 1]) for k in order)):
            tour = (0, *chosen, 0)
            best = min(best, sum(cost[a][b] for a, b in itertools.pairwise(tour)))
    return best


@pytest.mark.parametrize("seed", range(12))
def test_small_sequences_are_the_true_optimum(seed: int) -> None:
    """Up to six views, no order and no choice is faster than the sequence, priced edges included."""
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
    truth = cheapest(configurations, prices)
    assert found.duration == pytest.approx(truth, rel=1e-12)
    assert found.status is (OrderStatus.OPTIMAL if np.isfinite(truth) else OrderStatus.NO_TOUR)


def random_problem(seed: int, n: int, solutions: int) -> gtsp.Instance:
    """Home and n views of random joint solutions."""
    configurations, _ = views(seed, n, solutions)
    nodes = np.concatenate([HOME[None], *configurations])
    return gtsp.make_instance(move_time(nodes[:, None], nodes, LIMITS), np.cumsum([0, 1, *map(len, configurations)]))


def test_the_search_meets_the_exact_optimum() -> None:
    """On ten instances of nine views, the search finds the exact cost of each.

    Precondition: the order to begin with is worse by more than 5 % on average, so that the search had something to do.
    """
    start_gaps = []
    for seed in range(10):
        problem = random_problem(100 + seed, 9, 8)
        exact = gtsp.solve_exactly(problem)
        start_cost, start = gtsp.best_nodes(problem, np.arange(1, 10))
        cost, tour = gtsp.search(problem, start, seed, 3000)
        assert cost == pytest.approx(exact.cost, rel=1e-12)
        assert cost == pytest.approx(gtsp.best_nodes(problem, problem.clusters_of(tour)[1:])[0], rel=1e-12)
        assert exact.cost == pytest.approx(problem.length(exact.tour), rel=1e-12)
        start_gaps.append(start_cost / exact.cost - 1)
    assert np.mean(start_gaps) > 0.05


@pytest.mark.parametrize("work", [0, 10_000, 1_000_000, 100_000_000])
def test_bounds_are_bounds(work: int) -> None:
    """Neither bound is above the optimum by more than rounding, whatever its budget and the tour it is told."""
    for seed in range(6):
        problem = random_problem(200 + seed, seed % 5 + 3, 6)
        optimum = gtsp.solve_exactly(problem).cost
        assert bounds.one_tree_bound(problem.cost, problem.first) <= optimum * (1 + 1e-12)
        for told in (optimum, 1.3 * optimum):
            bound = bounds.walk_bound(problem.cost, problem.first, told, work)
            assert bound.value <= optimum * (1 + 1e-9)
            if bound.tour is not None:
                assert problem.length(bound.tour) == pytest.approx(optimum, rel=1e-9)


def test_walks_that_could_not_be_raised_are_not_looked_for() -> None:
    """With work for a few evaluations, as of hundreds of clusters, nothing is; with more there is a bound."""
    problem = random_problem(200, 8, 6)
    price = bounds._Ascent(problem.cost, problem.first, 1.0, 0).price
    best = gtsp.solve_exactly(problem).cost
    assert bounds.walk_bound(problem.cost, problem.first, best, 9 * price).value == 0.0
    assert bounds.walk_bound(problem.cost, problem.first, best, 90 * price).value > 0.0


def test_the_walks_prove_the_optimum() -> None:
    """With work enough, the bound of each of six instances is the optimum, which the quick bound is not."""
    for seed in range(6):
        problem = random_problem(300 + seed, 8, 6)
        optimum = gtsp.solve_exactly(problem).cost
        assert bounds.walk_bound(problem.cost, problem.first, optimum, 10**9).value == pytest.approx(optimum)
        assert bounds.one_tree_bound(problem.cost, problem.first) < 0.99 * optimum


def test_a_start_of_several_nodes() -> None:
    """Without a home, the first cluster has several nodes too: exact search, search and bound agree."""
    rng = np.random.default_rng(4)
    first = np.array([0, 3, 5, 8, 10, 11, 14])
    places = rng.uniform(0, 1, (14, 2))
    cost = np.linalg.norm(places[:, None] - places, axis=2)
    problem = gtsp.make_instance(cost, first)
    best = np.inf
    for order in itertools.permutations(range(1, 6)):
        if order[0] < order[-1]:
            for nodes in itertools.product(*(range(first[k], first[k + 1]) for k in (0, *order))):
                best = min(best, problem.length(np.array(nodes)))
    exact = gtsp.solve_exactly(problem)
    assert exact.cost == pytest.approx(best, rel=1e-12)
    start = gtsp.best_nodes(problem, np.arange(1, 6))[1]
    assert gtsp.search(problem, start, 0, 2000)[0] == pytest.approx(best, rel=1e-12)
    assert bounds.walk_bound(cost, first, best, 10**8).value == pytest.approx(best)


def test_what_is_too_dear_for_the_exact_search_is_found_and_bounded() -> None:
    """Seventeen views: found by search, within 2 % by walks; with no steps and no work, start and quick bound."""
    problem = random_problem(400, 17, 6)
    proven = gtsp.solve(problem, np.arange(1, 18), np.random.default_rng(0), 5000, 10**9)
    assert gtsp.exact_effort(problem) > 5000 * 45_000
    assert proven.cost <= 1.02 * proven.lower_bound
    idle = gtsp.solve(problem, np.arange(1, 18), np.random.default_rng(0), 0, 0)
    assert idle.cost == gtsp.best_nodes(problem, np.arange(1, 18))[0]
    assert idle.lower_bound < proven.lower_bound <= proven.cost < idle.cost


@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_whole_numbers_are_whole_and_never_above_the_optimum(seed: int) -> None:
    """Places on a grid at whole distances: the bound of a search is a whole number, and at most the exact cost."""
    rng = np.random.default_rng(seed)
    places = rng.integers(0, 50, (28, 2)).astype(float)
    first = np.arange(0, 29, 4)
    problem = gtsp.make_instance(np.rint(np.linalg.norm(places[:, None] - places, axis=2)), first)
    cost, tour = gtsp.best_nodes(problem, np.arange(1, 7))
    found = gtsp._found(problem, tour, cost, bounds.one_tree_bound(problem.cost, first))
    assert found.lower_bound == np.floor(found.lower_bound)
    assert found.lower_bound <= gtsp.solve_exactly(problem).cost


def test_the_steps_grow_with_the_square_of_the_clusters() -> None:
    """Up to 22 clusters the steps are those that were asked for; with 88 there are sixteen times as many."""
    few, many = (gtsp.make_instance(np.ones((m, m)), np.arange(m + 1)) for m in (22, 88))
    assert gtsp.scale_steps(few, 1000) == 1000
    assert gtsp.scale_steps(many, 1000) == 16_000
