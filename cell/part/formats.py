"""Suffixes and units by the format of a geometry file; imported by the scene model, so without arrays."""

from pathlib import PurePath

STEP = (".stp", ".step")
"""Suffixes of STEP files."""

SUFFIXES = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf", ".3mf", *STEP)
"""Suffixes of the files of parts."""

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Metres per unit of a file."""

_STATED = (".3mf", *STEP)  # each file names its unit


def own_units(path: str) -> str | None:
    """Return the unit of a format that defines one, else None.

    glTF files are in metres (glTF 2.0, 3.4). STEP and 3MF files name their own unit, and are read in metres.
    """
    return "m" if PurePath(path).suffix.lower() in (".glb", ".gltf", *_STATED) else None


def units_problem(path: str, units: str | None) -> str:
    """Return why units must not be given for a file, as a sentence after its name; "" if they can be given.

    Whether a STEP file states its unit is known when it is read.
    """
    if units in (None, "m") or PurePath(path).suffix.lower() != ".3mf":
        return ""
    return "states its own unit; omit the units"
