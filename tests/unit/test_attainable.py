"""Attainable share of the surface: cases with known results, and the sentence of the report."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cell.plan.evaluation import attainable_coverage
from cell.plan.selection import Request
from cell.report.plan_report import attainable_sentence
from cell.runs.schema import Attainable
from cell.scanners.laser_area import LaserArea
from cell.session import Effort
from cell.world.embree import EmbreeRayCaster
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.coverage import Coverage
from planner.viewpoints.attainable import probe_attainable
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets

SCANNER = LaserArea(range_mm=(50, 150), baseline_mm=25, sensor_grazing_max_deg=75)


def _ball(are_reachable, *around):
    """Return 300 points of a ball of 40 mm, and the evaluator of poses about it."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    casters = [EmbreeRayCaster(mesh.vertices, mesh.faces) for mesh in (ball, *around)]
    points, faces = trimesh.sample.sample_surface(ball, 300, seed=0)
    return RayTargets.of(points, ball.face_normals[faces]), ViewEvaluator(
        SCANNER, casters, are_reachable, np.eye(4)[None]
    )


def _anywhere(T):
    return np.ones(len(T), dtype=bool)


def test_all_of_a_ball_is_measured_from_anywhere():
    """All points of a convex body are measured if every pose is reachable."""
    found = probe_attainable(*_ball(_anywhere))
    assert found.measured.all()


def test_from_above_the_lowest_points_of_a_ball_are_seen_but_not_reached():
    """With sources above the ball's lowest point all points are visible."""
    targets, evaluator = _ball(lambda T: (T[:, :, 2, 3] > -0.04).all(axis=1))
    found = probe_attainable(targets, evaluator)
    assert found.visible.all()
    # From height z of a point, 150 mm away at most and within 75 deg of its normal, the source must rise to -40 mm.
    height, lean = targets.points[2], np.arccos(np.clip(targets.normals[2], -1, 1))
    highest = height + 0.15 * np.cos(np.maximum(lean - np.radians(75), 0))
    assert not found.measured[highest < -0.04].any()
    assert found.measured[lean < np.radians(150)].all()


def test_in_a_closed_box_nothing_is_seen_from_outside():
    """No point of a ball is visible in a tight box, since poses inside it are nearer than the range."""
    found = probe_attainable(*_ball(_anywhere, trimesh.creation.box((0.09, 0.09, 0.09))))
    assert not found.visible.any()


def test_an_arm_that_reaches_nothing_measures_nothing():
    """Without reachable poses all points are visible and none is measured. Results are repeatable."""
    targets, evaluator = _ball(lambda T: np.zeros(len(T), dtype=bool))
    found, again = probe_attainable(targets, evaluator), probe_attainable(targets, evaluator)
    assert found.visible.all()
    assert not found.measured.any()
    np.testing.assert_array_equal(found.visible, again.visible)


def test_the_share_of_a_plan_is_that_of_all_samples(monkeypatch):
    """The share is exact if all samples are tested. From half of them it is within a few standard errors."""
    targets, evaluator = _ball(lambda T: (T[:, :, 2, 3] > -0.02).all(axis=1))
    areas = np.full(300, 2.0)
    samples = SurfaceSamples(targets.points.T, targets.normals.T, areas, np.arange(300), np.arange(300))
    covered = targets.points[2] > 0.02
    some = Coverage(covered, float(areas[covered].sum()), float(areas.sum()))
    prediction = SimpleNamespace(samples=samples, coverable=some, scanner=None, casters=())
    monkeypatch.setattr("cell.plan.evaluation.view_evaluator", lambda *_: evaluator)
    monkeypatch.setattr("cell.plan.evaluation.fixed_occluders", lambda _: ())
    monkeypatch.setattr("cell.plan.evaluation.in_contact", lambda samples, _: np.zeros(len(samples), dtype=bool))

    def estimated(effort: Effort):
        cell = SimpleNamespace(world=None)
        problem = SimpleNamespace(prediction=prediction, cell=cell, request=Request(effort=effort))
        return attainable_coverage(problem, some, np.random.default_rng(0))

    exact = estimated(Effort())
    truth = probe_attainable(targets, evaluator)
    assert exact.standard_error == 0
    assert exact.share == pytest.approx((covered | truth.measured).mean(), abs=0.01)
    assert exact.share + exact.out_of_reach + exact.out_of_sight == pytest.approx(1.0)
    half = estimated(Effort(searched_samples=int((~covered).sum()) // 2))
    assert half.standard_error > 0
    assert abs(half.share - exact.share) < 4 * half.standard_error + 0.01


def test_the_sentence_names_the_largest_loss_if_little_is_measured():
    """Below four fifths of the surface the sentence states the largest loss; above, only the measured share."""
    found = Attainable(share=0.75, standard_error=0.001, samples=1000, out_of_reach=0.2, out_of_sight=0.05)
    high = attainable_sentence(0.85, 0.9, found.model_copy(update={"share": 0.91}))
    assert high.startswith("at least 91.00 % of the surface by any pose of this robot (found by search, ")
    assert high.endswith("measures 85.00 %")
    low = attainable_sentence(0.7, 0.74, found)
    assert "20.0 % of the surface is lost because the search found no reachable pose that sees it" in low
    low = attainable_sentence(0.44, 0.74, found)
    assert "30.0 % of the surface is lost because the request did not include it" in low
