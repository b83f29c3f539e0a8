"""Which points to keep of many: one of each small cube, or one of each side that it was looked at from."""

import numpy as np

from planner.values import Floats, Ints


def first_in_cubes(points: Floats, side: float) -> Ints:
    """(M,) of the points (N, 3) [m] the first in each cube with such sides [m], in their order."""
    return np.sort(np.unique(_cubes(points, side), return_index=True)[1])


def first_of_each_side(points: Floats, looks: Floats, side: float, least: float) -> Ints:
    """(M,) of the points the first in each cube, and there the first whose direction leads elsewhere, in their order.

    Args:
        points: (N, 3) [m].
        looks: (N, 3) unit vectors, what each looks towards or is looked at from.
        side: of a cube [m].
        least: cosine to the direction of the first one below which another leads elsewhere.
    """
    _, first, cube = np.unique(_cubes(points, side), return_index=True, return_inverse=True)
    elsewhere = np.flatnonzero(np.einsum("ij,ij->i", looks, looks[first[cube]]) < least)
    second = elsewhere[np.unique(cube[elsewhere], return_index=True)[1]]
    return np.sort(np.concatenate([first, second]))


def _cubes(points: Floats, side: float) -> Ints:
    """(N,) the number of the cube that each point lies in."""
    if not len(points):
        return np.empty(0, dtype=np.int64)
    cubes = np.floor(points / side).astype(np.int64)
    cubes -= cubes.min(axis=0)
    return np.asarray(np.ravel_multi_index(tuple(cubes.T), tuple(cubes.max(axis=0) + 1)))
