"""Reading a scene: the tables of a TOML file, with options of the command line or keywords of Python before them."""

import difflib
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from cell.errors import FileError, SceneError, UsageError
from cell.files import read_bytes
from cell.part.formats import SUFFIXES
from cell.scene.model import Part, Scene
from cell.scene.options import Spell, option_specs, option_values
from cell.scene.validation import error_messages

BUILT_IN: tuple[str, ...] = get_args(Part.model_fields["name"].annotation)
"""Names of the parts that need no file."""

Tables = dict[str, dict[str, object]]

_DEEPEST = 8  # levels of tables and lists; a scene needs four


def load_scene(
    path: Path | None, options: Mapping[str, Mapping[str, object]] | None = None, names: Mapping[str, str] | None = None
) -> Scene:
    """Read and check a scene file.

    Args:
        path: the TOML file; None is the built-in scene. Paths inside it are relative to its folder.
        options: tables of keys that replace those of the file. A `part` with a name or a path replaces the whole table.
        names: user's spelling of option keys in messages, such as "--faces" for "plan.faces".

    Raises:
        SceneError: with every problem of the file on a line of its own: the key, what is wrong, what is valid.
    """
    content: dict[str, object] = {} if path is None else _parsed(path)
    for table, keys in (options or {}).items():
        below = content.get(table, {})
        replaces = table == "part" and ("name" in keys or "path" in keys)
        if keys and isinstance(below, dict):
            content[table] = dict(keys) if replaces else {**_without_other_point(table, below, keys), **keys}
    folder = Path.cwd() if path is None else path.absolute().parent
    try:
        return Scene.model_validate(content, context={"folder": folder})
    except ValidationError as error:
        problems = error_messages(error, Scene, names)
    scene = "the scene" if path is None else f"the scene {path}"
    count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
    raise SceneError("\n  ".join([f"{scene} has {count}:", *problems]))


def scene_from_options(
    path: Path | None, options: Mapping[str, object], part: str | Path | None = None, spell: Spell = str
) -> Scene:
    """Read a scene file, or take the built-in scene for None, with options before it; see `option_tables`.

    Raises:
        UsageError: as `option_tables`.
        FileError: as `option_tables`.
        SceneError: with every problem on a line of its own; an option is named as its user wrote it.
    """
    tables = option_tables(options, part, spell)
    return load_scene(path, tables, option_names(tables, spell))


def option_tables(options: Mapping[str, object], part: str | Path | None = None, spell: Spell = str) -> Tables:
    """Convert options, such as `{"place": (1200, 500, 0), "pin": [1, 2]}`, to tables of a scene.

    Args:
        options: by the names of `option_specs(Scene)`; texts of the command line, or values. None is no value.
        part: a built-in part by name, or a mesh file.
        spell: spelling of names in messages.

    Raises:
        UsageError: if an option is unknown or has another form, or the part is neither built in nor a file.
        FileError: if the part's file is a folder or missing.
    """
    tables: Tables = {} if part is None else {"part": _part_table(str(part))}
    for key, value in option_values(Scene, options, spell).items():
        table, _, name = key.partition(".")
        tables.setdefault(table, {})[name] = value
    return tables


def option_names(tables: Mapping[str, Mapping[str, object]], spell: Spell = str) -> dict[str, str]:
    """Return the user's spelling of the keys of `option_tables`, for the messages of `load_scene`."""
    known = {key: spell(spec.name) for spec in option_specs(Scene).values() for key in spec.fields}
    known |= {"part.path": "the part", "part.name": "the part"}
    names = (f"{table}.{key}" for table, keys in tables.items() for key in keys)
    return {key: known[key] for key in names if key in known}


def _part_table(name_or_path: str) -> dict[str, object]:
    """Return `[part]` for the name of a built-in part, or for a file."""
    path = Path(name_or_path)
    if name_or_path in BUILT_IN and not path.is_file():
        return {"name": name_or_path}
    if path.is_dir():
        raise FileError(f"{name_or_path} is a folder; give a mesh file in it")
    if path.suffix.lower() == ".toml":
        raise UsageError(f"{name_or_path} is a scene file, not a part; give it with --scene")
    if not path.exists():
        if path.suffix == "" and os.sep not in name_or_path:
            close = difflib.get_close_matches(name_or_path.lower(), BUILT_IN, n=1)
            hint = f"did you mean {close[0]}? " if close else ""
            raise UsageError(
                f"there is no built-in part and no file {name_or_path}; {hint}Built in are {', '.join(BUILT_IN)}"
            )
        raise FileError(
            f"there is no file {name_or_path}; give the path of a mesh (STL, OBJ, PLY, OFF, GLB, glTF, 3MF) or of a "
            "STEP file"
        )
    return {"path": str(path.absolute()), "units": None}


def _parsed(path: Path) -> dict[str, object]:
    """Return the tables of a scene file, not validated.

    Raises:
        SceneError: if the file cannot be read, or is not the TOML of a scene.
    """
    if path.suffix.lower() in SUFFIXES:
        raise SceneError(f"{path} is a part, not a scene; give a TOML file that names it as part.path")
    try:
        content = tomllib.loads(read_bytes(path).decode("utf-8-sig"))
    except OSError as error:
        raise SceneError(
            f"the scene {path} cannot be read: {error.strerror or error}; give the path of a TOML file"
        ) from error
    except UnicodeDecodeError as error:
        raise SceneError(
            f"the scene {path} is not UTF-8 text (byte {error.start}); save it as a UTF-8 TOML file"
        ) from error
    except tomllib.TOMLDecodeError as error:
        hint = (
            "; write a path in single quotes, or with / in place of \\\\" if re.search("hex|escape", str(error)) else ""
        )
        raise SceneError(f"the scene {path} is not valid TOML: {error}; correct that line{hint}") from error
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, thousands of brackets
        raise SceneError(
            f"the scene {path} has a number that is too long, or lists nested too deep; models/scene.toml shows a "
            "valid scene"
        ) from error
    level: list[object] = [content]
    for _ in range(_DEEPEST):
        level = [each for table in level for each in _items(table)]
        if not level:
            return content
    raise SceneError(
        f"the scene {path} nests its tables or lists deeper than {_DEEPEST}; models/scene.toml shows a valid scene"
    )


def _items(value: object) -> Iterable[object]:
    """Return the items of a table or a list."""
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _without_other_point(table: str, below: dict[str, object], keys: Mapping[str, object]) -> dict[str, object]:
    """Remove the centre from a file's placement if the options give the file's origin, and the reverse."""
    other = {"position_mm": "origin_mm", "origin_mm": "position_mm"}
    replaced = {other[key] for key in keys if key in other} if table == "placement" else set()
    return {key: value for key, value in below.items() if key not in replaced}
