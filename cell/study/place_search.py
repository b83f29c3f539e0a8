"""`cell place`: search where the part should stand: most coverage, then fewest views, then the shortest cycle.

In four rounds, each with its own trials, so that a stopped search goes on where it was:

1. quick looks (some 200 candidates, coverage alone) at places of a Sobol sequence over the whole range;
2. closer looks (some 300 candidates) at the best of them, and a compass search about the best of these: steps along
   each axis that halve where nothing near is better;
3. full coverage at the best places that were seen closer;
4. views and cycle time of the best of these.

Then it says how sure it is: the ten best and their spread, and how far the best is from where nothing is reached and
from where a twentieth of its coverage is lost.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

from cell.errors import UnreachableError
from cell.scene.model import Scene
from cell.study.options import PlaceRange
from cell.study.placement_map import AXES, place_option, row_of, time_of
from cell.study.placement_trial import COVERAGE_ONLY, WHOLE, placement
from cell.study.run import run
from cell.study.scenes import scene_settings
from cell.study.study import Row
from cell.study.trial import JsonTable, Outcome, Trial
from cell.study.workers import Workers
from cell.view.palette import VERMILION
from planner.values import Floats, Ints

LOOKS, CANDIDATES = 256, 200
"""Round 1: places that are looked at, and candidates per look."""
CLOSER, CLOSER_CANDIDATES, CLIMBERS = 24, 300, 4
"""Round 2: places that are looked at first, candidates per look, starts of the compass search."""
FULL, FINALISTS = 16, 10
"""Places in rounds 3 and 4."""
FIRST_STEPS = (100.0, 100.0, 100.0, 30.0)
LAST_STEPS = (12.5, 12.5, 12.5, 3.75)
"""Steps of the compass search [mm, mm, mm, deg]."""
POINT = 0.001
"""Shares of the surface that differ by less count as equal."""
_LOST = 0.95  # of the best coverage: what is below is another place
_PROBES = (25.0, 50.0, 100.0, 200.0, 400.0, 800.0)  # distances [mm] at which the surroundings are looked at

Place = tuple[float, ...]
"""Values of AXES."""

Progress = Callable[[str, int, int], None]
"""Told (round, trials done, trials in all)."""


@dataclass(frozen=True, slots=True)
class Look:
    """What a place gives: the share of the surface that is coverable, and of the candidates that are reachable."""

    coverable: float
    reachable: float

    @property
    def rank(self) -> tuple[int, float]:
        """Less is better: coverage to a tenth of a point, then the choice that is left, which makes for fewer views."""
        return -round(self.coverable / POINT), -self.reachable


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found.

    Attributes:
        ten: the ten best places, the best first (fewer where fewer can be reached).
        looked: places of the quick looks and what they cover [share], for the picture.
        lost_mm: distance from the best place at which, in some direction, a twentieth of its coverage is lost [mm];
            infinite where it is not within the looks.
        unreached_mm: distance at which nothing is reached any more [mm]; likewise.
        places: how many places were looked at in each round.
        n_places: how many in all; a place may be looked at in several rounds.
    """

    ten: Sequence[Row]
    looked: Sequence[tuple[Place, float]]
    lost_mm: float
    unreached_mm: float
    places: Mapping[str, int]
    n_places: int


