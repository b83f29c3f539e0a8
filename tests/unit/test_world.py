"""The compiled cell: names, checked pairs, placement, cell.xml, occluders."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import SceneError
from cell.robot import model as robot
from cell.scene.model import Scene, pose
from cell.world.checks import find_problems, require_feasible
from cell.world.files import write_mjcf
from cell.world.model import World, compile_world
from cell.world.occluders import Occluder, arm_occluders, fixed_occluders
from cell.world.shapes import set_robot_pairs

OFFSET = np.array([3.0, -2.0, 1.0])  # the object frame's origin is far from the part
PART = np.array(trimesh.creation.icosphere(2, 0.1).vertices) * [1.0, 0.7, 1.5] + OFFSET


def _scene(**tables: object) -> Scene:
    return Scene.model_validate(tables)


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    """Return the built-in cell with one fixture of every kind and a turned part."""
    ring = tmp_path_factory.mktemp("fixtures") / "ring.stl"
    trimesh.creation.torus(100.0, 30.0).export(ring)
    fixtures = [
        {"name": "ring", "shape": "mesh", "path": str(ring), "units": "mm", "position_mm": [1200, -600, 0]},
        {"name": "clamp", "shape": "box", "size_mm": [20, 30, 40], "attached_to": "object", "abc_deg": [10, 20, 30],
         "position_mm": [3000, -2000, 1170]},
        {"name": "pillar", "shape": "cylinder", "size_mm": [80, 900], "position_mm": [600, -900, 0]},
        {"name": "glass", "shape": "box", "size_mm": [20, 300, 400], "position_mm": [0, 1200, 0], "occludes": False},
    ]  # fmt: skip
    return compile_world(_scene(fixtures=fixtures, placement={"abc_deg": [20, 30, 40]}), PART, baseline_mm=75.0)


def test_every_shape_has_a_name_for_reports(world: World) -> None:
    """Links, tool, cell and fixtures have one name each."""
    assert set(world.entities) == {
        *robot.LINKS, "bracket", "housing", "part", "post", "pedestal", "floor", "ring", "clamp", "pillar", "glass"
    }  # fmt: skip


def test_the_checked_pairs_are_those_of_the_table(world: World) -> None:
    """Every moving shape is checked with exactly those shapes that it can touch."""
    names = {frozenset(world.entities[geom] for geom in pair) for pair in world.pairs}
    standing = ("part", "post", "ring", "clamp", "pillar", "glass")
    arm = robot.LINKS[1:]
    expected = {frozenset((link, thing)) for link in (*arm, "bracket", "housing") for thing in standing}
    expected |= {frozenset((link, low)) for link in (*arm[1:], "bracket", "housing") for low in ("pedestal", "floor")}
    expected |= {frozenset((tool, link)) for tool in ("bracket", "housing") for link in robot.LINKS[:4]}
    expected |= {
        frozenset(("housing", "link_4"))
    }  # the bracket keeps clear of link_4 at every A5, the housing does not
    own = robot.load()
    assert names - expected == {
        frozenset((a, b))
        for i, a in enumerate(robot.LINKS)
        for b in robot.LINKS[i + 2 :]
        if not any(
            {own.body(int(s) >> 16).name, own.body(int(s) & 0xFFFF).name} == {a, b} for s in own.exclude_signature
        )
    }
    assert expected <= names


def test_mujoco_checks_exactly_these_pairs() -> None:
    """With margins larger than the cell MuJoCo reports exactly the checked pairs."""
    world = compile_world(_scene(clearance_mm=0), PART - OFFSET, baseline_mm=75.0)
    spec = world.spec.copy()
    for geom in spec.geoms:
        geom.margin = 20.0
    spec.memory = 64 * 2**20
    model = spec.compile()
    data = mujoco.MjData(model)
    seen = set()
    for q in np.random.default_rng(0).uniform(world.limits.lower, world.limits.upper, (20, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        seen |= {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
    assert seen <= {tuple(pair) for pair in world.pairs.tolist()}
    boxes = world.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX  # which the engine overlooks when far apart
    assert {tuple(p) for p in world.pairs.tolist() if not boxes[p].all()} <= seen


def test_the_placement_is_the_pose_of_the_part_s_centre(world: World) -> None:
    """The middle of the bounding box is at placement.position_mm, turned by abc_deg."""
    middle = np.append((PART.min(axis=0) + PART.max(axis=0)) / 2, 1.0)
    np.testing.assert_allclose((world.T_base_object @ middle)[:3], [1.2, 0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(world.T_base_object[:3, :3], pose((0, 0, 0), (20, 30, 40))[:3, :3], atol=1e-12)


def test_the_part_s_hull_is_at_its_vertices(world: World) -> None:
    """MuJoCo's copy of the hull, in base, has the corners of the part."""
    data, geom = world.data(), world.model.geom("part").id
    mesh = world.model.geom_dataid[geom]
    start = world.model.mesh_vertadr[mesh]
    local = world.model.mesh_vert[start : start + world.model.mesh_vertnum[mesh]]
    placed = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    expected = PART @ world.T_base_object[:3, :3].T + world.T_base_object[:3, 3]
    assert len(local) == len(PART)  # an ellipsoid is its own hull
    distance = np.linalg.norm(placed[:, None] - expected[None], axis=2)
    assert distance.min(axis=1).max() < 1e-7


