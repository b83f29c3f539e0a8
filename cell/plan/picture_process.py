"""The report's pictures, drawn beside the work by a process of their own: matplotlib is never imported by the planner.

The process imports matplotlib while the plan is made, and forks for what rays draw, so that several pictures are drawn
at a time. Arrays go to it through a pipe as .npz, without pickled objects; it ends when the pipe does.
"""

import gc
import io
import os
import signal
import struct
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cell.session import PlotQueue

_LENGTH = struct.Struct("<q")
_BY_RAYS = ("part_and_views", "cell_with_arm")  # take as long as all others together


class Drawing(PlotQueue):
    """Pictures on their way into a run folder; see `beside`."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process
        self._sent: list[Path] = []
        self._waiting: SimpleQueue[bytes | None] = SimpleQueue()
        self._writer = Thread(target=self._write, name="pictures", daemon=True)
        self._writer.start()

    def send(self, plot: str, path: Path, **arrays: ArrayLike) -> None:
        """Have a picture drawn.

        Args:
            plot: function of `cell.plan.pictures` or `cell.plan.picture_jobs`.
            path: PNG to write.
            arrays: its arguments; numbers and words arrive as arrays without dimension.
        """
        self._post(plot, path, **arrays)
        self._sent.append(path)

    def part_ready(self, folder: Path) -> None:
        """Have the part of a run folder made ready to be drawn: its meshes are there."""
        self._post("part_ready", folder)

    def cell_ready(self, folder: Path) -> None:
        """Have the cell of a run folder made ready to be drawn: its files are there."""
        self._post("cell_ready", folder)

    def finish(self) -> list[Path]:
        """Wait until all is drawn; see `PlotQueue`."""
        self._wait()
        return self._sent

    def _post(self, what: str, path: Path, **arrays: ArrayLike) -> None:
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, what=np.array(what), path=np.array(str(path)), **arrays)
        self._waiting.put(_LENGTH.pack(content.getbuffer().nbytes) + content.getvalue())

    def _wait(self) -> None:
        self._waiting.put(None)
        self._writer.join()
        _, said = self._process.communicate()
        if self._process.returncode:
            raise RuntimeError(f"pictures were not drawn: {said.decode(errors='replace').strip()[-2000:]}")

    def _write(self) -> None:
        """Hand on what was sent: the pipe holds less than a picture, and the process reads after drawing."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError, ValueError):  # the process has ended, its pipe may be closed: `finish` says why
            while (content := self._waiting.get()) is not None:
                self._process.stdin.write(content)
                self._process.stdin.flush()


@contextmanager
def beside() -> Iterator[Drawing]:
    """A process that draws; it is ended with the block, whatever happens in it, but for pictures that are begun."""
    command = [sys.executable, "-P", "-c", "from cell.plan.picture_process import serve; serve()"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=subprocess.DEVNULL, stderr=pipe) as process:
        try:
            yield Drawing(process)
        finally:
            if process.poll() is None:
                process.kill()


def serve() -> None:
    """Draw what comes through stdin until it ends: the process of `beside`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the planner's; the pipe ends with it
    gc.disable()  # for the seconds that this process lives there is nothing to collect
    from cell.plan import picture_jobs, pictures  # noqa: F401  # they take seconds: before they are asked for

    forks, failed = list[int](), False
    while length := sys.stdin.buffer.read(_LENGTH.size):
        with np.load(io.BytesIO(sys.stdin.buffer.read(*_LENGTH.unpack(length))), allow_pickle=False) as content:
            arguments = {name: content[name][()] for name in content.files}
        what, path = str(arguments.pop("what")), Path(str(arguments.pop("path")))
        fork = os.fork() if what in _BY_RAYS and hasattr(os, "fork") else None  # Windows has no forks
        if fork:
            forks.append(fork)
            continue
        try:
            draw(what, path, **arguments)
        except Exception:
            traceback.print_exc()  # told when all are waited for
            failed = True
        if fork == 0:
            os._exit(failed)
    ended = [os.waitpid(fork, 0)[1] for fork in forks]
    os._exit(failed or any(ended))  # what is left here need not be taken down: that would take as long as a picture


def draw(what: str, path: Path, **arguments: Any) -> None:
    """Draw one picture here, or make ready what pictures need; arguments as in `Drawing.send`."""
    from cell.plan import picture_jobs, pictures  # matplotlib takes a second: that is why this is a process of its own

    getattr(picture_jobs if hasattr(picture_jobs, what) else pictures, what)(path, **arguments)
