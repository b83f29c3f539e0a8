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
from cell.plan.request import AGAIN_WORK, LOOK_WORK, WORK, Selected
from cell.plan.view_plan import first_choice
from cell.world.measurability import PartSurface
from cell.world.prediction import Prediction
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.measurability import quality
from planner.measurability.matrix import Measurability, append_rows, spread_measurability
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.ports import SigmaScanner
from planner.values import Bools
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

ROUNDS = 6
"""Times that samples are added at most; each time the views are chosen again."""

FRESH = 20_000
"""Samples that are looked at."""

_MORE = 4_000  # rows that a round adds at most, or twice as many as there are: each round's views say where more help


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
    asked, known = problem.request.asked, problem.prediction
    spread = known.samples if known.required is None else pick_samples(known.samples, known.required)
    selected = None
    for left in reversed(range(ROUNDS + 1)):
        selected = first_choice(problem, rng, looked=selected, look=LOOK_WORK)
        if selected.nearly(asked):
            selected = _settled(problem, selected, rng)
            if selected.nearly(asked):
                break
        if not left:  # what is raised and bounded from here on has to have been looked at on the same samples
            break
        pool = draw_samples(surface.reference, surface.planning, FRESH, fresh)
        pool = pool if known.is_required is None else pick_samples(pool, known.is_required(pool))
        added = _needed(problem, selected, pool)
        if not added.any():
            break
        more = rows_of(
            problem.candidates, problem.reached.reachable, problem.prediction, pick_samples(pool, added),
            sigma=problem.M.sigma is not None,
        )  # fmt: skip
        problem = replace(problem, M=append_rows(problem.M, more, spread))
    return problem, first_choice(problem, rng, looked=selected)


def _settled(problem: Problem, looked: Selected, rng: np.random.Generator) -> Selected:
    """What the whole work makes of views: searched on, and bounded."""
    if not problem.request.brief:  # a look was the whole work
        return looked
    asked, targets = problem.request.asked, looked.raised(problem.request.asked)
    if looked.keeps(asked):  # should they stay, then as views for targets that they meet
        targets = np.minimum(targets, looked.claimed)
    looked = replace(looked, targets=targets)
    found = first_choice(problem, rng, looked=looked, look=WORK)
    if found.keeps(asked) or not looked.keeps(asked):
        return found
    # Fewer, but too few: a few more of the matrix' samples, or else the views that were there.
    again = replace(found, targets=found.raised(asked))
    more = first_choice(problem, rng, looked=again, look=AGAIN_WORK).bounded(found)
    better = more.keeps(asked) and len(more.cover.views) < len(looked.cover.views)
    return more if better else looked.bounded(found)


def _adds(problem: Problem) -> bool:
    """Whether more samples help: a plain coverage below 1 is asked for, of samples."""
    return problem.request.promises and problem.request.plan.fill == "aimed"


def _needed(problem: Problem, selected: Selected, pool: SurfaceSamples) -> Bools:
    """(S,) which of the pool become rows; none where they show nothing that candidates measure and the views leave."""
    known, T = problem.prediction, problem.candidates.T_object_scanner
    left = pick_samples(pool, ~find_measured(T[selected.cover.views], pool, known.scanner, known.casters))
    left = pick_samples(left, find_measured(T[problem.usable(())], left, known.scanner, known.casters))
    # All fresh samples of the planning faces on which the views fail: these alone would make the faces look worse.
    needed = np.isin(pool.planning_face, left.planning_face)
    some = np.flatnonzero(needed)[:: 1 + int(needed.sum()) // max(2 * len(problem.M.samples), _MORE)]
    return np.asarray(np.isin(np.arange(len(pool)), some))


def rows_of(
    candidates: Viewpoints, reachable: Bools, prediction: Prediction, features: SurfaceSamples, *, sigma: bool
) -> Measurability:
    """What reachable candidates measure of further features, occluders applied, the limit on sigma kept.

    Args:
        candidates: V viewpoints, all poses of each.
        reachable: (V,) those that are asked.
        prediction: for the sensor's law and what stands in the way.
        features: the rows.
        sigma: whether the layer of sigma is there.
    """
    usable, total = np.flatnonzero(reachable), len(candidates)
    candidates, scanner = pick_viewpoints(candidates, usable), prediction.scanner
    part, others = prediction.casters
    M = apply_occluders(fill_matrix(candidates, features, scanner, part), candidates, scanner, others, ray_caster=part)
    if sigma:
        M = quality.sigma_layer(M, candidates, cast(SigmaScanner, scanner), casters=(part, others))
    return spread_measurability(M, usable, total)
