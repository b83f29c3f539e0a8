"""Search for a generalised travelling salesman's tour: ruin a part of it, rebuild it, choose all nodes anew.

A step takes stretches of neighbouring clusters out of the tour and puts each cluster back where, and through which of
its nodes, it costs least (slack induction by string removals: Christiaens and Vanden Berghe 2020,
doi:10.1287/trsc.2019.0914; with a choice of nodes: Smith and Imeson 2017, doi:10.1016/j.cor.2017.05.010). Where the
result may be worth it, an exact dynamic programme over layers chooses the best node of every cluster for its order.
Worse tours are accepted by simulated annealing.

These are compiled kernels: import this module only where it is used (`planner.compiled`). A tour is cyclic: an array of
one node per cluster. Random numbers are SplitMix64 (Steele, Lea and Flood 2014, doi:10.1145/2660193.2660195), so that
equal seeds give equal tours on every machine. Arrays are copied number by number: a slice assignment brings its error
message along, which costs seconds to compile.
"""

import numpy as np
from numpy.typing import NDArray

from planner.compiled import compiled
from planner.values import Floats, Ints

_STRING = 10  # clusters in one removed stretch at most: the paper's
_REMOVED = 10  # clusters removed in a step on average, in large tours: the paper's
_BLINK = 0.01  # probability that an insertion place is overlooked: the paper's
_WORTH = 1.02  # nodes are chosen anew where the rebuilt tour is at most this much above the current one


