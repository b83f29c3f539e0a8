"""The generalised travelling salesman: visit every cluster once through one of its nodes, from a start node and back.

Pure combinatorics on a matrix of edge costs. For one order of the clusters the best nodes follow from an exact dynamic
programme over layers (`best_nodes`). Over orders, `exact` runs the dynamic programme of Held and Karp (1962,
doi:10.1137/0110015) on subsets of clusters, with nodes as states; `improve` is an iterated local search: neighbours by
2-opt and or-opt are ranked with the current nodes and the most promising evaluated exactly, each with its own best
nodes; at a local optimum the order is kicked and the search goes on from there (Lourenco, Martin and Stuetzle 2003,
doi:10.1007/0-306-48056-5_11).

Costs are symmetric. An edge that cannot be used costs `BLOCKED`, a number that dwarfs every real cost: a tour is then
compared first by how many such edges it needs, which an infinite cost could not do.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.ports import Floats
from planner.readonly import readonly

BLOCKED = 1e7
"""Cost of an edge that cannot be used."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """Nodes, their clusters and the costs between them.

    Attributes:
        cost: (N, N) symmetric, finite, not negative; node 0 is the start. Entries inside one cluster are never used.
        offsets: (n + 1,) cluster k holds the nodes offsets[k] to offsets[k + 1] - 1; offsets[0] = 1.
        layered: (n + 1, n + 1, B, B) the same costs by cluster (the start is cluster 0) and padded node.
    """

    cost: Floats
    offsets: Ints
    layered: Floats

    @property
    def n_clusters(self) -> int:
        """Number of clusters, the start not counted."""
        return len(self.offsets) - 1


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A tour and what is known about it.

    Attributes:
        order: (n,) clusters in visiting order.
        cost: cost of the tour through its best nodes.
        lower_bound: no tour costs less.
        evaluations: orders whose best nodes were computed.
    """

    order: Ints
    cost: float
    lower_bound: float
    evaluations: int


def instance(cost: Floats, offsets: Ints) -> Instance:
    """Check and index an instance.

    Args:
        cost: (N, N) symmetric costs, not negative; inf where an edge cannot be used.
        offsets: (n + 1,) first node of each cluster and the number of nodes; the first is 1.

    Raises:
        PlannerError: if a cluster is empty or a cost negative or not symmetric.
    """
    offsets = readonly("offsets", offsets, (None,), np.int64)
    cost = readonly("cost", np.minimum(cost, BLOCKED), (int(offsets[-1]), int(offsets[-1])))
    sizes = np.diff(offsets)
    if offsets[0] != 1 or (sizes < 1).any():
        raise PlannerError("every cluster needs at least one node, and the first cluster begins at node 1")
    if (cost < 0).any() or not np.array_equal(cost, cost.T):
        raise PlannerError("the costs must be symmetric and not negative")
    n, width = len(sizes), int(sizes.max(initial=1))
    members = np.full((n + 1, width), -1)
    members[0, 0] = 0
    for k in range(n):
        members[k + 1, : sizes[k]] = np.arange(offsets[k], offsets[k + 1])
    layered = cost[members[:, None, :, None], members[None, :, None, :]]
    absent = members < 0
    # A padded node costs far more than any number of blocked edges, so it is never chosen.
    layered[absent[:, None, :, None] | absent[None, :, None, :]] = 1e6 * BLOCKED
    return Instance(cost, offsets, layered)


def evaluate(problem: Instance, orders: Ints) -> Floats:
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
    totals: Floats = (reached + layered[clusters[:, -1], 0, :, 0]).min(axis=1)
    return totals


def best_nodes(problem: Instance, order: Ints) -> tuple[float, Ints]:
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


def exact_work(problem: Instance) -> int:
    """Additions that `exact` needs: subsets times nodes squared."""
    return int(2 ** min(problem.n_clusters, 60)) * len(problem.cost) ** 2


def exact(problem: Instance) -> Found:
    """The optimum over all orders and nodes, by dynamic programming over subsets; see `exact_work` for its price."""
    n, cost, offsets = problem.n_clusters, problem.cost, problem.offsets
    if n == 0:
        return Found(np.zeros(0, dtype=np.int64), 0.0, 0.0, 1)
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
    total = float(ends.min())
    while True:
        last = int(ends.argmin())
        cluster = int(np.searchsorted(offsets, last, side="right")) - 1
        order.append(cluster)
        subset &= ~(1 << cluster)
        if subset == 0:
            break
        ends = best[subset] + cost[:, last]
    found = np.array(order[::-1], dtype=np.int64)
    return Found(_oriented(found), total, total, 1)


