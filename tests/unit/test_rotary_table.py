"""The rotary table: closed-form rotations, the chain of seven axes, travel, collisions, invalid tables."""

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from cell.errors import SceneError
from cell.robot import model as robot
from cell.robot.arm import kinematics_of
from cell.runs.cell import table_of, with_placement
from cell.runs.schema import ResolvedScene, ResolvedTable
from cell.scene.file import scene_from_options
from cell.scene.model import Scene, pose
from cell.world.checks import find_problems, find_warnings
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from cell.world.occluders import fixed_occluders, occluders_beside_table
from cell.world.table import TablePoses
from cell.world.travel import table_radius
from planner.kinematics.rotary_table import ArmOnTable, RotaryTable
from planner.path.certified_edge import certify_many

BLOCK = trimesh.creation.box((0.2, 0.1, 0.3))


def _table(x: float = 0.0, y: float = 0.0, lower: float = -180.0, upper: float = 180.0) -> RotaryTable:
    T = np.eye(4)
    T[:3, 3] = x, y, 0.3
    return RotaryTable(T, np.radians(lower), np.radians(upper), 2.0, 4.0, 40.0)


def _world(**tables: object) -> World:
    scene = Scene.model_validate({"table": {"enabled": True}} | tables)
    return compile_world(scene, BLOCK.vertices, part_faces=BLOCK.faces, baseline_mm=75.0)


@pytest.fixture(scope="module")
def off_axis() -> World:
    """Return the world of a block 300 mm off the axis with a clamp, and a pillar within its swing."""
    clamp = {
        "name": "clamp",
        "shape": "box",
        "size_mm": [20, 20, 20],
        "position_mm": [0, 0, 170],
        "attached_to": "object",
    }
    pillar = {"name": "pillar", "shape": "cylinder", "size_mm": [100, 800], "position_mm": [1200, 200, 0]}
    return _world(
        table={"position_mm": [1200.0, 500.0, -400.0]},
        placement={"position_mm": [1500.0, 500.0, 0.0], "abc_deg": [20.0, 0.0, 10.0]},
        fixtures=[clamp, pillar],
    )


@pytest.fixture(scope="module")
def tilted() -> World:
    """Return the world of a block off an axis tilted by 40 deg, its post to the face, and an upright pillar."""
    pillar = {"name": "pillar", "shape": "cylinder", "size_mm": [100, 800], "position_mm": [1560, 440, 0]}
    clamp = {"name": "clamp", "shape": "box", "size_mm": [20, 20, 20], "position_mm": [0, 0, 170]}
    return _world(
        table={"position_mm": [1100.0, 500.0, -300.0], "abc_deg": [25.0, 40.0, 0.0]},
        placement={"position_mm": [1300.0, 800.0, 100.0], "abc_deg": [20.0, 0.0, 10.0]},
        fixtures=[pillar, clamp | {"attached_to": "object"}],
    )


@pytest.fixture(params=["off_axis", "tilted"])
def either(request: pytest.FixtureRequest) -> World:
    """Return the world of an upright and of a tilted axis."""
    world: World = request.getfixturevalue(request.param)
    return world


def test_a_quarter_turn_moves_a_point_about_the_axis() -> None:
    """A right-handed turn about the upright axis moves 100 mm along x to 100 mm along y."""
    turned = _table(1.0, 2.0).turn(np.radians([0.0, 90.0])) @ np.array([1.1, 2.0, 0.7, 1.0])
    np.testing.assert_allclose(turned[:, :3], [[1.1, 2.0, 0.7], [1.0, 2.1, 0.7]], atol=1e-12)


def test_a_table_about_the_first_axis_of_the_arm_is_that_axis() -> None:
    """With the table's axis on that of A1, a turn of either (with opposite sign) has the same effect on a view."""
    arm = kinematics_of(robot.load())
    chain = ArmOnTable(arm, _table(), np.zeros(7), 36)
    q = np.radians([[10, -80, 100, 20, 60, 30, 25], [-40, -70, 80, -30, -50, 10, -110]])
    same = q[:, :6].copy()
    same[:, 0] += q[:, 6]
    np.testing.assert_allclose(chain.forward(q), arm.forward(same), atol=1e-12)


