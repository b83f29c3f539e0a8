"""Shortest closed walks with a short memory: the relaxation from which a tour's lower bound comes.

A walk leaves the start, makes as many visits as there are clusters and returns. It goes through nodes, so it cannot
arrive at one joint solution and leave from another; but it may come back to a cluster once it has forgotten it. What it
remembers at a cluster `a` is which clusters of the set `NG(a)` it visited without forgetting them since (the ng-route
relaxation of Baldacci, Mingozzi and Roberti 2011, doi:10.1287/opre.1110.0975). Every tour is such a walk, so the
shortest walk is never longer than the best tour; with all clusters remembered everywhere it is the best tour.

Costs are symmetric, so walks from the start and walks back to it are the same: layers are computed to the middle only,
and the halves are put together at the node where they meet.

Compiled kernels: import this module only where it is used. A state is (cluster, memory, node); the states of cluster k
stand at base[k] + memory * size + node, where `memory` is a number whose bits are the members of NG(k).
"""

import numpy as np

from planner.compiled import compiled
from planner.values import Floats, Ints


@compiled
def memory_table(neighbours: Ints, count: Ints) -> tuple[Ints, Ints]:
    """What is remembered after each step between clusters.

    Args:
        neighbours: (m, g) members of each NG set, the first `count[k]` of row k.
        count: (m,) sizes of the NG sets.

    Returns:
        (T, m) the memory on arrival at each cluster, -1 where the walk may not go there; and (m,) the first row of each
        cluster: row rows[k] + memory is for a walk that leaves k with that memory.
    """
    m = len(count)
    rows = np.zeros(m, dtype=np.int64)
    total = 0
    for k in range(m):
        rows[k] = total
        total += 1 << count[k]
    bit = np.full((m, m), -1, dtype=np.int64)
    for k in range(m):
        for i in range(count[k]):
            bit[k, neighbours[k, i]] = i
    table = np.full((total, m), -1, dtype=np.int64)
    for a in range(m):
        for memory in range(1 << count[a]):
            for b in range(m):
                if b == a or (bit[a, b] >= 0 and (memory >> bit[a, b]) & 1):
                    continue
                arrived = 0
                if bit[b, a] >= 0:
                    arrived |= 1 << bit[b, a]
                for i in range(count[a]):
                    if (memory >> i) & 1 and bit[b, neighbours[a, i]] >= 0:
                        arrived |= 1 << bit[b, neighbours[a, i]]
                table[rows[a] + memory, b] = arrived
    return table, rows


@compiled
def layers(
    cost: Floats, first: Ints, prize: Floats, start: int, table: Ints, rows: Ints, count: Ints, base: Ints, depth: int
) -> Floats:
    """Cost of the cheapest walk from the start to each state, by its number of visits.

    Args:
        cost: (N, N) symmetric costs.
        first: (m + 1,) first node of each cluster; cluster 0 is the start's and is not visited.
        prize: (m,) gained by each visit of a cluster.
        start: node of cluster 0 at which the walk begins.
        table: from `memory_table`.
        rows: from `memory_table`.
        count: (m,) sizes of the NG sets.
        base: (m + 1,) first state of each cluster, and the number of states.
        depth: visits of the longest walk.

    Returns:
        (depth + 1, states) costs less prizes; row 0 is not used.
    """
    m = len(first) - 1
    value = np.full((depth + 1, base[m]), np.inf)
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
    return value


@compiled
def join(
    value: Floats, first: Ints, prize: Floats, count: Ints, base: Ints, near: int, far: int
) -> tuple[float, int, int, int, int, Floats]:
    """The cheapest closed walk whose halves meet after `near` visits on one side and `far` on the other.

    The visit at which they meet counts in both.

    Returns:
        Its cost less prizes; cluster, node (from 0 in the cluster) and the memories of the halves where they meet; and
        (N,) the cost of the cheapest such walk through each node there.
    """
    m = len(first) - 1
    through = np.full(first[m], np.inf)
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
    return best, cluster, node, memory_near, memory_far, through
