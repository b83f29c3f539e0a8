"""Candidate viewpoints: the geometry of Section 3.4, the meaning of roll, sweeps."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.viewpoints.viewpoints import (
    Viewpoints,
    enclosing_radius,
    optimal_scanning_zone,
    straight_sweep_poses,
    sweep_viewpoints,
    turned_sweep_poses,
    view_sphere,
)


def ball(subdivisions: int = 2) -> TriangleMesh:
    """Return a rotated icosphere of radius 0.1 m off the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    turned = trimesh.transformations.rotation_matrix(0.3, [1, 2, 3])[:3, :3]
    return TriangleMesh(mesh.vertices @ turned.T + [0.5, -0.2, 0.1], mesh.faces)


def assert_proper(viewpoints: Viewpoints) -> None:
    """Require every pose to be a rotation and a translation."""
    R = viewpoints.T_object_scanner[:, 0, :3, :3]
    assert np.abs(np.einsum("vji,vjk->vik", R, R) - np.eye(3)).max() < 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)
    assert (viewpoints.T_object_scanner[:, 0, 3] == [0, 0, 0, 1]).all()


def test_each_face_has_views_at_its_standoff_against_its_normal() -> None:
    """Source = centre + standoff x normal, viewing direction = -normal, for every face, standoff and roll in order."""
    mesh = ball()
    viewpoints = optimal_scanning_zone(mesh, [0.3, 0.1], [0.0, np.pi / 2, 1.0])
    assert len(viewpoints) == len(mesh.faces) * 6
    assert_proper(viewpoints)
    face = np.repeat(np.arange(len(mesh.faces)), 6)
    assert (viewpoints.face == face).all()
    assert (viewpoints.standoff == np.tile([0.3, 0.3, 0.3, 0.1, 0.1, 0.1], len(mesh.faces))).all()
    assert (viewpoints.roll == np.tile([0.0, np.pi / 2, 1.0], len(mesh.faces) * 2)).all()
    normals, centres = mesh.normals[face], mesh.centres[face]
    T = viewpoints.T_object_scanner[:, 0]
    assert np.abs(T[:, :3, 2] + normals).max() < 1e-12
    assert np.abs(T[:, :3, 3] - (centres + viewpoints.standoff[:, None] * normals)).max() < 1e-12


def test_at_roll_zero_no_other_roll_is_more_parallel_to_z() -> None:
    """The baseline's z component at roll 0 is the largest over all rolls."""
    rolls = np.linspace(0, 2 * np.pi, 73)[:-1]
    viewpoints = optimal_scanning_zone(ball(1), [0.3], list(rolls))
    z = viewpoints.T_object_scanner[:, 0, 2, 0].reshape(-1, len(rolls))
    assert (z[:, 0] >= z.max(axis=1) - 1e-12).all()
    assert (z[:, 0] > 0).all()


def test_a_view_along_z_has_its_baseline_along_x() -> None:
    """On a box's top and bottom the baseline is the object's +x at roll 0, and +-y at 90 degrees by the right hand."""
    body = trimesh.creation.box(extents=(0.1, 0.2, 0.3))
    mesh = TriangleMesh(body.vertices, body.faces)
    viewpoints = optimal_scanning_zone(mesh, [0.3], [0.0, np.pi / 2])
    normals = mesh.normals[viewpoints.face]
    baseline = viewpoints.T_object_scanner[:, 0, :3, 0]
    flat, turned = np.abs(normals[:, 2]) > 0.5, viewpoints.roll > 0
    assert (flat & ~turned).sum() == 4
    assert np.abs(baseline[flat & ~turned] - [1, 0, 0]).max() < 1e-12
    view = -normals[flat & turned]
    assert np.abs(baseline[flat & turned] - np.cross(view, [1, 0, 0])).max() < 1e-12


def test_roll_turns_the_baseline_right_handed_about_the_view() -> None:
    """The scanner at roll r is the one at roll 0 turned by r about its own viewing axis (Rodrigues' formula)."""
    roll = 0.4
    viewpoints = optimal_scanning_zone(ball(1), [0.2], [0.0, roll])
    T = viewpoints.T_object_scanner[:, 0].reshape(-1, 2, 4, 4)
    for before, after in T:
        turn = trimesh.transformations.rotation_matrix(roll, before[:3, 2])[:3, :3]
        assert np.abs(turn @ before[:3, :3] - after[:3, :3]).max() < 1e-12
        assert (before[:3, 3] == after[:3, 3]).all()


def test_a_nearly_flat_top_does_not_scatter_its_baselines() -> None:
    """Normals that deviate from z by float32 rounding all give a baseline along x."""
    rng = np.random.default_rng(0)
    triangles = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) + rng.random((50, 1, 3))
    triangles[..., 2] += rng.normal(size=(50, 3)) * 1e-6
    mesh = TriangleMesh(triangles.reshape(-1, 3), np.arange(150).reshape(-1, 3))
    baseline = optimal_scanning_zone(mesh, [0.3], [0.0]).T_object_scanner[:, 0, :3, 0]
    assert np.abs(baseline - [1, 0, 0]).max() < 1e-4


@given(st.floats(-1e-2, 1e-2), st.floats(-1e-2, 1e-2), st.sampled_from([1.0, -1.0]))
def test_rotations_are_proper_near_the_z_axis(x: float, y: float, z: float) -> None:
    """For any view close to the z axis, the pose is a rotation to 1e-12 with the right direction."""
    normal = np.array([x, y, z]) / np.linalg.norm([x, y, z])
    first = np.cross(normal, [0, 1, 0])
    mesh = TriangleMesh(np.stack([np.zeros(3), first, np.cross(normal, first)]), np.array([[0, 1, 2]]))
    viewpoints = optimal_scanning_zone(mesh, [0.3], [0.0])
    assert_proper(viewpoints)
    assert np.abs(viewpoints.T_object_scanner[0, 0, :3, 2] + normal).max() < 1e-12


