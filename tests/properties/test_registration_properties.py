"""Registration and closest points do not depend on where the axes lie."""

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import ScanCloud
from planner.registration.registration import register

_BOX = trimesh.creation.box((0.06, 0.04, 0.03)).subdivide().subdivide()
_MODEL = TriangleMesh(_BOX.vertices, _BOX.faces)
_POSES = st.tuples(st.integers(0, 2**31), st.floats(0, 3), st.floats(-0.5, 0.5))


def _pose(parameters: tuple[int, float, float]) -> np.ndarray:
    seed, angle, shift = parameters
    axis = np.random.default_rng(seed).normal(size=3)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    T[:3, 3] = [shift, -shift / 2, shift / 3]
    return T


def _placed(mesh: TriangleMesh, T: np.ndarray) -> TriangleMesh:
    return TriangleMesh(mesh.vertices @ T[:3, :3].T + T[:3, 3], mesh.faces)


@given(_POSES)
def test_distances_do_not_change_with_the_frame(parameters: tuple[int, float, float]) -> None:
    """Signed distances of points stay the same when mesh and points move together."""
    T = _pose(parameters)
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (200, 3))
    here, there = ClosestPointQuery(_MODEL), ClosestPointQuery(_placed(_MODEL, T))
    moved = points @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(there.signed_distance(moved), here.signed_distance(points), atol=1e-12)


@settings(max_examples=settings.default.max_examples // 4)
@given(_POSES)
def test_corrections_move_with_the_frame(parameters: tuple[int, float, float]) -> None:
    """Registering everything in another frame gives the same correction, written in that frame."""
    T = _pose(parameters)
    rng = np.random.default_rng(1)
    top = np.stack([rng.uniform(-0.029, 0.029, 500), rng.uniform(-0.019, 0.019, 500), np.full(500, 0.015)], axis=1)
    side = np.stack([np.full(300, 0.03), rng.uniform(-0.019, 0.019, 300), rng.uniform(-0.014, 0.014, 300)], axis=1)
    front = np.stack([rng.uniform(-0.029, 0.029, 300), np.full(300, 0.02), rng.uniform(-0.014, 0.014, 300)], axis=1)
    scan = ScanCloud(np.concatenate([top, side, front]) + np.array([4e-4, -3e-4, 2e-4]), np.array([0.3, 0.3, 0.3]))
    here = register([scan], _MODEL).scans[0]
    there = register([scan.transformed(T)], _placed(_MODEL, T)).scans[0]
    assert here.rank == there.rank == 6
    np.testing.assert_allclose(here.T_correction[:3, 3], [-4e-4, 3e-4, -2e-4], atol=2e-6)
    np.testing.assert_allclose(np.linalg.inv(T) @ there.T_correction @ T, here.T_correction, atol=2e-6)
