"""Why believed surface stays open: the condition at which the candidate that came closest fails (`planner.why`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cell.runs.schema import OpenReason
from planner.explore.gain import OpenSamples
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach
from planner.ports import RayCaster, Scanner
from planner.values import Ints, Value
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import why
from planner.why.why import REASON_OF_VERDICT, Reason

SMALL, TRIED, NOT_TAKEN = -3, -2, -1
"""Beside `Reason`: what views that were to measure it left, near what was measured and far from it; and what a view
is to measure that was not taken."""

BESIDE = 2.0
"""Edges from the middle of a measured voxel within which what views left is a rest, whose believed place and normal
are too uncertain for any other reason."""

_SHADED = (Reason.SOURCE_SHADED_BY_PART, Reason.SENSOR_SHADED_BY_PART, Reason.SOURCE_SHADED, Reason.SENSOR_SHADED)

_SAID: dict[int, str] = {
    SMALL: "a rest within two voxels of what was measured, which the views that were taken for it left",
    TRIED: "views were expected to measure it and did not: it is too steep, or not there",
    NOT_TAKEN: "a reachable view is expected to measure it, and was not taken",
    **dict.fromkeys(_SHADED, "laser or sensor shaded"),
    Reason.OUT_OF_REACH: "views that might measure it are out of the arm's reach",
    Reason.JOINT_LIMIT: "views that might measure it are beyond a joint limit",
    Reason.COLLISION: "views that might measure it are in collision, or too near to what was not seen",
}
"""Where surface is believed, not known: which leg something shades, and what, is within a voxel no news of the part."""


@dataclass(frozen=True, slots=True, eq=False)
class StillOpen(Value):
    """Samples of the believed surface that are open, and why.

    Attributes:
        samples: N of them.
        reason: (N,) `Reason` values, `SMALL`, `TRIED` or `NOT_TAKEN`.
        candidates: viewpoints that were looked at.
    """

    samples: SurfaceSamples
    reason: Annotated[Ints, "N"]
    candidates: Viewpoints

    def by_area(self) -> tuple[OpenReason, ...]:
        """Area by sentence, the largest first."""
        said = np.array([sentence(code) for code in self.reason.tolist()], dtype=object)
        areas = {each: 1e6 * float(self.samples.areas[said == each].sum()) for each in dict.fromkeys(said.tolist())}
        return tuple(
            OpenReason(reason=each, area_mm2=round(area, 3))
            for each, area in sorted(areas.items(), key=lambda item: -item[1])
        )


def sentence(code: int) -> str:
    """A reason in words."""
    return _SAID.get(code) or Reason(code).sentence


def still_open(
    samples: SurfaceSamples,
    of: OpenSamples,
    candidates: Viewpoints,
    reached: Reach,
    scanner: Scanner,
    casters: Sequence[RayCaster],
) -> StillOpen:
    """Open samples with their reasons.

    Args:
        samples: of the believed surface, those that are open.
        of: their classes.
        candidates: viewpoints that were looked at.
        reached: their verdicts.
        scanner: the sensor's law.
        casters: the believed part's, and that of occluders.
    """
    found = closest(samples, candidates, reached, scanner, casters)
    reason = np.where(found == Reason.NOT_SELECTED, np.where(of.tries > 0, TRIED, NOT_TAKEN), found)
    # What is shaded by others than the part is, that near, a voxel of belief in what the part stands on.
    reason[(of.tries > 0) & (of.distance_edges <= BESIDE) & (found >= Reason.SOURCE_SHADED)] = SMALL
    return StillOpen(samples, reason, candidates)


def closest(
    samples: SurfaceSamples, candidates: Viewpoints, reached: Reach, scanner: Scanner, casters: Sequence[RayCaster]
) -> Ints:
    """(S,) the `Reason` at which the candidate fails that comes closest to measuring each; as in `still_open`."""
    fails = np.array([REASON_OF_VERDICT[verdict] for verdict in REASON_OF_VERDICT], dtype=np.uint8)[reached.verdict]
    targets, rows = RayTargets.of(samples.points, samples.normals), np.arange(len(samples))
    found = why.diagnose(targets, rows, candidates, scanner, casters[0], casters[1], fails)
    return found.reason.astype(np.int64)
