"""`cell place`: search the placement with most coverage, then fewest views, then the shortest cycle.

Five rounds of trials, so that a stopped search resumes:

1. coarse evaluations (200 candidates, coverage only) at the placements of a Sobol sequence over the range;
2. finer evaluations (300 candidates) of the best of them, and a compass search from the best basins: steps along each
   axis, halved if no neighbour is better;
3. full coverage at the best placements of round 2;
4. views and cycle time of the best of round 3;
5. plans of the best of round 4 and of the placement of the scene, if it is in the range; the best plan is recommended.
   The plan of the scene's placement begins after the first round.

The result has the ten best placements with their spread, and the distances from the best one to placements where
nothing is reachable or 5 % of its coverage is lost.
"""

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

from cell.errors import UnreachableError, UsageError
from cell.scene.model import Scene
from cell.study.options import PlaceRange
from cell.study.placement_study import (
    AXES,
    place_option,
    placement_row,
    planned_text,
)
from cell.study.placement_trial import COVERAGE_ONLY, WITH_VIEWS, evaluate_placement
from cell.study.planned_placement import (
    N_PLANNED,
    Place,
    PlannedPlacement,
    best_place,
    finalist_trials,
    is_within,
    place_of,
    planned_columns,
    planned_of,
)
from cell.study.prepared_part import scene_settings
from cell.study.study import Row, StudyResult, write_folder
from cell.study.trials import JsonTable, OnOutcome, Outcome, Trial, Workers, run_trials, start_trials
from cell.view.palette import VERMILION
from cell.view.study_page import colour_limits
from planner.ports import no_progress
from planner.values import Floats, Ints

COARSE_PLACES, COARSE_CANDIDATES = 256, 200
"""Placements of round 1, and candidates of each."""
FINE_PLACES, FINE_CANDIDATES, CLIMBERS = 24, 300, 4
"""First placements of round 2, candidates of each, and starts of the compass search."""
FULL, FINALISTS = 16, 10
"""Placements of rounds 3 and 4."""
FIRST_STEPS = (100.0, 100.0, 100.0, 30.0)
LAST_STEPS = (12.5, 12.5, 12.5, 3.75)
"""Steps of the compass search [mm, mm, mm, deg]."""
TOLERANCE = 0.001
"""Coverages that differ by less count as equal [share of the surface]."""
_SUFFICIENT_COVERAGE = 0.95  # share of the best coverage; less counts as a loss
_PROBES_MM = (25.0, 50.0, 100.0, 200.0, 400.0, 800.0)  # distances of the surroundings
_BASIN = 0.1  # radius of a basin, as a share of the range

Progress = Callable[[str, int, int], None]
"""Called with (round, finished trials, all trials)."""


