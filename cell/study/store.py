"""Results of trials on disk, one file each under its key: a study that was stopped goes on where it was.

A failure is kept for the report, never for the next run: the trial is computed again.
"""

import json
from pathlib import Path

from cell import files
from cell.errors import FileError
from cell.files import atomic_write
from cell.study.trial import Outcome, Trial

SCHEMA = "scan-cell/trial/2"


def cache_folder() -> Path:
    """Where results are kept."""
    return files.cache_folder("studies")


def load(trial: Trial, folder: Path) -> Outcome | None:
    """The result that was kept, or None: not there, damaged, of another version, or a failure."""
    try:
        kept = json.loads(_path(trial, folder).read_text(encoding="utf-8"))
        if kept["schema"] == SCHEMA and kept["settings"] == trial.settings and not kept["failure"]:
            return Outcome(trial, dict(kept["values"]), "", dict(kept["seconds"]), cached=True)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return None


def save(outcome: Outcome, folder: Path) -> None:
    """Keep a result; the file appears complete or not at all.

    Raises:
        FileError: if it cannot be written.
    """
    path = _path(outcome.trial, folder)
    text = json.dumps(
        {
            "schema": SCHEMA,
            "function": outcome.trial.function,
            "settings": outcome.trial.settings,
            "values": dict(outcome.values),
            "failure": outcome.failure,
            "seconds": dict(outcome.seconds),
        },
        allow_nan=False,
    )
    try:
        with atomic_write(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(
            f"the result of a trial cannot be kept in {folder}: {error.strerror or error}; make room, or set "
            "XDG_CACHE_HOME to a folder that you may write to"
        ) from error


def _path(trial: Trial, folder: Path) -> Path:
    key = trial.key
    return folder / key[:2] / f"{key}.json"
