"""Budget of a solve, start-up cost and output of the cover package."""

import subprocess
import sys

import numpy as np
import pytest

from planner.cover import CoverProblem, CoverStatus, solve
from planner.cover.budget import LARGE, Budget, interruptible, scaled_effort
from planner.cover.reductions import canonical_form
from planner.cover.search import CHUNK_EFFORT, LocalSearch, greedy


def test_portions_of_effort_nest() -> None:
    """A portion limits what may be spent inside, and the rest is available again afterwards."""
    budget = Budget(100)
    assert budget.spend(20)
    with budget.portion(0.5):
        assert budget.remaining == 40
        assert not budget.spend(45)
    assert budget.remaining == 35
    assert budget.spend(34)
    assert not budget.spend(1)


def test_budgets_grow_only_with_large_matrices() -> None:
    """They are constant up to `LARGE` entries, and grow in proportion from there on."""
    assert [scaled_effort(400, n) for n in (0, LARGE // 2, LARGE, 3 * LARGE)] == [400, 400, 400, 1200]


def test_the_time_is_divided_like_the_effort() -> None:
    """Half of the budget has half of the seconds; a limit that is reached inside leaves the outer time."""
    now = [0.0]
    budget = Budget(100, time_limit_s=10.0, clock=lambda: now[0])
    with budget.portion(0.5):
        assert budget.remaining_seconds == pytest.approx(5.0)
        now[0] = 6.0
        assert not budget.spend(1)
    assert budget.time_limited
    assert budget.remaining_seconds == pytest.approx(4.0)
    assert budget.spend(1)


def test_the_incumbent_is_the_smallest_and_proven_by_the_bound() -> None:
    """Once it is proven no effort is granted."""
    budget = Budget(100)
    assert budget.offer(np.arange(4), 4)
    assert not budget.offer(np.arange(4) + 1, 4)
    budget.raise_lower_bound(3)
    assert not budget.is_proven
    assert budget.offer(np.arange(3), 3)
    assert budget.is_proven
    assert not budget.spend(0)


def test_a_search_exceeds_its_time_limit_by_one_chunk() -> None:
    """With a clock that jumps past the limit the search ends at the next check."""
    rng = np.random.default_rng(0)
    instance = canonical_form(CoverProblem(rng.random((200, 300)) < 0.03, np.ones(200))).reduced
    ticks = iter([0.0, *[0.5] * 3, *[2.0] * 1000])
    budget = Budget(10**12, time_limit_s=1.0, clock=lambda: next(ticks))
    first, _ = greedy(instance)
    budget.offer(first, len(first))
    LocalSearch(instance, first, rng).run(budget)
    assert budget.time_limited
    assert budget.spent <= 4 * CHUNK_EFFORT


def test_interruptible_returns_results_and_raises_errors() -> None:
    """Both come back from its thread."""
    assert interruptible(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)


def test_nothing_is_imported_if_the_reductions_leave_nothing() -> None:
    """The import of numba takes 0.5 s: it is postponed to the first compiled loop."""
    program = (
        "import sys, numpy as np\n"
        "from planner.cover import CoverProblem, solve\n"
        "cover = solve(CoverProblem(np.eye(40, dtype=bool), np.ones(40)), rng=np.random.default_rng(0))\n"
        "assert len(cover.views) == cover.lower_bound == 40\n"
        "assert not {'numba', 'highspy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_highs_is_silent() -> None:
    """Standard output belongs to the command, `--json` above all; some releases print a greeting there."""
    program = "from planner.cover import bounds; bounds._highs().run()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_answers_are_read_only_and_have_sentences() -> None:
    """The values of the status are without numbers, `Cover.sentence` has them."""
    assert all(" " in status.sentence for status in CoverStatus)
    cover = solve(CoverProblem(np.eye(3, dtype=bool), np.ones(3)), rng=np.random.default_rng(0))
    assert cover.sentence == "proven fewest views for these candidates and samples"
    with pytest.raises(ValueError, match="read-only"):
        cover.views[0] = 1
