"""Compare the user's current files with the cell that was planned.

A plan depends on its run folder alone. If the scene file or the part's mesh changed after planning, the user may mean
another cell than the verified one; if the folder was changed, it describes another cell than the files. Therefore the
files named in the manifest, or those given instead, are read again before anything is driven, also if they are
unchanged; without a scene file, the built-in scene. Keys that options replaced (`overrides` of the manifest) are not
compared. Each difference has a name: `part`, `placement`, `mount`, `housing`, `post`, `pedestal`, `robot`, `limits`,
`speed`, `table`, `fixture:NAME`; `scene` if the file cannot be read; `missing` for deleted files. The built-in robot
always comes from this version (`cell.runs.verification`), so a difference there is never accepted.
"""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from cell.errors import CellError, FileError, SceneError
from cell.part import builtin, workpiece
from cell.robot import model as robot
from cell.robot.model import KR16
from cell.runs.cell import scene_of_run
from cell.runs.current_files import CurrentFiles
from cell.runs.verification import VerifiedPlan, sha256_of
from cell.scene.file import load_scene
from cell.scene.model import Fixture, MeshFixture, Scene
from cell.scene.settle import with_device
from cell.session import ProgressReporter
from cell.world.shapes import fixture_mesh
from cell.world.table import place_table
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.ports import ARM_AXES

MISSING = "missing"
"""Name that accepts missing files."""

_SCENE_TOLERANCE = 1e-6  # m, and entries of a rotation
_TABLES = {
    "placement": ("placement",),
    "mount": ("mount",),
    "housing": ("housing", "mount", "scanner"),
    "post": ("post", "robot"),
    "pedestal": ("robot",),
    "robot": ("robot",),
    "limits": ("robot",),
    "speed": ("robot",),
    "table": ("table",),
}
"""Tables of the scene file that define each object."""

_KEYS = {
    **_TABLES,
    "post": ("post", "robot.pedestal"),
    "pedestal": ("robot.pedestal",),
    "robot": ("robot.model", "robot.base"),
    "limits": ("robot.velocity", "robot.acceleration_deg", "robot.jerk"),
    "speed": ("robot.speed", "robot.acceleration_scaling"),
    "table": ("table", "placement"),
}
"""Beginnings of the keys that define each object."""


def require_current_scene(
    verified: VerifiedPlan, now: CurrentFiles, reporter: ProgressReporter | None, *, wire: bool
) -> None:
    """Raise SceneError unless the current files describe the planned cell, except for accepted differences.

    Args:
        verified: the plan.
        now: the current files and the accepted differences.
        reporter: receives notes about accepted differences and missing files.
        wire: whether a real controller is driven; a missing file is then a difference.
    """
    missing_files: list[str] = []
    differences = dict(_differences(verified, now, missing_files))
    if missing_files:
        differences[MISSING] = (
            f"{', '.join(missing_files)} {'is' if len(missing_files) == 1 else 'are'} missing and cannot be compared "
            "with the plan"
        )
    unaccepted = {name: sentence for name, sentence in differences.items() if name not in now.accept_changed_scene}
    refused = {name: sentence for name, sentence in unaccepted.items() if name != MISSING or wire}
    if refused:
        raise SceneError(
            f"the cell differs from the plan: {'; '.join(refused.values())}. Plan again, or accept it with "
            f"--accept-changed-scene {','.join(refused)}"
        )
    for sentence in differences.values():
        if reporter is not None:
            reporter.note(sentence)


def _differences(verified: VerifiedPlan, now: CurrentFiles, missing_files: list[str]) -> Iterator[tuple[str, str]]:
    """Yield name and sentence of each difference; append missing files to `missing_files`."""
    scene, changed = now.scene, None
    for file in verified.run.manifest.files:
        path = Path(file.path)
        if (file.role == "scene" and now.scene is not None) or (file.role == "part" and now.part is not None):
            continue
        sha = sha256_of(path)
        if not sha:
            missing_files.append(file.path)
        elif file.role == "part":
            yield from _part(verified, file.path)
        elif sha == file.sha256:
            continue
        elif file.role == "scene":
            scene, changed = path, _changed_tables(verified, path)
            if changed and "setup" in changed:
                yield "placement", f"the [[setup]] tables of {path} were changed"
        elif file.role == "robot":
            yield "robot", f"the robot's file {path} was changed"
        else:
            yield file.role, f"the mesh {path} of the fixture '{file.role.partition(':')[2]}' was changed"
    if now.part is not None:
        yield from _part(verified, now.part)
    elif verified.scene.part.name in builtin.NAMES and verified.scene.part.units is None:
        yield from _part(verified, verified.scene.part.name)
    if scene is None and not missing_files:
        yield from _unchanged_scene(verified)
    if scene is not None:
        try:
            described = load_scene(scene)
        except CellError as error:
            yield "scene", " ".join(str(error).split())
            return
        if now.scene is not None and now.part is None and described.part.path is not None:
            yield from _part(verified, described.part.path)
        yield from _scene(verified, described, changed)


