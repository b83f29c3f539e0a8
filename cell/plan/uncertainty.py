"""Views for the uncertainty of characteristics: samples on their features become rows that demand several views.

The uncertainty of a mean falls with the root of the number of points, and that of a pose error with the root of the
number of views. A characteristic with U above its limit therefore raises the number of views that its samples demand,
and views are added to those that answer the request until the demands are met. Bounds are those of the request alone,
over the rows of the enlarged matrix.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cell.inspect.evaluation import Measurement
from cell.inspect.features import InspectionPlan
from cell.inspect.measured import Association, MeasuredFeature
from cell.inspect.prediction import PlannedViews, main_source, predict_features, predicted_measurements
from cell.plan.selection import N_FRESH, Search, Selection, SelectionProblem, measure_rows, select_views
from cell.world.measurability import PartSurface
from planner.cover import CoverStatus
from planner.geometry.sampling import draw_samples
from planner.measurability.matrix import append_rows
from planner.values import Ints

log = logging.getLogger(__name__)

ROUNDS = 3
"""Selections with raised demands at most."""

MOST_TIMES = 2.0
"""Points of a feature are multiplied by this factor at most; a characteristic that needs more is named."""

MISSED = 1.5
"""Factor of a characteristic of which too little is measured: its samples become rows that two views measure."""

_IMPROVED = 0.9  # of the points that a characteristic needed; with less of a gain no more views are added for it
_MARGIN = 1.2  # of the needed number of points: samples are measured by whole numbers of views
_CONSIDERABLE = 0.1  # share of a feature in the variance from which more points on it are worth views
_ROWS = 600  # rows that a round adds at most


def add_views_for_uncertainty(
    problem: SelectionProblem, selection: Selection, surface: PartSurface, plan: InspectionPlan,
    rng: np.random.Generator, fresh: np.random.Generator,
) -> tuple[SelectionProblem, Selection, tuple[str, ...]]:  # fmt: skip
    """Add views until the predicted uncertainty of every characteristic is within its limit.

    Args:
        problem: candidates and request, for which `Request.allows_swaps` holds.
        selection: views that answer the request.
        surface: the part.
        plan: features and characteristics.
        rng: randomness of the selection.
        fresh: draws the added samples.

    Returns:
        The problem with its rows and demands, the views, and a sentence for each characteristic that no reasonable
        number of views keeps.
    """
    association, known, before = Association(surface.reference, plan), problem.prediction, selection
    pinned = tuple(dict.fromkeys((*problem.request.plan.pinned, *before.cover.views.tolist())))
    with_pins = problem.request.plan.model_copy(update={"pinned": pinned})
    demand: Ints = np.ones(len(surface.reference.faces), dtype=np.int64)
    demand_of = _feature_sets(association)
    last = [np.inf] * len(plan.characteristics)
    for left in reversed(range(ROUNDS + 1)):
        T = problem.candidates.T_object_scanner[selection.cover.views]
        features = predict_features(association, [PlannedViews(T, known.scanner, known.casters)])
        predicted = predicted_measurements(plan, association, features, np.zeros((len(T), 2)))
        times = [_needed_times(plan, each, features) for each in predicted]
        log.info("%d views; needed times of points: %s", len(T), np.round(times, 2).tolist())
        raised = demand.copy()
        for each, factor, earlier in zip(predicted, times, last, strict=True) if left else ():
            if 1.0 < factor <= min(MOST_TIMES, _IMPROVED * earlier):
                _raise_demand(raised, plan, each, features, association, factor)
        # The factor of a characteristic that lacks points says nothing about a later one.
        last = [
            np.inf if _lacks_points(plan, each, features) else factor
            for each, factor in zip(predicted, times, strict=True)
        ]
        if (raised == demand).all():
            break
        new = np.flatnonzero((raised > 1) & (demand == 1))
        demand = raised
        problem = _with_rows(problem, surface, new, fresh)
        problem = replace(problem, request=replace(problem.request, demand=demand, demand_of=demand_of))
        adding = replace(problem, request=replace(problem.request, plan=with_pins))
        selection = select_views(adding, rng, start=selection, search=Search.CONTINUED)
        selection = select_views(adding, rng, start=selection)
    if problem.request.demand is not None:
        selection = _with_bound(problem, before, selection, rng)
    return problem, selection, tuple(_causes(plan, predicted, times, association, demand))


def _feature_sets(association: Association) -> Ints:
    """Return a number (F,) for each triangle of the reference: triangles of the same features have the same."""
    found = np.zeros(len(association.reference.faces), dtype=np.int64)
    for surfaces in association.surfaces.values():
        own = np.isin(np.arange(len(found)), np.concatenate([each.triangles for each in surfaces]))
        found = np.unique(2 * found + own, return_inverse=True)[1]
    return found


def _with_bound(
    problem: SelectionProblem, before: Selection, selection: Selection, rng: np.random.Generator
) -> Selection:
    """Return a selection with target and bound of the request without demands, over the rows of the problem."""
    easier, targets = before, before.targets
    if not problem.request.is_complete:  # else the bound holds for more rows too
        targets = np.minimum(targets, selection.claimed_coverage)
        plain = replace(problem, request=replace(problem.request, demand=None, demand_of=None))
        start = replace(before, targets=targets)
        easier = select_views(plain, rng.spawn(1)[0], start=start, search=Search.CONTINUED)
    bound = min(easier.cover.lower_bound, len(selection.cover.views))
    status = CoverStatus.PROVEN if bound == len(selection.cover.views) else CoverStatus.BOUNDED
    cover = replace(selection.cover, lower_bound=bound, status=status)
    return replace(selection, cover=cover, targets=targets, sentence=cover.sentence, cost_bound=before.cost_bound)


def _causes(
    plan: InspectionPlan, predicted: Sequence[Measurement], times: Sequence[float], association: Association,
    demand: Ints,
) -> Iterator[str]:  # fmt: skip
    """Yield a sentence for each characteristic whose requirement is not met."""
    for each, factor in zip(predicted, times, strict=True):
        name = each.characteristic.name
        if factor > MOST_TIMES:
            source = main_source(plan, each.characteristic, each.contributions)
            source = f" ({source})" if source else ""
            yield (
                f"{name}: about {factor:.0f} times as many points are needed, and views are added for at most "
                f"{MOST_TIMES:g} times{source}; use a scanner with denser points or less noise, or "
                "allow a larger u_over_t in [inspection]"
            )
        elif factor > 1:
            names = [feature.name for feature in plan.features_of(each.characteristic)]
            views = max(int(demand[own.triangles].max()) for every in names for own in association.surfaces[every])
            number = f"{views} views" if views > 1 else "1 view"
            yield f"{name}: the requirement is not met with {number} of each sample, or all that can measure it"


def _needed_times(plan: InspectionPlan, predicted: Measurement, features: Mapping[str, MeasuredFeature]) -> float:
    """Return the factor of the number of points that a characteristic needs; 1 if it needs no more."""
    tolerance, uncertainty = predicted.characteristic.tolerance, predicted.expanded_uncertainty
    if _lacks_points(plan, predicted, features):
        return MISSED
    if plan.u_over_t is None or not tolerance or uncertainty is None:
        return 1.0
    ratio = uncertainty / (plan.u_over_t * tolerance)
    return _MARGIN * ratio**2 if ratio > 1 else 1.0


def _lacks_points(plan: InspectionPlan, predicted: Measurement, features: Mapping[str, MeasuredFeature]) -> bool:
    """Return whether too little of the features of a characteristic is measured."""
    own = [patch for each in plan.features_of(predicted.characteristic) for patch in features[each.name].patches]
    return predicted.value is None or not all(patch.is_measured for patch in own)


def _raise_demand(
    demand: Ints, plan: InspectionPlan, predicted: Measurement, features: Mapping[str, MeasuredFeature],
    association: Association, times: float,
) -> None:  # fmt: skip
    """Raise the demand (F,) of the triangles of the features that make a characteristic uncertain.

    These are the ones of which too little is measured, else those with a considerable share of the variance.
    """
    every = [
        (feature.name, patch, surface.triangles)
        for feature in plan.features_of(predicted.characteristic)
        for patch, surface in zip(features[feature.name].patches, association.surfaces[feature.name], strict=True)
    ]
    missed = [each for each in every if not each[1].is_measured]
    if missed or predicted.value is None:
        for _, _, triangles in missed or every:
            demand[triangles] = np.maximum(demand[triangles], 2)
        return
    for name, patch, triangles in every:
        if predicted.contributions.get(name, 0.0) >= _CONSIDERABLE:
            views = int(np.ceil(times * max(patch.mean_views, 1.0)))
            demand[triangles] = np.maximum(demand[triangles], views)


def _with_rows(
    problem: SelectionProblem, surface: PartSurface, faces: Ints, fresh: np.random.Generator
) -> SelectionProblem:
    """Return the problem with fresh samples on some triangles of the reference as rows."""
    pool = draw_samples(surface.reference, surface.planning, N_FRESH, fresh)
    pool_rows = np.flatnonzero(np.isin(pool.face, faces))
    pool_rows = pool_rows[:: 1 + len(pool_rows) // _ROWS]
    if not len(pool_rows):
        return problem
    rows = measure_rows(problem, problem.reached.reachable, pool.pick(pool_rows))
    return replace(problem, M=append_rows(problem.M, rows, problem.prediction.samples))