@dataclass(frozen=True, slots=True)
class PlaceCoverage:
    """Coverage at a placement: coverable share of the surface, and reachable share of the candidates."""

    coverable: float
    reachable: float

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key, lowest best: coverage to `TOLERANCE`, then reachable candidates, which allow fewer views."""
        return -round(self.coverable / TOLERANCE), -self.reachable


@dataclass(frozen=True, slots=True)
class PlaceSearchResult:
    """Result of a search.

    Attributes:
        ten: the ten best placements, best first (fewer if fewer are reachable).
        coarse: placements of round 1 with their coverable share, for the picture.
        lost_mm: distance from the best placement at which, in some direction, 5 % of its coverage is lost [mm];
            infinite if beyond the evaluated distances.
        unreached_mm: distance at which nothing is reachable [mm]; likewise.
        places: number of placements of each round.
        n_places: number of distinct placements.
        outcomes: of the distinct trials.
    """

    ten: Sequence[Row]
    coarse: Sequence[tuple[Place, float]]
    lost_mm: float
    unreached_mm: float
    places: Mapping[str, int]
    n_places: int
    outcomes: Sequence[Outcome] = field(compare=False)


def search(scene: Scene, where: PlaceRange, workers: Workers, *, progress: Progress = no_progress) -> PlaceSearchResult:
    """Search the best placement.

    Args:
        scene: part, scanner and cell; its own placement gives the rotations B and C, its plan the seed.
        where: the allowed placements.
        workers: compute the trials.
        progress: is called for each trial.

    Raises:
        UnreachableError: if nothing is reachable in the range, or no placement has a plan.
        UsageError: if trials failed, and at the other places nothing is reachable.
    """
    return _PlaceSearch(scene, where, workers, progress).run()


class _PlaceSearch:
    """State of a search: the range, and the placements that were evaluated in each round."""

    def __init__(self, scene: Scene, where: PlaceRange, workers: Workers, progress: Progress) -> None:
        self._scene, self._where, self._workers, self._progress = scene, where, workers, progress
        self._low, self._high = map(np.array, where.ends)
        self._free = np.flatnonzero(self._high > self._low)
        self._rotation = scene.placement.abc_deg[1:]
        self._fixed = {**scene_settings(scene), "solver": "auto"}
        self._n_trials: dict[str, int] = {}
        self._outcomes: dict[Trial, Outcome] = {}
        self._evaluated: set[Place] = set()
        self._fine: dict[Place, PlaceCoverage] = {}

    def run(self) -> PlaceSearchResult:
        """Take the rounds in their order."""
        default, extent = place_of(self._scene), self._high - self._low
        planned_places = [default] if is_within(default, list(zip(*self._where.ends, strict=True))) else []
        starts = self._starts()
        coarse = self._measure("coarse", starts, COARSE_CANDIDATES)
        if not any(each.coverable for each in coarse):
            if failures := [outcome.failure for outcome in self._outcomes.values() if outcome.failure]:
                raise UsageError(
                    f"{len(failures)} of {len(self._outcomes)} trials failed ({failures[0]}), and in the others "
                    "nothing of the part is reachable"
                )
            raise UnreachableError(
                "nothing of the part is reachable in this range; move or widen it (--x, --y, --z, --yaw)"
            )
        start_trials(list(finalist_trials(self._scene, planned_places).values()), self._workers)
        self._refine(_best_first(dict(zip(starts, coarse, strict=True)))[:FINE_PLACES])
        climbers = self._climb([basin[0] for basin in _basins(_best_first(self._fine), extent)][:CLIMBERS])
        full = _best_of_all_basins(list(dict.fromkeys([*climbers, *_best_first(self._fine)])), FULL, extent)
        full = _best_first(dict(zip(full, self._measure("full", full, None), strict=True)))
        ten = sorted(
            (row for row in self._with_views(_best_of_all_basins(full, FINALISTS, extent)) if row["views"] is not None),
            key=lambda row: (-round(row["coverable %"], 1), row["views"], row["cycle s"] or np.inf),
        )[:10]
        if planned_places and default not in [_place(row) for row in ten]:
            ten += self._with_views([default])
        planned_places += [_place(row) for row in ten[:N_PLANNED]]
        ten = _planned_first(ten, self._plan(planned_places), default)
        lost_mm, unreached_mm = _surroundings(
            ten[0], lambda points: self._measure("surroundings", points, COARSE_CANDIDATES)
        )
        shares = [each.coverable for each in coarse]
        return PlaceSearchResult(
            ten, list(zip(starts, shares, strict=True)), lost_mm, unreached_mm, self._n_trials, len(self._evaluated),
            list(self._outcomes.values()),
        )  # fmt: skip

    def _starts(self) -> list[Place]:
        """Return the placements of the first round: a Sobol sequence over the range."""
        rng = np.random.default_rng(self._scene.plan.seed)
        unit = qmc.Sobol(max(len(self._free), 1), scramble=True, rng=rng).random(COARSE_PLACES)
        points = np.tile(self._low, (COARSE_PLACES if len(self._free) else 1, 1))
        if len(self._free):
            points[:, self._free] += unit * (self._high - self._low)[self._free]
        return [_rounded(point) for point in points]

    def _refine(self, places: Sequence[Place]) -> None:
        """Evaluate placements with more candidates, unless that was done before."""
        new = [place for place in dict.fromkeys(places) if place not in self._fine]
        self._fine.update(zip(new, self._measure("fine", new, FINE_CANDIDATES), strict=True))

    def _climb(self, climbers: list[Place]) -> list[Place]:
        """Return the end of a compass search from each placement."""
        steps = [np.array(FIRST_STEPS)] * len(climbers)
        last = np.array(LAST_STEPS) / 2
        while any((step > last).all() for step in steps):
            neighbours = [
                _neighbours(place, step, self._low, self._high, self._free) if (step > last).all() else []
                for place, step in zip(climbers, steps, strict=True)
            ]
            self._refine([place for places in neighbours for place in places])
            for k, places in enumerate(neighbours):
                best = min(places, key=lambda place: (self._fine[place].rank, place), default=climbers[k])
                if self._fine[best].rank < self._fine[climbers[k]].rank:
                    climbers[k] = best
                else:
                    steps[k] = steps[k] / 2
        return climbers

    def _measure(self, name: str, places: Sequence[Place], candidates: int | None) -> list[PlaceCoverage]:
        values = self._compute(name, places, what=COVERAGE_ONLY, candidates=candidates)
        return [PlaceCoverage(value.get("coverable", 0.0), value.get("reachable", 0.0)) for value in values]

    def _with_views(self, places: Sequence[Place]) -> list[Row]:
        """Return the row of each placement whose trial did not fail, with views and cycle time if it has any."""
        values = self._compute("views and time", places, what=WITH_VIEWS, candidates=None)
        return [placement_row(place, self._rotation, each) for place, each in zip(places, values, strict=True) if each]

    def _compute(self, name: str, places: Sequence[Place], **settings: Any) -> list[JsonTable]:
        """Return the values of the trial of each placement."""
        trials = [
            Trial.of(
                evaluate_placement,
                {**self._fixed, **settings, "position_mm": place[:3], "abc_deg": (place[3], *self._rotation)},
            )
            for place in places
        ]
        self._n_trials[name] = self._n_trials.get(name, 0) + len(trials)
        self._evaluated.update(places)
        return [outcome.values for outcome in self._run(name, trials)]

    def _run(self, name: str, trials: Sequence[Trial]) -> list[Outcome]:
        """Return the outcome of each trial of a round, and keep the first one of each."""
        outcomes = run_trials(trials, self._workers, on_outcome=self._report(name))
        for outcome in outcomes:
            self._outcomes.setdefault(outcome.trial, outcome)
        return outcomes

    def _plan(self, places: Sequence[Place]) -> dict[Place, PlannedPlacement]:
        """Return the plan of each placement that has one."""
        trials = finalist_trials(self._scene, places)
        self._n_trials["plans"] = len(trials)
        values = {outcome.trial: outcome.values for outcome in self._run("plans", list(trials.values()))}
        plans = {place: planned_of(values.get(trial)) for place, trial in trials.items()}
        return {place: each for place, each in plans.items() if each is not None}

    def _report(self, name: str) -> OnOutcome:
        """Return the function that reports the progress of a round."""
        return lambda n_done, total, _: self._progress(name, n_done, total)


def _place(row: Row) -> Place:
    return tuple(row[axis] for axis in AXES)


def _planned_first(rows: Sequence[Row], planned: Mapping[Place, PlannedPlacement], default: Place) -> list[Row]:
    """Return the ten best rows with the numbers of their plans: the best plan, other plans, then rows without a plan.

    Raises:
        UnreachableError: if none of the placements has a plan.
    """
    if not planned:
        raise UnreachableError("none of the best placements has a plan; move or widen the range (--x, --y, --z, --yaw)")
    best = best_place(planned, default)

    def rank(row: Row) -> tuple[bool, bool, tuple[float, ...]]:
        place = _place(row)
        return place != best, place not in planned, planned[place].rank if place in planned else ()

    return [row | planned_columns(planned.get(_place(row))) for row in sorted(rows, key=rank)[:10]]


def place_study(
    scene: Scene, where: PlaceRange, workers: Workers, folder: Path, progress: Progress, plan: Sequence[object]
) -> StudyResult:
    """Search the best placement and write the folder of the study.

    Args:
        scene: as in `search`.
        where: as in `search`.
        workers: compute the trials.
        folder: of the study.
        progress: is called for each trial.
        plan: command that plans the scene, to which a placement is appended.
    """
    outcome = search(scene, where, workers, progress=progress)
    commands = [f"{shlex.join(map(str, plan))} {place_option(row)}" for row in outcome.ten]
    failed = [each for each in outcome.outcomes if each.failure]
    computed = sum(not each.cached for each in outcome.outcomes)
    result = StudyResult(folder, outcome.ten, sentences(outcome), failed, computed, list(outcome.ten[0]), commands, 0)
    seconds = [{"round": name, "places": count} for name, count in outcome.places.items()]
    write_folder("place", "Best placements of the part", result, pictures(outcome), seconds)
    return result


def _best_first(places: Mapping[Place, PlaceCoverage]) -> list[Place]:
    return sorted(places, key=lambda place: (places[place].rank, place))


def _rounded(point: Floats) -> Place:
    """Round to 0.1 mm and 0.1 deg, as the user would give it to `--place`."""
    return tuple(round(float(value), 1) + 0.0 for value in point)


def _best_of_all_basins(points: Sequence[Place], count: int, extent: Floats) -> list[Place]:
    """Return `count` points: the first half, then in turn the first of every basin, the second of each, and so on.

    Placements of equal coverage differ in their views, and neighbours differ little.
    """
    basins = _basins(points, extent)
    by_turns = [basin[turn] for turn in range(len(points)) for basin in basins if turn < len(basin)]
    return list(dict.fromkeys([*points[: count // 2], *by_turns]))[:count]


def _basins(points: Sequence[Place], extent: Floats) -> list[list[Place]]:
    """Group points: a point within a tenth of the range of an earlier group's first point belongs to that group."""
    basins: list[list[Place]] = []
    scale = np.where(extent > 0, extent, 1.0)
    for point in points:
        for basin in basins:
            if np.linalg.norm((np.array(point) - np.array(basin[0])) / scale) <= _BASIN:
                basin.append(point)
                break
        else:
            basins.append([point])
    return basins


