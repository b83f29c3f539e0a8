"""The scene as a MuJoCo model: robot on its pedestal, scanner on its flange, part, post, fixtures and floor.

The model is *kinematic*: only `mj_kinematics` and `mj_collision` run on it; it has no actuators, gravity or time steps.
Part and post are mocap bodies, so a new placement is data and needs no new model. World frame = base frame (KUKA
$ROBROOT). `cell.world.shapes` lists the pairs of shapes that are checked for collision.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.errors import SceneError
from cell.robot import model as robot
from cell.robot.arm import kinematics_of
from cell.robot.refusals import describe_refusal
from cell.robot.robot_file import capture_mujoco_warnings
from cell.scene.model import Placement, Scene
from cell.scene.settle import SettledScene, with_device
from cell.world import self_collision
from cell.world import shapes as cell_shapes
from cell.world.robot_spec import robot_spec
from cell.world.shapes import ShapeDistances, meshes_of
from cell.world.table import TableCollision, height_above_face, kinematics_on_table, place_table
from planner.geometry.hull import is_convex
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import translation
from planner.kinematics.rotary_table import RotaryTable
from planner.ports import ARM_AXES, JointLimits, Kinematics
from planner.values import Floats, Value, readonly

if TYPE_CHECKING:
    import mujoco

# "housing with link_2", never the reverse: the more mobile of the two comes first.
_RANK = ("housing", "bracket", *reversed(robot.LINKS))
ON_AXIS = 1e-6
"""Distance [m] from the axis of a rotary table below which a post turns in place."""


@dataclass(frozen=True, slots=True, eq=False)
class World(Value):
    """A compiled scene.

    Attributes:
        scene: the settled scene.
        model: the compiled kinematic model; treat as read-only.
        inflated: the model with every box enlarged by half the clearance instead of a margin (`cell.world.collision`).
        spec: the editable specification of `model`.
        T_base_object: placement of the scene [m].
        T_object_centre: middle of the part's bounding box, axes parallel to the object's [m].
        T_flange_scanner: the mount [m].
        T_flange_housing: middle of the housing [m].
        baseline: from source to sensor [m].
        home: joint angles [rad], the table's after the arm's.
        limits: of the axes, at full speed and acceleration.
        table: rotary table that turns part, post and the part's fixtures; None: no table.
        clearance: distance that a free configuration keeps [m].
        part_hull: convex hull of the part, object frame [m].
        part_mesh: triangles of the part, object frame [m]; its hull if only vertices were given.
        collision: shape of the part in collision checks: "hull" or "exact" (its triangles).
        shapes: distances of geoms, by the triangles of the robot's meshes and, with `collision` "exact", of the part
            and the mesh fixtures.
        clearance_reduction: pairs of link geoms with a smaller clearance, and how much smaller it is [m].
        refinement: factor on the number of checks along a motion that keeps these pairs apart between two checks.
        mimic_joints: joints that are coupled to the axes.
        fixture_meshes: triangles of the mesh fixtures by name, in the frame that they are attached to [m].
        entities: for each geom, the name in reports ("link_4", "housing", "post", the name of a fixture).
        pairs: geom ids of every checked pair.
    """

    scene: Scene
    model: mujoco.MjModel
    inflated: mujoco.MjModel
    spec: mujoco.MjSpec
    T_base_object: Annotated[Floats, "4 4"]
    T_object_centre: Annotated[Floats, "4 4"]
    T_flange_scanner: Annotated[Floats, "4 4"]
    T_flange_housing: Annotated[Floats, "4 4"]
    baseline: float
    home: Annotated[Floats, "axes"]
    limits: JointLimits
    table: RotaryTable | None
    clearance: float
    part_hull: TriangleMesh
    part_mesh: TriangleMesh
    collision: str
    shapes: ShapeDistances
    clearance_reduction: Mapping[tuple[int, int], float]
    refinement: float
    mimic_joints: robot.MimicJoints
    fixture_meshes: dict[str, TriangleMesh]
    entities: tuple[str, ...]
    pairs: Annotated[NDArray[np.int32], "P 2"]

    @property
    def floor(self) -> float:
        """Height of the floor [m], base frame."""
        return -self.scene.robot.pedestal_height_mm / 1000.0

    @property
    def kinematics(self) -> Kinematics:
        """Kinematics of the arm, or of arm and table as one chain (`planner.kinematics.rotary_table`)."""
        return kinematics_on_table(kinematics_of(self.model), self.table, self.home, self.scene.table.angles)

    def T_base_part(self, q: Floats) -> Floats:
        """Return T_base_object (..., 4, 4) [m] at joint angles (..., axes): the placement, turned by the table."""
        return self.in_base(q, self.T_base_object)

    def in_base(self, q: Floats, T_part: Floats) -> Floats:
        """Turn poses (..., 4, 4) [m], given at table angle 0, by the table angle of (..., axes) joint angles [rad]."""
        return T_part if self.table is None else self.table.turn(q[..., ARM_AXES]) @ T_part

    def T_base_object_at(self, T_base_centre: ArrayLike) -> Floats:
        """Return T_base_object (4, 4) of a pose of the part's centre (4, 4) [m]."""
        T: Floats = readonly("T_base_centre", T_base_centre, (4, 4)) @ np.linalg.inv(self.T_object_centre)
        return T

    def with_placement(self, T_base_centre: Floats) -> World:
        """Return the cell with the part's centre at another pose (4, 4) [m]; a table without a position moves along.

        Raises:
            SceneError: if the table cannot carry the part there.
        """
        if self.table is None:
            return replace(self, T_base_object=self.T_base_object_at(T_base_centre))
        scene, part = self.scene.model_copy(update={"placement": Placement.at(T_base_centre)}), self.part_mesh
        return compile_world(scene, part.vertices, part_faces=part.faces, baseline_mm=1000 * self.baseline)

    def T_base_post(self, T_base_object: ArrayLike) -> Floats:
        """Return the top of the post (4, 4) [m]: below the part's centre, at the height of its lowest point.

        The post extends down -z; on a rotary table that is along the table's axis.
        """
        T = readonly("T_base_object", T_base_object, (4, 4))
        post, up = np.eye(4), np.array([0.0, 0.0, 1.0])
        if self.table is not None:
            post[:3, :3] = self.table.T_base_table[:3, :3]
            up = post[:3, 2]
        centre = (T @ self.T_object_centre)[:3, 3]
        lowest = (self.part_hull.vertices @ (up @ T[:3, :3])).min() + up @ T[:3, 3]
        post[:3, 3] = centre - (up @ centre) * up + lowest * up
        return post

    def data(self, T_base_object: ArrayLike | None = None, model: mujoco.MjModel | None = None) -> mujoco.MjData:
        """Create a state with the robot at home and the part at a placement.

        Args:
            T_base_object: (4, 4) [m]; None is the scene's placement.
            model: `inflated` for a state of that model.
        """
        import mujoco

        model = self.model if model is None else model
        T = self.T_base_object if T_base_object is None else readonly("T_base_object", T_base_object, (4, 4))
        data = mujoco.MjData(model)
        for name, pose in (("object", T), ("post", self.T_base_post(T))):
            data.mocap_pos[model.body(name).mocapid] = pose[:3, 3]
            data.mocap_quat[model.body(name).mocapid] = cell_shapes.quaternion(pose[:3, :3])
        data.qpos[:] = self.mimic_joints.qpos(self.home[:ARM_AXES])
        mujoco.mj_kinematics(model, data)
        return data

    def distance(
        self,
        data: mujoco.MjData,
        a: int,
        b: int,
        reach: float,
        *,
        any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:
        """Measure two geoms as `ShapeDistances.distance`, plus the pair's clearance reduction.

        The sum is compared with the full clearance.
        """
        if not self.clearance_reduction:
            return self.shapes.distance(data, a, b, reach, any_nearer=any_nearer, points=points)
        more = self.clearance_reduction.get((a, b), 0.0)
        return more + self.shapes.distance(data, a, b, reach - more, any_nearer=any_nearer, points=points)

    def pair_name(self, geom_a: int, geom_b: int) -> str:
        """Return the name of a pair of geoms in reports: "housing with part"."""
        names = self.entities[geom_a], self.entities[geom_b]
        first, second = sorted(names, key=lambda name: _RANK.index(name) if name in _RANK else len(_RANK))
        return f"{first} with {second}"


def compile_settled(settled: SettledScene, part: TriangleMesh | None = None) -> World:
    """Compile a settled scene, with its part or with another mesh in the part's frame; see `compile_world`."""
    mesh = settled.part.reference if part is None else part
    return compile_world(settled.scene, mesh.vertices, part_faces=mesh.faces, baseline_mm=settled.baseline_mm)


def compile_world(
    scene: Scene, part_vertices: ArrayLike, *, part_faces: ArrayLike | None = None, baseline_mm: float | None = None
) -> World:
    """Build and compile the model of a scene. `cell.world.checks` decides whether the scene is feasible.

    Args:
        scene: settled or not; an open scanner is chosen by the part's size.
        part_vertices: (N, 3) vertices of the part, or of its convex hull [m], object frame.
        part_faces: (F, 3) its triangles, for `plan.collision = "exact"`; None: the part is its hull.
        baseline_mm: baseline of the scanner if the scene has none; the housing is centred over it.

    Raises:
        SceneError: if part or fixture have no solid, or the baseline is unknown.
    """
    vertices = np.asarray(part_vertices, dtype=np.float64)
    scene, baseline_mm = _settled(scene, vertices, baseline_mm)
    hull = cell_shapes.collision_hull(vertices, "part")
    part = {} if part_faces is None else {"part": TriangleMesh(vertices, np.asarray(part_faces, dtype=np.int32))}
    T_object_centre = translation((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
    scene = scene.model_copy(update={"placement": scene.placement.by_centre(T_object_centre)})
    T_flange_scanner = scene.mount.T
    T_flange_housing = T_flange_scanner @ scene.housing.T_scanner_housing(baseline_mm)

    spec = robot_spec(scene.robot)
    cell_shapes.set_robot_pairs(spec, on_pedestal=scene.robot.base is None)
    alone = _kr16() if scene.robot.model == robot.KR16 else _compiled(spec.copy())
    scene = _with_home(scene, spec, alone)
    entities = {geom.name: body.name for body in spec.bodies for geom in body.geoms}
    cell_shapes.add_tool(spec, alone, scene, T_flange_housing)
    clearance, arm = scene.clearance_mm / 1000.0, _compiled(spec)
    nonconvex = [name for name, mesh in _link_meshes(arm, entities).items() if not is_convex(mesh)]
    shapes = ShapeDistances(arm, _link_meshes(arm, entities), nonconvex)
    self_collision.exclude_tool_pairs(spec, arm, shapes, clearance, by_hand=scene.robot.model == robot.KR16)
    T_base_object = scene.placement.T @ np.linalg.inv(T_object_centre)
    table = place_table(scene, T_base_object, hull)
    fixture_meshes = _add_surroundings(spec, scene, hull, T_base_object, table)
    for geom in spec.geoms:
        geom.margin = clearance / 2  # MuJoCo 4 adds the two margins of a pair

    model = _compiled(spec)
    limits = robot.override_limits(
        robot.limits(model), scene.robot.velocity_deg_s, scene.robot.acceleration_deg_s2, scene.robot.jerk_deg_s3
    )
    home = np.append(np.deg2rad(scene.robot.settled_home_deg), [] if table is None else [0.0])
    if table is not None:
        limits = replace(table.limits(limits), table_turn_q=home if scene.table.moves == "indexed" else None)
    exact = {**fixture_meshes, **part} if scene.plan.collision == "exact" else {}
    near = {pair: keep for pair, keep in robot.reduced_clearances(model).items() if keep < clearance}
    return _with_table_limits(
        World(
            scene=scene,
            model=model,
            inflated=_compiled(_inflated(spec, clearance / 2)),
            spec=spec,
            T_base_object=T_base_object,
            T_object_centre=T_object_centre,
            T_flange_scanner=T_flange_scanner,
            T_flange_housing=T_flange_housing,
            baseline=baseline_mm / 1000.0,
            home=home,
            limits=limits,
            table=table,
            clearance=clearance,
            part_hull=hull,
            part_mesh=part.get("part", hull),
            collision=scene.plan.collision if part else "hull",
            shapes=ShapeDistances(model, {**_link_meshes(model, entities), **exact}, [*exact, *nonconvex]),
            clearance_reduction={pair: clearance - keep for pair, keep in near.items()},
            refinement=self_collision.motion_refinement(model, clearance, near),
            mimic_joints=robot.MimicJoints.from_model(model),
            fixture_meshes=fixture_meshes,
            entities=tuple(entities.get(model.geom(i).name, model.geom(i).name) for i in range(model.ngeom)),
            pairs=self_collision.checked_pairs(model),
        )
    )


def _with_table_limits(world: World) -> World:
    """Limit the table to the angles at which it can turn its part."""
    if (table := world.table) is None:
        return world
    collision = TableCollision(world.model, world.data(), table, world.pairs, world.clearance, world.distance)
    table = collision.within(table, world.home, endless=world.scene.table.limits_deg is None)
    lower, upper = (
        np.append(ends[:ARM_AXES], end)
        for ends, end in ((world.limits.lower, table.lower), (world.limits.upper, table.upper))
    )
    return replace(world, table=table, limits=replace(world.limits, lower=lower, upper=upper))


def _settled(scene: Scene, vertices: Floats, baseline_mm: float | None) -> tuple[Scene, float]:
    """Return the scene with a device, and the baseline [mm]: the scene's, else the given one, else the device's."""
    given_mm = scene.scanner.baseline_mm
    if scene.scanner.range_mm is None or scene.housing.size_mm is None or scene.housing.bracket_diameter_mm is None:
        scene = with_device(scene, scene.part.name, 1000 * float(np.ptp(vertices, axis=0).max()))
    baseline = next((each for each in (given_mm, baseline_mm, scene.scanner.baseline_mm) if each is not None), None)
    if baseline is None:
        raise SceneError("the scanner's baseline is not known; set scanner.baseline_mm")
    return scene, baseline


def _add_surroundings(
    spec: mujoco.MjSpec, scene: Scene, hull: TriangleMesh, T_base_object: Floats, table: RotaryTable | None
) -> dict[str, TriangleMesh]:
    """Add ground, table, part, post and fixtures; return the triangles of the mesh fixtures by name.

    Raises:
        SceneError: if a fixture has the name of a shape of the cell.
    """
    cell_shapes.add_ground(spec, scene)
    placed_body = spec.worldbody.add_body(name="object", mocap=True)
    post_body = spec.worldbody.add_body(name="post", mocap=True)
    cell_shapes.add_mesh(spec, placed_body, "part", hull)
    if table is not None:
        cell_shapes.add_table(spec, scene, table)
    if scene.post.enabled:
        length = cell_shapes.POST_LENGTH if table is None else height_above_face(table, T_base_object, hull)
        middle = translation([0, 0, -length / 2])
        cell_shapes.add_cylinder(post_body, "post", scene.post.diameter_mm / 2000.0, length, middle)
    names = {each.name for each in (*spec.geoms, *spec.bodies)}
    for i, fixture in enumerate(scene.fixtures):
        if fixture.name in names:
            raise SceneError(f"fixtures[{i}].name is '{fixture.name}', a shape of the cell's own; choose another name")
    fixture_meshes = cell_shapes.add_fixtures(spec, scene, placed_body)
    if table is not None:
        off_axis = np.linalg.norm(table.to_table_frame(scene.placement.T[:3, 3])[:2])
        cell_shapes.enable_table_pairs(spec, post_swings=bool(off_axis > ON_AXIS), upright=table.upright)
    return fixture_meshes


@cache
def _kr16() -> mujoco.MjModel:
    """Return the model of the KR 16 alone; it must not be changed."""
    return robot.load()


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    try:
        with capture_mujoco_warnings():  # about masses, which kinematics does not use
            return spec.compile()
    except ValueError as error:
        raise SceneError(
            f"the scene does not compile as a model of shapes: {describe_refusal(error)}; check sizes and meshes"
        ) from error


def _with_home(scene: Scene, spec: mujoco.MjSpec, model: mujoco.MjModel) -> Scene:
    """Return the scene with the home of its robot, from the model of the robot alone if the scene gives none."""
    if scene.robot.home_deg is not None:
        if spec.key("home") is None:
            spec.add_key(name="home", qpos=np.zeros(model.nq))
        return scene
    degrees = np.degrees(robot.home(model)).round(4).tolist()
    # Whole numbers stay integers in the file of the settled scene.
    home = tuple(int(angle) if angle == int(angle) else angle for angle in degrees)
    return scene.model_copy(update={"robot": scene.robot.model_copy(update={"home_deg": home})})


def _link_meshes(model: mujoco.MjModel, robot_geoms: Collection[str]) -> dict[str, TriangleMesh]:
    """Return the triangles of the robot's mesh geoms by name."""
    return {name: mesh for name, mesh in meshes_of(model).items() if name in robot_geoms}


def _inflated(spec: mujoco.MjSpec, by: float) -> mujoco.MjSpec:
    """Return a copy with boxes enlarged by a distance [m] on every side, and without their margin."""
    import mujoco

    copy = spec.copy()
    for geom in copy.geoms:
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
            geom.size, geom.margin = np.asarray(geom.size) + by, 0.0
    return copy
