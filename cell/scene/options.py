"""The scene's options as tables that go before a scene file's, for the command line and for Python alike."""

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from cell.errors import FileError, UsageError
from cell.scene.option import Spell, offers, values
from cell.scene.scene import Part, Scene
from cell.scene.scene_file import load_scene

BUILT_IN: tuple[str, ...] = get_args(Part.model_fields["name"].annotation)
"""Names of the parts that need no file."""

Tables = dict[str, dict[str, object]]


def tables(wishes: Mapping[str, object], part: str | Path | None = None, spell: Spell = str) -> Tables:
    """Tables of the scene with what is wished: `{"place": (1200, 500, 0), "standoff": 300, "pin": [1, 2]}`.

    Args:
        wishes: by the names of `offers(Scene)`; texts as on the command line, or values. None is no wish.
        part: a built-in part by name, else a mesh file.
        spell: how the user writes the name of a wish, for the sentences.

    Raises:
        UsageError: if a wish is unknown or its value has another form, or the part is neither built in nor a file.
        FileError: if the part's file is a folder or missing.
    """
    found: Tables = {} if part is None else {"part": _part(str(part))}
    for key, value in values(Scene, wishes, spell).items():
        table, _, name = key.partition(".")
        found.setdefault(table, {})[name] = value
    return found


def spelled(asked: Mapping[str, Mapping[str, object]], spell: Spell = str) -> dict[str, str]:
    """How the user wrote the keys of `tables`, for the sentences of `load_scene`."""
    known = {key: spell(offer.name) for offer in offers(Scene).values() for key in offer.fields}
    known |= {"part.path": "the part", "part.name": "the part"}
    given = (f"{table}.{key}" for table, keys in asked.items() for key in keys)
    return {key: known[key] for key in given if key in known}


def scene_of(
    path: Path | None,
    wishes: Mapping[str, object],
    part: str | Path | None = None,
    spell: Spell = str,
) -> Scene:
    """A scene file with wishes before it; the built-in scene for None.

    Raises:
        UsageError: as `tables`.
        FileError: as `tables`.
        SceneError: with every problem on a line of its own; one of a wish names it as its user wrote it.
    """
    asked = tables(wishes, part, spell)
    return load_scene(path, asked, spelled(asked, spell))


def _part(name_or_path: str) -> dict[str, object]:
    """`[part]` of a built-in part's name, or of a file."""
    path = Path(name_or_path)
    if name_or_path in BUILT_IN and not path.is_file():
        return {"name": name_or_path}
    if path.is_dir():
        raise FileError(f"{name_or_path} is a folder; give a mesh file in it")
    if not path.exists():
        if path.suffix == "" and os.sep not in name_or_path:
            close = difflib.get_close_matches(name_or_path.lower(), BUILT_IN, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise UsageError(
                f"there is no built-in part and no file {name_or_path}; {hint}Built in are {', '.join(BUILT_IN)}"
            )
        raise FileError(f"there is no file {name_or_path}; give the path of a mesh (STL, OBJ, PLY, OFF or GLB)")
    return {"path": str(path.absolute()), "units": None}