def _part(verified: VerifiedPlan, source: str) -> Iterator[tuple[str, str]]:
    """Yield a difference unless the part has the same file or the same surface as in the plan."""
    try:
        part = workpiece.load(source, verified.scene.part.units)
    except CellError as error:
        yield "part", str(error)
        return
    planned = verified.run.mesh("reference.ply")
    is_same = _same_mesh if planned.region is None else _same_surface
    if not is_same(part.reference, planned):
        yield "part", f"the part {source} has another surface than the planned part"


def _unchanged_scene(verified: VerifiedPlan) -> Iterator[tuple[str, str]]:
    """Yield the differences of the plan from its unchanged scene file, or from the built-in scene."""
    overrides = verified.run.manifest.overrides
    if overrides is None:  # of an earlier version
        return
    paths = [Path(file.path) for file in verified.run.manifest.files if file.role == "scene"]
    try:
        described = load_scene(paths[0] if paths else None)
    except CellError as error:
        yield "scene", " ".join(str(error).split())
        return
    skipped = {
        name for name, keys in _KEYS.items() if any(key.startswith(begin) for key in overrides for begin in keys)
    }
    yield from _scene(verified, described, None, {*skipped, *({"fixtures"} & {*overrides})})


def _changed_tables(verified: VerifiedPlan, path: Path) -> set[str] | None:
    """Return the tables of a scene file that differ from the planned file; None if unknown."""
    try:
        then = tomllib.loads(verified.run.artefact("scene.toml").decode())
        now = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError, FileError):
        return None
    return {table for table in {*then, *now} if then.get(table) != now.get(table)}


def _scene(
    verified: VerifiedPlan, now: Scene, changed: Collection[str] | None, skipped: Collection[str] = ()
) -> Iterator[tuple[str, str]]:
    """Yield the differences between a scene and the plan.

    Args:
        verified: the plan.
        now: the current scene.
        changed: tables of the scene file to compare; None means all. Unchanged tables are skipped, because the plan may
            use values from the command line instead of the file.
        skipped: names that are not compared.
    """
    then, planned = verified.scene, scene_of_run(verified.run)
    now = _scanner_as_planned(now, planned)
    values: Mapping[str, tuple[object, object]] = {
        "placement": (now.placement.by_centre(then.T_object_centre).T, planned.placement.T),
        "mount": (now.mount.T, planned.mount.T),
        "housing": (
            [now.mount.T @ now.housing.T_scanner_housing(now.scanner.baseline_mm or 0.0), *_housing(now)],
            [then.housing.T_flange_housing, *_housing(planned)],
        ),
        "post": (
            [now.post.enabled, now.post.diameter_mm if now.post.enabled else 0.0],
            [planned.post.enabled, planned.post.diameter_mm if planned.post.enabled else 0.0],
        ),
        "pedestal": (_pedestal(now), _pedestal(planned)),
        "robot": ([now.robot.T_base, _names_robot(verified, now)], [planned.robot.T_base, True]),
        "limits": (_limits(verified, now), _limits(verified, planned)),
        "speed": (
            [now.robot.speed_scaling, now.robot.acceleration_scaling],
            [then.speed_scaling, then.acceleration_scaling],
        ),
        "table": (_table(verified, now), _table(verified, planned)),
    }
    for name, (one, other) in values.items():
        looked_at = changed is None or any(table in changed for table in _TABLES[name])
        if looked_at and name not in skipped and not _close(one, other):
            yield name, f"the {name} {'differ' if name == 'limits' else 'differs'} from the plan"
    if "fixtures" in skipped or (changed is not None and "fixtures" not in changed):
        return
    here, there = ({fixture.name: fixture for fixture in scene.fixtures} for scene in (now, planned))
    for name in sorted({*here, *there}):
        if name not in here or name not in there:
            yield f"fixture:{name}", f"the fixture '{name}' is {'new' if name in here else 'missing'}"
        elif not _same_fixture(here[name], there[name]):
            yield f"fixture:{name}", f"the fixture '{name}' has another shape, size or pose"