def test_every_configuration_reaches_the_pose_and_the_first_is_nearest_home() -> None:
    """Each branch at each angle within the limits, sorted by the slowest axis' time from home."""
    arm, home = kinematics_of(robot.load()), np.append(np.radians([0.0, -90, 90, 0, 90, 0]), 0.0)
    chain = ArmOnTable(arm, _table(1.2, 0.5, -90.0, 60.0), home, 24)
    T = chain.forward(np.radians([[-20, -60, 110, 40, 50, 70, 15], [5, -75, 100, -20, 60, 0, -45]]))
    for target, found in zip(T, chain.inverse(T), strict=True):
        real = found[~np.isnan(found[:, 0])]
        assert len(real) >= 8
        assert np.isnan(found[len(real) :]).all()
        np.testing.assert_allclose(chain.forward(real), np.broadcast_to(target, (len(real), 4, 4)), atol=1e-9)
        seconds = (np.abs(real - home) / chain.limits.velocity).max(axis=1)
        assert (np.diff(seconds) >= 0).all()
        angles = np.degrees(np.unique(real[:, 6])).round(4)
        assert set(angles) <= {-90.0 + 15 * k for k in range(11)}
    assert len(chain.limits.lower) == 7


def test_one_pose_at_given_angles() -> None:
    """All branches at each given angle reach the pose, as many as the arm has there."""
    chain = ArmOnTable(kinematics_of(robot.load()), _table(1.2, 0.5), np.zeros(7), 36)
    T = chain.forward(np.radians([[-20, -60, 110, 40, 50, 70, 15]]))[0]
    angles = np.radians([12.5, 15.0, 21.25])
    for angle, found in zip(angles, chain.inverse_at(T, angles), strict=True):
        real = found[~np.isnan(found).any(axis=1)]
        assert len(real) == 8
        assert (real[:, 6] == angle).all()
        np.testing.assert_allclose(chain.forward(real), np.broadcast_to(T, (8, 4, 4)), atol=1e-9)


def test_limits_narrower_than_a_step_have_one_angle() -> None:
    """A range of 4 deg between two of the 24 angles (15 deg steps) has one angle, its middle."""
    np.testing.assert_allclose(np.degrees(_table(0, 0, 2.0, 6.0).angles(24)), [4.0], atol=1e-9)
    assert len(_table().angles(36)) == 36


def test_mujoco_has_part_and_post_at_the_transform(either: World) -> None:
    """MuJoCo's kinematics of the mocap bodies against a rotation vector about the table's axis."""
    data, q = either.data(), either.home.copy()
    assert either.table is not None
    poses, T_base_table = TablePoses(data, either.table), either.table.T_base_table
    for angle in (0.7, -2.0, 0.0):
        q[6] = angle
        poses.set_configuration(data, q)
        mujoco.mj_kinematics(either.model, data)
        turn, face = Rotation.from_rotvec(angle * T_base_table[:3, 2]).as_matrix(), T_base_table[:3, 3]
        for name, at_0 in (("object", either.T_base_object), ("post", either.T_base_post(either.T_base_object))):
            body = data.body(name)
            np.testing.assert_allclose(body.xpos, turn @ (at_0[:3, 3] - face) + face, atol=1e-12)
            np.testing.assert_allclose(body.xmat.reshape(3, 3), turn @ at_0[:3, :3], atol=1e-9)
        T = either.T_base_part(q)
        clamp = data.geom("clamp").xpos
        np.testing.assert_allclose(clamp, (T @ [0, 0, 0.17, 1])[:3], atol=1e-9)


def test_no_distance_of_arm_and_part_changes_by_more_than_the_travel(either: World) -> None:
    """The travel bounds the change of distance from a corner to the flange, and to a fixed point, at random ends."""
    checker, arm = MujocoCollisionChecker(either), kinematics_of(either.model)
    rng = np.random.default_rng(3)
    low, high = either.limits.lower, either.limits.upper
    q_from = rng.uniform(low, high, (400, 7))
    q_to = np.clip(q_from + rng.uniform(-0.3, 0.3, (400, 7)), low, high)
    q_to[:100, :6] = q_from[:100, :6]  # only the table moves
    travel = checker.travel(q_from, q_to)
    for corner in BLOCK.vertices:
        at = [(either.T_base_part(q) @ [*corner, 1.0])[:, :3] for q in (q_from, q_to)]
        flange = [arm.forward(q[:, :6])[:, :3, 3] for q in (q_from, q_to)]
        for other in (flange, [np.array([1.2, 0.2, 0.0])] * 2):
            before, after = (np.linalg.norm(a - b, axis=1) for a, b in zip(at, other, strict=True))
            assert (np.abs(after - before) <= travel + 1e-12).all()
    assert either.table is not None
    axis, face = either.table.T_base_table[:3, 2:].T
    middle = np.linalg.norm(np.cross(axis, either.T_base_object[:3, 3] - face))
    assert (travel[:100] > middle * np.abs(q_to - q_from)[:100, 6]).all()  # the travel of the block's middle


