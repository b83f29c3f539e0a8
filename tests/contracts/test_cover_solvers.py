"""What every solver of the cover problem promises."""

import numpy as np
import pytest
import scipy.sparse as sp

from planner.cover import SOLVERS, CoverProblem, CoverStatus, solve
from planner.cover.answer import COST_TOLERANCE
from planner.cover.budget import Budget

WORK = 100_000_000
COVERAGES = (0.0, 0.3, 0.8, 0.95, 1.0)


def instance(seed, n_rows=60, n_columns=40, density=0.1):
    """A random matrix and log-normal areas."""
    rng = np.random.default_rng(seed)
    return rng.random((n_rows, n_columns)) < density, rng.lognormal(0, 1, n_rows)


def run(M, areas, solver, coverage=1.0, seed=5, **options):
    """Solve with a fresh generator and the tests' budget; options go to the problem or to `solve`."""
    told = {name: options.pop(name) for name in ("effort_budget", "time_limit_s", "clock", "start") if name in options}
    problem = CoverProblem(M, areas, coverage=coverage, **options)
    return solve(problem, rng=np.random.default_rng(seed), solver=solver, **{"effort_budget": WORK} | told)


def covered_share(M, areas, views, multiplicity=1):
    """Area that the views cover as often as demanded (or as all columns can), over what all columns cover."""
    demand = np.minimum(M.sum(axis=1), multiplicity)
    satisfied = (M[:, views].sum(axis=1) >= demand) & (demand > 0)
    return areas[satisfied].sum() / areas[demand > 0].sum()


@pytest.fixture(params=list(SOLVERS))
def solver(request):
    """Each solver by name."""
    return request.param


@pytest.mark.parametrize("coverage", COVERAGES)
@pytest.mark.parametrize("seed", range(3))
def test_covers_the_target_and_needs_every_view(solver, coverage, seed):
    """The chosen views reach the share asked for, and without any one of them they would not."""
    M, areas = instance(seed)
    result = run(M, areas, solver, coverage)
    if coverage == 1.0:
        coverable = M.any(axis=1)
        assert (M[:, result.views].any(axis=1) == coverable).all()
        for view in result.views:
            assert (M[:, np.setdiff1d(result.views, view)].any(axis=1) != coverable).any()
    else:
        assert covered_share(M, areas, result.views) >= coverage - 1e-12
        for view in result.views:
            assert covered_share(M, areas, np.setdiff1d(result.views, view)) < coverage


@pytest.mark.parametrize("coverage", [0.5, 0.9, 1.0])
@pytest.mark.parametrize("multiplicity", [2, 3])
def test_covers_several_times_and_needs_every_view(solver, coverage, multiplicity):
    """The rows that count are covered k times, or by all their columns; without any one view the target is missed."""
    M, areas = instance(1)
    result = run(M, areas, solver, coverage, demand=multiplicity)
    assert covered_share(M, areas, result.views, multiplicity) >= coverage - 1e-12
    for view in result.views:
        rest = np.setdiff1d(result.views, view)
        assert covered_share(M, areas, rest, multiplicity) < coverage - (1e-12 if coverage == 1.0 else 0.0)
    per_row = M.sum(axis=1)
    np.testing.assert_array_equal(result.unsatisfiable_rows, np.flatnonzero((per_row > 0) & (per_row < multiplicity)))
    assert result.demand == multiplicity
    assert result.lower_bound <= len(result.views)


@pytest.mark.parametrize("multiplicity", [1, 2])
@pytest.mark.parametrize("coverage", [0.8, 1.0])
def test_costs_add_up_and_bound_the_cheapest(solver, coverage, multiplicity):
    """Cost is that of the views, the bound is not above it, and proven means that they are equal but for rounding."""
    M, areas = instance(6)
    costs = np.random.default_rng(3).uniform(2.0, 9.0, M.shape[1])
    result = run(M, areas, solver, coverage, costs=costs, demand=multiplicity)
    assert covered_share(M, areas, result.views, multiplicity) >= coverage - 1e-12
    assert result.cost == pytest.approx(costs[result.views].sum(), rel=1e-12)
    assert 0 < result.cost_bound <= result.cost
    assert result.gap == pytest.approx(1 - result.cost_bound / result.cost)
    assert (result.status is CoverStatus.PROVEN) == (result.cost_bound >= result.cost * (1 - COST_TOLERANCE))
    assert "cheapest" in result.sentence
    assert result.lower_bound <= len(result.views)
    for view in result.views:
        assert covered_share(M, areas, np.setdiff1d(result.views, view), multiplicity) < coverage


