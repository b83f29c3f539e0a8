"""An arm from a URDF or MJCF: reading, conversion, self-collision, error messages."""

import itertools
import json
import logging
import os
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh

from cell.errors import CellError
from cell.robot import model as robot
from cell.robot import robot_file
from cell.robot.arm import kinematics_of, wrist_positions
from cell.robot.model import mesh_of
from cell.robot.normalise import normalise
from cell.robot.robot_file import capture_mujoco_warnings
from cell.scene.model import Scene
from cell.view.overlays import find_violations
from cell.world import robot_spec, self_collision
from cell.world.checks import find_problems, find_warnings
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import compile_world
from cell.world.robot_check import report
from cell.world.self_collision import LinkPairs, prove_separation
from cell.world.shapes import ShapeDistances, enclosing_points
from cell.world.travel import TravelBound
from planner.geometry.hull import is_convex
from planner.geometry.mesh import TriangleMesh
from planner.path.certified_edge import subdivide
from tests.support.fixture_types import RunCommand

# Origin in the parent [m] and axis of each joint, and the middle and sides of the box that is its link.
CHAIN = (
    ((0, 0, 0.3), (0, 0, 1), (0, 0, 0.1), (0.12, 0.12, 0.2)),
    ((0.1, 0, 0.2), (0, 1, 0), (0, 0.15, 0.25), (0.08, 0.08, 0.6)),
    ((0, 0, 0.5), (0, -1, 0), (0.05, 0, 0.05), (0.3, 0.1, 0.1)),
    ((0.25, 0, 0.1), (1, 0, 0), (0.1, 0, 0), (0.16, 0.06, 0.06)),
    ((0.25, 0, 0), (0, 1, 0), (0.01, 0, 0), (0.05, 0.05, 0.05)),
    ((0.05, 0, 0), (-1, 0, 0), (0.02, 0, 0), (0.02, 0.04, 0.04)),
)
Q = np.array([0.0, 0.3, 0.3, 0.0, 0.0, 0.0])
CUBE = np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (-0.03, 0.03)])


def urdf(
    extra: str = "", limit: str = '<limit lower="-2.8" upper="2.8" velocity="3" effort="0"/>', **links: str
) -> str:
    """Return an arm of six box-shaped links; `links` replace the collision shape of a link, `extra` is added."""
    foot = '<collision><geometry><box size="0.2 0.2 0.4"/></geometry></collision>'
    text = f'<robot name="small"><link name="base_link">{foot}</link>'
    for number, (origin, axis, middle, sides) in enumerate(CHAIN, 1):
        box = f'<origin xyz="{_text(middle)}"/><geometry><box size="{_text(sides)}"/></geometry>'
        text += f'''<link name="l{number}"><collision>{links.get(f"l{number}", box)}</collision></link>
            <joint name="j{number}" type="revolute"><parent link="{"base_link" if number == 1 else f"l{number - 1}"}"/>
            <child link="l{number}"/><origin xyz="{_text(origin)}"/><axis xyz="{_text(axis)}"/>{limit}</joint>'''
    text += """<link name="tool0"/><joint name="mount" type="fixed"><parent link="l6"/><child link="tool0"/>
        <origin xyz="0.04 0 0" rpy="0 1.5707963267948966 0"/></joint>"""
    return text + extra + "</robot>"


def _text(values: tuple[float, ...]) -> str:
    return " ".join(str(value) for value in values)


LEVER = """<link name="lever"><collision><origin xyz="0 -0.2 0.1"/><geometry><box size="0.03 0.03 0.2"/></geometry>
    </collision></link><joint name="drive" type="continuous"><parent link="l2"/><child link="lever"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><mimic joint="j3" multiplier="-0.5" offset="0.2"/></joint>"""

SLIDES = LEVER.replace('type="continuous"', 'type="prismatic"').replace(
    "<mimic", '<limit lower="0" upper="1" velocity="1" effort="0"/><mimic'
)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(self_collision, "N_POSES", 200)


def written(folder: Path, text: str) -> Path:
    """Write the text to a file."""
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def by_mujoco(text: str, q: np.ndarray, body: str) -> np.ndarray:
    """Return the pose (4, 4) of a link of the URDF by MuJoCo, with mimic joints set by hand."""
    robot_tag = '<robot name="small"><mujoco><compiler fusestatic="false"/></mujoco>'
    model = mujoco.MjSpec.from_string(text.replace('<robot name="small">', robot_tag)).compile()
    data = mujoco.MjData(model)
    for axis, angle in enumerate(q, 1):
        data.joint(f"j{axis}").qpos = angle
    if "drive" in text:
        data.joint("drive").qpos = 0.2 - 0.5 * q[2]
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
    return T


