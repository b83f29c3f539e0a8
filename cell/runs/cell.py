"""Rebuild the cell of a run from its own files.

A command works in the planned cell even if the scene file or the part's file changed since. `RunCell` holds what scans
and coverage need: its occluders are the shapes of `cell.xml`, converted to triangles by the same function as in
planning. `world_of` compiles the cell again, unchanged or without some fixtures. Metres and radians, object frame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cell import scanners
from cell.errors import SceneError, UsageError
from cell.robot.model import KR16
from cell.runs.run import Run, reading
from cell.runs.schema import ResolvedScene, ScannerKeys, StandingFixture
from cell.scene.file import BUILT_IN
from cell.scene.model import Placement, PlanKeys, Region, Scene, pose_keys
from cell.scene.regions import with_limits
from cell.world import shapes
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World, compile_world
from cell.world.occluders import Occluder, make_caster, names_beside_table, occluders_of_model
from cell.world.table import ENDLESS_LIMITS_DEG, kinematics_on_table
from cell.world.travel import TravelBound, table_radius
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import RotaryTable
from planner.ports import ARM_AXES, Kinematics, Scanner
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, slots=True, eq=False)
class RunCell:
    """Part, occluders and scanner of a run.

    Attributes:
        scene: scene.resolved.json.
        reference: the part [m].
        planning: its decimated copy [m].
        part_caster: ray caster of the reference.
        occluders: post, pedestal, floor and occluding fixtures.
        occluder_caster: ray caster of the occluders.
        scanner: the scanner, at the requested resolution and with the plan's sigma limit.
        scanner_keys: its keys in scene.resolved.json.
        kinematics: of the arm, with the rotary table if there is one.
        travel: upper bound on the displacement of any point of arm or tool between two configurations.
        table: rotary table; None if the part is fixed.
    """

    scene: ResolvedScene
    reference: TriangleMesh
    planning: TriangleMesh
    part_caster: EmbreeRayCaster
    occluders: tuple[Occluder, ...]
    occluder_caster: EmbreeRayCaster
    scanner: Scanner
    scanner_keys: ScannerKeys
    kinematics: Kinematics
    travel: TravelBound
    table: RotaryTable | None = None

    @property
    def casters(self) -> tuple[EmbreeRayCaster, EmbreeRayCaster]:
        """Ray casters of the part and of the occluders."""
        return self.part_caster, self.occluder_caster

    def in_base(self, q: Floats, T_part: Floats) -> Floats:
        """Return (..., 4, 4) poses in base of poses relative to the turned part, at (..., axes) angles [m, rad]."""
        return T_part if self.table is None else self.table.turn(q[..., ARM_AXES]) @ T_part

    @property
    def arrival(self) -> float:
        """Tolerance on the position of any point of arm or tool at the end of a move [m]."""
        allowed = self.scene.arrival_mm
        return (min(1.0, self.scene.clearance_mm / 10) if allowed is None else allowed) / 1000

    def path_tolerance(self, proven_clearance: float = np.inf) -> float:
        """Return how far any point of arm or tool may be from the path of a move [m].

        It is at most half of the proven clearance of the motion, and of the clearance of the scene, of which a
        certified segment keeps more than half (`planner.path.certified_edge`). The rest remains until a stop acts.

        Args:
            proven_clearance: lower bound of the motion [m].
        """
        allowed = self.scene.path_tolerance_mm
        half = min(self.scene.clearance_mm / 1000, proven_clearance) / 2
        return half if allowed is None else min(allowed / 1000, half)

    def scanner_pose(self, q: Floats) -> Floats:
        """Return (4, 4) T_object_scanner [m] at (axes,) joint angles [rad]."""
        T_part_scanner = self.kinematics.forward(np.asarray(q)[None])[0] @ self.scene.T_flange_scanner
        T: Floats = np.linalg.inv(self.scene.T_base_object) @ T_part_scanner
        return T

    def with_surface(self, mesh: TriangleMesh) -> RunCell:
        """Return the cell with another surface of the part [m], object frame, for the rays of scans."""
        return replace(self, reference=mesh, part_caster=EmbreeRayCaster(mesh.vertices, mesh.faces))

    def about_part(self, T: Floats) -> RunCell:
        """Return the cell for a part that is displaced: its surroundings are moved by (4, 4) T in the object frame.

        The post and fixtures attached to the part stay with the part.
        """
        R, t = T[:3, :3], T[:3, 3]
        with_it = {"post", *(each.name for each in self.scene.fixtures if each.attached_to == "object")}
        moved = tuple(
            each if each.name in with_it else replace(each, vertices=each.vertices @ R.T + t) for each in self.occluders
        )
        return replace(self, occluders=moved, occluder_caster=make_caster(moved))


def collision_note(scene: ResolvedScene) -> list[str]:
    """Return a sentence about shapes that `world_of` takes as triangles and an older version did not, or []."""
    if scene.plan.collision == "hull":
        return []
    parts = ["the part as convex pieces"] if scene.plan.collision == "decomposed" else []
    hulls = [fixture.name for fixture in scene.fixtures if fixture.file is not None and fixture.collision != "exact"]
    parts += [f"the fixture '{name}' as its convex hull" for name in hulls]
    return [f"the plan was checked with {' and '.join(parts)}; their triangles are used here"] if parts else []


def read_cell(run: Run, resolution_deg: float | None = None) -> RunCell:
    """Return the cell of a finished run; `resolution_deg` replaces the plan's angle between neighbouring rays."""
    from cell.robot.arm import kinematics_of

    scene, model = run.scene, run.cell_model()
    reference = run.mesh("reference.ply")
    keys = scene.scanner
    known = scanners.keys(keys.type)
    if resolution_deg is not None and known is not None and "resolution_deg" not in known:
        raise UsageError(f"--resolution is the angle between rays, and the scanner {keys.type} has none; omit it")
    if resolution_deg is not None:
        keys = ScannerKeys(**keys.as_json() | {"resolution_deg": [resolution_deg, resolution_deg]})
    try:
        scanner = scanner_of(scene, keys)
    except SceneError as error:
        if resolution_deg is None:
            raise
        raise UsageError(f"--resolution {resolution_deg:g} is not possible: {error}") from error
    with reading(run.folder / "cell.xml"):
        table, home = table_of(scene), np.append(np.radians(scene.home_deg), 0.0)
        kinematics = kinematics_on_table(
            kinematics_of(model), table, home, 0 if scene.table is None else scene.table.angles
        )
        occluders, radius = _surroundings(run, scene, model, table)
    return RunCell(
        scene=scene,
        reference=reference,
        planning=run.mesh("planning.ply"),
        part_caster=EmbreeRayCaster(reference.vertices, reference.faces),
        occluders=occluders,
        occluder_caster=make_caster(occluders),
        scanner=scanner,
        scanner_keys=keys,
        kinematics=kinematics,
        travel=TravelBound(model, radius),
        table=table,
    )


