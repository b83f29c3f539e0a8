"""The run folder opened for reading: its manifest, and its artefacts as the bytes that the manifest vouches for.

`open_run` looks at the manifest alone; `artefact` takes one file and checks it against the sha256 that the manifest has
for it. Every fault is one sentence: missing (and in which stage the run ended), foreign, of another schema, damaged or
changed. A failed run (`.part`) is opened as well: it holds what its stages had finished.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run.folder import SCHEMA
from cell.run.json_table import Table, parsed
from planner.errors import PlannerError

_KINDS: Mapping[str, tuple[Any, str]] = {
    "status": (str, "a word"), "stage": (str, "a word"), "seed": (int, "a whole number"),
    "options": (dict, "an object"), "artefacts": (dict, "an object"), "seconds": (dict, "an object"),
    "pid": (int, "a whole number"), "moving_s": (int | float, "a number"), "exit_code": (int, "a whole number"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class RunRecord:
    """An opened run folder.

    Attributes:
        folder: where it is (with `.part` behind for a run that did not finish).
        manifest: the content of manifest.json.
    """

    folder: Path
    manifest: Mapping[str, Any]

    @property
    def finished(self) -> bool:
        """Whether every stage was finished."""
        return self.manifest.get("status") == "finished"

    @property
    def ended(self) -> str:
        """How the run ended, for sentences: "failed in the stage 'reach': none of the candidates is reachable"."""
        status, stage = self.manifest.get("status", "unknown"), self.manifest.get("stage", "unknown")
        if self.finished:
            return "finished"
        if status == "running":
            return f"still running, or was killed, in the stage '{stage}'"
        reason = str(self.manifest.get("reason", "")).split(";")[0]
        return f"{status} in the stage '{stage}'" + (f": {reason}" if reason else "")

    def has(self, name: str) -> bool:
        """Whether an artefact is there."""
        return (self.folder / name).is_file()


def open_run(folder: Path) -> RunRecord:
    """Open a run folder by its manifest.

    Raises:
        FileError: if it is missing, not a run folder, damaged or of another schema.
    """
    if not folder.is_dir():
        raise FileError(_no_folder(folder))
    path = folder / "manifest.json"
    if not path.is_file():
        raise FileError(f"{folder} is not a run folder: it has no manifest.json; give the folder that cell plan made")
    manifest = read_manifest(path)
    schema = manifest.get("schema")
    if schema != SCHEMA:
        if isinstance(schema, str) and schema.startswith("scan-cell/run/"):
            raise FileError(
                f"{folder} has the schema {schema}, and this version of scan-cell reads {SCHEMA}; plan again, or use "
                "the version that its manifest.json names"
            )
        raise FileError(
            f"{folder} is not a run folder: its manifest.json is not of the schema {SCHEMA}; give the folder that "
            "cell plan made"
        )
    return RunRecord(folder, manifest)


def open_finished(folder: Path) -> RunRecord:
    """Open the run folder of a finished plan.

    Raises:
        FileError: if there is none, or the plan did not finish.
    """
    run = open_run(folder)
    if not run.finished:
        raise FileError(f"{folder} has no finished plan: the run {run.ended}; plan again")
    return run


def arrays(run: RunRecord, name: str) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz artefact.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return npz(run.folder / name, artefact(run, name))


def npz(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz; nothing in it is unpickled.

    Raises:
        FileError: if it is damaged.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (ValueError, OSError, EOFError, TypeError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise FileError(f"{path} is damaged or cut short and cannot be read; plan or scan again") from error


def artefact(run: RunRecord, name: str) -> bytes:
    """The bytes of an artefact, those that the manifest knows.

    Raises:
        FileError: if it is missing, cannot be read, or is not what the manifest has the sha256 of.
    """
    path = run.folder / name
    if not path.is_file():
        if run.finished:
            raise FileError(f"{path} is missing, although the run finished; the folder is damaged, plan again")
        raise FileError(f"{run.folder} has no {name}: the run {run.ended}; plan again")
    content = file_bytes(path)
    expected = run.manifest.get("artefacts", {}).get(name)
    if expected is not None and hashlib.sha256(content).hexdigest() != expected:
        raise FileError(
            f"{path} is not what the run wrote (its sha256 is not the manifest's): it was changed or damaged; a run "
            "folder is never edited, plan again"
        )
    return content


def artefact_value(run: RunRecord, name: str, kind: type[Table]) -> Table:
    """A JSON artefact as the value that `kind` defines.

    Raises:
        FileError: if it is missing, changed or damaged.
    """
    return parsed(kind, artefact(run, name), run.folder / name)


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object of a file.

    Raises:
        FileError: if it is missing or is not a JSON object.
    """
    return _json(path, file_bytes(path))


def read_manifest(path: Path) -> dict[str, Any]:
    """A manifest.json, its entries of the kinds that readers rely on; any entry may be missing.

    Raises:
        FileError: if it cannot be read, is not JSON, or an entry is of another kind.
    """
    manifest = read_json(path)
    for name, (kind, said) in _KINDS.items():
        value = manifest.get(name)
        if value is not None and (not isinstance(value, kind) or isinstance(value, bool)):
            raise FileError(f"{path} is damaged: its {name} is {value!r}; it must be {said}")
    if (manifest.get("seed") or 0) < 0:
        raise FileError(f"{path} is damaged: its seed is {manifest['seed']}; it must be 0 or more")
    return manifest


def file_bytes(path: Path) -> bytes:
    """The content of a file.

    Raises:
        FileError: if it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}; check its rights") from error


@contextmanager
def understood(path: Path) -> Iterator[None]:
    """Turn what wrong content raises inside the block into the sentence about its file.

    Raises:
        FileError: for a missing name, a wrong shape or a wrong kind of value.
    """
    try:
        yield
    except KeyError as error:
        raise FileError(f"{path} is damaged: it has no {error.args[0]}; plan or scan again") from error
    except (PlannerError, ValueError, TypeError, IndexError) as error:
        raise FileError(f"{path} is damaged: {error}; plan or scan again") from error


def _json(path: Path, content: bytes) -> dict[str, Any]:
    try:
        value = json.loads(content)
    except ValueError as error:
        raise FileError(f"{path} is damaged: it is not JSON ({error}); plan or scan again") from error
    if not isinstance(value, dict):
        raise FileError(f"{path} is damaged: it must hold one JSON object; plan or scan again")
    return value


def _no_folder(folder: Path) -> str:
    if folder.exists():
        return f"{folder} is a file; give the run folder that cell plan made"
    unfinished = folder.with_name(folder.name + ".part")
    if unfinished.is_dir():
        return f"{folder} does not exist, but {unfinished} does: a run that did not finish; give that name to see it"
    beside = folder.parent
    runs = sorted(path.parent.name for path in beside.glob("*/manifest.json")) if beside.is_dir() else []
    found = f"; run folders beside it: {', '.join(runs[-3:])}" if runs else ""
    return f"the run folder {folder} does not exist; give the folder that cell plan made{found}"