@pytest.mark.parametrize("beside", [0.0, 0.15])
def test_wrist_positions_are_those_of_mujoco(beside: float, tmp_path: Path) -> None:
    """Distances from the A1 axis and heights at all angles of A2 and A3, also of an arm beside its A1 axis."""
    text = urdf().replace('xyz="0.1 0 0.2"', f'xyz="0.1 {beside} 0.2"')
    model = robot_spec.load_robot(written(tmp_path, text)).compile()
    distance, height = wrist_positions(model, np.eye(4), 0.39)
    data, expected = mujoco.MjData(model), []
    for a2, a3 in itertools.product(np.linspace(-2.8, 2.8, 15), repeat=2):
        data.qpos[:] = 0.3, a2, a3, 0.0, 0.0, 0.0
        mujoco.mj_kinematics(model, data)
        x, y, z = data.joint("A5").xanchor
        expected.append((np.hypot(x, y), z))
    found = np.stack([np.abs(distance), height], axis=1)
    np.testing.assert_allclose(sorted(found.round(9).tolist()), sorted(np.round(expected, 9).tolist()), atol=2e-9)


def test_flange_and_levers_have_mujocos_poses(tmp_path: Path) -> None:
    """Flange and driven lever of the converted arm have the poses of the file's to 1e-9."""
    text = urdf(LEVER)
    model = robot_spec.load_robot(written(tmp_path, text)).compile()
    kinematics, followers, data = kinematics_of(model), robot.MimicJoints.from_model(model), mujoco.MjData(model)
    at_zero = by_mujoco(text, np.zeros(6), "lever")
    for q in np.random.default_rng(1).uniform(-2.8, 2.8, (20, 6)):
        np.testing.assert_allclose(kinematics.forward(q[None])[0], by_mujoco(text, q, "tool0"), rtol=0, atol=1e-9)
        data.qpos[:] = followers.qpos(q)
        mujoco.mj_kinematics(model, data)
        due = by_mujoco(text, q, "lever")
        np.testing.assert_allclose(data.body("lever").xpos, due[:3, 3], rtol=0, atol=1e-9)
        turned = data.body("lever").xmat.reshape(3, 3) @ at_zero[:3, :3]  # its frame is parallel to the base at zero
        np.testing.assert_allclose(turned, due[:3, :3], rtol=0, atol=1e-9)


def test_a_home_is_found_if_the_file_has_none(tmp_path: Path) -> None:
    """The flange points down, within the limits, and no links touch."""
    model = robot_spec.load_robot(written(tmp_path, urdf())).compile()
    home = robot.home(model)
    np.testing.assert_allclose(kinematics_of(model).forward(home[None])[0][:3, 2], (0, 0, -1), atol=1e-9)
    assert (np.abs(home) <= 2.8).all()
    assert LinkPairs(model).is_free(home, {})


def fork(apart: float = 0.09) -> trimesh.Trimesh:
    """Return two plates with a web behind them: a body between them touches the hull but not the fork."""
    sides = [
        trimesh.creation.box((0.24, 0.01, 0.12), trimesh.transformations.translation_matrix((0.2, y, 0)))
        for y in (-apart, apart)
    ]
    return trimesh.util.concatenate(
        [*sides, trimesh.creation.box((0.02, 0.19, 0.12), trimesh.transformations.translation_matrix((0.09, 0, 0)))]
    )


def test_hulls_that_touch_are_decided_by_triangles(tmp_path: Path) -> None:
    """Between the plates of a fork the last link is always free; with the hull it would always collide."""
    fork().export(tmp_path / "fork.stl")
    text = urdf(l4='<geometry><mesh filename="fork.stl"/></geometry>')
    model = robot_spec.load_robot(written(tmp_path, text)).compile()
    own = LinkPairs(model)
    assert [model.geom(geom).name for geom in own.shapes.nonconvex] == ["link_4_0"]
    a, b = model.geom("link_4_0").id, model.geom("link_6_0").id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    own.set_configuration(np.zeros(6))
    assert mujoco.mj_geomDistance(model, data, a, b, 1.0, None) < 0
    # The disc, 40 mm square, reaches 28.3 mm from its axis at most; at zero its side is 85 - 20 mm from a plate.
    assert own.distance(("link_4", "link_6"), 1.0) == pytest.approx(0.065, abs=1e-6)
    assert not own.classify().joined


def forked(folder: Path, apart: float) -> Path:
    """Write an arm whose last link, a square of 40 mm, turns between the plates of a fork at +-`apart` [m]."""
    fork(apart).export(folder / "fork.stl")
    return written(folder, urdf(l4='<geometry><mesh filename="fork.stl"/></geometry>'))


