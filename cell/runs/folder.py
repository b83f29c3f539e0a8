"""Write run folders: `<name>.part` during the run, renamed when it is finished.

Every artefact is written as soon as its stage is done, so a killed run keeps its finished stages; the manifest names
the current stage. Artefacts contain no clock value and no machine path: equal inputs and seed give equal bytes.
Nothing is pickled. docs/internals/run_folder.md describes the layout, `SCHEMA` is its version.
"""

import errno
import functools
import hashlib
import json
import os
import platform
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from cell import signals
from cell.errors import CellError, FileError
from cell.runs import digest, ply
from cell.runs.schema import Manifest, NamedFile
from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh

SCHEMA = "scan-cell/run/3"
"""Version of the layout. A change needs a line in CHANGELOG.md."""

_REDRAWN = (".png", ".html", ".xml")
"""Pictures, pages and models: removed from a full disk if they are incomplete."""

_VERSIONS_OF = (
    "scan-cell", "numpy", "scipy", "mujoco", "embreex", "trimesh", "fast-simplification", "libigl", "networkx",
)  # fmt: skip


@dataclass(slots=True)
class RunFolder:
    """A run folder that is being written. Use `create`, the `stage` context, the writers, and `finish` or `fail`.

    Attributes:
        target: path of the finished folder.
        path: current path (`target` with `.part` appended until it is finished).
    """

    target: Path
    path: Path
    manifest: Manifest
    _artefacts: dict[str, str] = field(default_factory=dict)

    @classmethod
    def create(
        cls, out: Path | None, argv: list[str], seed: int, inputs: Mapping[str, str], now: datetime
    ) -> "RunFolder":
        """Create the folder.

        Args:
            out: path; None means `sim_runs/<UTC>-<hash>` below the working directory.
            argv: command line for the manifest.
            seed: seed of every random choice.
            inputs: sha256 of each input (part, scene, settings).
            now: time of the start (UTC).
        """
        short = hashlib.sha256(json.dumps([dict(inputs), seed], sort_keys=True).encode()).hexdigest()[:8]
        target = out if out is not None else Path("sim_runs") / f"{now:%Y%m%dT%H%M%SZ}-{short}"
        if target.name in ("", "."):
            raise FileError(f"the run folder {target} has no name; give --out the path of a new folder")
        path = target.with_name(target.name + ".part")
        _move_aside(path)
        for existing in (target, path):
            if existing.exists():
                raise FileError(
                    f"the run folder {existing} exists already and is never overwritten; choose another --out or "
                    "remove it"
                )
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise FileError(
                f"the run folder {path} cannot be created: {_reason(error)}; choose a writable --out"
            ) from error
        folder = cls(
            target,
            path,
            Manifest(
                schema=SCHEMA,
                status="running",
                stage="start",
                start_time=now.isoformat(timespec="seconds"),
                argv=tuple(argv),
                seed=seed,
                inputs=dict(inputs),
                versions=versions(),
                seconds={},
            ),
        )
        folder._write_manifest()
        return folder

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Enter a stage: write its name to the manifest and add its duration at the end."""
        self.manifest = self.manifest.but(stage=name)
        self._write_manifest()
        start = perf_counter()
        try:
            yield
        finally:
            seconds = self.manifest.seconds
            took = round(seconds.get(name, 0.0) + perf_counter() - start, 3)
            self.manifest = self.manifest.but(seconds={**seconds, name: took})

    @contextmanager
    def keep_on_failure(self) -> Iterator[None]:
        """Keep the unfinished folder, with status, stage and reason, if the block raises."""
        try:
            yield
        except (CellError, PlannerError) as error:
            self.fail("failed", getattr(error, "exit_code", CellError.exit_code), str(error))
            raise
        except BaseException as error:
            if signals.is_interruption(error):
                self.fail("interrupted", signals.INTERRUPTED, f"stopped by {signals.last_signal()}")
                signals.keep_folder(self.path)
            else:
                self.fail("failed", CellError.exit_code, f"{type(error).__name__}: {error}")
            raise

    def write_text(self, name: str, text: str) -> None:
        """Write a text artefact in UTF-8."""
        self._write(name, text.encode())

    def write_json(self, name: str, content: Mapping[str, JsonValue]) -> None:
        """Write a JSON artefact; `schema` becomes its first key."""
        self.write_text(name, json_text({"schema": self.manifest.schema_version, **content}))

    def write_arrays(self, name: str, **arrays: NDArray[Any]) -> None:
        """Write arrays as a compressed .npz."""
        with self._writing(name, name):
            np.savez_compressed(self.path / name, allow_pickle=False, **arrays)
        self.adopt(name)

    def write_bytes(self, name: str, pieces: Iterable[bytes]) -> None:
        """Write a binary artefact."""
        self._write(name, b"".join(pieces))

    def write_mesh(self, name: str, mesh: TriangleMesh) -> None:
        """Write a mesh as binary PLY in millimetres, with the region of each face if it has regions."""
        self._write(name, ply.mesh_bytes(mesh))

    def adopt(self, name: str) -> None:
        """Record the sha256 of an artefact that another function wrote into the folder."""
        with self._writing(name):
            self._artefacts[name] = hashlib.sha256((self.path / name).read_bytes()).hexdigest()

    def record_files(self, files: tuple[NamedFile, ...], overrides: tuple[str, ...] | None) -> None:
        """Record the user's files that the plan depends on, and the keys of the scene that are not from its file."""
        self.manifest = self.manifest.but(overrides=overrides, **({"files": files} if files else {}))

    def seal(self) -> None:
        """Record the digest of the driving artefacts, which must all be written."""
        self.manifest = self.manifest.but(digest=digest.plan_digest(self._artefacts))

    def finish(self, exit_code: int | None, status: str = "finished") -> Path:
        """Complete the manifest, rename the folder to its final name and return its path."""
        self._close(status, exit_code)
        with self._writing(self.target.name):
            self.path.rename(self.target)
        self.path = self.target
        return self.target

    def fail(self, status: str, exit_code: int, reason: str) -> None:
        """Write status, stage and reason to the manifest of the unfinished folder.

        Never raises, because it is called while another error is handled.
        """
        self.manifest = self.manifest.but(reason=reason)
        try:
            self._close(status, exit_code)
        except FileError:
            # A full disk refuses this manifest as well, until there is room; otherwise the earlier one names the stage.
            with suppress(FileError, OSError):
                for path in self.path.iterdir():
                    if path.suffix in _REDRAWN and path.name not in self._artefacts:
                        path.unlink()
                self._write_manifest()

    def discard(self) -> None:
        """Remove the unfinished folder."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _close(self, status: str, exit_code: int | None) -> None:
        artefacts = dict(sorted(self._artefacts.items()))
        self.manifest = self.manifest.but(status=status, exit_code=exit_code, artefacts=artefacts)
        self._write_manifest()

    def _write_manifest(self) -> None:
        # Through a temporary file, so that a full disk leaves the last good manifest in place.
        temporary = self.path / "manifest.json.tmp"
        with self._writing("manifest.json", temporary.name):
            temporary.write_text(json_text(self.manifest.as_json()), encoding="utf-8")
            temporary.replace(self.path / "manifest.json")

    def _write(self, name: str, content: bytes) -> None:
        with self._writing(name, name):
            (self.path / name).write_bytes(content)
        self._artefacts[name] = hashlib.sha256(content).hexdigest()

    @contextmanager
    def _writing(self, name: str, incomplete: str = "") -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if incomplete:  # it would keep the disk full, and the manifest could not state the failure
                with suppress(OSError):
                    (self.path / incomplete).unlink()
            raise FileError(
                f"{self.path / name} cannot be written: {_reason(error)}; finished artefacts remain in {self.path}"
            ) from error


def _move_aside(path: Path) -> None:
    """Rename the `.part` folder of an ended run to `.part.1`, `.part.2`, ..., so that a new run can use the name."""
    try:
        status = json.loads((path / "manifest.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return  # not a run folder, or none at all
    if status == "running":
        return  # it may still be running
    number = next(n for n in range(1, 10_000) if not path.with_name(f"{path.name}.{n}").exists())
    try:
        path.rename(path.with_name(f"{path.name}.{number}"))
    except OSError as error:
        raise FileError(f"{path} cannot be renamed: {_reason(error)}; choose another --out") from error


def json_text(content: Mapping[str, JsonValue]) -> str:
    """Return JSON with two-space indent, a final newline and no NaN."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full"
    return (error.strerror or str(error)).lower() if error.errno is not None else str(error)


