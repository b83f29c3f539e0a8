"""Rigid motions and their uncertainty: screws against the matrix logarithm, covariances against noisy fits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from planner.errors import PlannerError
from planner.registration.localisation import fit_pairs, fit_three_two_one
from planner.registration.rigid import motion_from_screw, recentring_matrix, remove_free_motion, screw_from_motion, skew
from planner.values import Floats

CENTRE, LENGTH = np.array([0.02, -0.01, 0.03]), 0.06


def _random_pose(seed: int) -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = np.random.default_rng(seed).uniform(-1, 1, 3)
    return T


def _by_angles(first: Floats, x: Floats) -> Floats:
    """Return a pose by another parametrisation than the program's: Euler angles in base, and a shift in base."""
    T = first.copy()
    T[:3, :3] = Rotation.from_euler("zyx", x[3:]).as_matrix() @ first[:3, :3]
    T[:3, 3] += x[:3]
    return T


@pytest.mark.parametrize("size", [1e-7, 1e-3, 0.5, 3.0])
def test_screws_are_the_matrix_logarithm(size: float) -> None:
    """`screw_from_motion` is the logarithm about the centre, `motion_from_screw` the exponential."""
    rng = np.random.default_rng(1)
    turn = rng.standard_normal(3)
    screw = np.concatenate([rng.standard_normal(3), size * turn / np.linalg.norm(turn)])
    T = motion_from_screw(screw, CENTRE)
    np.testing.assert_allclose(screw_from_motion(T, CENTRE), screw, atol=1e-9)
    shifted = T.copy()
    shifted[:3, 3] += T[:3, :3] @ CENTRE - CENTRE
    np.testing.assert_allclose(np.real(logm(shifted))[:3, 3], screw[:3], atol=1e-8)
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(screw[3:]), screw[:3]
    np.testing.assert_allclose(shifted, expm(generator), atol=1e-14)


def test_a_small_motion_about_another_centre_moves_points_alike() -> None:
    """`recentring_matrix` agrees with its definition, and `skew` with numpy's cross product."""
    rng = np.random.default_rng(0)
    change, offset, points = rng.standard_normal(6), rng.standard_normal(3), rng.standard_normal((20, 3))
    here = change[:3] + np.cross(change[3:], points)
    there = recentring_matrix(offset) @ change
    np.testing.assert_allclose(there[:3] + np.cross(there[3:], points - offset), here, atol=1e-12)
    np.testing.assert_allclose(skew(offset) @ change[:3], np.cross(offset, change[:3]))


def test_free_motions_are_taken_back_to_the_least() -> None:
    """Motions that differ by a turn about a free axis are reduced to the one without a component of that turn."""
    axis, through = np.array([0.0, 0.6, 0.8]), CENTRE + np.array([0.03, 0.0, 0.0])
    free = np.concatenate([np.cross(axis, CENTRE - through), LENGTH * axis])[:, None]
    free /= np.linalg.norm(free)
    small = motion_from_screw(np.array([0.01, 0.002, -0.004, 0.03, -0.05, 0.02]), CENTRE)
    least = [
        remove_free_motion(
            motion_from_screw(angle * np.concatenate([np.zeros(3), axis]), through) @ small, free, CENTRE, LENGTH
        )
        for angle in (0.0, 0.4, -0.3)
    ]
    np.testing.assert_allclose(least[1], least[0], atol=1e-6)
    np.testing.assert_allclose(least[2], least[0], atol=1e-6)
    scale = np.array([1, 1, 1, LENGTH, LENGTH, LENGTH])
    assert abs(float(free[:, 0] @ (scale * screw_from_motion(least[0], CENTRE)))) < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_pairs_against_least_squares_in_other_coordinates(seed: int) -> None:
    """The closed form has no greater sum of squares than scipy's answer by Euler angles, and is the same pose."""
    rng = np.random.default_rng(seed)
    T, nominal = _random_pose(seed), rng.uniform(-0.1, 0.1, (5, 3))
    measured = nominal @ T[:3, :3].T + T[:3, 3] + rng.normal(0, 1e-3, (5, 3))

    def off(x: Floats) -> Floats:
        pose = _by_angles(T, x)
        return np.asarray((nominal @ pose[:3, :3].T + pose[:3, 3] - measured).ravel())

    solved = least_squares(off, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = fit_pairs(nominal, measured, CENTRE, LENGTH)
    np.testing.assert_allclose(found.T, _by_angles(T, solved.x), atol=1e-7)
    assert (found.residuals**2).sum() == pytest.approx(2 * solved.cost, rel=1e-9)


@pytest.mark.parametrize("fit", [fit_pairs, fit_three_two_one])
def test_the_covariance_is_the_scatter_of_fits(fit: Callable[..., Any]) -> None:
    """The covariance of one fit equals that of 500 fits with noise of 0.1 mm, to 20 % of the largest variance."""
    rng, T = np.random.default_rng(3), _random_pose(7)
    nominal = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.08, 0], [0, 0, 0.02], [0.1, 0, 0.02], [0, 0.04, 0.02]])
    there = nominal @ T[:3, :3].T + T[:3, 3]
    fits = [fit(nominal, there + rng.normal(0, 1e-4, (6, 3)), CENTRE, LENGTH, 1e-4) for _ in range(500)]
    screws = np.stack([screw_from_motion(np.linalg.inv(T) @ each.T, CENTRE) for each in fits])
    scale = np.array([1, 1, 1, LENGTH, LENGTH, LENGTH])
    scatter, reported = np.cov((screws * scale).T), fits[0].covariance * scale[:, None] * scale
    np.testing.assert_allclose(scatter, reported, atol=0.2 * np.abs(reported).max())