def test_links_that_are_always_near_are_proven_separate(tmp_path: Path) -> None:
    """Between plates 62 mm apart the square keeps 31 mm minus half its diagonal: the proof confirms it."""
    path = forked(tmp_path, 0.036)
    model = robot_spec.load_robot(path).compile()
    assert "apart_link_4_link_6" in {model.exclude(i).name for i in range(model.nexclude)}
    ((pair, message),) = report(path)[0].apart.items()
    nearest = 0.031 - 0.02 * np.sqrt(2)
    assert pair == "link_4 with link_6"
    assert 0.5 * nearest <= message / 1000 <= 0.002
    own, bodies = LinkPairs(model), [model.body(name).id for name in ("link_4", "link_6")]
    assert not prove_separation(model, own.shapes, *bodies, 1.05 * nearest)
    world = compile_world(Scene.model_validate({"robot": {"model": str(path)}}), CUBE)
    assert not [pair for pair in MujocoCollisionChecker(world).contacts(Q) if "link_6 with link_4" in pair]
    assert (world.refinement, world.clearance_reduction) == (1.0, {})


def test_a_changed_mesh_is_read_again(tmp_path: Path) -> None:
    """An unchanged description with a changed mesh is another arm."""
    of = Scene.model_validate({"robot": {"model": str(forked(tmp_path, 0.09))}}).robot
    widths = []
    for plates in (0.09, 0.11):
        fork(plates).export(tmp_path / "fork.stl")
        os.utime(tmp_path / "fork.stl", (1e9 * plates, 1e9 * plates))  # MuJoCo keeps meshes by the second
        model = robot_spec.robot_spec(of).compile()
        widths.append(np.ptp(mesh_of(model, model.geom("link_4_0").id).vertices[:, 1]))
    np.testing.assert_allclose(widths, (0.19, 0.23), atol=1e-6)


def test_sampled_poses_without_contact_are_no_proof(tmp_path: Path) -> None:
    """The square's corners touch the plates between the sampled poses, so the pair is checked."""
    path = forked(tmp_path, 0.0325)
    own = LinkPairs(normalise(robot_file.read_robot(path)).compile())
    own.q = 0.01 * own.q
    found = own.classify()
    assert (found.joined, found.separate) == ([], [])
    assert [pair[:2] for pair in found.reduced] == [("link_4", "link_6")]
    distances = []
    for q in own.q:
        own.set_configuration(q)
        distances.append(own.distance(("link_4", "link_6"), 1.0))
    assert found.reduced[0][2] == pytest.approx(max(distances) / 2, abs=1e-7)


@pytest.mark.parametrize("levers", ["", LEVER])
def test_the_motion_bound_of_the_proof_holds(tmp_path: Path, levers: str) -> None:
    """Random steps of the axes between two bodies change their distance by no more than the sum of the bounds."""
    model = robot_spec.load_robot(written(tmp_path, urdf(levers))).compile()
    shapes, data, followers = ShapeDistances(model, {}, []), mujoco.MjData(model), robot.MimicJoints.from_model(model)
    pairs = [("link_4", "link_6"), ("link_2", "link_4"), ("base", "link_2")] + [("link_3", "lever")] * bool(levers)
    rng = np.random.default_rng(3)
    for names in pairs:
        one, other = (model.body(name).id for name in names)
        axes, moved = self_collision.axes_between(model, one, other)
        shape = int(model.body_geomadr[one]), int(model.body_geomadr[other])
        for _ in range(200):
            q = rng.uniform(-2.8, 2.8, (1, 6)).repeat(2, axis=0)
            step = rng.uniform(-0.4, 0.4, len(axes))
            q[1, axes] += step
            distances = []
            for angles in followers.qpos(q):
                data.qpos[:] = angles
                mujoco.mj_kinematics(model, data)
                distances.append(max(shapes.distance(data, *shape, 5.0), 0.0))
            assert abs(distances[0] - distances[1]) <= (moved @ np.abs(step)).min() + 1e-9