def test_a_face_without_area_gives_no_viewpoint() -> None:
    """A degenerate face has no normal and no viewpoint, and the other faces keep their numbers."""
    mesh = ball(1)
    with_sliver = TriangleMesh(mesh.vertices, np.vstack([[[0, 0, 1]], mesh.faces]))
    viewpoints = optimal_scanning_zone(with_sliver, [0.3], [0.0])
    assert (viewpoints.face == np.arange(1, len(mesh.faces) + 1)).all()


def test_the_view_sphere_looks_at_its_centre_from_its_radius() -> None:
    """Every source is a radius away and the viewing ray passes through the centre."""
    centre = np.array([0.1, -0.2, 0.3])
    viewpoints = view_sphere(centre, 0.5, np.deg2rad(30), np.deg2rad(45), [0.0, 0.7])
    assert_proper(viewpoints)
    T = viewpoints.T_object_scanner[:, 0]
    assert np.abs(T[:, :3, 3] + 0.5 * T[:, :3, 2] - centre).max() < 1e-12
    assert (viewpoints.face == -1).all()
    assert (viewpoints.standoff == 0.5).all()


@pytest.mark.parametrize(("step_deg", "count"), [(45, 26), (30, 62), (15, 266), (90, 6), (180, 2)])
def test_the_view_sphere_has_no_direction_twice(step_deg: float, count: int) -> None:
    """The paper's steps give (180 / step - 1) x 360 / step + 2 directions, all different."""
    viewpoints = view_sphere([0, 0, 0], 1.0, np.deg2rad(step_deg), np.deg2rad(step_deg))
    directions = viewpoints.T_object_scanner[:, 0, :3, 2]
    assert len(viewpoints) == count
    assert len(np.unique(np.round(directions, 9) + 0.0, axis=0)) == count


def test_the_view_sphere_leaves_no_gap_wider_than_its_step() -> None:
    """No direction in space is farther than half a step's diagonal from a viewpoint."""
    viewpoints = view_sphere([0, 0, 0], 1.0, np.deg2rad(30), np.deg2rad(30))
    anywhere = np.random.default_rng(0).normal(size=(5000, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    nearest = np.arccos(np.clip(anywhere @ -viewpoints.T_object_scanner[:, 0, :3, 2].T, -1, 1)).min(axis=1)
    assert np.rad2deg(nearest.max()) < 15 * np.sqrt(2)


def test_the_enclosing_radius_encloses_and_touches() -> None:
    """Every vertex is inside, and one is on, the sphere of the radius returned."""
    mesh = ball()
    radius = enclosing_radius(mesh, [0.5, -0.2, 0.1])
    assert radius == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optimal_scanning_zone(ball(1), [], [0.0]), "standoffs is empty"),
        (lambda: optimal_scanning_zone(ball(1), [0.3, 0.0], [0.0]), "above 0"),
        (lambda: optimal_scanning_zone(ball(1), [np.inf], [0.0]), "finite"),
        (lambda: optimal_scanning_zone(ball(1), [0.3], []), "at least one finite angle"),
        (lambda: view_sphere([0, 0, 0], -1.0, 0.5, 0.5), "radius is -1 m"),
        (lambda: view_sphere([0, 0, 0], 1.0, 0.0, 0.5), "step_x is 0"),
        (lambda: view_sphere([0, 0, 0], 1.0, 0.5, 4.0), "step_y is 4"),
    ],
    ids=["no standoff", "standoff 0", "standoff infinite", "no roll", "radius", "step_x", "step_y"],
)
def test_impossible_arguments_are_refused(call: object, message: str) -> None:
    """The message names the argument and the valid values."""
    with pytest.raises(PlannerError, match=message):
        call()  # type: ignore[operator]


def _views() -> Viewpoints:
    return view_sphere(np.array([0.1, 0.2, 0.3]), 0.5, np.pi / 4, np.pi / 3, (0.0, 0.7))


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_straight_sweep_has_poses_in_the_middles_of_equal_cells(count: int) -> None:
    """The distances between poses are length / K, the mean is the viewpoint, and the orientation is constant."""
    views = _views()
    sweeps = sweep_viewpoints(views, straight_sweep_poses(0.14, count, (0.0, 3.0, 4.0)))
    T = sweeps.T_object_scanner
    assert T.shape == (len(views), count, 4, 4)
    np.testing.assert_allclose(
        T[:, :, :3, :3], np.repeat(views.T_object_scanner[:, :, :3, :3], count, axis=1), atol=1e-15
    )
    np.testing.assert_allclose(T[..., :3, 3].mean(axis=1), views.T_object_scanner[:, 0, :3, 3], atol=1e-15)
    along = np.einsum("vij,j->vi", views.T_object_scanner[:, 0, :3, :3], [0.0, 0.6, 0.8]) * 0.14 / count
    np.testing.assert_allclose(np.diff(T[..., :3, 3], axis=1), np.repeat(along[:, None], count - 1, axis=1), atol=1e-15)
    for name in ("face", "standoff", "roll"):
        assert (getattr(sweeps, name) == getattr(views, name)).all()


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
    """The message names the argument and its valid values."""
    with pytest.raises(PlannerError, match=words):
        make()
