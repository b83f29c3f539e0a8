"""Registration where it may slide, turn or find nothing, by name."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.registration.cloud import ScanCloud
from planner.registration.observability import FreeKind
from planner.registration.registration import RegistrationStatus, register

SENSOR = np.array([0.0, 0.0, 0.3])


def _height(shape: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the height of a surface with its top or middle at the origin."""
    return {
        "plane": lambda: 0 * x,
        "cylinder": lambda: np.sqrt(0.03**2 - y**2) - 0.03,
        "sphere": lambda: np.sqrt(0.03**2 - x**2 - y**2) - 0.03,
        "cone": lambda: -np.hypot(x, y),
        "extrusion": lambda: 0.003 * np.sin(y / 0.006),
        "saddle and ripples": lambda: (x**2 - 0.7 * y**2) / 0.05 + 0.001 * np.sin(x / 0.004) * np.cos(y / 0.005),
    }[shape]()


def _patch(shape: str, side: int = 60) -> np.ndarray:
    """Return points 0.8 mm apart on the upper side of a surface."""
    ticks = (np.arange(side) - side / 2 + 0.5) * 0.8e-3
    x, y = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    inside = x**2 + y**2 < 0.024**2
    x, y = x[inside], y[inside]
    return np.stack([x, y, _height(shape, x, y)], axis=1)


def _model(shape: str) -> TriangleMesh:
    """Return the same surface, larger than the patch and finely tessellated."""
    if shape == "sphere":
        ball = trimesh.creation.icosphere(5, 0.03)
        return TriangleMesh(ball.vertices - [0, 0, 0.03], ball.faces)
    n = 161
    x, y = np.meshgrid(np.linspace(-0.0295, 0.0295, n), np.linspace(-0.0295, 0.0295, n))
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (index[i : i + n - 1, j : j + n - 1].ravel() for i, j in ((0, 0), (0, 1), (1, 1), (1, 0)))
    return TriangleMesh(
        np.stack([x.ravel(), y.ravel(), _height(shape, x, y).ravel()], axis=1),
        np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]),
    )


T, R = FreeKind.TRANSLATION, FreeKind.ROTATION
FREE = {
    "plane": ([T, T, R], "a plane"),
    "cylinder": ([T, R], "a cylinder"),
    "sphere": ([R, R, R], "a sphere"),
    "cone": ([R], "a surface of revolution"),
    "extrusion": ([T], "an extruded profile"),
    "saddle and ripples": ([], ""),
}


@pytest.mark.parametrize("shape", FREE)
@pytest.mark.parametrize("noise", [0.0, 10e-6])
def test_undetermined_motions_are_reported_and_not_corrected(shape: str, noise: float) -> None:
    """Rank, names and message are correct. The visible part of the error is corrected, the free motions are not."""
    true = _patch(shape)
    true[:, 2] += np.random.default_rng(0).normal(0, noise, len(true)) if noise else 0.0
    error = np.eye(4)
    error[:3, :3] = Rotation.from_rotvec([0.002, -0.001, 0.003]).as_matrix()
    error[:3, 3] = [0.0003, -0.0002, 0.0004]
    result = register([ScanCloud(true, SENSOR).transformed(error)], _model(shape)).scans[0]
    kinds, name = FREE[shape]
    assert [motion.kind for motion in result.free] == kinds
    assert result.rank == 6 - len(kinds)
    assert result.status is (RegistrationStatus.PARTLY_FREE if kinds else RegistrationStatus.CONVERGED)
    assert result.sentence.startswith(result.status.value)
    assert name in result.sentence
    assert result.rms_after < max(result.rms_before / 20, 1.2 * noise)
    # An error splits into a determined part, which the correction removes, and a free part, which stays.
    before, free_before = result.split_motion(np.linalg.inv(error))
    after, free_after = result.split_motion(np.linalg.inv(result.T_correction @ error))
    size = [np.hypot(part[0], part[1] * result.length) for part in (before, after, free_before, free_after)]
    assert size[1] < max(size[0] / 10, 30e-6 + noise)
    assert size[3] == pytest.approx(size[2], abs=60e-6)
    assert (size[2] > 1e-6) == bool(kinds)
    # The correction is orthogonal to each free motion.
    moved = ScanCloud(true, SENSOR).transformed(error).points
    field = ScanCloud(moved, SENSOR).transformed(result.T_correction).points - moved
    for motion in result.free:
        if motion.kind is T:
            slide = np.broadcast_to(motion.direction, moved.shape)
            assert abs(np.mean(np.einsum("nj,nj->n", field, slide))) < 30e-6
    if shape == "plane":
        turn = Rotation.from_matrix(result.T_correction[:3, :3]).as_rotvec()
        assert abs(turn[2]) < 0.0003  # of the applied 0.003
    if not kinds:
        np.testing.assert_allclose(result.T_correction @ error, np.eye(4), atol=2e-4)


