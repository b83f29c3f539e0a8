"""Generalised tours whose costs depend on the direction: every solver against all orders, nodes and directions."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from planner.ports import JointLimits
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import order_views
from planner.tour.visits import TourProblem
from planner.values import Floats

LIMITS = JointLimits(np.full(6, -3.0), np.full(6, 3.0), np.ones(6), np.full(6, 2.0))


def _brute_force(cost: Floats, first: np.ndarray) -> float:
    """The cheapest closed tour from node 0 over all orders and nodes."""
    best = np.inf
    for order in itertools.permutations(range(1, len(first) - 1)):
        for nodes in itertools.product(*(range(first[k], first[k + 1]) for k in order)):
            tour = [0, *nodes, 0]
            best = min(best, sum(cost[a, b] for a, b in itertools.pairwise(tour)))
    return best


def _problem(seed: int, clusters: int) -> tuple[Floats, np.ndarray]:
    rng = np.random.default_rng(seed)
    first = np.concatenate([[0, 1], 1 + np.cumsum(rng.integers(1, 4, clusters))])
    return rng.uniform(0, 1, (first[-1], first[-1])), first


@pytest.mark.parametrize("seed", range(12))
def test_exact_search_and_bound_on_directed_costs(seed: int) -> None:
    """Exact is exact; the search finds the optimum of these small ones; no bound is above it."""
    cost, first = _problem(seed, 5)
    problem = gtsp.make_instance(cost, first)
    assert not problem.symmetric
    best = _brute_force(cost, first)
    exact = gtsp.solve_exactly(problem)
    assert exact.cost == pytest.approx(best, abs=1e-12)
    assert problem.length(exact.tour) == pytest.approx(best, abs=1e-12)
    start = gtsp.best_nodes(problem, np.arange(1, 6))[1]
    length, tour = gtsp.search(problem, start, seed, 3000)
    assert length == pytest.approx(problem.length(tour), abs=1e-12)
    assert sorted(problem.clusters_of(tour).tolist()) == list(range(6))
    assert length == pytest.approx(best, abs=1e-9)
    assert gtsp.bounds.one_tree(problem.either, problem.first) <= best + 1e-9
    assert gtsp.bounds.by_walks(problem.either, problem.first, best, 10**7).value <= best + 1e-9


def test_a_one_way_ring_is_found_in_its_direction() -> None:
    """Forwards costs 1, backwards 10, all else 100: twelve clusters, the search must not turn it round."""
    m = 12
    cost = np.full((m, m), 100.0)
    for k in range(m):
        cost[k, (k + 1) % m], cost[(k + 1) % m, k] = 1.0, 10.0
    problem = gtsp.make_instance(cost, np.arange(m + 1))
    rng = np.random.default_rng(1)
    found = gtsp.solve(problem, 1 + rng.permutation(m - 1), rng, 4000)
    assert found.cost == pytest.approx(m)
    assert found.tour.tolist() == list(range(m))


@pytest.mark.parametrize("seed", range(6))
def test_sweeps_are_entered_at_one_end_and_left_at_the_other(seed: int) -> None:
    """Views with two ends each, driven either way: the time is the least over orders and directions, stays counted."""
    from planner.timing.move_time import move_time

    rng = np.random.default_rng(seed)
    ends = rng.uniform(-1, 1, (4, 2, 6))
    stays = rng.uniform(0.1, 0.5, 4)
    home = np.zeros(6)
    moves = TourProblem.straight(list(ends), home, LIMITS)
    moves = replace(moves, leave=[0, 2, 1, 4, 3, 6, 5, 8, 7], stays=np.concatenate([[0.0], np.repeat(stays, 2)]))
    found = order_views(moves, np.tile(np.eye(4), (4, 1, 1)), rng)
    best = np.inf
    for order in itertools.permutations(range(4)):
        for way in itertools.product((0, 1), repeat=4):
            stands, time = home, float(stays.sum())
            for view, begin in zip(order, way, strict=True):
                time += float(move_time(stands, ends[view, begin], LIMITS))
                stands = ends[view, 1 - begin]
            best = min(best, time + float(move_time(stands, home, LIMITS)))
    assert found.duration == pytest.approx(best, abs=1e-9)
