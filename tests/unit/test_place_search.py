"""`cell place`: its rounds, selection of the placements that are evaluated again, and of their candidates."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Circle

from cell.errors import UnreachableError, UsageError
from cell.scene.file import load_scene
from cell.study.options import PlaceRange
from cell.study.place_search import LAST_STEPS, _basins, _best_of_all_basins, place_study, search
from cell.study.placement_study import pictures, placement_study, reach_circle
from cell.study.placement_trial import COVERAGE_ONLY
from cell.study.planned_placement import PlannedPlacement, best_place, place_of
from cell.study.prepared_part import Bench
from cell.study.trials import Outcome, Trial, Workers
from planner.ports import no_progress

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


_RANGE = PlaceRange(x_mm=(800.0, 1600.0), y_mm=(0.0, 800.0), z_mm=(0.0, 0.0), yaw_deg=(0.0, 0.0))
_BEST, _SECOND = np.array([1437.0, 263.0, 0.0]), np.array([950.0, 700.0, 0.0])


class AnalyticWorkers(Workers):
    """Workers whose coverage is a function of the placement: two cones on a plain, the higher one at `_BEST`.

    Attributes:
        height: coverage at `_BEST`.
        has_plans: whether placements have plans.
        functions: names of the functions of all computed trials.
    """

    def __init__(self, height: float = 0.9, *, has_plans: bool = True) -> None:
        self.height, self.has_plans, self.functions = height, has_plans, list[str]()

    def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
        """Yield the values of each trial."""
        for trial in trials:
            _, _, function = trial.function.partition(":")
            self.functions.append(function)
            settings = json.loads(trial.settings)
            place = np.array(settings["position_mm"])
            to_best, to_second = (float(np.linalg.norm(place - centre)) for centre in (_BEST, _SECOND))
            coverage = max(0.0, self.height - to_best / 1000, self.height - 0.1 - to_second / 1000)
            views = {"views": 7, "lower_bound": 6, "visible": coverage}
            if function == "plan_placement":
                yield Outcome(trial, {**views, "duration_s": 9.0} if self.has_plans else {"cause": "none"}, "", {})
            else:
                values = {"reachable": coverage, "coverable": coverage, "cycle_s": 9.0}
                yield Outcome(trial, values if settings["what"] == COVERAGE_ONLY else values | views, "", {})

    def close(self) -> None:
        """Do nothing."""


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep analytic results out of the cache of other tests."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.mark.usefixtures("own_cache")
def test_the_rounds_find_the_higher_of_two_maxima() -> None:
    """The best placement is within the last steps of the maximum; its surroundings have the distances of the cone."""
    scene = load_scene(None, {"part": {"name": "mug"}, "placement": {"position_mm": [950.0, 700.0, 0.0]}})
    workers = AnalyticWorkers()
    found = search(scene, _RANGE, workers)
    best = found.ten[0]
    assert abs(best["x mm"] - _BEST[0]) < LAST_STEPS[0]
    assert abs(best["y mm"] - _BEST[1]) < LAST_STEPS[1]
    assert best["planned views"] == 7
    assert found.lost_mm == 50.0  # 5 % of 0.9 are lost at 45 mm
    assert found.unreached_mm == np.inf or found.unreached_mm >= 800.0
    assert len(found.ten) == 10
    assert found.ten[1]["planned views"] == found.ten[2]["planned views"] == 7  # the second, and the scene's
    assert (950.0, 700.0) in {(row["x mm"], row["y mm"]) for row in found.ten[:3]}
    assert found.places["coarse"] == 256
    assert found.places["plans"] == 3
    assert len(workers.functions) <= sum(found.places.values())
    again = AnalyticWorkers()
    assert search(scene, _RANGE, again) == found
    assert again.functions == []


@pytest.mark.usefixtures("own_cache")
def test_failed_trials_are_reported_and_no_unreachable_places() -> None:
    """Trials that all fail are the cause, with the first failure; single ones are among the outcomes."""
    scene = load_scene(None, {"part": {"name": "mug"}})

    class Failing(AnalyticWorkers):
        """Workers that fail at some placements."""

        def __init__(self, low: float) -> None:
            super().__init__()
            self.low = low

        def compute(self, trials: Sequence[Trial]) -> Iterator[Outcome]:
            for outcome in super().compute(trials):
                fails = json.loads(outcome.trial.settings)["position_mm"][0] > self.low
                yield Outcome(outcome.trial, {}, "the part is broken", {}) if fails else outcome

    with pytest.raises(UsageError, match=r"(\d+) of \1 trials failed \(the part is broken\)"):
        search(scene, _RANGE, Failing(0.0))
    found = search(scene, _RANGE, Failing(1590.0))
    assert {each.failure for each in found.outcomes} == {"", "the part is broken"}


@pytest.mark.usefixtures("own_cache")
def test_a_repeated_search_computes_nothing(tmp_path: Path) -> None:
    """The result counts the trials that were computed now, not those of the cache."""
    scene = load_scene(None, {"part": {"name": "mug"}})
    results, workers = [], AnalyticWorkers()
    for folder in ("first", "second"):
        results.append(place_study(scene, _RANGE, workers, tmp_path / folder, no_progress, ["cell", "plan"]))
    assert [result.computed for result in results] == [len(workers.functions), 0]
    assert results[0].rows == results[1].rows


def test_the_circle_of_a_map_is_the_reach_of_the_robot_about_its_base() -> None:
    """The KR 16 reaches 1611 mm from its A1 axis (KUKA's data sheet), wherever its base is."""
    scene = load_scene(None, {"robot": {"base": {"position_mm": [100.0, -200.0, 300.0]}}})
    circle = reach_circle(scene.robot)
    assert circle.centre_mm == pytest.approx((100.0, -200.0))
    assert circle.radius_mm == pytest.approx(1611.0, abs=0.5)
    row = {"x mm": 1000.0, "y mm": 0.0, "z mm": 0.0, "yaw deg": 0.0, "reachable %": 1.0, "coverable %": 1.0}
    ((_, figure),) = pictures([row | {"views": 3, "cycle s": 9.0, "best": True}], circle)
    (drawn,) = (patch for patch in figure.axes[0].patches if isinstance(patch, Circle))
    assert (drawn.center, drawn.radius) == (circle.centre_mm, circle.radius_mm)


@pytest.mark.usefixtures("own_cache")
@pytest.mark.parametrize(
    ("workers", "cause"),
    [
        (AnalyticWorkers(-1.0), "nothing of the part is reachable in this range"),
        (AnalyticWorkers(has_plans=False), "none of the best placements has a plan"),
    ],
    ids=["coverage", "plans"],
)
def test_a_range_without_coverage_or_plans_is_refused(workers: AnalyticWorkers, cause: str) -> None:
    """The message names the options of the range."""
    scene = load_scene(None, {"part": {"name": "mug"}, "placement": {"position_mm": [5000.0, 0.0, 0.0]}})
    with pytest.raises(UnreachableError, match=f"{cause}; .*--x"):
        search(scene, _RANGE, workers)