def test_equal_costs_choose_as_no_costs_do(solver):
    """12.5 s for each view is a unit of its own: the same views, 12.5 times the cost."""
    M, areas = instance(9)
    plain, priced = run(M, areas, solver), run(M, areas, solver, costs=np.full(M.shape[1], 12.5))
    np.testing.assert_array_equal(plain.views, priced.views)
    assert priced.cost == 12.5 * len(plain.views)
    assert (priced.cost_bound, priced.lower_bound) == (12.5 * plain.lower_bound, plain.lower_bound)


def test_a_dear_column_is_avoided(solver):
    """Of two ways to cover all, one column or two, the cheaper is taken, whichever it is."""
    M = np.array([[1, 1, 0], [1, 0, 1]], dtype=bool)
    areas = np.ones(2)
    assert sorted(run(M, areas, solver, costs=[5.0, 2.0, 2.0]).views) == [1, 2]
    assert sorted(run(M, areas, solver, costs=[3.0, 2.0, 2.0]).views) == [0]


@pytest.mark.parametrize("coverage", COVERAGES)
def test_bound_is_not_above_the_plan(solver, coverage):
    """lower_bound <= views; the status says proven exactly when they are equal, and gap and sentence agree."""
    for seed in range(4):
        M, areas = instance(seed)
        result = run(M, areas, solver, coverage)
        assert 0 <= result.lower_bound <= len(result.views)
        assert (result.status is CoverStatus.PROVEN) == (result.lower_bound == len(result.views))
        assert result.gap == pytest.approx(
            1 - result.lower_bound / max(len(result.views), 1) if len(result.views) else 0
        )
        if result.excess_views:
            assert f"at most {result.excess_views} view" in result.sentence


@pytest.mark.parametrize("coverage", [0.9, 1.0])
def test_same_seed_same_plan(solver, coverage):
    """Two runs with the same seed and budget agree in every field; work is counted, not timed."""
    M, areas = instance(8)
    first, second = (run(M, areas, solver, coverage) for _ in range(2))
    np.testing.assert_array_equal(first.views, second.views)
    assert (first.lower_bound, first.effort, first.status) == (second.lower_bound, second.effort, second.status)


@pytest.mark.parametrize("coverage", [0.9, 1.0])
def test_permuting_columns_changes_nothing_but_indices(solver, coverage):
    """The plan of the permuted matrix consists of the same sets of rows, in the same order."""
    rng = np.random.default_rng(0)
    M = rng.random((50, 30)) < 0.15
    areas = np.ones(50)  # equal areas make many ties
    order = rng.permutation(30)
    plain = run(M, areas, solver, coverage)
    permuted = run(M[:, order], areas, solver, coverage)
    assert len(plain.views) > 3
    np.testing.assert_array_equal(M[:, plain.views], M[:, order][:, permuted.views])


def test_views_are_ordered_by_what_they_add(solver):
    """Marginal areas fall, add up to the covered area, and each is what the view adds to those before it."""
    M, areas = instance(3)
    result = run(M, areas, solver)
    seen = np.zeros(len(areas), dtype=bool)
    for view, marginal in zip(result.views, result.marginal_area, strict=True):
        assert marginal == pytest.approx(areas[M[:, view] & ~seen].sum())
        seen |= M[:, view]
    assert (np.diff(result.marginal_area) <= 1e-12).all()
    assert result.marginal_area.sum() == pytest.approx(result.covered_area) == pytest.approx(areas[seen].sum())
    assert result.coverable_area == pytest.approx(areas[M.any(axis=1)].sum())
    assert result.total_area == pytest.approx(areas.sum())


