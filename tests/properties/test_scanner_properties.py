"""Monotonicity of the scanner's conditions: wider limits never lose a point, occluders never add one."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.quality import LimitedScanner
from planner.measurability.visibility import find_measured
from planner.ports import Rejection
from planner.viewpoints.viewpoints import optimal_scanning_zone

_ANGLE = st.floats(5, 85)
_LIMITS = st.fixed_dictionaries({
    "fov_deg": st.tuples(st.floats(10, 89), st.floats(10, 89)),
    "range_mm": st.tuples(st.floats(50, 250), st.floats(260, 600)),
    "baseline_mm": st.floats(0, 500),
    "grazing_max_deg": _ANGLE,
    "sensor_grazing_max_deg": _ANGLE,
    "sensor_fov_deg": st.tuples(st.floats(10, 89), st.floats(10, 89)),
    "sensor_tilt_deg": st.floats(-20, 60),
    "depth_of_field_mm": st.tuples(st.floats(50, 250), st.floats(260, 600)),
})  # fmt: skip


def _cloud(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.3, -0.3, 0.02], [0.3, 0.3, 0.6], (3000, 3))
    normals = rng.normal(size=(3000, 3)) - points / 0.2
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _measured(limits: dict, cloud: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return LaserArea(resolution_deg=(5, 5), **limits).reject(*cloud) == Rejection.MEASURED


@given(_LIMITS, st.floats(0, 1), st.integers(0, 5))
def test_widening_any_limit_never_loses_a_point(limits, share, seed):
    """Wider or removed limits of FOV, range, grazing, sensor's FOV and depth of field keep every point."""
    cloud = _cloud(seed)
    before = _measured(limits, cloud)
    front, back = limits["depth_of_field_mm"]
    wider = {
        "fov_deg": tuple(a + share * (179 - a) for a in limits["fov_deg"]),
        "sensor_fov_deg": tuple(a + share * (179 - a) for a in limits["sensor_fov_deg"]),
        "range_mm": (limits["range_mm"][0] * (1 - share), limits["range_mm"][1] * (1 + share)),
        "depth_of_field_mm": (front * (1 - share), back * (1 + share)),
        "grazing_max_deg": limits["grazing_max_deg"] + share * (90 - limits["grazing_max_deg"]),
        "sensor_grazing_max_deg": limits["sensor_grazing_max_deg"] + share * (90 - limits["sensor_grazing_max_deg"]),
    }  # fmt: skip
    for name, value in wider.items():
        assert (_measured({**limits, name: value}, cloud) | ~before).all(), name
    for name in ("sensor_fov_deg", "depth_of_field_mm"):
        assert (_measured({**limits, name: None}, cloud) | ~before).all(), name


@given(_LIMITS, st.floats(1e-5, 1e-3), st.floats(1, 10), st.integers(0, 5))
def test_a_larger_limit_on_sigma_never_loses_a_point(limits, limit, factor, seed):
    """No limit on sigma measures a point that the scanner without one rejects."""
    cloud = _cloud(seed)
    scanner = LaserArea(resolution_deg=(5, 5), **limits)
    tight, loose = (
        LimitedScanner(scanner, bound).reject(*cloud) == Rejection.MEASURED for bound in (limit, factor * limit)
    )
    assert (loose | ~tight).all()
    assert (_measured(limits, cloud) | ~loose).all()


@given(st.floats(0.05, 0.5), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(1.01, 3.0))
def test_sigma_grows_with_noise_and_shrinks_with_the_baseline_on_the_axis(z, tilt_x, tilt_y, factor):
    """Proportional to the angular noise; a longer baseline is better while it is short against the distance."""
    point, normal = np.array([[0.0, 0.0, z]]), np.array([[tilt_x, tilt_y, -1.0]])
    normal /= np.linalg.norm(normal)
    short = z / 6

    def sigma(baseline: float, noise: float) -> float:
        return LaserArea(baseline_mm=1000 * baseline, sigma_angle_mdeg=noise).sigma(point, normal)[0]

    assert sigma(short, factor) == pytest.approx(factor * sigma(short, 1.0), rel=1e-12)
    assert sigma(short * factor**0.5, 1.0) < sigma(short, 1.0)


def test_an_arm_never_adds_a_sample_and_occludes_only_its_own_view():
    """The rows of views with their own caster (`own_occluders`) equal those of a common one, view by view."""
    ball = trimesh.creation.icosphere(2, 0.05)
    part = TriangleMesh(ball.vertices, ball.faces)
    caster = EmbreeRayCaster(part.vertices, part.faces)
    samples = draw_samples(part, part, 2000, np.random.default_rng(0))
    views = optimal_scanning_zone(TriangleMesh(part.vertices, part.faces[::40]), (0.2,), (0.0,))
    scanner = LaserArea(range_mm=(50, 400), baseline_mm=40)
    rng = np.random.default_rng(4)
    own = []
    for T in views.T_object_scanner[:, 0]:
        block = trimesh.creation.box((0.03, 0.03, 0.03))
        block.apply_translation(T[:3, 3] * 0.6 + rng.uniform(-0.02, 0.02, 3))
        own.append(EmbreeRayCaster(block.vertices, block.faces))
    own[0] = None
    T = views.T_object_scanner
    free = find_measured(T, samples, scanner, (caster,), each=True)
    hidden = find_measured(T, samples, scanner, (caster,), each=True, own_occluders=own)
    assert (free | ~hidden).all()
    np.testing.assert_array_equal(free[:, 0], hidden[:, 0])
    for view in range(1, len(T)):
        alone = find_measured(T[[view]], samples, scanner, (caster, own[view]))
        np.testing.assert_array_equal(hidden[:, view], alone)
        assert hidden[:, view].sum() < free[:, view].sum()
    np.testing.assert_array_equal(find_measured(T, samples, scanner, (caster,), own_occluders=own), hidden.any(axis=1))