def _neighbours(point: Place, step: Floats, low: Floats, high: Floats, free: Ints) -> list[Place]:
    """Return the points one step away in both directions of each free axis, inside the range."""
    neighbours = []
    for axis in free:
        for sign in (-1.0, 1.0):
            other = np.array(point)
            other[axis] = np.clip(other[axis] + sign * step[axis], low[axis], high[axis])
            neighbours.append(_rounded(other))
    return [other for other in dict.fromkeys(neighbours) if other != point]


def _surroundings(best: Row, measure: Callable[[Sequence[Place]], list[PlaceCoverage]]) -> tuple[float, float]:
    """Return the distances [mm] at which coverage is lost, and at which nothing is reachable, in any direction."""
    here = _place(best)
    directions = np.vstack([np.eye(3), -np.eye(3)])
    points = [here] + [
        _rounded(np.array([*(np.array(here[:3]) + distance * direction), here[3]]))
        for direction in directions
        for distance in _PROBES_MM
    ]
    covered = np.array([each.coverable for each in measure(points)])
    around = covered[1:].reshape(len(directions), len(_PROBES_MM))
    distance = np.broadcast_to(_PROBES_MM, around.shape)
    lost_mm = distance[around < _SUFFICIENT_COVERAGE * covered[0]]
    unreached_mm = distance[around == 0.0]
    return float(lost_mm.min(initial=np.inf)), float(unreached_mm.min(initial=np.inf))


