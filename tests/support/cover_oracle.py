"""Oracle for cover problems: all selections of a small problem, evaluated together, and random problems.

The oracle does not use the code under test. Loads, areas, costs, targets and connectivity follow from the definition
of `CoverProblem` by plain sums.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, milp

from planner.cover import Cover, CoverProblem, CoverStatus, Overlap
from planner.values import Bools, Floats, Ints

TOLERANCE = 1e-9
COST_TOLERANCE = 1e-4  # costs that are not integers are rounded


def fewest_views(M: Any, areas: Floats, share: float, *, relaxed: bool = False) -> float:
    """Return the smallest number of columns that measure a share of the coverable area, by an integer programme.

    Args:
        M: (S, V) measurability of the usable columns.
        areas: (S,) of the rows.
        share: of the area of the rows with a column.
        relaxed: columns may be selected in part.
    """
    dense, of_row = np.unique(M.toarray().astype(bool), axis=0, return_inverse=True)
    areas = np.bincount(of_row.ravel(), weights=areas)
    dense, areas = dense[dense.any(axis=1)], areas[dense.any(axis=1)] / areas[dense.any(axis=1)].sum()
    rows, columns = dense.shape
    objective = np.repeat([1.0, 0.0], [columns, rows])
    is_measured = sp.hstack([sp.csr_array(dense.astype(float)), -sp.eye_array(rows)])
    limits = [LinearConstraint(is_measured, 0.0, np.inf), LinearConstraint(np.append(np.zeros(columns), areas), share)]
    found = milp(objective, constraints=limits, integrality=(not relaxed) * objective, bounds=(0, 1))
    assert found.status == 0, found.message
    return float(found.fun) if relaxed else round(found.fun)


class Selections:
    """All selections of the usable columns of a problem, or given ones.

    Attributes:
        usable: (u,) usable columns.
        selected: (n, u) whether each selection contains each usable column.
        size: (n,) number of columns.
        cost: (n,) cost of columns and groups; the size without costs.
        n_groups: (n,) number of groups.
        coverable: (S,) whether all usable columns together bring a load to a row.
        satisfied: (n, S) whether each row has its demanded load, or the largest available one.
        area: (n,) area of the satisfied rows; with `max_views` their weight.
        weight: (n,) weight of the satisfied rows in the target.
        meets_target: (n,) whether a selection reaches the coverage of all regions.
        is_connected: (n,) whether the overlap graph is connected.
        is_feasible: (n,) whether a selection meets the target, is connected, and contains the pinned columns; with
            `max_views`, whether its size is allowed.
    """

    def __init__(self, problem: CoverProblem, selections: Sequence[Iterable[int]] | None = None) -> None:
        M = _dense(problem)
        n_rows, n_columns = M.shape
        self.problem = problem
        usable = np.ones(n_columns, bool) if problem.allowed is None else np.array(problem.allowed)
        usable[list(problem.banned)] = False
        self.usable = np.flatnonzero(usable)
        n = len(self.usable)
        if selections is None:
            assert n <= 14, "too many selections"
            self.selected = (np.arange(2**n)[:, None] >> np.arange(n)) & 1 > 0
        else:
            assert all(usable[list(views)].all() for views in selections), "a column is not usable"
            self.selected = np.array([np.isin(self.usable, list(views)) for views in selections]).reshape(
                len(selections), n
            )
        self.size = self.selected.sum(axis=1)
        loads = M[:, self.usable]
        available = loads.sum(axis=1)
        self.coverable = available > 0
        demanded = np.asarray(np.minimum(np.asarray(problem.demand, dtype=object), 2**40), dtype=np.int64)
        demand = np.minimum(available, demanded)
        self.satisfied = (self.selected.astype(np.int64) @ loads.T >= demand) & self.coverable
        self.unsatisfiable = self.coverable & (available < np.broadcast_to(demanded, n_rows))
        areas = np.asarray(problem.areas, float)
        weights = areas if problem.weights is None else np.asarray(problem.weights, float)
        self.row_area = areas if problem.max_views is None else weights
        self.area = self.satisfied @ self.row_area
        weights = weights if weights.any() else np.ones(n_rows)  # without areas all rows have equal weight
        self.weight = self.satisfied @ weights
        self.n_groups, self.cost = self._costs()
        self.meets_target = np.ones(len(self.selected), bool)
        if problem.max_views is not None:
            self.meets_target = self.size <= problem.max_views
        else:
            region = np.zeros(n_rows, int) if problem.region is None else np.asarray(problem.region)
            for number, share in enumerate(problem.region_coverage or (problem.coverage,)):
                rows = self.coverable & (region == number)
                uncovered = (rows & ~self.satisfied) @ weights
                missed = (rows & ~self.satisfied).any(axis=1)
                slack = (1 - share) * weights[rows].sum()
                tolerance = TOLERANCE if problem.region_coverage else TOLERANCE / 100
                allowed = uncovered <= slack + tolerance * weights[self.coverable].sum()
                self.meets_target &= ~missed if share == 1 else allowed
        self.is_connected = self._connected(loads > 0)
        pinned = np.isin(self.usable, list(problem.pinned))
        self.is_feasible = self.meets_target & self.is_connected & self.selected[:, pinned].all(axis=1)

    def _costs(self) -> tuple[Ints, Floats]:
        problem = self.problem
        n_columns = np.shape(problem.matrix)[1]
        costs = np.ones(n_columns) if problem.costs is None else np.asarray(problem.costs, float)
        group = np.zeros(n_columns, int) if problem.group is None else np.asarray(problem.group)
        n_groups = int(group.max(initial=0)) + 1
        group_costs = np.zeros(n_groups) if problem.group_costs is None else np.asarray(problem.group_costs, float)
        used = np.stack([self.selected[:, group[self.usable] == g].any(axis=1) for g in range(n_groups)], axis=1)
        return used.sum(axis=1), self.selected @ costs[self.usable] + used @ group_costs[:n_groups]

    def _connected(self, measured: Bools) -> Bools:
        """Return whether the columns of each selection are connected, by growing a component in each selection."""
        overlap, n = self.problem.overlap, len(self.usable)
        if overlap is None:
            return np.ones(len(self.selected), bool)
        areas = np.where(self.coverable, np.asarray(self.problem.areas, float), 0.0)
        shared = measured.T.astype(float) @ (areas[:, None] * measured)
        own = np.diag(shared)
        required = overlap.area if overlap.share is None else overlap.share * np.minimum(own[:, None], own[None, :])
        adjacent = (shared > 0) & (shared >= np.asarray(required) * (1 - TOLERANCE))
        reached = self.selected & (np.cumsum(self.selected, axis=1) == 1)
        for _ in range(n):
            reached |= self.selected & (reached @ adjacent.astype(np.int64) > 0)
        return np.asarray((reached == self.selected).all(axis=1))

    def least(self, values: Floats | Ints) -> float | None:
        """Return the smallest value of a feasible selection; None if none is feasible."""
        return float(values[self.is_feasible].min()) if self.is_feasible.any() else None


def assert_consistent(problem: CoverProblem, cover: Cover, *, is_minimal: bool = True) -> None:
    """Check the statements of a cover on its views, its target, and that no view is redundant."""
    views = cover.views.tolist()
    rest = [[other for other in views if other != view] for view in views]
    this = Selections(problem, [views, *rest, *(views[: k + 1] for k in range(len(views)))])
    n = len(views)
    assert len(set(views)) == n == this.size[0]
    assert cover.pinned.tolist() == sorted(set(problem.pinned))
    assert set(problem.pinned) <= set(views)
    assert np.flatnonzero(~this.coverable).tolist() == cover.uncoverable_rows.tolist()
    assert np.flatnonzero(this.unsatisfiable).tolist() == cover.unsatisfiable_rows.tolist()
    assert cover.demand == min(np.min(problem.demand, initial=2**30), 2**30)
    area = this.row_area
    scale = float(area.sum()) + 1e-300
    assert abs(cover.total_area - area.sum()) <= TOLERANCE * scale
    assert abs(cover.coverable_area - area[this.coverable].sum()) <= TOLERANCE * scale
    assert abs(cover.covered_area - this.area[0]) <= TOLERANCE * scale
    marginal = np.diff(this.area[n + 1 :], prepend=0.0)
    np.testing.assert_allclose(cover.marginal_area, marginal, atol=TOLERANCE * scale)
    if np.max(problem.demand, initial=1) == 1:
        assert (np.diff(cover.marginal_area) <= TOLERANCE * scale).all()
    assert this.meets_target[0]
    if is_minimal and problem.max_views is None and this.is_connected[0]:
        redundant = (this.meets_target & this.is_connected)[1 : n + 1]
        assert not redundant[~np.isin(views, list(problem.pinned))].any()
    has_costs = problem.costs is not None or problem.group is not None
    assert (cover.cost_and_bound is not None) == has_costs
    assert abs(cover.cost - this.cost[0]) <= 1e-12 * this.cost[0]
    assert cover.lower_bound <= n
    assert cover.cost_bound <= cover.cost
    assert cover.gap == (1 - cover.cost_bound / cover.cost if n and cover.cost else 0) or n
    assert cover.covered_area <= cover.upper_area * (1 + TOLERANCE)
    assert cover.max_views == problem.max_views
    if problem.max_views is None:
        assert cover.upper_area == cover.coverable_area
        if cover.status is CoverStatus.PROVEN:
            assert cover.cost_bound >= cover.cost * (1 - COST_TOLERANCE)
            assert has_costs or cover.lower_bound == n
    assert (cover.status is CoverStatus.NOTHING_COVERABLE) == (not this.coverable.any())
    is_certain = cover.sentence.startswith(("optimal for", "proven"))
    assert is_certain == (cover.status is CoverStatus.PROVEN and "complete" not in cover.sentence)


def assert_bounded(selections: Selections, cover: Cover, *, is_optimal: bool) -> None:
    """Check that the bounds of a cover admit the best selection; with `is_optimal`, that the cover equals it."""
    problem = selections.problem
    if problem.max_views is not None:
        best = -(selections.least(-selections.area) or 0.0)
        assert cover.covered_area <= best * (1 + TOLERANCE)
        assert cover.upper_area >= best * (1 - TOLERANCE)
        own = Selections(problem, [cover.views.tolist()]).weight[0]
        as_good = selections.is_feasible & (selections.weight >= own * (1 - TOLERANCE))
        assert cover.lower_bound <= selections.size[as_good].min()
        if is_optimal:
            assert cover.covered_area >= best * (1 - 1e-6)
            assert cover.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE)
        return
    least, fewest = selections.least(selections.cost), selections.least(selections.size)
    if least is None or fewest is None:
        return
    assert cover.lower_bound <= fewest
    assert cover.cost_bound <= least * (1 + 1e-12) + 1e-12
    assert least <= cover.cost * (1 + 1e-12)
    if is_optimal:
        assert cover.cost <= least * (1 + COST_TOLERANCE) + 1e-12
        assert cover.status in (CoverStatus.PROVEN, CoverStatus.NOTHING_COVERABLE)


def _dense(problem: CoverProblem) -> Any:
    matrix: Any = problem.matrix
    M = matrix.toarray() if sp.issparse(matrix) else np.asarray(matrix)
    return M.astype(np.int64) if M.dtype == np.int64 else (M != 0).astype(np.int64)


KINDS = ("cost", "area", "overlap", "regions", "weights")


@st.composite
def cover_problems(
    draw: st.DrawFn, kinds: Sequence[str] = KINDS, max_rows: int = 12, max_columns: int = 8
) -> CoverProblem:
    """Draw a small problem of one of the kinds, with any features that the kind allows."""
    kind = draw(st.sampled_from(kinds))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_rows, n_columns = draw(st.integers(0, max_rows)), draw(st.integers(0, max_columns))
    if kind == "overlap":  # windows on a strip: their overlap graphs are of all kinds
        start, width = rng.integers(0, max(n_rows, 1), n_columns), rng.integers(1, max(2, n_rows // 2 + 1), n_columns)
        rows = np.arange(n_rows)[:, None]
        M: Any = (rows >= start) & (rows < start + width)
    else:
        M = rng.random((n_rows, n_columns)) < rng.uniform(0.1, 0.6)
    if draw(st.booleans()) and kind != "overlap":
        M = rng.integers(1, 5, M.shape) * M
    areas = draw(
        st.sampled_from([rng.integers(1, 5, n_rows).astype(float), rng.lognormal(0, 2, n_rows), np.zeros(n_rows)])
    )
    demand = draw(st.sampled_from([1, 1, 2, 3, rng.integers(1, 5, n_rows)]))
    roles = rng.permutation(n_columns)
    n_pinned, n_banned = draw(st.integers(0, min(2, n_columns))), draw(st.integers(0, 1))
    pinned, banned = roles[:n_pinned].tolist(), roles[n_pinned : n_pinned + n_banned].tolist()
    allowed = rng.random(n_columns) < 0.85 if draw(st.booleans()) else None
    if allowed is not None:
        allowed[pinned] = True
    options: dict[str, Any] = {"coverage": draw(st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.0]))}
    if kind != "area":
        whole = rng.integers(1, 9, n_columns).astype(float)
        options["costs"] = draw(st.sampled_from([None, whole, rng.uniform(1, 9, n_columns)]))
    if kind == "cost" and draw(st.booleans()):
        options |= {"group": rng.integers(0, 3, n_columns), "group_costs": rng.integers(0, 4, 3).astype(float)}
    if kind == "area":
        options = {"max_views": draw(st.integers(n_pinned, n_columns + 1))}
    if kind == "overlap":
        demand, shares = 1, [Overlap(area=2.0), Overlap(share=0.4), Overlap(share=1.0)]
        options["overlap"] = draw(st.sampled_from(shares))
    if kind == "regions":
        areas = np.maximum(areas, 0.5)
        options["region"] = rng.integers(0, 3, n_rows)
        options["region_coverage"] = tuple(rng.choice([0.3, 0.7, 1.0], 3).tolist())
    if kind == "weights" or (kind in ("area", "regions") and draw(st.booleans())):
        options["weights"] = rng.choice([0.1, 1.0, 10.0], n_rows)
    return CoverProblem(M, areas, allowed=allowed, demand=demand, pinned=pinned, banned=banned, **options)


def as_sparse(problem: CoverProblem) -> Any:
    """Return the matrix of a problem in compressed columns."""
    return sp.csc_array(problem.matrix)
