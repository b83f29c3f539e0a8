"""Grown candidates: all reachable, each measures an open point, and together as much as a dense pool of others."""

import numpy as np
import pytest

from cell.part.workpiece import load
from cell.scanners.laser_area import LaserArea
from cell.scanners.laser_line import LaserLine
from cell.world.embree import EmbreeRayCaster
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples
from planner.measurability.visibility import find_measured
from planner.viewpoints.growth import SearchStage, ViewEvaluator, grow
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import optimal_scanning_zone, view_sphere


def _above(T):
    """Return whether all sources are above the plane z = -0.02."""
    return (T[:, :, 2, 3] > -0.02).all(axis=1)


@pytest.fixture(scope="module")
def mug():
    """Return the mug, coarse, with 1,500 scouts."""
    part = load("mug")
    planning = decimate(part.reference, 120)
    scouts = draw_samples(part.reference, planning, 1500, np.random.default_rng(0))
    return part, planning, scouts, EmbreeRayCaster(part.reference.vertices, part.reference.faces)


def _evaluator(caster, scanner, are_reachable=_above):
    return ViewEvaluator(scanner, (caster,), are_reachable, getattr(scanner, "T_view_scanner", np.eye(4)[None]))


def test_grown_views_measure_as_much_as_a_dense_pool(mug):
    """Grown views measure at most 0.5 points less than views along all normals and directions."""
    part, planning, scouts, caster = mug
    scanner = LaserArea(range_mm=(50, 150), baseline_mm=25, sensor_grazing_max_deg=75)
    targets = RayTargets.of(scouts.points, scouts.normals)
    grown = grow(targets, np.zeros(len(targets), dtype=bool), _evaluator(caster, scanner))
    assert _above(grown.T_object_scanner[:, None]).all()
    rolls = tuple(np.radians([0, 90, 180, 270]))
    pools = [
        optimal_scanning_zone(planning, (0.06, 0.1, 0.14), rolls),
        view_sphere(part.centre, 0.14, np.radians(20), np.radians(20), rolls),
    ]
    pool = np.concatenate([p.T_object_scanner for p in pools])
    pool = pool[_above(pool)]
    best = find_measured(pool, scouts, scanner, (caster,)).mean()
    measured = find_measured(grown.T_object_scanner[:, None], scouts, scanner, (caster,), each=True)
    assert measured.any(axis=1).mean() >= best - 0.005
    assert measured[grown.row, np.arange(len(grown))].all()  # each measures the point at which it is aimed
    assert len(grown) < len(pool) / 5


def test_views_grow_for_open_points_only(mug):
    """Without open points no view grows. With one, every view measures it. Equal inputs give equal views."""
    _, _, scouts, caster = mug
    evaluator = _evaluator(caster, LaserArea(range_mm=(50, 150), baseline_mm=25))
    targets = RayTargets.of(scouts.points, scouts.normals)
    seen = np.ones(len(targets), dtype=bool)
    assert not len(grow(targets, seen, evaluator))
    seen[np.argmax(scouts.points[:, 2])] = False
    some, again = grow(targets, seen, evaluator), grow(targets, seen, evaluator)
    assert 1 <= len(some) <= 3
    views = find_measured(some.T_object_scanner[:, None], scouts, evaluator.scanner, (caster,), each=True)
    assert views[~seen].all()
    np.testing.assert_array_equal(some.T_object_scanner, again.T_object_scanner)


def test_unreachable_views_do_not_grow(mug):
    """An arm without reach ends the search without a view, within its budget."""
    _, _, scouts, caster = mug
    tested = []

    def nowhere(T):
        tested.append(len(T))
        return np.zeros(len(T), dtype=bool)

    evaluator = _evaluator(caster, LaserArea(range_mm=(50, 150), baseline_mm=25), nowhere)
    targets = RayTargets.of(scouts.points, scouts.normals)
    schedule = (SearchStage((0, 8), False, 4000), SearchStage((0, 8), True, 4000))
    assert not len(grow(targets, np.zeros(len(targets), dtype=bool), evaluator, schedule=schedule))
    assert 0 < sum(tested) <= 4000


def test_sweeps_are_aimed_with_their_middle_pose(mug):
    """Every pose of a sweep is tested for reachability, and the sweep measures the point at which it is aimed."""
    _, _, scouts, caster = mug
    scanner = LaserLine(range_mm=(50, 150), baseline_mm=25, sweep_mm=40.0, sweep_steps=4)
    evaluator = _evaluator(caster, scanner)
    targets = RayTargets.of(scouts.points, scouts.normals)
    schedule = (SearchStage((0, 16), False, 20_000), SearchStage((0, 8), True, 20_000))
    grown = grow(targets, np.zeros(len(targets), dtype=bool), evaluator, schedule=schedule)
    sweeps = grown.T_object_scanner[:, None] @ scanner.T_view_scanner
    assert len(grown)
    assert _above(sweeps).all()
    assert find_measured(sweeps, scouts, scanner, (caster,), each=True)[grown.row, np.arange(len(grown))].all()
