"""`cell place`: selection of the placements that are evaluated again, and of their candidates."""

import numpy as np

from cell.scene.file import load_scene
from cell.study.place_search import _basins, _best_of_all_basins
from cell.study.prepared_part import Bench

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
