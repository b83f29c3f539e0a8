"""Cover problems of any shape: what must hold for all of them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import planner.cover.problem as problem_module
from planner.cover import CoverProblem, reductions, solve
from planner.cover.bounds import Relaxation
from planner.cover.budget import Budget
from planner.cover.problem import gather_slices, reduce_slices, set_hash
from planner.cover.reductions import canonical_form, reduce
from planner.cover.search import order_by_marginal_area, prune

matrices = hnp.arrays(bool, st.tuples(st.integers(0, 12), st.integers(0, 9)))


@st.composite
def problems(draw):
    """A matrix, areas and a target."""
    M = draw(matrices)
    areas = draw(hnp.arrays(float, M.shape[0], elements=st.floats(0, 1e6)))
    return M, areas, draw(st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]))


@given(problems(), st.sampled_from(["auto", "greedy", "meta-raps", "local-search"]), st.integers(0, 3))
def test_every_claimed_cover_covers(problem, solver, seed):
    """Whatever the matrix, areas and target: the target is met and the bound is not above the plan."""
    M, areas, coverage = problem
    asked = CoverProblem(M, areas, coverage=coverage)
    result = solve(asked, rng=np.random.default_rng(seed), solver=solver, effort_budget=300_000)
    covered, coverable = M[:, result.views].any(axis=1), M.any(axis=1)
    if coverage == 1.0:
        assert (covered == coverable).all()
    else:
        assert areas[covered].sum() >= coverage * areas[coverable].sum() * (1 - 1e-11)
    assert result.lower_bound <= len(result.views)


@given(problems(), st.data())
def test_any_multipliers_give_a_bound_below_any_cover(problem, data):
    """L(u) <= columns of every cover, for arbitrary u >= 0, full and partial."""
    M, areas, coverage = problem
    sets = canonical_form(CoverProblem(M, areas, coverage=coverage)).reduced
    if sets.needs_no_column:
        return
    bound = Relaxation(sets)
    bound.evaluate(data.draw(hnp.arrays(float, sets.n_rows, elements=st.floats(0, 3))))
    assert bound.bound <= len(prune(sets, np.arange(sets.n_columns)))


@given(problems())
def test_pruned_covers_are_covers_without_a_redundant_column(problem):
    """Pruning all columns leaves a cover of which no column can go."""
    M, areas, coverage = problem
    sets = canonical_form(CoverProblem(M, areas, coverage=coverage)).reduced
    cover = prune(sets, np.arange(sets.n_columns))
    assert sets.is_feasible(cover)
    for column in cover:
        assert not sets.is_feasible(np.setdiff1d(cover, column))


@given(problems())
def test_the_canonical_problem_is_the_matrix(problem):
    """Rows and columns of the canonical problem, mapped back, are the matrix without its empty rows and columns."""
    M, areas, coverage = problem
    found = canonical_form(CoverProblem(M, areas, coverage=coverage))
    again = np.zeros(M.shape, dtype=bool)
    again[np.ix_(found.rows, found.columns)] = found.reduced.matrix().toarray() > 0
    np.testing.assert_array_equal(again, M)
    np.testing.assert_array_equal(found.uncoverable_rows, np.flatnonzero(~M.any(axis=1)))
    assert (found.reduced.units >= 1).all()
    assert found.reduced.units.sum() < 2**53


@given(problems())
def test_reduced_problems_cannot_be_reduced_and_lift_to_covers(problem):
    """No dominated column is left, no dominated row at full cover, and all reduced columns together lift to a cover."""
    M, areas, coverage = problem
    sets = canonical_form(CoverProblem(M, areas, coverage=coverage)).reduced
    reduction = reduce(sets, Budget(10**9))
    rest = reduction.instance
    lifted = reduction.lift(np.arange(rest.n_columns) if not rest.needs_no_column else np.zeros(0, dtype=np.int64))
    assert sets.is_feasible(lifted)
    if rest.needs_no_column:
        return
    dense = rest.matrix().toarray() > 0
    for i in range(rest.n_columns):
        for j in range(rest.n_columns):
            assert i == j or not (dense[:, i] <= dense[:, j]).all()
    if rest.full:
        for i in range(rest.n_rows):
            for k in range(rest.n_rows):
                assert i == k or not (dense[i] <= dense[k]).all()


@given(st.lists(st.lists(st.integers(0, 99)), min_size=1, max_size=30), st.data())
def test_gather_concatenates_slices(slices, data):
    """Against plain Python concatenation, below and above the size at which the method changes."""
    start = np.cumsum([0] + [len(s) for s in slices])
    items = np.array([x for s in slices for x in s], dtype=np.int64)
    which = np.array(data.draw(st.lists(st.integers(0, len(slices) - 1), max_size=40)), dtype=np.int64)
    joined, lengths = gather_slices(start, items, which)
    assert joined.tolist() == [x for w in which for x in slices[w]]
    assert lengths.tolist() == [len(slices[w]) for w in which]


@given(st.lists(st.integers(0, 10**6), unique=True, max_size=20), st.randoms())
def test_set_hash_ignores_order_and_sees_members(members, random):
    """Equal sets hash alike; adding a member changes the hash."""
    shuffled = members.copy()
    random.shuffle(shuffled)
    extended = [*members, 10**6 + 1]
    items = np.array(members + shuffled + extended, dtype=np.int64)
    start = np.cumsum([0, len(members), len(shuffled), len(extended)])
    a, b, c = set_hash(start, items)
    assert a == b != c


@given(problems())
def test_marginal_order_keeps_the_columns_and_their_rows(problem):
    """Ordering by marginal area is a permutation whose marginal rows partition what the columns cover."""
    M, areas, _ = problem
    sets = canonical_form(CoverProblem(M, areas)).reduced
    order, added = order_by_marginal_area(sets, np.arange(sets.n_columns))
    assert sorted(order.tolist()) == list(range(sets.n_columns))
    together = np.concatenate(added) if added else np.zeros(0, dtype=np.int64)
    assert sorted(together.tolist()) == list(range(sets.n_rows))
    gains = [sets.units[rows].sum() for rows in added]
    assert all(first >= second for first, second in pairwise(gains))


@given(st.lists(st.lists(st.integers(0, 50), max_size=6), max_size=9), st.integers(1, 5))
def test_what_slices_come_to_does_not_depend_on_how_many_are_looked_at_together(slices, block):
    """Sum, least and most of each slice, 0 of an empty one, for blocks of any length."""
    start = np.cumsum([0, *map(len, slices)])
    items, worth = np.array([i for some in slices for i in some], dtype=np.int64), np.arange(51) ** 2 + 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem_module, "_SLICE_BLOCK", block)
        for ufunc, of in ((np.add, sum), (np.minimum, min), (np.maximum, max)):
            expected = [of(int(worth[i]) for i in some) if some else 0 for some in slices]
            assert reduce_slices(ufunc, start, items, worth.__getitem__).tolist() == expected


def test_rows_are_merged_by_their_columns_and_not_by_their_hash(monkeypatch):
    """With one hash for all: rows of as many columns stay apart where these differ, in blocks of any length."""
    M = np.array([[1, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [0, 1, 0, 1], [0, 1, 0, 1]], dtype=bool)
    sets = canonical_form(CoverProblem(M, np.array([16.0, 8.0, 4.0, 2.0, 1.0]))).reduced
    monkeypatch.setattr(reductions, "set_hash", lambda start, items: np.zeros(len(start) - 1, dtype=np.uint64))
    for block in (1, 3, 100_000):
        monkeypatch.setattr(problem_module, "_SLICE_BLOCK", block)
        merged = reductions._merge_rows(sets)
        assert merged.n_rows == 3
        assert sorted(merged.units / merged.units.min()) == pytest.approx([1.0, 4 / 3, 8.0])
