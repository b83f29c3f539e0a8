"""Samples added where a plan fails: a coverage below 1 is kept on held-out samples, whatever the matrix saw.

Views that measure 99 % of the matrix' samples measure less of the held-out ones: the matrix has too few samples on
the slivers that they leave. Asking for more of the matrix costs views that measure next to nothing. So fresh samples,
neither the matrix's nor the held-out ones, are asked which of them the views leave and a reachable candidate
measures; all fresh samples of the planning faces with such ones become rows, and the views are chosen again.
"""

from dataclasses import replace
from typing import cast

import numpy as np

from cell.plan.problem import Problem
from cell.plan.request import Selected
from cell.plan.view_plan import first_choice
from cell.rays.matrix import PartSurface
from planner.measurability import quality
from planner.measurability.columns import spread_measurability
from planner.measurability.matrix import Measurability, fill, measured, occlude
from planner.measurability.rows import add_rows
from planner.ports import SigmaScanner
from planner.surface.sample import SurfaceSamples, pick_samples, sample
from planner.viewpoints.viewpoints import pick_viewpoints

ROUNDS = 6
"""Times that samples are added at most; each time the views are chosen again."""

_FRESH = 20_000  # samples that a round looks at


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
    if not _adds(problem):
        return problem, first_choice(problem, rng)
    selected = first_choice(problem, rng, look=True)
    for _ in range(ROUNDS):
        if not selected.short:
            return problem, first_choice(problem, rng, looked=selected)
        more = with_samples(problem, selected, surface, fresh)
        if more is None:
            break
        problem, selected = more, first_choice(more, rng, look=True)
    return problem, first_choice(problem, rng)


def _adds(problem: Problem) -> bool:
    """Whether more samples help: a plain coverage below 1 is asked for, of samples."""
    return problem.request.promises and problem.request.plan.fill == "aimed"


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
    fresh = sample(surface.reference, surface.planning, _FRESH, rng)
    left = pick_samples(fresh, ~measured(T[selected.cover.views], fresh, known.scanner, known.casters))
    left = pick_samples(left, measured(T[problem.usable(())], left, known.scanner, known.casters))
    if not len(left):
        return None
    # All fresh samples of the planning faces on which the views fail: these alone would make the faces look worse.
    added = pick_samples(fresh, np.isin(fresh.planning_face, left.planning_face))
    return replace(problem, M=add_rows(problem.M, _rows(problem, added)))


def _rows(problem: Problem, features: SurfaceSamples) -> Measurability:
    """What reachable candidates measure of further features, occluders applied, the limit on sigma kept."""
    usable = np.flatnonzero(problem.reached.reachable)
    candidates, scanner = pick_viewpoints(problem.candidates, usable), problem.prediction.scanner
    part, others = problem.prediction.casters
    M = occlude(fill(candidates, features, scanner, part), candidates, scanner, others, ray_caster=part)
    if problem.M.sigma is not None:
        M = quality.sigma_layer(M, candidates, cast(SigmaScanner, scanner), casters=(part, others))
    return spread_measurability(M, usable, len(problem.candidates))
