"""Folder of an execution, `executions/<number>/` of a run folder, written so that a killed execution can be read.

The manifest exists from the first moment, every event is on disk when it happens, and every scan before the next move.
The plan is never changed. docs/internals/run_folder.md is the contract.
"""

import io
import json
import os
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from cell.files import file_errors
from cell.runs.folder import PROCESS_KEYS, SCHEMA, RunFolder, json_text, versions, with_process
from cell.runs.run import EXECUTIONS, Run
from cell.runs.schema import Manifest, Resumption

EVENTS = "events.jsonl"
MOTION = "motion.npz"
EXECUTING = "execute and scan"
"""Stage that a later report does not repeat."""


class ExecutionFolder(RunFolder):
    """Folder of an execution while it is written; stages, writers, `finish` and `fail` are those of a run folder.

    Unlike a run folder it has its final name from the start: a stopped execution is an execution.
    """

    @classmethod
    def make(
        cls,
        run: Run,
        argv: list[str],
        seed: int,
        options: Mapping[str, JsonValue],
        now: datetime,
        path_digest: str | None = None,
    ) -> "ExecutionFolder":
        """Make the folder of the next execution of a run.

        Args:
            run: the executed run.
            argv: command line for the manifest.
            seed: seed of noise and pose errors.
            options: for the manifest, where a later report reads them.
            now: time of the start (UTC).
            path_digest: digest of the driven path if it is not the plan's motion.

        Raises:
            FileError: if it cannot be made.
        """
        root = run.folder / EXECUTIONS
        with file_errors(f"an execution cannot be made in {root}", "the run folder must be writable"):
            root.mkdir(exist_ok=True)
            while True:
                numbers = [int(path.name) for path in root.iterdir() if path.name.isdecimal()]
                path = root / f"{max(numbers, default=0) + 1:04d}"
                try:
                    path.mkdir()
                    break
                except FileExistsError:
                    continue  # another execution took the number in the meantime
            (path / "scans").mkdir()
            _sync_folder(root)
        manifest = Manifest(
            schema=SCHEMA,
            status="running",
            stage="start",
            start_time=now.isoformat(timespec="seconds"),
            argv=tuple(argv),
            seed=seed,
            options=dict(options),
            plan=run.plan_sha256,
            digest=run.digest,
            **({} if path_digest is None else {"path_digest": path_digest}),
            versions=versions(),
            seconds={},
        )
        folder = cls(path, path, with_process(manifest))
        folder._write_manifest()
        return folder

    @classmethod
    def reopen(cls, path: Path, manifest: Manifest) -> "ExecutionFolder":
        """Open the folder of an earlier execution, to report or resume it."""
        seconds = {name: took for name, took in manifest.seconds.items() if name == EXECUTING}
        return cls(path, path, manifest.but(schema_version=SCHEMA, seconds=seconds), dict(manifest.artefacts))

    def resume(self, argv: list[str], driver: str, **approach: object) -> None:
        """Mark a stopped execution as running in this process, and record its continuation in the manifest.

        Args:
            argv: command line.
            driver: URL of the controller.
            **approach: entries `path_digest` and `path_deg` of an approach path.
        """
        now = datetime.now(UTC).isoformat(timespec="seconds")
        continued = Resumption(
            time=now, argv=tuple(argv), driver=driver, previous_status=self.manifest.status or "", **approach
        )
        outdated = [name for name in self._artefacts if not name.startswith("scans/") and name != MOTION]
        artefacts = {name: sha for name, sha in sorted(self._artefacts.items()) if name not in outdated}
        self.manifest = with_process(self.manifest.without("exit_code", "reason"))
        self.note(status="running", resumptions=(*self.manifest.resumptions, continued), artefacts=artefacts)
        for name in outdated:  # the earlier report, which the manifest no longer lists
            self.remove(name)

    def note(self, **entries: object) -> None:
        """Write entries to the manifest."""
        self.manifest = self.manifest.but(**entries)
        self._write_manifest()

    def event(self, seconds: float, name: str, **details: Any) -> None:
        """Append an event to events.jsonl; it is on disk when this returns.

        Args:
            seconds: controller's clock since the start [s].
            name: type of the event.
            details: JSON values.
        """
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"t_s": round(seconds, 6), "utc": now, "event": name, **details}, allow_nan=False) + "\n"

        def append(path: Path) -> None:
            is_new = not path.exists()
            with path.open("ab+") as file:
                _cut_torn_line(file)
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
            if is_new:
                _sync_folder(path.parent)

        self._on_disk(EVENTS, append)

    def write_scan(self, name: str, **arrays: NDArray[Any]) -> None:
        """Write scans/`name` atomically; it and its sha256 in the manifest are on disk when this returns."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        self._on_disk(f"scans/{name}", lambda path: _replace(path, buffer.getvalue()))
        self.adopt(f"scans/{name}")
        self.note(artefacts=dict(sorted(self._artefacts.items())))

    def remove(self, name: str) -> None:
        """Remove an artefact of an earlier report for which there are no data now."""
        (self.path / name).unlink(missing_ok=True)
        self._artefacts.pop(name, None)

    def _close(self, status: str, exit_code: int | None) -> None:
        self.manifest = self.manifest.without(*PROCESS_KEYS)
        RunFolder._close(self, status, exit_code)

    def _write_manifest(self) -> None:
        self._on_disk("manifest.json", lambda path: _replace(path, json_text(self.manifest.as_json()).encode()))

    def _on_disk(self, name: str, write: Callable[[Path], None]) -> None:
        with self._writing(name, f"{name}.tmp"):
            write(self.path / name)


def _replace(path: Path, content: bytes) -> None:
    """Write a file atomically; it is on disk, under its name, when this returns."""
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    _sync_folder(path.parent)


def _cut_torn_line(file: IO[bytes]) -> None:
    """Remove an incomplete last line, which a kill or a full disk can leave and which no reader uses."""
    if not file.seek(0, os.SEEK_END):
        return
    file.seek(-1, os.SEEK_END)
    if file.read(1) != b"\n":
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)


def _sync_folder(path: Path) -> None:
    """Flush a folder: a renamed file survives a power failure only then. Windows has no such call."""
    if os.name == "posix":
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
