"""Samples added where a plan fails: a coverage below 1 is kept on held-out samples, whatever the matrix saw.

A plan that measures every sample of the matrix may still measure less of the held-out ones than was asked: the matrix
had none on the slivers that it leaves. Then fresh samples, neither the matrix's nor the held-out ones, are asked which
of them the views leave and a reachable candidate measures; these become rows, and the views are chosen again.
"""

from dataclasses import replace

import numpy as np

from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.view_plan import first_choice
from cell.rays.matrix import PartSurface
from planner.measurability import quality
from planner.measurability.matrix import Measurability, fill, measured, occlude
from planner.measurability.quality import Limited
from planner.measurability.rows import add_rows
from planner.surface.sample import SurfaceSamples, pick_samples, sample

ROUNDS = 6
"""Times that samples are added at most; each time the views are chosen again."""

_FRESH = 40_000  # samples that a round looks at: at 1 % left open 400 become rows


def chosen_where_kept(
    problem: Problem, surface: PartSurface, rng: np.random.Generator, fresh: np.random.Generator
) -> tuple[Problem, Selected]:
    """The first choice of views, with samples added until they keep the coverage that is asked for.

    Args:
        problem: what is asked.
        surface: the part.
        rng: randomness of the selection.
        fresh: draws the samples.

    Returns:
        The problem with its samples, and the views; they fall short only where fresh samples show nothing more.
    """
    selected = first_choice(problem, rng)
    for _ in range(ROUNDS):
        more = with_samples(problem, selected, surface, fresh) if falls_short(problem, selected) else None
        if more is None:
            break
        problem, selected = more, first_choice(more, rng)
    return problem, selected


def falls_short(problem: Problem, selected: Selected) -> bool:
    """Whether views cover all that was asked on the matrix, and yet less than that of the held-out samples."""
    plan = problem.request.plan
    plain = plan.max_views is None and plan.multiplicity == 1 and problem.request.layer is None
    if not (plain and plan.coverage < 1 and plan.fill == "aimed" and selected.target >= 1):
        return False
    poses = problem.candidates.T_object_scanner[selected.cover.views]
    return problem.prediction.share_of_coverable(poses) < plan.coverage


def with_samples(
    problem: Problem, selected: Selected, surface: PartSurface, rng: np.random.Generator
) -> Problem | None:
    """The problem with rows for what the views leave; None where fresh samples show nothing that a candidate measures.

    Args:
        problem: what was asked.
        selected: the views that fall short.
        surface: the part.
        rng: draws the fresh samples.
    """
    known, T = problem.prediction, problem.candidates.T_object_scanner
    left = sample(surface.reference, surface.planning, _FRESH, rng)
    left = pick_samples(left, ~measured(T[selected.cover.views], left, known.scanner, known.casters))
    left = pick_samples(left, measured(T[problem.usable(())], left, known.scanner, known.casters))
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
