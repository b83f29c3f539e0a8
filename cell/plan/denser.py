"""Samples added where a plan fails: a coverage below 1 is kept on held-out samples, whatever the matrix saw.

A plan that measures every sample of the matrix may still measure less of the held-out ones than was asked: the matrix
had none on the slivers that it leaves. Then fresh samples, neither the matrix's nor the held-out ones, are asked which
of them the plan leaves and a reachable candidate measures; these become rows, and the plan is made again.
"""

from dataclasses import replace

import numpy as np

from cell.plan.problem import Problem
from cell.plan.view_plan import ConnectedPlan
from cell.rays.matrix import PartSurface
from planner.measurability import quality
from planner.measurability.matrix import Measurability, fill, measured, occlude
from planner.measurability.quality import Limited
from planner.measurability.rows import add_rows
from planner.surface.sample import SurfaceSamples, pick_samples, sample

ROUNDS = 6
"""Times that samples are added at most; each time the plan is made again."""

_FRESH = 40_000  # samples that a round looks at: at 1 % left open 400 become rows


def falls_short(problem: Problem, chosen: ConnectedPlan) -> bool:
    """Whether a plan covers all that was asked on the matrix, and yet less than that of the held-out samples."""
    plan, coverable = problem.request.plan, problem.prediction.coverable
    asked = plan.coverage < 1 and plan.multiplicity == 1 and problem.request.layer is None and plan.fill == "aimed"
    return asked and chosen.target >= 1 and chosen.visible.area < plan.coverage * coverable.area


def with_samples(
    problem: Problem, chosen: ConnectedPlan, surface: PartSurface, rng: np.random.Generator
) -> Problem | None:
    """The problem with rows for what the plan leaves; None where fresh samples show nothing that a candidate measures.

    Args:
        problem: what was asked.
        chosen: the plan that falls short.
        surface: the part.
        rng: draws the fresh samples.
    """
    known, candidates = problem.prediction, problem.candidates
    fresh = sample(surface.reference, surface.planning, _FRESH, rng)
    left = pick_samples(fresh, ~measured(chosen.T_object_poses, fresh, known.scanner, known.casters))
    usable = problem.usable([view.candidate for view in chosen.dropped])
    poses = candidates.T_object_scanner[usable]
    left = pick_samples(left, measured(poses, left, known.scanner, known.casters))
    if not len(left):
        return None
    return replace(problem, M=add_rows(problem.M, _rows(problem, left)))


def _rows(problem: Problem, features: SurfaceSamples) -> Measurability:
    """What the candidates measure of further features, occluders applied, the limit on sigma kept."""
    candidates, scanner = problem.candidates, problem.prediction.scanner
    part, others = problem.prediction.casters
    M = occlude(fill(candidates, features, scanner, part), candidates, scanner, others, ray_caster=part)
    if isinstance(scanner, Limited):
        M = quality.sigma_layer(M, candidates, scanner.scanner, casters=(part, others))
    return M
