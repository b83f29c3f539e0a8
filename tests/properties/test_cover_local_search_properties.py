"""The choice that the local search moves: its running numbers against numbers computed from scratch."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.cover import CoverProblem
from planner.cover import search as search_kernels
from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.reductions import canonical_form
from planner.cover.search import LocalSearch, greedy
from planner.cover.solvers import SolverTask


@st.composite
def moves(draw):
    """A problem with loads or demands, costs, groups and areas, and columns to be moved in or out in turn."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    M = rng.random((draw(st.integers(1, 25)), draw(st.integers(1, 15)))) < draw(st.floats(0.1, 0.6))
    M[0, 0] = True
    loads = rng.integers(1, 5, M.shape) * M if draw(st.booleans()) else M
    sets = canonical_form(
        CoverProblem(
            loads,
            rng.lognormal(0, 1, len(M)),
            coverage=draw(st.sampled_from([0.7, 1.0])),
            demand=draw(st.integers(1, 6)),
            costs=rng.integers(1, 9, M.shape[1]).astype(float),
            group=rng.integers(0, 3, M.shape[1]),
            group_costs=np.array([0.0, 3.0, 5.0]),
        )
    ).reduced
    return sets, rng.integers(0, sets.n_columns, draw(st.integers(0, 40)))


@given(moves(), st.integers(0, 1000))
def test_running_numbers_are_those_computed_from_scratch(case, seed):
    """Losses, gains, loads, members, open rows, cost and missing area after any sequence of moves."""
    sets, columns = case
    search = LocalSearch(sets, np.zeros(0, dtype=np.int64), np.random.default_rng(seed))
    state, numbers = search._state, search._state.numbers
    state.rows[search_kernels.FIRST_WEIGHT] = np.random.default_rng(seed).integers(1, 100, sets.n_rows)
    search._restart(np.zeros(0, dtype=np.int64))
    chosen: set[int] = set()
    for column in columns.tolist():
        search_kernels.move(state, column, -1 if column in chosen else 1)
        chosen ^= {column}
    loads = sets.matrix().toarray()
    inside = np.isin(np.arange(sets.n_columns), list(chosen))
    total = loads[:, inside].sum(axis=1)
    deficit = np.maximum(sets.demand - total, 0)
    other = np.maximum(sets.demand - total + np.where(inside[:, None], loads.T, -loads.T), 0)
    weights = state.rows[search_kernels.WEIGHT]
    worth = np.abs(other - deficit) @ weights
    if sets.has_unit_demand:
        np.testing.assert_array_equal(state.columns[search_kernels.LOSS, inside], worth[inside])
    np.testing.assert_array_equal(state.rows[search_kernels.OPEN_WEIGHT], weights * (deficit > 0))
    empty = np.array([not inside[sets.group == g].any() for g in range(3)])
    alone = np.array([inside[sets.group == g].sum() == 1 for g in range(3)])
    rate = worth / (sets.costs + sets.group_costs[sets.group] * np.where(inside, alone[sets.group], empty[sets.group]))
    if inside.any():
        out = search_kernels.select_leaving(state, -1, 0, 0)
        assert rate[out] == pytest.approx(rate[inside].min())
    if not inside.all():
        come = search_kernels.select_entering(state, np.int64(-1), -1, 0, 0, sets.n_columns)
        assert rate[come] == pytest.approx(rate[~inside].max())
    np.testing.assert_array_equal(state.rows[search_kernels.LOAD], total)
    assert set(state.columns[search_kernels.MEMBER, : numbers[search_kernels.MEMBERS]].tolist()) == chosen
    open_rows = state.rows[search_kernels.OPEN_ROW, : numbers[search_kernels.OPEN]]
    assert sorted(open_rows.tolist()) == np.flatnonzero(deficit).tolist()
    assert numbers[search_kernels.SPENT] == sets.cost(sorted(chosen))
    assert numbers[search_kernels.MISSING] == int(sets.units[deficit > 0].sum())


def test_draws_are_even_and_in_range():
    """Ten thousand draws of seven numbers: none outside, each about as often as the others."""
    sets = canonical_form(CoverProblem(np.eye(2, dtype=bool), np.ones(2))).reduced
    state = LocalSearch(sets, np.zeros(0, dtype=np.int64), np.random.default_rng(0))._state
    drawn = np.bincount([search_kernels.draw(state.random, 7) for _ in range(10_000)], minlength=7)
    assert len(drawn) == 7
    assert abs(drawn - 10_000 / 7).max() < 5 * np.sqrt(10_000 / 7)


@pytest.mark.parametrize("seed", [11, 25, 56, 113])
def test_a_core_that_begins_with_the_best_choice_ends_its_search(seed):
    """Columns that a better choice may contain, completed, meet the bound at times: nothing to search."""
    rng = np.random.default_rng(seed)
    M = rng.random((40, 50)) < 0.08
    M[np.arange(40), rng.integers(0, 50, 40)] = True
    sets = canonical_form(CoverProblem(M, np.ones(40), costs=rng.integers(1, 20, 50).astype(float))).residual
    budget = Budget(10**9)
    first, _ = greedy(sets)
    budget.offer(first, sets.objective(first))
    relaxation = Relaxation(sets)
    raise_bound(relaxation, budget.objective, budget)
    search = SolverTask(sets, rng, budget, relaxation).core_search()
    assert sets.is_feasible(budget.incumbent)
    assert budget.lower_bound == budget.objective == sets.objective(budget.incumbent) < sets.objective(first)
    search.run(budget)
