"""Where the cell is described now, as the options of `cell scan` and `cell export` say it."""

from dataclasses import dataclass
from pathlib import Path

MISSING = "missing"
"""Accepts files that are gone."""


@dataclass(frozen=True, slots=True)
class FilesNow:
    """Where the cell is described now, and which changes are accepted.

    Attributes:
        scene: scene file in place of the manifest's.
        part: mesh file or built-in part in place of the manifest's.
        accepted: names of differences that are accepted.
    """

    scene: Path | None = None
    part: str | None = None
    accepted: tuple[str, ...] = ()


AS_PLANNED = FilesNow()
"""The files that the manifest names."""
