"""Spacing of the points of a scan: compared with rays, as a condition, and for the views of a plan."""

import numpy as np
import pytest

from cell.errors import SceneError
from cell.scanners.laser_area import LaserArea
from cell.scanners.laser_line import LaserLine
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability import coverage
from planner.measurability.quality import best_values
from planner.ports import Rejection

AREA = LaserArea(fov_deg=(60, 40), resolution_deg=(0.02, 0.05), range_mm=(1, 2000), grazing_max_deg=90)


def _planes(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points in the field of view with normals up to 80 degrees from the source."""
    angles = np.radians(rng.uniform([-28, -18], [28, 18], (count, 2)))
    depth = rng.uniform(0.1, 0.6, count)
    points = np.stack([depth * np.tan(angles[:, 0]), depth * np.tan(angles[:, 1]), depth], axis=1)
    back = -points / np.linalg.norm(points, axis=1, keepdims=True)
    beside = np.cross(back, rng.normal(size=(count, 3)))
    beside /= np.linalg.norm(beside, axis=1, keepdims=True)
    tilt = np.radians(rng.uniform(0, 80, count))[:, None]
    return points, np.cos(tilt) * back + np.sin(tilt) * beside


def _met(direction: np.ndarray, origin: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the intersection of a ray with the plane through a point."""
    return origin + direction * ((point - origin) @ normal) / (direction @ normal)


def test_the_spacing_of_an_area_scanner_is_that_of_its_neighbouring_rays() -> None:
    """The spacing equals that of rays half a step to either side, at 500 positions and inclinations."""
    points, normals = _planes(np.random.default_rng(1), 500)
    for point, normal, spacing in zip(points, normals, AREA.spacing(points, normals), strict=True):
        gaps = []
        for axis, step in ((0, 0.02), (1, 0.05)):
            ends = []
            for side in (-0.5, 0.5):
                angles = np.arctan2(point[:2], point[2])
                angles[axis] += side * np.radians(step)
                ends.append(_met(np.array([*np.tan(angles), 1.0]), np.zeros(3), point, normal))
            gaps.append(np.linalg.norm(ends[1] - ends[0]))
        assert spacing == pytest.approx(max(gaps), rel=1e-4)


@pytest.mark.parametrize("sweep", [{"sweep_mm": 120.0}, {"sweep_deg": 30.0}])
def test_the_spacing_of_a_line_sensor_is_along_its_line_and_to_the_next_one(sweep: dict[str, float]) -> None:
    """The spacing equals that of a neighbouring ray of the sheet, and of the next line at full speed, on planes."""
    line = LaserLine(fan_deg=30, line_points=4000, range_mm=(50, 800), profile_rate_hz=500.0, **sweep)
    points, normals = _planes(np.random.default_rng(2), 300)
    points[:, 0] = 0.0
    seen = np.einsum("ij,ij->i", points, normals) < -0.02 * np.linalg.norm(points, axis=1)
    assert line.spacing is not None
    for point, normal, spacing in zip(points[seen], normals[seen], line.spacing(points, normals)[seen], strict=True):
        angle, step = np.arctan2(point[1], point[2]), np.radians(30 / 4000)
        along = [
            _met(np.array([0, np.sin(angle + d), np.cos(angle + d)]), np.zeros(3), point, normal)
            for d in (-step / 2, step / 2)
        ]
        ray, ends = np.array([0.0, point[1], point[2]]), []
        for side in (-0.5, 0.5):
            if "sweep_mm" in sweep:
                ends.append(_met(ray, np.array([side * 0.05 / 500, 0, 0]), point, normal))
            else:
                turn = side * 0.35 / 500
                ends.append(
                    _met(np.array([ray[2] * np.sin(turn), ray[1], ray[2] * np.cos(turn)]), np.zeros(3), point, normal)
                )
        gaps = [np.linalg.norm(pair[1] - pair[0]) for pair in (along, ends)]
        assert spacing == pytest.approx(max(gaps), rel=1e-3)


@pytest.mark.parametrize("limit_mm", [0.2, 0.5, 2.0])
def test_the_limit_rejects_exactly_the_sparser_points(limit_mm: float) -> None:
    """The limit rejects exactly the sparser points among those that satisfy all other conditions."""
    points, normals = _planes(np.random.default_rng(3), 2000)
    for free, limited in (
        (AREA, LaserArea(**_keys(AREA), max_spacing_mm=limit_mm)),
        (
            line := LaserLine(fan_deg=40, range_mm=(50, 800), profile_rate_hz=500.0, sweep_mm=500.0, sweep_steps=1),
            LaserLine(**_keys(line), max_spacing_mm=limit_mm),
        ),
    ):
        before, after = free.reject(points, normals), limited.reject(points, normals)
        assert free.spacing is not None
        sparse = (before == Rejection.MEASURED) & (free.spacing(points, normals) > limit_mm / 1000 * (1 + 1e-9))
        np.testing.assert_array_equal(after, np.where(sparse, np.uint8(Rejection.TOO_SPARSE), before))
    facing = np.array([[0.0, 0.0, 0.4]]), np.array([[0.0, 0.0, -1.0]])
    exact = float(1000 * AREA.spacing(*facing)[0])
    assert LaserArea(**_keys(AREA), max_spacing_mm=exact).reject(*facing)[0] == Rejection.MEASURED


def _keys(scanner: LaserArea | LaserLine) -> dict[str, object]:
    return {key: value for key, value in scanner.parameters().items() if key != "type"}


def test_a_surface_that_does_not_face_the_source_has_no_spacing() -> None:
    """Points behind the scanner, on a back face or at a right angle have no spacing."""
    points = np.array([[0, 0, -0.3], [0, 0, 0.3], [0, 0, 0.3]])
    normals = np.array([[0, 0, 1.0], [0, 0, 1.0], [1.0, 0, 0]])
    assert np.isinf(AREA.spacing(points, normals)).all()


def test_an_unknown_rate_must_be_given() -> None:
    """A line sensor without its rate has no spacing and no limit on it; a limit is above 0."""
    assert LaserLine().spacing is None
    with pytest.raises(SceneError, match=r"set scanner\.profile_rate_hz"):
        LaserLine(max_spacing_mm=1.0)
    with pytest.raises(SceneError, match=r"max_spacing_mm is 0; it must be above 0"):
        LaserArea(max_spacing_mm=0.0)


@pytest.mark.parametrize(
    "scanner", [LaserArea(), LaserArea(fov_deg=(90, 90), resolution_deg=(0.1, 0.1)), LaserLine(profile_rate_hz=50.0)]
)
def test_an_unattainable_limit_is_refused(scanner: LaserArea | LaserLine) -> None:
    """A limit is valid down to the smallest spacing in range and field of view."""
    rng = np.random.default_rng(7)
    angles = np.radians(rng.uniform(-45, 45, (200_000, 2)))
    points = np.stack([np.tan(angles[:, 0]), np.tan(angles[:, 1]), np.ones(len(angles))], axis=1)
    points *= (rng.uniform(0.15, 0.16, len(angles)) / np.linalg.norm(points, axis=1))[:, None]
    normals = -points + 0.02 * rng.normal(size=points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert scanner.spacing is not None
    measured = scanner.reject(points, normals) == Rejection.MEASURED
    least = float(1000 * scanner.spacing(points[measured], normals[measured]).min())
    kind = type(scanner)
    kind(**_keys(scanner), max_spacing_mm=1.005 * least)
    with pytest.raises(SceneError, match="at the near end of its range"):
        kind(**_keys(scanner), max_spacing_mm=0.97 * least)


def test_the_densest_view_that_measures_a_point_counts() -> None:
    """Two views of a plate, each of a half and both of the middle, at 200 and 300 mm."""
    square = 0.05 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    plate = TriangleMesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    samples = draw_samples(plate, plate, 400, np.random.default_rng(0))
    near, far = (np.diag([1.0, -1.0, -1.0, 1.0]) for _ in range(2))
    near[2, 3], far[2, 3] = 0.2, 0.3
    seen = np.stack([samples.points[:, 0] < 0.01, samples.points[:, 0] > -0.01], axis=1)
    seen[0] = False
    scanner = LaserArea()
    (best,) = best_values([scanner.spacing], np.stack([near, far])[:, None], samples, seen, scanner)
    for T, rows in ((near, seen[:, 0]), (far, seen[:, 1] & ~seen[:, 0])):
        points, normals = (samples.points[rows] - T[:3, 3]) @ T[:3, :3], samples.normals[rows] @ T[:3, :3]
        np.testing.assert_array_equal(best[rows], scanner.spacing(points, normals))
    assert np.isnan(best[0])


def test_dense_coverage_against_all_pairs() -> None:
    """A sample with a point within 1.5 times the spacing counts, and a sample without a spacing never does."""
    rng = np.random.default_rng(5)
    square = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]])
    plate = TriangleMesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    samples = draw_samples(plate, plate, 500, rng)
    points = np.concatenate([rng.uniform(0, 0.1, (200, 2)), np.zeros((200, 1))], axis=1)
    spacing = rng.uniform(0.001, 0.005, 500)
    spacing[:20] = np.nan
    nearest = np.linalg.norm(samples.points[:, None] - points[None], axis=2).min(axis=1)
    found = coverage.dense_coverage(points, samples, spacing)
    np.testing.assert_array_equal(found.covered, nearest <= 1.5 * spacing)
    assert not coverage.dense_coverage(np.empty((0, 3)), samples, spacing).covered.any()
    assert not coverage.dense_coverage(points, samples, np.full(500, np.nan)).covered.any()
