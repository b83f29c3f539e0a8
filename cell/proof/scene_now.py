"""The cell as the user's files describe it now, against the one that was planned in.

A plan rests on its run folder alone; but somebody who changed the scene file, or the part's mesh, after planning means
another cell than the one that was proven. So the files that the manifest names, or those given in their place, are
looked at again before anything is driven. What differs has a name: `part`, `placement`, `mount`, `housing`, `post`,
`pedestal`, `robot`, `table`, `fixture:NAME`; `scene` where the file cannot be read any more; `missing` for files that
are gone. The built-in robot is always this version's own (`cell.proof.cell_again`), so a difference there is never
accepted.
"""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from cell.errors import CellError, FileError, SceneError
from cell.part import workpiece
from cell.proof.artefacts import sha256_of
from cell.proof.files_now import MISSING, FilesNow
from cell.proof.proof import Proven
from cell.robot.model import KR16
from cell.runs.cell import scene_of_run
from cell.scene import settle
from cell.scene.file import load_scene
from cell.scene.model import Fixture, MeshFixture, Scene
from cell.session import ProgressReporter
from cell.world.shapes import fixture_mesh
from cell.world.table import rotary_table
from planner.geometry.mesh import TriangleMesh

_NEAR = 1e-6  # m, and entries of a rotation
_TABLES = {
    "placement": ("placement",),
    "mount": ("mount",),
    "housing": ("housing", "mount", "scanner"),
    "post": ("post", "robot"),
    "pedestal": ("robot",),
    "robot": ("robot",),
    "table": ("table",),
}
"""Of the scene file, the tables that say each thing."""


def require_same(proven: Proven, now: FilesNow, reporter: ProgressReporter | None, *, wire: bool) -> None:
    """The files still describe the cell that was planned in, but for what is accepted.

    Args:
        proven: the plan.
        now: the files, and what is accepted.
        reporter: is told what is accepted and which files are gone; None: nobody.
        wire: whether something real may move: files that are gone are a difference then.

    Raises:
        SceneError: naming every difference.
    """
    gone: list[str] = []
    found = dict(_differences(proven, now, gone))
    if gone:
        found[MISSING] = (
            f"{', '.join(gone)} {'is' if len(gone) == 1 else 'are'} gone and cannot be compared with the plan"
        )
    open_ = {name: told for name, told in found.items() if name not in now.accept_changed_scene}
    refused = {name: told for name, told in open_.items() if name != MISSING or wire}
    if refused:
        raise SceneError(
            f"the cell is no longer the one of the plan: {'; '.join(refused.values())}. Plan again, or accept it with "
            f"--accept-changed-scene {','.join(refused)}"
        )
    for told in found.values():
        if reporter is not None:
            reporter.note(told)


def _differences(proven: Proven, now: FilesNow, gone: list[str]) -> Iterator[tuple[str, str]]:
    """Name and sentence of each difference; files that are gone are appended to `gone`."""
    scene, changed = now.scene, None
    for named in proven.run.manifest.files:
        path = Path(named.path)
        if (named.what == "scene" and now.scene is not None) or (named.what == "part" and now.part is not None):
            continue
        sha = sha256_of(path)
        if not sha:
            gone.append(named.path)
        elif sha == named.sha256:
            continue
        elif named.what == "scene":
            scene, changed = path, _changed_tables(proven, path)
            if changed and "setup" in changed:
                yield "placement", f"the [[setup]] tables of {path} were changed"
        elif named.what == "part":
            yield from _part(proven, named.path)
        elif named.what == "robot":
            yield "robot", f"the robot's file {path} was changed"
        else:
            yield named.what, f"the mesh {path} of the fixture '{named.what.partition(':')[2]}' was changed"
    if now.part is not None:
        yield from _part(proven, now.part)
    if scene is not None:
        try:
            described = load_scene(scene)
        except CellError as error:
            yield "scene", " ".join(str(error).split())
            return
        if now.scene is not None and now.part is None and described.part.path is not None:
            yield from _part(proven, described.part.path)
        yield from _scene(proven, described, changed)


def _part(proven: Proven, source: str) -> Iterator[tuple[str, str]]:
    """Whether a part is the plan's: its file, or at least its surface."""
    try:
        part = workpiece.load(source, proven.scene.part.units)
    except CellError as error:
        yield "part", str(error)
        return
    if part.sha256 != proven.scene.part.sha256 and not _same_mesh(part.reference, proven.run.mesh("reference.ply")):
        yield "part", f"the part {source} has another surface than the one that was planned for"


def _changed_tables(proven: Proven, path: Path) -> set[str] | None:
    """Tables of a scene file that differ from those of the file that was planned with; None: not known."""
    try:
        then = tomllib.loads(proven.run.artefact("scene.toml").decode())
        now = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError, FileError):
        return None
    return {table for table in {*then, *now} if then.get(table) != now.get(table)}