def test_the_post_reaches_from_below_the_floor_to_the_lowest_point(world: World) -> None:
    """The post is below the centre and ends at the height of the lowest vertex, also for a turned part."""
    placed = PART @ world.T_base_object[:3, :3].T + world.T_base_object[:3, 3]
    data, post = world.data(), world.model.geom("post").id
    half = world.model.geom_size[post, 1]
    assert data.geom_xpos[post, 2] + half == pytest.approx(placed[:, 2].min(), abs=1e-12)
    assert data.geom_xpos[post, 2] - half < world.floor
    np.testing.assert_allclose(data.geom_xpos[post, :2], [1.2, 0.5], atol=1e-12)


def test_housing_and_bracket_are_on_the_flange(world: World) -> None:
    """The front face is in the source's plane, centred over the baseline; the bracket spans flange to housing."""
    data = world.data()
    flange, housing, bracket = data.site("flange"), data.geom("housing"), data.geom("bracket")
    R = flange.xmat.reshape(3, 3)
    np.testing.assert_allclose(R.T @ (housing.xpos - flange.xpos), [0.0375, 0.0, 0.09], atol=1e-12)
    np.testing.assert_allclose(R.T @ (bracket.xpos - flange.xpos), [0.0, 0.0, 0.03], atol=1e-12)
    np.testing.assert_allclose(world.model.geom("bracket").size[:2], [0.039, 0.03])
    np.testing.assert_allclose(world.T_flange_scanner[:3, 3], [0, 0, 0.12])


def test_a_tilted_mount_turns_housing_and_bracket() -> None:
    """The bracket ends on the housing's surface, at its nearest point to the flange."""
    scene = _scene(mount={"position_mm": [80, 20, 150], "abc_deg": [30, 60, 10]})
    world = compile_world(scene, PART, baseline_mm=25.0)
    bracket = world.model.geom("bracket")
    end = 2 * np.asarray(bracket.pos)
    in_housing = np.linalg.inv(world.T_flange_housing) @ np.append(end, 1.0)
    half = np.array(world.scene.housing.sides_mm) / 2000
    assert np.abs(in_housing[:3] / half).max() == pytest.approx(1.0, abs=1e-9)
    samples = np.random.default_rng(0).uniform(-half, half, (5000, 3))
    placed = samples @ world.T_flange_housing[:3, :3].T + world.T_flange_housing[:3, 3]
    assert np.linalg.norm(placed, axis=1).min() >= np.linalg.norm(end) - 1e-9
    no_bracket = _scene(housing={"bracket_diameter_mm": 0})
    assert "bracket" not in compile_world(no_bracket, PART, baseline_mm=25.0).entities


def test_the_housing_is_checked_with_the_hand_if_the_mount_lets_them_meet() -> None:
    """A scanner folded back over the hand meets link_5; the default one never does and is not checked."""

    def guards_hand(mount: dict) -> bool:
        world = compile_world(_scene(mount=mount), PART, baseline_mm=75.0)
        return any({world.entities[a], world.entities[b]} == {"housing", "link_5"} for a, b in world.pairs)

    assert not guards_hand({})
    assert guards_hand({"position_mm": [150, 0, -20], "abc_deg": [0, 180, 0]})


