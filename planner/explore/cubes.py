"""Which points to keep of many: the first in each of small cubes."""

import numpy as np

from planner.values import Floats, Ints


def first_in_cubes(points: Floats, side: float) -> Ints:
    """(M,) of the points (N, 3) [m] the first in each cube with such sides [m], in their order.

    They lie less than two million sides apart.
    """
    if not len(points):
        return np.empty(0, dtype=np.int64)
    cubes = np.floor(points / side).astype(np.int64)
    cubes -= cubes.min(axis=0)
    number = np.ravel_multi_index(tuple(cubes.T), tuple(cubes.max(axis=0) + 1))
    return np.sort(np.unique(number, return_index=True)[1])
