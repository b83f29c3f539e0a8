"""The run folder: an immutable plan on disk, written as `<name>.part` and renamed when it is finished.

Every artefact is on disk as soon as its stage is done, so that a killed run keeps what it had finished; the manifest
always tells the stage. Artefacts hold no clock value and no machine path: equal inputs and seed give equal bytes.
Nothing is pickled. The layout is described in docs/internals/run_folder.md and versioned by `SCHEMA`.
"""

import errno
import hashlib
import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
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

SCHEMA, WITH_TABLE = "scan-cell/run/1", "scan-cell/run/2"
"""Versions of the layout: that of every plan whose part stands, and that of one whose part a rotary table turns. They
change together with a line in CHANGELOG.md."""

_VERSIONS_OF = (
    "scan-cell", "numpy", "scipy", "mujoco", "embreex", "trimesh", "fast-simplification", "libigl", "networkx",
)  # fmt: skip


@dataclass(slots=True)
class RunFolder:
    """An open run folder. Use `create`, the `stage` context, the writers, and `finish` or `fail`.

    Attributes:
        target: where the finished folder will be.
        path: where it is now (`target` with `.part` behind until it is finished).
    """

    target: Path
    path: Path
    manifest: Manifest
    _stage: str = "start"
    _artefacts: dict[str, str] = field(default_factory=dict)

    @classmethod
    def create(
        cls,
        out: Path | None,
        argv: list[str],
        seed: int,
        inputs: Mapping[str, str],
        now: datetime,
        schema: str = SCHEMA,
    ) -> "RunFolder":
        """Make the folder.

        Args:
            out: the folder to make; None makes `sim_runs/<UTC>-<hash>` below the working directory.
            argv: the command line, kept in the manifest.
            seed: seed of every random choice.
            inputs: sha256 per input (part, scene, settings).
            now: time of the start (UTC).
            schema: of its files.

        Raises:
            FileError: if it exists already or cannot be made.
        """
        short = hashlib.sha256(json.dumps([dict(inputs), seed], sort_keys=True).encode()).hexdigest()[:8]
        target = out if out is not None else Path("sim_runs") / f"{now:%Y%m%dT%H%M%SZ}-{short}"
        if target.name in ("", "."):
            raise FileError(f"the run folder {target} has no name of its own; give --out a new folder's path")
        path = target.with_name(target.name + ".part")
        _move_aside(path)
        for taken in (target, path):
            if taken.exists():
                raise FileError(
                    f"the run folder {taken} exists already and is never overwritten; choose another --out or remove it"
                )
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise FileError(
                f"the run folder {path} cannot be made: {_reason(error)}; choose a writable --out"
            ) from error
        folder = cls(
            target,
            path,
            Manifest(
                schema=schema,
                status="running",
                stage="start",
                started=now.isoformat(timespec="seconds"),
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
        """Name the stage that runs and record its seconds; a failure inside is reported under this name."""
        self._stage = name
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
    def kept_on_failure(self) -> Iterator[None]:
        """Work that ends early keeps the folder with what was finished, its status, stage and reason."""
        try:
            yield
        except KeyboardInterrupt:
            self.fail("interrupted", signals.INTERRUPTED, f"stopped by {signals.told()}")
            raise
        except (CellError, PlannerError) as error:
            self.fail("failed", getattr(error, "exit_code", CellError.exit_code), str(error))
            raise
        except BaseException as error:
            self.fail("failed", CellError.exit_code, f"{type(error).__name__}: {error}")
            raise

    def write_text(self, name: str, text: str) -> None:
        """Write a text artefact (UTF-8, as given)."""
        self._write(name, text.encode())

    def write_json(self, name: str, content: Mapping[str, JsonValue]) -> None:
        """Write a JSON artefact; `schema` is put in front."""
        self.write_text(name, json_text({"schema": self.manifest.schema_version, **content}))

    def write_arrays(self, name: str, **arrays: NDArray[Any]) -> None:
        """Write a compressed .npz without pickled objects."""
        with self._writing(name):
            np.savez_compressed(self.path / name, allow_pickle=False, **arrays)
        self.adopt(name)

    def write_bytes(self, name: str, pieces: Iterable[bytes]) -> None:
        """Write a binary artefact."""
        self._write(name, b"".join(pieces))

    def write_mesh(self, name: str, mesh: TriangleMesh) -> None:
        """Write a mesh as binary PLY in millimetres, with the region of each face where it has such."""
        self._write(name, ply.mesh_bytes(mesh))

    def adopt(self, name: str) -> None:
        """Record the sha256 of an artefact that another function has written into the folder."""
        with self._writing(name):
            self._artefacts[name] = hashlib.sha256((self.path / name).read_bytes()).hexdigest()

    def named(self, files: tuple[NamedFile, ...]) -> None:
        """Keep which files of the user's the plan is made of."""
        if files:
            self.manifest = self.manifest.but(files=files)

    def seal(self) -> None:
        """Put the digest of all that drives into the manifest; whatever it covers is written."""
        self.manifest = self.manifest.but(digest=digest.plan_digest(self._artefacts))

    def finish(self, exit_code: int | None, status: str = "finished") -> Path:
        """Complete the manifest and rename the folder to its final name.

        Returns:
            The final path.
        """
        self._close(status, exit_code)
        with self._writing(self.target.name):
            self.path.rename(self.target)
        self.path = self.target
        return self.target

    def fail(self, status: str, exit_code: int, reason: str) -> None:
        """Keep the unfinished folder with status, stage and reason; never raises: another error is on its way."""
        self.manifest = self.manifest.but(reason=reason)
        try:
            self._close(status, exit_code)
        except FileError:
            # The disk that failed the run may refuse the last manifest as well; the earlier one still names the stage.
            return

    def _close(self, status: str, exit_code: int | None) -> None:
        artefacts = dict(sorted(self._artefacts.items()))
        self.manifest = self.manifest.but(status=status, exit_code=exit_code, artefacts=artefacts)
        self._write_manifest()

    def _write_manifest(self) -> None:
        # Through a temporary file, so that a full disk leaves the last good manifest in place.
        temporary = self.path / "manifest.json.tmp"
        with self._writing("manifest.json"):
            temporary.write_text(json_text(self.manifest.as_json()), encoding="utf-8")
            temporary.replace(self.path / "manifest.json")

    def _write(self, name: str, content: bytes) -> None:
        with self._writing(name):
            (self.path / name).write_bytes(content)
        self._artefacts[name] = hashlib.sha256(content).hexdigest()

    @contextmanager
    def _writing(self, name: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise FileError(
                f"{self.path / name} cannot be written: {_reason(error)}; what was finished before stays in {self.path}"
            ) from error


def _move_aside(path: Path) -> None:
    """Make way for a new run: an ended run's `.part` folder is kept as `.part.1`, `.part.2`, ..."""
    try:
        status = json.loads((path / "manifest.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return  # no folder of ours, or none at all
    if status == "running":
        return  # perhaps it still is
    number = next(n for n in range(1, 10_000) if not path.with_name(f"{path.name}.{n}").exists())
    try:
        path.rename(path.with_name(f"{path.name}.{number}"))
    except OSError as error:
        raise FileError(f"{path} cannot be moved out of the way: {_reason(error)}; choose another --out") from error


def json_text(content: Mapping[str, JsonValue]) -> str:
    """JSON with two-space indent, a final newline and no NaN."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _reason(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "the disk is full"
    return (error.strerror or str(error)).lower() if error.errno is not None else str(error)


def versions() -> dict[str, str]:
    """Versions of Python, of this project and of what results depend on."""
    found = {"python": platform.python_version()}
    for name in _VERSIONS_OF:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


PROCESS_KEYS = ("pid", "pid_began", "machine")
"""Entries of a manifest while it is written."""


def with_process(manifest: Manifest) -> Manifest:
    """The manifest with the entries of the process that asks."""
    pid = os.getpid()
    return manifest.but(pid=pid, pid_began=_stat(pid)[1], machine=platform.node())


def is_running(manifest: Manifest) -> bool:
    """Whether the process of a manifest runs on this machine; False where that cannot be found out.

    Numbers of processes are used again, so where the system tells when a process began (Linux), that must agree too.
    """
    pid = manifest.pid
    if os.name != "posix" or pid is None or pid <= 0 or manifest.machine != platform.node():
        return False  # on other systems signal 0 is no question
    try:
        os.kill(pid, 0)
    except PermissionError:
        pass  # somebody else's, but it lives
    except (OSError, OverflowError):
        return False
    state, began = _stat(pid)
    return state != "Z" and began == manifest.pid_began


def _stat(pid: int) -> tuple[str, int | None]:
    """State of a process and its beginning in ticks since the machine's start; ("", None) where nothing tells it."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return fields[0], int(fields[19])
    except (OSError, ValueError, IndexError):
        return "", None
