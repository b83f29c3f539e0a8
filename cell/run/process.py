"""Whether the process that writes a folder still lives: its number, when it began, and on which machine."""

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

KEYS = ("pid", "pid_began", "machine")
"""Entries of a manifest while it is written; `lives` understands them."""


def this_process() -> dict[str, Any]:
    """The entries for the process that asks."""
    pid = os.getpid()
    return {"pid": pid, "pid_began": _stat(pid)[1], "machine": platform.node()}


def lives(entries: Mapping[str, Any]) -> bool:
    """Whether the process of these entries runs on this machine; False where that cannot be found out.

    Numbers of processes are used again, so where the system tells when a process began (Linux), that must agree too.
    """
    pid = entries.get("pid")
    if os.name != "posix" or not isinstance(pid, int) or pid <= 0 or entries.get("machine") != platform.node():
        return False  # on other systems signal 0 is no question
    try:
        os.kill(pid, 0)
    except PermissionError:
        pass  # somebody else's, but it lives
    except (OSError, OverflowError):
        return False
    state, began = _stat(pid)
    return state != "Z" and began == entries.get("pid_began")


def _stat(pid: int) -> tuple[str, int | None]:
    """State of a process and its beginning in ticks since the machine's start; ("", None) where nothing tells it."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return fields[0], int(fields[19])
    except (OSError, ValueError, IndexError):
        return "", None