def versions() -> dict[str, str]:
    """Return the versions of Python, of this project and of the packages that affect results."""
    return {"python": platform.python_version(), **{name: _version(name) for name in _VERSIONS_OF}}


@functools.cache  # reading the metadata of all packages takes 50 ms, and an exploration writes 30 folders
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


PROCESS_KEYS = ("pid", "pid_start", "machine")
"""Manifest entries of the writing process, present while the folder is written."""


def with_process(manifest: Manifest) -> Manifest:
    """Return the manifest with the entries of the current process."""
    pid = os.getpid()
    return manifest.but(pid=pid, pid_start=_stat(pid)[1], machine=platform.node())


def is_running(manifest: Manifest) -> bool:
    """Return whether the process of a manifest runs on this machine; False if that is unknown.

    Process numbers are reused, so the start time must agree as well on systems that report it (Linux).
    """
    pid = manifest.pid
    if os.name != "posix" or pid is None or pid <= 0 or manifest.machine != platform.node():
        return False  # on other systems signal 0 is not a query
    try:
        os.kill(pid, 0)
    except PermissionError:
        pass  # another user's process, but it runs
    except (OSError, OverflowError):
        return False
    state, began = _stat(pid)
    return state != "Z" and began == manifest.pid_start


def _stat(pid: int) -> tuple[str, int | None]:
    """Return the state of a process and its start in ticks since boot; ("", None) if they are not reported."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return fields[0], int(fields[19])
    except (OSError, ValueError, IndexError):
        return "", None
