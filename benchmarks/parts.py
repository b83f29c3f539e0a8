"""Parts of the benchmarks of the main job: the built-in parts, and meshes from outside the repository."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

from cell.part.builtin import NAMES

_SIDE_MM = 150.0


def place() -> str:
    """Return the place of the parts; SCAN_CELL_PLACE replaces that of the README."""
    return os.environ.get("SCAN_CELL_PLACE", "1200,500,0")


def parts(folder: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Return name and command-line arguments of each part, built-in ones first; meshes are written into the folder."""
    for name in NAMES:
        yield name, (name,)
    yield from meshes(folder)


def meshes(folder: Path) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Return name and command-line arguments of each mesh of `$SCAN_CELL_MESHES`, scaled and written into the folder.

    `manifest.json` in that folder lists them: `file`, and `scale_len` that brings its numbers to millimetres; without
    one the longest side becomes 150 mm.
    """
    source = os.environ.get("SCAN_CELL_MESHES")
    if source is None:
        return
    listed = json.loads((Path(source) / "manifest.json").read_text())["meshes"]
    for name, entry in listed.items():
        mesh = trimesh.load(Path(source) / entry["file"], process=False)
        mesh.apply_scale(entry["scale_len"] or _SIDE_MM / float(np.max(mesh.extents)))
        path = folder / f"{name}.ply"
        mesh.export(path)
        yield f"{name} (file)", (str(path), "--units", "mm")