def table_of(scene: ResolvedScene) -> RotaryTable | None:
    """Return the rotary table of a run; None if the part is fixed."""
    table = scene.table
    if table is None:
        return None
    limits = table.free_range_deg or table.limits_deg or ENDLESS_LIMITS_DEG
    rates = table.velocity_deg_s, table.acceleration_deg_s2, table.jerk_deg_s3
    return RotaryTable(table.T_base_table, *np.deg2rad([*limits, *rates]).tolist())


def scanner_of(scene: ResolvedScene, keys: ScannerKeys) -> Scanner:
    """Return the scanner with these keys and the plan's sigma limit, which also applies to scans."""
    return with_limits(scanners.make(keys.type, keys.own), scene.plan.max_sigma_mm, scene.regions or ())


def _surroundings(
    run: Run, scene: ResolvedScene, model: mujoco.MjModel, table: RotaryTable | None
) -> tuple[tuple[Occluder, ...], float]:
    """Return the planned occluders, and the radius of the turned objects about the axis of the table [m].

    Equal to those of the plan bit for bit, except for mesh fixtures, which are stored in millimetres.
    """
    import mujoco

    data, T = mujoco.MjData(model), scene.T_base_object
    data.mocap_quat[model.body("object").mocapid] = shapes.quaternion(T[:3, :3])
    if table is not None:
        data.mocap_quat[model.body("post").mocapid] = shapes.quaternion(table.T_base_table[:3, :3])
    mujoco.mj_kinematics(model, data)
    meshes = {each.name: run.mesh(each.file) for each in scene.fixtures if each.file is not None}
    pieces = occluders_of_model(data, T, meshes, [each.name for each in scene.fixtures if not each.occludes])
    names = (each.name for each in scene.fixtures if each.attached_to == "base" and not each.built_in)
    ignored = names_beside_table(table, names)
    return tuple(piece for piece in pieces if piece.name not in ignored), table_radius(model, data, table)