@compiled
def anneal(
    cost: Floats, back: Floats, first: Ints, near: Ints, start: Ints, steps: int, hot: float, cold: float, seed: int
) -> tuple[Ints, float]:
    """The best tour seen in a number of steps.

    Args:
        cost: (N, N) costs from node to node.
        back: (N, N) the same transposed, so that costs to a node lie side by side too; of symmetric costs themselves.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1.
        near: (m, m) the clusters by distance from each cluster, itself first.
        start: (m,) nodes of the tour to begin with.
        steps: how often to ruin and recreate.
        hot: temperature at the first step, in units of cost.
        cold: temperature at the last step.
        seed: seed of the random numbers.

    Returns:
        (m,) nodes in visiting order, and the cost of their tour.
    """
    m = len(first) - 1
    state = np.empty(1, dtype=np.uint64)
    state[0] = seed
    cluster_of = np.empty(len(cost), dtype=np.int64)
    widest = 0
    for k in range(m):
        widest = max(widest, first[k + 1] - first[k])
        for v in range(first[k], first[k + 1]):
            cluster_of[v] = k
    value, onward = np.empty(widest), np.empty(widest)
    parent = np.empty((m, widest), dtype=np.int64)
    best, tour = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    _copy(start, best)
    best_cost = _choose_nodes(cost, back, first, cluster_of, best, value, onward, parent)
    _copy(best, tour)
    tour_cost = best_cost
    trial, removed, order = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    is_out = np.zeros(m, dtype=np.int64)
    longest = min(_STRING, max(1, m // 3))
    most_strings = max(1.0, 4.0 * _REMOVED / (1.0 + longest) - 1.0)
    temperature, cooling = hot, (cold / hot) ** (1.0 / max(1, steps - 1))
    for _ in range(steps):
        _copy(tour, trial)
        left = _ruin(cluster_of, near, trial, removed, is_out, longest, most_strings, state)
        trial_cost = _recreate(cost, back, first, trial, removed, order, is_out, left, state)
        if trial_cost <= tour_cost * _WORTH:
            trial_cost = _choose_nodes(cost, back, first, cluster_of, trial, value, onward, parent)
        if trial_cost < tour_cost - temperature * np.log(1.0 - _uniform(state)):
            _copy(trial, tour)
            tour_cost = trial_cost
            if tour_cost < best_cost * (1.0 - 1e-12):
                _copy(tour, best)
                best_cost = tour_cost
        temperature *= cooling
    return best, best_cost


@compiled
def _choose_nodes(
    cost: Floats, back: Floats, first: Ints, cluster_of: Ints, tour: Ints, value: Floats, onward: Floats, parent: Ints
) -> float:
    """Replace the nodes of a tour by the best ones for its order of clusters, exactly; returns the tour's cost.

    `value` and `onward` (widest cluster,) and `parent` (m, widest cluster) are scratch.
    """
    m = len(tour)
    anchor = 0  # the cycle is cut at its smallest cluster
    for i in range(m):
        k, a = cluster_of[tour[i]], cluster_of[tour[anchor]]
        if first[k + 1] - first[k] < first[a + 1] - first[a]:
            anchor = i
    root = cluster_of[tour[anchor]]
    if m == 1:
        return 0.0
    best = np.inf
    chosen = np.empty(m, dtype=np.int64)
    for s in range(first[root], first[root + 1]):
        k = cluster_of[tour[(anchor + 1) % m]]
        for j in range(first[k + 1] - first[k]):
            value[j] = cost[s, first[k] + j]
        for step in range(2, m):
            before, k = k, cluster_of[tour[(anchor + step) % m]]
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
            chosen[anchor] = s
            for step in range(m - 1, 0, -1):
                place = (anchor + step) % m
                chosen[place] = first[cluster_of[tour[place]]] + at
                at = parent[step, at]
    _copy(chosen, tour)
    return best


@compiled
def _copy(source: Ints, target: Ints) -> None:
    for i in range(len(source)):
        target[i] = source[i]


@compiled
def _ruin(
    cluster_of: Ints,
    near: Ints,
    tour: Ints,
    removed: Ints,
    is_out: Ints,
    longest: int,
    most_strings: float,
    state: NDArray[np.uint64],
) -> int:
    """Take stretches near one cluster out of a tour; `removed` then holds their clusters.

    Returns how many nodes are left, at the front of the tour.
    """
    m = len(tour)
    left, strings = m, int(_uniform(state) * most_strings) + 1
    seed = int(_uniform(state) * m)
    for k in near[seed]:
        if strings == 0 or left <= 2:
            break
        if is_out[k]:
            continue
        length = min(int(_uniform(state) * longest) + 1, left - 2)
        at = 0
        while cluster_of[tour[at]] != k:
            at += 1
        begin = (at - int(_uniform(state) * length) + left) % left
        for i in range(length):
            gone = cluster_of[tour[(begin + i) % left]]
            is_out[gone] = 1
            removed[m - left + i] = gone
        kept = 0
        for i in range(left):
            if not is_out[cluster_of[tour[i]]]:
                tour[kept] = tour[i]
                kept += 1
        left = kept
        strings -= 1
    return left


@compiled
def _recreate(
    cost: Floats,
    back: Floats,
    first: Ints,
    tour: Ints,
    removed: Ints,
    order: Ints,
    is_out: Ints,
    left: int,
    state: NDArray[np.uint64],
) -> float:
    """Put the removed clusters back, in random order, each where it costs least; returns the tour's cost."""
    m = len(tour)
    total = 0.0
    for i in range(left):
        total += cost[tour[i], tour[(i + 1) % left]]
    for i in range(m - left):
        j = int(_uniform(state) * (i + 1))
        order[i] = order[j]
        order[j] = removed[i]
    for r in range(m - left):
        k = order[r]
        is_out[k] = 0
        least, place, node = np.inf, 0, first[k]
        for i in range(left):
            if _uniform(state) < _BLINK:
                continue
            a, b = tour[i], tour[(i + 1) % left]
            from_a, to_b, now = cost[a], back[b], cost[a, b]
            for v in range(first[k], first[k + 1]):
                more = from_a[v] + to_b[v] - now
                if more < least:
                    least, place, node = more, i, v
        if least == np.inf:
            a, b = tour[0], tour[1 % left]
            least = cost[a, node] + cost[node, b] - cost[a, b]
        for i in range(left, place + 1, -1):
            tour[i] = tour[i - 1]
        tour[place + 1] = node
        total += least
        left += 1
    return total


@compiled
def _uniform(state: NDArray[np.uint64]) -> float:
    """The next random number, in [0, 1)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * 1.1102230246251565e-16  # 2^-53
