"""Scenes as settings of trials: what JSON can hold, with the hash of every file that a scene names; and back again."""

import hashlib
import json
from functools import lru_cache
from pathlib import Path

from cell.errors import FileError
from cell.robot.model import KR16
from cell.scene.model import Scene
from cell.study.bench import Bench
from cell.study.trial import JsonTable


def scene_settings(scene: Scene) -> dict[str, object]:
    """A scene for the settings of a trial: only what differs from the defaults, and the files' contents as hashes."""
    content = scene.model_dump(mode="json", exclude_defaults=True)
    # Where a value is a default of a table that depends on the type of the shape, the dump leaves out the type's key.
    content["fixtures"] = [fixture.model_dump(mode="json") for fixture in scene.fixtures]
    arm = None if scene.robot.model == KR16 else scene.robot.model
    paths = [arm, scene.part.path, *(getattr(fixture, "path", None) for fixture in scene.fixtures)]
    return {"scene": content, "files": {path: _sha256(path) for path in paths if path is not None}}


def scene_of(settings: JsonTable) -> Scene:
    """The scene of a trial's settings.

    Raises:
        FileError: if a file that it names is not the one that was asked about.
    """
    for path, sha256 in settings["files"].items():
        if _sha256(path) != sha256:
            raise FileError(f"{path} has changed since the study was begun; begin the study again")
    return Scene.model_validate(settings["scene"])


def bench_of(settings: JsonTable) -> Bench:
    """The bench of a trial's scene; trials of one process share it, so a map of placements loads its part once."""
    return _bench(json.dumps({key: settings[key] for key in ("scene", "files")}, sort_keys=True))


@lru_cache(maxsize=2)
def _bench(settings: str) -> Bench:
    return Bench(scene_of(json.loads(settings)))


def _sha256(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror or error}") from error
