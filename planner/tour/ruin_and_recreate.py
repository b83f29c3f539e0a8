"""Search for a tour of a generalised travelling salesman problem by ruin and recreate.

A step removes strings of neighbouring clusters from the tour and inserts each cluster again at the cheapest place
beside its nearest clusters, through its cheapest node (slack induction by string removals: Christiaens and Vanden
Berghe 2020, doi:10.1287/trsc.2019.0914; with a choice of nodes: Smith and Imeson 2017,
doi:10.1016/j.cor.2017.05.010). So a step costs the same in long tours as in short ones. Worse tours are accepted by
simulated annealing. For promising tours an exact dynamic programme over layers chooses the best node of every cluster
for the order.

These are compiled kernels (`planner.compiled`). A tour is cyclic: its array has a row with the visited node of each
cluster and two rows with the clusters before and after it. Random numbers are SplitMix64 (Steele, Lea and Flood 2014,
doi:10.1145/2660193.2660195), so that equal seeds give equal tours on every machine. Arrays are copied number by number:
a slice assignment compiles its error message too, which takes seconds.
"""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.values import Floats, Ints

_STRING = 5  # largest number of clusters in a removed string, from the paper
_REMOVED = 10  # mean number of clusters removed in a step in large tours, from the paper
_BLINK = 0.01  # probability that an insertion place is skipped, from the paper
_BESIDE = 8  # nearest clusters next to which a cluster is inserted; all of them in small tours
_PROMISING = 0.2  # nodes are chosen again if the rebuilt tour exceeds the accepted cost by at most this many mean edges
_NODE, _BEFORE, _AFTER = 0, 1, 2  # rows of a tour

Problem = tuple[Floats, Floats, Ints, Ints]
"""Costs, transposed costs, first node of each cluster, clusters by distance from each cluster (see `anneal`)."""

Layers = tuple[Ints, Floats, Floats, Ints]
"""Scratch arrays of the choice of nodes: order (m,), values and next values (widest cluster,), parents (m, widest)."""


def anneal(
    cost: Floats, back: Floats, first: Ints, near: Ints, start: Ints, steps: int, hot: float, cold: float, seed: int
) -> Ints:
    """Return the best tour found in a number of steps.

    Args:
        cost: (N, N) costs from node to node.
        back: (N, N) the transposed costs, so that costs to a node are contiguous too; `cost` itself if symmetric.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1.
        near: (m, m) the clusters by distance from each cluster, itself first.
        start: (m,) nodes of the initial tour.
        steps: number of ruin-and-recreate steps.
        hot: temperature at the first step, in units of cost.
        cold: temperature at the last step.
        seed: seed of the random numbers.

    Returns:
        (m,) nodes in visiting order, that of cluster 0 first.
    """
    sizes = np.diff(first)
    m, widest = len(sizes), int(sizes.max())
    clusters = np.searchsorted(first, start, side="right") - 1
    tour = np.empty((3, m), dtype=np.int64)
    tour[_NODE, clusters], tour[_BEFORE, clusters] = start, np.roll(clusters, 1)
    tour[_AFTER, clusters] = np.roll(clusters, -1)
    best, trial = tour.copy(), tour.copy()
    layers = np.empty(m, dtype=np.int64), np.empty(widest), np.empty(widest), np.empty((m, widest), dtype=np.int64)
    out = np.empty(m, dtype=np.int64), np.zeros(m, dtype=np.int64)
    state = np.array([seed], dtype=np.uint64)
    root = int(sizes.argmin())  # the cycle is cut at its smallest cluster
    _anneal((cost, back, first, near), root, (best, tour, trial), layers, out, steps, hot, cold, state)
    order = [0]
    while len(order) < m:
        order.append(int(best[_AFTER, order[-1]]))
    return best[_NODE, order]


