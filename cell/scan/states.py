"""`cell scan --states FILE`: a JSON line for each state that the client reads from the controller.

Names and units are those of sensor_msgs/JointState where it has them: `header.stamp`, `name`, `position` [rad]. The
stamp is UTC; of a controller with simulated time it counts from the start. Other programs can follow the file while it
grows.
"""

import json
import time
from collections.abc import Sequence
from pathlib import Path

from cell.errors import FileError, UsageError
from drivers.client import ControllerClient
from drivers.clock import Clock
from drivers.contract import FULL, Driver, RobotState

_NANO = 10**9


class StateLog:
    """Appends states to a file.

    Args:
        path: the file.
        names: of the joints.
        clock: of the client.

    Raises:
        FileError: if it cannot be written.
    """

    def __init__(self, path: Path, names: Sequence[str], clock: Clock) -> None:
        self._path, self._names, self._clock = path, list(names), clock
        self._epoch = 0.0 if clock.simulated else time.time() - clock.now()
        self._has_failed = False
        is_new = not (path.exists() or path.is_symlink())
        self._append("")
        if is_new:  # a refused scan leaves no empty file behind
            path.unlink(missing_ok=True)

    def record(self, state: RobotState) -> None:
        """Append a state; a file that fails raises once, so that the arm can still be stopped."""
        sec, nanosec = divmod(round((self._epoch + self._clock.now()) * _NANO), _NANO)
        row = {
            "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": ""},
            "name": self._names,
            "position": state.q.tolist(),
            "mode": state.mode.name.lower(),
            "at_rest": state.at_rest,
            "fault_code": state.fault_code,
            "fault_message": state.fault_message,
            "path": state.path / FULL,
            "override": state.override / FULL,
        }
        self._append(json.dumps(row, allow_nan=False) + "\n")

    def _append(self, line: str) -> None:
        if self._has_failed:
            return
        try:
            with self._path.open("a", encoding="utf-8", newline="\n") as file:
                file.write(line)
        except OSError as error:
            self._has_failed = True
            raise FileError(f"{self._path} cannot be written: {error.strerror or error}") from error


def record_states(driver: Driver, clock: Clock, path: Path, names: Sequence[str]) -> None:
    """Record the states that a driver reads.

    Raises:
        UsageError: if the driver is of another distribution, without the client of this project.
        FileError: if the file cannot be written.
    """
    if not isinstance(driver, ControllerClient):
        raise UsageError(f"--states needs a drivers.client.ControllerClient, and {type(driver).__name__} is none")
    driver.on_state = StateLog(path, names, clock).record