def test_cell_xml_is_the_checked_cell(world: World, tmp_path: Path) -> None:
    """MuJoCo loads the file alone, and every shape has its checked pose at home and at other configurations."""
    T = world.T_base_object_at(pose((1000, -300, 100), (70, -20, 5)))
    assert write_mjcf(replace(world, T_base_object=T), tmp_path) == ("cell.xml",)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data, expected = mujoco.MjData(model), world.data(T)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    np.testing.assert_array_equal(data.qpos, world.home)
    for q in np.random.default_rng(1).uniform(world.limits.lower, world.limits.upper, (20, 6)):
        data.qpos[:] = expected.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_kinematics(world.model, expected)
        np.testing.assert_allclose(data.geom_xpos, expected.geom_xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.geom_xmat, expected.geom_xmat, rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.site("flange").xpos, expected.site("flange").xpos, rtol=0, atol=1e-12)
    for name in ("geom_size", "geom_contype", "geom_conaffinity", "geom_margin", "jnt_range"):
        np.testing.assert_allclose(getattr(model, name), getattr(world.model, name), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(model.exclude_signature, world.model.exclude_signature)
    np.testing.assert_array_equal(model.mesh_vert, world.model.mesh_vert)


def test_cell_xml_opens_at_home_with_a_light(world: World, tmp_path: Path) -> None:
    """MuJoCo's viewer initially shows visible groups only (0 to 2), the first state and the file's lights."""
    write_mjcf(world, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    np.testing.assert_array_equal(mujoco.MjData(model).qpos, world.home)
    assert (model.geom_group <= 2).all()
    assert model.nlight == 1


def test_occluders_are_all_stationary_opaque_objects(world: World) -> None:
    """Post, pedestal, floor and occluding fixtures are closed, outward, and attached as in the scene."""
    T = world.T_base_object
    found = {o.name: Occluder(o.name, o.vertices @ T[:3, :3].T + T[:3, 3], o.faces) for o in fixed_occluders(world)}
    assert set(found) == {"post", "pedestal", "floor", "ring", "clamp", "pillar"}
    volumes = {"pedestal": 0.6**3, "clamp": 20 * 30 * 40e-9, "ring": None, "post": None, "pillar": None}
    for name, volume in volumes.items():
        mesh = trimesh.Trimesh(found[name].vertices, found[name].faces)
        assert mesh.is_watertight, name
        assert mesh.volume > 0, name
        if volume is not None:
            assert mesh.volume == pytest.approx(volume)
    for name, radius, low, high in (
        ("pillar", 0.04, -0.45, 0.45),
        ("post", 0.02, -0.6, world.T_base_post(world.T_base_object)[2, 3]),
    ):
        mesh = trimesh.Trimesh(found[name].vertices, found[name].faces)
        np.testing.assert_allclose(mesh.bounds[:, 2], [low, high], atol=1e-12)
        true = np.pi * radius**2 * (high - low)
        assert true < mesh.volume < 1.003 * true  # circumscribes
    np.testing.assert_allclose(found["floor"].vertices[:, 2], world.floor, rtol=0, atol=1e-12)
    ring = trimesh.Trimesh(found["ring"].vertices, found["ring"].faces)
    assert ring.euler_number == 0  # its hole is open: not the hull


def test_fixtures_of_the_object_move_with_it(world: World) -> None:
    """In the object frame the clamp never moves; the other fixtures keep their pose in base."""
    T, T_now = world.T_base_object_at(pose((900, 700, 50), (10, 80, -30))), world.T_base_object
    for moved, here in zip(fixed_occluders(world, T), fixed_occluders(world), strict=True):
        if moved.name == "clamp":
            np.testing.assert_allclose(moved.vertices, here.vertices, rtol=0, atol=1e-12)
            np.testing.assert_allclose(moved.vertices.mean(axis=0), [3.0, -2.0, 1.17], atol=1e-12)
        elif moved.name != "post":  # the post follows the part's lowest point
            in_base = here.vertices @ T_now[:3, :3].T + T_now[:3, 3]
            np.testing.assert_allclose(moved.vertices @ T[:3, :3].T + T[:3, 3], in_base, atol=1e-10, err_msg=moved.name)


def test_the_arm_s_triangles_are_its_shapes_without_the_housing(world: World) -> None:
    """One mesh per shape of base, links and bracket, at the given configuration."""
    q = np.deg2rad([40, -60, 80, 10, 20, 30])
    found = arm_occluders(world, q)
    assert {o.name for o in found} == {*robot.LINKS, "bracket"}
    data = world.data()
    data.qpos[:] = q
    mujoco.mj_kinematics(world.model, data)
    bracket = next(o for o in found if o.name == "bracket")
    np.testing.assert_allclose(bracket.vertices.mean(axis=0), data.geom("bracket").xpos, atol=1e-12)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"placement": {"position_mm": [0, 0, 300]}}, ["intersects the robot's base", "placement.position_mm"]),
        ({"placement": {"position_mm": [0, 0, 700]}}, ["the part intersects the robot's link_1", "at home"]),
        ({"placement": {"position_mm": [310, 0, 300]}}, ["the post intersects the pedestal"]),
        ({"placement": {"position_mm": [1200, 500, -600]}}, ["150.0 mm below the floor", "by (0, 0, 150) mm"]),
        ({"placement": {"position_mm": [1200, 500, 9000]}}, ["9.4 m above the floor", "post.enabled"]),
        ({"placement": {"position_mm": [930, 0, 885]}}, ["nearer than the clearance of 10 mm", "housing at home"]),
        ({"robot": {"home_deg": [0, -90, 90, 0, 140, 0]}}, ["A5 at 140 deg", "from -130 to 130"]),
        ({"robot": {"home_deg": [-185, -155, -130, -350, -130, -350]}}, ["too near to itself", "robot.home_deg"]),
        ({"robot": {"home_deg": [0, 30, 60, 0, 0, 0]}}, ["too near to the cell", "with floor"]),
        (
            {"fixtures": [{"name": "wall", "shape": "box", "size_mm": [50, 900, 900], "position_mm": [700, 0, 1300]}]},
            ["the fixture 'wall' intersects the robot's link_", "fixtures[0].position_mm"],
        ),
    ],
)  # fmt: skip
def test_an_impossible_scene_is_refused(tables: dict, words: list[str]) -> None:
    """The message names the error and the required change."""
    world = compile_world(_scene(**tables), PART, baseline_mm=75.0)
    with pytest.raises(SceneError) as caught:
        require_feasible(world)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_part_inside_base_and_pedestal_has_one_correction() -> None:
    """Both sentences name the same move, and after it the part is inside neither."""
    place: list[float] = [0, 0, 0]
    problems = find_problems(compile_world(_scene(placement={"position_mm": place}), PART, baseline_mm=75.0))
    moves = [re.findall(r"position_mm by .* mm, to \((.*)\)", each) for each in problems if "intersects the" in each]
    assert len(moves) == 2
    assert moves[0] == moves[1]
    place = [float(value) for value in moves[0][0].split(",")]
    problems = find_problems(compile_world(_scene(placement={"position_mm": place}), PART, baseline_mm=75.0))
    assert not [each for each in problems if "part intersects" in each]