def test_the_radius_of_the_table_is_that_of_the_farthest_corner(either: World) -> None:
    """The radius is exactly the travel per radian. A smaller one would miss contacts between two checks."""
    assert either.table is not None
    corners = (either.T_base_object @ np.c_[BLOCK.vertices, np.ones(8)].T)[:3].T
    axis, face = either.table.T_base_table[:3, 2:].T
    farthest = np.linalg.norm(np.cross(axis, corners - face), axis=1).max()
    assert table_radius(either.model, either.data(), either.table) == pytest.approx(farthest, abs=1e-7)


def test_a_tilted_axis_carries_its_post_without_collision(tilted: World) -> None:
    """The post extends along the axis from the part's lowest point to the face."""
    assert tilted.table is not None
    T_base_table, T_base_post = tilted.table.T_base_table, tilted.T_base_post(tilted.T_base_object)
    corners = (tilted.T_base_object @ np.c_[BLOCK.vertices, np.ones(8)].T).T @ np.linalg.inv(T_base_table).T
    radius, half = tilted.model.geom("post").size[:2]
    assert 2 * half == pytest.approx(corners[:, 2].min(), abs=1e-9)
    found = {piece.name: piece for piece in fixed_occluders(tilted)}
    in_base = found["post"].vertices @ tilted.T_base_object[:3, :3].T + tilted.T_base_object[:3, 3]
    on_face = (in_base - T_base_table[:3, 3]) @ T_base_table[:3, :3]
    np.testing.assert_allclose([on_face[:, 2].min(), on_face[:, 2].max()], [0.0, 2 * half], atol=1e-9)
    assert np.ptp(on_face[:, 0]) == pytest.approx(2 * radius, rel=3e-3)
    assert not {"floor", "pillar", "pedestal"} & set(found)
    assert {"floor", "pillar", "pedestal"} == {piece.name for piece in occluders_beside_table(tilted)}
    checker, angles = MujocoCollisionChecker(tilted), np.radians(np.arange(-180, 180, 20))
    q = np.repeat(tilted.home[None], len(angles), axis=0)
    q[:, 6] = angles
    part, post, pillar = (trimesh.collision.CollisionManager() for _ in range(3))
    at = trimesh.transformations.translation_matrix
    pillar.add_object("pillar", trimesh.creation.cylinder(0.05, 0.8, transform=at([1.56, 0.44, 0]), sections=128))
    part.add_object("part", BLOCK)
    part.add_object("clamp", trimesh.creation.box((0.02,) * 3, at([0, 0, 0.17])))
    post.add_object("post", trimesh.creation.cylinder(radius, 2 * half, transform=at([0, 0, -half]), sections=128))
    free = []
    for row, ours in zip(q, checker.free(q), strict=True):
        for name in ("part", "clamp"):
            part.set_transform(name, tilted.T_base_part(row))
        post.set_transform("post", tilted.in_base(row, T_base_post))
        corners = tilted.T_base_part(row) @ np.c_[BLOCK.vertices, np.ones(8)].T
        gaps = part.min_distance_other(pillar), post.min_distance_other(pillar), corners[2].min() - tilted.floor
        if abs(min(gaps) - tilted.clearance) > 1e-3:  # prisms, and fcl, are not exact
            assert ours == (min(gaps) > tilted.clearance), gaps
        free.append(ours)
    assert 3 < sum(free) < len(free) - 3


