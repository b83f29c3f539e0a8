"""Whether an execution fits into memory and on the disk: asked before the first move, for all scans together.

Every ray is counted as if it gave a point, so the answer holds for every part.
"""

import os
import shutil
from pathlib import Path

import numpy as np

from cell.errors import FileError, UsageError
from cell.runs.cell import RunCell
from cell.scan.legs import Legs
from cell.scan.sweep_scan import lines_between

_RAY_BYTES = 250
"""Memory [bytes] for each ray while a view is scanned: directions, hits, normals and their copies."""

_POINT_BYTES = 60
"""Memory [bytes] for each ray of all views, when their points are merged."""

_STORED_BYTES = 66
"""Disk [bytes] for each ray of all views: point, face, pixel and code, and the point in the merged cloud."""

_REST_BYTES = 50e6  # of the disk, for the report, its pictures and the surface


def require_room(cell: RunCell, legs: Legs, folder: Path) -> None:
    """Look whether all scans of an execution can be taken and kept.

    Args:
        cell: with the scanner at its resolution.
        legs: what is to be driven and scanned.
        folder: of the run; the scans go on its disk.

    Raises:
        UsageError: if the memory does not suffice.
        FileError: if the disk does not.
    """
    rows, columns = cell.scanner.grid_shape
    views: dict[int, list[np.ndarray]] = {}
    for leg in legs.legs:
        if leg.stop:
            views.setdefault(leg.stop, []).append(leg.via[-1])
    lines = [
        1 if len(poses) == 1 else len(poses) * lines_between(np.stack([cell.scanner_pose(q) for q in poses]))
        for poses in views.values()
    ]
    largest, every = (rows * columns * count for count in (max(lines, default=0), sum(lines)))
    needed, there = largest * _RAY_BYTES + every * _POINT_BYTES, _memory()
    if needed > there:
        raise UsageError(
            f"{largest:.3g} rays in a view and {every:.3g} in all need up to {needed / 1e9:.3g} GB of memory, and "
            f"{there / 1e9:.3g} GB are free; nothing was moved: give a coarser --resolution"
        )
    stored = every * _STORED_BYTES + _REST_BYTES
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise FileError(f"how much room is on the disk of {folder} cannot be found out: {error.strerror}") from error
    if stored > free:
        raise FileError(
            f"the scans need up to {stored / 1e9:.3g} GB on the disk of {folder}, and {free / 1e9:.3g} GB are free; "
            "nothing was moved: make room, or give a coarser --resolution"
        )


def _memory() -> float:
    """Memory that is free or can be freed [bytes]; without a system that tells, all that an address reaches."""
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (OSError, ValueError, AttributeError):
        return 2.0**47
