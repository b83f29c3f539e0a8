"""The files that a motion rests on: each with its sha256 in the manifest, and all of them under the plan's digest."""

import hashlib
from pathlib import Path
from typing import NoReturn

from cell.errors import FileError
from cell.runs import digest
from cell.runs.run import Run


def refuse(path: Path, what: str) -> NoReturn:
    """End with the sentence about a file that does not fit the others.

    Raises:
        FileError: always.
    """
    raise FileError(f"{path} {what}; nothing of it is driven or exported: a run folder is never edited, plan again")


def whole(run: Run) -> str:
    """The digest of a plan of which every file that drives is there and is what it was.

    Raises:
        FileError: if the manifest has no digest, as in runs of earlier versions, lacks the sha256 of a file, or one of
            them is not that of the file or of the digest.
    """
    manifest = run.folder / "manifest.json"
    if not run.digest:
        raise FileError(
            f"{manifest} has no digest of what drives: the plan is of an earlier version, or the manifest was changed; "
            "it can be read and replayed, but is never driven: plan again"
        )
    for name in digest.driving_artefacts(run.manifest.artefacts):
        if name not in run.manifest.artefacts:
            refuse(manifest, f"has no sha256 of {name}")
        run.artefact(name)
    if digest.plan_digest(run.manifest.artefacts) != run.digest:
        refuse(manifest, f"has the digest {run.digest[: digest.SHORT_DIGEST]}, and its files have another")
    return run.digest


def sha256_of(path: Path) -> str:
    """sha256 of a file; "" where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
