"""Causes of uncovered points against the definition, pair by pair, without classes, bundles or culling."""

from collections.abc import Callable

import numpy as np
import trimesh

from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.ports import Rejection
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import optimal_scanning_zone
from planner.why import why
from planner.why.why import Reason


def test_every_reason_is_that_of_the_closest_candidate(blob: Callable[[int], trimesh.Trimesh]) -> None:
    """The reason of each sample equals that of single pairs: conditions in order, one ray after the other."""
    mesh = blob(3)
    part = TriangleMesh(mesh.vertices / 1000, mesh.faces.astype(np.int32))
    planning = decimate(part, 24)
    samples = draw_samples(part, planning, 150, np.random.default_rng(4))
    views = optimal_scanning_zone(planning, [0.15], [0.0, 1.2])
    # The range is short enough and the angles small enough that every condition is the last one of some sample.
    scanner = LaserArea(range_mm=(120, 156), fov_deg=(24, 18), baseline_mm=60, grazing_max_deg=40)
    caster = EmbreeRayCaster(part.vertices, part.faces)
    screen = trimesh.creation.box((0.2, 0.012, 0.2), trimesh.transformations.translation_matrix((0.02, 0.06, 0.035)))
    other = EmbreeRayCaster(screen.vertices, screen.faces)
    rng = np.random.default_rng(2)
    last = [Reason.OUT_OF_REACH, Reason.JOINT_LIMIT, Reason.COLLISION, Reason.NO_PATH, Reason.NOT_SELECTED]
    fails = np.array(last, dtype=np.uint8)[rng.integers(0, len(last), len(views))]
    targets = RayTargets.of(samples.points, samples.normals)
    rows = np.flatnonzero(rng.random(len(samples)) < 0.9)
    found = why.diagnose(targets, rows, views, scanner, (caster, other), fails)

    expected, cosines = [], []
    for row in rows:
        best = (0, -np.inf)
        for view, T in enumerate(views.T_object_scanner[:, 0]):
            R, o = T[:3, :3], T[:3, 3]
            point, normal = R.T @ (samples.points[row] - o), R.T @ samples.normals[row]
            code = Rejection(scanner.reject(point[None], normal[None])[0])
            end = targets.lifted[row][None]
            source, sensor = o[None], (R @ scanner.sensor + o)[None]
            if code is not Rejection.MEASURED:
                level = Reason[code.name]
            elif caster.blocked(source, end)[0]:
                level = Reason.SOURCE_SHADED_BY_PART
            elif caster.blocked(sensor, end)[0]:
                level = Reason.SENSOR_SHADED_BY_PART
            elif other.blocked(source, end)[0]:
                level = Reason.SOURCE_SHADED
            elif other.blocked(sensor, end)[0]:
                level = Reason.SENSOR_SHADED
            else:
                level = Reason(fails[view])
            cosine = float(normal @ -point / np.linalg.norm(point))
            best = max(best, (int(level), cosine))
        expected.append(best[0])
        cosines.append(best[1])
    assert len(set(expected)) >= 7, "the case must have most of the reasons"
    np.testing.assert_array_equal(found.reason, expected)
    # For conditions without a measure, the closest candidate has the smallest grazing angle.
    unmeasured = found.reason >= Reason.SOURCE_SHADED_BY_PART
    assert unmeasured.any()
    np.testing.assert_allclose(np.cos(found.grazing_source[unmeasured]), np.array(cosines)[unmeasured], atol=1e-9)
