"""Where the program keeps what it can make again: matrices, results of studies, stand-ins."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


def folder(kind: str) -> Path:
    """The folder of one kind of thing: `$XDG_CACHE_HOME/scan-cell/<kind>`, else where the system keeps caches.

    That is ~/.cache, on macOS ~/Library/Caches and on Windows %LOCALAPPDATA%.

    Raises:
        RuntimeError: if no cache is named and the user has no home.
    """
    named = os.environ.get("XDG_CACHE_HOME")
    if named:
        base = Path(named)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path.home() / ".cache"
    return base / "scan-cell" / kind


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A place beside a file to write it to; it takes the file's place with the end of the block, or is removed.

    So the file appears complete or not at all. Its folder is made if it is missing.

    Raises:
        OSError: if the folder cannot be made or the file not be put there.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):  # the folder itself may be what is wrong
            temporary.unlink(missing_ok=True)
