"""Shared surface of set-ups: shapes with known free motions connect their scans or leave them free."""

import numpy as np
import pytest

from cell.plan.shared_surface import connecting_view, remaining_freedom, shared_surfaces, unconnected_setups
from cell.runs.schema import CommonSurface
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.registration.observability import free_motions_of_surface
from planner.values import Bools


def _box() -> tuple[SurfaceSamples, Bools]:
    """Return samples on a box of 60 x 80 x 100 mm, and (S, 6) their sides: +x, -x, +y, -y, +z, -z."""
    rng = np.random.default_rng(0)
    half, points, normals = np.array([0.03, 0.04, 0.05]), [], []
    for axis in range(3):
        for sign in (1, -1):
            own = rng.uniform(-1, 1, (200, 3)) * half
            own[:, axis] = sign * half[axis]
            points.append(own)
            normals.append(np.tile(sign * np.eye(3)[axis], (200, 1)))
    flat = np.zeros(1200, dtype=np.int32)
    samples = SurfaceSamples(np.concatenate(points), np.concatenate(normals), np.ones(1200), flat, flat)
    return samples, np.repeat(np.eye(6, dtype=bool), 200, axis=0)


def _ball() -> SurfaceSamples:
    normals = np.random.default_rng(1).normal(size=(2000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    flat = np.zeros(2000, dtype=np.int32)
    return SurfaceSamples(0.05 * normals, normals, np.ones(2000), flat, flat)


@pytest.mark.parametrize(("sides", "free"), [((4,), 3), ((2, 4), 1), ((0, 2, 4), 0), ((0, 1, 2, 3), 1), ((), 6)])
def test_sides_of_a_box_leave_motions_along_them_free(sides: tuple[int, ...], free: int) -> None:
    """One plane leaves three motions, two leave one, three none, four parallel to an axis one, and no side six."""
    samples, side = _box()
    seen = side[:, list(sides)].any(axis=1)
    assert len(free_motions_of_surface(samples.points[seen], samples.normals[seen])) == free


def test_a_ball_turns_and_nothing_is_lost_by_it() -> None:
    """A ball has three free turns, as has a cap of it. The shared surface of two caps leaves no other freedom."""
    samples = _ball()
    lower, upper = samples.normals[:, 2] < 0.2, samples.normals[:, 2] > -0.2
    assert len(free_motions_of_surface(samples.points, samples.normals)) == 3
    assert remaining_freedom(lower, upper, samples) == ()


def test_set_ups_are_apart_where_their_common_side_slides() -> None:
    """Set-ups whose shared sides leave a free motion are unconnected."""
    samples, side = _box()
    seen = {1: side[:, [0, 2, 4]].any(axis=1), 2: side[:, [0, 1, 2, 4]].any(axis=1), 3: side[:, [1, 3, 5]].any(axis=1)}
    pairs = shared_surfaces(seen, samples)
    assert [pair.setups for pair in pairs] == [(1, 2), (1, 3), (2, 3)]
    assert [bool(pair.free_motions) for pair in pairs] == [False, True, True]
    assert [pair.share for pair in pairs] == pytest.approx([0.5, 0, 1 / 6])
    assert unconnected_setups(pairs, (1, 2, 3)) == (3,)
    assert unconnected_setups([CommonSurface(setups=(2, 3), share=0.1, free_motions=())], (1, 2, 3)) == (2, 3)


def test_the_view_that_joins_is_the_one_that_ends_the_freedom() -> None:
    """Only the view that adds both a side and an edge connects the set-ups, if it is usable."""
    samples, side = _box()

    def columns(*sides: tuple[int, ...]) -> Measurability:
        dense = np.stack([side[:, list(each)].any(axis=1) for each in sides], axis=1)
        indptr = np.concatenate([[0], np.cumsum(dense.sum(axis=1))])
        return Measurability(indptr, np.nonzero(dense)[1].astype(np.int32), samples, len(sides))

    M = {0: columns((0, 2, 4)), 5: columns((1, 3, 5), (0,), (2, 4), (0, 2, 4))}
    views = {0: np.array([0]), 5: np.array([0])}
    usable = {0: np.ones(1, dtype=bool), 5: np.ones(4, dtype=bool)}
    assert connecting_view(M, usable, views) == (5, 3)
    assert connecting_view(M, usable, {0: views[0], 5: np.array([0, 3])}) is None
    usable[5][3] = False
    assert connecting_view(M, usable, views) is None
