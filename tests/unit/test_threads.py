"""Work in threads: every item once, errors, nested calls and forks."""

import os
import threading

import numpy as np
import pytest

from planner.threads import run_in_threads

pytestmark = pytest.mark.usefixtures("four_threads")


@pytest.mark.parametrize(
    ("count", "least", "blocks"), [(0, 0, 0), (1, 0, 1), (3, 0, 3), (1000, 10, 4), (1000, 1000, 1)]
)
def test_each_item_is_worked_on_once(count, least, blocks):
    """The blocks are disjoint and complete; there are as many as cores, or one for few items."""
    times, n_blocks = np.zeros(count, dtype=int), []

    def work(block):
        n_blocks.append(block)
        times[block] += 1

    run_in_threads(work, count, least)
    assert (times == 1).all()
    assert len(n_blocks) == blocks


@pytest.mark.parametrize("wrong", [0, 999])
def test_an_error_of_any_block_is_raised_after_all_have_ended(wrong):
    """No block is still at work when the error is raised, and the next call works."""
    ended = []

    def work(block):
        try:
            if block.start <= wrong < block.stop:
                raise ValueError("wrong block")
        finally:
            ended.append(block)

    with pytest.raises(ValueError, match="wrong block"):
        run_in_threads(work, 1000, 0)
    assert len(ended) == 4
    test_each_item_is_worked_on_once(1000, 10, 4)


def test_calls_from_a_block_use_its_thread():
    """Nested calls do not wait for threads that are all at work."""
    used: dict[int, set[int]] = {}

    def work(block):
        own = used.setdefault(block.start, set())
        run_in_threads(lambda _: own.add(threading.get_ident()), 100, 0)
        assert own == {threading.get_ident()}

    run_in_threads(work, 1000, 0)
    assert len(used) == 4


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks on this system")
def test_a_fork_has_threads_of_its_own():
    """A forked process, which has no threads of its parent, works as well."""
    run_in_threads(lambda _: None, 1000, 0)
    child = os.fork()
    if child == 0:
        done = []
        run_in_threads(done.append, 1000, 0)
        os._exit(len(done) != 4)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
