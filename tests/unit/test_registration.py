"""Registration on a small head whose scans have known pose errors."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cell.world.embree import EmbreeRayCaster
from planner.errors import PlannerError
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import ScanCloud
from planner.registration.registration import RegistrationStatus, register

VIEWS = 0.25 * np.array([[1, 0, 0.2], [-1, 0.1, 0], [0, 1, 0], [0, -1, 0.1], [0.3, 0, 1], [0, 0.2, -1]])


@pytest.fixture(scope="module")
def head() -> TriangleMesh:
    """Return a ball of 50 mm with a nose, a chin and flattened cheeks, 20,480 faces."""
    ball = trimesh.creation.icosphere(5, 1.0)
    x, y, z = ball.vertices.T
    radius = 0.05 * (1 - 0.15 * y**2) + 0.008 * np.exp(-20 * ((x - 1) ** 2 + y**2 + z**2))
    radius += 0.005 * np.exp(-10 * ((x - 0.7) ** 2 + y**2 + (z + 0.7) ** 2)) + 0.002 * np.sin(6 * z) * x
    return TriangleMesh(ball.vertices * radius[:, None], ball.faces)


@pytest.fixture(scope="module")
def scans(head: TriangleMesh) -> list[ScanCloud]:
    """Return six exact scans, pitch about 1 mm, with 20 micrometres of range noise."""
    caster = EmbreeRayCaster(head.vertices, head.faces)
    rng = np.random.default_rng(0)
    return [_scan(caster, view, rng) for view in VIEWS]


@pytest.fixture(scope="module")
def nearest(head: TriangleMesh) -> ClosestPointQuery:
    """Return the closest-point query of the head."""
    return ClosestPointQuery(head)


def _scan(caster: EmbreeRayCaster, sensor: np.ndarray, rng: np.random.Generator) -> ScanCloud:
    z = -sensor / np.linalg.norm(sensor)
    x = np.cross([0.3, 0.5, 0.8], z)
    x /= np.linalg.norm(x)
    h, v = np.meshgrid(*[np.tan(np.radians(np.arange(-16, 16, 0.25)))] * 2)
    rays = h.ravel()[:, None] * x + v.ravel()[:, None] * np.cross(z, x) + z
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = caster.first_hit(np.broadcast_to(sensor, rays.shape).copy(), rays).distance
    hit = np.isfinite(distance)
    distance = distance[hit] + rng.normal(0, 20e-6, hit.sum())
    return ScanCloud(sensor + distance[:, None] * rays[hit], sensor)


def _moved(scan: ScanCloud, shift: np.ndarray, turn: np.ndarray) -> ScanCloud:
    """Return the scan with its scanner shifted [m] and turned about itself [rad]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = scan.sensor + shift - T[:3, :3] @ scan.sensor
    return scan.transformed(T)


def _disturbed(scans: Sequence[ScanCloud], mm: float, deg: float, seed: int) -> list[ScanCloud]:
    rng = np.random.default_rng(seed)
    return [_moved(s, rng.normal(0, mm * 1e-3, 3), rng.normal(0, np.radians(deg), 3)) for s in scans]


def _rms(scans: Sequence[ScanCloud], nearest: ClosestPointQuery) -> float:
    return float(np.sqrt(np.mean(nearest.closest(np.concatenate([s.points for s in scans])).distance ** 2)))


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_pose_error_is_reduced_at_least_four_times(
    scans: list[ScanCloud], head: TriangleMesh, nearest: ClosestPointQuery, seed: int
) -> None:
    """With 0.5 mm and 0.1 degree (one sigma), the rms of the merged cloud falls 4 times, to its noise."""
    disturbed = _disturbed(scans, 0.5, 0.1, seed)
    result = register(disturbed, head)
    assert {scan.status for scan in result.scans} == {RegistrationStatus.CONVERGED}
    assert {scan.rank for scan in result.scans} == {6}
    before = _rms(disturbed, nearest)
    after = _rms([s.transformed(r.T_correction) for s, r in zip(disturbed, result.scans, strict=True)], nearest)
    assert before > 0.3e-3
    assert after < before / 4
    assert after == pytest.approx(_rms(scans, nearest), rel=0.05)
    assert result.rms_before == pytest.approx(before, rel=0.25)
    assert result.rms_after == pytest.approx(after, rel=0.25)


