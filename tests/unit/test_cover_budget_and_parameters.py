"""Budget, Meta-RaPS and the readable parts of a result."""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from planner.cover import CoverProblem, CoverStatus, solve, solvers
from planner.cover.budget import LARGE, Budget, interruptible, scaled_effort
from planner.cover.reductions import canonical_form
from planner.cover.search import CHUNK_EFFORT, LocalSearch, greedy


def test_budget_counts_work_and_portions_nest():
    """A portion limits what may be spent inside, and the rest is available again afterwards."""
    budget = Budget(100)
    assert budget.spend(20)
    with budget.portion(0.5):
        assert budget.remaining == 40
        assert not budget.spend(45)
    assert budget.remaining == 35
    assert budget.spend(34)
    assert not budget.spend(1)


def test_budget_grows_with_matrices_beyond_the_usual_only():
    """Any part of the default is left as it is up to `LARGE` entries, and grows in proportion from there on."""
    assert [scaled_effort(400, n) for n in (0, LARGE // 2, LARGE, 3 * LARGE)] == [400, 400, 400, 1200]


def test_clock_guard_is_split_with_the_work():
    """Half of the budget has half of the seconds; a guard that fires inside is reported but leaves the outer time."""
    now = [0.0]
    budget = Budget(100, time_limit_s=10.0, clock=lambda: now[0])
    with budget.portion(0.5):
        assert budget.remaining_seconds == pytest.approx(5.0)
        now[0] = 6.0
        assert not budget.spend(1)
    assert budget.time_limited
    assert budget.remaining_seconds == pytest.approx(4.0)
    assert budget.spend(1)


def test_budget_keeps_the_smaller_cover_and_knows_when_it_is_proven():
    """The best is kept; proven as soon as the bound meets it, and then no work is granted."""
    budget = Budget(100)
    assert budget.offer(np.arange(4), 4)
    assert not budget.offer(np.arange(4) + 1, 4)
    budget.raise_lower_bound(3)
    assert not budget.is_proven
    assert budget.offer(np.arange(3), 3)
    assert budget.is_proven
    assert not budget.spend(0)


def test_meta_raps_improves_on_greedy():
    """It finds shorter covers than greedy on most of ten random instances."""
    better = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        M = rng.random((100, 100)) < 0.08
        found, first = (
            solve(CoverProblem(M, np.ones(100)), rng=rng, solver=name, effort_budget=2 * 10**7)
            for name in ("meta-raps", "greedy")
        )
        better += len(found.views) < len(first.views)
    assert better >= 7


def test_every_status_is_a_sentence():
    """Values are words for a report; numbers come with Cover.sentence."""
    for status in CoverStatus:
        assert " " in status.sentence
    M = np.eye(3, dtype=bool)
    said = solve(CoverProblem(M, np.ones(3)), rng=np.random.default_rng(0)).sentence
    assert said == "proven fewest views for these candidates and samples"


def test_results_are_read_only():
    """Arrays of a Cover cannot be changed in place."""
    result = solve(CoverProblem(np.eye(3, dtype=bool), np.ones(3)), rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="read-only"):
        result.views[0] = 1


def test_nothing_is_compiled_where_the_reductions_leave_nothing():
    """Importing the package and solving what reduces to nothing does not import numba: that costs 0.5 s."""
    program = (
        "import sys, numpy as np\n"
        "from planner.cover import CoverProblem, solve\n"
        "result = solve(CoverProblem(np.eye(40, dtype=bool), np.ones(40)), rng=np.random.default_rng(0))\n"
        "assert len(result.views) == result.lower_bound == 40\n"
        "assert not {'numba', 'highspy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_solver_of_bounds_is_silent():
    """Standard output is for what a command prints, `--json` above all; some releases greet there."""
    program = "import planner.cover.bounds as bounds; bounds._highs().run()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_interruptible_hands_over_results_and_errors():
    """What the call returns or raises comes back from its thread."""
    assert interruptible(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)


def test_guard_overrun_is_one_chunk():
    """With a clock that jumps past the limit the search ends at the next look, after one chunk of work at most."""
    rng = np.random.default_rng(0)
    sets = canonical_form(CoverProblem(rng.random((200, 300)) < 0.03, np.ones(200))).reduced
    ticks = iter([0.0, *[0.5] * 3, *[2.0] * 1000])
    budget = Budget(10**12, time_limit_s=1.0, clock=lambda: next(ticks))
    first, _ = greedy(sets)
    budget.offer(first, len(first))
    LocalSearch(sets, first, rng).run(budget)
    assert budget.time_limited
    assert budget.spent <= 4 * CHUNK_EFFORT


@pytest.mark.parametrize(
    ("best", "bound", "full", "most", "share"),
    [
        (9, 8, True, -1, solvers.PROOF_SHARE),
        (10, 8, True, -1, solvers.PROOF_SHARE),
        (84, 80, True, -1, solvers.FAR_PROOF_SHARE),
        (9, 8, False, -1, solvers.PROOF_SHARE),
        (10, 8, False, -1, solvers.FAR_PROOF_SHARE),
        (10, 8, False, 5, solvers.AREA_PROOF_SHARE),
    ],
)
def test_branch_and_bound_has_the_most_of_the_budget_where_few_views_are_left(
    best: int, bound: int, full: bool, most: int, share: float
) -> None:
    """Beyond two views the search finds more in the same time, as on rail-like problems."""
    sets = SimpleNamespace(full=full, maximises_area=most > 0, costs=np.ones(500, dtype=np.int64), n_columns=500)
    budget = SimpleNamespace(objective=best, lower_bound=bound)
    assert solvers.SolverTask(sets, None, budget, None).proof_share == share  # type: ignore[arg-type]