def improve(problem: Instance, start: Ints, rng: np.random.Generator, evaluations: int) -> Found:
    """A good order within a budget of evaluated orders, never worse than the start.

    Args:
        problem: the instance.
        start: (n,) order to begin with.
        rng: source of the kicks.
        evaluations: orders to evaluate at most (each with its own best nodes).

    Returns:
        The best order found with `lower_bound`.
    """
    n = problem.n_clusters
    bound = lower_bound(problem)
    moves = _neighbours(n)
    best, best_cost, used = start, float(evaluate(problem, start[None])[0]), 1
    current, current_cost = best, best_cost
    while n > 2 and used < evaluations and best_cost > bound * (1 + 1e-12):
        nodes = np.concatenate(([0], best_nodes(problem, current)[1]))
        fixed = problem.cost[np.ix_(nodes, nodes)]  # costs between positions of the order, through the current nodes
        picked = moves if len(moves) <= _RANKED else moves[rng.choice(len(moves), _RANKED, replace=False)]
        ends = fixed[0, picked[:, 0]] + fixed[picked[:, -1], 0]
        ranked = ends + fixed[picked[:, :-1], picked[:, 1:]].sum(axis=1)
        promising = picked[np.argsort(ranked, kind="stable")[:_EVALUATED]]
        orders = current[promising - 1]
        costs = evaluate(problem, orders)
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
        current_cost = float(evaluate(problem, current[None])[0])
        used += 1
    return Found(_oriented(best), best_cost, min(bound, best_cost), used)


def lower_bound(problem: Instance, rounds: int = 40) -> float:
    """No tour costs less: the bound of Held and Karp (1970, doi:10.1287/opre.18.6.1138) on the clusters.

    Each pair of clusters costs what its cheapest pair of nodes costs, so the bound is that of a travelling salesman
    who may change the node between arriving and leaving: it is weak where the choice of nodes matters. It is the
    cheapest 1-tree, lifted by node penalties in a subgradient ascent.
    """
    n = problem.n_clusters
    cheapest = problem.layered.min(axis=(2, 3))
    if n == 0:
        return 0.0
    if n == 1:
        return float(2.0 * cheapest[0, 1])
    penalty, bound, step = np.zeros(n + 1), 0.0, 0.5 * float(np.median(cheapest[0, 1:])) / n
    for _ in range(rounds):
        lifted = cheapest + penalty[:, None] + penalty[None, :]
        total, degree = _one_tree(lifted)
        bound = max(bound, total - 2.0 * float(penalty.sum()))
        if (degree == 2).all():
            break
        penalty += step * (degree - 2)
        step *= 0.95
    return bound


_RANKED, _EVALUATED = 4000, 32  # neighbours ranked with fixed nodes, and evaluated exactly, per step


@lru_cache(maxsize=8)
def _neighbours(n: int) -> Ints:
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


def _kick(order: Ints, rng: np.random.Generator) -> Ints:
    """The double bridge: exchange two neighbouring stretches of the order (2-opt and or-opt cannot undo it at once)."""
    a, b, c = np.sort(rng.choice(len(order) + 1, 3, replace=False))
    return np.concatenate((order[:a], order[b:c], order[a:b], order[c:]))


def _oriented(order: Ints) -> Ints:
    """The same tour, in the direction in which the first cluster has the smaller number; symmetric costs allow both."""
    return order[::-1].copy() if len(order) > 1 and order[0] > order[-1] else order


def _one_tree(cost: Floats) -> tuple[float, Ints]:
    """Cost and degrees of the cheapest spanning tree on clusters 1.. plus the two cheapest edges of the start."""
    count = len(cost)
    degree = np.zeros(count, dtype=np.int64)
    near, parent = cost[1].copy(), np.ones(count, dtype=np.int64)
    near[[0, 1]] = np.inf
    total = 0.0
    for _ in range(count - 2):
        k = int(near.argmin())
        total += float(near[k])
        degree[k] += 1
        degree[parent[k]] += 1
        near[k] = np.inf
        closer = np.isfinite(near) & (cost[k] < near)
        near[closer] = cost[k, closer]
        parent[closer] = k
    two = np.argsort(cost[0, 1:], kind="stable")[:2] + 1
    degree[two] += 1
    degree[0] += 2
    return total + float(cost[0, two].sum()), degree
