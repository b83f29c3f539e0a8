"""What plan.json and report.json say of wishes beyond the fewest views, from the selection that answers them."""

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from cell.plan.request import Selected
from cell.runs import schema
from cell.scene.model import PlanSettings
from planner.cover import Cover
from planner.cover.overlap import OverlapGraph
from planner.cover.robust import RobustCover, min_views_at_confidence


def settings(plan: PlanSettings) -> dict[str, JsonValue]:
    """The wishes that differ from their defaults, as report.json lists them."""
    keys = ("max_views", "multiplicity", "pinned", "banned", "cost", "overlap_mm2", "overlap_share", "overlap_in_order")
    asked = {key: getattr(plan, key) for key in keys if getattr(plan, key) != PlanSettings.model_fields[key].default}
    if plan.cost == "time":
        asked |= {"scan_s": plan.scan_s, "settle_s": plan.settle_s}
    if plan.pose_sd_mm > 0 or plan.pose_sd_deg > 0:
        asked |= {key: getattr(plan, key) for key in ("pose_sd_mm", "pose_sd_deg", "alpha", "ensemble")}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asked.items()}


def most_coverage_of(selected: Selected, total_area: float) -> schema.MostCoverage | None:
    """What plan.json and report.json say of the most coverage with a number of views; None where it was not asked for.

    Args:
        selected: the answer.
        total_area: of the surface [m^2].
    """
    cover = selected.cover
    if cover.max_views is None:
        return None
    return schema.MostCoverage(
        max_views=cover.max_views,
        covered=cover.covered_area / total_area,
        upper_bound=cover.upper_area / total_area,
        gap_points=cover.gap_percent,
    )


def overlap_of(selected: Selected, order: NDArray[np.int64], total_area: float) -> schema.Overlap | None:
    """What they say of overlap; None where it was not asked for.

    Args:
        selected: the answer.
        order: (n,) its views in visiting order.
        total_area: of the surface [m^2].
    """
    answer = selected.answer
    if not isinstance(answer, OverlapGraph):
        return None
    without = selected.cover.n_views_without_overlap or 0
    return schema.Overlap(
        connected=answer.is_connected,
        extra_views=len(selected.cover.views) - without,
        views_without=without,
        # The first of all overlaps none before it and does not count.
        without_earlier=sum(not answer.adjacent[order[k], order[:k]].any() for k in range(1, len(order))),
        parts=[
            schema.OverlapPart(views=(answer.component == k).sum(), covered=area / total_area)
            for k, area in enumerate(answer.component_area)
        ],
    )


def robust_of(selected: Selected, total_area: float) -> schema.RobustSelection | None:
    """What they say of the selection under pose errors; None where poses count as exact.

    Args:
        selected: the answer.
        total_area: of the surface [m^2].
    """
    answer = selected.answer
    if not isinstance(answer, RobustCover):
        return None
    return schema.RobustSelection(
        alpha=answer.alpha,
        members=answer.ensemble_size,
        views_needed=min_views_at_confidence(answer.alpha, answer.ensemble_size),
        robust_on_features=answer.robust_area / total_area,
        robust_coverable_on_features=answer.robust_coverable_area / total_area,
    )


def multiplicity_of(selected: Selected) -> schema.Multiplicity | None:
    """What they say of samples measured several times; None where once is enough."""
    cover = selected.cover
    if cover.demand == 1:
        return None
    return schema.Multiplicity(
        views_per_sample=cover.demand, samples_with_fewer_candidates=len(cover.unsatisfiable_rows)
    )


def cost_of(cover: Cover) -> schema.Cost | None:
    """What they say of seconds; None where the number of views counts."""
    return None if cover.cost_and_bound is None else schema.Cost(seconds=cover.cost, bound_seconds=cover.cost_bound)