def sentences(result: PlaceSearchResult) -> list[str]:
    """Summarise the best placement and its certainty."""
    best, ten = result.ten[0], result.ten
    views = [row["views"] for row in ten if row["views"] is not None]
    spread = [np.ptp([row[axis] for row in ten]) for axis in AXES]
    low, high = min(row["coverable %"] for row in ten), max(row["coverable %"] for row in ten)
    return [
        f"Best place: `{place_option(best)}`. {planned_text(best)}.",
        f"By the estimates before the plans, the {len(ten)} best places cover {low:.1f} to {high:.1f} % with "
        f"{min(views)} to {max(views)} views; they spread over {spread[0]:.0f} x {spread[1]:.0f} x "
        f"{spread[2]:.0f} mm and {spread[3]:.0f} deg.",
        f"{_distance_text(result.lost_mm, '5 % of its coverage is lost')}; "
        f"{_distance_text(result.unreached_mm, 'nothing is reachable').lower()}.",
        f"{result.n_places} places were evaluated; another seed evaluates others.",
    ]


def _distance_text(distance: float, event: str) -> str:
    if np.isfinite(distance):
        return f"{distance:g} mm from the best place {event}"
    return f"Nowhere within {_PROBES_MM[-1]:g} mm of the best place {event}"


def pictures(result: PlaceSearchResult) -> Iterator[tuple[str, Figure]]:
    """Draw the coarse evaluations from above and over height and yaw, with the ten best marked."""
    points = np.array([point for point, _ in result.coarse])
    covered = 100 * np.array([share for _, share in result.coarse])
    low, high = colour_limits(covered.tolist(), "coverable %")
    figure = Figure(figsize=(12.0, 5.4), dpi=110, layout="constrained")
    for axes, (a, b) in zip(figure.subplots(1, 2), ((0, 1), (3, 2)), strict=True):
        image = axes.scatter(points[:, a], points[:, b], c=covered, cmap="viridis", s=18, vmin=low, vmax=high)
        x, y = ([row[AXES[k]] for row in result.ten] for k in (a, b))
        axes.scatter(x, y, facecolors="none", edgecolors=VERMILION, s=70, label="ten best")
        axes.plot(x[0], y[0], "*", color=VERMILION, markersize=14, label="best")
        axes.set_xlabel(f"{AXES[a].replace(' ', ' [')}]")
        axes.set_ylabel(f"{AXES[b].replace(' ', ' [')}]")
        axes.legend(loc="upper right", fontsize=8)
    figure.colorbar(image, ax=figure.axes, label="coverable surface, coarse evaluation [%]", shrink=0.9)
    yield "places", figure
