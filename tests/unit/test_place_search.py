"""`cell place`: selection of the placements that are evaluated again, and of their candidates."""

import numpy as np

from cell.scene.file import load_scene
from cell.study.place_search import _basins, _best_of_all_basins
from cell.study.placement_study import placement_study
from cell.study.planned_placement import PlannedPlacement, best_place, place_of
from cell.study.prepared_part import Bench
from cell.study.trials import Outcome

_EXTENT = np.array([1000.0, 1000.0, 0.0, 360.0])  # the height is fixed
_NEAR = [(0.0, 0.0, 5.0, 0.0), (50.0, 0.0, 5.0, 0.0), (90.0, 0.0, 5.0, 10.0), (0.0, 60.0, 5.0, 0.0)]
_FAR = [(500.0, 0.0, 5.0, 0.0), (0.0, 0.0, 5.0, 180.0), (510.0, 10.0, 5.0, 0.0)]


def test_placements_within_a_tenth_of_the_range_are_one_basin():
    """Positions and rotations both count for the distance; a fixed axis does not count."""
    basins = _basins([*_NEAR, *_FAR], _EXTENT)
    assert basins == [_NEAR, [_FAR[0], _FAR[2]], [_FAR[1]]]


def test_the_best_half_is_kept_and_every_basin_follows_in_turn():
    """Four of seven placements are selected: the best two, then the first of both other basins."""
    assert _best_of_all_basins([*_NEAR, *_FAR], 4, _EXTENT) == [*_NEAR[:2], _FAR[0], _FAR[1]]
    assert sorted(_best_of_all_basins([*_NEAR, *_FAR], 99, _EXTENT)) == sorted([*_NEAR, *_FAR])


def test_a_larger_subset_contains_the_candidates_of_a_smaller_one():
    """A placement reached in the coarse round is also reached in the fine one, because the subsets are nested."""
    bench = Bench(load_scene(None, {"part": {"name": "mug"}, "plan": {"faces": 60}}), samples=1000)
    few, more = (bench.candidate_subset(count)[0].T_object_scanner for count in (20, 45))
    assert len(few) == 20
    assert {pose.tobytes() for pose in few} < {pose.tobytes() for pose in more}
    views, M = bench.candidate_subset(20)
    assert M.n_viewpoints == len(views) == 20
    assert bench.candidate_subset(20)[1] is M
    assert bench.candidate_subset(None)[0] is bench.candidates


def _plan(visible: float, views: int, seconds: float) -> PlannedPlacement:
    return PlannedPlacement(visible, views, 1, seconds)


def test_the_best_plan_is_chosen_and_none_is_worse_than_the_default():
    """Coverage counts to 0.1 points, then views and time; but the default is replaced only by a plan not below it."""
    a, b, c, default = (0.0,) * 4, (1.0,) * 4, (2.0,) * 4, (9.0,) * 4
    planned = {a: _plan(0.9804, 5, 9.0), b: _plan(0.9801, 5, 8.0), c: _plan(0.97, 2, 1.0)}
    assert best_place(planned, default) == b
    assert best_place(planned | {default: _plan(0.9802, 5, 10.0)}, default) == a  # b has a little less coverage
    assert best_place(planned | {default: _plan(0.9802, 5, 8.5)}, default) == default
    assert best_place(planned | {default: _plan(0.99, 9, 99.0)}, default) == default
    assert best_place({c: planned[c]}, default) == c


def test_the_plan_of_the_scene_is_a_trial_once():
    """In a grid with the placement of the scene, its plan is among the first trials and no finalist again."""
    scene = load_scene(None, {"part": {"name": "mug"}, "placement": {"position_mm": [1200.0, 500.0, 0.0]}})
    x, y, z, yaw = place_of(scene)
    values = {"reachable": 1.0, "coverable": 0.9, "home_free": True, "views": 5, "lower_bound": 5, "visible": 0.9}
    for grid_x in ([x], [x, x + 100.0]):
        study = placement_study(scene, grid_x, [y], [z], [yaw])
        of_grid = [trial for trial in study.trials if trial.function.endswith(":evaluate_placement")]
        finalists = study.finalists([Outcome(trial, values | {"cycle_s": 9.0}, "", {}) for trial in of_grid])
        assert len(of_grid) == len(grid_x)
        assert len(study.trials) == len(set(study.trials)) == len(grid_x) + 1
        assert len(finalists) == len(grid_x) - 1
        assert not set(finalists) & set(study.trials)
