"""Questions about the most area on which methods fail, by name."""

import numpy as np
import pytest
import scipy.sparse as sp

from planner.cover import CoverProblem, CoverStatus, solve
from planner.cover.curve import coverage_curve
from planner.errors import PlannerError


def ask(M, areas, k, **options):
    """The most area with a fresh generator and the tests' budget."""
    told = {name: options.pop(name) for name in ("effort_budget", "time_limit_s") if name in options}
    problem = CoverProblem(M, areas, max_views=k, **options)
    return solve(problem, rng=np.random.default_rng(0), **{"effort_budget": 20_000_000} | told)


def draw(M, areas, **options):
    """The curve with a fresh generator and the tests' budget."""
    told = {name: options.pop(name) for name in ("effort_budget", "known_selections") if name in options}
    return coverage_curve(
        CoverProblem(M, areas, **options), rng=np.random.default_rng(0), **{"effort_budget": 20_000_000} | told
    )


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0), (5, 5)])
def test_empty_matrix(shape):
    """Nothing to cover: no views, a status, a curve of one point; no exception."""
    M = sp.csr_array(shape, dtype=bool)
    found = ask(M, np.ones(shape[0]), 3)
    assert (found.status, len(found.views), found.gap_percent) == (CoverStatus.NOTHING_COVERABLE, 0, 0.0)
    curve = draw(M, np.ones(shape[0]))
    assert (curve.covered_area.tolist(), curve.upper_area.tolist()) == ([0.0], [0.0])
    assert curve.fewest_views(1.0) == (0, 0)


def test_no_views_at_all():
    """None of the columns measures nothing, and that is the most."""
    found = ask(np.eye(4, dtype=bool), np.ones(4), 0)
    assert (len(found.views), found.covered_area, found.status) == (0, 0.0, CoverStatus.PROVEN)


def test_more_views_than_columns():
    """A number beyond the columns gives everything, with no view that adds nothing."""
    M = np.array([[1, 1, 0], [0, 1, 0], [0, 0, 1]], dtype=bool)
    for k in (99, 10**12):
        found = ask(M, np.ones(3), k)
        assert found.status is CoverStatus.PROVEN
        assert sorted(found.views.tolist()) == [1, 2]


def test_one_column_too_few():
    """Disjoint columns: one less than needed leaves exactly the smallest."""
    found = ask(np.eye(5, dtype=bool), np.array([1.0, 2, 3, 4, 5]), 4)
    assert sorted(found.views.tolist()) == [1, 2, 3, 4]
    assert found.status is CoverStatus.PROVEN


def test_identical_columns_are_one():
    """Copies of a column do not make room for more."""
    M = np.repeat(np.eye(3, dtype=bool), 4, axis=1)
    found = ask(M, np.ones(3), 2)
    assert found.covered_area == 2.0
    assert found.status is CoverStatus.PROVEN


def test_permuting_the_columns_changes_nothing_but_indices():
    """The same candidates in another order: the same area, the same rows."""
    rng = np.random.default_rng(3)
    M = rng.random((60, 25)) < 0.15
    order = rng.permutation(25)
    one, other = ask(M, np.ones(60), 5), ask(M[:, order], np.ones(60), 5)
    np.testing.assert_array_equal(order[other.views], one.views)
    np.testing.assert_array_equal(draw(M, np.ones(60)).covered_area, draw(M[:, order], np.ones(60)).covered_area)


def test_areas_over_eighteen_decades():
    """Rows of 1e-12 and of 1e6: the large ones decide, the bound holds, nothing overflows."""
    rng = np.random.default_rng(0)
    M = rng.random((40, 15)) < 0.2
    areas = 10.0 ** rng.uniform(-12, 6, 40)
    curve = draw(M, areas)
    assert (np.diff(curve.covered_area) >= 0).all()
    assert (curve.upper_area >= curve.covered_area).all()
    assert curve.covered_area[-1] == pytest.approx(areas[M.any(axis=1)].sum())


def test_all_areas_zero():
    """Rows without area: every row counts alike, the area is 0."""
    found = ask(np.eye(3, dtype=bool), np.zeros(3), 2)
    assert (len(found.views), found.covered_area, found.gap_percent) == (2, 0.0, 0.0)


def test_pinned_views_that_measure_nothing_stay():
    """A pinned empty column takes one of the k places."""
    M = np.array([[0, 1, 0], [0, 0, 1]], dtype=bool)
    found = ask(M, np.ones(2), 2, pinned=[0])
    assert (len(found.views), found.covered_area) == (2, 1.0)
    assert found.views[-1] == 0
    assert draw(M, np.ones(2), pinned=[0]).first_n_views == 1


def test_pinned_alone_fill_k():
    """As many pinned as k: they are the selection, proven."""
    M = np.eye(4, dtype=bool)
    found = ask(M, np.ones(4), 2, pinned=[1, 3])
    assert sorted(found.views.tolist()) == [1, 3]
    assert found.status is CoverStatus.PROVEN


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"k": -1}, "max_views is -1"),
        ({"k": 1, "pinned": [0, 1]}, "2 views are pinned"),
        ({"k": 2, "pinned": [0], "banned": [0]}, "banned or not among the allowed"),
        ({"k": 2, "pinned": [0], "allowed": np.array([False, True, True])}, "banned or not among the allowed"),
        ({"k": 2, "pinned": [7]}, "pinned names column 7"),
    ],
)
def test_requests_that_contradict_themselves_are_refused(options, words):
    """One sentence that names what is wrong."""
    with pytest.raises(PlannerError, match=words):
        ask(np.eye(3, dtype=bool), np.ones(3), **options)


def test_a_known_plan_is_on_the_curve_and_ends_it():
    """Budget 0 finds little; the plan that is known is a point all the same."""
    rng = np.random.default_rng(1)
    M = rng.random((80, 30)) < 0.15
    M = M[M.any(axis=1)]
    full = draw(M, np.ones(len(M))).views[-1]
    curve = draw(M, np.ones(len(M)), effort_budget=0, known_selections=[full])
    assert curve.n_views[-1] == len(full)
    assert curve.covered_area[-1] == curve.coverable_area
    with pytest.raises(PlannerError, match="pinned"):
        draw(M, np.ones(len(M)), known_selections=[full], pinned=np.setdiff1d(np.arange(30), full)[:1].tolist())


def test_a_clock_that_has_run_out_is_said():
    """A time limit of 0 s: the greedy selection, a valid bound, and the status says why."""
    rng = np.random.default_rng(2)
    M = rng.random((200, 80)) < 0.05
    found = ask(M, np.ones(200), 10, time_limit_s=0.0)
    assert found.status is CoverStatus.TIME_LIMITED
    assert "time limit" in found.sentence
    assert found.upper_area >= ask(M, np.ones(200), 10).covered_area


def test_no_area_at_a_coverage_beyond_one():
    """The curve is asked for a share."""
    with pytest.raises(PlannerError, match="from 0 to 1"):
        draw(np.eye(2, dtype=bool), np.ones(2)).fewest_views(1.5)
