"""The run folder opened for reading: its manifest, and its artefacts as the bytes that the manifest vouches for.

`open_run` looks at the manifest alone; `artefact` takes one file and checks it against the sha256 that the manifest has
for it. Every fault is one sentence: missing (and in which stage the run ended), foreign, of another schema, damaged or
changed. A failed run (`.part`) is opened as well: it holds what its stages had finished.
"""

import hashlib
import io
import lzma
import math
import struct
import sys
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import FileError
from cell.run.folder import SCHEMA, WITH_TABLE
from cell.run.json_table import parsed
from cell.run.manifest_json import Manifest
from planner.errors import PlannerError

_SMALL, _MOST_UNFOLDED = 64 << 20, 50
"""An .npz unfolds to so many bytes, or so many times its size, at most: those of a run to some ten times."""


@dataclass(frozen=True, slots=True)
class RunRecord:
    """An opened run folder.

    Attributes:
        folder: where it is (with `.part` behind for a run that did not finish).
        manifest: its manifest.json.
    """

    folder: Path
    manifest: Manifest

    @property
    def finished(self) -> bool:
        """Whether every stage was finished."""
        return self.manifest.status == "finished"

    @property
    def ended(self) -> str:
        """How the run ended, for sentences: "failed in the stage 'reach': none of the candidates is reachable"."""
        status, stage = self.manifest.status or "unknown", self.manifest.stage or "unknown"
        if self.finished:
            return "finished"
        if status == "running":
            return f"still running, or was killed, in the stage '{stage}'"
        reason = self.manifest.reason.split(";")[0]
        return f"{status} in the stage '{stage}'" + (f": {reason}" if reason else "")

    @property
    def seed(self) -> int:
        """Seed of every random choice.

        Raises:
            FileError: if the manifest does not say it.
        """
        return self.manifest.require_seed(self.folder)

    @property
    def plan_sha256(self) -> str:
        """sha256 of plan.json; "" where there is none."""
        return self.manifest.artefacts.get("plan.json", "")

    @property
    def digest(self) -> str:
        """Digest of all that drives, as the manifest says it; "" where there is none."""
        return self.manifest.digest or ""

    @property
    def of_several(self) -> bool:
        """Whether it is one of several set-ups that one cover was planned for."""
        return (self.folder.absolute().parent.parent / "setups.json").is_file()

    def has(self, name: str) -> bool:
        """Whether an artefact is there."""
        return (self.folder / name).is_file()


def open_run(folder: Path) -> RunRecord:
    """Open a run folder by its manifest.

    Raises:
        FileError: if it is missing, not a run folder, damaged or of another schema, or holds several set-ups.
    """
    if not folder.is_dir():
        raise FileError(_no_folder(folder))
    path = folder / "manifest.json"
    if not path.is_file():
        raise FileError(f"{folder} is not a run folder: it has no manifest.json; give the folder that cell plan made")
    if (folder / "setups.json").is_file():
        runs = ", ".join(str(path) for path in sorted((folder / "setups").iterdir()))
        raise FileError(f"{folder} holds several set-ups; give the run folder of one of them: {runs}")
    manifest = read_manifest(path)
    schema = manifest.schema_version
    if schema not in (SCHEMA, WITH_TABLE):
        if schema is not None and schema.startswith("scan-cell/run/"):
            raise FileError(
                f"{folder} has the schema {schema}, and this version of scan-cell reads {SCHEMA} and {WITH_TABLE}; "
                "plan again, or use the version that its manifest.json names"
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
        with warnings.catch_warnings(action="ignore"):  # numpy reads a header as Python, which has its doubts
            _require_room(content)
            with np.load(io.BytesIO(content), allow_pickle=False) as stored:
                found = {name: stored[name] for name in stored.files}
        for array in found.values():  # characters that there are none of would fail where they are first looked at
            own = array.astype(array.dtype.newbyteorder("=")).tobytes() if array.dtype.kind == "U" else b""
            if (np.frombuffer(own, dtype=np.uint32) > sys.maxunicode).any():
                raise ValueError("holds a text that is none")
        return found
    except (
        ValueError, OSError, EOFError, TypeError, NotImplementedError, OverflowError, RuntimeError, SyntaxError,
        KeyError, MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
    ) as error:  # fmt: skip
        raise FileError(f"{path} is damaged or cut short and cannot be read; plan or scan again") from error


def _require_room(content: bytes) -> None:
    """Look at what an .npz announces before anything is allocated: a few bytes may announce gigabytes.

    Raises:
        ValueError: if it unfolds to more than `_MOST_UNFOLDED` times its size, or an array is not as long as it says.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as members:
        listed = members.infolist()
        if sum(member.file_size for member in listed) > max(_SMALL, _MOST_UNFOLDED * len(content)):
            raise ValueError("unfolds to more than a run folder holds")
        for member in listed:
            with members.open(member) as file:
                version = np.lib.format.read_magic(file)
                header = (
                    np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = header(file)
                if math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
                    raise ValueError("holds an array that is not as long as it says")


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
    expected = run.manifest.artefacts.get(name)
    if expected is not None and hashlib.sha256(content).hexdigest() != expected:
        raise FileError(
            f"{path} is not what the run wrote (its sha256 is not the manifest's): it was changed or damaged; a run "
            "folder is never edited, plan again"
        )
    return content


def read_manifest(path: Path) -> Manifest:
    """A manifest.json; any entry may be missing.

    Raises:
        FileError: if it cannot be read, is not JSON, or an entry is of another kind.
    """
    return parsed(Manifest, file_bytes(path), path)


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
        raise FileError(f"{path} is damaged: it has no {str(error.args[0])[:80]}; plan or scan again") from error
    except PlannerError as error:
        raise FileError(f"{path} is damaged: {error}; plan or scan again") from error
    except (ValueError, TypeError, IndexError, AttributeError, OverflowError, ArithmeticError) as error:
        # a library's words are for who wrote this, not for who reads it
        raise FileError(f"{path} is damaged: it does not hold what it should; plan or scan again") from error


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