def test_a_link_of_another_shape_than_box_cylinder_and_mesh_is_named() -> None:
    """Distances from triangles are defined for these shapes only."""
    spec = robot.spec()
    spec.geom("link_4_wrist").type = mujoco.mjtGeom.mjGEOM_CAPSULE
    with pytest.raises(SceneError, match="'link_4_wrist' is no box, cylinder or mesh"):
        set_robot_pairs(spec)


def test_the_baseline_of_the_scene_takes_precedence() -> None:
    """The baseline of the scene precedes the given one and the device's, and the housing is centred over it."""
    world = compile_world(_scene(scanner={"baseline_mm": 50}), PART, baseline_mm=70.0)
    assert world.T_flange_housing[0, 3] == pytest.approx(0.025)
    assert compile_world(Scene(), PART, baseline_mm=70.0).T_flange_housing[0, 3] == pytest.approx(0.035)
    assert compile_world(Scene(), PART).T_flange_housing[0, 3] == pytest.approx(0.0375)


def test_a_scanner_without_a_baseline_must_be_given_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scanner without a baseline is refused, because the housing would have no position."""
    monkeypatch.setattr("cell.scanners.keys", lambda name: ("fov_deg", "range_mm"))
    with pytest.raises(SceneError, match=r"scanner\.baseline_mm"):
        compile_world(Scene(), PART)