def world_of(
    run: Run, part: TriangleMesh, *, without: Collection[str] = (), T_base_object: Floats | None = None
) -> World:
    """Compile the cell of a run again, unchanged (see `collision_note`) or without some fixtures.

    Args:
        run: the run.
        part: its reference [m].
        without: names of fixtures to omit; "post" omits the post.
        T_base_object: (4, 4) another placement of the part [m]; a rotary table stays in place.
    """
    resolved = run.scene
    keys, scene = resolved.scanner, scene_of_run(run, without)
    if T_base_object is not None:
        scene = with_placement(scene, T_base_object, resolved)
    baseline_mm = scanners.baseline_mm(keys.own, scanners.make(keys.type, keys.own))
    return compile_world(scene, part.vertices, part_faces=part.faces, baseline_mm=baseline_mm)


def scene_of_run(run: Run, without: Collection[str] = ()) -> Scene:
    """Return the scene of a run with all values resolved; its part is the run's reference.ply.

    `without` names fixtures to omit; "post" omits the post.
    """
    resolved = run.scene
    T_scanner_housing = np.linalg.inv(resolved.T_flange_scanner) @ resolved.housing.T_flange_housing
    fixtures = [fixture for fixture in resolved.fixtures if fixture.name not in without]
    built_in = {fixture.name: fixture for fixture in fixtures if fixture.built_in}
    pedestal, post = built_in.get("pedestal"), built_in.get("post")
    with reading(run.folder / "scene.resolved.json"):
        scene = Scene.model_validate(
            {
                "clearance_mm": resolved.clearance_mm,
                "plan": _plan(resolved),
                "robot": {
                    **_robot(run, resolved),
                    **_limits(resolved),
                    "home_deg": resolved.home_deg,
                    "pedestal_height_mm": round(-1000 * built_in["floor"].pose[2, 3], 9),
                    **({} if pedestal is None else {"pedestal_size_mm": pedestal.size_mm[:2]}),
                },
                "scanner": {"type": resolved.scanner.type, **resolved.scanner.own},
                "mount": pose_keys(resolved.T_flange_scanner),
                "housing": {
                    **pose_keys(T_scanner_housing),
                    "size_mm": resolved.housing.size_mm,
                    "bracket_diameter_mm": resolved.housing.bracket_diameter_mm,
                },
                "part": _part(run, resolved),
                "placement": pose_keys(resolved.T_base_object @ resolved.T_object_centre),
                "post": {"enabled": False} if post is None else {"diameter_mm": post.size_mm[0]},
                "table": _table(resolved),
                "fixtures": [
                    {**fixture.model_dump(include={"name", "shape", "attached_to", "occludes"}), **_place(run, fixture)}
                    for fixture in fixtures
                    if not fixture.built_in
                ],
            }
        )
    # Keys that the validated tables do not accept next to resolved values: not every scanner has a planning resolution,
    # and a percentage of faces excludes their number.
    scanner: dict[str, object] = {"planning_resolution_deg": resolved.planning_resolution_deg}
    if run.has("report.json"):
        scanner["sensor"] = run.report.settings.sensor
    return scene.model_copy(
        update={
            "robot": scene.robot if resolved.robot is None else scene.robot.with_name(resolved.robot.name),
            "scanner": scene.scanner.model_copy(update=scanner),
            "plan": scene.plan.model_copy(update={"percent_kept": resolved.plan.percent_kept}),
            # Their selectors are applied already: the run's mesh stores the region of each face.
            "region": tuple(Region.model_construct(**dict(region)) for region in resolved.regions or ()),
        }
    )


