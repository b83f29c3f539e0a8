"""Parts of the cover solver on problems of any shape: canonical form, reductions, slices, numbers of a search."""

from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.cover import CoverProblem, problem, reductions, search
from planner.cover.bounds import Relaxation, raise_bound
from planner.cover.budget import Budget
from planner.cover.problem import CoverInstance, gather_slices, reduce_slices, set_hash
from planner.cover.reductions import canonical_form, reduce
from planner.cover.search import LocalSearch, greedy
from planner.cover.solvers import SolverTask
from planner.values import Ints
from tests.support.cover_oracle import cover_problems

SLICES = st.lists(st.lists(st.integers(0, 50), max_size=6), min_size=1, max_size=30)


@given(cover_problems(("cost",)))
def test_the_canonical_problem_is_the_matrix(stated: CoverProblem) -> None:
    """Rows and columns, mapped back, are the usable matrix with loads limited to the demand."""
    form = canonical_form(stated)
    M = np.array(stated.matrix, dtype=np.int64)
    usable = np.ones(M.shape[1], bool) if stated.allowed is None else np.array(stated.allowed)
    usable[list(stated.banned)] = False
    M[:, ~usable] = 0
    demand = np.minimum(M.sum(axis=1), stated.demand)
    back = np.zeros_like(M)
    back[np.ix_(form.rows, form.columns)] = form.reduced.matrix().toarray()
    np.testing.assert_array_equal(back, np.minimum(M, demand[:, None]))
    np.testing.assert_array_equal(form.reduced.demand, demand[form.rows])
    np.testing.assert_array_equal(form.uncoverable_rows, np.flatnonzero(demand == 0))
    assert (form.reduced.units >= 1).all()
    assert form.reduced.total_units < 2**53


@given(cover_problems(("cost",)))
def test_reduced_problems_cannot_be_reduced(stated: CoverProblem) -> None:
    """No dominated column is left, no dominated row at full cover, and all columns together lift to a cover."""
    stated = CoverProblem(np.asarray(stated.matrix) > 0, stated.areas, coverage=stated.coverage)
    instance = canonical_form(stated).reduced
    reduction = reduce(instance, Budget(10**9))
    rest = reduction.instance
    every = np.arange(0 if rest.needs_no_column else rest.n_columns)
    assert instance.is_feasible(reduction.lift(every))
    dense = rest.matrix().toarray() > 0
    inside = (dense[:, :, None] <= dense[:, None, :]).all(axis=0)
    assert rest.needs_no_column or not (inside & ~np.eye(rest.n_columns, dtype=bool)).any()
    inside = (dense[:, None, :] <= dense[None, :, :]).all(axis=2)
    assert rest.needs_no_column or not rest.full or not (inside & ~np.eye(rest.n_rows, dtype=bool)).any()


def test_rows_are_merged_by_their_columns_and_not_by_their_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    """With one hash for all, rows with different columns stay apart, in blocks of any length."""
    M = np.array([[1, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [0, 1, 0, 1], [0, 1, 0, 1]], dtype=bool)
    instance = canonical_form(CoverProblem(M, np.array([16.0, 8.0, 4.0, 2.0, 1.0]))).reduced
    monkeypatch.setattr(reductions, "set_hash", lambda start, items: np.zeros(len(start) - 1, dtype=np.uint64))
    for block in (1, 3, 100_000):
        monkeypatch.setattr(problem, "_SLICE_BLOCK", block)
        merged = reductions._merge_rows(instance)
        assert merged.n_rows == 3
        assert sorted(merged.units / merged.units.min()) == pytest.approx([1.0, 4 / 3, 8.0])


@given(SLICES, st.data(), st.integers(1, 5))
def test_slices_are_gathered_and_reduced_like_lists(slices: list[list[int]], data: st.DataObject, block: int) -> None:
    """Concatenation, and sum, minimum and maximum (0 of an empty slice), for any number of slices and block length."""
    start = np.cumsum([0, *map(len, slices)])
    items = np.array([i for some in slices for i in some], dtype=np.int64)
    which = np.array(data.draw(st.lists(st.integers(0, len(slices) - 1), max_size=40)), dtype=np.int64)
    gathered, lengths = gather_slices(start, items, which)
    assert gathered.tolist() == [x for w in which for x in slices[w]]
    assert lengths.tolist() == [len(slices[w]) for w in which]
    values = np.arange(51) ** 2 + 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem, "_SLICE_BLOCK", block)
        for ufunc, of in ((np.add, sum), (np.minimum, min), (np.maximum, max)):
            expected = [of(int(values[i]) for i in some) if some else 0 for some in slices]
            assert reduce_slices(ufunc, start, items, values.__getitem__).tolist() == expected


@given(st.lists(st.integers(0, 10**6), unique=True, max_size=20), st.randoms())
def test_set_hash_ignores_order_and_sees_members(members: list[int], random: Random) -> None:
    """Equal sets have equal hashes, and another member changes the hash."""
    shuffled = members.copy()
    random.shuffle(shuffled)
    extended = [*members, 10**6 + 1]
    start = np.cumsum([0, len(members), len(shuffled), len(extended)])
    a, b, c = set_hash(start, np.array(members + shuffled + extended, dtype=np.int64))
    assert a == b != c


