"""Compiled walk through a voxel grid: which voxels a straight leg crosses (Amanatides and Woo 1987).

Voxel (i, j, k) is the box from `low + edge * (i, j, k)` to one edge further; its flat place is that of a C-ordered
array.
"""

import numpy as np

from planner.compiled import compiled
from planner.values import Floats, Ints


@compiled
def cross(starts: Floats, ends: Floats, low: Floats, edge: float, shape: Ints, crossed: Ints) -> None:
    """Count the legs that cross each voxel.

    Args:
        starts: (N, 3) where the legs begin [m].
        ends: (N, 3) where they end [m].
        low: (3,) lowest corner of the grid [m].
        edge: of a voxel [m].
        shape: (3,) voxels along each axis.
        crossed: (shape[0] * shape[1] * shape[2],) is added to.
    """
    at, step = np.empty(3, np.int64), np.empty(3, np.int64)
    border, across = np.empty(3), np.empty(3)
    for n in range(len(starts)):
        begin, end = 0.0, 1.0  # of the leg, as shares of its length: what lies in the grid
        for axis in range(3):
            along = ends[n, axis] - starts[n, axis]
            first = low[axis] - starts[n, axis]
            last = first + edge * shape[axis]
            if along == 0.0:
                if first > 0.0 or last < 0.0:
                    begin = 2.0
            else:
                begin = max(begin, min(first / along, last / along))
                end = min(end, max(first / along, last / along))
        if begin >= end:
            continue
        for axis in range(3):
            along = ends[n, axis] - starts[n, axis]
            place = (starts[n, axis] + begin * along - low[axis]) / edge
            at[axis] = min(max(np.int64(np.floor(place)), 0), shape[axis] - 1)
            step[axis] = 1 if along > 0.0 else -1
            if along == 0.0:
                border[axis], across[axis] = np.inf, np.inf
            else:
                wall = low[axis] + edge * (at[axis] + (1 if along > 0.0 else 0))
                border[axis] = (wall - starts[n, axis]) / along
                across[axis] = edge / abs(along)
        while True:
            crossed[(at[0] * shape[1] + at[1]) * shape[2] + at[2]] += 1
            axis = 0
            if border[1] < border[axis]:
                axis = 1
            if border[2] < border[axis]:
                axis = 2
            if border[axis] >= end:
                break
            at[axis] += step[axis]
            if at[axis] < 0 or at[axis] >= shape[axis]:
                break
            border[axis] += across[axis]
