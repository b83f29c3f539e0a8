"""The graph of views that share enough for their scans to be brought into one frame."""

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from planner.cover.problem import Overlap
from planner.cover.sets import Graph
from planner.values import Ints

NO_GRAPH: Graph = np.zeros((0, 0), dtype=np.uint8)

_BLOCK = 512  # columns whose shared areas are looked at at a time
_ROUNDING = 1e-9  # share of an overlap that rounding may have taken from it


def joined_columns(M: Any, areas: ArrayLike, overlap: Overlap) -> Graph:
    """Which columns of a matrix are joined.

    Args:
        M: (S, V) matrix, True where a column measures a row.
        areas: (S,) [m^2].
        overlap: when two count as joined.

    Returns:
        (V, V) 1 where joined, 0 on the diagonal.
    """
    matrix: Any = sp.csc_array(M, dtype=bool).astype(np.float64)
    weighted: Any = sp.csc_array(sp.diags_array(np.asarray(areas, dtype=np.float64)) @ matrix)
    n = matrix.shape[1]
    own = np.asarray(weighted.sum(axis=0)).ravel()
    adjacent = np.zeros((n, n), dtype=np.uint8)
    for first in range(0, n, _BLOCK):  # shared areas of all pairs at once would be 8 bytes each
        some = slice(first, first + _BLOCK)
        shared = (matrix[:, some].T @ weighted).toarray()
        least: Any = overlap.area
        if overlap.share is not None:
            least = overlap.share * np.minimum(own[some, None], own[None, :])
        adjacent[some] = (shared >= least * (1 - _ROUNDING)) & (shared > 0)
    np.fill_diagonal(adjacent, 0)
    return adjacent


def parts_of(adjacent: Graph, columns: Ints) -> Ints:
    """(n,) number of the part of the graph that each column belongs to; parts are numbered by their first column."""
    from scipy.sparse.csgraph import connected_components  # costs start-up

    if not len(columns):
        return np.zeros(0, dtype=np.int64)
    _, labels = connected_components(adjacent[np.ix_(columns, columns)], directed=False)
    return np.asarray(labels, dtype=np.int64)


def connected(adjacent: Graph, columns: Ints) -> bool:
    """Whether the graph of columns holds together; that of none and of one does."""
    return len(adjacent) == 0 or len(columns) < 2 or int(parts_of(adjacent, columns).max()) == 0


def join(adjacent: Graph, columns: Ints) -> Ints:
    """Columns and those on shortest ways between their parts, until the graph holds together.

    The largest part grows towards the nearest other one (Takahashi, Matsuyama 1980, for Steiner trees).

    Raises:
        AssertionError: if no way exists; the caller looks first.
    """
    chosen = list(dict.fromkeys(columns.tolist()))
    while not connected(adjacent, np.array(chosen)):
        members = np.array(chosen, dtype=np.int64)
        labels = parts_of(adjacent, members)
        home = members[labels == int(np.bincount(labels).argmax())]
        goal = np.zeros(len(adjacent), dtype=bool)
        goal[np.setdiff1d(members, home)] = True
        before = np.full(len(adjacent), -2, dtype=np.int64)
        before[home] = -1
        front, found = home, -1
        while found < 0:
            assert len(front), "the parts cannot be joined"
            reached = (adjacent[front] == 1) & (before == -2)[None, :]
            fresh = np.flatnonzero(reached.any(axis=0))
            before[fresh] = front[reached[:, fresh].argmax(axis=0)]
            hits = fresh[goal[fresh]]
            found = int(hits[0]) if len(hits) else -1
            front = fresh
        while before[found] >= 0:
            found = int(before[found])
            if found not in chosen:
                chosen.append(found)
    return np.array(chosen, dtype=np.int64)