@st.composite
def moves(draw: st.DrawFn) -> tuple[CoverInstance, Ints]:
    """Return a problem with loads or demands, costs, groups and areas, and columns to move in or out in turn."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    M = rng.random((draw(st.integers(1, 25)), draw(st.integers(1, 15)))) < draw(st.floats(0.1, 0.6))
    M[0, 0] = True
    stated = CoverProblem(
        rng.integers(1, 5, M.shape) * M if draw(st.booleans()) else M,
        rng.lognormal(0, 1, len(M)),
        coverage=draw(st.sampled_from([0.7, 1.0])),
        demand=draw(st.sampled_from([1, 1, 2, 6])),
        costs=rng.integers(1, 9, M.shape[1]).astype(float),
        group=rng.integers(0, 3, M.shape[1]),
        group_costs=np.array([0.0, 3.0, 5.0]),
    )
    instance = canonical_form(stated).reduced
    return instance, rng.integers(0, instance.n_columns, draw(st.integers(0, 40)))


@given(moves(), st.integers(0, 1000))
def test_running_numbers_of_a_search_equal_those_computed_from_scratch(
    case: tuple[CoverInstance, Ints], seed: int
) -> None:
    """Losses, gains, loads, members, uncovered rows, cost and missing area after any sequence of moves."""
    instance, columns = case
    local = LocalSearch(instance, np.zeros(0, dtype=np.int64), np.random.default_rng(seed))
    state, numbers = local._state, local._state.numbers
    state.rows[search.FIRST_WEIGHT] = np.random.default_rng(seed).integers(1, 100, instance.n_rows)
    local._restart(np.zeros(0, dtype=np.int64))
    selected: set[int] = set()
    for column in columns.tolist():
        search.move(state, column, -1 if column in selected else 1)
        selected ^= {column}
    loads = instance.matrix().toarray()
    inside = np.isin(np.arange(instance.n_columns), list(selected))
    total = loads[:, inside].sum(axis=1)
    deficit = np.maximum(instance.demand - total, 0)
    other = np.maximum(instance.demand - total + np.where(inside[:, None], loads.T, -loads.T), 0)
    weights = state.rows[search.WEIGHT]
    change = np.abs(other - deficit) @ weights
    if instance.has_unit_demand:
        np.testing.assert_array_equal(state.columns[search.LOSS, inside], change[inside])
    np.testing.assert_array_equal(state.rows[search.OPEN_WEIGHT], weights * (deficit > 0))
    in_group = np.array([inside[instance.group == g].sum() for g in range(3)])
    pays_group = in_group[instance.group] == inside  # the only one of its group, or the first
    rate = change / (instance.costs + instance.group_costs[instance.group] * pays_group)
    if inside.any():
        out = search.select_leaving(state, -1, 0, 0)
        assert rate[out] == pytest.approx(rate[inside].min())
    if not inside.all():
        come = search.select_entering(state, np.int64(-1), -1, 0, 0, instance.n_columns)
        assert rate[come] == pytest.approx(rate[~inside].max())
    np.testing.assert_array_equal(state.rows[search.LOAD], total)
    assert set(state.columns[search.MEMBER, : numbers[search.MEMBERS]].tolist()) == selected
    uncovered = state.rows[search.OPEN_ROW, : numbers[search.OPEN]]
    assert sorted(uncovered.tolist()) == np.flatnonzero(deficit).tolist()
    assert numbers[search.TOTAL_COST] == instance.cost(sorted(selected))
    assert numbers[search.MISSING] == int(instance.units[deficit > 0].sum())


def test_draws_are_even_and_in_range() -> None:
    """In ten thousand draws of seven numbers none is out of range, and all are about equally frequent."""
    instance = canonical_form(CoverProblem(np.eye(2, dtype=bool), np.ones(2))).reduced
    state = LocalSearch(instance, np.zeros(0, dtype=np.int64), np.random.default_rng(0))._state
    counts = np.bincount([search.draw(state.random, 7) for _ in range(10_000)], minlength=7)
    assert len(counts) == 7
    assert abs(counts - 10_000 / 7).max() < 5 * np.sqrt(10_000 / 7)


@pytest.mark.parametrize("seed", [113])
def test_a_core_that_starts_at_the_optimum_ends_its_search(seed: int) -> None:
    """A core whose completed columns meet the bound needs no search."""
    rng = np.random.default_rng(seed)
    M = rng.random((40, 50)) < 0.08
    M[np.arange(40), rng.integers(0, 50, 40)] = True
    instance = canonical_form(CoverProblem(M, np.ones(40), costs=rng.integers(1, 20, 50).astype(float))).residual
    budget = Budget(10**9)
    first, _ = greedy(instance)
    budget.offer(first, instance.objective(first))
    relaxation = Relaxation(instance)
    raise_bound(relaxation, budget.objective, budget)
    local = SolverTask(instance, rng, budget, relaxation).core_search()
    assert budget.incumbent is not None
    assert instance.is_feasible(budget.incumbent)
    assert budget.lower_bound == budget.objective == instance.objective(budget.incumbent) < instance.objective(first)
    local.run(budget)
