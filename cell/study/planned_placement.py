"""Finalists of placements: each is planned by the stages of `cell plan`, at its effort, and the best plan decides.

The estimates that choose the finalists know neither row generation, pose search nor detours, so that their order and
their bounds do not hold for the plans. The placement of the scene is a finalist as well: the recommended placement is
never worse than the one that a plan without `--place` has.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell.errors import SceneError, UnreachableError
from cell.part import workpiece
from cell.plan import pipeline
from cell.scene.model import Placement, Scene
from cell.scene.settle import settle
from cell.session import Session
from cell.study.prepared_part import scene_from_settings, scene_settings
from cell.study.trials import JsonTable, Trial

N_PLANNED = 2
"""Placements that are planned besides that of the scene."""

Place = tuple[float, ...]
"""Position of the part's centre [mm] and rotation A [deg]."""


@dataclass(frozen=True, slots=True)
class PlannedPlacement:
    """Result of a plan: the first is the best of several by its `rank`.

    Attributes:
        visible: coverage, share of the surface.
        views: number of views.
        lower_bound: on this number, for the candidates of the plan.
        duration_s: of the motion.
    """

    visible: float
    views: int
    lower_bound: int
    duration_s: float

    @property
    def rank(self) -> tuple[float, int, float]:
        """Sort key: coverage to 0.1 percentage points, views, time."""
        return -round(100 * self.visible, 1), self.views, self.duration_s

    def is_no_worse_than(self, other: "PlannedPlacement") -> bool:
        """Return whether coverage, views and time, in this order and unrounded, are no worse."""
        own, others = ((-each.visible, each.views, each.duration_s) for each in (self, other))
        return own <= others


def plan_placement(settings: JsonTable) -> dict[str, object]:
    """Plan a placement as `cell plan` does, without its files: the trial of a finalist.

    Args:
        settings: scene and files (`cell.study.prepared_part`), position_mm (3), abc_deg (3).

    Returns:
        The values of `PlannedPlacement`, or `cause` if there is no plan.
    """
    place = Placement(position_mm=tuple(settings["position_mm"]), abc_deg=tuple(settings["abc_deg"]))
    scene = scene_from_settings(settings).model_copy(update={"placement": place})
    with tempfile.TemporaryDirectory(prefix="cell-place-") as folder:
        try:
            with pipeline.open_run(Session(None, out=Path(folder) / "run"), scene, with_plots=False) as run:
                _, problem, plan = pipeline.plan_views(run)
                _, motion = pipeline.time_motion(run.session, problem, plan)
                run.stopped = "only its numbers are needed"
        except (SceneError, UnreachableError) as error:
            return {"cause": str(error)}
    return {
        "visible": plan.visible.fraction,
        "views": len(plan.cover.views),
        "lower_bound": plan.cover.lower_bound,
        "duration_s": motion.duration,
    }


def place_of(scene: Scene) -> Place:
    """Return the placement of a scene."""
    placement = scene.placement
    if placement.origin_mm is not None:  # the position of the centre depends on the part
        placement = settle(scene, workpiece.load(scene.part.source, scene.part.units)).scene.placement
    return *placement.position_mm, placement.abc_deg[0]


def finalist_trials(scene: Scene, places: Iterable[Place]) -> dict[Place, Trial]:
    """Return the trials of finalists; all have the rotations B and C of the scene."""
    base, (_, b, c) = scene_settings(scene), scene.placement.abc_deg
    return {
        place: Trial.of(plan_placement, {**base, "position_mm": place[:3], "abc_deg": (place[3], b, c)})
        for place in dict.fromkeys(tuple(map(float, place)) for place in places)
    }


def planned_of(values: JsonTable | None) -> PlannedPlacement | None:
    """Return the result of a trial; None without a plan."""
    return PlannedPlacement(**values) if values and "visible" in values else None


def best_place(planned: Mapping[Place, PlannedPlacement], default: Place) -> Place:
    """Return the place of the best plan, which is no worse than that of the default place if this is planned.

    Args:
        planned: at least one.
        default: placement of the scene.
    """
    known = planned.get(default)
    allowed = [place for place, each in planned.items() if known is None or each.is_no_worse_than(known)]
    return min(allowed, key=lambda place: (planned[place].rank, place != default, place))


def is_within(place: Place, ends: Sequence[Sequence[float]]) -> bool:
    """Return whether a place is within the (4) ranges (first, ..., last) of a search."""
    return all(min(range_) - 1e-9 <= value <= max(range_) + 1e-9 for value, range_ in zip(place, ends, strict=True))


def planned_columns(placement: PlannedPlacement | None) -> dict[str, float | int | None]:
    """Return the columns of a row with the numbers of its plan."""
    if placement is None:
        return {"planned %": None, "planned views": None, "planned bound": None, "planned s": None}
    return {
        "planned %": 100 * placement.visible,
        "planned views": placement.views,
        "planned bound": placement.lower_bound,
        "planned s": float(np.round(placement.duration_s, 3)),
    }
