"""One process at a time works on an execution, whatever drives: a lock of its folder, which the system gives back.

The lock is on the folder itself and leaves no file. Where the system has none for folders (Windows, some network
disks), only the number of the process in the manifest tells of another one.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cell.errors import FileError
from cell.runs.run import EXECUTIONS

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def held(execution: Path) -> Iterator[None]:
    """Keep others off an execution.

    Args:
        execution: its folder; one that does not exist is nobody's.

    Raises:
        FileError: if another process works on it.
    """
    if fcntl is None or not execution.is_dir():
        yield
        return
    handle = os.open(execution, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileError(
                f"another process works on execution {execution.name}; wait for its end, or stop it with Ctrl-C"
            ) from error
        except OSError:
            pass  # no locks here
        yield
    finally:
        os.close(handle)


def folder_of(run: Path, execution: str) -> Path:
    """Where an execution of a run is, by its id or "latest"; it may not exist."""
    root = run / EXECUTIONS
    if execution == "latest" and root.is_dir():
        execution = max((path.name for path in root.iterdir() if path.name.isdecimal()), key=int, default=execution)
    return root / execution
