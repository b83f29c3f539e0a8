"""States of a live cell: scenes and their plans, each saved as a file, with undo."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field

from cell.errors import UsageError
from cell.files import atomic_write
from cell.runs.cell import scene_of_run
from cell.runs.run import Run
from cell.scene.fields import Positive, Table, Triple
from cell.scene.file import load_scene
from cell.scene.model import Base, BoxFixture, Placement, Scene, pose
from cell.scene.writer import scene_text
from planner.values import Floats

Model = TypeVar("Model", bound=BaseModel)

PART, ROBOT, TABLE = "part", "robot", "table"
"""Names of movable objects besides the fixtures."""


class Pose(Table):
    """Pose of a movable object: the part's centre, the base of the robot, the table, or a fixture."""

    name: str
    position_mm: Triple
    abc_deg: Triple

    @property
    def T(self) -> Floats:
        """Transform (4, 4) [m]."""
        return pose(self.position_mm, self.abc_deg)


class Box(Table):
    """A new keep-out box."""

    position_mm: Triple
    size_mm: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]


@dataclass(frozen=True, slots=True)
class State:
    """A scene with its file.

    Attributes:
        scene: as read from the file.
        file: the scene file.
        run: folder of its plan; None without one.
    """

    scene: Scene
    file: Path
    run: Path | None = None

    @property
    def command(self) -> str:
        """Command that makes the same plan."""
        return f"cell plan --scene {shlex.quote(str(self.file))}"


class States:
    """History of states in a folder: `0001.toml`, `0002.toml`, ...; plans are in `plans/`.

    Args:
        scene: first scene.
        folder: existing folder.
        run: plan of the first scene.
    """

    def __init__(self, scene: Scene, folder: Path, run: Path | None = None) -> None:
        self.folder = folder
        self._count = self._plans = 0
        self._history: list[State] = []
        self.push(scene)
        self.with_run(run)

    @property
    def state(self) -> State:
        """The present state."""
        return self._history[-1]

    @property
    def can_undo(self) -> bool:
        """Whether there is an earlier state."""
        return len(self._history) > 1

    def push(self, scene: Scene) -> State:
        """Save a scene and make it the present state; read from its file, so that both are equal.

        Raises:
            SceneError: if it is not valid; the present state stays.
        """
        path = self.folder / f"{self._count + 1:04d}.toml"
        with atomic_write(path) as unfinished:
            unfinished.write_text(scene_text(scene), encoding="utf-8")
            load_scene(unfinished)
        self._count += 1
        self._history.append(State(load_scene(path), path))
        return self.state

    def push_run(self, run: Path) -> None:
        """Make a changed plan of the present scene a state of its own."""
        self._history.append(replace(self.state, run=run))

    def with_run(self, run: Path | None) -> None:
        """Set the plan of the present state."""
        self._history[-1] = replace(self.state, run=run)

    def undo(self) -> State:
        """Return to the earlier state, if there is one."""
        if self.can_undo:
            self._history.pop()
        return self.state

    def new_run(self) -> Path:
        """Return the folder of a new plan."""
        self._plans += 1
        return self.folder / "plans" / f"{self._plans:04d}"


def scene_of(run: Run) -> Scene:
    """Return the scene of a finished plan, for further plans.

    Raises:
        UsageError: if its regions cannot be named any more.
    """
    if run.scene.regions:
        raise UsageError(
            f"{run.folder} has regions, whose faces are stored in its mesh only; give its scene file to cell live"
        )
    return scene_of_run(run)


def targets(scene: Scene) -> list[Pose]:
    """Return the movable objects of a settled scene with their poses."""
    poses = [Pose(name=PART, position_mm=scene.placement.position_mm, abc_deg=scene.placement.abc_deg)]
    base = scene.robot.base or Base()
    poses.append(Pose(name=ROBOT, position_mm=base.position_mm, abc_deg=base.abc_deg))
    if scene.table.enabled and scene.table.position_mm is not None:
        poses.append(Pose(name=TABLE, position_mm=scene.table.position_mm, abc_deg=scene.table.abc_deg))
    return poses + [Pose(name=each.name, position_mm=each.position_mm, abc_deg=each.abc_deg) for each in scene.fixtures]


def moved(scene: Scene, target: Pose) -> Scene:
    """Return a scene with an object at another pose.

    Raises:
        UsageError: if there is no such object.
    """
    keys = {"position_mm": target.position_mm, "abc_deg": target.abc_deg}
    if target.name == PART:
        return _with(scene, placement=Placement(**keys))
    if target.name == ROBOT:
        return _with(scene, robot=_with(scene.robot, base=Base(**keys)))
    if target.name == TABLE:
        return _with(scene, table=_with(scene.table, **keys))
    if target.name not in [each.name for each in scene.fixtures]:
        raise UsageError(f"there is no '{target.name}' to move; there are {_names(scene)}")
    return _with_fixtures(scene, lambda each: [_with(each, **keys) if each.name == target.name else each])


def without(scene: Scene, name: str) -> Scene:
    """Return a scene without a fixture."""
    return _with_fixtures(scene, lambda each: [] if each.name == name else [each])


def resized(scene: Scene, name: str, size_mm: Sequence[float]) -> Scene:
    """Return a scene with another size of a box or a cylinder."""
    return _with_fixtures(scene, lambda each: [_with(each, size_mm=tuple(size_mm)) if each.name == name else each])


def with_box(scene: Scene, box: Box) -> tuple[Scene, str]:
    """Return a scene with a keep-out box, which does not hide the part, and its name."""
    names = [each.name for each in scene.fixtures]
    name = next(text for number in range(1, len(names) + 2) if (text := f"keep-out {number}") not in names)
    fixture = BoxFixture(name=name, shape="box", position_mm=box.position_mm, size_mm=box.size_mm, occludes=False)
    return _with(scene, fixtures=(*scene.fixtures, fixture)), name


def pinned(scene: Scene, candidates: Sequence[int]) -> Scene:
    """Return a scene whose plan must use these candidates."""
    return _with(scene, plan=_with(scene.plan, pinned=tuple(candidates)))


def _with(model: Model, **update: object) -> Model:
    return model.model_copy(update=update)


def _with_fixtures(scene: Scene, change: Callable[[Any], list[Any]]) -> Scene:
    return _with(scene, fixtures=tuple(other for each in scene.fixtures for other in change(each)))


def _names(scene: Scene) -> str:
    return ", ".join(each.name for each in targets(scene))
