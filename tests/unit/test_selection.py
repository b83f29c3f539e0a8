"""Selection of views: a coverage below 1 also holds on samples that the optimiser has not seen."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

from cell.plan import evaluation
from cell.plan.selection import RegionGroups, Request, Search, Selection, SelectionProblem, select_views
from cell.scene.model import PlanSettings, RegionTargets
from planner.cover import Cover, CoverProblem, solve
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import Reach, Verdict
from planner.measurability.matrix import Measurability
from planner.viewpoints.viewpoints import Viewpoints


class HeldOut:
    """Held-out samples of which each view measures a separate share; the interface of `Prediction`."""

    def __init__(self, share_of_view: list[float]) -> None:
        self._shares = np.array(share_of_view)

    def share_of_coverable(self, poses: np.ndarray) -> float:
        return float(self._shares[poses[:, 0, 0, 3].astype(int)].sum())


def _problem(
    areas: np.ndarray, plan: PlanSettings, held_out: object, regions: RegionGroups | None = None
) -> SelectionProblem:
    """Candidate k measures row k alone; its pose has the translation k."""
    n = len(areas)
    T = np.tile(np.eye(4), (n, 1, 1, 1))
    T[:, 0, 0, 3] = np.arange(n)
    face = np.zeros(n, dtype=np.int32)
    viewpoints = Viewpoints(T, face, np.full(n, 0.3), np.zeros(n))
    region = None if regions is None else np.zeros(n, dtype=np.int16)
    samples = SurfaceSamples(np.zeros((n, 3)), np.tile([0.0, 0, 1], (n, 1)), areas, face, face, region)
    M = Measurability(np.arange(n + 1), np.arange(n, dtype=np.int32), samples, n)
    reached = Reach(np.full(n, Verdict.REACHABLE, dtype=np.uint8), np.zeros((n, 6)), np.arange(n + 1), ("",) * n)
    cell = SimpleNamespace(world=None)
    return SelectionProblem(viewpoints, reached, M, held_out, Request(plan, regions=regions), cell, None)  # type: ignore[arg-type]


def _selected(requested: float, share_of_view: list[float]) -> tuple[int, float]:
    problem = _problem(np.ones(len(share_of_view)), PlanSettings(coverage=requested), HeldOut(share_of_view))
    selection = select_views(problem, np.random.default_rng(0))
    return len(selection.cover.views), selection.target


def test_a_selection_that_holds_is_not_changed() -> None:
    """Half of ten equal samples needs five views, and the target remains the requested coverage."""
    assert _selected(0.5, [0.1] * 10) == (5, 0.5)


def test_the_target_is_raised_until_the_held_out_share_is_reached() -> None:
    """With 0.08 of the held-out samples per view, half of them needs seven views and not the five of the matrix."""
    views, target = _selected(0.5, [0.08] * 10)
    assert views == 7
    assert 0.5 < target <= 0.7


def test_a_target_that_cannot_hold_ends_at_full_coverage() -> None:
    """If all views measure almost no held-out sample, all are selected and the target is 1."""
    assert _selected(0.5, [0.001] * 10) == (10, pytest.approx(1.0))


def test_weighted_views_claim_no_more_than_their_target() -> None:
    """A view with nine tenths of the area and half of the weight claims half of the coverage."""
    areas, weights = np.array([9.0, *[0.1] * 10]), np.array([10.0, *[1.0] * 10])

    class Weighted(RegionGroups):
        def apply(self, problem: CoverProblem, rows: SurfaceSamples) -> CoverProblem:
            return replace(problem, weights=weights)

        def shares(self, *_: object) -> np.ndarray:
            return np.array([0.4])

    regions = Weighted.of([RegionTargets(name="all", weight=2.0)], PlanSettings(coverage=0.5))
    assert regions is not None
    problem = _problem(areas, PlanSettings(coverage=0.5), None, regions)
    probe = select_views(problem, np.random.default_rng(0), search=Search.PROBE)
    measured = weights[probe.cover.views].sum() / weights.sum()
    assert probe.cover.covered_area / areas.sum() > 0.8
    assert probe.claimed_coverage == pytest.approx([0.5])
    assert probe.claimed_coverage <= measured


def test_triangles_that_demand_several_views_are_measured_by_them() -> None:
    """Row 0 lies on a triangle that demands two views, and is measured by all candidates; rows 1 to 4 by one each."""
    problem = _problem(np.ones(5), PlanSettings(coverage=0.4), HeldOut([0.5] * 5))
    dense = np.eye(5, dtype=bool)
    dense[0] = True
    matrix = csr_array(dense)
    samples = replace(problem.M.samples, face=np.array([0, 1, 1, 1, 1], dtype=np.int32))
    M = Measurability(matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32), samples, 5)
    for views in (2, 4):
        request = replace(problem.request, demand=np.array([views, 1]))
        start = select_views(replace(problem, M=M), np.random.default_rng(0))
        demanding = replace(problem, M=M, request=request)
        found = select_views(demanding, np.random.default_rng(0), start=start, search=Search.CONTINUED)
        assert len(found.cover.views) == views
        assert not request.allows_swaps


@pytest.mark.parametrize("is_split", [False, True])
def test_each_feature_has_its_own_share_of_demanded_views(is_split: bool) -> None:
    """Two triangles demand two views of 0.6 of their samples: a large one that has them, and a small one."""
    problem = _problem(np.ones(6), PlanSettings(coverage=0.4), HeldOut([0.5] * 6))
    dense = np.eye(6, dtype=bool)
    dense[:5] = True
    dense[5, :3] = True
    matrix = csr_array(dense)
    samples = replace(problem.M.samples, face=np.array([0] * 5 + [1], dtype=np.int32), areas=np.array([9.0] * 5 + [1]))
    M = Measurability(matrix.indptr.astype(np.int64), matrix.indices.astype(np.int32), samples, 6)
    demand_of = np.array([1, 2]) if is_split else None
    request = replace(problem.request, demand=np.array([2, 2]), demand_of=demand_of)
    pinned = request.plan.model_copy(update={"pinned": (4, 5)})
    found = select_views(
        replace(problem, M=M, request=replace(request, plan=pinned)), np.random.default_rng(0), search=Search.CONTINUED
    )
    assert len(found.cover.views) == (3 if is_split else 2)


def _half_covered(share: float) -> Cover:
    return solve(
        CoverProblem(csr_array(np.eye(100, dtype=bool)), np.ones(100), coverage=share), rng=np.random.default_rng(0)
    )


@pytest.mark.parametrize(
    ("requested", "share", "is_near"), [(0.99, 0.9895, True), (0.99, 0.98, False), (0.999, 0.9988, False)]
)
def test_a_target_above_full_coverage_is_not_near(requested: float, share: float, is_near: bool) -> None:
    """Views that measure all of the matrix leave no higher target: samples must be added."""
    found = Selection(_half_covered(requested), np.array([requested]), "", shares=np.array([share]))
    assert found.almost_satisfies(np.array([requested])) is is_near
    assert found.raised_targets(np.array([requested])) <= 1


@pytest.mark.parametrize("max_views", [None, 2])
def test_the_status_names_a_raised_target_if_a_coverage_was_requested(max_views: int | None) -> None:
    """A plan with a largest number of views has no requested coverage, and its target is that of its cover."""
    cover = SimpleNamespace(sentence="proven", max_views=max_views)
    selection = SimpleNamespace(details=None, targets=np.ones(1))
    plan: Any = SimpleNamespace(cover=cover, selection=selection, target=1.0, searched="")
    raised = ", at 100.00 % of the coverable samples for the requested 99 %" if max_views is None else ""
    assert evaluation._status(plan, 0.99) == f"Proven{raised}"
