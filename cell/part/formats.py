"""What the format of a mesh file says about its numbers."""

from pathlib import PurePath


def units_of(path: str) -> str | None:
    """The unit of a file whose format has one: metres of a GLB (glTF 2.0, 3.4); None of all others."""
    return "m" if PurePath(path).suffix.lower() == ".glb" else None
