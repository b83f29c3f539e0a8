"""Units by the format of a geometry file; imported by the scene model, so without arrays."""

from pathlib import PurePath

STEP = (".stp", ".step")
"""Suffixes of STEP files."""


def own_units(path: str) -> str | None:
    """Return the unit of a format that defines one, else None.

    GLB files are in metres (glTF 2.0, 3.4). STEP files name their own unit, and are read in metres.
    """
    return "m" if PurePath(path).suffix.lower() in (".glb", *STEP) else None


def units_problem(path: str, units: str | None) -> str:
    """Return why units must not be given for a file, as a sentence after its name; "" if they can be given."""
    if units in (None, "m") or PurePath(path).suffix.lower() not in STEP:
        return ""
    return "states its own unit; omit the units"
