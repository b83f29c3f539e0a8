"""Overlap and promises where they fail, by name."""

from itertools import count

import numpy as np
import pytest
from scipy.sparse import csr_array

from planner.cover import CoverProblem, CoverStatus, Overlap, solve
from planner.cover.budget import Budget
from planner.cover.overlap import overlap_graph
from planner.cover.robust import robust_cover
from planner.errors import PlannerError
from planner.measurability.pose_ensemble import ProbabilityLayer


def joined(M, areas, overlap, **options):
    """A cover that hangs together, with the tests' budget."""
    told = {name: options.pop(name) for name in ("effort_budget", "time_limit_s", "clock") if name in options}
    problem = CoverProblem(M, areas, overlap=overlap, **options)
    found = solve(problem, rng=np.random.default_rng(0), **{"effort_budget": 2_000_000} | told)
    return found, overlap_graph(problem, found)


def promised(M, hits, members=32, **options):
    """A robust cover of a dense matrix with hits of its entries."""
    matrix = csr_array(np.asarray(M, dtype=bool))
    layer = ProbabilityLayer(matrix.indptr, matrix.indices, np.broadcast_to(hits, matrix.nnz), members)
    told = {name: options.pop(name) for name in ("effort_budget", "alpha") if name in options}
    problem = CoverProblem(matrix, np.ones(len(M)), **options)
    return robust_cover(problem, layer, rng=np.random.default_rng(0), **{"effort_budget": 2_000_000} | told)


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0), (3, 3)])
def test_empty_matrix(shape):
    """Nothing to cover: no views, a status each, no exception."""
    found, _ = joined(csr_array(shape, dtype=bool), np.ones(shape[0]), Overlap(area=1.0))
    assert (len(found.views), found.status) == (0, CoverStatus.NOTHING_COVERABLE)
    assert found.sentence == "no allowed candidate measures any sample"
    robust = promised(np.zeros(shape, dtype=bool), np.zeros(0))
    assert (len(robust.cover.views), robust.robust_coverable_area) == (0, 0.0)


def test_two_islands_cannot_be_connected():
    """Disjoint blocks: said, with the part that measures most; each part hangs together, everything is covered."""
    M = np.zeros((10, 4), dtype=bool)
    M[:4, 0] = M[3:7, 1] = M[7:9, 2] = M[8:, 3] = True
    found, how = joined(M, np.ones(10), Overlap(area=1.0))
    assert not how.is_connected
    assert sorted(found.views.tolist()) == [0, 1, 2, 3]
    assert how.component_area.tolist() == [7.0, 3.0]
    assert set(found.views[how.component == 0].tolist()) == {0, 1}
    assert "falls into 2 components" in how.sentence
    assert "2 of 4 views" in how.sentence
    assert "70.00 %" in how.sentence


def test_part_of_the_coverage_connects_where_all_of_it_cannot():
    """The same islands at 70 %: the large one is enough, and hangs together."""
    M = np.zeros((10, 4), dtype=bool)
    M[:4, 0] = M[3:7, 1] = M[7:9, 2] = M[8:, 3] = True
    found, how = joined(M, np.ones(10), Overlap(area=1.0), coverage=0.7)
    assert how.is_connected
    assert sorted(found.views.tolist()) == [0, 1]


def test_pinned_views_on_both_islands_cannot_be_connected():
    """A pinned view on the small island: the plan has it, and says that it stands apart."""
    M = np.zeros((10, 4), dtype=bool)
    M[:4, 0] = M[3:7, 1] = M[7:9, 2] = M[8:, 3] = True
    found, how = joined(M, np.ones(10), Overlap(area=1.0), coverage=0.7, pinned=[3])
    assert not how.is_connected
    assert 3 in found.views


def test_one_view_hangs_together_with_itself():
    """A column that covers all needs no neighbour."""
    M = np.ones((5, 3), dtype=bool)
    found, how = joined(M, np.ones(5), Overlap(share=1.0))
    assert (len(found.views), found.n_views_without_overlap, how.is_connected) == (1, 1, True)
    assert found.sentence.startswith("proven fewest")


def test_an_overlap_that_is_met_exactly_counts():
    """Inclusive, also where the area is a sum of rounded numbers."""
    M = np.zeros((12, 2), dtype=bool)
    M[:7, 0] = M[4:, 1] = True
    for overlap in (Overlap(area=0.1 + 0.1 + 0.1), Overlap(share=3 / 7)):
        assert joined(M, np.full(12, 0.1), overlap)[1].is_connected
    assert not joined(M, np.full(12, 0.1), Overlap(area=0.3001))[1].is_connected


@pytest.mark.parametrize(
    "wanted", [{}, {"area": 1.0, "share": 0.5}, {"area": 0.0}, {"area": np.inf}, {"share": 0.0}, {"share": 1.1}]
)
def test_what_is_no_overlap_is_refused(wanted):
    """Neither or both, none, endless, more than all."""
    with pytest.raises(PlannerError, match="overlap"):
        Overlap(**wanted)