@pytest.mark.parametrize("number", [1, 3, 6])
def test_a_link_without_shape_has_a_motion_bound(tmp_path: Path, number: int) -> None:
    """The arm is checked like any other, and no corner of a link moves farther than the bound on its travel."""
    box = f'<collision><origin xyz="{_text(CHAIN[number - 1][2])}"/>'
    text = urdf()
    begin = text.index(box)
    text = text[:begin] + text[text.index("</collision>", begin) + len("</collision>") :]
    world = compile_world(Scene.model_validate({"robot": {"model": str(written(tmp_path, text))}}), CUBE)
    assert f"link_{number}" not in world.entities
    assert not find_problems(world)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 2, 6))
    bound, data, moved = MujocoCollisionChecker(world).travel(q[:, 0], q[:, 1]), world.data(), np.zeros(50)
    for k, ends in enumerate(q):
        corners = []
        for data.qpos[:] in ends:
            mujoco.mj_kinematics(world.model, data)
            geoms = [geom for geom, name in enumerate(world.entities) if name in (*robot.LINKS, "housing")]
            corners.append(np.concatenate([enclosing_points(world.model, data, geom)[0] for geom in geoms]))
        moved[k] = np.linalg.norm(corners[1] - corners[0], axis=1).max()
    assert (moved <= bound).all()
    assert (bound < 8 * moved).all()


def test_links_that_are_near_and_can_touch_are_checked_with_a_smaller_clearance(tmp_path: Path) -> None:
    """Two links that are always nearer than 20 mm and can touch are checked with half of their largest distance."""
    world = compile_world(Scene.model_validate({"robot": {"model": str(forked(tmp_path, 0.032))}}), CUBE)
    pair = tuple(world.model.geom(f"link_{number}_0").id for number in (4, 6))
    keep = world.clearance - world.clearance_reduction[pair]
    assert keep == pytest.approx(0.0035, abs=2e-4)  # lying flat the square is 27 - 20 mm from a plate
    data = world.data()
    data.qpos[:] = Q
    mujoco.mj_kinematics(world.model, data)
    assert world.shapes.distance(data, *pair, 0.3) == pytest.approx(0.007, abs=1e-6)
    assert world.distance(data, *pair, 0.3) == pytest.approx(0.007 + world.clearance - keep, abs=1e-6)
    replay_model = SimpleNamespace(
        model=world.model,
        geom_names=world.entities,
        clearance=world.clearance,
        pair_clearances=robot.reduced_clearances(world.model),
        shapes=world.shapes,
    )
    assert not [touch for touch in find_violations(replay_model, data) if touch.names == "link_6 with link_4"]  # type: ignore[arg-type]
    replay_model.pair_clearances = {}
    assert [touch for touch in find_violations(replay_model, data) if touch.names == "link_6 with link_4"]  # type: ignore[arg-type]
    checker, q_to = MujocoCollisionChecker(world), Q + np.array([0, 0, 0, 0, 0, 2.0])
    looks = subdivide(Q[None], q_to[None], checker)[0]
    moved = TravelBound(world.model)(looks[:-1], looks[1:]) / 2  # travel to the nearer of the two checks
    assert 2 * moved.max() < keep


TWO_BOXES = """<geometry><box size="0.05 0.05 0.05"/></geometry></collision><collision><origin xyz="{x} {y} 0"/>
    <geometry><box size="0.06 0.02 0.02"/></geometry>"""


@pytest.mark.parametrize(
    ("x", "y", "excluded"),
    [
        (0.1, 0.0, "bolted_bracket_link_5"),  # a finger of the hand that sticks in the bracket's end
        (0.13, 0.05, None),  # an offset finger that meets the bracket at some angles only
        (0.0, 0.045, "apart_bracket_link_5"),
    ],
)
def test_the_bracket_is_excluded_from_link_5_only_if_justified(
    tmp_path: Path, x: float, y: float, excluded: str | None
) -> None:
    """The pair is excluded if it touches at all wrist angles or provably at none; otherwise it is checked."""
    path = written(tmp_path, urdf(l5=TWO_BOXES.format(x=x, y=y)))
    mount = {"position_mm": (100.0, 0.0, 120.0)}
    world = compile_world(Scene.model_validate({"robot": {"model": str(path)}, "mount": mount}), CUBE)
    names = {world.model.exclude(i).name for i in range(world.model.nexclude)}
    assert {name for name in names if name.endswith("bracket_link_5")} == ({excluded} if excluded else set())
    checked = {frozenset((world.entities[a], world.entities[b])) for a, b in world.pairs}
    assert (frozenset(("bracket", "link_5")) in checked) is (excluded is None)


def test_links_that_always_touch_are_excluded_and_reported(tmp_path: Path) -> None:
    """A block on link 1 around the far end of link 3 is excluded if and only if it always touches."""
    block = '<link name="block"><collision><geometry><box size="0.05 0.05 0.05"/></geometry></collision></link>'
    joint = """<joint name="turn" type="continuous"><parent link="l1"/><child link="block"/>
        <origin xyz="0.1 0 0.2"/><axis xyz="0 1 0"/><mimic joint="j2"/></joint>"""
    long = '<origin xyz="0 0.15 0.25"/><geometry><box size="0.08 0.38 0.6"/></geometry>'
    model = robot_spec.load_robot(written(tmp_path, urdf(block + joint, l2=long))).compile()
    excluded = [model.exclude(i).name for i in range(model.nexclude)]
    assert "joined_link_2_block" in excluded
    assert sum(name.startswith("joined_") for name in excluded) == 1
    # The cache identifies links by name: another name is another arm.
    renamed = written(tmp_path, urdf((block + joint).replace('"block"', '"stop"'), l2=long))
    assert "joined_link_2_stop" in {each.name for each in robot_spec.load_robot(renamed, stamp=(1,)).excludes}


