"""Ctrl-C at chosen points: deferred to the next question, raised once, and the second one at once."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

import numpy as np
import pytest

from planner.cover.budget import Budget, interruptible
from planner.interrupts import deferred_interrupt, raise_interrupt


@pytest.fixture(autouse=True)
def _python_raises_at_ctrl_c() -> Iterator[None]:
    """Install Python's own handler, which processes of test runners may have replaced."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def press_ctrl_c() -> None:
    """Send SIGINT to this process; the main thread handles it before its next instruction."""
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0)


def run_deferred(*steps: Callable[[], object]) -> None:
    """Run steps one after the other in a block that defers Ctrl-C."""
    with deferred_interrupt():
        for step in steps:
            step()


def test_ctrl_c_waits_for_the_next_question() -> None:
    """The block goes on after Ctrl-C until it asks; nothing remains after the block."""
    calls: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        run_deferred(
            press_ctrl_c, lambda: calls.append("before"), raise_interrupt, lambda: calls.append("after the question")
        )
    assert calls == ["before"]
    raise_interrupt()
    with pytest.raises(KeyboardInterrupt):
        press_ctrl_c()


def test_ctrl_c_is_raised_at_the_end_of_the_block() -> None:
    """A block that does not ask loses no Ctrl-C; an inner block raises it first, the outer block again."""
    raised_by_inner: list[bool] = []

    def inner() -> None:
        with pytest.raises(KeyboardInterrupt):
            run_deferred(press_ctrl_c)
        raised_by_inner.append(True)

    with pytest.raises(KeyboardInterrupt):
        run_deferred(inner)
    assert raised_by_inner


def test_the_second_ctrl_c_acts_at_once() -> None:
    """A block that never asks can be left by a second Ctrl-C."""
    calls: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        run_deferred(press_ctrl_c, press_ctrl_c, lambda: calls.append("after the second"))
    assert not calls


def test_ctrl_c_after_the_last_question_is_not_lost() -> None:
    """Ctrl-C at any instruction of the end of a block is raised, and the next block begins without it."""

    def trace(frame: FrameType, event: str, argument: object) -> object:
        """Press Ctrl-C at the instruction whose number is next, in the function of the block."""
        if frame.f_code.co_name != "deferred_interrupt":
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            seen[0] += 1
            if seen[0] == moment:
                sys.settrace(None)
                press_ctrl_c()
        return trace

    before = signal.getsignal(signal.SIGINT)
    for moment in range(1, 400):
        seen, is_raised = [0], False
        try:
            sys.settrace(trace)
            run_deferred()
        except KeyboardInterrupt:
            is_raised = True
        finally:
            sys.settrace(None)
        assert signal.getsignal(signal.SIGINT) is before
        if seen[0] < moment:
            break
        assert is_raised, moment
        run_deferred(raise_interrupt)
    else:
        pytest.fail("the block has more instructions")
    assert moment > 40


def test_an_error_of_the_block_is_not_replaced() -> None:
    """The error of a block after Ctrl-C is raised as such."""
    with pytest.raises(ZeroDivisionError):
        run_deferred(press_ctrl_c, lambda: 1 // 0)
    raise_interrupt()


def test_other_threads_are_not_interrupted() -> None:
    """A deferred Ctrl-C belongs to the main thread."""
    finished: list[bool] = []

    def ask() -> None:
        run_deferred(raise_interrupt)
        finished.append(True)

    thread = threading.Thread(target=ask)
    with pytest.raises(KeyboardInterrupt):
        run_deferred(press_ctrl_c, thread.start, thread.join)
    assert finished


@pytest.mark.parametrize("question", ["charge", "solver"])
def test_a_budget_ends_its_block_and_keeps_the_incumbent(question: str) -> None:
    """Ctrl-C ends the search of a budget at its next charge, and while a compiled solver runs in another thread."""
    budget = Budget(100)
    budget.offer(np.array([3]), 7)
    begin, calls = time.monotonic(), list[str]()
    with budget.stopped_by_interrupt():
        press_ctrl_c()
        if question == "charge":
            budget.spend(1)
        else:
            interruptible(lambda: time.sleep(60))
        calls.append("after the question")
    assert not calls
    assert budget.interrupted
    assert budget.incumbent is not None
    assert budget.incumbent.tolist() == [3]
    assert budget.remaining == 0
    assert time.monotonic() - begin < 30
