"""Where the program keeps what it can make again: matrices, results of studies, stand-ins."""

import os
import sys
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