@pytest.mark.parametrize("alpha", [0.0, 1.0, -0.1, 2.0, np.nan])
def test_certainty_and_indifference_are_refused(alpha):
    """With pose errors nothing is certain, and a miss that is always allowed is no promise."""
    with pytest.raises(PlannerError, match="alpha"):
        promised(np.eye(3, dtype=bool), 32, alpha=alpha)


def test_no_entry_is_ever_hit():
    """All hits 0: nothing can be promised; no views, a sentence, nominal coverable area as before."""
    found = promised(np.eye(3, dtype=bool), 0)
    assert (len(found.cover.views), found.robust_coverable_area) == (0, 0.0)
    assert found.cover.coverable_area == 3.0
    assert "no sample can be measured" in found.sentence


def test_a_promise_that_needs_more_views_than_there_are():
    """One view of 32 hits in 32 gives 98.5 %: enough for 95 %, not for 99 %; two are."""
    assert len(promised(np.ones((1, 1)), 32, alpha=0.05).cover.views) == 1
    assert promised(np.ones((1, 1)), 32, alpha=0.01).robust_coverable_area == 0.0
    assert len(promised(np.ones((1, 2)), 32, alpha=0.01).cover.views) == 2


def test_pinned_and_banned_views_hold_for_promises_too():
    """Pinned is in, banned is out, both at once is refused."""
    M = np.ones((2, 4))
    found = promised(M, 32, pinned=[2], banned=[0])
    assert found.cover.views.tolist() == [2]
    with pytest.raises(PlannerError, match="banned"):
        promised(M, 32, pinned=[2], banned=[2])
    with pytest.raises(PlannerError, match="banned"):
        joined(M, np.ones(2), Overlap(area=1.0), pinned=[2], banned=[2])


def test_identical_columns_and_budget_zero():
    """Ties and no work: greedy's answer, a bound that holds, the promise kept."""
    M = np.repeat(np.eye(4, dtype=bool), 5, axis=1)
    for budget in (0, 2_000_000):
        found = promised(M, 20, alpha=0.05, effort_budget=budget)
        assert found.robust_area == 4.0
        assert found.cover.lower_bound <= 16 == len(found.cover.views)  # four of each: (13.5/33)^4 < 0.05 < (13.5/33)^3


def test_nothing_is_asked_for():
    """A coverage of 0 needs no view, and the sentence does not say that nothing can be measured."""
    found, how = joined(np.eye(3, dtype=bool), np.ones(3), Overlap(area=1.0), coverage=0.0)
    assert (len(found.views), how.is_connected) == (0, True)
    assert found.sentence.startswith("proven fewest")


def test_one_time_limit_holds_for_both_searches_and_is_said():
    """The cover without the wish takes a share of the clock, not a clock of its own; the answer names the limit."""
    rng = np.random.default_rng(5)
    M = rng.random((150, 300)) < 0.05
    M[:, 0] |= ~M.any(axis=1)
    ticks = count()
    found, _ = joined(
        M, np.ones(150), Overlap(area=2.0), effort_budget=10**12, time_limit_s=60.0, clock=lambda: float(next(ticks))
    )
    assert next(ticks) <= 70
    assert found.sentence.startswith("the time limit stopped the search; at most")


def test_a_pinned_view_that_measures_nothing_does_not_end_the_search_early():
    """It counts in the bound, but not among the columns that are searched."""
    for seed in (48, 98, 117):  # where the last view less has to be searched for
        M = np.random.default_rng(seed).random((30, 16)) < 0.25
        M[:, 15] = False
        without, _ = joined(M, np.ones(30), Overlap(area=2.0))
        pinned, _ = joined(M, np.ones(30), Overlap(area=2.0), pinned=[15])
        assert len(pinned.views) == len(without.views) + 1


@pytest.mark.parametrize("after", [1, 5, 20, 40, 60])
@pytest.mark.parametrize("ask", ["overlap", "promise", "most"])
def test_ctrl_c_gives_the_best_so_far(ask, after, monkeypatch):
    """Whenever it comes: what is asked for holds, the bound too, and the sentence says that it was interrupted."""
    rng = np.random.default_rng(5)
    M = rng.random((150, 300)) < 0.05
    M[:, 0] |= ~M.any(axis=1)
    calls, spend = count(), Budget.spend

    def interrupted(self, work):
        if next(calls) == after:
            raise KeyboardInterrupt
        return spend(self, work)

    monkeypatch.setattr(Budget, "spend", interrupted)
    monkeypatch.setattr("planner.cover.search.CHUNK_EFFORT", 100_000)
    if ask == "overlap":
        found, how = joined(M, np.ones(150), Overlap(area=2.0), effort_budget=10**11)
        assert how.is_connected
    elif ask == "promise":
        found = promised(M, 20, alpha=0.5, effort_budget=10**11)
        assert found.robust_area == found.robust_coverable_area
    else:
        found = solve(CoverProblem(M, np.ones(150), max_views=9), rng=rng, effort_budget=10**11)
        assert found.covered_area < found.upper_area
    assert next(calls) > after
    cover = found.cover if ask == "promise" else found
    assert 0 <= cover.lower_bound < len(cover.views) + (ask == "most")
    assert found.sentence.startswith("the search was interrupted; at most")