NOTHING = {
    "a view that sees nothing": (np.empty((0, 3)), RegistrationStatus.EMPTY),
    "one point": (np.zeros((1, 3)), RegistrationStatus.TOO_FEW_POINTS),
    "eleven points": (_patch("plane")[:11], RegistrationStatus.TOO_FEW_POINTS),
    "a scan of something else": (_patch("plane") + np.array([0, 0, 0.1]), RegistrationStatus.NO_OVERLAP),
}


@pytest.mark.parametrize("name", NOTHING)
def test_scans_that_cannot_be_registered_keep_their_pose(name: str) -> None:
    """The status has the reason, the correction is the identity, and a valid second scan is registered."""
    points, status = NOTHING[name]
    good = ScanCloud(_patch("saddle and ripples") + np.array([0, 0, 3e-4]), SENSOR)
    bad, other = register([ScanCloud(points, SENSOR), good], _model("saddle and ripples")).scans
    assert bad.status is status
    assert bad.T_correction.tobytes() == np.eye(4).tobytes()
    assert bad.rank == 0
    assert other.status is RegistrationStatus.CONVERGED
    assert other.T_correction[2, 3] == pytest.approx(-3e-4, abs=5e-6)


def test_no_scans() -> None:
    """Without scans the result is empty."""
    result = register([], _model("plane"))
    assert result.scans == ()
    assert np.isnan(result.rms_before)


def test_one_view_without_a_model_stays() -> None:
    """A single scan without a model has the status NO_OVERLAP and keeps its pose."""
    result = register([ScanCloud(_patch("saddle and ripples"), SENSOR)], None).scans[0]
    assert result.status is RegistrationStatus.NO_OVERLAP
    assert result.T_correction.tobytes() == np.eye(4).tobytes()


def test_two_views_without_overlap_are_registered_to_the_model_alone() -> None:
    """Two separate corners form no pair and converge on the model; without a model both keep their pose."""
    patch = _patch("saddle and ripples")
    left, right = patch[patch[:, 0] < -0.006] + [0, 0, 3e-4], patch[patch[:, 0] > 0.006] - [0, 0, 2e-4]
    scans = [ScanCloud(left, SENSOR), ScanCloud(right, SENSOR)]
    result = register(scans, _model("saddle and ripples"), reach=2e-3)
    assert result.overlaps == ()
    assert all(scan.status is RegistrationStatus.CONVERGED for scan in result.scans)
    assert result.rms_after < result.rms_before / 20
    alone = register(scans, None, reach=2e-3)
    assert all(scan.status is RegistrationStatus.NO_OVERLAP for scan in alone.scans)


def test_outliers_of_one_percent_do_not_pull() -> None:
    """With 1 % of the points up to 5 mm off, the corrected points change by less than 5 micrometres."""
    clean = _patch("saddle and ripples") + np.array([2e-4, -1e-4, 3e-4])
    dirty = clean.copy()
    rng = np.random.default_rng(0)
    bad = rng.choice(len(dirty), len(dirty) // 100, replace=False)
    dirty[bad, 2] += rng.uniform(0, 0.005, len(bad))
    model = _model("saddle and ripples")
    a, b = (register([ScanCloud(points, SENSOR)], model, samples=10_000).scans[0] for points in (clean, dirty))
    difference = (
        ScanCloud(clean, SENSOR).transformed(a.T_correction).points
        - ScanCloud(clean, SENSOR).transformed(b.T_correction).points
    )
    assert np.linalg.norm(difference, axis=1).max() < 5e-6
    assert 0.9 < b.used < 1


def test_a_large_error_on_a_surface_with_features_is_found() -> None:
    """An error of 8 mm is refused at the usual reach, and corrected to 2 micrometres at a reach of 10 mm."""
    scan = ScanCloud(_patch("saddle and ripples") + np.array([0.008, 0.004, 0.0]), SENSOR)
    doubted = register([scan], _model("saddle and ripples"), samples=500).scans[0]
    assert doubted.status is RegistrationStatus.TOO_FAR
    assert (doubted.T_correction == np.eye(4)).all()
    result = register([scan], _model("saddle and ripples"), samples=500, reach=0.01).scans[0]
    assert result.status is RegistrationStatus.CONVERGED
    np.testing.assert_allclose(scan.transformed(result.T_correction).points, _patch("saddle and ripples"), atol=2e-6)


def test_too_few_steps_do_not_converge() -> None:
    """After one of several steps the scan has the status NOT_CONVERGED."""
    scan = ScanCloud(_patch("saddle and ripples") + np.array([0.008, 0.004, 0.0]), SENSOR)
    result = register([scan], _model("saddle and ripples"), samples=500, iterations=1)
    assert result.scans[0].status is RegistrationStatus.NOT_CONVERGED
    assert result.iterations == 1


def test_nan_is_refused_by_name() -> None:
    """A scan with NaN is refused before registration."""
    points = _patch("plane")
    points[5] = np.nan
    with pytest.raises(PlannerError, match=r"points of the scan: 1 of .* NaN"):
        register([ScanCloud(points, SENSOR)], _model("plane"))
