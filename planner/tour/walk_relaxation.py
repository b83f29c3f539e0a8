"""Shortest closed walks with a short memory: the relaxation that gives the lower bound of a tour.

A walk leaves the start, makes as many visits as there are clusters and returns. It goes through nodes, so it cannot
arrive at one configuration and leave from another; but it may visit a cluster again after it has forgotten it. Its
memory at a cluster `a` holds the clusters of the set `NG(a)` that it visited and has not forgotten since (the ng-route
relaxation of Baldacci, Mingozzi and Roberti 2011, doi:10.1287/opre.1110.0975). Every tour is such a walk, so the
shortest walk is never longer than the best tour; with all clusters remembered everywhere it is the best tour.

Costs are symmetric, so walks from the start and walks back to it are the same: layers are computed to the middle only,
and the halves are joined at a common node.

These are compiled kernels that get the arrays of their results (allocation in a kernel takes a third of its compile
time). A state is (cluster, memory, node); the states of cluster k are at
base[k] + memory * size + node, where the bits of `memory` are the members of NG(k).
"""

import numpy as np

from planner.compiled import compiled
from planner.values import Floats, Ints


def memory_table(neighbours: Ints, count: Ints) -> tuple[Ints, Ints]:
    """Tabulate the memory after each step between clusters; in NumPy, because compilation would take longer.

    Args:
        neighbours: (m, g) members of each NG set, the first `count[k]` of row k.
        count: (m,) sizes of the NG sets.

    Returns:
        (T, m) the memory on arrival at each cluster, -1 if the walk may not go there; and (m,) the first row of each
        cluster: row rows[k] + memory is for a walk that leaves k with this memory.
    """
    m = len(count)
    bit = np.full((m, m), -1)
    for k, size in enumerate(count):
        bit[k, neighbours[k, :size]] = np.arange(size)
    number = np.where(bit >= 0, 1 << np.maximum(bit, 0), 0)  # [k, i]: i as a member of NG(k)
    tables = []
    for a, size in enumerate(count):
        members = neighbours[a, :size]
        holds = np.arange(1 << size)[:, None] >> np.arange(size) & 1
        arrived = number[:, a] | holds @ number[:, members].T
        arrived[:, a] = -1
        arrived[:, members] = np.where(holds, -1, arrived[:, members])
        tables.append(arrived)
    return np.concatenate(tables), np.concatenate(([0], np.cumsum(1 << count)[:-1]))


@compiled
def extend_walks(
    cost: Floats, first: Ints, prize: Floats, start: int, table: Ints, rows: Ints, count: Ints, base: Ints,
    value: Floats,
) -> None:  # fmt: skip
    """Compute the cost of the cheapest walk from the start to each state, by number of visits.

    Args:
        cost: (N, N) symmetric costs.
        first: (m + 1,) first node of each cluster; cluster 0 is the start's and is not visited.
        prize: (m,) gain of each visit to a cluster.
        start: node of cluster 0 at which the walk begins.
        table: from `memory_table`.
        rows: from `memory_table`.
        count: (m,) sizes of the NG sets.
        base: (m + 1,) first state of each cluster, and the number of states.
        value: (visits of the longest walk + 1, states) infinities, overwritten with costs less prizes; row 0 is not
            used.
    """
    m, depth = len(first) - 1, len(value) - 1
    for b in range(1, m):
        for v in range(first[b], first[b + 1]):
            value[1, base[b] + v - first[b]] = cost[start, v] - prize[b]
    for k in range(1, depth):
        here, there = value[k], value[k + 1]
        for a in range(1, m):
            size_a = first[a + 1] - first[a]
            for memory in range(1 << count[a]):
                at = base[a] + memory * size_a
                alive = False
                for i in range(size_a):
                    if here[at + i] < np.inf:
                        alive = True
                if not alive:
                    continue
                row = table[rows[a] + memory]
                for b in range(1, m):
                    arrived = row[b]
                    if arrived < 0:
                        continue
                    low, size_b = first[b], first[b + 1] - first[b]
                    target = there[base[b] + arrived * size_b : base[b] + (arrived + 1) * size_b]
                    gained = prize[b]
                    for i in range(size_a):
                        so_far = here[at + i] - gained
                        edges = cost[first[a] + i, low : low + size_b]
                        for j in range(size_b):
                            reached = so_far + edges[j]
                            if reached < target[j]:
                                target[j] = reached


@compiled
def join_walks(
    value: Floats, first: Ints, prize: Floats, count: Ints, base: Ints, near: int, far: int, through: Floats
) -> tuple[float, int, int, int, int]:
    """Find the cheapest closed walk whose halves meet after `near` visits on one side and `far` on the other.

    The visit at which they meet counts in both. `through` (N,) is lowered to the cost of the cheapest such walk that
    meets in each node.

    Returns:
        Its cost less prizes; cluster, node (from 0 in the cluster) and memories of the halves where they meet.
    """
    m = len(first) - 1
    best, cluster, node, memory_near, memory_far = np.inf, 0, 0, 0, 0
    for k in range(1, m):
        size, memories = first[k + 1] - first[k], 1 << count[k]
        least = np.empty(memories)
        for i in range(size):
            for memory in range(memories):
                least[memory] = value[far, base[k] + memory * size + i]
            for bit in range(count[k]):  # least over all subsets of each memory
                for memory in range(memories):
                    if (memory >> bit) & 1 and least[memory ^ (1 << bit)] < least[memory]:
                        least[memory] = least[memory ^ (1 << bit)]
            for memory in range(memories):
                here = value[near, base[k] + memory * size + i]
                if here == np.inf:
                    continue
                total = here + least[memories - 1 - memory] + prize[k]
                if total < through[first[k] + i]:
                    through[first[k] + i] = total
                if total < best:
                    best, cluster, node, memory_near = total, k, i, memory
    if best < np.inf:
        size, memories = first[cluster + 1] - first[cluster], 1 << count[cluster]
        least_far = np.inf
        for memory in range(memories):
            if memory & memory_near:
                continue
            there = value[far, base[cluster] + memory * size + node]
            if there < least_far:
                least_far, memory_far = there, memory
    return best, cluster, node, memory_near, memory_far