@compiled
def _anneal(
    problem: Problem, root: int, tours: tuple[Ints, Ints, Ints], layers: Layers, out: tuple[Ints, Ints], steps: int,
    hot: float, cold: float, state: NDArray[np.uint64],
) -> None:  # fmt: skip
    """Ruin and recreate the second of three tours; the first becomes the best one found, the third is scratch."""
    best, tour, trial = tours
    m = tour.shape[1]
    removed, is_out = out
    tour_cost = _choose_nodes(problem, root, tour, layers)
    _copy(tour, best)
    best_cost = tour_cost
    longest = min(_STRING, max(1, m // 3))
    most_strings = max(1.0, 4.0 * _REMOVED / (1.0 + longest) - 1.0)
    temperature, cooling = hot, (cold / hot) ** (1.0 / max(1, steps - 1))
    for _ in range(steps):
        _copy(tour, trial)
        n_removed, saved = _ruin(problem, trial, removed, is_out, longest, most_strings, state)
        trial_cost = tour_cost + saved + _recreate(problem, trial, removed, n_removed, is_out, state)
        accepted = tour_cost - temperature * np.log(1.0 - _uniform(state))
        if trial_cost <= min(accepted, best_cost) + _PROMISING * tour_cost / m:
            trial_cost = _choose_nodes(problem, root, trial, layers)
        if trial_cost < accepted:
            _copy(trial, tour)
            tour_cost = trial_cost
            if tour_cost < best_cost * (1.0 - 1e-12):
                _copy(tour, best)
                best_cost = tour_cost
        temperature *= cooling


@compiled
def _choose_nodes(problem: Problem, root: int, tour: Ints, layers: Layers) -> float:
    """Replace the nodes of a tour by the best ones for its order of clusters, exactly; return the tour's cost.

    The cycle is cut at cluster `root`; `layers` is scratch.
    """
    cost, back, first, _ = problem
    order, value, onward, parent = layers
    m = len(order)
    order[0] = root
    for i in range(1, m):
        order[i] = tour[_AFTER, order[i - 1]]
    best = np.inf
    for s in range(first[root], first[root + 1]):
        k = order[1]
        for j in range(first[k + 1] - first[k]):
            value[j] = cost[s, first[k] + j]
        for step in range(2, m):
            before, k = k, order[step]
            low, size = first[before], first[before + 1] - first[before]
            for j in range(first[k + 1] - first[k]):
                row = back[first[k] + j]
                least, at = np.inf, 0
                for i in range(size):
                    through = value[i] + row[low + i]
                    if through < least:
                        least, at = through, i
                onward[j] = least
                parent[step, j] = at
            for j in range(first[k + 1] - first[k]):
                value[j] = onward[j]
        least, at = np.inf, 0
        for j in range(first[k + 1] - first[k]):
            through = value[j] + cost[first[k] + j, s]
            if through < least:
                least, at = through, j
        if least < best:
            best = least
            tour[_NODE, root] = s
            for step in range(m - 1, 0, -1):
                k = order[step]
                tour[_NODE, k] = first[k] + at
                at = parent[step, at]
    return best


@compiled
def _copy(source: Ints, target: Ints) -> None:
    for row in range(3):
        for k in range(source.shape[1]):
            target[row, k] = source[row, k]


@compiled
def _ruin(
    problem: Problem, tour: Ints, removed: Ints, is_out: Ints, longest: int, most_strings: float,
    state: NDArray[np.uint64],
) -> tuple[int, float]:  # fmt: skip
    """Remove strings near one cluster from a tour; `removed` then begins with their clusters.

    Returns the number of removed clusters and the change of the tour's cost.
    """
    cost, _, _, near = problem
    m, n_removed, more = tour.shape[1], 0, 0.0
    strings = int(_uniform(state) * most_strings) + 1
    for k in near[int(_uniform(state) * m)]:
        if strings == 0 or m - n_removed <= 2:
            break
        if is_out[k]:
            continue
        length = min(int(_uniform(state) * longest) + 1, m - n_removed - 2)
        at = k
        for _ in range(int(_uniform(state) * length)):
            at = tour[_BEFORE, at]
        for _ in range(length):
            before, after = tour[_BEFORE, at], tour[_AFTER, at]
            a, v, b = tour[_NODE, before], tour[_NODE, at], tour[_NODE, after]
            more += cost[a, b] - cost[a, v] - cost[v, b]
            tour[_AFTER, before], tour[_BEFORE, after] = after, before
            is_out[at] = 1
            removed[n_removed] = at
            n_removed += 1
            at = after
        strings -= 1
    return n_removed, more


@compiled
def _recreate(
    problem: Problem, tour: Ints, removed: Ints, n_removed: int, is_out: Ints, state: NDArray[np.uint64]
) -> float:
    """Insert the removed clusters in random order, each at its cheapest place; return the change of the cost."""
    cost, back, first, near = problem
    total = 0.0
    for i in range(n_removed - 1, 0, -1):
        j = int(_uniform(state) * (i + 1))
        removed[i], removed[j] = removed[j], removed[i]
    for r in range(n_removed):
        k = removed[r]
        least, place, node, beside = np.inf, -1, first[k], 0
        for c in near[k]:
            if is_out[c]:
                continue
            for before in (tour[_BEFORE, c], c):
                if place >= 0 and _uniform(state) < _BLINK:
                    continue
                a, b = tour[_NODE, before], tour[_NODE, tour[_AFTER, before]]
                from_a, to_b, now = cost[a], back[b], cost[a, b]
                for v in range(first[k], first[k + 1]):
                    more = from_a[v] + to_b[v] - now
                    if more < least:
                        least, place, node = more, before, v
            beside += 1
            if beside == _BESIDE:
                break
        after = tour[_AFTER, place]
        tour[_NODE, k], tour[_BEFORE, k], tour[_AFTER, k] = node, place, after
        tour[_AFTER, place], tour[_BEFORE, after] = k, k
        is_out[k] = 0
        total += least
        for c in (place, after, k):
            total += _settle(problem, tour, c)
    return total


@compiled
def _settle(problem: Problem, tour: Ints, k: int) -> float:
    """Visit a cluster through the best node between its neighbours' nodes; return the change of the cost."""
    cost, back, first, _ = problem
    a, b = tour[_NODE, tour[_BEFORE, k]], tour[_NODE, tour[_AFTER, k]]
    from_a, to_b = cost[a], back[b]
    now = from_a[tour[_NODE, k]] + to_b[tour[_NODE, k]]
    least = now
    for v in range(first[k], first[k + 1]):
        if from_a[v] + to_b[v] < least:
            least = from_a[v] + to_b[v]
            tour[_NODE, k] = v
    return float(least - now)


@compiled
def _uniform(state: NDArray[np.uint64]) -> float:
    """Return the next random number, in [0, 1)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16  # 2^-53
