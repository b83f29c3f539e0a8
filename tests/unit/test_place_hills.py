"""`cell place`: which places are looked at again, and with which candidates."""

import numpy as np

from cell.scene.file import load_scene
from cell.study.bench import Bench
from cell.study.place_search import _best_and_others, _hills

_EXTENT = np.array([1000.0, 1000.0, 0.0, 360.0])  # the height is fixed
_NEAR = [(0.0, 0.0, 5.0, 0.0), (50.0, 0.0, 5.0, 0.0), (90.0, 0.0, 5.0, 10.0), (0.0, 60.0, 5.0, 0.0)]
_FAR = [(500.0, 0.0, 5.0, 0.0), (0.0, 0.0, 5.0, 180.0), (510.0, 10.0, 5.0, 0.0)]


def test_places_within_a_tenth_of_the_range_are_one_hill():
    """Turns count as well as metres, and a fixed axis does not."""
    hills = _hills([*_NEAR, *_FAR], _EXTENT)
    assert hills == [_NEAR, [_FAR[0], _FAR[2]], [_FAR[1]]]


def test_the_best_half_is_kept_and_every_hill_has_its_turn():
    """Four of seven: the best two, and the first of both hills behind them."""
    assert _best_and_others([*_NEAR, *_FAR], 4, _EXTENT) == [*_NEAR[:2], _FAR[0], _FAR[1]]
    assert sorted(_best_and_others([*_NEAR, *_FAR], 99, _EXTENT)) == sorted([*_NEAR, *_FAR])


def test_a_closer_look_has_the_candidates_of_a_quicker_one():
    """Else a place that is reached in a quick look might not be in a closer one."""
    bench = Bench(load_scene(None, {"part": {"name": "mug"}, "plan": {"faces": 60}}), samples=1000)
    few, more = (bench.some(count)[0].T_object_scanner for count in (20, 45))
    assert len(few) == 20
    assert {pose.tobytes() for pose in few} < {pose.tobytes() for pose in more}
    views, M = bench.some(20)
    assert M.n_viewpoints == len(views) == 20
    assert bench.some(20)[1] is M
    assert bench.some(None)[0] is bench.zone