def test_a_mesh_is_replaced_by_its_hull_only_if_convex() -> None:
    """A ball is convex; a fork and a ball with a dent are not."""
    ball = trimesh.creation.icosphere(3, 0.1)
    assert is_convex(TriangleMesh(ball.vertices, ball.faces.astype(np.int32)))
    assert not is_convex(TriangleMesh(fork().vertices, fork().faces.astype(np.int32)))
    dent = ball.vertices * np.where(ball.vertices[:, :1] > 0.09, 0.85, 1.0)
    assert not is_convex(TriangleMesh(dent, ball.faces.astype(np.int32)))


@pytest.mark.parametrize("base", [None, {"position_mm": (0, 0, 2000), "abc_deg": (0, 0, 180)}])
def test_a_cell_checks_the_arm_and_bounds_its_travel(tmp_path: Path, base: dict[str, object] | None) -> None:
    """No point of an upright or hanging arm moves beyond the bound, and the flange pose equals the kinematics."""
    path = written(tmp_path, urdf(LEVER))
    scene = Scene.model_validate({"robot": {"model": str(path), "base": base, "pedestal_height_mm": 0}})
    world = compile_world(scene, CUBE)
    assert ("pedestal" in world.entities) is False
    checker, kinematics = MujocoCollisionChecker(world), kinematics_of(world.model)
    rng = np.random.default_rng(2)
    q_from = rng.uniform(-2, 2, (30, 6))
    q_to = q_from + rng.normal(0, 0.3, (30, 6))
    bound = checker.travel(q_from, q_to)
    data = world.data()
    arm = [geom for geom, name in enumerate(world.entities) if name.startswith("link_") or name == "lever"]
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])

    def at(q: np.ndarray) -> np.ndarray:
        data.qpos[:] = world.mimic_joints.qpos(q)
        mujoco.mj_kinematics(world.model, data)
        placed = [
            data.geom_xpos[geom] + (corners * world.model.geom_size[geom]) @ data.geom_xmat[geom].reshape(3, 3).T
            for geom in arm
        ]
        return np.concatenate(placed)

    for one, other, most in zip(q_from, q_to, bound, strict=True):
        assert np.linalg.norm(at(one) - at(other), axis=1).max() <= most
        T = kinematics.forward(other[None])[0]
        np.testing.assert_allclose(data.site("flange").xpos, T[:3, 3], atol=1e-9)


def test_names_of_levers_and_of_the_cell_are_distinct(tmp_path: Path) -> None:
    """A lever may have the name of a shape of the cell; a fixture must not have that of a lever."""
    for name in ("rotary table", "tool of a home", "link_3"):
        path = written(tmp_path, urdf(LEVER.replace('"lever"', f'"{name}"')))
        assert robot_spec.load_robot(path).body(f"{name} of the robot") is not None
        robot_spec.load_robot.cache_clear()
    clamp = {"name": "lever", "shape": "box", "size_mm": (10.0, 10.0, 10.0), "position_mm": (0.0, 900.0, 0.0)}
    settings = {"robot": {"model": str(written(tmp_path, urdf(LEVER)))}, "fixtures": [clamp]}
    with pytest.raises(CellError, match=r"fixtures\[0\].name is 'lever', a shape of the cell's own"):
        compile_world(Scene.model_validate(settings), CUBE)


def test_mimic_joints_on_the_base_are_in_the_travel_bound(tmp_path: Path) -> None:
    """A lever on the base that is driven by A3 moves within the bound while no link moves."""
    long = LEVER.replace('parent link="l2"', 'parent link="base_link"').replace('"0 -0.2 0.1"', '"0.9 0 0"')
    long = long.replace('multiplier="-0.5"', 'multiplier="5"')
    scene = Scene.model_validate({"robot": {"model": str(written(tmp_path, urdf(long)))}})
    checker = MujocoCollisionChecker(compile_world(scene, CUBE))
    turned = np.array([[0, 0, 0.01, 0, 0, 0]])
    moved = 2 * 0.9 * np.sin(5 * 0.01 / 2)  # the middle of its box
    assert moved <= checker.travel(0 * turned, turned)[0] <= 1.3 * moved