@pytest.mark.parametrize("width_mm", [0.0, 0.1])
def test_pairs_on_a_line_are_refused(width_mm: float) -> None:
    """Points on a line leave the turn about it open. A width of a thousandth of the length is noise, two are not."""
    T, axis = _random_pose(2), np.array([0.6, 0.0, 0.8])
    nominal = CENTRE + np.linspace(-0.1, 0.1, 4)[:, None] * axis
    nominal[1, 1] += width_mm / 1000
    measured = nominal @ T[:3, :3].T + T[:3, 3]
    with pytest.raises(PlannerError, match="the nominal points lie on a line, and any rotation about it fits as well"):
        fit_pairs(nominal, measured, CENTRE, LENGTH)
    nominal[1, 1] += 0.0004
    with pytest.raises(PlannerError, match="the measured points lie on a line"):
        fit_pairs(nominal, measured, CENTRE, LENGTH)
    measured = nominal @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(fit_pairs(nominal, measured, CENTRE, LENGTH).T, T, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_six_points_meet_their_planes(seed: int) -> None:
    """The result agrees with scipy's root of the six plane conditions by Euler angles."""
    rng = np.random.default_rng(seed)
    T, nominal = _random_pose(seed), rng.uniform(-0.1, 0.1, (6, 3))
    first = np.cross(nominal[1] - nominal[0], nominal[2] - nominal[0])
    z = first / np.linalg.norm(first)
    x = nominal[4] - nominal[3] - z * ((nominal[4] - nominal[3]) @ z)
    x /= np.linalg.norm(x)
    normals = np.stack([z, z, z, np.cross(z, x), np.cross(z, x), x])
    slid = rng.uniform(-0.01, 0.01, (6, 3))
    slid -= (slid * normals).sum(axis=1)[:, None] * normals
    measured = (nominal + slid + rng.normal(0, 1e-4, (6, 3))) @ T[:3, :3].T + T[:3, 3]

    def off(x: Floats) -> Floats:
        pose = np.linalg.inv(_by_angles(T, x))
        return np.asarray((((measured @ pose[:3, :3].T + pose[:3, 3]) - nominal) * normals).sum(axis=1))

    solved = least_squares(off, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert solved.cost < 1e-20
    np.testing.assert_allclose(
        fit_three_two_one(nominal, measured, CENTRE, LENGTH).T, _by_angles(T, solved.x), atol=1e-7
    )


def test_points_without_a_placement_are_refused() -> None:
    """Too few, identical, collinear and stacked points are refused with one sentence each."""
    some = np.random.default_rng(0).uniform(-0.1, 0.1, (6, 3))
    with pytest.raises(PlannerError, match="at least three"):
        fit_pairs(some[:2], some[:2], CENTRE, LENGTH)
    with pytest.raises(PlannerError, match="name the same point"):
        fit_pairs(some[[0, 0, 0]], some[:3], CENTRE, LENGTH)
    with pytest.raises(PlannerError, match="six pairs"):
        fit_three_two_one(some[:5], some[:5], CENTRE, LENGTH)
    line = some.copy()
    line[2] = (line[0] + line[1]) / 2
    with pytest.raises(PlannerError, match="first three nominal points lie on a line"):
        fit_three_two_one(line, some, CENTRE, LENGTH)
    above = some.copy()
    normal = np.cross(some[1] - some[0], some[2] - some[0])
    above[4] = above[3] + 0.05 * normal / np.linalg.norm(normal)
    with pytest.raises(PlannerError, match="on a normal of the plane"):
        fit_three_two_one(some, above, CENTRE, LENGTH)
