"""Plans, edits and simulated executions in a process of their own, so that the page stays live.

The process reads a job as JSON from stdin and writes progress and result as lines of JSON to stdout. It ends with its
job; a cancelled job is terminated, and the unfinished folder is removed.
"""

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from planner.processes import python_command

Report = Callable[[Mapping[str, Any]], None]
"""Receives `stage`, `done` and `total`, `note`, or the end: `folder` and `exit_code`, or `failed`."""


class Job:
    """A running job.

    Args:
        task: `command` (plan, edit or scan), `source` (scene file or run folder), `out` and `options`.
        report: called in a thread of the job.
    """

    def __init__(self, task: Mapping[str, Any], report: Report) -> None:
        self.task, self._report, self._is_cancelled = task, report, False
        words = python_command("from cell.live.jobs import serve; serve()")
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True, encoding="utf-8")
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether the job has not ended."""
        return self._thread.is_alive()

    def cancel(self) -> None:
        """End the process, remove its unfinished folder, and report nothing more."""
        self._is_cancelled = True
        self._process.terminate()
        self._thread.join()
        out = self.task.get("out")
        if out is not None:
            shutil.rmtree(Path(f"{out}.part"), ignore_errors=True)

    def _read(self) -> None:
        process, has_ended = self._process, False
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        with process:
            errors: list[str] = []
            other = threading.Thread(target=_collect, args=(process.stderr, errors), daemon=True)
            other.start()
            with suppress(OSError):  # cancelled before it has read its job
                process.stdin.write(json.dumps(self.task))
                process.stdin.close()
            for line in process.stdout:
                message = json.loads(line)
                has_ended |= "folder" in message or "failed" in message
                if not self._is_cancelled:
                    self._report(message)
            other.join()
        if not has_ended and not self._is_cancelled:
            self._report({"failed": f"the process of the job ended: {''.join(errors).strip()[-500:]}"})


def _collect(stream: IO[str], lines: list[str]) -> None:
    lines.extend(stream)


def serve() -> None:
    """Run the job of stdin: the process of a `Job`."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C concerns the server, which ends this process
    task, lines = json.loads(sys.stdin.read()), sys.stdout
    sys.stdout = sys.stderr  # no library writes between the lines

    def send(message: Mapping[str, Any]) -> None:
        lines.write(json.dumps(message) + "\n")
        lines.flush()

    from cell.errors import CellError
    from planner.errors import PlannerError

    try:
        send(_run(task, send))
    except (CellError, PlannerError) as error:
        send({"failed": str(error)})


def _run(task: Mapping[str, Any], send: Callable[[Mapping[str, Any]], None]) -> Mapping[str, Any]:
    """Run a job and return its last message."""
    from cell import api
    from cell.plan.edit_options import Edit
    from cell.scan.options import ScanOptions
    from cell.scene.options import parse_options
    from cell.session import LoggedProgress

    class Reporter(LoggedProgress):
        def note(self, sentence: str) -> None:
            send({"note": sentence})

    reporter = Reporter(lambda stage, n_done, total: send({"stage": stage, "done": n_done, "total": total}))
    source, out = Path(task["source"]), task.get("out")
    if task["command"] == "scan":
        options = ScanOptions(driver="sim://", realtime=True)  # never a real controller
        executed = api.scan(source, options, progress=reporter, argv=["scan", str(source), "--realtime"])
        return {"folder": str(executed.folder), "exit_code": executed.exit_code}
    if task["command"] == "edit":
        edit = parse_options(Edit, task["options"])
        run = api.edit(source, edit, out=out, progress=reporter, argv=task["argv"])
    else:
        run = api.plan(scene=source, out=out, progress=reporter, argv=task["argv"])
    return {"folder": str(run.folder), "exit_code": run.exit_code}