@pytest.mark.parametrize(("tip", "is_checked"), [(0, False), (0.5, True)])
def test_a_first_link_that_tips_is_checked_against_the_floor(tmp_path: Path, tip: float, is_checked: bool) -> None:
    """With a tilted A1 link_1 can move down: floor and pedestal are checked against it."""
    text = urdf().replace('<origin xyz="0 0 0.3"/>', f'<origin xyz="0 0 0.3" rpy="{tip} 0 0"/>', 1)
    assert "rpy" in text.split("j2")[0]
    world = compile_world(Scene.model_validate({"robot": {"model": str(written(tmp_path, text))}}), CUBE)
    pairs = {frozenset((world.entities[a], world.entities[b])) for a, b in world.pairs}
    assert (frozenset(("link_1", "floor")) in pairs) is is_checked
    assert (frozenset(("link_1", "pedestal")) in pairs) is is_checked


def test_links_are_compared_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A note announces the comparison of an unknown arm; the next process reads its result."""
    monkeypatch.setattr(logging.getLogger("cell.world.self_collision"), "disabled", False)
    own = LinkPairs(normalise(robot_file.read_robot(written(tmp_path, urdf()))).compile())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "nothing_known"))
    classes = own.classify()
    assert [record.getMessage()[:31] for record in caplog.records] == ["comparing the links of the robo"]
    caplog.clear()
    again = own.classify()
    assert (again.joined, again.reduced) == ([list(p) for p in classes.joined], [list(p) for p in classes.reduced])
    assert not caplog.records


def test_a_pair_that_touched_once_is_not_excluded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pair that touches only at the first sampled pose gets half of the largest sampled distance as clearance."""
    own = LinkPairs(robot_spec.load_robot(written(tmp_path, urdf())).compile())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "nothing_known"))
    pair = next(iter(own.pairs))
    own.pairs = {pair: own.pairs[pair]}
    distances: list[float] = []

    def move(q: np.ndarray) -> None:
        distances.append(0.015 if distances else 0.0)

    own.set_configuration, own.in_contact = move, lambda _: distances[-1] <= 0  # type: ignore[method-assign]
    own.distance = lambda _, reach: distances[-1] - 0.01 * (len(distances) == 3)  # type: ignore[method-assign]
    own.is_nearer = lambda pair, reach: own.distance(pair, reach) < reach  # type: ignore[method-assign]
    assert own.classify().reduced == [(*pair, 0.0075)]


def no_mesh(text: str) -> str:
    """Return the text with a mesh of a missing package."""
    return text.replace('<box size="0.05 0.05 0.05"/>', '<mesh filename="package://acme/hand.stl"/>')


def five_axes(text: str) -> str:
    """Return the text with a fixed last axis."""
    return text.replace('"j6" type="revolute"', '"j6" type="fixed"')


def millimetres(text: str) -> str:
    """Return the text with lengths a thousand times longer."""
    root = ElementTree.fromstring(text)
    for origin in root.iter("origin"):
        origin.set("xyz", " ".join(str(1000 * float(value)) for value in origin.get("xyz", "0 0 0").split()))
    return ElementTree.tostring(root, encoding="unicode")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (urdf(limit=""), "'j1' has no limits; add <limit lower upper velocity>"),
        (
            urdf(limit='<limit lower="-1" upper="1" velocity="0" effort="0"/>'),
            "give the speeds of the six axes as robot.velocity_deg_s",
        ),
        *(
            (urdf(limit=f'<limit lower="{low}" upper="{high}" velocity="3" effort="0"/>'), "has the empty range")
            for low, high in (("0", "0"), ("1", "-1"), ("nan", "1"), ("-inf", "inf"))
        ),
        (urdf().replace('<child link="l3"/>', '<child link="l3"/><mimic joint="j2"/>'), "'j3' is one of the six"),
        (urdf(SLIDES), "'drive' mimics 'j3' and slides"),
        (urdf().replace("tool0", "hand"), "name the flange's link"),
        (five_axes(urdf()), "has 5 joints from 'base_link' to 'tool0'"),
        (millimetres(urdf()), "seems to be in millimetres"),
        (no_mesh(urdf()), "--package acme=DIR"),
    ],
)
def test_a_mistake_has_a_clear_message(tmp_path: Path, text: str, words: str) -> None:
    """The message names the file, the error and the remedy in one line."""
    path = written(tmp_path, text)
    with pytest.raises(CellError) as message:
        robot_spec.load_robot(path)
    assert words in str(message.value)
    assert str(path) in str(message.value)
    assert "\n" not in str(message.value)


