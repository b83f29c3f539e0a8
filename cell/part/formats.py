"""What the format of a file of geometry says about its numbers."""

from pathlib import PurePath

STEP = (".stp", ".step")
"""Suffixes of files of a CAD model."""


def units_of(path: str) -> str | None:
    """The unit of a file whose format has one; None of all others.

    A GLB has metres (glTF 2.0, 3.4); a STEP file names its own unit, and what is read of it is in metres.
    """
    return "m" if PurePath(path).suffix.lower() in (".glb", *STEP) else None


def wrong_units(path: str, units: str | None) -> str:
    """Why units must not be given for a file, as a sentence that follows its name; "" where they may."""
    if units in (None, "m") or PurePath(path).suffix.lower() not in STEP:
        return ""
    return "says its own unit; leave the units out"
