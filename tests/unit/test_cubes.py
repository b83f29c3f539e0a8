"""Points thinned by cubes, against brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.explore.space import first_in_cubes

SIDE = 0.25


@given(st.integers(0, 2**32 - 1), st.integers(0, 300))
def test_each_cube_keeps_its_first_point(seed: int, count: int) -> None:
    """Cubes begin at 0, on either side of it; of no points there are none."""
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    taken: dict[tuple[int, ...], int] = {}
    for number, point in enumerate(points):
        taken.setdefault(tuple(np.floor(point / SIDE).astype(int)), number)
    assert first_in_cubes(points, SIDE).tolist() == sorted(taken.values())


@pytest.mark.parametrize("offset", [1e6, -1e6])
def test_far_from_the_origin_they_are_the_same(offset: float) -> None:
    """Numbers of cubes do not grow with the place."""
    points = np.round(np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * 1024) / 1024  # so that sums are exact
    assert np.array_equal(first_in_cubes(points + offset, SIDE), first_in_cubes(points, SIDE))
