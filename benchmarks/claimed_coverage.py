"""Coverage that a measurability matrix predicts for its plan, and the coverage on samples outside the matrix.

The error of a fill: the greedy plan of a matrix, the share of area that the matrix predicts for it, and visible
coverage by its definition (planner/measurability/coverage.py).
"""

from dataclasses import dataclass

import numpy as np

from planner import cover
from planner.geometry.sampling import SurfaceSamples
from planner.measurability import coverage
from planner.measurability.matrix import Measurability
from planner.ports import RayCaster, Scanner
from planner.viewpoints.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True)
class Claim:
    """A plan with its predicted and its true coverage.

    Attributes:
        views: of the greedy plan.
        claimed: share of the area of the matrix's rows that the plan measures.
        visible: share of the surface that it measures, on held-out samples.
    """

    views: int
    claimed: float
    visible: float

    @property
    def error_points(self) -> float:
        """Predicted minus visible [percentage points]."""
        return 100 * (self.claimed - self.visible)


def claim(
    M: Measurability, candidates: Viewpoints, held_out: SurfaceSamples, scanner: Scanner, caster: RayCaster
) -> Claim:
    """Select the greedy plan of a matrix and evaluate it.

    Args:
        M: the matrix.
        candidates: its columns.
        held_out: samples outside the matrix.
        scanner: the sensor model.
        caster: ray caster of the part.
    """
    areas = M.samples.areas
    plan = cover.solve(
        cover.CoverProblem(M.matrix(), areas), rng=np.random.default_rng(0), solver="greedy", effort_budget=0
    )
    claimed = float(areas[M.matrix()[:, plan.views].sum(axis=1) > 0].sum() / areas.sum())
    poses = candidates.T_object_scanner[plan.views]
    return Claim(len(plan.views), claimed, coverage.visible_coverage(poses, held_out, scanner, [caster]).fraction)