def test_the_correction_undoes_the_error(scans: list[ScanCloud], head: TriangleMesh) -> None:
    """Every point returns to its true place within the noise of one point, not only onto the surface."""
    disturbed = _disturbed(scans, 0.5, 0.1, 4)
    for true, wrong, result in zip(scans, disturbed, register(disturbed, head).scans, strict=True):
        back = wrong.transformed(result.T_correction).points
        assert np.linalg.norm(wrong.points - true.points, axis=1).mean() > 0.2e-3
        assert np.linalg.norm(back - true.points, axis=1).max() < 20e-6


def test_without_a_model_the_scans_come_together(scans: list[ScanCloud], nearest: ClosestPointQuery) -> None:
    """Scans matched to each other without a model are correct except for one common motion."""
    disturbed = _disturbed(scans, 0.5, 0.1, 5)
    result = register(disturbed, None)
    assert len(result.overlaps) >= 6
    assert result.rms_after < result.rms_before / 4
    back = [s.transformed(r.T_correction) for s, r in zip(disturbed, result.scans, strict=True)]
    source, target = (np.concatenate([s.points for s in group]) for group in (back, scans))
    turn, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    left = turn.apply(source - source.mean(axis=0)) - (target - target.mean(axis=0))
    assert (
        np.sqrt(np.mean(left**2))
        < 0.1e-3
        < np.sqrt(np.mean((np.concatenate([s.points for s in disturbed]) - target) ** 2))
    )


def test_scans_that_fit_are_left_where_they_are(scans: list[ScanCloud], head: TriangleMesh) -> None:
    """Without pose error no point moves by more than half of the noise."""
    for scan, result in zip(scans, register(scans, head).scans, strict=True):
        assert np.linalg.norm(scan.transformed(result.T_correction).points - scan.points, axis=1).max() < 10e-6


def test_corrections_are_rigid_and_repeat(scans: list[ScanCloud], head: TriangleMesh) -> None:
    """Each correction is a rotation and a translation; the same input gives the same bytes."""
    disturbed = _disturbed(scans[:3], 0.5, 0.1, 7)
    first, second = register(disturbed, head), register(disturbed, head)
    for a, b in zip(first.scans, second.scans, strict=True):
        R = a.T_correction[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        assert a.T_correction.tobytes() == b.T_correction.tobytes()


@pytest.mark.parametrize(("mm", "deg", "seed"), [pytest.param(5.0, 1.0, 2, marks=pytest.mark.slow), (20.0, 2.0, 2)])
def test_a_huge_pose_error_is_never_made_larger(
    scans: list[ScanCloud], head: TriangleMesh, mm: float, deg: float, seed: int
) -> None:
    """Beyond the reach of matches, a scan moves towards its true place or keeps its reported pose."""
    disturbed = _disturbed(scans, mm, deg, seed)
    result = register(disturbed, head)
    kept = [scan for scan in result.scans if not scan.is_corrected]
    for true, wrong, scan in zip(scans, disturbed, result.scans, strict=True):
        before, after = (
            np.linalg.norm(s.points - true.points, axis=1).mean() for s in (wrong, wrong.transformed(scan.T_correction))
        )
        assert after <= before
    for scan in kept:
        assert (scan.T_correction == np.eye(4)).all()
        assert scan.rms_after == scan.rms_before or np.isnan(scan.rms_before)
    assert kept or mm < 10


def test_arguments_must_be_positive(scans: list[ScanCloud], head: TriangleMesh) -> None:
    """No samples, no iterations and no reach are refused."""
    for wrong in ({"samples": 0}, {"iterations": 0}, {"reach": 0.0}):
        with pytest.raises(PlannerError, match="must be positive"):
            register(scans, head, **wrong)