@pytest.mark.parametrize("coverage", [0.6, 1.0])
def test_allowed_pinned_and_banned_are_respected(solver, coverage):
    """Only allowed and not banned columns are used, all pinned ones are, and the target refers to what is usable."""
    M, areas = instance(11)
    allowed = np.random.default_rng(1).random(M.shape[1]) < 0.7
    pinned, banned = np.flatnonzero(allowed)[[3, 9, 3]], np.flatnonzero(allowed)[[0, 5]]
    result = run(M, areas, solver, coverage, allowed=allowed, pinned=pinned, banned=banned)
    usable = allowed.copy()
    usable[banned] = False
    assert usable[result.views].all()
    assert set(pinned) <= set(result.views.tolist())
    assert len(set(result.views.tolist())) == len(result.views)
    assert covered_share(M[:, usable], areas, np.searchsorted(np.flatnonzero(usable), result.views)) >= coverage - 1e-12
    np.testing.assert_array_equal(result.uncoverable_rows, np.flatnonzero(~M[:, usable].any(axis=1)))
    for view in np.setdiff1d(result.views, pinned):
        rest = np.setdiff1d(result.views, view)
        assert covered_share(M[:, usable], areas, np.searchsorted(np.flatnonzero(usable), rest)) < coverage


def test_sparse_and_dense_input_agree(solver):
    """csr, csc, coo and dense matrices give the same plan."""
    M, areas = instance(2)
    plans = [run(form(M), areas, solver).views for form in (np.asarray, sp.csr_array, sp.csc_matrix, sp.coo_array)]
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan, plans[0])


def test_clock_guard_stops_the_search_and_says_so(solver):
    """A guard that has run out at once still gives a cover and a bound; a search that was cut says so."""
    M, areas = instance(4, 300, 200, 0.05)
    ticks = iter(np.arange(0, 1e6, 0.5))
    result = run(M, areas, solver, time_limit_s=0.0, clock=lambda: float(next(ticks)), effort_budget=10**12)
    assert (M[:, result.views].any(axis=1) == M.any(axis=1)).all()
    assert result.status is CoverStatus.TIME_LIMITED
    assert "time limit" in result.sentence
    assert 1 <= result.lower_bound < len(result.views)


@pytest.mark.parametrize("solver", ["meta-raps", "local-search", "auto"])
def test_ctrl_c_returns_the_best_cover_so_far(solver, monkeypatch):
    """`solve` ends with a cover, a bound, and a status that says that it was interrupted."""
    M, areas = instance(4, 300, 200, 0.05)
    calls = []
    spend = Budget.spend

    def interrupted(self, work):
        calls.append(work)
        if len(calls) > 40:
            raise KeyboardInterrupt
        return spend(self, work)

    monkeypatch.setattr(Budget, "spend", interrupted)
    monkeypatch.setattr("planner.cover.search.CHUNK_EFFORT", 10_000)
    result = run(M, areas, solver, effort_budget=10**12)
    assert (M[:, result.views].any(axis=1) == M.any(axis=1)).all()
    assert result.status is CoverStatus.INTERRUPTED
    assert "interrupted" in result.sentence
    assert 1 <= result.lower_bound < len(result.views)


def test_a_kill_is_not_taken_for_a_wish_for_the_best_so_far(monkeypatch):
    """Only Ctrl-C itself ends a search with its result; what is derived from it goes on to the caller."""

    class Killed(KeyboardInterrupt):
        pass

    def killed(job):
        raise Killed

    monkeypatch.setitem(SOLVERS, "local-search", killed)
    M, areas = instance(4, 150, 100, 0.05)
    with pytest.raises(Killed):
        run(M, areas, "local-search")


@pytest.mark.parametrize("coverage", [0.5, 0.9, 1.0])
@pytest.mark.parametrize("seed", range(2))
def test_a_search_that_begins_with_a_choice_is_no_worse(solver, coverage, seed):
    """Whether the choice is a cover or not; what may not be used is left out; a best one stays as it is."""
    M, areas = instance(seed)
    best = run(M, areas, "exact", coverage, effort_budget=10 * WORK)
    again = run(M, areas, solver, coverage, start=best.views)
    np.testing.assert_array_equal(np.sort(again.views), np.sort(best.views))
    for start in (best.views[:1], np.arange(M.shape[1]), np.zeros(0, dtype=np.int64)):
        result = run(M, areas, solver, coverage, start=start, banned=[int(best.views[0])])
        assert best.views[0] not in result.views
        usable = M.copy()
        usable[:, best.views[0]] = False
        assert covered_share(usable, areas, result.views) >= coverage - 1e-12


def test_a_beginning_of_more_views_than_are_allowed_is_cut(solver):
    """With a number of columns."""
    M, areas = instance(1)
    assert len(run(M, areas, solver, max_views=3, start=np.arange(10)).views) <= 3
