"""What the regions of a part ask of the selection: demand and weight of each row, and shares of the parts of the rows.

Regions with a coverage of their own are a part each; all others share one, whose coverage is the plan's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell.errors import UnreachableError
from cell.scene.model import PlanSettings, RegionTargets
from cell.world.prediction import Prediction
from planner.cover import CoverProblem
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.matrix import Measurability
from planner.values import Bools, Floats, Ints

_MOST_VIEWS = 2**31 - 1  # more than any plan has; a demand above is not a number of NumPy's any more


def require_measurable(regions: Sequence[RegionTargets], M: Measurability) -> None:
    """Refuse regions of which no reachable candidate measures anything, naming their limits.

    Raises:
        UnreachableError: with what helps.
    """
    if not regions or len(M.indices):
        return
    limits = [
        f"'{each.name}' takes {what} {limit:g} mm"
        for each in regions
        for what, limit in (("a spacing of at most", each.max_spacing_mm), ("a sigma of at most", each.max_sigma_mm))
        if limit is not None
    ]
    raise UnreachableError(
        "no reachable candidate measures anything that the regions ask for"
        + (f" ({', '.join(limits)})" if limits else "")
        + "; allow more, take a finer resolution or a device with a nearer range, or move the part"
    )


@dataclass(frozen=True, slots=True, eq=False)
class RegionGoals:
    """The wishes by the numbers of the regions.

    Attributes:
        part: (R,) part that each region belongs to.
        coverage: (P,) share of what is coverable that is asked of each part.
        views: (R,) views from which samples are measured.
        weight: (R,) of their area.
    """

    part: Ints
    coverage: Floats
    views: Ints
    weight: Floats

    @classmethod
    def of(cls, regions: Sequence[RegionTargets], plan: PlanSettings) -> "RegionGoals | None":
        """The wishes of a scene's regions, the rest among them; None where it has none."""
        if not regions:
            return None
        own = [each for each in regions if each.cared and each.coverage is not None]
        others = [each for each in regions if each.cared and each.coverage is None]
        first = int(bool(others))  # the part that regions without a coverage share
        asked = [plan.coverage] * first + [float(each.coverage or 0.0) for each in own]
        return cls(
            np.array([first + own.index(each) if each in own else 0 for each in regions]),
            np.array(asked or [plan.coverage]),
            np.array([min(plan.multiplicity if each.views is None else each.views, _MOST_VIEWS) for each in regions]),
            np.array([each.weight for each in regions]),
        )

    @property
    def plain(self) -> bool:
        """Whether a selection that knows of no regions answers them: they limit what counts, and no more."""
        return len(self.coverage) == 1 and bool((self.views == 1).all() and (self.weight == 1).all())

    def applied(self, wish: CoverProblem, rows: SurfaceSamples) -> CoverProblem:
        """A wish that asks for what the regions of its rows do."""
        assert rows.region is not None, "the part has regions"
        region = rows.region.astype(np.int64)
        if (self.views != wish.demand).any():
            wish = replace(wish, demand=self.views[region])
        if (self.weight != 1).any():
            wish = replace(wish, weights=rows.areas * self.weight[region])
        if wish.max_views is not None:
            return wish
        wish = replace(wish, coverage=float(self.coverage[0]))
        if len(self.coverage) > 1:
            wish = replace(wish, region=self.part[region])
        return wish

    def shares(self, prediction: Prediction, T_object_scanner: Floats) -> Floats:
        """(P,) what views (n, K, 4, 4) [m] measure of what is coverable of each part, on the held-out samples."""
        seen = prediction.visible(T_object_scanner).covered
        return self.shares_of(prediction.samples, seen, prediction.coverable.covered)

    def shares_of(self, samples: SurfaceSamples, seen: Bools, can: Bools) -> Floats:
        """(P,) what is seen of what can be measured of (S,) samples, of each part of them."""
        assert samples.region is not None, "the part has regions"
        region = samples.region.astype(np.int64)
        worth, part = samples.areas * self.weight[region], self.part[region]
        count = len(self.coverage)
        worth_seen, worth_can = (np.bincount(part, weights=worth * which, minlength=count) for which in (seen, can))
        return np.divide(worth_seen, worth_can, out=np.ones(count), where=worth_can > 0)