def search(scene: Scene, where: PlaceRange, workers: Workers, *, progress: Progress | None = None) -> Found:
    """Search the best place.

    Args:
        scene: part, scanner and cell; its own placement gives the turns B and C, its plan the seed and the solver.
        where: the places that are allowed.
        workers: who computes.
        progress: is told of each round's trials.

    Raises:
        UnreachableError: if nothing is reached anywhere in the range.
    """
    low, high = map(np.array, where.ends)
    free = np.flatnonzero(high > low)
    base = scene_settings(scene)
    _, b, c = scene.placement.abc_deg
    places: dict[str, int] = {}
    asked: set[Place] = set()

    def ask(name: str, points: Sequence[Place], **what: Any) -> list[JsonTable]:
        trials = [
            Trial.of(placement, {**base, "position_mm": p[:3], "abc_deg": (p[3], b, c), "solver": "auto", **what})
            for p in points
        ]

        def told(done: int, total: int, outcome: Outcome) -> None:
            if progress is not None:
                progress(name, done, total)

        places[name] = places.get(name, 0) + len(trials)
        asked.update(points)
        return [outcome.values for outcome in run(trials, workers, told=told)]

    def look(name: str, points: Sequence[Place], candidates: int | None) -> list[Look]:
        values = ask(name, points, what=COVERAGE_ONLY, candidates=candidates)
        return [Look(value.get("coverable", 0.0), value.get("reachable", 0.0)) for value in values]

    unit = qmc.Sobol(max(len(free), 1), scramble=True, rng=np.random.default_rng(scene.plan.seed)).random(LOOKS)
    points = np.tile(low, (LOOKS if len(free) else 1, 1))
    if len(free):
        points[:, free] += unit * (high - low)[free]
    looks = [_rounded(point) for point in points]
    quick = look("quick looks", looks, CANDIDATES)
    if not any(each.coverable for each in quick):
        raise UnreachableError(
            "the robot reaches nothing of the part anywhere in this range; move or widen it (--x, --y, --z, --yaw)"
        )
    seen: dict[Place, Look] = {}

    def look_closer(wanted: Sequence[Place]) -> None:
        new = [point for point in dict.fromkeys(wanted) if point not in seen]
        seen.update(zip(new, look("closer looks", new, CLOSER_CANDIDATES), strict=True))

    look_closer(_best_first(dict(zip(looks, quick, strict=True)))[:CLOSER])
    climbers = [hill[0] for hill in _hills(_best_first(seen), high - low)][:CLIMBERS]  # not all on the same hill
    steps = [np.array(FIRST_STEPS)] * len(climbers)
    while any((step > np.array(LAST_STEPS) / 2).all() for step in steps):
        around = [
            _around(p, step, low, high, free) if (step > np.array(LAST_STEPS) / 2).all() else []
            for p, step in zip(climbers, steps, strict=True)
        ]
        look_closer([point for points in around for point in points])
        for k, points_near in enumerate(around):
            best = min(points_near, key=lambda p: (seen[p].rank, p), default=climbers[k])
            if seen[best].rank < seen[climbers[k]].rank:
                climbers[k] = best
            else:
                steps[k] = steps[k] / 2
    hopeful = _best_and_others(list(dict.fromkeys([*climbers, *_best_first(seen)])), FULL, high - low)
    full = _best_first(dict(zip(hopeful, look("full looks", hopeful, None), strict=True)))
    finalists = _best_and_others(full, FINALISTS, high - low)
    wholes = ask("views and time", finalists, what=WHOLE, candidates=None)
    ten = sorted(
        (row_of(point, (b, c), value) for point, value in zip(finalists, wholes, strict=True) if "views" in value),
        key=lambda row: (-round(row["coverable %"], 1), row["views"], row["cycle s"] or np.inf),
    )[:10]
    lost, unreached = _surroundings(ten[0], low, high, lambda points: look("surroundings", points, CANDIDATES))
    shares = [each.coverable for each in quick]
    return Found(ten, list(zip(looks, shares, strict=True)), lost, unreached, places, len(asked))


def _best_first(looks: Mapping[Place, Look]) -> list[Place]:
    return sorted(looks, key=lambda place: (looks[place].rank, place))


def _rounded(point: Floats) -> Place:
    """To a tenth of a millimetre and of a degree: what `--place` would be given."""
    return tuple(round(float(value), 1) + 0.0 for value in point)


