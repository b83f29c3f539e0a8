"""Plots of a run, drawn in a separate process while the command continues: the planner never imports matplotlib.

The process imports matplotlib while the plan is made, and forks for ray-traced pictures, so that several are drawn at a
time. Arrays reach it through a pipe as .npz without pickled objects; it ends with the pipe.
"""

import gc
import io
import os
import signal
import struct
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from cell.session import PlotQueue
from planner.processes import python_command

_LENGTH = struct.Struct("<q")
_RAY_TRACED = ("part_and_views", "cell_with_arm")  # take as long as all others together


class PlotProcess(PlotQueue):
    """Queue of plots that a process draws; see `plot_process`."""

    def __init__(self, process: "subprocess.Popen[bytes]", errors: IO[bytes]) -> None:
        self._process, self._errors = process, errors
        self._sent: list[Path] = []
        self._waiting: SimpleQueue[bytes | None] = SimpleQueue()
        self._writer = Thread(target=self._write, name="plots", daemon=True)
        self._writer.start()

    def send(self, plot: str, path: Path, **arrays: ArrayLike) -> None:
        """Queue a plot; see `PlotQueue`."""
        self._post(plot, path, **arrays)
        self._sent.append(path)

    def part_ready(self, folder: Path) -> None:
        """Prepare the part for drawing; see `PlotQueue`."""
        self._post("part_ready", folder)

    def cell_ready(self, folder: Path) -> None:
        """Prepare the cell for drawing; see `PlotQueue`."""
        self._post("cell_ready", folder)

    def finish(self) -> list[Path]:
        """Wait until all plots are drawn and return their files; see `PlotQueue`."""
        self._wait()
        return self._sent

    def _post(self, plot: str, path: Path, **arrays: ArrayLike) -> None:
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, plot=np.array(plot), path=np.array(str(path)), **arrays)
        self._waiting.put(_LENGTH.pack(content.getbuffer().nbytes) + content.getvalue())

    def _wait(self) -> None:
        self._waiting.put(None)
        self._writer.join()
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        if self._process.wait():
            self._errors.seek(0)
            text = self._errors.read().decode(errors="replace")
            raise RuntimeError(f"plots were not drawn: {text.strip()[-2000:]}")

    def _write(self) -> None:
        """Write to the pipe: it holds less than a plot, and the process reads after drawing."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError, ValueError):  # the process has ended, its pipe may be closed: `finish` reports
            while (content := self._waiting.get()) is not None:
                self._process.stdin.write(content)
                self._process.stdin.flush()


@contextmanager
def plot_process() -> Iterator[PlotQueue]:
    """Start a process that draws; it ends with the block, except for plots that are begun."""
    command = python_command("from cell.report.plots import serve; serve()")
    # Messages go to a file: a full pipe would stop the process, which then would not read the next plot.
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors) as process,
    ):
        try:
            yield PlotProcess(process, errors)
        finally:
            if process.poll() is None:
                process.kill()


def serve() -> None:
    """Draw the plots that arrive at stdin until it ends: the process of `plot_process`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C concerns the planner; the pipe ends with it
    gc.disable()  # the process ends within seconds
    from cell.report import figures  # noqa: F401  # takes seconds: imported before the first plot arrives

    forks, has_failed = list[int](), False
    while length := sys.stdin.buffer.read(_LENGTH.size):
        with np.load(io.BytesIO(sys.stdin.buffer.read(*_LENGTH.unpack(length))), allow_pickle=False) as content:
            arguments = {name: content[name][()] for name in content.files}
        plot, path = str(arguments.pop("plot")), Path(str(arguments.pop("path")))
        fork = os.fork() if plot in _RAY_TRACED and hasattr(os, "fork") else None  # Windows has no forks
        if fork:
            forks.append(fork)
            continue
        try:
            draw(plot, path, **arguments)
        except Exception:
            traceback.print_exc()  # reported when all plots are waited for
            has_failed = True
        if fork == 0:
            os._exit(has_failed)
    ended = [os.waitpid(fork, 0)[1] for fork in forks]
    os._exit(has_failed or any(ended))  # tearing down takes as long as a plot


def draw(plot: str, path: Path, **arguments: Any) -> None:
    """Draw one plot in this process, or prepare for plots; arguments as in `PlotQueue.send`."""
    from cell.report import figures  # importing matplotlib takes a second: hence the separate process

    getattr(figures, plot)(path, **arguments)
