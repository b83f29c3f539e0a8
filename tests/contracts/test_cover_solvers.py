"""Contract of every solver of the cover problem: reproducible, interruptible, independent of the form of the input."""

from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from planner.cover import SOLVERS, Cover, CoverProblem, CoverStatus, Overlap, solve
from planner.cover.budget import Budget
from planner.cover.overlap import overlap_graph
from planner.cover.robust import robust_cover
from planner.measurability.pose_ensemble import ProbabilityLayer
from tests.support.cover_oracle import assert_consistent

EFFORT = 5_000_000


def instance(seed: int, n_rows: int = 60, n_columns: int = 40, density: float = 0.1) -> tuple[Any, Any]:
    """Return a random matrix and log-normal areas."""
    rng = np.random.default_rng(seed)
    return rng.random((n_rows, n_columns)) < density, rng.lognormal(0, 1, n_rows)


def run(M: Any, areas: Any, solver: str, coverage: float = 1.0, **options: Any) -> Cover:
    """Solve with a fresh generator and the tests' budget; check the answer."""
    of_solve = {key: options.pop(key) for key in ("effort_budget", "start") if key in options}
    problem = CoverProblem(M, areas, coverage=coverage, **options)
    cover = solve(problem, rng=np.random.default_rng(5), solver=solver, **{"effort_budget": EFFORT} | of_solve)
    assert_consistent(problem, cover)
    return cover


@pytest.fixture(params=list(SOLVERS))
def solver(request: pytest.FixtureRequest) -> str:
    """Return each solver by name."""
    return str(request.param)


@pytest.mark.parametrize(
    "options", [{"coverage": 0.3}, {"demand": 2}, {"coverage": 0.9, "costs": np.linspace(2.0, 9.0, 40)}],
    ids=["share", "demand", "costs"],
)  # fmt: skip
def test_same_seed_same_answer(solver: str, options: dict[str, Any]) -> None:
    """Two runs with the same seed and budget agree in every field: effort is counted, not timed."""
    M, areas = instance(8)
    first, second = (run(M, areas, solver, **options) for _ in range(2))
    np.testing.assert_array_equal(first.views, second.views)
    assert (first.lower_bound, first.cost_bound) == (second.lower_bound, second.cost_bound)
    assert (first.effort, first.status) == (second.effort, second.status)


@pytest.mark.parametrize("options", [{}, {"coverage": 0.9}, {"max_views": 5}], ids=["full", "share", "area"])
def test_permuting_columns_changes_only_indices(solver: str, options: dict[str, Any]) -> None:
    """The answer to the permuted matrix contains the same sets of rows, in the same order."""
    rng = np.random.default_rng(0)
    M = rng.random((40, 25)) < 0.15
    order = rng.permutation(25)
    plain, permuted = (run(m, np.ones(40), solver, **options) for m in (M, M[:, order]))  # equal areas give ties
    assert len(plain.views) > 3
    np.testing.assert_array_equal(M[:, plain.views], M[:, order][:, permuted.views])


def test_sparse_and_dense_matrices_agree(solver: str) -> None:
    """csr, csc, coo and dense matrices give the same answer."""
    M, areas = instance(2)
    first, *others = (
        run(form(M), areas, solver).views for form in (np.asarray, sp.csr_array, sp.csc_matrix, sp.coo_array)
    )
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_equal_costs_select_like_no_costs(solver: str) -> None:
    """A cost of 12.5 s for each view selects the same views, at 12.5 times the cost."""
    M, areas = instance(9)
    plain, priced = run(M, areas, solver), run(M, areas, solver, costs=np.full(M.shape[1], 12.5))
    np.testing.assert_array_equal(plain.views, priced.views)
    assert priced.cost == 12.5 * len(plain.views)
    assert (priced.cost_bound, priced.lower_bound) == (12.5 * plain.lower_bound, plain.lower_bound)


@pytest.mark.parametrize("coverage", [0.9, 1.0])
def test_the_optimum_is_kept_as_start_and_unusable_starts_are_ignored(solver: str, coverage: float) -> None:
    """Starts may miss the target, contain banned columns or more views than are allowed."""
    M, areas = instance(1)
    best = run(M, areas, "exact", coverage, effort_budget=60 * EFFORT)
    again = run(M, areas, solver, coverage, start=best.views)
    np.testing.assert_array_equal(np.sort(again.views), np.sort(best.views))
    for start in (best.views[:1], np.arange(M.shape[1]), np.zeros(0, dtype=np.int64)):
        assert best.views[0] not in run(M, areas, solver, coverage, start=start, banned=[int(best.views[0])]).views
    assert len(run(M, areas, solver, max_views=3, start=np.arange(10)).views) <= 3


