"""A scene read from its file: the tables of its TOML, with what goes before them.

The scene's options as tables that go before a scene file's, for the command line and for Python alike.
"""

import difflib
import os
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from cell.errors import FileError, SceneError, UsageError
from cell.scene.model import Part, Scene
from cell.scene.options import Spell, option_specs, option_values

_DEEPEST = 8  # levels of tables and lists; a scene needs four


def _parsed(path: Path) -> dict[str, object]:
    """The tables of a scene file; what stands in them is not looked at.

    Raises:
        SceneError: if it cannot be read, or is no TOML that a scene could be.
    """
    try:
        content = tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise SceneError(
            f"the scene {path} cannot be read: {error.strerror or error}; give the path of a TOML file"
        ) from error
    except UnicodeDecodeError as error:
        raise SceneError(
            f"the scene {path} is not UTF-8 text (byte {error.start}); save it as a UTF-8 TOML file"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"the scene {path} is not valid TOML: {error}; correct that line") from error
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, thousands of brackets
        raise SceneError(
            f"the scene {path} holds a number that is too long, or lists nested too deep; models/scene.toml shows what "
            "a scene holds"
        ) from error
    level: list[object] = [content]
    for _ in range(_DEEPEST):
        level = [each for table in level for each in _inside(table)]
        if not level:
            return content
    raise SceneError(
        f"the scene {path} nests its tables or lists deeper than {_DEEPEST}; models/scene.toml shows what a scene holds"
    )


def _inside(value: object) -> Iterable[object]:
    """What a table or a list holds."""
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _without_the_other_point(table: str, below: dict[str, object], keys: Mapping[str, object]) -> dict[str, object]:
    """A file's placement without the point that the command line gives the other of: centre or the file's origin."""
    other = {"position_mm": "origin_mm", "origin_mm": "position_mm"}
    left = {other[key] for key in keys if key in other} if table == "placement" else set()
    return {key: value for key, value in below.items() if key not in left}


def load_scene(
    path: Path | None,
    options: Mapping[str, Mapping[str, object]] | None = None,
    names: Mapping[str, str] | None = None,
) -> Scene:
    """Read and check a scene file.

    Args:
        path: the TOML file; None is the built-in scene. Paths inside it are relative to its folder.
        options: tables of keys that go before the file's (the command line's). A `part` with a name or a path replaces
            the file's whole part.
        names: how their user wrote keys of the options, such as "--faces" for "plan.faces", for the sentences.

    Raises:
        SceneError: with every problem of the file on a line of its own: the key, what is wrong, what would be valid.
    """
    from cell.scene.validation import error_messages

    content: dict[str, object] = {} if path is None else _parsed(path)
    for table, keys in (options or {}).items():
        below = content.get(table, {})
        replaces = table == "part" and ("name" in keys or "path" in keys)
        if keys and isinstance(below, dict):
            below = _without_the_other_point(table, below, keys)
            content[table] = dict(keys) if replaces else {**below, **keys}
    folder = Path.cwd() if path is None else path.absolute().parent
    try:
        return Scene.model_validate(content, context={"folder": folder})
    except ValidationError as error:
        problems = error_messages(error, Scene, names)
    where = "the scene" if path is None else f"the scene {path}"
    count = "1 problem" if len(problems) == 1 else f"{len(problems)} problems"
    raise SceneError("\n  ".join([f"{where} has {count}:", *problems]))


BUILT_IN: tuple[str, ...] = get_args(Part.model_fields["name"].annotation)
"""Names of the parts that need no file."""

Tables = dict[str, dict[str, object]]


def option_tables(wishes: Mapping[str, object], part: str | Path | None = None, spell: Spell = str) -> Tables:
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
    for key, value in option_values(Scene, wishes, spell).items():
        table, _, name = key.partition(".")
        found.setdefault(table, {})[name] = value
    return found


def option_names(asked: Mapping[str, Mapping[str, object]], spell: Spell = str) -> dict[str, str]:
    """How the user wrote the keys of `tables`, for the sentences of `load_scene`."""
    known = {key: spell(offer.name) for offer in option_specs(Scene).values() for key in offer.fields}
    known |= {"part.path": "the part", "part.name": "the part"}
    given = (f"{table}.{key}" for table, keys in asked.items() for key in keys)
    return {key: known[key] for key in given if key in known}


def scene_from_options(
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
    asked = option_tables(wishes, part, spell)
    return load_scene(path, asked, option_names(asked, spell))


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
