"""Budget of a solve, start-up cost and output of the cover package."""

import subprocess
import sys

import numpy as np
import pytest

from planner.cover import CoverProblem, CoverStatus, solve
from planner.cover.budget import LARGE, Budget, interruptible, scaled_effort


def test_portions_of_effort_nest() -> None:
    """A portion limits the effort inside it, and the remaining effort is available again afterwards."""
    budget = Budget(100)
    assert budget.spend(20)
    with budget.portion(0.5):
        assert budget.remaining == 40
        assert not budget.spend(45)
    assert budget.remaining == 35
    assert budget.spend(34)
    assert not budget.spend(1)


def test_budgets_grow_only_with_large_matrices() -> None:
    """The effort is constant up to `LARGE` entries and proportional to their number above."""
    assert [scaled_effort(400, n) for n in (0, LARGE // 2, LARGE, 3 * LARGE)] == [400, 400, 400, 1200]


def test_the_incumbent_is_the_smallest_and_proven_by_the_bound() -> None:
    """The smallest cover is kept. Once the bound proves it, no effort is granted."""
    budget = Budget(100)
    assert budget.offer(np.arange(4), 4)
    assert not budget.offer(np.arange(4) + 1, 4)
    budget.raise_lower_bound(3)
    assert not budget.is_proven
    assert budget.offer(np.arange(3), 3)
    assert budget.is_proven
    assert not budget.spend(0)


def test_interruptible_returns_results_and_raises_errors() -> None:
    """Results are returned and errors raised from the thread."""
    assert interruptible(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)


def test_nothing_is_imported_if_the_reductions_leave_nothing() -> None:
    """Numba and HiGHS are not imported if the reductions solve the problem; the import of Numba takes 0.5 s."""
    program = (
        "import sys, numpy as np\n"
        "from planner.cover import CoverProblem, solve\n"
        "cover = solve(CoverProblem(np.eye(40, dtype=bool), np.ones(40)), rng=np.random.default_rng(0))\n"
        "assert len(cover.views) == cover.lower_bound == 40\n"
        "assert not {'numba', 'highspy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_highs_is_silent() -> None:
    """HiGHS prints nothing, because standard output belongs to the command; some releases print a banner."""
    program = "from planner.cover import bounds; bounds._highs().run()"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert (process.stdout, process.stderr) == ("", "")


def test_answers_are_read_only_and_have_sentences() -> None:
    """A cover is read-only and has a sentence, as does each status."""
    assert all(" " in status.sentence for status in CoverStatus)
    cover = solve(CoverProblem(np.eye(3, dtype=bool), np.ones(3)), rng=np.random.default_rng(0))
    assert cover.sentence == "optimal for the 3 candidate poses (bound 3)"
    with pytest.raises(ValueError, match="read-only"):
        cover.views[0] = 1
