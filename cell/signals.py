"""What Ctrl-C, a polite kill and a closed terminal do to a command: each ends it, and is told by its name.

While an arm is driven (`driving`) the first of them is a stop with one second for its answer, the second ends the
process at once; then the controller's own watchdog stops the arm. Elsewhere Ctrl-C keeps what a stage makes of it.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

INTERRUPTED: Final = 130
"""Exit code of a command that was ended like this."""

NAMES: Final = {
    signal.Signals[name]: told
    for name, told in {
        "SIGINT": "Ctrl-C",
        "SIGTERM": "SIGTERM, a polite kill",
        "SIGHUP": "SIGHUP, its terminal was closed",
    }.items()
    if name in signal.Signals.__members__  # Windows has no SIGHUP
}

_last = ["Ctrl-C"]  # the name of the one that came; a frame between here and the command's end may lose the exception


class Killed(KeyboardInterrupt):
    """A polite kill; unlike Ctrl-C it never means "go on with the best so far"."""


def told() -> str:
    """The name of the signal that ended the command."""
    return _last[0]


def end_politely() -> None:
    """SIGTERM and SIGHUP end a command as Ctrl-C does: its folder keeps its status."""
    for number in _heard():
        if number != signal.SIGINT:
            signal.signal(number, _killed)


def _heard() -> list[signal.Signals]:
    """Those that whoever started the process did not ask it to ignore, as nohup does."""
    return [number for number in NAMES if signal.getsignal(number) != signal.SIG_IGN]


def _killed(number: int, frame: FrameType | None) -> None:
    _last[0] = NAMES[signal.Signals(number)]
    raise Killed(_last[0])


@contextmanager
def driving() -> Iterator[None]:
    """While an arm may move: the first signal raises, the second ends the process at once.

    Only the main thread can be told of signals; in another one nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came = False

    def first_or_second(number: int, frame: FrameType | None) -> None:
        nonlocal came
        if came:
            sys.stderr.write("cell: ended at once by a second signal; the controller's watchdog stops the arm\n")
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        came = True
        _last[0] = NAMES[signal.Signals(number)]
        raise (KeyboardInterrupt if number == signal.SIGINT else Killed)(_last[0])

    before = {number: signal.signal(number, first_or_second) for number in _heard()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
