"""Sweeps: where the poses stand, and what is refused."""

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.viewpoints.viewpoints import (
    Viewpoints,
    straight_sweep_poses,
    sweep_viewpoints,
    turned_sweep_poses,
    view_sphere,
)


def _views() -> Viewpoints:
    return view_sphere(np.array([0.1, 0.2, 0.3]), 0.5, np.pi / 4, np.pi / 3, (0.0, 0.7))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_straight_sweep_stands_in_the_middles_of_equal_cells_along_its_direction(count: int) -> None:
    """Distances between poses are length / K, the mean is the viewpoint, nothing turns."""
    views = _views()
    swept_views = sweep_viewpoints(views, straight_sweep_poses(0.14, count, (0.0, 3.0, 4.0)))
    T = swept_views.T_object_scanner
    assert T.shape == (len(views), count, 4, 4)
    np.testing.assert_allclose(
        T[:, :, :3, :3], np.repeat(views.T_object_scanner[:, :, :3, :3], count, axis=1), atol=1e-15
    )
    np.testing.assert_allclose(T[..., :3, 3].mean(axis=1), views.T_object_scanner[:, 0, :3, 3], atol=1e-15)
    along = np.einsum("vij,j->vi", views.T_object_scanner[:, 0, :3, :3], [0.0, 0.6, 0.8]) * 0.14 / count
    np.testing.assert_allclose(np.diff(T[..., :3, 3], axis=1), np.repeat(along[:, None], count - 1, axis=1), atol=1e-15)
    for name in ("face", "standoff", "roll"):
        assert (getattr(swept_views, name) == getattr(views, name)).all()


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_turned_sweep_turns_about_the_line_through_the_source(count: int) -> None:
    """Sources and the y axis stay; the viewing axes lie at the middles of equal angles from -x to +x."""
    poses = turned_sweep_poses(1.2, count)
    assert (poses[:, :3, 3] == 0).all()
    np.testing.assert_allclose(poses[:, :3, 1], np.tile([0.0, 1.0, 0.0], (count, 1)), atol=1e-15)
    np.testing.assert_allclose(
        np.arctan2(poses[:, 0, 2], poses[:, 2, 2]), 1.2 * ((np.arange(count) + 0.5) / count - 0.5), atol=1e-15
    )
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1.0)
    T = sweep_viewpoints(_views(), poses).T_object_scanner
    np.testing.assert_allclose(T, _views().T_object_scanner @ poses, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: straight_sweep_poses(0.0, 3), "length must be above 0"),
        (lambda: straight_sweep_poses(np.inf, 3), "length must be above 0"),
        (lambda: straight_sweep_poses(0.1, 0), "at least one"),
        (lambda: straight_sweep_poses(0.1, 3, (0, 0, 0)), "no direction"),
        (lambda: turned_sweep_poses(np.pi, 3), "below pi"),
        (lambda: turned_sweep_poses(float("nan"), 3), "above 0"),
        (lambda: turned_sweep_poses(0.5, -1), "at least one"),
        (
            lambda: sweep_viewpoints(
                sweep_viewpoints(_views(), straight_sweep_poses(0.1, 2)), straight_sweep_poses(0.1, 2)
            ),
            "2 poses each",
        ),
        (lambda: sweep_viewpoints(_views(), np.empty((0, 4, 4))), "no pose"),
    ],
)
def test_impossible_sweeps_are_refused(make, words: str) -> None:
    """One sentence with what would be valid."""
    with pytest.raises(PlannerError, match=words):
        make()
