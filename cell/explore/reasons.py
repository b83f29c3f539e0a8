"""Why believed surface stays open: the condition at which the candidate that came closest fails (`planner.why`)."""

from collections.abc import Sequence

import numpy as np

from cell.run.explore_json import OpenReason
from planner.ports import RayCaster, Scanner
from planner.reach.reach import Reach
from planner.surface.sample import SurfaceSamples
from planner.values import Ints
from planner.viewpoints.lines_of_sight import Targets
from planner.viewpoints.viewpoints import Viewpoints
from planner.why import why
from planner.why.reasons import OF_VERDICT, Reason

_TRIED = "views were expected to measure it and did not: it is too small, too steep, or not there"
_NOT_TAKEN = "a reachable view is expected to measure it, and was not taken"


def reasons(
    samples: SurfaceSamples,
    tries: Ints,
    candidates: Viewpoints,
    reached: Reach,
    scanner: Scanner,
    casters: Sequence[RayCaster],
) -> tuple[OpenReason, ...]:
    """Area by reason, the largest first.

    Args:
        samples: of the believed surface, those that are open.
        tries: (S,) how many views were expected to measure each and did not.
        candidates: viewpoints that were looked at.
        reached: their verdicts.
        scanner: the sensor's law.
        casters: the believed part's, and that of occluders.
    """
    fails = np.array([OF_VERDICT[verdict] for verdict in OF_VERDICT], dtype=np.uint8)[reached.verdict]
    targets = Targets.of(samples.points, samples.normals)
    rows = np.arange(len(samples))
    found = why.diagnose(targets, rows, candidates, scanner, casters[0], casters[1], fails).reason
    named = np.where(found == Reason.NOT_SELECTED, np.where(tries > 0, -2, -1), found.astype(np.int64))
    said = {-2: _TRIED, -1: _NOT_TAKEN}
    areas = {int(code): 1e6 * float(samples.areas[named == code].sum()) for code in np.unique(named)}
    return tuple(
        OpenReason(reason=said.get(code) or Reason(code).sentence, area_mm2=round(area, 3))
        for code, area in sorted(areas.items(), key=lambda item: -item[1])
    )
