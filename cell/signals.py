"""Signals that end a command: Ctrl-C, SIGTERM, and SIGHUP of a closed terminal.

While an arm moves (`stop_on_signal`), the first signal stops it with one second for the answer of the controller. The
second ends the process at once; then the watchdog of the controller stops the arm. Elsewhere a stage can catch Ctrl-C.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final

INTERRUPTED: Final = 130
"""Exit code of a command that a signal ended."""

NAMES: Final = {
    signal.Signals[name]: text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM", "SIGHUP": "SIGHUP, its terminal was closed"}.items()
    if name in signal.Signals.__members__  # Windows has no SIGHUP
}

_last = ["Ctrl-C"]  # kept here because a frame between the signal and the end of the command can lose the exception


_kept_folder: list[str] = []


def keep_folder(path: Path) -> None:
    """Remember the folder that an interrupted command keeps, for the sentence at its end."""
    _kept_folder[:] = [str(path)]


def kept_folder() -> str:
    """Return the folder that the interrupted command keeps; "" if there is none."""
    return _kept_folder[0] if _kept_folder else ""


class Killed(KeyboardInterrupt):
    """SIGTERM or SIGHUP; unlike Ctrl-C it never means "continue with the best result so far"."""


def last_signal() -> str:
    """Return the name of the signal that ended the command."""
    return _last[0]


def is_interruption(error: BaseException) -> bool:
    """Return whether a signal caused an error; compiled kernels turn `KeyboardInterrupt` into `SystemError`."""
    cause: BaseException | None = error
    while isinstance(cause, SystemError):
        cause = cause.__cause__
    return isinstance(cause, KeyboardInterrupt)


def handle_termination() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, so that its folder keeps its status."""
    for number in _handled():
        if number != signal.SIGINT:
            signal.signal(number, _kill)


def _handled() -> list[signal.Signals]:
    """Return the signals that the parent process does not ignore, as nohup does."""
    return [number for number in NAMES if signal.getsignal(number) != signal.SIG_IGN]


def _kill(number: int, frame: FrameType | None) -> None:
    _last[0] = NAMES[signal.Signals(number)]
    raise Killed(_last[0])


@contextmanager
def stop_on_signal() -> Iterator[None]:
    """While an arm can move: raise at the first signal, end the process at the second.

    Only the main thread receives signals; in another thread nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    is_stopping = False

    def stop_or_exit(number: int, frame: FrameType | None) -> None:
        nonlocal is_stopping
        if is_stopping:
            sys.stderr.write("cell: ended at once by a second signal; the controller's watchdog stops the arm\n")
            sys.stderr.flush()
            os._exit(INTERRUPTED)
        is_stopping = True
        _last[0] = NAMES[signal.Signals(number)]
        raise (KeyboardInterrupt if number == signal.SIGINT else Killed)(_last[0])

    before = {number: signal.signal(number, stop_or_exit) for number in _handled()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
