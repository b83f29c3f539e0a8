"""A scene file as the tables of its TOML, within what a scene can hold."""

import tomllib
from collections.abc import Iterable
from pathlib import Path

from cell.errors import SceneError

_DEEPEST = 8  # levels of tables and lists; a scene needs four


def parsed(path: Path) -> dict[str, object]:
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