CAPSULES = """<mujoco model="small"><worldbody><body name="foot"><geom type="box" size="0.1 0.1 0.2"/>
  <body name="b1" pos="0 0 0.3"><joint name="q1" axis="0 0 1" range="-170 170"/><geom type="sphere" size="0.08"/>
  <body name="b2" pos="0.1 0 0.2"><joint name="q2" axis="0 1 0" range="-170 170"/>
    <geom type="capsule" size="0.03" fromto="0 0.1 0 0 0.1 0.5"/>
  <body name="b3" pos="0 0 0.5"><joint name="q3" axis="0 1 0" range="-170 170"/><geom type="capsule" size="0.03 0.05"/>
  <body name="b4" pos="0.25 0 0.1"><joint name="q4" axis="1 0 0" range="-170 170"/><geom type="sphere" size="0.03"/>
  <body name="b5" pos="0.25 0 0"><joint name="q5" axis="0 1 0" range="-170 170"/><geom type="sphere" size="0.03"/>
  <body name="b6" pos="0.05 0 0"><joint name="q6" axis="1 0 0" range="-170 170"/>
    <geom type="ellipsoid" size="0.01 0.02 0.02"/><site name="flange" pos="0.03 0 0" euler="0 90 0"/>
  </body></body></body></body></body></body></body></worldbody>
  <keyframe><key name="home" qpos="0 0 0.5 0 1 0"/></keyframe></mujoco>"""


FALLS = "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"


def test_warnings_about_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A hinge without a range and warnings of MuJoCo give one sentence each. No other output is printed."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "arm.xml"
    text = CAPSULES.replace('axis="1 0 0" range="-170 170"', 'axis="1 0 0"')
    path.write_text(text.replace("<worldbody>", '<compiler settotalmass="9"/><worldbody>'), encoding="utf-8")
    message, _ = report(path)
    assert message.limits_deg[3] == (-360.0, 360.0)
    robot_settings = {"model": str(path), "velocity_deg_s": (90.0,) * 6}
    world = compile_world(Scene.model_validate({"robot": robot_settings}), CUBE)
    assert message.missing[:2] == tuple(find_warnings(world))
    assert "arm.xml: MuJoCo warns that compiler attribute 'settotalmass' is deprecated" in message.missing[0]
    assert "arm.xml gives no range of q4, q6: -360 to 360 deg is assumed" in message.missing[1]
    assert all("\n" not in sentence for sentence in message.missing)
    with capture_mujoco_warnings() as output:
        mujoco.mj_forward(of := mujoco.MjModel.from_xml_string(FALLS), data := mujoco.MjData(of))
        data.qpos[2] = np.nan
        mujoco.mj_step(of, data)
    assert "Nan" in output[0]
    assert capfd.readouterr() == ("", "")
    assert {each.name for each in tmp_path.iterdir()} == {"arm.xml", "cache"}
    path.write_text(CAPSULES, encoding="utf-8")
    assert robot_file.read_robot(path).warnings == ()
    path.write_text(CAPSULES.replace('euler="0 90 0"', 'euler="0 0 0"'), encoding="utf-8")  # x leaves the face
    (sentence,) = robot_file.read_robot(path).warnings
    assert sentence.startswith("arm.xml: z of the link 'flange' is across A6")


@pytest.mark.parametrize(("links", "flange"), [(("flange", "fanuc_flange"), "fanuc_flange"), (("flange",), "flange")])
def test_the_default_flange_has_its_z_along_a6(links: tuple[str, ...], flange: str, tmp_path: Path) -> None:
    """Of links with usual names the first with z out of the face is taken; x of Fanuc's `flange` leaves it."""
    text = urdf().replace("tool0", links[-1])
    if len(links) == 1:
        text = text.replace(' rpy="0 1.5707963267948966 0"', "")
    else:
        text = text.replace(
            "</robot>",
            """<link name="flange"/><joint name="f" type="fixed"><parent link="l6"/>
            <child link="flange"/></joint></robot>""",
        )
    file = robot_file.read_robot(written(tmp_path, text))
    assert (file.flange, len(file.warnings)) == (flange, 2 - len(links))