@pytest.mark.parametrize(
    ("table", "of_part", "met"),
    [
        (((1000.0, 500.0, -350.0), (0.0, 90.0, 0.0)), (-0.25, 0.0, 0.3), "floor with part"),
        (((1300.0, 500.0, -450.0), (0.0, 40.0, 0.0)), (-0.3, 0.0, 0.6), "floor with post"),
        (((1300.0, 500.0, -300.0), (0.0, 30.0, 0.0)), (-0.3, 0.0, 0.4), "stop with part"),
    ],
)
def test_half_a_turn_about_a_tilted_axis_collides_on_the_other_side(
    table: tuple[tuple[float, float, float], tuple[float, float, float]], of_part: tuple[float, ...], met: str
) -> None:
    """A cube off the axis collides with floor, post or a box of 60 mm after half a turn."""
    small, T = trimesh.creation.box((0.1, 0.1, 0.1)), pose(*table)
    place, across = (1000 * (T @ [sign * of_part[0], *of_part[1:], 1.0])[:3] for sign in (1, -1))
    box = {"name": "stop", "shape": "box", "size_mm": [60, 60, 60], "position_mm": across.tolist()}
    scene = Scene.model_validate({
        "table": {"position_mm": table[0], "abc_deg": table[1]}, "placement": {"position_mm": place.tolist()},
        "post": {"enabled": met != "floor with part"}, "fixtures": [box] if met.startswith("stop") else [],
    })  # fmt: skip
    world = compile_world(scene, small.vertices, part_faces=small.faces, baseline_mm=75.0)
    checker, q = MujocoCollisionChecker(world), np.repeat(world.home[None], 2, axis=0)
    q[1, 6] = np.pi
    assert checker.free(q).tolist() == [True, False]
    assert checker.contacts(q[1]) == (met,)
    assert world.table is not None
    assert 90 < np.degrees(world.table.upper) < 180


def test_a_post_that_swings_into_a_stud_is_not_free() -> None:
    """The post of a small part off the axis meets a stud at -90 deg. On the axis every angle is free."""
    small = trimesh.creation.box((0.05, 0.05, 0.05))
    stud = {"name": "stud", "shape": "cylinder", "size_mm": [60, 200], "position_mm": [1200, 350, -300]}
    scene = {"table": {"position_mm": [1200.0, 500.0, -400.0]}, "fixtures": [stud]}
    for x, free in ((1350.0, [True, False, True]), (1200.0, [True, True, True])):  # off the axis, and on it
        tables = scene | {"placement": {"position_mm": [x, 500.0, 0.0]}}
        world = compile_world(Scene.model_validate(tables), small.vertices, part_faces=small.faces, baseline_mm=75.0)
        checker, q = MujocoCollisionChecker(world), np.repeat(world.home[None], 3, axis=0)
        q[:, 6] = np.radians([0.0, -90.0, 90.0])
        assert checker.free(q).tolist() == free
        assert checker.contacts(q[1]) == (() if free[1] else ("stud with post",))
        edges = q[[0, 0]], q[[1, 2]]
        assert certify_many(*edges, checker)[0].tolist() == free[1:]


def test_a_table_without_a_position_moves_with_the_part(off_axis: World) -> None:
    """A default table stays below the lowest point of a moved part. A table with a position refuses the move."""
    world, T = _world(), pose((900.0, -300.0, 200.0), (30.0, 0.0, 180.0))
    there = world.with_placement(T)
    assert world.table is not None
    assert there.table is not None
    lowest = (BLOCK.vertices @ there.T_base_object[:3, :3].T + there.T_base_object[:3, 3])[:, 2].min()
    np.testing.assert_allclose(there.table.T_base_table[:3, 3], [0.9, -0.3, lowest - 0.3], atol=1e-9)
    np.testing.assert_allclose(there.T_base_object @ there.T_object_centre, T, atol=1e-9)
    with pytest.raises(SceneError, match="swings through a circle"):
        off_axis.with_placement(T)


def test_a_table_turns_as_far_as_its_part_keeps_clear() -> None:
    """Every angle up to a pillar is clear, and the next angle beyond it collides."""
    place = {"table": {"position_mm": [1200.0, 500.0, -400.0]}, "placement": {"position_mm": [1450.0, 500.0, 0.0]}}

    def at(deg: float) -> dict[str, object]:
        x, y = 1200 + 250 * np.cos(np.radians(deg)), 500 + 250 * np.sin(np.radians(deg))
        return {"name": f"pillar {deg:g}", "shape": "cylinder", "size_mm": [40, 300], "position_mm": [x, y, 0]}

    one, two = (_world(**place, fixtures=[at(deg) for deg in some]) for some in ((100,), (100, -120)))
    for world, round_it in ((one, True), (two, False)):
        assert world.table is not None
        lower, upper = np.degrees([world.table.lower, world.table.upper])
        assert 40 < upper < 100
        assert (lower < -180) == round_it
        checker, q = MujocoCollisionChecker(world), np.repeat(world.home[None], 3, axis=0)
        q[:, 6] = np.radians([upper, upper + 1, lower - 1])
        assert checker.free(q).tolist() == [True, False, False]
        angles = np.degrees(world.table.angles(36)).round(4)
        assert len(angles) == len({angle % 360 for angle in angles})
        assert ((angles >= lower - 1e-9) & (angles <= upper + 1e-9)).all()
        assert len(angles) == sum(any(lower <= a + k <= upper for k in (-360, 0)) for a in range(-180, 180, 10))
        limits = world.limits
        assert (limits.lower[6], limits.upper[6]) == (world.table.lower, world.table.upper)
    assert any("the rotary table turns its part" in output for output in find_warnings(two))