def interrupt_after(n_calls: int, monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Raise Ctrl-C at a call of `Budget.spend`; return the counter of calls."""
    calls, spend = count(), Budget.spend

    def interrupted(self: Budget, effort: int) -> bool:
        if next(calls) == n_calls:
            raise KeyboardInterrupt
        return spend(self, effort)

    monkeypatch.setattr(Budget, "spend", interrupted)
    monkeypatch.setattr("planner.cover.search.CHUNK_EFFORT", 10_000)
    return calls.__next__


@pytest.mark.parametrize("solver", ["meta-raps", "local-search", "auto"])
def test_ctrl_c_returns_the_best_cover_so_far(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The interrupted search returns a cover with a bound and the status INTERRUPTED."""
    interrupt_after(40, monkeypatch)
    M, areas = instance(4, 300, 200, 0.05)
    cover = run(M, areas, solver, effort_budget=10**12)
    assert cover.status is CoverStatus.INTERRUPTED
    assert cover.sentence.startswith("the search was interrupted; at most")
    assert 1 <= cover.lower_bound < len(cover.views)


@pytest.mark.parametrize("after", [1, 20])
@pytest.mark.parametrize("kind", ["overlap", "robust", "area"])
def test_ctrl_c_returns_a_valid_answer_to_every_kind_of_problem(
    kind: str, after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupt at any time leaves the constraints and the bound valid."""
    rng = np.random.default_rng(5)
    M = rng.random((150, 300)) < 0.05
    M[:, 0] |= ~M.any(axis=1)
    calls = interrupt_after(after, monkeypatch)
    monkeypatch.setattr("planner.cover.search.CHUNK_EFFORT", 100_000)
    if kind == "robust":
        matrix = sp.csr_array(M)
        layer = ProbabilityLayer(matrix.indptr, matrix.indices, np.full(matrix.nnz, 20), 32)
        problem = CoverProblem(matrix, np.ones(150))
        robust = robust_cover(problem, layer, alpha=0.5, rng=rng, effort_budget=10**11)
        assert robust.robust_area == robust.robust_coverable_area
        cover, sentence = robust.cover, robust.sentence
    else:
        options: dict[str, Any] = {"overlap": Overlap(area=2.0)} if kind == "overlap" else {"max_views": 9}
        cover = run(M, np.ones(150), "auto", effort_budget=10**11, **options)
        sentence = cover.sentence
    if kind == "overlap":
        assert overlap_graph(CoverProblem(M, np.ones(150), overlap=Overlap(area=2.0)), cover).is_connected
    assert calls() > after
    assert 0 <= cover.lower_bound < len(cover.views) + (kind == "area")
    assert sentence.startswith("the search was interrupted; at most")


def test_ctrl_c_ends_the_search_for_all_regions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several targets are one search: the problems after the interrupted one get no effort."""
    M, areas = instance(4, 300, 200, 0.05)
    options: dict[str, Any] = {"region": np.arange(300) % 3, "region_coverage": (0.9, 0.8, 0.95)}
    interrupt_after(40, monkeypatch)
    cover = run(M, areas, "local-search", effort_budget=4 * 10**8, **options)
    assert cover.status is CoverStatus.INTERRUPTED
    assert cover.effort < 10**8


def test_ctrl_c_before_the_bound_still_gives_a_cost(solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The result has the greedy cover and the cost of one column as its bound."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.cover.solvers.Relaxation", interrupted)
    M = np.random.default_rng(3).random((60, 80)) < 0.1
    cover = run(M, np.ones(60), solver, costs=np.random.default_rng(4).uniform(1.0, 2.0, 80))
    assert cover.status is CoverStatus.INTERRUPTED
    assert 0 < cover.cost_bound < cover.cost
    assert cover.sentence.startswith("the search was interrupted; costs at most")


def test_a_kill_is_not_a_request_for_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only Ctrl-C itself ends a search with its result; a subclass of its exception reaches the caller."""

    class Killed(KeyboardInterrupt):
        pass

    def killed(task: object) -> None:
        raise Killed

    monkeypatch.setitem(SOLVERS, "local-search", killed)
    M, areas = instance(4, 150, 100, 0.05)
    with pytest.raises(Killed):
        run(M, areas, "local-search")
