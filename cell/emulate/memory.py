"""What an emulated controller leaves on disk: where its arm stands, and a journal of what it executed.

A real arm does not teleport when its controller is restarted. So the position is on disk before a client is told of it,
written beside the file and renamed, so that a kill at any moment leaves the old or the new one. The file outlives the
process, not the machine: nothing is flushed to the disk's surface for it.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from cell import caches
from cell.errors import FileError, UsageError
from drivers.contract import RobotState
from drivers.emulated.endpoint import Event
from drivers.setpoints import AXES, SetPoints

SCHEMA = "cell-emulator-state/1"


class Memory:
    """The witness of an emulated controller.

    Args:
        state: file of the arm's position; None: it is forgotten.
        log: file of the journal, JSON lines, appended to; None: none.

    Attributes:
        axes: (6,) where the arm stood last, counts of 1e-4 deg, or None on the first start.
        boot: number of the last start, 0 on the first.
        ended_in_order: False where the last run was killed.

    Raises:
        FileError: if a file cannot be read or written.
    """

    def __init__(self, state: Path | None, log: Path | None) -> None:
        self._state = state
        try:
            self._log = None if log is None else log.open("a", encoding="utf-8")
        except OSError as error:
            raise FileError(f"{log} cannot be written: {error.strerror}; choose another --log") from error
        self.axes: SetPoints | None = None
        self.boot, self.ended_in_order = 0, True
        if state is not None and state.exists():
            self.axes, self.boot, self.ended_in_order = _read(state)
        self._written: tuple[object, ...] = ()

    def record_event(self, entry: Event) -> None:
        """Append one line."""
        if self._log is None:
            return
        try:
            self._log.write(json.dumps(entry) + "\n")
            self._log.flush()
        except OSError as error:
            raise FileError(f"{self._log.name} cannot be written: {error.strerror}; choose another --log") from error

    def record_state(self, state: RobotState) -> None:
        """Remember the position, before it is told."""
        self._write(state.axes, state.boot, ended_in_order=False)

    def close(self, state: RobotState) -> None:
        """The run ends in order; the arm stands."""
        self._write(state.axes, state.boot, ended_in_order=True)
        if self._log is not None:
            self._log.close()

    def _write(self, axes: SetPoints, boot: int, *, ended_in_order: bool) -> None:
        if self._state is None:
            return
        content = (axes.tolist(), boot, ended_in_order)
        if content == self._written:
            return
        text = json.dumps({"schema": SCHEMA, "axes": content[0], "boot": boot, "ended_in_order": ended_in_order})
        try:
            with caches.whole(self._state) as part:
                part.write_text(text + "\n", encoding="utf-8")
        except OSError as error:
            raise FileError(f"{self._state} cannot be written: {error.strerror}; choose another --state") from error
        self._written = content


def _read(path: Path) -> tuple[SetPoints, int, bool]:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        axes = np.array(content["axes"], dtype=np.int32)
        boot, in_order = int(content["boot"]), bool(content["ended_in_order"])
        if content["schema"] != SCHEMA or axes.ndim != 1 or len(axes) < AXES or not 0 <= boot <= 65535:
            raise ValueError("it is none")
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise UsageError(
            f"{path} is no state of an emulated arm ({error}); remove it, and the arm stands at --start"
        ) from error
    return axes, boot, in_order