def with_placement(scene: Scene, T_base_object: Floats, resolved: ResolvedScene) -> Scene:
    """Return a scene of a run with another placement (4, 4) of the part [m]; a rotary table stays in place."""
    update: dict[str, object] = {"placement": Placement.at(T_base_object @ resolved.T_object_centre)}
    if resolved.table is not None:
        update["table"] = scene.table.model_copy(update=pose_keys(resolved.table.T_base_table))
    return scene.model_copy(update=update)


def _plan(resolved: ResolvedScene) -> dict[str, object]:
    """Return the keys of `[plan]`. Convex pieces of earlier versions become triangles."""
    omitted = {"percent_kept", "coverage" if resolved.plan.max_views is not None else ""}
    keys = {name: getattr(resolved.plan, name) for name in PlanKeys.model_fields if name not in omitted}
    return keys | {"collision": "hull" if resolved.plan.collision == "hull" else "exact"}


def _robot(run: Run, resolved: ResolvedScene) -> dict[str, object]:
    """Return the keys of `[robot]` for model and base."""
    if resolved.robot is None:
        return {}
    model: str = resolved.robot.model
    if model != KR16:
        run.artefact(model)  # checks its sha256
        model = str((run.folder / model).absolute())
    upright = np.array_equal(resolved.robot.T_base, np.eye(4))
    return {"model": model, **({} if upright else {"base": pose_keys(resolved.robot.T_base)})}


def _table(resolved: ResolvedScene) -> Mapping[str, object]:
    """Return the keys of `[table]`; empty without a table."""
    if resolved.table is None:
        return {}
    keys = resolved.table.model_dump(exclude={"T_base_table", "post_mm", "free_range_deg"})
    pose = pose_keys(resolved.table.T_base_table)
    if resolved.table.post_mm is not None:
        return {**keys, "post_mm": resolved.table.post_mm, "abc_deg": pose["abc_deg"]}
    return {**keys, **pose}


def _limits(resolved: ResolvedScene) -> dict[str, object]:
    """Return the keys of `[robot]` for the limits of the axes."""
    jerk = resolved.joint_jerk_limits_deg_s3 or (None,) * len(resolved.joint_limits_deg)
    return {
        "velocity_deg_s": resolved.joint_velocity_limits_deg_s,
        "acceleration_deg_s2": resolved.joint_acceleration_limits_deg_s2,
        "jerk_deg_s3": tuple(float("inf") if limit is None else limit for limit in jerk),
        "speed_scaling": resolved.speed_scaling,
        "acceleration_scaling": resolved.acceleration_scaling,
    }


def _part(run: Run, resolved: ResolvedScene) -> dict[str, object]:
    """Return the keys of `[part]`: the name of a built-in part, or the run's own mesh, which is in millimetres."""
    if resolved.part.units is None and resolved.part.name in BUILT_IN:
        return {"name": resolved.part.name}
    return {"path": str((run.folder / "reference.ply").absolute()), "units": "mm"}


def _place(run: Run, fixture: StandingFixture) -> Mapping[str, object]:
    """Return the keys of a fixture that depend on its shape."""
    if fixture.file is None:
        return {**pose_keys(fixture.pose), "size_mm": fixture.size_mm}
    run.artefact(fixture.file)  # checks its sha256
    # The vertices are stored in the frame that the mesh is attached to, so there is no pose.
    return {"path": str((run.folder / fixture.file).absolute()), "units": "mm"}