def test_fixed_shapes_beside_the_base_belong_to_the_arm(tmp_path: Path) -> None:
    """A column on the parent of base_link keeps its pose; the floor of an MJCF is omitted."""
    column = """<link name="table"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 1"/></geometry>
        </collision></link><joint name="stands" type="fixed"><parent link="table"/><child link="base_link"/>
        <origin xyz="0.4 0 0.7" rpy="0 0 1"/></joint>"""
    model = robot_spec.load_robot(written(tmp_path, urdf(column)), base_link="base_link").compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert model.body("base").geomnum[0] == 2
    turn = np.array([[np.cos(1), np.sin(1), 0], [-np.sin(1), np.cos(1), 0], [0, 0, 1]])
    stands = [data.geom_xpos[geom] for geom in range(model.ngeom) if model.geom_size[geom][2] == 0.5]
    np.testing.assert_allclose(stands, [turn @ (-0.4, 0, 0.5 - 0.7)], atol=1e-12)
    path = tmp_path / "arm.xml"
    path.write_text(CAPSULES.replace("<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>'), encoding="utf-8")
    assert robot_spec.load_robot(path, velocity_deg_s=(90.0,) * 6).compile().body("base").geomnum[0] == 1


def test_round_shapes_of_an_mjcf_are_enclosed(tmp_path: Path) -> None:
    """A capsule becomes an enclosing polyhedron at most 5 % larger; the key home is used."""
    path = tmp_path / "arm.xml"
    path.write_text(CAPSULES, encoding="utf-8")
    model = robot_spec.load_robot(path, velocity_deg_s=(90.0,) * 6).compile()
    np.testing.assert_allclose(robot.home(model), (0, 0, 0.5, 0, 1, 0), atol=1e-9)
    np.testing.assert_allclose(np.degrees(robot.limits(model).velocity), 90.0)
    mesh = mesh_of(model, model.geom("link_2_0").id)
    off = mesh.vertices - (0, 0.1, 0)
    off[:, 2] -= np.clip(off[:, 2], 0, 0.5)
    assert (np.linalg.norm(off, axis=1) <= 0.03 * 1.05).all()
    middles = mesh.vertices[mesh.faces].mean(axis=1) - (0, 0.1, 0)
    middles[:, 2] -= np.clip(middles[:, 2], 0, 0.5)
    assert (np.linalg.norm(middles, axis=1) >= 0.03 - 1e-7).all()


def test_an_arm_from_a_file_is_planned_verified_and_driven(tmp_path: Path, run_cell: RunCommand) -> None:
    """The arm of a file is planned, scanned and explored. The plan keeps its robot, and a changed file is detected."""
    written(tmp_path, urdf(LEVER))
    trimesh.creation.box((50, 50, 40)).export(tmp_path / "block.stl")
    scene = """[robot]
        model = "arm.urdf"
        [placement]
        position_mm = [600, 150, 450]"""
    (tmp_path / "cell.toml").write_text(scene, encoding="utf-8")
    message = json.loads(run_cell("robot", "arm.urdf", "--json", cwd=tmp_path).stdout)
    assert message["family"] == "spherical wrist"
    assert message["residual_mm"] < 1e-6
    assert message["followers"] == ["drive by A3 x -0.5"]
    options = ("--faces", "40", "--samples", "1", "--candidates", "optimal-scanning-zone", "--coverage", "0.9")
    run_cell("plan", "block.stl", "--units=mm", "--scene=cell.toml", *options, "--out=run", cwd=tmp_path, code=0)
    assert "robot.xml" in json.loads((tmp_path / "run/manifest.json").read_text())["artefacts"]
    run_cell("scan", "run", "--resolution=1", cwd=tmp_path, code=0)
    run_cell("edit", "run", "--keep-order", "--out=edited", cwd=tmp_path, code=0)
    assert json.loads((tmp_path / "edited/scene.resolved.json").read_text())["robot"]["name"] == "arm.urdf"
    run_cell("export", "edited", "--format=csv", "--scene=cell.toml", cwd=tmp_path, code=0)
    run_cell("export", "run", "--format=ros", "--out=ros", "--name=trial", cwd=tmp_path, code=0)
    trajectory = json.loads((tmp_path / "ros/trial_trajectory.json").read_text())
    assert trajectory["joint_names"] == ["A1", "A2", "A3", "A4", "A5", "A6"]
    exported = robot_file.read_robot(tmp_path / "ros/trial.urdf", base="base", flange="link_6")
    assert exported.mimic_joints == (robot_file.MimicJoint("drives_lever", 2, -0.5, 0.0),)
    np.testing.assert_allclose(exported.velocity, 3.0, rtol=1e-9)
    process = run_cell("scan", "run", "--driver=sim://?plant=mujoco", cwd=tmp_path)
    assert "the plant 'mujoco' models the built-in arm, and this plan is for arm.urdf" in process.stderr, process.stderr
    few = ("--resolution=1", "--ring=2", "--batch=1", "--max-views=2", "--out=explored")
    run_cell("explore", "block.stl", "--units=mm", "--scene=cell.toml", *options[:-2], *few, cwd=tmp_path, code=0)
    written(tmp_path, urdf())
    process = run_cell("scan", "run", cwd=tmp_path, code=2)
    assert "the robot's file" in process.stderr
