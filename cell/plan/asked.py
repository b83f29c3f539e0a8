"""The scene and the part that somebody asks for: by names and files, by a mesh in memory, or by a whole scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.scene.file import BUILT_IN, scene_from_options
from cell.scene.model import Scene

if TYPE_CHECKING:
    import trimesh


def scene_and_part(
    part: str | Path | trimesh.Trimesh | Scene | None, path: str | Path | None, wishes: dict[str, object]
) -> tuple[Scene, Workpiece | None]:
    """The checked scene, and the part where it is no file's.

    Args:
        part: mesh file or built-in part by name, a mesh in memory, a whole scene, or None for the scene's.
        path: scene file; None is the built-in scene.
        wishes: by the names of `cell.scene.options.option_specs(Scene)`; the unit of a mesh in memory is taken out.

    Raises:
        UsageError: if there are wishes beside a whole scene.
        SceneError: if the scene is not possible.
    """
    if isinstance(part, Scene):
        if wishes:
            raise UsageError(
                f"{', '.join(wishes)} beside a whole Scene: a Scene says all of it; set them there, or give a scene "
                "file in its place"
            )
        return part, None
    file = None if path is None else Path(path)
    if part is None or isinstance(part, str | Path):
        return scene_from_options(file, wishes, part), None
    units = wishes.pop("units", None)
    name = Path(str(part.metadata.get("file_name") or "mesh")).stem
    loaded = workpiece.from_arrays(
        "mesh" if name in BUILT_IN else name, part.vertices, part.faces, None if units is None else str(units)
    )
    return scene_from_options(file, wishes), loaded
