"""M compared with a slow program for single pairs: angles by arctan2 and arccos, rays by float64 triangles."""

import math

import numpy as np
import pytest

from cell.scanners.laser_area import LaserArea
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import apply_occluders, fill_matrix
from planner.viewpoints.viewpoints import optimal_scanning_zone
from tests.support.meshes import block, caster_of, joined

SCANNER = LaserArea((50, 40), (2, 2), (100, 260), 60, 70, 80)


def _is_free(triangles, start, end):
    """Return whether no triangle is between start and end (float64); the face of the end lies beyond 1 - 1e-5."""
    a, b, c = triangles
    direction = end - start
    e1, e2 = b - a, c - a
    p = np.cross(direction, e2)
    determinant = (p * e1).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = start - a
        u = (p * s).sum(axis=1) / determinant
        q = np.cross(s, e1)
        v = q @ direction / determinant
        t = (e2 * q).sum(axis=1) / determinant
        crossed = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t < 1 - 1e-5)
    return not crossed.any()


def _is_measured(T, point, normal, triangle_sets):
    """Evaluate one pair by the definitions; return None if a limit is closer than 1e-6."""
    local = T[:3, :3].T @ (point - T[:3, 3])
    distance = math.sqrt(sum(local**2))
    sensor = T[:3, 3] + T[:3, :3] @ np.array([0.06, 0, 0])

    def angle(towards):
        direction = towards - point
        return math.degrees(math.acos(np.clip(direction @ normal / np.linalg.norm(direction), -1, 1)))

    margins = [
        25 - abs(math.degrees(math.atan2(local[0], local[2]))),
        20 - abs(math.degrees(math.atan2(local[1], local[2]))),
        (distance - 0.1) * 1000,
        (0.26 - distance) * 1000,
        70 - angle(T[:3, 3]),
        80 - angle(sensor),
    ]
    if min(abs(margin) for margin in margins) < 1e-6:
        return None
    return min(margins) > 0 and all(
        _is_free(triangles, start, point) for triangles in triangle_sets for start in (T[:3, 3], sensor)
    )


@pytest.mark.parametrize("occluded", [False, True])
def test_every_entry_equals_the_single_pair(occluded):
    """Every entry is equal for 150 samples x 72 viewpoints of three boxes, with and without a bar as occluder."""
    part = joined(
        block((0.1, 0.08, 0.03), (0, 0, 0)),
        block((0.03, 0.08, 0.07), (0.03, 0, 0.06)),
        block((0.02, 0.01, 0.04), (-0.03, 0, 0.04)),
    )
    bar = block((0.02, 0.3, 0.02), (-0.08, 0, 0.1))
    caster = caster_of(part)
    samples = draw_samples(part, part, 150, np.random.default_rng(5))
    views = optimal_scanning_zone(part, [0.17], [0.3, 1.2])
    matrix = fill_matrix(views, samples, SCANNER, caster)
    sets = [tuple(part.vertices[part.faces[:, corner]] for corner in range(3))]
    if occluded:
        matrix = apply_occluders(matrix, views, SCANNER, caster_of(bar))
        sets.append(tuple(bar.vertices[bar.faces[:, corner]] for corner in range(3)))
    dense = matrix.matrix().toarray()
    compared = 0
    for j, T in enumerate(views.T_object_scanner[:, 0]):
        for i in range(len(samples)):
            expected = _is_measured(T, samples.points[i], samples.normals[i], sets)
            if expected is not None:
                compared += 1
                assert dense[i, j] == expected, (i, j)
    assert compared > 0.99 * dense.size
    assert 0.02 < dense.mean() < 0.5
