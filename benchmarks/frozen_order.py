"""The ordering of views as it was before generalised tours were searched by ruin and recreate: frozen for comparison.

Copied from the commit 279c889 (planner/order/generalised_tsp.py and planner/order/orderings.py) and cut to what `cell
plan` ran then: a Christofides tour in task space, improved by an iterated local search (2-opt and or-opt, each order
with its own best joint solutions, double-bridge kicks), or the exact dynamic programme for few views. Only the bound
that could end the local search early is left out. Not changed since; used by `benchmarks.cycle_time` alone. Times of
moves are today's.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np

from planner.order.moves import Moves
from planner.order.orderings import OrderStatus, Sequence

_BLOCKED = 1e7
EVALUATIONS = 10_000
_ALWAYS_EXACT = 10_000_000
_EXACT_PER_EVALUATION = 6
_RANKED, _EVALUATED = 4000, 32


class _Instance:
    def __init__(self, cost: Any, offsets: Any) -> None:
        self.cost, self.offsets = np.minimum(cost, _BLOCKED), offsets
        sizes = np.diff(offsets)
        n, width = len(sizes), int(sizes.max(initial=1))
        members = np.full((n + 1, width), -1)
        members[0, 0] = 0
        for k in range(n):
            members[k + 1, : sizes[k]] = np.arange(offsets[k], offsets[k + 1])
        self.layered = self.cost[members[:, None, :, None], members[None, :, None, :]]
        absent = members < 0
        self.layered[absent[:, None, :, None] | absent[None, :, None, :]] = 1e6 * _BLOCKED
        self.n_clusters = n


def frozen(
    moves: Moves,
    T_base_scanner: Any,
    rng: np.random.Generator,
    *,
    budget: int = EVALUATIONS,
    bound_work: int | None = 0,
    T_base_home: Any = None,
    start: Any = None,
) -> Sequence:
    """Order the views as it was done then; arguments as in `planner.order.orderings.sequence`."""
    problem = _Instance(moves.times, moves.offsets)
    baseline = _christofides(problem, T_base_scanner, T_base_home)
    local_work = budget * len(problem.cost) * problem.layered.shape[-1]
    exact_work = int(2 ** min(problem.n_clusters, 60)) * len(problem.cost) ** 2
    if exact_work <= max(_ALWAYS_EXACT, _EXACT_PER_EVALUATION * local_work):
        order = _exact(problem)
    else:
        starts = np.array([baseline] if start is None else [baseline, start])
        order = _improve(problem, starts[int(_evaluate(problem, starts).argmin())], rng, budget)
    baseline_cost, baseline_nodes = _best_nodes(problem, baseline)
    found, chosen = _best_nodes(problem, order)
    if baseline_cost < found:
        found, chosen, order = baseline_cost, baseline_nodes, baseline
    choice = chosen - problem.offsets[order]
    return Sequence(
        order=order,
        choice=choice,
        q=moves.q[chosen],
        duration=found if found < _BLOCKED else float("inf"),
        baseline_duration=baseline_cost if baseline_cost < _BLOCKED else float("inf"),
        lower_bound=0.0,
        status=OrderStatus.HEURISTIC if found < _BLOCKED else OrderStatus.NO_TOUR,
        steps=budget,
    )


def _evaluate(problem: Any, orders: Any) -> Any:
    """Cost of each order through its best nodes.

    Args:
        problem: the instance.
        orders: (P, n) clusters, counted from 0, in visiting order.

    Returns:
        (P,) costs.
    """
    if orders.shape[1] == 0:
        return np.zeros(len(orders))
    layered, clusters = problem.layered, orders + 1
    reached = layered[0, clusters[:, 0], 0, :]
    for k in range(1, clusters.shape[1]):
        reached = (reached[:, :, None] + layered[clusters[:, k - 1], clusters[:, k]]).min(axis=1)
    totals: Any = (reached + layered[clusters[:, -1], 0, :, 0]).min(axis=1)
    return totals


def _best_nodes(problem: Any, order: Any) -> tuple[float, Any]:
    """The exact best node of each cluster for one order.

    Args:
        problem: the instance.
        order: (n,) clusters in visiting order.

    Returns:
        The cost, and (n,) node numbers in visiting order.
    """
    clusters = order + 1
    if len(clusters) == 0:
        return 0.0, np.zeros(0, dtype=np.int64)
    layered = problem.layered
    reached, came_from = layered[0, clusters[0], 0], []
    for before, after in pairwise(clusters):
        through = reached[:, None] + layered[before, after]
        came_from.append(through.argmin(axis=0))
        reached = through.min(axis=0)
    total = reached + layered[clusters[-1], 0, :, 0]
    chosen = [int(total.argmin())]
    for parents in reversed(came_from):
        chosen.append(int(parents[chosen[-1]]))
    return float(total.min()), problem.offsets[order] + np.array(chosen[::-1], dtype=np.int64)


def _exact(problem: Any) -> Any:
    """The optimum over all orders and nodes, by dynamic programming over subsets; see `exact_work` for its price."""
    n, cost, offsets = problem.n_clusters, problem.cost, problem.offsets
    if n == 0:
        return np.zeros(0, dtype=np.int64)
    nodes = [slice(offsets[k], offsets[k + 1]) for k in range(n)]
    full = 2**n - 1
    best = np.full((full + 1, len(cost)), np.inf)  # cheapest way from the start through the subset, by last node
    for k in range(n):
        best[1 << k, nodes[k]] = cost[0, nodes[k]]
    for subset in range(1, full):
        inside = np.concatenate([np.arange(s.start, s.stop) for k, s in enumerate(nodes) if subset >> k & 1])
        onward = (best[subset, inside, None] + cost[inside]).min(axis=0)
        for k in range(n):
            if not subset >> k & 1:
                best[subset | 1 << k, nodes[k]] = onward[nodes[k]]
    order, subset, ends = [], full, best[full] + cost[:, 0]
    while True:
        last = int(ends.argmin())
        cluster = int(np.searchsorted(offsets, last, side="right")) - 1
        order.append(cluster)
        subset &= ~(1 << cluster)
        if subset == 0:
            break
        ends = best[subset] + cost[:, last]
    return np.array(order[::-1], dtype=np.int64)


def _improve(problem: Any, start: Any, rng: np.random.Generator, evaluations: int) -> Any:
    """A good order within a budget of evaluated orders, never worse than the start.

    Args:
        problem: the instance.
        start: (n,) order to begin with.
        rng: source of the kicks.
        evaluations: orders to evaluate at most (each with its own best nodes).

    Returns:
        The best order found.
    """
    n = problem.n_clusters
    moves = _neighbours(n)
    best, best_cost, used = start, float(_evaluate(problem, start[None])[0]), 1
    current, current_cost = best, best_cost
    while n > 2 and used < evaluations:
        nodes = np.concatenate(([0], _best_nodes(problem, current)[1]))
        fixed = problem.cost[np.ix_(nodes, nodes)]  # costs between positions of the order, through the current nodes
        picked = moves if len(moves) <= _RANKED else moves[rng.choice(len(moves), _RANKED, replace=False)]
        ends = fixed[0, picked[:, 0]] + fixed[picked[:, -1], 0]
        ranked = ends + fixed[picked[:, :-1], picked[:, 1:]].sum(axis=1)
        promising = picked[np.argsort(ranked, kind="stable")[:_EVALUATED]]
        orders = current[promising - 1]
        costs = _evaluate(problem, orders)
        used += len(orders)
        k = int(costs.argmin())
        if costs[k] < current_cost - 1e-12:
            current, current_cost = orders[k], float(costs[k])
            if current_cost < best_cost:
                best, best_cost = current, current_cost
            continue
        # A local optimum: kick the best order, or the current one where it is nearly as good.
        if current_cost > 1.03 * best_cost:
            current = best
        current = _kick(current, rng)
        current_cost = float(_evaluate(problem, current[None])[0])
        used += 1
    return best


@lru_cache(maxsize=8)
def _neighbours(n: int) -> Any:
    """(Q, n) positions 1..n of an order, rearranged by each 2-opt move and each or-opt move of up to three clusters."""
    identity = tuple(range(1, n + 1))
    found: dict[tuple[int, ...], None] = {}
    for i in range(n):
        for j in range(i + 2, n + 1):
            found[identity[:i] + identity[i:j][::-1] + identity[j:]] = None
        for length in (1, 2, 3):
            moved, rest = identity[i : i + length], identity[:i] + identity[i + length :]
            for place in range(len(rest) + 1):
                found[rest[:place] + moved + rest[place:]] = None
                found[rest[:place] + moved[::-1] + rest[place:]] = None
    found.pop(identity, None)
    moves = np.array(list(found), dtype=np.int64).reshape(-1, n)
    moves.flags.writeable = False
    return moves


def _kick(order: Any, rng: np.random.Generator) -> Any:
    """The double bridge: exchange two neighbouring stretches of the order (2-opt and or-opt cannot undo it at once)."""
    a, b, c = np.sort(rng.choice(len(order) + 1, 3, replace=False))
    return np.concatenate((order[:a], order[b:c], order[a:b], order[c:]))


def _christofides(problem: Any, T_base_scanner: Any, T_base_home: Any | None) -> Any:
    """(n,) order of the views along a Christofides tour through the scanner's positions."""
    n = problem.n_clusters
    positions = np.asarray(T_base_scanner)[:, :3, 3]
    if T_base_home is not None:
        positions = np.concatenate((T_base_home[None, :3, 3], positions))
    tour = _task_space_tour(positions)
    if T_base_home is not None:
        return np.roll(tour, -int(np.flatnonzero(tour == 0)[0]))[1:] - 1
    if n < 2:
        return tour
    cuts = np.stack([np.roll(tour, -k) for k in range(n)])
    best: Any = cuts[int(_evaluate(problem, cuts).argmin())]
    return best


def _task_space_tour(positions: Any) -> Any:
    """(m,) cyclic Christofides tour through (m, 3) positions [m]."""
    m = len(positions)
    if m < 4:  # every cyclic order has the same length
        return np.arange(m, dtype=np.int64)
    graph = nx.Graph()
    lengths = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    graph.add_weighted_edges_from((a, b, float(lengths[a, b])) for a in range(m) for b in range(a))
    tour: list[int] = nx.approximation.christofides(graph)
    return np.array(tour[:-1], dtype=np.int64)
