"""Extremal spheres and cylinders against the best of all shapes that few points determine."""

import itertools
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

from planner.fitting.extremal import Criterion, fit_extremal
from planner.fitting.least_squares import fit
from planner.fitting.shapes import Shape, ShapeKind
from planner.values import Floats, Ints

NEAR = 0.5  # radii from the middle of the points; other inscribed spheres and circles lie between points or outside


@cache
def splits(n: int, size: int, n_first: int) -> Ints:
    """Return all groups (K, size) of n rows, in two sets, of which the first has `n_first` rows."""
    return np.array([
        [*first, *(each for each in group if each not in first)]
        for group in itertools.combinations(range(n), size)
        for first in itertools.combinations(group, n_first)
    ])  # fmt: skip


def equidistant(points: Floats, groups: Ints, n_first: int) -> Floats:
    """Return the centres (K, d) with one distance to the first points of each group and one to its others.

    If there are several such centres, the one in the plane or on the line of the points is returned.
    """
    local = points[groups] - points[groups[:, :1]]
    base = np.repeat([0, n_first], [n_first, groups.shape[1] - n_first])
    used = np.flatnonzero(base != np.arange(len(base)))
    squares = (local**2).sum(axis=2)
    A, right = 2 * (local - local[:, base])[:, used], (squares - squares[:, base])[:, used]
    if A.shape[1] == A.shape[2]:  # a tenth of the time of the pseudo-inverse
        centres = np.linalg.solve(A, right[..., None])[..., 0]
    else:
        centres = np.einsum("kij,kj->ki", np.linalg.pinv(A, rcond=1e-9), right)
    return np.asarray(points[groups[:, 0]] + centres)


def best_of_supports(points: Floats, criterion: Criterion) -> float:
    """Return the radius or zone of the best sphere (circle, for d = 2) of points (N, d) by all its supports.

    Two to d + 1 points determine a circumscribed one, d + 1 an inscribed one, and d + 2 on both sides a zone.
    """
    n, d = points.shape
    supports = {
        Criterion.CIRCUMSCRIBED: [(size, size) for size in range(2, d + 2)],
        Criterion.INSCRIBED: [(d + 1, d + 1)],
        # A group with its two sets exchanged has the same centre.
        Criterion.ZONE: [(d + 2, n_first) for n_first in range(1, (d + 2) // 2 + 1)],
    }[criterion]
    centres = np.concatenate([equidistant(points, splits(n, *each), each[1]) for each in supports])
    off = np.linalg.norm(centres - points.mean(axis=0), axis=1)
    distances = np.linalg.norm(centres[off < NEAR * np.abs(points).max(), None] - points, axis=2)
    match criterion:
        case Criterion.CIRCUMSCRIBED:
            return float(distances.max(axis=1).min())
        case Criterion.INSCRIBED:
            return float(distances.min(axis=1).max())
    return float(np.ptp(distances, axis=1).min())


def rough(kind: ShapeKind, count: int, rng: np.random.Generator) -> Floats:
    """Return points (N, 3) evenly about a sphere or cylinder of radius 1 with form errors of 0.01.

    Much larger errors of few points make several local optima.
    """
    number, radius = np.arange(count), 1 + rng.normal(0, 0.01, count)
    if kind is ShapeKind.SPHERE:  # on a spiral
        z, turn = 1 - (2 * number + 1) / count, np.pi * (1 + np.sqrt(5)) * number
        ring = np.sqrt(1 - z**2)
        return radius[:, None] * np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
    turn = 2 * np.pi * number / count
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), rng.uniform(-1.5, 1.5, count)])


def value_of(criterion: Criterion, points: Floats, start: Shape) -> float:
    """Return the radius or zone by the product."""
    found = fit_extremal(criterion, points, start)
    return found.zone if criterion is Criterion.ZONE else found.shape.size


@pytest.mark.parametrize("criterion", list(Criterion))
@pytest.mark.parametrize("seed", range(6))
def test_extremal_spheres_are_the_best_of_all_supports(criterion: Criterion, seed: int) -> None:
    """Spheres through two to five of the points."""
    points = rough(ShapeKind.SPHERE, 14, np.random.default_rng(seed))
    found = value_of(criterion, points, fit(ShapeKind.SPHERE, points).shape)
    assert found == pytest.approx(best_of_supports(points, criterion), rel=1e-7)


@pytest.mark.parametrize("criterion", list(Criterion))
@pytest.mark.parametrize("seed", range(3))
def test_extremal_cylinders_are_the_best_over_axes_and_circles(criterion: Criterion, seed: int) -> None:
    """Each axis has an exact circle by all its supports; axes are searched on a grid and from its best one."""
    points = rough(ShapeKind.CYLINDER, 12, np.random.default_rng(seed))
    start = fit(ShapeKind.CYLINDER, points, Shape(ShapeKind.CYLINDER, np.zeros(3), np.array([0, 0, 1.0]), 1.0)).shape
    sign = -1.0 if criterion is Criterion.INSCRIBED else 1.0

    def along(tilt: Floats) -> float:
        across = Shape(ShapeKind.PLANE, np.zeros(3), np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])).frame
        return sign * best_of_supports(points @ across[:, :2], criterion)

    middle, axes = start.axis[:2] / start.axis[2], np.linspace(-0.04, 0.04, 5)
    nearest = min((middle + np.array([x, y]) for x in axes for y in axes), key=along)
    options = {"xatol": 1e-11, "fatol": 1e-13, "initial_simplex": nearest + 0.005 * np.array([[0, 0], [1, 0], [0, 1]])}
    best = sign * float(minimize(along, nearest, method="Nelder-Mead", options=options).fun)
    assert value_of(criterion, points, start) == pytest.approx(best, rel=1e-7)
