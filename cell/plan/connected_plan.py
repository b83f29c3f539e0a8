"""Chosen views with the motion through them: what steps 6 to 8 of a plan come to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cell.plan.request import Selected
from planner.cover import Cover
from planner.measurability.coverage import Coverage
from planner.measurability.matrix import Measurability
from planner.path.sweeps import SweepPath
from planner.timing.motion import TimedLine
from planner.tour.tour import Tour
from planner.values import Bools, Floats, Ints, Value


@dataclass(frozen=True, slots=True)
class DroppedView:
    """A candidate that was chosen and is not in the plan: it could not be connected, or its own arm shades it.

    Attributes:
        candidate: row of the viewpoints.
        reason: one sentence.
    """

    candidate: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class ConnectedPlan(Value):
    """Chosen views with the motion through them.

    Attributes:
        cover: the selection, in order of the area that each view adds.
        selected: the answer to the request, before views were exchanged.
        matrix: measurability as the arm leaves it: what the cover was solved on.
        tour: the motion; its views are indices into `cover.views`.
        candidate: (n,) candidates in visiting order.
        T_object_scanner: (n, 4, 4) poses of the rounded joint angles through forward kinematics [m], visiting order.
        T_base_scanner: (n, 4, 4) the same in base [m].
        T_base_flange: (n, 4, 4) the same of the flange [m].
        T_object_poses: (n, K, 4, 4) all poses of each view; of a sweep `T_object_scanner` is the middle one.
        sweeps: the sweeps that are driven, in visiting order; none for views at rest.
        lines: their timing, by the via point at which each begins.
        dropped: candidates that could not be connected, or that the arm shades.
        seen: (S, n) which held-out samples each view measures, in visiting order.
        visible: visible coverage of the views on these samples.
        visible_with_arm: visible coverage where each view's own arm hides as well, fraction of the surface; None for
            views that sweep: the arm's shadow along a sweep is not judged.
    """

    cover: Cover
    selected: Selected
    matrix: Measurability
    tour: Tour
    candidate: Annotated[Ints, "n"]
    T_object_scanner: Annotated[Floats, "n 4 4"]
    T_base_scanner: Annotated[Floats, "n 4 4"]
    T_base_flange: Annotated[Floats, "n 4 4"]
    T_object_poses: Annotated[Floats, "n _ 4 4"]
    sweeps: tuple[SweepPath, ...]
    lines: Mapping[int, TimedLine]
    dropped: tuple[DroppedView, ...]
    seen: Annotated[Bools, "S n"]
    visible: Coverage
    visible_with_arm: float | None

    @property
    def target(self) -> float:
        """Share of the coverable samples of the matrix that was asked of the cover."""
        return self.selected.target

    @property
    def via_candidate(self) -> Ints:
        """(N,) candidate taken at each via point of the tour, -1 where none is."""
        at = self.tour.view
        return np.where(at >= 0, self.cover.views[np.maximum(at, 0)], -1)
