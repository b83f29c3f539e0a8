"""Whether the process that writes a folder still lives: its number, when it began, and on which machine."""

import os
import platform
from pathlib import Path

from cell.run.manifest_json import Manifest

KEYS = ("pid", "pid_began", "machine")
"""Entries of a manifest while it is written."""


def begun_here(manifest: Manifest) -> Manifest:
    """The manifest with the entries of the process that asks."""
    pid = os.getpid()
    return manifest.but(pid=pid, pid_began=_stat(pid)[1], machine=platform.node())


def lives(manifest: Manifest) -> bool:
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