def _scanner_as_planned(now: Scene, planned: Scene) -> Scene:
    """Return the scene with unset scanner keys taken from the plan, or from the sensor that it names."""
    if now.scanner.sensor in (None, planned.scanner.sensor):
        left = {"scanner": ("baseline_mm",), "housing": ("size_mm", "bracket_diameter_mm")}
        update = {}
        for table, keys in left.items():
            current, default = getattr(now, table), getattr(planned, table)
            update[table] = current.model_copy(
                update={key: getattr(default, key) for key in keys if getattr(current, key) is None}
            )
        return now.model_copy(update=update)
    return with_device(now.model_copy(update={"plan": planned.plan}), planned.part.name, 0.0)


def _housing(scene: Scene) -> list[float]:
    return [*scene.housing.sides_mm, scene.housing.bracket_mm]


def _pedestal(scene: Scene) -> list[float]:
    """Return the height of the floor, and sides and centre of the pedestal if there is one."""
    return [scene.robot.pedestal_height_mm, *(number for row in scene.robot.pedestal_mm or () for number in row)]


def _table(verified: VerifiedPlan, scene: Scene) -> list[object]:
    """Return pose, size, range, rates and mode of the rotary table; empty without one."""
    placement = scene.placement.by_centre(verified.scene.T_object_centre)
    placed = scene.model_copy(update={"placement": placement})
    try:
        table = place_table(placed, verified.world.T_base_object_at(placement.T), verified.world.part_hull)
    except SceneError:
        return [False]  # an impossible table differs from any planned one
    if table is None:
        return []
    rates = table.velocity, table.acceleration, table.jerk
    size, indexed = (scene.table.diameter_mm, scene.table.height_mm), scene.table.moves == "indexed"
    return [table.T_base_table, [*size, indexed], [table.lower, table.upper, *rates]]


def _limits(verified: VerifiedPlan, scene: Scene) -> list[object]:
    """Return speeds, accelerations and jerks of the arm [deg]; -1 for a jerk without limit."""
    keys = scene.robot
    limits = robot.override_limits(
        robot.limits(verified.world.model), keys.velocity_deg_s, keys.acceleration_deg_s2, keys.jerk_deg_s3
    )
    jerk = np.where(np.isfinite(limits.jerk), limits.jerk, np.radians(-1.0))
    return [np.degrees(each[:ARM_AXES]) for each in (limits.velocity, limits.acceleration, jerk)]


def _names_robot(verified: VerifiedPlan, scene: Scene) -> bool:
    """Return whether a scene names the robot of the plan."""
    planned = verified.scene.robot.name if verified.scene.robot is not None else KR16
    return scene.robot.name == planned


def _close(one: object, other: object) -> bool:
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_close(*pair) for pair in zip(one, other, strict=True))
    return bool(np.allclose(np.asarray(one, float), np.asarray(other, float), rtol=0.0, atol=_SCENE_TOLERANCE))


def _same_fixture(one: Fixture, other: Fixture) -> bool:
    if (one.shape, one.attached_to) != (other.shape, other.attached_to):
        return False
    if isinstance(one, MeshFixture) and isinstance(other, MeshFixture):
        try:
            return _same_mesh(fixture_mesh(one), fixture_mesh(other))
        except CellError:  # a file that cannot be read is not the planned one
            return False
    assert not isinstance(one, MeshFixture)
    assert not isinstance(other, MeshFixture)
    sizes = [np.asarray(fixture.size_mm) for fixture in (one, other)]
    return _close(one.T, other.T) and _close(*sizes)


def _same_surface(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two meshes are the same surface, whatever its triangles: borders of regions cut triangles."""
    areas = float(one.areas.sum()), float(other.areas.sum())
    off = [ClosestPointQuery(a).closest(b.vertices).distance.max() for a, b in ((one, other), (other, one))]
    return max(off) <= _SCENE_TOLERANCE and abs(areas[0] - areas[1]) <= _SCENE_TOLERANCE * areas[0]


def _same_mesh(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two meshes have the same triangles in the same order."""
    return len(one.faces) == len(other.faces) and _close(one.vertices[one.faces], other.vertices[other.faces])
