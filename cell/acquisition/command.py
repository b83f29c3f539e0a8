"""`--acquire command:CMD`: a program of the user's is called at each stop and writes the points."""

import json
import logging
import shlex
import subprocess
from pathlib import Path

import numpy as np

from cell.acquisition.files import frame_and_units
from cell.acquisition.sources import Acquired, Context, View
from cell.errors import FileError, UsageError
from cell.metrology import point_files
from planner.ports import ARM_AXES

log = logging.getLogger(__name__)

_TRIES = 3


class Command:
    """Calls `CMD VIEW POSE OUT`: the view's number, a JSON file with the pose, the PLY file to write.

    Attributes:
        source: the command, frame and unit.
    """

    def __init__(self, argument: str, context: Context) -> None:
        """Split the command into words, as a shell would.

        Raises:
            UsageError: if there is none, or frame and units are not said.
        """
        try:
            self._words = shlex.split(argument)
        except ValueError as error:
            raise UsageError(f"--acquire command:{argument} cannot be read: {error}") from error
        if not self._words:
            raise UsageError("--acquire command: names no command; give --acquire 'command:my_scanner --fast'")
        self._frame, self._unit, self._metres = frame_and_units(context)
        self._timeout, self._say = float(context.options["acquire_timeout_s"]), context.say
        self._raw = context.folder / "raw"
        self.source = f"command {argument} ({self._frame} frame, {self._unit})"

    def take(self, view: View) -> Acquired | None:
        """The points that the command wrote; None where it failed every time."""
        self._raw.mkdir(exist_ok=True)
        out, pose = self._raw / f"{view.stop:04d}.ply", self._raw / f"{view.stop:04d}.json"
        pose.write_text(json.dumps(_described(view), indent=1), encoding="utf-8")
        why = ""
        for number in range(1, _TRIES + 1):
            out.unlink(missing_ok=True)
            code, said = self._called(view, pose, out)
            log.info("view %d, call %d of %s: %s\n%s", view.stop, number, self._words[0], code, said)
            why = f"{self._words[0]} {code}"
            if code == "ended with code 0":
                try:
                    points = point_files.read(out) * self._metres
                except FileError as error:
                    why = str(error)
                else:
                    return Acquired(points, self._frame, told={"calls": number, "said": said[-2000:]})
        self._say(f"view {view.stop} is missing: {why} ({_TRIES} calls); cell scan --resume takes it")
        return None

    def _called(self, view: View, pose: Path, out: Path) -> tuple[str, str]:
        """How one call ended, and what it said."""
        try:
            done = subprocess.run(
                [*self._words, str(view.stop), str(pose), str(out)],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=self._timeout, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            return f"took longer than {self._timeout:g} s", (error.stdout or b"").decode("utf-8", "replace")
        except OSError as error:
            return f"cannot be started: {error.strerror or error}", ""
        return f"ended with code {done.returncode}", done.stdout.decode("utf-8", "replace")


def _described(view: View) -> dict[str, object]:
    """What the pose file says: frames as rows of 4 x 4 matrices, metres; angles in degrees."""
    T_base_scanner = view.T_base_object @ view.T_object_scanner
    return {
        "view": view.stop,
        "candidate": view.candidate,
        "units": "m, deg",
        "q_deg": np.rad2deg(view.q[:ARM_AXES]).tolist(),
        **({"e_deg": np.rad2deg(view.q[ARM_AXES:]).tolist()} if len(view.q) > ARM_AXES else {}),
        "T_base_flange": view.T_base_flange.tolist(),
        "T_base_scanner": T_base_scanner.tolist(),
        "T_object_scanner": view.T_object_scanner.tolist(),
    }
