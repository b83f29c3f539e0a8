"""The cell of a run, read back from `scene.resolved.json` and the model that was checked, or compiled anew.

Everything comes from the run's own files, so that a command works in the cell that was planned in, whatever became of
the scene file or the part's file since. `RunCell` is what is measured in: its occluders are the shapes of `cell.xml`,
made into triangles by the function that the plan used. `world_of` compiles the cell anew, as it was or with one thing
taken out of it. Metres, radians; object frame where nothing else is said.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cell import scanners
from cell.errors import SceneError, UsageError
from cell.rays.embree import EmbreeRayCaster
from cell.rays.occluders import Occluder, caster_of, standing_triangles
from cell.robot.frames import kuka_abc_from_pose
from cell.run import reader as run_reader
from cell.run.record import RunRecord, artefact, artefact_json, understood
from cell.scene.scene import Scene
from cell.world import shapes
from cell.world.model import World, compile_world
from planner.measurability.quality import Limited
from planner.ports import Floats, Scanner
from planner.surface.mesh import TriangleMesh
from planner.values import readonly

if TYPE_CHECKING:
    import mujoco

    from cell.robot.kinematics import Kr16Kinematics

_FILE = "scene.resolved.json"


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScene:
    """What `scene.resolved.json` says that commands ask for.

    Attributes:
        part_name: for reports.
        T_base_object: (4, 4) placement [m].
        T_object_centre: (4, 4) middle of the part's bounding box [m].
        T_flange_scanner: (4, 4) mount [m].
        scanner: what defines the scanner, its `type` among it.
        max_sigma: limit on the expected standard deviation of a point [m]; None where there is none.
        clearance: distance that a free configuration keeps [m].
        collision: what the part was to arm and scanner: hull, exact or (earlier versions) decomposed, convex pieces.
        speed: fraction of the axis speeds that the plan was timed with.
        acceleration: the same of the accelerations.
        required_visible: visible coverage that the plan was asked for, fraction.
        preset: that the plan was made with; None: of a version without.
        targeted: whether candidates were aimed at what stayed open.
        removable: names of the fixtures, and "post": what may be taken out.
        glass: names of the fixtures that hide nothing.
        mesh_files: file of each mesh fixture by its name.
        as_hulls: names of those that arm and scanner kept clear of as convex hulls.
    """

    part_name: str
    T_base_object: Floats
    T_object_centre: Floats
    T_flange_scanner: Floats
    scanner: Mapping[str, Any]
    max_sigma: float | None
    clearance: float
    collision: str
    speed: float
    acceleration: float
    required_visible: float
    preset: str | None
    targeted: bool
    removable: tuple[str, ...]
    glass: tuple[str, ...]
    mesh_files: Mapping[str, str]
    as_hulls: tuple[str, ...]

    def taken_as_triangles(self) -> list[str]:
        """What `world_of` takes as its triangles and earlier versions checked otherwise: a sentence, or none."""
        if self.collision == "hull":
            return []
        parts = ["the part as convex pieces"] if self.collision == "decomposed" else []
        parts += [f"the fixture '{name}' as its convex hull" for name in self.as_hulls]
        return [f"the plan was checked with {' and '.join(parts)}; true triangles are taken here"] if parts else []


@dataclass(frozen=True, slots=True, eq=False)
class RunCell:
    """Part, surroundings and scanner of a run: what is measured in.

    Attributes:
        scene: placement, mount and settings.
        reference: the part [m].
        planning: its decimated copy [m].
        part_caster: casts rays on the reference.
        occluders: post, pedestal, floor and the fixtures that occlude.
        occluder_caster: casts rays on them.
        scanner: the sensor's law, at the resolution that was asked for and with the plan's limit on sigma.
        scanner_parameters: what defines it, named as in the run folder.
        kinematics: of the arm.
    """

    scene: RecordedScene
    reference: TriangleMesh
    planning: TriangleMesh
    part_caster: EmbreeRayCaster
    occluders: tuple[Occluder, ...]
    occluder_caster: EmbreeRayCaster
    scanner: Scanner
    scanner_parameters: Mapping[str, Any]
    kinematics: Kr16Kinematics

    def scanner_pose(self, q: Floats) -> Floats:
        """(4, 4) T_object_scanner [m] at (6,) joint angles [rad]."""
        T_base_scanner = self.kinematics.forward(np.asarray(q)[None])[0] @ self.scene.T_flange_scanner
        T: Floats = np.linalg.inv(self.scene.T_base_object) @ T_base_scanner
        return T


def read_scene(run: RunRecord) -> RecordedScene:
    """The scene of a run.

    Raises:
        FileError: if scene.resolved.json is missing, changed or damaged.
    """
    resolved = artefact_json(run, _FILE)
    with understood(run.folder / _FILE):
        plan, fixtures = resolved["plan"], resolved["fixtures"]
        max_sigma_mm = plan.get("max_sigma_mm")
        return RecordedScene(
            part_name=str(resolved["part"]["name"]),
            T_base_object=_transform(resolved, "T_base_object"),
            T_object_centre=_transform(resolved, "T_object_centre"),
            T_flange_scanner=_transform(resolved, "T_flange_scanner"),
            scanner=dict(resolved["scanner"], type=str(resolved["scanner"]["type"])),
            max_sigma=None if max_sigma_mm is None else float(max_sigma_mm) / 1000,
            clearance=float(resolved["clearance_mm"]) / 1000,
            collision=plan.get("collision", "hull"),  # runs that do not say it were checked with the hull
            speed=float(resolved["speed_scaling"]),
            acceleration=float(resolved["acceleration_scaling"]),
            required_visible=float(plan["required_visible"]),
            preset=plan.get("preset"),
            targeted=plan["candidates"] == "targeted",
            removable=tuple(f["name"] for f in fixtures if not f["built_in"] or f["name"] == "post"),
            glass=tuple(f["name"] for f in fixtures if not f["occludes"]),
            mesh_files={f["name"]: f["file"] for f in fixtures if f["shape"] == "mesh"},
            as_hulls=tuple(f["name"] for f in fixtures if f["shape"] == "mesh" and f.get("collision") != "exact"),
        )


def read_cell(run: RunRecord, resolution_deg: float | None = None) -> RunCell:
    """Read the cell of a run, ready to be measured in.

    Args:
        run: a run folder with every artefact of a finished plan.
        resolution_deg: angle between neighbouring rays in place of the plan's; None keeps that.

    Raises:
        UsageError: if the resolution is not possible.
        FileError: if an artefact is missing, changed or damaged.
    """
    from cell.robot.kinematics import Kr16Kinematics

    scene, model = read_scene(run), run_reader.cell_model(run)
    reference = run_reader.mesh(run, "reference.ply")
    parameters = dict(scene.scanner)
    if resolution_deg is not None:
        parameters["resolution_deg"] = [resolution_deg, resolution_deg]
    try:
        values = {key: value for key, value in parameters.items() if key != "type"}
        scanner: Any = scanners.make(str(parameters["type"]), values)
    except SceneError as error:
        if resolution_deg is None:
            raise
        raise UsageError(f"--resolution {resolution_deg:g} is not possible: {error}") from error
    if scene.max_sigma is not None:
        scanner = Limited(scanner, scene.max_sigma)  # what the plan does not count, the scan does not take
    with understood(run.folder / "cell.xml"):
        kinematics = Kr16Kinematics.from_model(model)
        occluders = _occluders(run, scene, model)
    return RunCell(
        scene=scene,
        reference=reference,
        planning=run_reader.mesh(run, "planning.ply"),
        part_caster=EmbreeRayCaster(reference.vertices, reference.faces),
        occluders=occluders,
        occluder_caster=caster_of(occluders),
        scanner=scanner,
        scanner_parameters=parameters,
        kinematics=kinematics,
    )


def _occluders(run: RunRecord, scene: RecordedScene, model: mujoco.MjModel) -> tuple[Occluder, ...]:
    """Those that were planned with: bit for bit, but for mesh fixtures, which the folder holds in millimetres."""
    import mujoco

    data, T = mujoco.MjData(model), scene.T_base_object
    data.mocap_quat[model.body("object").mocapid] = shapes.quaternion(T[:3, :3])
    mujoco.mj_kinematics(model, data)
    meshes = {name: run_reader.mesh(run, file) for name, file in scene.mesh_files.items()}
    return standing_triangles(data, T, meshes, scene.glass)


def world_of(run: RunRecord, part: TriangleMesh, *, without: Collection[str] = ()) -> World:
    """The cell compiled anew, as it was checked (but see `taken_as_triangles`) or with something taken out.

    Args:
        run: a run folder.
        part: its reference [m].
        without: names of fixtures to leave out; "post" leaves out the post.

    Raises:
        FileError: if the run's files are damaged.
    """
    return compile_world(_scene(run, without), part.vertices, part_faces=part.faces)


def _scene(run: RunRecord, without: Collection[str]) -> Scene:
    """What stood in the cell, as a scene; scanner and plan keep their defaults (but for baseline and collision)."""
    resolved = artefact_json(run, _FILE)
    with understood(run.folder / _FILE):
        T_base_centre = _transform(resolved, "T_base_object") @ _transform(resolved, "T_object_centre")
        T_flange_scanner = _transform(resolved, "T_flange_scanner")
        T_scanner_housing = np.linalg.inv(T_flange_scanner) @ _transform(resolved["housing"], "T_flange_housing")
        built_in = {fixture["name"]: fixture for fixture in resolved["fixtures"] if fixture["built_in"]}
        pedestal, post = built_in.get("pedestal"), built_in.get("post")
        robot: dict[str, Any] = {"home_deg": [float(angle) for angle in resolved["home_deg"]]}
        robot["pedestal_height_mm"] = 0.0 if pedestal is None else float(pedestal["size_mm"][2])
        if pedestal is not None:
            robot["pedestal_size_mm"] = pedestal["size_mm"][:2]
        content = {
            "clearance_mm": float(resolved["clearance_mm"]),
            "plan": {"collision": "hull" if resolved["plan"].get("collision", "hull") == "hull" else "exact"},
            "robot": robot,
            "scanner": {"baseline_mm": float(resolved["scanner"].get("baseline_mm", 0.0))},
            "mount": _pose(T_flange_scanner),
            "housing": _pose(T_scanner_housing)
            | {
                "size_mm": resolved["housing"]["size_mm"],
                "bracket_diameter_mm": float(resolved["housing"]["bracket_diameter_mm"]),
            },
            "placement": _pose(T_base_centre),
            "post": {"enabled": False} if post is None or "post" in without else {"diameter_mm": post["size_mm"][0]},
            "fixtures": [
                _fixture(run, fixture)
                for fixture in resolved["fixtures"]
                if not fixture["built_in"] and fixture["name"] not in without
            ],
        }
        return Scene.model_validate(content)


def _fixture(run: RunRecord, fixture: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: fixture[key] for key in ("name", "shape", "attached_to", "occludes")}
    if fixture["shape"] != "mesh":
        return kept | _pose(_transform(fixture, "pose")) | {"size_mm": fixture["size_mm"]}
    artefact(run, fixture["file"])  # checks that it is what the run wrote
    # The file holds the mesh in the frame that it is attached to: the pose is in its vertices.
    return kept | {"path": str((run.folder / fixture["file"]).absolute()), "units": "mm"}


def _transform(table: Mapping[str, Any], name: str) -> Floats:
    return readonly(name, table[name], (4, 4))


def _pose(T: Floats) -> dict[str, list[float]]:
    position, abc = kuka_abc_from_pose(T)
    return {"position_mm": (position * 1000).tolist(), "abc_deg": np.degrees(abc).tolist()}
