"""One execution on disk: `executions/<number>/` of a run folder, written so that a killed execution can be read.

The manifest stands from the first moment, every event is on disk when it happens, and every scan before the next move.
The plan beside it is never touched. docs/internals/run_folder.md is the contract.
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

from cell.errors import FileError
from cell.runs import folder as process
from cell.runs.folder import SCHEMA, RunFolder, json_text, versions
from cell.runs.run import EXECUTIONS, Run
from cell.runs.schema import Manifest, Resumed

EVENTS = "events.jsonl"
MOTION = "motion.npz"
EXECUTING = "execute and scan"
"""The stage that a report made later does not repeat."""


class ExecutionFolder(RunFolder):
    """The folder of an execution while it is written; stages, writers, `finish` and `fail` are those of a run folder.

    Unlike a run folder it has its final name from the beginning: a stopped execution is an execution.
    """

    @classmethod
    def make(
        cls,
        run: Run,
        argv: list[str],
        seed: int,
        options: Mapping[str, JsonValue],
        now: datetime,
        way: str | None = None,
    ) -> "ExecutionFolder":
        """Make the next execution of a run.

        Args:
            run: the run that is executed.
            argv: the command line, kept in the manifest.
            seed: seed of noise and pose errors.
            options: what was asked for, kept in the manifest; a report made later reads it there.
            now: time of the start (UTC).
            way: digest of what is driven, where that is not the plan's motion.

        Raises:
            FileError: if it cannot be made.
        """
        root = run.folder / EXECUTIONS
        try:
            root.mkdir(exist_ok=True)
            while True:
                taken = [int(path.name) for path in root.iterdir() if path.name.isdecimal()]
                path = root / f"{max(taken, default=0) + 1:04d}"
                try:
                    path.mkdir()
                    break
                except FileExistsError:
                    continue  # another execution took the number in between
            (path / "scans").mkdir()
            _sync_folder(root)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise FileError(
                f"an execution cannot be made in {root}: {reason}; the run folder must be writable"
            ) from error
        folder = cls(
            path,
            path,
            process.with_process(
                Manifest(
                    schema=SCHEMA,
                    status="running",
                    stage="start",
                    started=now.isoformat(timespec="seconds"),
                    argv=tuple(argv),
                    seed=seed,
                    options=dict(options),
                    plan=run.plan_sha256,
                    digest=run.digest,
                    **({} if way is None else {"way": way}),
                    versions=versions(),
                    seconds={},
                )
            ),
        )
        folder._write_manifest()
        return folder

    @classmethod
    def reopen(cls, path: Path, manifest: Manifest) -> "ExecutionFolder":
        """An execution that was made before, to make its report anew."""
        seconds = {name: took for name, took in manifest.seconds.items() if name == EXECUTING}
        entries = manifest.but(schema_version=SCHEMA, seconds=seconds)
        return cls(path, path, entries, "start", dict(manifest.artefacts))

    def resume(self, argv: list[str], driver: str, **way: object) -> None:
        """Take a stopped execution up again: it runs, in this process, and its manifest says how often it was begun.

        Args:
            argv: the command line.
            driver: URL of the controller.
            **way: of the way that was planned to go on, the entries `way` and `way_deg`.
        """
        now = datetime.now(UTC).isoformat(timespec="seconds")
        again = Resumed(at=now, argv=tuple(argv), driver=driver, after=self.manifest.status or "", **way)
        outdated = [name for name in self._artefacts if not name.startswith("scans/") and name != MOTION]
        kept = {name: sha for name, sha in sorted(self._artefacts.items()) if name not in outdated}
        self.manifest = process.with_process(self.manifest.without("exit_code", "reason"))
        self.note(status="running", resumed=(*self.manifest.resumed, again), artefacts=kept)
        for name in outdated:  # a report of what was there before; the manifest no longer promises it
            self.remove(name)

    def note(self, **entries: object) -> None:
        """Put entries into the manifest."""
        self.manifest = self.manifest.but(**entries)
        self._write_manifest()

    def event(self, seconds: float, name: str, **details: Any) -> None:
        """Append an event to events.jsonl; it is on disk when this returns.

        Args:
            seconds: the controller's clock since the start [s].
            name: what happened.
            details: more about it, as JSON types.
        """
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"t_s": round(seconds, 6), "utc": now, "event": name, **details}, allow_nan=False) + "\n"

        def append(path: Path) -> None:
            new = not path.exists()
            with path.open("ab+") as file:
                _cut_torn_line(file)
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
            if new:
                _sync_folder(path.parent)

        self._on_disk(EVENTS, append)

    def write_scan(self, name: str, **arrays: NDArray[Any]) -> None:
        """Write scans/`name`: whole or not at all; it and its sha256 in the manifest are on disk when this returns."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)

        self._on_disk(f"scans/{name}", lambda path: _replace(path, buffer.getvalue()))
        self.adopt(f"scans/{name}")
        self.note(artefacts=dict(sorted(self._artefacts.items())))

    def remove(self, name: str) -> None:
        """Take away an artefact that an earlier report made and this one has no data for."""
        (self.path / name).unlink(missing_ok=True)
        self._artefacts.pop(name, None)

    def _close(self, status: str, exit_code: int | None) -> None:
        self.manifest = self.manifest.without(*process.PROCESS_KEYS)  # they are for while it is written
        RunFolder._close(self, status, exit_code)

    def _write_manifest(self) -> None:
        self._on_disk("manifest.json", lambda path: _replace(path, json_text(self.manifest.as_json()).encode()))

    def _on_disk(self, name: str, write: Callable[[Path], None]) -> None:
        with self._writing(name):
            write(self.path / name)


def _replace(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; it is on disk, under its name, when this returns."""
    temporary = path.with_name(path.name + ".tmp")
    with temporary.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    _sync_folder(path.parent)


def _cut_torn_line(file: IO[bytes]) -> None:
    """A kill or a full disk can leave a part of the last line; it was never relied on, and the next one stays whole."""
    if not file.seek(0, os.SEEK_END):
        return
    file.seek(-1, os.SEEK_END)
    if file.read(1) != b"\n":
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)


def _sync_folder(path: Path) -> None:
    """A renamed file survives a power failure only when its folder is on disk as well; Windows has no such call."""
    if os.name == "posix":
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