def _best_and_others(points: Sequence[Place], count: int, extent: Floats) -> list[Place]:
    """So many of the points: the first half, and by turns the first of every hill, the second of each, and so on.

    Places of equal coverage differ in their views, and neighbours differ little.
    """
    hills = _hills(points, extent)
    by_turns = [hill[turn] for turn in range(len(points)) for hill in hills if turn < len(hill)]
    return list(dict.fromkeys([*points[: count // 2], *by_turns]))[:count]


def _hills(points: Sequence[Place], extent: Floats) -> list[list[Place]]:
    """Points within a tenth of the range of an earlier one are of its hill."""
    hills: list[list[Place]] = []
    scale = np.where(extent > 0, extent, 1.0)
    for point in points:
        for hill in hills:
            if np.linalg.norm((np.array(point) - np.array(hill[0])) / scale) <= 0.1:
                hill.append(point)
                break
        else:
            hills.append([point])
    return hills


def _around(point: Place, step: Floats, low: Floats, high: Floats, free: Ints) -> list[Place]:
    """One step each way along each free axis, inside the range."""
    moved = []
    for axis in free:
        for sign in (-1.0, 1.0):
            other = np.array(point)
            other[axis] = np.clip(other[axis] + sign * step[axis], low[axis], high[axis])
            moved.append(_rounded(other))
    return [other for other in dict.fromkeys(moved) if other != point]


def _surroundings(
    best: Row, low: Floats, high: Floats, look: Callable[[Sequence[Place]], list[Look]]
) -> tuple[float, float]:
    """Distances [mm] at which coverage is lost, and at which nothing is reached, in the nearest direction."""
    here = tuple(best[axis] for axis in AXES)
    directions = np.vstack([np.eye(3), -np.eye(3)])
    points = [here] + [
        _rounded(np.array([*(np.array(here[:3]) + distance * direction), here[3]]))
        for direction in directions
        for distance in _PROBES
    ]
    covered = np.array([each.coverable for each in look(points)])
    around = covered[1:].reshape(len(directions), len(_PROBES))
    distance = np.broadcast_to(_PROBES, around.shape)
    lost = distance[around < _LOST * covered[0]]
    nothing = distance[around == 0.0]
    return float(lost.min(initial=np.inf)), float(nothing.min(initial=np.inf))


def sentences(found: Found) -> list[str]:
    """The best place, and how sure that is."""
    best, ten = found.ten[0], found.ten
    said = [
        f"Best place: `{place_option(best)}`. {best['views']} views (no fewer than {best['fewest views']}) measure "
        f"{best['visible %']:.1f} % of the surface{time_of(best)}."
    ]
    spread = [np.ptp([row[axis] for row in ten]) for axis in AXES]
    low, high = min(row["coverable %"] for row in ten), max(row["coverable %"] for row in ten)
    said.append(
        f"The {len(ten)} best places cover {low:.1f} to {high:.1f} % with {min(row['views'] for row in ten)} to "
        f"{max(row['views'] for row in ten)} views; they spread over {spread[0]:.0f} x {spread[1]:.0f} x "
        f"{spread[2]:.0f} mm and {spread[3]:.0f} deg."
    )
    said.append(
        f"{_from(found.lost_mm, 'a twentieth of its coverage is lost')}; "
        f"{_from(found.unreached_mm, 'nothing can be reached').lower()}."
    )
    said.append(f"Looked at {found.n_places} places; another seed looks at others.")
    return said


def _from(distance: float, what: str) -> str:
    """From where on something is so, of the places that were looked at."""
    if np.isfinite(distance):
        return f"{distance:g} mm from the best {what}"
    return f"It is nowhere within {_PROBES[-1]:g} mm of the best that {what}"


def pictures(found: Found) -> Iterator[tuple[str, Figure]]:
    """The quick looks from above and over height and turn; the ten best are marked."""
    points = np.array([point for point, _ in found.looked])
    covered = 100 * np.array([share for _, share in found.looked])
    figure = Figure(figsize=(12.0, 5.4), dpi=110, layout="constrained")
    for axes, (a, b) in zip(figure.subplots(1, 2), ((0, 1), (3, 2)), strict=True):
        image = axes.scatter(points[:, a], points[:, b], c=covered, cmap="viridis", s=18)
        axes.scatter(
            [row[AXES[a]] for row in found.ten], [row[AXES[b]] for row in found.ten], facecolors="none",
            edgecolors=VERMILION, s=70, label="ten best",
        )  # fmt: skip
        axes.plot(found.ten[0][AXES[a]], found.ten[0][AXES[b]], "*", color=VERMILION, markersize=14, label="best")
        axes.set_xlabel(f"{AXES[a].replace(' ', ' [')}]")
        axes.set_ylabel(f"{AXES[b].replace(' ', ' [')}]")
        axes.legend(loc="upper right", fontsize=8)
    figure.colorbar(image, ax=figure.axes, label="surface measured at best, quick look [%]", shrink=0.9)
    yield "places", figure
