"""Points thinned by cubes, against brute force."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.explore.cubes import first_in_cubes, first_of_each_side
from planner.values import Floats

SIDE = 0.25


def _points(seed: int, count: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    looks = rng.normal(size=(count, 3))
    return rng.uniform(-1, 1, (count, 3)), looks / np.linalg.norm(looks, axis=1, keepdims=True)


@given(st.integers(0, 2**32 - 1), st.integers(0, 300))
def test_each_cube_keeps_its_first_point(seed: int, count: int) -> None:
    """Cubes begin at 0, on either side of it; of no points there are none."""
    points, _ = _points(seed, count)
    taken: dict[tuple[int, ...], int] = {}
    for number, point in enumerate(points):
        taken.setdefault(tuple(np.floor(point / SIDE).astype(int)), number)
    assert first_in_cubes(points, SIDE).tolist() == sorted(taken.values())


@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.sampled_from([-1.0, 0.0, 0.7]))
def test_each_cube_keeps_its_first_point_of_another_side_too(seed: int, count: int, least: float) -> None:
    """At most two: which look apart by more than asked for."""
    points, looks = _points(seed, count)
    taken: dict[tuple[int, ...], list[int]] = {}
    for number, point in enumerate(points):
        kept = taken.setdefault(tuple(np.floor(point / SIDE).astype(int)), [])
        if not kept or (len(kept) == 1 and looks[kept[0]] @ looks[number] < least):
            kept.append(number)
    assert first_of_each_side(points, looks, SIDE, least).tolist() == sorted(chain(*taken.values()))


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_far_from_the_origin_they_are_the_same(offset: float) -> None:
    """Numbers of cubes do not grow with the place."""
    points, looks = _points(0, 1000)
    points = np.round(points * 1024) / 1024  # so that sums are exact
    assert np.array_equal(first_in_cubes(points + offset, SIDE), first_in_cubes(points, SIDE))
    there = first_of_each_side(points + offset, looks, SIDE, 0.0)
    assert np.array_equal(there, first_of_each_side(points, looks, SIDE, 0.0))
