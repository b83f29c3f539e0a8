"""The moving cover of the local search: its running numbers against numbers computed from scratch."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planner.cover import local_search_kernels as kernels
from planner.cover.local_search import _state
from planner.cover.canonical import candidates


@st.composite
def moves(draw):
    """A problem with demands, costs and areas, and columns to be moved in or out in turn."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    M = rng.random((draw(st.integers(1, 25)), draw(st.integers(1, 15)))) < draw(st.floats(0.1, 0.6))
    M[0, 0] = True
    problem = candidates(
        M,
        rng.lognormal(0, 1, len(M)),
        coverage=draw(st.sampled_from([0.7, 1.0])),
        multiplicity=draw(st.integers(1, 3)),
        costs=rng.integers(1, 9, M.shape[1]).astype(float),
    ).problem
    return problem, rng.integers(0, problem.n_columns, draw(st.integers(0, 40)))


@given(moves(), st.integers(0, 1000))
def test_running_numbers_are_those_computed_from_scratch(case, seed):
    """Scores, counts, members, open rows, cost and missing area after any sequence of moves."""
    problem, columns = case
    state = _state(problem, problem.cost(np.arange(problem.n_columns)), np.random.default_rng(seed))
    state.weights[:] = np.random.default_rng(seed).integers(1, 100, problem.n_rows)
    kernels.start(state, np.zeros(0, dtype=np.int64))
    chosen: set[int] = set()
    for column in columns.tolist():
        (kernels.remove if column in chosen else kernels.add)(state, column)
        chosen ^= {column}
    dense = problem.matrix().toarray() > 0
    inside = np.zeros(problem.n_columns, dtype=bool)
    inside[list(chosen)] = True
    counts = dense[:, inside].sum(axis=1)
    helped, lost = counts < problem.demand, counts <= problem.demand
    gain, loss = (dense.T @ (state.weights * rows) for rows in (helped, lost))
    np.testing.assert_array_equal(state.score, np.where(inside, loss, gain))
    np.testing.assert_array_equal(state.counts, counts)
    numbers = state.numbers
    assert set(state.members[: numbers[kernels.MEMBERS]].tolist()) == chosen
    assert sorted(state.open_rows[: numbers[kernels.OPEN]].tolist()) == np.flatnonzero(helped).tolist()
    assert numbers[kernels.COST] == problem.cost(sorted(chosen))
    assert numbers[kernels.MISSING] == int(problem.units[helped].sum()) - problem.slack


def test_draws_are_even_and_in_range():
    """Ten thousand draws of seven numbers: none outside, each about as often as the others."""
    problem = candidates(np.eye(2, dtype=bool), np.ones(2)).problem
    state = _state(problem, 2, np.random.default_rng(0))
    drawn = np.bincount([kernels.draw(state, 7) for _ in range(10_000)], minlength=7)
    assert len(drawn) == 7
    assert abs(drawn - 10_000 / 7).max() < 5 * np.sqrt(10_000 / 7)
