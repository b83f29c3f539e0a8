"""Ctrl-C at chosen points of a search.

Python raises `KeyboardInterrupt` between any two instructions, also while numba converts the arguments or results of a
kernel; the kernel then fails with `SystemError`. A search that keeps its result defers Ctrl-C and asks for it itself.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_state = {"is_deferred": False, "is_pressed": False}


@contextmanager
def deferred_interrupt() -> Iterator[None]:
    """Defer Ctrl-C in the block to the next `raise_interrupt` or the end of the block; the second one acts at once.

    Nothing changes in threads other than the main thread, which receive no signals, and where SIGINT is ignored.
    """
    handler = signal.getsignal(signal.SIGINT)
    if _state["is_deferred"] or threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        raise_interrupt()
        return
    act = handler

    def defer(number: int, frame: FrameType | None) -> None:
        if _state["is_pressed"]:
            act(number, frame)
        _state["is_pressed"] = True

    try:
        _state["is_deferred"] = True
        signal.signal(signal.SIGINT, defer)
        yield
        raise_interrupt()
    finally:  # Ctrl-C may come between any two of these statements
        _state["is_deferred"] = False
        signal.signal(signal.SIGINT, handler)
        is_pressed, _state["is_pressed"] = _state["is_pressed"], False
    if is_pressed:
        raise KeyboardInterrupt


def raise_interrupt() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed in the surrounding `deferred_interrupt`."""
    if _state["is_pressed"] and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt
