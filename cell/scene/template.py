"""`cell init`: a scene file with every key, made from the built-in scene, which explains them."""

import json
import re
from pathlib import Path

from cell import files
from cell.errors import FileError
from cell.scene.file import BUILT_IN, scene_from_options


def write_scene(path: Path, part: str | None, units: str | None) -> None:
    """Write a scene file.

    Args:
        path: of the new file.
        part: mesh file or name of a built-in part; None: that of the built-in scene.
        units: of the mesh file; None for a format that states it, and for a built-in part.

    Raises:
        FileError: if the file exists or cannot be written.
        SceneError: if the part is not valid.
    """
    if path.exists():
        raise FileError(f"{path} exists; choose another name, or remove it")
    scene_from_options(None, {} if units is None else {"units": units}, part)
    text = files.model_file("scene.toml").read_text(encoding="utf-8")
    if part is not None:
        text = re.sub(r'(?m)^name = "\w+"(.*)$', lambda match: _part_lines(path, part, units), text, count=1)
    with files.file_errors(f"{path} cannot be written", "choose another name"), files.atomic_write(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def _part_lines(scene: Path, part: str, units: str | None) -> str:
    """Return the keys of a part; a path is relative to the scene's folder if it lies below."""
    if part in BUILT_IN:
        return f"name = {json.dumps(part)}"
    file, folder = Path(part).expanduser().absolute(), scene.absolute().parent
    path = file.relative_to(folder) if file.is_relative_to(folder) else file
    lines = [f"path = {json.dumps(path.as_posix())}"]
    return "\n".join([*lines, f"units = {json.dumps(units)}"] if units is not None else lines)
