"""Refined candidates of a stage: poses that measure more, in a reduced planning problem."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from cell.explore import refinement
from cell.explore.refinement import with_refined_candidates
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.viewpoints import Viewpoints, aim_viewpoints

_GROWN, _NOT = (SimpleNamespace(plan=SimpleNamespace(candidates=kind)) for kind in ("grown", "view-sphere"))


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return a problem with twelve candidates about a ball of 60 mm, all of them reachable."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    mesh = TriangleMesh(ball.vertices, ball.faces)
    scanner = LaserArea(fov_deg=(40, 40), range_mm=(50, 150), baseline_mm=20, sensor_grazing_max_deg=75)
    casters = (EmbreeRayCaster(mesh.vertices, mesh.faces),)
    outward = np.random.default_rng(2).normal(size=(12, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    candidates = aim_viewpoints(0.03 * outward, outward, np.arange(12), [0.1], [0.0])
    scouts = draw_samples(mesh, mesh, 300, np.random.default_rng(1))
    arm = ViewEvaluator(scanner, casters, lambda T: np.ones(len(T), dtype=bool), np.eye(4)[None])
    monkeypatch.setattr(refinement, "view_evaluator", lambda *_: arm)
    prediction = SimpleNamespace(samples=scouts, scanner=scanner, casters=casters)
    return SimpleNamespace(
        candidates=candidates,
        prediction=prediction,
        world=None,
        kinematics=None,
        checker=None,
        arm=arm,
        request=_GROWN,
        cell=None,
    )


def _append(problem: SimpleNamespace, views: object) -> SimpleNamespace:
    return SimpleNamespace(**vars(problem) | {"candidates": Viewpoints.join([problem.candidates, views])})


def test_poses_that_measure_more_stand_behind_the_candidates(problem: SimpleNamespace) -> None:
    """Refined poses are appended, keep face and standoff of their candidate, and measure more area than it does."""
    views = np.array([7, 2, 4])
    after = with_refined_candidates(problem, views, _append)
    added = len(after.candidates) - 12
    assert 0 < added <= 3
    assert np.array_equal(after.candidates.T_object_scanner[:12], problem.candidates.T_object_scanner)
    known, scouts = problem.prediction, problem.prediction.samples
    faces = after.candidates.face[12:].tolist()
    assert set(faces) <= {7, 2, 4}
    assert after.candidates.standoff[12:] == pytest.approx(0.1)
    area = scouts.areas @ find_measured(
        after.candidates.T_object_scanner, scouts, known.scanner, known.casters, each=True
    )
    assert (area[12:] > area[faces]).all()


def test_where_nothing_is_better_the_problem_is_the_same(problem: SimpleNamespace) -> None:
    """The problem is returned unchanged without views, with candidates of a generator, or without reachable poses."""
    assert with_refined_candidates(problem, np.empty(0, dtype=np.int64), _append) is problem
    sphere = SimpleNamespace(**vars(problem) | {"request": _NOT})
    assert with_refined_candidates(sphere, np.arange(12), _append) is sphere
    object.__setattr__(problem.arm, "are_reachable", lambda T: np.zeros(len(T), dtype=bool))
    assert with_refined_candidates(problem, np.arange(12), _append) is problem