def _scene(proven: Proven, now: Scene, changed: Collection[str] | None) -> Iterator[tuple[str, str]]:
    """What stands elsewhere, or otherwise, in a scene than in the plan.

    Args:
        proven: the plan.
        now: the scene.
        changed: tables of the scene file to look at; None: all. What the command line said in place of the others
            stands in the plan and not in the file.
    """
    then, due = proven.scene, scene_of_run(proven.run)
    now = _scanner_as_planned(now, due)
    values: Mapping[str, tuple[object, object]] = {
        "placement": (now.placement.by_centre(then.T_object_centre).T, due.placement.T),
        "mount": (now.mount.T, due.mount.T),
        "housing": (
            [now.mount.T @ now.housing.T_scanner_housing(now.scanner.baseline_mm or 0.0), *_housing(now)],
            [then.housing.T_flange_housing, *_housing(due)],
        ),
        "post": (
            [now.post.enabled, now.post.diameter_mm if now.post.enabled else 0.0],
            [due.post.enabled, due.post.diameter_mm if due.post.enabled else 0.0],
        ),
        "pedestal": (_pedestal(now), _pedestal(due)),
        "robot": ([now.robot.T_base, _named(proven, now)], [due.robot.T_base, True]),
        "table": (_table(proven, now), _table(proven, due)),
    }
    for name, (one, other) in values.items():
        looked_at = changed is None or any(table in changed for table in _TABLES[name])
        if looked_at and not _close(one, other):
            yield name, f"the {name} is another than the plan's"
    if changed is not None and "fixtures" not in changed:
        return
    here, there = ({fixture.name: fixture for fixture in scene.fixtures} for scene in (now, due))
    for name in sorted({*here, *there}):
        if name not in here or name not in there:
            yield f"fixture:{name}", f"the fixture '{name}' is {'new' if name in here else 'no longer there'}"
        elif not _same_fixture(here[name], there[name]):
            yield f"fixture:{name}", f"the fixture '{name}' is another, or elsewhere"


def _scanner_as_planned(now: Scene, due: Scene) -> Scene:
    """The scene with what it leaves open of its scanner as in the plan, or as of the other scanner that it names."""
    if now.scanner.sensor in (None, due.scanner.sensor):
        left = {"scanner": ("baseline_mm",), "housing": ("size_mm", "bracket_diameter_mm")}
        update = {}
        for table, keys in left.items():
            own, planned = getattr(now, table), getattr(due, table)
            update[table] = own.model_copy(
                update={key: getattr(planned, key) for key in keys if getattr(own, key) is None}
            )
        return now.model_copy(update=update)
    return settle.settled(now.model_copy(update={"plan": due.plan}), due.part.name, 0.0)


def _housing(scene: Scene) -> list[float]:
    return [*scene.housing.sides_mm, scene.housing.bracket_mm]


def _pedestal(scene: Scene) -> list[float]:
    """Height of the floor, and the pedestal's sides and middle where there is one."""
    return [scene.robot.pedestal_height_mm, *(number for row in scene.robot.pedestal_mm or () for number in row)]


def _table(proven: Proven, scene: Scene) -> list[object]:
    """Where a scene's rotary table stands, its size, range, rates and manner; empty where it has none."""
    placement = scene.placement.by_centre(proven.scene.T_object_centre)
    placed = scene.model_copy(update={"placement": placement})
    try:
        table = rotary_table(placed, proven.world.placed(placement.T), proven.world.part_hull)
    except SceneError:
        return [False]  # one that cannot be is no plan's
    if table is None:
        return []
    rates = table.velocity, table.acceleration, table.jerk
    size, indexed = (scene.table.diameter_mm, scene.table.height_mm), scene.table.moves == "indexed"
    return [table.T_base_table, [*size, indexed], [table.lower, table.upper, *rates]]


def _named(proven: Proven, scene: Scene) -> bool:
    """Whether a scene names the robot of the plan."""
    planned = proven.scene.robot.name if proven.scene.robot is not None else KR16
    return Path(scene.robot.model).name == planned


def _close(one: object, other: object) -> bool:
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_close(*pair) for pair in zip(one, other, strict=True))
    return bool(np.allclose(np.asarray(one, float), np.asarray(other, float), rtol=0.0, atol=_NEAR))


def _same_fixture(one: Fixture, other: Fixture) -> bool:
    if (one.shape, one.attached_to) != (other.shape, other.attached_to):
        return False
    if isinstance(one, MeshFixture) and isinstance(other, MeshFixture):
        return _same_mesh(fixture_mesh(one), fixture_mesh(other))
    assert not isinstance(one, MeshFixture)
    assert not isinstance(other, MeshFixture)
    sizes = [np.asarray(fixture.size_mm) for fixture in (one, other)]
    return _close(one.T, other.T) and _close(*sizes)


def _same_mesh(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Whether two meshes have the same triangles at the same places, one after the other."""
    return len(one.faces) == len(other.faces) and _close(one.vertices[one.faces], other.vertices[other.faces])