def test_the_option_and_the_table_of_a_scene_are_equivalent() -> None:
    """`--table` enables the default table; keys of [table] enable it without `enabled`."""
    assert scene_from_options(None, {"table": True}).table == Scene.model_validate({"table": {"enabled": True}}).table
    assert Scene.model_validate({"table": {"diameter_mm": 300.0}}).table.enabled
    assert not Scene().table.enabled


@pytest.mark.parametrize(
    ("tables", "output"),
    [
        ({"table": {"swing_mm": 100.0}}, "swings through a circle of 224 mm, and the rotary table carries 100 mm"),
        ({"table": {"position_mm": [1200.0, 500.0, -100.0]}}, "lowest point is -50.0 mm above the face"),
        (
            {"table": {"position_mm": [1200.0, 500.0, -150.0]}},
            "a part that stands on the face itself needs post.enabled = false",
        ),
        (
            {"fixtures": [{"name": "rotary table", "shape": "box", "size_mm": [9, 9, 9], "position_mm": [0, 900, 0]}]},
            "'rotary table', a shape of the cell's own",
        ),
    ],
)
def test_an_invalid_table_is_refused(tables: dict[str, object], output: str) -> None:
    """A table that is too small, too high or too low, or whose name is used by a fixture, is refused."""
    with pytest.raises(SceneError, match=output):
        _world(**tables)


def test_a_table_inside_the_robot_is_a_problem_with_a_remedy() -> None:
    """A table inside the pedestal or the robot's base is reported with the key to change."""
    found = find_problems(
        _world(table={"position_mm": [100.0, 390.0, 100.0]}, placement={"position_mm": [300.0, 700.0, 600.0]})
    )
    assert any("rotary table" in sentence and "table.position_mm" in sentence for sentence in found), found


def test_limits_must_contain_home() -> None:
    """Limits without 0 are refused, because every motion begins and ends at 0."""
    with pytest.raises(ValueError, match="around 0, where motions begin and end"):
        Scene.model_validate({"table": {"limits_deg": [10.0, 90.0]}})


def test_limits_of_a_scene_are_never_extended() -> None:
    """A pillar at 100 deg ends the range on one side, and the limit of the scene ends it on the other."""
    x, y = 1200 + 250 * np.cos(np.radians(100)), 500 + 250 * np.sin(np.radians(100))
    pillar = {"name": "pillar", "shape": "cylinder", "size_mm": [40, 300], "position_mm": [x, y, 0]}
    table = {"position_mm": [1200.0, 500.0, -400.0], "limits_deg": [-90.5, 150.0]}
    world = _world(table=table, placement={"position_mm": [1450.0, 500.0, 0.0]}, fixtures=[pillar])
    assert world.table is not None
    lower, upper = np.degrees([world.table.lower, world.table.upper])
    assert lower == pytest.approx(-90.5)
    assert 40 < upper < 100


def test_a_run_stores_the_range_of_its_table() -> None:
    """The stored range has priority over the limits of the scene. Without both the table is endless."""
    T = np.eye(4)
    T[:3, 3] = 1.2, 0.5, -0.4
    output = ResolvedTable.model_construct(
        T_base_table=T, limits_deg=(-90.0, 150.0), free_range_deg=(-90.0, 62.0), velocity_deg_s=120.0,
        acceleration_deg_s2=240.0, jerk_deg_s3=2400.0,
    )  # fmt: skip
    for message, limits in (
        (output, (-90, 62)),
        (output.model_copy(update={"free_range_deg": None}), (-90, 150)),
        (output.model_copy(update={"free_range_deg": None, "limits_deg": None}), (-180, 180)),
    ):
        table = table_of(ResolvedScene.model_construct(table=message))
        assert table is not None
        np.testing.assert_allclose(np.degrees([table.lower, table.upper]), limits)
    resolved = ResolvedScene.model_construct(table=output, T_object_centre=np.eye(4))
    there = with_placement(
        Scene.model_validate({"table": {"enabled": True}}), pose((900.0, 0.0, 0.0), (0.0, 0.0, 0.0)), resolved
    )
    assert there.placement.position_mm == (900.0, 0.0, 0.0)
    np.testing.assert_allclose(there.table.position_mm, (1200.0, 500.0, -400.0))
